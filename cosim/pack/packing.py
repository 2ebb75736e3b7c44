"""A whole system as one FMU, without Python: its components, their couplings and the compiled loop in one archive."""

from __future__ import annotations

import dataclasses
import hashlib
import math
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path, PurePosixPath
from typing import Literal

from cosim.errors import SetupError
from cosim.fmi.fmu_file import LoadedFMU, load
from cosim.fmi.interfaces import CO_SIMULATION, MODEL_EXCHANGE
from cosim.fmi.types import Texts
from cosim.fmi.unpacking import folder_for_fmus
from cosim.master.coupling.algorithm import AUTO, Algorithm, algorithm
from cosim.master.coupling.extrapolated_inputs import extrapolated_inputs
from cosim.master.value_layout import ValueLayout
from cosim.pack.description import About, model_description
from cosim.pack.interface import chosen_inputs, chosen_outputs, interface_of
from cosim.pack.library import chosen_platforms, folder_of, libraries_beside, library_for
from cosim.pack.plan import PackedComponent, Plan
from cosim.pack.signals import tables_of
from cosim.system.resolution import ResolvedSystem, resolve
from cosim.system.system import Signal, System
from cosim.system.variables import Element, Ports
from fmu_export.native.toolchain import Target
from fmu_export.package.archive import write_archive

#: The file that the library of a packed FMU reads.
_PLAN = "resources/plan.txt"

#: Names that can be those of folders everywhere.
_FOLDER_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,40}")

#: Parts of the archives of components that are packed, beside resources and libraries.
_KEPT = ("modelDescription.xml", "documentation/licenses/", "resources/")

#: The file by which pythonfmu's FMUs are known.
_OF_PYTHON = "resources/slavemodule.txt"


@dataclass(frozen=True)
class PackedFMU:
    """A packed FMU.

    Attributes
    ----------
    path : Path
    inputs, outputs, parameters : tuple of str
        Names of its variables.
    platforms : tuple of str
        For which it has libraries.
    notes : tuple of str
        What was left out, sampled or assumed, and the user should know.
    """

    path: Path
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    platforms: tuple[str, ...]
    notes: tuple[str, ...]


def pack(
    system: System,
    path: str | PathLike[str],
    step_size: float,
    *,
    fmi: Literal[2, 3] = 2,
    order: str = "sequential",
    extrapolation: str = AUTO,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    platforms: Sequence[str] | None = None,
    start_time: float = 0.0,
    stop_time: float | None = None,
    tolerance: float | None = None,
    name: str | None = None,
    description: str = "",
) -> PackedFMU:
    """Pack a system into one FMU for co-simulation, which needs neither Python nor this package.

    With a communication step of `step_size` it computes what `Simulation.run` computes, to the last bit. Longer
    communication steps are split into equal internal ones, no longer than its parameter `max_step`.

    Parameters
    ----------
    system : System
        Its components are FMUs of FMI 2.0 and 3.0 for co-simulation, also mixed.
    path : path
        File to be written, `Whole.fmu`.
    step_size : float
        Longest internal communication step (s): the start value of `max_step`.
    fmi : {2, 3}
        Version of FMI of the packed FMU.
    order, extrapolation : str
        As in `Simulation`.
    inputs : sequence of str, optional
        Inputs `component.variable`, scalars or vectors, that become inputs; by default all that nothing feeds. The
        others keep their start values.
    outputs : sequence of str, optional
        Outputs and local variables that become outputs; all outputs by default.
    platforms : sequence of str, optional
        Names as x86_64-linux for which all components have libraries, or "all"; compiled by zig. By default this
        machine, without a compiler.
    start_time, stop_time : float, optional
        Default experiment (s). Signals that are no straight pieces are sampled from one to the other.
    tolerance : float, optional
        Relative tolerance of the default experiment. The components are told the importer's, else each its own.
    name : str, optional
        Name of the model; that of the file by default.
    description : str
        One line about the model.

    Returns
    -------
    PackedFMU

    Raises
    ------
    SetupError
        The system can't be packed; nothing is written.
    ToolchainError
        There is no zig for another platform.
    OSError
        The file can't be written.

    Examples
    --------
    >>> packed = pack(system, "Whole.fmu", 1e-3, stop_time=0.1, outputs=["controller.tau_a"])
    >>> packed.outputs
    ('controller.tau_a[1]', 'controller.tau_a[2]', 'controller.tau_a[3]')
    """
    path = Path(path)
    if fmi not in (2, 3):
        raise SetupError(f"fmi = {fmi!r}: packed FMUs are of FMI 2 or 3")
    for what, value in (("step", step_size), ("start time", start_time), ("stop time", stop_time)):
        if value is not None and not math.isfinite(value):
            raise SetupError(f"{what} {value!r} s is not a finite number")
    if not step_size > 0.0:
        raise SetupError(f"step {step_size!r} s must be positive")
    if stop_time is not None and not stop_time > start_time:
        raise SetupError(f"stop time {stop_time!r} s must be later than the start time {start_time!r} s")
    chosen = algorithm(order, extrapolation)
    whole = _Whole(system, chosen, inputs, outputs, fmi, step_size, (start_time, stop_time))
    targets = chosen_platforms(platforms, whole.fmus, fmi)
    stem = path.stem if name is None else name
    about = whole.about(stem, description, tolerance)
    identifier = about.identifier
    digest = hashlib.sha256(whole.plan.text("", step_size) + whole.description(about))
    for fmu in whole.fmus.values():
        digest.update(fmu.sha256.encode())
    about = dataclasses.replace(about, token="{" + digest.hexdigest()[:32] + "}")
    members = {
        "modelDescription.xml": whole.description(about),
        _PLAN: whole.plan.text(about.token, step_size),
        **{
            f"binaries/{folder_of(t, fmi)}/{identifier}{t.suffix}": library_for(t, compiled_here=platforms is None)
            for t in targets
        },
    }
    for component in whole.components:
        if f"resources/{component.folder}/modelDescription.xml" not in members:
            members |= {f"resources/{component.folder}/{n}": c for n, c in _members(component, targets)}
    write_archive(path, members)
    interface = whole.interface
    return PackedFMU(
        path=path,
        inputs=tuple(v.name for v in interface.inputs),
        outputs=tuple(v.name for v in interface.outputs),
        parameters=tuple(v.name for v in interface.parameters),
        platforms=tuple(t.name for t in targets),
        notes=tuple(dict.fromkeys(whole.notes)),
    )


