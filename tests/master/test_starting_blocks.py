"""Starting blocks: full order from the first step on and after a jump, where components can go back."""

from __future__ import annotations

import ctypes
import dataclasses
from pathlib import Path

import numpy as np
import pytest

from cosim import Results, Simulation, SimulationError, System, simulate
from cosim.master.operations import Exchange
from fmu_export.modelling.variables import Layout
from tests.support.oscillators import FORCED, FORCING, coupled, oscillator
from tests.support.small_fmus import TANK, build, redescribed
from tests.support.tiny_models import GAIN

NATIVE = ("fmi2", "fmi3")

K, JUMP, HEIGHT, STOP = 2.0, 4.0, 3.0, 8.0

ORDERS = [("cubic", 4.0), ("quadratic-least-squares", 3.0), ("hermite", 4.0), ("adaptive", 4.0)]


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("starts")
    for flavour in NATIVE:
        build(folder / flavour, flavour, TANK, GAIN)
    return folder


def loop(
    folder: Path, flavours: tuple[str, str] = ("fmi2", "fmi2"), gain: Path | None = None, jump: float = JUMP
) -> System:
    """A tank and a gain, x' = -K x + a flow that jumps, from x = 1."""
    system = System()
    system.add("tank", folder / flavours[0] / "Tank.fmu", start={"x_start": 1.0})
    system.add("gain", gain or folder / flavours[1] / "Gain.fmu", start={"K": -K, "u[2]": 0.0})
    system.connect("tank.x", "gain.u[1]")
    system.connect("gain.y[1]", "tank.a")
    system.drive("tank.b", lambda t: HEIGHT * (np.asarray(t) >= jump), vectorized=True, breakpoints=[jump])
    return system


def exact(t: np.ndarray) -> np.ndarray:
    """Solution of `loop`."""
    since = np.maximum(t - JUMP, 0.0)
    return np.exp(-K * t) + HEIGHT / K * (1.0 - np.exp(-K * since))


@pytest.mark.parametrize(("name", "order"), ORDERS)
def test_the_start_and_a_jump_have_the_order_of_all_steps(fmus: Path, name: str, order: float) -> None:
    """In three windows: from the start, from the jump, and late, when what both have left is gone."""
    steps = [1 / 40, 1 / 80, 1 / 160]
    windows = [(0.0, JUMP), (JUMP, STOP), (JUMP + 3.0, STOP)]
    errors: list[list[float]] = [[] for _ in windows]
    with Simulation(loop(fmus), extrapolation=name) as simulation:
        for h in steps:
            r = simulation.run(STOP, h)
            found = r.info["starting_blocks"]
            assert (found["blocks"], found["not_found"]) == (2, 0)
            apart = np.abs(r["tank.x"] - exact(r.time))
            for window, (first, last) in zip(errors, windows, strict=True):
                window.append(apart[(r.time > first) & (r.time <= last)].max())
    orders = [float(np.polyfit(np.log(steps), np.log(e), 1)[0]) for e in errors]
    print(f"{name}: {errors} {orders}")
    assert orders == pytest.approx([order] * 3, abs=0.2)


@pytest.mark.parametrize("name", ["cubic", "adaptive"])
def test_restored_stepped_mixed_and_isolated_runs_have_the_same_bits(fmus: Path, name: str) -> None:
    """Also where a state was saved between the steps of a block."""
    whole = simulate(loop(fmus), STOP, 0.1, extrapolation=name)
    with Simulation(loop(fmus), extrapolation=name) as simulation, simulation.start(0.1) as run:
        for before in (0, 1, 2, 40, 41):
            run.advance_to(before * 0.1)
            state = run.save()
            run.step(2)
            run.restore(state)
        run.advance_to(STOP)
        assert run.results.values.tobytes() == whole.values.tobytes()
    assert simulate(loop(fmus), STOP, 0.1, extrapolation=name, isolate=True).values.tobytes() == whole.values.tobytes()
    for flavours in (("fmi3", "fmi3"), ("fmi2", "fmi3")):
        other = simulate(loop(fmus, flavours), STOP, 0.1, extrapolation=name)
        assert other.values.tobytes() == whole.values.tobytes(), flavours


