"""FMI 3.0 FMUs (arrays, integers, booleans) alone and together with FMI 2.0 FMUs, by a small FMU in C."""

from __future__ import annotations

import itertools
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from cosim import SetupError, Simulation, SimulationError, System, simulate
from cosim.system.variables import ElementArray
from tests.support import some
from tests.support.fmi3_gain import DESCRIPTION, HELD, build_gain, zipped
from tests.support.tiny_models import GAIN, GAIN3, build


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("tiny"), GAIN, GAIN3)


def start(*fed: str, **others: object) -> dict:
    """Start values that hold all inputs but those that a test feeds."""
    return {**{k: v for k, v in HELD.items() if k not in fed}, **others}


def ramp(t: float) -> list[float]:
    return [t, -2.0 * t, 1.0]


def test_the_fmu_is_valid(gain3c):
    assert validate_fmu(str(gain3c)) == []


def test_vectors_pass_between_both_versions_in_both_directions(gain3c, tiny):
    system = System()
    system.add("last", tiny / "Gain3.fmu", start={"K": 0.5})
    system.add("c", gain3c, start=start("u", K=-4.0))
    system.add("d", gain3c, start=start("u"))
    system.add("first", tiny / "Gain3.fmu", start={"K": 8.0})
    system.connect("c.y", "d.u")  # FMI 3 to 3
    system.connect("d.y", "last.u")  # FMI 3 to 2
    system.connect("first.y", "c.u")  # FMI 2 to 3
    system.drive("first.u", ramp)
    r = simulate(system, 1.0, 0.125)
    u = np.array([ramp(t) for t in r.time])
    for name, factor in (("first.y", 8), ("c.u", 8), ("c.y", -32), ("d.u", -32), ("d.y", -64), ("last.y", -32)):
        assert (r[name] == factor * u).all(), name


def test_elements_pass_between_both_versions(gain3c, tiny):
    system = System()
    system.add("g", tiny / "Gain.fmu", start={"K": 1.0})
    system.add("c", gain3c, start=start(u=[3.0, 5.0, 7.0]))
    system.connect("c.y[3]", "g.u[1]")
    system.connect("g.y[1]", "c.u[2]")  # no loop: but in the standard's eyes y depends on all of u
    system.connect("c.y[1]", "g.u[2]")
    with pytest.raises(SetupError, match=r"algebraic loop .*c\.y.*parallel"):
        simulate(system, 1.0, 0.5)
    r = simulate(system, 2.0, 0.5, order="parallel")
    assert (r["c.u"][-1] == [3.0, 14.0, 7.0]).all()
    assert (r["c.y"][-1] == [6.0, 28.0, 14.0]).all()


def test_closed_loop_across_versions_is_the_exact_recurrence(gain3c, tiny):
    h, K = 0.1, -1.5
    system = System()
    system.add("c", gain3c, start=start("v", x=1.0))  # an output with initial="exact" has a start value to set
    system.add("g", tiny / "Gain.fmu", start={"K": K, "u[2]": 0.0})
    system.connect("c.x", "g.u[1]")
    system.connect("g.y[1]", "c.v")
    r = simulate(system, 2.0, h)
    x = 1.0
    for measured, fed_back in some(zip(r["c.x"], r["g.y[1]"], strict=True)):
        assert measured == x
        assert fed_back == K * x
        x += h * (K * x)


def test_one_driven_element_leaves_the_others_at_their_start_values(gain3c):
    system = System()
    system.add("c", gain3c, start=start(u=[3.0, 5.0, 7.0]))
    system.drive("c.u[2]", lambda t: t)
    r = simulate(system, 1.0, 0.5)
    assert r["c.u"].tolist() == [[3.0, t, 7.0] for t in (0.0, 0.5, 1.0)]
    assert r["c.y"].tolist() == [[6.0, 2 * t, 14.0] for t in (0.0, 0.5, 1.0)]


