"""Linear inputs: which ones are, and that they make the coupling second-order accurate, also over jumps."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import fmpy
import numpy as np
import pytest

import cosim.master.sampling
from cosim import Results, SetupError, Signal, Simulation, System, simulate
from cosim.fmi.fmu_file import read_fmu
from cosim.master import chunks
from cosim.master.coupling.algorithm import algorithm
from cosim.master.coupling.extrapolated_inputs import extrapolated_inputs
from cosim.system.resolution import resolve
from cosim.system.variables import Ports
from tests.support.fmi3_gain import DESCRIPTION, HELD, zipped
from tests.support.small_fmus import TANK, build, redescribed
from tests.support.tiny_models import GAIN, INTEGRATOR, TWO_LEVELS

NATIVE = ("fmi2", "fmi3")


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("coupling")
    for flavour in NATIVE:
        build(folder / flavour, flavour, GAIN, INTEGRATOR, TANK, TWO_LEVELS)
    build(folder / "pythonfmu", "pythonfmu", GAIN, INTEGRATOR, TANK)
    return folder


# Which inputs are linear


def ramp(fmu: Path, every: int = 1) -> System:
    """An integrator of t."""
    system = System()
    system.add("i", fmu, every=every)
    system.drive("i.u", lambda t: 1.0 * t, vectorized=True)
    return system


def coupled(system: System, coupling: str) -> Mapping[str, object]:
    return simulate(system, 0.6, 0.1, extrapolation=coupling).info["extrapolation"]


@pytest.mark.parametrize("flavour", NATIVE)
def test_inputs_are_linear_where_the_fmu_can(fmus: Path, flavour: str) -> None:
    system = ramp(fmus / flavour / "Integrator.fmu")
    assert coupled(system, "auto") == {"mode": "auto", "linear": ["i.u"], "hold": []}
    assert coupled(system, "linear") == {"mode": "linear", "linear": ["i.u"], "hold": []}
    assert coupled(system, "hold") == {"mode": "hold", "hold": ["i.u"]}


def obstacles(fmus: Path, folder: Path) -> dict[str, tuple[Path, str]]:
    """FMUs that can't have linear inputs, and why."""
    fmi2, fmi3 = fmus / "fmi2" / "Integrator.fmu", fmus / "fmi3" / "Integrator.fmu"
    interpolates = 'canInterpolateInputs="true"'
    asks = 'providesIntermediateUpdate="true"'
    during = 'intermediateUpdate="true"'
    cant = r"its FMU can't interpolate inputs \(canInterpolateInputs\)"
    doesnt = r"its FMU doesn't ask for inputs during a step \(providesIntermediateUpdate\)"
    neither = r"it can't be set during a step \(intermediateUpdate\)"
    return {
        "fmi2-absent": (redescribed(fmi2, folder / "a.fmu", {interpolates: ""}), cant),
        "fmi2-false": (redescribed(fmi2, folder / "b.fmu", {interpolates: 'canInterpolateInputs="false"'}), cant),
        "fmi3-absent": (redescribed(fmi3, folder / "c.fmu", {asks: ""}), doesnt),
        "fmi3-false": (redescribed(fmi3, folder / "d.fmu", {asks: 'providesIntermediateUpdate="false"'}), doesnt),
        "fmi3-input-absent": (redescribed(fmi3, folder / "e.fmu", {during: ""}), neither),
        "fmi3-input-false": (redescribed(fmi3, folder / "f.fmu", {during: 'intermediateUpdate="false"'}), neither),
        "pythonfmu": (fmus / "pythonfmu" / "Integrator.fmu", cant),
    }


OBSTACLES = (
    "fmi2-absent",
    "fmi2-false",
    "fmi3-absent",
    "fmi3-false",
    "fmi3-input-absent",
    "fmi3-input-false",
    "pythonfmu",
)


