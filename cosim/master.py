"""Couple FMUs in one call; see `Simulation` for many runs of one system."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from cosim.coupling import Coupling
from cosim.exchange import Order
from cosim.recording import Sink
from cosim.results import Results
from cosim.simulation import Simulation
from cosim.system import System


def simulate(
    system: System,
    stop_time: float,
    step_size: float,
    *,
    start_time: float = 0.0,
    order: Order = "sequential",
    coupling: Coupling = "auto",
    record: Sequence[str] | None = None,
    record_every: int = 1,
    sink: Sink | None = None,
    realtime: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> Results:
    """Couple the FMUs of a system at a fixed communication step.

    Set up, run once, clean up; parameters, results and errors are those of `Simulation` and `Simulation.run`.
    """
    with Simulation(system, order=order, coupling=coupling, record=record) as simulation:
        return simulation.run(
            stop_time,
            step_size,
            start_time=start_time,
            record_every=record_every,
            sink=sink,
            realtime=realtime,
            progress=progress,
        )
