"""What each order delays, measured against exact recurrences; multirate systems; the times of a run."""

from __future__ import annotations

import itertools
import math
import random
from pathlib import Path

import numpy as np
import pytest

from cosim import System, simulate
from tests.support.tiny_models import build

ORDERS = ["sequential", "parallel"]


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("tiny"))


def held(signal, h: float, every: int = 1):
    """Value of a signal at the points i h, sampled and held over every so many of them."""
    return lambda i: signal(h * (max(i, 0) // every * every))


# Delays along a chain


def chain(tiny: Path, signal) -> System:
    """Signal -> gain K = 2 -> gain K = 3 -> integrator."""
    system = System()
    system.add("g1", tiny / "Gain.fmu", start={"K": 2.0, "u[2]": 0.0})
    system.add("g2", tiny / "Gain.fmu", start={"K": 3.0, "u[2]": 0.0})
    system.add("i", tiny / "Integrator.fmu")
    system.drive("g1.u[1]", signal)
    system.connect("g1.y[1]", "g2.u[1]")
    system.connect("g2.y[1]", "i.u")
    return system


@pytest.mark.parametrize(("order", "delay"), [("sequential", 0), ("parallel", 1)])
def test_delay_of_each_component_with_feedthrough(tiny, order, delay):
    h, n = 0.25, 12
    r = simulate(chain(tiny, lambda t: 1.0 + t * t), n * h, h, order=order)
    s = held(lambda t: 1.0 + t * t, h)
    i = range(n + 1)
    assert r["g1.u[1]"].tolist() == [s(k) for k in i]
    assert r["g1.y[1]"].tolist() == [2 * s(k - delay) for k in i]
    assert r["g2.u[1]"].tolist() == [2 * s(k - delay) for k in i]
    assert r["g2.y[1]"].tolist() == [6 * s(k - 2 * delay) for k in i]
    assert r["i.u"].tolist() == [6 * s(k - 2 * delay) for k in i]
    # the integrator itself adds its held input: x[k+1] = x[k] + h u[k], with no delay of its own
    x = h * np.concatenate([[0.0], np.cumsum(r["i.u"][:-1])])
    assert r["i.x"] == pytest.approx(x, rel=1e-13)


def test_the_delays_of_both_orders_can_be_told_apart(tiny):
    runs = [simulate(chain(tiny, lambda t: t), 1.0, 0.25, order=order)["i.x"] for order in ORDERS]
    assert abs(runs[0] - runs[1]).max() > 0.5


@pytest.mark.parametrize("order", ORDERS)
def test_outputs_without_feedthrough_are_never_delayed(tiny, order):
    h = 0.25
    system = System()
    system.add("second", tiny / "Integrator.fmu")
    system.add("first", tiny / "Integrator.fmu")
    system.drive("first.u", lambda t: 1.0)
    system.connect("first.x", "second.u")
    r = simulate(system, 2.0, h, order=order)
    assert r["first.x"] == pytest.approx(r.time, rel=1e-13)
    assert (r["second.u"] == r["first.x"]).all()
    k = np.arange(len(r.time))
    assert r["second.x"] == pytest.approx(h * h * k * (k - 1) / 2, rel=1e-13)  # explicit Euler of x'' = 1


@pytest.mark.parametrize("order", ORDERS)
def test_the_first_point_is_consistent_in_both_orders(tiny, order):
    r = simulate(chain(tiny, lambda t: 5.0), 1.0, 0.5, order=order)
    assert (r["g2.y[1]"] == 30.0).all()


# Closed loops


def feedback(tiny: Path, K: float, x_start: float = 1.0) -> System:
    """Couple an integrator and a gain to x' = -K x."""
    system = System()
    system.add("i", tiny / "Integrator.fmu", start={"x_start": x_start})
    system.add("g", tiny / "Gain.fmu", start={"K": -K, "u[2]": 0.0})
    system.connect("i.x", "g.u[1]")
    system.connect("g.y[1]", "i.u")
    return system


def recurrence(K: float, h: float, n: int, delay: int) -> list[float]:
    """x[k+1] = x[k] - h K x[k - delay], with x[k] = x[0] for negative k."""
    x = [1.0]
    for k in range(n):
        x.append(x[k] - h * K * x[max(k - delay, 0)])
    return x


@pytest.mark.parametrize(("order", "delay"), [("sequential", 0), ("parallel", 1)])
@pytest.mark.parametrize("K", [0.3, 1.7, 7.0])
def test_closed_loop_is_its_recurrence_to_rounding(tiny, order, delay, K):
    h, n = 0.125, 40
    r = simulate(feedback(tiny, K), n * h, h, order=order)
    x = np.array(recurrence(K, h, n, delay))
    scale = np.maximum.accumulate(abs(x))
    assert (abs(r["i.x"] - x) <= 1e-13 * scale).all()
    wrong = np.array(recurrence(K, h, n, 1 - delay))
    assert (abs(r["i.x"] - wrong) > 1e-6 * scale).any()


@pytest.mark.parametrize(("order", "limit"), [("sequential", 2.0), ("parallel", 1.0)])
def test_stability_limit_of_the_coupling_step(tiny, order, limit):
    # roots of z = 1 - K h, and of z^2 = z - K h: |z| = 1 at K h = 2 and at K h = 1
    h, n = 0.5, 400
    for factor, stable in ((0.97, True), (1.03, False)):
        x = simulate(feedback(tiny, limit * factor / h), n * h, h, order=order)["i.x"]
        late = abs(x[-20:]).max()
        assert (late < 1e-2) if stable else (late > 1e2)


@pytest.mark.parametrize("order", ORDERS)
def test_closed_loop_converges_with_order_one_to_the_exponential(tiny, order):
    K, stop = 2.0, 1.0
    steps = np.array([1 / 20, 1 / 40, 1 / 80, 1 / 160])
    errors = [
        abs(simulate(feedback(tiny, K), stop, float(h), order=order)["i.x"][-1] - math.exp(-K * stop)) for h in steps
    ]
    fitted = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert fitted == pytest.approx(1.0, abs=0.1)


def test_an_fmu_with_its_own_solver_is_exact_under_a_held_input(tiny):
    system = System()
    system.add("lag", tiny / "Lag.fmu", start={"x_start": 3.0, "T": 0.5, "u": 1.0})
    r = simulate(system, 2.0, 0.1)
    assert r["lag.x"] == pytest.approx(1.0 + 2.0 * np.exp(-r.time / 0.5), rel=1e-12)


# Structure


def crossed(tiny: Path) -> System:
    """Two components that feed each other; acyclic, for their paths a -> p and b -> q are apart."""
    system = System()
    system.add("A", tiny / "Cross.fmu")
    system.add("B", tiny / "Cross.fmu")
    system.drive("A.a", lambda t: t)
    system.connect("A.p", "B.a")  # t + 1
    system.connect("B.p", "A.b")  # t + 2
    system.connect("A.q", "B.b")  # 2 t + 4
    return system


def test_components_that_feed_each_other_without_a_loop_are_not_delayed(tiny):
    r = simulate(crossed(tiny), 1.0, 0.25)
    assert r["B.q"].tolist() == [4.0 * t + 8.0 for t in r.time]
    r = simulate(crossed(tiny), 2.0, 0.25, order="parallel")
    assert r["B.q"].tolist() == [4.0 * max(t - 4 * 0.25, 0.0) + 8.0 for t in r.time]  # four passages


@pytest.mark.parametrize("order", ORDERS)
def test_order_of_adding_changes_nothing(tiny, order):
    reference = simulate(crossed(tiny), 1.0, 0.125, order=order)
    generator = random.Random(1)
    for _ in range(8):
        system = crossed(tiny)
        names = list(system.components)
        generator.shuffle(names)
        system.components = {name: system.components[name] for name in names}
        generator.shuffle(system.connections)
        r = simulate(system, 1.0, 0.125, order=order)
        assert sorted(r.names) == sorted(reference.names)
        for name in r.names:
            assert (r[name] == reference[name]).all()


def test_order_of_adding_changes_nothing_in_a_closed_loop(tiny):
    runs = []
    for names in itertools.permutations(["i", "g"]):
        system = feedback(tiny, 3.0)
        system.components = {name: system.components[name] for name in names}
        system.connections.reverse()
        runs.append(simulate(system, 2.0, 0.1)["i.x"])
    assert (runs[0] == runs[1]).all()


def test_vectors_are_connected_index_by_index_however_they_are_declared(tiny):
    system = System()
    system.add("g", tiny / "Gain.fmu", start={"K": 1.0, "u": [1.0, 2.0]})
    system.add("reversed", tiny / "Reversed.fmu")
    system.add("h", tiny / "Gain.fmu", start={"K": 1.0})
    system.connect("g.y", "reversed.u")
    system.connect("reversed.y", "h.u")
    r = simulate(system, 1.0, 0.5)
    assert r["reversed.u[1]"].tolist() == [1.0] * 3
    assert r["h.y"].tolist() == [[1.0, 2.0]] * 3
    assert r["reversed.y"].tolist() == [[1.0, 2.0]] * 3
    system = System()
    system.add("reversed", tiny / "Reversed.fmu", start={"u": [1.0, 2.0]})
    assert simulate(system, 1.0, 1.0)["reversed.y[1]"].tolist() == [1.0, 1.0]
    system = System()
    system.add("reversed", tiny / "Reversed.fmu")
    system.drive("reversed.u", lambda t: [1.0, 2.0])
    assert simulate(system, 1.0, 1.0)["reversed.y[1]"].tolist() == [1.0, 1.0]


def test_recorded_vectors_come_in_the_order_of_their_indices(tiny):
    system = System()
    system.add("g", tiny / "Gain.fmu", start={"u": [1.0, 2.0]})
    r = simulate(system, 1.0, 1.0, record=["g.y[2]", "g.y", "g.K", "g.u[1]"])
    assert sorted(r.names) == ["g.K", "g.u[1]", "g.y[1]", "g.y[2]"]
    assert r["g.y"].tolist() == [[2.0, 4.0]] * 2


def test_an_algebraic_loop_in_parallel_begins_at_the_start_values(tiny):
    # each passage through a gain is one step old; the first inputs are given
    system = System()
    system.add("a", tiny / "Gain.fmu", start={"K": 0.5, "u": [8.0, 0.0]})
    system.add("b", tiny / "Gain.fmu", start={"K": 0.5, "u": [4.0, 0.0]})
    system.connect("a.y[1]", "b.u[1]")
    system.connect("b.y[1]", "a.u[1]")
    r = simulate(system, 3.0, 1.0, order="parallel")
    a, b = r["a.y[1]"], r["b.y[1]"]
    assert (a[1:] == 0.5 * b[:-1]).all()
    assert (b[1:] == 0.5 * a[:-1]).all()
    assert a[0] > 0.0
    assert b[0] > 0.0


def test_an_algebraic_loop_in_parallel_never_feeds_values_that_no_fmu_gave(tiny):
    # inputs that must stay positive, as they do: u[k] = u[k-1] around the loop
    system = System()
    for name in "ab":
        system.add(name, tiny / "Fragile.fmu", start={"u": 2.0})
    system.connect("a.y", "b.u")
    system.connect("b.y", "a.u")
    r = simulate(system, 3.0, 1.0, order="parallel")
    assert (r["a.y"] == 2.0).all()


# Multirate


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("every", [2, 3, 5])
def test_a_slow_component_samples_and_is_held(tiny, order, every):
    h, n = 0.25, 30
    system = System()
    system.add("slow", tiny / "Integrator.fmu", every=every)
    system.add("fast", tiny / "Gain.fmu", start={"K": 1.0, "u[2]": 0.0})
    system.drive("slow.u", lambda t: 1.0 + t)
    system.connect("slow.x", "fast.u[1]")
    r = simulate(system, n * h, h, order=order)
    x = [0.0]  # at the slow component's own points
    for k in range(n // every):
        x.append(x[-1] + every * h * (1.0 + k * every * h))
    own = np.arange(n + 1) // every
    expected = np.array(x)[own]
    # never from the future: in between, its output is that of its last own point
    assert r["slow.x"] == pytest.approx(expected, rel=1e-13)
    assert (r["fast.u[1]"] == r["slow.x"]).all()
    assert r["slow.u"].tolist() == [1.0 + every * h * k for k in own]


@pytest.mark.parametrize(("order", "delay"), [("sequential", 0), ("parallel", 1)])
def test_multirate_closed_loop_is_its_recurrence(tiny, order, delay):
    """A slow controller (gain) on a fast plant (integrator)."""
    h, n, K, every = 0.125, 48, 1.5, 4
    system = feedback(tiny, K)
    system.components = {}
    system.add("i", tiny / "Integrator.fmu", start={"x_start": 1.0})
    system.add("g", tiny / "Gain.fmu", start={"K": -K, "u[2]": 0.0}, every=every)
    r = simulate(system, n * h, h, order=order)
    x, sampled, command = [1.0], [1.0], -K
    for k in range(n + 1):
        if k % every == 0:
            sampled.append(x[k])
            command = -K * sampled[-1 - delay]
        x.append(x[k] + h * command)
    assert r["i.x"] == pytest.approx(np.array(x[:-1]), rel=1e-12, abs=1e-13)
    assert set(np.flatnonzero(np.diff(r["g.u[1]"])) + 1) <= set(range(0, n + 1, every))


def test_a_fast_component_between_slow_ones_takes_the_newest_values(tiny):
    h, n = 0.5, 12
    system = System()
    system.add("two", tiny / "Gain.fmu", start={"K": 1.0, "u[2]": 0.0}, every=2)
    system.add("one", tiny / "Gain.fmu", start={"K": 1.0, "u[2]": 0.0})
    system.add("three", tiny / "Gain.fmu", start={"K": 1.0, "u[2]": 0.0}, every=3)
    system.drive("two.u[1]", lambda t: t)
    system.connect("two.y[1]", "one.u[1]")
    system.connect("one.y[1]", "three.u[1]")
    r = simulate(system, n * h, h)
    k = np.arange(n + 1)
    assert r["one.y[1]"].tolist() == (h * (k // 2 * 2)).tolist()
    assert r["three.y[1]"].tolist() == (h * (k // 3 * 3 // 2 * 2)).tolist()


def test_signals_are_sampled_at_the_points_of_their_component_only(tiny):
    times = []

    def signal(t: float) -> float:
        times.append(t)
        return t

    system = System()
    system.add("slow", tiny / "Gain.fmu", start={"u[2]": 0.0}, every=4)
    system.drive("slow.u[1]", signal)
    simulate(system, 2.0, 0.25)
    assert sorted(set(times)) == [0.0, 1.0, 2.0]


# Times


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("every", [1, 2, 3])
def test_every_component_is_at_its_own_last_point(tiny, order, every):
    system = System()
    system.add("clock", tiny / "Clock.fmu", every=every)
    system.add("other", tiny / "Clock.fmu")
    r = simulate(system, 5.0, 0.25, start_time=2.0, order=order)
    k = np.arange(len(r.time))
    assert (r["clock.now"] == 2.0 + 0.25 * (k // every * every)).all()
    assert (r["other.now"] == r.time).all()


@pytest.mark.parametrize(("start", "h", "n"), [(0.0, 0.1, 1000), (3.7, 0.1, 333), (-1.3, 1e-3, 2000), (1e6, 0.01, 10)])
def test_times_are_start_plus_i_times_h_exactly(tiny, start, h, n):
    times = []

    def signal(t: float) -> float:
        times.append(t)
        return 1.0

    system = System()
    system.add("f", tiny / "Fragile.fmu")
    system.drive("f.u", signal)
    r = simulate(system, start + n * h, h, start_time=start)
    exact = [start + i * h for i in range(n + 1)]
    assert r.time.tolist() == exact
    assert times[-n - 1 :] == exact
    accumulated = list(itertools.accumulate([h] * n, initial=start))
    assert accumulated != exact or h == 0.25  # what the assertion above rules out


def test_a_start_time_shifts_the_run_and_nothing_else(tiny):
    runs = []
    for start in (0.0, 4.0):
        system = feedback(tiny, 2.0)
        runs.append(simulate(system, start + 2.0, 0.125, start_time=start))
    assert (runs[0].values == runs[1].values).all()
    assert (runs[0].time + 4.0 == runs[1].time).all()


def test_recording_does_not_change_a_run(tiny):
    everything = simulate(feedback(tiny, 2.0), 1.0, 0.1)
    little = simulate(feedback(tiny, 2.0), 1.0, 0.1, record=["i.x"])
    nothing = simulate(feedback(tiny, 2.0), 1.0, 0.1, record=[])
    assert little.names == ["i.x"]
    assert (little["i.x"] == everything["i.x"]).all()
    assert nothing.values.shape == (11, 0)
    assert everything.names == [f"{c}" for c in ("i.u", "i.x", "g.u[1]", "g.u[2]", "g.y[1]", "g.y[2]")]


def test_progress_reports_rising_times_up_to_the_end(tiny):
    reported: list[float] = []
    simulate(feedback(tiny, 0.1), 25.0, 0.1, progress=reported.append)
    assert reported == sorted(reported)
    assert (reported[0], reported[-1]) == (0.0, 25.0)
    assert len(reported) >= 3


def test_info_says_how_the_run_was_made(tiny):
    info = simulate(feedback(tiny, 0.5), 1.0, 0.1, order="parallel").info
    assert (info["step_size"], info["stop_time"], info["start_time"]) == (0.1, 1.0, 0.0)
    assert (info["order"], info["status"]) == ("parallel", "completed")
    assert info["parameters"]["g.K"] == -0.5
    assert info["parameters"]["i.x_start"] == 1.0
    assert info["fmus"]["i"]["path"].endswith("Integrator.fmu")
    assert len(info["fmus"]["i"]["sha256"]) == 64
    assert 0.0 < info["loop_time_s"] <= info["wall_time_s"]
