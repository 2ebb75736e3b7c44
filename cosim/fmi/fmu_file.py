"""Read, check and unpack FMU files."""

from __future__ import annotations

import hashlib
import io
import math
import re
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

import fmpy
from fmpy.model_description import ModelDescription, read_model_description

from cosim.errors import SetupError
from cosim.file_kinds import FMU, not_read
from cosim.fmi import fmi1_description
from cosim.fmi.compilation import compile_library, has_sources
from cosim.fmi.fmi3_description import expand_clock_types, read_further_attributes
from cosim.fmi.further_libraries import keep_apart
from cosim.fmi.python_fmus import prepare
from cosim.fmi.shared_library import Library, LibraryError, library_names, library_path

#: An archive that unpacks to more than this is refused: no co-simulation FMU is so large, but zip bombs are.
MOST_UNPACKED_BYTES = 4 * 1024**3


@dataclass(frozen=True)
class LoadedFMU:
    """An FMU file, its model description, and the names of the files in it.

    `resets_completely` is what the FMU says of itself in an annotation: after a reset an instance is as a new one.
    """

    path: Path
    sha256: str
    description: ModelDescription
    files: tuple[str, ...]
    resets_completely: bool = False

    @property
    def tolerance(self) -> float | None:
        """Relative tolerance of its default experiment, if it has a usable one."""
        experiment = self.description.defaultExperiment
        try:
            tolerance = float(getattr(experiment, "tolerance", None) or "nan")
        except ValueError:
            return None
        return tolerance if math.isfinite(tolerance) and tolerance > 0.0 else None

    def check_binary(self, *, build: bool = False) -> None:
        """Whether there is a library for this machine; with `build`, also sources for one.

        Raises
        ------
        SetupError
            There is none.
        """
        if wrong := next((i for i in self._identifiers if not re.fullmatch(r"[^/\\\0]+", i or "")), None):
            raise SetupError(f"{self.path}: its model identifier {wrong!r} is no name of a library; export it again")
        names = [name for identifier in self._identifiers for name in self._library_names(identifier)]
        if not set(names).isdisjoint(self.files) or (build and has_sources(self.files)):
            return
        binaries = [PurePosixPath(name) for name in self.files if name.startswith("binaries/") and name[-1] != "/"]
        here = {PurePosixPath(name).parent for name in names}
        if beside := [library.name for library in binaries if library.parent in here]:
            has = ", ".join(beside[:3])
            what = f"has no {names[0]}, which its model identifier asks for (it has {has}); rename the library"
        else:
            has = ", ".join(sorted({library.parts[1] for library in binaries if len(library.parts) > 2})) or "none"
            what = f"has no binary for {fmpy.platform} (it has: {has}); get one built for this platform"
        if has_sources(self.files):
            what += ", or compile its C sources: --build (pytest: --fmu-build; in Python: build=True)"
        raise SetupError(f"{self.path}: {what}")

    @property
    def _identifiers(self) -> list[str]:
        """Model identifiers of the interfaces."""
        interfaces = (self.description.coSimulation, self.description.modelExchange)
        return list(dict.fromkeys(interface.modelIdentifier for interface in interfaces if interface is not None))

    def _library_names(self, identifier: str) -> tuple[str, str]:
        return library_names(self.description.fmiMajorVersion, identifier)

    def unpack(self, folder: Path, *, build: bool = False) -> None:
        """Unpack into a folder, ready to be loaded.

        Parameters
        ----------
        folder : Path
            An empty folder.
        build : bool
            Whether to compile the C sources where there is no library that can be loaded here.

        Raises
        ------
        SetupError
            The folder can't be written, the archive can't be read, its sources can't be compiled, or its Python can't
            run here.
        """
        try:
            fmpy.extract(self.path, folder)
        except OSError as error:
            raise SetupError(f"{self.path}: can't be unpacked into {folder}: {error}; free some space") from error
        except Exception as error:  # fmpy raises bare exceptions here
            raise SetupError(f"{self.path}: can't be unpacked: {error}") from error
        try:
            prepare(folder, self.description)
        except SetupError as error:
            raise SetupError(f"{self.path}: {error}") from error
        own = [folder / name for identifier in self._identifiers for name in self._library_names(identifier)]
        for libraries in {library.parent for library in own}:
            keep_apart(libraries, {library.name for library in own})
        if build and has_sources(self.files):
            for identifier in self._identifiers:
                self._build(folder, identifier)

    def _build(self, folder: Path, identifier: str) -> None:
        try:
            Library(library_path(folder, self.description.fmiMajorVersion, identifier), identifier).close()
        except LibraryError:
            library = folder / self._library_names(identifier)[0]
            try:
                compile_library(folder, self.description, identifier, self.sha256, library)
            except SetupError as error:
                raise SetupError(f"{self.path}: {error}") from error


def load(component: str, path: Path) -> LoadedFMU:
    """Read the FMU file of a component.

    Raises
    ------
    SetupError
        There is no such file, it is no FMU, or not one for co-simulation.
    """
    here = f"component '{component}': {path}"
    fmu = read_fmu(path, here)
    if fmu.description.coSimulation is None:
        raise SetupError(f"{here}: has no co-simulation interface; export it for co-simulation")
    return fmu


