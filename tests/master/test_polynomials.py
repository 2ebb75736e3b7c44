"""Inputs of higher degree between communication points: which polynomials they are, and the order that they give."""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from cosim import SetupError, Simulation, System, simulate
from cosim.analysis import LinearComponent, LinearSystem, largest_stable_step, spectral_radius
from cosim.fmi.instance import Instance
from cosim.master.coupling.algorithm import EXTRAPOLATIONS
from fmu_export import build_native
from tests.support.small_fmus import TANK, build, redescribed
from tests.support.tiny_models import CLOCK, GAIN, INTEGRATOR

NATIVE = ("fmi2", "fmi3")

#: Degree, and number of values and of rates that are known, of each.
KNOWN = {
    "linear": (1, 2, 0),
    "quadratic": (2, 3, 0),
    "cubic": (3, 4, 0),
    "quadratic-least-squares": (2, 4, 0),
    "cubic-least-squares": (3, 5, 0),
    "tangent": (1, 1, 1),
    "hermite": (3, 2, 2),
    "hermite-least-squares": (3, 3, 3),
}


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("polynomials")
    for flavour in NATIVE:
        build(folder / flavour, flavour, GAIN, INTEGRATOR, TANK, CLOCK)
    return folder


# Which polynomials


def fitted(degree: int, values: Sequence[float], rates: Sequence[float], h: float) -> Polynomial:
    """Polynomial of the time since the last of values h apart, the newest first.

    It goes through the last, and by least squares along the others.
    Oracle: an orthogonal factorisation in place of the tables of weights.
    """
    powers = np.arange(1, degree + 1)
    s = -np.arange(len(values), dtype=float)
    matrix = np.vstack(
        [s[1:, None] ** powers, powers * (-np.arange(len(rates), dtype=float))[:, None] ** (powers - 1.0)]
    )
    right = np.concatenate([np.array(values[1:]) - values[0], h * np.array(rates)])
    found = np.linalg.lstsq(matrix, right, rcond=None)[0]
    return Polynomial([values[0], *(found / h**powers)])


@pytest.mark.parametrize("name", KNOWN)
def test_the_weights_are_those_of_the_fitted_polynomial(name: str) -> None:
    degree, n, m = KNOWN[name]
    extrapolation = EXTRAPOLATIONS[name]
    assert (extrapolation.degree, extrapolation.points, extrapolation.uses_rates) == (degree, max(n, m), m > 0)
    for i in range(n + m):
        unit = np.eye(n + m)[i]
        polynomial = fitted(degree, unit[:n], unit[n:], 1.0)
        table = extrapolation.weights if i < n else extrapolation.rate_weights
        for d in range(1, degree + 1):
            assert table[d - 1][i if i < n else i - n] == pytest.approx(polynomial.deriv(d)(0.0), abs=1e-12)


#: Inputs of the tank over time.
FLOWS: tuple[Callable[..., float], ...] = (lambda t: np.sin(3.0 * t), lambda t: np.exp(-t))


def integral(name: str, function: Callable[[float], float], times: np.ndarray, since: int, block: int) -> float:
    """Integral of the polynomials by the last values, each over the step that follows; from `since` on anew.

    The first ones, a block of them, go through the values at the ends of all its steps.
    """
    total = 0.0
    for k, (a, b) in enumerate(itertools.pairwise(times)):
        begin = since if k >= since else 0
        known = k + 1 - begin
        used = EXTRAPOLATIONS[name].used(known).name
        degree, n, _ = KNOWN.get(used, (0, 1, 0))
        values = [function(t) for t in times[k - min(n, known) + 1 : k + 1][::-1]]
        if k < begin + block:
            nodes = times[begin : begin + block + 1]
            through = Polynomial.fit(nodes, [function(t) for t in nodes], block).integ()
            total += through(b) - through(a)
            continue
        primitive = (fitted(degree, values, (), b - a) if degree else Polynomial(values)).integ()
        total += primitive(b - a) - primitive(0.0)
    return total


