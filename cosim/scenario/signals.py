"""Input signals that scenarios name: functions of time described by a few numbers.

A random signal is random once: its seed fixes it, and it is a function of time like any other, so that runs with
different steps, and runs without a step, get the same disturbance.

A shape of one's own is a subclass of `Shape` with a name. Scenarios write that name, and the fields of the
class as keys.
"""

from __future__ import annotations

import dataclasses
import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from cosim.errors import ArgumentError, MissingExtra, ResultsError, SetupError, nearest
from cosim.results.results import Results

#: Value (size,) of a signal at a time (s), or values (n, size) at times (n,).
SignalFunction = Callable[[float | np.ndarray], np.ndarray]

#: More sines, or pulses, than this would cost more than the FMUs.
_MOST_COMPONENTS = 10_000

#: Shape classes by the name that scenarios write.
SHAPES: dict[str, type[Shape]] = {}


@dataclass(frozen=True)
class Shape(ABC):
    """The shape of an input signal.

    A subclass is a frozen dataclass and says its name: `class Step(Shape, name="step")`. Its fields are numbers, whole
    numbers or texts; `__post_init__` raises ValueError where they make no sense.
    """

    name: ClassVar[str]

    #: Fields that are paths of files; in a TOML file they are relative to it.
    paths: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls, *, name: str) -> None:
        cls.name = name
        SHAPES[name] = cls

    @abstractmethod
    def function(self, size: int, seed: int, target: str) -> SignalFunction:
        """The signal for an input of some size; a random one is the same for the same seed and target."""

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times (s) at which the signal jumps; linear extrapolation starts anew there."""
        return ()

    def as_data(self) -> dict[str, Any]:
        """The shape as JSON can write it."""
        return {"shape": self.name, **dataclasses.asdict(self)}


@dataclass(frozen=True)
class ShapedSignal:
    """A signal of a shape, whose size is that of the input that it feeds.

    Parameters
    ----------
    shape : Shape
    seed : int
        Of what is random.
    target : str
        Input `component.variable`; different inputs get different random values.
    """

    shape: Shape
    seed: int
    target: str

    def for_size(self, size: int) -> SignalFunction:
        """The function of time for an input of some size, always the same one."""
        return _function(self.shape, size, self.seed, self.target)


@lru_cache(256)
def _function(shape: Shape, size: int, seed: int, target: str) -> SignalFunction:
    return shape.function(size, seed, target)


def _alike(wave: np.ndarray, size: int) -> np.ndarray:
    """The same values for all elements."""
    return np.repeat(wave[..., np.newaxis], size, axis=-1)


@dataclass(frozen=True)
class Constant(Shape, name="constant"):
    """The same value all the time.

    Parameters
    ----------
    value : float
        In the unit of the input.
    """

    value: float

    def function(self, size: int, seed: int, target: str) -> SignalFunction:  # noqa: ARG002 -- nothing random
        """The signal for an input of some size."""
        return lambda times: np.full((*np.shape(times), size), self.value)


@dataclass(frozen=True)
class Step(Shape, name="step"):
    """`before` until `time`, and `after` from there on.

    Parameters
    ----------
    time : float
        When it jumps (s).
    after, before : float
        In the unit of the input.
    """

    time: float
    after: float
    before: float = 0.0

    def function(self, size: int, seed: int, target: str) -> SignalFunction:  # noqa: ARG002 -- nothing random
        """The signal for an input of some size."""
        return lambda times: _alike(np.where(np.asarray(times) < self.time, self.before, self.after), size)

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times (s) at which the signal jumps."""
        return (self.time,)


@dataclass(frozen=True)
class Ramp(Shape, name="ramp"):
    """`before` until `start_time`, then a straight line that reaches `after` at `end_time`, and `after` from there on.

    Parameters
    ----------
    start_time, end_time : float
        In s.
    after, before : float
        In the unit of the input.
    """

    start_time: float
    end_time: float
    after: float
    before: float = 0.0

    def __post_init__(self) -> None:
        if not self.start_time < self.end_time:
            raise ArgumentError(f"end_time = {self.end_time!r} s must be later than start_time = {self.start_time!r} s")

    def function(self, size: int, seed: int, target: str) -> SignalFunction:  # noqa: ARG002 -- nothing random
        """The signal for an input of some size."""

        def values(times: float | np.ndarray) -> np.ndarray:
            ends = (self.start_time, self.end_time), (self.before, self.after)
            return _alike(np.interp(np.asarray(times, dtype=float), *ends), size)

        return values