def test_where_an_fmu_cannot_save_its_state_the_start_has_a_lower_order(fmus: Path, tmp_path: Path) -> None:
    forgetful = redescribed(fmus / "fmi2" / "Gain.fmu", tmp_path / "Gain.fmu", {'canGetAndSetFMUstate="true"': ""})
    plain = simulate(loop(fmus, gain=forgetful), STOP, 0.1, extrapolation="cubic")
    assert plain.info["starts_not_iterated"].startswith("component 'gain': its FMU can't save its state")
    assert "starting_blocks" not in plain.info
    better = simulate(loop(fmus), STOP, 0.1, extrapolation="cubic")
    assert "starts_not_iterated" not in better.info
    errors = [np.abs(r["tank.x"] - exact(r.time)).max() for r in (plain, better)]
    assert errors[1] < 0.1 * errors[0]


def test_a_function_is_called_once_at_each_point(fmus: Path) -> None:
    calls: list[float] = []
    system = loop(fmus)
    system.add_function("counter", lambda t, u: calls.append(t) or u, inputs=["u"], outputs=["y"])
    system.connect("tank.x", "counter.u")
    r = simulate(system, 1.0, 0.1)
    assert r.info["extrapolation"]["adaptive"][:2] == ["gain.u[1]", "tank.a"]
    assert len(calls) == len(set(calls)) == len(r.time)
    assert "component 'counter' is a function" in r.info["starts_not_iterated"]


def test_linear_and_held_inputs_begin_as_ever(fmus: Path) -> None:
    """One step of explicit Euler, and then slopes."""
    for name in ("linear", "hold"):
        r = simulate(loop(fmus), 0.2, 0.1, extrapolation=name)
        assert "starting_blocks" not in r.info
        assert "starts_not_iterated" not in r.info
        assert r["tank.x"][1] == pytest.approx(1.0 - K * 0.1, rel=1e-14)


def test_a_block_ends_before_a_jump_and_before_the_end(fmus: Path) -> None:
    """Where three steps of a cubic do not fit, it begins by polynomials of lower degree."""
    system = loop(fmus, jump=0.2)
    assert "starting_blocks" not in simulate(system, 0.4, 0.1, extrapolation="cubic").info
    assert simulate(system, 0.5, 0.1, extrapolation="cubic").info["starting_blocks"]["blocks"] == 1
    assert simulate(system, 0.3, 0.1, extrapolation="adaptive").info["starting_blocks"]["blocks"] == 2


def test_a_value_that_is_set_begins_a_block(fmus: Path, tmp_path: Path) -> None:
    tunable = [dataclasses.replace(GAIN.parameters.variables[0], tunable=True)]
    build(tmp_path, "fmi2", dataclasses.replace(GAIN, parameters=Layout(tunable)))
    system = loop(fmus, gain=tmp_path / "Gain.fmu")
    with Simulation(system, extrapolation="adaptive") as simulation, simulation.start(0.1) as run:
        run.step(5)
        run["gain.K"] = -3.0
        before = run["tank.x"]
        run.step()
        assert run.results.info["starting_blocks"]["blocks"] == 2
        assert run["tank.x"] == pytest.approx(before * np.exp(-0.3), rel=2e-4)  # a tangent is 4 % away


def test_a_stiff_split_begins_as_without_blocks(tmp_path: Path) -> None:
    """Its trials do not contract, and nothing is taken from them."""
    folder = build(tmp_path, "fmi2", FORCED, FORCING)
    system = coupled(folder, oscillator(0.1, 1e4, 1e-3))
    r = simulate(system, 2e-2, 1e-2, extrapolation="hermite")
    assert r.info["starting_blocks"]["not_found"] == r.info["starting_blocks"]["blocks"] == 1
    for fmu in folder.glob("*.fmu"):
        redescribed(fmu, tmp_path / "forgetful.fmu", {'canGetAndSetFMUstate="true"': ""}).replace(fmu)
    assert simulate(system, 2e-2, 1e-2, extrapolation="hermite").values.tobytes() == r.values.tobytes()


def test_an_fmu_that_does_not_go_back_ends_the_run(fmus: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refusing = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)(lambda instance, state: 3)
    start = Exchange.start_in_blocks

    def start_refusing(self: Exchange) -> None:
        start(self)
        assert self.starting is not None
        self.starting.states[1].set = ctypes.cast(refusing, ctypes.c_void_p).value

    monkeypatch.setattr(Exchange, "start_in_blocks", start_refusing)
    with pytest.raises(SimulationError, match="gain failed at t = 0 s: fmi2SetFMUstate returned error") as caught:
        simulate(loop(fmus), 1.0, 0.1, extrapolation="cubic")
    results = caught.value.results
    assert isinstance(results, Results)
    assert results.time.tolist() == [0.0]
