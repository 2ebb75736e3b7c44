"""Components in model exchange as the compiled loop sees them; see model_exchange.h."""

from __future__ import annotations

import ctypes
from ctypes import POINTER, c_double, c_int32, c_int64, c_size_t, c_uint32, c_void_p
from enum import IntEnum
from functools import cache

from cosim.loop.binding import Loop, Operation, check_layout, loop_library

#: Functions of FMI 2.0 that the loop calls, in its order.
_FUNCTIONS_2 = (
    *("fmi2SetTime", "fmi2SetContinuousStates", "fmi2GetContinuousStates", "fmi2GetDerivatives"),
    *("fmi2GetNominalsOfContinuousStates", "fmi2GetEventIndicators", "fmi2CompletedIntegratorStep"),
    *("fmi2EnterEventMode", "fmi2NewDiscreteStates", "fmi2EnterContinuousTimeMode"),
)

#: Those with another name in FMI 3.0 than that with another number.
_RENAMED_3 = {
    "fmi3GetDerivatives": "fmi3GetContinuousStateDerivatives",
    "fmi3NewDiscreteStates": "fmi3UpdateDiscreteStates",
}

#: Version of FMI -> names of the functions that the loop calls, in its order.
FUNCTIONS = {
    2: _FUNCTIONS_2,
    3: tuple(_RENAMED_3.get(name, name) for name in (n.replace("fmi2", "fmi3") for n in _FUNCTIONS_2)),
}

#: Methods of integration by name.
METHODS = {"rk4": 0, "dopri5": 1, "cvode": 2}

#: Statuses beyond those of the loop.
ENDLESS_UPDATES, ENDLESS_EVENTS, STEP_TOO_SHORT, STATES_NOT_FINITE, CVODE_FAILED = 120, 121, 122, 123, 124

#: Exchanges in which an operation failed.
IN_STAGE, IN_STAGE_AGAIN, IN_EVENT, AT_POINT = 1, 2, 3, 4


class Mode(IntEnum):
    """Modes of an instance."""

    INITIALIZATION = 0
    EVENT = 1
    CONTINUOUS_TIME = 2


class ContinuousComponent(ctypes.Structure):
    """A component and what is known of it."""

    _fields_ = (
        ("instance", c_void_p),
        ("functions", c_void_p * len(_FUNCTIONS_2)),
        ("codes", c_uint32 * len(_FUNCTIONS_2)),
        ("told", Operation),
        ("next_event", c_double),
        ("version", c_int32),
        ("mode", c_int32),
        ("n_states", c_int32),
        ("n_indicators", c_int32),
        ("first_state", c_int32),
        ("first_indicator", c_int32),
        ("needs_completed_step", c_int32),
        ("is_fed", c_int32),
    )


class DiscreteInputs(ctypes.Structure):
    """Inputs that may be set in event mode only."""

    _fields_ = (
        ("component", POINTER(ContinuousComponent)),
        ("function", c_void_p),
        ("last", c_void_p),
        ("size", c_size_t),
        ("known", c_int32),
        ("padding", c_int32),
    )


class OutsideInputs(ctypes.Structure):
    """Extrapolated inputs from outside of the group."""

    _fields_ = (("operation", POINTER(Operation)), ("targets", POINTER(c_int32)))


class GroupExchange(ctypes.Structure):
    """An exchange among the components of the group alone."""

    _fields_ = (
        ("loop", Loop),
        ("again", POINTER(Operation)),
        ("codes_again", POINTER(c_uint32)),
        ("n_again", c_int64),
        ("inputs", POINTER(OutsideInputs)),
        ("copied", POINTER(c_int32)),
        ("n_values", c_int64),
        ("n_inputs", c_int32),
        ("n_copied", c_int32),
    )


class Group(ctypes.Structure):
    """The components that are integrated together."""

    _fields_ = (
        ("components", POINTER(POINTER(ContinuousComponent))),
        ("stage", GroupExchange),
        ("event", GroupExchange),
        *((name, POINTER(c_double)) for name in ("states", "next", "trial", "rates", "nominals")),
        *((name, POINTER(c_double)) for name in ("indicators", "later", "tried")),
        *((f"cvode_{name}", c_void_p) for name in ("memory", "states", "within", "errors")),
        *((f"cvode_{name}", c_void_p) for name in ("step", "begin", "allow", "stop", "look", "values")),
        *((name, POINTER(c_double)) for name in ("allowed", "values_before")),
        *((name, c_double) for name in ("tolerance", "proposed", "last_error", "last_event", "time", "exchanged_at")),
        ("ended_at", c_double),
        *((name, c_int64) for name in ("n_steps", "n_rejected", "n_events", "first_again", "n_again")),
        *((name, c_int32) for name in ("method", "steps", "n_components", "n_states", "n_indicators")),
        *((name, c_int32) for name in ("exchanges_at_end", "exchanges_at_start", "is_exchanged")),
        *(
            (name, c_int32)
            for name in ("rates_known", "indicators_known", "states_known", "ended_by", "begins", "at_once")
        ),
        *((name, c_int32) for name in ("failed_component", "failed_function", "failed_exchange", "status")),
        ("failed_operation", c_int64),
        ("failed_at", c_double),
    )


@cache
def group_library() -> ctypes.CDLL:
    """The library of the loop, for groups.

    Raises
    ------
    LoopLibraryError
        It is missing, or lays the structs out otherwise.
    """
    library = loop_library()
    structs = (ContinuousComponent, DiscreteInputs, OutsideInputs, GroupExchange, Group)
    check_layout(library.model_exchange_layout, structs)
    return library
