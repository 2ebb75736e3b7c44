"""Refusals of what can't be traced: where the author's code stands, and what it takes."""

from __future__ import annotations

import dis
import sys
import sysconfig
from types import FrameType
from typing import NoReturn

from fmu_export.errors import TraceError

#: Packages whose frames are not the author's.
_OTHERS = (
    *("numpy", "casadi", "scipy", "contextlib", "functools", "fmu_export.trace"),
    *("fmu_export.modelling.model", "fmu_export.modelling.model_class", "fmu_export.modelling.variables"),
    "fmu_export.modelling.tables",
)

#: Where Python's own modules are.
_STANDARD = (sysconfig.get_path("stdlib"), "<frozen")

BRANCH = "an `if`, `and`, `or`, `max`, `min` or loop on values can't be traced; use np.where, np.maximum, np.clip, &, |"
NUMBER = "math.*, float() and int() take no symbols; use np.sin, np.floor, ..."
STORED = (
    "a list or an array of numbers, np.float64(), np.vectorize and compiled code take no symbols; make the array by "
    "np.zeros, np.array or np.stack in this function"
)
MASK = "a Boolean mask is not an index of an array of numbers; write np.array(C)[mask] for C[mask], or np.where"
SHIFT = "<< and >> can't be traced; multiply, or divide and use np.floor"


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


def place_of_function(function: object) -> str:
    """File and line where a function of the author's is defined, if it is one of Python."""
    code = getattr(function, "__code__", None)
    module = getattr(function, "__module__", None) or ""
    return f"{code.co_filename}:{code.co_firstlineno}: " if code and not module.startswith("fmu_export.") else ""


def refuse_number() -> NoReturn:
    """Refuse what needs a number: a function of a number, or an element of an array of numbers."""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None and not _is_authors(frame):
        frame = frame.f_back
    stores = frame is not None and dis.opname[frame.f_code.co_code[frame.f_lasti]].startswith("STORE_")
    refuse(STORED if stores else NUMBER)


def _is_authors(frame: FrameType) -> bool:
    if frame.f_code.co_filename.startswith(_STANDARD) and "site-packages" not in frame.f_code.co_filename:
        return False
    module = frame.f_globals.get("__name__", "")
    return not any(module == other or module.startswith(other + ".") for other in _OTHERS)


refused: list[TraceError] = []


def refuse(text: str) -> NoReturn:
    """Refuse an idiom at the line where it stands; remembered, in case the author's code catches the error."""
    error = TraceError(f"{place()}{text}")
    refused.append(error)
    raise error
