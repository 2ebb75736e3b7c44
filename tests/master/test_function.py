"""Components that are functions in Python: when they are called, what they may return, and how they keep a state."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import sys
import threading
import time as clock
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controller_fmu.model import MODEL as CONTROLLER
from cosim import Results, RunState, SetupError, Simulation, SimulationError, SimulationInterrupted, System, simulate
from parallel_robot.fmus import fmu_path
from parallel_robot.wiring import CONNECTIONS
from tests.support.native_fmus import DEFAULT_FLAVOUR
from tests.support.small_fmus import compiled
from tests.support.tiny_models import CLOCK, GAIN, INTEGRATOR, TWO_LEVELS, build

H = 0.125  # s; times of communication points are exact with it
ORDERS = ("sequential", "parallel")


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("function"), GAIN, INTEGRATOR, CLOCK, TWO_LEVELS)


def same(found: Results, expected: Results) -> None:
    assert found.names == expected.names
    assert found.time.tobytes() == expected.time.tobytes()
    assert found.values.tobytes() == expected.values.tobytes()


class Integral:
    """U = -x - (sum of all x so far), with a state that can be reset, saved and restored."""

    def __init__(self) -> None:
        self.sum = 0.0

    def __call__(self, _time: float, x: float) -> float:
        self.sum += x
        return -x - self.sum


class Resettable(Integral):
    def reset(self) -> None:
        self.sum = 0.0


class Saveable(Integral):
    def save(self) -> bytes:
        return np.float64(self.sum).tobytes()

    def restore(self, state: bytes) -> None:
        self.sum = float(np.frombuffer(state)[0])


class Full(Saveable, Resettable):
    pass


def loop(tiny: Path, function: Any, **options: Any) -> System:
    """An integrator, from 1, whose input a function computes from its state."""
    system = System()
    system.add("i", tiny / "Integrator.fmu", start={"x_start": 1.0})
    system.add_function("c", function, inputs={"x": "1"}, outputs={"u": "1"}, **options)
    system.connect("i.x", "c.x")
    system.connect("c.u", "i.u")
    return system


# The same numbers


def test_it_gives_the_numbers_of_a_loop_that_is_stepped_by_hand(tiny: Path) -> None:
    """To the last bit, for the law's state too."""
    system = System()
    system.add("i", tiny / "Integrator.fmu", start={"x_start": 1.0, "u": 0.0})
    law = Integral()
    with Simulation(system) as simulation, simulation.start(step_size=H) as run:
        for n in range(41):
            run["i.u"] = law(run.time, run["i.x"])
            if n < 40:
                run.step()
    expected = run.results
    found = simulate(loop(tiny, Full()), 40 * H, H, extrapolation="hold")
    assert found["i.x"].tobytes() == expected["i.x"].tobytes()
    assert found["c.u"].tobytes() == found["i.u"].tobytes() == expected["i.u"].tobytes()
    assert found["c.x"].tobytes() == expected["i.x"].tobytes()


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("extrapolation", ["auto", "hold"])
@pytest.mark.parametrize("every", [1, 3])
def test_it_gives_the_numbers_of_an_fmu_that_computes_the_same(
    tiny: Path, order: str, extrapolation: str, every: int
) -> None:
    """Y = 2 u as FMU and as function, between an integrator and a signal, with a disturbance and a converted input."""
    found = []
    for as_function in (False, True):
        system = System()
        system.add("i", tiny / "Integrator.fmu", start={"x_start": 1.0})
        if as_function:
            system.add_function("g", lambda t, u: 2.0 * u, inputs={"u": ("1", 2)}, outputs=["y[1..2]"], every=every)
        else:
            system.add("g", tiny / "Gain.fmu", every=every)
        system.connect("i.x", "g.u[1]", factor=-0.7, offset=0.1)
        system.disturb("g.u[1]", lambda t: 0.01 * math.sin(9.0 * t))
        system.drive("g.u[2]", math.cos)
        system.connect("g.y[1]", "i.u")
        found.append(simulate(system, 24 * H, H, order=order, extrapolation=extrapolation))
    same(found[1], found[0])
    assert np.ptp(found[0]["i.x"]) > 0.1


def pd(time: float, theta: np.ndarray, omega: np.ndarray, theta_ref: np.ndarray, omega_ref: np.ndarray) -> np.ndarray:
    assert theta.shape == omega.shape == theta_ref.shape == omega_ref.shape == (3,)
    return -6.0 * (theta - theta_ref) - 2.0 * (omega - omega_ref)


def robot(robot_fmus: Path) -> System:
    system = System()
    system.add("plant", fmu_path(robot_fmus, DEFAULT_FLAVOUR, "plant"), start={"tau_d": 0.0, "dm": 0.0})
    system.add("trajectory", fmu_path(robot_fmus, DEFAULT_FLAVOUR, "trajectory"))
    return system


