"""Repeats of traced equations become loops, with the results of straight-line code to the last bit."""

from __future__ import annotations

import ctypes
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from fmu_export.native.c_source import c_function
from fmu_export.native.elementary import declarations, elementary_sources
from fmu_export.native.expressions import Tables
from fmu_export.native.loops import LoopWriter
from fmu_export.native.toolchain import compile_library, host_target
from fmu_export.trace.graph import Graph
from fmu_export.trace.operations import helpers
from fmu_export.trace.symbols.expressions import as_written
from fmu_export.trace.trace import trace
from parallel_robot.models import closed_loop_model

EXPORT = '#ifdef _WIN32\n__declspec(dllexport)\n#else\n__attribute__((visibility("default")))\n#endif\n'


def heat(n: int) -> ca.Function:
    x, p = ca.SX.sym("x", n), ca.SX.sym("p", 2)
    padded = ca.vertcat(p[0], x, 0.0)
    return ca.Function("heat", [x, p], [p[1] * (padded[2:] - 2.0 * x + padded[:-2])])


def plate(n: int) -> ca.Function:
    """A grid in two directions, with a border that is held."""
    x, p = ca.SX.sym("x", n * n), ca.SX.sym("p", 2)
    T = ca.reshape(x, n, n)
    padded = ca.SX.zeros(n + 2, n + 2)
    padded[:, 0] = p[0]
    padded[1:-1, 1:-1] = T
    change = padded[2:, 1:-1] + padded[:-2, 1:-1] + padded[1:-1, 2:] + padded[1:-1, :-2] - 4.0 * T
    return ca.Function("plate", [x, p], [ca.vec(p[1] * change)])


def network(n: int) -> ca.Function:
    rng = np.random.default_rng(1)
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    hidden = ca.tanh(rng.normal(size=(n, 3)) @ x + rng.normal(size=n))
    hidden = ca.exp(-((rng.normal(size=(n, n)) @ hidden) ** 2))
    return ca.Function("network", [x, p], [p[0] * (rng.normal(size=(5, n)) @ hidden)])


def bodies(n: int) -> ca.Function:
    """Each attracts each: sums over all but one."""
    x, p = ca.SX.sym("x", 2 * n), ca.SX.sym("p", n)
    forces = []
    for i in range(n):
        total = ca.SX(0.0)
        for j in range(n):
            if j != i:
                gap, other = x[j] - x[i], x[n + j] - x[n + i]
                total = total + p[j] * gap / (gap**2 + other**2 + 0.1)
        forces.append(total)
    return ca.Function("bodies", [x, p], [ca.vertcat(*forces)])


def sparse(n: int) -> ca.Function:
    """Nothing lies at equal distances."""
    rng = np.random.default_rng(2)
    x, p = ca.SX.sym("x", n), ca.SX.sym("p", 2)
    rows = [sum(float(rng.normal()) * x[int(i)] for i in rng.integers(n, size=12)) for _ in range(n)]
    return ca.Function("sparse", [x, p], [ca.vertcat(*rows)])


def sums(n: int) -> ca.Function:
    """Long sums and differences, of terms of several shapes, used once and more often."""
    x, p = ca.SX.sym("x", n), ca.SX.sym("p", 2)
    first = x[0]
    for i in range(1, n):
        first = first - x[i] * p[0] if i % 3 else first + x[i]
    second = p[1]
    for i in range(n):
        second = x[n - 1 - i] * x[i] + second
    third = x[1]
    for i in range(n):  # terms that are sums themselves
        third = third - (x[i] + p[i % 2]) if i % 2 else third + (x[i] - first)
    for i in range(n):
        third = third + first / (x[i] + 3.0)
    return ca.Function("sums", [x, p], [ca.vertcat(first, second, third, first * second, second, 0.0)])


def constants(n: int) -> ca.Function:
    """Tables of constants: zeros of both signs, infinity, numbers of all sizes."""
    x, p = ca.SX.sym("x", n), ca.SX.sym("p", 2)
    numbers = [0.0, -0.0, float("inf"), 1e300, -1e-300, 1.0 / 3.0, 5e-324]
    values = [x[i] + numbers[i % len(numbers)] for i in range(n)] + [ca.SX(numbers[i % 6]) for i in range(n)]
    return ca.Function("constants", [x, p], [ca.vertcat(*values)])


