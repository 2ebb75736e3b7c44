"""The step of the classical Runge-Kutta method as C: loops over the states around calls of the traced rates."""

from __future__ import annotations

from typing import Any

from fmu_export.errors import needs
from fmu_export.modelling.functions import rk4_step
from fmu_export.modelling.model import Solver
from fmu_export.trace.operations import template
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
    places = {"t": "t", "h": "h", "x": "x[i]", "k1": "k1[i]"}
    places |= {str(k): f"{k}[i]" for *_, k in stages}

    def loop(n: int, target: str, value: ca.SX) -> str:
        return f"    for (int i = 0; i < {n}; i++) {target}[i] = {_expression(value, places)};\n"

    lines = ""
    middle, *_, last = (str(inputs) for _, _, inputs, _ in stages)
    inputs_at = {middle: "u_middle", last: "u_end"}
    for time, state, inputs, k in stages:
        lines += loop(n_x, "stage_x", state)
        lines += f"    {prefix}_rates({_expression(time, places)}, stage_x, {inputs_at[str(inputs)]}, p, {k});\n"
    results = ", ".join(f"*{k} = stages + {i * n_rates}" for i, (*_, k) in enumerate(stages))
    return (
        (_FLATTEN if _part_without_states(rates) > SHARED else "") + f"{STEP_PROTOTYPE.format(prefix=prefix)}\n{{\n"
        f"    double stage_x[{n_x}], {results};\n" + lines + loop(n_x, "y", end) + "}\n"
    )


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


def _expression(value: ca.SX, places: dict[str, str]) -> str:
    """One scalar expression as C, with names in place of its symbols."""
    symbols = ca.symvar(value)
    f = ca.Function("runge_kutta", symbols, [value])
    work: dict[int, str] = {}
    written = ""
    for k in range(f.n_instructions()):
        operation, operands, targets = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if operation == ca.OP_CONST:
            work[targets[0]] = repr(f.instruction_constant(k))
        elif operation == ca.OP_INPUT:
            work[targets[0]] = places[str(symbols[operands[0]])]
        elif operation == ca.OP_OUTPUT:
            written = work[operands[0]]
        else:
            work[targets[0]] = f"({template(operation, f.name()).format(*(work[i] for i in operands))})"
    return written
