"""The robot's FMUs: where they are, and how they are built."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from cosim.errors import CosimError, nearest
from cosim.robot.models import MODELS

#: Flavours that can be built.
FLAVOURS = ("pythonfmu",)


class BuildError(CosimError):
    """FMUs can't be built."""


def fmu_path(folder: Path, flavour: str, instance: str) -> Path:
    """Path of the FMU behind an instance name: `<folder>/<flavour>/<FMU name>.fmu`."""
    return folder / flavour / f"{MODELS[instance].name}.fmu"


def build(folder: Path, flavour: str, instances: Iterable[str] = tuple(MODELS)) -> list[Path]:
    """Build all FMUs of a flavour into `<folder>/<flavour>`.

    Raises
    ------
    BuildError
        The flavour is unknown, or the folder can't be written; older files are unchanged.
    """
    if flavour not in FLAVOURS:
        raise BuildError(f"flavour '{flavour}' is unknown; {nearest(flavour, FLAVOURS)}")
    # CasADi takes a while to import, and only building needs it
    from fmu_export.pythonfmu_backend import build_pythonfmu

    try:
        return [build_pythonfmu(model, folder / flavour) for model in map(MODELS.__getitem__, instances)]
    except OSError as error:
        raise BuildError(
            f"can't write the FMUs into {folder / flavour}: {error}; choose another folder with --fmus"
        ) from error


def build_missing(folder: Path, flavour: str) -> list[Path]:
    """Build a flavour if any of its FMUs is missing; returns what was built.

    Raises
    ------
    BuildError
        As `build`.
    """
    missing = [i for i in MODELS if not fmu_path(folder, flavour, i).is_file()]
    return build(folder, flavour, missing) if missing else []


def newer_sources(folder: Path, flavour: str) -> list[Path]:
    """Source files that have changed since the FMUs of a flavour were built."""
    built = min(fmu_path(folder, flavour, i).stat().st_mtime for i in MODELS)
    root = Path(__file__).resolve().parents[2]
    packages = ("plant_fmu", "controller_fmu", "fmu_export")
    sources = [p for package in packages for p in (root / package).glob("*.py")]
    sources.append(Path(__file__).with_name("trajectory.py"))
    return [p for p in sources if p.stat().st_mtime > built]