def extremes(n: int) -> ca.Function:
    """The largest and the smallest of many, their product, whether one is above a limit, and how these change."""
    x, p = ca.SX.sym("x", n), ca.SX.sym("p", 2)
    largest, smallest, product, above = x[0], x[0] * p[0], x[0], x[0] > 0.9
    for i in range(1, n):
        largest, smallest = ca.fmax(largest, x[i]), ca.fmin(x[i] * p[0], smallest)
        product, above = product * (x[i] + 1.5), ca.logic_or(above, x[i] > 0.9)
    values = ca.vertcat(largest, smallest, product, above, largest - smallest)
    change = ca.cse(ca.jtimes(values, x, p[1] * ca.sin(x)))
    return ca.Function("extremes", [x, p], [ca.densify(ca.vertcat(values, change))])


def recurrences(n: int) -> ca.Function:
    """Each value from the one before: sums so far, a filter of second order."""
    x, p = ca.SX.sym("x", n), ca.SX.sym("p", 2)
    so_far, filtered = [x[0]], [x[0], x[1]]
    for i in range(1, n):
        so_far.append(so_far[-1] + x[i])
        filtered.append(0.5 * filtered[-1] - 0.1 * filtered[-2] + x[i] * p[0])
    last = ca.sqrt(so_far[-1] ** 2 + 1.0)
    return ca.Function("recurrences", [x, p], [ca.vertcat(*so_far, *filtered, last)])


def coupled(n: int) -> ca.Function:
    """Two recurrences that wait for each other, and a third for both."""
    x, p = ca.SX.sym("x", n), ca.SX.sym("p", 2)
    first, second, third = [x[0]], [x[1]], [p[0]]
    for i in range(1, n):
        first.append(ca.tanh(first[-1] + second[-1]))
        second.append(second[-1] * first[-1] + x[i])
        third.append(0.5 * third[-1] + first[-1] * second[-1])
    return ca.Function("coupled", [x, p], [ca.vertcat(*first, *second, *third)])


ZOO = [heat, plate, network, bodies, sparse, sums, constants, extremes, recurrences, coupled]
NAMES = ("x", "p")


def statements_in_c(f: ca.Function, names: tuple[str, ...]) -> str:
    """The function as straight-line code, and with loops whether these are shorter or not."""
    tables = Tables()
    body = LoopWriter(Graph(f), names, tables).write()
    straight = c_function(f, names, "straight")
    prototype = straight.partition("\n")[0].replace("straight_", "loops_")
    return f"{tables.source()}{EXPORT}{straight}{EXPORT}{prototype}\n{{\n" + "\n".join(body) + "\n}\n"


def random_points(f: ca.Function) -> list[list[np.ndarray]]:
    rng = np.random.default_rng(3)
    return [[rng.uniform(-1.0, 1.0, f.numel_in(k)) for k in range(f.n_in())] for _ in range(10)]


