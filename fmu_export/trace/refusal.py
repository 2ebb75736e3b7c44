"""Refusals of what can't be traced: where the author's code stands, and what it takes."""

from __future__ import annotations

import sys
from types import FrameType
from typing import NoReturn

from fmu_export.errors import TraceError

#: Packages whose frames are not the author's.
_OTHERS = (
    *("numpy", "casadi", "scipy", "contextlib", "functools", "fmu_export.trace"),
    *("fmu_export.modelling.model", "fmu_export.modelling.model_class", "fmu_export.modelling.variables"),
)

BRANCH = "an `if`, `and`, `or`, `max`, `min` or loop on values can't be traced; use np.where, np.maximum, np.clip, &, |"
NUMBER = "math.*, float() and int() take no symbols; use np.sin, np.floor, ..."
STORED = (
    "a symbol can't be stored in an array of numbers; make the array by np.zeros, np.array or np.stack in this function"
)


def place() -> str:
    """File and line of the author's code that runs now."""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        if _is_authors(frame):
            return f"{frame.f_code.co_filename}:{frame.f_lineno}: "
        frame = frame.f_back
    return ""


def place_of(error: BaseException) -> str:
    """File and line of the author's code that an error comes from."""
    found, step = "", error.__traceback__
    while step is not None:
        if _is_authors(step.tb_frame):
            found = f"{step.tb_frame.f_code.co_filename}:{step.tb_lineno}: "
        step = step.tb_next
    return found


def _is_authors(frame: FrameType) -> bool:
    module = frame.f_globals.get("__name__", "")
    return not any(module == other or module.startswith(other + ".") for other in _OTHERS)


refused: list[TraceError] = []


def refuse(text: str) -> NoReturn:
    """Refuse an idiom at the line where it stands; remembered, in case the author's code catches the error."""
    error = TraceError(f"{place()}{text}")
    refused.append(error)
    raise error
