"""What each thread calls of an FMU at this moment, for a last line where the FMU ends the process (current_calls.c).

The calls stand in memory that another process can map. A call costs one number written before it and one after.
"""

from __future__ import annotations

import ctypes
import math
import mmap
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any

from cosim.loop.binding import LoopLibraryError, loop_library

#: Numbers of current_calls.h.
_LAYOUT = {
    "N_CALLS": 256,
    "N_FUNCTIONS": 256,
    "N_COMPONENTS": 4096,
    "FUNCTION_SIZE": 64,
    "COMPONENT_SIZE": 256,
}
_N_FUNCTIONS, _FUNCTION_SIZE, _COMPONENT_SIZE = (_LAYOUT[n] for n in ("N_FUNCTIONS", "FUNCTION_SIZE", "COMPONENT_SIZE"))


class _Call(ctypes.Structure):
    """The call of a thread; see current_calls.h."""

    _fields_ = (
        ("thread", ctypes.c_uint64),
        ("time", ctypes.c_double),
        ("code", ctypes.c_uint32),
        ("padding", ctypes.c_uint32),
    )


class _Calls(ctypes.Structure):
    """All of them; see current_calls.h."""

    _fields_ = (
        ("process", ctypes.c_uint64),
        ("told", ctypes.c_uint64),
        ("finished", ctypes.c_uint64),
        ("calls", _Call * _LAYOUT["N_CALLS"]),
        ("functions", (ctypes.c_char * _FUNCTION_SIZE) * _N_FUNCTIONS),
        ("components", (ctypes.c_char * _COMPONENT_SIZE) * _LAYOUT["N_COMPONENTS"]),
    )


def memory_of_calls() -> mmap.mmap:
    """Memory for the calls of this process, which processes that it forks share."""
    return mmap.mmap(-1, ctypes.sizeof(_Calls))


def has_finished(memory: mmap.mmap) -> None:
    """Tell the process that watches this one that its work is done."""
    _Calls.from_buffer(memory).finished = 1


def is_finished(memory: mmap.mmap) -> bool:
    """Whether the process that has its calls in this memory had done its work."""
    return bool(_Calls.from_buffer(memory).finished)


def is_told(memory: mmap.mmap) -> bool:
    """Whether the process that has its calls in this memory has said why it ends."""
    return bool(_Calls.from_buffer(memory).told)


def calls_in(memory: mmap.mmap) -> bytes:
    """The calls that a process is in which has them in this memory, to compare them later; empty if it is in none."""
    calls = _Calls.from_buffer(memory).calls
    return b"".join(bytes(call) for call in calls if call.code)


def last_line(memory: mmap.mmap, how: str, what: str = "ended the process", *, again: bool = False) -> str:
    """The line for a process that has ended in a call, empty if it has said why itself, or was in none.

    Parameters
    ----------
    memory : mmap
        With its calls.
    how : str
        What else is known of its end.
    what : str
        What the component did, before the name of the function.
    again : bool
        Give it also where the process has said why.
    """
    if again:
        _Calls.from_buffer(memory).told = 0
    text = ctypes.create_string_buffer(1024)
    address = ctypes.c_void_p(ctypes.addressof(_Calls.from_buffer(memory)))
    loop_library().say_how_it_ended(address, what.encode(), how.encode(), text, ctypes.c_size_t(len(text)))
    return text.value.decode(errors="replace")


class _Memory:
    """The calls of this process, and which numbers of functions and components are given away."""

    def __init__(self, calls: _Calls) -> None:
        self.calls = calls
        self._lock = threading.Lock()
        self._functions: dict[str, int] = {}
        self._free = list(range(_LAYOUT["N_COMPONENTS"] - 1, 0, -1))

    def function(self, name: str) -> int:
        """Number of a function; 0, for a call without a name, where there are too many."""
        with self._lock:
            number = self._functions.get(name)
            if number is None:
                number = len(self._functions) + 1
                if number >= _N_FUNCTIONS:
                    return 0
                self.calls.functions[number].value = name.encode()[: _FUNCTION_SIZE - 1]
                self._functions[name] = number
        return number

    def take(self, component: str) -> int:
        """A number for a component; 0, for one without a name, where there are too many."""
        with self._lock:
            if not self._free:
                return 0
            number = self._free.pop()
        self.calls.components[number].value = component.encode(errors="replace")[: _COMPONENT_SIZE - 1]
        return number

    def give_back(self, number: int) -> None:
        """A component that is gone needs its number no more."""
        if number:
            self._free.append(number)


#: Memory that another process watches, where one does; set before the first FMU is loaded.
watched_memory: mmap.mmap | None = None


