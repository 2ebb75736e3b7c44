"""FMUs from scripts for pythonfmu: any Python, not only what can be traced."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from importlib import import_module
from importlib.metadata import distribution
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

from fmu_export.errors import ArgumentError, needs
from fmu_export.package.archive import write_archive
from fmu_export.package.bill_of_materials import bill_of_materials
from fmu_export.package.metadata import NO_METADATA
from fmu_export.pythonfmu.binary import binaries, licence
from fmu_export.pythonfmu.entry import bundle_of, entry_members
from fmu_export.pythonfmu.script_slave import Namespace, namespace_of, reason, slave_class_of

#: Variable names that FMI's structured naming allows; others need the flat convention.
_NAME = r"[A-Za-z_][A-Za-z0-9_]*(\[[0-9]+(, ?[0-9]+)*\])?|'([^'\\\n]|\\.)+'"
_STRUCTURED = re.compile(rf"(?:{_NAME})(?:\.(?:{_NAME}))*|der\(.*\)")


def build_script(
    script: str | PathLike[str], folder: str | PathLike[str] = ".", files: Iterable[str | PathLike[str]] = ()
) -> Path:
    """Write `<folder>/<class name>.fmu`, an FMI 2.0 co-simulation FMU; the same files give the same bytes.

    Unlike one of `pythonfmu build`, it does not harm its host at exit or by an exception, can be instantiated often,
    and keeps its modules to itself: each instance imports its own, whatever others of the host process are called.
    Modules that are compiled are the exception, for Python loads one of a name only.

    Parameters
    ----------
    script : path
        Python file with one class derived from `pythonfmu.Fmi2Slave`.
    folder : path
    files : iterable of path
        Other files and folders that the script needs, as modules that it imports.

    Raises
    ------
    ArgumentError
        There is no such script or file, no such class in the script, or the script fails.
    OSError
        The FMU can't be written; an older one is unchanged.
    BinariesMissing
        The installed pythonfmu has no binaries.
    MissingExtra
        pythonfmu is not installed.
    """
    path = Path(script)
    if not path.is_file():
        raise ArgumentError(f"there is no script {path}")
    if path.suffix != ".py" or "." in path.stem:
        raise ArgumentError(f"{path}: call it <name>.py, without more dots, so that Python can import it")
    resources = _resources(path, [Path(f) for f in files])
    description = _description(path, resources)
    name = description.get("modelName", "")
    slave = description.attrib.pop("class")
    resources |= entry_members(name, path.stem, resources, slave)
    digest = hashlib.sha256()
    for member in sorted(resources):
        digest.update(member.encode() + resources[member])
    description.set("guid", f"{{{digest.hexdigest()[:32]}}}")
    target = Path(folder) / f"{name}.fmu"
    members = {
        "modelDescription.xml": ElementTree.tostring(description, "utf-8", xml_declaration=True),
        **{f"resources/{member}": content for member, content in resources.items()},
        **binaries(description.find("CoSimulation").get("modelIdentifier", "")),  # type: ignore[union-attr]
        "documentation/licenses/pythonfmu.txt": licence(),
    }
    write_archive(target, members | bill_of_materials(name, NO_METADATA, members))
    return target


def _resources(script: Path, files: list[Path]) -> dict[str, bytes]:
    """What goes into the archive's resources, by path: pythonfmu, the files, the script."""
    found = {}
    with needs("export"):
        # not where the module comes from: an FMU in this process may have brought a pythonfmu of its own
        library = Path(str(distribution("pythonfmu").locate_file("pythonfmu")))
    for source in library.glob("*.py"):
        found[f"pythonfmu/{source.name}"] = source.read_bytes()
    for file in files:
        if file.is_dir():
            inside = [f for f in file.rglob("*") if f.is_file() and "__pycache__" not in f.relative_to(file).parts]
            found |= {f"{file.resolve().name}/{f.relative_to(file).as_posix()}": f.read_bytes() for f in inside}
        elif file.is_file():
            found[file.name] = file.read_bytes()
        else:
            raise ArgumentError(f"there is no file {file} to put into the FMU of {script}")
    found[script.name] = script.read_bytes()
    return found


def _description(script: Path, resources: dict[str, bytes]) -> ElementTree.Element:
    """The model description, by an instance made here of what is in the archive."""
    with TemporaryDirectory(prefix="build_script_") as folder:
        for member, content in resources.items():
            target = Path(folder, member)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
        namespace = namespace_of("build_script", folder, bundle_of(resources))
        try:
            slave_class = slave_class_of(import_module(f"{namespace.name}.{script.stem}"))
            slave = slave_class(instance_name="dummyInstance", resources=folder)
            description: ElementTree.Element = slave.to_xml()
            description.set("class", slave_class.__name__)
        except Exception as error:
            raise ArgumentError(f"{script}: {_why(error, namespace, script)}") from error
        finally:
            namespace.close()
    _mend(description)
    return description


def _why(error: Exception, namespace: Namespace, script: Path) -> str:
    missing = getattr(error, "name", None) or ""
    beside = [script.parent / missing, script.parent / f"{missing}.py"]
    if isinstance(error, ModuleNotFoundError) and any(file.exists() for file in beside):
        return f"imports '{missing}', which lies beside it; list it in files"
    return reason(error, namespace)


def _mend(description: ElementTree.Element) -> None:
    """Make the description valid: pythonfmu 0.7.0 writes no InitialUnknowns, nor defaults of variability."""
    co_simulation = description.find("CoSimulation")
    structure = description.find("ModelStructure")
    assert co_simulation is not None
    assert structure is not None
    description.attrib.pop("generationDateAndTime", None)  # the same files give the same bytes
    # it means a separate program, which there is none: Python is embedded
    co_simulation.set("needsExecutionTool", "false")
    identifier = re.sub(r"\W", "_", co_simulation.get("modelIdentifier", ""))
    co_simulation.set("modelIdentifier", identifier)
    variables = description.findall("ModelVariables/ScalarVariable")
    if not all(_STRUCTURED.fullmatch(v.get("name", "")) for v in variables):
        description.set("variableNamingConvention", "flat")
    unknowns = []
    for index, variable in enumerate(variables, start=1):
        causality = variable.get("causality", "local")
        if "variability" not in variable.attrib:
            if causality in ("parameter", "calculatedParameter"):
                variable.set("variability", "fixed")
            elif variable.find("Real") is None:
                variable.set("variability", "discrete")
        default = "exact" if variable.get("variability") == "constant" else "calculated"
        initial = variable.get("initial", default)
        if causality == "calculatedParameter" or (causality == "output" and initial != "exact"):
            unknowns.append(index)
    if unknowns:
        node = ElementTree.SubElement(structure, "InitialUnknowns")
        for index in unknowns:
            ElementTree.SubElement(node, "Unknown", index=str(index))
    ElementTree.indent(description)
