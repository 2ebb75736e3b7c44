"""A function in Python behind the face of an instance of an FMU, so that the master couples it as one.

The loop calls it once at a communication point. Its variables are cells in memory, which the loop gets and sets as it
does those of an FMU of FMI 3.0.
"""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from cosim.errors import SetupError
from cosim.fmi.instance import CallFailed, ExperimentSetup, Instance, function_address
from cosim.fmi.messages import Messages
from cosim.fmi.types import FMI_TYPES, Texts
from cosim.loop.binding import Called, Cell, loop_library
from cosim.loop.current_calls import Caller
from cosim.master.interrupts import DeferredInterrupt
from cosim.system.function import FunctionVariable, PythonFunction

_OK, _ERROR = 0, 3

#: Alignment of the variables in memory (bytes).
_ALIGNMENT = 8

#: Kinds of numpy's types that a variable takes.
_TAKES = {"Float64": "fiu", "Int64": "iu", "Boolean": "b"}

#: In place of the length of what is not there.
_ABSENT = -1


class FunctionInstance(Instance):
    """A component that is a function in Python.

    Parameters
    ----------
    name : str
        Name of the component.
    function : PythonFunction

    Attributes
    ----------
    interrupt : DeferredInterrupt
        Of the run; Ctrl-C ends the function at once.
    is_stepped : bool
        What is set by hand at a communication point, or an event there, may make another call necessary.
    """

    noun = "function"
    is_isolated = shares_core = False
    runs_python = True

    def __init__(self, name: str, function: PythonFunction) -> None:  # there is no library to load
        self.name, self.version, self.texts = name, 3, Texts()
        self.function = function
        self.interrupt = DeferredInterrupt()
        self.is_stepped = False
        self.messages = Messages(name)
        self._corrupted = False
        self._call_function = function.function
        self._input_memory, inputs = self._memory(function.inputs)
        self._output_memory, self._outputs = self._memory(function.outputs)
        # numbers as Python's, arrays as copies: what a function keeps must not change behind its back
        self._arguments: list[Callable[[], Any]] = [view.copy if view.shape else view.item for view in inputs]
        self._reals = [
            (v, view) for v, view in zip(function.outputs, self._outputs, strict=True) if v.type == "Float64"
        ]
        self._cells = (Cell * (len(inputs) + len(self._outputs)))(
            *(Cell(view.ctypes.data, view.nbytes) for view in (*inputs, *self._outputs))
        )
        self._called = Called(self._call)
        self._caller = Caller(f"component '{name}' (a function in Python)")
        self._error: BaseException | None = None
        self._run = 0  # number that the object gave it
        self._time: float | None = None  # of the last call
        self._seen = self._before = b""
        self._has_before = False
        self._start_time = 0.0

    def _memory(self, variables: Sequence[FunctionVariable]) -> tuple[np.ndarray, list[np.ndarray]]:
        """Memory (bytes) of variables, and each of them as an array in it."""
        dtypes = [np.dtype(FMI_TYPES[v.type].functions[self.version][1]) for v in variables]
        sizes = [d.itemsize * int(np.prod(v.shape, dtype=int)) for d, v in zip(dtypes, variables, strict=True)]
        places = np.cumsum([0, *(size + -size % _ALIGNMENT for size in sizes)])
        memory = np.zeros(places[-1], np.uint8)
        return memory, [
            memory[place : place + size].view(dtype).reshape(v.shape)
            for place, size, dtype, v in zip(places, sizes, dtypes, variables, strict=False)
        ]

    # The call

    @property
    def call_address(self) -> int:
        """Address of the function that the loop calls at a communication point."""
        return ctypes.cast(self._called, ctypes.c_void_p).value or 0

    def _call(self, time: float) -> int:
        """The callback of the loop; no exception may leave it."""
        try:
            if self.interrupt.requested:  # while an FMU computed
                raise KeyboardInterrupt
            self.interrupt.at_once = True
            try:
                self._evaluate(time)
            finally:
                self.interrupt.at_once = False
        except BaseException as error:
            self._error = error
            return _ERROR
        return _OK

    def _evaluate(self, time: float) -> None:
        inputs = self._input_memory.tobytes()
        if self._run != self.function.begun:
            raise CallFailed("its object has begun another run in between; give each of the two an object of its own")
        if time == self._time:  # an exchange again at the same communication point
            if inputs == self._seen or not self.function.direct_feedthrough:
                return
            self._go_back()
        else:
            self._keep_state(time)
        self._time = None
        self._take(self._call_function(time, *[argument() for argument in self._arguments]))
        self._time, self._seen = time, inputs

    def _keep_state(self, time: float) -> None:
        """Have the state of before a call, where there may be another one at the same communication point."""
        at_start = time == self._start_time and not self.function.can_reset
        self._has_before = self.function.can_save and (self.is_stepped or at_start)
        if self._has_before:
            self._before = self.function.save()

    def _go_back(self) -> None:
        if self.function.owner is None:
            return
        if self._has_before:
            self.function.restore(self._before)
        elif self.function.can_reset and self._time == self._start_time:
            self._run = self.function.begin()
        else:
            raise CallFailed(
                "its inputs have changed since it was called at this communication point; to be called again its "
                "object needs save() and restore()"
            )

    def _take(self, result: Any) -> None:
        """Take over what the function gave."""
        variables = self.function.outputs
        if len(variables) == 1:
            self._take_one(variables[0], self._outputs[0], result)
        elif not variables:
            if result is not None:
                raise CallFailed(f"it gave {_shown(result)}, but has no outputs")
        elif not _has_length(result, len(variables)):
            names = ", ".join(v.name for v in variables)
            raise CallFailed(f"it gave {_shown(result)} in place of {len(variables)} outputs ({names})")
        else:
            for variable, view, value in zip(variables, self._outputs, result, strict=True):
                self._take_one(variable, view, value)
        for variable, view in self._reals:
            if 0 in np.isfinite(view).tobytes():  # all() of so few takes three times as long
                raise CallFailed(f"it gave {_shown(view)} for '{variable.name}', which is not finite")

    def _take_one(self, variable: FunctionVariable, view: np.ndarray, value: Any) -> None:
        array = np.asarray(value)
        if array.shape != view.shape:
            has, needs = _shape(array.shape), _shape(view.shape)
            raise CallFailed(f"it gave {has} for '{variable.name}', which is {needs}")
        if array.dtype.kind not in _TAKES[variable.type] or (array.dtype.kind == "u" and (array > _LARGEST).any()):
            raise CallFailed(f"it gave {_shown(value)} for '{variable.name}', which is of type {variable.type}")
        view[...] = array

    def raised(self) -> BaseException:
        """The exception that ended the last call; it is then forgotten."""
        error, self._error = self._error, None
        assert error is not None
        return error

    # As an FMU

    def instantiate(self) -> None:
        """See `Instance`; nothing is to be done."""

    @property
    def address(self) -> int:
        """The cells, as `cells_get` and `cells_set` take them."""
        return ctypes.addressof(self._cells)

    def code_of_call(self, function: str) -> int:
        """See `Instance`; none of copies from and to its cells."""
        return 0 if function else self._caller.code("its call")

    def function_address(self, name: str) -> int:
        """Address of the C function that gets or sets variables."""
        library = loop_library()
        return function_address(library.cells_get if "Get" in name else library.cells_set)

    def call(self, function: str, *arguments: Any) -> None:
        """Get or set variables; entering and leaving modes asks nothing of a function."""
        if "Get" in function:
            loop_library().cells_get(self.address, *arguments)
        elif "Set" in function:
            loop_library().cells_set(self.address, *arguments)

    def set_up(self, experiment: ExperimentSetup) -> None:
        """Begin a run.

        Raises
        ------
        SetupError
            The object behind the function can't be brought to where it began.
        CallFailed
            It fails in doing so.
        """
        self._start_time, self._time = experiment.start_time, None
        self.is_stepped = False
        self._run = self._asking("reset" if self.function.can_reset else "restore", self.function.begin)

    def save_state(self) -> bytes:
        """See `Instance`."""
        function = self.function
        if function.owner is not None and not function.can_save:
            raise CallFailed(f"can't save its state: a {type(function.owner).__qualname__} has no save() and restore()")
        time = None if self._time is None else struct.pack("<d", self._time)
        before = self._before if self._has_before else None
        now = self._asking("save", function.save)
        memory = (self._input_memory.tobytes(), self._output_memory.tobytes())
        return _joined([time, self._seen, *memory, before, now])

    def restore_state(self, data: bytes) -> None:
        """See `Instance`."""
        time, seen, inputs, outputs, before, now = _parted(data)
        self._time = None if time is None else struct.unpack("<d", time)[0]
        self._seen = seen or b""
        self._input_memory[:] = np.frombuffer(inputs or b"", np.uint8)
        self._output_memory[:] = np.frombuffer(outputs or b"", np.uint8)
        self._has_before, self._before = before is not None, before or b""
        self._asking("restore", lambda: self.function.restore(now or b""))

    def _asking(self, method: str, ask: Callable[[], Any]) -> Any:
        try:
            return ask()
        except SetupError:
            raise
        except Exception as error:
            raise CallFailed(f"failed: {method}() raised {in_one_line(error)}") from error

    def reset(self) -> None:
        """Bring the variables back to where they were; the object behind the function follows in `set_up`."""
        self._input_memory[:] = 0
        self._output_memory[:] = 0

    def terminate(self) -> None:
        """See `Instance`; a function need not know."""

    def close(self) -> None:
        """See `Instance`; nothing is to be freed."""


_LARGEST = np.iinfo(np.int64).max


def in_one_line(error: BaseException) -> str:
    """Type and text of an exception."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _shown(value: Any) -> str:
    text = " ".join(repr(value.tolist() if isinstance(value, np.ndarray) else value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."


def _has_length(result: Any, length: int) -> bool:
    is_array = isinstance(result, np.ndarray) and result.ndim > 0
    return (is_array or isinstance(result, (tuple, list))) and len(result) == length


def _shape(shape: tuple[int, ...]) -> str:
    return f"an array of shape {shape}" if shape else "a single number"


def _joined(parts: Sequence[bytes | None]) -> bytes:
    return b"".join(
        struct.pack("<q", _ABSENT) if part is None else struct.pack("<q", len(part)) + part for part in parts
    )


def _parted(data: bytes) -> list[bytes | None]:
    parts: list[bytes | None] = []
    place = 0
    while place < len(data):
        (length,) = struct.unpack_from("<q", data, place)
        place += 8
        parts.append(None if length == _ABSENT else data[place : place + length])
        place += max(length, 0)
    return parts
