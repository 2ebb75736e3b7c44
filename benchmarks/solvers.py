"""Solvers of our FMUs against CVode: the same models in FMPy, by co-simulation and by model exchange."""

from __future__ import annotations

import runpy
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.measure import Section
from fmu_export import build_native
from fmu_export.modelling.model import Model, Solver

EXAMPLES = Path(__file__).parents[1] / "examples" / "models"
ROUNDS = 5


@dataclass(frozen=True)
class Problem:
    """A run of an example model, with states that are recorded at each communication point."""

    title: str
    module: str
    class_name: str
    stop: float
    step: float

    @property
    def model(self) -> Model:
        """The flat model."""
        found: Model = runpy.run_path(str(EXAMPLES / f"{self.module}.py"))[self.class_name].model()
        return found

    @property
    def times(self) -> np.ndarray:
        """The communication points."""
        return np.arange(round(self.stop / self.step) + 1) * self.step


PROBLEMS = (
    Problem("Robertson, one step of 40 s", "robertson", "Robertson", 40.0, 40.0),
    Problem("Robertson, one step of 1e5 s", "robertson", "Robertson", 1e5, 1e5),
    Problem("Van der Pol, mu = 1000, 2000 s by 1 s", "van_der_pol", "VanDerPol", 2000.0, 1.0),
    Problem("heat in a rod, 50 states, 20 s by 0.1 s", "heat_equation", "HeatEquation", 20.0, 0.1),
    Problem("pendulum of three links, 5 s by 10 ms", "n_link_pendulum", "NLinkPendulum", 5.0, 0.01),
)

SOLVERS: tuple[Solver, ...] = ("rodas4", "dopri5", "rk4")
CVODE = (1e-6, 1e-8, 1e-10)


def solution(problem: Problem) -> np.ndarray:
    """States (n, n_x) at the communication points."""
    model = problem.model
    p, u = model.parameters.starts, model.inputs.starts
    found = solve_ivp(
        lambda t, x: model.derivatives(t, x, u, p),
        (0.0, problem.stop),
        model.initial_state(p),
        "Radau",
        rtol=1e-12,
        atol=1e-15,
        t_eval=problem.times,
    )
    return np.array(found.y.T)


def runner(fmu: Path, folder: Path, problem: Problem, **options: Any) -> Callable[[], tuple[float, np.ndarray]]:
    """A function that runs an FMU in FMPy: seconds, and the states (n, n_x); the instance is made before."""
    fmpy.extract(fmu, folder)
    description = fmpy.read_model_description(folder)
    states = list(problem.model.state_layout.names)
    instance = fmpy.instantiate_fmu(folder, description, options["fmi_type"])

    def run() -> tuple[float, np.ndarray]:
        instance.reset()
        began = time.perf_counter()
        table = fmpy.simulate_fmu(
            folder,
            stop_time=problem.stop,
            step_size=problem.step,
            output_interval=problem.step,
            output=states,
            record_events=False,
            model_description=description,
            fmu_instance=instance,
            **options,
        )
        seconds = time.perf_counter() - began
        if len(table) != len(problem.times):
            raise RuntimeError("the run has ended early")
        return seconds, np.stack([table[name] for name in states], axis=1)

    return run


def measure(problem: Problem) -> list[tuple[str, str, str, str]]:
    """Error and time of each way to integrate a problem."""
    expected = solution(problem)
    largest = np.abs(expected).max(axis=0)
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        ways: dict[str, Callable[[], tuple[float, np.ndarray]]] = {}
        for solver in SOLVERS:
            folder = Path(temporary) / solver
            fmu = build_native(replace(problem.model, solver=solver), folder, "fmi2")
            ways[f"co-simulation, {solver}"] = runner(fmu, folder / "cs", problem, fmi_type="CoSimulation")
        for rtol in CVODE:
            ways[f"model exchange, CVode at {rtol:g}"] = runner(
                fmu, Path(temporary) / f"{rtol}", problem, fmi_type="ModelExchange", relative_tolerance=rtol
            )
        for way, run in ways.items():
            error, seconds = "fails", "-"
            with suppress(Exception):  # FMPy and its CVode raise whatever they like
                results = [run() for _ in range(ROUNDS)]
                error = f"{(np.abs(results[0][1] - expected).max(axis=0) / largest).max():.1e}"
                seconds = f"{1e3 * min(s for s, _ in results):.1f}"
            rows.append((problem.title, way, error, seconds))
    return rows


def measure_solvers() -> Section:
    """All problems."""
    return Section(
        "Solvers",
        "Largest error of a state at the communication points, relative to its largest value, against scipy's Radau at "
        f"1e-12; time of a run in FMPy, best of {ROUNDS}. Our solvers run with default settings.",
        ("model", "integrated by", "error", "ms"),
        [row for problem in PROBLEMS for row in measure(problem)],
        {},
        [],
    )