@dataclass(frozen=True)
class PulseTrain(Shape, name="pulses"):
    """Rectangular pulses: `amplitude` for a width at the start of each period, `base` before, between and after.

    Parameters
    ----------
    amplitude : float
        Value in a pulse, in the unit of the input.
    period, width : float
        From one pulse to the next, and how long each lasts (s).
    pulses : int
        How many there are.
    start_time : float
        When the first one begins (s).
    base : float
        Value outside of pulses, in the unit of the input.
    """

    amplitude: float
    period: float
    width: float
    pulses: int
    start_time: float = 0.0
    base: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.width < self.period:
            raise ArgumentError(f"width = {self.width!r} s must be positive and less than the period {self.period!r} s")
        if not 1 <= self.pulses <= _MOST_COMPONENTS:
            raise ArgumentError(f"pulses = {self.pulses!r} must be between 1 and {_MOST_COMPONENTS}")

    def function(self, size: int, seed: int, target: str) -> SignalFunction:  # noqa: ARG002 -- nothing random
        """The signal for an input of some size."""
        edges = np.array(self.breakpoints)

        def values(times: float | np.ndarray) -> np.ndarray:
            # by the very breakpoints, so that a time at one of them is behind it
            in_pulse = np.searchsorted(edges, np.asarray(times), side="right") % 2 == 1
            return _alike(np.where(in_pulse, self.amplitude, self.base), size)

        return values

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times (s) at which the signal jumps: both edges of each pulse."""
        starts = [self.start_time + i * self.period for i in range(self.pulses)]
        return tuple(edge for start in starts for edge in (start, start + self.width))


def unit_sine(times: Any, frequency: Any, phase: Any) -> Any:
    """sin(2 pi frequency t + phase) at times (s), of numbers and arrays, and of symbols, by which models are traced."""
    return np.sin(2.0 * np.pi * frequency * times + phase)


def sum_of_sines(times: Any, frequencies: Any, phases: Any) -> Any:
    """Sum of `unit_sine` over the first axis of frequencies (Hz) and phases (rad)."""
    total: Any = 0.0
    for frequency, phase in zip(frequencies, phases, strict=True):  # one at a time, for memory
        total = total + unit_sine(times, frequency, phase)
    return total


@dataclass(frozen=True)
class Sine(Shape, name="sine"):
    """amplitude * sin(2 pi frequency t + phase), the same for all elements.

    Parameters
    ----------
    amplitude : float
        In the unit of the input.
    frequency : float
        In Hz.
    phase : float
        In rad.
    """

    amplitude: float
    frequency: float
    phase: float = 0.0

    def function(self, size: int, seed: int, target: str) -> SignalFunction:  # noqa: ARG002 -- nothing random
        """The signal for an input of some size."""

        def values(times: float | np.ndarray) -> np.ndarray:
            wave = self.amplitude * unit_sine(np.asarray(times), self.frequency, self.phase)
            return _alike(wave, size)

        return values


@dataclass(frozen=True)
class Multisine(Shape, name="multisine"):
    """A random disturbance: from `start_time` on, a sum of sines with random frequencies and phases.

    The usual random-phase multisine of system identification (Pintelon and Schoukens, System Identification, 2012,
    section 5.2.2), with frequencies drawn as well so that it does not repeat. Smooth after it sets in, band-limited,
    and of a given size.

    Parameters
    ----------
    rms : float
        Root mean square of each element, in the unit of the input.
    lowest, highest : float
        Band of the frequencies (Hz).
    components : int
        Number of sines for each element.
    start_time : float
        When it sets in (s); it is zero before.
    """

    rms: float
    lowest: float
    highest: float
    components: int = 20
    start_time: float = 0.0

    def __post_init__(self) -> None:
        if self.rms < 0.0:
            raise ArgumentError(f"rms = {self.rms!r} must not be negative")
        if not 0.0 <= self.lowest <= self.highest:
            raise ArgumentError(f"the band [{self.lowest!r}, {self.highest!r}] Hz must not be negative and must ascend")
        if not 1 <= self.components <= _MOST_COMPONENTS:
            raise ArgumentError(f"components = {self.components!r} must be between 1 and {_MOST_COMPONENTS}")

    def function(self, size: int, seed: int, target: str) -> SignalFunction:
        """The signal for an input of some size; each target gets its own, the same for the same seed."""
        # components first and times last: numpy goes through long rows in half the time
        frequencies, phases = (drawn[..., np.newaxis] for drawn in self.drawn(size, seed, target))
        amplitude = self.rms * np.sqrt(2.0 / self.components)

        def values(times: float | np.ndarray) -> np.ndarray:
            since = np.asarray(times) - self.start_time
            waves = sum_of_sines(since[since >= 0.0], frequencies, phases)
            found = np.zeros((*since.shape, size))
            found[since >= 0.0] = amplitude * waves.T
            return found

        return values

    def drawn(self, size: int, seed: int, target: str) -> tuple[np.ndarray, np.ndarray]:
        """What is random: frequencies (Hz) and phases (rad), each (components, size)."""
        random = np.random.default_rng([seed, *target.encode()])
        frequencies = random.uniform(self.lowest, self.highest, (size, self.components))
        phases = random.uniform(0.0, 2.0 * np.pi, (size, self.components))
        return frequencies.T, phases.T

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times (s) at which the signal jumps: where it sets in."""
        return (self.start_time,)


