"""Native FMUs for tests: an importer of both FMI versions that lets calls fail.

`Host` calls the C functions by ctypes alone and returns their status, so that misuse can be tried too; what the FMU
logs is kept in `messages`.
"""

from __future__ import annotations

import ctypes
import itertools
import zipfile
from collections.abc import Callable, Iterable, Sequence
from ctypes import byref, c_bool, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import fmpy
import pytest
from fmpy import fmi2, fmi3

from fmu_export.native.toolchain import ToolchainError, find_compiler, host_target
from parallel_robot.fmus import default_flavour

FLAVOURS = ("fmi2", "fmi3")

#: The flavour that `cosim run` takes when none is asked for: fmi2 where there is a C compiler, else pythonfmu.
DEFAULT_FLAVOUR = default_flavour(Path("no such folder"))[0]

OK, DISCARD, ERROR = 0, 2, 3

_T = {"i": c_int, "b": c_bool, "d": c_double, "p": c_void_p, "n": c_size_t, "u": c_uint, "s": c_char_p}

#: C function without "fmi2"/"fmi3" -> types of its arguments after the instance.
_ARGUMENTS = {
    "fmi2": {
        "SetupExperiment": "iddid",
        "EnterInitializationMode": "",
        "DoStep": "ddi",
        "GetReal": "pnp",
        "SetReal": "pnp",
        "SetRealInputDerivatives": "pnpp",
        "GetRealOutputDerivatives": "pnpp",
        "GetDirectionalDerivative": "pnpnpp",
        "GetFMUstate": "p",
        "SetFMUstate": "p",
        "FreeFMUstate": "p",
        "SerializedFMUstateSize": "pp",
        "SerializeFMUstate": "ppn",
        "DeSerializeFMUstate": "pnp",
        "NewDiscreteStates": "p",
        "CompletedIntegratorStep": "ipp",
        "GetDerivatives": "pn",
        "GetInteger": "pnp",
        "SetInteger": "pnp",
        "GetBoolean": "pnp",
        "SetBoolean": "pnp",
        "GetString": "pnp",
        "SetString": "pnp",
        "CancelStep": "",
        "GetRealStatus": "ip",
        "GetBooleanStatus": "ip",
        "GetStatus": "ip",
    },
    "fmi3": {
        "EnterInitializationMode": "bddbd",
        "DoStep": "ddbpppp",
        "GetFloat64": "pnpn",
        "SetFloat64": "pnpn",
        "GetDirectionalDerivative": "pnpnpnpn",
        "GetAdjointDerivative": "pnpnpnpn",
        "GetOutputDerivatives": "pnppn",
        "GetFMUState": "p",
        "SetFMUState": "p",
        "FreeFMUState": "p",
        "SerializedFMUStateSize": "pp",
        "SerializeFMUState": "ppn",
        "DeserializeFMUState": "pnp",
        "UpdateDiscreteStates": "pppppp",
        "CompletedIntegratorStep": "bpp",
        "GetContinuousStateDerivatives": "pn",
        "GetInt32": "pnpn",
        "SetInt32": "pnpn",
        "GetInt64": "pnpn",
        "SetInt64": "pnpn",
        "GetBoolean": "pnpn",
        "SetBoolean": "pnpn",
        "GetString": "pnpn",
        "SetString": "pnpn",
        "EnterConfigurationMode": "",
        "EnterStepMode": "",
        "EvaluateDiscreteStates": "",
        "GetNumberOfContinuousStates": "p",
        "GetNumberOfEventIndicators": "p",
    },
}
_COMMON = {
    "ExitInitializationMode": "",
    "Terminate": "",
    "Reset": "",
    "EnterEventMode": "",
    "EnterContinuousTimeMode": "",
    "SetTime": "d",
    "SetContinuousStates": "pn",
    "GetContinuousStates": "pn",
    "GetNominalsOfContinuousStates": "pn",
    "GetEventIndicators": "pn",
}

_hosts: WeakValueDictionary[int, Host] = WeakValueDictionary()
_numbers = itertools.count(1)


def _log_fmi2(environment: int, _name: bytes, status: int, category: bytes, message: bytes) -> None:
    _hosts[environment].keep(status, category, message)


