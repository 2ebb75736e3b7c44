"""The state of a run between two steps: it goes back, to a file, and on in another process."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from cosim.errors import SetupError
from cosim.files.whole import write_whole

#: Version of the files; another one is not read.
_FORMAT = 2


#: Names in messages for properties of a run.
_WORDS = {
    "step_size": "communication step",
    "start_time": "start time",
    "fmus": "FMU file of",
    "tolerances": "tolerance of",
    "components": "interval of",
    "start_values": "start value of",
    "connections": "source of",
    "signals": "signal of",
    "names": "recorded variables",
}


def _said(value: Any) -> str:
    return "none" if value is None else str(value)


@dataclass(frozen=True)
class RunState:
    """The state of a run at a communication point; `SteppedRun.save` gives it, and `SteppedRun.restore` takes it.

    Attributes
    ----------
    made_with : dict
        What the run was made with, which must be the same where the state is restored: FMUs by their SHA-256,
        start values, connections, algorithm, communication step and start time (s), recorded names.
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
    texts : sequence of str or bytes
        What the numbers of texts and binary values in the arrays stand for.
    notes : mapping
        Numbers that who saved the state wants back.
    """

    made_with: dict[str, Any]
    point: int
    fmus: Mapping[str, bytes]
    values: np.ndarray
    history: np.ndarray
    recorded: np.ndarray
    texts: Sequence[str | bytes] = ("",)
    notes: Mapping[str, float] = field(default_factory=dict)

    def differences(self, made_with: Mapping[str, Any]) -> list[str]:
        """Differences to how another run was made, in words; a property that only one of them has does not count."""
        found = []
        for key in (key for key in made_with if key in self.made_with):
            then, now = self.made_with[key], json.loads(json.dumps(made_with[key]))
            if then == now:
                continue
            word = _WORDS.get(key, key)
            if isinstance(then, dict) and isinstance(now, dict):
                part = next(p for p in {**then, **now} if then.get(p) != now.get(p))
                word, then, now = f"{word} {part}", then.get(part), now.get(part)
            hides = key in ("fmus", "signals", "names") or isinstance(then, dict | list)
            found.append(word if hides else f"{word}: {_said(then)} then, {_said(now)} now")
        return found

    def write(self, path: str | PathLike[str]) -> None:
        """Write a file; an older one of that name stays whole until the new one is on the disk.

        Raises
        ------
        OSError
            The file can't be written.
        """
        head = {
            "format": _FORMAT,
            "made_with": self.made_with,
            "point": self.point,
            "components": list(self.fmus),
            "texts": [text if isinstance(text, str) else {"binary": text.hex()} for text in self.texts],
            "notes": dict(self.notes),
        }
        states = {f"fmu_{i}": np.frombuffer(data, np.uint8) for i, data in enumerate(self.fmus.values())}
        arrays = {"values": self.values, "history": self.history, "recorded": self.recorded, **states}
        content = io.BytesIO()
        np.savez(content, head=np.array(json.dumps(head)), **arrays)  # type: ignore[arg-type]
        write_whole(Path(path), lambda part: part.write_bytes(content.getbuffer()))

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
                arrays = (data["values"], data["history"], data["recorded"])
                texts = [text if isinstance(text, str) else bytes.fromhex(text["binary"]) for text in head["texts"]]
                return cls(head["made_with"], head["point"], fmus, *arrays, texts, head["notes"])
        except SetupError:
            raise
        except OSError as error:
            why = f"{error.strerror or error}; check the path"
            raise SetupError(f"{path}: can't be read as the state of a run: {why}") from error
        except Exception as error:  # numpy raises many kinds for damaged files
            why = "it is not one, or it is damaged; name a file that RunState.write wrote"
            raise SetupError(f"{path}: can't be read as the state of a run: {why}") from error
