"""Model descriptions without an FMU, for tests of what is decided before anything is loaded."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

from fmpy import read_model_description
from fmpy.model_description import ModelDescription

from cosim.system.variables import Ports

#: Units of temperature, of length, and one without a definition of its base.
UNITS = """<UnitDefinitions>
<Unit name="K"><BaseUnit K="1"/></Unit>
<Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit>
<Unit name="degF"><BaseUnit K="1" factor="0.5555555555555556" offset="255.3722222222222"/></Unit>
<Unit name="kelvin"><BaseUnit K="1"/></Unit>
<Unit name="m"><BaseUnit m="1"/></Unit>
<Unit name="strange"/>
</UnitDefinitions>
<TypeDefinitions>
<SimpleType name="Difference"><Real unit="degC" relativeQuantity="true"/></SimpleType>
<SimpleType name="Temperature"><Real unit="degC"/></SimpleType>
<SimpleType name="Mode"><Enumeration><Item name="off" value="1"/><Item name="on" value="2"/></Enumeration></SimpleType>
</TypeDefinitions>"""


def fmi2(
    *variables: str,
    guid: str = "{g}",
    interpolates: bool = False,
    feedthrough: bool | Mapping[str, str] = False,
) -> ModelDescription:
    """A description of FMI 2.0.

    Parameters
    ----------
    variables : str
        `name causality Type attribute=value ...`, with `initial` and `variability` among the attributes.
    guid : str
    interpolates : bool
        It takes rates of inputs.
    feedthrough : bool or mapping
        Outputs depend on all inputs; else on none; or those named do, on what is named.
    """
    items, outputs = [], []
    positions = {text.split()[0]: str(k) for k, text in enumerate(variables, start=1)}
    for k, text in enumerate(variables, start=1):
        name, causality, kind, *rest = text.split()
        given = dict(item.split("=", 1) for item in rest)
        outer = {key: given.pop(key) for key in ("initial", "variability") if key in given}
        if "arameter" in causality:
            outer.setdefault("variability", "fixed")
        items.append(
            f'<ScalarVariable name="{name}" valueReference="{k}" causality="{causality}" {_attributes(outer)}>'
            f"<{kind} {_attributes(given)}/></ScalarVariable>"
        )
        if causality == "output":
            known = {} if isinstance(feedthrough, bool) else feedthrough
            on = " ".join(positions[name] for name in known.get(name, "").split())
            outputs.append(f'<Unknown index="{k}"' + ("/>" if feedthrough is True else f' dependencies="{on}"/>'))
    text = (
        f'<fmiModelDescription fmiVersion="2.0" modelName="M" guid="{guid}"><CoSimulation modelIdentifier="M" '
        f'canInterpolateInputs="{str(interpolates).lower()}"/>{UNITS}<ModelVariables>{"".join(items)}'
        f"</ModelVariables><ModelStructure><Outputs>{''.join(outputs)}</Outputs></ModelStructure></fmiModelDescription>"
    )
    archive = BytesIO()
    with zipfile.ZipFile(archive, "w") as out:
        out.writestr("modelDescription.xml", text)
    return read_model_description(archive, validate=False)


def ports(**descriptions: ModelDescription) -> dict[str, Ports]:
    """Components by name."""
    return {name: Ports(name, description) for name, description in descriptions.items()}


def _attributes(given: dict[str, str]) -> str:
    return " ".join(f'{key}="{value}"' for key, value in given.items())


def without_capability(source: Path, target: Path, capability: str) -> Path:
    """A copy of an FMU whose model description does not have a capability."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for member in old.infolist():
            data = old.read(member)
            if member.filename == "modelDescription.xml":
                assert f'{capability}="true"'.encode() in data
                data = data.replace(f'{capability}="true"'.encode(), b"")
            new.writestr(member, data)
    return target
