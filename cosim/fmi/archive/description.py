"""Checks of a model description beyond what fmpy looks at: what it would wrap, overwrite, or stumble over."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING

from cosim.fmi.archive.findings import FileFindings, quoted
from cosim.terminal import printable

if TYPE_CHECKING:
    from lxml.etree import _Element

#: Model descriptions with more variables, and arrays with more elements, are refused.
MOST_VARIABLES, MOST_ELEMENTS = 500_000, 100_000_000

_ROOT = "fmiModelDescription"

_TYPES_OF_FMI_2 = frozenset({"Real", "Integer", "Boolean", "String", "Enumeration"})
_INTEGERS = tuple(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64))
_TYPES_OF_FMI_3 = frozenset({"Float32", "Float64", *_INTEGERS, "Boolean", "String", "Binary", "Enumeration", "Clock"})

#: Variables that a master sets, gets or records by default: two of one name would be taken for each other.
_EXCHANGED = frozenset({"input", "output", "parameter", "structuralParameter", "calculatedParameter"})

#: Names by the convention "structured" of FMI.
_BASE = r"(?:[A-Za-z_]\w*|'(?:[^'\\]|\\.)+')"
_INDEXED = rf"{_BASE}(?:\[\d+(?:,\d+)*\])?"
_STRUCTURED = re.compile(
    rf"{_INDEXED}(?:\.{_INDEXED})*|der\({_INDEXED}(?:\.{_INDEXED})*(?:,\d+)?\)(?:\[\d+(?:,\d+)*\])?", re.ASCII
)

_BOOLEANS = frozenset({"true", "false", "1", "0"})

#: Attributes that are whole numbers, wherever they stand.
_WHOLE = (
    "numberOfContinuousStates",
    "numberOfEventIndicators",
    "maxOutputDerivativeOrder",
    "recommendedIntermediateInputSmoothness",
    "previous",
    "priority",
    "resolution",
    "intervalCounter",
    "shiftCounter",
)

#: Attributes that are real numbers.
_REAL = ("fixedInternalStepSize", "intervalDecimal", "shiftDecimal")

_NUMBERS = frozenset({*_WHOLE, *_REAL})

_EXPONENTS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


def check_description(root: _Element) -> FileFindings:
    """Findings in a model description; texts begin with where it is.

    Parameters
    ----------
    root : Element
        Of its XML.
    """
    found = FileFindings()
    _check_root(root, found)
    if not found.wrong:
        _Description(root, found).check()
    return found


def _check_root(root: _Element, found: FileFindings) -> None:
    namespace, _, name = str(root.tag).rpartition("}")
    if name != _ROOT:
        found.add(wrong=f"its root element is {quoted(name)}, not {_ROOT}; it is not an FMU")
    elif namespace:
        found.add(
            wrong=f"its elements are in the namespace {quoted(namespace[1:])}, and those of FMI have none; correct it"
        )
    elif not root.get("fmiVersion"):
        found.add(wrong="it has no fmiVersion; export it again")
    elif re.fullmatch(r"1\.0|2\.0|3\.\d.*", root.get("fmiVersion", "")) is None:
        found.add(wrong=f"it is of FMI {quoted(root.get('fmiVersion'))}; FMI 1.0, 2.0 and 3.0 can be read")
    elif root.find("ModelVariables") is None:
        found.add(wrong="it has no ModelVariables; export it again")


class _Description:
    def __init__(self, root: _Element, found: FileFindings) -> None:
        self.root = root
        self.found = found
        self.version = int(root.get("fmiVersion", "")[0])
        self.variables: list[_Element] = list(root.iterfind("ModelVariables/*"))

    def check(self) -> None:
        """Check everything."""
        if len(self.variables) > MOST_VARIABLES:
            self.found.add(wrong=f"it has {len(self.variables)} variables, more than any FMU needs; not read")
            return
        self._check_interfaces()
        self._check_numbers()
        self._check_units()
        self._check_types()
        self._check_variables()
        if not self.found.wrong:
            self._check_names()
            self._check_structure()
            self._check_dimensions()

    def _at(self, element: _Element) -> str:
        return f"line {element.sourceline}"

    def _check_interfaces(self) -> None:
        token = "instantiationToken" if self.version == 3 else "guid"
        if not self.root.get("modelName"):
            self.found.add(unclean="it has no modelName")
        if self.root.get(token) is None:
            self.found.add(wrong=f"it has no {token}, by which the library knows its description; export it again")
        for name in ("CoSimulation", "ModelExchange", "ScheduledExecution") if self.version > 1 else ():
            elements = self.root.findall(name)
            if len(elements) > 1:
                self.found.add(wrong=f"{self._at(elements[1])}: there is a second {name}; remove one")
            for element in elements:
                if not element.get("modelIdentifier"):
                    self.found.add(wrong=f"{self._at(element)}: {name} has no modelIdentifier; export it again")
        if self.version == 1 and not self.root.get("modelIdentifier"):
            self.found.add(wrong="it has no modelIdentifier; export it again")

    def _check_numbers(self) -> None:
        """Attributes that are numbers, but for those of variables, units and types."""
        holders = (self.root, *(e for e in self.root if e.tag not in ("ModelVariables", "ModelStructure")))
        for element in holders:
            self._check_attributes(element, _WHOLE, _is_whole, "a whole number")
            self._check_attributes(element, _REAL, _is_finite, "a finite number")
        for element in self.root.iterfind("DefaultExperiment"):
            for name in ("startTime", "stopTime", "stepSize"):
                text = element.get(name)
                if text is not None and not _is_finite(text):
                    at = f"{self._at(element)}: its default experiment has {name}={quoted(text)}"
                    self.found.add(wrong=f"{at}, which is not a number; export it again")
            if not self.found.wrong:
                self._check_experiment(element)

    def _check_experiment(self, element: _Element) -> None:
        start, stop = float(element.get("startTime", "0")), element.get("stopTime")
        if stop is not None and float(stop) <= start:
            self.found.add(unclean=f"{self._at(element)}: its default experiment stops at {stop}, not after its start")
        if float(element.get("stepSize", "1")) <= 0.0:
            self.found.add(unclean=f"{self._at(element)}: its default experiment has a step that is not positive")

    def _check_attributes(
        self, element: _Element, names: tuple[str, ...], right: Callable[[str], bool], what: str
    ) -> None:
        for name in names:
            text = element.get(name)
            if text is not None and not right(text):
                at = f"{self._at(element)}: {element.tag} has {name}={quoted(text)}"
                self.found.add(wrong=f"{at}, which is not {what}; export it again")

    def _check_units(self) -> None:
        names = Counter(unit.get("name") for unit in self.root.iterfind("UnitDefinitions/Unit"))
        for name, number in names.items():
            if number > 1:
                self.found.add(unclean=f"unit {quoted(name)} is defined {number} times")
        for base in self.root.iterfind("UnitDefinitions/Unit/BaseUnit"):
            self._check_attributes(base, _EXPONENTS, _is_whole, "a whole number")
            for name in ("factor", "offset"):
                text = base.get(name)
                if text is not None and (not _is_finite(text) or (name == "factor" and float(text) == 0.0)):
                    unit = quoted(base.getparent().get("name"))
                    what = f"unit {unit} has {name}={quoted(text)}, by which no value can be converted"
                    self.found.add(wrong=f"{self._at(base)}: {what}; export it again")
        for display in self.root.iterfind("UnitDefinitions/Unit/DisplayUnit"):
            for name in ("factor", "offset"):
                text = display.get(name)
                if text is not None and not _is_number(text):
                    at = f"{self._at(display)}: a display unit has {name}={quoted(text)}"
                    self.found.add(wrong=f"{at}, which is not a number; export it again")

    def _check_types(self) -> None:
        for item in self.root.iterfind("TypeDefinitions//Item"):
            if self.version > 1 and not _is_whole(item.get("value", "")):
                self.found.add(
                    wrong=f"{self._at(item)}: an item of an enumeration has value={quoted(item.get('value', ''))}, "
                    "which is not a whole number; export it again"
                )
        if self.version < 3:
            for kind in self.root.iterfind("TypeDefinitions/*"):
                if len(kind) == 0:
                    at = f"{self._at(kind)}: type {quoted(kind.get('name'))}"
                    self.found.add(wrong=f"{at} has no element that says which it is; export it again")

    def _check_variables(self) -> None:
        known = _TYPES_OF_FMI_3 if self.version == 3 else _TYPES_OF_FMI_2
        for variable in self.variables:
            if not variable.get("name"):
                self.found.add(wrong=f"{self._at(variable)}: a variable has no name; export it again")
                continue
            reference = variable.get("valueReference", "")
            if not _is_whole(reference) or not 0 <= int(reference) < 2**32:
                what = f"has valueReference={quoted(reference)}, which is not a whole number below 2^32"
                self.found.add(wrong=f"{self._here(variable)} {what}; export it again")
            typed = self._typed(variable)
            if typed is None or typed.tag not in known:
                tag = variable.tag if typed is None else typed.tag
                what = f"is of type {quoted(tag)}" if self.version == 3 else "has no type"
                what += f", which FMI {self.version}.0 does not have; export it again"
                self.found.add(wrong=f"{self._here(variable)} {what}")
                continue
            if not _NUMBERS.isdisjoint(variable.keys()):
                self._check_attributes(variable, _WHOLE, _is_whole, "a whole number")
                self._check_attributes(variable, _REAL, _is_finite, "a finite number")
            starts = [typed.get("start"), *(s.get("value") for s in typed.iterfind("Start") if typed.tag == "Binary")]
            for start in starts:
                if start is not None:
                    self._check_start(variable, str(typed.tag), start)

    def _here(self, variable: _Element) -> str:
        return f"{self._at(variable)}: variable {quoted(variable.get('name'))}"

    def _typed(self, variable: _Element) -> _Element | None:
        """The element that says the type of a variable."""
        if self.version == 3:
            return variable
        return next((child for child in variable if child.tag in _TYPES_OF_FMI_2), None)

    def _check_start(self, variable: _Element, kind: str, text: str) -> None:
        """Start values that are none; the FMU has its own, and most masters never look at these."""
        right = _RIGHT.get(kind)
        if right is None:
            return
        words = text.split() if self.version == 3 else [text.strip()]
        wrong = next((word for word in words if not right(word)), None)
        if wrong is not None:
            self.found.add(
                unclean=f"{self._here(variable)} has the start value {quoted(wrong)}, which is not of type {kind}"
            )

    def _check_names(self) -> None:
        """Names that several variables have; which one is meant, nobody can say."""
        by_name: dict[str, _Element] = {}
        structured = self.root.get("variableNamingConvention") == "structured"
        for name, variable in self._named():
            if structured and not _STRUCTURED.fullmatch(name):
                self.found.add(unclean=f"{self._at(variable)}: variable {quoted(name)} has no structured name")
            elif not structured and (printable(name) != name or "\n" in name or "\t" in name):
                self.found.add(
                    unclean=f"{self._at(variable)}: variable {quoted(name)} has a character that can't be seen"
                )
            first = by_name.setdefault(name, variable)
            if first is variable:
                continue
            text = f"{self._at(variable)}: there are two variables named {quoted(name)}"
            if self._identity(first) == self._identity(variable):
                self.found.add(unclean=text)
            elif {first.get("causality"), variable.get("causality")} & _EXCHANGED:
                self.found.add(wrong=f"{text}; export it with one name for each")
            else:
                self.found.add(unclean=text)

    def _named(self) -> Iterator[tuple[str, _Element]]:
        for variable in self.variables:
            yield variable.get("name", ""), variable
            for alias in variable.iterfind("Alias"):
                yield alias.get("name", ""), alias

    def _identity(self, variable: _Element) -> tuple[object, ...]:
        typed = self._typed(variable)
        return variable.get("valueReference"), None if typed is None else typed.tag

    def _check_structure(self) -> None:
        """References of the model structure and of derivatives: indices from 1 in FMI 2.0, value references in 3.0."""
        if self.version == 1:
            return
        references = {int(v.get("valueReference", "")) for v in self.variables}
        known: Callable[[int], bool] = references.__contains__
        if self.version == 2:
            known = range(1, len(self.variables) + 1).__contains__
        which = "index" if self.version == 2 else "valueReference"
        for unknown in self.root.iterfind("ModelStructure/*/Unknown" if self.version == 2 else "ModelStructure/*"):
            for text in (unknown.get(which, ""), *unknown.get("dependencies", "").split()):
                if not _is_whole(text) or not known(int(text)):
                    at = f"{self._at(unknown)}: its ModelStructure refers to variable {quoted(text)}"
                    n = len(self.variables)
                    self.found.add(wrong=f"{at} of {n}, which there is not; export it again")
        for variable in self.variables:
            typed = self._typed(variable)
            text = None if typed is None else typed.get("derivative")
            texts = [text] if text is not None else []
            if self.version == 3:
                texts += variable.get("clocks", "").split()
            for text in texts:
                if not _is_whole(text) or not known(int(text)):
                    at = f"{self._at(variable)}: variable {quoted(variable.get('name'))} refers to variable"
                    self.found.add(wrong=f"{at} {quoted(text)}, which there is not; export it again")

    def _check_dimensions(self) -> None:
        if self.version < 3:
            return
        by_reference: dict[str, list[_Element]] = {}
        for variable in self.variables:
            by_reference.setdefault(variable.get("valueReference", "").strip(), []).append(variable)
        for variable in self.variables:
            sizes = [self._size(d, variable, by_reference) for d in variable.iterfind("Dimension")]
            here = f"{self._at(variable)}: array {quoted(variable.get('name'))}"
            words = variable.get("start", "").split() if variable.tag not in ("String", "Binary") else []
            if sizes and None not in sizes and len(words) not in (0, 1, math.prod(size or 0 for size in sizes)):
                self.found.add(unclean=f"{here} has {len(words)} start values for its elements")
            if None not in sizes and math.prod(size or 0 for size in sizes) > MOST_ELEMENTS:
                shape = " x ".join(map(str, sizes))
                self.found.add(wrong=f"{here} has {shape} elements, more than can be read ({MOST_ELEMENTS})")

    def _size(self, dimension: _Element, array: _Element, by_reference: Mapping[str, list[_Element]]) -> int | None:
        """One size of an array; None where it has been found wrong."""
        here = f"{self._at(dimension)}: a dimension of array {quoted(array.get('name'))}"
        text, reference = dimension.get("start"), dimension.get("valueReference")
        if (text is None) == (reference is None):
            self.found.add(wrong=f"{here} must have either start or valueReference; export it again")
            return None
        if reference is not None:
            holders = by_reference.get(reference.strip(), [])
            if len(holders) != 1:
                number = f"{len(holders)} variables have" if holders else "no variable has"
                self.found.add(wrong=f"{here} refers to valueReference {quoted(reference)}, which {number}; correct it")
                return None
            holder = holders[0]
            named = f"{here} refers to {quoted(holder.get('name'))}, which"
            if holder.tag not in _INTEGERS or holder.find("Dimension") is not None:
                self.found.add(wrong=f"{named} is not a single whole number; export it again")
                return None
            if holder.get("causality") != "structuralParameter" and holder.get("variability") != "constant":
                self.found.add(unclean=f"{named} is neither a structural parameter nor constant")
            text = holder.get("start", "")
            here = f"{named} has start={quoted(text)}: it"
        if text is None or not _is_whole(text) or int(text) < 0:
            self.found.add(wrong=f"{here} is {quoted(text)}, which is not a size; export it again")
            return None
        return int(text)


_BYTES = re.compile(r"(?:[0-9A-Fa-f]{2})*")

_WHOLE_NUMBER = re.compile(r"\s*[+-]?[0-9]{1,20}\s*")


def _is_whole(text: str) -> bool:
    return _WHOLE_NUMBER.fullmatch(text) is not None


def _is_whole_of(bits: int, text: str, *, signed: bool = True) -> bool:
    """Whether it is a whole number of so many bits."""
    smallest, largest = (-(2 ** (bits - 1)), 2 ** (bits - 1)) if signed else (0, 2**bits)
    return _is_whole(text) and smallest <= int(text) < largest


def _is_number(text: str) -> bool:
    """Whether a text is a real number to XML Schema, infinities and NaN among them."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def _is_finite(text: str) -> bool:
    return _is_number(text) and math.isfinite(float(text))


#: Type -> whether a text is a value of it; others than these have texts, or none.
_RIGHT: dict[str, Callable[[str], object]] = {
    "Boolean": _BOOLEANS.__contains__,
    **dict.fromkeys(("Real", "Float32", "Float64"), _is_number),
    "Binary": _BYTES.fullmatch,
    "Enumeration": _is_whole,
    "Integer": partial(_is_whole_of, 32),
    **{f"Int{bits}": partial(_is_whole_of, bits) for bits in (8, 16, 32, 64)},
    **{f"UInt{bits}": partial(_is_whole_of, bits, signed=False) for bits in (8, 16, 32, 64)},
}
