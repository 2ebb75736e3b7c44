"""The components of a system while it is open: FMUs unpacked and instantiated, and brought back for each run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from cosim.errors import SetupError
from cosim.fmi.event_mode import EventInstance
from cosim.fmi.fmu_file import LoadedFMU
from cosim.fmi.instance import CallFailed, CallInterrupted, Instance
from cosim.fmi.interfaces import used_interface
from cosim.fmi.isolation.library import IsolatedLibrary, PlacedLibrary
from cosim.fmi.isolation.limits import Limits
from cosim.fmi.message_log import LogWriter
from cosim.fmi.messages import Messages
from cosim.fmi.model_exchange import ModelExchangeInstance
from cosim.fmi.process_kept import KeptProcess
from cosim.fmi.shared_library import Library, Loader
from cosim.fmi.types import Texts
from cosim.fmi.unpacking import folder_for_fmus
from cosim.loop.current_calls import watched_calls
from cosim.loop.team import Threads
from cosim.master.function_instance import FunctionInstance
from cosim.master.interrupts import DeferredInterrupt
from cosim.system.function import PythonFunction
from cosim.system.variables import Element, Ports, variables_of

if TYPE_CHECKING:
    from cosim.fmi.isolation.placement import Hosts

#: Component -> inputs whose derivatives its FMU is given, or asks for.
Moving = Mapping[str, Sequence[Element]]


@contextmanager
def setting_up(component: str, path: str | PathLike[str] | None = None) -> Iterator[None]:
    """Context in which an error is one of setting up a component, with the path of its FMU.

    Raises
    ------
    SetupError, KeyboardInterrupt
    """
    try:
        yield
    except CallInterrupted as error:
        raise KeyboardInterrupt(str(error)) from error
    except CallFailed as error:
        raise SetupError(f"component '{component}': {path} {error}") from error
    except SetupError as error:
        raise SetupError(f"component '{component}': {error}") from error


class LoadedComponents:
    """FMUs and functions of a system, in this process, in processes of their own, or on other machines.

    Parameters
    ----------
    fmus, functions : mapping
        Component -> its FMU, or its function.
    ports : mapping
        Component -> its variables.
    isolated : frozenset of str
        Components whose FMUs live in processes of their own.
    texts : Texts
    log : LogWriter or None
    messages : mapping
        Component -> what takes the messages of its FMU.
    limits : Limits
        Of isolated FMUs.
    places : mapping
        Component -> worker of a Dask cluster where its FMU lives.
    scheduler : str or None
        Address of the scheduler of the cluster.
    build : bool
        Whether to compile the sources of FMUs without a binary.
    threads : int or "auto"
        Threads that call FMUs.

    Attributes
    ----------
    instances : dict
        Component -> instance, in the order of the system; empty while the components are not open.
    isolated : frozenset of str
    reset : set of str
        Components whose instances were reset before this run; others are new.
    interrupt : DeferredInterrupt or None
        What knows of Ctrl-C while FMUs are called.
    process : KeptProcess
    """

    def __init__(
        self,
        fmus: Mapping[str, LoadedFMU],
        functions: Mapping[str, PythonFunction],
        ports: Mapping[str, Ports],
        isolated: frozenset[str],
        texts: Texts,
        log: LogWriter | None,
        messages: Mapping[str, Messages],
        *,
        limits: Limits,
        places: Mapping[str, str],
        scheduler: str | None,
        build: bool,
        threads: Threads,
    ) -> None:
        self.instances: dict[str, Instance] = {}
        self.isolated = isolated
        self.reset: set[str] = set()
        self.interrupt: DeferredInterrupt | None = None
        self.messages = messages
        self.process = KeptProcess()
        self._fmus = fmus
        self._functions = functions
        self._ports = ports
        self._texts = texts
        self._log = log
        self._limits = limits
        self._places = places
        self._scheduler = scheduler
        self._build = build
        self._threads = threads
        self._hosts: Hosts | None = None
        self._folders: dict[str, Path] = {}
        self._stack: ExitStack | None = None
        self._postponed: list[Callable[[], None]] = []
        self._to_say: list[Callable[[], None]] = []

    @property
    def is_open(self) -> bool:
        """Whether there are instances."""
        return self._stack is not None

    def open(self, moving: Moving) -> None:
        """Unpack each FMU file once and instantiate all components.

        Raises
        ------
        SetupError
            An FMU can't be unpacked or instantiated.
        """
        self._folders.clear()
        with ExitStack() as opened:
            self._reach_hosts(opened)
            with watched_calls(), self.process.while_fmus_are_called(), self._interruptible(), ExitStack() as stack:
                if self._log is not None:
                    self._log.open()
                    stack.callback(self._log.close)
                folders: dict[str, Path] = {}
                for name, fmu in self._fmus.items():
                    if name in self._places:
                        continue
                    # an instance of an FMU that allows one in a process has a library, and global variables, of its own
                    alone = used_interface(fmu.description).canBeInstantiatedOnlyOncePerProcess
                    if alone or fmu.sha256 not in folders:
                        folders[fmu.sha256] = Path(stack.enter_context(folder_for_fmus()))
                        with setting_up(name, fmu.path):
                            fmu.unpack(folders[fmu.sha256], build=self._build)
                    self._folders[name] = folders[fmu.sha256]
                stack.callback(self._free)
                self._make(list(self._ports), moving)
                opened.push(stack.pop_all())
                self._stack = opened.pop_all()

    def postpone(self, end: Callable[[], None], say: Callable[[], None]) -> None:
        """Put off the end of a run to when the instances are freed, or begin another one; then have it `say` more."""
        self._postponed.append(end)
        self._to_say.append(say)

    def _end_runs(self) -> None:
        while self._postponed:
            self._postponed.pop()()

    def _say(self) -> None:
        while self._to_say:
            self._to_say.pop()()

    def close(self) -> None:
        """Free all instances and remove what was unpacked."""
        if self._stack is not None:
            with watched_calls(), self.process.while_fmus_are_called(), self._interruptible():
                self._stack.close()
            self._stack = None

    def renew(self, moving: Moving) -> bool:
        """Bring all instances back to where they were, or make new ones: many FMUs keep more than their reset resets.

        New ones are made once all old ones are gone: then libraries are loaded again, with fresh global variables.

        Returns
        -------
        bool
            All instances are those of before.

        Raises
        ------
        SetupError
            An FMU can't be instantiated again; the components are closed.
        """
        self._end_runs()
        self._say()
        for messages in self.messages.values():
            messages.begin()
        if self._log is not None:
            self._log.heading("the FMUs start afresh")
        self.reset = {name for name in self._ports if self._is_reset(name)}
        anew = [name for name in self._ports if name not in self.reset]
        try:
            for name in reversed(anew):
                self.instances.pop(name).close()
            self._make(anew, moving)
        except SetupError:
            self.close()
            raise
        self.instances = {name: self.instances[name] for name in self._ports}
        return not anew

    def _make(self, names: Sequence[str], moving: Moving) -> None:
        """Load the libraries of components, then instantiate them."""
        for name in names:
            self._load(name, moving.get(name, ()))
        for name in names:
            with self._setting_up(name):
                self.instances[name].instantiate()

    def _load(self, name: str, moving: Sequence[Element]) -> None:
        if name in self._functions:
            self.instances[name] = FunctionInstance(name, self._functions[name])
            return
        fmu, port = self._fmus[name], self._ports[name]
        asks = [v.valueReference for v in variables_of(moving)]
        with self._setting_up(name):
            kind: type[Instance] = EventInstance if port.uses_events else Instance
            if port.is_model_exchange:
                kind = ModelExchangeInstance
            folder, load = self._folders.get(name, Path()), self._loader(name)
            self.instances[name] = kind(
                name, folder, fmu.description, asks, self._texts, self.messages[name], fmu.path.name, load
            )

    def _loader(self, name: str) -> Loader:
        """What loads the library of a component: into this process, one of its own, or one on another machine."""
        if name not in self.isolated:
            return partial(Library.of, own_variables=not self._fmus[name].shares_library)
        messages, limits, stop = self.messages[name], self._limits, self._is_interrupted
        if self._hosts is None or name not in self._places:
            sides = 2 if self._threads != 1 else 1 + len(self.isolated - set(self._places))
            return partial(IsolatedLibrary.starting, messages=messages, limits=limits, stop=stop, sides=sides)
        process = self._hosts.process(self._places[name], self._fmus[name], name, build=self._build, limits=limits)
        return partial(PlacedLibrary.on, process, messages=messages, limits=limits, stop=stop)

    def _is_reset(self, name: str) -> bool:
        """Reset an instance, if that is known to bring it back completely; whether it was."""
        if name in self._fmus and not self._fmus[name].resets_completely:
            return False
        try:
            self.instances[name].reset()
        except CallFailed:
            return False
        return True

    def _free(self) -> None:
        try:
            self._end_runs()
        finally:
            for instance in reversed(self.instances.values()):
                instance.close()
            self._say()
            self.instances.clear()
            self.reset = set()

    def _reach_hosts(self, stack: ExitStack) -> None:
        """Become a client of the cluster where components have their places."""
        if not self._places:
            return
        from cosim.fmi.isolation.placement import Hosts

        self._hosts = Hosts(self._scheduler)
        stack.callback(self._hosts.close)
        for name, place in self._places.items():
            with self._setting_up(name):
                self._hosts.check(place)

    @contextmanager
    def _interruptible(self) -> Iterator[None]:
        """Context in which Ctrl-C ends a call of an isolated FMU that does not return."""
        if not self.isolated:
            yield
            return
        try:
            with DeferredInterrupt() as interrupt:
                self.interrupt = interrupt
                yield
        finally:
            self.interrupt = None
        if interrupt.requested:
            raise KeyboardInterrupt

    def _is_interrupted(self) -> bool:
        return self.interrupt is not None and self.interrupt.requested

    @contextmanager
    def _setting_up(self, name: str) -> Iterator[None]:
        with setting_up(name, self._fmus[name].path if name in self._fmus else None):
            yield