def test_a_pd_law_closes_the_loop_around_the_robot(robot_fmus: Path) -> None:
    """As it does in a loop of its own, to the last bit; and the robot follows its path."""
    system = robot(robot_fmus)
    system.components["plant"].start["tau_a"] = 0.0
    names = ("plant.theta_a", "plant.omega_a", "trajectory.theta_ref", "trajectory.omega_ref")
    with Simulation(system) as simulation, simulation.start(step_size=2e-3) as run:
        for n in range(1001):
            run["plant.tau_a"] = pd(run.time, *(run[name] for name in names))
            if n < 1000:
                run.step()
    system = robot(robot_fmus)
    angles = {f"{name}[1..3]": unit for name, unit in zip(("a", "b", "c", "d"), ("rad", "rad/s") * 2, strict=True)}
    system.add_function("controller", pd, inputs=angles, outputs={"tau": ("N.m", 3)})
    for name, target in zip(names, "abcd", strict=True):
        system.connect(name, f"controller.{target}")
    system.connect("controller.tau", "plant.tau_a")
    found = simulate(system, 2.0, 2e-3, extrapolation="hold")
    for name in ("plant.theta_a", "plant.omega_b", "plant.x_E", "plant.tau_a"):
        assert found[name].tobytes() == run.results[name].tobytes(), name
    error = np.hypot(found["plant.x_E"] - found["trajectory.x_ref"], found["plant.y_E"] - found["trajectory.y_ref"])
    assert error[found.time > 1.5].max() < 0.006


