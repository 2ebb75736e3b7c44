"""`RobotClosedLoop`: the continuous closed loop in one FMU, and what coupled FMUs tend to as their step shrinks."""

from __future__ import annotations

import itertools
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from cosim import Results, Simulation, SimulationError, System, simulate
from cosim.regression import Case, check
from fmu_export.control_backend import to_control
from fmu_export.native.backend import build_native
from fmu_export.pythonfmu.backend import build_pythonfmu
from parallel_robot import continuous_loop as closed_loop
from parallel_robot.fmus import BUILDABLE, CLOSED_LOOP, fmu_path
from parallel_robot.models import MODELS, closed_loop_model
from parallel_robot.wiring import CONNECTIONS
from tests.support.compilation import shared_compilation
from tests.support.continuous_loop import end_effector, solve
from tests.support.fmu_documentation import members_of, parsed, terminals
from tests.support.native_fmus import DEFAULT_FLAVOUR, require_compiler

ENDS = ["plant.x_E", "plant.y_E"]
#: Torque of the disturbance (N m) and mass change (kg) of the runs here.
TAU_D, DM = [0.05, -0.03, 0.04], 0.1
STOP_TIME = 3.0
TIMES = np.arange(0, 3001, 24) * 1e-3  # communication points of all steps used here


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    require_compiler()
    folder = tmp_path_factory.mktemp("closed loop")
    with shared_compilation():
        for flavour in ("fmi2", "fmi3"):
            build_native(closed_loop_model(), folder / flavour, flavour)
    build_pythonfmu(closed_loop_model(), folder / "pythonfmu")
    return folder


@pytest.fixture(scope="module")
def path() -> np.ndarray:
    """End effector (n, 2) in m of the continuous loop at `TIMES`."""
    return end_effector(solve(TIMES, lambda _: np.array([*TAU_D, DM, 0.0]), [], rtol=1e-11))


def whole(folder: Path, flavour: str = "fmi2", step: float = 1e-3, **start: float) -> Results:
    system = System()
    system.add("loop", fmu_path(folder, flavour, CLOSED_LOOP), {"plant.tau_d": TAU_D, "plant.dm": DM, **start})
    return simulate(system, STOP_TIME, step, tolerance=1e-9)


def ends(results: Results, prefix: str = "", every: float = 24e-3) -> np.ndarray:
    """End effector (n, 2) in m at `TIMES`."""
    rows = np.round(results.time / every).astype(int)
    at_times = np.abs(results.time - rows * every) < 1e-9
    return np.column_stack([results[f"{prefix}{name}"] for name in ENDS])[at_times]


def distance(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.hypot(*(a - b).T).max())


def test_files_have_the_names_of_their_models() -> None:
    models = {**MODELS, CLOSED_LOOP: closed_loop_model()}
    assert {c: fmu_path(Path(), "fmi2", c).stem for c in BUILDABLE} == {c: m.name for c, m in models.items()}


@pytest.mark.parametrize(
    "flavour", ["fmi3", *(pytest.param(flavour, marks=pytest.mark.slow) for flavour in ("fmi2", "pythonfmu"))]
)
def test_validation_finds_nothing(folder: Path, flavour: str) -> None:
    assert validate_fmu(str(fmu_path(folder, flavour, CLOSED_LOOP))) == []


@pytest.mark.parametrize("interface", ["co_simulation", "model_exchange"])
def test_the_fmu_gives_its_reference(folder: Path, interface: str) -> None:
    name = closed_loop_model().name
    case = Case(name, Path(__file__).parents[2] / "reference" / name)
    assert check(case, fmu_path(folder, "fmi3", CLOSED_LOOP), interface, isolated=False).findings == []


