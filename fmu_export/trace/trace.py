"""Trace the numpy functions of a `Model` with CasADi: one expression graph each, for code generation and structure.

The model's own source runs with symbols in place of numbers, so that no equation is written twice; the result is
compared with what numpy computes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from math import isnan
from typing import Any

import numpy as np

from fmu_export.errors import TraceError, needs
from fmu_export.modelling.functions import rk4_step
from fmu_export.modelling.model import Model, Requirement
from fmu_export.modelling.model_class import AnyModel, flat_model
from fmu_export.trace.arrays import Scalar
from fmu_export.trace.check import Checked, check_against_numpy
from fmu_export.trace.expressions import as_written
from fmu_export.trace.symbols import argument, column, tracing

with needs("export"):
    import casadi as ca


@dataclass(frozen=True)
class TracedModel:
    """The expression graphs of a model, as CasADi functions of flat arguments.

    Each function has one output (n,); `outputs` are those and the locals. Arguments: `initial_state` (p),
    `derivatives`, `outputs`, `step_margins`, `rates` and `everything` (t, x, u, p), `step` (t, x, u, p, h) and
    `start_margins` (p). `rates` are the derivatives, then the margins, `everything` the outputs, then the rates: what
    they share is computed once, and an integrator step that begins there takes the derivatives as its first stage.
    Directional derivatives by CasADi's forward mode: `initial_state_direction` (p, dp), and `direction` (t, x, u, p,
    dx, du, dp), that of the outputs, then that of the derivatives.
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
        )

    @cached_property
    def step(self) -> ca.Function:
        """A Runge-Kutta step with constant inputs; all stages in one graph."""

        def derivatives(*arguments: Any) -> Any:
            with as_written():
                return self.derivatives(*arguments)

        arguments = [*self.derivatives.sx_in(), ca.SX.sym("h")]
        return _function(self.model.name, "step", arguments, rk4_step(derivatives, *arguments))

    @property
    def rates_depend_on_time(self) -> bool:
        """Whether derivatives or margins depend on the time itself."""
        return self.rates.jac_sparsity(0, 0).nnz() > 0

    def output_dependencies(self) -> list[list[int]]:
        """For each output the inputs it depends on directly (indices)."""
        return _rows(self.outputs.jac_sparsity(0, 2))

    def output_state_dependencies(self) -> list[list[int]]:
        """For each output the states it depends on directly (indices)."""
        return _rows(self.outputs.jac_sparsity(0, 1))

    def output_parameter_dependencies(self) -> list[list[int]]:
        """For each output the parameters it depends on directly (indices)."""
        return _rows(self.outputs.jac_sparsity(0, 3))

    def derivative_parameter_dependencies(self) -> list[list[int]]:
        """For each state derivative the parameters it depends on directly (indices)."""
        return _rows(self.derivatives.jac_sparsity(0, 3))

    def start_requirement_dependencies(self) -> list[list[int]]:
        """For each requirement of the start the parameters it depends on (indices)."""
        return _rows(self.start_margins.jac_sparsity(0, 0))

    def derivative_dependencies(self) -> tuple[list[list[int]], list[list[int]], list[list[int]]]:
        """For each state derivative the states, the inputs, and at the start the parameters it depends on."""
        t, u, p = _symbols("t", 1), _symbols("u", len(self.model.inputs)), _symbols("p", len(self.model.parameters))
        rate = self.derivatives(t, self.initial_state(p), u, p)
        initial = ca.Function("initial_derivatives", [p, u, t], [rate])
        on_states, on_inputs = self.derivatives.jac_sparsity(0, 1), self.derivatives.jac_sparsity(0, 2)
        return _rows(on_states), _rows(on_inputs), _rows(initial.jac_sparsity(0, 0))

    def initial_output_dependencies(self) -> tuple[list[list[int]], list[list[int]]]:
        """For each output the parameters, and the inputs, that its initial value depends on (indices)."""
        t, u, p = _symbols("t", 1), _symbols("u", len(self.model.inputs)), _symbols("p", len(self.model.parameters))
        y = self.outputs(t, self.initial_state(p), u, p)
        initial_outputs = ca.Function("initial_outputs", [p, u, t], [y])
        return _rows(initial_outputs.jac_sparsity(0, 0)), _rows(initial_outputs.jac_sparsity(0, 1))


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
    if not model.is_continuous:
        raise TraceError(f"{model.name}: discrete states and events can't be exported yet")
    n_x, n_u, n_p = len(model.state_layout), len(model.inputs), len(model.parameters)
    t, x, u, p = (_symbols(*s) for s in (("t", 1), ("x", n_x), ("u", n_u), ("p", n_p)))
    T, X, U, P = Scalar(t), argument(x), argument(u), argument(p)
    dx, du, dp = (_symbols(*s) for s in (("dx", n_x), ("du", n_u), ("dp", n_p)))

    def function(name: str, arguments: list[ca.SX], value: ca.SX) -> ca.Function:
        return _function(model.name, name, arguments, value)

    def named(name: str) -> str:
        return f"{model.name}: {name}"

    def direction(
        name: str, value: ca.SX, arguments: list[ca.SX], along: list[ca.SX], seeds: list[ca.SX]
    ) -> ca.Function:
        """The derivative of a column along the direction that seeds give."""
        change = ca.jtimes(ca.cse(value), ca.vertcat(*along), ca.vertcat(*seeds))
        return ca.Function(name, [*arguments, *seeds], [ca.densify(ca.cse(change + ca.SX(*value.shape)))])

    with tracing(model.name):
        rates = column(model.derivatives(T, X, U, P), named("derivatives"), n_x)
        y = _outputs(model, T, X, U, P)
        initial = column(model.initial_state(P), named("initial_state"), n_x)
        start_margins, step_margins = (_margins(model, at, T, X, U, P) for at in ("start", "step"))
        rates_and_margins = ca.vertcat(rates, step_margins)
        everything = ca.vertcat(y, rates_and_margins)
        # the basic functions first: what is wrong with them is said in their names
        basic = {
            "initial_state": function("initial_state", [p], initial),
            "derivatives": function("derivatives", [t, x, u, p], rates),
            "outputs": function("outputs", [t, x, u, p], y),
            "start_margins": function("start_margins", [p], start_margins),
            "step_margins": function("step_margins", [t, x, u, p], step_margins),
        }
        if not unchecked:
            _check_same_trace(model, basic)
    traced = TracedModel(
        model=model,
        **basic,
        rates=function("rates", [t, x, u, p], rates_and_margins),
        everything=function("everything", [t, x, u, p], everything),
        initial_state_direction=direction("initial_state_direction", initial, [p], [p], [dp]),
        direction=direction("direction", ca.vertcat(y, rates), [t, x, u, p], [x, u, p], [dx, du, dp]),
    )
    if not unchecked:
        with as_written():
            check_against_numpy(model, _checked(model, traced))
    return traced


