"""One instance of an FMU, of FMI 2.0 or 3.0, behind one face; calls go through fmpy.

Values travel in batches: a batch is a fixed list of variables of one FMI type with its value references and its buffer
prepared once, for setting up these costs more than the call itself.
"""

from __future__ import annotations

import ctypes
import itertools
from collections import deque
from collections.abc import Sequence
from contextlib import chdir
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import fmpy.fmi2 as fmi2
import fmpy.fmi3 as fmi3
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription, ModelVariable

#: FMI type -> (name in the C functions, C type), for FMI 2.0 and for FMI 3.0.
_TYPES_2 = {
    "Real": ("Real", ctypes.c_double),
    "Integer": ("Integer", ctypes.c_int),
    "Enumeration": ("Integer", ctypes.c_int),
    "Boolean": ("Boolean", ctypes.c_int),
}
_TYPES_3 = {
    "Float64": ("Float64", ctypes.c_double),
    "Float32": ("Float32", ctypes.c_float),
    "Enumeration": ("Int64", ctypes.c_int64),
    "Boolean": ("Boolean", ctypes.c_bool),
    **{
        f"{sign}Int{bits}": (f"{sign}Int{bits}", getattr(ctypes, f"c_{sign.lower()}int{bits}"))
        for sign in ("", "U")
        for bits in (8, 16, 32, 64)
    },
}

_STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")

#: Log messages kept of one instance; the last ones explain a failure.
_MOST_MESSAGES = 100


#: Instances by the number that their FMUs pass to the logger.
_instances: WeakValueDictionary[int, Instance] = WeakValueDictionary()
_numbers = itertools.count(1)


def _dispatch_fmi2(environment: int | None, name: bytes, status: int, category: bytes, message: bytes) -> None:
    instance = None if environment is None else _instances.get(environment)
    if instance is None:  # an FMU that other code in this process has instantiated through fmpy
        fmi2.printLogMessage(environment, name, status, category, message)
    else:
        instance.keep(status, message)


#: One logger for all FMI 2.0 instances: fmpy's proxy, which formats the printf arguments, knows one per process.
_LOGGER = fmi2.fmi2CallbackLoggerTYPE(_dispatch_fmi2)


class CallFailed(Exception):
    """A call of an FMU returned an error; the text names the function and the status."""


class Batch:
    """Variables of one FMI type that are got or set together, on a part of the values of the whole system.

    `values` is the part of the system's values (float64) that belongs to the batch; the FMU reads and writes it
    directly where its type is a double, and through a buffer of its own type otherwise.
    """

    def __init__(self, instance: Instance, variables: Sequence[ModelVariable], values: np.ndarray) -> None:
        self._instance = instance
        self._values = values
        suffix, ctype = instance.c_type(variables[0].type)
        references = (ctypes.c_uint * len(variables))(*(v.valueReference for v in variables))
        self._buffer = values if ctype is ctypes.c_double else np.empty(len(values), dtype=ctype)
        pointer = (ctype * len(values)).from_buffer(self._buffer)
        fmu, version = instance.fmu, instance.version
        sizes: tuple[int, ...] = (len(values),) if version == 3 else ()
        self._arguments = (references, len(variables), pointer, *sizes)
        self._getter = getattr(fmu, f"fmi{version}Get{suffix}")
        self._setter = getattr(fmu, f"fmi{version}Set{suffix}")

    def get(self) -> None:
        """Read the variables from the FMU."""
        self._instance.call(self._getter, *self._arguments)
        if self._buffer is not self._values:
            self._values[:] = self._buffer

    def set(self) -> None:
        """Write the variables to the FMU."""
        if self._buffer is not self._values:
            self._buffer[:] = self._values
        self._instance.call(self._setter, *self._arguments)


