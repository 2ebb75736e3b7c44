"""Read an SSP into a `System`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, Literal

from cosim.errors import nearest
from cosim.files.xml_elements import children
from cosim.ssp.errors import SSPError
from cosim.ssp.experiment import is_isolated, place_of, step_size_of, steps_of, times_of
from cosim.ssp.flow import Feed, Flow, Node
from cosim.ssp.format.document import open_document
from cosim.ssp.format.package import DESCRIPTION, Package, open_package
from cosim.ssp.format.parameters import ParameterFiles
from cosim.ssp.format.structure import SEPARATOR, Part, read_structure, variable_nodes
from cosim.ssp.format.values import Value, values_of
from cosim.ssp.geometry import places
from cosim.ssp.mappings import add_mapping
from cosim.system.read import Findings, ReadSystem
from cosim.system.system import System
from cosim.system.variables import Element

__all__ = ["DESCRIPTION", "ReadSystem", "read_ssp"]


def read_ssp(
    path: str | PathLike[str],
    folder: str | PathLike[str],
    *,
    parameter_sets: Sequence[str] = (),
    units: Literal["convert", "ignore"] = "convert",
    step_size: float | None = None,
    start_time: float | None = None,
    stop_time: float | None = None,
    duration: float | None = None,
) -> ReadSystem:
    """Read an SSP.

    Parameters
    ----------
    path : path
        Of an archive, of a folder with `SystemStructure.ssd`, or of a description alone (`.ssd`).
    folder : path
        FMUs of an archive are unpacked into this folder, which must live as long as the system.
    parameter_sets : sequence of str
        Further parameter sets (SSV), which override all others, later ones earlier ones: `FILE` for the whole system,
        with names as `component.parameter`; `COMPONENT=FILE` for a component; `SOURCE=FILE` takes the place of a file
        that is bound already. A file that does not exist is looked for in the archive.
    units : {"convert", "ignore"}
        Convert values where both ends have a unit, or take all numbers as they are.
    step_size : float, optional
        Communication step (s) in place of that of the SSP; components that have steps of their own keep them.
    start_time, stop_time : float, optional
        Times (s) in place of those of the SSP. Where neither says a stop time, the latest of the default experiments of
        its FMUs is taken, with a note.
    duration : float, optional
        How long the run is (s) where they say none either; by default there is no stop time then.

    Returns
    -------
    ReadSystem

    Raises
    ------
    SSPError, SetupError
        The SSP is malformed, or has what can't be run; the message names all of it.
    """
    findings = Findings(SSPError)
    package, name = open_package(Path(path), findings)
    with package:
        document = open_document(package, name, Path(folder), units == "ignore")
        files = ParameterFiles(parameter_sets, document)
        root = read_structure(document)
        flow = Flow(root)
        findings.raise_problems(_file(package, name), f"{package.path}")
        values = _Values(files)
        values.bind(root)
        values.add_files(root)
        times = times_of(document, root, start_time, stop_time, duration)
        step = step_size_of(document, root, times) if step_size is None else step_size
        system = _system(root, flow, values.found, step, findings)
        if not system.components:
            findings.problem(f"{document.where}: has no components; add one there, a Component element with an FMU")
        findings.raise_problems(_file(package, name), f"{package.path}")
    return ReadSystem(
        document.content.attrib["name"],
        system,
        *times,
        step,
        findings.notes(),
        places=places(root),
    )


def _file(package: Package, name: str) -> str:
    """Beginning of messages about a package."""
    return f"{package.path}" if package.where(name).startswith(f"{package.path}: ") else package.where(name)


@dataclass
class _Values:
    """Values by what they are for."""

    files: ParameterFiles
    found: dict[Node, Value] = field(default_factory=dict)

    def bind(self, part: Part) -> None:
        """Add those of a part. Those of a system override those of its elements, later ones earlier ones."""
        for inner in part.parts.values():
            self.bind(inner)
        for element, document in part.bindings:
            here = f"{document.where}: " + (f"'{part.path}'" if part.path else "the system")
            definitions = part.units if part.ports is not None else document.definitions
            for binding in children(element, "ParameterBindings", "ParameterBinding"):
                with document.findings.collecting():
                    values = self.files.instead_of(binding)
                    if values is None:
                        values = values_of(binding, document, part.source, here, definitions)
                    self._add(values, part, document.findings)

    def add_files(self, root: Part) -> None:
        """Add those of parameter sets that a user names."""
        findings = root.document.findings
        for text, values in self.files.further():
            with findings.collecting():
                if not self._add(values, root, findings) and values:
                    raise SSPError(
                        f"{text}: none of its parameters is one of the system, as '{values[0].name}'; "
                        "names are component.parameter, or give COMPONENT=FILE"
                    )

    def _add(self, values: Sequence[Value], part: Part, findings: Findings) -> int:
        """Add values of a part; returns how many are of something."""
        count = 0
        for value in values:
            found = variable_nodes(part, value.name)
            if not found:
                known = part.variables if part.ports is not None else _hierarchical_names(part)
                hint = nearest(value.name, known)
                findings.note(
                    f"{value.origin}: nothing is named '{value.name}', which is ignored; {hint}",
                    f"{value.origin}: unknown names",
                )
            count += bool(found)
            for target, name in found:
                scalars = (name,) if target.ports is not None else target.connectors[name].scalars
                with findings.collecting():
                    for scalar, part_of_value in zip(scalars, value.split(len(scalars)), strict=True):
                        self.found[target.path, scalar] = part_of_value
        return count


def _hierarchical_names(part: Part) -> list[str]:
    if part.ports is not None:
        return list(part.variables)
    names = list(part.connectors)
    for name, inner in part.parts.items():
        names += [f"{name}.{n}" for n in _hierarchical_names(inner)]
    return names


def _system(root: Part, flow: Flow, values: Mapping[Node, Value], step: float | None, findings: Findings) -> System:
    system = System()
    components = [part for part in root.all_parts() if part.ports is not None]
    paths = {part.path: part for part in components}
    connections: list[tuple[str, str, float, float]] = []
    mapped: list[tuple[Feed, Part, Element]] = []
    for part in components:
        assert part.ports is not None
        assert part.fmu is not None
        start: dict[str, Any] = {}
        for name, elements in part.variables.items():
            if (part.path, name) in values:
                with findings.collecting():
                    value = values[part.path, name]
                    if _settable(value, part, elements[0], findings):
                        start[name] = _plain(_fit(value, part, elements))
        for element in part.ports.all_elements():
            with findings.collecting():
                feed = flow.into((part.path, element.name))
                if feed is None:
                    continue
                source_part, source_name = feed.source
                relative = part.ports.is_relative(element)
                target = f"{part.path}.{element.name}"
                if source_part in paths:
                    if feed.tables:
                        mapped.append((feed, part, element))
                        continue
                    factor, offset = feed.transformation(relative=relative)
                    connections.append((f"{source_part}.{source_name}", target, factor, offset))
                elif feed.source in values:
                    value = values[feed.source]
                    start[element.name] = _plain(feed.handed_on(value, target, element.items, relative=relative))
        isolate = False
        with findings.collecting():
            isolate = is_isolated(part)
        every, place = steps_of(part, step), place_of(part)
        system.add(part.path, part.fmu, start, every, part.interface, isolate=isolate, place=place)
    for feed, part, element in mapped:
        with findings.collecting():
            source_part, source_name = feed.source
            source = paths[source_part].variables[source_name][0]
            name = SEPARATOR.join((part.path, element.name.replace(".", SEPARATOR)))
            entry, exit_ = add_mapping(system, name, feed, source, element, findings)
            connections.append((f"{source_part}.{source_name}", entry, 1.0, 0.0))
            connections.append((exit_, f"{part.path}.{element.name}", 1.0, 0.0))
    for source_path, target_path, factor, offset in connections:
        system.connect(source_path, target_path, factor=factor, offset=offset, units="ignore")  # converted already
    return system


def _settable(value: Value, part: Part, element: Element, findings: Findings) -> bool:
    """Whether a parameter set can give a variable its value; the standard has others ignored."""
    variable = element.variable
    settable = variable.causality == "input" or variable.initial in ("exact", "approx")
    if settable and variable.variability != "constant":
        return True
    findings.note(
        f"{value.origin}: '{part.path}.{variable.name}' is of causality {variable.causality} and can't be set; "
        "its value is ignored",
        f"{value.origin}: not settable",
    )
    return False


def _fit(value: Value, part: Part, elements: list[Element]) -> list[Any] | str:
    """A value for a variable of a component."""
    assert part.ports is not None
    name = f"{part.path}.{value.name}"
    relative = part.ports.is_relative(elements[0])
    unit = part.ports.unit(elements[0])
    return value.fit(name, unit, elements[0].items, relative=relative, findings=part.document.findings)


def _plain(value: list[Any] | str) -> Any:
    return value[0] if len(value) == 1 and not isinstance(value, str) else value
