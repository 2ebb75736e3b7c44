"""FMUs in C for the tests of how FMUs are loaded: what they need, and what they lack, is chosen."""

from __future__ import annotations

import subprocess
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import fmpy

from fmu_export.native.toolchain import find_compiler
from tests.support.native_fmus import require_compiler

HEADERS = Path(fmpy.__file__).parent / "c-code"

_TANK = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Tank" guid="{tank}">
<CoSimulation modelIdentifier="tank" canHandleVariableCommunicationStepSize="true" ATTRIBUTES>SOURCES</CoSimulation>
<ModelVariables>
<ScalarVariable name="x" valueReference="0" causality="local" initial="exact"><Real start="0"/></ScalarVariable>
<ScalarVariable name="u" valueReference="1" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="y" valueReference="2" causality="output"><Real/></ScalarVariable>
</ModelVariables>
<ModelStructure>
<Outputs><Unknown index="3" dependencies=""/></Outputs>
<InitialUnknowns><Unknown index="3" dependencies=""/></InitialUnknowns>
</ModelStructure>
</fmiModelDescription>
"""


def description_of_tank(attributes: str = "", sources: str = "") -> str:
    """Its model description, with attributes and children of the element CoSimulation."""
    return _TANK.replace("ATTRIBUTES", attributes).replace("SOURCES", sources)


def compile_c(source: Path, library: Path, *options: str) -> Path:
    """Compile a C file to a shared library."""
    require_compiler()
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", f"-I{HEADERS}"]
    subprocess.run([*find_compiler(), *flags, str(source), "-o", str(library), *options], check=True)
    return library


def packed(path: Path, description: str, members: Mapping[str, Path | bytes | str]) -> Path:
    """An FMU of a model description and other members."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        for name, content in members.items():
            archive.writestr(name, content.read_bytes() if isinstance(content, Path) else content)
    return path


def binary(identifier: str) -> str:
    """Name of the library of an FMU of FMI 1.0 or 2.0 for this machine."""
    return f"binaries/{fmpy.platform}/{identifier}{fmpy.sharedLibraryExtension}"


def tank(
    path: Path,
    *flags: str,
    options: Sequence[str] = (),
    attributes: str = "",
    members: Mapping[str, Path | bytes | str] | None = None,
) -> Path:
    """The FMU of fmi2_tank.c, compiled with the flags as definitions and with further options."""
    library = path.with_suffix(".so")
    compile_c(Path(__file__).with_name("fmi2_tank.c"), library, *(f"-D{flag}" for flag in flags), *options)
    description = description_of_tank(attributes)
    return packed(path, description, {binary("tank"): library, **(members or {})})


def sources_of_tank(
    path: Path,
    source: str | None = None,
    listed: str = "tank.c",
    members: Mapping[str, Path | bytes | str] | None = None,
) -> Path:
    """The FMU of fmi2_tank.c as sources only, or of another text in place of it; `listed` in its description."""
    text = Path(__file__).with_name("fmi2_tank.c").read_text() if source is None else source
    sources = "".join(f'<File name="{name}"/>' for name in listed.split())
    description = description_of_tank(sources=f"<SourceFiles>{sources}</SourceFiles>" if listed else "")
    return packed(path, description, {"sources/tank.c": text, **(members or {})})


_TALKERS = {
    2: """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Talker" guid="{talker}">
<CoSimulation modelIdentifier="talker" canHandleVariableCommunicationStepSize="true"/>
<LogCategories>CATEGORIES</LogCategories>
<ModelVariables>
<ScalarVariable name="y" valueReference="0" causality="output" initial="exact"><Real start="0"/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="1" dependencies=""/></Outputs></ModelStructure>
</fmiModelDescription>
""",
    3: """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Talker" instantiationToken="{talker}">
<CoSimulation modelIdentifier="talker" canHandleVariableCommunicationStepSize="true"/>
<LogCategories>CATEGORIES</LogCategories>
<ModelVariables>
<Float64 name="time" valueReference="1" causality="independent" variability="continuous"/>
<Float64 name="y" valueReference="0" causality="output" initial="exact" start="0"/>
</ModelVariables>
<ModelStructure><Output valueReference="0" dependencies=""/></ModelStructure>
</fmiModelDescription>
""",
}


def talker(path: Path, *flags: str, version: int = 2, categories: Sequence[str] = ("logEvents", "logTable")) -> Path:
    """The FMU of talker.c, of a version of FMI, compiled with the flags as definitions; it lists log categories."""
    library = path.with_suffix(".so")
    definitions = [f"-D{flag}" for flag in (f"FMI={version}", *flags)]
    compile_c(Path(__file__).with_name("talker.c"), library, *definitions, "-pthread")
    listed = "".join(f'<Category name="{name}"/>' for name in categories)
    listed = f"<LogCategories>{listed}</LogCategories>" if categories else ""
    description = _TALKERS[version].replace("<LogCategories>CATEGORIES</LogCategories>", listed)
    return packed(path, description, {binary("talker"): library})


_ENDER = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Ender" guid="{ender}">
<CoSimulation modelIdentifier="ender" canHandleVariableCommunicationStepSize="true"/>
<DefaultExperiment startTime="0" stopTime="1" stepSize="0.1"/>
<ModelVariables>
<ScalarVariable name="y" valueReference="0" causality="output"><Real/></ScalarVariable>
</ModelVariables>
<ModelStructure>
<Outputs><Unknown index="1" dependencies=""/></Outputs>
<InitialUnknowns><Unknown index="1" dependencies=""/></InitialUnknowns>
</ModelStructure>
</fmiModelDescription>
"""


def ender(path: Path, where: str, how: str, *flags: str) -> Path:
    """The FMU of fmi2_ender.c, compiled with flags: it ends its process in a place and a way that the source names."""
    library = path.with_suffix(".so")
    definitions = [f"-D{flag}" for flag in (*flags, f"WHERE={where}", f"HOW={how}")]
    definitions += ["-Wno-infinite-recursion", "-O0", "-pthread"]
    compile_c(Path(__file__).with_name("fmi2_ender.c"), library, *definitions)
    return packed(path, _ENDER, {binary("ender"): library})