def _function(model: str, name: str, arguments: Sequence[ca.SX], value: ca.SX) -> ca.Function:
    known = {str(s) for a in arguments for s in ca.symvar(a)}
    if strange := [str(s) for s in ca.symvar(value) if str(s) not in known]:
        raise TraceError(
            f"{model}: {name} depends on {', '.join(strange)}, which is not among its arguments: a value that another "
            "function or an earlier call has kept; compute it from the arguments"
        )
    try:
        with as_written():
            traced = ca.Function(name, list(arguments), [ca.densify(ca.cse(value))])
    except RuntimeError as error:
        raise TraceError(
            f"{model}: {name} depends on a value that an earlier call has kept; compute it from the arguments"
        ) from error
    if any(traced.instruction_id(k) == ca.OP_CONST and isnan(traced.instruction_constant(k)) for k in _all(traced)):
        raise TraceError(
            f"{model}: {name} has a constant NaN, as of an element of np.empty that is never set; write a number"
        )
    return traced


def _outputs(model: Model, t: Any, x: Any, u: Any, p: Any) -> ca.SX:
    """Outputs and locals; one with the name of a state is the state itself, whatever the model computes for it."""
    returned = column(model.output_values(t, x, u, p), f"{model.name}: output_values", len(model.returned))
    states = column(x, "states", len(model.state_layout))
    found = {name: returned[i] for i, name in enumerate(model.returned.names)}
    found |= {name: states[i] for i, name in enumerate(model.state_layout.names)}
    return ca.vertcat(ca.SX(0, 1), *(found[name] for name in model.computed.names))


def _margins(model: Model, at: str, *arguments: Any) -> ca.SX:
    requirements: list[Requirement] = [r for r in model.requirements if r.at == at]
    return ca.vertcat(
        ca.SX(0, 1),
        *(column(r.margin(*arguments), f"{model.name}: the margin of '{r.message}'", 1) for r in requirements),
    )