def test_start_value_of_one_element_leaves_the_others_as_the_fmu_declares_them(gain3c):
    # no value may be read from an FMU before its initialisation mode (FMI 3.0, state Instantiated)
    system = System()
    system.add("c", gain3c, start={**start("u"), "u[3]": -7.0, "u[1]": 3.0})
    system.drive("c.u[2]", lambda t: t)
    r = simulate(system, 1.0, 0.5)
    assert r["c.u"].tolist() == [[3.0, t, -7.0] for t in (0.0, 0.5, 1.0)]


def test_integers_and_booleans_pass_exactly(gain3c):
    wanted = [0, 1, -1, 2**31 - 1, -(2**31), 7]
    system = System()
    for name in ("a", "b"):
        system.add(name, gain3c, start=start("n", "b", "f"))
    system.drive("a.n", lambda t: wanted[round(t)])
    system.drive("a.b", lambda t: round(t) % 2 == 1)
    system.drive("a.f", lambda t: t / 10)
    for variable in "nbf":
        system.connect(f"a.{variable}_out", f"b.{variable}")
    r = simulate(system, 5.0, 1.0)
    assert r["b.n_out"].tolist() == wanted
    assert r["b.b_out"].tolist() == [0, 1, 0, 1, 0, 1]
    assert r["b.f_out"].tolist() == [float(np.float32(t / 10)) for t in range(6)]  # FMI Float32 rounds, once
    assert r["b.f_out"].tolist() != [t / 10 for t in range(6)]


@pytest.mark.parametrize(
    ("source", "target", "message"),
    [
        ("a.x", "b.n", "real and integer"),
        ("a.x", "b.b", "real and boolean"),
        ("a.y", "b.v", "3 values can't feed 1"),
        ("a.x", "b.u", "1 values can't feed 3"),
        ("a.y", "b.journal", "'b.journal' is a parameter"),
        ("a.time", "b.v", "'a.time' is an independent"),
    ],
)
def test_types_and_sizes_that_do_not_match_are_refused(gain3c, source, target, message):
    system = System()
    for name in ("a", "b"):
        system.add(name, gain3c, start=HELD)
    system.connect(source, target)
    with pytest.raises(SetupError, match=message):
        simulate(system, 1.0, 0.5)


def test_float32_and_float64_may_be_connected(gain3c):
    system = System()
    system.add("a", gain3c, start=start("v", "f"))
    system.add("b", gain3c, start=start("f", "v"))
    system.drive("a.v", lambda t: 0.1)
    system.drive("a.f", lambda t: 0.1)
    system.connect("a.x", "b.f")
    system.connect("a.f_out", "b.v")
    r = simulate(system, 0.3, 0.1)
    assert (r["b.f_out"] == r["a.x"].astype(np.float32)).all()
    assert (r["b.v"] == float(np.float32(0.1))).all()


@pytest.mark.parametrize(
    ("name", "value"), [("n", 0.5), ("n", 2**31), ("n", -(2**31) - 1), ("b", 2), ("b", 0.5), ("failure", 4)]
)
def test_start_values_outside_a_type_or_its_bounds_are_refused(gain3c, name, value):
    system = System()
    system.add("c", gain3c, start={**HELD, name: value})
    with pytest.raises(SetupError, match=rf"'c\.{name}'"):
        simulate(system, 1.0, 0.5)


@pytest.mark.parametrize(("name", "value"), [("n", 0.5), ("n", 2.0**31), ("b", 2)])
def test_signal_values_outside_a_type_are_refused(gain3c, name, value):
    system = System()
    system.add("c", gain3c, start=start(name))
    system.drive(f"c.{name}", lambda t: value)
    with pytest.raises(SetupError, match=rf"signal that feeds 'c\.{name}'"):
        simulate(system, 1.0, 0.5)
    system.signals.clear()
    system.drive(f"c.{name}", lambda t: value if t == 0.5 else 0)
    with pytest.raises(SimulationError, match=rf"c failed at t = 0\.5 s: the signal that feeds 'c\.{name}'"):
        simulate(system, 1.0, 0.5)


