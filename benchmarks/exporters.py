"""Exporters of FMUs on one model: size of the archive, time of a step, and error; those that are installed.

The model is Van der Pol's oscillator with mu = 1, by Runge-Kutta of order 4 with a step of 1 ms: inside the FMU in
co-simulation, in the host in model exchange. The host is a loop in C, so that what is measured is the FMU.
"""

from __future__ import annotations

import ctypes
import shutil
import statistics
import sys
import tempfile
import textwrap
from collections.abc import Callable, Iterator
from contextlib import ExitStack, chdir, contextmanager, redirect_stdout
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter

import casadi
import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Model, FMU3Slave
from scipy.integrate import solve_ivp

from benchmarks.measure import Section, interleaved
from fmu_export import ModelClass, build_native, build_pythonfmu, parameter, state
from fmu_export.native.toolchain import compile_library, host_target

STEP, CHECKED = 1e-3, 2000  # s, and steps after which states are compared
ROUNDS = 7

_LOOPS = b"""
#include <stddef.h>
#include <stdbool.h>
#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
typedef int Step2(void *, double, double, int);
typedef int Step3(void *, double, double, bool, bool *, bool *, bool *, double *);
typedef int SetTime(void *, double);
typedef int SetStates(void *, const double *, size_t);
typedef int GetDerivatives(void *, double *, size_t);
EXPORT int fmi2_steps(Step2 *do_step, void *instance, double h, int begin, int n) {
    int status = 0;
    for (int i = begin; i < begin + n && !status; i++) status = do_step(instance, i * h, h, 1);
    return status;
}
EXPORT int fmi3_steps(Step3 *do_step, void *instance, double h, int begin, int n) {
    int status = 0;
    bool event, end, early;
    double last;
    for (int i = begin; i < begin + n && !status; i++)
        status = do_step(instance, i * h, h, true, &event, &end, &early, &last);
    return status;
}
static SetTime *set_time;
static SetStates *set_states;
static GetDerivatives *get_derivatives;
static int evaluate(void *instance, double t, const double *x, double *dx) {
    int status = set_time(instance, t);
    status |= set_states(instance, x, 2);
    return status | get_derivatives(instance, dx, 2);
}
EXPORT int rk4_steps(void *functions[3], void *instance, double h, int begin, int n, double x[2]) {
    int status = 0;
    double k1[2], k2[2], k3[2], k4[2], y[2];
    set_time = (SetTime *)functions[0];
    set_states = (SetStates *)functions[1];
    get_derivatives = (GetDerivatives *)functions[2];
    for (int i = begin; i < begin + n && !status; i++) {
        double t = i * h;
        status |= evaluate(instance, t, x, k1);
        for (int j = 0; j < 2; j++) y[j] = x[j] + 0.5 * h * k1[j];
        status |= evaluate(instance, t + 0.5 * h, y, k2);
        for (int j = 0; j < 2; j++) y[j] = x[j] + 0.5 * h * k2[j];
        status |= evaluate(instance, t + 0.5 * h, y, k3);
        for (int j = 0; j < 2; j++) y[j] = x[j] + h * k3[j];
        status |= evaluate(instance, t + h, y, k4);
        for (int j = 0; j < 2; j++) x[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j]);
    }
    return status;
}
"""


class Oscillator(ModelClass, step_size=STEP, stop_time=20.0):
    """Van der Pol's oscillator."""

    mu = parameter(1.0, "1", "Damping")
    x = state(2.0, "1", "Position")
    v = state(0.0, "s-1", "Speed")

    def derivatives(m):  # noqa: D102, N805 : methods of models take m
        return dict(x=m.v, v=m.mu * (1.0 - m.x**2) * m.v - m.x)


#: One Runge-Kutta step in plain Python, for the exporters of Python that leave the integration to the model.
_RK4 = """
def derivatives(mu, x, v):
    return v, mu * (1.0 - x * x) * v - x


def rk4(mu, x, v, h):
    a, b = derivatives(mu, x, v)
    c, d = derivatives(mu, x + 0.5 * h * a, v + 0.5 * h * b)
    e, f = derivatives(mu, x + 0.5 * h * c, v + 0.5 * h * d)
    g, k = derivatives(mu, x + h * e, v + h * f)
    return x + h / 6.0 * (a + 2.0 * c + 2.0 * e + g), v + h / 6.0 * (b + 2.0 * d + 2.0 * f + k)

"""