class RobotController:
    """The paper's law, its estimate of the uncertainty bound integrated by Euler's method."""

    def __init__(self, step_size: float, **changed: Any) -> None:
        parameters = vars(CONTROLLER.parameters.unpack(CONTROLLER.parameters.starts)) | changed
        self.p = CONTROLLER.parameters.pack(**parameters)
        self.h = step_size

    def reset(self) -> None:
        self.x = CONTROLLER.initial_state(self.p)

    def __call__(self, time: float, *inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u = np.concatenate(inputs)
        y = CONTROLLER.output_values(time, self.x, u, self.p)
        self.x = self.x + self.h * CONTROLLER.derivatives(time, self.x, u, self.p)
        return y[:3], y[3:]


def controlled_robot(robot_fmus: Path, controller: RobotController | Path, **start: float) -> System:
    system = robot(robot_fmus)
    if isinstance(controller, Path):
        system.add("controller", controller, start=start)
    else:
        variables = {
            role: {v.name: (v.unit, v.size) for v in getattr(CONTROLLER, role).variables}
            for role in ("inputs", "outputs")
        }
        system.add_function("controller", controller, **variables)
    for source, target in CONNECTIONS:
        system.connect(source, target)
    return system


#: Inputs of Python FMUs are held.
LINEAR = "auto" if DEFAULT_FLAVOUR == "pythonfmu" else "linear"


@pytest.mark.parametrize(("order", "extrapolation"), [("sequential", LINEAR), ("parallel", "hold")])
def test_the_controllers_law_is_that_of_its_fmu(robot_fmus: Path, order: str, extrapolation: str) -> None:
    """Without the robust part the law has no state that matters, so both compute the same at a communication point.

    In parallel order an FMU that extrapolates its inputs computes from those, and a function from those of the point
    before.
    """
    fmu = fmu_path(robot_fmus, DEFAULT_FLAVOUR, "controller")
    expected = simulate(
        controlled_robot(robot_fmus, fmu, alpha=0.0), 1.0, 1e-3, order=order, extrapolation=extrapolation
    )
    system = controlled_robot(robot_fmus, RobotController(1e-3, alpha=0.0))
    other = "hold" if extrapolation == "hold" else "auto"  # linear: the rate of what a function gives is not known
    found = simulate(system, 1.0, 1e-3, order=order, extrapolation=other)
    for name in ("plant.theta_a", "plant.omega_a", "controller.tau_a"):
        np.testing.assert_allclose(found[name], expected[name], rtol=0.0, atol=1e-12)


def test_the_controllers_law_with_its_state_is_that_of_a_loop_by_hand(robot_fmus: Path) -> None:
    found = simulate(controlled_robot(robot_fmus, RobotController(1e-3)), 0.5, 1e-3, extrapolation="hold")
    system = robot(robot_fmus)
    system.components["plant"].start["tau_a"] = 0.0
    controller = RobotController(1e-3)
    controller.reset()
    sources = [source for source, target in CONNECTIONS if target.startswith("controller.")]
    with Simulation(system) as simulation, simulation.start(step_size=1e-3) as run:
        for n in range(501):
            tau, _ = controller(run.time, *(run[source] for source in sources))
            run["plant.tau_a"] = tau
            if n < 500:
                run.step()
    for name in ("plant.theta_a", "plant.omega_a", "plant.tau_a"):
        assert found[name].tobytes() == run.results[name].tobytes(), name
    assert found["controller.psi"][-1, 0] > 0.0


# When it is called


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("every", [1, 4])
@pytest.mark.parametrize("direct_feedthrough", [True, False])
@pytest.mark.parametrize("start_time", [0.0, 2.0])
def test_it_is_called_once_at_a_communication_point(
    tiny: Path, order: str, every: int, direct_feedthrough: bool, start_time: float
) -> None:
    calls = []

    def law(time: float, x: float) -> float:
        calls.append(time)
        return -x

    system = loop(tiny, law, every=every, direct_feedthrough=direct_feedthrough)
    expected = [start_time + n * H for n in range(0, 17, every)]
    with Simulation(system, order=order) as simulation:
        simulation.run(start_time + 16 * H, H, start_time=start_time)
        assert calls == expected
        calls.clear()
        with simulation.start(H, start_time=start_time) as run:
            for _ in range(16):
                assert run["c.u"] == run.results["c.u"][-1]
                run.step()
        assert calls == expected


def test_it_sees_the_inputs_of_its_point_and_gives_the_time_of_a_first_run_again(tiny: Path) -> None:
    seen = []
    system = System()
    system.add("clock", tiny / "Clock.fmu")
    system.add_function("c", lambda t, now: seen.append((t, now)), inputs=["now"])
    system.connect("clock.now", "c.now")
    with Simulation(system) as simulation:
        for _ in range(2):
            simulation.run(4 * H, H)
    assert seen == [(n * H, n * H) for n in (0, 1, 2, 3, 4)] * 2


@pytest.mark.parametrize("order", ORDERS)
def test_without_direct_feedthrough_its_inputs_are_those_of_the_point_before(order: str) -> None:
    system = System()
    system.add_function(
        "delay",
        lambda t, u, v: (t, u, v),
        inputs=["u", "v"],
        outputs=["t", "u0", "v0"],
        start={"u": -5.0},
        direct_feedthrough=False,
        every=2,
    )
    system.add_function("source", lambda t: 10.0 * t, outputs=["y"])
    system.connect("source.y", "delay.u")
    system.drive("delay.v", lambda t: t + 1.0)
    results = simulate(system, 6 * H, H, order=order)
    assert results["delay.t"].tolist() == [0.0, 0.0, 2 * H, 2 * H, 4 * H, 4 * H, 6 * H]
    assert results["delay.v0"].tolist() == [0.0, 0.0, 1.0, 1.0, 1.0 + 2 * H, 1.0 + 2 * H, 1.0 + 4 * H]
    assert results["delay.u0"].tolist() == [-5.0, -5.0, 0.0, 0.0, 20 * H, 20 * H, 40 * H]


@pytest.mark.parametrize("order", ORDERS)
def test_without_direct_feedthrough_a_signal_too_is_that_of_the_point_before(order: str) -> None:
    system = System()
    system.add_function("delay", lambda t, v: v, inputs=["v"], outputs=["y"], direct_feedthrough=False)
    system.drive("delay.v", lambda t: t + 1.0)
    assert simulate(system, 3 * H, H, order=order)["delay.y"].tolist() == [0.0, 1.0, 1.0 + H, 1.0 + 2 * H]


def test_a_chain_of_functions_has_no_delay_in_sequential_order_and_one_each_in_parallel_order() -> None:
    system = System()
    system.add_function("c", lambda t, u: u + 1.0, inputs=["u"], outputs=["y"])
    system.add_function("b", lambda t, u: u + 1.0, inputs=["u"], outputs=["y"])
    system.add_function("a", lambda t: t, outputs=["y"])
    system.connect("a.y", "b.u")
    system.connect("b.y", "c.u")
    times = np.arange(9) * H
    assert simulate(system, 8 * H, H)["c.y"].tolist() == (times + 2.0).tolist()
    parallel = simulate(system, 8 * H, H, order="parallel")
    assert parallel["c.y"][2:].tolist() == (times[:-2] + 2.0).tolist()


def test_inputs_on_several_levels_are_all_set_before_the_call(tiny: Path) -> None:
    system = System()
    system.add("two", tiny / "TwoLevels.fmu")
    system.add_function("f", lambda t, a, b: 100.0 * a + b, inputs=["a", "b"], outputs=["y"])
    system.add_function("last", lambda t, y: None, inputs=["y"])
    system.drive("two.a", lambda t: t + 1.0)
    system.connect("two.p", "two.b")
    system.drive("f.a", lambda t: t)
    system.connect("two.p", "f.b")
    system.connect("f.y", "last.y")
    results = simulate(system, 4 * H, H)
    assert results["last.y"].tolist() == (101.0 * results.time + 1.0).tolist()


def test_an_algebraic_loop_is_refused_and_can_be_broken() -> None:
    def system(direct_feedthrough: bool) -> System:
        system = System()
        system.add_function("a", lambda t, u: u + 1.0, inputs=["u"], outputs=["y"])
        system.add_function(
            "b", lambda t, u: 2.0 * u, inputs=["u"], outputs=["y"], direct_feedthrough=direct_feedthrough
        )
        system.connect("a.y", "b.u")
        system.connect("b.y", "a.u")
        return system

    with pytest.raises(SetupError, match=r"algebraic loop .*functions with direct_feedthrough=False"):
        simulate(system(True), 1.0, H)
    assert simulate(system(False), 3 * H, H)["a.y"].tolist() == [1.0, 3.0, 7.0, 15.0]
    assert np.isfinite(simulate(system(True), 3 * H, H, order="parallel").values).all()


# Variables


def test_numbers_are_those_of_python_and_arrays_the_functions_own() -> None:
    seen: list[tuple[Any, ...]] = []

    def sink(time: float, *inputs: Any) -> None:
        seen.append(inputs)

    system = System()
    system.add_function(
        "source",
        lambda t: (t, round(t / H), t > H, [[t, 1.0, 2.0], [3.0, 4.0, 5.0]], [True, False], np.int32([7, -8])),
        outputs={"x": "m", "n": int, "on": bool, "M": (2, 3), "flags[1..2]": bool, "k": (int, 2)},
    )
    system.add_function(
        "sink",
        sink,
        inputs={"x": ("m", ()), "n": int, "on": (bool, ()), "M[1..2,1..3]": "rad", "flags": (bool, 2), "k": [int, [2]]},
    )
    for name in ("x", "n", "on", "flags", "k"):
        system.connect(f"source.{name}", f"sink.{name}")
    system.connect("source.M", "sink.M")
    results = simulate(system, 2 * H, H)
    assert [row[:3] for row in seen] == [(0.0, 0, False), (H, 1, False), (2 * H, 2, True)]
    assert [type(v) for v in seen[0][:3]] == [float, int, bool]
    matrices = [row[3] for row in seen]
    assert [m.tolist() for m in matrices] == [[[t, 1.0, 2.0], [3.0, 4.0, 5.0]] for t in (0.0, H, 2 * H)]
    flags, integers = seen[2][4], seen[2][5]
    assert (flags.dtype, flags.tolist()) == (np.dtype(bool), [True, False])
    assert (integers.dtype, integers.tolist()) == (np.dtype(np.int64), [7, -8])
    assert results["source.M[2,3]"].tolist() == [5.0] * 3
    assert results["sink.M[1,1]"].tolist() == [0.0, H, 2 * H]
    assert results.info["units"] == {
        "source.x": "m",
        "sink.x": "m",
        **{f"sink.M[{i},{k}]": "rad" for i in (1, 2) for k in (1, 2, 3)},
    }


def test_integers_booleans_and_enumerations_go_to_fmus_and_back(tmp_path: Path) -> None:
    system = System()
    system.add("p", compiled(tmp_path, "fmi2_probe"), start={"u": 0.0})
    variables = {"n": int, "e": int, "b": bool}
    seen = []

    def source(time: float) -> tuple[int, int, bool]:
        step = round(time / H)
        return -step, 1 + step % 2, step > 1

    system.add_function("f", source, outputs=variables)
    system.add_function("g", lambda t, *values: seen.append(values), inputs=variables)
    for name in variables:
        system.connect(f"f.{name}", f"p.{name}")
        system.connect(f"p.{name}_out", f"g.{name}")
    simulate(system, 3 * H, H)
    assert seen == [(0, 1, False), (-1, 2, False), (-2, 1, True), (-3, 2, True)]
    assert {type(v) for row in seen for v in row} == {int, bool}


def test_start_values_of_inputs_hold_and_can_be_those_of_a_run() -> None:
    system = System()
    system.add_function(
        "f",
        lambda t, gain, v, n: (gain * v, n),
        inputs={"gain": "1", "v": 3, "n": int},
        outputs={"y": 3, "m": int},
        start={"gain": 2.0, "v": [1.0, 2.0, 3.0], "n": 4},
    )
    with Simulation(system, record=["f.y", "f.gain", "f.m"]) as simulation:
        assert simulation.run(H, H)["f.y"].tolist() == [[2.0, 4.0, 6.0]] * 2
        results = simulation.run(H, H, start={"f.gain": -1.0, "f.v[2]": 9.0})
        assert results["f.y"].tolist() == [[-1.0, -9.0, -3.0]] * 2
        assert results["f.gain"].tolist() == [-1.0] * 2
        assert results["f.m"].tolist() == [4.0] * 2
        assert simulation.run(H, H)["f.y"].tolist() == [[2.0, 4.0, 6.0]] * 2


def test_results_name_the_function(tiny: Path) -> None:
    system = loop(tiny, Full())
    system.add_function("p", partial(max, 1.0), inputs=["u"], outputs=["y"], start={"u": 0.0})
    info = simulate(system, H, H).info
    assert info["functions"] == {"c": f"{__name__}.Full", "p": "builtins.max"}
    assert list(info["fmus"]) == ["i"]


# Failures


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (math.nan, "it gave nan for 'u', which is not finite"),
        (np.inf, "it gave inf for 'u', which is not finite"),
        ([1.0], r"it gave an array of shape \(1,\) for 'u', which is a single number"),
        ((1.0, 2.0), r"it gave an array of shape \(2,\) for 'u', which is a single number"),
        (None, "it gave None for 'u', which is of type Float64"),
        ("fast", "it gave 'fast' for 'u', which is of type Float64"),
        (True, "it gave True for 'u', which is of type Float64"),
        (1j, "it gave 1j for 'u', which is of type Float64"),
    ],
)
def test_what_it_must_not_return_ends_the_run(tiny: Path, value: Any, message: str) -> None:
    system = loop(tiny, lambda t, x: value if t >= 4 * H else 0.0)
    with pytest.raises(SimulationError, match=rf"^c failed at t = 0\.5 s: {message}$") as error:
        simulate(system, 1.0, H)
    assert (error.value.component, error.value.time) == ("c", 4 * H)
    assert error.value.results is not None
    assert error.value.results.time.tolist() == [n * H for n in range(4)]
    assert error.value.results.info["status"] == "failed"


