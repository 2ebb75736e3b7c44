"""Read, check and unpack FMU files."""

from __future__ import annotations

import hashlib
import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import fmpy
from fmpy.model_description import ModelDescription, read_model_description

from cosim.errors import SetupError
from cosim.fmi.python_fmus import prepare

#: An archive that unpacks to more than this is refused: no co-simulation FMU is so large, but zip bombs are.
MOST_UNPACKED_BYTES = 4 * 1024**3


@dataclass(frozen=True)
class LoadedFMU:
    """An FMU file and its model description."""

    path: Path
    sha256: str
    description: ModelDescription

    def unpack(self, folder: Path) -> None:
        """Unpack into a folder, ready to be loaded.

        Raises
        ------
        SetupError
            The folder can't be written, the archive can't be read, or its Python can't run here.
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


def load(component: str, path: Path) -> LoadedFMU:
    """Read the FMU file of a component.

    Raises
    ------
    SetupError
        There is no such file, it is no FMU, or not one that this machine can co-simulate.
    """
    here = f"component '{component}': {path}"
    fmu = read_fmu(path, here)
    if fmu.description.coSimulation is None:
        raise SetupError(f"{here}: has no co-simulation interface; export it for co-simulation")
    return fmu


def read_fmu(path: Path, here: str) -> LoadedFMU:
    """Read an FMU file, whatever interfaces it has; messages begin with `here`.

    Raises
    ------
    SetupError
        There is no such file, it is no FMU, or not one for this machine.
    """
    if not path.is_file():
        raise SetupError(f"{here}: there is no such FMU file; check the path, or build the FMU")
    try:
        data = path.read_bytes()
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            unpacked = sum(info.file_size for info in archive.infolist())
            xml = archive.read("modelDescription.xml") if unpacked <= MOST_UNPACKED_BYTES else b""
        if unpacked > MOST_UNPACKED_BYTES:
            raise SetupError(f"{here}: unpacks to {unpacked} bytes, more than any FMU needs; not opened")
        description = read_model_description(io.BytesIO(data), validate=False)
        _read_intermediate_update(xml, description)
        platforms = fmpy.supported_platforms(io.BytesIO(data))
    except SetupError:
        raise
    except zipfile.BadZipFile:
        raise SetupError(f"{here}: not an FMU (not a zip archive)") from None
    except Exception as error:  # fmpy raises bare exceptions here
        raise SetupError(f"{here}: not a readable FMU: {' '.join(str(error).split())}") from error
    if description.fmiVersion is None or description.fmiMajorVersion not in (2, 3):
        raise SetupError(f"{here}: FMI {description.fmiVersion} is not supported; use FMI 2.0 or 3.0")
    if fmpy.platform not in platforms:
        has = ", ".join(platforms) or "none"
        raise SetupError(f"{here}: has no binary for {fmpy.platform} (it has: {has}); get one built for this platform")
    return LoadedFMU(path, hashlib.sha256(data).hexdigest(), description)


def _read_intermediate_update(xml: bytes, description: ModelDescription) -> None:
    """Which variables can be set during a step: an attribute of FMI 3.0 that fmpy knows but does not read."""
    variables = {v.name: v for v in description.modelVariables}
    for element in ElementTree.fromstring(xml).iterfind("ModelVariables/*"):
        if element.get("intermediateUpdate") in ("true", "1"):
            variables[element.get("name")].intermediateUpdate = True
