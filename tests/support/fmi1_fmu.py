"""The FMU of fmi1_tank.c, of FMI 1.0 for co-simulation."""

from __future__ import annotations

from pathlib import Path

from tests.support.c_fmus import binary, compile_c, packed

_VARIABLES = """
<ScalarVariable name="x" valueReference="0"><Real/></ScalarVariable>
<ScalarVariable name="u" valueReference="1" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="y" valueReference="2" causality="output"><Real unit="m"/>
  <DirectDependency><Name>direct</Name></DirectDependency></ScalarVariable>
<ScalarVariable name="minus_u" valueReference="1" causality="output" alias="negatedAlias"><Real/></ScalarVariable>
<ScalarVariable name="x_start" valueReference="3" variability="parameter"><Real start="0.5"/></ScalarVariable>
<ScalarVariable name="u_at_start" valueReference="4" causality="output"><Real/></ScalarVariable>
<ScalarVariable name="direct" valueReference="5" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="n" valueReference="6" causality="input" variability="discrete">
  <Integer start="0"/></ScalarVariable>
<ScalarVariable name="n_out" valueReference="7" causality="output" variability="discrete"><Integer/>
  <DirectDependency><Name>n</Name></DirectDependency></ScalarVariable>
<ScalarVariable name="b" valueReference="8" causality="input" variability="discrete">
  <Boolean start="false"/></ScalarVariable>
<ScalarVariable name="b_out" valueReference="9" causality="output" variability="discrete"><Boolean/>
  <DirectDependency><Name>b</Name></DirectDependency></ScalarVariable>
<ScalarVariable name="text" valueReference="10" variability="parameter"><String start=""/></ScalarVariable>
<ScalarVariable name="length" valueReference="11" causality="output" variability="discrete"><Integer/>
  <DirectDependency/></ScalarVariable>
<ScalarVariable name="stop" valueReference="14" causality="output"><Real/><DirectDependency/></ScalarVariable>
<ScalarVariable name="mode" valueReference="12" causality="input" variability="discrete">
  <Enumeration declaredType="Mode" start="1"/></ScalarVariable>
<ScalarVariable name="mode_out" valueReference="13" causality="output" variability="discrete">
  <Enumeration declaredType="Mode"/><DirectDependency><Name>mode</Name></DirectDependency></ScalarVariable>
"""

DESCRIPTION = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="1.0" modelName="Tank" modelIdentifier="tank" guid="{{fmi1-tank}}"
  numberOfContinuousStates="1" numberOfEventIndicators="0">
<UnitDefinitions><BaseUnit unit="m"/></UnitDefinitions>
<TypeDefinitions><Type name="Mode"><EnumerationType><Item name="off"/><Item name="on"/></EnumerationType></Type>
</TypeDefinitions>
<DefaultExperiment startTime="0" stopTime="2"/>
<ModelVariables>{_VARIABLES}</ModelVariables>
<Implementation><CoSimulation_StandAlone><Capabilities canHandleVariableCommunicationStepSize="true"/>
</CoSimulation_StandAlone></Implementation>
</fmiModelDescription>
"""


def build_fmi1_tank(path: Path, description: str = DESCRIPTION, *flags: str) -> Path:
    """Compile it, with flags as definitions, and pack it."""
    definitions = [f"-D{flag}" for flag in flags]
    library = compile_c(Path(__file__).with_name("fmi1_tank.c"), path.with_suffix(".so"), *definitions)
    return packed(path, description, {binary("tank"): library})
