"""Small FMUs for the tests of the stepping loop: the tiny models in any flavour, and two FMUs written in C."""

from __future__ import annotations

import subprocess
import zipfile
from collections.abc import Mapping
from pathlib import Path

import fmpy

from fmu_export.modelling.model import DefaultExperiment, Model
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.native.backend import build_native
from fmu_export.native.toolchain import find_compiler
from fmu_export.pythonfmu.backend import build_pythonfmu
from tests.support.compilation import shared_compilation
from tests.support.native_fmus import require_compiler

FLAVOURS = ("fmi2", "fmi3", "pythonfmu")

#: x' = a + b from x_start: a loop can be closed by one input and fed by the other; no feedthrough.
TANK = Model(
    name="Tank",
    description="Tank, a model for tests",
    parameters=Layout([Variable("x_start", "1", "Start")]),
    inputs=Layout([Variable("a", "1", "One inflow"), Variable("b", "1", "The other")]),
    outputs=Layout([Variable("x", "1", "Level")]),
    states=("x",),
    initial_state=lambda p: p[:1],
    derivatives=lambda t, x, u, p: u[:1] + u[1:2],
    output_values=lambda t, x, u, p: x,
    default_experiment=DefaultExperiment(stop_time=1.0, step_size=0.1),
)

#: Variables of fmi2_probe.c by value reference: name, causality, element.
_PROBE = (
    ("u", "input", '<Real start="0"/>'),
    ("y", "output", "<Real/>"),
    ("n", "input", '<Integer start="0"/>'),
    ("n_out", "output", "<Integer/>"),
    ("e", "input", '<Enumeration declaredType="Mode" start="1"/>'),
    ("e_out", "output", '<Enumeration declaredType="Mode"/>'),
    ("b", "input", '<Boolean start="false"/>'),
    ("b_out", "output", "<Boolean/>"),
    ("fail_at", "parameter", '<Real start="1e9"/>'),
    ("status", "parameter", '<Integer start="0"/>'),
    ("where", "parameter", '<Integer start="0"/>'),
    ("journal", "parameter", '<String start=""/>'),
)


def _fmi2_probe() -> str:
    variables = [
        f'<ScalarVariable name="{name}" valueReference="{k}" causality="{causality}" '
        f'variability="{"fixed" if causality == "parameter" else "discrete"}">{element}</ScalarVariable>'
        for k, (name, causality, element) in enumerate(_PROBE)
    ]
    unknowns = [f'<Unknown index="{k}" dependencies="{k - 1}"/>' for k in (2, 4, 6, 8)]
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            '<fmiModelDescription fmiVersion="2.0" modelName="Probe" guid="{probe}">',
            '<CoSimulation modelIdentifier="probe" canHandleVariableCommunicationStepSize="true"/>',
            '<TypeDefinitions><SimpleType name="Mode"><Enumeration>',
            '<Item name="off" value="1"/><Item name="on" value="2"/>',
            "</Enumeration></SimpleType></TypeDefinitions>",
            "<ModelVariables>",
            *variables,
            "</ModelVariables>",
            "<ModelStructure>",
            *("<Outputs>", *unknowns, "</Outputs>"),
            *("<InitialUnknowns>", *unknowns, "</InitialUnknowns>"),
            "</ModelStructure>",
            "</fmiModelDescription>",
        ]
    )


#: In the order of fmi3_types.c.
FMI3_TYPES = (
    "Float32",
    "Float64",
    *(f"{sign}Int{bits}" for bits in (8, 16, 32, 64) for sign in ("", "U")),
    "Boolean",
)


def _fmi3_types() -> str:
    variables = ['<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>']
    structure = []
    for k, kind in enumerate(FMI3_TYPES):
        start = "false false" if kind == "Boolean" else "0 0"
        variability = "" if kind.startswith("Float") else ' variability="discrete"'
        for name, reference, causality, more in (
            (kind, 2 * k + 1, "input", f' start="{start}"'),
            (f"{kind}_out", 2 * k + 2, "output", ""),
        ):
            variables.append(
                f'<{kind} name="{name}" valueReference="{reference}" causality="{causality}"{variability}{more}>'
                f'<Dimension start="2"/></{kind}>'
            )
        structure.append(f'<Output valueReference="{2 * k + 2}" dependencies="{2 * k + 1}"/>')
    for reference, kind in enumerate(("Int64", "UInt64"), start=2 * len(FMI3_TYPES) + 1):
        variables.append(
            f'<{kind} name="largest_{kind}" valueReference="{reference}" causality="output" variability="discrete">'
            f'<Dimension start="2"/></{kind}>'
        )
        structure.append(f'<Output valueReference="{reference}" dependencies=""/>')
    for reference, (name, kind, start) in enumerate(
        (
            ("String", "String", '<Start value="first"/>'),
            ("words", "String", '<Dimension start="2"/><Start value="a"/><Start value="b"/>'),
            ("Binary", "Binary", '<Start value="00ff"/>'),
        ),
    ):
        r = 101 + 2 * reference
        for label, number, causality in ((name, r, "input"), (f"{name}_out", r + 1, "output")):
            inner = start if causality == "input" else start[: start.index("<Start")]
            variables.append(
                f'<{kind} name="{label}" valueReference="{number}" causality="{causality}" variability="discrete">'
                f"{inner}</{kind}>"
            )
        structure.append(f'<Output valueReference="{r + 1}" dependencies="{r}"/>')
    unknowns = [s.replace("<Output", "<InitialUnknown") for s in structure]
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            '<fmiModelDescription fmiVersion="3.0" modelName="Types" instantiationToken="{types}">',
            '<CoSimulation modelIdentifier="types" canHandleVariableCommunicationStepSize="true" '
            'canGetAndSetFMUState="true" canSerializeFMUState="true"/>',
            "<ModelVariables>",
            *variables,
            "</ModelVariables>",
            "<ModelStructure>",
            *structure,
            *unknowns,
            "</ModelStructure>",
            "</fmiModelDescription>",
        ]
    )


def build(folder: Path, flavour: str, *models: Model) -> Path:
    """Write the FMUs of models to a folder and give it back."""
    if flavour != "pythonfmu":
        require_compiler()
    for model in models:
        if flavour == "pythonfmu":
            build_pythonfmu(model, folder)
        else:
            with shared_compilation():
                build_native(model, folder, flavour)
    return folder


def compiled(folder: Path, source: str) -> Path:
    """The FMU of a C file of this folder: "fmi2_probe" or "fmi3_types"."""
    require_compiler()
    identifier = source.partition("_")[2]
    library = folder / f"{identifier}{fmpy.sharedLibraryExtension}"
    headers = Path(fmpy.__file__).parent / "c-code"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", f"-I{headers}"]
    file = Path(__file__).with_name(f"{source}.c")
    subprocess.run([*find_compiler(), *flags, str(file), "-o", str(library)], check=True)
    version2 = source.startswith("fmi2")
    platform = fmpy.platform if version2 else fmpy.platform_tuple
    path = folder / f"{identifier}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", _fmi2_probe() if version2 else _fmi3_types())
        archive.write(library, f"binaries/{platform}/{library.name}")
    return path


def redescribed(fmu: Path, path: Path, replaced: Mapping[str, str]) -> Path:
    """A copy of an FMU in which texts of the model description are replaced; each must be in it."""
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(path, "w") as new:
        for member in old.namelist():
            data = old.read(member)
            if member == "modelDescription.xml":
                text = data.decode()
                for before, after in replaced.items():
                    assert before in text, before
                    text = text.replace(before, after)
                data = text.encode()
            new.writestr(member, data)
    return path
