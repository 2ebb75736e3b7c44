"""Trace the numpy functions of a `Model` with CasADi: one expression graph each, for code generation and structure.

CasADi's numpy mode runs the model's own source with symbols in place of numbers, so that no equation is written twice.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from math import isnan
from typing import Any

import numpy as np

from fmu_export.errors import TraceError, needs
from fmu_export.modelling.functions import rk4_step
from fmu_export.modelling.model import Array, Model, Requirement

with needs("export"):
    import casadi as ca


@dataclass(frozen=True)
class TracedModel:
    """The expression graphs of a model, as CasADi functions of flat arguments.

    Each function has one output (n,). Arguments: `initial_state` (p), `derivatives`, `outputs`, `step_margins`, `rates`
    and `everything` (t, x, u, p), `step` (t, x, u, p, h), `linear_step` (t, x, u, p, h, u_rate, k1) and
    `start_margins` (p). `rates` are the derivatives, then the margins, `everything` the outputs, then the rates: what
    they share is computed once, and an integrator step that begins there takes the derivatives as its first stage.
    Directional derivatives by CasADi's forward mode: `initial_state_direction` (p, dp), and `direction` (t, x, u, p,
    dx, du, dp), that of the outputs, then that of the derivatives.
    """

    model: Model
    initial_state: ca.Function
    derivatives: ca.Function
    outputs: ca.Function
    step: ca.Function
    start_margins: ca.Function
    step_margins: ca.Function
    rates: ca.Function
    everything: ca.Function
    linear_step: ca.Function
    initial_state_direction: ca.Function
    direction: ca.Function

    @property
    def functions(self) -> tuple[ca.Function, ...]:
        """All functions, in the order of their definition."""
        return (
            self.initial_state,
            self.derivatives,
            self.outputs,
            self.step,
            self.start_margins,
            self.step_margins,
            self.rates,
            self.everything,
            self.linear_step,
            self.initial_state_direction,
            self.direction,
        )

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


@cache  # all flavours are built from the same
def trace(model: Model) -> TracedModel:
    """Trace all functions of a model.

    Raises
    ------
    TraceError
        The model's functions return arrays whose lengths differ from what it declares, branch on values, use functions
        of the module `math` on their arguments, or make arrays of single values by np.array.
    """
    n_x, n_u, n_p = len(model.state_layout), len(model.inputs), len(model.parameters)
    t, x, u, p, h = (_symbols(*s) for s in (("t", 1), ("x", n_x), ("u", n_u), ("p", n_p), ("h", 1)))
    T, X, U, P, H = _scalar(t), _vector(x), _vector(u), _vector(p), _scalar(h)
    u_rate, k1 = _symbols("u_rate", n_u), _symbols("k1", n_x)
    dx, du, dp = (_symbols(*s) for s in (("dx", n_x), ("du", n_u), ("dp", n_p)))

    def function(name: str, arguments: list[ca.SX], value: Array, length: int) -> ca.Function:
        column = _column(value)
        if column.numel() != length:
            raise TraceError(f"{model.name}: {name} returns {column.numel()} values, {length} are declared")
        traced = ca.Function(name, arguments, [ca.densify(ca.cse(column))])
        if any(traced.instruction_id(k) == ca.OP_CONST and isnan(traced.instruction_constant(k)) for k in _all(traced)):
            raise TraceError(f"{model.name}: {name} has a constant NaN, as of math.sin(t) or float(t); use np.sin")
        return traced

    def margins(at: str) -> tuple[Array, int]:
        requirements: list[Requirement] = [r for r in model.requirements if r.at == at]
        if not requirements:
            return np.zeros(0), 0
        return np.stack([r.margin(T, X, U, P) for r in requirements]), len(requirements)

    def direction(
        name: str, column: ca.SX, arguments: list[ca.SX], along: list[ca.SX], seeds: list[ca.SX]
    ) -> ca.Function:
        """The derivative of a column along the direction that seeds give."""
        change = ca.jtimes(column, ca.vertcat(*along), ca.vertcat(*seeds))
        return ca.Function(name, [*arguments, *seeds], [ca.densify(ca.cse(change + ca.SX(*column.shape)))])

    with _numpy_mode(), _explained(model.name):
        rates, y = model.derivatives(T, X, U, P), model.output_values(T, X, U, P)
        step_margins, n_margins = margins("step")
        rates_and_margins = ca.vertcat(_column(rates), _column(step_margins))
        everything = ca.vertcat(_column(y), rates_and_margins)
        n_rates, n_y = n_x + n_margins, len(model.outputs)
        return TracedModel(
            model=model,
            initial_state=function("initial_state", [p], model.initial_state(P), n_x),
            derivatives=function("derivatives", [t, x, u, p], rates, n_x),
            outputs=function("outputs", [t, x, u, p], y, n_y),
            step=function("step", [t, x, u, p, h], rk4_step(model.derivatives, T, X, U, P, H), n_x),
            start_margins=function("start_margins", [p], *margins("start")),
            step_margins=function("step_margins", [t, x, u, p], step_margins, n_margins),
            rates=function("rates", [t, x, u, p], rates_and_margins, n_rates),
            everything=function("everything", [t, x, u, p], everything, n_y + n_rates),
            linear_step=function(
                "linear_step",
                [t, x, u, p, h, u_rate, k1],
                rk4_step(model.derivatives, T, X, U, P, H, _vector(u_rate), _vector(k1)),
                n_x,
            ),
            initial_state_direction=direction(
                "initial_state_direction", _column(model.initial_state(P)), [p], [p], [dp]
            ),
            direction=direction(
                "direction", ca.vertcat(_column(y), _column(rates)), [t, x, u, p], [x, u, p], [dx, du, dp]
            ),
        )


def feedthrough(model: Model) -> list[list[int]]:
    """For each output of a model the inputs it depends on directly (indices); much faster than `trace`."""
    t, x = _symbols("t", 1), _symbols("x", len(model.state_layout))
    u, p = _symbols("u", len(model.inputs)), _symbols("p", len(model.parameters))
    with _numpy_mode():
        y = _column(model.output_values(_scalar(t), _vector(x), _vector(u), _vector(p)))
    return _rows(ca.Function("outputs", [t, x, u, p], [y]).jac_sparsity(0, 2))


def _all(function: ca.Function) -> range:
    return range(function.n_instructions())


def _column(value: Array) -> ca.SX:
    return ca.vec(ca.SX(value)) if np.size(value) else ca.SX(0, 1)


def _symbols(name: str, n: int) -> ca.SX:
    return ca.SX.sym(name, n)


def _vector(symbols: ca.SX) -> Any:
    return ca.ArrayInterface(symbols.T, 1)


def _scalar(symbol: ca.SX) -> Any:
    return ca.ArrayInterface(symbol, 0)


def _rows(sparsity: ca.Sparsity) -> list[list[int]]:
    """Column indices of the structural nonzeros of each row."""
    rows: list[list[int]] = [[] for _ in range(sparsity.size1())]
    for row, column in zip(*sparsity.get_triplet(), strict=True):
        rows[row].append(column)
    return [sorted(r) for r in rows]


#: What CasADi says when it can't trace -> what the author of a model can do.
_REMEDIES = {
    "truth value": "an `if`, `max` or `min` on values can't be traced; use np.where, np.maximum, np.clip",
    "numpy array": "np.array, math.* and float() take no symbols; use np.stack, np.concatenate, np.sin, ...",
}


@contextmanager
def _explained(model: str) -> Iterator[None]:
    """Say in the model's terms what CasADi can't trace."""
    try:
        yield
    except (RuntimeError, TypeError) as error:
        for part, remedy in _REMEDIES.items():
            if part in str(error):
                raise TraceError(f"{model}: {remedy}") from error
        raise


@contextmanager
def _numpy_mode() -> Iterator[None]:
    """Let numpy functions act on CasADi arrays; the mode is global in CasADi, so put it back."""
    before = ca.GlobalOptions.getNumpyMode()
    ca.GlobalOptions.setNumpyMode(1)
    try:
        yield
    finally:
        ca.GlobalOptions.setNumpyMode(before)
