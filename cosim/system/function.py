"""A function in Python as a component: its variables, its description in the terms of FMI, and the object behind it."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import TYPE_CHECKING, Any
from weakref import WeakValueDictionary

import numpy as np

from cosim.errors import SetupError

if TYPE_CHECKING:
    from fmpy.model_description import ModelDescription, ModelVariable

#: Unit or type of a variable, its shape, or both: "rad", 3, ("rad", 3), bool, (int, (2, 3)), None.
VariableSpec = str | int | type | Sequence[Any] | None

#: Variables by name, or names alone; `theta[1..3]` is a vector of 3.
VariableSpecs = Mapping[str, VariableSpec] | Iterable[str]

_TYPES = {float: "Float64", int: "Int64", bool: "Boolean"}

_NAME = re.compile(r"(?P<name>[^\[\]]+)(\[(?P<ranges>1\.\.\d+(,1\.\.\d+)*)\])?$")

#: Objects that can't be brought back to where they began, and have taken part in a run.
_used: WeakValueDictionary[int, Any] = WeakValueDictionary()


@dataclass(frozen=True)
class FunctionVariable:
    """An input or an output of a function: a number, or an array of some shape."""

    name: str
    type: str
    unit: str | None
    shape: tuple[int, ...]


class PythonFunction:
    """A function in Python that is a component; see `System.add_function`.

    Parameters
    ----------
    component : str
        Name of the component.
    function : callable
    inputs, outputs : mapping or sequence
    direct_feedthrough : bool

    Raises
    ------
    SetupError
        It is not callable, or a variable is not described as it must be.
    """

    def __init__(
        self,
        component: str,
        function: Callable[..., Any],
        inputs: VariableSpecs,
        outputs: VariableSpecs,
        *,
        direct_feedthrough: bool,
    ) -> None:
        self.component = component
        self.function = function
        self.direct_feedthrough = direct_feedthrough
        if not callable(function):
            raise SetupError(f"component '{component}': {function!r} is not callable; give a function f(time, ...)")
        self.inputs = self._variables("inputs", inputs)
        self.outputs = self._variables("outputs", outputs)
        names = [v.name for v in (*self.inputs, *self.outputs)]
        for name in names:
            if names.count(name) > 1:
                raise SetupError(f"component '{component}': there are two variables '{name}'; give each its own name")
        self._check_signature()
        self.begun = 0  # runs
        self.owner = _owner(function)
        self.can_reset = callable(getattr(self.owner, "reset", None))
        self.can_save = all(callable(getattr(self.owner, name, None)) for name in ("save", "restore"))
        self._initial = self._saved_first() if self.can_save and not self.can_reset else b""

    @property
    def qualified_name(self) -> str:
        """Module and name of the function, or of the class of the object, for people."""
        function = self.function
        while isinstance(function, functools.partial):
            function = function.func
        named = function if hasattr(function, "__qualname__") else type(function)
        own = getattr(function, "__name__", named.__qualname__)  # all that a ufunc of NumPy before 2.2 has
        name = named.__qualname__ if named is function else own
        return f"{getattr(named, '__module__', None) or 'builtins'}.{name}"

    def description(self) -> ModelDescription:
        """What the model description of an FMU with these variables would say."""
        # late: a command that simulates nothing need not wait for fmpy
        from fmpy.model_description import CoSimulation, ModelDescription, ModelVariable, Unit, Unknown

        variables = [
            ModelVariable(
                name=v.name,
                valueReference=reference,
                type=v.type,
                shape=v.shape or None,
                causality="input" if reference < len(self.inputs) else "output",
                variability="discrete",
                unit=v.unit,
            )
            for reference, v in enumerate((*self.inputs, *self.outputs))
        ]
        depends_on: list[ModelVariable] | None = None if self.direct_feedthrough else []
        return ModelDescription(
            fmiVersion="3.0",
            modelName=self.qualified_name,
            instantiationToken=f"function {self.component}",
            unitDefinitions=[Unit(name=u) for u in dict.fromkeys(v.unit for v in variables) if u is not None],
            coSimulation=CoSimulation(modelIdentifier=self.component),
            modelVariables=variables,
            outputs=[Unknown(variable=v, dependencies=depends_on) for v in variables if v.causality == "output"],
        )

    # The object behind the function

    def begin(self) -> int:
        """Bring the object to where every run begins; returns how many runs have begun with it.

        Raises
        ------
        SetupError
            It can't be brought there, and has taken part in a run before.
        """
        owner = self.owner
        if owner is None:
            return self.begun
        if self.can_reset:
            owner.reset()
        elif self.can_save:
            owner.restore(self._initial)
        elif _used.get(id(owner)) is owner:
            raise SetupError(
                f"component '{self.component}': a {type(owner).__qualname__} has taken part in a run before and may "
                "have kept something; give it a method reset(), or pass a plain function if it keeps nothing"
            )
        else:
            self._note_use()
        self.begun += 1
        return self.begun

    def save(self) -> bytes:
        """The state of the object.

        Raises
        ------
        TypeError
            `save` of the object gives something else than bytes.
        """
        state = self.owner.save() if self.owner is not None else b""
        if not isinstance(state, (bytes, bytearray, memoryview)):
            raise TypeError(f"save() gave a {type(state).__qualname__}; it must give bytes, as pickle.dumps does")
        return bytes(state)

    def _saved_first(self) -> bytes:
        try:
            return self.save()
        except Exception as error:
            here = f"component '{self.component}': the state of its object can't be saved"
            raise SetupError(f"{here}: {type(error).__name__}: {error}") from error

    def restore(self, state: bytes) -> None:
        """Bring the object into a state that `save` gave."""
        if self.owner is not None:
            self.owner.restore(state)

    def _note_use(self) -> None:
        try:
            _used[id(self.owner)] = self.owner
        except TypeError:
            raise SetupError(
                f"component '{self.component}': a {type(self.owner).__qualname__} can't be told from one that has "
                "taken part in a run before; give it a method reset(), or pass a plain function if it keeps nothing"
            ) from None

    # Variables

    def _check_signature(self) -> None:
        """Whether the function takes the time and the inputs, as far as its signature says."""
        try:
            signature = inspect.signature(self.function)
        except (TypeError, ValueError):  # of a function in C
            return
        try:
            signature.bind(0.0, *self.inputs)
        except TypeError as error:
            names = ", ".join(["time", *(v.name for v in self.inputs)])
            raise SetupError(
                f"component '{self.component}': its function is called with ({names}), which it does not take: {error}"
            ) from None

    def _variables(self, role: str, specs: VariableSpecs) -> tuple[FunctionVariable, ...]:
        if isinstance(specs, str) or not isinstance(specs, Iterable):
            raise SetupError(f"component '{self.component}': {role} = {specs!r} must be a mapping or a list of names")
        items = specs.items() if isinstance(specs, Mapping) else [(name, None) for name in specs]
        return tuple(self._variable(role, name, spec) for name, spec in items)

    def _variable(self, role: str, name: Any, spec: Any) -> FunctionVariable:
        match = _NAME.match(name) if isinstance(name, str) else None
        here = f"component '{self.component}': {role}: {name!r}"
        if match is None:
            raise SetupError(f"{here} is not a name; write a vector of 3 as theta[1..3]")
        ranges = match["ranges"]
        by_name = tuple(int(r.removeprefix("1..")) for r in ranges.split(",")) if ranges else ()
        what, shape = _unit_or_type_and_shape(here, spec)
        if by_name and shape:
            raise SetupError(f"{here} has a shape by its name, and another one beside it; give one of them")
        shape = by_name or shape
        if any(isinstance(n, bool) or not isinstance(n, int) or n < 1 for n in shape):
            raise SetupError(f"{here} has the shape {shape}; its sizes must be positive whole numbers")
        is_type = isinstance(what, type)
        return FunctionVariable(match["name"], _TYPES[what] if is_type else "Float64", None if is_type else what, shape)


def _unit_or_type_and_shape(here: str, spec: Any) -> tuple[Any, tuple[int, ...]]:
    if _is_what(spec):
        return spec, ()
    is_pair = isinstance(spec, (tuple, list)) and len(spec) == 2 and _is_what(spec[0])
    what, shape = spec if is_pair else (None, spec)
    sizes = (shape,) if isinstance(shape, (int, np.integer)) else shape
    if not isinstance(sizes, (tuple, list)):
        raise SetupError(
            f"{here} is described by {spec!r}; write its unit or type, its shape, or both: 'rad', 3, ('rad', 3), bool"
        )
    return what, tuple(int(n) if isinstance(n, np.integer) else n for n in sizes)


def _is_what(value: Any) -> bool:
    """Whether a value stands for a unit or a type."""
    return value is None or isinstance(value, str) or (isinstance(value, type) and value in _TYPES)


def _owner(function: Any) -> Any:
    """The object that may keep something from one call to the next; None for a plain function, which must not."""
    while isinstance(function, functools.partial):
        function = function.func
    if isinstance(function, (MethodType, BuiltinFunctionType)):
        owner = function.__self__
        return None if owner is None or isinstance(owner, (type, ModuleType)) else owner
    is_plain = isinstance(function, (FunctionType, type, np.ufunc)) or hasattr(function, "__wrapped__")
    return None if is_plain else function
