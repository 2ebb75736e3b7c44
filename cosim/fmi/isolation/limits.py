"""What an isolated FMU may take, and where."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

from cosim.errors import SetupError

_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9}


@dataclass(frozen=True)
class Limits:
    """Limits of isolated FMUs.

    Parameters
    ----------
    call_time : float, optional
        Longest time (s) that a call of an FMU may take, of whichever function; without an end by default.
    memory : int, optional
        Memory (bytes) that an FMU may take besides what its process has when it is loaded; as much as there is by
        default.
    lifetime : float, optional
        Longest time (s) that the process may live.
    output : path, optional
        File to which is added what the FMU prints; it prints where this process does by default.

    Raises
    ------
    SetupError
        One makes no sense.
    """

    call_time: float | None = None
    memory: int | None = None
    lifetime: float | None = None
    output: Path | None = None

    def __post_init__(self) -> None:
        if self.call_time is not None and not (math.isfinite(self.call_time) and self.call_time > 0.0):
            raise SetupError(f"step timeout {self.call_time!r} s must be a positive number of seconds")
        if self.memory is not None and self.memory < 1:
            raise SetupError(f"memory limit {self.memory!r} must be a positive number of bytes")


def parse_bytes(text: str) -> int:
    """A number of bytes, as 500M or 2G.

    Raises
    ------
    SetupError
        It is written otherwise.
    """
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([kmg]?)b?", text.strip().lower())
    if found is None or not float(found[1]):
        raise SetupError(f"'{text}' is not an amount of memory; write bytes, or a number with k, M or G, as 500M")
    return round(float(found[1]) * _UNITS[found[2]])
