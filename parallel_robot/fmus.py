"""The robot's FMUs: where they are, and how they are built."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from importlib.resources import files
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

from cosim.errors import CosimError, nearest
from fmu_export.errors import DocumentationError
from fmu_export.native.toolchain import TARGETS, ToolchainError, compiler_identity, find_compiler, host_target
from fmu_export.package.record import (
    Recipe,
    fingerprint_of_sources,
    fingerprint_of_tools,
    has_other_sources,
    is_current,
    remember,
)
from fmu_export.pythonfmu.binary import BinariesMissing
from parallel_robot.choices import FLAVOURS, WASM

if TYPE_CHECKING:
    from fmu_export.modelling.model import Model

#: The FMU that holds the whole closed loop; no part of the system that `cosim run` couples.
CLOSED_LOOP = "closed_loop"

#: The components that `cosim run` couples.
_COUPLED = ("plant", "controller", "trajectory")

#: All that can be built.
BUILDABLE = (*_COUPLED, CLOSED_LOOP)

#: Names of their models, which take a while to import.
_NAMES = dict(zip(BUILDABLE, ("RobotPlant", "RobotController", "RobotTrajectory", "RobotClosedLoop"), strict=True))

#: The run that each FMU brings along: its end (s), and how far each input is from its start value, by turns.
_REFERENCE_TIME, _OFF = 0.02, 0.05

#: Package and file of the page of each FMU.
_PAGES = {
    "plant": ("plant_fmu", "README.md"),
    "controller": ("controller_fmu", "README.md"),
    "trajectory": ("trajectory_fmu", "README.md"),
    CLOSED_LOOP: ("parallel_robot", "CLOSED_LOOP.md"),
}


class BuildError(CosimError):
    """FMUs can't be built."""


def fmu_path(folder: Path, flavour: str, component: str) -> Path:
    """Path of the FMU behind a component: `<folder>/<flavour>/<FMU name>.fmu`, or `.wasm` of that flavour."""
    return folder / flavour / f"{_NAMES[component]}.{'wasm' if flavour == WASM else 'fmu'}"


def _model(component: str) -> Model:
    from parallel_robot.models import MODELS, closed_loop_model

    return closed_loop_model() if component == CLOSED_LOOP else MODELS[component]


def build(
    folder: str | PathLike[str], flavour: str, components: Iterable[str] = _COUPLED, *, all_platforms: bool = False
) -> list[Path]:
    """Build FMUs of a flavour into `<folder>/<flavour>`; those that are there and would come out the same stay.

    Parameters
    ----------
    folder : path
    flavour : str
        One of `FLAVOURS`, or `WASM`.
    components : iterable of str
        Which of the models, by default all that are coupled; `CLOSED_LOOP` has to be asked for.
    all_platforms : bool
        Compile the native flavours for all platforms that the FMI version knows, by zig, not only for this machine.

    Raises
    ------
    BuildError
        The flavour is unknown, there is no C compiler, or the folder can't be written; older files are unchanged.
    """
    folder = Path(folder)
    if flavour not in (*FLAVOURS, WASM):
        raise BuildError(f"flavour '{flavour}' is unknown; {nearest(flavour, [*FLAVOURS, WASM])}")
    try:
        wanted = _recipe(flavour, all_platforms)
        paths = {component: fmu_path(folder, flavour, component) for component in components}
        for component, path in paths.items():
            if not is_current(path, wanted):
                _build_one(_model(component), component, folder, flavour, all_platforms)
                remember(path, wanted)
        return list(paths.values())
    except ToolchainError as error:
        others = "" if flavour == WASM else "; the flavour pythonfmu needs no compiler"
        raise BuildError(f"flavour {flavour}: {error}{others}") from error
    except BinariesMissing as error:
        raise BuildError(f"flavour {flavour}: {error}") from error
    except OSError as error:
        raise BuildError(
            f"can't write the FMUs into {folder / flavour}: {error}; choose another folder with --fmus"
        ) from error


def _build_one(model: Model, component: str, folder: Path, flavour: str, all_platforms: bool) -> None:
    # CasADi takes a while to import, and only building needs them
    from fmu_export.native.backend import build_native
    from fmu_export.package.description_common import package_version
    from fmu_export.package.documentation import figures_of
    from fmu_export.package.metadata import Metadata, project_licence
    from fmu_export.package.references import Reference
    from fmu_export.pythonfmu.backend import build_pythonfmu
    from fmu_export.wasm.backend import build_wasm

    if flavour == WASM:
        build_wasm(model, folder / flavour)
        return
    package, name = _PAGES[component]
    page = (files(package) / name).read_text(encoding="utf-8")
    figures = figures_of(page, files(package))
    inputs = {v.name: [s + _OFF * (-1.0) ** i for i, s in enumerate(v.starts)] for v in model.inputs.variables}
    reference = Reference({n: v if len(v) > 1 else v[0] for n, v in inputs.items()}, stop_time=_REFERENCE_TIME)
    own = Metadata(version=package_version(), license="MIT", license_text=project_licence())
    try:
        if flavour == "pythonfmu":
            build_pythonfmu(model, folder / flavour, page, figures, metadata=own, reference=reference)
        else:
            version = cast(Literal["fmi2", "fmi3"], flavour)
            targets = list(TARGETS.values()) if all_platforms else None
            build_native(model, folder / flavour, version, targets, page, figures, metadata=own, reference=reference)
    except DocumentationError as error:
        raise BuildError(f"documentation: {error}") from error