def test_rates_are_those_of_python_control() -> None:
    """The same connections made by another library, at states away from the path."""
    model, oracle = closed_loop_model(), closed_loop.closed_loop()
    rng = np.random.default_rng(3)
    for _ in range(5):
        t, p = rng.uniform(0.0, 15.0), model.parameters.starts
        x = model.initial_state(p) + rng.uniform(-0.1, 0.1, 14)
        u = rng.uniform(-0.1, 0.1, 5)
        expected = oracle.dynamics(t, x, u)
        np.testing.assert_allclose(model.derivatives(t, x, u, p), expected, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(model.output_values(t, x, u, p), oracle.output(t, x, u), rtol=1e-12, atol=1e-12)


def test_it_is_a_system_of_python_control_too() -> None:
    """The composed model, and the interconnection of the models by python-control: the same signals."""
    system, oracle = to_control(closed_loop_model()), closed_loop.closed_loop()
    assert system.input_labels == oracle.input_labels
    assert system.output_labels == oracle.output_labels
    assert system.nstates == oracle.nstates


@pytest.mark.parametrize("flavour", ["fmi2", "fmi3"])
@pytest.mark.parametrize("step", [1e-3, 24e-3])
def test_co_simulation_is_the_continuous_loop_whatever_the_step(
    folder: Path, path: np.ndarray, flavour: str, step: float
) -> None:
    """Nothing is sampled between the parts, so that the communication step has no effect beyond rounding."""
    assert distance(ends(whole(folder, flavour, step), "loop."), path) < 1e-10


@pytest.mark.parametrize("flavour", ["fmi2", "fmi3"])
def test_model_exchange_is_the_continuous_loop(folder: Path, path: np.ndarray, flavour: str) -> None:
    found = fmpy.simulate_fmu(
        str(fmu_path(folder, flavour, CLOSED_LOOP)),
        fmi_type="ModelExchange",
        solver="CVode",
        stop_time=STOP_TIME,
        output_interval=24e-3,
        relative_tolerance=1e-10,
        start_values={**{f"plant.tau_d[{i + 1}]": value for i, value in enumerate(TAU_D)}, "plant.dm": DM},
        output=ENDS,
    )
    np.testing.assert_allclose(found["time"], TIMES, atol=1e-9)
    assert distance(np.column_stack([found[name] for name in ENDS]), path) < 1e-8


@pytest.mark.parametrize(("coupling", "order"), [("hold", 1), ("linear", 2)])
def test_coupled_fmus_tend_to_it_with_the_order_of_their_coupling(
    folder: Path,
    robot_fmus: Path,
    coupling: str,
    order: int,
) -> None:
    expected = ends(whole(folder), "loop.")
    system = System()
    for name in MODELS:
        start = {"tau_d": TAU_D, "dm": DM} if name == "plant" else {}
        system.add(name, fmu_path(robot_fmus, "fmi2", name), start)
    for source, target in CONNECTIONS:
        system.connect(source, target)
    steps = [8e-3, 4e-3, 2e-3, 1e-3]
    with Simulation(system, extrapolation=coupling) as simulation:
        errors = [distance(ends(simulation.run(STOP_TIME, step)), expected) for step in steps]
    orders = [np.log2(a / b) for a, b in itertools.pairwise(errors)]
    print(coupling, [f"{e:.2e}" for e in errors], [f"{o:.3f}" for o in orders])
    assert np.abs(np.array(orders) - order).max() < 0.15


@pytest.mark.parametrize("order", ["sequential", "parallel"])
@pytest.mark.parametrize("step", [1e-3, 24e-3])
def test_fmus_in_model_exchange_are_the_composed_model(folder: Path, robot_fmus: Path, order: str, step: float) -> None:
    """Their equations are coupled: at the same steps of one method nothing but rounding tells them from one model."""
    system = System()
    for name in MODELS:
        start = {"tau_d": TAU_D, "dm": DM} if name == "plant" else {}
        system.add(name, fmu_path(robot_fmus, DEFAULT_FLAVOUR, name), start)
    for source, target in CONNECTIONS:
        system.connect(source, target)
    coupled = simulate(system, STOP_TIME, step, order=order, interface="model-exchange", solver="rk4")
    one = System()
    one.add("loop", fmu_path(folder, "fmi3", CLOSED_LOOP), {"plant.tau_d": TAU_D, "plant.dm": DM})
    together = simulate(one, STOP_TIME, step, interface="model-exchange", solver="rk4")
    names = [name for name in coupled.names if f"loop.{name}" in together.names]
    assert {"plant.x_E", "plant.omega_b[3]", "controller.tau_a[1]", "trajectory.theta_ref[2]"} <= set(names)
    for name in names:
        np.testing.assert_allclose(coupled[name], together[f"loop.{name}"], rtol=0.0, atol=1e-12, err_msg=name)
    assert not any(coupled.info["extrapolation"].get(name) for name in ("linear", "adaptive"))
    assert coupled.info["model_exchange"]["steps"] == round(STOP_TIME / step)


@pytest.mark.parametrize("step", [24e-3, 12e-3])
def test_model_exchange_has_the_order_of_its_method(robot_fmus: Path, path: np.ndarray, step: float) -> None:
    """At steps at which hold and linear extrapolation are off by millimetres."""
    system = System()
    for name in MODELS:
        start = {"tau_d": TAU_D, "dm": DM} if name == "plant" else {}
        system.add(name, fmu_path(robot_fmus, DEFAULT_FLAVOUR, name), start)
    for source, target in CONNECTIONS:
        system.connect(source, target)
    with Simulation(system, interface="model-exchange") as simulation:
        errors = [distance(ends(simulation.run(STOP_TIME, h)), path) for h in (step, step / 2.0)]
    assert errors[0] < 1e-5
    assert np.log2(errors[0] / errors[1]) > 3.7


def test_parameters_of_the_parts_take_effect(folder: Path, robot_fmus: Path) -> None:
    """With another gain and another path, as the coupled FMUs with the same ones."""
    changed = {"controller.alpha": 0.2, "trajectory.R": 0.3, "plant.x_E_start": 0.21}
    one = whole(folder, **changed)
    system = System()
    for name in MODELS:
        start = {"tau_d": TAU_D, "dm": DM} if name == "plant" else {}
        own = {path.partition(".")[2]: v for path, v in changed.items() if path.startswith(name)}
        system.add(name, fmu_path(robot_fmus, "fmi2", name), {**start, **own})
    for source, target in CONNECTIONS:
        system.connect(source, target)
    coupled = ends(simulate(system, STOP_TIME, 1e-3))
    assert distance(ends(one, "loop."), coupled) < 3e-7
    assert distance(ends(whole(folder), "loop."), coupled) > 1e-3


def test_a_violated_requirement_names_its_part(folder: Path) -> None:
    with pytest.raises(SimulationError, match=r"trajectory: the desired path .* leaves the reach of chain"):
        whole(folder, **{"trajectory.a": 30.0})


def test_structure_shows_what_passes_through(folder: Path) -> None:
    """Of the outputs only force and energy depend on an input at once, and nothing that was connected is an input."""
    description = fmpy.read_model_description(str(fmu_path(folder, "fmi2", CLOSED_LOOP)))
    inputs = {v.name for v in description.modelVariables if v.causality == "input"}
    assert inputs == {"plant.dm", "plant.dm_rate", *(f"plant.tau_d[{i}]" for i in (1, 2, 3))}
    depends = {u.variable.name: {v.name for v in u.dependencies} for u in description.outputs}
    passing = {name for name, on in depends.items() if on & inputs}
    assert passing == {*(f"plant.F_c[{i}]" for i in range(1, 7)), "plant.kinetic_energy"}


def test_documentation_and_terminals() -> None:
    model = closed_loop_model()
    members = members_of(model, "# The closed loop", "fmi3")
    page = parsed(members)
    assert model.description in page.text["body"]
    cells = {row[0] for row in page.rows}
    assert {"plant.x_E", "controller.alpha", "trajectory.x_c", "max_step"} <= cells
    vectors = {v.name for v in (*model.inputs.variables, *model.outputs.variables) if v.size}
    assert terminals(model, members).keys() == vectors
