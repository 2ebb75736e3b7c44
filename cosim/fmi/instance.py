"""One instance of an FMU, of FMI 1.0, 2.0 or 3.0, behind one face.

Values are got and set by way of buffers, see `cosim.fmi.variable_buffer`.
"""

from __future__ import annotations

import ctypes
import math
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import fmpy.fmi1 as fmi1
import fmpy.fmi2 as fmi2
import fmpy.fmi3 as fmi3
from fmpy.model_description import ModelDescription

from cosim.errors import CosimError
from cosim.fmi.loading import LibraryError
from cosim.fmi.messages import STATUSES, Messages, keep_callbacks
from cosim.fmi.python_fmus import resources_uri, runs_python
from cosim.fmi.shared_library import Library, Loader
from cosim.fmi.types import Texts
from cosim.loop.binding import Operation, loop_library
from cosim.loop.iterated_step import KeptState

#: C functions about the state of an FMU, for FMI 2.0 and for FMI 3.0.
_STATE_FUNCTIONS = {
    version: {
        "get": f"fmi{version}GetFMU{word}",
        "set": f"fmi{version}SetFMU{word}",
        "free": f"fmi{version}FreeFMU{word}",
        "size": f"fmi{version}SerializedFMU{word}Size",
        "serialise": f"fmi{version}SerializeFMU{word}",
        "read": f"fmi{version}De{serialize}FMU{word}",
    }
    for version, word, serialize in ((2, "state", "Serialize"), (3, "State", "serialize"))
}

#: The attribute of a model description by which states can be kept, in fmpy's words, for FMI 3.0 too.
_CAN_KEEP = "canGetAndSetFMUstate"

#: Functions that FMI 1.0 has under another name.
_NAMES_1 = {
    "fmi1Terminate": "fmi1TerminateSlave",
    "fmi1Reset": "fmi1ResetSlave",
    "fmi1FreeInstance": "fmi1FreeSlaveInstance",
}

#: Statuses of all versions.
_WARNING, _DISCARD, _PENDING = 1, 2, 5

#: Functions that an FMU may fail in for want of a tolerance.
INITIALIZING = (
    *("fmiInitializeSlave", "fmi2SetupExperiment", "fmi2EnterInitializationMode", "fmi2ExitInitializationMode"),
    *("fmi3EnterInitializationMode", "fmi3ExitInitializationMode"),
)

#: Whether a crash of an FMU is an exception of Python.
_CRASHES_RAISE = sys.platform == "win32"

#: fmi2StatusKind
_STEP_STATUS, _LAST_SUCCESSFUL_TIME, _TERMINATED = 0, 2, 3


class CallFailed(CosimError):
    """A call of an FMU returned an error; the text names the function and the status.

    Attributes
    ----------
    status : int
        What it returned, as FMI numbers it; error where it returned none.
    function : str
        Its name, empty where it was not called.
    """

    def __init__(self, message: str, status: int = fmi2.fmi2Error, function: str = "") -> None:
        super().__init__(message)
        self.status, self.function = status, function

    @classmethod
    def of(cls, function: str, status: int) -> CallFailed:
        """The error for a status that a function has returned."""
        function = function.replace("fmi1", "fmi")
        said = STATUSES[status] if 0 <= status < len(STATUSES) else status
        return cls(f"{function} returned {said}", status, function)


class ProcessEnded(CallFailed):
    """The process of an isolated FMU has ended; `was_killed` where that is perhaps not the fault of the FMU."""

    def __init__(self, message: str, *, was_killed: bool = False) -> None:
        super().__init__(message, fmi2.fmi2Fatal)
        self.was_killed = was_killed


class CallInterrupted(CallFailed):
    """Ctrl-C ended a call of an isolated FMU, and its process."""


