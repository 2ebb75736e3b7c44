"""The types of FMI in one table: how a value is written, passed to the functions of an FMU, and kept by the loop.

The loop keeps every value in a slot of 8 bytes: real values as doubles, whole numbers, Booleans and enumerations as
64-bit integers, so that each is exact, and texts and binary values as the number under which `Texts` has them. A new
type is one entry of `FMI_TYPES`; the loop (`convert` in loop.c) knows values by class and size, not by type.
"""

from __future__ import annotations

import ctypes
from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np

from cosim.errors import ArgumentError

#: Classes of C types; the code of a C type, which loop.c switches on, is its class and its size in bytes.
_CLASSES = {"f": 0, "i": 16, "u": 32, "b": 32}

#: Code of a type that the loop can't pass by itself: pointers.
_POINTER = 64


def type_code(c_type: Any) -> int:
    """Code of a C type, as loop.c has it."""
    kind = np.dtype(c_type)
    return _CLASSES[kind.kind] + int(kind.itemsize)


class Texts:
    """Texts and binary values of a simulation, each kept once, under a number."""

    def __init__(self) -> None:
        self._values: list[str | bytes] = [""]
        self._numbers: dict[str | bytes, int] = {"": 0}

    def number(self, value: str | bytes) -> int:
        """Number of a value; the first time it is given one."""
        number = self._numbers.setdefault(value, len(self._values))
        if number == len(self._values):
            self._values.append(value)
        return number

    def __getitem__(self, number: int) -> str | bytes:
        return self._values[number]

    @property
    def values(self) -> tuple[str | bytes, ...]:
        """All values, in the order of their numbers."""
        return tuple(self._values)

    def take_over(self, values: Sequence[str | bytes]) -> None:
        """Give values the numbers that another simulation gave them; those that they had here are void then."""
        if tuple(values) != self.values[: len(values)]:
            self._values = list(values)
            self._numbers = {value: number for number, value in enumerate(values)}


@dataclass(frozen=True, eq=False)
class FmiType:
    """A type of FMI.

    Attributes
    ----------
    name : str
        As model descriptions write it.
    kind : str
        real, integer, boolean, enumeration, string, binary or clock.
    functions : mapping
        Version of FMI -> name of the type in its functions (`fmi2GetReal`) and C type of one value.
    smallest, largest : number or None
        Bounds of the values, None where there are none.
    """

    name: str
    kind: str
    functions: Mapping[int, tuple[str, Any]]
    smallest: float | None = None
    largest: float | None = None

    @cached_property
    def is_text(self) -> bool:
        """Whether its values stand in `Texts`."""
        return self.kind in ("string", "binary")

    @cached_property
    def slot(self) -> np.dtype[Any]:
        """NumPy type of a value in the loop."""
        if self.kind == "real":
            return np.dtype(np.float64)
        return np.dtype(np.uint64 if self.name == "UInt64" else np.int64)

    @cached_property
    def recorded(self) -> np.dtype[Any]:
        """NumPy type of a value in results."""
        if self.is_text:
            return np.dtype(object)
        return np.dtype(np.bool_) if self.kind in ("boolean", "clock") else self.slot

    @property
    def column(self) -> str:
        """Arrow's name of the type of a column of values."""
        texts = {"string": "string", "binary": "binary"}
        return texts.get(self.kind) or {"bool": "bool", "float64": "double"}.get(self.recorded.name, self.recorded.name)

    @cache  # noqa: B019 -- the types live as long as the process
    def code(self, version: int) -> int:
        """Code of the C type that the functions of a version of FMI take, for loop.c."""
        return _POINTER if self.is_text else type_code(self.functions[version][1])

    @cache  # noqa: B019
    def stands_in_slots(self, version: int) -> bool:
        """Whether the functions of a version of FMI take the slots as they are."""
        return not self.is_text and np.dtype(self.functions[version][1]) == self.slot

    def value(self, value: Any) -> Any:
        """A value of this type, in Python's own: float, int, bool, str or bytes; exactly what was given.

        Raises
        ------
        ArgumentError
            It is none.
        """
        if isinstance(value, np.generic):
            value = value.item()
        wrong = ArgumentError(f"{value!r} is not a value of type {self.name}")
        if self.is_text:
            if not isinstance(value, str if self.kind == "string" else (bytes, bytearray, memoryview)):
                raise wrong
            if isinstance(value, str) and not _can_be_passed(value):
                raise ArgumentError(f"{value!r} has a character that no FMU can take: NUL or a lone surrogate")
            return value if isinstance(value, str) else bytes(value)
        if not isinstance(value, (int, float)) or (self.kind == "real" and isinstance(value, bool)):
            raise wrong
        if self.kind != "real" and isinstance(value, float) and not value.is_integer():
            raise wrong
        number = float(value) if self.kind == "real" else int(value)
        if self.smallest is not None and self.largest is not None and not self.smallest <= number <= self.largest:
            raise wrong
        return bool(number) if self.kind in ("boolean", "clock") else number

    def rounded(self, number: int) -> float:
        """The real value nearest to a whole number."""
        return float(np.float32(number)) if self.name == "Float32" else float(number)

    def slots(self, values: Iterable[Any], texts: Texts) -> np.ndarray:
        """Slots (n,), as doubles, of values that `value` gave."""
        if isinstance(values, array):
            return np.array(values, dtype=self.slot).view(np.float64)
        numbers = [texts.number(v) for v in values] if self.is_text else list(values)
        return np.array(numbers, dtype=self.slot).view(np.float64)

    def from_slots(self, slots: np.ndarray, texts: Texts) -> np.ndarray:
        """Values in results of slots, an array of doubles of any shape."""
        numbers = np.ascontiguousarray(slots).view(self.slot)
        if not self.is_text:
            return numbers.astype(self.recorded)
        values = np.empty(numbers.size, dtype=object)
        values[:] = [texts[number] for number in numbers.ravel().tolist()]
        return values.reshape(numbers.shape)


