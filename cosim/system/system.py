"""What is simulated: components (FMUs), connections between them, and input signals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, Literal, Protocol, cast

from cosim.errors import SetupError

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


#: What a connection does where the units of its ends differ: an error, a conversion, or nothing.
Units = Literal["equal", "convert", "ignore"]


@dataclass(frozen=True)
class Component:
    """One instance of an FMU; see `System.add`."""

    name: str
    fmu: Path
    start: Mapping[str, Any]
    every: int


@dataclass(frozen=True)
class Connection:
    """An output of one component that feeds an input of another; see `System.connect`."""

    source: str
    target: str
    factor: float = 1.0
    offset: float = 0.0
    units: Units = "equal"


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
    ) -> None:
        """Add a component.

        Parameters
        ----------
        name : str
            Name of the instance; names of variables in results begin with it.
        fmu : path
            FMU file (FMI 2.0 or 3.0 co-simulation).
        start : mapping, optional
            Start values of parameters and inputs; whole vectors by their common name. An input that has one needs
            no connection.
        every : int
            The component communicates at every so many communication points; its step is that multiple of the
            communication step. Its last step may end after the stop time.

        Raises
        ------
        SetupError
            The name is taken or malformed, or `every` is not a positive integer.
        """
        if not name or "." in name:
            raise SetupError(f"component name {name!r} must be a non-empty text without a dot")
        if name in self.components:
            raise SetupError(f"there are two components named '{name}'; give each its own name")
        if isinstance(every, bool) or not isinstance(every, int) or every < 1:
            raise SetupError(f"component '{name}': every = {every!r} must be a positive whole number of steps")
        self.components[name] = Component(name, Path(fmu), dict(start or {}), every)

    def connect(
        self, source: str, target: str, *, factor: float = 1.0, offset: float = 0.0, units: Units = "equal"
    ) -> None:
        """Connect an output to an input; scalars, or whole vectors of equal size.

        The input becomes `factor` * output + `offset`.

        Parameters
        ----------
        source, target : str
            Output and input, both `component.variable`.
        factor, offset : float
            For real values only; the offset is in the unit of the input.
        units : {"equal", "convert", "ignore"}
            What to do where the FMUs give the two ends different units: refuse the connection, convert the output to
            the unit of the input before factor and offset are applied, or take the number as it is.
        """
        self.connections.append(Connection(source, target, factor, offset, units))

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
            Input `component.variable`, a scalar or a vector.
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
