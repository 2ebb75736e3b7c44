"""PathSim with its FMI toolbox: co-simulation blocks, stepped by scheduled events; a scope keeps all outputs.

Traps: it wants every input connected, so that inputs which the case leaves alone get blocks of constants; its blocks do
a step at its beginning, and what it files under a time are the outputs at the end of the step from there on.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from interop.tools.availability import missing
from interop.tools.case import Case, ToolRun, split

if TYPE_CHECKING:
    from pathsim import Connection
    from pathsim.blocks import Constant
    from pathsim_fmi import CoSimulationFMU

NAME = "pathsim"
TITLE = "PathSim, co-simulation blocks"
PACKAGE = "pathsim-fmi"


def unavailable() -> str | None:
    """It is Python on FMPy."""
    return missing("pathsim_fmi", "pip install pathsim-fmi")


def run(case: Case, folder: Path) -> ToolRun:
    """One call simulates until the stop time."""
    from pathsim import Connection, Simulation
    from pathsim.blocks import Scope
    from pathsim_fmi import CoSimulationFMU

    tempfile.tempdir = str(folder)  # it unpacks FMUs there and leaves them behind
    began = time.perf_counter()
    fmus = {
        instance: CoSimulationFMU(str(fmu), instance, dict(case.start.get(instance, {})), case.step_size)
        for instance, fmu in case.fmus.items()
    }
    wires = [Connection(_port(fmus, source), _port(fmus, target)) for source, target in case.connections]
    constants, more = _constants(case, fmus)
    outputs = [f"{instance}.{name}" for instance, fmu in fmus.items() for name in fmu.fmu_wrapper.output_refs]
    scope = Scope(labels=outputs)
    wires += more + [Connection(_port(fmus, output), scope[i]) for i, output in enumerate(outputs)]
    blocks = [*constants, *fmus.values(), scope]
    simulation = Simulation(blocks=blocks, connections=wires, dt=case.step_size, log=False)
    loop_began = time.perf_counter()
    simulation.run(case.stop_time)
    loop_time = time.perf_counter() - loop_began
    times, values = scope.read()
    x_E, y_E = (values[outputs.index(name)] for name in case.path)
    total = time.perf_counter() - began
    return ToolRun(
        loop_time, total, times + case.step_size, x_E, y_E, "sequential", len(outputs), "records outputs only"
    )


def _port(blocks: dict[str, CoSimulationFMU], path: str) -> object:
    instance, variable = split(path)
    return blocks[instance][variable]


def _constants(case: Case, fmus: dict[str, CoSimulationFMU]) -> tuple[list[Constant], list[Connection]]:
    """Blocks and connections for the inputs that nothing else feeds."""
    from pathsim import Connection
    from pathsim.blocks import Constant

    fed = {target for _, target in case.connections}
    inputs = [(i, name) for i, fmu in fmus.items() for name in fmu.fmu_wrapper.input_refs if f"{i}.{name}" not in fed]
    blocks = [Constant(case.start.get(i, {}).get(name, 0.0)) for i, name in inputs]
    return blocks, [Connection(b, fmus[i][name]) for b, (i, name) in zip(blocks, inputs, strict=True)]
