"""The shared library of an FMU, loaded by its full path, and the prototypes of its functions.

FMPy changes the working folder of the process to load a library, and wants every function that the standard has, also
those that an FMU may leave out. Here nothing of the process changes, and a function is looked up when it is first
called.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import c_bool, c_char, c_double, c_int, c_size_t, c_void_p
from pathlib import Path
from typing import TYPE_CHECKING, Any

import fmpy
from fmpy.fmi1 import fmi1CallbackFunctions

from cosim.fmi.loading import LibraryError, in_standard, load, names_in_library, unload
from cosim.fmi.own_variables import library_of_its_own
from cosim.loop.current_calls import Caller

if TYPE_CHECKING:
    from cosim.fmi.instance import CallFailed

#: C types by a letter; arrays, structures and texts are addresses.
_TYPES = {
    "p": c_void_p,
    "n": c_size_t,
    "d": c_double,
    "i": c_int,
    "b": c_bool,
    "c": c_char,
    "F": fmi1CallbackFunctions,
}

#: Arguments -> functions that take them. Those of FMI 1.0 begin with `fmi1` here, in the standard with `fmi`.
_ARGUMENTS = {
    # to make and to free an instance
    "ppppdccFc": "fmi1InstantiateSlave",
    "pipppii": "fmi2Instantiate",
    "pppbbbbpnppp": "fmi3InstantiateCoSimulation",
    "pppbbpp": "fmi3InstantiateModelExchange",
    # modes
    "pdcd": "fmi1InitializeSlave",
    "piddid": "fmi2SetupExperiment",
    "pbddbd": "fmi3EnterInitializationMode",
    "p": """
        fmi1FreeSlaveInstance fmi1TerminateSlave fmi1ResetSlave fmi1CancelStep
        fmi2FreeInstance fmi2Terminate fmi2Reset fmi2CancelStep fmi2EnterInitializationMode fmi2ExitInitializationMode
        fmi2EnterEventMode fmi2EnterContinuousTimeMode
        fmi3FreeInstance fmi3Terminate fmi3Reset fmi3ExitInitializationMode
        fmi3EnterEventMode fmi3EnterContinuousTimeMode fmi3EnterStepMode
        fmi3EnterConfigurationMode fmi3ExitConfigurationMode fmi3EvaluateDiscreteStates
    """,
    # steps
    "pddc": "fmi1DoStep",
    "pddi": "fmi2DoStep",
    "pddbpppp": "fmi3DoStep",
    "ppppppp": "fmi3UpdateDiscreteStates",
    "pip": """
        fmi1GetStatus fmi1GetRealStatus fmi1GetIntegerStatus fmi1GetBooleanStatus fmi1GetStringStatus
        fmi2GetStatus fmi2GetRealStatus fmi2GetIntegerStatus fmi2GetBooleanStatus fmi2GetStringStatus
    """,
    # values
    "ppnp": """
        fmi1GetReal fmi1GetInteger fmi1GetBoolean fmi1GetString
        fmi1SetReal fmi1SetInteger fmi1SetBoolean fmi1SetString
        fmi2GetReal fmi2GetInteger fmi2GetBoolean fmi2GetString
        fmi2SetReal fmi2SetInteger fmi2SetBoolean fmi2SetString
        fmi3GetClock fmi3SetClock fmi3SetIntervalDecimal fmi3GetShiftDecimal fmi3SetShiftDecimal
        fmi2DeSerializeFMUstate fmi3DeserializeFMUState
    """,
    "ppnpn": """
        fmi3GetFloat32 fmi3GetFloat64 fmi3GetInt8 fmi3GetUInt8 fmi3GetInt16 fmi3GetUInt16
        fmi3GetInt32 fmi3GetUInt32 fmi3GetInt64 fmi3GetUInt64 fmi3GetBoolean fmi3GetString
        fmi3SetFloat32 fmi3SetFloat64 fmi3SetInt8 fmi3SetUInt8 fmi3SetInt16 fmi3SetUInt16
        fmi3SetInt32 fmi3SetUInt32 fmi3SetInt64 fmi3SetUInt64 fmi3SetBoolean fmi3SetString
    """,
    "ppnppn": "fmi3GetBinary fmi3SetBinary fmi3GetOutputDerivatives",
    "ppnpp": """
        fmi1SetRealInputDerivatives fmi1GetRealOutputDerivatives
        fmi2SetRealInputDerivatives fmi2GetRealOutputDerivatives
        fmi3GetIntervalDecimal fmi3SetIntervalFraction fmi3GetShiftFraction fmi3SetShiftFraction
    """,
    "ppnppp": "fmi3GetIntervalFraction",
    # states of the FMU
    "pp": """
        fmi2GetFMUstate fmi2SetFMUstate fmi2FreeFMUstate fmi2NewDiscreteStates
        fmi3GetFMUState fmi3SetFMUState fmi3FreeFMUState fmi3GetNumberOfEventIndicators fmi3GetNumberOfContinuousStates
    """,
    "ppp": "fmi2SerializedFMUstateSize fmi3SerializedFMUStateSize",
    "pppn": "fmi2SerializeFMUstate fmi3SerializeFMUState",
    # model exchange and derivatives
    "pd": "fmi2SetTime fmi3SetTime",
    "ppn": """
        fmi2SetContinuousStates fmi2GetContinuousStates fmi2GetDerivatives fmi2GetEventIndicators
        fmi2GetNominalsOfContinuousStates
        fmi3SetContinuousStates fmi3GetContinuousStates fmi3GetContinuousStateDerivatives fmi3GetEventIndicators
        fmi3GetNominalsOfContinuousStates
    """,
    "pipp": "fmi2CompletedIntegratorStep",
    "pbpp": "fmi3CompletedIntegratorStep",
    "ppnpnpp": "fmi2GetDirectionalDerivative",
    "ppnpnpnpn": "fmi3GetDirectionalDerivative fmi3GetAdjointDerivative",
    # messages
    "pc": "fmi1SetDebugLogging",
    "pinp": "fmi2SetDebugLogging",
    "pbnp": "fmi3SetDebugLogging",
}

#: Function -> its arguments.
PROTOTYPES = {
    name: tuple(_TYPES[c] for c in letters) for letters, names in _ARGUMENTS.items() for name in names.split()
}


def library_names(version: int, identifier: str) -> tuple[str, str]:
    """Names, inside an FMU, under which it may have a library for this machine; the one of its version of FMI first."""
    fmi2, fmi3 = (
        f"binaries/{folder}/{identifier}{fmpy.sharedLibraryExtension}"
        for folder in (fmpy.platform, fmpy.platform_tuple)
    )
    return (fmi3, fmi2) if version == 3 else (fmi2, fmi3)


def library_path(folder: Path, version: int, identifier: str) -> Path:
    """Path of the library for this machine in an unpacked FMU of a version of FMI.

    Raises
    ------
    LibraryError
        It has none.
    """
    paths = [folder / name for name in library_names(version, identifier)]
    path = next((path for path in paths if path.is_file()), None)
    if path is None:
        raise LibraryError(f"has no {paths[0].relative_to(folder).as_posix()}; get a build of it for this machine")
    return path


class Library:
    """A loaded shared library, with further ones that lie beside it as far as the loader does not find them.

    Parameters
    ----------
    path : Path
        The file.
    identifier : str
        Model identifier; the names of functions of FMI 1.0 begin with it.
    component : str, optional
        What to call the FMU where it ends the process.
    own_variables : bool
        Whether its global variables must be those of no other instance; a library that is loaded is then copied.

    Raises
    ------
    LibraryError
        It can't be loaded; the text says why, and what to do.
    """

    def __init__(self, path: Path, identifier: str, component: str = "", *, own_variables: bool = False) -> None:
        self._identifier = identifier
        self._caller = Caller(component or f"the FMU '{identifier}'")
        self._functions: dict[str, Callable[..., Any]] = {}
        self._symbols: dict[str, Any] = {}
        file = library_of_its_own(path.absolute()) if own_variables else path.absolute()
        self._libraries = self._caller.noting(load, "the loading of its library")(file)

    @classmethod
    def of(
        cls, folder: Path, version: int, identifier: str, component: str = "", *, own_variables: bool = False
    ) -> Library:
        """The library for this machine in an unpacked FMU of a version of FMI.

        Raises
        ------
        LibraryError
            It has none, or it can't be loaded.
        """
        return cls(library_path(folder, version, identifier), identifier, component, own_variables=own_variables)

    #: Whether it is loaded in another process.
    is_isolated = False

    #: Whether its process is to compute on the core of the loop, see core.c.
    shares_core = False

    #: The error by which the process of an isolated FMU has ended, see `cosim.fmi.isolation`.
    end: CallFailed | None = None

    def function(self, name: str) -> Callable[..., Any]:
        """A function by its name in the standard, with `fmi1` for the `fmi` of FMI 1.0.

        Raises
        ------
        LibraryError
            The library lacks it.
        """
        try:
            return self._functions[name]
        except KeyError:
            return self._functions.setdefault(name, self._found(name))

    def address(self, name: str) -> int:
        """Address of a function.

        Raises
        ------
        LibraryError
            The library lacks it.
        """
        self.function(name)
        return ctypes.cast(self._symbols[name], c_void_p).value or 0

    def code(self, name: str) -> int:
        """Code of a call of a function, as the loop notes it."""
        return self._caller.code(in_standard(name))

    def has(self, name: str) -> bool:
        """Whether there is a function of this name in the standard."""
        try:
            self.function(name)
        except LibraryError:
            return False
        return True

    def failure(self, function: str, status: int) -> CallFailed | None:  # noqa: ARG002
        """The error for a status that is none of the FMU's; None for one that is, as always in this process."""
        return None

    def abandon(self) -> None:
        """Leave a library whose FMU must not be called any more as it is."""

    def close(self) -> None:
        """Unload the library."""
        self._functions.clear()
        self._symbols.clear()
        self._caller.noting(unload, "the unloading of its library")(self._libraries)

    def _found(self, name: str) -> Callable[..., Any]:
        names = names_in_library(name, self._identifier)
        function: Any = next((f for n in names if (f := getattr(self._libraries[0], n, None)) is not None), None)
        if function is None:
            raise LibraryError(f"lacks the function {in_standard(name)}")
        function.argtypes = PROTOTYPES[name]
        function.restype = c_void_p if "Instantiate" in name else None if name.endswith("Instance") else c_int
        self._symbols[name] = function
        return self._caller.noting(function, in_standard(name))


#: Loads the library of an FMU from the folder where it is unpacked: version of FMI, model identifier, what to call it.
Loader = Callable[[Path, int, str, str], Library]
