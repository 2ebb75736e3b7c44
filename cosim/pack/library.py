"""The library of packed FMUs for a platform: that for this machine comes with the package, zig compiles the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath

from cosim.errors import SetupError
from cosim.fmi.fmu_file import LoadedFMU
from cosim.pack.source import LIBRARY, SYSTEM_LIBRARIES, library_hash, library_sources
from fmu_export.native.toolchain import TARGETS, Target, compile_library, host_target

#: Stands for all platforms for which all components have libraries.
ALL = "all"


def chosen_platforms(names: Sequence[str] | None, fmus: Mapping[str, LoadedFMU], version: int) -> list[Target]:
    """The platforms of a packed FMU.

    Parameters
    ----------
    names : sequence of str, optional
        Names of `TARGETS`, or "all" for all that the components' libraries allow; this machine by default.
    fmus : mapping
        Component -> its FMU.
    version : {2, 3}
        Of FMI of the packed FMU.

    Raises
    ------
    SetupError
        A name is unknown, or a component has no library for a platform.
    """
    if names is not None and list(names) == [ALL]:
        found = [
            target
            for target in TARGETS.values()
            if folder_of(target, version) is not None and not any(_lacks(fmu, target) for fmu in fmus.values())
        ]
        if not found:
            have = "; ".join(
                f"{component} {', '.join(t.name for t in TARGETS.values() if not _lacks(fmu, t)) or 'none'}"
                for component, fmu in fmus.items()
            )
            raise SetupError(f"there is no platform for which all components have a library; they have: {have}")
        return found
    chosen = [host_target()] if names is None else [_target(name) for name in names]
    for target in chosen:
        if folder_of(target, version) is None:
            raise SetupError(
                f"FMI 2.0 has no place for libraries for {target.name}; pack into an FMU of FMI 3.0 (--fmi 3)"
            )
        for component, fmu in fmus.items():
            if _lacks(fmu, target):
                raise SetupError(
                    f"component '{component}': {fmu.path} has no library for {target.name}; take an FMU that has "
                    "one, or leave this platform out"
                )
    return chosen


def library_for(target: Target, *, compiled_here: bool) -> bytes:
    """The library for a platform: that of the package where it is meant for this machine only, else compiled by zig.

    Raises
    ------
    SetupError
        The package lacks its library.
    ToolchainError
        There is no zig, or it fails.
    """
    if not compiled_here:
        return compile_library(library_sources(), LIBRARY.stem, target, libraries=SYSTEM_LIBRARIES)
    library = LIBRARY.read_bytes() if LIBRARY.is_file() else b""
    if library_hash().encode() not in library:
        what = "belongs to another version of its sources" if library else "is missing"
        raise SetupError(
            f"the library of packed FMUs {LIBRARY} {what}; install the package again (pip install .), or in a "
            "checkout: python hatch_build.py"
        )
    return library


def folder_of(target: Target, version: int) -> str | None:
    """Folder below binaries/ for a platform in FMUs of a version of FMI."""
    return target.fmi2_folder if version == 2 else target.fmi3_folder


def libraries_beside(fmu: LoadedFMU) -> tuple[str, ...]:
    """Names of further libraries beside those of an FMU: the loader may not find them by itself."""
    identifier = fmu.description.coSimulation.modelIdentifier
    names = {
        path.name for path in map(PurePosixPath, fmu.files) if len(path.parts) == 3 and path.parts[0] == "binaries"
    }
    return tuple(sorted(n for n in names if (".so" in n or ".dylib" in n) and n.partition(".")[0] != identifier))


def _target(name: str) -> Target:
    if name not in TARGETS:
        raise SetupError(f"platform '{name}' is unknown; there are: {', '.join(TARGETS)}, or '{ALL}'")
    return TARGETS[name]


def _lacks(fmu: LoadedFMU, target: Target) -> bool:
    """Whether an FMU has no library for a platform."""
    identifier = fmu.description.coSimulation.modelIdentifier
    folders = [folder for folder in (target.fmi2_folder, target.fmi3_folder) if folder is not None]
    return not any(f"binaries/{folder}/{identifier}{target.suffix}" in fmu.files for folder in folders)
