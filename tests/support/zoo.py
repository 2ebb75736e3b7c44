"""A program that computes elementary functions and the robot's models, and prints a digest of all results' bits."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from fmu_export.native.c_source import c_function
from fmu_export.native.elementary import FUNCTIONS, declarations, elementary_sources
from fmu_export.native.expressions import Tables, literal
from fmu_export.native.runge_kutta import runge_kutta_source
from fmu_export.trace.operations import helpers
from fmu_export.trace.trace import TracedModel, trace
from parallel_robot.models import MODELS

N = 12

_HEAD = """#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

"""

#: FNV-1a over the bits of all results; NaN has many, of which none is better.
_DIGEST = """
static uint64_t digest(uint64_t hash, const double *y, int n) {
    for (int i = 0; i < n; i++) {
        uint64_t bits = 0x7ff8000000000000;
        if (y[i] == y[i]) memcpy(&bits, &y[i], sizeof bits);
        for (int k = 0; k < 64; k += 8) hash = (hash ^ (bits >> k & 255)) * 1099511628211u;
    }
    return hash;
}
"""


def of_elements(name: str, operation: int) -> ca.Function:
    """One operation on all elements of x (N,), and of y (N,)."""
    x, y = ca.SX.sym("x", N), ca.SX.sym("y", N)
    second = ca.SX.binary(operation, x, y) if FUNCTIONS.get(operation) in ("atan2", "hypot", "pow") else None
    return ca.Function(name, [x, y], [ca.SX.unary(operation, x) if second is None else second])


def all_functions() -> list[ca.Function]:
    """Each elementary function, by its name."""
    of_one = {name: operation for operation, name in FUNCTIONS.items()} | {"sin": ca.OP_SIN, "cos": ca.OP_COS}
    return [of_elements(f"all_{name}", operation) for name, operation in sorted(of_one.items())]


def arguments(rng: np.random.Generator) -> list[np.ndarray]:
    """Two arrays (N,) of numbers of all sizes, some of them special."""
    found = []
    for _ in range(2):
        kind = rng.integers(5)
        size = (1.0, 10.0, 1e4)[kind] if kind < 3 else 10.0 ** rng.uniform(-300.0, 300.0, N)
        values = size * rng.uniform(-1.0, 1.0, N)
        special = rng.choice([0.0, -0.0, np.inf, -np.inf, np.nan, 1.0, -1.0, 0.5, 5e-324, 1e308, 710.0], N)
        found.append(np.where(rng.random(N) < 0.08, special, values))
    return found


def program() -> dict[str, bytes]:
    """Sources of the program, by their names."""
    rng, parts, runs, written = np.random.default_rng(8), [], [], []
    tables = Tables()
    for f in all_functions():
        written.append(f)
        parts.append(c_function(f, ("x", "y_"), "zoo"))
        runs.append(_run(f, "zoo", [arguments(rng) for _ in range(40)], (False, False)))
    for name, model in MODELS.items():
        traced = trace(model)
        p = np.append(model.parameters.starts, 1e-3)
        u = rng.uniform(-0.05, 0.05, (3, len(model.inputs)))
        x0 = np.asarray(model.initial_state(p))
        for f, names in _functions(traced):
            written.append(f)
            parts.append(c_function(f, names, name, tables))
            points = []
            for k in range(3):
                known = {"t": np.array([0.5 * k]), "x": x0 + 0.01 * k, "u": u[k], "p": p, "dx": x0, "du": u[0], "dp": p}
                points.append([known[n] for n in names])
            runs.append(_run(f, name, points, tuple(n == "t" for n in names)))
        if model.states:
            parts.append(runge_kutta_source(traced.rates, name))
            runs.append(_steps(traced, name, u[0], p))
    head = declarations(written) + "".join(helper.c + "\n" for helper in helpers(written))
    main = "int main(void) {\n" + "\n".join(runs) + "\n    return 0;\n}\n"
    text = _HEAD + head + tables.source() + "\n".join(parts) + _DIGEST + main
    return {"zoo.c": text.encode(), **elementary_sources(text.encode())}


def _functions(traced: TracedModel) -> list[tuple[ca.Function, tuple[str, ...]]]:
    four = ("t", "x", "u", "p")
    return [
        (traced.initial_state, ("p",)),
        (traced.rates, four),
        (traced.everything, four),
        (traced.direction, (*four, "dx", "du", "dp")),
    ]


def _array(values: np.ndarray) -> str:
    texts = ["NAN" if np.isnan(v) else literal(float(v)) for v in values] or ["0.0"]
    return f"{{{', '.join(texts)}}}"


def _run(f: ca.Function, prefix: str, points: Sequence[Sequence[np.ndarray]], scalars: Sequence[bool]) -> str:
    """Evaluate a function at points and print what its results have for a digest."""
    lines = [
        f"    {{\n        static double y[{max(f.numel_out(0), 1)}];\n        uint64_t hash = 14695981039346656037u;"
    ]
    for number, point in enumerate(points):
        names = []
        for k, (values, scalar) in enumerate(zip(point, scalars, strict=True)):
            names.append(f"a{number}_{k}" + ("[0]" if scalar else ""))
            lines.append(f"        static double a{number}_{k}[] = {_array(values)};")
        lines.append(f"        {prefix}_{f.name()}({', '.join(names)}, y);")
        lines.append(f"        hash = digest(hash, y, {f.numel_out(0)});")
    lines.append(f'        printf("{prefix} {f.name()} %016llx\\n", (unsigned long long)hash);\n    }}')
    return "\n".join(lines)


def _steps(traced: TracedModel, prefix: str, u: np.ndarray, p: np.ndarray) -> str:
    """A second of steps of 1 ms under constant inputs."""
    n, n_rates = traced.rates.numel_in(1), traced.rates.numel_out(0)
    return f"""    {{
        static double p[] = {_array(p)}, u[] = {_array(u)}, x[{n}], next[{n}];
        static double k[{n_rates}], stages[{3 * n_rates}];
        uint64_t hash = 14695981039346656037u;
        {prefix}_initial_state(p, x);
        for (int i = 0; i < 1000; i++) {{
            {prefix}_rates(i * 1e-3, x, u, p, k);
            {prefix}_step(i * 1e-3, 1e-3, x, u, u, p, k, next, stages);
            memcpy(x, next, sizeof x);
            hash = digest(hash, x, {n});
        }}
        printf("{prefix} second %016llx\\n", (unsigned long long)hash);
    }}"""
