"""Compare results with a reference, signal by signal."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cosim.errors import nearest
from cosim.regression.funnel import Curve, funnel
from cosim.regression.tolerances import Tolerance, Tolerances, vector_of
from cosim.results.columns import TypedColumn
from cosim.results.flat_arrays import with_names_of
from cosim.results.results import Results


@dataclass(frozen=True)
class SignalComparison:
    """Result of the comparison of one signal.

    Attributes
    ----------
    name, unit : str
        The unit is empty where it is not known.
    tolerance : Tolerance
    allowed : float
        Largest allowed difference, in the unit of the signal.
    reference, result, lower, upper : Curve
        The signal, and the band that it has to stay in.
    distance : array
        For each time of the result its distance (in the unit of the signal): from the reference, or with a time shift
        from the funnel; NaN where one of the two is not a number.
    finding : str
        One line, empty where the signal agrees.
    """

    name: str
    unit: str
    tolerance: Tolerance
    allowed: float
    reference: Curve
    result: Curve
    lower: Curve
    upper: Curve
    distance: np.ndarray
    finding: str

    @property
    def worst(self) -> int:
        """Row of the result that is farthest off; not a number counts as farthest."""
        return int(np.argmax(np.nan_to_num(self.distance, nan=np.inf)))


@dataclass(frozen=True)
class Comparison:
    """Findings, one line each and none where all agrees, and the signals that were compared."""

    findings: list[str]
    signals: list[SignalComparison]


def compare(result: Results, reference: Results, tolerances: Tolerances | None = None) -> list[str]:
    """Differences of a result from a reference, one line each; an empty list when there are none.

    Compared are all signals of the reference, at its times. Signals that only the result has are no difference.

    Parameters
    ----------
    result, reference : Results
        Where `result.info["units"]` has the unit of a signal, it must be that of the reference and of the tolerance, if
        these name one. Texts must be equal.
    tolerances : Tolerances, optional
        By default 1e-9 of each reference signal's range.

    Raises
    ------
    FunnelError
        A tolerance has a time shift, and its library can't be used.
    MissingExtra
        It is not installed.
    """
    return compare_signals(result, reference, tolerances).findings


def compare_signals(result: Results, reference: Results, tolerances: Tolerances | None = None) -> Comparison:
    """The same as `compare`, with the curves and the bands."""
    tolerances = tolerances or Tolerances()
    reference, result = with_names_of(reference, result.names), with_names_of(result, reference.names)
    known = {*reference.names, *map(vector_of, reference.names)}
    findings = [
        f"there is a tolerance for '{name}', which the reference lacks; {nearest(name, reference.names)}"
        for name in tolerances.signals
        if name not in known
    ]
    other_times = _compare_times(result, reference)
    shifted = any(tolerances.of(name).time_shift for name in reference.names)
    unusable = _compare_ends(result, reference) if shifted else other_times
    if not findings and unusable:
        findings.append(unusable)
    if not findings and not (reference.names and len(reference.time)):
        findings.append("the reference holds nothing to compare")
    if findings:
        return Comparison(findings, [])
    signals = []
    units = result.info.get("units", {})
    for i, name in enumerate(reference.names):
        if name not in result.names:
            findings.append(f"'{name}' is missing in the result; {nearest(name, result.names)}")
            continue
        tolerance, unit = tolerances.of(name), units.get(name, "")
        if tolerance.unit is not None and unit != tolerance.unit and name in units:
            findings.append(f"'{name}' has the unit '{unit}' in the result, '{tolerance.unit}' in the tolerances")
        if name in units and (wanted := reference.units.get(name, unit)) != unit:
            findings.append(f"'{name}' has the unit '{unit}' in the result, '{wanted}' in the reference")
        if any(name in table.typed and table.typed[name].is_text for table in (result, reference)):
            if finding := other_times or _text_difference(name, result, reference):
                findings.append(finding)
            continue
        expected = Curve(reference.time, reference.values[:, i])
        found = Curve(result.time, result.values[:, result.names.index(name)])
        if other_times and not tolerance.time_shift:
            findings.append(f"'{name}' has no time_shift, and {other_times}")
            continue
        signals.append((_in_funnel if tolerance.time_shift else _at_each_time)(name, unit, found, expected, tolerance))
        if signals[-1].finding:
            findings.append(signals[-1].finding)
    return Comparison(findings, signals)


def _text_difference(name: str, result: Results, reference: Results) -> str:
    """Where a text is another one, empty where none is."""
    for one, other, table in (("result", "reference", reference), ("reference", "result", result)):
        if name not in table.typed or not table.typed[name].is_text:
            return f"'{name}' is text in the {one}, a number in the {other}"
    found, expected = (_texts(table.typed[name]) for table in (result, reference))
    if "binary" in (result.typed[name].type, reference.typed[name].type):
        found, expected = ([text.lower() for text in texts] for texts in (found, expected))
    differs = [i for i, (a, b) in enumerate(zip(found, expected, strict=True)) if a != b]
    if not differs:
        return ""
    i = differs[0]
    return (
        f"'{name}' differs at {len(differs)} of {len(found)} times, first at t = {result.time[i]:.9g} s: "
        f"{found[i]!r} instead of {expected[i]!r}"
    )


def _texts(column: TypedColumn) -> list[str]:
    """Texts of a column; binary values as digits of base 16, as text files have them."""
    return [value.hex() if isinstance(value, bytes) else value for value in column.values.tolist()]


def _compare_times(result: Results, reference: Results) -> str:
    n, m = len(result.time), len(reference.time)
    if n != m:
        return f"the result has {n} rows, the reference {m}; run both with the same step and duration"
    same = np.isclose(result.time, reference.time, rtol=1e-12, atol=1e-12)
    if same.all():
        return ""
    i = int(np.argmin(same))
    found, expected = result.time[i].item(), reference.time[i].item()
    return f"row {i + 1}: time {found!r} s in the result, {expected!r} s in the reference"


def _compare_ends(result: Results, reference: Results) -> str:
    """Reason why two curves with times of their own can't be compared, or none."""
    for name, time in (("result", result.time), ("reference", reference.time)):
        if not len(time):
            return f"the {name} has no rows"
        if not (np.isfinite(time).all() and (np.diff(time) >= 0.0).all()):
            return f"the times of the {name} must increase"
    for verb, row in (("begins", 0), ("ends", -1)):
        found, expected = result.time[row].item(), reference.time[row].item()
        if not np.isclose(found, expected, rtol=1e-9, atol=1e-12):
            return f"the result {verb} at t = {found!r} s, the reference at {expected!r} s"
    return ""


