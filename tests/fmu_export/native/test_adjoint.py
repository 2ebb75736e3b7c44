"""Adjoint derivatives of FMI 3.0 are the transpose of the directional ones, which others check."""

from __future__ import annotations

import zipfile
from ctypes import c_double
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
import pytest

from fmu_export.modelling.model import Model
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.native.backend import build_native
from parallel_robot.models import MODELS
from tests.support.hybrid_models import THERMOSTAT
from tests.support.native_fmus import Host, unpack

#: Structure with zeros, a parameter in the initial state, a function with a kink, a local.
SMALL = Model(
    name="Small",
    parameters=Layout([Variable("a", start=2.0), Variable("b", start=0.5), Variable("unused")]),
    inputs=Layout([Variable("u", size=2, start=(0.3, -0.7))]),
    outputs=Layout([Variable("y"), Variable("x_1")]),
    locals=Layout([Variable("x_2"), Variable("w")]),
    states=("x_1", "x_2"),
    initial_state=lambda p: np.stack([p[0] * p[1], np.sin(p[0])]),
    derivatives=lambda t, x, u, p: np.stack([x[1] * u[0], -p[1] * np.exp(x[0]) + t]),
    output_values=lambda t, x, u, p: np.stack([np.hypot(x[0], u[1]) * p[0], x[0], np.maximum(u[0], u[1]) ** 2]),
)
ALL = {"small": SMALL, "thermostat": THERMOSTAT, **MODELS}


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory, native_fmus: Path) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("adjoint")
    fmus = {name: build_native(ALL[name], root, "fmi3") for name in ("small", "thermostat")}
    fmus |= {name: native_fmus / "fmi3" / f"{model.name}.fmu" for name, model in MODELS.items()}
    return {name: unpack(fmu, root / name) for name, fmu in fmus.items()}


def jacobians(host: Host, unknowns: list[str], knowns: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """By directions, known by known, and by adjoints, unknown by unknown; both (unknowns, knowns)."""
    columns, rows = [], []
    for known in knowns:
        status, column = host.direction(unknowns, {known: 1.0})
        host.must(status)
        columns.append(column)
    for unknown in unknowns:
        status, row = host.adjoint(knowns, {unknown: 1.0})
        host.must(status)
        rows.append(row)
    return np.array(columns).T, np.array(rows)


def compare(host: Host, unknowns: list[str], knowns: list[str], rng: np.random.Generator) -> None:
    forward, backward = jacobians(host, unknowns, knowns)
    assert np.count_nonzero(forward) > 0
    scale = np.abs(forward).max(axis=1, keepdims=True) + 1e-300
    np.testing.assert_allclose(backward / scale, forward / scale, rtol=1e-10, atol=1e-12)
    weights = rng.standard_normal(len(unknowns))
    before = host.get(unknowns)
    status, combined = host.adjoint(knowns, dict(zip(unknowns, weights, strict=True)))
    host.must(status)
    expected = weights @ forward
    np.testing.assert_allclose(combined, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    assert host.get(unknowns) == before


@pytest.mark.parametrize("name", ALL)
def test_adjoint_derivatives_are_the_transpose(folders: dict[str, Path], name: str) -> None:
    model, rng = ALL[name], np.random.default_rng(5)
    states, inputs = list(model.state_layout.names), list(model.inputs.names)
    rates = [f"der({s})" for s in states]
    at = {n: 0.2 + 0.1 * rng.random() for n in inputs}
    with Host(folders[name], "ModelExchange") as host:
        host.must(host.enter(0.4))
        host.must(host.set(at))
        known = [*model.parameters.names, *inputs]
        # the loop is closed whatever the parameters are: this error is rounding, and so are its derivatives
        computed = [n for n in model.computed.names if n != "closure_error"]
        compare(host, [*computed, *rates], known, rng)  # through the initial state
        host.must(host.exit())
        host.continuous()
        if states:
            x = np.array(host.get_states(len(states)))
            host.must(host.set_states(x + 0.05 * rng.standard_normal(len(x))))
        compare(host, [*model.computed.names, *rates], [*states, *inputs, *model.parameters.names], rng)
    with Host(folders[name]) as host:
        host.run_up(at)
        host.must(host.step(0.0, 0.01))
        compare(host, list(model.outputs.names), [*states, *inputs, *model.parameters.names], rng)


def test_the_closed_form(folders: dict[str, Path]) -> None:
    with Host(folders["small"], "ModelExchange") as host:
        host.run_up()
        x_1, x_2, u_1, u_2, a, b = host.get(["x_1", "x_2", "u[1]", "u[2]", "a", "b"])
        length = np.hypot(x_1, u_2)
        knowns = ["x_1", "x_2", "u[1]", "u[2]", "a", "b", "unused", "max_step"]
        status, found = host.adjoint(knowns, {"y": 1.0, "der(x_2)": 10.0, "w": 100.0})
        host.must(status)
        expected = [
            x_1 / length * a - 10.0 * b * np.exp(x_1),
            0.0,
            100.0 * 2.0 * u_1,  # the larger of both
            u_2 / length * a,
            length,
            -10.0 * np.exp(x_1),
            0.0,
            0.0,
        ]
        assert found == pytest.approx(expected, rel=1e-14, abs=1e-14)
        # of one unknown that is given twice the weights add up
        result, unknowns = (c_double * 1)(), host.vr(["y", "y"])
        seed = (c_double * 2)(1.0, 2.0)
        host.must(host.call("GetAdjointDerivative", unknowns, 2, host.vr(["a"]), 1, seed, 2, result, 1))
        assert list(result) == [pytest.approx(3.0 * length, rel=1e-14)]
        assert host.adjoint(["a"], {})[1] == [0.0]
        assert x_2 == np.sin(a)


def test_the_description_says_so_and_fmi_2_has_none(tmp_path: Path) -> None:
    description = fmpy.read_model_description(str(build_native(SMALL, tmp_path, "fmi3")))
    assert description.coSimulation.providesAdjointDerivatives
    assert description.modelExchange.providesAdjointDerivatives
    with zipfile.ZipFile(build_native(SMALL, tmp_path, "fmi2")) as archive:
        assert not [name for name in archive.namelist() if "adjoint" in name]


def test_an_importer_takes_them(folders: dict[str, Path]) -> None:
    """CasADi's DaeBuilder, against derivatives by hand."""
    dae = ca.DaeBuilder("small", str(folders["small"]))
    assert (dae.x(), dae.u(), dae.y()) == (["x_1", "x_2"], ["u[1]", "u[2]"], ["y", "x_1"])
    adjoint = dae.create("adjoint", ["x", "u", "adj_ode", "adj_y"], ["adj_x", "adj_u"])
    (x_1, x_2), (u_1, u_2), a, b = (1.0, 0.9), (0.3, -0.7), 2.0, 0.5
    length = np.hypot(x_1, u_2)
    for of_rates, of_outputs, of_states, of_inputs in (
        ((1.0, 0.0), (0.0, 0.0), (0.0, u_1), (x_2, 0.0)),
        ((0.0, 1.0), (0.0, 0.0), (-b * np.exp(x_1), 0.0), (0.0, 0.0)),
        ((0.0, 0.0), (1.0, 10.0), (x_1 / length * a + 10.0, 0.0), (0.0, u_2 / length * a)),
    ):
        found_x, found_u = adjoint((x_1, x_2), (u_1, u_2), of_rates, of_outputs)
        np.testing.assert_allclose(found_x.full().ravel(), of_states, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(found_u.full().ravel(), of_inputs, rtol=1e-12, atol=1e-14)
