"""libcosim through libcosimpy: its fixed-step algorithm, all recorded in memory by its time-series observer."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from interop.tools.availability import missing
from interop.tools.case import Case, ToolRun, split

if TYPE_CHECKING:
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver

NAME = "libcosim"
TITLE = "libcosim, time-series observer"
PACKAGE = "libcosimpy"

NOTE = "loop time holds the initialisation of the FMUs"


def unavailable() -> str | None:
    """Its wheel is self-contained."""
    return missing("libcosimpy", "pip install libcosimpy")


def run(case: Case, folder: Path) -> ToolRun:  # noqa: ARG001 - nothing is written
    """One call of libcosim simulates until the stop time."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.WARNING)
    began = time.perf_counter()
    references = case.references()
    execution = CosimExecution.from_step_size(nanoseconds(case.step_size))
    slaves = {i: CosimLocalSlave(fmu_path=str(fmu), instance_name=i) for i, fmu in case.fmus.items()}
    indices = {i: execution.add_local_slave(slave) for i, slave in slaves.items()}
    for source, target in ((split(s), split(t)) for s, t in case.connections):
        execution.connect_real_variables(
            indices[source[0]], references[source[0]][source[1]], indices[target[0]], references[target[0]][target[1]]
        )
    for instance, values in case.start.items():
        for name, value in values.items():
            execution.real_initial_value(indices[instance], references[instance][name], value)

    recorded = {name: (indices[i], references[i][v]) for name in case.recorded for i, v in [split(name)]}
    table, loop_time = simulate(execution, recorded, case)
    x_E, y_E = (table[name] for name in case.path)
    total = time.perf_counter() - began
    return ToolRun(loop_time, total, case.times, x_E, y_E, "parallel (Jacobi)", len(recorded), NOTE)


def nanoseconds(seconds: float) -> int:
    """Times as libcosim takes them."""
    return round(seconds * 1e9)


def simulate(
    execution: CosimExecution, recorded: dict[str, tuple[int, int]], case: Case
) -> tuple[dict[str, np.ndarray], float]:
    """Run until the stop time.

    Parameters
    ----------
    execution : CosimExecution
    recorded : dict
        Name -> index of the FMU and value reference.
    case : Case

    Returns
    -------
    table : dict
        Name -> samples (steps + 1,).
    loop_time : float
        In s.
    """
    from libcosimpy.CosimEnums import CosimVariableType
    from libcosimpy.CosimObserver import CosimObserver

    # by default the observer forgets all but the last 10,000 samples
    observer = CosimObserver.create_time_series(buffer_size=case.steps + 1)
    execution.add_observer(observer)
    for index, reference in recorded.values():
        observer.start_time_series(index, reference, CosimVariableType.REAL)
    # the first step initialises the FMUs, and only then is there a sample of the start
    loop_began = time.perf_counter()
    if not execution.simulate_until(nanoseconds(case.stop_time)):
        raise RuntimeError("libcosim could not simulate until the stop time")
    loop_time = time.perf_counter() - loop_began
    return {name: _samples(observer, *at, case.steps) for name, at in recorded.items()}, loop_time


def _samples(observer: CosimObserver, index: int, reference: int, steps: int) -> np.ndarray:
    """All samples of a variable (steps + 1,).

    libcosimpy counts the samples by their step numbers that are not 0, so a call that covers step 0 lacks its last one.
    """
    start = observer.time_series_real_samples(index, reference, from_step=0, sample_count=2)[2]
    return np.array(start + observer.time_series_real_samples(index, reference, from_step=1, sample_count=steps)[2])
