"""Adjoint derivatives as C: CasADi's reverse mode through outputs, derivatives and initial states."""

from __future__ import annotations

from functools import cache

from fmu_export.errors import needs
from fmu_export.native.c_source import HEADER, c_function
from fmu_export.native.elementary import declarations
from fmu_export.native.expressions import Tables
from fmu_export.trace.operations import helpers
from fmu_export.trace.trace import TracedModel

with needs("export"):
    import casadi as ca


@cache
def adjoint_source(traced: TracedModel) -> bytes:
    """`model_adjoint.c` of a model: `model_adjoint` and `model_initial_state_adjoint`.

    The first gives what the weighted sum of outputs, locals and state derivatives changes by with each state, input and
    parameter; the second the same of the initial states with each parameter.
    """
    known = traced.outputs.sx_in()
    computed = ca.vertcat(traced.outputs(*known), traced.derivatives(*known))
    p = traced.initial_state.sx_in(0)
    functions = [
        (_adjoint("adjoint", computed, known, known[1:4]), ("t", "x", "u", "p", *["z"][: len(known) - 4], "dy")),
        (_adjoint("initial_state_adjoint", traced.initial_state(p), [p], [p]), ("p", "dy")),
    ]
    tables = Tables()
    parts = [c_function(f, names, tables=tables) for f, names in functions]
    head = HEADER + '#include <math.h>\n#include "model.h"\n' + '#include "table.h"\n' * bool(traced.tables) + "\n"
    prototypes = "".join(f"{part.partition(chr(10))[0]};\n" for part in parts) + "\n"
    traced_functions = [f for f, _ in functions]
    before = declarations(traced_functions) + "".join(helper.c + "\n" for helper in helpers(traced_functions))
    before += tables.source()
    return (head + prototypes + before + "\n".join(parts)).encode()


def _adjoint(name: str, values: ca.SX, arguments: list[ca.SX], knowns: list[ca.SX]) -> ca.Function:
    weights = ca.SX.sym("dy", values.numel())
    sums = ca.jtimes(values, ca.vertcat(*knowns), weights, True)
    sums = sums + ca.SX(sum(k.numel() for k in knowns), 1)  # structural zeros are numbers too
    return ca.Function(name, [*arguments, weights], [ca.densify(ca.cse(sums))])
