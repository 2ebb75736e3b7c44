"""Trace the numpy functions of a `Model` with CasADi: one expression graph each, for code generation and structure.

The model's own source runs with symbols in place of numbers, so that no equation is written twice; the result is
compared with what numpy computes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from math import isnan
from typing import Any

import numpy as np

from fmu_export.errors import TraceError, needs
from fmu_export.modelling.functions import rk4_defect, rk4_step
from fmu_export.modelling.model import Model, Requirement
from fmu_export.modelling.model_class import AnyModel, flat_model
from fmu_export.modelling.tables import Table
from fmu_export.trace.check import Checked, check_against_numpy
from fmu_export.trace.hybrid import Influence, changes, influence, instants, rows
from fmu_export.trace.symbols.arrays import Scalar
from fmu_export.trace.symbols.context import argument, column, tracing
from fmu_export.trace.symbols.expressions import as_written
from fmu_export.trace.symbols.tables import tables_found

with needs("export"):
    import casadi as ca


#: The functions that every model has.
_BASIC = ("initial_state", "derivatives", "outputs", "start_margins", "step_margins")


@dataclass(frozen=True)
class TracedModel:
    """The expression graphs of a model, as CasADi functions of flat arguments.

    Each function has one output (n,); `outputs` are those and the locals. Arguments: `initial_state` (p),
    `derivatives`, `outputs`, `step_margins`, `rates` and `everything` (t, x, u, p), `step` (t, x, u, p, h) and
    `start_margins` (p). `rates` are the derivatives, then the margins, `everything` the outputs, then the rates: what
    they share is computed once, and an integrator step that begins there takes the derivatives as its first stage.
    Directional derivatives by CasADi's forward mode: `initial_state_direction` (p, dp), and `direction` (t, x, u, p,
    dx, du, dp), that of the outputs, then that of the derivatives; and `output_rates` (t, x, u, p, x_rate), the
    derivatives of the outputs by time, without locals, with constant inputs.

    With discrete states z, which are constants of all these, z follows p among the arguments. `changes` are the
    functions of events and samplers: those of `fmu_export.trace.hybrid.changes`, `initial_discrete` of (p),
    and `instants` of (p), the period and the offset of each sampler.
    """

    model: Model
    initial_state: ca.Function
    derivatives: ca.Function
    outputs: ca.Function
    start_margins: ca.Function
    step_margins: ca.Function
    rates: ca.Function
    everything: ca.Function
    initial_state_direction: ca.Function
    direction: ca.Function
    output_rates: ca.Function
    changes: tuple[ca.Function, ...]
    #: Lookup tables, in the order of the numbers that calls of them have.
    tables: tuple[Table, ...]

    @property
    def functions(self) -> tuple[ca.Function, ...]:
        """All functions, in the order of their definition."""
        return (
            self.initial_state,
            self.derivatives,
            self.outputs,
            self.start_margins,
            self.step_margins,
            self.rates,
            self.everything,
            self.initial_state_direction,
            self.direction,
            self.output_rates,
            *self.changes,
        )

    @cached_property
    def change(self) -> dict[str, ca.Function]:
        """The functions of events and samplers by name."""
        return {f.name(): f for f in self.changes}

    @cached_property
    def step(self) -> ca.Function:
        """A Runge-Kutta step with constant inputs, all stages in one graph; for "rk43" also their derivatives."""
        stages = []

        def derivatives(*arguments: Any) -> Any:
            with as_written():
                stages.append(self.derivatives(*arguments))
            return stages[-1]

        arguments = [*self.derivatives.sx_in(), ca.SX.sym("h")]
        with as_written():
            end = rk4_step(derivatives, *arguments)
            results = ca.vertcat(end, *stages) if self.model.solver == "rk43" else end
            return ca.Function("step", arguments, [ca.densify(ca.cse(results))])

    @cached_property
    def defect(self) -> ca.Function:
        """What is wrong with such a step, from its h and the derivatives of its stages; then the margins inside it."""
        n, margins = len(self.model.state_layout), []

        def derivatives(*arguments: Any) -> Any:
            with as_written():
                rates = self.rates(*arguments)
            margins.append(rates[n:])
            return rates[:n]

        t, x, u, p, *others = self.derivatives.sx_in()
        h, stages = ca.SX.sym("h"), ca.SX.sym("stages", 4 * n)
        with as_written():
            found = rk4_defect(derivatives, t, x, u, p, h, ca.vertsplit(stages, max(n, 1)))
            results = ca.vertcat(found, *margins)
            return ca.Function("defect", [t, x, u, p, *others, h, stages], [ca.densify(ca.cse(results))])

    @property
    def rates_depend_on_time(self) -> bool:
        """Whether derivatives or margins depend on the time itself."""
        return self.rates.jac_sparsity(0, 0).nnz() > 0

    def start_parameters(self) -> list[int | None]:
        """For each state the parameter that is its value at the start (index), None where it is computed otherwise."""
        (p,) = self.initial_state.sx_in()
        position = {str(p[k]): k for k in range(p.numel())}
        starts = self.initial_state(p)
        return [position.get(str(starts[i])) if starts[i].is_symbolic() else None for i in range(starts.numel())]

    def output_dependencies(self) -> list[list[int]]:
        """For each output the inputs it depends on directly (indices)."""
        return rows(self.outputs.jac_sparsity(0, 2))

    def output_state_dependencies(self) -> list[list[int]]:
        """For each output the states it depends on directly (indices)."""
        return rows(self.outputs.jac_sparsity(0, 1))

    def output_parameter_dependencies(self) -> list[list[int]]:
        """For each output the parameters it depends on directly (indices)."""
        return rows(self.outputs.jac_sparsity(0, 3))

    def derivative_parameter_dependencies(self) -> list[list[int]]:
        """For each state derivative the parameters it depends on directly (indices)."""
        return rows(self.derivatives.jac_sparsity(0, 3))

    def influence(self, *, at_start: bool = False) -> Influence:
        """Which inputs and parameters states depend on by events and samplers, at the start or at other instants."""
        p = _symbols("p", len(self.model.parameters))
        initial = ca.vertcat(self.initial_state(p), self.change["initial_discrete"](p))
        return influence(self.model, self.change, ca.Function("initial", [p], [initial]) if at_start else None)

    def output_states(self) -> list[list[int]]:
        """For each output the states, then the discrete states behind, that it depends on directly (indices)."""
        n_x = len(self.model.state_layout)
        on_discrete = rows(self.outputs.jac_sparsity(0, 4)) if len(self.model.discrete) else []
        on_states = self.output_state_dependencies()
        return [[*row, *(n_x + j for j in on_discrete[i])] if on_discrete else row for i, row in enumerate(on_states)]

    def discrete_outputs(self) -> list[int]:
        """The outputs and locals that change at events and sampling instants only (indices)."""
        if not len(self.model.discrete):
            return []
        on_others = [rows(self.outputs.jac_sparsity(0, i)) for i in (0, 1, 2)]
        on_discrete = rows(self.outputs.jac_sparsity(0, 4))
        return [i for i, on in enumerate(on_discrete) if on and not any(others[i] for others in on_others)]

    def change_parameter_dependencies(self) -> set[int]:
        """The parameters that events and samplers depend on (indices)."""
        functions = [f for f in self.changes if f.n_in() > 1]
        return {i for f in functions for row in rows(f.jac_sparsity(0, 3)) for i in row}

    def start_requirement_dependencies(self) -> list[list[int]]:
        """For each requirement of the start the parameters it depends on (indices)."""
        return rows(self.start_margins.jac_sparsity(0, 0))

    def derivative_dependencies(self) -> tuple[list[list[int]], list[list[int]], list[list[int]]]:
        """For each state derivative the states, the inputs, and at the start the parameters it depends on."""
        initial = self._at_start(self.derivatives)
        on_states, on_inputs = self.derivatives.jac_sparsity(0, 1), self.derivatives.jac_sparsity(0, 2)
        return rows(on_states), rows(on_inputs), rows(initial.jac_sparsity(0, 0))

    def initial_output_dependencies(self) -> tuple[list[list[int]], list[list[int]]]:
        """For each output the parameters, and the inputs, that its initial value depends on (indices)."""
        initial_outputs = self._at_start(self.outputs)
        return rows(initial_outputs.jac_sparsity(0, 0)), rows(initial_outputs.jac_sparsity(0, 1))

    def _at_start(self, f: ca.Function) -> ca.Function:
        """A function of (t, x, u, p) at the initial states, as a function of (p, u, t)."""
        t, u, p = _symbols("t", 1), _symbols("u", len(self.model.inputs)), _symbols("p", len(self.model.parameters))
        z = [self.change["initial_discrete"](p)] if len(self.model.discrete) else []
        return ca.Function(f"initial_{f.name()}", [p, u, t], [f(t, self.initial_state(p), u, p, *z)])


def trace(model: AnyModel, unchecked: bool = False) -> TracedModel:
    """Trace all functions of a model.

    Parameters
    ----------
    model : Model or ModelClass
    unchecked : bool, optional
        Leave out the comparison with what numpy computes.

    Raises
    ------
    TraceError
        The model's functions return arrays whose shapes differ from what it declares, use what can't be traced, depend
        on more than their arguments, or compute something else with symbols than with numbers.
    """
    return _traced(flat_model(model), unchecked)


@cache  # all flavours are built from the same
def _traced(model: Model, unchecked: bool) -> TracedModel:
    n_x, n_u, n_p, n_z = _sizes(model)
    t, x, u, p, z = (_symbols(*s) for s in (("t", 1), ("x", n_x), ("u", n_u), ("p", n_p), ("z", n_z)))
    T, X, U, P, Z = Scalar(t), argument(x), argument(u), argument(p), argument(z)
    everything_known = [t, x, u, p, z] if n_z else [t, x, u, p]
    dx, du, dp = (_symbols(*s) for s in (("dx", n_x), ("du", n_u), ("dp", n_p)))

    def named(name: str) -> str:
        return f"{model.name}: {name}"

    def direction(
        name: str, value: ca.SX, arguments: list[ca.SX], along: list[ca.SX], seeds: list[ca.SX]
    ) -> ca.Function:
        """The derivative of a column along the direction that seeds give."""
        change = ca.jtimes(ca.cse(value), ca.vertcat(*along), ca.vertcat(*seeds))
        return ca.Function(name, [*arguments, *seeds], [ca.densify(ca.cse(change + ca.SX(*value.shape)))])

    with tracing(model.name):
        known = model.arguments(T, X, Z, U, P)
        rates = column(model.derivatives(*known), named("derivatives"), n_x)
        y = _outputs(model, T, X, Z, U, P)
        initial = column(model.initial_state(P), named("initial_state"), n_x)
        start_margins, step_margins = (_margins(model, at, *known) for at in ("start", "step"))
        values = {
            "initial_state": initial,
            "derivatives": rates,
            "outputs": y,
            "start_margins": start_margins,
            "step_margins": step_margins,
            **{c.name: c.traced(T, X, Z, U, P) for c in changes(model)},
        }
        of_parameters = ("initial_state", "start_margins", "initial_discrete", "instants")
        arguments = {name: [p] if name in of_parameters else everything_known for name in values}
        first = {name: _as_traced(model.name, name, arguments[name], value) for name, value in values.items()}
        if not unchecked:
            _check_same_trace(model, first)
        found = tables_found()
    if not model.is_continuous:
        values["instants"] = instants(model, p)
    with as_written():
        everything = ca.cse(ca.vertcat(y, rates, step_margins))  # in which all others are
        values = {name: ca.cse(value) for name, value in values.items() if name not in ("derivatives", "outputs")}
        n_y, n_rates = y.numel(), y.numel() + n_x
        values |= {
            "outputs": everything[:n_y, 0],
            "derivatives": everything[n_y:n_rates, 0],
            "step_margins": everything[n_rates:, 0],
            "rates": everything[n_y:, 0],
            "everything": everything,
        }
        functions = {
            name: ca.Function(name, [p] if name in of_parameters else everything_known, [ca.densify(value)])
            for name, value in values.items()
        }
    traced = TracedModel(
        model=model,
        **{name: functions.pop(name) for name in (*_BASIC, "rates", "everything")},
        initial_state_direction=direction("initial_state_direction", initial, [p], [p], [dp]),
        direction=direction("direction", ca.vertcat(y, rates), everything_known, [x, u, p], [dx, du, dp]),
        output_rates=_output_rates(everything_known, y[: len(model.outputs)], t, x),
        changes=tuple(functions.values()),
        tables=found,
    )
    if not unchecked:
        with as_written():
            check_against_numpy(model, _checked(model, traced), traced.tables)
    return traced


def _output_rates(known: list[ca.SX], outputs: ca.SX, t: ca.SX, x: ca.SX) -> ca.Function:
    """Derivatives of outputs by time with constant inputs, as a function of those of the states, x_rate, too."""
    x_rate = _symbols("x_rate", x.numel())
    change = ca.jtimes(ca.cse(outputs), ca.vertcat(t, x), ca.vertcat(ca.SX(1), x_rate))
    return ca.Function("output_rates", [*known, x_rate], [ca.densify(ca.cse(change + ca.SX(*outputs.shape)))])


def _sizes(model: Model) -> tuple[int, int, int, int]:
    return len(model.state_layout), len(model.inputs), len(model.parameters), len(model.discrete)


def _as_traced(model: str, name: str, arguments: Sequence[ca.SX], value: ca.SX) -> ca.Function:
    """A function as it has been traced, every operation as often as it was met."""
    known = {str(s) for a in arguments for s in ca.symvar(a)}
    if strange := [str(s) for s in ca.symvar(value) if str(s) not in known]:
        raise TraceError(
            f"{model}: {name} depends on {', '.join(strange)}, which is not among its arguments: a value that another "
            "function or an earlier call has kept; compute it from the arguments"
        )
    try:
        with as_written():
            traced = ca.Function(name, list(arguments), [ca.densify(value)])
    except RuntimeError as error:
        raise TraceError(
            f"{model}: {name} depends on a value that an earlier call has kept; compute it from the arguments"
        ) from error
    if any(isnan(constant) for constant in _written(traced)[1]):
        raise TraceError(
            f"{model}: {name} has a constant NaN, as of an element of np.empty that is never set; write a number"
        )
    return traced


def _outputs(model: Model, t: Any, x: Any, z: Any, u: Any, p: Any) -> ca.SX:
    """Outputs and locals; one with the name of a state is the state itself, whatever the model computes for it."""
    values = model.output_values(*model.arguments(t, x, z, u, p))
    returned = column(values, f"{model.name}: output_values", len(model.returned))
    found = dict(zip(model.returned.names, ca.vertsplit(returned), strict=True))
    for layout, states in ((model.state_layout, x), (model.discrete, z)):
        found |= dict(zip(layout.names, ca.vertsplit(column(states, "states", len(layout))), strict=True))
    return ca.vertcat(ca.SX(0, 1), *(found[name] for name in model.computed.names))


def _margins(model: Model, at: str, *arguments: Any) -> ca.SX:
    requirements: list[Requirement] = [r for r in model.requirements if r.at == at]
    return ca.vertcat(
        ca.SX(0, 1),
        *(column(r.margin(*arguments), f"{model.name}: the margin of '{r.message}'", 1) for r in requirements),
    )


def _check_same_trace(model: Model, first: Mapping[str, ca.Function]) -> None:
    """Refuse functions that are traced to something else a second time, in another order and with other symbols."""
    n_x, n_u, n_p, n_z = _sizes(model)
    functions: dict[str, Callable[..., ca.SX]] = {
        **{c.name: c.traced for c in reversed(changes(model))},
        "step_margins": lambda *a: _margins(model, "step", *model.arguments(*a)),
        "start_margins": lambda *a: _margins(model, "start", *model.arguments(*a)),
        "outputs": lambda *a: _outputs(model, *a),
        "derivatives": lambda *a: column(model.derivatives(*model.arguments(*a)), "derivatives", n_x),
        "initial_state": lambda *a: column(model.initial_state(a[4]), "initial_state", n_x),
    }
    for name, again in functions.items():
        sizes = {"t_": 1, "x_": n_x, "z_": n_z, "u_": n_u, "p_": n_p}
        t, x, z, u, p = (_symbols(*s) for s in sizes.items())
        value = again(Scalar(t), argument(x), argument(z), argument(u), argument(p))
        arguments = [p] if first[name].n_in() == 1 else [t, x, u, p, z][: first[name].n_in()]
        if _written(_as_traced(model.name, name, arguments, value)) != _written(first[name]):
            raise TraceError(
                f"{model.name}: {name}: traced twice, the equations differ: they depend on np.random, a clock, a "
                "counter or what an earlier call has left; make it a parameter, an input or a state"
            )


#: A line of a function's text that sets a constant, of which the text has some digits only.
_CONSTANT = re.compile(r"@\d+ = -?(\d\S*|inf|nan);")


def _written(f: ca.Function) -> tuple[str, list[float]]:
    """The operations of a function as text, and its constants."""
    text = f.str(True)
    lines = text.splitlines()
    first = len(lines) - f.n_instructions()
    return text, [f.instruction_constant(k - first) for k, line in enumerate(lines) if _CONSTANT.fullmatch(line)]


def _checked(model: Model, traced: TracedModel) -> list[Checked]:
    """The functions of a model beside their traces, all of (t, x, u, p): discrete states follow the states in x."""
    n_x, n_u, n_p, n_z = _sizes(model)
    t, x, u, p = _symbols("t", 1), _symbols("x", n_x + n_z), _symbols("u", n_u), _symbols("p", n_p)

    def checked(name: str, function: Callable[..., Any], f: ca.Function, elements: tuple[str, ...]) -> Checked:
        """Of function(t, x, z, u, p)."""
        arguments = [p] if f.n_in() == 1 else [t, x[:n_x], u, p, x[n_x:]][: f.n_in()]
        return Checked(
            name,
            lambda t, x, u, p: function(t, x[:n_x], x[n_x:], u, p),
            ca.Function(f.name(), [t, x, u, p], [f(*arguments)]),
            elements,
        )

    def of_model(function: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *a: function(*model.arguments(*a))

    def margins(at: str, f: ca.Function) -> Checked:
        requirements = [r for r in model.requirements if r.at == at]
        return checked(
            "requirements",
            of_model(lambda *a: np.array([np.asarray(r.margin(*a)).item() for r in requirements], dtype=float)),
            f,
            tuple(f"'{r.message}'" for r in requirements),
        )

    states = model.state_layout.names
    rates = tuple(f"der({s})" for s in states)
    return [
        checked("initial_state", lambda t, x, z, u, p: model.initial_state(p), traced.initial_state, states),
        checked("derivatives", of_model(model.derivatives), traced.derivatives, rates),
        checked("output_values", of_model(model.output_values), _returned(traced), model.returned.names),
        margins("start", traced.start_margins),
        margins("step", traced.step_margins),
        *(checked(c.called, c.computed, traced.change[c.name], c.elements) for c in changes(model)),
    ]


def _returned(traced: TracedModel) -> ca.Function:
    """The traced function of what `output_values` returns: without locals that are states."""
    arguments, names = traced.outputs.sx_in(), traced.model.computed.names
    values = traced.outputs(*arguments)
    wanted = set(traced.model.returned.names)
    returned = [value for name, value in zip(names, ca.vertsplit(values), strict=True) if name in wanted]
    return ca.Function("outputs", arguments, [ca.vertcat(ca.SX(0, 1), *returned)])


def feedthrough(model: Model) -> list[list[int]]:
    """For each output of a model the inputs it depends on directly (indices); much faster than `trace`."""
    n_x, n_u, n_p, n_z = _sizes(model)
    t, x, u, p, z = (_symbols(*s) for s in (("t", 1), ("x", n_x), ("u", n_u), ("p", n_p), ("z", n_z)))
    with tracing(model.name):
        y = _outputs(model, Scalar(t), argument(x), argument(z), argument(u), argument(p))
    return rows(ca.Function("outputs", [t, x, u, p, z], [y]).jac_sparsity(0, 2))


def _all(function: ca.Function) -> range:
    return range(function.n_instructions())


def _symbols(name: str, n: int) -> ca.SX:
    return ca.SX.sym(name, n)
