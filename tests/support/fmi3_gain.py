"""The FMU of fmi3_gain.c: an FMI 3.0 FMU that calls no Python, with vectors, several types and failures on demand."""

import subprocess
import zipfile
from pathlib import Path

import fmpy

from fmu_export.native.toolchain import find_compiler
from tests.support import SUPPORT

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Gain" instantiationToken="{fmi3-gain}">
  <CoSimulation modelIdentifier="gain" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Float64 name="u" valueReference="1" causality="input" start="1 10 100"><Dimension start="3"/></Float64>
    <Float64 name="y" valueReference="2" causality="output"><Dimension start="3"/></Float64>
    <Float64 name="K" valueReference="3" causality="parameter" variability="fixed" start="2"/>
    <Float64 name="v" valueReference="4" causality="input" start="0"/>
    <Float64 name="x" valueReference="5" causality="output" initial="exact" start="0"/>
    <Int32 name="n" valueReference="6" causality="input" start="0" min="-2147483648" max="2147483647"/>
    <Int32 name="n_out" valueReference="7" causality="output"/>
    <Boolean name="b" valueReference="8" causality="input" start="false"/>
    <Boolean name="b_out" valueReference="9" causality="output"/>
    <Float32 name="f" valueReference="10" causality="input" start="0"/>
    <Float32 name="f_out" valueReference="11" causality="output"/>
    <Float64 name="fail_at" valueReference="12" causality="parameter" variability="fixed" start="1e9"/>
    <Int32 name="failure" valueReference="13" causality="parameter" variability="fixed" start="0" min="0" max="3"/>
    <String name="journal" valueReference="14" causality="parameter" variability="fixed"><Start value=""/></String>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="2" dependencies="1"/>
    <Output valueReference="5" dependencies=""/>
    <Output valueReference="7" dependencies="6"/>
    <Output valueReference="9" dependencies="8"/>
    <Output valueReference="11" dependencies="10"/>
    <InitialUnknown valueReference="2"/>
    <InitialUnknown valueReference="7"/>
    <InitialUnknown valueReference="9"/>
    <InitialUnknown valueReference="11"/>
  </ModelStructure>
</fmiModelDescription>
"""


#: Start values of all inputs of the C FMU, so that a test feeds only those it is about.
HELD = {"u": [1, 10, 100], "v": 0, "n": 0, "b": False, "f": 0}


def zipped(path: Path, library: Path, description: str = DESCRIPTION) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        archive.write(library, f"binaries/{fmpy.platform_tuple}/gain{library.suffix}")
    return path


def build_gain(folder: Path, *definitions: str, description: str = DESCRIPTION) -> Path:
    """Compile it with definitions, and pack it with a description; returns <folder>/gain.fmu."""
    library = folder / f"gain{fmpy.sharedLibraryExtension}"
    headers = Path(fmpy.__file__).parent / "c-code"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", f"-I{headers}"]
    flags += [f"-D{name}" for name in definitions]
    subprocess.run([*find_compiler(), *flags, str(SUPPORT / "fmi3_gain.c"), "-o", str(library)], check=True)
    return zipped(folder / "gain.fmu", library, description)
