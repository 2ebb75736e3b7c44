"""A case of the corpus, and what cases are made of."""

from __future__ import annotations

import io
import subprocess
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import fmpy

from fmu_export.native.toolchain import find_compiler
from tests.support.c_fmus import HEADERS

Kind = Literal["archive", "system", "scenario", "reference"]

#: What should come of a case: it runs; it is refused in a line; it is stopped in a line, with the results so far.
RUNS, REFUSED, STOPS = "runs", "refused", "stops"

#: One member of an archive: its name, or all of its header, and its content.
Member = tuple[str | zipfile.ZipInfo, bytes]

_HERE = Path(__file__).parent


class Materials:
    """What cases are made of: libraries, compiled when the first case needs them.

    Parameters
    ----------
    folder : Path
        For the libraries.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def _compiled(self, name: str) -> bytes:
        library = self._folder / f"{name}.so"
        command = [*find_compiler(), "-std=gnu11", "-O1", "-w", "-shared", "-fPIC", f"-I{HEADERS}"]
        subprocess.run([*command, str(_HERE / f"{name}.c"), "-o", str(library), "-lm"], check=True)
        return library.read_bytes()

    @cached_property
    def fmi2(self) -> bytes:
        """Library of stranger2.c."""
        return self._compiled("stranger2")

    @cached_property
    def fmi3(self) -> bytes:
        """Library of stranger3.c."""
        return self._compiled("stranger3")


@dataclass(frozen=True)
class Case:
    """One file, or folder of files, with what should come of it.

    Attributes
    ----------
    name : str
    make : callable
        Writes it into a folder, and returns the path that the command gets.
    expected : str
        `RUNS`, `REFUSED` or `STOPS`.
    says : str
        Part of the line in which it is refused or stopped.
    kind : str
    is_hostile : bool
        Whether it may end or block the process that it runs in, or changes it.
    is_valid : bool, optional
        Of an FMU: whether `cosim validate` finds nothing; by default so where it runs.
    arguments : tuple of str
        Further arguments of the command.
    """

    name: str
    make: Callable[[Path, Materials], Path]
    expected: str = REFUSED
    says: str = ""
    kind: Kind = "archive"
    is_hostile: bool = False
    is_valid: bool | None = None
    arguments: tuple[str, ...] = ()

    @property
    def passes(self) -> bool:
        """Whether `cosim validate` finds nothing."""
        return self.expected == RUNS if self.is_valid is None else self.is_valid


HEAD_2 = (
    '<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="2.0" modelName="Stranger" guid="{GUID}">'
)
DESCRIPTION_2 = f"""{HEAD_2}
<CoSimulation modelIdentifier="stranger" canHandleVariableCommunicationStepSize="true"/>
<DefaultExperiment startTime="0" stopTime="1" stepSize="0.1"/>
<ModelVariables>
<ScalarVariable name="u" valueReference="1" causality="input"><Real start="1"/></ScalarVariable>
<ScalarVariable name="y" valueReference="2" causality="output"><Real/></ScalarVariable>
</ModelVariables>
<ModelStructure>
<Outputs><Unknown index="2" dependencies=""/></Outputs>
<InitialUnknowns><Unknown index="2" dependencies=""/></InitialUnknowns>
</ModelStructure>
</fmiModelDescription>
"""
DESCRIPTION_3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Stranger" instantiationToken="3">
<CoSimulation modelIdentifier="stranger" canHandleVariableCommunicationStepSize="true"/>
<DefaultExperiment startTime="0" stopTime="1" stepSize="0.1"/>
<ModelVariables>
<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
<UInt64 name="n" valueReference="1" causality="structuralParameter" variability="fixed" start="3"/>
<Float64 name="a" valueReference="2" causality="input" start="0"><Dimension valueReference="1"/></Float64>
<Float64 name="b" valueReference="3" causality="output"><Dimension valueReference="1"/></Float64>
</ModelVariables>
<ModelStructure>
<Output valueReference="3"/>
<InitialUnknown valueReference="3"/>
</ModelStructure>
</fmiModelDescription>
"""
DESCRIPTION_1 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="1.0" modelName="Stranger" modelIdentifier="stranger" guid="{1}"
 numberOfContinuousStates="0" numberOfEventIndicators="0">
<ModelVariables>
<ScalarVariable name="y" valueReference="2" causality="output"><Real/></ScalarVariable>
</ModelVariables>
<Implementation><CoSimulation_StandAlone><Capabilities/></CoSimulation_StandAlone></Implementation>
</fmiModelDescription>
"""

#: Name of the library for this machine.
LIBRARY = f"binaries/{fmpy.platform}/stranger{fmpy.sharedLibraryExtension}"
LIBRARY_3 = f"binaries/{fmpy.platform_tuple}/stranger{fmpy.sharedLibraryExtension}"


def zipped(path: Path, *members: Member, method: int = zipfile.ZIP_STORED) -> Path:
    """An archive of members, in this order; names may be there twice."""
    import warnings

    with warnings.catch_warnings(), zipfile.ZipFile(path, "w", method) as archive:
        warnings.simplefilter("ignore")
        for name, content in members:
            archive.writestr(name, content)
    return path


def in_memory(*members: Member, method: int = zipfile.ZIP_STORED) -> bytes:
    """The bytes of an archive of members."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, content in members:
            archive.writestr(name, content)
    return stream.getvalue()


def members_2(materials: Materials, xml: str | bytes = DESCRIPTION_2) -> list[Member]:
    """Members of the FMU of FMI 2.0."""
    data = xml.encode() if isinstance(xml, str) else xml
    return [("modelDescription.xml", data), (LIBRARY, materials.fmi2)]


def members_3(materials: Materials, xml: str | bytes = DESCRIPTION_3) -> list[Member]:
    """Members of the FMU of FMI 3.0."""
    data = xml.encode() if isinstance(xml, str) else xml
    return [("modelDescription.xml", data), (LIBRARY_3, materials.fmi3)]


def fmu_2(
    folder: Path, materials: Materials, xml: str | bytes = DESCRIPTION_2, *more: Member, name: str = "x.fmu"
) -> Path:
    """The FMU of FMI 2.0 with a model description and further members."""
    return zipped(folder / name, *members_2(materials, xml), *more)


def replaced(text: str, before: str, after: str) -> str:
    """A text with a replacement, which must do something."""
    assert before in text, before
    return text.replace(before, after)