@pytest.mark.parametrize("every", [1, 2])
@pytest.mark.parametrize("jump", [None, 0.7, 0.8])
@pytest.mark.parametrize("name", ["quadratic", "cubic", "quadratic-least-squares", "cubic-least-squares"])
def test_inputs_follow_the_polynomial_by_their_last_values(
    fmus: Path, name: str, jump: float | None, every: int
) -> None:
    """After a block at the start, and at a jump, it goes by as many values as there are; both versions have equal bits.

    Components that do not step at each point begin without a block.
    """
    h, found = 0.1, []
    for flavour in NATIVE:
        system = System()
        system.add("gain", fmus / flavour / "Gain.fmu", start={"K": 1.0})
        system.add("tank", fmus / flavour / "Tank.fmu", every=every)
        for i, flow in enumerate(FLOWS, 1):
            system.drive(f"gain.u[{i}]", flow, vectorized=True, breakpoints=() if jump is None else (jump,))
        system.connect("gain.y[1]", "tank.a")
        system.connect("gain.y[2]", "tank.b")
        found.append(simulate(system, 2.0, h, extrapolation=name))
    r = found[0]
    assert r.values.tobytes() == found[1].values.tobytes()
    own = r.time[::every]
    since = 0 if jump is None else int(np.flatnonzero(own > jump - 1e-9)[0])
    block = KNOWN[name][0] if every == 1 else 0
    assert ("starting_blocks" in r.info) == (block > 0)
    # Simpson's rule of the Runge-Kutta method is exact for cubics
    expected = sum(integral(name, flow, own, since, block) for flow in FLOWS)
    assert r["tank.x"][-1] == pytest.approx(expected, rel=1e-12)


def chain(folder: Path, flavours: Sequence[str] = ("fmi2", "fmi2", "fmi2")) -> System:
    """An integrator of sin(t), a gain of 2, and an integrator of that: the rate of its input is 2 sin(t)."""
    system = System()
    system.add("i", folder / flavours[0] / "Integrator.fmu", start={"x_start": -1.0})
    system.add("g", folder / flavours[1] / "Gain.fmu", start={"K": 2.0, "u[2]": 0.0})
    system.add("j", folder / flavours[2] / "Integrator.fmu")
    system.drive("i.u", np.sin, vectorized=True)
    system.connect("i.x", "g.u[1]")
    system.connect("g.y[1]", "j.u")
    return system


@pytest.mark.parametrize("name", ["tangent", "hermite", "hermite-least-squares"])
def test_inputs_follow_the_polynomial_by_values_and_rates(fmus: Path, name: str) -> None:
    """A rate goes through the gain, whose directional derivatives carry it; all versions of FMI have equal bits.

    But for linear ones, which FMUs of FMI 3.0 know by their values only.
    """
    mixed = (("fmi2",) * 3, ("fmi3",) * 3, ("fmi2", "fmi3", "fmi2"), ("fmi3", "fmi2", "fmi3"))
    r, *others = (simulate(chain(fmus, flavours), 2.0, 0.1, extrapolation=name) for flavours in mixed)
    for other in others:
        if name == "tangent":
            assert other.values == pytest.approx(r.values, abs=1e-14)
        else:
            assert other.values.tobytes() == r.values.tobytes()
    total = 0.0
    for k, (a, b) in enumerate(itertools.pairwise(r.time)):
        degree, n, m = KNOWN[EXTRAPOLATIONS[name].used(k + 1).name]
        n = max(n, 1)
        rates = [2.0 * np.sin(t) for t in r.time[k - m + 1 : k + 1][::-1]]
        if k == 0 and name != "tangent":  # it begins with the cubic through both ends
            y, ends = r["g.y[1]"], 2.0 * np.sin(r.time)
            total += (b - a) * (y[0] + y[1]) / 2.0 + (b - a) ** 2 * (ends[0] - ends[1]) / 12.0
            continue
        primitive = fitted(degree, r["g.y[1]"][k - n + 1 : k + 1][::-1], rates, b - a).integ()
        total += primitive(b - a) - primitive(0.0)
    assert r["j.x"][-1] == pytest.approx(total, rel=1e-12)


