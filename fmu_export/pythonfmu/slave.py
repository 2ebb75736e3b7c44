"""What runs inside an FMU of the pythonfmu flavour; copied into the archive, so it needs the standard library only.

pythonfmu's binary calls the methods of this class. It turns an exception into fmi2Fatal and then drops one reference
too many to the instance, its class and its log, after which some hosts crash. So nothing here raises unless those
references are held (`_allowed`). The binary knows no fmi2Error: what the standard calls one is raised, whereas a step
that can't be computed returns False (fmi2Discard) with the reason in the log.
"""

from __future__ import annotations

import ctypes
import json
import sys
import zlib
from collections import namedtuple
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from math import ceil, inf, isfinite, nan
from operator import itemgetter
from pathlib import Path
from typing import Any

from .life_cycle import ANY, OVER, LifeCycle, Phase  # in the archive it lies beside this file

ERROR = 3  # fmi2Error

LogMessage = namedtuple("LogMessage", "status category msg")


class SlaveError(Exception):
    """The reason why a call of the importer fails, as the importer's log shows it."""

    def __repr__(self) -> str:
        return _printf_format(str(self))


def _printf_format(message: str) -> str:
    """Escape a message for FMI's loggers, which take it for a printf format."""
    return message.replace("%", "%%")


def _all_finite(values: list[float]) -> bool:
    """Whether all are; a finite sum says so at once."""
    return isfinite(sum(values)) or all(map(isfinite, values))


def _allowed(phases: Phase) -> Callable[[Any], Any]:
    """Refuse a method in other phases, and let it raise without harm to the host; see the head of this file.

    The binary logs what is raised. It would also flush the queued messages while the exception is still set, which the
    logger of a Python host does not survive, so these go into what is raised.
    """
    each = tuple(phase for phase in Phase if phase in phases)  # a flag takes ten times as long to look into

    def decorate(method: Any) -> Any:
        @wraps(method)
        def guarded(self: Any, *arguments: Any) -> Any:
            try:
                if self._phase not in each:
                    raise SlaveError(self._not_in_this_phase(method.__name__))
                return method(self, *arguments)
            except BaseException as error:  # also Ctrl-C, which a Python host delivers here
                self._phase = Phase.FAILED
                messages = [*(m.msg.replace("%%", "%") for m in self.log_queue), str(error) or type(error).__name__]
                self.log_queue.clear()
                for held in (type(self), self, self.log_queue):
                    ctypes.pythonapi.Py_IncRef(ctypes.py_object(held))
                raise SlaveError("; ".join(dict.fromkeys(messages))) from None

        return guarded

    return decorate


