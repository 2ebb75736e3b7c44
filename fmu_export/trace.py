"""Trace the numpy functions of a `Model` with CasADi: one expression graph each, for code generation and structure.

CasADi's numpy mode runs the model's own source with symbols in place of numbers, so that no equation is written twice.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from fmu_export.model import Array, Model, Requirement
from fmu_export.rk4 import rk4_step


@dataclass(frozen=True)
class TracedModel:
    """The expression graphs of a model, as CasADi functions of flat arguments.

    Each function has one output (n,). Arguments: `initial_state` (p), `derivatives`, `outputs` and
    `step_margins` (t, x, u, p), `step` (t, x, u, p, h) and `start_margins` (p).
    """

    model: Model
    initial_state: ca.Function
    derivatives: ca.Function
    outputs: ca.Function
    step: ca.Function
    start_margins: ca.Function
    step_margins: ca.Function

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
        )

    def output_dependencies(self) -> list[list[int]]:
        """For each output the inputs it depends on directly (indices)."""
        return _rows(self.outputs.jac_sparsity(0, 2))

    def initial_output_dependencies(self) -> tuple[list[list[int]], list[list[int]]]:
        """For each output the parameters, and the inputs, that its initial value depends on (indices)."""
        t, u, p = _symbols("t", 1), _symbols("u", len(self.model.inputs)), _symbols("p", len(self.model.parameters))
        y = self.outputs(t, self.initial_state(p), u, p)
        initial_outputs = ca.Function("initial_outputs", [p, u, t], [y])
        return _rows(initial_outputs.jac_sparsity(0, 0)), _rows(initial_outputs.jac_sparsity(0, 1))


def trace(model: Model) -> TracedModel:
    """Trace all functions of a model.

    Raises
    ------
    ValueError
        The model's functions return arrays whose lengths differ from what it declares.
    """
    n_x, n_u, n_p = len(model.state_layout), len(model.inputs), len(model.parameters)
    t, x, u, p, h = (_symbols(*s) for s in (("t", 1), ("x", n_x), ("u", n_u), ("p", n_p), ("h", 1)))
    T, X, U, P, H = _scalar(t), _vector(x), _vector(u), _vector(p), _scalar(h)

    def function(name: str, arguments: list[ca.SX], value: Array, length: int) -> ca.Function:
        column = ca.vec(ca.SX(value)) if np.size(value) else ca.SX(0, 1)
        if column.numel() != length:
            raise ValueError(f"{model.name}: {name} returns {column.numel()} values, {length} are declared")
        return ca.Function(name, arguments, [ca.densify(ca.cse(column))])

    def margins(at: str) -> tuple[Array, int]:
        requirements: list[Requirement] = [r for r in model.requirements if r.at == at]
        if not requirements:
            return np.zeros(0), 0
        return np.stack([r.margin(T, X, U, P) for r in requirements]), len(requirements)

    with _numpy_mode():
        return TracedModel(
            model=model,
            initial_state=function("initial_state", [p], model.initial_state(P), n_x),
            derivatives=function("derivatives", [t, x, u, p], model.derivatives(T, X, U, P), n_x),
            outputs=function("outputs", [t, x, u, p], model.output_values(T, X, U, P), len(model.outputs)),
            step=function("step", [t, x, u, p, h], rk4_step(model.derivatives, T, X, U, P, H), n_x),
            start_margins=function("start_margins", [p], *margins("start")),
            step_margins=function("step_margins", [t, x, u, p], *margins("step")),
        )


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


@contextmanager
def _numpy_mode() -> Iterator[None]:
    """Let numpy functions act on CasADi arrays; the mode is global in CasADi, so put it back."""
    before = ca.GlobalOptions.getNumpyMode()
    ca.GlobalOptions.setNumpyMode(1)
    try:
        yield
    finally:
        ca.GlobalOptions.setNumpyMode(before)
