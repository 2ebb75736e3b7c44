"""Tracing: the expression graphs and the straight-line Python compute what the numpy functions compute."""

import ast
import math
from dataclasses import fields, replace

import casadi as ca
import numpy as np
import pytest

from controller_fmu.model import MODEL as CONTROLLER
from fmu_export.errors import TraceError
from fmu_export.modelling.functions import rk4_step
from fmu_export.modelling.model import DefaultExperiment, Model, Requirement
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.package.interface import interface_of
from fmu_export.trace.straight_line import HEADER, python_source, statements
from fmu_export.trace.trace import feedthrough, trace
from plant_fmu.kinematics import inverse_kinematics, velocity_jacobians
from plant_fmu.model import MODEL as PLANT
from tests.support import some
from trajectory_fmu.model import MODEL as TRAJECTORY

MODELS = [PLANT, CONTROLLER, TRAJECTORY]
N_POINTS = 100

#: Arguments of each traced function.
ARGUMENTS = {
    "initial_state": ("p",),
    "derivatives": ("t", "x", "u", "p"),
    "outputs": ("t", "x", "u", "p"),
    "step": ("t", "x", "u", "p", "h"),
    "start_margins": ("p",),
    "step_margins": ("t", "x", "u", "p"),
    "rates": ("t", "x", "u", "p"),
    "everything": ("t", "x", "u", "p"),
}


def margins(model, at):
    requirements = [r for r in model.requirements if r.at == at]
    return lambda t, x, u, p: np.array([r.margin(t, x, u, p) for r in requirements])


def numpy_value(model, name, point):
    """The oracle: the model's own functions called with numbers."""
    t, x, u, p, h = (point[k] for k in "txuph")

    def rates():
        return np.concatenate([model.derivatives(t, x, u, p), margins(model, "step")(t, x, u, p)])

    def step():
        """For rk43 the derivatives of the stages follow the new states."""
        stages = []

        def derivatives(*at):
            stages.append(model.derivatives(*at))
            return stages[-1]

        end = rk4_step(derivatives, t, x, u, p, h)
        return np.concatenate([end, *stages]) if model.solver == "rk43" else end

    return {
        "initial_state": lambda: model.initial_state(p),
        "derivatives": lambda: model.derivatives(t, x, u, p),
        "outputs": lambda: model.output_values(t, x, u, p),
        "step": step,
        "start_margins": lambda: margins(model, "start")(t, x, u, p),
        "step_margins": lambda: margins(model, "step")(t, x, u, p),
        "rates": rates,
        "everything": lambda: np.concatenate([model.output_values(t, x, u, p), rates()]),
    }[name]()


def random_points(model, n=N_POINTS, seed=1):
    """Points (t, x, u, p, h) with parameters near their start values; for the plant every other state is closed."""
    rng = np.random.default_rng(seed)
    points = []
    for i in range(n):
        p = model.parameters.starts * rng.uniform(0.97, 1.03, len(model.parameters))
        p += rng.uniform(0.0, 0.02, len(p)) * (model.parameters.starts == 0)
        u = rng.uniform(-1.0, 1.0, len(model.inputs))
        x = rng.uniform(-2.0, 2.0, len(model.state_layout))
        if model is PLANT:
            P = model.parameters.unpack(p)
            position = np.array([P.x_E_start, P.y_E_start]) + rng.uniform(-0.05, 0.05, 2)
            velocity = rng.uniform(-1.0, 1.0, 2)
            theta = inverse_kinematics(*position, P.l, P.x_A, P.y_A)
            J_a, J_b = velocity_jacobians(theta, P.l)
            x = np.concatenate([theta, J_a @ velocity, J_b @ velocity])
            if i % 2:
                x += rng.uniform(-0.1, 0.1, 12)
            u[-1] = rng.uniform(-0.2, 0.5)  # dm
        points.append({"t": rng.uniform(0.0, 15.0), "x": x, "u": u, "p": p, "h": 1e-3})
    return points