class Fmi2Slave(LifeCycle):
    """A model behind pythonfmu's binary, which looks for a class of just this name among the bases.

    A subclass sets `equations` and `interface`, the two modules generated from the model, and for a solver that chooses
    its internal steps `internal_steps`, the module that does. The values of all variables
    stand in one list, parameters first, then inputs, then outputs; a value reference is a position in it.
    """

    equations: Any
    interface: Any
    internal_steps: Any = None

    def __init__(self, **arguments: Any) -> None:
        super().__init__()
        self.log_queue: list[LogMessage] = []
        resources = arguments["resources"]
        # The binary puts the resources on the host's path at each instantiation; the imports are done, so take it off,
        # once and in one call, for other threads put theirs there at the same time.
        with suppress(ValueError):
            sys.path.remove(resources)
        names = self.interface.NAMES
        self._n_p = self.interface.N_PARAMETERS
        self._n_pu = self._n_p + self.interface.N_INPUTS
        self._values = [nan] * len(names)
        self._x: list[float] = []
        self._outputs_valid = False
        self._tuned = False  # parameters were set since they were checked
        self._arrived = False  # nothing was set since the last step
        self._steps = self.internal_steps.InternalSteps() if self.internal_steps else None
        self._tolerance = 0.0  # of the importer, 0 if it gives none
        self._refusal: str | None = None
        self._getters: dict[tuple[int, ...], tuple[Any, bool]] = {}
        self._setters: dict[tuple[bool, tuple[int, ...]], tuple[slice | None, bool]] = {}
        try:
            self._values[: self._n_pu] = self._read_start_values(Path(resources) / "start_values.txt")
        except Exception as error:  # a raise here would crash the host at a later reset
            self._refusal = f"start values can't be read: {error}"

    def _read_start_values(self, path: Path) -> list[float]:
        with path.open(encoding="utf-8") as lines:
            pairs = dict(line.rstrip("\n").split(" = ", 1) for line in lines)
        starts = [float(pairs[name]) for name in self.interface.NAMES[: self._n_pu]]
        for name, start in zip(self.interface.NAMES, starts, strict=False):
            if not isfinite(start):
                raise SlaveError(f"'{name}' is {start}, not a finite number")
        return starts

    # Logging

    def _log(self, message: str) -> None:
        """Queue an error for the importer's logger."""
        self.log_queue.append(LogMessage(ERROR, "logStatusError", _printf_format(message)))

    def _get_log_queue(self) -> list[LogMessage]:
        return self.log_queue

    # Life cycle

    @_allowed(Phase.INSTANTIATED)
    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """Take the start time, and if there are these the stop time (s) and the relative tolerance."""
        self._check(self._begin_at(start_time, stop_time))
        if self._steps and tolerance is not None:
            if not tolerance > 0.0:
                raise SlaveError(f"the relative tolerance {tolerance!r} is not positive; leave it undefined")
            self._tolerance = min(tolerance, self.interface.LIMITS[-2][1])
        self._outputs_valid = False

    @_allowed(Phase.INSTANTIATED)
    def enter_initialization_mode(self) -> None:
        """Nothing to compute: that is done when it is asked for, or at the end of the initialisation."""
        if self._refusal is not None:
            raise SlaveError(self._refusal)
        self._check(self._begin_initialization())

    @_allowed(Phase.INITIALIZATION)
    def exit_initialization_mode(self) -> None:
        """Check all values and compute the initial state."""
        self._check_parameters()
        self._x = self.equations.initial_state(self._parameters)
        self._check_step(self._time)
        self._phase = Phase.STEP
        self._outputs_valid = False

    @_allowed(Phase.STEP | Phase.DISCARDED)
    def terminate(self) -> None:
        """There is nothing to close."""
        self._phase = Phase.TERMINATED

    @_allowed(Phase.STEP)
    def do_step(self, time: float, h: float) -> bool:
        """Integrate over one communication step (s) with the inputs held; False keeps the state as it was."""
        self._check(self._why_no_step(time, h))
        try:
            self._integrate(time, h)
        except BaseException as error:  # also Ctrl-C, which a Python host delivers here
            self._log(f"step from t = {time!r} s: {str(error) or type(error).__name__}")
            self._phase = Phase.DISCARDED
            return False
        return True

    @staticmethod
    def _check(problem: str) -> None:
        if problem:
            raise SlaveError(problem)

    def _integrate(self, time: float, h: float) -> None:
        self._check_step(time)
        x, u, p = self._x, self._inputs, self._parameters
        if x:
            x = self._stepped(time, h, x, u, p)
            if not _all_finite(x):
                raise SlaveError(
                    "the state is no longer finite; reduce the step, max_step or the inputs, or build a stiff model by "
                    "build_native with another solver"
                )
        self._x, self._time = x, time + h
        self._outputs_valid, self._arrived = False, True

    def _stepped(self, time: float, h: float, x: list[float], u: list[float], p: list[float]) -> list[float]:
        """States after a communication step."""
        n, step = len(x), self.equations.step
        if not self._steps or not p[-2]:
            parts = self._internal_steps(h)
            for i in range(parts):
                x = step(time + i * (h / parts), x, u, p, h / parts)[:n]
            return x

        def checked_defect(at: float, states: list[float], length: float, stages: list[float]) -> list[float]:
            found: list[float] = self.equations.defect(at, states, u, p, length, stages)
            if not all(margin > 0.0 for margin in found[n:]):
                raise self.internal_steps.NoRates
            return found[:n]

        try:
            after: list[float] = self._steps.advance(
                lambda at, states, length: step(at, states, u, p, length),
                checked_defect,
                x,
                (time, h),
                (self._tolerance or p[-2], p[-1]),
                self.interface.NOMINALS,
            )
            return after
        except self.internal_steps.TooManySteps as error:
            raise SlaveError(f"{error}; reduce the step, max_step or the inputs, or set rtol higher") from None

    def _internal_steps(self, h: float) -> int:
        max_step: float = self._values[self._n_p - 1]
        n = h / max_step
        if n > self.interface.MOST_INTERNAL_STEPS:
            raise SlaveError(
                f"communication step {h!r} s needs {n:.4g} internal steps; "
                f"make it shorter, or max_step ({max_step!r} s) longer"
            )
        return max(1, ceil(n - 1e-6))  # a step that is longer by rounding only stays one step

    # Checks

    @property
    def _parameters(self) -> list[float]:
        return self._values[: self._n_p]

    @property
    def _inputs(self) -> list[float]:
        return self._values[self._n_p : self._n_pu]

    def _check_parameters(self) -> None:
        if self._refusal is not None:
            raise SlaveError(self._refusal)
        limits = zip(self.interface.NAMES, self._parameters, self.interface.LIMITS, strict=False)
        for name, value, (lower, upper) in limits:
            if not isfinite(value):
                raise SlaveError(f"parameter '{name}' is {value}; set a finite number")
            if not lower <= value <= upper:
                bounds = f"at least {lower!r}" if upper == inf else f"between {lower!r} and {upper!r}"
                raise SlaveError(f"parameter '{name}' is {value!r}; it must be {bounds}")
        self._require(self.equations.start_margins(self._parameters), self.interface.START_REQUIREMENTS)

    def _check_tuned(self) -> None:
        self._check_parameters()
        self._tuned = False

    def _check_step(self, time: float) -> None:
        if self._tuned:
            self._check_tuned()
        inputs = self._inputs
        if not _all_finite(inputs):
            names = self.interface.NAMES[self._n_p : self._n_pu]
            wrong = ", ".join(f"'{n}' is {v}" for n, v in zip(names, inputs, strict=True) if not isfinite(v))
            raise SlaveError(f"input {wrong}; set a finite number")
        margins = self.equations.step_margins(time, self._x, inputs, self._parameters)
        self._require(margins, self.interface.STEP_REQUIREMENTS)

    @staticmethod
    def _require(margins: list[float], messages: tuple[str, ...]) -> None:
        for margin, message in zip(margins, messages, strict=True):
            if not margin > 0.0:
                raise SlaveError(message)

    # Values

    @_allowed(Phase.INITIALIZATION | Phase.STEP | OVER)
    def get_real(self, references: list[int]) -> list[float]:
        """Values of variables."""
        key = tuple(references)
        if key not in self._getters:
            self._getters[key] = self._getter(key)
        getter, needs_outputs = self._getters[key]
        if needs_outputs and not self._outputs_valid:
            self._compute_outputs()
        return list(getter(self._values))  # the binary reads nothing but a list

    def _getter(self, references: tuple[int, ...]) -> tuple[Any, bool]:
        """What picks values by reference, and whether outputs are among them."""
        self._check_references(references)
        needs_outputs = any(reference >= self._n_pu for reference in references)
        if len(references) == 1:
            return itemgetter(slice(references[0], references[0] + 1)), needs_outputs
        return (itemgetter(*references) if references else lambda _: ()), needs_outputs

    def _check_references(self, references: tuple[int, ...]) -> None:
        for reference in references:
            if not 0 <= reference < len(self._values):
                raise SlaveError(f"no variable has the value reference {reference}")

    def _compute_outputs(self) -> None:
        try:
            if self._phase is Phase.INITIALIZATION:
                self._check_parameters()
                self._x = self.equations.initial_state(self._parameters)
            if self._tuned:
                self._check_tuned()
            if self._arrived:  # else a step that broke a requirement would be noticed by the next one only
                self._check_step(self._time)
            outputs = self.equations.outputs(self._time, self._x, self._inputs, self._parameters)
            if not _all_finite(outputs):
                raise SlaveError("they are not finite; check the inputs")
        except Exception as error:
            raise SlaveError(f"outputs at t = {self._time!r} s: {self._reason(error)}") from error
        self._values[self._n_pu :] = outputs
        self._outputs_valid = True

    def _reason(self, error: Exception) -> str:
        """Why the equations failed: the requirement that does not hold says more than a mathematical error."""
        try:
            self._check_step(self._time)
        except SlaveError as requirement:
            return str(requirement)
        except Exception:
            pass
        return str(error) or type(error).__name__

    @_allowed(Phase.INSTANTIATED | Phase.INITIALIZATION | Phase.STEP)
    def set_real(self, references: list[int], values: list[float]) -> None:
        """Set inputs and parameters, after the initialisation the tunable ones only; where one can't be, none is.

        The values are checked where they are used.
        """
        key = (self._phase is Phase.STEP, tuple(references))
        if key not in self._setters:
            self._setters[key] = self._setter(*key)
        places, tunes = self._setters[key]
        if places is not None and len(values) == len(references):
            self._values[places] = values
        else:
            for reference, value in zip(references, values, strict=True):
                self._values[reference] = value
        self._tuned = self._tuned or tunes
        self._outputs_valid = self._arrived = False

    def _setter(self, running: bool, references: tuple[int, ...]) -> tuple[slice | None, bool]:
        """Where values stand, if that is one after the other, and whether there are parameters, to be checked."""
        settable = range(self._n_p if running else 0, self._n_pu)
        self._check_references(references)
        for reference in references:
            if reference not in settable and reference not in self.interface.TUNABLE:
                raise SlaveError(self._why_not_set(reference))
        first = references[0] if references else 0
        is_in_a_row = references == tuple(range(first, first + len(references)))
        tunes = running and any(reference < self._n_p for reference in references)
        return (slice(first, first + len(references)) if is_in_a_row else None), tunes

    def _why_not_set(self, reference: int) -> str:
        name = self.interface.NAMES[reference]
        if reference >= self._n_pu:
            return f"output '{name}' can't be set"
        return f"parameter '{name}' is fixed after the initialisation; reset the instance to change it"

    @_allowed(Phase.INITIALIZATION | Phase.STEP | OVER)
    def get_integer(self, references: list[int]) -> list[int]:
        """Refuse: all variables are Real."""
        return self._no_such_type(references)

    get_boolean = get_string = get_integer

    @_allowed(Phase.INSTANTIATED | Phase.INITIALIZATION | Phase.STEP)
    def set_integer(self, references: list[int], values: list[Any]) -> None:  # noqa: ARG002
        """Refuse: all variables are Real."""
        self._no_such_type(references)

    set_boolean = set_string = set_integer

    def _no_such_type(self, references: list[int]) -> list[Any]:
        if references:
            raise SlaveError(f"value references {references}: every variable of this FMU is of type Real")
        return []

    # FMU state: everything that changes, so that a restored instance goes on exactly as the saved one would

    @_allowed(ANY)
    def _get_fmu_state(self) -> dict[str, Any]:
        return {
            "fingerprint": self.interface.FINGERPRINT,
            "values": list(self._values),
            "x": list(self._x),
            "time": self._time,
            "phase": self._phase.name,
            "set_up": self._set_up,
            "outputs_valid": self._outputs_valid,
            "tuned": self._tuned,
            "arrived": self._arrived,
            "refusal": self._refusal,
            "tolerance": self._tolerance,
            "steps": dict(vars(self._steps)) if self._steps else {},
        }

    @_allowed(ANY)
    def _set_fmu_state(self, state: dict[str, Any]) -> None:
        if state.get("fingerprint") != self.interface.FINGERPRINT:
            raise SlaveError("the FMU state is damaged or belongs to another FMU")
        self._values = list(state["values"])
        self._x = list(state["x"])
        self._time = state["time"]
        self._phase = Phase[state["phase"]]
        self._set_up = state["set_up"]
        self._outputs_valid = state["outputs_valid"]
        self._tuned = state["tuned"]
        self._arrived = state["arrived"]
        self._refusal = state["refusal"]
        self._tolerance = state["tolerance"]
        if self._steps:
            vars(self._steps).update(state["steps"])

    @staticmethod
    def _fmu_state_to_bytes(state: dict[str, Any]) -> bytes:
        text = json.dumps(state).encode()
        return b"%08x" % zlib.crc32(text) + text

    @staticmethod
    def _fmu_state_from_bytes(data: bytes) -> dict[str, Any]:
        """Read a state; damaged bytes give a state that `_set_fmu_state` refuses, for here a raise can't be guarded."""
        checksum, text = data[:8], data[8:]
        try:
            state = json.loads(text) if checksum == b"%08x" % zlib.crc32(text) else {}
        except (ValueError, RecursionError):
            return {}
        return state if isinstance(state, dict) else {}
