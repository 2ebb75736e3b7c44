"""Components in model exchange: their equations are coupled exactly, events included."""

from __future__ import annotations

import dataclasses
import math
import re
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from cosim import Results, SetupError, Simulation, SimulationError, System, simulate
from fmu_export.modelling.model import Model
from fmu_export.native.backend import build_native
from tests.support.changed_fmus import rewritten
from tests.support.compilation import shared_compilation
from tests.support.coupled_models import ALL, oscillation, oscillator_matrix
from tests.support.native_fmus import FLAVOURS, require_compiler

BY_NAME: Mapping[str, Model] = {model.name: model for model in ALL}

Find = Callable[[str, str], Path]

#: Two masses of which one moves at the start.
MASSES, START, SPRING, DAMPER = (2.0, 0.5), np.array([0.1, 0.0, 0.0, -0.3]), 50.0, 0.4


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Find:
    """The FMU of a model, built when it is first asked for."""
    require_compiler()
    folder = tmp_path_factory.mktemp("coupled")

    def built(name: str, flavour: str) -> Path:
        path = folder / flavour / f"{name}.fmu"
        if not path.exists():
            with shared_compilation():
                build_native(BY_NAME[name], path.parent, flavour)  # type: ignore[arg-type]
        return path

    return built


def oscillator(fmu: Find, *flavours: str, interface: str = "model-exchange") -> System:
    """Two masses and a spring, of the flavours that are given, or all of one."""
    first, second, spring = flavours if len(flavours) == 3 else 3 * flavours
    system = System()
    for name, flavour, m, (x, v) in zip("ab", (first, second), MASSES, START.reshape(2, 2), strict=True):
        system.add(name, fmu("Mass", flavour), {"m": m, "x_start": x, "v_start": v}, interface=interface)
    system.add("spring", fmu("Spring", spring), {"c": SPRING, "d": DAMPER}, interface=interface)
    for i, name in enumerate("ab", start=1):
        system.connect(f"{name}.x", f"spring.x[{i}]")
        system.connect(f"{name}.v", f"spring.v[{i}]")
        system.connect(f"spring.F[{i}]", f"{name}.F")
    return system


def motion(results: Results) -> np.ndarray:
    """Places and speeds (n, 4)."""
    return np.column_stack([results[name] for name in ("a.x", "a.v", "b.x", "b.v")])


def error(results: Results) -> float:
    return float(np.abs(motion(results) - oscillation(results.time, MASSES, START, SPRING, DAMPER)).max())


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_it_is_the_method_on_the_equations_of_the_whole(fmu: Find, order: str) -> None:
    """For linear equations a step of RK4 is the exponential of their matrix, cut off after the fourth power."""
    with Simulation(oscillator(fmu, "fmi2"), order=order) as simulation:
        results = simulation.run(2.0, 0.02)
    matrix = 0.02 * oscillator_matrix(MASSES, SPRING, DAMPER)
    step = sum(np.linalg.matrix_power(matrix, k) / math.factorial(k) for k in range(5))
    expected = [START]
    for _ in results.time[1:]:
        expected.append(step @ expected[-1])
    np.testing.assert_allclose(motion(results), expected, atol=1e-13)


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_a_communication_step_holds_several_steps_of_the_method(fmu: Find, order: str) -> None:
    with Simulation(oscillator(fmu, "fmi2"), order=order, solver_step=0.02) as simulation:
        long = simulation.run(2.0, 0.1)
        short = simulation.run(2.0, 0.02)
    np.testing.assert_allclose(motion(long), motion(short)[::5], atol=1e-13)
    assert long.info["model_exchange"]["steps"] == 100
    with Simulation(oscillator(fmu, "fmi2"), order=order, solver="dopri5") as simulation:
        assert error(simulation.run(2.0, 0.1, tolerance=1e-9)) < 1e-7


def test_both_versions_and_their_mixtures_give_equal_bits(fmu: Find) -> None:
    expected = simulate(oscillator(fmu, "fmi2"), 1.0, 0.01)
    for flavours in [("fmi3",), ("fmi2", "fmi3", "fmi2"), ("fmi3", "fmi3", "fmi2")]:
        found = simulate(oscillator(fmu, *flavours), 1.0, 0.01)
        np.testing.assert_array_equal(found.values, expected.values, err_msg=str(flavours))
    again = simulate(oscillator(fmu, "fmi2"), 1.0, 0.01, threads=2)
    np.testing.assert_array_equal(again.values, expected.values)


def test_the_time_that_they_take_together_is_measured(fmu: Find) -> None:
    components = simulate(oscillator(fmu, "fmi2"), 1.0, 0.01, profile=True).info["profile"]["components"]
    assert list(components) == ["a", "b", "spring", "model exchange"]
    assert components["model exchange"]["steps"] == 100
    assert components["model exchange"]["steps_s"] > 0.0
    assert components["a"]["steps_s"] == 0.0