def agree(value, expected):
    """Equal to a few hundred ulp of the largest entry: room for another order of operations and the linear solver."""
    value, expected = np.ravel(np.asarray(value, dtype=float)), np.ravel(expected)
    scale = np.max(np.abs(expected), initial=1e-3)
    np.testing.assert_allclose(value, expected, rtol=1e-12, atol=1e-13 * scale)


@pytest.fixture(scope="module", params=MODELS, ids=lambda m: m.name)
def traced(request):
    return trace(request.param)


def test_the_comparison_can_fail():
    agree([1.0, 1e-9], [1.0, 1e-9])
    with pytest.raises(AssertionError):
        agree([1.0 + 1e-11], [1.0])
    with pytest.raises(AssertionError):
        agree([1.0, 1e-9], [1.0, 2e-9])


@pytest.mark.parametrize("name", ARGUMENTS)
def test_traced_functions_agree_with_numpy(traced, name):
    function = getattr(traced, name)
    assert function.name() == name
    for point in random_points(traced.model):
        agree(function(*(point[a] for a in ARGUMENTS[name])), numpy_value(traced.model, name, point))


@pytest.mark.parametrize("name", ARGUMENTS)
def test_straight_line_python_agrees_with_numpy(traced, name):
    source = python_source([(getattr(traced, name), ARGUMENTS[name])])
    namespace = {}
    exec(compile(source, "equations.py", "exec"), namespace)
    for point in some(random_points(traced.model)):
        # plain floats: inside an FMU there is no numpy
        arguments = [np.asarray(point[a]).tolist() for a in ARGUMENTS[name]]
        value = namespace[name](*arguments)
        assert isinstance(value, list)
        assert all(type(v) is float for v in value)
        agree(value, numpy_value(traced.model, name, point))


@pytest.mark.parametrize("name", ARGUMENTS)
def test_nested_expressions_compute_the_bits_of_single_operations(traced, name):
    """One operation a line, as they were traced, against what is written: few names, and fewer lines."""
    function = getattr(traced, name)
    lines = [f"    {target} = {text}" for target, text in statements(function, ARGUMENTS[name], repr)]
    returned = f"    return [{', '.join(f'y{i}' for i in range(function.numel_out(0)))}]"
    single = "\n".join([HEADER, f"def single({', '.join(ARGUMENTS[name])}):", *lines, returned, ""])
    nested = python_source([(function, ARGUMENTS[name])])
    namespace = {}
    exec(single, namespace)
    exec(nested, namespace)
    for point in some(random_points(traced.model)):
        arguments = [np.asarray(point[a]).tolist() for a in ARGUMENTS[name]]
        assert namespace[name](*arguments) == namespace["single"](*arguments)
    assert nested.count("\n    ") <= len(lines) + 1
    if len(lines) > 100:
        assert nested.count("\n    ") < 0.7 * len(lines)
        written = {node.id for node in ast.walk(ast.parse(nested)) if isinstance(node, ast.Name)}
        assert len(written) < 256  # beyond that Python takes longer for each


def test_straight_line_python_needs_math_only(traced):
    tree = ast.parse(python_source([(f, ARGUMENTS[f.name()]) for f in traced.functions if f.name() in ARGUMENTS]))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    assert [(type(node), getattr(node, "module", None)) for node in imports] == [(ast.ImportFrom, "math")]
    imported = {alias.name for node in imports for alias in node.names}
    called = {node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call)}
    assert called <= imported


def test_results_that_are_structurally_zero_are_zero():
    x = ca.SX.sym("x", 2)
    f = ca.Function("f", [x], [ca.densify(ca.vertcat(x[0], 0, x[1], 3.0))])
    namespace = {}
    exec(python_source([(f, ["x"])]), namespace)
    assert namespace["f"]([1.0, 2.0]) == [1.0, 0.0, 2.0, 3.0]


# Dependencies


def changed_outputs(function, arguments, which, index):
    """Outputs of `function(*arguments)` that change, by more than rounding, when one element of one argument does."""
    arguments = [np.array(a, dtype=float) for a in arguments]
    before = function(*arguments)
    arguments[which][index] += 1e-4
    return np.abs(function(*arguments) - before) > 1e-10


