"""Check what is varied before anything runs: a wrong name should not become a million error rows."""

from __future__ import annotations

from cosim.errors import SetupError
from cosim.master.simulation import Simulation
from cosim.sweep.errors import SweepError
from cosim.sweep.factors import Factor, Range


def check_start(simulation: Simulation, factor: Factor) -> None:
    """Whether a start value can be varied: at least one of its values must be accepted, for the others are error rows.

    Raises
    ------
    SweepError
        All are refused: there is no such variable, it can't be set, or something feeds it.
    """
    refused = None
    for value in (factor.low, factor.high) if isinstance(factor, Range) else factor.values:
        try:
            simulation._extra_starts({factor.name: value})
        except SetupError as error:
            refused = error
        else:
            return
    raise SweepError(f"{factor.name}: {refused}") from refused
