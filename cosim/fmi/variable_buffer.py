"""Variables of an FMU that are got or set in one call."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

import fmpy.fmi3 as fmi3
import numpy as np
from fmpy.model_description import ModelVariable

from cosim.fmi.instance import CallFailed, Instance
from cosim.fmi.types import FMI_TYPES


def _status_of(call: Callable[[], None]) -> int:
    """Status of FMI that a call ends with."""
    try:
        call()
    except CallFailed as error:
        return error.status
    return 0


class VariableBuffer:
    """Variables of one FMI type that are got or set together, on a part of the slots of the whole system.

    Value references and arguments are prepared once, for setting up these costs more than the call itself. The FMU
    reads and writes the slots directly where its type is theirs, and through a buffer of its own type otherwise.

    Parameters
    ----------
    instance : Instance
        Texts of its variables stand in `instance.texts`.
    variables : sequence of ModelVariable
        Of one type.
    slots : array (n,) of float64
        Slots of all elements of the variables; see `cosim.fmi.types`.
    """

    def __init__(self, instance: Instance, variables: Sequence[ModelVariable], slots: np.ndarray) -> None:
        self.type = FMI_TYPES[variables[0].type]
        self.code = self.type.code(instance.version)
        self._instance = instance
        self._own = slots.view(self.type.slot)
        suffix, c_type = self.type.functions[instance.version]
        n = len(slots)
        self.references = (ctypes.c_uint * len(variables))(*(v.valueReference for v in variables))
        self.getter_name = f"fmi{instance.version}Get{suffix}"
        self.setter_name = f"fmi{instance.version}Set{suffix}"
        self._sizes: Any = (ctypes.c_size_t * n)() if self.type.kind == "binary" else None
        if self.type.is_text:
            self._buffer: Any = (fmi3.fmi3Binary * n)() if self._sizes else (ctypes.c_char_p * n)()
            pointer = self._buffer
        else:
            self._buffer = self._own if self.type.stands_in_slots(instance.version) else np.empty(n, dtype=c_type)
            pointer = (c_type * n).from_buffer(self._buffer)
        values = (pointer,) if self._sizes is None else (self._sizes, pointer)
        counts = (ctypes.c_size_t(n),) if instance.version == 3 else ()
        self._arguments = (self.references, ctypes.c_size_t(len(variables)), *values, *counts)

    @property
    def address(self) -> int | None:
        """Address of the values in the type of the FMU; None where these are the slots themselves, or texts."""
        return None if self._buffer is self._own or self.type.is_text else self._buffer.ctypes.data

    @property
    def size(self) -> int:
        """Size in bytes of what the loop hands to a function."""
        return int(self._own.nbytes if self.type.is_text else self._buffer.nbytes)

    def function_address(self, name: str) -> int:
        """Address of a function by which the compiled loop gets or sets the values.

        That of the FMU, where the values are numbers; texts go by way of Python.

        Raises
        ------
        CallFailed
            The FMU lacks it.
        """
        address = self._instance.function_address(name)
        if not self.type.is_text:
            return address
        passed = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p]
        passed += [ctypes.c_size_t] if self._instance.version == 3 else []
        move = self.get if name == self.getter_name else self.set
        self._moving = ctypes.CFUNCTYPE(ctypes.c_int, *passed)(lambda *_: _status_of(move))
        return ctypes.cast(self._moving, ctypes.c_void_p).value or 0

    def get(self) -> None:
        """Read the variables from the FMU.

        Raises
        ------
        CallFailed
            The FMU does not give them.
        """
        self._instance.call(self.getter_name, *self._arguments)
        if self.type.is_text:
            self._own[:] = [self._instance.texts.number(value) for value in self._texts()]
        elif self._buffer is not self._own:
            self._own[:] = self._buffer

    def set(self) -> None:
        """Write the variables to the FMU.

        Raises
        ------
        CallFailed
            The FMU does not take them.
        """
        if self.type.is_text:
            self._take([self._instance.texts[number] for number in self._own.tolist()])
        elif self._buffer is not self._own:
            self._buffer[:] = self._own
        self._instance.call(self.setter_name, *self._arguments)

    def _texts(self) -> list[str | bytes]:
        """Values that an FMU has written into the buffer: pointers to its own memory."""
        if self._sizes is None:
            return [(value or b"").decode("utf-8", "replace") for value in self._buffer]
        sizes = list(self._sizes)
        return [ctypes.string_at(p, size) if size else b"" for p, size in zip(self._buffer, sizes, strict=True)]

    def _take(self, values: Sequence[str | bytes]) -> None:
        for i, value in enumerate(values):
            if self._sizes is None:
                self._buffer[i] = str(value).encode()
                continue
            data = value if isinstance(value, bytes) else value.encode()
            self._sizes[i] = len(data)
            self._buffer[i] = ctypes.cast(ctypes.create_string_buffer(data, max(1, len(data))), fmi3.fmi3Binary)
