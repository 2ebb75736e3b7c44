"""libcosim through libcosimpy, from an SSP: it takes connections and component-level parameters from the file."""

from __future__ import annotations

import time
from pathlib import Path

from interop.tools import libcosim
from interop.tools.case import Case, ToolRun, split

NAME = "libcosim_ssp"
TITLE = "libcosim, SSP"
PACKAGE = libcosim.PACKAGE

unavailable = libcosim.unavailable


def run(case: Case, folder: Path) -> ToolRun:  # noqa: ARG001 - nothing is written
    """One call of libcosim simulates until the stop time."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level

    log_output_level(CosimLogLevel.WARNING)
    began = time.perf_counter()
    (ssp,) = case.fmus.values()
    execution = CosimExecution.from_ssp_file(str(ssp), libcosim.nanoseconds(case.step_size))
    indices = {info.name.decode(): info.index for info in execution.slave_infos()}
    recorded = {}
    for name in case.recorded:
        instance, variable = split(name)
        references = {v.name.decode(): v.reference for v in execution.slave_variables(indices[instance])}
        recorded[name] = indices[instance], references[variable]
    table, loop_time = libcosim.simulate(execution, recorded, case)
    x_E, y_E = (table[name] for name in case.path)
    total = time.perf_counter() - began
    return ToolRun(loop_time, total, case.times, x_E, y_E, "parallel (Jacobi)", len(recorded), libcosim.NOTE)