def read_fmu(path: Path, here: str) -> LoadedFMU:
    """Read an FMU file, whatever interfaces and binaries it has; messages begin with `here`.

    Raises
    ------
    SetupError
        There is no such file, or it is no FMU.
    """
    if not path.is_file():
        raise SetupError(f"{here}: there is no such FMU file; check the path, or build the FMU")
    xml = b"<none/>"
    try:
        data = path.read_bytes()
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            files = archive.infolist()
            unpacked = sum(info.file_size for info in files)
            xml = archive.read("modelDescription.xml") if unpacked <= MOST_UNPACKED_BYTES else b""
        if unpacked > MOST_UNPACKED_BYTES:
            raise SetupError(f"{here}: unpacks to {unpacked} bytes, more than any FMU needs; not opened")
        root = ElementTree.fromstring(xml)
        readable = data
        if expand_clock_types(root):
            readable = _with_description(data, root)
        description = read_model_description(io.BytesIO(readable), validate=False)
        read_further_attributes(root, description)
        if description.fmiMajorVersion == 1:
            fmi1_description.complete(description, root)
    except SetupError:
        raise
    except zipfile.BadZipFile:
        why = "not an FMU (not a zip archive)"
        raise SetupError(f"{here}: {not_read(path, 'an FMU', why, FMU).removeprefix(f'{path}: ')}") from None
    except Exception as error:  # fmpy raises bare exceptions here
        what = " ".join(str(error).split())
        if isinstance(
            error, (AttributeError, LookupError, TypeError)
        ):  # it has met something that it does not look for
            what = f"its modelDescription.xml is not as the standard has it: {_fault_of(xml) or repr(error)}"
        why = f"not a readable FMU: {what}"
        raise SetupError(f"{here}: {not_read(path, 'an FMU', why, FMU).removeprefix(f'{path}: ')}") from error
    version = str(description.fmiVersion)
    if version.startswith("3.0-"):
        raise SetupError(
            f"{here}: is of FMI {version}, a draft with other functions than FMI 3.0; export it again with a tool that "
            "writes FMI 1.0, 2.0 or 3.0"
        )
    if description.fmiMajorVersion == 1 and fmi1_description.needs_tool(root):
        raise SetupError(
            f"{here}: is a connection to a tool, which would have to run beside (CoSimulation_Tool); export it as a "
            "stand-alone FMU (CoSimulation_StandAlone)"
        )
    for name in ("startTime", "stopTime", "stepSize"):
        text = getattr(description.defaultExperiment, name, None)
        if text is not None and not _is_number(text):
            raise SetupError(f"{here}: its default experiment has {name}={text!r}, which is no number; export it again")
    return LoadedFMU(
        path,
        hashlib.sha256(data).hexdigest(),
        description,
        tuple(info.filename for info in files),
        _says_reset_is_complete(root),
    )


def _fault_of(xml: bytes) -> str:
    """What is wrong with a model description that fmpy stumbles over, where that is known."""
    root = ElementTree.fromstring(xml)
    if not root.get("fmiVersion"):
        return "it has no fmiVersion"
    n = len(root.findall("ModelVariables/*"))
    for unknown in root.iterfind("ModelStructure/*/Unknown"):
        index = unknown.get("index", "")
        if not (index.isdecimal() and 1 <= int(index) <= n):
            return f"its ModelStructure refers to variable '{index}' of {n}"
    return ""


def _is_number(text: object) -> bool:
    try:
        float(str(text))
    except ValueError:
        return False
    return True


def _with_description(data: bytes, root: ElementTree.Element, suffix: str = ".xml") -> bytes:
    """An archive with another model description, and of the other files those whose names end with a suffix."""
    changed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as archive, zipfile.ZipFile(changed, "w") as target:
        target.writestr("modelDescription.xml", ElementTree.tostring(root))
        for name in archive.namelist():
            if name.endswith(suffix) and name != "modelDescription.xml":
                target.writestr(name, archive.read(name))
    return changed.getvalue()


@contextmanager
def readable_by_fmpy(path: Path) -> Iterator[Path]:
    """An FMU file as fmpy can read it: itself, or a copy without the types of clocks that it does not know.

    Raises
    ------
    BadZipFile
        The file is no archive.
    """
    data, name = path.read_bytes(), "modelDescription.xml"
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        xml = archive.read(name) if name in archive.namelist() else b""
    root = None
    if b"<ClockType" in xml:
        with suppress(ElementTree.ParseError):  # which fmpy will find
            root = ElementTree.fromstring(xml)
    if root is None or not expand_clock_types(root):
        yield path
        return
    with TemporaryDirectory(prefix="cosim_fmu_") as folder:
        copy = Path(folder) / path.name
        copy.write_bytes(_with_description(data, root, suffix=""))
        yield copy


def _says_reset_is_complete(root: ElementTree.Element) -> bool:
    """Whether the annotation is there that the exporter of this project writes; see `fmu_export.package`."""
    annotations = (*root.iterfind("VendorAnnotations/Tool"), *root.iterfind("Annotations/Annotation"))
    return any(
        a.get("name", a.get("type")) == "closed-chain-cosim" and element.get("resetIsComplete") == "true"
        for a in annotations
        for element in a.iterfind("Instance")
    )
