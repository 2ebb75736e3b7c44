"""The library of an isolated FMU: what `cosim.fmi.shared_library.Library` is for one in this process."""

from __future__ import annotations

import ctypes
import sys
import time as clock
import weakref
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from cosim.fmi.instance import CallFailed, CallInterrupted, ProcessEnded, location
from cosim.fmi.isolation.limits import Limits
from cosim.fmi.isolation.process import WorkerProcess
from cosim.fmi.loading import LibraryError, in_standard
from cosim.fmi.messages import Messages
from cosim.fmi.shared_library import PROTOTYPES, Library, library_path
from cosim.loop.channel import FAILED_BEFORE, LOST, TOO_LARGE, GivesUp, Takes, WarnedOf, channel_library, functions
from cosim.loop.team import cores

if TYPE_CHECKING:
    from cosim.fmi.isolation.placement import PlacedProcess

#: After Ctrl-C a call may take so much longer (s).
_LONGEST_AFTER_CTRL_C = 1.0

#: How long (ns) each side looks for the other before it sleeps.
_SPIN = 20_000

#: Which arguments of FMI the functions that make an instance take over a channel.
_MAKING = {
    "fmi1InstantiateSlave": (0, 1, 2, 3),
    "fmi2Instantiate": (0, 1, 2, 3),
    "fmi3InstantiateCoSimulation": (0, 1, 2, 5, 7, 8, 9),
    "fmi3InstantiateModelExchange": (0, 1, 2),
}

#: Which argument of them says where the unpacked FMU is.
_LOCATION = {
    "fmi1InstantiateSlave": 2,
    "fmi2Instantiate": 3,
    "fmi3InstantiateCoSimulation": 2,
    "fmi3InstantiateModelExchange": 2,
}