def numerical_dependencies(function, points, which, n_in):
    """For each output the elements of one argument that change it at any of the points."""
    n_out = len(function(*points[0]))
    depends = np.zeros((n_out, n_in), dtype=bool)
    for arguments in points:
        for index in range(n_in):
            depends[:, index] |= changed_outputs(function, arguments, which, index)
    return [np.flatnonzero(row).tolist() for row in depends]


def test_output_dependencies_are_those_that_perturbing_the_inputs_shows(traced):
    model = traced.model
    points = [[q[k] for k in "txup"] for q in random_points(model, 10, seed=2)]
    assert traced.output_dependencies() == numerical_dependencies(model.output_values, points, 2, len(model.inputs))


#: Parameters on which initial outputs of the plant depend by structure only, with the reason.
STRUCTURAL_ONLY = {
    # no torque reaches its limit of 1e60 N m
    **{f"tau_a[{i}]": {f"tau_max[{i}]"} for i in (1, 2, 3)},
    # inverse and forward kinematics cancel: the end effector is where its start position says
    "x_E": {"l", "x_A[1]", "x_A[2]", "x_A[3]", "y_A[1]", "y_A[2]", "y_A[3]", "y_E_start"},
    "y_E": {"l", "x_A[1]", "x_A[2]", "x_A[3]", "y_A[1]", "y_A[2]", "y_A[3]", "x_E_start"},
    # the chain is closed, so that everything multiplies zero
    "closure_error": {
        "l",
        "x_A[1]",
        "x_A[2]",
        "x_A[3]",
        "y_A[1]",
        "y_A[2]",
        "y_A[3]",
        "x_E_start",
        "y_E_start",
    },
    **{f"F_c[{i + 1}]": {"baumgarte"} for i in range(6)},
}


def test_initial_dependencies_are_those_that_perturbing_shows(traced):
    model = traced.model
    points = [[q["p"], q["u"], q["t"]] for q in random_points(model, 10, seed=3)]

    def initial_outputs(p, u, t):
        return model.output_values(t, model.initial_state(p), u, p)

    on_parameters, on_inputs = traced.initial_output_dependencies()
    assert on_inputs == numerical_dependencies(initial_outputs, points, 1, len(model.inputs))
    found = numerical_dependencies(initial_outputs, points, 0, len(model.parameters))
    for name, declared, numerical in zip(model.outputs.names, on_parameters, found, strict=True):
        assert set(numerical) <= set(declared), name
        more = {model.parameters.names[i] for i in set(declared) - set(numerical)}
        assert more == STRUCTURAL_ONLY.get(name, set()), name


def test_interface_counts_positions_of_all_variables(traced):
    interface, model = interface_of(traced), traced.model
    names = [v.name for v in interface.variables]
    of_solver = [*(["rtol"] if model.solver == "rk43" else []), "max_step"] if model.states else []
    assert names == [*model.parameters.names, *of_solver, *model.inputs.names, *model.outputs.names]
    assert interface.n_outputs == len(model.outputs)
    for rows, causalities in (
        (interface.dependencies, {"input"}),
        (interface.initial_dependencies, {"input", "parameter"}),
    ):
        assert len(rows) == len(model.outputs)
        for row in rows:
            assert list(row) == sorted(set(row))
            assert {interface.variables[i].causality for i in row} <= causalities
            assert not {"rtol", "max_step"} & {names[i] for i in row}


# A small model for what the robot does not show


def small_model(**changes):
    """Damped oscillator x'' = -k x - d x' + u as a model of its own."""

    def derivatives(t, x, u, p):
        return np.stack([x[1], -p[0] * x[0] - p[1] * x[1] + u[0]])

    model = Model(
        name="Oscillator",
        description="Oscillator",
        parameters=Layout([Variable("k", "1", "", start=1.0), Variable("d", "1", "", start=0.0)]),
        inputs=Layout([Variable("u", "1", "")]),
        outputs=Layout([Variable("x", "m", ""), Variable("v", "1", "")]),
        states=("x", "v"),
        initial_state=lambda p: np.stack([p[0], p[0] * 0.0]),
        derivatives=derivatives,
        output_values=lambda t, x, u, p: x,
        default_experiment=DefaultExperiment(stop_time=1.0, step_size=0.01),
    )
    return replace(model, **changes)


