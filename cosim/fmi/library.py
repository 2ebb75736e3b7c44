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
from typing import Any

import fmpy
from fmpy.fmi1 import fmi1CallbackFunctions

from cosim.errors import CosimError

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
        fmi3GetClock fmi3SetClock fmi3SetIntervalDecimal fmi3GetShiftDecimal
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
        fmi3GetIntervalDecimal fmi3SetIntervalFraction fmi3GetShiftFraction
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


class LibraryError(CosimError):
    """The shared library of an FMU can't be loaded, or lacks a function."""


def library_path(folder: Path, version: int, identifier: str) -> Path:
    """Where an unpacked FMU of a version of FMI has its library for this machine.

    Raises
    ------
    LibraryError
        It has none.
    """
    folders = [folder / "binaries" / name for name in (fmpy.platform, fmpy.platform_tuple)]
    for binaries in reversed(folders) if version == 3 else folders:
        path: Path = binaries / f"{identifier}{fmpy.sharedLibraryExtension}"
        if path.is_file():
            return path
    raise LibraryError(f"has no library {identifier}{fmpy.sharedLibraryExtension} for {fmpy.platform}")


class Library:
    """A loaded shared library.

    Parameters
    ----------
    path : Path
        The file.
    identifier : str
        Model identifier; the names of functions of FMI 1.0 begin with it.

    Raises
    ------
    LibraryError
        It can't be loaded.
    """

    def __init__(self, path: Path, identifier: str) -> None:
        self._identifier = identifier
        self._functions: dict[str, Callable[..., Any]] = {}
        try:
            # the full path: on Windows the loader then looks for further libraries beside it
            self._library = ctypes.CDLL(str(path.absolute()))
        except OSError as error:
            raise LibraryError(f"can't be loaded: {' '.join(str(error).split())}") from error

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

    def close(self) -> None:
        """Unload the library."""
        self._functions.clear()
        fmpy.freeLibrary(self._library._handle)

    def _found(self, name: str) -> Callable[..., Any]:
        in_library = f"{self._identifier}_fmi{name[4:]}" if name.startswith("fmi1") else name
        try:
            function: Any = self._library[in_library]
        except AttributeError:
            raise LibraryError(f"lacks the function {in_library}") from None
        function.argtypes = PROTOTYPES[name]
        function.restype = c_void_p if "Instantiate" in name else None if name.endswith("Instance") else c_int
        bound: Callable[..., Any] = function
        return bound
