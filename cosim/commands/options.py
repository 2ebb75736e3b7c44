"""Options that several commands have in common."""

from __future__ import annotations

import argparse

from cosim.master.algorithm import AUTO, EXTRAPOLATIONS, ORDERS


def add_algorithm_options(parser: argparse._ActionsContainer) -> None:
    """Add --order and --extrapolation; what is not given is None."""
    orders = ", ".join(f"{order.name} ({order.known_as})" for order in ORDERS.values())
    extrapolations = ", ".join(f"{each.name} ({each.known_as})" for each in EXTRAPOLATIONS.values())
    parser.add_argument("--order", choices=tuple(ORDERS), help=f"order of the value exchange: {orders}")
    parser.add_argument(
        "--extrapolation",
        "--coupling",
        choices=(AUTO, *EXTRAPOLATIONS),
        help=f"inputs between communication points: {AUTO} (linear where the FMU can, else hold), {extrapolations}",
    )
