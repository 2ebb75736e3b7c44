"""modelDescription.xml of FMI 3.0 for a model (FMI 3.0.1, section 2.4).

Arrays are declared as scalars `name[1]`, `name[2]`, ..., as in FMI 2.0, though FMI 3.0 has arrays: every flavour then
has the same variables under the same names, and several importers can't plot, connect or record array elements yet. On
request they are arrays.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from xml.etree import ElementTree as ET

from fmu_export.modelling.model import Model
from fmu_export.modelling.variables import Type
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
from fmu_export.package.interface import Entry, Interface, Items, text_of
from fmu_export.package.metadata import NO_METADATA, Metadata

_TAGS: dict[Type, str] = {
    "real": "Float64",
    "integer": "Int32",
    "boolean": "Boolean",
    "enumeration": "Enumeration",
    "string": "String",
}


def model_description(
    model: Model,
    interface: Interface,
    token: str,
    interfaces: Mapping[str, Mapping[str, str]],
    tool: str,
    metadata: Metadata = NO_METADATA,
) -> bytes:
    """Write the model description of an FMU.

    Parameters
    ----------
    model, interface : Model, Interface
        The model and its flat variables. Value references are the positions in `interface.variables`, then those of
        the state derivatives, then the time.
    token : str
        Fingerprint that ties the description to the code.
    interfaces : mapping
        "ModelExchange" and "CoSimulation" -> attributes of that element besides the model identifier.
    tool : str
        What executes the model, named behind the distribution in generationTool.
    metadata : Metadata, optional
        Who made the model and under which terms.
    """
    head = {
        "fmiVersion": "3.0",
        "modelName": model.name,
        "instantiationToken": token,
        "description": model.description,
        **metadata.attributes,
        "generationTool": f"{DISTRIBUTION} {package_version()} ({tool})",
        "variableNamingConvention": "structured",
    }
    root = ET.Element("fmiModelDescription", head)
    for kind, options in interfaces.items():
        ET.SubElement(root, kind, {"modelIdentifier": model.name, **options})
    derivatives = interface.derivatives
    add_units(root, interface, *(d.unit for d in derivatives), "s")
    types = enumeration_types(interface)
    if types:
        definitions = ET.SubElement(root, "TypeDefinitions")
        for items, name in types.items():
            add_items(ET.SubElement(definitions, "EnumerationType", name=name), items)
    add_log_categories(root)
    add_default_experiment(root, model)
    variables = ET.SubElement(root, "ModelVariables")
    guesses = {d.state: d.state_start for d in derivatives}
    for entry in interface.entries:
        _variable(variables, entry, interface, types, guesses)
    for entry in interface.derivative_entries:
        d = derivatives[entry.reference - len(interface.variables)]
        element = ET.SubElement(
            variables,
            "Float64",
            name=entry.name,
            valueReference=str(entry.reference),
            description=entry.description,
            causality="local",
            variability="continuous",
            initial="calculated",
            unit=d.unit,
            derivative=str(d.state),
        )
        _dimensions(element, entry)
    ET.SubElement(
        variables,
        "Float64",
        name="time",
        valueReference=str(len(interface.variables) + len(derivatives)),
        description="Simulation time",
        causality="independent",
        variability="continuous",
        unit="s",
    )
    first_indicator = len(interface.variables) + len(derivatives) + 1
    for reference, name in enumerate(interface.indicators, start=first_indicator):
        ET.SubElement(variables, "Float64", indicator_attributes(name, reference))
    _model_structure(root, interface)
    annotation = ET.SubElement(ET.SubElement(root, "Annotations"), "Annotation", type=DISTRIBUTION)
    annotation.append(instance_annotation())
    return to_bytes(root)


def _variable(
    parent: ET.Element, entry: Entry, interface: Interface, types: Mapping[Items, str], guesses: Mapping[int, float]
) -> None:
    elements = [interface.variables[i] for i in entry.elements]
    v, variability = elements[0], {e.variability for e in elements}
    attributes = {
        "name": entry.name,
        "valueReference": str(entry.reference),
        **({"description": entry.description} if entry.description else {}),
        "causality": v.causality,
        "variability": "continuous" if "continuous" in variability else v.variability,
    }
    if v.causality in ("output", "local"):
        attributes["initial"] = "approx" if entry.reference in guesses else "calculated"
    if v.causality == "input" and v.type == "real":
        attributes["intermediateUpdate"] = "true"
    attributes |= type_attributes(v, types)
    starts = [guesses.get(i, e.start) for i, e in zip(entry.elements, elements, strict=True)]
    texts = [text_of(v.type, start, v.items) for start in starts if start is not None]
    if texts and v.type != "string":
        attributes["start"] = " ".join(texts)
    element = ET.SubElement(parent, _TAGS[v.type], attributes)
    if v.type == "string":
        add_texts(ET.SubElement(ET.SubElement(element, "Annotations"), "Annotation", type=DISTRIBUTION), v)
    _dimensions(element, entry)
    for text in texts if v.type == "string" else ():
        ET.SubElement(element, "Start", value=text)


def _dimensions(element: ET.Element, entry: Entry) -> None:
    for n in entry.shape:
        ET.SubElement(element, "Dimension", start=str(n))


def build_description(model: Model, source_files: Sequence[str]) -> bytes:
    """Write `sources/buildDescription.xml` for tools that compile FMUs (FMI 3.0.1, section 2.5.1.4)."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=model.name)
    files = ET.SubElement(configuration, "SourceFileSet", language="C99")
    for name in source_files:
        ET.SubElement(files, "SourceFile", name=name)
    return to_bytes(root)


def _model_structure(root: ET.Element, interface: Interface) -> None:
    """Outputs, state derivatives and initial unknowns; unlike in FMI 2.0, parameters are knowns of all of them."""
    structure = ET.SubElement(root, "ModelStructure")
    first_output = interface.n_parameters + interface.n_inputs
    first_derivative = len(interface.variables)
    of_outputs = interface.dependencies, interface.state_dependencies, interface.parameter_dependencies
    outputs = [(*u, *x, *p) for u, x, p in zip(*of_outputs, strict=True)]
    derivatives = [(*d.dependencies, *d.parameter_dependencies) for d in interface.derivatives]
    n = interface.n_outputs  # locals are no unknowns, unless they are states at the initialisation
    references = interface.references
    _unknowns(structure, "Output", enumerate(outputs[:n], start=first_output), references)
    _unknowns(structure, "ContinuousStateDerivative", enumerate(derivatives, start=first_derivative), references)
    computed = enumerate(interface.initial_dependencies, start=first_output)
    initial = [(i, row) for i, row in computed if i < first_output + n or i in interface.states]
    initial += enumerate((d.initial_dependencies for d in interface.derivatives), start=first_derivative)
    _unknowns(structure, "InitialUnknown", initial, references)
    first_indicator = first_derivative + len(interface.derivatives) + 1
    for reference, _ in enumerate(interface.indicators, start=first_indicator):
        ET.SubElement(structure, "EventIndicator", valueReference=str(reference))


def _unknowns(
    structure: ET.Element, tag: str, rows: Iterable[tuple[int, Iterable[int]]], references: Mapping[int, int]
) -> None:
    """Add unknowns; an array depends on what its elements depend on."""
    knowns: dict[int, set[int]] = {}
    for position, row in rows:
        knowns.setdefault(references[position], set()).update(references[i] for i in row)
    for reference, found in knowns.items():
        ET.SubElement(
            structure,
            tag,
            valueReference=str(reference),
            dependencies=" ".join(map(str, sorted(found))),
            dependenciesKind=" ".join("dependent" for _ in found),
        )