@pytest.mark.parametrize("traced_by", [trace, feedthrough])
def test_numpy_is_put_back(traced_by):
    """Arrays made while tracing hold symbols; afterwards, also after an error, numpy is as it was."""
    before = dict(vars(np))
    seen = []

    def outputs(t, x, u, p):
        seen.append(np.zeros is before["zeros"])
        return x

    traced_by(small_model(output_values=outputs))
    assert not seen[0]
    assert dict(vars(np)) == before

    def broken(t, x, u, p):
        raise RuntimeError("broken model")

    with pytest.raises(TraceError, match=r"test_trace.py:\d+: broken model"):
        traced_by(small_model(output_values=broken))
    assert dict(vars(np)) == before


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"derivatives": lambda t, x, u, p: x[:1]},
            "Oscillator: derivatives returns 1 values, 2 are declared",
        ),
        (
            {"output_values": lambda t, x, u, p: np.concatenate([x, x])},
            "output_values returns 4 values, 2 are declared",
        ),
        ({"initial_state": lambda p: p[:0]}, "initial_state returns 0 values, 2 are declared"),
    ],
)
def test_wrong_number_of_values_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        trace(small_model(**changes))


def test_requirements_become_margins_in_their_order():
    model = small_model(
        requirements=(
            Requirement("start", lambda t, x, u, p: p[0] - 1.0, at="start"),
            Requirement("first", lambda t, x, u, p: x[0] + t),
            Requirement("second", lambda t, x, u, p: u[0] - p[1]),
        )
    )
    traced = trace(model)
    assert float(traced.start_margins([3.0, 0.5])) == 2.0
    step_margins = traced.step_margins(2.0, [1.0, 0.0], [0.25], [3.0, 0.5])
    np.testing.assert_array_equal(step_margins.full().ravel(), [3.0, -0.25])


def test_equations_are_compared_where_their_requirements_hold():
    """Beyond them the equations may be rounding alone, and so differ: singular matrices, small differences."""

    def derivatives(t, x, u, p):
        return -3.0 * x if type(x) is np.ndarray and x[0] < 0.0 else -1.0 * x

    with pytest.raises(TraceError, match="numpy computes"):
        trace(small_model(derivatives=derivatives))
    positive = Requirement("x must be positive", lambda t, x, u, p: x[0])
    assert trace(small_model(derivatives=derivatives, requirements=(positive,))).derivatives.size1_out(0) == 2


def test_rates_and_everything_hold_the_margins_of_the_step_last():
    model = small_model(
        requirements=(
            Requirement("start", lambda t, x, u, p: p[0] - 1.0, at="start"),
            Requirement("step", lambda t, x, u, p: 7.0 * x[0] + t),
        )
    )
    traced = trace(model)
    point = 2.0, [1.0, 3.0], [0.25], [3.0, 0.5]
    # x' = v, v' = -3 - 0.5 * 3 + 0.25, margin = 7 + 2
    np.testing.assert_array_equal(traced.rates(*point).full().ravel(), [3.0, -4.25, 9.0])
    np.testing.assert_array_equal(traced.everything(*point).full().ravel(), [1.0, 3.0, 3.0, -4.25, 9.0])


def test_a_model_without_requirements_has_no_margins():
    traced = trace(small_model())
    assert [f.size_out(0) for f in (traced.start_margins, traced.step_margins)] == [(0, 1), (0, 1)]
    assert traced.rates.size_out(0) == (2, 1)


def test_a_model_is_traced_once():
    """All flavours are built from the same graphs."""
    model = small_model()
    assert trace(model) is trace(model)