def _check_same_trace(model: Model, first: dict[str, ca.Function]) -> None:
    """Refuse functions that are traced to something else a second time, in another order and with other symbols."""
    sizes = 1, len(model.state_layout), len(model.inputs), len(model.parameters)
    functions: dict[str, Callable[..., ca.SX]] = {
        "step_margins": lambda *a: _margins(model, "step", *a),
        "start_margins": lambda *a: _margins(model, "start", *a),
        "outputs": lambda *a: _outputs(model, *a),
        "derivatives": lambda *a: column(model.derivatives(*a), "derivatives", sizes[1]),
        "initial_state": lambda *a: column(model.initial_state(a[3]), "initial_state", sizes[1]),
    }
    for name, again in functions.items():
        t, x, u, p = (_symbols(f"{n}_", size) for n, size in zip("txup", sizes, strict=True))
        value = again(Scalar(t), argument(x), argument(u), argument(p))
        arguments = [p] if first[name].n_in() == 1 else [t, x, u, p]
        if _instructions(_function(model.name, name, arguments, value)) != _instructions(first[name]):
            raise TraceError(
                f"{model.name}: {name}: traced twice, the equations differ: they depend on np.random, a clock, a "
                "counter or what an earlier call has left; make it a parameter, an input or a state"
            )


def _instructions(f: ca.Function) -> list[Any]:
    return [
        (
            f.instruction_id(k),
            f.instruction_input(k),
            f.instruction_output(k),
            f.instruction_constant(k) if f.instruction_id(k) == ca.OP_CONST else None,
        )
        for k in _all(f)
    ]


def _checked(model: Model, traced: TracedModel) -> list[Checked]:
    """The functions of a model beside their traces, with the names of their elements, all of (t, x, u, p)."""
    t, x, u, p = traced.derivatives.sx_in()

    def of_all(f: ca.Function) -> ca.Function:
        return ca.Function(f.name(), [t, x, u, p], [f(p)])

    def margins(at: str) -> tuple[Any, tuple[str, ...]]:
        requirements = [r for r in model.requirements if r.at == at]
        return (
            lambda *a: np.array([np.asarray(r.margin(*a)).item() for r in requirements], dtype=float),
            tuple(f"'{r.message}'" for r in requirements),
        )

    states = model.state_layout.names
    start, start_names = margins("start")
    step, step_names = margins("step")
    return [
        Checked("initial_state", lambda t, x, u, p: model.initial_state(p), of_all(traced.initial_state), states),
        Checked("derivatives", model.derivatives, traced.derivatives, tuple(f"der({s})" for s in states)),
        Checked("output_values", model.output_values, _returned(traced), model.returned.names),
        Checked("requirements", start, of_all(traced.start_margins), start_names),
        Checked("requirements", step, traced.step_margins, step_names),
    ]


def _returned(traced: TracedModel) -> ca.Function:
    """The traced function of what `output_values` returns: without locals that are states."""
    arguments, names = traced.outputs.sx_in(), traced.model.computed.names
    values = traced.outputs(*arguments)
    wanted = set(traced.model.returned.names)
    rows = [values[i] for i, name in enumerate(names) if name in wanted]
    return ca.Function("outputs", arguments, [ca.vertcat(ca.SX(0, 1), *rows)])


def feedthrough(model: Model) -> list[list[int]]:
    """For each output of a model the inputs it depends on directly (indices); much faster than `trace`."""
    t, x = _symbols("t", 1), _symbols("x", len(model.state_layout))
    u, p = _symbols("u", len(model.inputs)), _symbols("p", len(model.parameters))
    with tracing(model.name):
        y = _outputs(model, Scalar(t), argument(x), argument(u), argument(p))
    return _rows(ca.Function("outputs", [t, x, u, p], [y]).jac_sparsity(0, 2))


def _all(function: ca.Function) -> range:
    return range(function.n_instructions())


def _symbols(name: str, n: int) -> ca.SX:
    return ca.SX.sym(name, n)


def _rows(sparsity: ca.Sparsity) -> list[list[int]]:
    """Column indices of the structural nonzeros of each row."""
    rows: list[list[int]] = [[] for _ in range(sparsity.size1())]
    for row, place in zip(*sparsity.get_triplet(), strict=True):
        rows[row].append(place)
    return [sorted(r) for r in rows]
