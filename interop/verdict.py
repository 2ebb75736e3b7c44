"""Does a tool's run agree with ours? To a tolerance that follows from how the tool exchanges values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from interop.cases import STEP
from interop.entries import Exchange
from interop.references import References, distance, path_of
from interop.tools.case import ToolRun
from interop.tools.fmpy_me import RELATIVE_TOLERANCE

#: Where the same values are exchanged at the same points, only rounding differs, in times and in sums (m).
ROUNDING = 1e-10
#: Errors of the steps of a solver add up; over this run by no more than this factor.
ACCUMULATION = 100.0
#: A first-order error halves with the step; what the extrapolation to step 0 may leave of it. What does not come from
#: the coupling, as a parameter that was not set, does not vanish with the step.
REMAINDER = 0.1

TOLERANCES: dict[Exchange, str] = {
    "sequential": f"our run in the sequential order, inputs held: equal to rounding, {ROUNDING:g} m",
    "parallel": f"our run in the parallel order, inputs held: equal to rounding, {ROUNDING:g} m",
    "none": "the FMU integrates itself by the same steps, so that it follows the continuous loop as closely as in our "
    f"master: within {ROUNDING:g} m",
    "solver": f"the continuous loop: {ACCUMULATION:g} times the relative tolerance of the solver, "
    f"{RELATIVE_TOLERANCE:g}, in m",
    "own": "the continuous loop: not further away than our own run in the parallel order, which delays every "
    "connection by one step; and first order, so that the extrapolation to step 0, from runs at the step and at half "
    f"of it, leaves less than {REMAINDER:.0%} of that",
}


@dataclass(frozen=True)
class Verdict:
    """What a run differs by.

    Attributes
    ----------
    difference, tolerance : float
        From what `TOLERANCES` says, in m.
    error : float
        Distance from the continuous closed loop (m).
    remainder : float or None
        Distance (m) of the path extrapolated to step 0 from the continuous loop, where the exchange is the tool's own.
    remainder_tolerance : float
        What it may be (m).
    """

    difference: float
    tolerance: float
    error: float
    remainder: float | None = None
    remainder_tolerance: float = 0.0

    @property
    def holds(self) -> bool:
        """Whether all is within its tolerance."""
        return self.difference <= self.tolerance and (
            self.remainder is None or self.remainder <= self.remainder_tolerance
        )


def judge(exchange: Exchange, run: Callable[[float], ToolRun], references: References) -> Verdict:
    """Compare the runs of a tool.

    Parameters
    ----------
    exchange : str
        How the tool exchanges values.
    run : callable
        run(step) -> what the tool did at that communication step (s).
    references : References

    Raises
    ------
    ValueError
        A run has other times than asked for, or gaps.
    """
    path = path_of(run(STEP))
    error = distance(path, references.continuous)
    if exchange in ("sequential", "parallel"):
        ours = references.sequential if exchange == "sequential" else references.parallel
        return Verdict(distance(path, ours), ROUNDING, error)
    if exchange == "none":
        return Verdict(error, ROUNDING, error)
    if exchange == "solver":
        return Verdict(error, ACCUMULATION * RELATIVE_TOLERANCE, error)
    bound = references.first_order_error
    n = len(references.continuous)
    halved = path_of(run(STEP / 2), STEP / 2)[::2]
    extrapolated = 2.0 * halved[:n] - path[:n]
    return Verdict(error, bound, error, distance(extrapolated, references.continuous), REMAINDER * bound)
