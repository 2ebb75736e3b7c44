"""A case: the inputs of an FMU, what it should answer, and how near to that it has to be.

The files of a case lie in a folder of its name, and are named as in the FMI cross-check.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cosim.errors import CosimError, nearest
from cosim.regression.options import Options, read_options
from cosim.regression.tolerances import Interface, Tolerances, read_toml, tolerances_of
from cosim.results.results import Results

#: Endings of tables of a case; the first is that of a new reference.
ENDINGS = (".csv", ".parquet", ".mat", ".npz", ".json")

#: Interpolations of inputs between two rows of `<case>_in.csv`.
Between = Literal["linear", "hold"]

#: Solvers of model exchange: FMPy's CVode, Euler's explicit method, or the first of the two that agrees.
Solver = Literal["CVode", "Euler", "either"]
Method = Literal["CVode", "Euler"]


class CaseError(CosimError):
    """A case is incomplete, or its files don't fit each other."""


class RunError(CosimError):
    """An FMU could not be run to its end."""


@dataclass(frozen=True)
class Case:
    """Files `<name>_in.csv`, `<name>_ref.csv`, `<name>_ref.opt` and `<name>_ref.toml` of a folder; read when asked for.

    Only `<name>_ref.csv` has to be there. Tables may have another format that `Results.read` takes. The methods raise
    `CosimError` where a file can't be read.
    """

    name: str
    folder: Path

    @property
    def reference_path(self) -> Path:
        """The reference result."""
        return self._table("ref")

    @property
    def inputs_path(self) -> Path:
        """Values of inputs over time."""
        return self._table("in")

    def _table(self, what: str) -> Path:
        """The only file of a table that is there; the name of the CSV file where there is none."""
        found = [path for ending in ENDINGS if (path := self.folder / f"{self.name}_{what}{ending}").is_file()]
        if len(found) > 1:
            raise CaseError(f"{found[0]} and {found[1]} are both there; remove one of them")
        return found[0] if found else self.folder / f"{self.name}_{what}.csv"

    @property
    def options_path(self) -> Path:
        """Start, stop and step."""
        return self.folder / f"{self.name}_ref.opt"

    @property
    def tolerances_path(self) -> Path:
        """Tolerances, units, start values."""
        return self.folder / f"{self.name}_ref.toml"

    @property
    def paths(self) -> tuple[Path, ...]:
        """All files that a case may have."""
        return self.inputs_path, self.reference_path, self.options_path, self.tolerances_path

    @property
    def exists(self) -> bool:
        """Whether there is any of the files."""
        return any(path.is_file() for path in self.paths)

    def reference(self) -> Results:
        """The reference result."""
        if not self.reference_path.is_file():
            raise CaseError(
                f"case '{self.name}': there is no {self.reference_path}; "
                f"make it with: pytest --fmu <FMU> --fmu-reference <FOLDER> --fmu-rebaseline {self.name}"
            )
        return _in_order(self.reference_path)

    def inputs(self) -> Results | None:
        """Values of inputs over time; None where there is no such file, or it has times only."""
        inputs = _in_order(self.inputs_path) if self.inputs_path.is_file() else None
        return inputs if inputs is not None and len(inputs.time) else None

    def options(self) -> Options | None:
        """Start, stop and step; None where there is no such file."""
        return read_options(self.options_path) if self.options_path.is_file() else None

    @cached_property
    def _own_tables(self) -> dict[str, Any]:
        return read_toml(self.tolerances_path) if self.tolerances_path.is_file() else {}

    @property
    def _tables(self) -> dict[str, Any]:
        return self._own_tables

    def tolerances(self, interface: Interface) -> Tolerances:
        """Tolerances of one interface."""
        return tolerances_of(self.tolerances_path, self._tables, interface)

    @property
    def fmu(self) -> str:
        """Name of the FMU file without its ending: that of the case, unless the tolerances have a key `fmu`."""
        name = self._tables.get("fmu", self.name)
        if not isinstance(name, str):
            raise CaseError(f"{self.tolerances_path}: fmu = {name!r} must be the name of an FMU file, without .fmu")
        return name

    @property
    def between(self) -> Between:
        """Interpolation of inputs between two rows."""
        between: Between = self._tables.get("inputs", "linear")
        if between not in ("linear", "hold"):
            hint = nearest(str(between), ("linear", "hold"))
            raise CaseError(f"{self.tolerances_path}: inputs = {between!r} is unknown; {hint}")
        return between

    @property
    def solver(self) -> Solver:
        """What integrates in model exchange."""
        solver: Solver = self._tables.get("solver", "CVode")
        if solver not in ("CVode", "Euler", "either"):
            hint = nearest(str(solver), ("CVode", "Euler", "either"))
            raise CaseError(f"{self.tolerances_path}: solver = {solver!r} is unknown; {hint}")
        return solver

    @property
    def solver_step(self) -> float | None:
        """Step of Euler's method (s); None where the FMU or the communication step says it."""
        step = self._tables.get("solver_step")
        if step is None:
            return None
        if not isinstance(step, (int, float)) or isinstance(step, bool) or not 0.0 < step < float("inf"):
            raise CaseError(f"{self.tolerances_path}: solver_step = {step!r} must be a positive number (s)")
        return float(step)

    @property
    def is_compared(self) -> bool:
        """Whether there is a reference to compare with; else the FMU has to run to the end with finite values."""
        compared = self._tables.get("reference", True)
        if not isinstance(compared, bool):
            raise CaseError(f"{self.tolerances_path}: reference = {compared!r} must be true or false")
        return compared

    @property
    def start(self) -> Mapping[str, Any]:
        """Start values of parameters and inputs that differ from those of the FMU."""
        start = self._tables.get("start", {})
        if not isinstance(start, dict):
            raise CaseError(f"{self.tolerances_path}: start = {start!r} must be a table of start values")
        return start


def find_cases(fmu: str | PathLike[str], folder: str | PathLike[str] | None = None) -> list[Case]:
    """Cases of an FMU file.

    Parameters
    ----------
    fmu : path
    folder : path, optional
        Folder of cases, or of one; by default that of the FMU, else `reference` in it, else `reference` here.

    Returns
    -------
    list of Case
        Those named as the FMU file, and those whose tolerances name it; a case whose tolerances can't be read counts
        as one of the FMU that it is named after.
    """
    fmu = Path(fmu)
    if folder is None:
        for near in (fmu.parent, fmu.parent / "reference", Path("reference")):
            if near.is_dir() and (cases := find_cases(fmu, near)):
                return cases
        return []
    own = Case(fmu.stem, Path(folder))
    if own.exists:
        return [own]
    cases = [Case(path.name, path) for path in sorted(Path(folder).glob("*/"))]
    return [case for case in cases if case.exists and _fmu_of(case) == fmu.stem]


def _in_order(path: Path) -> Results:
    """A table whose times are finite and do not descend."""
    table = Results.read(path)
    if not np.isfinite(table.time).all() or (np.diff(table.time) < 0.0).any():
        raise CaseError(f"{path}: its times must be finite and must not descend; correct them")
    return table


def _fmu_of(case: Case) -> str:
    try:
        return case.fmu
    except CosimError:
        return case.name
