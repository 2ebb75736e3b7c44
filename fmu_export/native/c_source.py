"""Write a traced model as C99: `model.c` with its equations, `model.h` with its sizes, names and limits."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

from fmu_export.errors import needs
from fmu_export.modelling.internal_steps import MOST_INTERNAL_STEPS
from fmu_export.native import type_tables
from fmu_export.native.elementary import declarations, elementary_sources
from fmu_export.native.expressions import SCALARS, Tables, c_string, literal
from fmu_export.native.hybrid_source import hybrid_calls, hybrid_prototypes, hybrid_sizes, hybrid_tables
from fmu_export.native.implicit import ImplicitParts, implicit_parts
from fmu_export.native.loops import LoopWriter
from fmu_export.native.runge_kutta import (
    DEFECT_PROTOTYPE,
    RUNGE_KUTTA,
    STEP_PROTOTYPE,
    defect_source,
    runge_kutta_source,
)
from fmu_export.native.straight_c import straight_statements
from fmu_export.package.interface import Interface
from fmu_export.trace.graph import Graph
from fmu_export.trace.operations import helpers
from fmu_export.trace.trace import TracedModel

with needs("export"):
    import casadi as ca

#: The traced functions that the adapter calls, with their arguments.
_ARGUMENTS = {
    "initial_state": ("p",),
    "start_margins": ("p",),
    "rates": ("t", "x", "u", "p"),
    "everything": ("t", "x", "u", "p"),
    "initial_state_direction": ("p", "dp"),
    "direction": ("t", "x", "u", "p", "dx", "du", "dp"),
    "output_rates": ("t", "x", "u", "p", "x_rate"),
    "jacobian": ("t", "x", "u", "p"),
    "rates_direction": ("t", "x", "u", "p", "dx"),
    "time_derivative": ("t", "x", "u", "p", "u_rate"),
}

#: An FMU exports the functions of the standard only, whoever compiles it.
_HIDE = "\n#if defined(__GNUC__) && !defined(_WIN32)\n#pragma GCC visibility push(hidden)\n#endif\n"
_SHOW = "\n#if defined(__GNUC__) && !defined(_WIN32)\n#pragma GCC visibility pop\n#endif\n"

#: Marks functions that no step calls: gcc and clang do not spend their time on them.
_SELDOM = """#if defined(__GNUC__)
#define SELDOM __attribute__((cold))
#else
#define SELDOM
#endif

"""
_CALLED_SELDOM = {"initial_state", "start_margins", "initial_state_direction", "direction"}

#: Functions with fewer characters stay as they are; others get loops where these save so much, where a table of
#: constants counts for a part of its length, since a compiler takes little time for it.
_SHORT = 1000
_SHORTER = 0.6
_TABLE = 0.25

#: Products and sums are rounded one by one, with whatever options the sources are compiled; gcc does so by -std=c99.
_APART = """#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(_MSC_VER)
#pragma fp_contract(off)
#endif

