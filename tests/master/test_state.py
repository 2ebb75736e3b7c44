"""The state of a run: saved between two steps, restored in the same run, in another one and in another process."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import RunState, SetupError, Simulation, System
from parallel_robot.scenario import load_scenario
from tests.support.descriptions import without_capability
from tests.support.native_fmus import DEFAULT_FLAVOUR
from tests.support.tiny_models import INTEGRATOR
from tests.support.tiny_models import build as build_tiny

STEP, STOP = 1e-3, 4.05  # a signal sets in at 4 s


def system_of(folder: Path, flavour: str) -> System:
    return load_scenario("tracking").system(folder, flavour)


@pytest.mark.parametrize("flavour", ["fmi2", "fmi3", "pythonfmu"])
@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_a_restored_run_goes_on_with_the_same_bits(
    request: pytest.FixtureRequest, robot_fmus: Path, flavour: str, order: str
) -> None:
    if flavour not in (DEFAULT_FLAVOUR, "pythonfmu"):
        robot_fmus = request.getfixturevalue("native_fmus")
    stop, points = (STOP, (3.9, 3.999, 4.0, 4.001)) if flavour != "pythonfmu" else (0.05, (0.01, 0.02))
    with Simulation(system_of(robot_fmus, flavour), order=order) as simulation:
        expected = simulation.run(stop, STEP)
        states = []
        with simulation.start(step_size=STEP) as run:
            for time in points:
                run.advance_to(time)
                states.append(run.save())
            run.advance_to(stop)
            for state in (states[0], states[-1], states[1], states[0]):  # back, on, and back again
                run.restore(state)
                assert run.time == state.point * STEP
                assert run["plant.x_E"] == expected["plant.x_E"][state.point]
                run.advance_to(stop)
                assert run.results.values.tobytes() == expected.values.tobytes()
        with simulation.start(step_size=STEP) as run:  # another run, which has not been there
            run.restore(states[-1])
            run.advance_to(stop)
        assert run.results.values.tobytes() == expected.values.tobytes()
        assert run.results.time.tobytes() == expected.time.tobytes()
        assert simulation.run(stop, STEP).values.tobytes() == expected.values.tobytes()


SCRIPT = """
import sys
from pathlib import Path
from cosim import RunState, Simulation
from parallel_robot.scenario import load_scenario
folder, flavour, state, result = sys.argv[1:]
system = load_scenario("tracking").system(Path(folder), flavour)
with Simulation(system) as simulation, simulation.start(step_size=1e-3) as run:
    run.restore(RunState.read(state))
    run.advance_to(4.05)
