"""Compare results with a reference, signal by signal."""

from __future__ import annotations

import sys
import tomllib
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from cosim.errors import CosimError, nearest
from cosim.results import Results


class ToleranceError(CosimError):
    """A file of tolerances is malformed."""


@dataclass(frozen=True)
class Tolerances:
    """Allowed differences: `absolute` in the unit of the signal, or `relative` to the reference signal's range.

    A value passes within the larger of the two. `signals` holds (absolute, relative) of signals that differ.
    """

    absolute: float = 0.0
    relative: float = 1e-9
    signals: dict[str, tuple[float, float]] | None = None

    def of(self, name: str) -> tuple[float, float]:
        """(absolute, relative) tolerance of a signal."""
        return (self.signals or {}).get(name, (self.absolute, self.relative))

    @classmethod
    def from_toml(cls, path: str | PathLike[str]) -> Tolerances:
        """Read `absolute`, `relative`, and per signal a table of both under `[signals]`.

        Raises
        ------
        ToleranceError
            The file is missing or malformed; the message names the key.
        """
        try:
            data = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise ToleranceError(f"{path}: can't be read as TOML: {error}") from error
        for key in data:
            if key not in ("absolute", "relative", "signals"):
                raise ToleranceError(
                    f"{path}: unknown key '{key}'; {nearest(key, ('absolute', 'relative', 'signals'))}"
                )
        default = _pair(path, "tolerances", {k: v for k, v in data.items() if k != "signals"}, (0.0, 1e-9))
        tables = data.get("signals", {})
        if not isinstance(tables, dict):
            raise ToleranceError(f"{path}: signals = {tables!r} must be a table")
        signals = {name: _pair(path, name, table, default) for name, table in tables.items()}
        return cls(*default, signals)


def _pair(path: Any, name: str, table: Any, default: tuple[float, float]) -> tuple[float, float]:
    if not isinstance(table, dict):
        raise ToleranceError(f"{path}: {name} must hold 'absolute', 'relative' or both")
    for key in table:
        if key not in ("absolute", "relative"):
            raise ToleranceError(f"{path}: {name} has an unknown key '{key}'; {nearest(key, ('absolute', 'relative'))}")
    pair = {"absolute": default[0], "relative": default[1]} | table
    for key, value in pair.items():
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (number and 0 <= value <= sys.float_info.max):
            raise ToleranceError(f"{path}: {name}: {key} = {value!r} must be a finite number, 0 or greater")
    return float(pair["absolute"]), float(pair["relative"])


def compare(result: Results, reference: Results, tolerances: Tolerances | None = None) -> list[str]:
    """Differences of a result from a reference, one line each; an empty list when there are none.

    Compared are all signals of the reference, at its times. Signals that only the result has are no difference.

    Parameters
    ----------
    result, reference : Results
    tolerances : Tolerances, optional
        By default 1e-9 of each reference signal's range.
    """
    tolerances = tolerances or Tolerances()
    findings = [
        f"there is a tolerance for '{name}', which the reference lacks; {nearest(name, reference.names)}"
        for name in tolerances.signals or {}
        if name not in reference.names
    ]
    findings = findings or _compare_times(result, reference)
    if not findings and not (reference.names and len(reference.time)):
        findings.append("the reference holds nothing to compare")
    if findings:
        return findings
    for i, name in enumerate(reference.names):
        if name not in result.names:
            findings.append(f"'{name}' is missing in the result; {nearest(name, result.names)}")
            continue
        findings += _compare_signal(name, reference.time, result[name], reference.values[:, i], tolerances.of(name))
    return findings


def _compare_times(result: Results, reference: Results) -> list[str]:
    n, m = len(result.time), len(reference.time)
    if n != m:
        return [f"the result has {n} rows, the reference {m}; run both with the same step and duration"]
    if n and not np.allclose(result.time, reference.time, rtol=1e-12, atol=1e-12):
        i = int(np.argmax(~np.isclose(result.time, reference.time, rtol=1e-12, atol=1e-12)))
        found, expected = result.time[i].item(), reference.time[i].item()
        return [f"row {i + 1}: time {found!r} s in the result, {expected!r} s in the reference"]
    return []


def _compare_signal(
    name: str, time: np.ndarray, value: np.ndarray, reference: np.ndarray, tolerance: tuple[float, float]
) -> list[str]:
    if not len(time):
        return []
    spread = float(np.ptp(reference)) if np.isfinite(reference).all() else 0.0
    allowed = max(tolerance[0], tolerance[1] * spread)
    with np.errstate(invalid="ignore"):  # inf - inf
        difference = np.abs(value - reference)
    # NaN is never within a tolerance, except where the reference has it too
    outside = ~((difference <= allowed) | (np.isnan(value) & np.isnan(reference)) | (value == reference))
    if not outside.any():
        return []
    worst = int(np.nanargmax(np.where(outside, np.nan_to_num(difference, nan=np.inf), -1.0)))
    return [
        f"'{name}' differs at {outside.sum()} of {len(time)} times, most at t = {time[worst]:.9g} s: "
        f"{value[worst]:.9g} instead of {reference[worst]:.9g} (tolerance {allowed:.3g})"
    ]