class _Whole:
    """A system that has been resolved and laid out as it will be in the packed FMU."""

    def __init__(
        self,
        system: System,
        chosen: Algorithm,
        inputs: Sequence[str] | None,
        outputs: Sequence[str] | None,
        fmi: int,
        step_size: float,
        times: tuple[float, float | None],
    ) -> None:
        self._fmi, self._step_size, self._times = fmi, step_size, times
        self.notes: list[str] = []
        self.fmus = dict(_loaded(system))
        self.ports = {n: Ports(n, fmu.description, system.components[n].start) for n, fmu in self.fmus.items()}
        for component, port in self.ports.items():
            if port.uses_events:
                raise SetupError(
                    f"component '{component}' has clocks, whose events the packed FMU would have to handle: it can't "
                    "be packed; leave it out, and connect it to the packed FMU"
                )
        needs_levels = chosen.order.needs_levels
        alone = resolve(system, self.ports, needs_levels=needs_levels)
        orders = {name: fmu.input_derivative_order for name, fmu in self.fmus.items()}
        found = extrapolated_inputs(alone, chosen, orders=orders)  # where what is demanded is possible
        self._refuse_binary(alone)
        own_inputs = chosen_inputs(alone, inputs, fmi)
        own_outputs, notes = chosen_outputs(alone, outputs, fmi)
        self.notes += notes
        self._say_kept(alone, own_inputs)
        driven = [Signal(f"{component}.{element.name}", lambda t: 0.0) for component, element in own_inputs]
        extended = dataclasses.replace(system, signals=[*system.signals, *driven])
        self.resolved = resolve(extended, self.ports, needs_levels=needs_levels)
        texts = Texts()
        signals, drives = system.signals, self.resolved.drives[: len(system.signals)]
        inside = any(each.degree > 1 for each in found.moving.values())
        tables = tables_of(signals, drives, texts, (*times, step_size), inside=inside)
        for table, drive in zip(tables, drives, strict=True):
            if table.sampled:
                self.notes.append(
                    f"the signal that feeds '{drive.component}.{drive.targets[0].name}' is sampled every "
                    f"{step_size:g} s up to {times[1]:g} s, and keeps its last value afterwards"
                )
        outside = {(component, element.name) for component, element in own_inputs}
        extrapolated = extrapolated_inputs(self.resolved, chosen, orders=orders, outside=outside)
        exchanged = [(component, element) for component, element in own_outputs if not element.type.is_text]
        layout = ValueLayout(self.resolved, exchanged, extrapolated)
        self.interface = interface_of(
            self.resolved, own_inputs, own_outputs, fmi, max_step=step_size, sequential=needs_levels
        )
        self.notes += self.interface.notes
        self.components = _components(self.fmus)
        self.notes += [
            f"component '{c.name}' runs Python in the importer's process: the packed FMU needs a Python there"
            for c in self.components
            if _OF_PYTHON in c.fmu.files
        ]
        self.plan = Plan(self.resolved, extrapolated, layout, self.components, self.interface, tables, texts, fmi)

    @staticmethod
    def _refuse_binary(resolved: ResolvedSystem) -> None:
        for link in resolved.links:
            if link.target.kind == "binary":
                raise SetupError(
                    f"'{link.source_component}.{link.source.name}' feeds "
                    f"'{link.target_component}.{link.target.name}' with binary values: that can't be packed; "
                    "pack one of the two without the other"
                )

    def _say_kept(self, resolved: ResolvedSystem, chosen: Sequence[tuple[str, Element]]) -> None:
        """Say which inputs keep the start value of their FMU: nothing feeds them, and they were not chosen."""
        names = {f"{component}.{element.name}" for component, element in chosen}
        kept = [n for n in resolved.kept if n not in names]
        if kept:
            shown = ", ".join(kept[:5]) + (f" and {len(kept) - 5} more" if len(kept) > 5 else "")
            self.notes.append(f"these inputs keep the start values of their FMUs: {shown}")

    def about(self, name: str, description: str, tolerance: float | None) -> About:
        """What the packed FMU says of itself, without its token."""
        interfaces = [fmu.description.coSimulation for fmu in self.fmus.values()]
        identifier = re.sub(r"\W", "_", name, flags=re.ASCII)
        return About(
            name=name,
            identifier=identifier if identifier[:1].isalpha() else f"_{identifier}",
            token="",
            description=description,
            start_time=self._times[0],
            stop_time=self._times[1],
            step_size=self._step_size,
            tolerance=tolerance,
            saves_states=all(i.canGetAndSetFMUstate for i in interfaces),
            serializes_states=all(i.canGetAndSetFMUstate and i.canSerializeFMUstate for i in interfaces),
            takes_any_step=all(i.canHandleVariableCommunicationStepSize for i in interfaces),
            resets_completely=all(fmu.resets_completely for fmu in self.fmus.values()),
            only_once=any(i.canBeInstantiatedOnlyOncePerProcess for i in interfaces),
        )

    def description(self, about: About) -> bytes:
        """The model description."""
        return model_description(about, self.interface.variables, self.ports, self._fmi)