#: Values of a noise that are drawn at once, and how many such blocks are kept.
_BLOCK, _MOST_BLOCKS = 4096, 64

#: Shortest period (s), for the number of values to be one that can be counted.
_SHORTEST = 1e-9

#: A time this near before the next value (in periods) is taken to be at it, for rounding.
_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Noise(Shape, name="noise"):
    """White noise as a sampled sensor has it: independent normal values, each held for a period.

    Its spectrum is that of the period, whatever the communication step: steps that fit into the period see all of its
    values, longer ones pass over some.

    Parameters
    ----------
    rms : float
        Root mean square of each element, in the unit of the input.
    period : float
        How long a value lasts (s).
    """

    rms: float
    period: float = 1e-3

    def __post_init__(self) -> None:
        if self.rms < 0.0:
            raise ArgumentError(f"rms = {self.rms!r} must not be negative")
        if not self.period >= _SHORTEST:
            raise ArgumentError(f"period = {self.period!r} s must be at least {_SHORTEST:g} s")

    def function(self, size: int, seed: int, target: str) -> SignalFunction:
        """The signal for an input of some size; each target gets its own, the same for the same seed."""

        @lru_cache(_MOST_BLOCKS)
        def block(number: int) -> np.ndarray:
            # a stream for each block, so that a value depends on its time alone and not on what was asked for before
            return np.random.default_rng([seed, *target.encode(), number]).standard_normal((_BLOCK, size))

        def values(times: float | np.ndarray) -> np.ndarray:
            index = np.floor(np.asarray(times) / self.period + _TOLERANCE).astype(np.int64)
            numbers, places = index // _BLOCK, index % _BLOCK
            found = np.empty((*index.shape, size))
            for number in np.unique(numbers).tolist():
                own = numbers == number
                found[own] = block(number % 2**32)[places[own]]
            return self.rms * found

        return values