@pytest.mark.parametrize("which", OBSTACLES)
def test_inputs_of_an_fmu_that_cannot_are_held_or_refused(fmus: Path, tmp_path: Path, which: str) -> None:
    fmu, why = obstacles(fmus, tmp_path)[which]
    system = ramp(fmu)
    assert coupled(system, "auto") == {"mode": "auto", "linear": [], "hold": ["i.u"]}
    assert coupled(system, "hold") == {"mode": "hold", "hold": ["i.u"]}
    message = rf"^extrapolation 'linear': input 'i\.u' can only be held, because {why}; use 'auto'$"
    with pytest.raises(SetupError, match=message):
        Simulation(system, extrapolation="linear")
    # and it is: the rate is not asked for, and the run is that of an FMU that can, with held inputs
    held = simulate(ramp(fmus / "fmi2" / "Integrator.fmu"), 0.6, 0.1, extrapolation="hold")
    assert simulate(system, 0.6, 0.1).values == pytest.approx(held.values, rel=1e-12)


def test_intermediate_update_may_be_written_as_1(fmus: Path, tmp_path: Path) -> None:
    """A boolean of XML Schema."""
    fmu = redescribed(
        fmus / "fmi3" / "Integrator.fmu",
        tmp_path / "one.fmu",
        {'intermediateUpdate="true"': 'intermediateUpdate="1"', 'IntermediateUpdate="true"': 'IntermediateUpdate="1"'},
    )
    assert coupled(ramp(fmu), "linear")["linear"] == ["i.u"]


def test_only_reals_of_64_bits_are_linear(gain3c: Path, tmp_path: Path) -> None:
    description = DESCRIPTION.replace("<CoSimulation ", '<CoSimulation providesIntermediateUpdate="true" ').replace(
        'causality="input"', 'causality="input" intermediateUpdate="true"'
    )
    library = gain3c.with_suffix(fmpy.sharedLibraryExtension)
    fmu = zipped(tmp_path / "gain.fmu", library, description)
    system = System()
    system.add("c", fmu, start={"u[2]": 1.0})
    system.drive("c.u[3]", lambda t: t)
    system.drive("c.u[1]", lambda t: t)
    for name in "vnbf":
        system.drive(f"c.{name}", lambda t: 0.0)
    assert coupled(system, "auto") == {
        "mode": "auto",
        "linear": ["c.u[1]", "c.u[3]", "c.v"],
        "hold": ["c.b", "c.f", "c.n"],
    }
    for name, kind in (("n", "Int32"), ("b", "Boolean"), ("f", "Float32")):
        system = System()
        system.add("c", fmu, start={k: v for k, v in HELD.items() if k != name})
        system.drive(f"c.{name}", lambda t: 0.0)
        message = rf"input 'c\.{name}' can only be held, because it is of type {kind}; use 'auto'"
        with pytest.raises(SetupError, match=message):
            Simulation(system, extrapolation="linear")


@pytest.mark.parametrize(
    ("source", "target", "linear"),
    [(1, 1, True), (1, 2, True), (2, 2, True), (2, 4, True), (2, 1, False), (2, 3, False), (4, 2, False)],
)
def test_a_component_that_reads_more_often_than_its_source_gives_is_held(
    fmus: Path, source: int, target: int, linear: bool
) -> None:
    system = ramp(fmus / "fmi2" / "Integrator.fmu", every=source)
    system.add("j", fmus / "fmi2" / "Integrator.fmu", every=target)
    system.connect("i.x", "j.u")
    moving: dict[str, object] = {"linear": ["i.u"], "adaptive": ["j.u"], "hold": []}
    expected = moving if linear else {"linear": ["i.u"], "hold": ["j.u"]}
    assert coupled(system, "auto") == {"mode": "auto", **expected}
    if not linear:
        message = (
            rf"input 'j\.u' can only be held, because it gets a value every {source} steps only, "
            rf"and its component needs one every {target}; use 'auto'"
        )
        with pytest.raises(SetupError, match=message):
            Simulation(system, extrapolation="linear")