def test_the_rate_of_an_output_that_depends_on_the_time_is_known(fmus: Path) -> None:
    """A clock's output goes on at 1 per second from the first step on, where its values say nothing yet."""
    system = System()
    system.add("clock", fmus / "fmi2" / "Clock.fmu")
    system.add("i", fmus / "fmi2" / "Integrator.fmu")
    system.connect("clock.now", "i.u", units="ignore")
    r = simulate(system, 1.0, 0.25, extrapolation="hermite")
    assert r["i.x"] == pytest.approx(r.time**2 / 2.0, rel=1e-14)


@pytest.mark.parametrize("every", [1, 2])
@pytest.mark.parametrize("jump", [None, 0.8])
@pytest.mark.parametrize(("name", "nodes"), [("quadratic", [0, 2 / 3, 1]), ("cubic", [0, 1 / 3, 2 / 3, 1])])
def test_a_signal_is_followed_by_a_polynomial_through_its_values_in_the_step(
    fmus: Path, name: str, nodes: list[float], jump: float | None, every: int
) -> None:
    """But for a step at whose end it jumps: there it is extrapolated."""
    system = System()
    system.add("tank", fmus / "fmi2" / "Tank.fmu", every=every)
    for which, flow in zip("ab", FLOWS, strict=True):
        system.drive(f"tank.{which}", flow, vectorized=True, breakpoints=() if jump is None else (jump,))
    r = simulate(system, 2.0, 0.1, extrapolation=name)
    own, total = r.time[::every], 0.0
    for k, (a, b) in enumerate(itertools.pairwise(own)):
        if jump is not None and own[k + 1] > jump - 1e-9 > own[k]:
            total += sum(jumped(name, flow, own, k) for flow in FLOWS)
            continue
        times = (b - a) * np.array(nodes)
        for flow in FLOWS:
            primitive = Polynomial.fit(times, flow(a + times), len(nodes) - 1).integ()
            total += primitive(b - a) - primitive(0.0)
    assert r["tank.x"][-1] == pytest.approx(total, rel=1e-12)


@pytest.mark.parametrize("vectorized", [False, True])
def test_a_signal_with_a_kink_at_a_point_is_followed_exactly_and_one_that_fails_inside_goes_straight(
    fmus: Path, vectorized: bool
) -> None:
    """Also where a table has a row at each point, as input files have."""
    kinks = np.array([0.0, 1.0, -2.0, 3.0, 3.0])

    def table(t: float) -> float:
        return np.interp(t, np.arange(5) * 0.5, kinks)

    def on_grid(t: float) -> float:
        if not np.allclose(np.asarray(t) / 0.5, np.round(np.asarray(t) / 0.5)):
            raise ValueError("there is no value")
        return table(t)

    for function in (table, on_grid):
        system = System()
        system.add("tank", fmus / "fmi2" / "Tank.fmu", start={"b": 0.0})
        system.drive("tank.a", function, vectorized=vectorized)
        r = simulate(system, 2.0, 0.5, extrapolation="cubic")
        assert r["tank.x"] == pytest.approx(np.cumsum([0.0, *(0.25 * (kinks[1:] + kinks[:-1]))]), abs=1e-12)


def jumped(name: str, flow: Callable[[float], float], times: np.ndarray, k: int) -> float:
    degree, n, _ = KNOWN[name]
    h = times[k + 1] - times[k]
    primitive = fitted(degree, [flow(t) for t in times[k - n + 1 : k + 1][::-1]], (), h).integ()
    return float(primitive(h) - primitive(0.0))


# Order of convergence

K = 2.0


def loop(folder: Path, flavours: Sequence[str] = ("fmi2", "fmi2")) -> System:
    """A tank and a gain, x' = -K x + sin t from x = 1."""
    system = System()
    system.add("tank", folder / flavours[0] / "Tank.fmu", start={"x_start": 1.0})
    system.add("gain", folder / flavours[1] / "Gain.fmu", start={"K": -K, "u[2]": 0.0})
    system.connect("tank.x", "gain.u[1]")
    system.connect("gain.y[1]", "tank.a")
    system.drive("tank.b", np.sin, vectorized=True)
    return system


