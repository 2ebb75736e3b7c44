"""Options that several commands have in common."""

from __future__ import annotations

import argparse

from cosim.choices import EXTRAPOLATIONS, ORDERS


def add_algorithm_options(parser: argparse._ActionsContainer) -> None:
    """Add --order and --extrapolation; what is not given is None."""
    orders = ", ".join(f"{name} ({also})" for name, also in ORDERS.items())
    extrapolations = ", ".join(f"{name} ({also})" for name, also in EXTRAPOLATIONS.items())
    parser.add_argument("--order", choices=tuple(ORDERS), help=f"order of the value exchange: {orders}")
    parser.add_argument(
        "--extrapolation",
        "--coupling",
        choices=tuple(EXTRAPOLATIONS),
        help=f"inputs between communication points: {extrapolations}",
    )