@dataclass(frozen=True)
class StepStatus:
    """End of a call of a step: the status, whether the FMU ended the simulation, and the time (s) it has reached.

    `gave_up`: it ended the simulation for an error, which it has logged.
    """

    code: int
    has_ended: bool
    reached: float
    returned_early: bool = False
    gave_up: bool = False

    @property
    def is_done(self) -> bool:
        """Whether the step is computed whole."""
        return 0 <= self.code <= _WARNING and not self.has_ended and not self.returned_early

    @property
    def is_discarded(self) -> bool:
        """Whether a part of the step, or all, has not been computed, and may be tried again."""
        return (self.code == _DISCARD or self.returned_early) and not self.gave_up

    @property
    def is_pending(self) -> bool:
        """Whether the FMU is still computing."""
        return self.code == _PENDING


@dataclass(frozen=True)
class ExperimentSetup:
    """Set-up of an experiment for an FMU: start time, stop time if there is one (s), relative tolerance if any."""

    start_time: float
    stop_time: float | None = None
    tolerance: float | None = None


def _arguments_of(experiment: ExperimentSetup) -> tuple[bool, float, float, bool, float]:
    """Arguments of fmi2SetupExperiment and fmi3EnterInitializationMode."""
    tolerance, stop_time = experiment.tolerance, experiment.stop_time
    return (
        *(tolerance is not None, 0.0 if tolerance is None else tolerance),
        experiment.start_time,
        *(stop_time is not None, 0.0 if stop_time is None else stop_time),
    )


def location(version: int, folder: Path) -> bytes:
    """Where an FMU is unpacked, as its function that makes an instance wants it."""
    resources = folder.absolute() / "resources"
    if version == 1:
        return resources.parent.as_uri().encode()
    return (resources_uri(resources) if version == 2 else f"{resources}{os.sep}").encode()


def function_address(function: Any) -> int:
    """Address of a function of a loaded library."""
    return ctypes.cast(function, ctypes.c_void_p).value or 0


