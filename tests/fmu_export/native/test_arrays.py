"""Vectors and matrices: row by row in flat arrays, scalars of an FMU by default, arrays of FMI 3.0 on request."""

from __future__ import annotations

from ctypes import c_bool, c_char_p, c_double, c_int32
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from cosim import System, simulate
from fmu_export import ArgumentError, build_native, build_pythonfmu, compose, to_control, write_start_values
from fmu_export.modelling.model import DefaultExperiment, Model
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.package.start_values import StartValueError
from fmu_export.trace.trace import trace
from tests.support.native_fmus import ERROR, OK, Host, doubles, unpack

A = np.array([[1.0, -2.0, 3.0], [0.5, 5.0, -6.0]])
PARAMETERS = Layout(
    [Variable("A", size=(2, 3), start=A), Variable("k", start=2.0), Variable("X_0", size=(2, 2), start=1.5)]
)
INPUTS = Layout([Variable("u", "m", size=3), Variable("M", size=(3, 2), start=np.arange(6.0).reshape(3, 2))])
OUTPUTS = Layout(
    [Variable("y", "m", size=2), Variable("Q", size=(2, 2)), Variable("X", size=(2, 2), description="State")]
)


def derivatives(t: Any, x: Any, u: Any, p: Any) -> Any:
    """X' = k X' + Q: transposes, so that rows and columns can't be mixed up."""
    parameters, inputs = PARAMETERS.unpack(p), INPUTS.unpack(u)
    return (-parameters.k * x.reshape(2, 2).T + parameters.A @ inputs.M).ravel()


def outputs(t: Any, x: Any, u: Any, p: Any) -> Any:
    parameters, inputs = PARAMETERS.unpack(p), INPUTS.unpack(u)
    return OUTPUTS.pack(y=parameters.A @ inputs.u, Q=parameters.A @ inputs.M, X=x.reshape(2, 2))


MATRICES = Model(
    name="Matrices",
    parameters=PARAMETERS,
    inputs=INPUTS,
    outputs=OUTPUTS,
    states=("X",),
    initial_state=lambda p: PARAMETERS.unpack(p).X_0.T.ravel(),
    derivatives=derivatives,
    output_values=outputs,
)

TEXTS = ("a b", "<c>", "d")
TYPED = Model(
    name="TypedArrays",
    parameters=Layout(
        [
            Variable("n", type="integer", size=2, start=[3, -4]),
            Variable(
                "names", type="string", items=("a b", "<c>", "d"), size=(2, 2), start=[["a b", "<c>"], ["d", "d"]]
            ),
        ]
    ),
    inputs=Layout([Variable("on", type="boolean", size=3, start=[True, False, True])]),
    outputs=Layout(
        [
            Variable("twice", type="integer", size=2),
            Variable("off", type="boolean", size=3),
            Variable("names_seen", type="string", items=TEXTS, size=(2, 2)),
        ]
    ),
    output_values=lambda t, x, u, p: np.concatenate([2.0 * p[:2], 1.0 - u, p[2:6]]),
)


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_native(MATRICES, tmp_path_factory.mktemp("arrays"), "fmi3", arrays=True, page="# Matrices\n")


@pytest.fixture(scope="module")
def folder(fmu: Path) -> Path:
    return unpack(fmu, fmu.parent / "unpacked")


