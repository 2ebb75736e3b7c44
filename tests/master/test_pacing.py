"""Runs in real time: how long they take, and what they report when they can't keep up."""

from __future__ import annotations

import math
import re
import subprocess
import sys
import time as clock
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import cosim.master.pacing
from cosim import SetupError, Signal, Simulation, System, simulate
from cosim.master.pacing import Pacer
from tests.support.clock import Clock
from tests.support.small_fmus import build
from tests.support.tiny_models import INTEGRATOR


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("pacing"), "fmi2", INTEGRATOR)


def system(fmus: Path, function: Callable[[float], float] = lambda t: 1.0) -> System:
    system = System()
    system.add("i", fmus / "Integrator.fmu")
    system.drive("i.u", function)
    return system


@pytest.fixture
def by_hand(monkeypatch: pytest.MonkeyPatch) -> Clock:
    by_hand = Clock()
    monkeypatch.setattr(cosim.master.pacing, "clock", by_hand)
    return by_hand


@pytest.mark.parametrize(("stop", "factor"), [(0.3, 1.0), (0.1, 0.5), (3.0, 10.0), (2.0, 10)])
def test_a_run_takes_its_duration_divided_by_the_factor(fmus: Path, by_hand: Clock, stop: float, factor: float) -> None:
    results = simulate(system(fmus), stop, stop / 30, realtime=factor)
    assert by_hand.now - 100.0 == pytest.approx(stop / factor, abs=1e-9)  # up to the last point, which is waited for
    assert results.info["realtime"]["factor"] == factor


def test_the_clock_of_a_run_is_that_of_the_machine(fmus: Path) -> None:
    """It never takes less."""
    began = clock.perf_counter()
    results = simulate(system(fmus), 0.1, 0.01, realtime=1.0)
    assert clock.perf_counter() - began >= 0.1
    assert results.info["loop_time_s"] >= 0.1


def test_real_time_changes_no_value(fmus: Path, by_hand: Clock) -> None:
    expected = simulate(system(fmus), 0.3, 0.01)
    assert by_hand.now == 100.0
    paced = simulate(system(fmus), 0.3, 0.01, realtime=3.0)
    assert paced.values.tobytes() == expected.values.tobytes()
    assert paced.time.tobytes() == expected.time.tobytes()
    assert "realtime" not in expected.info


def test_the_time_counts_from_the_start_time(fmus: Path, by_hand: Clock) -> None:
    simulate(system(fmus), 1000.1, 0.01, start_time=1000.0, realtime=1.0)
    assert by_hand.now - 100.0 == pytest.approx(0.1, abs=1e-9)


@pytest.mark.parametrize("factor", [0, 0.0, -1.0, math.nan, math.inf, -math.inf, True, "fast", "1", [1.0]])
def test_bad_factors_are_refused_before_anything_runs(fmus: Path, factor: object) -> None:
    calls: list[float] = []
    message = rf"^real-time factor {re.escape(repr(factor))} must be a positive number$"
    with pytest.raises(SetupError, match=message):
        simulate(system(fmus), 1.0, 0.1, realtime=factor, progress=calls.append)
    assert calls == []


def test_points_are_not_before_they_are_due_and_reported_as_they_come(fmus: Path) -> None:
    reported: list[tuple[float, float]] = []
    began = None

    def progress(t: float) -> None:
        nonlocal began
        began = began or clock.perf_counter()
        reported.append((t, clock.perf_counter() - began))

    simulate(system(fmus), 0.2, 0.02, realtime=1.0, progress=progress)
    assert [t for t, _ in reported] == [0.0, *(0.02 * i for i in range(11))]
    assert all(elapsed >= t - 1e-4 for t, elapsed in reported)


def test_a_quick_run_has_no_overruns_and_its_lateness_is_reported(fmus: Path, by_hand: Clock) -> None:
    report = simulate(system(fmus), 0.3, 0.1, realtime=1.0).info["realtime"]
    assert set(report) == {"factor", "overruns", "lateness_max_s", "lateness_mean_s", "jitter_rms_s"}
    assert report["overruns"] == 0
    assert 0.0 <= report["lateness_mean_s"] <= report["lateness_max_s"] < 1e-9
    assert 0.0 <= report["jitter_rms_s"] <= report["lateness_max_s"]