def test_a_solver_is_chosen_by_who_has_chosen_the_interface(fmu: Find, tmp_path: Path) -> None:
    """What has equations only runs without an option, by a method that finds its own steps."""
    only = tmp_path / "Mass.fmu"
    with zipfile.ZipFile(fmu("Mass", "fmi2")) as archive:
        xml = archive.read("modelDescription.xml").decode()
    rewritten(
        fmu("Mass", "fmi2"), only, modelDescription=re.sub(r"<CoSimulation.*</CoSimulation>", "", xml, flags=re.DOTALL)
    )
    alone = System()
    alone.add("mass", only, {"v_start": 0.5})
    results = simulate(alone, 1.0, 0.1)
    np.testing.assert_allclose(results["mass.x"], 0.5 * results.time, atol=1e-12)
    assert results.info["model_exchange"]["solver"] == "dopri5"
    assert results.info["fmus"]["mass"]["interface"] == "model-exchange"
    assert simulate(alone, 1.0, 0.1, interface="model-exchange").info["model_exchange"]["solver"] == "rk4"
    assert simulate(alone, 1.0, 0.1, solver_step=0.05).info["model_exchange"]["solver"] == "rk4"
    with pytest.raises(SetupError, match=r"has no co-simulation interface.*interface 'auto'"):
        simulate(alone, 1.0, 0.1, interface="co-simulation")
    both = simulate(oscillator(fmu, "fmi2", interface="auto"), 0.1, 0.1)
    assert "model_exchange" not in both.info


@pytest.mark.parametrize("extrapolation", ["hold", "linear"])
def test_a_component_in_co_simulation_sees_the_others_at_communication_points(fmu: Find, extrapolation: str) -> None:
    """The coupling with it has the order of its extrapolation; that of the others stays exact."""
    system = oscillator(fmu, "fmi2", "fmi3", "fmi2")
    system.components["b"] = dataclasses.replace(system.components["b"], interface="co-simulation")
    with Simulation(system, extrapolation=extrapolation) as simulation:
        errors = [error(simulation.run(1.0, step)) for step in (4e-3, 2e-3)]
        extrapolated = simulation.run(0.1, 0.1).info["extrapolation"]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0 if extrapolation == "linear" else 1.0, abs=0.25)
    assert {"a.F", "spring.x[1]", "spring.v[1]"} == set(extrapolated["model_exchange"])


def test_signals_are_interpolated_within_a_step(fmu: Find) -> None:
    """A force that rises linearly: the method integrates it exactly; held, it is late by half a step."""
    system = System()
    system.add("mass", fmu("Mass", "fmi2"), {"m": 1.0}, interface="model-exchange")
    system.drive("mass.F", lambda t: 6.0 * t)
    results = simulate(system, 1.0, 0.1)
    np.testing.assert_allclose(results["mass.x"], results.time**3, atol=1e-14)
    held = simulate(system, 1.0, 0.1, extrapolation="hold")
    assert held["mass.v"][-1] == pytest.approx(3.0 - 0.5 * 6.0 * 0.1, abs=1e-12)


def test_a_jump_of_a_signal_is_no_ramp(fmu: Find) -> None:
    system = System()
    system.add("mass", fmu("Mass", "fmi3"), {"m": 1.0}, interface="model-exchange")
    system.drive("mass.F", lambda t: 0.0 if t < 0.5 - 1e-9 else 1.0, breakpoints=[0.5])
    results = simulate(system, 1.0, 0.1)
    np.testing.assert_allclose(results["mass.v"], np.maximum(0.0, results.time - 0.5), atol=1e-14)


def test_a_disturbance_is_added_within_the_group(fmu: Find) -> None:
    """A constant that is added to what a connection carries acts in each stage."""
    system = oscillator(fmu, "fmi2")
    system.disturb("a.F", lambda t: 3.0 + 0.0 * t, vectorized=True)
    system.disturb("b.F", lambda t: 3.0 * MASSES[1] / MASSES[0] + 0.0 * t, vectorized=True)
    results = simulate(system, 1.0, 0.002)
    free = motion(results) - oscillation(results.time, MASSES, START, SPRING, DAMPER)
    t = results.time
    np.testing.assert_allclose(free, np.column_stack([0.75 * t**2, 1.5 * t, 0.75 * t**2, 1.5 * t]), atol=1e-7)


@pytest.mark.parametrize("solver", ["rk4", "dopri5"])
def test_saved_resumed_and_stepped_by_hand_it_is_the_same_run(fmu: Find, solver: str) -> None:
    with Simulation(oscillator(fmu, "fmi2", "fmi3", "fmi2"), solver=solver) as simulation:
        expected = simulation.run(1.0, 0.02)
        with simulation.start(0.02) as run:
            run.step(20)
            state = run.save()
            run.step(30)
            np.testing.assert_array_equal(run.results.values, expected.values)
            run.restore(state)
            run.step(30)
            np.testing.assert_array_equal(run.results.values, expected.values)
        np.testing.assert_array_equal(simulation.run(1.0, 0.02).values, expected.values)