def exact(t: np.ndarray) -> np.ndarray:
    """Solution of `loop`."""
    forced = (K * np.sin(t) - np.cos(t)) / (1.0 + K * K)
    return forced + (1.0 + 1.0 / (1.0 + K * K)) * np.exp(-K * t)


STEPS = [1 / 40, 1 / 80, 1 / 160, 1 / 320]


@pytest.mark.parametrize(
    ("name", "order"),
    [
        ("quadratic", 3.0),
        ("cubic", 4.0),
        ("quadratic-least-squares", 3.0),
        ("cubic-least-squares", 4.0),
        ("tangent", 2.0),
        ("hermite", 4.0),
        ("hermite-least-squares", 4.0),
        ("adaptive", 4.0),
    ],
)
def test_order_of_convergence_of_a_feedback_loop(fmus: Path, name: str, order: float) -> None:
    """From the first step on, by starting blocks; what the start leaves decays by exp(-2 t)."""
    late, all_ = [], []
    with Simulation(loop(fmus), extrapolation=name) as simulation:
        for h in STEPS:
            r = simulation.run(10.0, h)
            errors = np.abs(r["tank.x"] - exact(r.time))
            late.append(errors[r.time >= 8.0].max())
            all_.append(errors.max())
    orders = [float(np.polyfit(np.log(STEPS), np.log(e), 1)[0]) for e in (late, all_)]
    print(f"{name}: {late} {all_} {orders}")
    assert orders == pytest.approx([order, order], abs=0.15)


@pytest.mark.parametrize("name", ["cubic-least-squares", "hermite-least-squares", "adaptive"])
def test_bits_are_equal_in_all_versions_of_fmi_and_after_a_restored_state(fmus: Path, name: str) -> None:
    with Simulation(loop(fmus), extrapolation=name) as simulation:
        whole = simulation.run(2.0, 0.1)
        assert simulation.run(2.0, 0.1).values.tobytes() == whole.values.tobytes()
        with simulation.start(0.1) as run:
            run.step(7)
            state = run.save()
            run.step(5)
            run.restore(state)
            run.advance_to(2.0)
            assert run.results.values.tobytes() == whole.values.tobytes()
    for flavours in (("fmi3", "fmi3"), ("fmi2", "fmi3"), ("fmi3", "fmi2")):
        other = simulate(loop(fmus, flavours), 2.0, 0.1, extrapolation=name)
        assert other.values.tobytes() == whole.values.tobytes(), flavours


# What the stability analysis says of them


def feedback(K: float) -> LinearSystem:
    """The loop of a tank and a gain without the signal: x' = -K x."""
    tank = LinearComponent([[0.0]], [[1.0]], [[1.0]], [[0.0]], ["a"], ["x"])
    gain = LinearComponent((), (), (), [[-K]], ["u"], ["y"])
    return LinearSystem({"tank": tank, "gain": gain}, [("tank.x", "gain.u"), ("gain.y", "tank.a")])


def feedback_of_fmus(folder: Path, K: float) -> System:
    system = System()
    system.add("tank", folder / "fmi2" / "Tank.fmu", start={"x_start": 1.0, "b": 0.0, "max_step": 1.0})
    system.add("gain", folder / "fmi3" / "Gain.fmu", start={"K": -K, "u[2]": 0.0})
    system.connect("tank.x", "gain.u[1]")
    system.connect("gain.y[1]", "tank.a")
    return system


