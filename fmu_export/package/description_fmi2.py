"""modelDescription.xml of FMI 2.0 for a model (FMI 2.0.4, section 2.2)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from xml.etree import ElementTree as ET

from fmu_export.modelling.model import Model
from fmu_export.package.description_common import (
    DISTRIBUTION,
    add_default_experiment,
    add_items,
    add_log_categories,
    add_texts,
    add_units,
    enumeration_types,
    indicator_attributes,
    instance_annotation,
    package_version,
    to_bytes,
    type_attributes,
)
from fmu_export.package.interface import Interface, Items, ScalarVariable, StateDerivative, text_of
from fmu_export.package.metadata import NO_METADATA, Metadata


def model_description(
    model: Model,
    interface: Interface,
    guid: str,
    interfaces: Mapping[str, Mapping[str, str]],
    tool: str,
    source_files: Sequence[str] = (),
    metadata: Metadata = NO_METADATA,
) -> bytes:
    """Write the model description of an FMU.

    Parameters
    ----------
    model, interface : Model, Interface
        The model and its flat variables; value references are the positions in `interface.variables`.
    guid : str
        Fingerprint that ties the description to the code.
    interfaces : mapping
        "ModelExchange", "CoSimulation" or both -> attributes of that element besides the model identifier. With model
        exchange, the derivatives of the states are variables too.
    tool : str
        What executes the model, named behind the distribution in generationTool.
    source_files : sequence of str
        C files in `sources/`, for tools that compile FMUs.
    metadata : Metadata, optional
        Who made the model and under which terms.

    Returns
    -------
    bytes
        UTF-8, the same for the same arguments; floats are written so that they read back bit for bit.
    """
    attributes = {
        "fmiVersion": "2.0",
        "modelName": model.name,
        "guid": guid,
        "description": model.description,
        **metadata.attributes,
        "generationTool": f"{DISTRIBUTION} {package_version()} ({tool})",
        "variableNamingConvention": "structured",
        "numberOfEventIndicators": str(len(interface.indicators)),
    }
    root = ET.Element("fmiModelDescription", attributes)
    for kind in ("ModelExchange", "CoSimulation"):
        if kind in interfaces:
            element = ET.SubElement(root, kind, {"modelIdentifier": model.name, **interfaces[kind]})
            if source_files:
                files = ET.SubElement(element, "SourceFiles")
                for name in source_files:
                    ET.SubElement(files, "File", name=name)
    derivatives = interface.derivatives if "ModelExchange" in interfaces else ()
    add_units(root, interface, *(d.unit for d in derivatives))
    types = _add_types(root, interface)
    add_log_categories(root)
    add_default_experiment(root, model)
    tool_annotation = ET.SubElement(ET.SubElement(root, "VendorAnnotations"), "Tool", name=DISTRIBUTION)
    tool_annotation.append(instance_annotation())
    variables = ET.SubElement(root, "ModelVariables")
    guesses = {d.state: d.state_start for d in derivatives}
    for reference, v in enumerate(interface.variables):
        _scalar_variable(variables, v, reference, types, guesses.get(reference))
    for reference, d in enumerate(derivatives, start=len(interface.variables)):
        _state_derivative(variables, d, reference, interface.variables[d.state].about)
    for reference, name in enumerate(interface.indicators, start=len(interface.variables) + len(derivatives) + 1):
        element = ET.SubElement(variables, "ScalarVariable", indicator_attributes(name, reference))
        ET.SubElement(element, "Real")
    _model_structure(root, interface, derivatives)
    return to_bytes(root)


def _add_types(root: ET.Element, interface: Interface) -> dict[Items, str]:
    types = enumeration_types(interface)
    if types:
        definitions = ET.SubElement(root, "TypeDefinitions")
        for items, name in types.items():
            add_items(ET.SubElement(ET.SubElement(definitions, "SimpleType", name=name), "Enumeration"), items)
    return types


def _scalar_variable(
    parent: ET.Element, v: ScalarVariable, reference: int, types: Mapping[Items, str], guess: float | None
) -> None:
    attributes = {
        "name": v.name,
        "valueReference": str(reference),
        **({"description": v.description} if v.description else {}),
        "causality": v.causality,
        "variability": v.variability,
    }
    if v.causality != "input":  # FMI 2.0, table on page 51: "initial" must not be given for inputs
        computed = "calculated" if guess is None else "approx"
        attributes["initial"] = "exact" if v.causality == "parameter" else computed
    element = ET.SubElement(parent, "ScalarVariable", attributes)
    # a state has a guess: with it importers that take a model for its states and inputs, such as CasADi's DaeBuilder,
    # begin at the start of the system and not at zero
    start = v.start if guess is None else guess
    found = {} if start is None else {"start": text_of(v.type, start, v.items)}
    ET.SubElement(element, v.type.capitalize(), type_attributes(v, types) | found)
    if v.type == "string":
        add_texts(ET.SubElement(ET.SubElement(element, "Annotations"), "Tool", name=DISTRIBUTION), v)


def _state_derivative(parent: ET.Element, d: StateDerivative, reference: int, state: str) -> None:
    element = ET.SubElement(
        parent,
        "ScalarVariable",
        name=d.name,
        valueReference=str(reference),
        description=f"Time derivative of: {state}",
        causality="local",
        variability="continuous",
        initial="calculated",
    )
    ET.SubElement(element, "Real", unit=d.unit, derivative=str(d.state + 1))


def _model_structure(root: ET.Element, interface: Interface, derivatives: Sequence[StateDerivative]) -> None:
    """Outputs, state derivatives and initial unknowns with their dependencies; indices count from 1.

    States are knowns in model exchange only.
    """
    structure = ET.SubElement(root, "ModelStructure")
    first_output = interface.n_parameters + interface.n_inputs
    first_derivative = len(interface.variables)
    outputs = interface.dependencies
    if derivatives:
        outputs = tuple((*u, *x) for u, x in zip(outputs, interface.state_dependencies, strict=True))
    n = interface.n_outputs  # locals are no unknowns, unless they are states at the initialisation
    _unknowns(structure, "Outputs", enumerate(outputs[:n], start=first_output))
    if derivatives:
        _unknowns(structure, "Derivatives", enumerate((d.dependencies for d in derivatives), start=first_derivative))
    states = interface.states if derivatives else ()
    computed = enumerate(interface.initial_dependencies, start=first_output)
    initial = [(i, row) for i, row in computed if i < first_output + n or i in states]
    initial += enumerate((d.initial_dependencies for d in derivatives), start=first_derivative)
    _unknowns(structure, "InitialUnknowns", initial)


def _unknowns(structure: ET.Element, tag: str, rows: Iterable[tuple[int, Iterable[int]]]) -> None:
    rows = list(rows)
    if not rows:  # FMI 2.0 has no empty lists
        return
    parent = ET.SubElement(structure, tag)
    for position, row in rows:
        knowns = sorted(row)
        ET.SubElement(
            parent,
            "Unknown",
            index=str(position + 1),
            dependencies=" ".join(str(j + 1) for j in knowns),
            dependenciesKind=" ".join("dependent" for _ in knowns),
        )
