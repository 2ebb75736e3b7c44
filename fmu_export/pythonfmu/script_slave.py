"""What runs a script inside an FMU; copied into the archive, so it needs the standard library only.

Python keeps modules by name and files by path, once for the whole process, where FMUs have equal names and folders that
come and go. So each instance gets a namespace: the modules of its archive under names of its own, imported from its own
folder and dropped with it. Inside, `import helper` finds the archive's helper, whenever it runs and whatever the
process knows by that name; outside, nobody sees it.

pythonfmu's binary turns an exception into fmi2Fatal and then drops one reference too many to the instance, its class
and its log, after which some hosts crash. Here these references are held first.
"""

from __future__ import annotations

import builtins
import ctypes
import importlib
import importlib.util
import itertools
import os
import sys
import threading
import weakref
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import wraps
from importlib.abc import Loader
from importlib.machinery import (
    BYTECODE_SUFFIXES,
    SOURCE_SUFFIXES,
    FileFinder,
    ModuleSpec,
    PathFinder,
    SourceFileLoader,
    SourcelessFileLoader,
)
from opcode import opmap
from types import CodeType, FrameType, ModuleType
from typing import Any

from .life_cycle import ANY, OVER, LifeCycle, Phase  # in the archive it lies beside this file

_IMPORT_NAME = opmap["IMPORT_NAME"]
_STANDARD: frozenset[str] = getattr(sys, "stdlib_module_names", frozenset())

#: Namespaces by the name that they have in `sys.modules`, and how many of them have a module of a name.
_namespaces: dict[str, Namespace] = {}
_bundled: Counter[str] = Counter()
_changing = threading.RLock()
_numbers = itertools.count(1)

#: Libraries that archives share because their content is equal: digest -> namespace.
_libraries: dict[str, Namespace] = {}

#: Compiled modules of archives, which Python can load only once: name -> digest.
_compiled: dict[str, str] = {}

_thread = threading.local()


class ScriptError(Exception):
    """The reason why a call of the importer fails, as the importer's log shows it."""

    def __repr__(self) -> str:
        return _printf_format(str(self))


def _printf_format(message: str) -> str:
    """Escape a message for FMI's loggers, which take it for a printf format."""
    return message.replace("%", "%%")


# Modules


