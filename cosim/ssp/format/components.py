"""A system as an SSP has it: components, connections of scalar values, start values."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from cosim.fmi.fmu_file import LoadedFMU, load
from cosim.fmi.interfaces import AUTO_INTERFACE
from cosim.ssp.errors import SSPError
from cosim.ssp.format.diagram import Wire
from cosim.system.resolution import resolve, resolve_start_value, split
from cosim.system.system import Connection, System
from cosim.system.variables import Element, Ports


@dataclass
class PackagedComponent:
    """A component: its FMU, its path in the archive, its connected inputs and the start values of the others."""

    fmu: LoadedFMU
    ports: Ports
    source: str
    isolate: bool = False
    place: str | None = None
    inputs: list[Element] = field(default_factory=list)
    start: dict[str, tuple[Element, Any]] = field(default_factory=dict)

    @property
    def outputs(self) -> list[Element]:
        """Scalar outputs."""
        return self.ports.of_causality("output")


@dataclass
class SystemContent:
    """All components, and connections between scalar values, each with its connection of the system."""

    components: dict[str, PackagedComponent]
    wires: list[Wire]
    connections: list[Connection]


def content_of(system: System) -> SystemContent:
    """Check a system, and collect its content for an SSP.

    Raises
    ------
    SetupError
        It can't be simulated.
    SSPError
        An SSP can't describe a part of it.
    """
    fmus: dict[str, LoadedFMU] = {}
    for name, c in system.components.items():
        if c.fmu is None:
            raise SSPError(f"component '{name}' is a function in Python; an SSP takes FMUs only")
        fmus[name] = load(name, c.fmu, c.interface or AUTO_INTERFACE)
    ports = {name: Ports(name, fmu.description, system.components[name].start) for name, fmu in fmus.items()}
    resolve(system, ports, needs_levels=False)
    sources = _sources(fmus)
    asked = system.components
    components = {
        n: PackagedComponent(f, ports[n], sources[n], asked[n].isolate, asked[n].place) for n, f in fmus.items()
    }
    content = SystemContent(components, [], [])
    for component in system.components.values():
        if component.every != 1:
            raise SSPError(f"component '{component.name}' has steps of its own (every); an SSP can't describe that")
    for signal in system.signals:
        if signal.added:
            raise SSPError(f"a signal is added to '{signal.target}'; an SSP can't describe that")
    for connection in system.connections:
        (source, elements), (target, inputs) = (_elements(p, ports) for p in (connection.source, connection.target))
        for a, b in zip(elements, inputs, strict=True):
            content.wires.append(((source, a.name), (target, b.name)))
            content.connections.append(connection)
    fed = {target for _, target in content.wires}
    for name, packaged in content.components.items():
        packaged.inputs = [e for e in packaged.ports.of_causality("input") if (name, e.name) in fed]
        for variable, value in system.components[name].start.items():
            start = resolve_start_value(packaged.ports, variable, value)
            if start.is_interval:
                raise SSPError(f"'{name}.{variable}' has the interval of a clock; an SSP can't describe that")
            for element, v in zip(start.elements, start.values, strict=True):
                if (name, element.name) not in fed:
                    packaged.start[element.name] = (element, v)
    return content


def _elements(path: str, ports: dict[str, Ports]) -> tuple[str, list[Element]]:
    port, name = split(path, ports)
    return port.component, list(port.find(name))


def _sources(fmus: dict[str, LoadedFMU]) -> dict[str, str]:
    """Path of each FMU in the archive: one, however many components it has."""
    sources: dict[str, str] = {}
    taken: dict[str, str] = {}
    for name, fmu in fmus.items():
        source = f"resources/{fmu.path.name}"
        if taken.setdefault(source, fmu.sha256) != fmu.sha256:
            source = f"resources/{name}_{fmu.path.name}"
            taken[source] = fmu.sha256
        sources[name] = source
    return sources
