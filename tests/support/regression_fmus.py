"""FMUs for the tests of the regression, after the examples that the FMI project publishes, and their cases."""

from __future__ import annotations

import atexit
import subprocess
import zipfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fmpy
import numpy as np

from cosim.regression.case import Case
from cosim.results.results import Results
from fmu_export.modelling.model import DefaultExperiment, Model
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.native.backend import build_native
from fmu_export.native.toolchain import find_compiler
from tests.support.compilation import shared_compilation
from tests.support.native_fmus import require_compiler


def _model(
    name: str,
    parameters: Sequence[Variable],
    outputs: Sequence[Variable],
    output_values: Callable[..., Any],
    *,
    inputs: Sequence[Variable] = (),
    states: tuple[str, ...] = (),
    start: Sequence[float] = (),
    derivatives: Callable[..., Any] = lambda t, x, u, p: x,
    stop: float,
    step: float,
) -> Model:
    return Model(
        name=name,
        description=f"{name}, a model for tests",
        parameters=Layout(parameters),
        inputs=Layout(inputs),
        outputs=Layout(outputs),
        states=states,
        initial_state=lambda p: np.concatenate([0.0 * p[:0], np.array(start, dtype=float)]),
        derivatives=derivatives,
        output_values=output_values,
        default_experiment=DefaultExperiment(stop_time=stop, step_size=step),
    )


def _number(name: str, unit: str = "1", **options: Any) -> Variable:
    return Variable(name, unit, f"Test quantity {name}", **options)


#: x' = -k x: x(t) = exp(-k t).
DAHLQUIST = _model(
    "Dahlquist",
    [_number("k", start=1.0)],
    [_number("x", "m")],
    lambda t, x, u, p: x,
    states=("x",),
    start=[1.0],
    derivatives=lambda t, x, u, p: -p[0] * x,
    stop=2.0,
    step=0.01,
)

#: x0' = x1, x1' = mu (1 - x0^2) x1 - x0.
VAN_DER_POL = _model(
    "VanDerPol",
    [_number("mu", start=1.0)],
    [_number("x0"), _number("x1")],
    lambda t, x, u, p: x,
    states=("x0", "x1"),
    start=[2.0, 0.0],
    derivatives=lambda t, x, u, p: np.stack([x[1], p[0] * (1.0 - x[0] ** 2) * x[1] - x[0]]),
    stop=10.0,
    step=0.02,
)

#: y = K u.
FEEDTHROUGH = _model(
    "Feedthrough",
    [_number("K", start=1.0)],
    [_number("y", "rad")],
    lambda t, x, u, p: p[0] * u,
    inputs=[_number("u", "rad", start=0.25)],
    stop=1.0,
    step=0.05,
)

#: A step up by 1 at T, 2 T and 3 T.
STAIR = _model(
    "Stair",
    [_number("T", "s", start=0.25)],
    [_number("y")],
    lambda t, x, u, p: np.reshape(1.0 * (t >= p[0]) + 1.0 * (t >= 2.0 * p[0]) + 1.0 * (t >= 3.0 * p[0]), (1,)),
    stop=1.0,
    step=0.01,
)

MODELS = (DAHLQUIST, VAN_DER_POL, FEEDTHROUGH, STAIR)

_PARAMETERS = "\n".join(
    f'<ScalarVariable name="{name}" valueReference="{reference}" causality="parameter" variability="fixed">'
    f'<Real start="{start}"/></ScalarVariable>'
    for reference, (name, start) in enumerate({"g": 9.81, "e": 0.7, "crash_at": 1e9, "nan_at": 1e9}.items(), start=4)
)

_BALL = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Ball" guid="{{ball}}" numberOfEventIndicators="1">
<ModelExchange modelIdentifier="Ball"/>
<CoSimulation modelIdentifier="Ball" canHandleVariableCommunicationStepSize="true"/>
<UnitDefinitions><Unit name="m"><BaseUnit m="1"/></Unit></UnitDefinitions>
<DefaultExperiment startTime="0" stopTime="2" stepSize="0.01"/>
<ModelVariables>
<ScalarVariable name="h" valueReference="0" causality="output" initial="exact">
<Real unit="m" start="1"/></ScalarVariable>
<ScalarVariable name="v" valueReference="1" causality="output" initial="exact"><Real start="0"/></ScalarVariable>
<ScalarVariable name="der(h)" valueReference="2"><Real derivative="1"/></ScalarVariable>
<ScalarVariable name="der(v)" valueReference="3"><Real derivative="2"/></ScalarVariable>
{_PARAMETERS}
</ModelVariables>
<ModelStructure>
<Outputs><Unknown index="1"/><Unknown index="2"/></Outputs>
<Derivatives><Unknown index="3"/><Unknown index="4"/></Derivatives>
</ModelStructure>
</fmiModelDescription>
"""


@cache
def built_fmus() -> Path:
    """Folder with the FMUs of all models (FMI 2.0; Feedthrough in `fmi3` too) and of the ball; built once a worker."""
    require_compiler()
    temporary = TemporaryDirectory(prefix="regression_", ignore_cleanup_errors=True)
    atexit.register(temporary.cleanup)
    folder = Path(temporary.name)
    with shared_compilation():
        for model in MODELS:
            build_native(model, folder, "fmi2", reference=False)
        build_native(FEEDTHROUGH, folder / "fmi3", "fmi3", reference=False)
    build_ball(folder)
    return folder


def build_ball(folder: Path) -> Path:
    """The FMU of fmi2_ball.c, whose model exchange has a state event."""
    library = folder / f"Ball{fmpy.sharedLibraryExtension}"
    headers = Path(fmpy.__file__).parent / "c-code"
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", f"-I{headers}"]
    source = Path(__file__).with_name("fmi2_ball.c")
    subprocess.run([*find_compiler(), *flags, str(source), "-o", str(library), "-lm"], check=True)
    path = folder / "Ball.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", _BALL)
        archive.write(library, f"binaries/{fmpy.platform}/{library.name}")
    return path


def make_case(
    folder: Path,
    name: str,
    reference: Results | None = None,
    *,
    toml: str = "",
    opt: str = "",
    inputs: Results | None = None,
) -> Case:
    """Write the files of a case."""
    case = Case(name, folder / name)
    case.folder.mkdir(parents=True, exist_ok=True)
    if reference is not None:
        reference.to_csv(case.reference_path)
    if inputs is not None:
        inputs.to_csv(case.inputs_path)
    for text, path in ((toml, case.tolerances_path), (opt, case.options_path)):
        if text:
            path.write_text(text, encoding="utf-8")
    return case
