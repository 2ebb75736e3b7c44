"""Columns of results whose values are no real numbers: whole numbers, Booleans, texts and binary values, each exact."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TypedColumn:
    """Values of one type.

    Attributes
    ----------
    type : str
        Arrow's name of the type: int64, uint64, bool, string or binary.
    values : array (n,)
        Of that type; str or bytes objects for the last two.
    """

    type: str
    values: np.ndarray

    @property
    def is_text(self) -> bool:
        """Whether the values are texts or binary, which no number stands for."""
        return self.type in ("string", "binary")

    @property
    def numbers(self) -> np.ndarray:
        """The values as real numbers (n,), rounded where they must be; texts are NaN."""
        return np.full(len(self.values), np.nan) if self.is_text else self.values.astype(np.float64)

    def thinned(self, every: int) -> TypedColumn:
        """Every so many-th value."""
        return TypedColumn(self.type, self.values[::every])


def numbers_of(values: np.ndarray, names: Sequence[str], typed: Mapping[str, TypedColumn]) -> np.ndarray:
    """Real numbers (n, len(names)) of values of which some columns are typed."""
    numbers = np.empty(values.shape)
    for i, name in enumerate(names):
        numbers[:, i] = typed[name].numbers if name in typed else values[:, i]
    return numbers
