"""The state of a run between two steps: it goes back, to a file, and on in another process."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from cosim.errors import SetupError

#: Version of the files; another one is not read.
_FORMAT = 1


@dataclass(frozen=True)
class RunState:
    """What a run was at a communication point; `SteppedRun.save` gives it, and `SteppedRun.restore` takes it.

    Attributes
    ----------
    made_with : dict
        What the run was made with, which must be the same where the state is restored: FMUs by their SHA-256,
        algorithm, communication step and start time (s), recorded names.
    point : int
        Number of the communication point.
    fmus : mapping
        Component -> serialised state of its FMU or of its function in Python.
    values : array (n,)
        Exchanged values.
    history : array (n,)
        What extrapolated inputs know of earlier communication points.
    recorded : array (rows, columns)
        Rows recorded before this communication point.
    """

    made_with: dict[str, Any]
    point: int
    fmus: Mapping[str, bytes]
    values: np.ndarray
    history: np.ndarray
    recorded: np.ndarray

    def write(self, path: str | PathLike[str]) -> None:
        """Write a file; an older one of that name stays whole until the new one is.

        Raises
        ------
        OSError
            The file can't be written.
        """
        target = Path(path)
        part = target.with_name(f"{target.name}.part")
        head = {"format": _FORMAT, "made_with": self.made_with, "point": self.point, "components": list(self.fmus)}
        states = {f"fmu_{i}": np.frombuffer(data, np.uint8) for i, data in enumerate(self.fmus.values())}
        arrays = {"values": self.values, "history": self.history, "recorded": self.recorded, **states}
        with part.open("wb") as stream:
            np.savez(stream, head=np.array(json.dumps(head)), **arrays)  # type: ignore[arg-type]
        part.replace(target)

    @classmethod
    def read(cls, path: str | PathLike[str]) -> RunState:
        """Read a file that `write` wrote.

        Raises
        ------
        SetupError
            It is missing, or no such file.
        """
        try:
            with Path(path).open("rb") as stream, np.load(stream, allow_pickle=False) as data:
                head = json.loads(str(data["head"]))
                if head["format"] != _FORMAT:
                    raise SetupError(f"{path}: state of another version of this program; run again from the start")
                fmus = {name: data[f"fmu_{i}"].tobytes() for i, name in enumerate(head["components"])}
                made_with, point = head["made_with"], head["point"]
                return cls(made_with, point, fmus, data["values"], data["history"], data["recorded"])
        except SetupError:
            raise
        except Exception as error:  # numpy raises many kinds for damaged files
            raise SetupError(f"{path}: can't be read as the state of a run: {' '.join(str(error).split())}") from error
