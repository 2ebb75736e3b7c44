"""Instances of FMUs for model exchange: for the compiled loop, which integrates them, and for FMPy's solvers."""

from __future__ import annotations

import ctypes
import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from fmpy import fmi2, fmi3
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription, ModelVariable

from cosim.fmi.event_mode import DISCRETE
from cosim.fmi.instance import CallFailed, ExperimentSetup, Instance
from cosim.fmi.messages import Messages, keep_callbacks
from cosim.fmi.shared_library import Library, Loader
from cosim.fmi.types import FMI_TYPES
from cosim.loop.binding import Operation, OperationKind
from cosim.loop.model_exchange import FUNCTIONS, ContinuousComponent, Mode


def timing_in_model_exchange(variable: ModelVariable) -> str:
    """`DISCRETE` for what can be set in event mode only, and empty for other variables; see `Element.timing`."""
    if variable.causality == "parameter":
        return DISCRETE if variable.variability == "tunable" else ""
    known = FMI_TYPES.get(variable.type)
    is_continuous = known is None or (known.kind == "real" and variable.variability in (None, "continuous"))
    return "" if variable.causality != "input" or is_continuous else DISCRETE


class ModelExchangeInstance(Instance):
    """An instance for model exchange, of FMI 2.0 or 3.0; the group that it belongs to integrates it.

    Attributes
    ----------
    continuous : ContinuousComponent
        What the compiled loop knows of it.
    has_states : bool
        Whether it has continuous states.
    """

    fmi2_type = fmi2.fmi2ModelExchange

    def __init__(self, name: str, folder: Path, description: ModelDescription, *arguments: Any, **options: Any) -> None:
        super().__init__(name, folder, description, *arguments, **options)
        self.has_states = bool(description.derivatives)
        self._has_indicators = bool(description.numberOfEventIndicators)
        if self.version == 2:
            self._sizes: tuple[int, int] | None = (
                len(description.derivatives),
                int(description.numberOfEventIndicators or 0),
            )
        else:
            self._sizes = None  # they may follow structural parameters
        self.continuous = ContinuousComponent(
            version=self.version,
            next_event=math.inf,
            needs_completed_step=bool(self._interface.needsCompletedIntegratorStep),
        )

    @staticmethod
    def _interface_of(description: ModelDescription) -> Any:
        return description.modelExchange

    def _prepared_fmi3(self, token: bytes, where: bytes) -> Callable[[], int | None]:
        callback = self.messages.callback_fmi3()
        keep_callbacks(callback)
        return partial(
            self._function("fmi3InstantiateModelExchange"),
            *(self.name.encode(), token, where),
            *(False, True),  # invisible; says what is wrong
            *(None, callback),
        )

    def instantiate(self) -> None:
        """See `Instance`."""
        self._check_functions()
        super().instantiate()
        known = self.continuous
        known.instance = self.address
        known.told = Operation(kind=OperationKind.GROUP, version=self.version, instance=self.address)
        for i, function in enumerate(FUNCTIONS[self.version]):
            known.functions[i] = None if self.lacks(function) else self.function_address(function)
            known.codes[i] = self.code_of_call(function)

    def sizes(self) -> tuple[int, int]:
        """Numbers of continuous states and of event indicators.

        Raises
        ------
        CallFailed
            The FMU does not say.
        """
        if self._sizes is not None:
            return self._sizes
        n_states, n_indicators = ctypes.c_size_t(), ctypes.c_size_t()
        self.call("fmi3GetNumberOfContinuousStates", ctypes.byref(n_states))
        self.call("fmi3GetNumberOfEventIndicators", ctypes.byref(n_indicators))
        return n_states.value, n_indicators.value

    def _check_functions(self) -> None:
        """Whether the library has what the loop will call."""
        set_time, set_states, get_states, get_rates, _, indicators, completed, *modes = FUNCTIONS[self.version]
        needed = [set_time, *modes, *((set_states, get_states, get_rates) if self.has_states else ())]
        needed += [indicators] if self._has_indicators else []
        needed += [completed] if self.continuous.needs_completed_step else []
        for function in needed:
            self._function(function)

    # Modes

    def enter_initialization_mode(self, experiment: ExperimentSetup) -> None:
        """See `Instance`."""
        self.continuous.mode, self.continuous.next_event = Mode.INITIALIZATION, math.inf
        super().enter_initialization_mode(experiment)

    def exit_initialization_mode(self) -> None:
        """See `Instance`; the instance is then in event mode."""
        super().exit_initialization_mode()
        self.continuous.mode = Mode.EVENT

    def enter_event_mode(self) -> None:
        """Have what is set next be an event."""
        if self.continuous.mode == Mode.CONTINUOUS_TIME:
            self.call(f"fmi{self.version}EnterEventMode")
            self.continuous.mode = Mode.EVENT

    def let_ask_for_inputs(self, operation: Operation) -> None:
        """Nothing: inputs are set in each stage."""

    # States

    def save_state(self) -> bytes:
        """See `Instance`."""
        head = json.dumps([int(self.continuous.mode), float(self.continuous.next_event).hex()]).encode()
        return len(head).to_bytes(4, "little") + head + super().save_state()

    def restore_state(self, data: bytes) -> None:
        """See `Instance`."""
        n = int.from_bytes(data[:4], "little")
        try:
            mode, next_event = json.loads(data[4 : 4 + n])
        except ValueError:
            raise CallFailed("was not the one that saved this state") from None
        super().restore_state(data[4 + n :])
        self.continuous.mode, self.continuous.next_event = mode, float.fromhex(next_event)

    # Steps

    @property
    def takes_any_step(self) -> bool:
        """See `Instance`."""
        return True