@pytest.mark.parametrize(
    ("outputs", "value", "message"),
    [
        ({"y": 3}, 1.0, r"it gave a single number for 'y', which is an array of shape \(3,\)"),
        ({"y": (2, 2)}, np.zeros(4), r"shape \(4,\) for 'y', which is an array of shape \(2, 2\)"),
        (["y", "z"], (1.0, 2.0, 3.0), r"it gave \(1.0, 2.0, 3.0\) in place of 2 outputs \(y, z\)"),
        (["y", "z"], 1.0, "it gave 1.0 in place of 2 outputs"),
        (["y", "z"], None, "it gave None in place of 2 outputs"),
        (["y", "z"], {"y": 1.0, "z": 2.0}, "in place of 2 outputs"),
        (["y", "z"], (1.0, math.nan), "it gave nan for 'z', which is not finite"),
        ([], 1.0, "it gave 1.0, but has no outputs"),
        ({"n": int}, 1.0, "it gave 1.0 for 'n', which is of type Int64"),
        ({"n": int}, 2**63, "for 'n', which is of type Int64"),
        ({"n": int}, 2**70, "for 'n', which is of type Int64"),
        ({"b": bool}, 1, "it gave 1 for 'b', which is of type Boolean"),
    ],
)
def test_outputs_that_do_not_fit_are_refused_also_where_nothing_reads_them(
    outputs: Any, value: Any, message: str
) -> None:
    system = System()
    system.add_function("f", lambda t: value, outputs=outputs)
    with pytest.raises(SimulationError, match=message):
        simulate(system, H, H)