def test_independent_variable_and_local_elements_can_be_recorded(gain3c):
    system = System()
    system.add("c", gain3c, start=HELD)
    r = simulate(system, 3.0, 0.5, start_time=1.0, record=["c.time", "c.y[2]", "c.K", "c.failure"])
    assert r.names == ["c.time", "c.y[2]", "c.K", "c.failure"]
    assert (r["c.time"] == r.time).all()
    assert (r["c.y[2]"] == 20.0).all()
    assert (r["c.K"] == 2.0).all()


@pytest.mark.parametrize(
    ("failure", "message"),
    [
        (0, "c failed at t = 0.5 s: fmi3DoStep returned error: the gain is 100% worn out"),
        (
            2,  # which returns early, whatever is left of the step
            "c failed at t = 0.5 s: fmi3DoStep did not finish the step of 0.25 s from t = 0.5 s on, "
            "nor steps of 4.66e-10 s; try another communication step",
        ),
    ],
)
def test_a_step_that_fails_ends_the_run_with_name_time_and_log(gain3c, failure, message):
    system = System()
    system.add("other", gain3c, start=HELD)
    system.add("c", gain3c, start=start("u", fail_at=0.5, failure=failure))
    system.drive("c.u", ramp)
    with pytest.raises(SimulationError) as failed:
        simulate(system, 1.0, 0.25)
    error = failed.value
    assert str(error) == message
    assert (error.component, error.time) == ("c", 0.5)
    assert error.log == ("the gain is 100% worn out" if failure == 0 else "")
    assert error.results.time.tolist() == [0.0, 0.25, 0.5]
    assert error.results["c.y"].tolist() == [[2.0 * v for v in ramp(t)] for t in (0.0, 0.25, 0.5)]


def test_an_fmu_that_terminates_the_simulation_ends_it_well(gain3c):
    system = System()
    system.add("c", gain3c, start=start("u", fail_at=0.5, failure=1))
    system.drive("c.u", ramp)
    results = simulate(system, 1.0, 0.25)
    assert results.info["ended_by"] == {"component": "c", "time": 0.625}  # between two communication points
    assert results.info["status"] == "completed"
    assert results.time.tolist() == [0.0, 0.25, 0.5]
    assert results["c.y"].tolist() == [[2.0 * v for v in ramp(t)] for t in results.time]


def test_an_initialisation_that_fails_has_no_results(gain3c):
    system = System()
    system.add("c", gain3c, start=start(failure=3))
    message = r"c failed at t = 2 s: fmi3ExitInitializationMode returned error: the start is 100% wrong"
    with pytest.raises(SimulationError, match=message) as failed:
        simulate(system, 3.0, 0.25, start_time=2.0)
    assert failed.value.results is None


