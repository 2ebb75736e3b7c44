"""Structural parameters of FMI 3.0: set in the configuration mode, with sizes of arrays that follow them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim import SetupError, Simulation, System, simulate
from tests.support.fmi3_events import state_space

H = 0.125


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return state_space(tmp_path_factory.mktemp("state_space"))


def euler(a: np.ndarray, b: np.ndarray, u: np.ndarray, steps: int) -> np.ndarray:
    """States (steps + 1, n) from 0 on."""
    x = [np.zeros(len(a))]
    for _ in range(steps):
        x.append(x[-1] + H * (a @ x[-1] + b @ u))
    return np.array(x)


def test_names_and_values_follow_the_sizes(fmu):
    a, b, c = np.array([[0.0, 1.0], [-4.0, -0.5]]), np.array([[0.5], [1.0]]), np.array([[1, 2], [3, 4], [5, 6], [7, 8]])
    system = System()
    start = {"m": 1, "n": 2, "r": 4, "A": a.tolist(), "B": b.tolist(), "C": c.tolist(), "D": 0.0, "u": 3.0}
    system.add("s", fmu, start=start)
    results = simulate(system, 1.0, H, record=["s.u", "s.x", "s.y", "s.n"])
    assert results.names == ["s.u[1]", "s.x[1]", "s.x[2]", *(f"s.y[{i}]" for i in range(1, 5)), "s.n"]
    x = euler(a, b, np.array([3.0]), 8)
    np.testing.assert_allclose(results["s.x"], x, rtol=1e-15)
    np.testing.assert_allclose(results["s.y"], x @ c.T, rtol=1e-15)
    assert (results["s.n"] == 2).all()


def test_without_start_values_of_them_the_sizes_are_those_of_the_fmu(fmu):
    system = System()
    system.add("s", fmu)
    results = simulate(system, 1.0, H)
    assert results.names == [*(f"s.u[{i}]" for i in (1, 2, 3)), *(f"s.y[{i}]" for i in (1, 2, 3))]
    x = euler(np.eye(3), np.eye(3), np.arange(1.0, 4.0), 8)
    np.testing.assert_allclose(results["s.y"], x + np.arange(1.0, 4.0), rtol=1e-15)


def test_connections_have_the_sizes_and_two_components_of_one_file_their_own(fmu):
    system = System()
    system.add("small", fmu, start={"m": 2, "r": 5, "u": [3.0, 4.0]})
    system.add("large", fmu, start={"m": 5})
    system.connect("small.y", "large.u")
    results = simulate(system, 0.5, H)
    assert results["large.u"].shape[1] == 5
    assert (results["large.u"] == results["small.y"]).all()
    system.connections.clear()
    system.add("third", fmu)
    system.connect("small.y", "third.u")
    with pytest.raises(SetupError, match="5 values can't feed 3"):
        simulate(system, 0.5, H)


def test_a_matrix_of_other_sizes_is_refused_however_many_values_it_has(fmu):
    sizes = {"m": 2, "n": 3, "r": 4}
    b, flat = np.arange(6.0).reshape(3, 2), np.arange(6.0)
    expected = np.add.accumulate([H * b @ [1.0, 2.0]] * 8)
    for value in (b, b.tolist(), flat, flat.reshape(1, 6), flat.reshape(6, 1)):
        system = System()
        system.add("s", fmu, start={**sizes, "A": 0.0, "B": value, "u": [1.0, 2.0]})
        np.testing.assert_allclose(simulate(system, 1.0, H, record=["s.x"])["s.x"][1:], expected, rtol=1e-15)
    system = System()
    system.add("s", fmu, start={**sizes, "B": b.T})
    with pytest.raises(SetupError, match=r"start value of 's\.B': an array of 2 x 3 was given for one of 3 x 2$"):
        simulate(system, 1.0, H)


def test_every_run_sets_them_again(fmu):
    system = System()
    system.add("s", fmu, start={"m": 1, "n": 1, "r": 1})
    with Simulation(system) as simulation:
        first, second = simulation.run(1.0, H), simulation.run(1.0, H)
        assert (first.values == second.values).all()
        assert (simulation.run(1.0, H, start={"s.m": 1}).values == first.values).all()
        with pytest.raises(
            SetupError, match=r"'s\.m': sizes of arrays follow it, and it is 1 .* give 2 in System\.add"
        ):
            simulation.run(1.0, H, start={"s.m": 2})


def test_a_size_out_of_bounds_is_refused(fmu):
    system = System()
    system.add("s", fmu, start={"m": 6})
    with pytest.raises(SetupError, match=r"'s\.m': 6 is out of bounds; it must be between 0 and 5"):
        simulate(system, 1.0, H)


def test_an_array_without_elements_is_named(fmu):
    system = System()
    system.add("s", fmu, start={"m": 0})
    assert "s.u[1]" not in simulate(system, 1.0, H).names
    system.drive("s.u", lambda t: t)
    with pytest.raises(SetupError, match=r"'s\.u' has no elements: its size is 0"):
        simulate(system, 1.0, H)


def test_during_a_run_they_cannot_be_set(fmu):
    system = System()
    system.add("s", fmu)
    refused = pytest.raises(SetupError, match="it is a tunable structuralParameter; FMI allows")
    with Simulation(system) as simulation, simulation.start(H) as run, refused:
        run["s.n"] = 2
