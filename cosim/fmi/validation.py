"""All that can be found about an FMU file without running anything of it."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import fmpy

from cosim.errors import SetupError
from cosim.files.temporary import TemporaryFolder
from cosim.fmi.archive.fmpy_reading import violations
from cosim.fmi.archive.libraries import misplaced, missing_functions
from cosim.fmi.archive.members import Members
from cosim.fmi.compilation import has_sources
from cosim.fmi.fmu_file import LoadedFMU, check_fmu
from cosim.fmi.load_failure import not_loadable
from cosim.fmi.loading import LibraryError
from cosim.fmi.shared_library import library_path


def problems_of(path: Path) -> list[str]:
    """What is wrong with an FMU file, or not as its standard has it; a run refuses the first only.

    Parameters
    ----------
    path : Path

    Returns
    -------
    list of str
        A text each, which is to follow the name of the file.

    Raises
    ------
    SetupError
        There is no such file, or nothing of an FMU can be read from it.
    """
    checked = check_fmu(path, str(path))
    found = checked.findings.wrong + checked.findings.unclean
    if checked.fmu is not None:
        found += violations(checked.readable)
        with TemporaryFolder() as folder:
            with Members(path) as members:
                members.unpack(Path(folder))
            found += _of_libraries(checked.fmu, Path(folder))
    return list(dict.fromkeys(found))


def _of_libraries(fmu: LoadedFMU, folder: Path) -> list[str]:
    """Findings about the libraries of an unpacked FMU."""
    found = misplaced(folder, fmu.files)
    libraries = [PurePosixPath(name) for name in fmu.files if name.startswith("binaries/") and not name.endswith("/")]
    if {library.parent.name for library in libraries} & {fmpy.platform, fmpy.platform_tuple}:
        try:
            fmu.check_binary(build=has_sources(fmu.files))
        except SetupError as error:
            return [*found, str(error).removeprefix(f"{fmu.path}: ")]
    elif not has_sources(fmu.files) and not any(len(library.parts) == 3 for library in libraries):
        return [*found, "has neither a library nor C sources; export it again"]
    if fmu.description.coSimulation is None:
        return found
    version, identifier = fmu.description.fmiMajorVersion, fmu.description.coSimulation.modelIdentifier
    try:
        library = library_path(folder, version, identifier)
    except LibraryError:
        return found
    if why := not_loadable(library):
        return [*found, why]
    if missing := missing_functions(library, version, identifier, demanded=True):
        found.append(f"its library {library.name} lacks {', '.join(missing)}")
    return found
