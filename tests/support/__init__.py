"""Helpers of the tests, and C sources of their FMUs and hosts."""

from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")

#: This folder, and the checkout.
SUPPORT = Path(__file__).resolve().parent
CHECKOUT = SUPPORT.parents[1]


def some(found: Iterable[T]) -> list[T]:
    """What a test loops over, of which there must be something: a loop over nothing asserts nothing."""
    items = list(found)
    assert items, "there is nothing to loop over"
    return items
