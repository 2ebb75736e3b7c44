"""A packed system computes what the unpacked one does, to the last bit."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from cosim import System, simulate
from cosim.master.coupling.algorithm import EXTRAPOLATIONS
from cosim.pack import pack
from cosim.scenario.signals import CsvColumn, Multisine, PulseTrain, Ramp, Shape, ShapedSignal, Step
from tests.support.packed_fmus import VERSIONS, columns, initialized, instance_of, robot, run_in_fmpy, small_loop
from tests.support.small_fmus import TANK, build, compiled

ALGORITHMS = [(order, extrapolation) for order in ("sequential", "parallel") for extrapolation in ("hold", "auto")]


@pytest.mark.slow  # small loops run always
@pytest.mark.parametrize(("order", "extrapolation"), ALGORITHMS)
@pytest.mark.parametrize("flavours", [("fmi2",) * 3, ("fmi3",) * 3, ("fmi3", "fmi2", "fmi3")], ids="-".join)
def test_the_robot(
    native_fmus: Path, tmp_path: Path, flavours: tuple[str, ...], order: str, extrapolation: str
) -> None:
    system = robot([native_fmus / flavour for flavour in flavours])
    expected = simulate(system, 0.05, 1e-3, order=order, extrapolation=extrapolation)
    for version in VERSIONS:
        packed = pack(system, tmp_path / f"W{version}.fmu", 1e-3, fmi=version, order=order, extrapolation=extrapolation)
        found = run_in_fmpy(packed.path, 0.05, 1e-3, packed.outputs)
        assert found.shape == (51, 38)
        assert np.array_equal(found, columns(expected, packed.outputs))


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize(("order", "extrapolation"), ALGORITHMS)
@pytest.mark.parametrize("flavours", [("fmi2", "fmi2"), ("fmi3", "fmi3"), ("fmi2", "fmi3")], ids="-".join)
def test_both_versions_and_different_rates(
    small_fmus: dict[str, Path], tmp_path: Path, flavours: tuple[str, str], order: str, extrapolation: str, every: int
) -> None:
    """The last step of a component with a longer one ends after the run."""
    system = small_loop(small_fmus[flavours[0]], every, small_fmus[flavours[1]])
    expected = simulate(system, 3.1, 0.1, order=order, extrapolation=extrapolation)
    packed = pack(system, tmp_path / "W.fmu", 0.1, order=order, extrapolation=extrapolation)
    assert np.array_equal(run_in_fmpy(packed.path, 3.1, 0.1, packed.outputs), columns(expected, packed.outputs))


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("flavours", [("fmi2", "fmi3"), ("fmi3", "fmi2")], ids="-".join)
def test_polynomials_of_higher_degree(
    small_fmus: dict[str, Path], tmp_path: Path, flavours: tuple[str, str], every: int
) -> None:
    system = System()
    system.add("i", small_fmus[flavours[0]] / "Integrator.fmu", start={"x_start": 1.0}, every=every)
    system.add("g", small_fmus[flavours[1]] / "Gain.fmu", start={"K": -0.3})
    system.connect("i.x", "g.u[1]", extrapolation="quadratic" if every == 1 else "hold")
    system.connect("g.y[1]", "i.u", extrapolation="cubic-least-squares")
    ramp = Ramp(0.13, 1.77, 1.1, 0.3)
    system.drive("g.u[2]", ShapedSignal(ramp, 1, "g.u[2]"), breakpoints=ramp.breakpoints, vectorized=True)
    expected = simulate(system, 3.0, 0.1)
    packed = pack(system, tmp_path / "W.fmu", 0.1)
    assert np.array_equal(run_in_fmpy(packed.path, 3.0, 0.1, packed.outputs), columns(expected, packed.outputs))


@pytest.mark.parametrize("name", ["cubic", "adaptive"])
def test_a_sampled_signal_is_sampled_inside_the_steps_too(
    small_fmus: dict[str, Path], tmp_path: Path, name: str
) -> None:
    """Where inputs follow polynomials; one that fails there goes straight, as it does in a run."""

    def on_grid(t: float) -> float:
        if abs(t / 0.1 - round(t / 0.1)) > 1e-6:
            raise ValueError("there is no value")
        return math.sin(t)

    build(tmp_path, "fmi2", TANK)
    for function in (math.sin, on_grid):
        system = System()
        system.add("tank", tmp_path / "Tank.fmu", start={"x_start": 1.0})
        system.add("g", small_fmus["fmi2"] / "Gain.fmu", start={"K": -0.3, "u[2]": 0.0})
        system.connect("tank.x", "g.u[1]")
        system.connect("g.y[1]", "tank.a")
        system.drive("tank.b", function)
        expected = simulate(system, 3.0, 0.1, extrapolation=name)
        packed = pack(system, tmp_path / "W.fmu", 0.1, extrapolation=name, stop_time=3.0)
        found, wanted = run_in_fmpy(packed.path, 3.0, 0.1, packed.outputs), columns(expected, packed.outputs)
        assert np.array_equal(found, wanted) or function is on_grid
        np.testing.assert_allclose(found, wanted, rtol=1e-12)  # polynomials through points of a line, but for rounding


@pytest.mark.parametrize("name", sorted(EXTRAPOLATIONS))
def test_a_named_polynomial_is_followed_where_only_signals_feed(tmp_path: Path, name: str) -> None:
    """Of two tanks in a row one gets nothing but signals; an input of the packed FMU stands open beside them."""
    build(tmp_path, "fmi2", TANK)
    system = System()
    system.add("first", tmp_path / "Tank.fmu", start={"x_start": 1.0})
    system.add("second", tmp_path / "Tank.fmu")
    system.drive("first.a", math.sin)
    system.connect("first.x", "second.a", factor=-0.7)
    expected = simulate(system, 2.0, 0.1, extrapolation=name)
    packed = pack(system, tmp_path / "W.fmu", 0.1, extrapolation=name, stop_time=2.0)
    assert set(packed.inputs) == {"first.b", "second.b"}
    assert np.array_equal(run_in_fmpy(packed.path, 2.0, 0.1, packed.outputs), columns(expected, packed.outputs))


@pytest.mark.parametrize("name", ["hermite", "adaptive"])
@pytest.mark.parametrize("flavours", [("fmi2", "fmi2"), ("fmi2", "fmi3")], ids="-".join)
def test_rates_of_outputs_are_exchanged(
    small_fmus: dict[str, Path], tmp_path: Path, flavours: tuple[str, str], name: str
) -> None:
    """The packed FMU has an open input of its own, on which the gain's other output depends."""
    system = small_loop(small_fmus[flavours[0]], 1, small_fmus[flavours[1]])
    expected = simulate(system, 3.0, 0.1, extrapolation=name)
    packed = pack(system, tmp_path / "W.fmu", 0.1, extrapolation=name)
    assert np.array_equal(run_in_fmpy(packed.path, 3.0, 0.1, packed.outputs), columns(expected, packed.outputs))