class Namespace:
    """Modules of one folder, as `<name>.<module>` in `sys.modules`.

    Parameters
    ----------
    name : str
        Name that no other module of the process has.
    folder : str
        Where the modules are.
    modules : iterable of str
        Names of the top-level modules and packages in the folder.
    libraries : mapping of str to Namespace
        Modules that belong to other namespaces.
    compiled : iterable of str
        Modules in the folder that the process can load once only, and so under their own names.
    """

    def __init__(
        self,
        name: str,
        folder: str,
        modules: Iterable[str],
        libraries: Mapping[str, Namespace] | None = None,
        compiled: Iterable[str] = (),
    ) -> None:
        self.name = name
        self.folder = folder
        self.compiled = frozenset(compiled)
        self._owners = {**dict.fromkeys(modules, self), **(libraries or {})}
        self._path: tuple[str, ...] = ()
        self._added: list[str] = []
        self._elsewhere: set[str] = set()
        self._shown: dict[str, tuple[ModuleType | None, ModuleType]] = {}
        self._importlib = _Importlib(self)
        self.builtins = {**vars(builtins), "__import__": self._import}
        root = ModuleType(name, "Modules of an FMU.")
        root.__path__ = [folder]
        root.__spec__ = ModuleSpec(name, None, is_package=True)
        with _changing:
            _namespaces[name] = self
            if _Finder not in sys.meta_path:
                sys.meta_path.insert(0, _Finder)
            _bundled.update(self._names())
        sys.modules[name] = root

    def close(self) -> None:
        """Drop the modules, and what Python has kept by their names and their folder."""
        self.hide()
        self.take_paths()
        with _changing:
            _namespaces.pop(self.name, None)
            _bundled.subtract(self._names())
            if len(_namespaces) == len(_libraries) and _Finder in sys.meta_path:  # libraries stay, asleep
                sys.meta_path.remove(_Finder)
        logging = sys.modules.get("logging")
        loggers = logging.Logger.manager.loggerDict if logging is not None else {}
        for kept in (sys.modules, loggers):
            for name in [n for n in list(kept) if n == self.name or n.startswith(f"{self.name}.")]:
                kept.pop(name, None)
        forget_folder(self.folder)

    def _names(self) -> list[str]:
        return [*self._owners, *self.compiled]

    def private(self, name: str) -> str:
        """The name in `sys.modules` of what the modules here call `name`."""
        return f"{self._owners[_root(name)].name}.{name}" if self.has(name) else name

    def has(self, name: str) -> bool:
        """Whether the modules here mean one of the archive by `name`."""
        top = _root(name)
        return top in self._owners or self._is_in_an_added_folder(top)

    def _note_paths(self) -> None:
        """Note folders of the archive that its script has put on `sys.path`."""
        path = tuple(sys.path)
        if path == self._path:  # an import in a step must not take long
            return
        self._path = path
        real = os.path.realpath(self.folder)
        new = [p for p in path if isinstance(p, str) and p not in self._added]
        self._added += [p for p in new if _is_inside(os.path.realpath(p), real)]
        self._elsewhere.clear()

    def take_paths(self) -> None:
        """Take these folders off `sys.path`, so that others do not find what is in them."""
        self._note_paths()
        for entry in self._added:
            with suppress(ValueError):
                sys.path.remove(entry)

    def _is_in_an_added_folder(self, top: str) -> bool:
        self._note_paths()
        if not self._added or top in self._elsewhere or top in self.compiled or top in _STANDARD:
            return False
        if _private_spec(top, self._added) is None:
            self._elsewhere.add(top)
            return False
        with _changing:
            self._owners[top] = self
            _bundled[top] += 1
            sys.modules[self.name].__path__ = [self.folder, *self._added]
        return True

    def _import(
        self,
        name: str,
        globals: Mapping[str, object] | None = None,
        locals: Mapping[str, object] | None = None,
        fromlist: Any = (),
        level: int = 0,
    ) -> ModuleType:
        """Import for an `import` statement in these modules; they have this function as their `__import__`."""
        if level or not self.has(name):
            module = builtins.__import__(name, globals, locals, fromlist, level)
            return self._importlib if module is importlib else module
        private = self.private(name)
        if fromlist:
            return builtins.__import__(private, globals, locals, fromlist, 0)
        importlib.import_module(private)
        if isinstance(fromlist, list):  # from C code (pickle), which then looks up the name in sys.modules
            parts = name.split(".")
            for n in range(1, len(parts) + 1):
                bare = ".".join(parts[:n])
                self.show(bare, sys.modules[self.private(bare)])
        return sys.modules[self.private(name.partition(".")[0])]

    def show(self, name: str, module: ModuleType) -> None:
        """Let a module be seen in `sys.modules` by the name it has here, up to `hide`."""
        with _changing:
            before = sys.modules.get(name)
            if before is not module:
                ours = before is not None and _root(before.__name__) in _namespaces
                self._shown.setdefault(name, (None if ours else before, module))
                sys.modules[name] = module

    def hide(self) -> None:
        """Undo `show`."""
        if not self._shown:
            return
        with _changing:
            for name, (before, module) in self._shown.items():
                if sys.modules.get(name) is module:
                    if before is None:
                        del sys.modules[name]
                    else:
                        sys.modules[name] = before
            self._shown.clear()

    def alias(self, name: str) -> ModuleSpec | None:
        """How to import, by the name that it has here, a module that library code asks for (joblib, importlib ...)."""
        found = importlib.util.find_spec(self.private(name))
        if found is None:
            return None
        spec = ModuleSpec(name, _Alias(self, name), origin=found.origin)
        spec.submodule_search_locations = found.submodule_search_locations
        return spec


class _Importlib(ModuleType):
    """`importlib` as the modules of a namespace see it."""

    def __init__(self, namespace: Namespace) -> None:
        super().__init__("importlib")
        self._namespace = namespace

    def __getattr__(self, name: str) -> Any:
        return getattr(importlib, name)

    def import_module(self, name: str, package: str | None = None) -> ModuleType:
        """Import a module, from the archive where it has one of this name."""
        return importlib.import_module(self._namespace.private(name), package)