def test_cvode_is_accurate_by_its_tolerance_and_says_that_it_cannot_be_saved(fmu: Find) -> None:
    with Simulation(oscillator(fmu, "fmi2", "fmi3", "fmi2"), solver="cvode") as simulation:
        errors = [error(simulation.run(1.0, 0.1, tolerance=tolerance)) for tolerance in (1e-5, 1e-9)]
        assert errors[0] < 1e-3
        assert errors[1] < 1e-6
        np.testing.assert_array_equal(simulation.run(1.0, 0.1).values, simulation.run(1.0, 0.1).values)
        with simulation.start(0.1) as run:
            run.step(3)
            with pytest.raises(SetupError, match="solver 'cvode' keeps earlier steps"):
                run.save()


# Events


def heated(fmu: Find, flavour: str) -> System:
    system = System()
    system.add("room", fmu("Room", flavour), interface="model-exchange")
    system.add("switch", fmu("Switch", flavour), interface="model-exchange")
    system.connect("room.T", "switch.T")
    system.connect("switch.on", "room.on")
    return system


def temperature(times: np.ndarray) -> tuple[np.ndarray, int]:
    """Of the heated room: exponentials between switchings, whose instants are logarithms; and how often it switches."""
    low, high, tau, rate, ambient = 18.0, 22.0, 80.0, 0.25, 12.0
    begin, T_0, on, switchings, T = 0.0, 20.0, False, -1, np.empty_like(times)
    while begin <= times[-1]:
        now, rest = times >= begin, ambient + (rate * tau if on else 0.0)
        T[now] = rest + (T_0 - rest) * np.exp(-(times[now] - begin) / tau)
        switch = high if on else low
        begin += tau * np.log((T_0 - rest) / (switch - rest))
        T_0, on, switchings = switch, not on, switchings + 1
    return T, switchings


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_an_event_of_one_component_reaches_the_others_at_its_time(fmu: Find, flavour: str) -> None:
    """The switch sees the temperature pass its limit inside a step, and heats from that instant on."""
    results = simulate(heated(fmu, flavour), 600.0, 7.5, solver_step=0.5)
    expected, switchings = temperature(results.time)
    np.testing.assert_allclose(results["room.T"], expected, atol=1e-9)
    assert results.info["model_exchange"]["events"] >= switchings > 10
    for solver, nearness in (("dopri5", 1e-7), ("cvode", 1e-5)):
        ours = simulate(heated(fmu, flavour), 600.0, 7.5, solver=solver, tolerance=1e-10)
        np.testing.assert_allclose(ours["room.T"], expected, atol=nearness, err_msg=solver)


def test_a_run_with_events_goes_on_where_it_was_saved(fmu: Find) -> None:
    with Simulation(heated(fmu, "fmi3")) as simulation:
        expected = simulation.run(300.0, 7.5)
        with simulation.start(7.5) as run:
            run.step(13)
            state = run.save()
            run.step(11)
            run.restore(state)
            run.step(27)
            np.testing.assert_array_equal(run.results.values, expected.values)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_discrete_inputs_from_outside_are_set_in_event_mode(fmu: Find, flavour: str) -> None:
    """A Boolean signal switches the heater at communication points."""
    system = System()
    system.add("room", fmu("Room", flavour), interface="model-exchange")
    system.drive("room.on", lambda t: t > 9.9)
    results = simulate(system, 20.0, 1.0)
    t, tau = results.time, 80.0
    cold = 12.0 + 8.0 * np.exp(-t / tau)
    warm = 32.0 + (12.0 + 8.0 * np.exp(-10.0 / tau) - 32.0) * np.exp(-(t - 10.0) / tau)
    np.testing.assert_allclose(results["room.T"], np.where(t < 10.0, cold, warm), atol=1e-8)
    with Simulation(_room(fmu, flavour)) as simulation, simulation.start(1.0) as run:
        run.step(10)
        run["room.on"] = True
        run.step(10)
        np.testing.assert_array_equal(run.results["room.T"], results["room.T"])


