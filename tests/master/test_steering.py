"""Runs that are watched and steered as they go on, and repeated to the last bit."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import Results, SetupError, Simulation, SimulationError, Steering, System, simulate
from tests.support.patience import wait_for
from tests.support.tiny_models import build


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("steering"))


def tank(fmus: Path) -> System:
    """A tank, x' = u, and a gain, each with a free input."""
    system = System()
    system.add("tank", fmus / "Integrator.fmu", start={"x_start": 0.0, "u": 1.0})
    system.add("gain", fmus / "Gain.fmu", start={"u[2]": 0.0})
    system.connect("tank.x", "gain.u[1]")
    return system


@pytest.mark.parametrize(
    ("record_every", "with_sink"),
    [(1, False), (7, True), *(pytest.param(*row, marks=pytest.mark.slow) for row in ((7, False), (1, True)))],
)
def test_who_observes_sees_every_row_once(fmus: Path, record_every: int, with_sink: bool) -> None:
    plain = simulate(tank(fmus), 20.0, 1e-3, record_every=record_every)
    for steering in (None, Steering()):
        seen: list[tuple[np.ndarray, np.ndarray]] = []
        sunk: list[np.ndarray] = []
        results = simulate(
            tank(fmus),
            20.0,
            1e-3,
            record_every=record_every,
            observe=lambda t, v, seen=seen: seen.append((t.copy(), v.copy())),
            sink=(lambda t, v, sunk=sunk: sunk.append(v.copy())) if with_sink else None,
            steering=steering,
        )
        kept = np.vstack(sunk) if with_sink else results.values
        assert kept.tobytes() == plain.values.tobytes()
        assert np.concatenate([t for t, _ in seen]).tolist() == plain.time.tolist()
        assert np.vstack([v for _, v in seen]).tobytes() == plain.values.tobytes()
        assert len(seen) > 1
        assert results.info.get("commands", []) == []


def test_what_an_observer_raises_is_raised(fmus: Path) -> None:
    def fails(times: np.ndarray, values: np.ndarray) -> None:
        raise RuntimeError("no more")

    for steering in (None, Steering()):
        with pytest.raises(RuntimeError, match="no more"):
            simulate(tank(fmus), 1.0, 1e-3, observe=fails, steering=steering)


def steered_from_a_thread(fmus: Path) -> Results:
    """A run in real time whose input another thread changes."""
    steering = Steering()
    seen: list[float] = []

    def change() -> None:
        wait_for(lambda: bool(seen) and seen[-1] > 0.1)
        steering.set("tank.u", -2.0)
        wait_for(lambda: seen[-1] > 0.3)
        steering.set("gain.u[2]", 5.0)

    thread = threading.Thread(target=change)
    thread.start()
    results = simulate(
        tank(fmus), 1.0, 1e-2, realtime=1.0, steering=steering, observe=lambda t, _: seen.append(float(t[-1]))
    )
    thread.join()
    return results


def test_a_steered_run_can_be_repeated_to_the_last_bit(fmus: Path) -> None:
    results = steered_from_a_thread(fmus)
    commands = results.info["commands"]
    assert [c["set"] for c in commands] == [{"tank.u": -2.0}, {"gain.u[2]": 5.0}]
    first = commands[0]["point"]
    assert commands[0]["time"] == results.time[first]
    exact = np.where(
        np.arange(101) <= first, results.time, results.time[first] - 2.0 * (results.time - results.time[first])
    )
    assert results["tank.x"] == pytest.approx(exact, abs=1e-12)
    assert results["tank.u"][first - 1] == 1.0
    assert results["tank.u"][first] == -2.0  # in the row of its communication point already
    again = simulate(tank(fmus), 1.0, 1e-2, steering=Steering(commands))
    assert again.values.tobytes() == results.values.tobytes()
    assert again.info["commands"] == commands
    assert simulate(tank(fmus), 1.0, 1e-2).values.tobytes() != results.values.tobytes()


def test_a_run_is_paused_resumed_and_stopped(fmus: Path) -> None:
    steering = Steering()
    steering.pause()
    seen: list[float] = []
    found: list[Results] = []

    def go() -> None:
        found.append(
            simulate(tank(fmus), 1e4, 1e-3, record_every=1000, steering=steering, observe=lambda t, _: seen.extend(t))
        )

    thread = threading.Thread(target=go)
    thread.start()
    time.sleep(0.2)
    assert not seen
    assert steering.is_paused
    steering.set("tank.u", 3.0)  # while it is paused
    steering.resume()
    wait_for(lambda: bool(seen))
    steering.stop()
    thread.join()
    [results] = found
    assert results.info["status"] == "stopped"
    assert results.info["commands"][0] == {"point": 0, "time": 0.0, "set": {"tank.u": 3.0}}
    assert results.info["commands"][-1]["stop"] is True
    assert results.info["stop_time"] < 1e4
    assert results["tank.x"] == pytest.approx(3.0 * results.time, rel=1e-9)
    again = simulate(tank(fmus), 1e4, 1e-3, record_every=1000, steering=Steering(results.info["commands"]))
    assert again.values.tobytes() == results.values.tobytes()
    assert again.info["status"] == "stopped"


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("tank.nothing", 1.0, "no variable 'nothing'"),
        ("gain.u[1]", 1.0, "feeds it"),
        ("tank.u", "much", "tank.u"),
        ("tank.x", 1.0, "can't be set during a run"),
    ],
)
def test_a_command_that_can_not_be_obeyed_does_not_end_the_run(fmus: Path, name: str, value: Any, why: str) -> None:
    told: list[Any] = []
    steering = Steering(told=told.append)
    steering.set(name, value)
    results = simulate(tank(fmus), 1.0, 0.1, steering=steering)
    assert results.info["status"] == "completed"
    assert results.info["commands"] == []
    [refused] = results.info["commands_refused"]
    assert refused["point"] == 0
    assert told == [refused]
    assert why in refused["why"]


def test_an_fmu_that_fails_in_a_steered_run_has_its_results(fmus: Path) -> None:
    system = System()
    system.add("tank", fmus / "Integrator.fmu", start={"x_start": 1.0, "u": 0.0})
    system.add("fragile", fmus / "Fragile.fmu")
    system.connect("tank.x", "fragile.u")
    with Simulation(system) as simulation, pytest.raises(SimulationError) as failed:
        simulation.run(5.0, 0.25, steering=Steering([{"point": 4, "set": {"tank.u": -1.0}}]))
    assert failed.value.results is not None
    assert failed.value.results.info["commands"][0]["point"] == 4
    assert failed.value.results.info["status"] == "failed"


@pytest.mark.parametrize("wrong", [{}, {"point": -1, "set": {}}, {"point": 1}, {"point": 1.5, "stop": True}])
def test_what_is_no_command_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SetupError, match="is not a command"):
        Steering([wrong])


def test_no_checkpoints_with_it(fmus: Path, tmp_path: Path) -> None:
    from cosim import Checkpoint

    with pytest.raises(SetupError, match="can't be observed or steered"):
        simulate(tank(fmus), 1.0, 0.1, steering=Steering(), checkpoint=Checkpoint(tmp_path, 0.5))
