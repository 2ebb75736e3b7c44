"""The classical Runge-Kutta method as C: loops over the states around calls of the traced rates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fmu_export.errors import needs
from fmu_export.modelling.functions import rk4_defect, rk4_step
from fmu_export.modelling.model import Solver
from fmu_export.native.expressions import expression
from fmu_export.trace.symbols.expressions import as_written

with needs("export"):
    import casadi as ca


#: Solvers whose step this is.
RUNGE_KUTTA: tuple[Solver, ...] = ("rk4", "rk43")

#: Part of the operations of the rates that must be free of the states before all stages stand in one function.
SHARED = 0.2


def runge_kutta_source(rates: ca.Function, prefix: str = "model") -> str:
    """C source of `<prefix>_step`, which calls `<prefix>_rates` and gives those of its stages, too.

    The stages are those of `rk4_step`, which runs here for one state and one input, with derivatives that only record
    what they are asked for: operations and their order are those of a step that is traced as a whole.

    Parameters
    ----------
    rates : casadi.Function
        The derivatives as a function of (t, x, u, p); more values may follow them.
    prefix : str, optional
        What the names of the functions begin with.
    """
    n_x, n_rates = rates.numel_in(1), rates.numel_out(0)
    t, x, u, h, u_rate, k1 = (ca.SX.sym(name) for name in ("t", "x", "u", "h", "u_rate", "k1"))
    stages: list[tuple[Any, Any, Any, ca.SX]] = []

    def derivatives(time: Any, state: Any, inputs: Any, p: Any) -> ca.SX:  # noqa: ARG001
        stages.append((time, state, inputs, ca.SX.sym(f"k{len(stages) + 2}")))
        return stages[-1][-1]

    with as_written():
        end = rk4_step(derivatives, t, x, u, None, h, u_rate, k1)
    places = _PLACES | {str(k): f"{k}[i]" for *_, k in stages}
    lines = ""
    middle, *_, last = (str(inputs) for _, _, inputs, _ in stages)
    inputs_at = {middle: "u_middle", last: "u_end"}
    for time, state, inputs, k in stages:
        lines += _loop(n_x, "stage_x", state, places)
        lines += f"    {prefix}_rates({expression(time, places)}, stage_x, {inputs_at[str(inputs)]}, p, {k});\n"
    results = ", ".join(f"*{k} = stages + {i * n_rates}" for i, (*_, k) in enumerate(stages))
    return (
        (_FLATTEN if _part_without_states(rates) > SHARED else "") + f"{STEP_PROTOTYPE.format(prefix=prefix)}\n{{\n"
        f"    double stage_x[{n_x}], {results};\n" + lines + _loop(n_x, "y", end, places) + "}\n"
    )


def defect_source(rates: ca.Function) -> str:
    """C source of `model_defect`: `rk4_defect` of a step, whose stages are those that `model_step` gives.

    The function also gives the rates that it compares with.
    """
    n_x, n_rates = rates.numel_in(1), rates.numel_out(0)
    t, x, u, h, *stages = (ca.SX.sym(name) for name in ("t", "x", "u", "h", "k1", "k2", "k3", "k4"))
    asked_for: list[ca.SX] = []

    def derivatives(time: Any, state: Any, inputs: Any, p: Any) -> ca.SX:  # noqa: ARG001
        asked_for.extend((time, state))
        return ca.SX.sym("rates")

    with as_written():
        defect = rk4_defect(derivatives, t, x, u, None, h, stages)
    places = _PLACES | {name: f"{name}[i]" for name in ("k2", "k3", "k4", "rates")}
    time, state = asked_for
    results = ", ".join(f"*{k} = stages + {i * n_rates}" for i, k in enumerate(stages[1:]))
    return (
        f"{DEFECT_PROTOTYPE}\n{{\n    const double {results};\n    double early[{n_x}];\n"
        + _loop(n_x, "early", state, places)
        + f"    model_rates({expression(time, places)}, early, u_quarter, p, rates);\n"
        + _loop(n_x, "y", defect, places)
        + "}\n"
    )


def _loop(n: int, target: str, value: ca.SX, places: Mapping[str, str]) -> str:
    """C that sets the elements of a vector."""
    return f"    for (int i = 0; i < {n}; i++) {target}[i] = {expression(value, places)};\n"


#: Names in C of what both functions take.
_PLACES = {"t": "t", "h": "h", "x": "x[i]", "k1": "k1[i]"}


#: C of the inputs in the middle and at the end of a step, where they are linear, for callers of the function.
LINEAR_INPUTS = """
static void between(const double *u, const double *u_rate, double h, int n, double *middle, double *end) {
    for (int j = 0; j < n; j++) middle[j] = u[j] + h / 2.0 * u_rate[j], end[j] = u[j] + h * u_rate[j];
}
"""

#: How C declares the function. Results are nothing that is read, or what stages share would be computed again.
STEP_PROTOTYPE = (
    "void {prefix}_step(double t, double h, const double *x, const double *u_middle, const double *u_end, "
    "const double *p, const double *k1, double *restrict y, double *restrict stages)"
)

#: How C declares that of the defect.
DEFECT_PROTOTYPE = (
    "void model_defect(double t, double h, const double *x, const double *u_quarter, const double *p, "
    "const double *k1, const double *stages, double *restrict rates, double *restrict y)"
)


#: The middle stages have equal times and inputs: a compiler that sees both computes once what they share.
_FLATTEN = "#ifdef __GNUC__\n__attribute__((flatten))\n#endif\n"


def _part_without_states(f: ca.Function) -> float:
    """Part of the operations of f(t, x, u, p) that depend on time or inputs and not on states."""
    on_states, on_others = [False] * f.sz_w(), [False] * f.sz_w()
    n = free = 0
    for k in range(f.n_instructions()):
        operation, operands, targets = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if operation in (ca.OP_CONST, ca.OP_INPUT):
            argument = operands[0] if operation == ca.OP_INPUT else 3
            on_states[targets[0]], on_others[targets[0]] = argument == 1, argument in (0, 2)
        elif operation != ca.OP_OUTPUT:
            x, other = any(on_states[i] for i in operands), any(on_others[i] for i in operands)
            on_states[targets[0]], on_others[targets[0]] = x, other
            n += 1
            free += other and not x
    return free / max(n, 1)
