"""What is varied: a factor has a name, and levels or a range."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cosim.sweep.errors import SweepError

#: A value of a factor.
Value = float | int | str

#: More levels of one factor than this are taken for a mistake.
_MOST_LEVELS = 10_000_000

_FORMS = "write NAME=LOW:HIGH, NAME=LOW:HIGH:LEVELS or NAME=VALUE,VALUE,..."


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
    """A factor of numbers from `NAME=LOW:HIGH`, `NAME=LOW:HIGH:LEVELS` (evenly spaced) or `NAME=VALUE,VALUE,...`.

    Raises
    ------
    SweepError
        The text is none of these, or its numbers make no sense.
    """
    name, equals, values = text.partition("=")
    if not (equals and name and values):
        raise SweepError(f"'{text}' is no factor; {_FORMS}")
    if ":" not in values:
        return Levels(name, tuple(_number(text, v) for v in values.split(",")))
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