@pytest.fixture(scope="module")
def aliased(gain3c: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The FMU with aliases: v2 and u2 of inputs, y2 and x2 of outputs."""
    folder = tmp_path_factory.mktemp("aliased")
    description = DESCRIPTION
    for name in ("u", "y"):
        begin, dimension, _ = description.partition(f'name="{name}"')[2].partition('<Dimension start="3"/>')
        whole = f'name="{name}"{begin}{dimension}'
        description = description.replace(whole, f'{whole}<Alias name="{name}2"/>')
    for name in ("v", "x"):
        begin = description.partition(f'name="{name}"')[2].partition("/>")[0]
        whole = f'name="{name}"{begin}/>'
        description = description.replace(whole, f'{whole[:-2]}><Alias name="{name}2"/></Float64>')
    with zipfile.ZipFile(gain3c) as archive:
        library = Path(archive.extract(next(n for n in archive.namelist() if "binaries" in n), folder))
    return zipped(folder / "aliased.fmu", library, description)


def test_an_alias_is_fed_and_read_as_its_variable(aliased):
    names = ["u", "u2", "y", "y2", "v", "v2", "x", "x2"]
    results = []
    for u, v, y in (("u", "v", "y"), ("u2", "v2", "y2")):
        system = System()
        system.add("c", aliased, start=start("u", "v"))
        system.add("d", aliased, start=start("u"))
        system.drive(f"c.{u}", ramp)
        system.drive(f"c.{v}", np.sin)
        system.connect(f"c.{y}", f"d.{u}")
        results.append(simulate(system, 1.0, 0.125, record=[f"{c}.{n}" for c in "cd" for n in names]))
        assert results[-1].info["inputs_kept"] == []
    by_name, by_alias = results
    assert (by_alias.values == by_name.values).all()
    for name in names[::2]:
        assert (by_name[f"c.{name}2"] == by_name[f"c.{name}"]).all()
    assert (by_alias["d.y2"] == 4.0 * np.array([ramp(t) for t in by_alias.time])).all()


def test_an_alias_of_what_is_fed_is_not_fed_again(aliased):
    system = System()
    system.add("c", aliased, start=start("u"))
    system.drive("c.u", ramp)
    system.drive("c.u2[2]", lambda t: t)
    with pytest.raises(SetupError, match=r"input 'c\.u\[2\]' is fed twice"):
        simulate(system, 1.0, 0.125)
    del system.signals[1]
    with Simulation(system) as simulation, simulation.start(0.125) as run:
        run["c.v2"] = 2.0
        run.step(2)
        assert run["c.v"] == run["c.v2"] == 2.0
        assert run["c.x2"] == run["c.x"] == 0.5
        with pytest.raises(SetupError, match=r"'c\.u2' can't be set during a run: a connection or a signal feeds it"):
            run["c.u2"] = [1.0, 2.0, 3.0]


def test_an_fmu_that_refuses_to_be_instantiated_is_named_with_its_log(gain3c, tmp_path):
    with zipfile.ZipFile(gain3c) as archive:
        library = Path(archive.extract(next(n for n in archive.namelist() if "binaries" in n), tmp_path))
    other = zipped(tmp_path / "other.fmu", library, DESCRIPTION.replace("{fmi3-gain}", "{other}"))
    system = System()
    system.add("c", other, start=HELD)
    with pytest.raises(SetupError, match=r"component 'c': .*other\.fmu .*the instantiation token is wrong"):
        simulate(system, 1.0, 0.25)


def test_instances_are_terminated_and_freed_once(gain3c, tmp_path):
    # FMI 3.0, 2.2.4: fmi3Terminate tells the FMU that the run is over, for example to close its files
    system = System()
    system.add("c", gain3c, start=start(journal=str(tmp_path / "journal")))
    simulate(system, 1.0, 0.25)
    assert (tmp_path / "journal").read_text().split() == ["initialize", "terminate", "free"]


def test_instances_are_freed_when_another_fails(gain3c, tmp_path):
    system = System()
    for name, fail_at in (("a", 1e9), ("b", 0.5), ("c", 1e9)):
        system.add(name, gain3c, start=start(fail_at=fail_at, journal=str(tmp_path / name)))
    with pytest.raises(SimulationError, match="b failed"):
        simulate(system, 1.0, 0.25)
    for name in "abc":
        calls = (tmp_path / name).read_text().split()
        assert calls[0] == "initialize"
        assert calls[-1] == "free"
        assert calls.count("free") == 1


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_runs_are_repeated_bit_for_bit_whatever_the_order_of_components(gain3c, tiny, order):
    runs = []
    for names in itertools.permutations(("c", "g", "d")):
        system = System()
        for name in names:
            own = {"K": 0.3, "u[2]": 0.0} if name == "g" else start("v" if name == "d" else "f", "u")
            if name != "g":
                own["u"] = HELD["u"]
            system.add(name, tiny / "Gain.fmu" if name == "g" else gain3c, start=own)
        system.drive("c.f", lambda t: t)
        system.connect("c.y[2]", "g.u[1]")
        system.connect("g.y[1]", "d.v")
        runs.append(simulate(system, 1.0, 0.1, order=order))
    for run in some(runs[1:]):
        for name in some(runs[0].names):
            assert (run[name] == runs[0][name]).all(), name


# Start values of large arrays


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The FMU with 20,000 elements in u and y."""
    n = 20_000
    arrays = DESCRIPTION.replace('<Dimension start="3"/>', f'<Dimension start="{n}"/>').replace("1 10 100", "1")
    return build_gain(tmp_path_factory.mktemp("large"), f"LENGTH={n}", description=arrays)


def last_row(fmu: Path, run: dict | None = None, own: dict | None = None, **held: object) -> list[float]:
    """Three elements of y at the end, with start values of the run and of the system."""
    system = System()
    system.add("c", fmu, start={**start("u"), **(own or {}), **held})
    with Simulation(system, record=["c.y[1]", "c.y[7]", "c.y[20000]"]) as simulation:
        return simulation.run(0.5, 0.25, start=run).values[-1].tolist()


def test_start_values_of_a_large_array_are_numbers_in_any_shape_or_one_for_all(large):
    values = np.arange(20_000.0)
    assert last_row(large, u=values) == [0.0, 12.0, 39998.0]
    assert last_row(large, u=values.reshape(200, 100).tolist()) == [0.0, 12.0, 39998.0]
    assert last_row(large, u=4) == [8.0, 8.0, 8.0]
    assert last_row(large, {"c.u": values}, u=4) == [0.0, 12.0, 39998.0]


def test_start_values_of_a_large_array_need_no_object_for_each_element(large, monkeypatch):
    made, new = [], ElementArray._new
    monkeypatch.setattr(ElementArray, "_new", lambda array, k: made.append(k) or new(array, k))
    system = System()
    system.add("c", large, start=start("u", u=np.arange(20_000.0)))
    with Simulation(system, record=["c.x"]) as simulation:
        for own in (None, {"c.u": 3.0}):
            assert simulation.run(0.5, 0.25, start=own).info["inputs_kept"] == []
    assert len(made) < 100


def test_single_elements_of_a_large_array_go_before_the_whole_of_the_same_place(large):
    values = np.arange(20_000.0)
    assert last_row(large, own={"u": values, "u[7]": -1.0}) == [0.0, -2.0, 39998.0]
    # a run replaces the whole array, and with it the element of the system
    assert last_row(large, {"c.u": 1.0}, own={"u[7]": -1.0}) == [2.0, 2.0, 2.0]
    assert last_row(large, {"c.u[7]": 5.0}, u=values) == [0.0, 10.0, 39998.0]


@pytest.mark.parametrize(
    ("value", "why"),
    [
        (np.full(20_000, np.nan), "nan is not a finite number"),
        (np.full(20_000, np.inf), "inf is not a finite number"),
        ([1.0, 2.0], "2 values were given for 20000"),
        ([[1.0], [2.0, 3.0]], "a value of it is not a number, or its rows differ in size"),
        ("many", "a value of it is not a number"),
        (True, "a value of it is not a number"),
    ],
)
def test_start_values_of_a_large_array_that_are_none(large, value, why):
    with pytest.raises(SetupError, match=rf"start value of 'c\.u': {why}"):
        last_row(large, u=value)


def test_a_start_value_of_a_large_array_that_is_fed_has_no_effect(large):
    system = System()
    system.add("c", large, start=start("u"))
    system.drive("c.u[7]", lambda t: t)
    with (
        Simulation(system, record=["c.v"]) as simulation,
        pytest.raises(SetupError, match=r"start value of 'c\.u' would have no effect"),
    ):
        simulation.run(0.5, 0.25, start={"c.u": 1.0})
