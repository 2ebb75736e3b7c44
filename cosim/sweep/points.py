"""Factors and points of a sweep: all combinations of levels, a Latin hypercube, or Sobol' sequence."""

from __future__ import annotations

import hashlib
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.errors import nearest, needs
from cosim.sweep.errors import SweepError

#: A value of a factor.
Value = float | int | str

#: More levels of one factor than this are taken for a mistake.
_MOST_LEVELS = 10_000_000

_FORMS = "write NAME=LOW:HIGH, NAME=LOW:HIGH:LEVELS or NAME=VALUE,VALUE,..."

#: More points than this need more memory than a plan should take.
MOST_POINTS = 100_000_000

DESIGNS = ("grid", "lhs", "sobol")


@dataclass(frozen=True)
class Levels:
    """A factor with a few values, all numbers of one type or all texts.

    Raises
    ------
    SweepError
        There are none, one comes twice, or a number is not finite.
    """

    name: str
    values: tuple[Value, ...]

    def __post_init__(self) -> None:
        if not self.values:
            raise SweepError(f"{self.name} has no values; give at least one")
        for value in self.values:
            _check_finite(self.name, value)
        if len(set(self.values)) < len(self.values):
            twice = next(v for i, v in enumerate(self.values) if v in self.values[:i])
            raise SweepError(f"{self.name} has the value {twice!r} twice; give each once")


@dataclass(frozen=True)
class Range:
    """A factor that takes all numbers from `low` to `high`.

    Raises
    ------
    SweepError
        The range is empty, or an end is not finite.
    """

    name: str
    low: float
    high: float

    def __post_init__(self) -> None:
        _check_finite(self.name, self.low)
        _check_finite(self.name, self.high)
        if not self.low < self.high:
            raise SweepError(f"{self.name}: the range {self.low!r}:{self.high!r} is empty; write the smaller end first")
        if not math.isfinite(self.high - self.low):
            raise SweepError(f"{self.name}: the range {self.low!r}:{self.high!r} is too wide; narrow it")


Factor = Levels | Range


def parse_factor(text: str) -> Factor:
    """A factor from `NAME=LOW:HIGH`, `NAME=LOW:HIGH:LEVELS` (evenly spaced) or `NAME=VALUE,VALUE,...`.

    Values of a list are numbers, or texts if one of them is not a number: true and false, items of an enumeration,
    texts. In double quotes a number is a text.

    Raises
    ------
    SweepError
        The text is none of these, or its numbers make no sense.
    """
    name, equals, values = text.partition("=")
    if not (equals and name and values):
        raise SweepError(f"'{text}' is not a factor; {_FORMS}")
    if ":" not in values or '"' in values:
        return Levels(name, _listed(text, values))
    ends = values.split(":")
    if len(ends) not in (2, 3):
        raise SweepError(f"'{text}' has {len(ends)} numbers between colons; {_FORMS}")
    range_ = Range(name, _number(text, ends[0]), _number(text, ends[1]))
    if len(ends) == 2:
        return range_
    count = _whole(text, ends[2])
    if not 2 <= count <= _MOST_LEVELS:
        raise SweepError(f"'{text}': {count} levels of a range; use 2 to {_MOST_LEVELS}")
    return Levels(name, tuple(np.linspace(range_.low, range_.high, count).tolist()))


def _listed(where: str, values: str) -> tuple[Value, ...]:
    """Values of a list: all numbers, or all texts."""
    items = re.findall(r'("[^"]*"|[^,]*),', f"{values},")
    if not all(item.strip('"') for item in items):
        raise SweepError(f"'{where}': there is an empty value; {_FORMS}")
    try:
        return tuple(float(item) for item in items)
    except ValueError:
        return tuple(item.strip('"') for item in items)


def parse_whole_numbers(name: str, text: str) -> Levels:
    """A factor of whole numbers from `FIRST:LAST`, both included, or `VALUE,VALUE,...`.

    Raises
    ------
    SweepError
        The text is neither, or the numbers make no sense.
    """
    ends = [_whole(text, part) for part in text.split(":" if ":" in text else ",")]
    if ":" not in text:
        return Levels(name, tuple(ends))
    if len(ends) != 2 or ends[1] < ends[0]:
        raise SweepError(f"{name} {text}: write FIRST:LAST with the smaller number first")
    if ends[1] - ends[0] >= _MOST_LEVELS:
        raise SweepError(f"{name} {text}: {ends[1] - ends[0] + 1} values are too many; use at most {_MOST_LEVELS}")
    return Levels(name, tuple(range(ends[0], ends[1] + 1)))


def _check_finite(name: str, value: Value) -> None:
    if not isinstance(value, str) and not math.isfinite(value):
        raise SweepError(f"{name}: {value!r} is not a finite number")


