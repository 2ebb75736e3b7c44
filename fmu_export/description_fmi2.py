"""modelDescription.xml of FMI 2.0 for a model (FMI 2.0.4, section 2.2)."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as ET

from fmu_export.interface import Interface, ScalarVariable
from fmu_export.model import Model
from fmu_export.units import unit
from fmu_export.version import DISTRIBUTION, package_version


def model_description(model: Model, interface: Interface, guid: str, options: dict[str, str], tool: str) -> bytes:
    """Write the model description of a co-simulation FMU.

    Parameters
    ----------
    model, interface : Model, Interface
        The model and its flat variables; value references are the positions in `interface.variables`.
    guid : str
        Fingerprint that ties the description to the code.
    options : dict
        Attributes of the CoSimulation element besides the model identifier.
    tool : str
        What executes the model, named behind the distribution in generationTool.

    Returns
    -------
    bytes
        UTF-8, the same for the same arguments; floats are written so that they read back bit for bit.
    """
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=model.name,
        guid=guid,
        description=model.description,
        version=package_version(),
        license="MIT",
        generationTool=f"{DISTRIBUTION} {package_version()} ({tool})",
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    ET.SubElement(root, "CoSimulation", {"modelIdentifier": model.name, **options})
    _unit_definitions(root, interface.variables)
    categories = ET.SubElement(root, "LogCategories")
    for name in ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal", "logAll"):
        ET.SubElement(categories, "Category", name=name)
    experiment = model.default_experiment
    ET.SubElement(
        root,
        "DefaultExperiment",
        startTime=repr(experiment.start_time),
        stopTime=repr(experiment.stop_time),
        stepSize=repr(experiment.step_size),
    )
    variables = ET.SubElement(root, "ModelVariables")
    for reference, v in enumerate(interface.variables):
        _scalar_variable(variables, v, reference)
    _model_structure(root, interface)
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _unit_definitions(root: ET.Element, variables: Sequence[ScalarVariable]) -> None:
    definitions = ET.SubElement(root, "UnitDefinitions")
    for name in dict.fromkeys(v.unit for v in variables):
        element = ET.SubElement(definitions, "Unit", name=name)
        ET.SubElement(element, "BaseUnit", {k: str(n) for k, n in unit(name).exponents.items()})
        for display, factor in unit(name).display.items():
            ET.SubElement(element, "DisplayUnit", name=display, factor=repr(factor))


def _scalar_variable(parent: ET.Element, v: ScalarVariable, reference: int) -> None:
    variability = {"parameter": "fixed", "input": "continuous", "output": "continuous"}[v.causality]
    attributes = {
        "name": v.name,
        "valueReference": str(reference),
        "description": v.description,
        "causality": v.causality,
        "variability": variability,
    }
    if v.causality != "input":  # FMI 2.0, table on page 51: "initial" must not be given for inputs
        attributes["initial"] = "exact" if v.causality == "parameter" else "calculated"
    real = {"unit": v.unit}
    display = next(iter(unit(v.unit).display), None)
    if display is not None:
        real["displayUnit"] = display
    for name, value in (("min", v.min), ("max", v.max), ("start", v.start)):
        if value is not None:
            real[name] = repr(value)
    ET.SubElement(ET.SubElement(parent, "ScalarVariable", attributes), "Real", real)


def _model_structure(root: ET.Element, interface: Interface) -> None:
    """Outputs and InitialUnknowns with their dependencies; indices count from 1."""
    structure = ET.SubElement(root, "ModelStructure")
    first_output = interface.n_parameters + interface.n_inputs
    for tag, rows in (
        ("Outputs", interface.dependencies),
        ("InitialUnknowns", interface.initial_dependencies),
    ):
        parent = ET.SubElement(structure, tag)
        for i, row in enumerate(rows):
            ET.SubElement(
                parent,
                "Unknown",
                index=str(first_output + i + 1),
                dependencies=" ".join(str(j + 1) for j in row),
                dependenciesKind=" ".join("dependent" for _ in row),
            )
