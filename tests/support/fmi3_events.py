"""FMUs of FMI 3.0 in C for tests of structural parameters and of events."""

from __future__ import annotations

from pathlib import Path

import fmpy

from tests.support import SUPPORT
from tests.support.c_fmus import compile_c, packed

_STATE_SPACE = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="StateSpace" instantiationToken="{state-space}">
<CoSimulation modelIdentifier="model" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables>
<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
<UInt64 name="m" valueReference="1" causality="structuralParameter" variability="fixed" start="3" min="0" max="5"/>
<UInt64 name="n" valueReference="2" causality="structuralParameter" variability="tunable" start="3" min="0" max="5"/>
<UInt64 name="r" valueReference="3" causality="structuralParameter" variability="fixed" start="3" min="0" max="5"/>
<Float64 name="A" valueReference="4" causality="parameter" start="1 0 0 0 1 0 0 0 1">{n}{n}</Float64>
<Float64 name="B" valueReference="5" causality="parameter" start="1 0 0 0 1 0 0 0 1">{n}{m}</Float64>
<Float64 name="C" valueReference="6" causality="parameter" start="1 0 0 0 1 0 0 0 1">{r}{n}</Float64>
<Float64 name="D" valueReference="7" causality="parameter" start="1 0 0 0 1 0 0 0 1">{r}{m}</Float64>
<Float64 name="x0" valueReference="8" causality="parameter" start="0 0 0">{n}</Float64>
<Float64 name="u" valueReference="9" causality="input" start="1 2 3">{m}</Float64>
<Float64 name="y" valueReference="10" causality="output">{r}</Float64>
<Float64 name="x" valueReference="11" causality="local">{n}</Float64>
</ModelVariables>
<ModelStructure><Output valueReference="10" dependencies="9"/><InitialUnknown valueReference="10"/></ModelStructure>
</fmiModelDescription>
"""


def _built(folder: Path, name: str, description: str) -> Path:
    library = compile_c(SUPPORT / f"fmi3_{name}.c", folder / f"{name}{fmpy.sharedLibraryExtension}")
    member = f"binaries/{fmpy.platform_tuple}/model{library.suffix}"
    return packed(folder / f"{name}.fmu", description, {member: library})


def state_space(folder: Path) -> Path:
    """The FMU of fmi3_state_space.c."""
    sizes = {name: f'<Dimension valueReference="{i}"/>' for i, name in enumerate("mnr", 1)}
    description = _STATE_SPACE
    for name, dimension in sizes.items():
        description = description.replace(f"{{{name}}}", dimension)
    return _built(folder, "state_space", description)
