"""Model descriptions of FMI 1.0 in the form of FMI 2.0: what FMPy does not read of them."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from fmpy.model_description import ModelDescription, Unknown

#: Attributes of the element Capabilities that have the same name and meaning in FMI 2.0.
_CAPABILITIES = (
    "canHandleVariableCommunicationStepSize",
    "canInterpolateInputs",
    "canRunAsynchronuously",
    "canBeInstantiatedOnlyOncePerProcess",
    "canNotUseMemoryManagementFunctions",
)

#: Type of variables that are another one's negative: FMUs give the value of the other one.
NEGATED = "negated alias"


def needs_tool(root: Element) -> bool:
    """Whether the FMU is a connection to a tool, which must run beside."""
    return root.find("Implementation/CoSimulation_Tool") is not None


def complete(description: ModelDescription, root: Element) -> None:
    """Add capabilities, which variables can be set, and the dependencies of outputs.

    Parameters
    ----------
    description : ModelDescription
        As FMPy reads it.
    root : Element
        The XML that it was read from.
    """
    if (given := root.find("Implementation/*/Capabilities")) is not None:
        co_simulation = description.coSimulation
        for name in _CAPABILITIES:
            setattr(co_simulation, name, given.get(name) in ("true", "1"))
        co_simulation.maxOutputDerivativeOrder = int(given.get("maxOutputDerivativeOrder", "0"))
    variables = {variable.name: variable for variable in description.modelVariables}
    for element in root.iterfind("ModelVariables/ScalarVariable"):
        variable = variables[element.get("name")]
        fixed = element[0].get("fixed") not in ("false", "0")
        variable.initial = "calculated" if variable.start is None else "exact" if fixed else "approx"
        if element.get("alias") == "negatedAlias":
            variable.type = NEGATED
        elif variable.causality == "output":
            listed = element.find("DirectDependency")
            names = None if listed is None else [name.text or "" for name in listed.iterfind("Name")]
            inputs = None if names is None else [variables[name] for name in names if name in variables]
            description.outputs.append(Unknown(variable=variable, dependencies=inputs))
