"""Change an SSP in place of its XML: what no one asks to change stays as other tools have written it."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import IO, Any
from urllib.parse import quote, unquote
from xml.dom import minidom
from xml.parsers.expat import ExpatError

from cosim.errors import nearest
from cosim.files.temporary import TemporaryFolder
from cosim.files.whole import write_whole
from cosim.fmi.fmu_file import load
from cosim.ssp.errors import SSPError
from cosim.ssp.format.description import parameter_file
from cosim.ssp.format.package import DESCRIPTION, Archive
from cosim.ssp.format.schema import NAMESPACES, parse
from cosim.ssp.format.structure import GIVING, SEPARATOR, TAKING
from cosim.system.read import Findings
from cosim.system.variables import Ports

#: Name of the parameter sets that hold the values of `SSPFile.set_parameter`.
_EDITED = "edited"

#: An element of minidom, or None; its types know more kinds of nodes than there are here.
Tag = Any

_ENDS = ("startElement", "startConnector", "endElement", "endConnector")
_AFTER_CONNECTIONS = ("SignalDictionaries", "SystemGeometry", "GraphicalElements", "Annotations")
_AFTER_BINDINGS = ("MetaData", "Signature", "Elements", "Connections", *_AFTER_CONNECTIONS)


class SSPFile:
    """An SSP archive to be changed and written again.

    Connections and parameters change; nested systems, annotations, geometry, comments and all other files of the
    archive stay as they are.

    Parameters
    ----------
    path : path

    Attributes
    ----------
    notes : tuple of str
        What the reader would note of the description.

    Raises
    ------
    SSPError
        There is no such SSP, or it is malformed.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        self.path = Path(path)
        findings = Findings(SSPError)
        with Archive(self.path, findings) as archive:
            data = archive.read_xml(DESCRIPTION)
        self._where = f"{self.path}: {DESCRIPTION}"
        parse(data, "ssd", self._where, findings)  # which refuses entities
        try:
            self._document = minidom.parseString(data)
        except ExpatError as error:
            raise SSPError(f"{self._where}: not readable as XML: {error}") from None
        self.notes = findings.notes()
        self._new_files: dict[str, Path] = {}
        self._values: dict[str, dict[str, Any]] = {}

    @property
    def components(self) -> list[str]:
        """Names of all components; those of nested systems are `system/component`."""
        return [path for path, element in self._elements().items() if element.localName == "Component"]

    def connections(self, system: str = "") -> list[tuple[str, str]]:
        """Ends of the connections of a system, as `element.connector`, or `.connector` of the system itself.

        Raises
        ------
        SSPError
            There is no such system.
        """
        return [_ends(element) for element in self._connections(system)]

    def connect(
        self,
        start: str,
        end: str,
        *,
        system: str = "",
        factor: float = 1.0,
        offset: float = 0.0,
        convert_units: bool = True,
    ) -> None:
        """Add a connection.

        Parameters
        ----------
        start, end : str
            `element.connector`, or `.connector` of the system itself; which of them gives the value is theirs.
        system : str
            The system that has it: the outermost by default, `system/inner` for nested ones.
        factor, offset : float
            The value becomes factor * value + offset, after units are converted.
        convert_units : bool
            False takes the number as it is.

        Raises
        ------
        SSPError
            There is no such system, element or connector, or they are connected already.
        """
        owner = self._system(system)
        ends = [self._end(owner, text) for text in (start, end)]
        pair = {(start, end), (end, start)} & set(self.connections(system))
        if pair:
            raise SSPError(f"{self._where}: '{start}' and '{end}' are connected already; disconnect them first")
        attributes: dict[str, str] = {}
        for side, (element, connector) in zip(("start", "end"), ends, strict=True):
            if element:
                attributes[f"{side}Element"] = element
            attributes[f"{side}Connector"] = connector
        if not convert_units:
            attributes["suppressUnitConversion"] = "true"
        holder = _child(owner, "Connections")
        if holder is None:
            holder = self._insert(owner, "ssd", "Connections", _AFTER_CONNECTIONS)
        connection = self._append(holder, "ssd", "Connection", attributes)
        if (factor, offset) != (1.0, 0.0):
            transformation = {"factor": repr(float(factor)), "offset": repr(float(offset))}
            self._append(connection, "ssc", "LinearTransformation", transformation)

    def disconnect(self, start: str, end: str, *, system: str = "") -> None:
        """Remove the connection between two ends, given in any order as in `connect`.

        Raises
        ------
        SSPError
            They are not connected.
        """
        for element in self._connections(system):
            if _ends(element) in ((start, end), (end, start)):
                holder = element.parentNode
                holder.removeChild(element)
                if _child(holder, "Connection") is None:
                    holder.parentNode.removeChild(holder)
                    holder.unlink()
                return
        known = [f"{a} -> {b}" for a, b in self.connections(system)]
        hint = nearest(f"{start} -> {end}", known)
        raise SSPError(f"{self._where}: '{start}' and '{end}' are not connected; {hint}")

    def set_parameter(self, path: str, value: float | bool | str) -> None:
        """Give a parameter, or an input that nothing feeds, a value, which overrides all others in the archive.

        Parameters
        ----------
        path : str
            `component.variable`, of a scalar variable.
        value : float, bool or str
            In the unit of the FMU; of an enumeration its number.

        Raises
        ------
        SSPError
            There is no such component.
        """
        component, dot, name = path.partition(".")
        if not dot or component not in self.components:
            raise SSPError(
                f"{self._where}: '{path}': there is no component '{component}'; {nearest(component, self.components)}"
            )
        self._values.setdefault(component, {})[name] = value

    def replace_fmu(self, component: str, fmu: str | PathLike[str]) -> None:
        """Put another FMU in the place of a component's.

        Parameters
        ----------
        component : str
        fmu : path

        Raises
        ------
        SSPError
            There is no such component, or the FMU lacks a variable that a connector of it stands for.
        SetupError
            It is not an FMU that can be co-simulated.
        """
        element = self._elements().get(component)
        if element is None or element.localName != "Component":
            raise SSPError(f"{self._where}: no component '{component}'; {nearest(component, self.components)}")
        path = Path(fmu)
        variables = {v.name: str(v.causality) for v in load(component, path).description.modelVariables}
        wrong = []
        for connector in _children(_child(element, "Connectors"), "Connector"):
            name, kind = connector.getAttribute("name"), connector.getAttribute("kind")
            causality = variables.get(name)
            if causality is None or any(kind in kinds and causality not in kinds for kinds in (GIVING, TAKING)):
                wrong.append(f"'{name}' ({kind})")
        if wrong:
            raise SSPError(f"{path}: has no variables for connectors {', '.join(wrong)} of component '{component}'")
        name = f"resources/{path.name}"
        number = 1
        while self._has(name) and self._new_files.get(name) != path:
            number += 1
            name = f"resources/{path.stem}_{number}{path.suffix}"
        self._new_files[name] = path
        element.setAttribute("source", quote(name))

    def write(self, path: str | PathLike[str]) -> None:
        """Write the archive with all changes.

        Parameters
        ----------
        path : path
            May be that of the archive that was read.

        Raises
        ------
        SSPError
            A changed parameter is none of its FMU, or what was written would not be an SSP.
        OSError
            The file can't be written.
        """
        for component, values in self._values.items():
            self._bind(component, values)
        self._values.clear()
        data = self._document.toxml(encoding="UTF-8")
        parse(data, "ssd", self._where, Findings(SSPError))
        packed = io.BytesIO()
        self._pack(packed, data)
        write_whole(Path(path), lambda part: part.write_bytes(packed.getvalue()))

    def _pack(self, stream: IO[bytes], description: bytes) -> None:
        used = {unquote(e.getAttribute("source")) for e in self._elements().values()}
        with zipfile.ZipFile(self.path) as old, zipfile.ZipFile(stream, "w") as new:
            for info in old.infolist():
                new.writestr(info, description if info.filename == DESCRIPTION else old.read(info))
            for name, file in self._new_files.items():
                if name in used:
                    new.write(file, name)

    # Parameters

    def _bind(self, component: str, values: Mapping[str, Any]) -> None:
        """Bind values to a component, and above it if a system there could override them."""
        element = self._elements()[component]
        ports = self._ports(component, element)
        root: Tag = self._document.documentElement
        version = root.getAttribute("version")
        self._bind_at(element, parameter_file(_EDITED, "", values, ports, version), "")
        names = self._names_above(element)
        for depth, owner in enumerate(_systems_above(element)):
            if _child(owner, "ParameterBindings") is not None:
                prefix = "".join(f"{name}." for name in names[-depth - 1 :])
                self._bind_at(owner, parameter_file(_EDITED, "", values, ports, version), prefix)

    def _bind_at(self, element: Tag, data: bytes, prefix: str) -> None:
        holder = _child(element, "ParameterBindings")
        if holder is None:
            holder = self._insert(element, "ssd", "ParameterBindings", _AFTER_BINDINGS)
        attributes = {"prefix": prefix} if prefix else {}
        binding = self._append(holder, "ssd", "ParameterBinding", attributes)
        inline = self._append(binding, "ssd", "ParameterValues", {})
        content: Tag = minidom.parseString(data).documentElement
        inline.appendChild(self._document.importNode(content, True))

    def _names_above(self, element: Tag) -> list[str]:
        """Names from the element in the root system down to an element."""
        names: list[str] = []
        while element.localName in ("Component", "System") and element.parentNode.localName == "Elements":
            names.insert(0, element.getAttribute("name"))
            element = element.parentNode.parentNode
        return names

    def _ports(self, component: str, element: Tag) -> Ports:
        findings = Findings(SSPError)
        with Archive(self.path, findings) as archive, TemporaryFolder("ssp") as folder:
            source = element.getAttribute("source")
            path = self._new_files.get(unquote(source))
            if path is None:
                path = archive.unpack(archive.name_of(source, DESCRIPTION), Path(folder))
            return Ports(component, load(component, path).description)

    def _has(self, name: str) -> bool:
        with zipfile.ZipFile(self.path) as archive:
            return name in archive.namelist() or name in self._new_files

    # The tree

    def _elements(self) -> dict[str, Tag]:
        """All systems and components by path; the root system has none."""
        root = _child(self._document.documentElement, "System")
        assert root is not None
        return dict(_below(root, ""))

    def _system(self, path: str) -> Tag:
        systems = {p: e for p, e in self._elements().items() if e.localName == "System"}
        if path not in systems:
            raise SSPError(f"{self._where}: there is no system '{path}'; {nearest(path, systems)}")
        return systems[path]

    def _connections(self, system: str) -> list[Tag]:
        return list(_children(_child(self._system(system), "Connections"), "Connection"))

    def _end(self, system: Tag, text: str) -> tuple[str, str]:
        """Element and connector of an end."""
        name, dot, connector = text.partition(".")
        inner = {e.getAttribute("name"): e for e in _inner(system)}
        longer = [n for n in inner if text.startswith(f"{n}.")]  # names of elements may have dots
        if longer:
            name = max(longer, key=len)
            connector = text[len(name) + 1 :]
        if not dot or (name and name not in inner):
            raise SSPError(f"{self._where}: '{text}': there is no element '{name}'; {nearest(name, inner)}")
        owner = inner[name] if name else system
        known = [c.getAttribute("name") for c in _children(_child(owner, "Connectors"), "Connector")]
        if connector not in known:
            raise SSPError(f"{self._where}: '{text}': there is no connector '{connector}'; {nearest(connector, known)}")
        return name, connector

    def _append(self, parent: Tag, prefix: str, name: str, attributes: Mapping[str, str]) -> Tag:
        return self._made(parent, prefix, name, attributes, None)

    def _insert(self, parent: Tag, prefix: str, name: str, before: tuple[str, ...]) -> Tag:
        """Put an element where the schema has it: before the first of those that follow it."""
        following = next((c for c in parent.childNodes if c.localName in before), None)
        return self._made(parent, prefix, name, {}, following)

    def _made(
        self,
        parent: Tag,
        prefix: str,
        name: str,
        attributes: Mapping[str, str],
        before: Tag,
    ) -> Tag:
        space = NAMESPACES[prefix]
        known = _prefix_of(space, parent)
        element = self._document.createElementNS(space, f"{known}:{name}" if known else name)
        if known is None:
            element = self._document.createElementNS(space, f"{prefix}:{name}")
            element.setAttribute(f"xmlns:{prefix}", space)
        for key, value in attributes.items():
            element.setAttribute(key, value)
        parent.insertBefore(element, before)
        return element


