"""FMPy's simulation of SSPs.

Traps: it takes no parameters from the file, so that they are handed over by the caller here; connectors are 0 in the
first step; it files the outputs at the end of a step under the time of its start; FMI 3.0 it does not know.
"""

from __future__ import annotations

import time
from pathlib import Path

from interop.tools.case import Case, ToolRun

NAME = "fmpy_ssp"
TITLE = "FMPy, SSP"
PACKAGE = "fmpy"


def unavailable() -> str | None:
    """FMPy is a dependency of the project."""
    return None


def run(case: Case, folder: Path) -> ToolRun:
    """One call simulates until the stop time; it records all connectors."""
    from fmpy.ssp.simulation import simulate_ssp
    from fmpy.ssp.ssd import Parameter, ParameterSet

    from cosim.ssp.reader import read_ssp

    began = time.perf_counter()
    (ssp,) = case.fmus.values()
    start = {c.name: c.start for c in read_ssp(ssp, folder).system.components.values()}
    values = [Parameter(name=f"{part}.{name}", value=v) for part, given in start.items() for name, v in given.items()]
    loop_began = time.perf_counter()
    results = simulate_ssp(
        str(ssp),
        stop_time=case.stop_time - 0.5 * case.step_size,  # it goes on until a sum of steps reaches that
        step_size=case.step_size,
        parameter_set=ParameterSet(parameters=values),
    )
    loop_time = time.perf_counter() - loop_began
    x_E, y_E = (results[name] for name in case.path)
    total = time.perf_counter() - began
    ends = results["time"] + case.step_size
    return ToolRun(loop_time, total, ends, x_E, y_E, "own", len(results.dtype.names) - 1)
