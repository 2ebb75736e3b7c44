"""The functions of an OSP configuration: linear transformations, and sums of numbers or of vectors."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any
from xml.etree import ElementTree

import numpy as np

from cosim.errors import nearest
from cosim.files.xml_elements import local_name
from cosim.osp.errors import OSPError
from cosim.osp.parsing import attribute, number
from cosim.system.read import Findings
from cosim.system.system import System

#: Sums of more values are refused, before names of their inputs fill the memory.
_MOST_VALUES = 1_000_000


@dataclass
class Function:
    """A function with its signals, and the variables that are connected to them.

    Attributes
    ----------
    kind, name : str
    factor, offset : float
        Of a linear transformation.
    count, dimension : int
        Inputs, and elements of each.
    sources : dict
        Index of input and element -> variable that feeds it.
    targets : list
        Element of the output, and variable that it feeds.
    """

    kind: str
    name: str
    factor: float = 1.0
    offset: float = 0.0
    count: int = 1
    dimension: int = 1
    sources: dict[tuple[int, int], str] = field(default_factory=dict)
    targets: list[tuple[int, str]] = field(default_factory=list)

    def signals(self) -> list[str]:
        """Names of its signals and groups of signals."""
        inputs = ["in"] if self.kind == "LinearTransformation" else [f"in[{i}]" for i in range(self.count)]
        if self.kind != "VectorSum":
            return [*inputs, "out"]
        names = [*inputs, "out"]
        return [*names, *(f"{n}[{j}]" for n in names for j in range(self.dimension))]

    def connect(self, signal: str, variables: list[str], *, gives: bool, here: str) -> None:
        """Connect variables with a signal, or with a group of signals.

        Parameters
        ----------
        signal : str
        variables : list of str
        gives : bool
            Values come out of the variables.
        here : str
            For messages.

        Raises
        ------
        OSPError
            There is no such signal, or values can't go this way.
        """
        if signal not in self.signals():
            raise OSPError(f"{here}: {self.kind} '{self.name}' has no signal '{signal}'; {self._known(signal)}")
        is_output = signal.startswith("out")
        if is_output == gives:
            ends = "outputs" if gives else "inputs"
            raise OSPError(f"{here}: both ends are {ends}; one end must give values, the other take them")
        numbers = [int(n) for n in re.findall(r"\d+", signal)]
        index = 0 if is_output or not numbers else numbers.pop(0)
        first = numbers.pop(0) if numbers else 0
        whole = self.kind == "VectorSum" and signal.count("[") == (0 if is_output else 1)
        size = self.dimension if whole else 1
        if len(variables) != size:
            raise OSPError(f"{here}: {len(variables)} variables can't be connected to {size}; correct their numbers")
        for element, variable in enumerate(variables, first):
            if is_output:
                self.targets.append((element, variable))
            elif self.sources.setdefault((index, element), variable) != variable:
                raise OSPError(f"{here}: '{signal}' of '{self.name}' is fed twice; remove one of the connections")

    def _known(self, signal: str) -> str:
        return nearest(signal, self.signals())

    def add_to(self, system: System, here: str, findings: Findings) -> Iterator[tuple[str, str, float, float]]:
        """Add it to a system: as a component where it sums; gives the connections that it stands for.

        Yields
        ------
        source, target : str
        factor, offset : float
        """
        missing = [
            self._signal(i, j) for i in range(self.count) for j in range(self.dimension) if (i, j) not in self.sources
        ]
        if missing:
            findings.problem(f"{here}: nothing feeds {', '.join(missing[:5])} of {self.kind} '{self.name}'; connect it")
            return
        if not self.targets:
            findings.note(f"{here}: {self.kind} '{self.name}' feeds nothing and is left out")
            return
        if self.kind == "LinearTransformation":
            yield from ((self.sources[0, 0], target, self.factor, self.offset) for _, target in self.targets)
        elif self.count == 1:  # a sum of one
            yield from ((self.sources[0, j], target, 1.0, 0.0) for j, target in self.targets)
        else:
            size: Any = self.dimension if self.kind == "VectorSum" else None
            system.add_function(
                self.name, _sum, inputs={f"in_{i}": size for i in range(self.count)}, outputs={"out": size}
            )
            for (i, j), source in self.sources.items():
                yield source, self._variable(f"in_{i}", j), 1.0, 0.0
            for j, target in self.targets:
                yield self._variable("out", j), target, 1.0, 0.0

    def _variable(self, name: str, element: int) -> str:
        return f"{self.name}.{name}" + (f"[{element + 1}]" if self.kind == "VectorSum" else "")

    def _signal(self, index: int, element: int) -> str:
        if self.kind == "LinearTransformation":
            return "in"
        return f"in[{index}][{element}]" if self.kind == "VectorSum" else f"in[{index}]"


def _sum(time: float, *inputs: Any) -> Any:  # noqa: ARG001
    return np.sum(inputs, axis=0)


def read_function(element: ElementTree.Element, here: str) -> Function:
    """A function of a configuration.

    Raises
    ------
    OSPError
        It is of a kind that is not known, or malformed.
    """
    kind = local_name(element)
    name = attribute(element, "name", here)
    where = f"{here}: {kind} '{name}'"

    def size(key: str) -> int:
        value = number(attribute(element, key, here), f"{where}: {key}")
        if not (value.is_integer() and value >= 1):
            raise OSPError(f"{where}: {key} is {value!r}; it must be a positive whole number")
        return int(value)

    if kind == "LinearTransformation":
        factor, offset = (number(element.get(k, d), f"{where}: {k}") for k, d in (("factor", "1"), ("offset", "0")))
        return Function(kind, name, factor, offset)
    if kind not in ("Sum", "VectorSum"):
        raise OSPError(f"{where} is a function that is not known; known are LinearTransformation, Sum and VectorSum")
    count, dimension = size("inputCount"), size("dimension") if kind == "VectorSum" else 1
    if count * dimension > _MOST_VALUES:
        raise OSPError(f"{where} has {count * dimension} inputs, more than any system needs")
    return Function(kind, name, count=count, dimension=dimension)