"""

#: How each generated file begins.
HEADER = "/* Generated from the model by tracing; do not edit. */\n"


def model_sources(
    traced: TracedModel, interface: Interface, guid: str, more: Mapping[str, bytes] | None = None
) -> dict[str, bytes]:
    """`model.h`, `model.c` and the elementary functions of a model.

    Parameters
    ----------
    traced, interface : TracedModel, Interface
        The model's expression graphs and its flat variables.
    guid : str
        Fingerprint that the importer has to give back.
    more : mapping of str to bytes, optional
        Further C files with equations of the model, by name.
    """
    equations = _equations(traced)
    head = HEADER + '#include <math.h>\n#include "model.h"\n' + '#include "table.h"\n' * bool(traced.tables) + "\n"
    tables = _tables(traced, interface) + type_tables.definitions(interface) + _solver_tables(equations.implicit)
    tables += _hybrid_tables(traced) + _lookup_tables(traced)
    sources = {"model.c": (head + tables + equations.source).encode(), **(more or {})}
    header = _header(traced, interface, guid, equations).encode()
    return {"model.h": header, **sources, **elementary_sources(*sources.values())}


@dataclass(frozen=True)
class _Equations:
    """The traced functions that the adapter calls, what an implicit method needs besides, and all of them as C."""

    functions: list[ca.Function]
    implicit: ImplicitParts | None
    source: str


@cache  # once for all flavours
def _equations(traced: TracedModel) -> _Equations:
    arguments = _arguments(traced)
    functions = [f for f in traced.functions if f.name() in arguments]
    solver = traced.model.solver
    implicit = implicit_parts(traced) if solver == "rodas4" else None
    if implicit:
        functions += [implicit.jacobian, implicit.time_derivative]
    tables = Tables()
    parts = [c_function(f, arguments[f.name()], tables=tables) for f in functions]
    if traced.model.states and solver in RUNGE_KUTTA:
        parts.append(runge_kutta_source(traced.rates))
        if solver == "rk43":
            parts.append(defect_source(traced.rates))
    parts += hybrid_calls(traced)
    before = declarations(functions) + "".join(helper.c + "\n" for helper in helpers(functions)) + tables.source()
    return _Equations(functions, implicit, "\n".join([before, *parts] if before else parts))


def _arguments(traced: TracedModel) -> dict[str, tuple[str, ...]]:
    """The traced functions that the adapter calls, with their arguments; discrete states z follow the parameters."""
    found = _ARGUMENTS | {f.name(): ("p",) if f.n_in() == 1 else ("t", "x", "u", "p") for f in traced.changes}
    if not len(traced.model.discrete):
        return found
    behind = ("t", "x", "u", "p")
    return {name: (*behind, "z", *names[4:]) if names[:4] == behind else names for name, names in found.items()}


def _header(traced: TracedModel, interface: Interface, guid: str, equations: _Equations) -> str:
    start, step = (sum(r.at == at for r in traced.model.requirements) for at in ("start", "step"))
    sizes = {
        "N_P": interface.n_parameters,
        "N_U": interface.n_inputs,
        "N_Y": interface.n_computed,
        "N_OUTPUTS": interface.n_outputs,
        "N_X": len(interface.states),
        "MOST_INTERNAL_STEPS": MOST_INTERNAL_STEPS,
        "ARRAYS": int(interface.arrays),
        "N_TYPED": type_tables.number_of_typed(interface),
        "N_START_REQUIREMENTS": start,
        "N_STEP_REQUIREMENTS": step,
        "RATES_DEPEND_ON_TIME": int(traced.rates_depend_on_time),
        **_solver_sizes(traced, equations.implicit),
        **hybrid_sizes(traced),
        **({"N_TABLES": len(traced.tables)} if traced.tables else {}),
    }
    arguments, solver = _arguments(traced), traced.model.solver
    return (
        HEADER
        + "#ifndef MODEL_H\n#define MODEL_H\n\n"
        + _APART
        + _SELDOM
        + f'#define MODEL_IDENTIFIER "{traced.model.name}"\n'
        + f"#define MODEL_GUID {c_string(guid)}\n\n"
        + "".join(f"#define {name} {size}\n" for name, size in sizes.items())
        + _HIDE
        + "\n/* Arrays of length zero are no C: every table has one element more than it needs. */\n"
        + "extern const char *const model_names[N_P + N_U + N_Y + N_X + 1];\n"
        + "extern const double model_limits[N_P + 1][2];\n"
        + "extern const int model_tunable[N_P + 1]; /* whether a parameter may change between two steps */\n"
        + "extern const int model_state_outputs[N_X + 1]; /* output or local of each state */\n"
        + "extern const int model_output_states[N_Y + 1]; /* state of each output or local, -1 where it is none */\n"
        + "extern const double model_nominals[N_X + 1]; /* of the states */\n"
        + "extern const int model_state_parameters[N_X + 1]; /* that is each state at the start, -1 if none is */\n"
        + "extern const double model_guesses[N_X + 1]; /* of the states at the start, in the model description */\n"
        + "extern const char *const model_start_requirements[N_START_REQUIREMENTS + 1];\n"
        + "extern const char *const model_step_requirements[N_STEP_REQUIREMENTS + 1];\n"
        + "extern const int model_of_integration[N_STEP_REQUIREMENTS + 1]; /* requirements for co-simulation only */\n"
        + type_tables.declarations(interface)
        + "".join(f"extern const {table};\n" for table in _solver_table_values(equations.implicit))
        + "".join(f"extern const {table};\n" for table in hybrid_tables(traced, c_string))
        + _LOOKUP_TABLES * bool(traced.tables)
        + "\n"
        + "".join(
            f"{'SELDOM ' * (f.name() in _CALLED_SELDOM)}{_prototype(f, arguments[f.name()])};\n"
            for f in equations.functions
        )
        + hybrid_prototypes(traced)
        + (f"{STEP_PROTOTYPE.format(prefix='model')};\n" if interface.states and solver in RUNGE_KUTTA else "")
        + (f"{DEFECT_PROTOTYPE};\n" if interface.states and solver == "rk43" else "")
        + _SHOW
        + "\n#endif\n"
    )


def _tables(traced: TracedModel, interface: Interface) -> str:
    names = [v.name for v in interface.variables] + [d.name for d in interface.derivatives]
    parameters = interface.variables[: interface.n_parameters]
    limits = "".join(
        f"{{{literal(-math.inf if v.min is None else v.min)}, {literal(math.inf if v.max is None else v.max)}}}, "
        for v in parameters
    )
    tunable = "".join(f"{int(v.variability == 'tunable')}, " for v in parameters)
    first_output = interface.n_parameters + interface.n_inputs
    states = ", ".join(str(s - first_output) for s in (*interface.states, first_output))
    nominals = "".join(f"{literal(nominal)}, " for nominal in interface.nominals)
    guesses = "".join(f"{literal(d.state_start)}, " for d in interface.derivatives)
    starts = "".join(f"{-1 if k is None else k}, " for k in traced.start_parameters())
    state_of = {output: i for i, output in enumerate(interface.states)}
    state_of_outputs = ", ".join(str(state_of.get(first_output + i, -1)) for i in range(interface.n_computed + 1))

    def messages(at: str) -> str:
        return ", ".join(c_string(r.message) for r in traced.model.requirements if r.at == at) or "0"

    of_step = [r for r in traced.model.requirements if r.at == "step"]
    of_integration = ", ".join(str(int(r.of_integration)) for r in of_step) or "0"
    return (
        f"const char *const model_names[N_P + N_U + N_Y + N_X + 1] = {{{', '.join(map(c_string, names))}}};\n"
        f"const double model_limits[N_P + 1][2] = {{{limits}{{0.0, 0.0}}}};\n"
        f"const int model_tunable[N_P + 1] = {{{tunable}0}};\n"
        f"const int model_state_outputs[N_X + 1] = {{{states}}};\n"
        f"const int model_output_states[N_Y + 1] = {{{state_of_outputs}}};\n"
        f"const double model_nominals[N_X + 1] = {{{nominals}1.0}};\n"
        f"const int model_state_parameters[N_X + 1] = {{{starts}-1}};\n"
        f"const double model_guesses[N_X + 1] = {{{guesses}0.0}};\n"
        f"const char *const model_start_requirements[N_START_REQUIREMENTS + 1] = {{{messages('start')}}};\n"
        f"const char *const model_step_requirements[N_STEP_REQUIREMENTS + 1] = {{{messages('step')}}};\n"
        f"const int model_of_integration[N_STEP_REQUIREMENTS + 1] = {{{of_integration}}};\n\n"
    )


def _solver_sizes(traced: TracedModel, implicit: ImplicitParts | None) -> dict[str, int]:
    solver = traced.model.solver
    adaptive = {f"SOLVER_{solver.upper()}": 1} if solver != "rk4" else {}
    return {"ADAPTIVE": len(adaptive), **adaptive, **(implicit.sizes if implicit else {})}


def _solver_table_values(implicit: ImplicitParts | None) -> dict[str, str]:
    """What implicit methods read: declaration -> values."""
    return {f"int {name}": ", ".join(map(str, values)) for name, values in implicit.tables.items()} if implicit else {}


def _solver_tables(implicit: ImplicitParts | None) -> str:
    tables = _solver_table_values(implicit)
    return "".join(f"const {name} = {{{values}}};\n" for name, values in tables.items()) + "\n" * bool(tables)


def _hybrid_tables(traced: TracedModel) -> str:
    tables = hybrid_tables(traced, c_string)
    return "".join(f"const {name} = {{{values}}};\n" for name, values in tables.items()) + "\n" * bool(tables)


def _lookup_tables(traced: TracedModel) -> str:
    if not traced.tables:
        return ""
    names = ", ".join(f'"{table.name}"' for table in traced.tables)
    variables = ", ".join(str(table.n_variables) for table in traced.tables)
    return (
        f"const char *const model_tables[N_TABLES] = {{{names}}};\n"
        f"const int model_table_variables[N_TABLES] = {{{variables}}};\n\n"
    )


#: What the header declares of lookup tables, if there are some.
_LOOKUP_TABLES = (
    "extern const char *const model_tables[N_TABLES]; /* names of the lookup tables */\n"
    "extern const int model_table_variables[N_TABLES]; /* over one variable or two */\n"
)


def _prototype(f: ca.Function, names: Sequence[str], prefix: str = "model") -> str:
    arguments = [f"double {n}" if n in SCALARS else f"const double *{n}" for n in names if n != "z"]
    return f"void {prefix}_{f.name()}({', '.join(arguments)}, double *y)"


def c_function(f: ca.Function, names: Sequence[str], prefix: str = "model", tables: Tables | None = None) -> str:
    """C source of a traced function, `void <prefix>_<its name>(..., double *y)`, with these names of its arguments.

    Where that makes it much shorter it has loops; what constants they count through is added to `tables`.
    """
    graph = Graph(f)
    lines = straight_statements(graph, names)
    length = sum(map(len, lines))
    if tables is not None and length > _SHORT:
        more = tables.copy()
        writer = LoopWriter(graph, names, more)
        loops = writer.write() if writer.repeats else lines
        added, looped = more.size - tables.size, sum(map(len, loops))
        if looped + added < length and looped + _TABLE * added < _SHORTER * length:
            lines = loops
            tables.adopt(more)
    used = set(re.findall(r"\w+", " ".join(lines)))
    if "z" in used & {*names}:  # discrete states stand behind the parameters
        lines = ["const double *z = p + MODEL_Z;", *lines]
        used.add("p")
    lines = [*(f"(void){n};" for n in [*names, "y"] if n not in used | {"z"}), *lines]
    return "\n".join([f"{_prototype(f, names, prefix)}\n{{", *(f"    {line}" for line in lines), "}", ""])
