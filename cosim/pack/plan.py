"""The plan of a packed FMU: the master's table of operations, and all else that its library reads, as a text.

The table is made by the code that makes it for a run (`cosim.master.operations`), from instances that are none yet; the
library puts in addresses for names. How the words follow each other stands here and in plan.c.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from cosim.errors import SetupError
from cosim.fmi.fmu_file import LoadedFMU
from cosim.fmi.instance import Instance
from cosim.fmi.structure import is_structural
from cosim.fmi.types import FmiType, Texts
from cosim.loop.binding import Conversion, Extrapolated, OperationKind, Rates
from cosim.master.coupling.extrapolated_inputs import ExtrapolatedInputs
from cosim.master.coupling.starting_blocks import steps_of_block, why_no_block
from cosim.master.operations import Exchange, NamedOperation, OperationTable
from cosim.master.value_layout import ValueLayout
from cosim.pack.interface import Interface, PackedVariable, start_in_description
from cosim.pack.signals import SignalRows
from cosim.system.resolution import ResolvedSystem
from cosim.system.variables import Element, variables_of

#: Roles of variables, as in packed.h.
_EXCHANGED, _COLUMN, _START, _DIRECT, _MAX_STEP = range(5)

#: When a start value is set, as in packed.h.
_STRUCTURAL, _BEFORE = 0, 1

#: Code of texts, as in loop.h.
_POINTER = 64

#: How many arrays of positions an operation has, of `n_targets` each; the others have two.
_ARRAYS = {
    OperationKind.GET: 1,
    OperationKind.EXTRAPOLATE: 1,
    OperationKind.STEP: 0,
    OperationKind.TRANSFORM: 3,
}

#: Operations whose data are a buffer of values.
_EXCHANGES = (OperationKind.SET, OperationKind.GET)


@dataclass(frozen=True)
class PackedComponent:
    """A component in a packed FMU: its FMU file, and its folder below the resources."""

    name: str
    fmu: LoadedFMU
    folder: str
    beside: tuple[str, ...] = ()


class _NoInstance:
    """Stands for an instance that the packed FMU will make."""

    def __init__(self, version: int, number: int, texts: Texts) -> None:
        self.version, self.address, self.texts = version, number, texts

    def function_address(self, name: str) -> int:  # noqa: ARG002 -- as an instance's
        """No address: the library knows it."""
        return 0

    def code_of_call(self, name: str) -> int:  # noqa: ARG002
        """No code: the library notes no calls."""
        return 0

    def let_ask_for_inputs(self, operation: Any) -> None:
        """The library finds what answers."""


@dataclass(frozen=True)
class _Start:
    """Start values of a variable of a component, as the library sets them."""

    component: str
    element: Element
    values: tuple[Any, ...]
    given: bool


class Plan:
    """Everything that the library of a packed FMU reads.

    Parameters
    ----------
    resolved : ResolvedSystem
        With a drive for each input of the packed FMU, in their order, behind those of the system's own signals.
    extrapolated, layout : ExtrapolatedInputs, ValueLayout
        Of it.
    components : sequence of PackedComponent
    interface : Interface
    tables : sequence of SignalRows
        Of the system's own signals.
    texts : Texts
        Texts of the system.
    version : {2, 3}
        Of FMI of the packed FMU.
    """

    def __init__(
        self,
        resolved: ResolvedSystem,
        extrapolated: ExtrapolatedInputs,
        layout: ValueLayout,
        components: Sequence[PackedComponent],
        interface: Interface,
        tables: Sequence[SignalRows],
        texts: Texts,
        version: int,
    ) -> None:
        self._version = version
        self._resolved, self._extrapolated, self._layout = resolved, extrapolated, layout
        self._components, self._interface, self._tables, self._texts = components, interface, tables, texts
        self._number = {component.name: i for i, component in enumerate(components)}
        self._fmus = {component.name: component.fmu for component in components}
        instances = {
            c.name: _NoInstance(c.fmu.description.fmiMajorVersion, i + 1, texts) for i, c in enumerate(components)
        }
        needed = steps_of_block(resolved, extrapolated)
        self._steps_of_block = 0 if why_no_block(resolved, ()) else needed
        self._exchange = Exchange(
            resolved,
            cast(Mapping[str, Instance], instances),
            extrapolated,
            layout,
            steps_of_block=self._steps_of_block,
        )
        self._starts = list(self._all_starts())
        self._place = {(s.component, s.element.variable.name): i for i, s in enumerate(self._starts)}

    def text(self, token: str, max_step: float) -> bytes:
        """The plan, of an FMU with an instantiation token, and with a longest internal communication step (s)."""
        every = [component.every for component in self._resolved.components.values()]
        tables = (self._exchange.at_start, self._exchange.at_point, self._exchange.at_step)
        variables = self._interface.variables
        directs = [v for v in variables if self._is_direct(v)]
        slots = sum(len(s.values) for s in self._starts)
        text_slots = list(self._text_slots())
        lines: list[list[Any]] = [
            ["cosim-pack", "1"],
            [_text(token)],
            [
                *(len(self._components), self._layout.size, len(self._layout.columns), len(self._starts), slots),
                *(len(variables), len(directs), len(self._tables), *(len(table) for table in tables)),
                len(text_slots),
            ],
            [
                _real(max_step),
                max(*every, self._steps_of_block),
                math.lcm(*every),
                self._steps_of_block,
                int(not self._extrapolated.algorithm.order.needs_levels),
            ],
            *(self._component(c) for c in self._components),
            *(self._start(s) for s in self._starts),
            *self._columns(),
            *(self._signal(i, table) for i, table in enumerate(self._tables)),
            *(self._direct(v) for v in directs),
            *(self._variable(v, directs) for v in variables),
            [_text(name) for name in self._names_of_values()],
            text_slots,
            *(self._operation(row, operation) for table in tables for row, operation in _rows(table)),
            ["end"],
        ]
        return "".join(" ".join(map(str, line)) + "\n" for line in lines).encode()

    # Components and their start values

    def _component(self, component: PackedComponent) -> list[Any]:
        description = component.fmu.description
        interface = description.coSimulation
        tolerance = component.fmu.tolerance
        asks = [v.valueReference for v in variables_of(self._extrapolated.elements.get(component.name, ()))]
        return [
            *("component", _text(component.name), description.fmiMajorVersion, _text(interface.modelIdentifier)),
            *(_text(component.folder), _text(description.instantiationToken), int(component.fmu.resets_completely)),
            int(interface.canHandleVariableCommunicationStepSize),
            *(int(tolerance is not None), _real(tolerance or 0.0)),
            *(len(asks), *asks, len(component.beside), *map(_text, component.beside)),
        ]

    def _all_starts(self) -> Iterator[_Start]:
        """Start values that the system gives, in its order, then those of the parameters that an importer may set."""
        given: dict[tuple[str, str], dict[int, Any]] = {}
        elements: dict[tuple[str, str], Element] = {}
        for start in self._resolved.starts:
            for element, value in zip(start.elements, start.values, strict=True):
                key = (start.component, element.variable.name)
                given.setdefault(key, {})[element.offset] = value
                elements[key] = element
        for (component, name), values in given.items():
            element = elements[component, name]
            whole = start_in_description(element.variable)
            for offset, value in values.items():
                whole[offset] = value
            if element.kind == "binary":
                raise SetupError(
                    f"start value of '{component}.{name}': packed FMUs can't set binary values; leave it out"
                )
            if element.kind == "string" and len(values) < len(whole):
                raise SetupError(f"start value of '{component}.{name}': give all elements of an array of texts")
            yield _Start(component, element, tuple(whole), given=True)
        seen = set(given)
        for packed in self._interface.parameters:
            if packed.element is None or (key := (packed.component, packed.element.variable.name)) in seen:
                continue
            seen.add(key)
            values_in_description = tuple(start_in_description(packed.element.variable))
            yield _Start(packed.component, packed.element, values_in_description, given=False)

    def _start(self, start: _Start) -> list[Any]:
        version = self._fmus[start.component].description.fmiMajorVersion
        element = start.element
        suffix = element.type.functions[version][0]
        code = element.type.code(version)
        return [
            *("start", self._number[start.component], _STRUCTURAL if is_structural(element.variable) else _BEFORE),
            *(int(start.given), int(element.is_tunable), code),
            *(_text(f"fmi{version}Set{suffix}"), _text(f"fmi{version}Get{suffix}"), element.variable.valueReference),
            *(len(start.values), *(_value(element.type, v) for v in start.values)),
        ]

    # Samples

    def _columns(self) -> Iterator[list[Any]]:
        inputs = iter(self._interface.inputs)
        for number, drive in enumerate(self._resolved.drives):
            for i, element in enumerate(drive.targets):
                code = 0 if element.kind == "real" else _POINTER if element.type.is_text else 16
                if number < len(self._tables):
                    zero: Any = 0.0 if code == 0 else "" if code == _POINTER else 0
                    yield ["column", number, i, code, drive.every, _value(element.type, zero)]
                else:
                    yield ["column", -1, 0, code, drive.every, _value(element.type, next(inputs).start)]

    def _signal(self, number: int, table: SignalRows) -> list[Any]:
        drive = self._resolved.drives[number]
        kind = drive.targets[0].type
        code = 0 if kind.kind == "real" else _POINTER if kind.is_text else 16
        values = kind.from_slots(np.ascontiguousarray(table.slots), self._texts)
        return [
            *("signal", table.between, code, len(drive.targets)),
            *(len(table.breakpoints), *map(_real, table.breakpoints)),
            *(len(table.times), *map(_real, table.times.tolist())),
            *(_value(kind, v) for v in values.ravel().tolist()),
        ]

    # Variables

    @staticmethod
    def _is_direct(variable: PackedVariable) -> bool:
        return variable.causality == "output" and variable.type == "String"

    def _direct(self, variable: PackedVariable) -> list[Any]:
        element = variable.element
        assert element is not None
        version = self._fmus[variable.component].description.fmiMajorVersion
        getter = f"fmi{version}Get{element.type.functions[version][0]}"
        n = math.prod(element.variable.shape or ())
        return ["direct", self._number[variable.component], _text(getter), element.variable.valueReference, n]

    def _variable(self, variable: PackedVariable, directs: Sequence[PackedVariable]) -> list[Any]:
        element = variable.element
        if element is None:
            role, where, offset = _MAX_STEP, 0, 0
        elif variable.causality == "input":
            role, where, offset = _COLUMN, self._layout.columns[variable.component, element.name], 0
        elif variable.causality == "parameter":
            role, where, offset = _START, self._place[variable.component, element.variable.name], element.offset
        elif self._is_direct(variable):
            role, where, offset = _DIRECT, directs.index(variable), element.offset
        else:
            role, where, offset = _EXCHANGED, self._layout.positions[variable.component, element.name], 0
        smallest, largest = -math.inf, math.inf
        if element is not None and element.kind not in ("real", "string"):
            smallest = -math.inf if element.type.smallest is None else float(element.type.smallest)
            largest = math.inf if element.type.largest is None else float(element.type.largest)
        return [
            *("variable", _text(variable.name), variable.number_of_type(self._version), role, where, offset),
            *(_real(smallest), _real(largest)),
        ]

    def _names_of_values(self) -> list[str]:
        names = [""] * self._layout.size
        for positions in (self._layout.added, self._layout.positions):
            for (component, name), position in positions.items():
                names[position] = f"{component}.{name}"
        for (component, name), position in self._layout.rates.items():
            names[position] = f"{component}.der({name})"
        return names

    def _text_slots(self) -> Iterator[int]:
        """Which of the library's numbers are texts: values, inputs, their rates, start values follow each other."""
        for (component, name), position in self._layout.positions.items():
            (element,) = (e for e in self._resolved.ports[component].find(name) if e.name == name)
            if element.type.is_text:
                yield position
        for (component, name), column in self._layout.columns.items():
            (element,) = (e for e in self._resolved.ports[component].find(name) if e.name == name)
            if element.type.is_text:
                yield self._layout.size + column
        first = self._layout.size + 2 * len(self._layout.columns)
        for start in self._starts:
            if start.element.type.is_text:
                yield from range(first, first + len(start.values))
            first += len(start.values)

    # Operations

    def _operation(self, row: NamedOperation, operation: Any) -> list[Any]:
        kind = OperationKind(operation.kind)
        n, n_references = operation.n_targets, operation.n_references
        targets = {
            OperationKind.GET: 1,
            OperationKind.EXTRAPOLATE: 1,
            OperationKind.DIFFERENTIATE: 1,
            OperationKind.STEP: 0,
            OperationKind.TRANSFORM: 3,
        }
        n_all = n * targets.get(kind, 2)
        is_text = kind in _EXCHANGES and operation.type == _POINTER
        buffer = operation.n * (operation.type & 0xF) if kind in _EXCHANGES and operation.data and not is_text else 0
        return [
            # texts go by functions of the library, which are as those of FMI 3.0
            *("operation", int(kind), operation.type, 3 if is_text else operation.version, operation.more),
            *(operation.every, self._number[row.component], _text(row.function), operation.first, operation.n),
            *(n_references, *(operation.references[:n_references] if n_references else ())),
            *(n, n_all, *(operation.targets[:n_all] if n_all else ()), buffer),
            *self._data(kind, operation),
        ]

    @staticmethod
    def _data(kind: OperationKind, operation: Any) -> list[Any]:
        n = operation.n_targets
        if kind == OperationKind.TRANSFORM:
            numbers = (ctypes.c_double * (2 * n)).from_address(operation.data)
            return [_real(number) for number in numbers]
        if kind == OperationKind.CONVERT:
            conversions = (Conversion * n).from_address(operation.data)
            return [
                word for each in conversions for word in (getattr(each, "from"), each.to, each.smallest, each.largest)
            ]
        if kind == OperationKind.EXTRAPOLATE:
            inputs = Extrapolated.from_address(operation.data)
            degree, points, rates = inputs.degree, inputs.points, bool(inputs.rates)
            weights = inputs.weights[: (1 + rates) * points * degree * points]
            more = [int(rates), int(bool(inputs.watched)), int(bool(inputs.ahead)), inputs.first_rate]
            return [degree, points, *more, *inputs.orders[: operation.n_references], *map(_real, weights)]
        if kind == OperationKind.DIFFERENTIATE:
            through = Rates.from_address(operation.data)
            m = through.n
            fed_through = [*through.knowns[:m], *through.positions[:m]] if m else []
            return [*through.orders[: operation.n], m, *fed_through]
        return []


def _rows(table: OperationTable) -> Iterable[tuple[NamedOperation, Any]]:
    return zip(table.rows, table.operations, strict=True)


#: Characters that texts have escapes for.
_PLAIN = frozenset("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._-[](){}/,;:@+*=#'\"<>!?&|~^$")


def _text(text: str) -> str:
    return ":" + "".join(c if c in _PLAIN else "".join(f"%{byte:02x}" for byte in c.encode()) for c in text)


def _real(number: float) -> str:
    return float(number).hex()


def _value(kind: FmiType, value: Any) -> str | int:
    """A value as its slot is written."""
    if kind.is_text:
        return _text(value)
    return _real(value) if kind.kind == "real" else int(value)
