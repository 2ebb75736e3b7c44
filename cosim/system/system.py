"""Systems: components (FMUs, functions in Python), connections between them, and input signals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any, Literal, Protocol, cast

from cosim.errors import SetupError, nearest, positive_whole
from cosim.fmi.interfaces import INTERFACES
from cosim.system.function import PythonFunction, VariableSpecs

#: A function of time (s) that gives the value of an input: a number, or a sequence for a vector.
SignalFunction = Callable[[Any], Any]


class SizedLater(Protocol):
    """A signal that waits for the size of the input that it feeds."""

    def for_size(self, size: int) -> SignalFunction:
        """The function of time for an input of some size."""
        ...


class AsWritten(str):
    """A start value as a person wrote it, as an option; the type of its variable says what it means."""

    __slots__ = ()


#: Most communication points that a step of a component can span.
_LONGEST = 2**31 - 1

#: Treatment of different units at the ends of a connection: an error, a conversion, or nothing.
Units = Literal["equal", "convert", "ignore"]


@dataclass(frozen=True)
class Component:
    """A component of a system: an FMU, or a function in Python; see `System.add` and `System.add_function`."""

    name: str
    fmu: Path | None
    start: Mapping[str, Any]
    every: int
    function: PythonFunction | None = None
    interface: str | None = None
    isolate: bool = False
    place: str | None = None


@dataclass(frozen=True)
class Connection:
    """An output of one component that feeds an input of another; see `System.connect`."""

    source: str
    target: str
    factor: float = 1.0
    offset: float = 0.0
    units: Units = "equal"
    extrapolation: str | None = None


@dataclass(frozen=True)
class Signal:
    """A function of time for an input, `component.variable`; see `System.drive` and `System.disturb`."""

    target: str
    function: SignalFunction | SizedLater
    breakpoints: tuple[float, ...] = ()
    vectorized: bool = False
    added: bool = False

    def function_for(self, size: int) -> SignalFunction:
        """The function of time for an input of some size."""
        for_size: Callable[[int], SignalFunction] | None = getattr(self.function, "for_size", None)
        return cast(SignalFunction, self.function) if for_size is None else for_size(size)


@dataclass
class System:
    """Components, connections and input signals, by name; nothing is loaded or checked before `simulate`.

    Examples
    --------
    >>> system = System()
    >>> system.add("plant", "fmus/pythonfmu/RobotPlant.fmu", start={"tau_d": [0, 0, 0], "dm": 0})
    >>> system.drive("plant.tau_a", lambda t: [0.1, 0.1, 0.1])
    """

    components: dict[str, Component] = field(default_factory=dict)
    connections: list[Connection] = field(default_factory=list)
    signals: list[Signal] = field(default_factory=list)

    def add(
        self,
        name: str,
        fmu: str | PathLike[str],
        start: Mapping[str, float | int | bool | str | Sequence[float]] | None = None,
        every: int = 1,
        interface: str | None = None,
        *,
        isolate: bool = False,
        place: str | None = None,
    ) -> None:
        """Add a component.

        Parameters
        ----------
        name : str
            Name of the component; names of variables in results begin with it.
        fmu : path
            FMU file: for co-simulation of FMI 1.0, 2.0 or 3.0, or for model exchange of FMI 2.0 or 3.0.
        start : mapping, optional
            Start values of parameters and inputs; whole vectors by their common name. An input that has one needs
            no connection. Sizes of arrays follow start values of structural parameters.
        every : int
            The component communicates at every so many communication points; its step is that multiple of the
            communication step. Its last step may end after the stop time.
        interface : {"auto", "co-simulation", "model-exchange"}, optional
            Interface of the FMU that is used; that of the simulation by default. "auto" is co-simulation where the FMU
            has it, and else model exchange.
        isolate : bool
            Whether its FMU lives in a process of its own: if it crashes, ends its process or never returns, the run
            ends with what was recorded, and this process goes on.
        place : str, optional
            Where its FMU lives in a process of its own, on another machine: the address of a worker of a Dask cluster,
            or a resource that a worker has; see `Simulation`, `scheduler`.

        Raises
        ------
        SetupError
            The name is taken or malformed, `every` is not a positive integer, the interface is unknown, or the place is
            no text.
        """
        if interface is not None and interface not in INTERFACES:
            raise SetupError(
                f"component '{name}': interface {interface!r} is unknown; {nearest(str(interface), INTERFACES)}"
            )
        if not isinstance(isolate, bool):
            raise SetupError(f"component '{name}': isolate = {isolate!r} must be True or False")
        if place is not None and not (isinstance(place, str) and place):
            raise SetupError(
                f"component '{name}': place = {place!r} must be the address of a worker of a Dask cluster, or the name "
                "of a resource of one"
            )
        self._add(
            Component(name, Path(fmu), dict(start or {}), every, interface=interface, isolate=isolate, place=place)
        )

    def add_function(
        self,
        name: str,
        function: Callable[..., Any],
        *,
        inputs: VariableSpecs = (),
        outputs: VariableSpecs = (),
        start: Mapping[str, float | int | bool | Sequence[float]] | None = None,
        every: int = 1,
        direct_feedthrough: bool = True,
    ) -> None:
        """Add a component that is a function in Python, as a controller, an optimiser or a learner.

        It is called once at each communication point where it takes part; nothing happens to it in between.
        Connections, signals, units, orders and recordings treat its inputs and outputs as those of an FMU.

        Parameters
        ----------
        name : str
            Name of the component.
        function : callable
            ``function(time, *inputs)`` gives the outputs. The time is that of the communication point, in s. Inputs
            come in the order of `inputs`: numbers for scalars, arrays of their own for vectors and matrices. It returns
            the output, or as many outputs as there are, in their order; None where there are none.

            A plain function must not keep anything from one call to the next. What keeps something is an object with
            `__call__`, or a method of one, that has `reset()`, called at the beginning of each run, or `save()`, which
            gives bytes, and `restore(state)`: each run then begins with the state that it has now. `SteppedRun.save`
            needs the latter two. An object without any of them can take part in one run.
        inputs, outputs : mapping or sequence of str
            Name -> unit (a real number), type (float, int or bool), shape, or unit or type and shape: "rad", bool, 3,
            ("rad", 3). Or names only. The name of a vector may have its range: `theta[1..3]`.
        start : mapping, optional
            Start values of inputs. One that has a start value needs no connection.
        every : int
            As in `add`.
        direct_feedthrough : bool
            By default outputs at a communication point are computed from the inputs at that very point. Without direct
            feedthrough they are computed from the inputs of the point before (at the start: from the start values, 0 by
            default), as by a controller that needs a period to compute. Then the component closes no algebraic loop.

        Raises
        ------
        SetupError
            The name is taken or malformed, a variable is not described as it must be, or `every` is no positive
            integer.

        Examples
        --------
        >>> system = System()
        >>> system.add_function(
        ...     "controller", lambda t, theta: -2.0 * theta, inputs={"theta": ("rad", 3)}, outputs={"tau": ("N.m", 3)}
        ... )
        """
        if not isinstance(direct_feedthrough, bool):
            raise SetupError(f"component '{name}': direct_feedthrough = {direct_feedthrough!r} must be True or False")
        made = PythonFunction(name, function, inputs, outputs, direct_feedthrough=direct_feedthrough)
        for other in self.components.values():
            if made.owner is not None and other.function is not None and other.function.owner is made.owner:
                raise SetupError(
                    f"components '{other.name}' and '{name}' are functions of one object; give each its own object"
                )
        self._add(Component(name, None, dict(start or {}), every, made))

    def _add(self, component: Component) -> None:
        name, given, every = component.name, component.every, positive_whole(component.every)
        if not name or "." in name:
            raise SetupError(f"component name {name!r} must be a non-empty text without a dot")
        if name in self.components:
            raise SetupError(f"there are two components named '{name}'; give each its own name")
        if every is None:
            raise SetupError(f"component '{name}': every = {given!r} must be a positive whole number of steps")
        if every > _LONGEST:
            raise SetupError(f"component '{name}': every must be at most {_LONGEST}; no run has so many steps")
        self.components[name] = replace(component, every=every)

    def connect(
        self,
        source: str,
        target: str,
        *,
        factor: float = 1.0,
        offset: float = 0.0,
        units: Units = "equal",
        extrapolation: str | None = None,
    ) -> None:
        """Connect an output to an input; scalars, or whole vectors of equal size.

        The input becomes `factor` * output + `offset`. An input clock ticks when the output clock does.

        Parameters
        ----------
        source, target : str
            Output and input, both `component.variable`.
        factor, offset : float
            For real values only; the offset is in the unit of the input.
        units : {"equal", "convert", "ignore"}
            What to do where the FMUs give the two ends different units: refuse the connection, convert the output to
            the unit of the input before factor and offset are applied, or take the number as it is.
        extrapolation : str, optional
            What the input does between communication points, as in `Simulation`; that of the simulation by default.
        """
        self.connections.append(Connection(source, target, factor, offset, units, extrapolation))

    def drive(
        self,
        target: str,
        function: SignalFunction | SizedLater,
        *,
        breakpoints: Sequence[float] = (),
        vectorized: bool = False,
    ) -> None:
        """Feed an input from a function of time (s), sampled at the communication points.

        Parameters
        ----------
        target : str
            Input `component.variable`, a scalar or a vector. A triggered clock ticks at the communication points where
            the function is true.
        function : callable
            function(t) -> value, or a sequence of values for a vector; must depend on the time alone. Or an object
            whose `for_size(size)` gives that function for the number of elements of the input.
        breakpoints : sequence of float
            Times (s) at which the function jumps. Linear coupling then starts anew instead of drawing a line across.
        vectorized : bool
            The function takes an array of times (n,) and returns an array (n,) or (n, size): much faster.
        """
        self.signals.append(Signal(target, function, tuple(map(float, breakpoints)), vectorized))

    def disturb(
        self,
        target: str,
        function: SignalFunction | SizedLater,
        *,
        breakpoints: Sequence[float] = (),
        vectorized: bool = False,
    ) -> None:
        """Add a function of time (s) to a connected input, as sensor noise or a fault does.

        The sum is sampled at the communication points and held between them.

        Parameters
        ----------
        target : str
            Real input `component.variable` that a connection feeds.
        function, breakpoints, vectorized
            As in `drive`; in the unit of the input.
        """
        self.signals.append(Signal(target, function, tuple(map(float, breakpoints)), vectorized, added=True))

    def _repr_html_(self) -> str | None:
        """The diagram, for notebooks; None where there is none to draw."""
        from cosim.page.diagram import diagram_page  # with the scripts of the page
        from cosim.page.notebook import frame

        page = diagram_page(
            {
                "fmus": {name: {"path": str(c.fmu)} for name, c in self.components.items() if c.fmu is not None},
                "functions": {name: True for name, c in self.components.items() if c.fmu is None},
                "connections": {c.target: c.source for c in self.connections},
                "inputs_driven": [signal.target for signal in self.signals],
            }
        )
        return None if page is None else frame(page, "Diagram of the system", min(220 + 30 * len(self.components), 640))
