"""What an implicit method needs of a model: its Jacobian, and tables for the LU factors of shift I - Jacobian."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

from fmu_export.errors import needs
from fmu_export.native.elimination import Elimination, eliminate
from fmu_export.trace.trace import TracedModel

with needs("export"):
    import casadi as ca

#: Operations of a Jacobian that are written out at most; more of them are those of directions, one after the other.
MOST_WRITTEN = 200_000


@dataclass(frozen=True)
class ImplicitParts:
    """The derivatives of a model's derivatives, analytic and traced, and how a linear system with them is solved.

    Parameters
    ----------
    jacobian : casadi.Function
        (t, x, u, p) -> what is not zero of the derivatives by the states, in the order of its places in the factors;
        or, with `colours`, (t, x, u, p, dx) -> their change along a direction (n_x,).
    time_derivative : casadi.Function
        (t, x, u, p, u_rate) -> the derivatives by the time (n_x,), with inputs that change at u_rate.
    elimination : Elimination
        Of shift I - Jacobian.
    places : tuple of int
        Where each entry of the Jacobian is among the factors; ascending.
    colours : tuple of int
        Colour of each state, where columns of the Jacobian that have no row in common are computed together, as one
        direction; empty where all entries are written out.
    """

    jacobian: ca.Function
    time_derivative: ca.Function
    elimination: Elimination
    places: tuple[int, ...]
    colours: tuple[int, ...]

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Sizes of the tables, by their name in C."""
        return {
            "N_JACOBIAN": len(self.places),
            "N_FACTORS": len(self.elimination.columns),
            "N_COLOURS": max(self.colours, default=-1) + 1,
        }

    @cached_property
    def tables(self) -> dict[str, tuple[int, ...]]:
        """The tables of indices, by their declaration in C."""
        return {
            "model_pivots[N_X]": self.elimination.pivots,
            "model_factor_rows[N_X + 1]": self.elimination.row_starts,
            "model_factor_columns[N_FACTORS]": self.elimination.columns,
            "model_factor_diagonal[N_X]": self.elimination.diagonal,
            "model_jacobian_places[N_JACOBIAN + 1]": (*self.places, 0),
            **({"model_colours[N_X]": self.colours} if self.colours else {}),
        }


def implicit_parts(traced: TracedModel) -> ImplicitParts:
    """Differentiate the derivatives of a model with states, and plan the elimination."""
    arguments = traced.derivatives.sx_in()
    t, x, u, *_ = arguments
    u_rate, dx = ca.SX.sym("u_rate", u.numel()), ca.SX.sym("dx", x.numel())
    rates = traced.derivatives(*arguments)
    pattern = traced.derivatives.jac_sparsity(0, 1)
    entries = list(zip(*pattern.get_triplet(), strict=True))
    elimination = eliminate(x.numel(), entries)
    places = elimination.places(entries)
    order = sorted(range(len(places)), key=places.__getitem__)
    direction = _function("rates_direction", [*arguments, dx], [ca.jtimes(rates, x, dx)])
    colours = _colours(pattern)
    if (max(colours) + 1) * direction.n_instructions() > MOST_WRITTEN:
        jacobian = direction
    else:
        matrix = ca.project(ca.jacobian(rates, x), pattern)
        jacobian, colours = _function("jacobian", arguments, [matrix.nz[k] for k in order]), ()
    change = ca.jtimes(rates, ca.vertcat(t, u), ca.vertcat(1.0, u_rate))
    return ImplicitParts(
        jacobian,
        _function("time_derivative", [*arguments, u_rate], [change]),
        elimination,
        tuple(places[k] for k in order),
        colours,
    )


def _colours(pattern: ca.Sparsity) -> tuple[int, ...]:
    """A colour (from 0) for each column, so that columns of one colour have no row in common."""
    groups = pattern.uni_coloring(pattern.T)
    colours = [0] * pattern.size2()
    for column, colour in zip(*groups.get_triplet(), strict=True):
        colours[column] = colour
    return tuple(colours)


def _function(name: str, arguments: Iterable[ca.SX], values: Iterable[ca.SX]) -> ca.Function:
    return ca.Function(name, list(arguments), [ca.densify(ca.cse(ca.vertcat(ca.SX(0, 1), *values)))])
