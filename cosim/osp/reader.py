"""Read an OSP configuration into a `System`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

from cosim.errors import nearest
from cosim.files.xml_elements import children, local_name
from cosim.fmi.fmu_file import load
from cosim.osp.errors import OSPError
from cosim.osp.functions import Function, read_function
from cosim.osp.groups import Group, found_in, pairs, read_groups
from cosim.osp.parsing import attribute, number, parse
from cosim.ssp.format.package import Folder
from cosim.system.read import Findings, ReadSystem, assumed_stop_time, longest_experiment, multiple_of_step
from cosim.system.system import System, Units
from cosim.system.units import UnitsDiffer, conversion
from cosim.system.variables import Element, Ports

FILE = "OspSystemStructure.xml"

#: The communication step where a configuration has none, as libcosim has it (s).
_STEP = 0.1

#: Variables with one of these causalities give values.
_GIVING = ("output", "calculatedParameter", "local")

_PARSERS: Mapping[str, Callable[[str], Any]] = {
    "Real": float,
    "Integer": int,
    "Enumeration": int,
    "Boolean": lambda text: {"true": True, "1": True, "false": False, "0": False}[text.strip().lower()],
    "String": str,
}


def read_osp(
    path: str | PathLike[str],
    *,
    units: Literal["convert", "ignore"] = "ignore",
    step_size: float | None = None,
    start_time: float | None = None,
    stop_time: float | None = None,
    duration: float | None = None,
) -> ReadSystem:
    """Read an OSP configuration.

    Parameters
    ----------
    path : path
        Of the file, or of a folder with `OspSystemStructure.xml`.
    units : {"convert", "ignore"}
        Take all numbers as they are, as libcosim does, or convert them where both ends have a unit.
    step_size : float, optional
        Communication step (s) in place of the base step; simulators that have steps of their own keep them.
    start_time, stop_time : float, optional
        Times (s) in place of those of the configuration. Where neither says a stop time, the latest of the default
        experiments of its FMUs is taken, with a note.
    duration : float, optional
        How long the run is (s) where they say none either; by default there is no stop time then.

    Returns
    -------
    ReadSystem
        Its order is parallel (Jacobi), its extrapolation hold, as in libcosim.

    Raises
    ------
    OSPError
        The configuration is malformed, or has what can't be run; the message names all of it.
    """
    path = Path(path)
    file = path / FILE if path.is_dir() else path
    reader = _Reader(file, parse(file, "OspSystemStructure"), units, step_size)
    if path.is_dir() and (path / "SystemStructure.ssd").is_file():
        reader.findings.note(f"{path}: has SystemStructure.ssd, too, which is not read; name it to run it")
    system = reader.system()
    start = (reader.time("StartTime") or 0.0) if start_time is None else start_time
    stop = reader.stop_time(start, duration) if stop_time is None else stop_time
    reader.findings.raise_problems(f"{file}")
    return ReadSystem(
        file.resolve().parent.name if file.name == FILE else file.stem,
        system,
        start,
        stop,
        reader.step,
        reader.findings.notes(),
        order="parallel",
        extrapolation="hold",
    )


@dataclass
class _Simulator:
    """An FMU of a configuration."""

    name: str
    ports: Ports
    fmu: Path
    every: int
    start: dict[str, Any]
    folder: Path

    @cached_property
    def groups(self) -> Group:
        model = str(self.ports.description.modelName)
        return read_groups(self.name, model, [self.fmu.parent, self.folder])


class _Reader:
    def __init__(self, file: Path, root: ElementTree.Element, units: Units, step_size: float | None) -> None:
        self.file = file
        self.root = root
        self.units = units
        self.findings = Findings(OSPError)
        self.step = self._step() if step_size is None else step_size
        self._algorithm()
        self.simulators: dict[str, _Simulator] = {}
        self.functions: dict[str, Function] = {}
        self._broken: set[str] = set()
        self._wires: list[tuple[str, str, float, float]] = []

    # Times

    def time(self, name: str) -> float | None:
        """A time of the configuration (s)."""
        for element in children(self.root, name):
            with self.findings.collecting():
                return number(element.text or "", f"{self.file}: {name}")
        return None

    def stop_time(self, start_time: float, duration: float | None) -> float | None:
        """The stop time (s) of the configuration, or else of its FMUs, or else that after a duration (s)."""
        stop = self.time("EndTime")
        if stop is not None:
            return stop
        found = longest_experiment((s.ports.description for s in self.simulators.values()), start_time)
        length = duration if found is None else found - start_time
        if length is None or not self.step > 0:
            return found
        whole = math.ceil(length / self.step - 1e-9) * self.step
        self.findings.note(
            assumed_stop_time(f"{self.file}", start_time, whole)
            if found is None
            else f"{self.file}: has no EndTime; {start_time + whole:g} s is taken, the latest of its FMUs' default "
            "experiments in whole steps"
        )
        return start_time + whole

    def _step(self) -> float:
        step = self.time("BaseStepSize")
        if step is None:
            step = _STEP
            self.findings.note(f"{self.file}: has no BaseStepSize; {_STEP} s is taken, as libcosim does")
        if not (math.isfinite(step) and step > 0):
            self.findings.problem(f"{self.file}: BaseStepSize is {step!r}; it must be a positive number of seconds")
        return step

    def _algorithm(self) -> None:
        for element in children(self.root, "Algorithm"):
            name = (element.text or "").strip()
            if name.lower() != "fixedstep":
                self.findings.note(
                    f"{self.file}: algorithm '{name}' is not supported; the step is fixed, {self.step!r} s"
                )
        known = ("StartTime", "EndTime", "BaseStepSize", "Algorithm", "Simulators", "Functions", "Connections")
        for element in self.root:
            if local_name(element) not in (*known, "EccoConfiguration", "Description"):
                self.findings.note(f"{self.file}: {local_name(element)} is not known and ignored")

    # What the system is made of

    def system(self) -> System:
        for element in children(self.root, "Simulators", "Simulator"):
            self._read(element, self._simulator)
        for holder in children(self.root, "Functions"):
            for element in holder:
                self._read(element, self._function)
        connect = {
            "VariableConnection": self._variables,
            "SignalConnection": self._signal,
            "VariableGroupConnection": self._groups,
            "SignalGroupConnection": self._signal_group,
        }
        for holder in children(self.root, "Connections"):
            for element in holder:
                with self.findings.collecting():
                    if local_name(element) not in connect:
                        raise OSPError(f"{self.file}: a {local_name(element)} is not known; {', '.join(connect)} are")
                    connect[local_name(element)](element)
        return self._made()

    def _read(self, element: ElementTree.Element, read: Callable[[ElementTree.Element, str], None]) -> None:
        with self.findings.collecting():
            name = attribute(element, "name", f"{self.file}")
            if name in self.simulators or name in self.functions or name in self._broken:
                raise OSPError(f"{self.file}: there are two simulators or functions named '{name}'; rename one")
            self._broken.add(name)
            read(element, name)
            self._broken.remove(name)

    def _simulator(self, element: ElementTree.Element, name: str) -> None:
        here = f"{self.file}: simulator '{name}'"
        folder = Folder(self.file.parent, self.findings)
        source = attribute(element, "source", here)
        try:
            fmu = folder.unpack(folder.name_of(source, self.file.name), self.file.parent)
        except OSPError as error:
            raise OSPError(f"{here}: {str(error).removeprefix(f'{folder.path}: ')}") from None
        ports = Ports(name, load(name, fmu).description)
        simulator = _Simulator(name, ports, fmu, self._every(element, here), {}, self.file.parent)
        for value in children(element, "InitialValues", "InitialValue"):
            with self.findings.collecting():
                self._initial_value(value, simulator, here)
        self.simulators[name] = simulator

    def _every(self, element: ElementTree.Element, here: str) -> int:
        """Of how many communication steps a step of the simulator is made."""
        text = element.get("stepSize")
        if text is None:
            return 1
        return multiple_of_step(number(text, f"{here}: stepSize"), self.step, f"{here}: stepSize", self.findings)

    def _initial_value(self, element: ElementTree.Element, simulator: _Simulator, here: str) -> None:
        name = attribute(element, "variable", here)
        typed = next(iter(element), None)
        if typed is None or local_name(typed) not in _PARSERS:
            raise OSPError(f"{here}: initial value of '{name}' has no Real, Integer, Boolean or String; give it one")
        text = attribute(typed, "value", f"{here}: initial value of '{name}'")
        known = {e.name for e in simulator.ports.all_elements()}
        if name not in known:
            raise OSPError(f"{here}: initial value of '{name}', which the FMU does not have; {nearest(name, known)}")
        try:
            simulator.start[name] = _PARSERS[local_name(typed)](text)
        except (ValueError, KeyError):
            raise OSPError(
                f"{here}: initial value of '{name}': '{text}' is not of type {local_name(typed)}; correct it"
            ) from None

    def _function(self, element: ElementTree.Element, name: str) -> None:
        self.functions[name] = read_function(element, f"{self.file}")

    # Connections

    def _variables(self, element: ElementTree.Element) -> None:
        ends = list(children(element, "Variable"))
        self._two(ends, "variables")
        if self._any_broken(ends, "simulator"):
            return
        paths = [self._path(end) for end in ends]
        here = f"{self.file}: connection '{paths[0]}' - '{paths[1]}'"
        self._note_bond(element, here)
        self._wire(paths[0], paths[1], here)

    def _groups(self, element: ElementTree.Element) -> None:
        ends = list(children(element, "VariableGroup"))
        self._two(ends, "variable groups")
        if self._any_broken(ends, "simulator"):
            return
        shown = [f"{end.get('simulator')}: {end.get('name')}" for end in ends]
        here = f"{self.file}: group connection '{shown[0]}' - '{shown[1]}'"
        self._note_bond(element, here)
        first, second = (self._group(end, here) for end in ends)
        for a, b in pairs(first, second, here):
            with self.findings.collecting():
                self._wire(f"{ends[0].get('simulator')}.{a}", f"{ends[1].get('simulator')}.{b}", here)

    def _signal(self, element: ElementTree.Element) -> None:
        self._function_connection(element, "Signal", "Variable")

    def _signal_group(self, element: ElementTree.Element) -> None:
        self._function_connection(element, "SignalGroup", "VariableGroup")

    def _function_connection(self, element: ElementTree.Element, signal_name: str, variable_name: str) -> None:
        signals, ends = list(children(element, signal_name)), list(children(element, variable_name))
        if len(signals) != 1 or len(ends) != 1:
            raise OSPError(f"{self.file}: a {local_name(element)} must have a {signal_name} and a {variable_name}")
        if self._any_broken(signals, "function") or self._any_broken(ends, "simulator"):
            return
        function, signal = (attribute(signals[0], key, f"{self.file}") for key in ("function", "name"))
        here = f"{self.file}: connection with '{signal}' of '{function}'"
        if function not in self.functions:
            raise OSPError(f"{here}: there is no function '{function}'; {nearest(function, self.functions)}")
        if variable_name == "Variable":
            variables = [self._path(ends[0])]
        else:
            variables = [f"{ends[0].get('simulator')}.{v}" for v in self._group(ends[0], here).variables]
        gives = {self._gives(path, here) for path in variables}
        if len(gives) > 1:
            raise OSPError(f"{here}: the group has inputs and outputs; connect its variables one by one")
        self.functions[function].connect(signal, variables, gives=gives == {True}, here=here)

    def _two(self, ends: list[ElementTree.Element], what: str) -> None:
        if len(ends) != 2:
            raise OSPError(f"{self.file}: a connection has {len(ends)} {what}; it must have 2")

    def _any_broken(self, ends: list[ElementTree.Element], key: str) -> bool:
        """Whether an end could not be read, which is a problem that has been found already."""
        return any(end.get(key) in self._broken for end in ends)

    def _note_bond(self, element: ElementTree.Element, here: str) -> None:
        if element.get("powerBond") is not None:
            self.findings.note(
                f"{here}: that it is half of power bond '{element.get('powerBond')}' is ignored", "power bonds"
            )

    def _simulator_of(self, end: ElementTree.Element, here: str) -> _Simulator:
        name = attribute(end, "simulator", here)
        if name not in self.simulators:
            raise OSPError(f"{here}: there is no simulator '{name}'; {nearest(name, self.simulators)}")
        return self.simulators[name]

    def _path(self, end: ElementTree.Element) -> str:
        name = attribute(end, "name", f"{self.file}")
        simulator = self._simulator_of(end, f"{self.file}: connection of variable '{name}'")
        return f"{simulator.name}.{name}"

    def _group(self, end: ElementTree.Element, here: str) -> Group:
        return found_in(self._simulator_of(end, here).groups, attribute(end, "name", here), here)

    def _element(self, path: str, here: str) -> Element:
        simulator, _, name = path.partition(".")
        known = {e.name: e for e in self.simulators[simulator].ports.all_elements()}
        if name not in known:
            raise OSPError(f"{here}: simulator '{simulator}' has no variable '{name}'; {nearest(name, known)}")
        return known[name]

    def _gives(self, path: str, here: str) -> bool:
        return self._element(path, here).variable.causality in _GIVING

    def _wire(self, first: str, second: str, here: str) -> None:
        """Connect two variables, in the direction that their causalities leave."""
        gives = [self._gives(path, here) for path in (first, second)]
        if gives[0] == gives[1]:
            kinds = [self._element(path, here).variable.causality for path in (first, second)]
            raise OSPError(
                f"{here}: '{first}' is {kinds[0]} and '{second}' {kinds[1]}; "
                "one end must give values, the other take them"
            )
        source, target = (first, second) if gives[0] else (second, first)
        self._wires.append((source, target, 1.0, 0.0))

    # The system

    def _made(self) -> System:
        system = System()
        if not self.simulators and not self._broken:
            self.findings.problem(f"{self.file}: has no simulators; name FMUs there, in Simulator elements")
        for function in self.functions.values():
            with self.findings.collecting():
                self._wires += function.add_to(system, f"{self.file}", self.findings)
        for name, simulator in self.simulators.items():
            with self.findings.collecting():
                system.add(name, simulator.fmu, start=simulator.start, every=simulator.every)
        for source, target, factor, offset in self._wires:
            self._note_units(source, target, (factor, offset) == (1.0, 0.0))
            system.connect(source, target, factor=factor, offset=offset, units=self.units)
        return system

    def _note_units(self, source: str, target: str, plain: bool) -> None:
        """Note numbers that are taken as they are though their units differ; who transforms them knows that."""
        names = [path.partition(".")[0] for path in (source, target)]
        if self.units != "ignore" or not plain or not all(name in self.simulators for name in names):
            return
        elements = [self._element(path, f"{self.file}") for path in (source, target)]
        a, b = (self.simulators[n].ports.unit(e) for n, e in zip(names, elements, strict=True))
        if a is None or b is None:
            return
        try:
            differ = conversion(a, b, relative=False) != (1.0, 0.0)
        except UnitsDiffer:
            differ = True
        if differ:
            self.findings.note(
                f"{self.file}: '{source}' is in '{a.name}' and '{target}' in '{b.name}'; the number is taken as it is, "
                "as libcosim does (--units convert converts it)",
                "units",
            )