class Instance:
    """One instance of an FMU: loaded first, and instantiated by `instantiate`.

    Whoever has many of them loads all before the first is instantiated: then what the FMUs allocate lies together, and
    the loop finds it in the processor's cache.

    Parameters
    ----------
    name : str
        Instance name.
    folder : Path
        Folder with the unpacked FMU; must outlive the instance.
    description : ModelDescription
        Its model description.
    asks_for_inputs : sequence of int
        FMI 3.0: value references of the inputs that are set during a step, when the FMU asks for them.
    texts : Texts, optional
        Texts of the system that the instance is in; its own by default.
    messages : Messages, optional
        Takes what the FMU says; its own by default.
    file : str
        Name of the FMU file, for the last line where the FMU ends the process.
    load : callable
        Loads its library from the folder: into this process by default, see `cosim.fmi.isolation`.

    Raises
    ------
    CallFailed
        The FMU can't be loaded.
    """

    #: Name for the implementation of the component, in messages.
    noun = "FMU"

    #: Whether the importer handles events of the FMU, see `cosim.fmi.event_mode`; by default the FMU does.
    uses_events = False

    #: Whether its steps run Python in this process, where threads take turns.
    runs_python = False

    #: What FMI 2.0 calls the interface that is used.
    fmi2_type = fmi2.fmi2CoSimulation

    def __init__(
        self,
        name: str,
        folder: Path,
        description: ModelDescription,
        asks_for_inputs: Sequence[int] = (),
        texts: Texts | None = None,
        messages: Messages | None = None,
        file: str = "",
        load: Loader = Library.of,
    ) -> None:
        self.name = name
        self.messages = Messages(name) if messages is None else messages
        self.texts = Texts() if texts is None else texts
        self.version = description.fmiMajorVersion
        self._interface = self._interface_of(description)
        self._state_functions = _STATE_FUNCTIONS.get(self.version, {})
        self._byte: Any = fmi2.fmi2Byte if self.version == 2 else fmi3.fmi3Byte
        self._asks_for_inputs = tuple(asks_for_inputs)
        self._operation = ctypes.c_void_p()  # FMI 3.0: what answers when the FMU asks for its inputs
        self._component: int | None = None
        self._kept: list[ctypes.c_void_p] = []  # states in memory, which go with the instance
        self._corrupted = False
        identifier = self._interface.modelIdentifier
        try:
            self._library = load(folder, self.version, identifier, f"component '{name}' ({file or identifier})")
        except LibraryError as error:
            raise CallFailed(str(error)) from error
        self.runs_python = self.uses_events or (not self._library.is_isolated and runs_python(folder))
        prepared = {1: self._prepared_fmi1, 2: self._prepared_fmi2, 3: self._prepared_fmi3}[self.version]
        self._instantiate = prepared(description.instantiationToken.encode(), location(self.version, folder))

    @staticmethod
    def _interface_of(description: ModelDescription) -> Any:
        """What the model description says of the interface that is used."""
        return description.coSimulation

    def instantiate(self) -> None:
        """Make the instance.

        Raises
        ------
        CallFailed
            The FMU refuses.
        """
        try:
            self._component = self._instantiate()
        except LibraryError as error:
            raise CallFailed(str(error)) from error
        if self._component is None:
            if isinstance(self._library.end, CallInterrupted):
                raise self._library.end
            why = self._library.end or self.messages.last() or "it does not say why"
            raise CallFailed(f"can't be instantiated: {why}")
        self._choose_messages()

    def _prepared_fmi1(self, token: bytes, where: bytes) -> Callable[[], int | None]:
        callbacks = self.messages.callbacks_fmi1()
        make = partial(
            self._function("fmi1InstantiateSlave"),
            *(self.name.encode(), token, where, b"application/x-fmu-sharedlibrary", 0.0),
            *(fmi1.fmi1False, fmi1.fmi1False, callbacks, fmi1.fmi1True),  # invisible; alone; says what is wrong
        )
        return lambda: self.messages.of_instance_made_by(make)

    def _prepared_fmi2(self, token: bytes, where: bytes) -> Callable[[], int | None]:
        callbacks = self.messages.callbacks_fmi2()
        keep_callbacks(callbacks)  # FMUs have their address
        return partial(
            self._function("fmi2Instantiate"),
            *(self.name.encode(), self.fmi2_type, token, where, ctypes.byref(callbacks)),
            *(fmi2.fmi2False, fmi2.fmi2True),  # invisible; says what is wrong
        )

    def _prepared_fmi3(self, token: bytes, where: bytes) -> Callable[[], int | None]:
        """The environment is our own, by which the compiled loop finds the inputs to set."""
        callbacks = (
            self.messages.callback_fmi3(),
            function_address(loop_library().intermediate_update) if self._asks_for_inputs else None,
        )
        keep_callbacks(*callbacks, self._operation)
        references = (fmi3.fmi3ValueReference * len(self._asks_for_inputs))(*self._asks_for_inputs)
        return partial(
            self._function("fmi3InstantiateCoSimulation"),
            *(self.name.encode(), token, where),
            *(False, True),  # invisible; says what is wrong
            *(self.uses_events, self.uses_events),  # event mode; early return
            *(references, len(references), ctypes.addressof(self._operation)),
            *callbacks,
        )

    # Messages

    def log(self) -> str:
        """The last message of the FMU that was not just information, as one line; it is then forgotten."""
        return self.messages.last()

    def _choose_messages(self) -> None:
        """Ask the FMU for the categories that are to be logged; it need not know how, and must not fail for that."""
        asked, name = self.messages.asked, f"fmi{self.version}SetDebugLogging"
        if asked is None or not self._library.has(name):
            return
        names = (ctypes.c_char_p * len(asked))(*(category.encode() for category in asked)) if asked else None
        arguments = (fmi1.fmi1True,) if self.version == 1 else (True, len(asked), names)
        try:
            self.call(name, *arguments)
        except CallFailed as error:
            if self._corrupted:
                raise
            self.messages.take(fmi2.fmi2Warning, None, f"{error}; it says what it likes".encode())

    # Calls

    def lacks(self, function: str) -> bool:
        """Whether the library has no such function."""
        return not self._library.has(function)

    @property
    def address(self) -> int:
        """The instance as the FMU's functions take it; 0 before it is made."""
        return self._component or 0

    def function_address(self, name: str) -> int:
        """Address of a C function of the FMU.

        Raises
        ------
        CallFailed
            The FMU lacks it.
        """
        try:
            return self._library.address(name)
        except LibraryError as error:
            raise CallFailed(f"of component '{self.name}' {error}") from error

    def code_of_call(self, function: str) -> int:
        """Code of a call of a function, as the loop notes it."""
        return self._library.code(function)

    def call(self, function: str, *arguments: Any) -> None:
        """Call a C function of this instance.

        Raises
        ------
        CallFailed
            The FMU lacks it, or its status is worse than a warning.
        """
        function = _NAMES_1.get(function, function)
        status = self._function(function)(self._component, *arguments)
        if status == fmi2.fmi2Warning:
            self.messages.warned(function.replace("fmi1", "fmi"))
        elif status != fmi2.fmi2OK:
            raise self.failure(function, status)

    def _function(self, name: str) -> Callable[..., Any]:
        try:
            function = self._library.function(name)
        except LibraryError as error:
            raise CallFailed(str(error)) from error
        return partial(self._unless_it_crashes, function, name) if _CRASHES_RAISE else function

    def _unless_it_crashes(self, function: Callable[..., Any], name: str, *arguments: Any) -> Any:
        try:
            return function(*arguments)
        except OSError as error:
            raise self.crashed(name, error) from error

    def crashed(self, function: str, error: OSError) -> CallFailed:
        """The error for a crash in a function, where one is an exception; the instance is then left alone."""
        self._corrupted = True
        name = function.replace("fmi1", "fmi")
        text = f"crashed in {name} ({error}); the fault is in the FMU, ask its supplier"
        return CallFailed(text, fmi2.fmi2Fatal, function)

    def failure(self, function: str, status: int) -> CallFailed:
        """The error for a status that a function has returned; after a fatal one the instance is left alone."""
        error = self._library.failure(function, status) or CallFailed.of(function, status)
        self._corrupted = self._corrupted or error.status == fmi2.fmi2Fatal
        return error

    @property
    def is_isolated(self) -> bool:
        """Whether the FMU lives in a process of its own."""
        return self._library.is_isolated

    @property
    def shares_core(self) -> bool:
        """Whether its process is to compute on the core of the loop."""
        return self._library.shares_core

    @property
    def is_unusable(self) -> bool:
        """Whether a fatal error, or the end of its process, forbids any further call."""
        return self._corrupted

    def configure(self, set_values: Callable[[], None]) -> None:
        """FMI 3.0: let structural parameters be set, right after the instantiation or a reset.

        Raises
        ------
        CallFailed
            The FMU can't be configured so.
        """
        self.call("fmi3EnterConfigurationMode")
        set_values()
        self.call("fmi3ExitConfigurationMode")

    def set_up(self, experiment: ExperimentSetup) -> None:
        """Tell an FMU of FMI 2.0 of the run, before start values are set: some forget them here."""
        if self.version == 2:
            self.call("fmi2SetupExperiment", *_arguments_of(experiment))

    def enter_initialization_mode(self, experiment: ExperimentSetup) -> None:
        """Enter the initialisation mode of a run; FMI 1.0 has none, see `initialize`."""
        if self.version == 2:
            self.call("fmi2EnterInitializationMode")
        elif self.version == 3:
            self.call("fmi3EnterInitializationMode", *_arguments_of(experiment))

    def initialize(self, experiment: ExperimentSetup) -> None:
        """FMI 1.0: initialise for a run, after inputs have been set and before outputs are read."""
        stop_time = experiment.stop_time
        has_end = fmi1.fmi1False if stop_time is None else fmi1.fmi1True
        self.call("fmi1InitializeSlave", experiment.start_time, has_end, stop_time or 0.0)

    def exit_initialization_mode(self) -> None:
        """Leave the initialisation mode; the instance is then ready to step."""
        if self.version != 1:
            self.call(f"fmi{self.version}ExitInitializationMode")

    def let_ask_for_inputs(self, operation: Operation) -> None:
        """FMI 3.0: let an operation of the loop (which must outlive the steps) answer when the FMU asks for inputs."""
        self._operation.value = ctypes.addressof(operation)

    def save_state(self) -> bytes:
        """The state of the FMU, serialised.

        Raises
        ------
        CallFailed
            It can't be saved; the text says why.
        """
        self.check_states()
        state, size = ctypes.c_void_p(), ctypes.c_size_t()
        self.call(self._state_functions["get"], ctypes.byref(state))
        try:
            self.call(self._state_functions["size"], state, ctypes.byref(size))
            data = (self._byte * size.value)()
            self.call(self._state_functions["serialise"], state, data, size)
        finally:
            self.call(self._state_functions["free"], ctypes.byref(state))
        return bytes(data)

    def restore_state(self, data: bytes) -> None:
        """Bring the FMU into a state that `save_state` gave, of this instance or another one of the same FMU file.

        Raises
        ------
        CallFailed
            The FMU can't take it.
        """
        self.check_states()
        state, buffer = ctypes.c_void_p(), (self._byte * len(data)).from_buffer_copy(data)
        self.call(self._state_functions["read"], buffer, len(data), ctypes.byref(state))
        try:
            self.call(self._state_functions["set"], state)
        finally:
            self.call(self._state_functions["free"], ctypes.byref(state))

    def kept_state(self) -> KeptState:
        """Room for a state of the FMU in memory, which the loop keeps and goes back to; freed with the instance.

        Raises
        ------
        CallFailed
            It can't be kept.
        """
        check_kept(self._interface)
        get, set_ = self._state_functions["get"], self._state_functions["set"]
        state = ctypes.c_void_p()
        kept = KeptState(
            instance=self.address,
            get=self.function_address(get),
            set=self.function_address(set_),
            state=ctypes.pointer(state),
            code_of_get=self.code_of_call(get),
            code_of_set=self.code_of_call(set_),
        )
        self._kept.append(state)
        return kept

    def keep(self, kept: KeptState) -> None:
        """Keep the state of the FMU in room that `kept_state` gave."""
        self.call(self._state_functions["get"], kept.state)

    def go_back(self, kept: KeptState) -> None:
        """Bring the FMU back to the state that was kept."""
        self.call(self._state_functions["set"], kept.state[0])

    def check_states(self) -> None:
        """Whether the FMU has states that can be saved.

        Raises
        ------
        CallFailed
            It has none.
        """
        for capability in (_CAN_KEEP, "canSerializeFMUstate"):
            if not getattr(self._interface, capability):
                raise CallFailed(f"can't save its state ({capability} is not set in its model description)")

    # Steps

    @property
    def step_function(self) -> str:
        """Name of the function that computes a step."""
        return f"fmi{self.version}DoStep"

    @property
    def takes_any_step(self) -> bool:
        """Whether the length of its communication step may change."""
        return bool(self._interface.canHandleVariableCommunicationStepSize)

    def do_step(self, time: float, step: float) -> StepStatus:
        """Compute a step (s) from a time (s) on."""
        if self.version < 3:
            return self.status_of_step(self._function(self.step_function)(self._component, time, step, True), time)
        event, ended, early = ctypes.c_bool(), ctypes.c_bool(), ctypes.c_bool()
        reached = ctypes.c_double(time)
        told = (ctypes.byref(event), ctypes.byref(ended), ctypes.byref(early), ctypes.byref(reached))
        code = self._function(self.step_function)(self._component, time, step, True, *told)
        if code == _WARNING:
            self.messages.warned(self.step_function)
        return StepStatus(code, ended.value, reached.value, early.value)

    def status_of_step(self, code: int, time: float) -> StepStatus:
        """Result of a step from a time (s) on that returned a status, for FMI 1.0 and 2.0."""
        if code == _WARNING:
            self.messages.warned(self.step_function.replace("fmi1", "fmi"))
        if code != _DISCARD:
            return StepStatus(code, has_ended=False, reached=time)
        has_ended, reached = ctypes.c_int(), ctypes.c_double(time)
        # FMUs that don't say have not ended, and have computed nothing
        if self.version == 2:  # FMI 1.0 does not know this
            self._ask("fmi2GetBooleanStatus", _TERMINATED, has_ended)
        self._ask(f"fmi{self.version}GetRealStatus", _LAST_SUCCESSFUL_TIME, reached)
        ended, wrong = bool(has_ended.value), self.messages.tell_of_failure
        return StepStatus(code, ended and not wrong, reached.value, gave_up=ended and wrong)

    def step_status(self) -> StepStatus:
        """Status of a step that the FMU computes by itself.

        Raises
        ------
        CallFailed
            It does not say.
        """
        code = ctypes.c_int(fmi2.fmi2Error)
        try:
            self.call(f"fmi{self.version}GetStatus", _STEP_STATUS, ctypes.byref(code))
        except CallFailed as error:
            raise CallFailed(f"{self.step_function} returned pending, and then {error}") from error
        return self.status_of_step(code.value, math.nan)

    def cancel_step(self) -> None:
        """Tell the FMU to compute no further."""
        with suppress(CallFailed):
            self.call(f"fmi{self.version}CancelStep")

    def _ask(self, function: str, kind: int, answer: Any) -> None:
        with suppress(CallFailed):
            self.call(function, kind, ctypes.byref(answer))

    def terminate(self) -> None:
        """Tell the FMU that the run is over."""
        if self._library.end is None:
            self.call(f"fmi{self.version}Terminate")

    def reset(self) -> None:
        """Bring the FMU back to where it was after its instantiation.

        Raises
        ------
        CallFailed
            It can't; free it and make a new instance.
        """
        if self._corrupted:
            raise CallFailed("a fatal error has left the instance unusable")
        self._free_kept()
        self.call(f"fmi{self.version}Reset")
        self.log()
        self._choose_messages()

    def close(self) -> None:
        """Free the instance and unload its library.

        After a fatal error both standards forbid any further call, and some FMUs crash on it: the instance is left.
        """
        if self._corrupted:
            self._library.abandon()
            return
        if self._component is not None:
            try:
                self.free()
            except CallFailed as error:
                if not self._corrupted:
                    raise
                self.messages.take(fmi2.fmi2Fatal, None, str(error).encode())
                self._library.abandon()
                return
        self._library.close()

    def free(self) -> None:
        """Free the instance; its library stays loaded."""
        self._free_kept(forget=True)
        name = f"fmi{self.version}FreeInstance"
        self._function(_NAMES_1.get(name, name))(self._component)
        self._component = None
        self._operation.value = None

    def _free_kept(self, *, forget: bool = False) -> None:
        for state in self._kept:
            if state.value is not None:
                with suppress(CallFailed):
                    self.call(self._state_functions["free"], ctypes.byref(state))
                state.value = None
        if forget:
            self._kept.clear()


def check_kept(interface: Any) -> None:
    """Whether an FMU says that its state can be kept in memory and gone back to.

    Raises
    ------
    CallFailed
        It can't.
    """
    if not getattr(interface, _CAN_KEEP, False):
        raise CallFailed(f"can't save its state ({_CAN_KEEP} is not set in its model description)")
