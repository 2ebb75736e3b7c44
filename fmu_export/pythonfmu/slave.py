"""What runs inside an FMU of the pythonfmu flavour; copied into the archive, so it needs the standard library only.

pythonfmu's binary calls the methods of this class. It turns an exception into fmi2Fatal and then drops one reference
too many to the instance, its class and its log, after which some hosts crash. So nothing here raises unless those
references are held (`_guarded`), and a step that fails returns False (fmi2Discard) with the reason in the log.
"""

from __future__ import annotations

import ctypes
import json
import sys
import zlib
from collections import namedtuple
from contextlib import suppress
from functools import wraps
from math import ceil, inf, isfinite, nan
from operator import itemgetter
from pathlib import Path
from typing import Any

ERROR = 3  # fmi2Error

#: More internal steps than this in one communication step is taken for a mistake, not for work to do.
MOST_INTERNAL_STEPS = 1_000_000

LogMessage = namedtuple("LogMessage", "status category msg")


class SlaveError(Exception):
    """The reason why a call of the importer fails, as the importer's log shows it."""

    def __repr__(self) -> str:
        return _printf_format(str(self))


def _printf_format(message: str) -> str:
    """Escape a message for FMI's loggers, which take it for a printf format."""
    return message.replace("%", "%%")


def _guarded(method: Any) -> Any:
    """Let a method raise without harm to the host; see the head of this file.

    The binary logs what is raised. It would also flush the queued messages while the exception is still set, which the
    logger of a Python host does not survive, so these go into what is raised.
    """

    @wraps(method)
    def guarded(self: Any, *arguments: Any) -> Any:
        try:
            return method(self, *arguments)
        except BaseException as error:  # also Ctrl-C, which a Python host delivers here
            messages = [*(m.msg.replace("%%", "%") for m in self.log_queue), str(error) or type(error).__name__]
            self.log_queue.clear()
            for held in (type(self), self, self.log_queue):
                ctypes.pythonapi.Py_IncRef(ctypes.py_object(held))
            raise SlaveError("; ".join(dict.fromkeys(messages))) from None

    return guarded