def test_an_array_of_as_many_numbers_is_as_many_outputs() -> None:
    system = System()
    system.add_function("f", lambda t: np.array([t, 2.0]), outputs=["y", "z"])
    results = simulate(system, H, H)
    assert (results["f.y"].tolist(), results["f.z"].tolist()) == ([0.0, H], [2.0, 2.0])


class Trouble(Exception):
    pass


@pytest.mark.parametrize("every", [1, 2])
def test_an_exception_is_chained_and_earlier_results_are_kept(tiny: Path, every: int) -> None:
    def law(time: float, x: float) -> float:
        if time >= 4 * H:
            raise Trouble("no\nsolution")
        return -x

    message = r"^c failed at t = 0\.5 s: its function raised Trouble: no solution$"
    with pytest.raises(SimulationError, match=message) as error:
        simulate(loop(tiny, law, every=every), 1.0, H)
    assert isinstance(error.value.__cause__, Trouble)
    assert error.value.__cause__.__traceback__ is not None
    assert error.value.results is not None
    assert len(error.value.results.time) == 4


def test_a_run_after_one_that_failed_is_as_good_as_a_first_one(tiny: Path) -> None:
    law = Full()
    with Simulation(loop(tiny, lambda t, x: law(t, x) if t < limit else math.nan)) as simulation:
        limit = 9.0
        expected = simulation.run(1.0, H)
        limit = 0.5
        law.reset()
        with pytest.raises(SimulationError):
            simulation.run(1.0, H)
        limit = 9.0
        law.reset()
        same(simulation.run(1.0, H), expected)


def test_an_exception_at_the_start_names_the_start(tiny: Path) -> None:
    with pytest.raises(SimulationError, match=r"c failed at t = 3 s: its function raised ZeroDivisionError") as error:
        simulate(loop(tiny, lambda t, x: 1 / 0), 4.0, H, start_time=3.0)
    assert error.value.results is None


def test_in_a_run_by_hand_too(tiny: Path) -> None:
    with Simulation(loop(tiny, lambda t, x: -x if t < 2 * H else 1 / 0)) as simulation, simulation.start(H) as run:
        run.step()
        with pytest.raises(SimulationError, match=r"c failed at t = 0\.25 s") as error:
            run.step(5)
        assert isinstance(error.value.__cause__, ZeroDivisionError)
        assert error.value.results is not None
        assert error.value.results.time.tolist() == [0.0, H]
        with pytest.raises(SetupError, match="the run has ended"):
            run.step()