class _Loaded:
    """What FMPy's classes do to load a library and to call its functions, with our library."""

    def __init__(self, folder: Path, description: ModelDescription, load: Loader) -> None:
        identifier = description.modelExchange.modelIdentifier
        self.guid = description.instantiationToken
        self.instanceName = self.modelIdentifier = identifier
        self.unzipDirectory = str(folder)
        self._library = load(folder, description.fmiMajorVersion, identifier, "")
        self.component: Any = None
        self.corrupted = False

    def _call(self, name: str, *arguments: Any) -> Any:
        function: Any = self._library.function(name)
        result = function(*arguments)
        if "Instantiate" not in name and result is not None and result > fmi2.fmi2Warning:
            if (end := self._library.failure(name, result)) is not None:
                self.corrupted = True
                raise end
            self.corrupted = result == fmi2.fmi2Fatal
            raise FMICallException(function=name, status=result)
        return result

    def freeLibrary(self) -> None:
        self._library.close()

    def abandonLibrary(self) -> None:
        self._library.abandon()


class _Model2(_Loaded, fmi2.FMU2Model):  # type: ignore[misc] # fmpy has no types
    pass


class _Model3(_Loaded, fmi3.FMU3Model):  # type: ignore[misc]
    pass


@contextmanager
def model_exchange_instance(
    folder: Path,
    description: ModelDescription,
    messages: Messages,
    load: Loader = Library.of,
) -> Iterator[Any]:
    """An instance of an unpacked FMU of FMI 2.0 or 3.0, freed at the end.

    Parameters
    ----------
    folder : Path
        Folder with the unpacked FMU.
    description : ModelDescription
        Its model description.
    messages : Messages
        Takes what the FMU says.
    load : callable
        As of `Instance`.

    Raises
    ------
    LibraryError
        The library of the FMU can't be loaded.
    """
    instance: Any
    if description.fmiMajorVersion == 2:
        instance = _Model2(folder, description, load)
        options = {"callbacks": messages.callbacks_fmi2()}
    else:
        instance = _Model3(folder, description, load)
        options = {"logMessage": messages.callback_fmi3()}
    keep_callbacks(*options.values())
    try:
        instance.instantiate(**options)
    except BaseException:
        instance.freeLibrary()
        raise
    try:
        yield instance
    finally:
        if instance.corrupted:  # after a fatal error the standards forbid any further call
            instance.abandonLibrary()
        else:
            instance.freeInstance()