def _room(fmu: Find, flavour: str) -> System:
    system = System()
    system.add("room", fmu("Room", flavour), interface="model-exchange")
    return system


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_samplers_see_what_the_others_are_at_their_instants(fmu: Find, order: str) -> None:
    """A sampled controller of a mass, its instants between and on communication points; against the recursion."""
    system = System()
    system.add("law", fmu("Sampled", "fmi3"), {"K": 2.0}, interface="model-exchange")
    system.add("mass", fmu("Mass", "fmi2"), {"m": 1.0}, interface="model-exchange")
    system.connect("mass.x", "law.x", units="ignore")
    system.connect("law.u", "mass.F", units="ignore")
    results = simulate(system, 2.0, 0.25, order=order, record=["mass.x", "mass.v", "law.u"])
    x, v, rows, h = 0.0, 0.0, [], 0.05
    u = 0.0
    for k in range(41):
        if k % 2 == 0:
            u = 2.0 * (1.0 - x)
        if k % 5 == 0:
            rows.append((x, v, u))
        x, v = x + h * v + 0.5 * h**2 * u, v + h * u
    np.testing.assert_allclose(np.column_stack([results[n] for n in results.names]), rows, atol=1e-9)


def test_a_tunable_parameter_is_set_in_event_mode(fmu: Find) -> None:
    system = System()
    system.add("law", fmu("Sampled", "fmi3"), {"K": 2.0, "x": 0.25}, interface="model-exchange")
    with Simulation(system) as simulation, simulation.start(0.05) as run:
        run.step(4)
        assert run["law.u"] == 1.5
        run["law.K"] = 4.0
        run.step(2)
        assert run["law.u"] == 3.0


# What does not go


def test_what_makes_no_sense_is_refused_in_one_line(fmu: Find) -> None:
    mass = fmu("Mass", "fmi2")
    system = System()
    system.add("mass", mass, every=2, interface="model-exchange")
    with pytest.raises(SetupError, match=r"component 'mass': in model exchange .* every = 2 makes no sense"):
        simulate(system, 1.0, 0.1)
    with pytest.raises(SetupError, match="interface 'modelexchange' is unknown; did you mean 'model-exchange'"):
        System().add("mass", mass, interface="modelexchange")
    with pytest.raises(SetupError, match="interface 'cosimulation' is unknown"):
        simulate(oscillator(fmu, "fmi2"), 1.0, 0.1, interface="cosimulation")
    with pytest.raises(SetupError, match="solver 'rk45' is unknown; did you mean 'rk4'"):
        simulate(oscillator(fmu, "fmi2"), 1.0, 0.1, solver="rk45")
    with pytest.raises(
        SetupError, match=r"solver step 0.03 s does not divide the communication step 0.1 s; take 0.025 s"
    ):
        simulate(oscillator(fmu, "fmi2"), 1.0, 0.1, solver_step=0.03)
    with pytest.raises(SetupError, match="'dopri5' chooses its steps itself"):
        simulate(oscillator(fmu, "fmi2"), 1.0, 0.1, solver="dopri5", solver_step=0.1)
    with pytest.raises(SetupError, match="no component is in model exchange"):
        simulate(oscillator(fmu, "fmi2", interface="auto"), 1.0, 0.1, solver="rk4")


def test_an_algebraic_loop_in_the_group_is_named(fmu: Find) -> None:
    system = System()
    for name in "ab":
        system.add(name, fmu("Spring", "fmi2"), {"x": [0.0, 0.0], "v": [0.0, 0.0]}, interface="model-exchange")
    system.connect("a.F[1]", "b.x[1]", units="ignore")
    system.connect("b.F[1]", "a.x[1]", units="ignore")
    for component in system.components.values():
        component.start.pop("x")  # type: ignore[attr-defined]
    with pytest.raises(SetupError, match=r"algebraic loop .*a\.F\[1\]"):
        simulate(system, 1.0, 0.1, order="parallel")


def test_a_step_that_is_too_long_is_named_with_the_remedy(fmu: Find) -> None:
    with pytest.raises(SimulationError, match=r"take a shorter step .*--solver-step.*solver 'dopri5'") as failed:
        simulate(oscillator(fmu, "fmi2"), 4000.0, 2.0)
    assert failed.value.results is not None
    assert len(failed.value.results.time) > 10


def test_what_fails_within_a_step_is_named_where_less_is_exchanged_than_at_events(fmu: Find) -> None:
    """Before the spring come values that change at events only, and a force that is the same all the time."""
    system, diverging = heated(fmu, "fmi2"), oscillator(fmu, "fmi2")
    system.add("still", fmu("Spring", "fmi2"), interface="model-exchange")
    system.add("free", fmu("Mass", "fmi2"), interface="model-exchange")
    system.connect("still.F[1]", "free.F")
    system.components.update(diverging.components)
    system.connections.extend(diverging.connections)
    for name, start in {"a": {"m": 1e4}, "b": {"m": 1e4}, "spring": {"c": 1e6, "d": 1e6}}.items():
        system.components[name].start.update(start)  # the force of the spring is beyond all numbers, not yet the states
    with pytest.raises(SimulationError, match=r"^spring failed at .*: fmi2GetReal returned error within a step; where"):
        simulate(system, 4000.0, 2.0)