@pytest.mark.parametrize("flavour", NATIVE)
def test_discrete_inputs_are_held(fmus: Path, tmp_path: Path, flavour: str) -> None:
    """FMI 2.0, canInterpolateInputs: "continuous inputs"; discrete ones change at communication points only."""
    fmu = fmus / flavour / "Integrator.fmu"
    with zipfile.ZipFile(fmu) as archive:
        text = archive.read("modelDescription.xml").decode()
    (line,) = [line for line in text.splitlines() if 'name="u"' in line]
    other = line.replace('variability="continuous"', 'variability="discrete"')
    system = ramp(redescribed(fmu, tmp_path / "other.fmu", {line: other}))
    assert coupled(system, "auto") == {"mode": "auto", "linear": [], "hold": ["i.u"]}
    message = r"input 'i\.u' can only be held, because it is discrete and changes at communication points only"
    with pytest.raises(SetupError, match=message):
        Simulation(system, extrapolation="linear")


@pytest.mark.parametrize("flavour", NATIVE)
def test_what_a_discrete_output_feeds_is_held_unless_linear_is_demanded(
    fmus: Path, tmp_path: Path, flavour: str
) -> None:
    """A slope between its values would be that of no signal."""
    fmu = fmus / flavour / "Integrator.fmu"
    with zipfile.ZipFile(fmu) as archive:
        text = archive.read("modelDescription.xml").decode()
    (line,) = [line for line in text.splitlines() if 'name="x"' in line]
    other = line.replace('variability="continuous"', 'variability="discrete"')
    system = System()
    system.add("d", redescribed(fmu, tmp_path / "other.fmu", {line: other}))
    system.add("i", fmu)
    system.connect("d.x", "i.u")
    assert coupled(system, "auto") == {"mode": "auto", "linear": [], "hold": ["i.u"]}
    assert coupled(system, "linear") == {"mode": "linear", "linear": ["i.u"], "hold": []}


def test_an_input_that_nothing_feeds_is_neither_linear_nor_held(fmus: Path) -> None:
    system = System()
    system.add("i", fmus / "fmi2" / "Integrator.fmu", start={"u": 1.0})
    assert coupled(system, "linear") == {"mode": "linear", "linear": [], "hold": []}


def test_linear_and_held_inputs_stand_beside_each_other(fmus: Path) -> None:
    system = System()
    system.add("a", fmus / "fmi3" / "Integrator.fmu")
    system.add("b", fmus / "pythonfmu" / "Integrator.fmu")
    system.add("c", fmus / "fmi2" / "Integrator.fmu")
    system.drive("a.u", lambda t: t)
    system.connect("a.x", "b.u")
    system.connect("b.x", "c.u")
    assert coupled(system, "auto") == {"mode": "auto", "linear": ["a.u", "c.u"], "hold": ["b.u"]}
    with pytest.raises(SetupError, match=r"input 'b\.u' can only be held"):
        Simulation(system, extrapolation="linear")


def test_an_input_to_which_a_signal_is_added_is_held(fmus: Path) -> None:
    """The sum is formed at communication points; what it does between them is known of neither as of the other."""
    system = System()
    system.add("g", fmus / "fmi2" / "Gain.fmu", start={"K": 1.0, "u[2]": 0.0})
    system.add("i", fmus / "fmi2" / "Integrator.fmu")
    system.drive("g.u[1]", lambda t: 1.0 * t, vectorized=True)
    system.connect("g.y[1]", "i.u")
    system.disturb("i.u", lambda t: 2.0 * t, vectorized=True)
    h = 0.1
    r = simulate(system, 1.0, h)
    assert r.info["extrapolation"] == {"mode": "auto", "linear": ["g.u[1]"], "hold": ["i.u"]}
    assert r["i.x"] == pytest.approx(1.5 * r.time * (r.time - h), abs=1e-14)
    message = r"input 'i\.u' can only be held, because a sampled signal is added to it; use 'auto'$"
    with pytest.raises(SetupError, match=message):
        Simulation(system, extrapolation="linear")


