"""The variables of an FMU under the names users write: scalars, elements and whole vectors.

FMI 2.0 knows scalars only, of which `tau_a[1]`, `tau_a[2]`, ... make up the vector `tau_a`; FMI 3.0 has arrays, whose
elements get the same names here. So both versions answer to the same names.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

from fmpy.model_description import ModelDescription, ModelVariable, Unit

from cosim.errors import ArgumentError, SetupError, nearest
from cosim.fmi.event_mode import CLOCK, DISCRETE, set_intervals, timing_of, uses_events
from cosim.fmi.interfaces import is_model_exchange
from cosim.fmi.model_exchange import timing_in_model_exchange
from cosim.fmi.structure import resize
from cosim.fmi.types import FMI_TYPES, FmiType

_ELEMENT = re.compile(r"(?P<vector>.+)\[\d+(,\d+)*\]$")


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
                raise ArgumentError(f"{value!r} is no value of type {self.variable.type}; {nearest(value, self.words)}")
            return self.type.value(self.words[value])
        known = self.type.value(value)
        if self.kind == "enumeration" and self.items and known not in self.items.values():
            numbers = ", ".join(f"{name} = {number}" for name, number in self.items.items())
            raise ArgumentError(f"{value!r} is no item of the enumeration, which has {numbers}")
        return known


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
        self._elements: dict[str, Element] = {}
        self._variables = {v.name: v for v in description.modelVariables}
        self._vectors: dict[str, list[Element]] = {}
        for variable in description.modelVariables:
            for element in _elements_of(variable, timing(variable)):
                self._elements[element.name] = element
                match = _ELEMENT.match(element.name)
                if match:
                    self._vectors.setdefault(match["vector"], []).append(element)
        for elements in self._vectors.values():
            elements.sort(key=lambda e: indices(e.name))

    def of_another(self, component: str) -> Ports:
        """The variables of another component with the same FMU, whose description its start values do not change."""
        other = copy(self)
        other.component = component
        # computed once for all
        other.feedthrough, other._by_causality, other._units = self.feedthrough, self._by_causality, self._units
        return other

    def find(self, name: str) -> list[Element]:
        """Elements of a scalar, an element or a vector.

        Raises
        ------
        SetupError
            No variable has this name; the message offers the nearest one.
        """
        if name in self._elements:
            return [self._elements[name]]
        if name in self._vectors:
            return self._vectors[name]
        if name in self._variables:
            raise SetupError(f"'{self.component}.{name}' has no elements: its size is 0 by structural parameters")
        hint = nearest(name, [*self._vectors, *self._elements])
        raise SetupError(f"component '{self.component}' has no variable '{name}'; {hint}")

    def all_elements(self) -> list[Element]:
        """All elements, in the order of the model description."""
        return list(self._elements.values())

    def description_of(self, name: str) -> ModelVariable:
        """The variable with this very name."""
        return self._variables[name]

    def of_causality(self, causality: str) -> list[Element]:
        """All elements of one causality, in the order of the model description."""
        return list(self._by_causality.get(causality, ()))

    @cached_property
    def _by_causality(self) -> dict[str, list[Element]]:
        found: dict[str, list[Element]] = {}
        for element in self._elements.values():
            found.setdefault(element.variable.causality, []).append(element)
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
        variable = element.variable.alias
        return next(e for e in self._elements.values() if e.variable is variable and e.offset == element.offset)

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
    return list({e.variable.name: e.variable for e in elements}.values())


def indices(name: str) -> tuple[int, ...]:
    """Indices of an element `vector[1,2]`."""
    return tuple(int(i) for i in name[name.rindex("[") + 1 : -1].split(","))


def _elements_of(variable: ModelVariable, timing: str) -> list[Element]:
    shape = variable.shape or ()
    if not shape:
        return [Element(variable.name, variable, 0, timing)]
    all_indices = product(*(range(1, n + 1) for n in shape))
    return [
        Element(f"{variable.name}[{','.join(map(str, i))}]", variable, k, timing) for k, i in enumerate(all_indices)
    ]
