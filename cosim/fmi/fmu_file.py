"""Read, check and unpack FMU files."""

from __future__ import annotations

import hashlib
import math
import re
import zipfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

import fmpy
from fmpy.model_description import ModelDescription

from cosim.errors import SetupError
from cosim.files.kinds import FMU, not_read
from cosim.fmi import fmi1_description
from cosim.fmi.archive.description import check_description
from cosim.fmi.archive.findings import FileFindings
from cosim.fmi.archive.fmpy_reading import DESCRIPTION, SOURCES, described, readable_by_fmpy
from cosim.fmi.archive.libraries import missing_functions
from cosim.fmi.archive.members import ArchiveError, Members
from cosim.fmi.archive.xml_reading import MOST_XML_BYTES, XmlError, read_xml
from cosim.fmi.compilation import compile_library, has_sources
from cosim.fmi.fmi3_description import read_further_attributes
from cosim.fmi.further_libraries import keep_apart
from cosim.fmi.interfaces import AUTO_INTERFACE, CO_SIMULATION, MODEL_EXCHANGE, is_model_exchange, used_interface
from cosim.fmi.load_failure import not_loadable
from cosim.fmi.loading import LibraryError
from cosim.fmi.own_variables import forget_unique_symbols
from cosim.fmi.python_fmus import is_script, prepare
from cosim.fmi.shared_library import Library, library_names, library_path

if TYPE_CHECKING:
    from lxml.etree import _Element


@dataclass(frozen=True)
class LoadedFMU:
    """An FMU file, its model description, and the names of the files in it.

    Two things the FMU says of itself in an annotation: `resets_completely`, after a reset an instance is as a new one;
    and up to which order it takes derivatives of its inputs, 0 if it says nothing.
    """

    path: Path
    sha256: str
    description: ModelDescription
    files: tuple[str, ...]
    resets_completely: bool = False
    input_derivative_order: int = 0

    @property
    def shares_library(self) -> bool:
        """Whether its instances are independent though they have one library, and its global variables, together.

        So do those of pythonfmu's binary, whose modules are kept apart.
        """
        return self.resets_completely or is_script(self.files)

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
            raise SetupError(f"{self.path}: its model identifier {wrong!r} is not a name of a library; export it again")
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
            with Members(self.path) as members:
                if hashlib.sha256(self.path.read_bytes()).hexdigest() != self.sha256:
                    raise SetupError(f"{self.path}: was changed while it was read; run it again")
                members.unpack(folder)
        except (OSError, zipfile.BadZipFile, ArchiveError) as error:
            raise SetupError(f"{self.path}: {error}") from error
        try:
            prepare(folder, self.description)
        except SetupError as error:
            raise SetupError(f"{self.path}: {error}") from error
        own = [folder / name for identifier in self._identifiers for name in self._library_names(identifier)]
        for libraries in {library.parent for library in own}:
            if not keep_apart(libraries, {library.name for library in own}) and not self.shares_library:
                for library in filter(Path.is_file, own):
                    forget_unique_symbols(library)
        if build and has_sources(self.files):
            for identifier in self._identifiers:
                self._build(folder, identifier)
        self._check_libraries(folder)

    def _check_libraries(self, folder: Path) -> None:
        """Refuse libraries for another machine, that are cut off, or without the functions that a run needs."""
        interface = used_interface(self.description)
        if interface is None:
            return
        version, identifier = self.description.fmiMajorVersion, interface.modelIdentifier
        library = library_path(folder, version, identifier)
        if why := not_loadable(library):
            raise SetupError(f"{self.path}: {why}")
        if is_model_exchange(self.description):  # its instance looks for the functions
            return
        if missing := missing_functions(library, version, identifier):
            raise SetupError(
                f"{self.path}: its library {library.name} lacks {', '.join(missing)}; ask its maker for a complete one"
            )

    def _build(self, folder: Path, identifier: str) -> None:
        try:
            Library(library_path(folder, self.description.fmiMajorVersion, identifier), identifier).close()
        except LibraryError:
            library = folder / self._library_names(identifier)[0]
            try:
                compile_library(folder, self.description, identifier, self.sha256, library)
            except SetupError as error:
                raise SetupError(f"{self.path}: {error}") from error


def load(component: str, path: Path, interface: str = AUTO_INTERFACE) -> LoadedFMU:
    """Read the FMU file of a component, to use one interface of it: its description then has no other one.

    Parameters
    ----------
    component : str
    path : Path
    interface : str
        One of `INTERFACES`; "auto" is co-simulation where the FMU has it, and else model exchange.

    Raises
    ------
    SetupError
        There is no such file, it is not an FMU, or not one with this interface.
    """
    here = f"component '{component}': {path}"
    fmu = read_fmu(path, here)
    description = fmu.description
    if interface == AUTO_INTERFACE:
        only_equations = description.coSimulation is None and description.modelExchange is not None
        interface = MODEL_EXCHANGE if only_equations else CO_SIMULATION
    if interface == CO_SIMULATION:
        if description.coSimulation is None:
            remedy = "" if description.modelExchange is None else ", or use its model exchange (interface 'auto')"
            raise SetupError(f"{here}: has no co-simulation interface; export it for co-simulation{remedy}")
        return fmu
    if description.modelExchange is None:
        has = "" if description.coSimulation is None else ", or use its co-simulation (interface 'auto')"
        raise SetupError(f"{here}: has no model-exchange interface; export it for model exchange{has}")
    if description.fmiMajorVersion == 1:
        has = "has no co-simulation interface, and" if description.coSimulation is None else "is of FMI 1.0:"
        raise SetupError(
            f"{here}: {has} only the model exchange of FMI 2.0 and 3.0 can be coupled, not that of FMI 1.0"
        )
    if any(variable.type == "Clock" for variable in description.modelVariables):
        raise SetupError(f"{here}: has clocks, which tick in co-simulation only; export it for co-simulation")
    description.coSimulation = None
    return fmu