def test_an_exception_for_an_input_set_by_hand_ends_the_run() -> None:
    system = System()
    system.add_function("f", lambda t, u: 1.0 / u, inputs=["u"], outputs=["y"], start={"u": 1.0})
    with Simulation(system) as simulation, simulation.start(H) as run:
        run.step()
        run["f.u"] = 0.0
        with pytest.raises(SimulationError, match=r"f failed at t = 0\.125 s") as error:
            run["f.y"]
        assert isinstance(error.value.__cause__, ZeroDivisionError)
        with pytest.raises(SetupError, match="the run has ended"):
            run.step()


# Ctrl-C


def interrupting(act: Callable[[], None]) -> Callable[[float, float], float]:
    def law(time: float, x: float) -> float:
        if time >= 4 * H:
            act()
        return -x

    return law


def ctrl_c_while_it_waits() -> None:
    """Another thread sends it; the function would wait for long."""
    threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
    clock.sleep(60.0)
    raise AssertionError("not interrupted")


def ctrl_c_in_a_library() -> None:
    signal.raise_signal(signal.SIGINT)
    raise AssertionError("not interrupted")


def interrupt_raised() -> None:
    raise KeyboardInterrupt


def run_in_some_way(system: System, by_hand: bool) -> None:
    with Simulation(system) as simulation:
        if not by_hand:
            simulation.run(1.0, H)
            return
        with simulation.start(H) as run:
            run.step(8)


@pytest.mark.parametrize("act", [ctrl_c_in_a_library, ctrl_c_while_it_waits, interrupt_raised])
@pytest.mark.parametrize("by_hand", [False, True])
def test_ctrl_c_while_it_is_called_ends_the_run(tiny: Path, act: Callable[[], None], by_hand: bool) -> None:
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(SimulationInterrupted, match=r"interrupted at t = 0\.5 s") as stop:
        run_in_some_way(loop(tiny, interrupting(act)), by_hand)
    assert stop.value.results.time.tolist() == [n * H for n in range(4)]
    assert stop.value.results.info["status"] == "interrupted"
    assert signal.getsignal(signal.SIGINT) is handler


@pytest.mark.parametrize("by_hand", [False, True])
def test_ctrl_c_at_the_start(tiny: Path, by_hand: bool) -> None:
    with pytest.raises(SimulationInterrupted, match="interrupted at t = 0 s") as stop:
        run_in_some_way(loop(tiny, lambda t, x: ctrl_c_in_a_library()), by_hand)
    assert len(stop.value.results.time) == 0


def test_ctrl_c_outside_of_it_does_not_wait_for_the_chunk(tiny: Path) -> None:
    """Another function has caught it; at the next call of any the run ends."""

    def catches(time: float, x: float) -> float:
        if time == 2 * H:
            with contextlib.suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        return -x

    calls = []
    system = loop(tiny, catches)
    system.add_function("z", lambda t, u: calls.append(t), inputs=["u"])
    system.connect("c.u", "z.u")
    with pytest.raises(SimulationInterrupted):
        simulate(system, 8.0, H)
    assert max(calls) <= 2 * H


def test_leaving_the_program_leaves_it(tiny: Path) -> None:
    with pytest.raises(SystemExit, match="7"):
        simulate(loop(tiny, interrupting(partial(sys.exit, 7))), 1.0, H)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda simulation, run: simulation.run(1.0, H), "a run of this simulation is being stepped; end it first"),
        (lambda simulation, run: simulation.start(H).__enter__(), "a run of this simulation is being stepped"),
        (lambda simulation, run: run.step(), "the run is in the middle of a step"),
        (lambda simulation, run: run["i.x"], "the run is in the middle of a step"),
        (lambda simulation, run: run.__setitem__("c.gain", 2.0), "the run is in the middle of a step"),
        (lambda simulation, run: run.save(), "the run is in the middle of a step"),
        (lambda simulation, run: run.restore(run.save()), "the run is in the middle of a step"),
    ],
)
def test_it_can_not_step_the_run_that_calls_it(tiny: Path, act: Callable[..., Any], message: str) -> None:
    law = loop(tiny, lambda t, x: act(simulation, run) if t > H else -x)
    with Simulation(law) as simulation, simulation.start(H) as run:
        run.step()
        with pytest.raises(SimulationError, match=f"its function raised SetupError: {message}"):
            run.step()


def test_it_can_not_begin_a_run_of_the_simulation_that_calls_it(tiny: Path) -> None:
    with Simulation(loop(tiny, lambda t, x: simulation.run(1.0, H) and -x)) as simulation:
        for _ in range(2):
            with pytest.raises(SimulationError, match="SetupError: a run of this simulation is going on"):
                simulation.run(1.0, H)


