"""A team of threads steps components as one thread does, to the last bit, and ends as one thread does."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cosim import Results, SetupError, Simulation, SimulationError, System, simulate
from cosim.loop.source import loop_sources
from cosim.loop.team import Team, cores
from fmu_export.native.toolchain import find_compiler
from tests.support.c_fmus import ender, tank
from tests.support.native_fmus import require_compiler
from tests.support.patience import PATIENCE
from tests.support.quirks import Quirk, quirky
from tests.support.small_fmus import build, compiled
from tests.support.tiny_models import GAIN, INTEGRATOR

TEAMS = (2, 3, "auto")


def ring(fmus: dict[str, Path], n: int = 3) -> System:
    """Integrators and gains in turn, each fed by the one before; one of them every 3 steps, and a function."""
    system = System()
    for i in range(n):
        folder = list(fmus.values())[i % len(fmus)]
        system.add(f"i{i}", folder / "Integrator.fmu", start={"x_start": 1.0 + i}, every=3 if i == 1 else 1)
        system.add(f"g{i}", folder / "Gain.fmu", start={"K": -0.9 - 0.1 * i})
    system.add_function("f", lambda t, u: u, inputs=["u"], outputs=["y"])
    for i in range(n):
        system.connect(f"i{i}.x", f"g{i}.u[1]")
        if i:
            system.connect(f"g{i}.y[1]", f"i{(i + 1) % n}.u")
        system.drive(f"g{i}.u[2]", math.sin, breakpoints=[0.5])
    system.connect("g0.y[1]", "f.u")
    system.connect("f.y", f"i{1 % n}.u")
    return system


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {
        flavour: build(tmp_path_factory.mktemp(flavour), flavour, GAIN, INTEGRATOR)
        for flavour in ("fmi2", "fmi3", "pythonfmu")
    }


@pytest.mark.parametrize("order", ["sequential", "parallel"])
@pytest.mark.parametrize("extrapolation", ["hold", "auto"])
def test_results_are_equal_to_the_last_bit(fmus: dict[str, Path], order: str, extrapolation: str) -> None:
    def run(threads: int | str) -> Results:
        return simulate(ring(fmus), 3.0, 0.03, order=order, extrapolation=extrapolation, threads=threads)

    alone = run(1)
    assert "threads" not in alone.info
    for threads in TEAMS:
        results = run(threads)
        assert results.values.tobytes() == alone.values.tobytes()
        said = results.info["threads"]
        assert said["asked"] == threads
        assert said["used"] == (min(cores(), 5) if threads == "auto" else threads)  # Python's components are one
        assert said["steps_together"] == 100 or threads == "auto"


def test_a_run_that_is_stepped_by_hand_is_too(fmus: dict[str, Path]) -> None:
    values = []
    for threads in (1, 2):
        with Simulation(ring(fmus), threads=threads) as simulation, simulation.start(step_size=0.01) as run:
            run.step(50)
            state = run.save()
            run.step(50)
            run.restore(state)
            run.step(100)
            values.append(run.results.values.tobytes())
    assert values[0] == values[1]


@pytest.mark.parametrize("threads", TEAMS)
def test_steps_that_are_not_finished_at_once_are_finished(fmus: dict[str, Path], tmp_path: Path, threads: int) -> None:
    in_part, later = quirky(tmp_path, Quirk.COMPUTES_IN_PART), quirky(tmp_path, Quirk.IS_ASYNCHRONOUS)
    found = []
    for n in (1, threads):
        system = System()
        system.add("i", fmus["fmi2"] / "Integrator.fmu")
        for name, fmu in (("a", in_part), ("b", later), ("c", in_part)):
            system.add(name, fmu, start={"longest": 0.3, "end": 1.75} if name == "c" else {"longest": 0.3})
            system.drive(f"{name}.u", lambda t: t)
        results = simulate(system, 2.0, 0.5, threads=n)
        found.append((results.values.tobytes(), results.info.get("steps_repeated"), results.info.get("ended_by")))
    assert found[0] == found[1]
    assert found[0][1]


@pytest.mark.parametrize("threads", TEAMS)
def test_the_first_that_fails_is_named(tmp_path: Path, threads: int) -> None:
    system = System()
    for i in range(4):
        system.add(f"p{i}", compiled(tmp_path, "fmi2_probe"), start={"fail_at": 0.5 if i > 1 else 1e9, "status": 3})
    with pytest.raises(SimulationError) as alone:
        simulate(system, 1.0, 0.1)
    with pytest.raises(SimulationError) as failed:
        simulate(system, 1.0, 0.1, threads=threads)
    assert str(failed.value) == str(alone.value)
    assert str(failed.value).startswith("p2 failed at t = 0.5 s")
    assert failed.value.results.values.tobytes() == alone.value.results.values.tobytes()


@pytest.mark.skipif(sys.platform != "linux", reason="what a signal leaves differs elsewhere")
def test_a_crash_in_a_thread_of_the_team_is_explained(tmp_path: Path) -> None:
    script = """
import sys
from cosim import System, simulate
system = System()
system.add("a", sys.argv[1])
system.add("b", sys.argv[2])
system.add("c", sys.argv[2])
simulate(system, 1.0, 0.1, threads=3)
"""
    fmu = ender(tmp_path / "f.fmu", "STEPPING", "SEGMENTATION")
    command = [sys.executable, "-c", script, fmu, tank(tmp_path / "tank.fmu")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == -signal.SIGSEGV
    assert done.stderr.startswith("cosim: component 'a' (f.fmu) crashed in fmi2DoStep at t = 0.4 s: segmentation fault")


@pytest.mark.parametrize("wrong", [0, -1, 1.5, True, "two", None, 5000])
def test_a_number_that_makes_no_sense_is_refused(fmus: dict[str, Path], wrong: object) -> None:
    with pytest.raises(SetupError, match=r"^threads = .* must be a whole number from 1 to 1024, or 'auto'$"):
        Simulation(ring(fmus), threads=wrong)


def test_there_are_no_more_threads_than_can_work() -> None:
    assert Team(8, [1, 2], [False, False]).threads == 2
    assert Team(8, [1, 2, 3], [False, True, True]).threads == 2
    assert Team("auto", [1], [False]).threads == 1
    assert Team(8, [1, 2], [True, True]).address is None
    assert Team(8, [], []).steps_together == 0


@pytest.mark.parametrize("sanitised", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_team_in_c(tmp_path: Path, sanitised: bool) -> None:
    require_compiler()
    for name, content in loop_sources().items():
        (tmp_path / name).write_bytes(content)
    host = Path(__file__).parents[1] / "support/team_host.c"
    command = [*find_compiler(), "-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-I.", str(host)]
    command += [*(p.name for p in tmp_path.glob("*.c")), "-o", "host", "-lm", "-lpthread"]
    command += ["-g", "-fsanitize=thread"] if sanitised else []
    subprocess.run(command, cwd=tmp_path, check=True)
    done = subprocess.run(["./host"], cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    first, second = done.stdout.splitlines()
    assert float(first)  # teams whose sum differs would follow
    assert second == "-43"
