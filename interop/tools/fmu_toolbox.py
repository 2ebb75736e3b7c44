"""The container of the FMU Manipulation Toolbox: compiled code that couples the FMUs inside it.

Its own log of values, a text file, takes several times as long as reading them from outside.
"""

from __future__ import annotations

import logging
import time
from pathlib import Path
from typing import TYPE_CHECKING

from interop.tools.availability import missing
from interop.tools.case import Case, ToolRun, split
from interop.tools.container_loop import NOTE, run_container

if TYPE_CHECKING:
    from fmu_manipulation_toolbox.assembly import AssemblyNode

NAME = "fmu_toolbox"
TITLE = "FMU Manipulation Toolbox, container"
PACKAGE = "fmu-manipulation-toolbox"


def unavailable() -> str | None:
    """Its wheel holds the compiled container."""
    return missing("fmu_manipulation_toolbox.assembly", "pip install 'fmu-manipulation-toolbox>=2.0'")


def run(case: Case, folder: Path, *, sequential: bool = False) -> ToolRun:
    """Build the container, then step it and get all from it at each communication point."""
    from fmu_manipulation_toolbox.assembly import AssemblyNode

    logging.getLogger("fmu_manipulation_toolbox").setLevel(logging.CRITICAL)
    began = time.perf_counter()
    node = AssemblyNode(
        "container.fmu",
        step_size=case.step_size,
        sequential=sequential,
        **dict.fromkeys(("auto_link", "auto_input", "auto_output"), False),
    )
    outputs = _describe(node, case)
    node.make_fmu(folder)
    table, loop_time = run_container(folder / "container.fmu", folder / "container", case, outputs)
    x_E, y_E = (table[:, outputs.index(name)] for name in case.path)
    total = time.perf_counter() - began
    order = "Gauss-Seidel" if sequential else "parallel (Jacobi)"
    note = f"records all but connected inputs; {NOTE}"
    return ToolRun(loop_time, total, case.times, x_E, y_E, order, len(outputs), note)


def _describe(node: AssemblyNode, case: Case) -> list[str]:
    """Fill a container's description; names of the variables to record from it."""
    files = {instance: str(fmu) for instance, fmu in case.fmus.items()}
    # sequential: an FMU steps after those that feed it, in the order in which the case names sources
    for instance in dict.fromkeys([*(split(source)[0] for source, _ in case.connections), *case.fmus]):
        node.add_fmu(files[instance])
    for (source, output), (target, variable) in ((split(s), split(t)) for s, t in case.connections):
        node.add_link(files[source], output, files[target], variable)
    started = [f"{i}.{name}" for i, values in case.start.items() for name in values]
    fed = {target for _, target in case.connections}
    recorded = [name for name in case.recorded if name not in fed]
    for name in dict.fromkeys([*recorded, *started]):
        instance, variable = split(name)
        if name in started:
            node.add_input(name, files[instance], variable)
            node.add_start_value(files[instance], variable, repr(case.start[instance][variable]))
        else:
            node.add_output(files[instance], variable, name)
    return recorded
