"""Write a `System` as an SSP, with a diagram; checked against the standard's schemas before it is written."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Literal

from cosim.errors import nearest
from cosim.files.whole import write_whole
from cosim.ssp.errors import SSPError
from cosim.ssp.format.components import SystemContent, content_of
from cosim.ssp.format.description import description_file, parameter_file
from cosim.ssp.format.package import DESCRIPTION
from cosim.ssp.format.schema import parse
from cosim.system.system import System

_DATE = (1980, 1, 1, 0, 0, 0)  # of all members: equal systems become equal files


@dataclass(frozen=True)
class ParameterSet:
    """Values for the parameters of a component, as a file of their own.

    Attributes
    ----------
    file : str
        Name of the file `resources/<file>.ssv`.
    component : str
        Whose parameters they are; their units are those of its FMU.
    values : mapping
        Parameter -> value.
    description : str
        One line for people.
    bound : bool
        The component takes them. A set that is not bound is there to be chosen in an editor.
    """

    file: str
    component: str
    values: Mapping[str, Any]
    description: str = ""
    bound: bool = False


@dataclass(frozen=True)
class Experiment:
    """Defaults of a run, in s."""

    stop_time: float
    step_size: float
    start_time: float = 0.0


def write_ssp(
    path: str | PathLike[str],
    system: System,
    name: str,
    experiment: Experiment,
    parameter_sets: Sequence[ParameterSet] = (),
    *,
    version: Literal["1.0", "2.0"] = "1.0",
    description: str = "",
) -> None:
    """Write a system as an SSP.

    Vectors are connected element by element. Signals, which an SSP can't describe, are left out: inputs that they feed
    keep the start values of the FMUs, unless a tool sets them. They don't become inputs of the system, since libcosim
    opens no SSP in which those are connected.

    Parameters
    ----------
    path : path
    system : System
    name, description : str
        For people.
    experiment : Experiment
    parameter_sets : sequence of ParameterSet
    version : {"1.0", "2.0"}
        Of SSP.

    Raises
    ------
    SetupError
        The system can't be simulated.
    SSPError
        It can't be written as an SSP.
    OSError
        The file can't be written.
    """
    system_content = content_of(system)
    files, bindings = _parameter_files(system_content, parameter_sets, version)
    times = (experiment.start_time, experiment.stop_time, experiment.step_size)
    files = {DESCRIPTION: description_file(system_content, bindings, name, description, times, version)} | files
    for file, content in files.items():
        parse(content, "ssd" if file == DESCRIPTION else "ssv", file)
    files |= {m.source: m.fmu.path.read_bytes() for m in system_content.components.values()}
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        for member, content in files.items():
            compression = zipfile.ZIP_STORED if member.endswith(".fmu") else zipfile.ZIP_DEFLATED
            archive.writestr(zipfile.ZipInfo(member, _DATE), content, compression)
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    write_whole(target, lambda part: part.write_bytes(data.getvalue()))


def _parameter_files(
    system_content: SystemContent, parameter_sets: Sequence[ParameterSet], version: str
) -> tuple[dict[str, bytes], dict[str, list[str]]]:
    """Parameter sets by their place in the archive, and those that each component takes, in order."""
    files: dict[str, bytes] = {}
    bindings: dict[str, list[str]] = {}
    for name, component in system_content.components.items():
        if component.start:
            source = f"resources/{name}.ssv".replace("/", "_").replace("resources_", "resources/", 1)
            values = {n: value for n, (_, value) in component.start.items()}
            files[source] = parameter_file(name, f"Start values of {name}", values, component.ports, version)
            bindings[name] = [source]
    for parameters in parameter_sets:
        if parameters.component not in system_content.components:
            hint = nearest(parameters.component, system_content.components)
            raise SSPError(f"parameter set '{parameters.file}': there is no component '{parameters.component}'; {hint}")
        source = f"resources/{parameters.file}.ssv"
        if source in files:
            raise SSPError(f"there are two parameter sets named '{parameters.file}'; rename one")
        ports = system_content.components[parameters.component].ports
        files[source] = parameter_file(parameters.file, parameters.description, parameters.values, ports, version)
        if parameters.bound:
            bindings.setdefault(parameters.component, []).append(source)
    return files, bindings