def _allowed(reference: np.ndarray, tolerance: Tolerance) -> float:
    spread = float(np.ptp(reference)) if np.isfinite(reference).all() else 0.0
    return max(tolerance.absolute, tolerance.relative * spread)


def _at_each_time(name: str, unit: str, result: Curve, reference: Curve, tolerance: Tolerance) -> SignalComparison:
    time, value, expected = result.time, result.values, reference.values
    allowed = _allowed(expected, tolerance)
    with np.errstate(invalid="ignore"):  # inf - inf
        difference = np.abs(value - expected)
    # NaN is never within a tolerance, except where the reference has it too
    same = (np.isnan(value) & np.isnan(expected)) | (value == expected)
    difference[same] = 0.0
    outside = ~(difference <= allowed)
    lower, upper = Curve(time, expected - allowed), Curve(time, expected + allowed)
    compared = SignalComparison(name, unit, tolerance, allowed, reference, result, lower, upper, difference, "")
    if not outside.any():
        return compared
    worst = compared.worst
    return replace(
        compared,
        finding=f"'{name}' differs at {outside.sum()} of {len(time)} times, most at t = {time[worst]:.9g} s: "
        f"{value[worst]:.9g} instead of {expected[worst]:.9g} (tolerance {allowed:.3g})",
    )


def _in_funnel(name: str, unit: str, result: Curve, reference: Curve, tolerance: Tolerance) -> SignalComparison:
    allowed = _allowed(reference.values, tolerance)
    for what, curve in (("reference", reference), ("result", result)):
        bad = np.flatnonzero(~np.isfinite(curve.values))
        if len(bad):
            value, when = curve.values[bad[0]], curve.time[bad[0]]
            finding = f"'{name}' is {value:.9g} at t = {when:.9g} s in the {what}; a time_shift needs finite values"
            distance = np.where(np.isfinite(result.values), 0.0, np.nan)
            return SignalComparison(
                name, unit, tolerance, allowed, reference, result, reference, reference, distance, finding
            )
    if not allowed:  # a constant reference, which no shift changes
        lower = upper = reference
        beyond = np.abs(result.values - reference.values[0])
    else:
        band = funnel(reference, result, tolerance.time_shift, allowed)
        lower, upper, beyond = band.lower, band.upper, band.beyond
    compared = SignalComparison(name, unit, tolerance, allowed, reference, result, lower, upper, beyond, "")
    if not beyond.any():
        return compared
    worst = compared.worst
    when = result.time[worst]
    bounds = [np.interp(when, curve.time, curve.values) for curve in (lower, upper)]
    return replace(
        compared,
        finding=f"'{name}' leaves the funnel at {np.count_nonzero(beyond)} of {len(beyond)} times, most at "
        f"t = {when:.9g} s: {result.values[worst]:.9g} instead of {bounds[0]:.9g} to {bounds[1]:.9g} "
        f"(tolerance {allowed:.3g}, time shift {tolerance.time_shift:.3g} s)",
    )
