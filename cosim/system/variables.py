"""The variables of an FMU under the names users write: scalars, elements and whole vectors.

FMI 2.0 knows scalars only, of which `tau_a[1]`, `tau_a[2]`, ... make up the vector `tau_a`; FMI 3.0 has arrays, whose
elements get the same names here. So both versions answer to the same names.
"""

from __future__ import annotations

import math
import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Any, overload

from fmpy.model_description import ModelDescription, ModelVariable, Unit

from cosim.errors import ArgumentError, SetupError, nearest
from cosim.fmi.archive.description import MOST_ELEMENTS
from cosim.fmi.event_mode import CLOCK, DISCRETE, set_intervals, timing_of, uses_events
from cosim.fmi.interfaces import is_model_exchange
from cosim.fmi.model_exchange import timing_in_model_exchange
from cosim.fmi.structure import resize
from cosim.fmi.types import FMI_TYPES, FmiType

#: Arrays with more elements are recorded, and named in messages, element by element only where a user does so.
LARGE = 10_000

#: A name of an element; no vector has so many that an index has more digits.
_ELEMENT = re.compile(r"(?P<vector>.+)\[\d{1,18}(,\d{1,18})*\]$")


@dataclass(frozen=True)
class Element:
    """One scalar value of a variable: the variable itself in FMI 2.0, an element of an array in FMI 3.0.

    `timing` says when its values are exchanged, see `cosim.fmi.event_mode.timing_of` and
    `cosim.fmi.model_exchange.timing_in_model_exchange`; empty in FMUs whose events are their own.
    """

    name: str
    variable: ModelVariable
    offset: int
    timing: str = ""

    @property
    def is_exchanged(self) -> bool:
        """Whether its values can be exchanged and recorded; those of clocks can in event mode only."""
        return self.variable.type in FMI_TYPES and (self.variable.type != "Clock" or self.timing == CLOCK)

    @property
    def is_clocked(self) -> bool:
        """Whether it can be got and set while a clock is active only."""
        return self.timing not in ("", CLOCK, DISCRETE)

    @property
    def type(self) -> FmiType:
        """Its type, where `is_exchanged`."""
        return FMI_TYPES[self.variable.type]

    @property
    def kind(self) -> str:
        """Kind of the value: real, integer, boolean, enumeration, string, binary; clock."""
        return FMI_TYPES[self.variable.type].kind

    @property
    def is_tunable(self) -> bool:
        """Whether it is a parameter that may change during a run."""
        return bool(self.variable.causality == "parameter" and self.variable.variability == "tunable")

    @property
    def items(self) -> dict[str, int]:
        """Names of the items of an enumeration and their numbers; empty for other types."""
        declared = self.variable.declaredType
        return {} if declared is None else {str(i.name): int(i.value) for i in declared.items if i.value is not None}

    @property
    def words(self) -> dict[str, int]:
        """Words that stand for its values: those of Booleans, and items of enumerations."""
        return {"false": 0, "true": 1} if self.kind == "boolean" else self.items

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest number that its type, or its enumeration, has."""
        if self.kind == "enumeration" and self.items:
            return min(self.items.values()), max(self.items.values())
        smallest, largest = self.type.smallest, self.type.largest
        return (-math.inf if smallest is None else smallest), (math.inf if largest is None else largest)

    def value(self, value: Any) -> Any:
        """A value that the element can hold, in Python's own type; exactly what was given.

        Booleans and enumerations take their words too.

        Raises
        ------
        ArgumentError
            The element can't hold it.
        """
        if isinstance(value, str) and self.words:
            if value not in self.words:
                raise ArgumentError(
                    f"{value!r} is not a value of type {self.variable.type}; {nearest(value, self.words)}"
                )
            return self.type.value(self.words[value])
        known = self.type.value(value)
        if self.kind == "enumeration" and self.items and known not in self.items.values():
            numbers = ", ".join(f"{name} = {number}" for name, number in self.items.items())
            raise ArgumentError(f"{value!r} is not an item of the enumeration, which has {numbers}")
        return known


#: Elements of larger arrays than this are made anew each time: they would take memory.
_KEPT = 64


class ElementArray(Sequence[Element]):
    """The elements of a variable, made when one is asked for; a scalar has one.

    Parameters
    ----------
    variable : ModelVariable
    timing : str
        See `Element`.
    """

    def __init__(self, variable: ModelVariable, timing: str = "") -> None:
        self._variable = variable
        self._timing = timing
        self._shape: tuple[int, ...] = variable.shape or ()
        self._size = math.prod(self._shape)
        self._made: dict[int, Element] | None = {} if self._size <= _KEPT else None
        self._all: tuple[Element, ...] | None = None  # where they are kept

    def __len__(self) -> int:
        return self._size

    def __iter__(self) -> Iterator[Element]:
        if self._made is None:
            return map(self._new, range(self._size))
        if self._all is None:
            self._all = tuple(map(self._element, range(self._size)))
        return iter(self._all)

    @overload
    def __getitem__(self, k: int) -> Element: ...

    @overload
    def __getitem__(self, k: slice) -> list[Element]: ...

    def __getitem__(self, k: int | slice) -> Element | list[Element]:
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(self._size))]
        if not -self._size <= k < self._size:
            raise IndexError(k)
        return self._element(k % self._size)

    @property
    def whole(self) -> Element:
        """All elements as one, for messages."""
        return Element(self._variable.name, self._variable, 0, self._timing)

    def element(self, name: str) -> Element | None:
        """The element of a name, as `m[2,3]`; None where there is none."""
        place = indices(name)
        if not self._shape or len(place) != len(self._shape):
            return None
        offset = 0
        for i, n in zip(place, self._shape, strict=True):
            if not 1 <= i <= n:
                return None
            offset = offset * n + i - 1
        element = self._element(offset)
        return element if element.name == name else None

    def _element(self, offset: int) -> Element:
        if self._made is None:
            return self._new(offset)
        element = self._made.get(offset)
        if element is None:
            element = self._made[offset] = self._new(offset)
        return element

    def _new(self, offset: int) -> Element:
        if not self._shape:
            return Element(self._variable.name, self._variable, 0, self._timing)
        place, rest = [], offset
        for n in reversed(self._shape):
            rest, i = divmod(rest, n)
            place.append(str(i + 1))
        return Element(f"{self._variable.name}[{','.join(reversed(place))}]", self._variable, offset, self._timing)


class Ports:
    """Finds the elements of one component's variables by name.

    Parameters
    ----------
    component : str
        Name of the component.
    description : ModelDescription
        Of this component alone: arrays get the sizes that they have in it.
    start : mapping, optional
        Start values of the component. Sizes of arrays follow those of structural parameters, intervals of clocks their
        own.
    """

    def __init__(self, component: str, description: ModelDescription, start: Mapping[str, Any] | None = None) -> None:
        self.component = component
        resize(description, start or {})
        set_intervals(description, start or {})
        self.uses_events = uses_events(description)
        self.is_model_exchange = is_model_exchange(description)
        timing = timing_in_model_exchange if self.is_model_exchange else timing_of if self.uses_events else _at_any_time
        self.description = description
        self._variables = {v.name: v for v in description.modelVariables}
        self._timing = {name: timing(variable) for name, variable in self._variables.items()}
        self._ambiguous = _ambiguous(description)
        self._arrays: dict[str, ElementArray] = {}
        self._vectors: dict[str, list[str]] = {}
        for name, variable in self._variables.items():
            if math.prod(variable.shape or ()) > MOST_ELEMENTS:
                shape = " x ".join(map(str, variable.shape))
                raise SetupError(f"'{component}.{name}' has {shape} elements, more than can be read ({MOST_ELEMENTS})")
            if not variable.shape and (match := _ELEMENT.match(name)):
                self._vectors.setdefault(match["vector"], []).append(name)
        for names in self._vectors.values():
            names.sort(key=indices)

    def of_another(self, component: str) -> Ports:
        """The variables of another component with the same FMU, whose description its start values do not change."""
        other = copy(self)
        other.component = component
        # computed once for all
        other.feedthrough, other._by_causality, other._units = self.feedthrough, self._by_causality, self._units
        return other

    def has(self, name: str) -> bool:
        """Whether there is a variable, or a vector of scalars, of this name."""
        return name in self._variables or name in self._vectors

    def find(self, name: str) -> Sequence[Element]:
        """Elements of a scalar, an element or a vector.

        Raises
        ------
        SetupError
            No variable has this name, or several have; the message offers the nearest one.
        """
        if name in self._ambiguous:
            raise SetupError(f"'{self.component}.{name}' is the name of several variables; export its FMU again")
        found: Sequence[Element] | None = None
        if name in self._variables:
            found = self.elements_of(name)
        elif name in self._vectors:
            found = [self.elements_of(scalar)[0] for scalar in self._vectors[name]]
        elif (match := _ELEMENT.match(name)) and match["vector"] in self._variables:
            element = self.elements_of(match["vector"]).element(name)
            found = None if element is None else [element]
        if found is None:
            hint = nearest(name, chain(self._vectors, self._variables))
            raise SetupError(f"component '{self.component}' has no variable '{name}'; {hint}")
        if not found:
            raise SetupError(f"'{self.component}.{name}' has no elements: its size is 0 by structural parameters")
        return found

    def elements_of(self, name: str) -> ElementArray:
        """Elements of the variable with this very name; one of a scalar."""
        found = self._arrays.get(name)
        if found is None:
            found = self._arrays[name] = ElementArray(self._variables[name], self._timing[name])
        return found

    def elements_in(self, names: Container[str]) -> list[Element]:
        """Elements of some variables, in the order of the model description."""
        return [element for name in self._variables if name in names for element in self.elements_of(name)]

    def all_elements(self) -> list[Element]:
        """All elements, in the order of the model description."""
        return [element for name in self._variables for element in self.elements_of(name)]

    def description_of(self, name: str) -> ModelVariable:
        """The variable with this very name."""
        return self._variables[name]

    def of_causality(self, causality: str) -> list[Element]:
        """All elements of one causality, in the order of the model description."""
        return [element for name in self.names_of(causality) for element in self.elements_of(name)]

    def names_of(self, causality: str) -> Sequence[str]:
        """Names of the variables of one causality, in the order of the model description."""
        return self._by_causality.get(causality, ())

    @property
    def variables(self) -> Mapping[str, ModelVariable]:
        """All variables by name, in the order of the model description."""
        return self._variables

    @cached_property
    def _by_causality(self) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for name, variable in self._variables.items():
            found.setdefault(variable.causality, []).append(name)
        return found

    @cached_property
    def feedthrough(self) -> dict[str, set[str]]:
        """For each output the inputs it depends on directly; an undeclared dependency counts as one on all inputs.

        A clocked one depends on its clocks.
        """
        inputs = {v.name for v in self.description.modelVariables if v.causality == "input"}
        clocked = self.clocked if self.uses_events else {}
        found = {
            unknown.variable.name: inputs
            if unknown.dependencies is None
            else {d.name for d in unknown.dependencies if d.name in inputs}
            | (clocked.get(unknown.variable.name, set()) & inputs)
            for unknown in self.description.outputs
        }
        aliases = {v.name: v.alias.name for v in self.description.modelVariables if is_alias(v)}
        return found | {alias: found[name] for alias, name in aliases.items() if name in found}

    def original(self, element: Element) -> Element:
        """The element that an element of an alias stands for; of others the element itself."""
        if not is_alias(element.variable):
            return element
        return self.elements_of(element.variable.alias.name)[element.offset]

    @cached_property
    def clocked(self) -> dict[str, set[str]]:
        """For each clocked variable its clocks."""
        return {v.name: {clock.name for clock in v.clocks} for v in self.description.modelVariables if v.clocks}

    def unit(self, element: Element) -> Unit | None:
        """Unit definition of an element, None where the FMU gives no unit."""
        variable = element.variable
        name = variable.unit
        if name is None and variable.declaredType is not None:
            name = variable.declaredType.unit
        return self._units.get(name)

    @cached_property
    def _units(self) -> dict[str | None, Unit]:
        return {unit.name: unit for unit in reversed(self.description.unitDefinitions)}

    def is_relative(self, element: Element) -> bool:
        """Whether an element is a difference, to which the offset of its unit does not apply.

        fmpy 0.3 reads `relativeQuantity` of declared types only.
        """
        declared = element.variable.declaredType
        return bool(element.variable.relativeQuantity or (declared is not None and declared.relativeQuantity))


def _at_any_time(_: ModelVariable) -> str:
    """Timing of the variables of an FMU whose events are its own."""
    return ""


def is_alias(variable: ModelVariable) -> bool:
    """FMI 3.0: whether a variable is another name of one."""
    return isinstance(variable.alias, ModelVariable)


def variables_of(elements: Iterable[Element]) -> list[ModelVariable]:
    """The variables that elements belong to, each once, in order."""
    if isinstance(elements, ElementArray):
        return [elements.whole.variable] if elements else []
    return list({e.variable.name: e.variable for e in elements}.values())


def indices(name: str) -> tuple[int, ...]:
    """Indices of an element `vector[1,2]`."""
    return tuple(int(i) for i in name[name.rindex("[") + 1 : -1].split(","))


def _ambiguous(description: ModelDescription) -> frozenset[str]:
    """Names that several variables have which are not the same."""
    first: dict[str, ModelVariable] = {}
    found = set()
    for variable in description.modelVariables:
        known = first.setdefault(variable.name, variable)
        if (known.valueReference, known.type) != (variable.valueReference, variable.type):
            found.add(variable.name)
    return frozenset(found)
