"""An instance of an FMU for model exchange, as FMPy's solvers take it, but loaded by us."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fmpy import fmi2, fmi3
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription

from cosim.fmi.messages import Messages, keep_callbacks
from cosim.fmi.shared_library import Library, library_path


class _Loaded:
    """What FMPy's classes do to load a library and to call its functions, with our library."""

    def __init__(self, folder: Path, description: ModelDescription) -> None:
        identifier = description.modelExchange.modelIdentifier
        self.guid = description.instantiationToken
        self.instanceName = self.modelIdentifier = identifier
        self.unzipDirectory = str(folder)
        self._library = Library(library_path(folder, description.fmiMajorVersion, identifier), identifier)
        self.component: Any = None
        self.corrupted = False

    def _call(self, name: str, *arguments: Any) -> Any:
        function: Any = self._library.function(name)
        result = function(*arguments)
        if "Instantiate" not in name and result is not None and result > fmi2.fmi2Warning:
            self.corrupted = result == fmi2.fmi2Fatal
            raise FMICallException(function=name, status=result)
        return result

    def freeLibrary(self) -> None:
        self._library.close()


class _Model2(_Loaded, fmi2.FMU2Model):  # type: ignore[misc] # fmpy has no types
    pass


class _Model3(_Loaded, fmi3.FMU3Model):  # type: ignore[misc]
    pass


@contextmanager
def model_exchange_instance(folder: Path, description: ModelDescription, messages: Messages) -> Iterator[Any]:
    """An instance of an unpacked FMU of FMI 2.0 or 3.0, freed at the end.

    Parameters
    ----------
    folder : Path
        Folder with the unpacked FMU.
    description : ModelDescription
        Its model description.
    messages : Messages
        Takes what the FMU says.

    Raises
    ------
    LibraryError
        The library of the FMU can't be loaded.
    """
    instance: Any
    if description.fmiMajorVersion == 2:
        instance = _Model2(folder, description)
        options = {"callbacks": messages.callbacks_fmi2()}
    else:
        instance = _Model3(folder, description)
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
        if not instance.corrupted:  # after a fatal error the standards forbid any further call
            instance.freeInstance()
