"""Input signals that scenarios name: functions of time described by a few numbers.

A random signal is random once: its seed fixes it, and it is a function of time like any other, so that runs with
different steps, and runs without a step, get the same disturbance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

#: Value (size,) of a signal at a time (s), or values (n, size) at times (n,).
SignalFunction = Callable[[float | np.ndarray], np.ndarray]


#: More sines than this would cost more than the FMUs.
_MOST_COMPONENTS = 10_000


@dataclass(frozen=True)
class Sine:
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
            wave = self.amplitude * np.sin(2.0 * np.pi * self.frequency * np.asarray(times) + self.phase)
            return np.repeat(wave[..., np.newaxis], size, axis=-1)

        return values

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times (s) at which the signal jumps: none."""
        return ()


@dataclass(frozen=True)
class Multisine:
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
            raise ValueError(f"rms = {self.rms!r} must not be negative")
        if not 0.0 <= self.lowest <= self.highest:
            raise ValueError(f"the band [{self.lowest!r}, {self.highest!r}] Hz must not be negative and must ascend")
        if not 1 <= self.components <= _MOST_COMPONENTS:
            raise ValueError(f"components = {self.components!r} must be between 1 and {_MOST_COMPONENTS}")

    def function(self, size: int, seed: int, target: str) -> SignalFunction:
        """The signal for an input of some size; each target gets its own, the same for the same seed."""
        random = np.random.default_rng([seed, *target.encode()])
        frequencies = random.uniform(self.lowest, self.highest, (size, self.components))
        phases = random.uniform(0.0, 2.0 * np.pi, (size, self.components))
        # components first and times last: numpy goes through long rows in half the time
        angular, shift = 2.0 * np.pi * frequencies.T[..., np.newaxis], phases.T[..., np.newaxis]
        amplitude = self.rms * np.sqrt(2.0 / self.components)

        def values(times: float | np.ndarray) -> np.ndarray:
            since = np.asarray(times) - self.start_time
            on = since[since >= 0.0]
            waves = np.zeros((size, len(on)))
            for omega, phase in zip(angular, shift, strict=True):  # one component at a time, for memory
                waves += np.sin(omega * on + phase)
            found = np.zeros((*since.shape, size))
            found[since >= 0.0] = amplitude * waves.T
            return found

        return values

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
class Noise:
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
            raise ValueError(f"rms = {self.rms!r} must not be negative")
        if not self.period >= _SHORTEST:
            raise ValueError(f"period = {self.period!r} s must be at least {_SHORTEST:g} s")

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

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times (s) at which linear coupling starts anew: none, a noise jumps all the time."""
        return ()


#: A signal of any shape.
Shape = Sine | Multisine | Noise

#: Signal classes by the `shape` that scenarios write.
SHAPES: dict[str, type[Shape]] = {"sine": Sine, "multisine": Multisine, "noise": Noise}