def _number(where: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise SweepError(f"'{where}': {text!r} is not a number; {_FORMS}") from None


def _whole(where: str, text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise SweepError(f"'{where}': {text!r} is not a whole number") from None


@dataclass(frozen=True)
class Points:
    """The points of a sweep, column by column, so that millions take little memory.

    Attributes
    ----------
    factors : tuple of Factor
    columns : tuple of array (n,)
        For each factor the values of a range (float64), or the numbers of the levels (int32).
    """

    factors: tuple[Factor, ...]
    columns: tuple[np.ndarray, ...]

    def __len__(self) -> int:
        return len(self.columns[0])

    @property
    def names(self) -> list[str]:
        """Names of the factors."""
        return [f.name for f in self.factors]

    def take(self, indices: np.ndarray) -> dict[str, list[Value]]:
        """Values of all factors at some points."""
        return {
            factor.name: column[indices].tolist()
            if isinstance(factor, Range)
            else [factor.values[k] for k in column[indices].tolist()]
            for factor, column in zip(self.factors, self.columns, strict=True)
        }

    def sha256(self) -> str:
        """Fingerprint of all values."""
        digest = hashlib.sha256()
        for factor, column in zip(self.factors, self.columns, strict=True):
            digest.update(repr(factor).encode())
            digest.update(np.ascontiguousarray(column.astype(column.dtype.newbyteorder("<"))).tobytes())
        return digest.hexdigest()


def design(kind: str, factors: Sequence[Factor], points: int | None = None, seed: int = 0) -> Points:
    """The points of a design.

    Parameters
    ----------
    kind : {"grid", "lhs", "sobol"}
        All combinations of levels, the last factor varying fastest; a Latin hypercube; the Sobol' sequence, scrambled.
    factors : sequence of Factor
        A grid has no ranges. In the other designs levels are drawn as evenly as ranges are.
    points : int, optional
        How many; a grid has as many as its levels make.
    seed : int
        Fixes the Latin hypercube and the scrambling.

    Raises
    ------
    SweepError
        The factors and options don't go together.
    """
    if kind not in DESIGNS:
        raise SweepError(f"design '{kind}' is unknown; {nearest(kind, DESIGNS)}")
    if not factors:
        raise SweepError("nothing is varied; name at least one factor")
    for name, times in Counter(f.name for f in factors).items():
        if times > 1:
            raise SweepError(f"{name} is varied twice; name each factor once")
    if kind == "grid":
        return Points(tuple(factors), _grid(factors, points))
    if points is None:
        raise SweepError(f"design {kind} needs a number of points; give it with --points")
    check_number(points)
    if seed < 0:
        raise SweepError(f"design seed {seed} must be 0 or greater")
    unit = _latin_hypercube(len(factors), points, seed) if kind == "lhs" else _sobol(len(factors), points, seed)
    return Points(tuple(factors), tuple(scaled(f, u) for f, u in zip(factors, unit, strict=True)))


def advice(kind: str, points: int) -> str:
    """Warning about a number of points, empty if there is none."""
    if kind != "sobol" or points & (points - 1) == 0:
        return ""
    lower = 1 << (points.bit_length() - 1)
    return f"note: Sobol' points are balanced when their number is a power of two: {lower} or {2 * lower}"


def _grid(factors: Sequence[Factor], points: int | None) -> tuple[np.ndarray, ...]:
    if points is not None:
        raise SweepError("a grid has as many points as its levels make; leave out --points, or choose --design sobol")
    sizes = []
    for factor in factors:
        if isinstance(factor, Range):
            raise SweepError(
                f"a grid needs levels of {factor.name}: write {factor.low:g}:{factor.high:g}:11 for 11 of them, "
                "or choose --design sobol"
            )
        sizes.append(len(factor.values))
    check_number(math.prod(sizes))
    return tuple(column.astype(np.int32) for column in np.unravel_index(np.arange(math.prod(sizes)), sizes))


def _latin_hypercube(dimensions: int, points: int, seed: int) -> Iterator[np.ndarray]:
    with needs("sweep"):
        from scipy.stats import qmc  # takes a while to import, and a grid doesn't need it

    return iter(qmc.LatinHypercube(dimensions, rng=np.random.default_rng(seed)).random(points).T)


def _sobol(dimensions: int, points: int, seed: int) -> Iterator[np.ndarray]:
    with needs("sweep"):
        from scipy.stats import qmc

    if dimensions > qmc.Sobol.MAXDIM:
        raise SweepError(f"Sobol's sequence has at most {qmc.Sobol.MAXDIM} factors, not {dimensions}; use --design lhs")
    sequence = qmc.Sobol(dimensions, rng=np.random.default_rng(seed))
    # the first points of the next power of two: the same as fewer, without scipy's warning, which `advice` replaces
    return iter(sequence.random_base2((points - 1).bit_length())[:points].T)


def scaled(factor: Factor, unit: np.ndarray) -> np.ndarray:
    """Column of a factor from numbers (n,) in [0, 1): values of a range, numbers of levels."""
    if isinstance(factor, Levels):
        return np.minimum((unit * len(factor.values)).astype(np.int32), len(factor.values) - 1)
    return factor.low + unit * (factor.high - factor.low)


def check_number(points: int) -> None:
    """Whether a sweep can have so many points.

    Raises
    ------
    SweepError
        There are none, or too many.
    """
    if points < 1:
        raise SweepError(f"{points} points can't be run; ask for at least one")
    if points > MOST_POINTS:
        raise SweepError(f"{points:,} points are more than one sweep takes ({MOST_POINTS:,}); split it")