def test_layouts_reshape_and_pack_row_by_row() -> None:
    assert PARAMETERS.names[:7] == ("A[1,1]", "A[1,2]", "A[1,3]", "A[2,1]", "A[2,2]", "A[2,3]", "k")
    flat = np.arange(float(len(PARAMETERS)))
    parts = PARAMETERS.unpack(flat)
    np.testing.assert_array_equal(parts.A, [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_array_equal(PARAMETERS.pack(**vars(parts)), flat)
    np.testing.assert_array_equal(PARAMETERS.starts, [*A.ravel(), 2.0, 1.5, 1.5, 1.5, 1.5])
    with pytest.raises(ArgumentError, match=r"'A' has the shape \(3, 2\); \(2, 3\) is declared"):
        PARAMETERS.pack(**(vars(parts) | {"A": parts.A.T}))


@pytest.mark.parametrize(
    ("size", "start", "said"),
    [
        ((2, 3), np.ones((3, 2)), "variable 'A' has 2 x 3 elements but 3 x 2 start values"),
        ((2, 3), [[1.0, 2.0], [3.0]], "variable 'A': the rows of the start value have different lengths"),
        ((2, 3), [1.0] * 5, "variable 'A' has 2 x 3 elements but 5 start values"),
        ((2, 0), 1.0, r"variable 'A': size is (2, 0); give the number of elements or the shape"),
        ((), 1.0, r"variable 'A': size is (); give the number"),
        ((2.0, 3), 1.0, r"variable 'A': size is (2.0, 3); give the number"),
    ],
)
def test_shapes_that_do_not_fit(size: Any, start: Any, said: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        Variable("A", size=size, start=start)
    assert str(caught.value).startswith(said)


def expected_outputs(u: np.ndarray, M: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.concatenate([A @ u, (A @ M).ravel(), x])


@pytest.mark.parametrize("flavour", ["pythonfmu", "fmi2", "fmi3"])
def test_elements_are_scalars_by_default(tmp_path: Path, flavour: str) -> None:
    build = build_pythonfmu if flavour == "pythonfmu" else lambda m, f: build_native(m, f, flavour)  # type: ignore[arg-type]
    fmu = build(MATRICES, tmp_path)
    assert validate_fmu(str(fmu)) == []
    result = fmpy.simulate_fmu(
        str(fmu),
        stop_time=0.02,
        step_size=0.01,
        output_interval=0.01,
        start_values={"u[2]": 3.0, "M[3,1]": -1.0},
        output=list(OUTPUTS.names),
        fmi_type="CoSimulation",
    )
    M = np.array([[0.0, 1.0], [2.0, 3.0], [-1.0, 5.0]])
    first = [result[name][0] for name in OUTPUTS.names]
    assert first == pytest.approx(expected_outputs(np.array([0.0, 3.0, 0.0]), M, np.full(4, 1.5)), rel=1e-15)


def test_a_trace_is_what_numpy_computes() -> None:
    rng = np.random.default_rng(1)
    x, u, p = (rng.standard_normal(n) for n in (4, len(INPUTS), len(PARAMETERS)))
    traced = trace(MATRICES)
    np.testing.assert_allclose(traced.outputs(0.0, x, u, p).full().ravel(), outputs(0.0, x, u, p), rtol=1e-14)
    np.testing.assert_allclose(traced.derivatives(0.0, x, u, p).full().ravel(), derivatives(0.0, x, u, p), rtol=1e-14)


def test_composed_models_and_control_systems_have_matrices() -> None:
    whole = compose("Whole", "", {"a": MATRICES, "b": MATRICES}, [], DefaultExperiment(1.0, 0.1))
    assert whole.outputs.variables[1].names == ("a.Q[1,1]", "a.Q[1,2]", "a.Q[2,1]", "a.Q[2,2]")
    assert to_control(MATRICES).noutputs == len(OUTPUTS)


# Arrays of FMI 3.0


def test_arrays_in_the_description(fmu: Path) -> None:
    assert validate_fmu(str(fmu)) == []
    description = fmpy.read_model_description(str(fmu))
    found = {v.name: v for v in description.modelVariables}
    assert {n: tuple(int(d.start) for d in v.dimensions) for n, v in found.items()} == {
        "A": (2, 3),
        "k": (),
        "X_0": (2, 2),
        "max_step": (),
        "u": (3,),
        "M": (3, 2),
        "y": (2,),
        "Q": (2, 2),
        "X": (2, 2),
        "der(X)": (2, 2),
        "time": (),
    }
    assert found["A"].start == " ".join(map(repr, A.ravel().tolist()))
    assert found["X"].description == "State"
    assert [u.variable.name for u in description.outputs] == ["y", "Q", "X"]
    of_output = {u.variable.name: {v.name for v in u.dependencies} for u in description.outputs}
    assert of_output == {"y": {"A", "u"}, "Q": {"A", "M"}, "X": {"X"}}
    assert [u.variable.name for u in description.derivatives] == ["der(X)"]
    assert {v.name for v in description.derivatives[0].dependencies} == {"X", "M", "A", "k"}
    assert found["der(X)"].derivative is found["X"]


def test_values_of_arrays(folder: Path) -> None:
    with Host(folder) as host:
        values = doubles([7.0, 1.0, 2.0, 3.0])
        host.must(host.call("SetFloat64", host.vr(["k", "u"]), 2, values, 4))
        host.run_up()
        buffer = (c_double * 17)()
        host.must(host.call("GetFloat64", host.vr(["y", "A", "k", "Q", "X"]), 5, buffer, 17))
        M = INPUTS.starts[3:].reshape(3, 2)
        u = np.array([1.0, 2.0, 3.0])
        assert list(buffer) == pytest.approx([*A @ u, *A.ravel(), 7.0, *(A @ M).ravel(), *[1.5] * 4])
        host.must(host.step(0.0, 0.01))
        for references, n_values, said in (
            (["y"], 1, "1 values for 2 elements of variables"),
            ([1], 1, "no variable has the value reference 1"),  # within A
            ([999], 1, "no variable has the value reference 999"),
        ):
            assert host.call("GetFloat64", host.vr(references), 1, buffer, n_values) == ERROR
            assert said in host.messages[-1]


def test_derivatives_of_arrays(folder: Path) -> None:
    rng = np.random.default_rng(3)
    with Host(folder, "ModelExchange") as host:
        host.run_up().continuous()
        x = rng.standard_normal(4)
        host.must(host.set_states(x))
        status, found = host.try_derivatives(4)
        p, u = PARAMETERS.starts, INPUTS.starts
        np.testing.assert_allclose(found, derivatives(0.0, x, u, p), rtol=1e-14)
        unknowns, knowns, n, m = host.vr(["y", "der(X)"]), host.vr(["M", "X"]), 6, 10
        forward = np.empty((n, m))
        for j in range(m):
            column = (c_double * n)()
            seed = doubles(np.eye(m)[j])
            host.must(host.call("GetDirectionalDerivative", unknowns, 2, knowns, 2, seed, m, column, n))
            forward[:, j] = column
        backward = np.empty((n, m))
        for i in range(n):
            row = (c_double * m)()
            host.must(host.call("GetAdjointDerivative", unknowns, 2, knowns, 2, doubles(np.eye(n)[i]), n, row, m))
            backward[i] = row
        # d(A M)/dM and d(-k X^T)/dX, row by row
        expected = np.zeros((n, m))
        expected[2:, :6] = np.kron(A, np.eye(2))
        for row, column in ((0, 0), (1, 2), (2, 1), (3, 3)):
            expected[2 + row, 6 + column] = -2.0
        np.testing.assert_allclose(forward, expected, atol=1e-15)
        np.testing.assert_allclose(backward, expected, atol=1e-15)
        assert status == OK


def test_importers_run_arrays(fmu: Path) -> None:
    for kind in ("CoSimulation", "ModelExchange"):
        result = fmpy.simulate_fmu(
            str(fmu), stop_time=0.1, start_values={"u": [1.0, 2.0, 3.0]}, output=["y", "Q", "X"], fmi_type=kind
        )
        np.testing.assert_allclose(result["y"][-1], A @ [1.0, 2.0, 3.0])
        np.testing.assert_allclose(result["Q"][-1], A @ INPUTS.starts[3:].reshape(3, 2))
    system = System()
    system.add("a", fmu, start={"u": [1.0, 2.0, 3.0]})
    system.add("b", fmu)
    system.connect("a.y[2]", "b.u[1]")
    system.connect("a.Q[2,1]", "b.M[3,2]")
    results = simulate(system, 0.2, 0.1)
    assert results["b.y[2]"][0] == pytest.approx(A[1, 0] * (A[1] @ [1.0, 2.0, 3.0]))
    M = INPUTS.starts[3:].reshape(3, 2).copy()
    Q = A @ M
    M[2, 1] = Q[1, 0]
    assert results["b.Q[1,2]"][0] == pytest.approx((A @ M)[0, 1])


def test_start_values_of_elements(fmu: Path, tmp_path: Path) -> None:
    copy = tmp_path / "Matrices.fmu"
    copy.write_bytes(fmu.read_bytes())
    write_start_values(copy, {"A[2,1]": 0.25, "k": 3.0})
    assert validate_fmu(str(copy)) == []
    found = {v.name: v.start for v in fmpy.read_model_description(str(copy)).modelVariables}
    changed = A.copy()
    changed[1, 0] = 0.25
    assert found["A"] == " ".join(map(repr, changed.ravel().tolist()))
    assert found["k"] == "3.0"
    with Host(unpack(copy, tmp_path / "unpacked")) as host:
        buffer = (c_double * 6)()
        host.must(host.call("GetFloat64", host.vr(["A"]), 1, buffer, 6))
        assert list(buffer) == changed.ravel().tolist()
    with pytest.raises(StartValueError, match=r"no parameter 'A'; its parameters are A\[1,1\]"):
        write_start_values(copy, {"A": 1.0})


def test_arrays_of_other_types(tmp_path: Path) -> None:
    fmu = build_native(TYPED, tmp_path, "fmi3", arrays=True)
    assert validate_fmu(str(fmu)) == []
    write_start_values(fmu, {"names[2,1]": "<c>", "n[2]": 7})
    assert validate_fmu(str(fmu)) == []
    with Host(unpack(fmu, tmp_path / "unpacked")) as host:
        host.must(host.call("SetBoolean", host.vr(["on"]), 1, (c_bool * 3)(False, False, True), 3))
        host.run_up()
        whole, flags, texts = (c_int32 * 4)(), (c_bool * 3)(), (c_char_p * 4)()
        host.must(host.call("GetInt32", host.vr(["twice", "n"]), 2, whole, 4))
        host.must(host.call("GetBoolean", host.vr(["off"]), 1, flags, 3))
        host.must(host.call("GetString", host.vr(["names_seen"]), 1, texts, 4))
        assert list(whole) == [6, 14, 3, 7]
        assert list(flags) == [True, True, False]
        assert list(texts) == [b"a b", b"<c>", b"<c>", b"d"]


def test_fmi_2_has_no_arrays(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=r"Matrices: FMI 2\.0 has no arrays; build the fmi3 flavour"):
        build_native(MATRICES, tmp_path, "fmi2", arrays=True)