def test_an_array_is_extrapolated_whole_where_only_one_of_its_elements_is_fed(gain3c: Path, tmp_path: Path) -> None:
    """FMI 3.0 sets arrays whole: the elements that nothing feeds go along, at their start values."""
    description = DESCRIPTION.replace("<CoSimulation ", '<CoSimulation providesIntermediateUpdate="true" ').replace(
        'causality="input"', 'causality="input" intermediateUpdate="true"'
    )
    fmu = zipped(tmp_path / "gain.fmu", gain3c.with_suffix(fmpy.sharedLibraryExtension), description)
    system = System()
    system.add("c", fmu, start={"u[2]": 1.0})
    system.drive("c.u[3]", lambda t: t)
    port = Ports("c", read_fmu(fmu, "c").description)
    chosen = extrapolated_inputs(resolve(system, {"c": port}, needs_levels=True), algorithm())
    assert set(chosen.moving) == {("c", "u[3]")}
    assert [e.name for e in chosen.elements["c"]] == ["u[1]", "u[2]", "u[3]"]


@pytest.mark.parametrize("name", ["linaer", "", None])
def test_unknown_extrapolations_are_refused(fmus: Path, name: str) -> None:
    known = r"use 'auto', 'hold' \(zero-order hold\), 'linear' \(first-order hold, linear extrapolation\), 'quadratic'"
    with pytest.raises(SetupError, match=rf"^extrapolation {name!r} is unknown; {known}"):
        Simulation(ramp(fmus / "fmi2" / "Integrator.fmu"), extrapolation=name)


# Signals


@pytest.mark.parametrize("flavour", NATIVE)
def test_a_ramp_is_followed_exactly_where_linear_and_late_where_held(fmus: Path, flavour: str) -> None:
    system = ramp(fmus / flavour / "Integrator.fmu")
    for h in (0.1, 0.05):
        linear, held = (simulate(system, 2.0, h, extrapolation=c) for c in ("linear", "hold"))
        # the last step ends after the last sample; its rate is that of the step before
        assert linear["i.x"] == pytest.approx(linear.time**2 / 2, rel=1e-12, abs=1e-15)
        late = held.time**2 / 2 - held["i.x"]
        assert late == pytest.approx(held.time * h / 2, rel=1e-9, abs=1e-14)  # half a step