def _loaded(system: System) -> Iterator[tuple[str, LoadedFMU]]:
    """The FMUs of all components."""
    if not system.components:
        raise SetupError("the system has no components; add one with System.add")
    for name, component in system.components.items():
        if component.fmu is None:
            raise SetupError(f"component '{name}' is a function in Python, which can't be packed; make it an FMU first")
        if component.interface == MODEL_EXCHANGE:
            raise SetupError(f"component '{name}' is in model exchange, which can't be packed; use its co-simulation")
        if component.place is not None:
            raise SetupError(
                f"component '{name}' has a place, '{component.place}'; a packed FMU has its FMUs on one machine: leave "
                "it out"
            )
        fmu = load(name, component.fmu, CO_SIMULATION)
        if fmu.description.fmiMajorVersion == 1:
            raise SetupError(
                f"component '{name}': {fmu.path} is of FMI 1.0, which can't be packed; export it as FMI 2.0"
            )
        if getattr(fmu.description.coSimulation, "needsExecutionTool", False):
            raise SetupError(
                f"component '{name}': {fmu.path} needs a tool that runs beside it, and can't be packed; leave it out"
            )
        yield name, fmu


def _components(fmus: Mapping[str, LoadedFMU]) -> list[PackedComponent]:
    """Components and their folders: one a file, or a component whose FMU does not share its library."""
    folders: dict[str, str] = {}
    found = []
    for number, (name, fmu) in enumerate(fmus.items(), 1):
        alone = fmu.description.coSimulation.canBeInstantiatedOnlyOncePerProcess or not fmu.shares_library
        taken = {folder.lower() for folder in folders.values()}
        folder = name if _FOLDER_NAME.fullmatch(name) and name.lower() not in taken else f"component-{number}"
        key = f"{fmu.sha256} {name}" if alone else fmu.sha256
        folders.setdefault(key, folder)
        found.append(PackedComponent(name, fmu, folders[key], libraries_beside(fmu)))
    return found


def _members(component: PackedComponent, targets: Sequence[Target]) -> Iterator[tuple[str, bytes]]:
    """Files of a component's FMU that are packed."""
    folders = {f for target in targets for f in (target.fmi2_folder, target.fmi3_folder) if f is not None}
    kept = (*_KEPT, *(f"binaries/{folder}/" for folder in sorted(folders)))
    if _OF_PYTHON in component.fmu.files:  # made ready as for a run
        with folder_for_fmus() as temporary:
            folder = Path(temporary)
            component.fmu.unpack(folder)
            for path in sorted(folder.rglob("*")):
                name = path.relative_to(folder).as_posix()
                if path.is_file() and name.startswith(kept):
                    yield name, path.read_bytes()
        return
    with zipfile.ZipFile(component.fmu.path) as archive:
        for info in archive.infolist():
            parts = PurePosixPath(info.filename).parts
            if not info.is_dir() and info.filename.startswith(kept) and ".." not in parts:
                yield info.filename, archive.read(info)