class _Alias(Loader):
    """Loader that gives a module of a namespace to who asks for it by its bare name."""

    def __init__(self, namespace: Namespace, name: str) -> None:
        self._namespace = namespace
        self._name = name

    def create_module(self, _spec: ModuleSpec) -> ModuleType:
        """The module as it is in its namespace."""
        module = importlib.import_module(self._namespace.private(self._name))
        self._spec = module.__spec__
        self._namespace.show(self._name, module)
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Undo what importing it again has changed."""
        module.__spec__ = self._spec

    def get_code(self, _name: str) -> Any:
        """The module's code, for who runs it as a program."""
        private = self._namespace.private(self._name)
        return importlib.util.find_spec(private).loader.get_code(private)  # type: ignore[union-attr]


class _SourceLoader(SourceFileLoader):
    def get_code(self, fullname: str) -> CodeType:  # noqa: ARG002
        """The code of the file as it is now: the key of `__pycache__` is path and time, which archives share."""
        return self.source_to_code(self.get_data(self.path), self.path)

    def exec_module(self, module: ModuleType) -> None:
        """Run the module with the builtins of its namespace."""
        _give_builtins(module)
        super().exec_module(module)


class _BytecodeLoader(SourcelessFileLoader):
    def exec_module(self, module: ModuleType) -> None:
        """Run the module with the builtins of its namespace."""
        _give_builtins(module)
        super().exec_module(module)


def _give_builtins(module: ModuleType) -> None:
    """Functions take `__import__` from the builtins of their module, so imports in them find the archive, too."""
    module.__dict__["__builtins__"] = _namespaces[_root(module.__name__)].builtins