@pytest.mark.parametrize("flavour", NATIVE)
@pytest.mark.parametrize("every", [2, 3])
def test_a_slow_component_follows_a_ramp_exactly(fmus: Path, flavour: str, every: int) -> None:
    r = simulate(ramp(fmus / flavour / "Integrator.fmu", every), 1.2, 0.1, extrapolation="linear")
    own = r.time[::every]
    assert r["i.x"][::every] == pytest.approx(own**2 / 2, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("vectorized", [False, True])
def test_a_signal_is_never_asked_for_values_after_the_last_point(fmus: Path, vectorized: bool) -> None:
    asked: list[float] = []

    def signal(t: float | np.ndarray) -> float | np.ndarray:
        asked.extend(np.atleast_1d(t).tolist())
        return 1.0 * t

    for every in (1, 2, 3):
        system = System()
        system.add("i", fmus / "fmi2" / "Integrator.fmu", every=every)
        system.drive("i.u", signal, vectorized=vectorized)
        simulate(system, 20.0, 0.1, extrapolation="linear")
        assert sorted(set(asked)) == [0.1 * i for i in range(0, 201, every)]
        asked.clear()


# Order of convergence


def runs(system: System, stop: float, steps: Sequence[float], coupling: str) -> list[Results]:
    with Simulation(system, extrapolation=coupling) as simulation:
        return [simulation.run(stop, h) for h in steps]


def order(steps: Sequence[float], errors: Sequence[float]) -> float:
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


K = 2.0


def loop(folder: Path, *, tank: int = 1, gain: int = 1, breakpoints: tuple[float, ...] = ()) -> System:
    """A tank and a gain, x' = -K x + w from x = 1."""
    system = System()
    system.add("tank", folder / "Tank.fmu", start={"x_start": 1.0}, every=tank)
    system.add("gain", folder / "Gain.fmu", start={"K": -K, "u[2]": 0.0}, every=gain)
    system.connect("tank.x", "gain.u[1]")
    system.connect("gain.y[1]", "tank.a")
    system.drive("tank.b", np.sin, vectorized=True, breakpoints=breakpoints)
    return system


def exact(t: np.ndarray) -> np.ndarray:
    """Solution of `loop`."""
    forced = (K * np.sin(t) - np.cos(t)) / (1.0 + K * K)
    return forced + (1.0 + 1.0 / (1.0 + K * K)) * np.exp(-K * t)


def largest_error(results: Results, every: int = 1) -> float:
    return float(np.abs(results["tank.x"] - exact(results.time))[::every].max())


STEPS = [1 / 20, 1 / 40, 1 / 80, 1 / 160]


@pytest.mark.parametrize(("coupling", "expected"), [("hold", 1.0), ("linear", 2.0)])
@pytest.mark.parametrize("flavour", NATIVE)
def test_order_of_convergence_of_a_feedback_loop(fmus: Path, flavour: str, coupling: str, expected: float) -> None:
    errors = [largest_error(r) for r in runs(loop(fmus / flavour), 2.0, STEPS, coupling)]
    print(f"{flavour}, {coupling}: largest errors {errors}, order {order(STEPS, errors):.3f}")
    assert order(STEPS, errors) == pytest.approx(expected, abs=0.1)


@pytest.mark.parametrize("flavour", NATIVE)
def test_linear_coupling_of_an_integrator_and_a_gain_is_its_recurrence(fmus: Path, flavour: str) -> None:
    """x[k+1] = x[k] - h K (3 x[k] - x[k-1]) / 2: the method of Adams and Bashforth; the first step is held."""
    h, n = 0.125, 40
    x = [1.0, 1.0 - h * K]
    for k in range(1, n):
        x.append(x[k] - h * K * (3.0 * x[k] - x[k - 1]) / 2.0)
    system = System()
    system.add("i", fmus / flavour / "Integrator.fmu", start={"x_start": 1.0})
    system.add("g", fmus / flavour / "Gain.fmu", start={"K": -K, "u[2]": 0.0})
    system.connect("i.x", "g.u[1]")
    system.connect("g.y[1]", "i.u")
    found = simulate(system, n * h, h, extrapolation="linear")["i.x"]
    assert found == pytest.approx(np.array(x), rel=1e-11, abs=1e-13)


@pytest.mark.parametrize("every", [2, 3])
def test_order_of_convergence_of_a_slow_loop(fmus: Path, every: int) -> None:
    """Both components communicate at every second or third point only."""
    stop = 1.8  # a whole number of 2 and of 3 steps
    steps = [0.3 / n for n in (6, 12, 24, 48)]
    system = loop(fmus / "fmi2", tank=every, gain=every)
    for coupling, expected in (("hold", 1.0), ("linear", 2.0)):
        errors = [largest_error(r, every) for r in runs(system, stop, steps, coupling)]
        print(f"every {every}, {coupling}: largest errors {errors}, order {order(steps, errors):.3f}")
        assert order(steps, errors) == pytest.approx(expected, abs=0.15)


@pytest.mark.parametrize("every", [2, 3])
def test_a_slow_component_behind_a_fast_loop_is_of_second_order(fmus: Path, every: int) -> None:
    system = loop(fmus / "fmi2")
    system.add("i", fmus / "fmi2" / "Integrator.fmu", every=every)
    system.connect("tank.x", "i.u")

    def error(results: Results) -> float:
        t = results.time[::every]
        # x' = -K x + w, so that the integral of x is that of w less the change of x, divided by K
        expected = (1.0 - np.cos(t) - (exact(t) - 1.0)) / K
        return float(np.abs(results["i.x"][::every] - expected).max())

    steps = [0.3 / n for n in (6, 12, 24, 48)]
    for coupling, expected in (("hold", 1.0), ("linear", 2.0)):
        errors = [error(r) for r in runs(system, 1.8, steps, coupling)]
        assert order(steps, errors) == pytest.approx(expected, abs=0.15)


@pytest.mark.parametrize("every", [2, 3])
def test_a_slow_gain_in_a_fast_loop_is_held_and_of_first_order(fmus: Path, every: int) -> None:
    """What is not allowed: the tank would need the gain's output at every point."""
    system = loop(fmus / "fmi2", gain=every)
    steps = [0.3 / n for n in (6, 12, 24, 48)]
    found = runs(system, 1.8, steps, "auto")
    assert found[0].info["extrapolation"]["hold"] == ["tank.a"]
    assert found[0].info["extrapolation"]["adaptive"] == ["gain.u[1]"]
    assert found[0].info["extrapolation"]["linear"] == ["tank.b"]
    assert order(steps, [largest_error(r) for r in found]) == pytest.approx(1.0, abs=0.15)


# Jumps

JUMP = 0.5


def jumping(t: float) -> float:
    return 1.0 + t if t < JUMP else -2.0


def with_jump(folder: Path, function: Callable[[float], float], breakpoints: tuple[float, ...]) -> System:
    """The same with an inflow w that jumps."""
    system = loop(folder)
    system.signals = [Signal("tank.b", function, breakpoints)]
    return system


def exact_over_jump(t: np.ndarray) -> np.ndarray:
    """Solution of `with_jump` for `jumping`: before the jump, w = 1 + t; from then on, w = -2."""

    def before(t: np.ndarray) -> np.ndarray:
        return (1.0 + t) / K - 1.0 / K**2 + (1.0 - 1.0 / K + 1.0 / K**2) * np.exp(-K * t)

    return np.where(t < JUMP, before(t), -2.0 / K + (before(JUMP) + 2.0 / K) * np.exp(-K * (t - JUMP)))


@pytest.mark.parametrize("flavour", NATIVE)
def test_a_declared_jump_keeps_second_order_and_an_undeclared_one_loses_it(fmus: Path, flavour: str) -> None:
    steps = [1 / 8, 1 / 16, 1 / 32, 1 / 64, 1 / 128]  # all have a communication point at the jump, without rounding
    found = {}
    for breakpoints in ((JUMP,), ()):
        system = with_jump(fmus / flavour, jumping, breakpoints)
        found[breakpoints] = [
            float(np.abs(r["tank.x"] - exact_over_jump(r.time)).max()) for r in runs(system, 2.0, steps, "linear")
        ]
    print(f"{flavour}: declared {found[JUMP,]}, undeclared {found[()]}")
    assert order(steps, found[JUMP,]) == pytest.approx(2.0, abs=0.15)
    assert order(steps, found[()]) == pytest.approx(1.0, abs=0.15)
    assert found[JUMP,][-1] < found[()][-1] / 20


def test_a_declared_jump_at_a_point_that_is_rounded_keeps_second_order(fmus: Path) -> None:
    """3 * 0.1 > 0.3: the point at which the signal jumps is not the breakpoint to the last bit."""
    jump = 0.3
    assert jump != 3 * 0.1
    steps = [0.1 / n for n in (1, 2, 4, 8, 16)]

    def errors(breakpoints: tuple[float, ...]) -> list[float]:
        # the input of the integrator is t, then 5; its integral up to 0.6 s
        system = System()
        system.add("i", fmus / "fmi2" / "Integrator.fmu")
        system.drive("i.u", lambda t: t if t < jump - 1e-9 else 5.0, breakpoints=breakpoints)
        return [abs(r["i.x"][-1] - 0.045 - 1.5) for r in runs(system, 0.6, steps, "linear")]

    assert max(errors((jump,))) < 1e-12  # both parts are straight lines
    assert order(steps, errors(())) == pytest.approx(1.0, abs=0.05)


def test_a_declared_jump_just_after_a_point_by_rounding_is_at_this_point(fmus: Path) -> None:
    """3 * 0.3 < 0.9: the signal is asked at its breakpoint, where it gives what comes after the jump."""
    assert 3 * 0.3 < 0.9
    system = System()
    system.add("i", fmus / "fmi2" / "Integrator.fmu")
    system.drive("i.u", lambda t: 1.0 + t if t < 0.9 else 5.0, breakpoints=(0.9,))
    r = simulate(system, 1.8, 0.3, extrapolation="linear")
    assert r["i.u"].tolist()[2:4] == [1.6, 5.0]
    assert r["i.x"][-1] == pytest.approx(0.9 + 0.9**2 / 2 + 5.0 * 0.9, rel=1e-12)
    assert r.time[3] == 3 * 0.3


@pytest.mark.parametrize("flavour", NATIVE)
def test_a_breakpoint_between_two_points_draws_no_line_across(fmus: Path, flavour: str) -> None:
    """The step with the jump goes on as before it; the jump is seen at the next point."""
    h = 0.25
    system = System()
    system.add("i", fmus / flavour / "Integrator.fmu")
    # the slopes tell which side a rate comes from; the jump is between 0.75 and 1
    function = {"before": lambda t: 1.0 + 2.0 * t, "after": lambda t: 10.0 - 4.0 * t}
    system.drive("i.u", lambda t: function["before" if t < 0.8 else "after"](t), breakpoints=(0.8,))
    r = simulate(system, 2.0, h, extrapolation="linear")
    increments = np.diff(r["i.x"])
    middles = r.time[:-1] + h / 2
    expected = [h * function["before" if t < 1.0 else "after"](m) for t, m in zip(r.time[:-1], middles, strict=True)]
    assert increments == pytest.approx(expected, rel=1e-11)
    undeclared = System()
    undeclared.components = system.components
    undeclared.drive("i.u", system.signals[0].function)
    across = np.diff(simulate(undeclared, 2.0, h, extrapolation="linear")["i.x"])
    assert across[3] == pytest.approx(h * (function["before"](0.75) + function["after"](1.0)) / 2, rel=1e-11)
    assert np.flatnonzero(np.abs(across - increments) > 1e-9).tolist() == [3]


@pytest.mark.parametrize("flavour", NATIVE)
def test_from_a_jump_at_a_point_on_a_signal_is_followed_exactly(fmus: Path, flavour: str) -> None:
    """What comes after the jump is known beforehand; before it, the line goes on to the jump."""

    def function(t: float) -> float:
        return 1.0 + 2.0 * t if t < 1.0 else 10.0 - 4.0 * t

    h = 0.25
    system = System()
    system.add("i", fmus / flavour / "Integrator.fmu")
    system.drive("i.u", function, breakpoints=(1.0,))
    r = simulate(system, 2.0, h, extrapolation="linear")
    expected = [h * function(t + h / 2) for t in r.time[:-1]]
    assert np.diff(r["i.x"]) == pytest.approx(expected, rel=1e-11)


def test_breakpoints_outside_the_run_change_nothing(fmus: Path) -> None:
    plain = simulate(loop(fmus / "fmi2"), 2.0, 0.1, extrapolation="linear")
    for outside in (-0.5, 2.5, 1e9):
        other = simulate(loop(fmus / "fmi2", breakpoints=(outside,)), 2.0, 0.1, extrapolation="linear")
        assert other.values.tobytes() == plain.values.tobytes()


def test_breakpoints_do_not_matter_to_held_inputs(fmus: Path) -> None:
    runs = [simulate(loop(fmus / "fmi2", breakpoints=b), 2.0, 0.1, extrapolation="hold") for b in ((), (0.5, 0.77))]
    assert runs[0].values.tobytes() == runs[1].values.tobytes()


def test_after_a_jump_connections_are_held_too(fmus: Path) -> None:
    """Its output may jump through feedthrough: the rate of the step before says nothing."""
    h = 0.25
    system = System()
    system.add("g", fmus / "fmi2" / "Gain.fmu", start={"K": 1.0, "u[2]": 0.0})
    system.add("i", fmus / "fmi2" / "Integrator.fmu")
    system.drive("g.u[1]", lambda t: 8.0 if t >= 0.5 else 0.0, breakpoints=(0.5,))
    system.connect("g.y[1]", "i.u")
    x = simulate(system, 1.5, h, extrapolation="linear")["i.x"]
    assert x == pytest.approx(8.0 * np.maximum(h * np.arange(7) - 0.5, 0.0), abs=1e-12)


def test_both_versions_give_the_same_with_linear_inputs(fmus: Path) -> None:
    a, b = (simulate(loop(fmus / flavour), 2.0, 0.05, extrapolation="linear") for flavour in NATIVE)
    assert a.values == pytest.approx(b.values, rel=1e-12, abs=1e-14)
    assert not math.isclose(
        a["tank.x"][-1], simulate(loop(fmus / "fmi2"), 2.0, 0.05, extrapolation="hold")["tank.x"][-1]
    )


@pytest.mark.parametrize("flavour", NATIVE)
def test_inputs_that_are_set_one_after_the_other_are_all_linear(fmus: Path, flavour: str) -> None:
    system, h = System(), 0.1
    system.add("m", fmus / flavour / "TwoLevels.fmu")
    system.add("g", fmus / flavour / "Gain.fmu", start={"K": 2.0, "u[2]": 0.0})
    system.drive("m.a", lambda t: 1.0 * t, vectorized=True)
    system.connect("m.p", "g.u[1]")
    system.connect("g.y[1]", "m.b")
    r = simulate(system, 1.0, h)
    assert r.info["extrapolation"]["linear"] == ["g.u[1]", "m.a", "m.b"]
    # x' = 21 t, but for b = 2 t in the first step, in which nothing is known of its rate
    assert r["m.x"][1:] == pytest.approx(21.0 * r.time[1:] ** 2 / 2 - 10.0 * h**2, rel=1e-12)


def test_a_jump_of_a_held_signal_in_the_window_before_is_seen(fmus: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`_samples_of` keeps nothing behind (reach = 0) where no signal is linear.

    But a connection is, to a component with every = 2: at point 8 it must know of the jump at point 7.
    """
    system = System()
    system.add("g", fmus / "pythonfmu" / "Gain.fmu", start={"K": 1.0, "u[2]": 0.0})
    system.add("i", fmus / "fmi2" / "Integrator.fmu", every=2)
    system.drive("g.u[1]", lambda t: t if t < 7.0 else 100.0 + t, breakpoints=(7.0,))
    system.connect("g.y[1]", "i.u")
    for name in ("FIRST", "MOST"):
        monkeypatch.setattr(chunks, name, 4)
    whole = simulate(system, 20.0, 1.0)
    assert whole.info["extrapolation"]["linear"] == ["i.u"]
    monkeypatch.setattr(cosim.master.sampling, "_MOST_SAMPLES", 4)  # as 4 million are in a long run
    assert simulate(system, 20.0, 1.0)["i.x"].tolist() == whole["i.x"].tolist()


def test_a_restored_run_knows_of_the_jump_before_its_state(fmus: Path) -> None:
    """The state is that of point 8, from which `i` makes its next step of 2; the signal has jumped at point 7."""
    system = System()
    system.add("g", fmus / "fmi2" / "Gain.fmu", start={"K": 1.0, "u[2]": 0.0})
    system.add("i", fmus / "fmi2" / "Integrator.fmu", every=2)
    system.drive("g.u[1]", lambda t: t if t < 7.0 else 100.0 + t, breakpoints=(7.0,))
    system.connect("g.y[1]", "i.u")
    with Simulation(system) as simulation:
        whole = simulation.run(20.0, 1.0)
        assert whole.info["extrapolation"]["linear"] == ["g.u[1]", "i.u"]
        with simulation.start(step_size=1.0) as run:
            run.advance_to(8.0)
            state = run.save()
        with simulation.start(step_size=1.0) as run:
            run.restore(state)
            run.advance_to(20.0)
        assert run.results["i.x"].tolist() == whole["i.x"].tolist()