def _can_be_passed(text: str) -> bool:
    """Whether a C string, of UTF-8, can hold a text."""
    return "\0" not in text and not any("\ud800" <= c <= "\udfff" for c in text)


def _integers() -> Iterable[FmiType]:
    for sign in ("", "U"):
        for bits in (8, 16, 32, 64):
            name, c_type = f"{sign}Int{bits}", getattr(ctypes, f"c_{sign.lower()}int{bits}")
            smallest, largest = (0, 2**bits - 1) if sign else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
            yield FmiType(name, "integer", {3: (name, c_type)}, smallest, largest)


_INT32 = (-(2**31), 2**31 - 1)

#: Name in model descriptions -> type.
FMI_TYPES: Mapping[str, FmiType] = {
    known.name: known
    for known in (
        FmiType("Real", "real", dict.fromkeys((1, 2), ("Real", ctypes.c_double))),
        FmiType("Float64", "real", {3: ("Float64", ctypes.c_double)}),
        FmiType(
            "Float32",
            "real",
            {3: ("Float32", ctypes.c_float)},
            -float(np.finfo(np.float32).max),
            float(np.finfo(np.float32).max),
        ),
        FmiType("Integer", "integer", dict.fromkeys((1, 2), ("Integer", ctypes.c_int)), *_INT32),
        *_integers(),
        FmiType(
            "Enumeration",
            "enumeration",
            {1: ("Integer", ctypes.c_int), 2: ("Integer", ctypes.c_int), 3: ("Int64", ctypes.c_int64)},
            *_INT32,
        ),
        FmiType(
            "Boolean",
            "boolean",
            {1: ("Boolean", ctypes.c_int8), 2: ("Boolean", ctypes.c_int), 3: ("Boolean", ctypes.c_bool)},
            0,
            1,
        ),
        FmiType("String", "string", dict.fromkeys((1, 2, 3), ("String", ctypes.c_char_p))),
        FmiType("Binary", "binary", {3: ("Binary", ctypes.c_void_p)}),
        FmiType("Clock", "clock", {3: ("Clock", ctypes.c_bool)}, 0, 1),
    )
}

#: Kinds of values that a connection may convert, as far as each value is exact: from -> to.
CONVERSIONS = {
    ("integer", "real"),
    ("boolean", "real"),
    ("boolean", "integer"),
    ("integer", "boolean"),
    ("integer", "enumeration"),
    ("enumeration", "integer"),
}
