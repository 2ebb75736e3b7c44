"""The container of the FMU Manipulation Toolbox, made from an SSP.

Traps: it takes the connections of the SSP, but neither parameters nor the step, so that both are handed over here; the
outputs to record have to be named.
"""

from __future__ import annotations

import logging
import shutil
import time
from pathlib import Path

from interop.tools import fmu_toolbox
from interop.tools.case import Case, ToolRun, split
from interop.tools.container_loop import run_container

NAME = "fmu_toolbox_ssp"
TITLE = "FMU Manipulation Toolbox, container, SSP"
PACKAGE = fmu_toolbox.PACKAGE

unavailable = fmu_toolbox.unavailable


def run(case: Case, folder: Path) -> ToolRun:
    """Build the container, then step it and get all from it at each communication point."""
    from fmu_manipulation_toolbox.assembly import Assembly

    from cosim.ssp.reader import read_ssp

    logging.getLogger("fmu_manipulation_toolbox").setLevel(logging.CRITICAL)
    began = time.perf_counter()
    (ssp,) = case.fmus.values()
    shutil.copyfile(ssp, folder / ssp.name)
    assembly = Assembly(ssp.name, default_step_size=case.step_size, fmu_directory=folder)
    components = read_ssp(ssp, folder / "read").system.components.values()
    files = {c.name: file for c, file in zip(components, assembly.root.fmu_names_list, strict=True)}
    for component in components:
        for name, value in component.start.items():
            assembly.root.add_start_value(files[component.name], name, repr(value))
    fed = {(link.to_port.fmu_name, link.to_port.port_name) for link in assembly.root.links}
    recorded = [name for name in case.recorded if (files[split(name)[0]], split(name)[1]) not in fed]
    for name in recorded:
        instance, variable = split(name)
        assembly.root.add_output(files[instance], variable, name)
    assembly.make_fmu(filename="container.fmu")
    table, loop_time = run_container(folder / "container.fmu", folder / "container", case, recorded)
    x_E, y_E = (table[:, recorded.index(name)] for name in case.path)
    total = time.perf_counter() - began
    return ToolRun(loop_time, total, case.times, x_E, y_E, "parallel (Jacobi)", len(recorded), fmu_toolbox.NOTE)
