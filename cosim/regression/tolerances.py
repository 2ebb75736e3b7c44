"""Tolerances between a result and its reference, signal by signal, from a TOML file."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, Literal

from cosim.errors import CosimError, nearest
from cosim.files.kinds import SCENARIO, TOLERANCES, TOML, not_read

#: Name of an interface of an FMU, as in its tables of tolerances.
Interface = Literal["co_simulation", "model_exchange"]

_NUMBERS = ("absolute", "relative", "time_shift")

#: What is wanted where a file is something else.
_WANTED = "a TOML file of tolerances"

#: Keys of a file that say how a case is run; see `cosim.regression.case`.
RUN_KEYS = ("fmu", "inputs", "start", "solver", "solver_step", "reference")


class ToleranceError(CosimError):
    """A file of tolerances is malformed."""


@dataclass(frozen=True)
class Tolerance:
    """Allowed difference of one signal.

    Attributes
    ----------
    absolute : float
        In the unit of the signal.
    relative : float
        Of the range (largest minus smallest value) of the reference signal. The larger of the two holds.
    time_shift : float
        How much earlier or later the result may be (s): it then has to stay in the funnel around the reference.
    unit : str, optional
        The unit of the signal, "" for none; another one in the FMU is a difference. None: not looked at.
    """

    absolute: float = 0.0
    relative: float = 1e-9
    time_shift: float = 0.0
    unit: str | None = None


@dataclass(frozen=True)
class Tolerances:
    """Allowed differences of all signals: `Tolerance` by default, others by name (whole vectors by theirs)."""

    absolute: float = 0.0
    relative: float = 1e-9
    time_shift: float = 0.0
    signals: Mapping[str, Tolerance] = field(default_factory=dict)

    def of(self, name: str) -> Tolerance:
        """Tolerance of a signal: its own, that of its vector, or the default."""
        default = Tolerance(self.absolute, self.relative, self.time_shift)
        return self.signals.get(name) or self.signals.get(vector_of(name)) or default

    @classmethod
    def from_toml(cls, path: str | PathLike[str], interface: Interface | None = None) -> Tolerances:
        """Read a file; see docs/regression.md for what it may hold.

        Parameters
        ----------
        path : path
        interface : {"co_simulation", "model_exchange"}, optional
            The table of this name counts too, and more than the common values.

        Raises
        ------
        ToleranceError
            The file is missing or malformed; the message names the key.
        """
        return tolerances_of(path, read_toml(path), interface)


def vector_of(name: str) -> str:
    """Name of the vector that an element belongs to: `tau[2]` to `tau`."""
    return re.sub(r"\[\d+(,\d+)*\]$", "", name)


def read_toml(path: str | PathLike[str]) -> dict[str, Any]:
    """The tables of a file of tolerances.

    Raises
    ------
    ToleranceError
        The file can't be read as TOML, or has an unknown key.
    """
    try:
        data = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        why = f"can't be read as TOML: {error}"
        raise ToleranceError(not_read(Path(path), _WANTED, why, SCENARIO, TOLERANCES, TOML)) from error
    try:
        _known(path, data, (*_NUMBERS, "signals", "co_simulation", "model_exchange", *RUN_KEYS), "unknown key")
    except ToleranceError as error:
        why = str(error).removeprefix(f"{path}: ")
        raise ToleranceError(not_read(Path(path), _WANTED, why, TOLERANCES, TOML)) from None
    return data


def tolerances_of(path: str | PathLike[str], data: Mapping[str, Any], interface: Interface | None) -> Tolerances:
    """Tolerances out of the tables of a file; the path is for messages.

    Raises
    ------
    ToleranceError
        A value is none; the message names it.
    """
    for name in ("co_simulation", "model_exchange"):
        _known(path, _table(path, data, name), (*_NUMBERS, "signals"), f"{name} has an unknown key")
    layers = [data, *([_table(path, data, interface)] if interface else [])]
    defaults: dict[str, Any] = {}
    own: dict[str, dict[str, Any]] = {}
    for layer in layers:
        defaults |= {key: layer[key] for key in _NUMBERS if key in layer}
        for name, table in _table(path, layer, "signals").items():
            if not isinstance(table, dict):
                raise ToleranceError(f"{path}: {name} must hold a table of {', '.join((*_NUMBERS, 'unit'))}")
            _known(path, table, (*_NUMBERS, "unit"), f"{name} has an unknown key")
            own[name] = own.get(name, {}) | table
    default = _tolerance(path, "tolerances", defaults)
    signals = {name: _tolerance(path, name, defaults | table) for name, table in own.items()}
    return Tolerances(default.absolute, default.relative, default.time_shift, signals)


def _table(path: Any, data: Mapping[str, Any], key: str) -> dict[str, Any]:
    table = data.get(key, {})
    if not isinstance(table, dict):
        raise ToleranceError(f"{path}: {key} = {table!r} must be a table")
    return table


def _known(path: Any, table: Mapping[str, Any], keys: tuple[str, ...], problem: str) -> None:
    for key in table:
        if key not in keys:
            raise ToleranceError(f"{path}: {problem} '{key}'; {nearest(key, keys)}")


def _tolerance(path: Any, name: str, table: Mapping[str, Any]) -> Tolerance:
    for key, value in table.items():
        if key == "unit":
            if not isinstance(value, str):
                raise ToleranceError(f"{path}: {name}: unit = {value!r} must be a text")
            continue
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (number and 0 <= value <= sys.float_info.max):
            raise ToleranceError(f"{path}: {name}: {key} = {value!r} must be a finite number, 0 or greater")
    numbers = {key: float(table[key]) for key in _NUMBERS if key in table}
    tolerance = Tolerance(**numbers, unit=table.get("unit"))
    if tolerance.time_shift and not (tolerance.absolute or tolerance.relative):
        raise ToleranceError(f"{path}: {name}: a time_shift needs an absolute or a relative tolerance beside it")
    return tolerance
