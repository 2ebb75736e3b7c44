"""Scenarios as data: a system and a run of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.errors import CosimError
from cosim.system.system import Connection, System

if TYPE_CHECKING:  # what takes a while to import is not needed to know which scenarios there are
    from typing import Self

    from cosim.scenario.metrics import Metric
    from cosim.scenario.signals import Shape


class ScenarioError(CosimError):
    """A scenario is missing or malformed."""


@dataclass(frozen=True)
class ScenarioComponent:
    """A component of a scenario.

    Attributes
    ----------
    fmu : Path, optional
        FMU file; None where the family of the scenario has yet to say which.
    every : int
        The component communicates at every so many communication points.
    interface : {"auto", "co-simulation", "model-exchange"}, optional
        Interface of the FMU; that of the scenario by default.
    isolate : bool
        The FMU lives in a process of its own.
    place : str, optional
        Worker of a Dask cluster, by its address or a resource, where the FMU lives; see `System.add`.
    stands_in : bool
        The FMU stands in for one of the family: `cosim run` leaves out connections to what it does not have.
    """

    fmu: Path | None = None
    every: int = 1
    isolate: bool = False
    stands_in: bool = False
    interface: str | None = None
    place: str | None = None


@dataclass(frozen=True)
class Scenario:
    """A system and a run of it, as a TOML file describes them.

    Attributes
    ----------
    name, title : str
        Name of the file, and one line for people.
    components : mapping
        Name -> FMU and rate of each component.
    stop_time : float
        In s.
    step_size : float or "variable"
        Communication step (s).
    start_time : float
        In s.
    order : {"sequential", "parallel"}
        Gauss-Seidel or Jacobi.
    extrapolation : str
        What inputs do between communication points: "auto", "hold", "linear" and others, see
        `cosim.master.coupling.algorithm`.
    interface : {"auto", "co-simulation", "model-exchange"}, optional
        Interface of the FMUs of components that choose none; "auto" by default.
    solver : {"auto", "rk4", "dopri5"}
        What integrates components in model exchange.
    solver_step : float, optional
        Step (s) of rk4; the communication step by default.
    iterations : int, "auto" or "loops", optional
        Solve algebraic loops and repeat steps, by so many iterations at most; "loops" repeats none.
    tolerance : float, optional
        Relative tolerance that the FMUs are told; that of the default experiment of each by default.
    seed : int
        Seed of all random signals.
    record : tuple of str, optional
        What is recorded; all inputs and outputs by default.
    record_every : int
        Record at every so many communication points.
    start : mapping
        Component -> start values of its variables.
    connections : tuple of Connection
    signals : mapping
        Target `component.variable` -> signal that feeds it.
    disturbances : mapping
        Target `component.variable` -> signal that is added to what a connection feeds there, as sensor noise is.
    metrics : mapping
        Name -> number that is computed from the results.
    """

    name: str
    title: str
    components: Mapping[str, ScenarioComponent]
    stop_time: float
    step_size: float | str
    start_time: float = 0.0
    order: str = "sequential"
    extrapolation: str = "auto"
    tolerance: float | None = None
    seed: int = 1
    record: tuple[str, ...] | None = None
    record_every: int = 1
    start: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    connections: tuple[Connection, ...] = ()
    signals: Mapping[str, Shape] = field(default_factory=dict)
    disturbances: Mapping[str, Shape] = field(default_factory=dict)
    metrics: Mapping[str, Metric] = field(default_factory=dict)
    interface: str | None = None
    solver: str = "auto"
    solver_step: float | None = None
    iterations: int | str | None = None

    def system(self) -> System:
        """The system that the scenario describes.

        Raises
        ------
        ScenarioError
            A component has no FMU.
        SetupError
            A name or a rate of a component makes no sense.
        """
        from cosim.scenario.signals import ShapedSignal

        system = System()
        for name, component in self.components.items():
            if component.fmu is None:
                raise ScenarioError(f"component '{name}' has no FMU; name its file: [components.{name}] fmu = ...")
            interface = component.interface or self.interface
            start, isolate, place = self.start.get(name), component.isolate, component.place
            system.add(name, component.fmu, start, component.every, interface, isolate=isolate, place=place)
        system.connections.extend(self.connections)
        for shapes, feed in ((self.signals, system.drive), (self.disturbances, system.disturb)):
            for target, shape in shapes.items():
                signal = ShapedSignal(shape, self.seed, target)
                feed(target, signal, breakpoints=shape.breakpoints, vectorized=True)
        return system

    def with_fmus(self, fmus: Mapping[str, str | PathLike[str]]) -> Self:
        """A copy in which components have these FMUs."""
        changed = {name: dataclasses.replace(self.components[name], fmu=Path(path)) for name, path in fmus.items()}
        return dataclasses.replace(self, components={**self.components, **changed})

    def with_interfaces(self, interfaces: Mapping[str, str]) -> Self:
        """A copy in which components use these interfaces of their FMUs."""
        changed = {name: dataclasses.replace(self.components[name], interface=i) for name, i in interfaces.items()}
        return dataclasses.replace(self, components={**self.components, **changed})

    @property
    def stand_ins(self) -> dict[str, Path]:
        """FMUs that stand in for one of the family, by component."""
        return {name: c.fmu for name, c in self.components.items() if c.stands_in and c.fmu is not None}

    def shape(self, target: str) -> Shape | None:
        """The signal or disturbance at an input, if there is one."""
        return self.signals.get(target, self.disturbances.get(target))

    def with_shape(self, target: str, shape: Shape) -> Self:
        """A copy in which the signal or disturbance at an input is another one."""
        if target in self.signals:
            return dataclasses.replace(self, signals={**self.signals, target: shape})
        return dataclasses.replace(self, disturbances={**self.disturbances, target: shape})

    def with_start_value(self, component: str, name: str, value: Any) -> Self:
        """A copy in which one start value differs; it comes last, where one of an element follows one of its vector."""
        start = {c: dict(v) for c, v in self.start.items()}
        of_component = start.setdefault(component, {})
        of_component.pop(name, None)
        of_component[name] = value
        return dataclasses.replace(self, start=start)