_PYTHONFMU = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real
{rk4}
class Oscillator2(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.mu, self.x, self.v = 1.0, 2.0, 0.0
        self.register_variable(Real("mu", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        self.register_variable(Real("x", causality=Fmi2Causality.output))
        self.register_variable(Real("v", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        self.x, self.v = rk4(self.mu, self.x, self.v, step_size)
        return True
"""

_PYTHONFMU3 = """
from pythonfmu3 import Fmi3Causality, Fmi3Initial, Fmi3Slave, Fmi3StepResult, Fmi3Variability, Float64
from pythonfmu3.cosimulation import CoSimulation
from pythonfmu3.enums import Fmi3Status
from pythonfmu3.modelexchange import ModelExchange
{rk4}
class Oscillator3(Fmi3Slave, CoSimulation, ModelExchange):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time, self.mu, self.x, self.v, self.dx, self.dv = 0.0, 1.0, 2.0, 0.0, 0.0, 0.0
        c, tunable, continuous = Fmi3Causality, Fmi3Variability.tunable, Fmi3Variability.continuous
        self.register_variable(Float64("time", causality=c.independent))
        self.register_variable(Float64("mu", causality=c.parameter, variability=tunable, start=1.0))
        exact = Fmi3Initial.exact
        for name, start in (("x", 2.0), ("v", 0.0)):
            how = dict(causality=c.output, variability=continuous, initial=exact, start=start)
            self.register_variable(Float64(name, **how))
        for reference, name in ((2, "dx"), (3, "dv")):
            self.register_variable(Float64(name, causality=c.local, variability=continuous, derivative=reference))

    def get_continuous_state_derivatives(self):
        return list(derivatives(self.mu, self.x, self.v))

    def do_step(self, current_time, step_size):
        self.x, self.v = rk4(self.mu, self.x, self.v, step_size)
        return Fmi3StepResult(status=Fmi3Status.ok)
"""

_UNIFMU = """
import logging

from fmi2 import Fmi2FMU, Fmi2Status

logging.disable(logging.INFO)
{rk4}
class Model(Fmi2FMU):
    def __init__(self, reference_to_attr=None):
        super().__init__(reference_to_attr)
        self.mu, self.x, self.v = 1.0, 2.0, 0.0

    def do_step(self, current_time, step_size, no_step_prior):
        self.x, self.v = rk4(self.mu, self.x, self.v, step_size)
        return Fmi2Status.ok
"""

_UNIFMU_DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="unifmu" guid="oscillator">
  <CoSimulation modelIdentifier="unifmu" needsExecutionTool="true" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <ScalarVariable name="mu" valueReference="0" variability="fixed" causality="parameter">
      <Real start="1"/>
    </ScalarVariable>
    <ScalarVariable name="x" valueReference="1" causality="output" initial="calculated"><Real/></ScalarVariable>
    <ScalarVariable name="v" valueReference="2" causality="output" initial="calculated"><Real/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="2"/><Unknown index="3"/></Outputs>
    <InitialUnknowns><Unknown index="2"/><Unknown index="3"/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""


def script(folder: Path, name: str, text: str) -> Path:
    """A model in Python, as a file."""
    path = folder / name
    path.write_text(textwrap.dedent(text).format(rk4=_RK4), encoding="utf-8")
    return path


def with_pythonfmu(folder: Path) -> Path:
    """The FMU that pythonfmu writes."""
    from pythonfmu.builder import FmuBuilder

    path: Path = FmuBuilder.build_FMU(script(folder, "oscillator2.py", _PYTHONFMU), folder)
    return path


def with_pythonfmu3(folder: Path) -> Path:
    """The FMU that PythonFMU3 writes."""
    from pythonfmu3.builder import FmuBuilder

    FmuBuilder.build_FMU(script(folder, "oscillator3.py", _PYTHONFMU3), folder)
    return folder / "Oscillator3.fmu"


def with_unifmu(folder: Path) -> Path:
    """The FMU that UniFMU writes, with its server in Python and without the log of every call."""
    from unifmu.generate import generate_fmu_from_backend

    content = folder / "content"
    generate_fmu_from_backend("python", str(content))
    script(content / "resources", "model.py", _UNIFMU)
    (content / "modelDescription.xml").write_text(_UNIFMU_DESCRIPTION, encoding="utf-8")
    launch = content / "resources" / "launch.toml"
    launch.write_text(launch.read_text(encoding="utf-8").replace('"python3"', f'"{sys.executable}"'), encoding="utf-8")
    return Path(shutil.make_archive(str(folder / "oscillator"), "zip", content)).rename(folder / "unifmu.fmu")


def with_casadi(folder: Path) -> Path:
    """The FMU that CasADi's DaeBuilder writes."""
    builder = casadi.DaeBuilder("oscillator")
    mu = builder.add("mu", "parameter", "tunable", {"start": 1.0})
    x = builder.add("x", "output", "continuous", {"start": 2.0})
    v = builder.add("v", "output", "continuous", {"start": 0.0})
    builder.eq(builder.der(x), v)
    builder.eq(builder.der(v), mu * (1.0 - x**2) * v - x)
    headers = str(Path(fmpy.__file__).parent / "c-code")
    with chdir(folder):
        files = builder.export_fmu({"no_warning": True})
        files = builder.compile_fmu(files, {"include_dirs": [headers], "compiler_options": {"flags": ["-O2"]}})
        return folder / builder.pack_fmu(files, {})


@dataclass(frozen=True)
class Exporter:
    """A tool, with the way to write the FMU and the packages that it takes.

    Attributes
    ----------
    title : str
        As it is shown.
    write : function
        Writes the FMU into a folder.
    kinds : tuple of str
        Interfaces that are measured: `fmi2`, `fmi3` (co-simulation) and `fmi3 ME` (model exchange).
    steps : int
        Steps of a round.
    distribution : str
        The tool's package, whose version is shown; empty for our own.
    needs : tuple of str
        Further packages.
    """

    title: str
    write: Callable[[Path], Path]
    kinds: tuple[str, ...]
    steps: int
    distribution: str = ""
    needs: tuple[str, ...] = ()

    @property
    def missing(self) -> str:
        """The packages that it lacks here; empty when there are all of them."""
        lacking = []
        for package in filter(None, (self.distribution, *self.needs)):
            try:
                found = version(package)
            except PackageNotFoundError:
                lacking.append(package)
            else:
                if (
                    package == "protobuf" and int(found.partition(".")[0]) > 3
                ):  # the code that UniFMU generated is older
                    lacking.append("protobuf 3.20")
        return ", ".join(lacking)


EXPORTERS = (
    Exporter("fmu_export, FMI 2.0", lambda to: build_native(Oscillator, to, "fmi2"), ("fmi2",), 20_000),
    Exporter("fmu_export, FMI 3.0", lambda to: build_native(Oscillator, to, "fmi3"), ("fmi3", "fmi3 ME"), 20_000),
    Exporter("fmu_export, pythonfmu flavour", lambda to: build_pythonfmu(Oscillator, to), ("fmi2",), 2000),
    Exporter("pythonfmu", with_pythonfmu, ("fmi2",), 2000, "pythonfmu"),
    Exporter("PythonFMU3", with_pythonfmu3, ("fmi3", "fmi3 ME"), 2000, "pythonfmu3"),
    Exporter("UniFMU in Python,", with_unifmu, ("fmi2",), 500, "unifmu", ("grpcio", "protobuf")),
    Exporter("CasADi DaeBuilder", with_casadi, ("fmi3 ME",), 20_000, "casadi"),
)


class Run:
    """An initialised instance, which is stepped by the loop in C from where it is."""

    def __init__(self, loops: ctypes.CDLL, instance: FMU2Slave, references: list[int], kind: str) -> None:
        self._loops, self._instance, self._references, self._kind = loops, instance, references, kind
        self._at = 0
        self._x = (ctypes.c_double * 2)(2.0, 0.0)
        names = ("SetTime", "SetContinuousStates", "GetContinuousStateDerivatives") if "ME" in kind else ("DoStep",)
        self._functions = (ctypes.c_void_p * len(names))(
            *(ctypes.cast(getattr(instance.dll, kind[:4] + name), ctypes.c_void_p).value for name in names)
        )

    def steps(self, n: int) -> float:
        """Seconds a step, over n of them."""
        instance = ctypes.c_void_p(self._instance.component)
        span = (ctypes.c_double(STEP), self._at, n)
        began = perf_counter()
        if "ME" in self._kind:
            status = self._loops.rk4_steps(self._functions, instance, *span, self._x)
        else:
            loop = getattr(self._loops, f"{self._kind}_steps")
            status = loop(ctypes.c_void_p(self._functions[0]), instance, *span)
        seconds = perf_counter() - began
        if status:
            raise RuntimeError(f"a call returned {status}")
        self._at += n
        return seconds / n

    @property
    def states(self) -> np.ndarray:
        """Position and speed."""
        if "ME" in self._kind:
            return np.array(self._x)
        get = self._instance.getReal if self._kind == "fmi2" else self._instance.getFloat64
        return np.array(get(self._references))


@contextmanager
def running(loops: ctypes.CDLL, fmu: Path, folder: Path, kind: str) -> Iterator[Run]:
    """An instance of an FMU, ready to step."""
    description = fmpy.read_model_description(fmu, validate=False)
    fmpy.extract(fmu, folder)
    part = description.modelExchange if "ME" in kind else description.coSimulation
    classes = {"fmi2": FMU2Slave, "fmi3": FMU3Slave, "fmi3 ME": FMU3Model}
    instance = classes[kind](
        guid=description.guid,
        unzipDirectory=str(folder),
        modelIdentifier=part.modelIdentifier,
        instanceName="oscillator",
    )
    instance.instantiate()
    if kind == "fmi2":
        instance.setupExperiment(startTime=0.0)
    instance.enterInitializationMode()
    instance.exitInitializationMode()
    if "ME" in kind:
        instance.enterContinuousTimeMode()
    references = {v.name: v.valueReference for v in description.modelVariables}
    try:
        yield Run(loops, instance, [references["x"], references["v"]], kind)
    finally:
        instance.terminate()
        instance.freeInstance()


def expected() -> np.ndarray:
    """The states after the steps that are compared."""
    derivatives = Oscillator.model().derivatives
    found = solve_ivp(
        lambda t, x: derivatives(t, x, np.empty(0), np.array([1.0, 2.0, 0.0])),
        (0.0, CHECKED * STEP),
        [2.0, 0.0],
        "DOP853",
        rtol=1e-13,
        atol=1e-13,
    )
    return np.array(found.y[:, -1])


def measure_exporters() -> Section:
    """All exporters that are installed."""
    rows, absent, sizes, errors = [], [], {}, {}
    solution = expected()
    with ExitStack() as stack:
        temporary = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        library = temporary / f"loops{host_target().suffix}"
        library.write_bytes(compile_library({"loops.c": _LOOPS}, "loops"))
        loops = ctypes.CDLL(str(library))
        calls: dict[tuple[str, str], Callable[[], float]] = {}
        for i, exporter in enumerate(EXPORTERS):
            if exporter.missing:
                absent.append(f"{exporter.title.rstrip(',')} (lacks {exporter.missing})")
                continue
            folder = temporary / f"exporter{i}"
            folder.mkdir()
            with redirect_stdout(sys.stderr):
                fmu = exporter.write(folder)
            title = f"{exporter.title} {version(exporter.distribution)}" if exporter.distribution else exporter.title
            for kind in exporter.kinds:
                run = stack.enter_context(running(loops, fmu, folder / kind, kind))
                run.steps(CHECKED)
                sizes[title, kind] = fmu.stat().st_size
                errors[title, kind] = float(np.abs(run.states - solution).max())
                calls[title, kind] = lambda run=run, n=exporter.steps: run.steps(n)
        seconds = interleaved(calls, ROUNDS)
    names = {"fmi2": "co-simulation", "fmi3": "co-simulation", "fmi3 ME": "model exchange"}
    for title, kind in calls:
        microseconds = statistics.median(seconds[title, kind]) * 1e6
        size = f"{sizes[title, kind] / 1000:,.0f}"
        rows.append((title, names[kind], size, f"{microseconds:.3g}", f"{errors[title, kind]:.0e}"))
    return Section(
        "Exporters",
        "Van der Pol's oscillator with mu = 1, one Runge-Kutta step of 1 ms a step, called from a loop in C; in model "
        f"exchange the loop integrates, with four evaluations. Medians of {ROUNDS} interleaved rounds; the error is "
        f"that of the states after {CHECKED * STEP:g} s, against scipy's DOP853 at 1e-13."
        + (f" Not installed here: {'; '.join(absent)}." if absent else ""),
        ("exporter", "interface", "archive (kB)", "us a step", "error"),
        rows,
        {"seconds": {" ".join(key): value for key, value in seconds.items()}},
        [(f"largest error: {max(errors.values()):.0e}, at most 1e-9", max(errors.values()) <= 1e-9)],
    )