def _log_fmi3(environment: int, status: int, category: bytes, message: bytes) -> None:
    _hosts[environment].keep(status, category, message)


_LOGGER_2 = fmi2.fmi2CallbackLoggerTYPE(_log_fmi2)
_LOGGER_3 = fmi3.fmi3LogMessageCallback(_log_fmi3)


class Refused(Exception):
    """The FMU returned NULL; the text is what it logged."""


def require_compiler() -> None:
    """Skip a test, with the reason, where no C compiler is found."""
    try:
        host_target()
        find_compiler()
    except ToolchainError as error:
        pytest.skip(str(error))


def unpack(fmu: Path, folder: Path) -> Path:
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder)
    return folder


def doubles(values: Iterable[float]) -> Any:
    values = list(values)
    return (c_double * len(values))(*values)


class Host:
    """One instance of an unpacked native FMU; every call returns its status.

    Raises
    ------
    Refused
        The FMU can't be instantiated.
    """

    def __init__(
        self,
        folder: Path,
        kind: str = "CoSimulation",
        *,
        token: str | None = None,
        resources: str | Path | None = Path(),
        name: str | None = "x",
        event_mode: bool = False,
        intermediate_update: Callable[[float], None] | None = None,
    ) -> None:
        self.description = fmpy.read_model_description(str(folder))
        self.version = self.description.fmiMajorVersion
        self.flavour = f"fmi{self.version}"
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.messages: list[str] = []
        self.log: list[tuple[int, str]] = []  # status and category
        self._number = next(_numbers)
        _hosts[self._number] = self
        self._library = ctypes.CDLL(str(library_path(folder, self.description)))
        if resources == Path():
            resources = (folder / "resources").as_uri() if self.version == 2 else str(folder / "resources")
        text = [
            None if v is None else str(v).encode()
            for v in (name, self.description.guid if token is None else token, resources)
        ]
        if self.version == 2:
            self._callbacks = fmi2.fmi2CallbackFunctions()
            self._callbacks.logger = _LOGGER_2
            self._callbacks.componentEnvironment = self._number
            fmi2.addLoggerProxy(byref(self._callbacks))  # it formats the printf arguments
            function = self._library.fmi2Instantiate
            function.argtypes = [c_char_p, c_int, c_char_p, c_char_p, c_void_p, c_int, c_int]
            arguments: list[Any] = [text[0], int(kind == "CoSimulation"), *text[1:], byref(self._callbacks), 0, 0]
        else:
            function = getattr(self._library, f"fmi3Instantiate{kind}")
            types = [c_char_p, c_char_p, c_char_p, c_bool, c_bool]
            arguments = [*text, False, False]
            if kind == "CoSimulation":
                types += [c_bool, c_bool, c_void_p, c_size_t]
                arguments += [event_mode, False, (c_uint * 1)(), int(intermediate_update is not None)]
            types += [c_void_p, fmi3.fmi3LogMessageCallback]
            arguments += [self._number, _LOGGER_3]
            if kind == "CoSimulation":
                callback = fmi3.fmi3IntermediateUpdateCallback
                give = intermediate_update
                self._update = callback() if give is None else callback(lambda _, time, *more: give(time))
                types += [fmi3.fmi3IntermediateUpdateCallback]
                arguments += [self._update]
            elif kind == "ScheduledExecution":
                types += [c_void_p] * 3
                arguments += [None] * 3
            function.argtypes = types
        function.restype = c_void_p
        self.component = function(*arguments)
        if not self.component:
            raise Refused("; ".join(self.messages))

    def keep(self, status: int, category: bytes, message: bytes) -> None:
        self.log.append((status, category.decode()))
        self.messages.append(message.decode())

    def call(self, function: str, *arguments: Any) -> int:
        """Call a C function by its name without fmi2 or fmi3."""
        types = (_COMMON | _ARGUMENTS[self.flavour])[function]
        f = getattr(self._library, self.flavour + function)
        f.argtypes, f.restype = [c_void_p, *(_T[t] for t in types)], c_int
        return f(self.component, *arguments)

    def must(self, status: int) -> None:
        assert status == OK, (status, self.messages)

    def free(self) -> None:
        if self.component:
            f = getattr(self._library, f"{self.flavour}FreeInstance")
            f.argtypes, f.restype = [c_void_p], None
            f(self.component)
            self.component = None

    def __enter__(self) -> Host:
        return self

    def __exit__(self, *_: object) -> None:
        self.free()

    # Life cycle

    def enter(self, start: float = 0.0, tolerance: float | None = None, stop: float | None = None) -> int:
        """Enter the initialisation mode; a warning that comes before it is its status."""
        told = tolerance is not None, tolerance or 0.0, start, stop is not None, stop or 0.0
        if self.version == 3:
            return self.call("EnterInitializationMode", *told)
        status = self.call("SetupExperiment", *told)
        return status if status > 1 else self.call("EnterInitializationMode") or status

    def exit(self) -> int:
        return self.call("ExitInitializationMode")

    def get_start(self, names: Sequence[str | int]) -> list[float]:
        """Values at the begin of the initialisation; the instance then is as before it."""
        values: list[float] = []

        def look() -> int:
            status = self.enter()
            values.extend(self.get(names))
            return status

        self.must(self.tried(look))
        return values

    def run_up(self, values: dict[str, float] | None = None, start: float = 0.0) -> Host:
        """Initialise; ready to step, or in continuous-time mode."""
        self.must(self.set(values or {}))
        self.must(self.enter(start))
        self.must(self.exit())
        return self

    def continuous(self) -> Host:
        """From event mode to continuous-time mode."""
        self.must(self.update())
        self.must(self.call("EnterContinuousTimeMode"))
        return self

    def update(self) -> int:
        if self.version == 2:
            return self.call("NewDiscreteStates", byref(fmi2.fmi2EventInfo()))
        return self.call("UpdateDiscreteStates", *(byref(c_bool()) for _ in range(5)), byref(c_double()))

    def new_discrete_states(self) -> tuple[bool, float | None]:
        """Whether continuous states have changed, and the time of the next event."""
        if self.version == 2:
            info = fmi2.fmi2EventInfo()
            self.must(self.call("NewDiscreteStates", byref(info)))
            return bool(info.valuesOfContinuousStatesChanged), info.nextEventTime if info.nextEventTimeDefined else None
        flags, time = [c_bool() for _ in range(5)], c_double()
        self.must(self.call("UpdateDiscreteStates", *map(byref, flags), byref(time)))
        return flags[3].value, time.value if flags[4].value else None

    def completed_step(self) -> bool:
        """Whether the integrator's step asks for the event mode."""
        kind = c_int if self.version == 2 else c_bool
        event, terminate = kind(), kind()
        self.must(self.call("CompletedIntegratorStep", True, byref(event), byref(terminate)))
        return bool(event.value)

    def indicators(self, n: int) -> list[float]:
        buffer = (c_double * n)()
        self.must(self.call("GetEventIndicators", buffer, n))
        return list(buffer)

    def step(self, time: float, h: float) -> int:
        if self.version == 2:
            return self.call("DoStep", time, h, 1)
        self.flags, self.last_time = [c_bool(True) for _ in range(3)], c_double(-1.0)
        return self.call("DoStep", time, h, True, *map(byref, self.flags), byref(self.last_time))

    # Values

    def vr(self, names: Sequence[str | int]) -> Any:
        return (c_uint * len(names))(*(n if isinstance(n, int) else self.references[n] for n in names))

    def _extra(self, n: int) -> tuple[int, ...]:
        return (n,) if self.version == 3 else ()

    @property
    def real(self) -> str:
        return "Real" if self.version == 2 else "Float64"

    @property
    def integer(self) -> str:
        return "Integer" if self.version == 2 else "Int32"

    def try_get(self, names: Sequence[str | int]) -> tuple[int, list[float]]:
        buffer = (c_double * len(names))()
        status = self.call(f"Get{self.real}", self.vr(names), len(names), buffer, *self._extra(len(names)))
        return status, list(buffer)

    def get(self, names: Sequence[str | int]) -> list[float]:
        status, values = self.try_get(names)
        self.must(status)
        return values

    def set(self, values: dict[Any, float]) -> int:
        n = len(values)
        return self.call(f"Set{self.real}", self.vr(list(values)), n, doubles(values.values()), *self._extra(n))

    def set_rates(self, rates: dict[Any, float], order: int = 1) -> int:
        """Derivatives of inputs (FMI 2.0)."""
        n = len(rates)
        orders = (c_int * n)(*[order] * n)
        return self.call("SetRealInputDerivatives", self.vr(list(rates)), n, orders, doubles(rates.values()))

    def output_rates(self, outputs: Sequence[str], order: int = 1) -> tuple[int, list[float]]:
        """Derivatives of outputs by time."""
        n = len(outputs)
        orders, result = (c_int * n)(*[order] * n), (c_double * n)()
        name = "GetRealOutputDerivatives" if self.version == 2 else "GetOutputDerivatives"
        return self.call(name, self.vr(outputs), n, orders, result, *self._extra(n)), list(result)

    def direction(self, unknowns: Sequence[str | int], change: dict[Any, float]) -> tuple[int, list[float]]:
        n, m = len(unknowns), len(change)
        seed, result = doubles(change.values()), (c_double * n)()
        arguments: list[Any] = [self.vr(unknowns), n, self.vr(list(change)), m, seed]
        arguments += [result] if self.version == 2 else [m, result, n]
        return self.call("GetDirectionalDerivative", *arguments), list(result)

    def adjoint(self, knowns: Sequence[str | int], weights: dict[Any, float]) -> tuple[int, list[float]]:
        """Of the sum of unknowns with their weights (FMI 3.0)."""
        n, m = len(weights), len(knowns)
        seed, result = doubles(weights.values()), (c_double * m)()
        arguments: list[Any] = [self.vr(list(weights)), n, self.vr(knowns), m, seed, n, result, m]
        return self.call("GetAdjointDerivative", *arguments), list(result)

    # Continuous states

    def get_states(self, n: int) -> list[float]:
        buffer = (c_double * n)()
        self.must(self.call("GetContinuousStates", buffer, n))
        return list(buffer)

    def set_states(self, x: Sequence[float]) -> int:
        return self.call("SetContinuousStates", doubles(x), len(x))

    def try_derivatives(self, n: int) -> tuple[int, list[float]]:
        buffer = (c_double * n)()
        name = "GetDerivatives" if self.version == 2 else "GetContinuousStateDerivatives"
        return self.call(name, buffer, n), list(buffer)

    # FMU states

    def _state_function(self, name: str) -> str:
        if self.version == 2:
            return name.replace("Deserialize", "DeSerialize").replace("State", "state")
        return name

    def save(self) -> c_void_p:
        state = c_void_p()
        self.must(self.call(self._state_function("GetFMUState"), byref(state)))
        return state

    def restore(self, state: c_void_p) -> int:
        return self.call(self._state_function("SetFMUState"), state)

    def forget(self, state: c_void_p) -> None:
        self.must(self.call(self._state_function("FreeFMUState"), byref(state)))
        assert not state.value

    def tried(self, call: Callable[[], int]) -> int:
        """Status of a call, after which the state from before it is restored."""
        state = self.save()
        status = call()
        self.must(self.restore(state))
        self.forget(state)
        return status

    def save_bytes(self) -> bytes:
        state, size = self.save(), c_size_t()
        self.must(self.call(self._state_function("SerializedFMUStateSize"), state, byref(size)))
        buffer = (ctypes.c_char * size.value)()
        self.must(self.call(self._state_function("SerializeFMUState"), state, buffer, size.value))
        self.forget(state)
        return buffer.raw

    def restore_bytes(self, data: bytes) -> int:
        state = c_void_p()
        status = self.call(self._state_function("DeserializeFMUState"), data, len(data), byref(state))
        if status == OK:
            status = self.restore(state)
            self.forget(state)
        return status


def library_path(folder: Path, description: Any) -> Path:
    target = host_target()
    platform = target.fmi2_folder if description.fmiMajorVersion == 2 else target.fmi3_folder
    return folder / "binaries" / str(platform) / f"{description.modelName}{target.suffix}"