run.results.save(result)
"""


def test_a_file_goes_on_in_another_process(robot_fmus: Path, tmp_path: Path) -> None:
    with Simulation(system_of(robot_fmus, DEFAULT_FLAVOUR)) as simulation:
        expected = simulation.run(STOP, STEP)
        with simulation.start(step_size=STEP) as run:
            run.advance_to(3.5)
            run.save().write(tmp_path / "run.state")
    command = [sys.executable, "-c", SCRIPT, robot_fmus, DEFAULT_FLAVOUR, tmp_path / "run.state", tmp_path / "end.npz"]
    subprocess.run(command, check=True, cwd=tmp_path)
    assert np.load(tmp_path / "end.npz")["values"].tobytes() == expected.values.tobytes()
    assert [p.name for p in tmp_path.iterdir() if p.suffix == ".part"] == []


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_tiny(tmp_path_factory.mktemp("state"), INTEGRATOR)


def integrator(path: Path) -> System:
    system = System()
    system.add("i", path, start={"u": 1.0})
    return system


def test_what_was_set_by_hand_is_part_of_the_state(tiny: Path) -> None:
    with Simulation(integrator(tiny / "Integrator.fmu")) as simulation, simulation.start(step_size=0.1) as run:
        run["i.u"] = 3.0
        state = run.save()
        run.step(2)
        first = run["i.x"]
        run["i.u"] = 5.0
        run.step(2)
        run.restore(state)
        assert run["i.u"] == 3.0
        run.step(2)
        assert run["i.x"] == first == pytest.approx(0.6, rel=1e-12)


@pytest.mark.parametrize("version", [1, 3])
def test_a_file_of_another_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, version: int) -> None:
    nothing = np.zeros(0)
    with monkeypatch.context() as patch:
        patch.setattr("cosim.master.state._FORMAT", version)
        RunState({}, 0, {}, nothing, nothing, np.zeros((0, 0))).write(tmp_path / "state")
    with pytest.raises(SetupError, match="state of another version of this program; run again from the start"):
        RunState.read(tmp_path / "state")


def test_a_state_at_the_end_of_a_run_is_restored(tiny: Path) -> None:
    system = System()
    system.add("i", tiny / "Integrator.fmu", start={"u": 1.0})
    with Simulation(system) as simulation:
        with simulation.start(step_size=0.1, stop_time=0.5) as run:
            run.step(5)
            state, x = run.save(), run["i.x"]
        with simulation.start(step_size=0.1, stop_time=0.5) as run:
            run.restore(state)
            assert (run.time, run["i.x"]) == (0.5, x)


@pytest.mark.parametrize("capability", ["canGetAndSetFMUstate", "canSerializeFMUstate"])
def test_an_fmu_that_can_not_save_its_state_is_named(tiny: Path, tmp_path: Path, capability: str) -> None:
    path = without_capability(tiny / "Integrator.fmu", tmp_path / "Poor.fmu", capability)
    with Simulation(integrator(path)) as simulation, simulation.start(step_size=0.1) as run:
        with pytest.raises(
            SetupError, match=rf"^component 'i': its FMU can't save its state \({capability} is not set"
        ):
            run.save()
        run.step()


def test_the_state_of_another_run_is_refused(tiny: Path) -> None:
    path = tiny / "Integrator.fmu"
    with Simulation(integrator(path)) as simulation:
        with simulation.start(step_size=0.1) as run:
            run.step(3)
            state = run.save()
        for options, what in (
            ({"step_size": 0.2}, "communication step"),
            ({"step_size": 0.1, "start_time": 1.0}, "start time"),
        ):
            with simulation.start(**options) as run, pytest.raises(SetupError, match=rf"other {what}"):
                run.restore(state)
        with simulation.start(step_size=0.1, stop_time=0.2) as run, pytest.raises(SetupError, match="beyond the stop"):
            run.restore(state)
    with (
        Simulation(integrator(path), order="parallel") as simulation,
        simulation.start(step_size=0.1) as run,
        pytest.raises(SetupError, match="other order"),
    ):
        run.restore(state)


@pytest.mark.parametrize("content", [None, b"", b"not a state", b"PK\x03\x04 damaged"])
def test_a_file_that_is_no_state_is_one_line(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "run.state"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SetupError, match=r"run\.state: can't be read as the state of a run") as error:
        RunState.read(path)
    assert "\n" not in str(error.value)


class Touches:
    """Pickled, it makes a file where it is read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, tuple[Path]]:
        return Path.touch, (self.path,)


def test_what_reads_a_state_runs_no_code_of_the_file(tmp_path: Path) -> None:
    """A state may come from somebody else; numpy's files can hold pickled objects, which do what they like."""
    head = np.empty((), dtype=object)
    head[()] = Touches(tmp_path / "touched")
    np.savez(tmp_path / "state.npz", head=head)
    with pytest.raises(SetupError, match=r"state\.npz: can't be read as the state of a run"):
        RunState.read(tmp_path / "state.npz")
    assert not (tmp_path / "touched").exists()
    with np.load(tmp_path / "state.npz", allow_pickle=True) as data:  # the file is what it should be
        assert data["head"] is not None
    assert (tmp_path / "touched").exists()