class IsolatedLibrary(Library):
    """The library of an FMU, loaded in a process of its own.

    Functions take the address of the channel in place of an instance. The process is started at once, and waited for
    when something of it is first needed: those of several FMUs start together.

    Parameters
    ----------
    process : WorkerProcess or PlacedProcess
        The process.
    messages : Messages
        Takes what the FMU says.
    limits : Limits
    stop : callable
        Whether a call that takes long is to end, as after Ctrl-C.
    shares_core : bool
        Whether the process is to compute on the core of the loop; else each looks for the other before it sleeps.
    """

    is_isolated = True

    def __init__(
        self,
        process: WorkerProcess | PlacedProcess,
        *,
        messages: Messages,
        limits: Limits,
        stop: Callable[[], bool],
        shares_core: bool = False,
    ) -> None:
        self._limits, self._stop, self.shares_core = limits, stop, shares_core
        self._stopped_at: float | None = None
        self._began_loading: float | None = None
        self.end: CallFailed | None = None
        self._functions: dict[str, Callable[..., Any]] = {}
        self._process = process
        this = weakref.ref(self)  # what C calls must not keep the library
        self._callbacks = (
            GivesUp(lambda seconds: _of(this)._gives_up(seconds)),
            Takes(lambda status, category, text: messages.take(status, category, text)),
            WarnedOf(lambda number: messages.warned(_doing(functions()[number]))),
        )
        memory = self._process.memory
        self._area = channel_library().channel_area()
        self._address = ctypes.addressof(ctypes.c_char.from_buffer(memory))
        self._remote: int = channel_library().channel_begin(self._address, len(memory), *self._callbacks)
        spin = 0 if shares_core or process.is_elsewhere else _SPIN
        channel_library().channel_spin(self._remote, spin, spin)

    @classmethod
    def starting(
        cls,
        folder: Path,
        version: int,
        identifier: str,
        component: str = "",  # noqa: ARG003
        *,
        messages: Messages,
        limits: Limits = Limits(),  # noqa: B008 (frozen)
        stop: Callable[[], bool] = lambda: False,
        sides: int = 2,
    ) -> Self:
        """See `Library`; the process is one of this machine, where so many (`sides`) compute by turns."""
        process = WorkerProcess(library_path(folder, version, identifier), identifier, limits)
        return cls(process, messages=messages, limits=limits, stop=stop, shares_core=sides > cores())

    def __del__(self) -> None:
        if hasattr(self, "_remote"):
            channel_library().channel_free(self._remote)

    # Functions

    @cached_property
    def _available(self) -> frozenset[str]:
        """Names of the functions that the library has."""
        if channel_library().channel_loaded(self._remote) == LOST:
            assert self.end is not None
            if isinstance(self.end, CallInterrupted):
                raise self.end
            raise LibraryError(f"can't be loaded: {self.end}")
        memory, area = self._process.memory, self._area
        length = int.from_bytes(memory[area : area + 8], sys.byteorder)
        found = memory[area + 8 : area + 8 + (length or len(functions()))]
        if length:
            self._process.wait()
            raise LibraryError(found.decode(errors="replace"))
        return frozenset(name for name, has in zip(functions(), found, strict=True) if has)

    def function(self, name: str) -> Callable[..., Any]:
        """See `Library`; those that make an instance find out when they are called whether they exist."""
        if name in _MAKING:
            return self._making(name)
        if name not in self._functions:
            self._functions[name] = self._stub(name, "isolated")
        return self._functions[name]

    def address(self, name: str) -> int:
        """See `Library`; functions that set values are made together with the next call, and values read ahead."""
        sides = ("deferred", "foreseen", "from_loop", "isolated")
        function = self._stub(name, next(side for side in sides if hasattr(channel_library(), f"{side}_{name}")))
        return ctypes.cast(function, ctypes.c_void_p).value or 0  # type: ignore[arg-type]

    def _stub(self, name: str, side: str) -> Callable[..., Any]:
        if name not in self._available:
            raise LibraryError(f"lacks the function {in_standard(name)}")
        function = getattr(channel_library(), f"{side}_{name}")
        function.argtypes, function.restype = PROTOTYPES[name], ctypes.c_int
        return function  # type: ignore[no-any-return]

    def _making(self, name: str) -> Callable[..., int | None]:
        make = getattr(channel_library(), f"isolated_{name}")

        def made(*arguments: Any) -> int | None:
            if name not in self._available:
                raise LibraryError(f"lacks the function {in_standard(name)}")
            instance: int | None = make(self._remote, *(arguments[i] for i in _MAKING[name]))
            return instance

        return made

    def code(self, name: str) -> int:  # noqa: ARG002
        """See `Library`; no call of the FMU can end this process."""
        return 0

    def has(self, name: str) -> bool:
        """See `Library`."""
        return name in self._available

    # Ends

    def failure(self, function: str, status: int) -> CallFailed | None:
        """The error for a status that is none of the FMU's; None for one that is."""
        if status not in (LOST, FAILED_BEFORE, TOO_LARGE):
            return None
        if self.end is not None:
            return self.end
        if status == TOO_LARGE:
            return CallFailed(f"{in_standard(function)}: its values are more than {len(self._process.memory)} bytes")
        own = ctypes.c_int()
        failed = functions()[channel_library().channel_failed(self._remote, ctypes.byref(own))]
        return CallFailed.of(failed, own.value)

    def _gives_up(self, seconds: float) -> int:
        """Called while a call takes long; whether it is no longer waited for."""
        try:
            self.end = self.end or self._found_end(seconds)
        except BaseException as error:  # Ctrl-C, where nothing else takes it
            self.end = CallInterrupted(f"was interrupted: {type(error).__name__}")
        if self.end is not None:
            self._process.kill()
        return self.end is not None

    def _found_end(self, seconds: float) -> CallFailed | None:
        if (end := self._process.ending()) is not None:
            if end.says_all:
                return ProcessEnded(end.what, was_killed=end.was_killed)
            why = "; it called exit(), which an FMU must not do" if end.has_called_exit else ""
            limit = self._limits.memory
            limited = "" if limit is None else f"; its memory is limited to {limit} bytes"
            ask = "" if end.was_killed else "; ask its supplier"
            return ProcessEnded(f"{end.what} in {self._current}{why}{limited}{ask}", was_killed=end.was_killed)
        longest = self._limits.call_time
        if longest is not None and seconds - self._before_loading(seconds) > longest:
            return ProcessEnded(f"{self._current} took longer than {longest:g} s, and its process was ended")
        if self._limits.lifetime is not None and self._process.age > self._limits.lifetime:
            return ProcessEnded(f"its process was ended after {self._limits.lifetime:g} s, in {self._current}")
        if not self._stop():
            self._stopped_at = None
        elif self._stopped_at is None:
            self._stopped_at = clock.monotonic()
        elif clock.monotonic() - self._stopped_at > _LONGEST_AFTER_CTRL_C:
            return CallInterrupted(f"was interrupted in {self._current}, which did not end")
        return None

    def _before_loading(self, seconds: float) -> float:
        """Seconds of a wait that were not the FMU's: until its process began to load the library."""
        if "_available" in self.__dict__:
            return 0.0
        if self._began_loading is None:
            self._began_loading = seconds if self._process.is_loading() else None
        return seconds if self._began_loading is None else self._began_loading

    @property
    def _current(self) -> str:
        """Name of the function that is being called."""
        self._process.note_call()
        number = channel_library().channel_current(self._remote)
        if number >= 0:
            return in_standard(functions()[number])
        return "the unloading of its library" if "_available" in self.__dict__ else "the loading of its library"

    # The end

    def close(self) -> None:
        """Unload the library, and end its process."""
        if self.end is None and "_available" in self.__dict__ and channel_library().channel_end(self._remote) == 0:
            self._process.wait()
        self.abandon()

    def abandon(self) -> None:
        """End the process as it is."""
        self._process.kill()
        self.end = self.end or ProcessEnded("its process has been ended")


class PlacedLibrary(IsolatedLibrary):
    """The library of an FMU, loaded in a process on another machine, where the FMU has been unpacked."""

    _place: PlacedProcess

    @classmethod
    def on(
        cls,
        process: PlacedProcess,
        folder: Path,  # noqa: ARG003 (the other machine has one of its own)
        version: int,  # noqa: ARG003
        identifier: str,  # noqa: ARG003
        component: str = "",  # noqa: ARG003
        **options: Any,
    ) -> Self:
        """See `Library`; `options` as of `IsolatedLibrary`."""
        library = cls(process, **options)
        library._place = process
        return library

    def _making(self, name: str) -> Callable[..., int | None]:
        make, position = super()._making(name), _LOCATION[name]

        def made(*arguments: Any) -> int | None:
            if name not in self._available:  # waits until the folder is known
                return make(*arguments)
            there = location(int(name[3]), Path(self._place.folder))
            return make(*arguments[:position], there, *arguments[position + 1 :])

        return made


def _of(reference: weakref.ref[IsolatedLibrary]) -> IsolatedLibrary:
    library = reference()
    assert library is not None
    return library


def _doing(function: str) -> str:
    """What a deferred function does, in the words of a warning."""
    return "setting derivatives of inputs" if "Derivatives" in function else "setting inputs"