@dataclass(frozen=True)
class CsvColumn(Shape, name="table"):
    """A column of a table over time (s): a CSV file, or another that `Results.read` takes.

    Before its first row and after its last one the signal has their values. Where rows have the same time it jumps, and
    has the value of the last of them there.

    Parameters
    ----------
    file : str
        Path, in a TOML file relative to it.
    column : str
        Its name; for a vector, the columns are `column[1]`, `column[2]`, ...
    between : {"linear", "hold"}
        What the signal does between two rows.
    """

    file: str
    column: str
    between: Literal["linear", "hold"] = "linear"
    sha256: str = field(init=False)  # of the file, so that scenarios with other contents differ

    paths = ("file",)

    def __post_init__(self) -> None:
        if self.between not in ("linear", "hold"):
            raise ArgumentError(f"between = {self.between!r} is unknown; {nearest(self.between, ('linear', 'hold'))}")
        try:
            table = Results.read(self.file)  # here, since a worker elsewhere does not have the file
            content = Path(self.file).read_bytes()
        except (ResultsError, MissingExtra, OSError) as error:
            raise ArgumentError(str(error)) from error
        names = [self.column] if self.column in table.names else []
        names = names or [n for n in table.names if n.rpartition("[")[0] == self.column]
        if not names:
            raise ArgumentError(f"{self.file}: there is no column '{self.column}'; {nearest(self.column, table.names)}")
        values = table.values[:, [table.names.index(name) for name in names]]
        if texts := [name for name in names if name in table.typed and table.typed[name].is_text]:
            raise ArgumentError(f"{self.file}: column '{texts[0]}' has texts; a signal needs numbers")
        if not (len(table.time) and np.isfinite(table.time).all() and np.isfinite(values).all()):
            raise ArgumentError(f"{self.file}: needs rows of finite numbers")
        if not (np.diff(table.time) >= 0.0).all():
            raise ArgumentError(f"{self.file}: the times must not descend")
        object.__setattr__(self, "sha256", hashlib.sha256(content).hexdigest())
        self.__dict__["_rows"] = table.time, values  # no field: they are no part of what a TOML file says

    @property
    def rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (n,) (s) and values (n, columns) of the table."""
        time, values = self.__dict__["_rows"]
        return time, values

    def function(self, size: int, seed: int, target: str) -> SignalFunction:  # noqa: ARG002 -- nothing random
        """The signal for an input of some size; one column feeds all elements alike.

        Raises
        ------
        SetupError
            There are neither one column nor as many as elements.
        """
        time, values = self.rows
        if values.shape[1] not in (1, size):
            raise SetupError(f"{self.file}: '{self.column}' has {values.shape[1]} columns for the {size} of '{target}'")
        return interpolated(time, np.broadcast_to(values, (len(time), size)), self.between)

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times (s) at which the signal jumps: at rows of equal times, or wherever held values differ."""
        time, values = self.rows
        differs = (np.diff(values, axis=0) != 0.0).any(axis=1)
        jumps = differs if self.between == "hold" else differs & (time[1:] == time[:-1])
        return tuple(np.unique(time[1:][jumps]).tolist())


def interpolated(time: np.ndarray, values: np.ndarray, between: Literal["linear", "hold"]) -> SignalFunction:
    """A function of time through rows; where rows have the same time it has the value of the last of them.

    Parameters
    ----------
    time : array (n,)
        In s, not descending.
    values : array (n, size)
    between : {"linear", "hold"}
        What the function does between two rows.
    """

    def held(times: float | np.ndarray) -> np.ndarray:
        return values[np.maximum(np.searchsorted(time, times, side="right") - 1, 0)]

    def linear(times: float | np.ndarray) -> np.ndarray:
        t = np.asarray(times, dtype=float)
        left = np.maximum(np.searchsorted(time, t, side="right") - 1, 0)
        right = np.minimum(left + 1, len(time) - 1)
        span = time[right] - time[left]
        share = np.clip(np.divide(t - time[left], span, out=np.zeros_like(t), where=span > 0.0), 0.0, 1.0)
        of_right = share[..., np.newaxis]
        with np.errstate(over="ignore", invalid="ignore"):
            between_rows: np.ndarray = values[left] + of_right * (values[right] - values[left])
            if not np.isfinite(between_rows).all():  # rows further apart than there are numbers
                far = ~np.isfinite(between_rows) & np.isfinite(values[left]) & np.isfinite(values[right])
                between_rows = np.where(far, (1.0 - of_right) * values[left] + of_right * values[right], between_rows)
        return between_rows

    return held if between == "hold" else linear
