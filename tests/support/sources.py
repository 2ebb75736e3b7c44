"""The modules of the project by their names."""

from pathlib import Path

from tests.support import CHECKOUT

PACKAGES = ("plant_fmu", "controller_fmu", "trajectory_fmu", "fmu_export", "cosim", "parallel_robot")


def module_name(path: Path, root: Path) -> str:
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def sources(root: Path = CHECKOUT) -> dict[str, Path]:
    """Module name -> file, of all packages."""
    return {module_name(p, root): p for package in PACKAGES for p in sorted((root / package).rglob("*.py"))}