class _Finder:
    """What Python asks first for modules while an archive's are loaded."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:  # noqa: ARG004
        """How to import a module, where it is of a namespace."""
        top = _root(name)
        if top in _namespaces:
            return _private_spec(name, path or ())
        if _bundled[top] <= 0:
            return None
        namespace = _asking(top)
        if namespace is None:
            return None
        if top in namespace.compiled:
            return PathFinder.find_spec(name, path or [namespace.folder])
        return namespace.alias(name)


def _private_spec(name: str, path: Iterable[str]) -> ModuleSpec | None:
    places = []
    for folder in path:
        # a new finder each time: those that Python keeps remember what was in a folder of the same path
        finder = FileFinder(folder, (_SourceLoader, SOURCE_SUFFIXES), (_BytecodeLoader, BYTECODE_SUFFIXES))
        spec = finder.find_spec(name)
        if spec is None:
            continue
        if spec.loader is not None:
            return spec
        places += spec.submodule_search_locations or []
    if not places:
        return None
    spec = ModuleSpec(name, None, is_package=True)  # a folder without __init__.py
    spec.submodule_search_locations = places
    return spec


def _asking(top: str) -> Namespace | None:
    """The namespace on whose behalf library code asks for a module by name.

    An import statement of a library means the library's own module, if it is no compiled one. A name that a library got
    as a value means the module of the nearest caller that has one of this name.
    """
    frame: FrameType | None = sys._getframe(2)
    nearest, static = True, False
    while frame is not None:
        module = frame.f_globals.get("__name__")
        root = _root(module) if isinstance(module, str) else ""
        if module != __name__ and root not in ("importlib", "_frozen_importlib", "_frozen_importlib_external"):
            namespace = _namespaces.get(root)
            if namespace is not None and (top in namespace.compiled or (not static and namespace.has(top))):
                return namespace
            if nearest and namespace is None:
                static = frame.f_lasti >= 0 and frame.f_code.co_code[frame.f_lasti] == _IMPORT_NAME
            nearest = False
        frame = frame.f_back
    return None


def _root(name: str) -> str:
    return name.partition(".")[0]


def _is_inside(path: str, folder: str) -> bool:
    """Whether a path is that of a folder or of what is in it."""
    path, folder = path.replace(os.sep, "/"), folder.replace(os.sep, "/").rstrip("/")
    return path == folder or path.startswith(f"{folder}/")


def forget_folder(folder: str) -> None:
    """Let Python forget what it keeps by the paths of files in a folder."""
    cached = getattr(sys.modules.get("linecache"), "cache", {})
    for kept in (sys.path_importer_cache, cached):
        for path in [p for p in list(kept) if isinstance(p, str) and _is_inside(p, folder)]:
            kept.pop(path, None)


def namespace_of(name: str, folder: str, bundle: Mapping[str, Any]) -> Namespace:
    """A new namespace for the modules of an archive.

    Parameters
    ----------
    name : str
        What the namespace's name begins with.
    folder : str
        Folder of the archive's resources.
    bundle : mapping
        `modules`: names of the archive's own modules; `libraries`: name -> digest of what archives of equal content
        share; `compiled`: name -> digest of what holds compiled modules.

    Raises
    ------
    ScriptError
        A compiled module differs from one of the same name that is loaded.
    """
    with _changing:
        libraries = {library: _library(library, digest, folder) for library, digest in bundle["libraries"].items()}
        for module, digest in bundle["compiled"].items():
            loaded = sys.modules.get(module)
            if loaded is None and _bundled[module] <= 0:
                _compiled[module] = digest
            elif _compiled.get(module, digest) != digest:
                raise ScriptError(
                    f"the compiled module '{module}' differs from that of another FMU in this process, and Python "
                    "loads only one of a name; run the FMUs in processes of their own"
                )
            elif loaded is not None and module in _compiled and hasattr(loaded, "__path__"):
                _look_first_in(loaded, f"{folder}/{module}")
        return Namespace(f"{name}_{next(_numbers)}", folder, bundle["modules"], libraries, bundle["compiled"])


def _library(name: str, digest: str, folder: str) -> Namespace:
    """The namespace of a library, which lasts as long as the process; `folder` has a copy of it."""
    found = _libraries.get(digest)
    if found is None:
        found = _libraries[digest] = Namespace(f"{name}_{digest}", folder, (name,))
    else:  # the folder that it came from may be gone, and some of its modules not imported yet
        for package, path in ((found.name, folder), (found.private(name), f"{folder}/{name}")):
            if package in sys.modules:
                _look_first_in(sys.modules[package], path)
    return found


def _look_first_in(package: ModuleType, folder: str) -> None:
    package.__path__ = [folder, *(f for f in package.__path__ if f != folder and os.path.isdir(f))]  # noqa: PTH112


def slave_class_of(script: ModuleType, preferred: str = "") -> type[Any]:
    """The class of a script that is the slave: of the preferred name, or that furthest down from Fmi2Slave.

    Raises
    ------
    ScriptError
        There is none.
    """
    deepest, chosen = 0, None
    for name, value in list(vars(script).items()):
        if isinstance(value, type):
            depth = [c.__name__ for c in value.__mro__].index("Fmi2Slave") if _is_slave(value) else 0
            if depth and name == preferred:
                return value
            if depth > deepest:
                deepest, chosen = depth, value
    if chosen is None:
        raise ScriptError(f"No child class of Fmi2Slave found in module {script.__name__.rpartition('.')[2]}")
    return chosen


def _is_slave(value: type[Any]) -> bool:
    return any(c.__name__ == "Fmi2Slave" for c in value.__mro__)


# The slave


def reason(error: BaseException, namespace: Namespace | None = None) -> str:
    """The last line of a traceback, and which line of the archive it comes from."""
    if isinstance(error, ScriptError):
        return str(error)
    import traceback

    text = " ".join(traceback.format_exception_only(type(error), error)[-1].split())
    if namespace is None:
        return text
    place, trace = "", error.__traceback__
    while trace is not None:
        code = trace.tb_frame.f_code
        if _root(str(trace.tb_frame.f_globals.get("__name__"))) == namespace.name:
            place = f" ({os.path.basename(code.co_filename)}, line {trace.tb_lineno}, in {code.co_name})"  # noqa: PTH119
        trace = trace.tb_next
    return text.replace(f"{namespace.name}.", "") + place


def new_instance() -> None:
    """Note that the instance made next in this thread is a new one, and not made by a reset."""
    _thread.new = True


class _State:
    """A state of an FMU: what the script gives, or the bytes of it.

    `life` is the name of its phase, its time (s), and whether the experiment is set up; empty where that can't be read.
    """

    def __init__(self, slave: Fmi2Slave | None, value: Any, life: tuple[Any, ...]) -> None:
        self.slave = slave
        self.value = value
        self.life = life


def _allowed(phases: Phase) -> Callable[[Any], Any]:
    """Refuse a method in other phases, and let it raise without harm to the host; see the head of this file."""
    each = tuple(phase for phase in Phase if phase in phases)  # a flag takes ten times as long to look into

    def decorate(method: Any) -> Any:
        @wraps(method)
        def guarded(self: Fmi2Slave, *arguments: Any) -> Any:
            try:
                if self._refusal:
                    raise ScriptError(self._refusal)
                if self._phase not in each:
                    raise ScriptError(self._not_in_this_phase(method.__name__))
                value = method(self, *arguments)
            except BaseException as error:  # also Ctrl-C, which a Python host delivers here
                self._phase = Phase.FAILED
                raise self._failure(error) from None
            finally:
                if self._namespace is not None:
                    self._namespace.hide()
            if self._log_queue:
                self._make_log_printable()
            return value

        return guarded

    return decorate


def _getter(name: str) -> Any:
    """A method that calls that of the script's slave; the binary reads no sequences but lists."""

    def method(self: Fmi2Slave, references: list[int]) -> list[Any]:
        return list(getattr(self._slave, name)(references))

    method.__name__ = name
    return _allowed(Phase.INITIALIZATION | Phase.STEP | OVER)(method)


