"""Lookup tables on arrays of symbols: `Table`, and numpy's functions that look up.

A table of many points is one operation in the graph: a call of a CasADi function that is never inlined, with the number
of the table as its first argument, which C and Python find the data by.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from typing import Any

import numpy as np

from fmu_export.errors import needs
from fmu_export.modelling.tables import Table
from fmu_export.trace.operations import number_of
from fmu_export.trace.symbols.arrays import FLOAT, Array, Scalar, depends, elements_of, filled, plain, unwrapped
from fmu_export.trace.symbols.expressions import is_number
from fmu_export.trace.symbols.refusal import refuse

with needs("export"):
    import casadi as ca

#: Tables of np.interp with more points are data; smaller ones are written into the equations.
MOST_POINTS_INLINE = 16


@dataclass(frozen=True)
class _Entry:
    """A table of the model that is traced."""

    number: int
    table: Table

    @cached_property
    def function(self) -> ca.Function:
        """CasADi's function of the table's number and the variables, with its derivatives."""
        number, variables = ca.MX.sym("number"), [ca.MX.sym(f"v{i}") for i in range(self.table.n_variables)]
        points = [b.tolist() for b in self.table.breakpoints]
        data = ca.interpolant("data", "linear", points, self.table.values.ravel(order="F").tolist())
        clipped = [ca.fmax(ca.fmin(v, b[-1]), b[0]) for v, b in zip(variables, points, strict=True)]
        value = data(ca.vertcat(*clipped))
        arguments = [number, *variables]
        out = ca.MX.sym("out")
        names = [f"i{i}" for i in range(len(arguments))]
        jacobian = ca.Function(
            f"jac_{self.table.name}",
            [*arguments, out],
            [ca.MX(1, 1), *(ca.jacobian(value, v) for v in variables)],
            [*names, "out_o0"],
            [f"jac_o0_{name}" for name in names],
        )
        return ca.Function(
            self.table.name, arguments, [value], names, ["o0"], {"never_inline": True, "custom_jacobian": jacobian}
        )


_entries: list[_Entry] = []


def forget_tables() -> None:
    """Begin a model."""
    _entries.clear()


def tables_found() -> tuple[Table, ...]:
    """The tables of the model that was traced, in the order of their numbers."""
    return tuple(entry.table for entry in _entries)


def _entry(table: Table, is_named: bool) -> _Entry:
    for entry in _entries:
        if entry.table.has_data_of(table) and (not is_named or entry.table.name == table.name):
            return entry
        if is_named and entry.table.name == table.name:
            refuse(f"two tables with different data have the name '{table.name}'; give one another name")
    _entries.append(_Entry(len(_entries), table))
    return _entries[-1]


def _free_name() -> str:
    names = {entry.table.name for entry in _entries}
    return next(name for i in count(1) if (name := f"interp_{i}") not in names)


def _look_up(table: Table, *where: Any, is_named: bool = True) -> Any:
    if not any(depends(v) for v in where):
        return table(*(plain(v) for v in where))
    entry = _entry(table, is_named)
    bases = np.broadcast_arrays(*(elements_of(v)[0] for v in where))

    def element(*expressions: Any) -> Any:
        if all(is_number(e) for e in expressions):
            return ca.SX(float(table(*map(float, expressions))))
        return entry.function(ca.SX(number_of(entry.number, table)), *expressions)

    flat = [[e.sx for e in base.flat] for base in bases]
    base = filled([Scalar(element(*e), FLOAT) for e in zip(*flat, strict=True)], bases[0].shape)
    return unwrapped(base if base.ndim else base.item(), FLOAT)


for _kind in (Scalar, Array):
    setattr(_kind, "__look_up__", staticmethod(_look_up))  # noqa: B010


def _searchsorted(a: Any, v: Any, side: str = "left", sorter: Any = None) -> Any:
    if sorter is not None:
        refuse("np.searchsorted with sorter= can't be traced")
    if depends(a):
        refuse("np.searchsorted and np.digitize with symbols as edges can't be traced; the edges must be numbers")
    place: Any = 0
    for edge in plain(a):  # NaN is sorted behind all numbers
        place = place + (~(v <= edge) if side == "left" else ~(v < edge)) * 1
    return place


def _digitize(x: Any, bins: Any, right: bool = False) -> Any:
    side = "left" if right else "right"
    edges = bins if depends(bins) else np.asarray(plain(bins))
    if depends(bins) or np.all(np.diff(edges) >= 0.0):
        return _searchsorted(edges, x, side)
    if not np.all(np.diff(edges) <= 0.0):
        refuse("np.digitize with bins that neither grow nor fall can't be traced")
    return len(edges) - _searchsorted(edges[::-1], x, side)


def _interp(x: Any, xp: Any, fp: Any, left: Any = None, right: Any = None, period: Any = None) -> Any:
    if depends(xp) or depends(period):
        refuse("np.interp with symbols as places of its table can't be traced; the places must be numbers")
    xs, ys = np.asarray(plain(xp), dtype=float), fp if type(fp) in (Array, list, tuple) else np.asarray(fp)
    ys = np.array(ys) if isinstance(ys, list | tuple) else ys
    if xs.ndim != 1 or np.shape(ys) != xs.shape:
        refuse("np.interp needs as many values as places, along one axis")
    if period is not None:
        period = abs(float(period))
        left = right = None
        order = np.argsort(xs % period)
        x, xs = x % period, (xs % period)[order]
        ys = ys[order]
        xs = np.concatenate((xs[-1:] - period, xs, xs[:1] + period))
        ys = np.concatenate((ys[-1:], ys, ys[:1]))
    if not np.all(np.diff(xs) > 0.0):
        refuse("np.interp with places that do not grow can't be traced")
    ends = ys[0] if left is None else left, ys[-1] if right is None else right
    if len(xs) > MOST_POINTS_INLINE and not depends(ys):
        inside = _look_up(Table(_free_name(), xs, plain(ys)), x, is_named=False)
        inside = inside if left is None else np.where(x < xs[0], left, inside)
        return inside if right is None else np.where(x > xs[-1], right, inside)
    if len(xs) == 1:
        return np.where(x < xs[0], ends[0], np.where(x > xs[0], ends[1], np.where(np.isnan(x), x, ys[0])))
    slope, x0, y0 = (ys[1] - ys[0]) / (xs[1] - xs[0]), xs[0], ys[0]
    for j in range(1, len(xs) - 1):
        beyond = x >= xs[j]
        slope = np.where(beyond, (ys[j + 1] - ys[j]) / (xs[j + 1] - xs[j]), slope)
        x0, y0 = np.where(beyond, xs[j], x0), np.where(beyond, ys[j], y0)
    inside = slope * (x - x0) + y0
    return np.where(x < xs[0], ends[0], np.where(x > xs[-1], ends[1], np.where(x == xs[-1], ys[-1], inside)))


HANDLERS: dict[Any, Callable[..., Any]] = {
    np.searchsorted: _searchsorted,
    np.digitize: _digitize,
    np.interp: _interp,
}