def test_it_may_simulate_itself(tiny: Path) -> None:
    """A look ahead by a simulation of its own, as predictive controllers make."""

    def law(time: float, x: float) -> float:
        model = System()
        model.add("i", tiny / "Integrator.fmu", start={"x_start": x, "u": -x})
        return -float(simulate(model, H, H)["i.x"][-1])

    results = simulate(loop(tiny, law), 4 * H, H, extrapolation="hold")
    np.testing.assert_allclose(results["i.x"], (1.0 - H * (1.0 - H)) ** np.arange(5), rtol=1e-12)


# State


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("make", [Resettable, Saveable, Full])
def test_every_run_is_as_the_first_one(tiny: Path, make: type[Integral], order: str) -> None:
    system = loop(tiny, make())
    expected = simulate(system, 2.0, H, order=order)
    with Simulation(system, order=order) as simulation:
        for _ in range(2):
            same(simulation.run(2.0, H), expected)
        with simulation.start(H) as run:
            run.step(16)
        same(run.results, expected)


def test_two_runs_at_once_do_not_share_an_object(tiny: Path) -> None:
    system = loop(tiny, Full())
    with Simulation(system) as one, Simulation(system) as other, one.start(H) as first, other.start(H) as second:
        second.step()
        with pytest.raises(SimulationError, match="its object has begun another run in between"):
            first.step()
        second.step()
    same(second.results, simulate(system, 2 * H, H))


def test_two_runs_at_once_may_share_a_function(tiny: Path) -> None:
    system = loop(tiny, lambda t, x: -x)
    with Simulation(system) as one, Simulation(system) as other, one.start(H) as first, other.start(H) as second:
        for _ in range(3):
            first.step()
            second.step()
    same(first.results, second.results)


def test_a_method_has_the_state_of_its_object(tiny: Path) -> None:
    law = Full()
    with Simulation(loop(tiny, law.__call__)) as simulation:
        first, second = (simulation.run(2.0, H) for _ in range(2))
    same(second, first)
    assert law.sum != 0.0


def test_a_state_that_can_not_be_reset_takes_part_in_one_run(tiny: Path) -> None:
    law = Integral()
    expected = simulate(loop(tiny, Full()), 1.0, H)
    with Simulation(loop(tiny, law)) as simulation:
        same(simulation.run(1.0, H), expected)
        with pytest.raises(
            SetupError, match=r"component 'c': a Integral has taken part in a run .*give it .*reset\(\)"
        ):
            simulation.run(1.0, H)
    with pytest.raises(SetupError, match="has taken part in a run before"):
        simulate(loop(tiny, law), 1.0, H)
    simulate(loop(tiny, Integral()), 1.0, H)


def test_a_run_goes_back_with_the_functions_state(tiny: Path, tmp_path: Path) -> None:
    """Also in another process."""
    with Simulation(loop(tiny, Full(), every=2)) as simulation:
        expected = simulation.run(2.0, H)
        with simulation.start(H) as run:
            run.step(5)
            run.save().write(tmp_path / "run.state")
            state = run.save()
            for _ in range(2):
                run.advance_to(2.0)
                same(run.results, expected)
                run.restore(state)
    with Simulation(loop(tiny, Full(), every=2)) as other, other.start(H) as run:
        run.restore(RunState.read(tmp_path / "run.state"))
        assert run["c.u"] == expected["c.u"][5]
        assert run["c.x"] == expected["c.x"][5]
        run.advance_to(2.0)
        same(run.results, expected)


@pytest.mark.parametrize("direct_feedthrough", [True, False])
def test_a_restored_run_has_the_inputs_of_the_point_before(tiny: Path, direct_feedthrough: bool) -> None:
    law = Full()
    with Simulation(loop(tiny, law, direct_feedthrough=direct_feedthrough)) as simulation:
        expected = simulation.run(1.0, H)
        with simulation.start(H) as run:
            run.step(3)
            state = run.save()
            run.step(5)
            run.restore(state)
            run.step(5)
            same(run.results, expected)


def test_a_state_is_not_that_of_a_run_with_another_function(tiny: Path) -> None:
    with Simulation(loop(tiny, Full())) as simulation, simulation.start(H) as run:
        state = run.save()
    other = pytest.raises(SetupError, match=r"another run \(other functions c: ")
    with Simulation(loop(tiny, Saveable())) as simulation, simulation.start(H) as run, other:
        run.restore(state)


@pytest.mark.parametrize("make", [Integral, Resettable])
def test_a_state_that_can_not_be_saved_is_refused_by_name(tiny: Path, make: type[Integral]) -> None:
    message = rf"component 'c': its function can't save its state: a {make.__name__} has no save\(\) and restore\(\)"
    with Simulation(loop(tiny, make())) as simulation, simulation.start(H) as run:
        with pytest.raises(SetupError, match=message):
            run.save()
        run.step()