@pytest.mark.parametrize("version", VERSIONS)
def test_longer_communication_steps_are_split(small_fmus: dict[str, Path], tmp_path: Path, version: int) -> None:
    system = small_loop(small_fmus["fmi2"])
    expected = simulate(system, 3.0, 0.01, record_every=10)
    packed = pack(system, tmp_path / "W.fmu", 0.01, fmi=version)
    found = run_in_fmpy(packed.path, 3.0, 0.1, packed.outputs)
    assert np.array_equal(found, columns(expected, packed.outputs))
    by_parameter = pack(system, tmp_path / "V.fmu", 0.1, fmi=version)
    assert np.array_equal(run_in_fmpy(by_parameter.path, 3.0, 0.1, packed.outputs, {"max_step": 0.01}), found)


@pytest.mark.parametrize(("name", "order"), [("linear", 2), ("auto", 4)])
def test_the_coupling_keeps_its_order_at_uneven_steps(
    small_fmus: dict[str, Path], tmp_path: Path, name: str, order: int
) -> None:
    """X' = -1.3 x: the error of a linear coupling falls by four for half the steps, whatever their order.

    That of cubics falls by sixteen: each step of another length begins by a block of its own.
    """
    packed = pack(small_loop(small_fmus["fmi2"]), tmp_path / "W.fmu", 1.0, outputs=["i.x"], extrapolation=name)
    errors = []
    with instance_of(packed.path) as (instance, references):
        for n in (20, 40, 80):
            initialized(instance)
            time = 0.0
            for step in np.tile([0.7 / n, 1.3 / n], n // 2).tolist():
                instance.doStep(time, step)
                time += step
            (x,) = instance.getReal([references["i.x"]])
            errors.append(abs(x - math.exp(-1.3)))
            instance.reset()
    ratios = [a / b for a, b in pairwise(errors)]
    assert all(0.8 < ratio / 2**order < 1.25 for ratio in ratios), (errors, ratios)


@pytest.mark.parametrize("version", VERSIONS)
def test_factor_offset_and_types(tmp_path: Path, version: int) -> None:
    """Values of every type of FMI 3.0 go round between two FMUs, some of them scaled or converted."""
    compiled(tmp_path, "fmi3_types")
    compiled(tmp_path, "fmi2_probe")
    system = System()
    system.add("a", tmp_path / "types.fmu", start={"Float32": [0.5, 1.5], "Int8": [-3, 4], "Boolean": [True, False]})
    system.add("b", tmp_path / "types.fmu")
    system.add("p", tmp_path / "probe.fmu")
    for kind in ("Float32", "Int8", "Boolean", "Int64", "UInt64", "String", "words"):
        system.connect(f"a.{kind}_out", f"b.{kind}")
    system.connect("a.Int8_out[2]", "p.n")
    system.connect("a.Boolean_out[1]", "p.b")
    system.connect("a.Float32_out[2]", "p.u", factor=3.0, offset=-1.0)
    expected = simulate(system, 0.3, 0.1)
    packed = pack(system, tmp_path / "W.fmu", 0.1, fmi=version)
    names = [n for n in packed.outputs if "String" not in n and "words" not in n]
    assert {"p.u"} & set(packed.inputs) == set()
    assert len(names) > 20
    assert np.array_equal(run_in_fmpy(packed.path, 0.3, 0.1, names), columns(expected, names))


def signals(folder: Path) -> dict[str, Shape]:
    (folder / "table.csv").write_text("time,a\n0,1\n0.25,2\n0.25,-1\n0.7,3.3\n0.9,0.1\n", encoding="utf-8")
    return {
        "step": Step(0.3, 1.7, -0.2),
        "ramp": Ramp(0.13, 0.77, 1.1, 0.3),
        "pulses": PulseTrain(2.0, 0.3, 0.11, 3, 0.1, -1.0),
        "table": CsvColumn(str(folder / "table.csv"), "a"),
        "held table": CsvColumn(str(folder / "table.csv"), "a", "hold"),
        "multisine": Multisine(1.0, 0.1, 3.0, start_time=0.2),
    }


@pytest.mark.parametrize("extrapolation", ["hold", "auto"])
@pytest.mark.parametrize("added", [False, True])
@pytest.mark.parametrize("shape", ["step", "ramp", "pulses", "table", "held table", "multisine"])
def test_signals(small_fmus: dict[str, Path], tmp_path: Path, shape: str, added: bool, extrapolation: str) -> None:
    system = small_loop(small_fmus["fmi2"])
    signal = signals(tmp_path)[shape]
    feed, target = (system.disturb, "g.u[1]") if added else (system.drive, "g.u[2]")
    feed(target, ShapedSignal(signal, 1, target), breakpoints=signal.breakpoints, vectorized=True)
    expected = simulate(system, 1.0, 0.05, extrapolation=extrapolation)
    packed = pack(system, tmp_path / "W.fmu", 0.05, stop_time=1.0, extrapolation=extrapolation)
    assert any("sampled" in note for note in packed.notes) == (shape == "multisine")
    assert np.array_equal(run_in_fmpy(packed.path, 1.0, 0.05, packed.outputs), columns(expected, packed.outputs))


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("flavour", ["fmi2", "fmi3"])
def test_a_packed_system_in_a_packed_system(
    small_fmus: dict[str, Path], tmp_path: Path, flavour: str, version: int
) -> None:
    inner = pack(small_loop(small_fmus[flavour]), tmp_path / "Inner.fmu", 0.1, fmi=version)
    system = System()
    system.add("w", inner.path, start={"g.K": -0.9, "g.u[2]": 0.25})
    system.add("i", small_fmus["fmi2"] / "Integrator.fmu", start={"x_start": 0.5})
    system.connect("w.g.y[2]", "i.u")
    expected = simulate(system, 1.0, 0.1)
    outer = pack(system, tmp_path / "Outer.fmu", 0.1, fmi=version)
    assert "w.i.x" in outer.outputs
    assert np.array_equal(run_in_fmpy(outer.path, 1.0, 0.1, outer.outputs), columns(expected, outer.outputs))


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("flavour", ["fmi2", "fmi3"])
def test_inputs_from_outside_move_as_signals_do(
    small_fmus: dict[str, Path], tmp_path: Path, flavour: str, version: int
) -> None:
    """Straight lines between communication points, at the internal ones too: the master gives their slopes."""
    system = small_loop(small_fmus[flavour])
    packed = pack(system, tmp_path / "W.fmu", 0.01, fmi=version)
    assert packed.inputs == ("g.u[2]",)
    whole = System()
    whole.add("w", packed.path)
    whole.drive("w.g.u[2]", lambda t: 3.0 * t - 1.0)
    found = simulate(whole, 1.0, 0.1)
    system.drive("g.u[2]", lambda t: 3.0 * t - 1.0)
    expected = simulate(system, 1.0, 0.01, record_every=10)
    for name in ("g.y[1]", "g.y[2]", "i.x"):
        np.testing.assert_allclose(found[f"w.{name}"], expected[name], rtol=1e-12, atol=1e-12)
