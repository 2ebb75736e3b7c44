"""The robot's FMUs: where they are, and how they are built."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path
from typing import Literal, cast

from cosim.errors import CosimError, nearest
from cosim.robot.models import MODELS

#: Flavours that can be built. The native ones need a C compiler to build and nothing to run.
FLAVOURS = ("fmi2", "fmi3", "pythonfmu")


#: Package with the page (README.md) of each model.
_PAGES = {"plant": "plant_fmu", "controller": "controller_fmu", "trajectory": "cosim.robot"}


class BuildError(CosimError):
    """FMUs can't be built."""


def fmu_path(folder: Path, flavour: str, instance: str) -> Path:
    """Path of the FMU behind an instance name: `<folder>/<flavour>/<FMU name>.fmu`."""
    return folder / flavour / f"{MODELS[instance].name}.fmu"


def build(
    folder: Path, flavour: str, instances: Iterable[str] = tuple(MODELS), *, all_platforms: bool = False
) -> list[Path]:
    """Build FMUs of a flavour into `<folder>/<flavour>`.

    Parameters
    ----------
    folder : Path
    flavour : str
        One of `FLAVOURS`.
    instances : iterable of str
        Which of the models, all by default.
    all_platforms : bool
        Compile the native flavours for all platforms that the FMI version knows, by zig, not only for this machine.

    Raises
    ------
    BuildError
        The flavour is unknown, there is no C compiler, or the folder can't be written; older files are unchanged.
    """
    if flavour not in FLAVOURS:
        raise BuildError(f"flavour '{flavour}' is unknown; {nearest(flavour, FLAVOURS)}")
    # CasADi takes a while to import, and only building needs it
    from fmu_export.documentation import DocumentationError
    from fmu_export.native_backend import build_native
    from fmu_export.pythonfmu_backend import build_pythonfmu
    from fmu_export.toolchain import TARGETS, ToolchainError

    def build_one(instance: str) -> Path:
        model, page = MODELS[instance], (files(_PAGES[instance]) / "README.md").read_text(encoding="utf-8")
        if flavour == "pythonfmu":
            return build_pythonfmu(model, folder / flavour, page)
        version = cast(Literal["fmi2", "fmi3"], flavour)
        return build_native(model, folder / flavour, version, list(TARGETS.values()) if all_platforms else None, page)

    try:
        return [build_one(instance) for instance in instances]
    except ToolchainError as error:
        raise BuildError(f"flavour {flavour}: {error}; the flavour pythonfmu needs no compiler") from error
    except DocumentationError as error:
        raise BuildError(f"documentation: {error}") from error
    except OSError as error:
        raise BuildError(
            f"can't write the FMUs into {folder / flavour}: {error}; choose another folder with --fmus"
        ) from error


def build_missing(folder: Path, flavour: str) -> list[Path]:
    """Build the FMUs of a flavour that are missing; returns what was built.

    Raises
    ------
    BuildError
        As `build`.
    """
    missing = [i for i in MODELS if not fmu_path(folder, flavour, i).is_file()]
    return build(folder, flavour, missing) if missing else []


def default_flavour(folder: Path) -> tuple[str, str]:
    """The flavour to run when none is asked for, and a note on why it is not the native one, else empty.

    fmi2 where its FMUs are there or can be compiled, else pythonfmu, which needs no compiler.
    """
    if all(fmu_path(folder, "fmi2", i).is_file() for i in MODELS):
        return "fmi2", ""
    from fmu_export.toolchain import ToolchainError, find_compiler, host_target

    try:
        host_target()
        find_compiler()
    except ToolchainError as error:
        return "pythonfmu", f"note: flavour pythonfmu, for fmi2 can't be built here: {error}"
    return "fmi2", ""


def newer_sources(folder: Path, flavour: str) -> list[Path]:
    """Source files that have changed since the FMUs of a flavour were built."""
    built = min(fmu_path(folder, flavour, i).stat().st_mtime for i in MODELS)
    root = Path(__file__).resolve().parents[2]
    packages = ("plant_fmu", "controller_fmu", "fmu_export", "fmu_export/c_adapter")
    sources = [p for package in packages for p in (root / package).glob("*.[pch]*") if p.is_file()]
    sources.append(Path(__file__).with_name("trajectory.py"))
    return [p for p in sources if p.stat().st_mtime > built]
