"""FMUs of fmi2_quirks.c: each with the quirks that a test asks for."""

from __future__ import annotations

import subprocess
import zipfile
from enum import IntFlag
from pathlib import Path

import fmpy

from fmu_export.native.toolchain import find_compiler
from tests.support.native_fmus import require_compiler


class Quirk(IntFlag):
    """In the order of the flags of fmi2_quirks.c."""

    NONE = 0
    NEEDS_STOP_TIME = 1
    NEEDS_TOLERANCE = 2
    KEEPS_STATE = 4
    KEEPS_GLOBALS = 8
    REFUSES_RESET = 16
    FAILS_TO_TERMINATE = 32
    IS_ASYNCHRONOUS = 64
    COMPUTES_IN_PART = 128
    REFUSES_TO_OVERSHOOT = 256
    REFUSES_DERIVATIVES = 512
    LACKS_DERIVATIVES = 1024
    REFUSES_OUTPUT = 2048


def quirky(
    folder: Path, quirks: Quirk = Quirk.NONE, *, experiment: str = "", any_step: bool = True, interpolates: bool = True
) -> Path:
    """An FMU with some quirks; `experiment` are the attributes of its DefaultExperiment."""
    require_compiler()
    name = f"quirks{int(quirks)}{'' if any_step else '_fixed'}{'' if interpolates else '_holds'}{len(experiment)}"
    library = folder / f"{name}{fmpy.sharedLibraryExtension}"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", f"-DQUIRKS={int(quirks)}"]
    headers = Path(fmpy.__file__).parent / "c-code"
    source = Path(__file__).with_name("fmi2_quirks.c")
    command = [*find_compiler(), *flags, f"-I{headers}", str(source), "-lm", "-o", str(library)]
    subprocess.run(command, check=True)
    variables = "".join(
        f'<ScalarVariable name="{label}" valueReference="{reference}" causality="{causality}" {more}>'
        f"<Real{start}/></ScalarVariable>"
        for reference, (label, causality, more, start) in enumerate(
            (
                ("u", "input", "", ' start="0"'),
                ("y", "output", "", ""),
                ("stop_time", "output", "", ""),
                ("tolerance", "output", "", ""),
                ("end", "parameter", 'variability="fixed" initial="exact"', ' start="1e9"'),
                ("internal", "parameter", 'variability="fixed" initial="exact"', ' start="0"'),
                ("longest", "parameter", 'variability="fixed" initial="exact"', ' start="1e9"'),
            )
        )
    )
    outputs = "".join(f'<Unknown index="{i}" dependencies=""/>' for i in (2, 3, 4))
    capabilities = {
        "canHandleVariableCommunicationStepSize": any_step,
        "canInterpolateInputs": interpolates,
        "canRunAsynchronuously": Quirk.IS_ASYNCHRONOUS in quirks,
    }
    attributes = " ".join(f'{key}="{str(value).lower()}"' for key, value in capabilities.items())
    path = folder / f"{name}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(library, f"binaries/{fmpy.platform}/{library.name}")
        archive.writestr(
            "modelDescription.xml",
            f'<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{{{name}}}">'
            f'<CoSimulation modelIdentifier="{name}" {attributes}/>'
            f"<DefaultExperiment {experiment}/><ModelVariables>{variables}</ModelVariables>"
            f"<ModelStructure><Outputs>{outputs}</Outputs><InitialUnknowns>{outputs}</InitialUnknowns></ModelStructure>"
            "</fmiModelDescription>",
        )
    return path