def read_fmu(path: Path, here: str) -> LoadedFMU:
    """Read an FMU file, whatever interfaces and binaries it has; messages begin with `here`.

    Raises
    ------
    SetupError
        There is no such file, it is not an FMU, or one that would run wrongly.
    """
    checked = check_fmu(path, here)
    if checked.fmu is None:
        raise SetupError(f"{here}: {'; '.join(checked.findings.wrong)}")
    return checked.fmu


@dataclass(frozen=True)
class CheckedFMU:
    """An FMU file after its check.

    Attributes
    ----------
    fmu : LoadedFMU, optional
        None where something is wrong with it.
    findings : FileFindings
    readable : bytes
        Its model description, as fmpy reads it.
    """

    fmu: LoadedFMU | None
    findings: FileFindings
    readable: bytes


def check_fmu(path: Path, here: str) -> CheckedFMU:
    """Check all of an FMU file that can be checked without unpacking it, and read its model description.

    Raises
    ------
    SetupError
        There is no such file, or nothing of an FMU can be read from it.
    """
    try:
        if not path.is_file():
            raise SetupError(f"{here}: there is no such FMU file; check the path, or build the FMU")
        with Members(path) as members:
            xml = members.read(DESCRIPTION, MOST_XML_BYTES)
            sources = members.read(SOURCES, MOST_XML_BYTES) if SOURCES in members.names else None
            files, findings = tuple(members.names), members.findings
            sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
        root = _read_xml(DESCRIPTION, xml)
        if sources is not None:
            _read_xml(SOURCES, sources)
    except zipfile.BadZipFile:
        raise SetupError(f"{here}: {_not_read(path, 'not an FMU (not a zip archive)')}") from None
    except ArchiveError as error:
        raise SetupError(f"{here}: {_not_read(path, str(error))}") from None
    except XmlError as error:
        raise SetupError(f"{here}: not a readable FMU: {error}") from None
    except OSError as error:
        raise SetupError(f"{here}: can't be read: {error.strerror or error}; check the path") from error
    of_description = check_description(root)
    findings.unclean += [f"{DESCRIPTION}, {text}" for text in of_description.unclean]
    findings.wrong += [f"not a readable FMU: {DESCRIPTION}, {text}" for text in of_description.wrong]
    readable = readable_by_fmpy(root, xml, sources)
    if findings.wrong:
        return CheckedFMU(None, findings, readable)
    try:
        description = described(readable)
        read_further_attributes(root, description)
        if description.fmiMajorVersion == 1:
            fmi1_description.complete(description, root)
    except Exception as error:  # fmpy raises bare exceptions
        what = " ".join(str(error).split())
        if isinstance(error, (AttributeError, LookupError, TypeError)):  # it has met something that it does not expect
            what = f"its {DESCRIPTION} is not as the standard has it: {what or type(error).__name__}"
        findings.add(wrong=f"not a readable FMU: {what}; export it again")
        return CheckedFMU(None, findings, readable)
    if why := _not_for_a_run(description, root):
        findings.add(wrong=why)
        return CheckedFMU(None, findings, readable)
    fmu = LoadedFMU(path, sha256, description, files, *_said_of_instances(root))
    return CheckedFMU(fmu, findings, readable)


def _not_read(path: Path, why: str) -> str:
    return not_read(path, "an FMU", why, FMU).removeprefix(f"{path}: ")


def _read_xml(name: str, data: bytes) -> _Element:
    try:
        return read_xml(data)
    except XmlError as error:
        raise XmlError(f"its {name} {error}") from None


def _not_for_a_run(description: ModelDescription, root: _Element) -> str:
    """Why an FMU can't be run by any master here, though it is as its standard has it; empty where it can."""
    if str(description.fmiVersion).startswith("3.0-"):
        return (
            f"is of FMI {description.fmiVersion}, a draft with other functions than FMI 3.0; export it again with a "
            "tool that writes FMI 1.0, 2.0 or 3.0"
        )
    if description.fmiMajorVersion == 1 and fmi1_description.needs_tool(root):
        return (
            "is a connection to a tool, which would have to run beside (CoSimulation_Tool); export it as a stand-alone "
            "FMU (CoSimulation_StandAlone)"
        )
    return ""


def _said_of_instances(root: _Element) -> tuple[bool, int]:
    """Whether a reset is complete, and the order of input derivatives, by an annotation; see `fmu_export.package`."""
    annotations = (*root.iterfind("VendorAnnotations/Tool"), *root.iterfind("Annotations/Annotation"))
    said = [
        element
        for a in annotations
        for element in a.iterfind("Instance")
        if a.get("name", a.get("type")) == "closed-chain-cosim"
    ]
    orders = [element.get("maxInputDerivativeOrder", "0") for element in said]
    return any(element.get("resetIsComplete") == "true" for element in said), int("3" in orders) * 3