def test_functions_are_all_of_the_graphs():
    traced = trace(small_model())
    names = [field.name for field in fields(traced) if field.name not in ("model", "changes", "tables")]
    assert [f.name() for f in traced.functions] == names
    assert [getattr(traced, name) for name in names] == list(traced.functions)


def crossed_model():
    """Two states, three inputs, four parameters, whose Jacobians have zeros at places that differ.

    x1' = p2 x2 + u2, x2' = t x1 u3; w = u3, y = x1 + u1 x2; x1(0) = p3 p1, x2(0) = p4.
    """
    return Model(
        name="Crossed",
        description="Crossed",
        parameters=Layout([Variable(f"p{i}", "1", "", start=float(i)) for i in (1, 2, 3, 4)]),
        inputs=Layout([Variable(f"u{i}", "1", "") for i in (1, 2, 3)]),
        outputs=Layout([Variable(n, "1", "") for n in ("w", "x2", "x1", "y")]),
        states=("x1", "x2"),
        initial_state=lambda p: np.stack([p[2] * p[0], p[3]]),
        derivatives=lambda t, x, u, p: np.stack([p[1] * x[1] + u[1], t * x[0] * u[2]]),
        output_values=lambda t, x, u, p: np.stack([u[2], x[1], x[0], x[0] + u[0] * x[1]]),
        default_experiment=DefaultExperiment(stop_time=1.0, step_size=0.01),
    )


def test_dependencies_are_those_of_the_equations():
    """Indices count from 0; at the start states stand for the parameters that they are made of."""
    model = crossed_model()
    traced = trace(model)
    assert traced.output_dependencies() == feedthrough(model) == [[2], [], [], [0]]
    assert traced.output_state_dependencies() == [[], [1], [0], [0, 1]]
    assert traced.derivative_dependencies() == ([[1], [0]], [[1], [2]], [[1, 3], [0, 2]])
    assert traced.initial_output_dependencies() == (
        [[], [3], [0, 2], [0, 2, 3]],
        [[2], [], [], [0]],
    )


