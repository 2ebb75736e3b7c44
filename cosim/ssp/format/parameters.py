"""Parameter sets that a user names beside those of an SSP."""

from __future__ import annotations

import posixpath
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cosim.errors import nearest
from cosim.files.xml_elements import child, children, local_name
from cosim.ssp.errors import SSPError
from cosim.ssp.format.document import Document
from cosim.ssp.format.schema import parse
from cosim.ssp.format.values import Value, set_values

if TYPE_CHECKING:
    from xmlschema import DataElement


class ParameterFiles:
    """Parameter sets by where they go: `FILE`, `COMPONENT=FILE`, or `SOURCE=FILE` in place of a bound one.

    Parameters
    ----------
    texts : sequence of str
    document : Document
        The description of the system.

    Raises
    ------
    SSPError
        A file is missing or malformed, or goes nowhere.
    """

    def __init__(self, texts: Sequence[str], document: Document) -> None:
        self._document = document
        self._instead: dict[str, str] = {}
        self._further: list[tuple[str, str, str]] = []  # option, prefix, file
        sources, elements = _sources(document), _elements(document)
        for text in texts:
            where, equals, file = text.rpartition("=")
            if not equals:
                self._further.append((text, "", text))
            elif where in elements:
                self._further.append((text, f"{where}.", file))
            elif sources.get(where) is not None:
                self._instead[sources[where]] = file
            else:
                hint = nearest(where, [*elements, *sources])
                raise SSPError(f"{text}: '{where}' is neither a component nor a bound parameter set; {hint}")

    def instead_of(self, binding: DataElement) -> list[Value] | None:
        """The values that take the place of those of a binding, if a user wants others."""
        source = binding.attrib.get("source")
        if source not in self._instead:
            return None
        if child(binding, "ParameterMapping") is not None:
            raise SSPError(
                f"{source}={self._instead[source]}: this parameter set is mapped; give the values as FILE, under the "
                "names of the system"
            )
        return self._values(self._instead[source], binding.attrib["prefix"])

    def further(self) -> list[tuple[str, list[Value]]]:
        """The sets that are for the whole system, with what the user wrote for each."""
        return [(text, self._values(file, prefix)) for text, prefix, file in self._further]

    def _values(self, file: str, prefix: str) -> list[Value]:
        package = self._document.package
        if Path(file).is_file():
            here, data = file, Path(file).read_bytes()
        else:
            try:
                name = package.name_of(Path(file).as_posix(), self._document.name)
            except SSPError:
                raise SSPError(f"{file}: there is no such file, nor one in {package.path}; check the path") from None
            here, data = package.where(name), package.read_xml(name)
        return set_values(parse(data, "ssv", here, self._document.findings), prefix, here, self._document)


def _sources(document: Document) -> dict[str, str]:
    """Parameter sets that are bound, by their source and by the name of their file."""
    found: dict[str, str] = {}
    for element in document.content.iter():
        if local_name(element) == "ParameterBinding" and element.attrib.get("source"):
            source = element.attrib["source"]
            found[source] = source
            found.setdefault(posixpath.basename(source), source)
    return found


def _elements(document: Document) -> list[str]:
    """Names of the elements of the system, also of those in nested systems, with dots."""

    def below(system: DataElement, prefix: str) -> list[str]:
        names = []
        for element in child(system, "Elements") or ():
            name = prefix + element.attrib["name"]
            names += [name, *below(element, f"{name}.")]
        return names

    return below(next(children(document.content, "System")), "")