def _recipe(flavour: str, all_platforms: bool, further: Iterable[Path] = ()) -> Recipe:
    """All that decides on the FMUs of a flavour.

    Raises
    ------
    ToolchainError
        There is no C compiler for a native flavour.
    """
    from fmu_export.package.description_common import package_version

    compiler = "" if flavour == "pythonfmu" else compiler_identity(all_platforms=all_platforms or flavour == WASM)
    return Recipe(_sources(*further), fingerprint_of_tools(flavour, package_version(), compiler))


def _sources(*further: Path) -> str:
    root = Path(__file__).resolve().parents[1]
    packages = [root / name for name in ("plant_fmu", "controller_fmu", "trajectory_fmu", "fmu_export")]
    robot = [Path(__file__).with_name(name) for name in ("models.py", "wiring.py", "CLOSED_LOOP.md")]
    # in a checkout, or where an installed package keeps it: the same licence is the same source
    licences = [root / "LICENSE", *root.glob("closed_chain_cosim-*.dist-info/licenses/LICENSE")]
    return fingerprint_of_sources([*packages, *robot, *[p for p in licences if p.is_file()][:1], *further])


def build_continuous(folder: Path) -> Path:
    """Build `<folder>/rodas4/RobotClosedLoop.fmu`, the closed loop by an implicit method, unless it is there.

    It is for gains that make the loop stiff. The FMU has no page, since nobody but this package uses it.

    Raises
    ------
    BuildError
        There is no C compiler, or the folder can't be written.
    """
    from fmu_export.native.backend import build_native  # CasADi takes a while to import
    from parallel_robot.models import closed_loop_model

    model = replace(closed_loop_model(), solver="rodas4")
    path = folder / "rodas4" / f"{model.name}.fmu"
    try:
        wanted = _recipe("fmi2", all_platforms=False)
        if not is_current(path, wanted):
            build_native(model, path.parent, "fmi2")
            remember(path, wanted)
    except ToolchainError as error:
        raise BuildError(f"{path}: {error}") from error
    except OSError as error:
        raise BuildError(f"can't write {path}: {error}; choose another folder with --fmus") from error
    return path


def build_live(folder: Path, model: Model, *further: Path) -> Path:
    """Build `<folder>/live/<name>.wasm`, a model that a page runs, unless it is there.

    Parameters
    ----------
    folder : Path
    model : Model
    further : Path
        Sources of the model besides those of all FMUs.

    Raises
    ------
    BuildError
        The ziglang package is not installed, or the folder can't be written.
    """
    from fmu_export.wasm.backend import build_wasm  # CasADi takes a while to import

    path = folder / "live" / f"{model.name}.wasm"
    try:
        wanted = _recipe(WASM, all_platforms=False, further=further)
        if not is_current(path, wanted):
            build_wasm(model, path.parent)
            remember(path, wanted)
    except ToolchainError as error:
        raise BuildError(f"{path}: {error}") from error
    except OSError as error:
        raise BuildError(f"can't write {path}: {error}; choose another folder with --fmus") from error
    return path


def build_missing(folder: Path, flavour: str) -> list[Path]:
    """Build the FMUs of a flavour that are missing; returns what was built.

    Raises
    ------
    BuildError
        As `build`.
    """
    missing = [i for i in _COUPLED if not fmu_path(folder, flavour, i).is_file()]
    return build(folder, flavour, missing) if missing else []


def default_flavour(folder: Path) -> tuple[str, str]:
    """The flavour to run when none is asked for, and a note on why it is not the native one, else empty.

    fmi2 where its FMUs are there or can be compiled, else pythonfmu, which needs no compiler.
    """
    if all(fmu_path(folder, "fmi2", i).is_file() for i in _COUPLED):
        return "fmi2", ""
    try:
        host_target()
        find_compiler()
    except ToolchainError as error:
        return "pythonfmu", f"note: flavour pythonfmu, for fmi2 can't be built here: {error}"
    return "fmi2", ""


def outdated(folder: Path, flavour: str) -> list[Path]:
    """FMU files of a flavour that were built from other sources than the present ones."""
    sources = _sources()
    return [path for path in (fmu_path(folder, flavour, i) for i in _COUPLED) if has_other_sources(path, sources)]