@pytest.mark.parametrize("base", [Saveable, Full])
def test_save_gives_bytes(tiny: Path, base: type[Saveable]) -> None:
    """Found when the function is added, or when the state is needed."""

    class Wrong(base):  # type: ignore[misc, valid-type]
        def save(self) -> float:
            return self.sum

    message = r"TypeError: save\(\) gave a float; it must give bytes, as pickle.dumps does"
    if base is Saveable:
        with pytest.raises(SetupError, match=rf"^component 'c': the state of its object can't be saved: {message}$"):
            loop(tiny, Wrong())
        return
    failing = pytest.raises(SimulationError, match=rf"^c failed at t = 0\.125 s: its function raised {message}$")
    with Simulation(loop(tiny, Wrong())) as simulation, simulation.start(H) as run, failing:
        run.step()


def driven(law: Any) -> System:
    """A function that computes from an input that can be set, by way of another one."""
    system = System()
    system.add_function("a", lambda t, u: 2.0 * u, inputs=["u"], outputs=["y"], start={"u": 1.0})
    system.add_function("c", law, inputs=["x"], outputs=["u"])
    system.connect("a.y", "c.x")
    return system


@pytest.mark.parametrize("make", [Saveable, Full])
def test_what_is_set_by_hand_calls_it_again_from_the_state_of_before(make: type[Integral]) -> None:
    law = make()
    with Simulation(driven(law)) as simulation, simulation.start(H) as run:
        for n in range(1, 5):
            for u in (7.0, float(n)):
                run["a.u"] = u
                run["c.u"]
            assert law.sum == sum(2.0 * k for k in range(1, n + 1))
            run["a.u"] = float(n)  # the same again: no call is necessary
            assert run["c.u"] == -2.0 * n - law.sum
            if n < 4:
                run.step()
                assert run["c.x"] == 2.0 * n
                run["a.u"] = float(n + 1)
    assert run.results["c.u"].tolist() == [-4.0, -10.0, -18.0, -28.0]


@pytest.mark.parametrize("changed", [True, False])
def test_what_is_set_in_a_restored_run_calls_it_again_from_the_state_of_before(changed: bool) -> None:
    with Simulation(driven(Full())) as simulation, simulation.start(H) as run:
        run["a.u"] = 3.0
        run.step(2)
        state = run.save()
    law = Full()
    with Simulation(driven(law)) as simulation, simulation.start(H) as run:
        run.restore(state)
        run["a.u"] = 5.0 if changed else 3.0
        assert law.sum == 18.0  # of three calls
        assert run["c.u"] == (-10.0 - 22.0 if changed else -6.0 - 18.0)
        assert law.sum == (22.0 if changed else 18.0)


def test_a_restored_run_has_outputs_that_nothing_reads() -> None:
    with Simulation(driven(Full()), record=["a.u"]) as simulation, simulation.start(H) as run:
        run.step()
        state, expected = run.save(), run["c.u"]
        assert expected == -6.0
        run.step()
        assert run["c.u"] == -8.0
        run.restore(state)
        assert run["c.u"] == expected


def test_a_state_that_can_not_go_back_is_not_called_twice() -> None:
    law = Resettable()
    with Simulation(driven(law)) as simulation, simulation.start(H) as run:
        run["a.u"] = 5.0  # at the start a reset goes back
        assert run["c.u"] == -20.0
        run.step()
        run["a.u"] = 6.0
        with pytest.raises(
            SimulationError, match=r"c failed at t = 0\.125 s: its inputs have changed .*needs save\(\)"
        ):
            run["c.u"]
    assert law.sum == 20.0


def test_in_parallel_order_an_input_set_by_hand_is_seen_at_once() -> None:
    system = System()
    system.add_function("c", Full(), inputs=["x"], outputs=["u"], start={"x": 1.0})
    with Simulation(system, order="parallel") as simulation, simulation.start(H) as run:
        run.step()
        run["c.x"] = 4.0
        assert run["c.u"] == -9.0
        run.step()
        assert run["c.u"] == -13.0


def test_the_start_is_one_call_for_the_state(tiny: Path) -> None:
    """In a loop without an order the inputs at the start come out in two passes."""
    calls = []

    class Noted(Full):
        def __call__(self, time: float, x: float) -> float:
            calls.append((time, x))
            return super().__call__(time, x)

    law = Noted()
    system = System()
    system.add_function("c", law, inputs=["x"], outputs=["u"], start={"x": 1.0})
    system.add_function("g", lambda t, u: 0.5 * u, inputs=["u"], outputs=["y"], start={"u": 3.0})
    system.connect("c.u", "g.u")
    system.connect("g.y", "c.x")
    simulate(system, 2 * H, H, order="parallel")
    at_start = [x for time, x in calls if time == 0.0]
    later = [x for time, x in calls if time > 0.0]
    assert len(at_start) == 2
    assert law.sum == pytest.approx(at_start[-1] + sum(later))