class Instance:
    """An instantiated FMU.

    Parameters
    ----------
    name : str
        Instance name.
    folder : Path
        Folder with the unpacked FMU; must outlive the instance.
    description : ModelDescription
        Its model description.

    Raises
    ------
    CallFailed
        The FMU can't be loaded or refuses to be instantiated.
    """

    def __init__(self, name: str, folder: Path, description: ModelDescription) -> None:
        self.name = name
        self.version = description.fmiMajorVersion
        self._corrupted = False
        self._messages: deque[str] = deque(maxlen=_MOST_MESSAGES)
        arguments = {
            "guid": description.guid,
            "unzipDirectory": str(folder),
            "modelIdentifier": description.coSimulation.modelIdentifier,
            "instanceName": name,
        }
        try:
            with chdir(folder):  # fmpy changes it, and leaves it changed when a library can't be loaded
                self.fmu: Any = self._instantiate(arguments)
        except CallFailed:
            raise
        except Exception as error:  # fmpy raises bare exceptions here
            raise CallFailed(f"can't be loaded: {error}") from error

    def _instantiate(self, arguments: dict[str, Any]) -> Any:
        if self.version == 2:
            slave = fmi2.FMU2Slave(**arguments)
            # the callbacks must live as long as the instance; fmpy keeps them
            callbacks = fmi2.fmi2CallbackFunctions()
            callbacks.logger = _LOGGER
            callbacks.componentEnvironment = number = next(_numbers)
            _instances[number] = self
            callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
            callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
            fmi2.addLoggerProxy(ctypes.byref(callbacks))
            options: dict[str, Any] = {"callbacks": callbacks}
        else:
            slave = fmi3.FMU3Slave(**arguments)
            options = {"logMessage": self._log_fmi3}
        try:
            slave.instantiate(loggingOn=True, **options)
        except Exception as error:
            slave.freeLibrary()
            raise CallFailed(f"can't be instantiated: {self.log() or error}") from error
        return slave

    # Logging

    def _log_fmi3(self, _environment: Any, status: int, _category: bytes, message: bytes) -> None:
        self.keep(status, message)

    def keep(self, status: int, message: bytes | None) -> None:
        """Keep a message of the FMU that is not just information."""
        if status > fmi2.fmi2OK and message:
            self._messages.append(" ".join(message.decode("utf-8", "replace").split()))

    def log(self) -> str:
        """What the FMU has said that was not just information, as one line; the messages are then forgotten."""
        text = "; ".join(dict.fromkeys(self._messages))
        self._messages.clear()
        return text

    # Calls

    def call(self, function: Any, *arguments: Any) -> None:
        """Call a C function of this instance.

        Raises
        ------
        CallFailed
            Its status is worse than a warning.
        """
        try:
            function(self.fmu.component, *arguments)
        except FMICallException as error:
            self._corrupted = error.status == fmi2.fmi2Fatal
            status = _STATUS[error.status] if error.status < len(_STATUS) else error.status
            raise CallFailed(f"{error.function} returned {status}") from error

    def c_type(self, fmi_type: str) -> tuple[str, Any]:
        """Name of a type in the C functions, and the C type."""
        return (_TYPES_2 if self.version == 2 else _TYPES_3)[fmi_type]

    def set_strings(self, variable: ModelVariable, value: str) -> None:
        """Set a string parameter."""
        text = (ctypes.c_char_p * 1)(value.encode())
        reference = (ctypes.c_uint * 1)(variable.valueReference)
        sizes: tuple[int, ...] = (1,) if self.version == 3 else ()
        self.call(getattr(self.fmu, f"fmi{self.version}SetString"), reference, 1, text, *sizes)

    def enter_initialization_mode(self, start_time: float) -> None:
        """Enter the initialisation mode at a start time (s)."""
        fmu = self.fmu
        if self.version == 2:
            self.call(fmu.fmi2SetupExperiment, fmi2.fmi2False, 0.0, start_time, fmi2.fmi2False, 0.0)
            self.call(fmu.fmi2EnterInitializationMode)
        else:
            self.call(fmu.fmi3EnterInitializationMode, False, 0.0, start_time, False, 0.0)

    def exit_initialization_mode(self) -> None:
        """Leave the initialisation mode; the instance is then ready to step."""
        self.call(getattr(self.fmu, f"fmi{self.version}ExitInitializationMode"))

    def do_step(self, time: float, step: float) -> None:
        """Advance from a communication point (s) by one step (s).

        Raises
        ------
        CallFailed
            The FMU fails, wants to end the simulation, or returns before the end of the step.
        """
        if self.version == 2:
            self.call(self.fmu.fmi2DoStep, time, step, fmi2.fmi2True)
            return
        flags = [ctypes.c_bool() for _ in range(3)]  # event encountered, terminate simulation, early return
        last_time = ctypes.c_double()
        self.call(self.fmu.fmi3DoStep, time, step, True, *map(ctypes.byref, flags), ctypes.byref(last_time))
        if flags[1]:
            raise CallFailed("fmi3DoStep asked to end the simulation")
        if flags[2]:
            raise CallFailed(f"fmi3DoStep returned early, at t = {last_time.value!r} s")

    def terminate(self) -> None:
        """Tell the FMU that the run is over."""
        self.call(getattr(self.fmu, f"fmi{self.version}Terminate"))

    def close(self) -> None:
        """Free the instance and unload its library.

        After a fatal error both standards forbid any further call, and some FMUs crash on it: the instance is left.
        """
        if not self._corrupted:
            self.fmu.freeInstance()