def _prefix_of(space: str, element: Tag) -> str | None:
    """The prefix of a namespace where an element is; empty for that without one, None where there is none."""
    node: Tag = element
    while node is not None and node.nodeType == node.ELEMENT_NODE:
        for attribute, value in node.attributes.items():
            if value == space and (attribute == "xmlns" or attribute.startswith("xmlns:")):
                return str(attribute.partition(":")[2])
        node = node.parentNode
    return None


def _children(element: Tag, name: str) -> Iterator[Tag]:
    for child in element.childNodes if element is not None else ():
        if child.localName == name:
            yield child


def _child(element: Tag, name: str) -> Tag:
    return next(_children(element, name), None)


def _inner(system: Tag) -> list[Tag]:
    """Elements of a system."""
    holder = _child(system, "Elements")
    return [c for c in holder.childNodes if c.nodeType == c.ELEMENT_NODE] if holder is not None else []


def _below(element: Tag, path: str) -> Iterator[tuple[str, Tag]]:
    yield path, element
    for inner in _inner(element):
        name = inner.getAttribute("name").replace(".", SEPARATOR)
        yield from _below(inner, f"{path}{SEPARATOR}{name}" if path else name)


def _systems_above(element: Tag) -> Iterator[Tag]:
    """The systems that an element is in, from the nearest to the outermost."""
    node: Tag = element.parentNode
    while node is not None:
        if node.localName == "System":
            yield node
        node = node.parentNode


def _ends(connection: Tag) -> tuple[str, str]:
    start, start_connector, end, end_connector = (connection.getAttribute(name) for name in _ENDS)
    return f"{start}.{start_connector}", f"{end}.{end_connector}"