def compare(f: ca.Function, names: tuple[str, ...], points: list[list[np.ndarray]], folder: Path) -> None:
    head = "#include <math.h>\n" + declarations([f]) + "".join(h.c + "\n" for h in helpers([f]))
    source = (head + statements_in_c(f, names)).encode()
    sources = {"both.c": source, **elementary_sources(source)}
    path = folder / f"both{host_target().suffix}"
    path.write_bytes(compile_library(sources, "both"))
    library = ctypes.CDLL(str(path))
    for arguments in points:
        found = []
        for kind in ("straight", "loops"):
            y = np.full(f.numel_out(0), np.nan)
            passed = [
                ctypes.c_double(a[0]) if name == "t" else a.ctypes.data_as(ctypes.c_void_p)
                for name, a in zip(names, arguments, strict=True)
            ]
            getattr(library, f"{kind}_{f.name()}")(*passed, y.ctypes.data_as(ctypes.c_void_p))
            found.append(y)
        assert found[0].tobytes() == found[1].tobytes()
        np.testing.assert_allclose(found[0], f(*arguments).full().ravel(), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("make", ZOO, ids=lambda make: make.__name__)
@pytest.mark.parametrize("n", [9, 14])
def test_loops_compute_what_straight_line_code_computes(make, n: int, tmp_path: Path) -> None:
    with as_written():
        f = make(n)
    compare(f, NAMES, random_points(f), tmp_path)


#: Two arrays (n,) and random numbers to a third.
OPERATIONS = [
    lambda a, b, rng: a * b,
    lambda a, b, rng: a - 0.5 * b,
    lambda a, b, rng: ca.vertcat(a[1:], b[0]),
    lambda a, b, rng: ca.sin(a) + b,
    lambda a, b, rng: a / (2.0 + b**2),
    lambda a, b, rng: rng.normal(size=(a.numel(), a.numel())).round(1) @ a / a.numel(),
    lambda a, b, rng: ca.sum1(a) - b,
    lambda a, b, rng: ca.vertcat(*(a[int(i)] for i in rng.integers(a.numel(), size=a.numel()))),
]


@pytest.mark.parametrize("seed", range(6))
def test_random_equations(seed: int, tmp_path: Path) -> None:
    """Graphs of which nobody chose the shape."""
    rng = np.random.default_rng(seed)
    x, p = ca.SX.sym("x", int(rng.integers(8, 20))), ca.SX.sym("p", 3)
    arrays = [x, x[::-1], p[0] * x + p[1]]
    for _ in range(12):
        a, b = (arrays[int(i)] for i in rng.integers(len(arrays), size=2))
        arrays.append(OPERATIONS[int(rng.integers(len(OPERATIONS)))](a, b, rng))
    f = ca.Function("random", [x, p], [ca.cse(ca.vertcat(*arrays[-3:]))])
    compare(f, NAMES, random_points(f), tmp_path)


@pytest.mark.parametrize("name", ["rates", "everything", "direction"])
@pytest.mark.slow
def test_the_robot_with_loops(name: str, tmp_path: Path) -> None:
    """It has none, since they would not be much shorter; but they would be right."""
    model = closed_loop_model()
    f = getattr(trace(model), name)
    p, rng = model.parameters.starts, np.random.default_rng(4)
    points = []
    for _ in range(10):
        x = model.initial_state(p) + rng.uniform(-0.01, 0.01, len(model.state_layout))
        seeds = [rng.uniform(-1.0, 1.0, n) for n in (len(x), len(model.inputs), len(p))]
        points.append([np.array([0.3]), x, np.array(model.inputs.starts), p, *seeds][: f.n_in()])
    compare(f, ("t", "x", "u", "p", "dx", "du", "dp")[: f.n_in()], points, tmp_path)


@pytest.mark.parametrize(
    "make",
    [heat, pytest.param(plate, marks=pytest.mark.slow), network, extremes, recurrences],
    ids=lambda make: make.__name__,
)
def test_the_length_of_the_source_does_not_grow_with_the_model(make) -> None:
    lengths = []
    for n in (50, 100):
        tables = Tables()
        source = c_function(make(n), NAMES, tables=tables)
        assert "for (" in source
        lengths.append(len(source))
    assert lengths[1] < 1.1 * lengths[0] + 50


def test_where_nothing_repeats_there_are_no_loops() -> None:
    tables = Tables()
    assert "for (" not in c_function(sparse(14), NAMES, tables=tables)
    assert tables.source() == ""


def test_equal_tables_stand_once() -> None:
    tables = Tables()
    first, again = (c_function(network(12), NAMES, tables=tables) for _ in range(2))
    assert first == again
    assert tables.source().count("static const double") == len(set(tables.source().splitlines()))


def test_loops_are_tried_where_few_shapes_repeat() -> None:
    x = ca.SX.sym("x", 40)
    terms = [ca.sin(x[0])]
    for i in range(1, 40):  # each operation after another one
        terms.append(
            (terms[-1] * x[i], terms[-1] / x[i], terms[-1] + ca.exp(x[i]), ca.sqrt(terms[-1]))[(i * i) % 11 % 4]
        )
    different = ca.Function("different", [x], [terms[-1]])
    assert not LoopWriter(Graph(different), ("x",), Tables()).repeats
    copies = ca.Function("copies", [x], [ca.vertcat(x, ca.SX(0.0), ca.DM([1.0] * 40))])
    for f in (copies, heat(12), network(12), sums(12)):
        assert LoopWriter(Graph(f), NAMES, Tables()).repeats