@pytest.mark.parametrize("order", ["sequential", "parallel"])
@pytest.mark.parametrize("name", KNOWN)
def test_runs_grow_and_decay_as_the_transition_matrix_says(fmus: Path, name: str, order: str) -> None:
    """By its largest eigenvalue, on both sides of the largest stable step."""
    limit = largest_stable_step(feedback(K), order=order, extrapolation=name)
    with Simulation(feedback_of_fmus(fmus, K), order=order, extrapolation=name) as simulation:
        for h in (0.97 * limit, 1.03 * limit):
            radius = spectral_radius(feedback(K), h, order=order, extrapolation=name)
            # so long that what grows fastest, of which the start leaves little, is the largest
            x = np.abs(simulation.run(1800 * h, h)["tank.x"])
            growth = (x[-100:].max() / x[-600:-500].max()) ** (1.0 / 500.0)
            assert growth == pytest.approx(radius, abs=2e-3), h
            assert (growth < 1.0) == (h < limit)


# Of single connections


def test_elements_that_are_set_together_agree(fmus: Path, tmp_path: Path) -> None:
    """The rate of what a function gives is not known: all of the array go straight, unless one is told otherwise."""
    array = build_native(GAIN, tmp_path, "fmi3", arrays=True)
    system = System()
    system.add("i", fmus / "fmi3" / "Integrator.fmu")
    system.drive("i.u", np.cos, vectorized=True)
    system.add("g", array)
    system.add_function("f", lambda t: [t], inputs={}, outputs={"y": 1})
    system.connect("i.x", "g.u[1]")
    with Simulation(system) as simulation:
        alone = simulation.run(0.5, 0.1).info["extrapolation"]
    system.connect("f.y[1]", "g.u[2]")
    with Simulation(system) as simulation:
        both = simulation.run(0.5, 0.1).info["extrapolation"]
    assert alone == {"mode": "auto", "adaptive": ["g.u[1]"], "linear": ["i.u"], "hold": []}
    assert both == {"mode": "auto", "linear": ["g.u[1]", "g.u[2]", "i.u"], "hold": []}


def test_a_connection_has_an_extrapolation_of_its_own(fmus: Path) -> None:
    system = System()
    for name in "ab":
        system.add(name, fmus / "fmi2" / "Integrator.fmu")
        system.drive(f"{name}.u", np.cos, vectorized=True)
    for name, flavour in (("t", "fmi2"), ("s", "fmi3")):
        system.add(name, fmus / flavour / "Tank.fmu")
        system.connect("a.x", f"{name}.a", extrapolation="cubic")
        system.connect("b.x", f"{name}.b", extrapolation="hold" if name == "s" else "linear")
    r = simulate(system, 2.0, 0.1)
    assert r.info["extrapolation"] == {
        "mode": "auto",
        "linear": ["a.u", "b.u", "t.b"],
        "cubic": ["s.a", "t.a"],
        "hold": ["s.b"],
    }
    b = r["b.x"]
    held = np.cumsum([0.0, *(0.1 * b[k] for k in range(20))])
    linear = held + np.cumsum([0.0, 0.0, *(0.05 * (b[k] - b[k - 1]) for k in range(1, 20))])
    whole = {name: simulate(system, 2.0, 0.1, extrapolation="cubic")[f"{name}.x"] for name in "ts"}
    # what the other input adds is that of the other extrapolation
    assert r["t.x"] - r["s.x"] == pytest.approx(linear - held, abs=1e-12)
    assert np.abs(whole["t"] - r["t.x"]).max() > 1e-4


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({'maxOutputDerivativeOrder="1"': ""}, "the FMU of component 'g' gives no derivatives of outputs"),
        ({'providesDirectionalDerivative="true"': ""}, "the FMU of component 'g' has direct feedthrough, and gives no"),
    ],
)
def test_rates_that_are_not_known_are_refused(fmus: Path, tmp_path: Path, change: dict[str, str], why: str) -> None:
    system = chain(fmus)
    other = redescribed(fmus / "fmi2" / "Gain.fmu", tmp_path / "other.fmu", change)
    again = System()
    again.add("i", fmus / "fmi2" / "Integrator.fmu")
    again.add("g", other, start={"K": 2.0, "u[2]": 0.0})
    again.add("j", fmus / "fmi2" / "Integrator.fmu")
    again.connections, again.signals = system.connections, system.signals
    message = (
        rf"^extrapolation 'hermite': the derivative of 'j\.u' is not known, because {why}.*; use 'cubic' or one of"
    )
    with pytest.raises(SetupError, match=message):
        Simulation(again, extrapolation="hermite")


