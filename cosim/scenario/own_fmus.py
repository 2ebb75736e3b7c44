"""FMUs of the user in place of those of a scenario, as a controller of one's own."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from cosim.errors import SetupError
from cosim.fmi.fmu_file import load
from cosim.system.system import System
from cosim.system.variables import Ports


def replaced(
    system: System, fmus: Mapping[str, str | PathLike[str]], optional_inputs: Mapping[str, Any] | None = None
) -> tuple[System, list[str]]:
    """A copy of a system in which some components are other FMUs.

    Connections to inputs that the new FMU does not have are left out: not every controller wants all signals. So are
    those from outputs that it does not have to optional inputs, which are then held.

    Parameters
    ----------
    system : System
    fmus : mapping
        Component -> FMU file.
    optional_inputs : mapping, optional
        Inputs `component.variable` that may stay unconnected, and the values that they are then held at.

    Returns
    -------
    system : System
    missing : list of str
        Inputs and outputs `component.variable` that are not there.

    Raises
    ------
    SetupError
        A file can't be read as a co-simulation FMU.
    """
    optional = optional_inputs or {}
    components = dict(system.components)
    missing = []
    for component, path in ((component, Path(fmu)) for component, fmu in fmus.items()):
        components[component] = dataclasses.replace(components[component], fmu=path, function=None)
        ports = Ports(component, load(component, path).description, components[component].start)
        ends = [c.target for c in system.connections]
        ends += [c.source for c in system.connections if c.target in optional]
        own = [end.partition(".") for end in ends]
        missing += [".".join((i, name)) for i, _, name in own if i == component and not _has(ports, name)]
    for target in (c.target for c in system.connections if c.source in missing and c.target not in missing):
        component, _, name = target.partition(".")
        start = {name: optional[target], **components[component].start}
        components[component] = dataclasses.replace(components[component], start=start)
    connections = [c for c in system.connections if not {c.source, c.target} & set(missing)]
    return System(components, connections, list(system.signals)), missing


def _has(ports: Ports, name: str) -> bool:
    try:
        ports.find(name)
    except SetupError:
        return False
    return True
