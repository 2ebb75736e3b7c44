"""CVode of SUNDIALS, as FMPy ships it, for components in model exchange: implicit, for stiff equations.

The compiled loop calls it directly, and it calls the compiled loop for the derivatives: no Python within a step.
"""

from __future__ import annotations

import ctypes
import weakref
from ctypes import c_double, c_int, c_int64, c_void_p
from typing import Any

import numpy as np

from cosim.errors import SetupError
from cosim.loop.model_exchange import Group, group_library

#: Backward differentiation formulas.
_BDF = 2


class CVode:
    """The memory of CVode for a group with states; it is freed with this object.

    Parameters
    ----------
    group : Group
        Its `next` and `trial` are what CVode writes states to.
    next_states, between, allowed : array (n,)
        States at the end of a step and within it, and errors that are allowed.

    Raises
    ------
    SetupError
        SUNDIALS is not there, or can't be set up.
    """

    def __init__(self, group: Group, next_states: np.ndarray, between: np.ndarray, allowed: np.ndarray) -> None:
        try:
            from fmpy.sundials import libraries
        except Exception as error:  # it asserts its version
            raise SetupError(
                f"solver 'cvode': FMPy's SUNDIALS can't be loaded: {error}; use solver 'dopri5'"
            ) from error
        core, own = libraries.sundials_core, libraries.sundials_cvode
        vectors, dense = libraries.sundials_nvecserial, libraries.sundials_sunmatrixdense
        self._context = c_void_p()
        _must(_function(core, "SUNContext_Create", c_int)(c_int(0), ctypes.byref(self._context)))
        n = c_int64(len(next_states))
        make = _function(vectors, "N_VMake_Serial", c_void_p)
        arrays = (next_states, between, allowed)
        states, within, errors = (c_void_p(make(n, c_void_p(a.ctypes.data), self._context)) for a in arrays)
        memory = c_void_p(_function(own, "CVodeCreate", c_void_p)(c_int(_BDF), self._context))
        rates = ctypes.cast(group_library().group_rates, c_void_p)
        _must(_function(own, "CVodeInit", c_int)(memory, rates, c_double(0.0), states))
        _must(_function(own, "CVodeSetUserData", c_int)(memory, c_void_p(ctypes.addressof(group))))
        _must(_function(own, "CVodeSVtolerances", c_int)(memory, c_double(1e-6), errors))
        matrix = c_void_p(_function(dense, "SUNDenseMatrix", c_void_p)(n, n, self._context))
        make_solver = _function(libraries.sundials_sunlinsoldense, "SUNLinSol_Dense", c_void_p)
        solver = c_void_p(make_solver(states, matrix, self._context))
        _must(_function(own, "CVodeSetLinearSolver", c_int)(memory, solver, matrix))
        quiet = _function(core, "SUNContext_ClearErrHandlers", c_int)
        quiet(self._context)  # what went wrong is in the error of the run
        group.cvode_memory, group.cvode_states = memory.value, states.value
        group.cvode_within, group.cvode_errors = within.value, errors.value
        for name, function in (
            ("cvode_step", own.CVode),
            ("cvode_begin", own.CVodeReInit),
            ("cvode_allow", own.CVodeSVtolerances),
            ("cvode_stop", own.CVodeSetStopTime),
            ("cvode_look", own.CVodeGetDky),
            ("cvode_values", core.N_VGetArrayPointer),
        ):
            setattr(group, name, ctypes.cast(function, c_void_p).value)
        parts = (own, core, memory, solver, matrix, (states, within, errors), self._context)
        weakref.finalize(self, _free, *parts)


def _function(library: Any, name: str, result: Any) -> Any:
    """A function of a library by a prototype of its own: that of FMPy wants FMPy's types."""
    address = ctypes.cast(getattr(library, name), c_void_p).value
    assert address is not None
    return ctypes.CFUNCTYPE(result)(address)


def _must(status: int) -> None:
    if status:
        raise SetupError(f"solver 'cvode' can't be set up (status {status}); use solver 'dopri5'")


def _free(own: Any, core: Any, memory: Any, solver: Any, matrix: Any, vectors: tuple[Any, ...], context: Any) -> None:
    _function(own, "CVodeFree", None)(ctypes.byref(memory))
    _function(core, "SUNLinSolFree", c_int)(solver)
    _function(core, "SUNMatDestroy", None)(matrix)
    for vector in vectors:
        _function(core, "N_VDestroy", None)(vector)
    _function(core, "SUNContext_Free", c_int)(ctypes.byref(context))