def test_a_slow_signal_overruns_and_the_run_catches_up(fmus: Path, by_hand: Clock) -> None:
    """Three values take 50 ms each, where a step has 20 ms."""

    def slow(t: float) -> float:
        if 0.095 < t < 0.145:
            by_hand.now += 0.05
        return 1.0

    report = simulate(system(fmus, slow), 0.4, 0.02, realtime=1.0).info["realtime"]
    # late by 30, 60 and 90 ms; this is worked off over four quick points: 70, 50, 30 and 10 ms
    assert report["overruns"] == 7
    assert report["lateness_max_s"] == pytest.approx(0.09, abs=1e-9)
    late = np.array([0.03, 0.06, 0.09, 0.07, 0.05, 0.03, 0.01, *[0.0] * 14])
    assert report["lateness_mean_s"] == pytest.approx(late.mean(), abs=1e-9)
    assert report["jitter_rms_s"] == pytest.approx(late.std(), abs=1e-9)


def test_a_run_that_never_keeps_up_overruns_at_every_point(fmus: Path, by_hand: Clock) -> None:
    """A value is asked for one point ahead: the first two before the clock runs."""

    def slow(t: float) -> float:
        by_hand.now += 0.01
        return 1.0

    report = simulate(system(fmus, slow), 0.02, 0.001, realtime=1.0).info["realtime"]
    assert report["overruns"] == 19
    assert report["lateness_max_s"] == pytest.approx(19 * 0.01 - 0.019, abs=0.0011)


def test_a_slow_fmu_overruns(tmp_path: Path) -> None:
    """One of pythonfmu's own, whose step takes 20 ms at least."""
    report = simulate(slow_fmu(tmp_path), 0.1, 0.01, realtime=1.0).info["realtime"]
    assert report["overruns"] == 10
    assert report["lateness_max_s"] >= 10 * (0.02 - 0.01) - 1e-3


def slow_fmu(folder: Path) -> System:
    (folder / "slow.py").write_text(
        "import time\n"
        "from pythonfmu import Fmi2Causality, Fmi2Slave, Real\n"
        "class Slow(Fmi2Slave):\n"
        "    def __init__(self, **arguments):\n"
        "        super().__init__(**arguments)\n"
        "        self.y = 0.0\n"
        "        self.register_variable(Real('y', causality=Fmi2Causality.output))\n"
        "    def do_step(self, t, h):\n"
        "        time.sleep(0.02)\n"
        "        return True\n"
    )
    command = [sys.executable, "-c", "from fmu_export import build_script; build_script('slow.py')"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    system = System()
    system.add("slow", folder / "Slow.fmu")
    return system


def test_each_run_has_its_own_report(fmus: Path, by_hand: Clock) -> None:
    def slow(t: float) -> float:
        by_hand.now += 0.02
        return 1.0

    with Simulation(system(fmus)) as simulation:
        late = simulation.run(1.0, 0.1, realtime=10.0, signals=[Signal("i.u", slow)]).info["realtime"]
        prompt = simulation.run(2.0, 1.0, realtime=10.0).info["realtime"]
    assert late["overruns"] == 9
    assert prompt["overruns"] == 0


# The pacer by itself


def test_waiting_ends_when_a_point_is_due(by_hand: Clock) -> None:
    pacer = Pacer(2.0)
    for elapsed in (0.0, 1.0, 2.0):
        pacer.wait(elapsed, lambda: False)
        assert by_hand.now == pytest.approx(100.0 + elapsed / 2.0, abs=1e-12)
        assert by_hand.now >= 100.0 + elapsed / 2.0
        by_hand.now += 0.1
    assert pacer.report() == pytest.approx(
        {"factor": 2.0, "overruns": 0, "lateness_max_s": 0.0, "lateness_mean_s": 0.0, "jitter_rms_s": 0.0}, abs=1e-12
    )


def test_report_of_a_run_with_late_points(by_hand: Clock) -> None:
    pacer = Pacer(1.0)
    work = [0.5, 2.5, 1.0, 0.25, 0.25]  # s that each point takes
    for elapsed, seconds in enumerate(work):
        pacer.wait(elapsed, lambda: False)
        by_hand.now += seconds
    # points begin at 0, 1, 3.5, 4.5 and 4.75 instead of 0, 1, 2, 3 and 4
    late = np.array([0.0, 0.0, 1.5, 1.5, 0.75])
    assert pacer.report() == {
        "factor": 1.0,
        "overruns": 3,
        "lateness_max_s": 1.5,
        "lateness_mean_s": late.mean(),
        "jitter_rms_s": late.std(),
    }


def test_report_of_a_run_without_points() -> None:
    assert Pacer(1.0).report() == {
        "factor": 1.0,
        "overruns": 0,
        "lateness_max_s": 0.0,
        "lateness_mean_s": 0.0,
        "jitter_rms_s": 0.0,
    }
