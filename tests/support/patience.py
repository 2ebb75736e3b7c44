"""How long tests wait for what must come: long on a busy machine, and for ever only on one that hangs."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

#: Seconds for what takes a moment on a quiet machine: it ends tests that hang, and no test asserts it.
PATIENCE = 900.0


def wait_for(condition: Callable[[], T]) -> T:
    """Wait until something has come about, and give it."""
    end = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < end, "nothing has happened"
        time.sleep(0.02)
    return found