def _setter(name: str) -> Any:
    def method(self: Fmi2Slave, references: list[int], values: list[Any]) -> None:
        getattr(self._slave, name)(references, values)

    method.__name__ = name
    return _allowed(Phase.INSTANTIATED | Phase.INITIALIZATION | Phase.STEP)(method)


class Fmi2Slave(LifeCycle):
    """A script's slave behind pythonfmu's binary, which looks for a class of just this name among the bases.

    A subclass sets `script` (its file without `.py`), `slave` (name of its class) and `bundle` (see `namespace_of`).
    """

    script: str
    slave: str
    bundle: Mapping[str, Any]

    def __init__(self, **arguments: Any) -> None:
        super().__init__()
        new, _thread.new = getattr(_thread, "new", False), False
        folder = arguments["resources"]
        # The binary puts the resources on the host's path at each instantiation; the imports are done, so take it off,
        # once and in one call, for other threads put theirs there at the same time.
        with suppress(ValueError):
            sys.path.remove(folder)
        forget_folder(folder)
        self._refusal = ""
        self._namespace: Namespace | None = None
        self._slave: Any = None
        self._log_queue: list[Any] = []
        try:
            self._namespace = namespace = namespace_of(type(self).__module__, folder, self.bundle)
            weakref.finalize(self, namespace.close).atexit = False
            script = importlib.import_module(f"{namespace.name}.{self.script}")
            self._slave = slave_class_of(script, self.slave)(**arguments)
            queue = self._slave._get_log_queue() if hasattr(self._slave, "_get_log_queue") else []
            self._log_queue = queue if isinstance(queue, list) else []
        except BaseException as error:
            said = reason(error, self._namespace)
            if new:
                raise ScriptError(said) from None
            self._refusal = said  # a raise here would crash the host at a reset
        finally:
            if self._namespace is not None:
                self._namespace.hide()
                self._namespace.take_paths()

    def _failure(self, error: BaseException) -> ScriptError:
        """The error to raise.

        The binary would flush the queued messages while the exception is set, which the logger of a Python host does
        not survive, so these go into what is raised.
        """
        for held in (type(self), self, self._log_queue):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(held))
        said = [str(getattr(message, "msg", message)) for message in self._log_queue]
        self._log_queue.clear()
        return ScriptError("; ".join(dict.fromkeys([*said, reason(error, self._namespace)])))

    def _make_log_printable(self) -> None:
        for i, message in enumerate(self._log_queue):
            text = _printf_format(str(message.msg))
            if text != message.msg:
                if hasattr(message, "_replace"):
                    self._log_queue[i] = message._replace(msg=text)
                else:
                    message.msg = text

    def _get_log_queue(self) -> list[Any]:
        return self._log_queue

    @staticmethod
    def _check(problem: str) -> None:
        if problem:
            raise ScriptError(problem)

    @_allowed(Phase.INSTANTIATED)
    def setup_experiment(self, start_time: float, stop_time: float | None = None, *further: Any) -> None:
        """Start time (s), stop time (s) and tolerance; scripts for older releases of pythonfmu take the first only."""
        from inspect import signature

        self._check(self._begin_at(start_time, stop_time))
        method, arguments = self._slave.setup_experiment, (start_time, stop_time, *further)
        try:
            signature(method).bind(*arguments)
        except TypeError:
            arguments = arguments[:1]
        method(*arguments)

    @_allowed(Phase.INSTANTIATED)
    def enter_initialization_mode(self) -> None:
        """Begin the initialisation."""
        self._check(self._begin_initialization())
        self._slave.enter_initialization_mode()

    @_allowed(Phase.INITIALIZATION)
    def exit_initialization_mode(self) -> None:
        """End the initialisation."""
        self._slave.exit_initialization_mode()
        self._phase = Phase.STEP

    @_allowed(Phase.STEP | Phase.DISCARDED)
    def terminate(self) -> None:
        """End the run."""
        self._phase = Phase.TERMINATED
        self._slave.terminate()

    @_allowed(Phase.STEP)
    def do_step(self, time: float, h: float) -> bool:
        """Advance by one communication step (s); False ends the simulation."""
        self._check(self._why_no_step(time, h))
        done = self._slave.do_step(time, h)
        if done is None:
            raise ScriptError("do_step returned None; it must return True, or False to end the simulation")
        if done:
            self._time = time + h
        else:
            self._phase = Phase.DISCARDED
        return bool(done)

    get_real, get_integer, get_boolean = _getter("get_real"), _getter("get_integer"), _getter("get_boolean")
    get_string = _getter("get_string")
    set_real, set_integer, set_boolean = _setter("set_real"), _setter("set_integer"), _setter("set_boolean")
    set_string = _setter("set_string")

    # State: the binary asks the class for its bytes, so the state knows whose it is

    @_allowed(ANY)
    def _get_fmu_state(self) -> _State:
        return _State(self, self._slave._get_fmu_state(), (self._phase.name or "", self._time, self._set_up))

    @_allowed(ANY)
    def _set_fmu_state(self, state: _State) -> None:
        if not state.life:
            raise ScriptError("the FMU state is damaged, or of no FMU that build_script makes")
        value = self._slave._fmu_state_from_bytes(state.value) if state.slave is None else state.value
        self._slave._set_fmu_state(value)
        phase, self._time, self._set_up = state.life
        self._phase = Phase[phase]

    @_allowed(ANY)
    def _bytes_of(self, value: Any) -> bytes:
        data: bytes = self._slave._fmu_state_to_bytes(value)
        return data

    @staticmethod
    def _fmu_state_to_bytes(state: _State) -> bytes:
        data: bytes = state.value if state.slave is None else state.slave._bytes_of(state.value)
        return b"%s %s %d\n" % (state.life[0].encode(), state.life[1].hex().encode(), state.life[2]) + data

    @staticmethod
    def _fmu_state_from_bytes(data: bytes) -> _State:
        """Read a state; damaged bytes give one that `_set_fmu_state` refuses, for here a raise can't be guarded."""
        head, _, own = data.partition(b"\n")
        life: tuple[Any, ...] = ()
        try:
            phase, time, set_up = head.decode("ascii").split(" ")
            life = (Phase[phase].name or "", float.fromhex(time), set_up == "1")
        except (ValueError, KeyError, OverflowError):
            pass
        return _State(None, own, life)