@cache
def _all() -> _Memory:
    """The calls of this process.

    Raises
    ------
    LoopLibraryError
        The compiled loop is missing, or lays them out otherwise.
    """
    library = loop_library()
    _check_layout(library)
    library.note_calls.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    library.note_calls.restype = ctypes.POINTER(_Calls)
    library.take_place.restype = ctypes.c_int32
    library.watch_calls.argtypes, library.watch_calls.restype = [ctypes.c_bool], ctypes.c_bool
    python_runs = ctypes.cast(ctypes.pythonapi.Py_IsInitialized, ctypes.c_void_p)
    elsewhere = None
    if watched_memory is not None:
        elsewhere = ctypes.addressof(_Calls.from_buffer(watched_memory))
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(watched_memory))  # C looks into it to the very end
    return _Memory(library.note_calls(elsewhere, python_runs).contents)


class _Number(ctypes.Structure):
    _fields_ = (("name", ctypes.c_char_p), ("number", ctypes.c_size_t))


def _check_layout(library: ctypes.CDLL) -> None:
    library.current_calls_layout.restype = ctypes.POINTER(_Number)
    here = {
        **_LAYOUT,
        "sizeof(CurrentCall)": ctypes.sizeof(_Call),
        "sizeof(CurrentCalls)": ctypes.sizeof(_Calls),
        "CurrentCall.time": _Call.time.offset,
        "CurrentCall.code": _Call.code.offset,
        "CurrentCalls.calls": _Calls.calls.offset,
        "CurrentCalls.functions": _Calls.functions.offset,
        "CurrentCalls.components": _Calls.components.offset,
    }
    there: dict[str, int] = {}
    numbers = library.current_calls_layout()
    while (entry := numbers[len(there)]).name:
        there[entry.name.decode()] = entry.number
    if here != there:
        raise LoopLibraryError(f"the compiled loop lays calls out differently from current_calls.py: {there}")


class _Place(threading.local):
    """Where this thread notes its calls.

    Attributes
    ----------
    address : int
        Of its `CurrentCall`.
    code, time : memoryview
        Of one number each.
    """

    def __init__(self) -> None:
        calls = _all().calls
        number = loop_library().take_place()
        call = _Call() if number < 0 else calls.calls[number]
        self.address = ctypes.addressof(call)
        numbers = memoryview(call).cast("B")
        self.time = numbers[_Call.time.offset :][:8].cast("d")
        self.code = numbers[_Call.code.offset :][:4].cast("I")
        self._owner = _Owner(call)


class _Owner:
    """Gives a place back when its thread ends."""

    def __init__(self, call: _Call) -> None:
        self._call = call

    def __del__(self) -> None:
        self._call.code = 0
        self._call.thread = 0


@cache
def _here() -> _Place:
    """The place of whichever thread asks; made late, when it is known where the calls stand."""
    return _Place()


def address_of_call() -> int:
    """Address of the `CurrentCall` of this thread, for the loop."""
    return _here().address


def is_at(time: float | None) -> None:
    """Have the calls of this thread come at a time (s) of a run, or outside of one."""
    _here().time[0] = math.nan if time is None else time


def left_call() -> int:
    """Code of the call that this thread was in when an exception left it, as one of Windows can; it is over now."""
    note = _here().code
    code, note[0] = note[0], 0
    return code


def function_of(code: int) -> str:
    """Name of the function of a code."""
    return str(_all().calls.functions[code % _N_FUNCTIONS].value.decode())


def have_one_component(code: int, other: int) -> bool:
    """Whether two codes are those of calls of one component."""
    return code // _N_FUNCTIONS == other // _N_FUNCTIONS


class Caller:
    """A component whose FMU, or function, is called.

    Parameters
    ----------
    component : str
        What the last line calls it.
    """

    def __init__(self, component: str) -> None:
        number = _all().take(component)
        self._first = number * _N_FUNCTIONS
        weakref.finalize(self, _all().give_back, number)

    def code(self, function: str) -> int:
        """Code of a call of a function, as the loop notes it."""
        return self._first + _all().function(function)

    def noting(self, function: Callable[..., Any], name: str) -> Callable[..., Any]:
        """A function that notes that it is called."""
        code, here = self.code(name), _here()

        def call(*arguments: Any) -> Any:
            note = here.code
            around = note[0]
            note[0] = code
            try:
                return function(*arguments)
            finally:
                note[0] = around

        return call


def codes(numbers: Sequence[int]) -> Any:
    """Codes of calls as the loop takes them."""
    return (ctypes.c_uint32 * max(1, len(numbers)))(*numbers)


@contextmanager
def watched_calls() -> Iterator[None]:
    """Context in which a crash of an FMU leaves a line; signal handlers are then what they were."""
    _all()
    library = loop_library()
    library.watch_calls(True)
    try:
        yield
    finally:
        library.watch_calls(False)