def test_an_unknown_name_of_a_connection_is_refused(fmus: Path) -> None:
    system = System()
    system.add("a", fmus / "fmi2" / "Integrator.fmu", start={"u": 0.0})
    system.add("b", fmus / "fmi2" / "Integrator.fmu")
    system.connect("a.x", "b.u", extrapolation="cubc")
    with pytest.raises(SetupError, match=r"^extrapolation 'cubc' is unknown; use 'auto', 'hold'"):
        Simulation(system)


SILENT = {' maxInputDerivativeOrder="3"': ""}
WITHOUT_STATES = {**SILENT, 'canGetAndSetFMUstate="true"': ""}


def driven(fmu: Path) -> System:
    """One FMU whose input is a signal."""
    system = System()
    system.add("i", fmu)
    system.drive("i.u", np.sin, vectorized=True)
    return system


@pytest.mark.parametrize(
    ("replaced", "name", "found", "assumed"),
    [
        (SILENT, "cubic", {"i": 3}, None),
        (SILENT, "quadratic", {"i": 2}, None),
        (SILENT, "linear", None, None),
        (SILENT, "auto", None, None),
        (WITHOUT_STATES, "cubic", None, ["i"]),
        ({}, "cubic", None, None),
    ],
)
def test_the_order_that_an_fmu_does_not_say_it_takes_is_found(
    fmus: Path, tmp_path: Path, replaced: dict[str, str], name: str, found: Any, assumed: Any
) -> None:
    """By steps from the state in which it begins, which change no result; where it can't go back, it is assumed."""
    known = fmus / "fmi2" / "Integrator.fmu"
    fmu = redescribed(known, tmp_path / "silent.fmu", replaced) if replaced else known
    with Simulation(driven(fmu), extrapolation=name) as simulation:
        results = [simulation.run(1.0, 0.1) for _ in range(2)]
    for r in results:
        assert r.info.get("order_found") == found
        assert r.info["extrapolation"].get("order_assumed") == assumed
        if name != "auto":
            assert r.values.tobytes() == simulate(driven(known), 1.0, 0.1, extrapolation=name).values.tobytes()


def test_an_fmu_that_ignores_derivatives_is_refused(
    fmus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fmu = redescribed(fmus / "fmi2" / "Integrator.fmu", tmp_path / "silent.fmu", SILENT)
    call = Instance.call

    def ignoring(self: Instance, function: str, *arguments: Any) -> None:
        if function == "fmi2SetRealInputDerivatives" and isinstance(arguments[2], ctypes.Array):
            references, n, orders, values = arguments
            kept = [value if order == 1 else 0.0 for order, value in zip(orders, values, strict=True)]
            arguments = (references, n, orders, (ctypes.c_double * n)(*kept))
        call(self, function, *arguments)

    monkeypatch.setattr(Instance, "call", ignoring)
    with pytest.raises(SetupError, match=r"^component 'i': its FMU ignores derivatives of its inputs from order 2 on"):
        simulate(driven(fmu), 1.0, 0.1, extrapolation="cubic")
    assert simulate(driven(fmu), 1.0, 0.1).info["extrapolation"]["linear"] == ["i.u"]


def test_a_signal_goes_straight_to_its_jump_also_where_others_go_by_rates(fmus: Path) -> None:
    """It has no rate: its slope before the jump is that of its last two values."""
    system = System()
    system.add("i", fmus / "fmi2" / "Integrator.fmu", start={"u": 1.0})
    system.add("tank", fmus / "fmi2" / "Tank.fmu")
    system.connect("i.x", "tank.a")
    system.drive("tank.b", lambda t: 2.0 * t if t < 0.5 else -3.0, breakpoints=[0.5])
    for name in ("hermite", "hermite-least-squares", "adaptive"):
        r = simulate(system, 0.5, 0.1, extrapolation=name)
        assert r["tank.x"] == pytest.approx(r.time**2 / 2.0 + r.time**2, abs=1e-13)
