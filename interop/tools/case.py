"""What a peer is given (`Case`) and what it gives back (`ToolRun`), each also as a file, to cross process borders."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

#: The position of the end effector where the robot is an instance of its own.
PATH = ("plant.x_E", "plant.y_E")


@dataclass(frozen=True)
class Case:
    """A system of FMUs and how long to run it; inputs that are not connected keep their start values.

    Attributes
    ----------
    fmus : mapping
        Instance name -> FMU file.
    connections : list of (str, str)
        (output, input), scalars `instance.variable`, in the order in which a sequential master exchanges them: where
        an output follows an input at once, that input comes first.
    start : mapping
        Instance name -> start values of scalars.
    stop_time, step_size : float
        In s; the start is at 0 and the stop time is a whole number of steps.
    recorded : list of str
        Scalars `instance.variable` to record at each communication point, those of `path` among them.
    path : (str, str)
        What is compared between masters: the position of the end effector (m).
    """

    fmus: Mapping[str, Path]
    connections: list[tuple[str, str]]
    start: Mapping[str, Mapping[str, float]]
    stop_time: float
    step_size: float
    recorded: list[str]
    path: tuple[str, str] = PATH

    @property
    def steps(self) -> int:
        """Number of communication steps."""
        return round(self.stop_time / self.step_size)

    @property
    def times(self) -> np.ndarray:
        """Communication points (steps + 1,) in s."""
        return np.arange(self.steps + 1) * self.step_size

    def recorded_of(self, instance: str) -> list[str]:
        """Names of the recorded variables of one instance."""
        return [name for owner, name in map(split, self.recorded) if owner == instance]

    def references(self) -> dict[str, dict[str, int]]:
        """Instance name -> variable name -> FMI value reference."""
        import fmpy

        descriptions = {instance: fmpy.read_model_description(fmu) for instance, fmu in self.fmus.items()}
        return {i: {v.name: v.valueReference for v in d.modelVariables} for i, d in descriptions.items()}

    def to_json(self, path: Path) -> None:
        """Write the case to a file."""
        fmus = {instance: str(Path(fmu).resolve()) for instance, fmu in self.fmus.items()}
        path.write_text(json.dumps(asdict(self) | {"fmus": fmus}, indent=1), encoding="utf-8")

    @classmethod
    def from_json(cls, path: Path) -> Case:
        """Read a case from a file that `to_json` wrote."""
        data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        data["fmus"] = {instance: Path(fmu) for instance, fmu in data["fmus"].items()}
        data["path"] = tuple(data["path"])
        data["connections"] = [(source, target) for source, target in data["connections"]]
        return cls(**data)


def split(path: str) -> tuple[str, str]:
    """Instance and variable of a name `instance.variable`; variables may hold dots, instances may not."""
    instance, _, variable = path.partition(".")
    return instance, variable


@dataclass
class ToolRun:
    """What a peer did.

    Attributes
    ----------
    loop_time_s : float
        Wall time from the first step to the last, recording included; set-up excluded unless `note` says otherwise.
    total_time_s : float
        Wall time of everything from the FMU files to the recorded values in memory (not the start of the process).
    time, x_E, y_E : array (n,)
        Communication points (s) and end-effector position there (m).
    order : str
        How the peer exchanges values.
    recorded : int
        Number of values recorded at each communication point.
    note : str
        What else a reader of the figures has to know; may be empty.
    """

    loop_time_s: float
    total_time_s: float
    time: np.ndarray
    x_E: np.ndarray
    y_E: np.ndarray
    order: str
    recorded: int
    note: str = ""

    def to_npz(self, path: Path) -> None:
        """Write the run to a file."""
        np.savez(path, **asdict(self))

    @classmethod
    def from_npz(cls, path: Path) -> ToolRun:
        """Read a run from a file that `to_npz` wrote."""
        with np.load(path) as data:
            return cls(**{name: data[name] if data[name].ndim else data[name].item() for name in data.files})