class Fmi2Slave:
    """A model behind pythonfmu's binary, which looks for a class of just this name among the bases.

    A subclass sets `equations` and `interface`, the two modules generated from the model. The values of all variables
    stand in one list, parameters first, then inputs, then outputs; a value reference is a position in it.
    """

    equations: Any
    interface: Any

    def __init__(self, **arguments: Any) -> None:
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
        self._time = 0.0
        self._initialized = False
        self._outputs_valid = False
        self._tuned = False  # parameters were set since they were checked
        self._refusal: str | None = None
        self._getters: dict[tuple[int, ...], Any] = {}
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

    @_guarded
    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:  # noqa: ARG002
        """Take the start time (s)."""
        if not isfinite(start_time):
            raise SlaveError(f"start time {start_time} is not a finite number")
        self._time = start_time
        self._outputs_valid = False

    @_guarded
    def enter_initialization_mode(self) -> None:
        """Nothing to do: everything is computed when asked for, or at the end of the initialisation."""
        if self._refusal is not None:
            raise SlaveError(self._refusal)

    @_guarded
    def exit_initialization_mode(self) -> None:
        """Check all values and compute the initial state."""
        self._check_parameters()
        self._x = self.equations.initial_state(self._parameters)
        self._check_step(self._time)
        self._initialized = True
        self._outputs_valid = False

    def terminate(self) -> None:
        """Nothing to do: there is nothing to close."""

    def do_step(self, time: float, h: float) -> bool:
        """Integrate over one communication step (s) with the inputs held; False keeps the state as it was."""
        try:
            self._integrate(time, h)
        except BaseException as error:  # also Ctrl-C, which a Python host delivers here
            self._log(f"step from t = {time!r} s: {str(error) or type(error).__name__}")
            return False
        return True

    def _integrate(self, time: float, h: float) -> None:
        if self._refusal is not None:
            raise SlaveError(self._refusal)
        if not self._initialized:
            raise SlaveError("the instance is not initialised; leave the initialisation mode first")
        if not (isfinite(time) and isfinite(h) and h > 0.0):
            raise SlaveError(f"communication step {h!r} s is not a positive finite number")
        self._check_step(time)
        x, u, p = self._x, self._inputs, self._parameters
        n = self._internal_steps(h)
        step = self.equations.step
        if x:
            for i in range(n):
                x = step(time + i * (h / n), x, u, p, h / n)
            if not all(map(isfinite, x)):
                raise SlaveError(
                    "the state is no longer finite; reduce the step, max_step or the inputs, or build a stiff model by "
                    "build_native with another solver"
                )
        self._x, self._time = x, time + h
        self._outputs_valid = False

    def _internal_steps(self, h: float) -> int:
        if not self._x:
            return 1
        max_step: float = self._values[self._n_p - 1]
        n = h / max_step
        if n > MOST_INTERNAL_STEPS:
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
        if not all(map(isfinite, inputs)):
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

    @_guarded
    def get_real(self, references: list[int]) -> list[float]:
        """Values of variables; outputs that can't be computed are NaN, with the reason in the log."""
        if not self._outputs_valid:
            self._compute_outputs()
        key = tuple(references)
        getter = self._getters.get(key)
        if getter is None:
            getter = self._getters[key] = self._getter(key)
        return list(getter(self._values))  # the binary reads nothing but a list

    def _getter(self, references: tuple[int, ...]) -> Any:
        self._check_references(references)
        if len(references) == 1:
            return itemgetter(slice(references[0], references[0] + 1))
        return itemgetter(*references) if references else lambda _: ()

    def _check_references(self, references: tuple[int, ...]) -> None:
        for reference in references:
            if not 0 <= reference < len(self._values):
                raise SlaveError(f"no variable has the value reference {reference}")

    def _compute_outputs(self) -> None:
        try:
            if not self._initialized:
                self._check_parameters()
                self._x = self.equations.initial_state(self._parameters)
            if self._tuned:
                self._check_tuned()
            outputs = self.equations.outputs(self._time, self._x, self._inputs, self._parameters)
        except Exception as error:
            self._log(f"outputs at t = {self._time!r} s: {self._reason(error)}")
            outputs = [nan] * (len(self._values) - self._n_pu)
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

    @_guarded
    def set_real(self, references: list[int], values: list[float]) -> None:
        """Set inputs and parameters, after the initialisation the tunable ones only.

        The values are checked where they are used; a variable that must not be set refuses all later steps.
        """
        settable = range(self._n_p if self._initialized else 0, self._n_pu)
        for reference, value in zip(references, values, strict=True):
            if reference in settable:
                self._values[reference] = value
            elif reference in self.interface.TUNABLE:
                self._values[reference] = value
                self._tuned = True
            else:
                self._check_references((reference,))
                self._refuse_set(reference)
        self._outputs_valid = False

    def _refuse_set(self, reference: int) -> None:
        name = self.interface.NAMES[reference]
        if reference >= self._n_pu:
            self._refusal = f"output '{name}' can't be set"
        else:
            self._refusal = f"parameter '{name}' is fixed after the initialisation; reset the instance to change it"
        self._log(self._refusal)

    @_guarded
    def get_integer(self, references: list[int]) -> list[int]:
        """Refuse: all variables are Real."""
        return self._no_such_type(references)

    get_boolean = get_string = get_integer

    @_guarded
    def set_integer(self, references: list[int], values: list[Any]) -> None:  # noqa: ARG002
        """Refuse: all variables are Real."""
        self._no_such_type(references)

    set_boolean = set_string = set_integer

    def _no_such_type(self, references: list[int]) -> list[Any]:
        if references:
            raise SlaveError(f"value references {references}: every variable of this FMU is of type Real")
        return []

    # FMU state: everything that changes, so that a restored instance goes on exactly as the saved one would

    @_guarded
    def _get_fmu_state(self) -> dict[str, Any]:
        return {
            "fingerprint": self.interface.FINGERPRINT,
            "values": list(self._values),
            "x": list(self._x),
            "time": self._time,
            "initialized": self._initialized,
            "outputs_valid": self._outputs_valid,
            "tuned": self._tuned,
            "refusal": self._refusal,
        }

    @_guarded
    def _set_fmu_state(self, state: dict[str, Any]) -> None:
        if state.get("fingerprint") != self.interface.FINGERPRINT:
            raise SlaveError("the FMU state is damaged or belongs to another FMU")
        self._values = list(state["values"])
        self._x = list(state["x"])
        self._time = state["time"]
        self._initialized = state["initialized"]
        self._outputs_valid = state["outputs_valid"]
        self._tuned = state["tuned"]
        self._refusal = state["refusal"]

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
