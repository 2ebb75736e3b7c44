"""The shared library of an FMU: prototypes of its functions."""

from __future__ import annotations

import ctypes
import inspect
from types import UnionType
from typing import Any, get_args

import pytest
from fmpy import fmi1, fmi2, fmi3

from cosim.fmi.shared_library import PROTOTYPES

#: FMPy's classes of the interfaces that are called.
_CLASSES = (fmi1.FMU1Slave, fmi2.FMU2Slave, fmi2.FMU2Model, fmi3.FMU3Slave, fmi3.FMU3Model)


def of_fmpy(name: str) -> tuple[Any, ...]:
    """Types of the arguments that FMPy passes to a function."""
    function = next(getattr(one, name) for one in _CLASSES if hasattr(one, name))
    annotations = [p.annotation for own, p in inspect.signature(function).parameters.items() if own != "self"]
    return tuple(get_args(t)[0] if isinstance(t, UnionType) else t for t in annotations)


def passed(c_type: Any) -> Any:
    """A C type as it is passed: texts, pointers and functions are addresses."""
    address = c_type is ctypes.c_char_p or issubclass(c_type, (ctypes._Pointer, ctypes._CFuncPtr))
    return ctypes.c_void_p if address else c_type


@pytest.mark.parametrize("name", sorted(PROTOTYPES))
def test_the_prototype_is_that_of_fmpy(name: str) -> None:
    assert tuple(map(passed, of_fmpy(name))) == PROTOTYPES[name]