def test_directions_are_the_derivatives_of_the_equations():
    """By the product rule, on paper: each seed alone is a column of the Jacobian."""
    traced = trace(crossed_model())
    t, (x1, x2), (u1, u2, u3), p = 2.0, (3.0, 5.0), (7.0, 11.0, 13.0), (17.0, 19.0, 23.0, 29.0)
    columns = {  # of w, x2, x1, y, x1', x2'
        ("dx", 0): [0.0, 0.0, 1.0, 1.0, 0.0, t * u3],
        ("dx", 1): [0.0, 1.0, 0.0, u1, p[1], 0.0],
        ("du", 0): [0.0, 0.0, 0.0, x2, 0.0, 0.0],
        ("du", 1): [0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        ("du", 2): [1.0, 0.0, 0.0, 0.0, 0.0, t * x1],
        ("dp", 0): [0.0] * 6,
        ("dp", 1): [0.0, 0.0, 0.0, 0.0, x2, 0.0],
    }
    for (name, i), expected in columns.items():
        seeds = {"dx": np.zeros(2), "du": np.zeros(3), "dp": np.zeros(4)}
        seeds[name][i] = 1.0
        found = traced.direction(t, [x1, x2], [u1, u2, u3], p, *seeds.values())
        np.testing.assert_array_equal(found.full().ravel(), expected, err_msg=f"{name}[{i}]")
    for i, expected in enumerate([[p[2], 0.0], [0.0, 0.0], [p[0], 0.0], [0.0, 1.0]]):
        found = traced.initial_state_direction(p, np.eye(4)[i])
        np.testing.assert_array_equal(found.full().ravel(), expected, err_msg=f"dp[{i}]")


def test_an_operation_without_a_template_gives_a_clear_error():
    x = ca.SX.sym("x")
    with pytest.raises(TraceError, match=r"my_function: CasADi's operation OP_ERF has no template"):
        python_source([(ca.Function("my_function", [x], [ca.erf(x)]), ["x"])])


ELEMENTARY = {
    "add": (lambda a, b: a + b, lambda a, b: a + b),
    "sub": (lambda a, b: a - b, lambda a, b: a - b),
    "mul": (lambda a, b: a * b, lambda a, b: a * b),
    "div": (lambda a, b: a / b, lambda a, b: a / b),
    "neg": (lambda a, b: -a, lambda a, b: -a),
    "inv": (lambda a, b: 1 / a, lambda a, b: 1 / a),
    "square": (lambda a, b: a**2, lambda a, b: a**2),
    "cube": (lambda a, b: a**3, lambda a, b: a**3),
    "root": (lambda a, b: ca.sqrt(a), lambda a, b: math.sqrt(a)),
    "power": (lambda a, b: a**b, lambda a, b: math.pow(a, b)),
    "constant power": (lambda a, b: a**0.3, lambda a, b: math.pow(a, 0.3)),
    "exp": (lambda a, b: ca.exp(a), lambda a, b: math.exp(a)),
    "log": (lambda a, b: ca.log(a), lambda a, b: math.log(a)),
    "sin": (lambda a, b: ca.sin(a), lambda a, b: math.sin(a)),
    "cos": (lambda a, b: ca.cos(a), lambda a, b: math.cos(a)),
    "tan": (lambda a, b: ca.tan(a), lambda a, b: math.tan(a)),
    "asin": (lambda a, b: ca.asin(a), lambda a, b: math.asin(a)),
    "acos": (lambda a, b: ca.acos(a), lambda a, b: math.acos(a)),
    "atan": (lambda a, b: ca.atan(a), lambda a, b: math.atan(a)),
    "atan2": (lambda a, b: ca.atan2(a, b), lambda a, b: math.atan2(a, b)),
    "hypot": (lambda a, b: ca.hypot(a, b), lambda a, b: math.hypot(a, b)),
    "abs": (lambda a, b: ca.fabs(a - 1), lambda a, b: abs(a - 1)),
    "tanh": (lambda a, b: ca.tanh(a), lambda a, b: math.tanh(a)),
    "twice": (lambda a, b: a + a, lambda a, b: 2 * a),
    "sinh": (lambda a, b: ca.sinh(a), lambda a, b: math.sinh(a)),
    "cosh": (lambda a, b: ca.cosh(a), lambda a, b: math.cosh(a)),
    "floor": (lambda a, b: ca.floor(3 * b), lambda a, b: math.floor(3 * b)),
    "ceil": (lambda a, b: ca.ceil(3 * b), lambda a, b: math.ceil(3 * b)),
}


@pytest.mark.parametrize("name", ELEMENTARY)
def test_each_elementary_operation_has_the_right_template(name):
    symbolic, plain = ELEMENTARY[name]
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    namespace = {}
    exec(python_source([(ca.Function("f", [a, b], [symbolic(a, b)]), ["a", "b"])]), namespace)
    for x, y in ((0.3, 0.7), (0.9, 2.5), (1e-3, -0.4)):
        assert namespace["f"]([x], [y])[0] == pytest.approx(plain(x, y), rel=1e-15)


def test_power_of_a_negative_number_is_never_complex():
    """Python's ** gives a complex number where numpy and C give NaN; that must not reach a state."""
    a = ca.SX.sym("a")
    namespace = {}
    exec(python_source([(ca.Function("f", [a], [a**0.3]), ["a"])]), namespace)
    try:
        value = namespace["f"]([-2.0])[0]
    except ValueError:
        return  # an error with a reason is as good as NaN
    assert isinstance(value, float)
    assert math.isnan(value)


@pytest.mark.parametrize("value", [0.1, 5e-324, 1e308, 123456789.123456789, math.inf, -math.inf])
def test_constants_keep_every_bit(value):
    a = ca.SX.sym("a")
    namespace = {}
    exec(python_source([(ca.Function("f", [a], [ca.vertcat(a, value)]), ["a"])]), namespace)
    result = namespace["f"]([1.0])[1]
    assert (result, math.copysign(1.0, result)) == (value, math.copysign(1.0, value))


# Runge-Kutta


def order(problem, steps=(8, 16, 32, 64, 128)):
    """Slope of log(error) over log(h) at t = 2."""
    errors = []
    for n in steps:
        derivatives, x, exact = problem
        h = 2.0 / n
        for i in range(n):
            x = rk4_step(derivatives, i * h, x, np.zeros(0), np.zeros(0), h)
        errors.append(np.max(np.abs(x - exact)))
    return np.polyfit(np.log([2.0 / n for n in steps]), np.log(errors), 1)[0]


PROBLEMS = {
    "decay": (lambda t, x, u, p: -x, np.array([1.0]), np.array([math.exp(-2.0)])),
    "oscillator": (
        lambda t, x, u, p: np.array([x[1], -x[0]]),
        np.array([1.0, 0.0]),
        np.array([math.cos(2.0), -math.sin(2.0)]),
    ),
    # x' = x cos t: shows that the stages are taken at the right times
    "time dependent": (
        lambda t, x, u, p: x * np.cos(t),
        np.array([1.0]),
        np.array([math.exp(math.sin(2.0))]),
    ),
    "logistic": (
        lambda t, x, u, p: x * (1.0 - x),
        np.array([0.1]),
        np.array([1.0 / (1.0 + 9.0 * math.exp(-2.0))]),
    ),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_runge_kutta_has_order_4(name):
    assert order(PROBLEMS[name]) == pytest.approx(4.0, abs=0.15)


def test_the_order_test_can_fail(monkeypatch):
    def euler(derivatives, t, x, u, p, h):
        return x + h * derivatives(t, x, u, p)

    monkeypatch.setitem(globals(), "rk4_step", euler)
    assert order(PROBLEMS["decay"]) == pytest.approx(1.0, abs=0.15)


def test_traced_step_of_the_oscillator_has_order_4():
    """The step an FMU runs, traced: against the closed form of x'' = -x."""
    step = trace(small_model()).step
    errors = []
    for n in (10, 20, 40):
        x = np.array([1.0, 0.0])
        for i in range(n):
            x = step(i / n, x, [0.0], [1.0, 0.0], 1.0 / n).full().ravel()
        errors.append(np.max(np.abs(x - [math.cos(1.0), -math.sin(1.0)])))
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 4.0, atol=0.15)


def test_the_first_stage_may_come_from_outside():
    """A step that is given the derivatives at its beginning is the step that computes them."""
    decay = rk4_step(lambda t, x, u, p: -x, 0.0, np.array([1.0]), np.zeros(0), np.zeros(0), 0.1)
    given = rk4_step(lambda t, x, u, p: -x, 0.0, np.array([1.0]), np.zeros(0), np.zeros(0), 0.1, k1=np.array([-1.0]))
    other = rk4_step(lambda t, x, u, p: -x, 0.0, np.array([1.0]), np.zeros(0), np.zeros(0), 0.1, k1=np.array([0.0]))
    assert decay.tolist() == given.tolist() != other.tolist()


def test_rates_depend_on_time_only_where_the_model_does():
    assert [trace(model).rates_depend_on_time for model in (PLANT, CONTROLLER)] == [False, False]
    forced = replace(PLANT, derivatives=lambda t, x, u, p: PLANT.derivatives(t, x, u, p) + t)
    assert trace(forced).rates_depend_on_time
    # an integrator asks for both at once, so a margin counts as well
    for margin, expected in ((lambda t, x, u, p: x[0] - t, True), (lambda t, x, u, p: x[0] - p[0], False)):
        assert trace(small_model(requirements=(Requirement("late", margin),))).rates_depend_on_time == expected
    late = small_model(requirements=(Requirement("start", lambda t, x, u, p: p[0] - t * 0.0, at="start"),))
    assert not trace(late).rates_depend_on_time
    # outputs are no rates
    outputs = Layout([*small_model().outputs.variables, Variable("later", "1", "")])
    clock = small_model(outputs=outputs, output_values=lambda t, x, u, p: np.stack([*x, t]))
    assert not trace(clock).rates_depend_on_time
