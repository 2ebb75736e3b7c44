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

_CLOCKS = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Clocks" instantiationToken="{clocks}">
<CoSimulation modelIdentifier="model" canHandleVariableCommunicationStepSize="true" canGetAndSetFMUState="true"
 canSerializeFMUState="true" hasEventMode="true"/>
<TypeDefinitions><ClockType name="Quarter" intervalVariability="constant" intervalDecimal="0.25"/></TypeDefinitions>
<ModelVariables>
<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
<Clock name="periodic" valueReference="1000" causality="input" declaredType="Quarter" intervalVariability="constant"
 shiftDecimal="0.125"/>
<Clock name="trigger" valueReference="1001" causality="input" intervalVariability="triggered"/>
<Clock name="countdown" valueReference="1002" causality="input" intervalVariability="countdown"/>
<Clock name="changing" valueReference="1003" causality="input" intervalVariability="changing"/>
<Clock name="fixed" valueReference="1004" causality="input" intervalVariability="fixed"/>
<Clock name="tunable" valueReference="1005" causality="input" intervalVariability="tunable" intervalDecimal="0.5"/>
<Clock name="out" valueReference="1006" causality="output" intervalVariability="triggered"/>
<Int32 name="n_periodic" valueReference="2000" causality="output" clocks="1000"/>
<Int32 name="n_trigger" valueReference="2001" causality="output" clocks="1001"/>
<Int32 name="n_countdown" valueReference="2002" causality="output" clocks="1002"/>
<Int32 name="n_changing" valueReference="2003" causality="output" clocks="1003"/>
<Int32 name="n_fixed" valueReference="2004" causality="output" clocks="1004"/>
<Int32 name="n_tunable" valueReference="2005" causality="output" clocks="1005"/>
<Int32 name="n_out" valueReference="2006" causality="output" clocks="1006"/>
<Int32 name="total" valueReference="2010" causality="output" clocks="1000 1001 1002 1003 1004 1005"/>
<Int32 name="changes" valueReference="2011" causality="output"/>
<Int32 name="iterations" valueReference="2012" causality="local"/>
<Int32 name="told" valueReference="2013" causality="local"/>
<Float64 name="u" valueReference="3000" causality="input" variability="discrete" clocks="1001" start="0"/>
<Float64 name="sum" valueReference="3001" causality="output" variability="discrete" clocks="1001"/>
<Float64 name="sample" valueReference="3002" causality="output" variability="discrete" clocks="1000"/>
<Float64 name="x" valueReference="3003" causality="output"/>
<Float64 name="gain" valueReference="3004" causality="parameter" variability="tunable" start="1"/>
<Float64 name="level" valueReference="3005" causality="input" variability="discrete" start="0"/>
<Float64 name="jump_at" valueReference="3006" causality="parameter" variability="fixed" start="1e9"/>
<Float64 name="delay" valueReference="3007" causality="parameter" variability="fixed" start="0.25"/>
<Float64 name="period" valueReference="3008" causality="parameter" variability="fixed" start="0.5"/>
<Float64 name="end_at" valueReference="3009" causality="parameter" variability="fixed" start="1e9"/>
<Float64 name="endless" valueReference="3010" causality="parameter" variability="fixed" start="0"/>
<Float64 name="alarm" valueReference="3011" causality="parameter" variability="fixed" start="1e9"/>
</ModelVariables>
<ModelStructure>
<Output valueReference="1006" dependencies="1000 1001 1002 1003 1004 1005"/>
<Output valueReference="2000" dependencies="1000"/>
<Output valueReference="2001" dependencies="1001"/>
<Output valueReference="2002" dependencies="1002"/>
<Output valueReference="2003" dependencies="1003"/>
<Output valueReference="2004" dependencies="1004"/>
<Output valueReference="2005" dependencies="1005"/>
<Output valueReference="2006" dependencies="1000 1001 1002 1003 1004 1005"/>
<Output valueReference="2010" dependencies="1000 1001 1002 1003 1004 1005"/>
<Output valueReference="2011" dependencies=""/>
<Output valueReference="3001" dependencies="1001 3000"/>
<Output valueReference="3002" dependencies=""/>
<Output valueReference="3003" dependencies=""/>
<InitialUnknown valueReference="1006"/><InitialUnknown valueReference="2011"/><InitialUnknown valueReference="3003"/>
</ModelStructure>
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


def clocks(folder: Path, change: tuple[str, str] = ("", "")) -> Path:
    """The FMU of fmi3_clocks.c; with a replacement in its model description."""
    return _built(folder, "clocks", _CLOCKS.replace(*change))
