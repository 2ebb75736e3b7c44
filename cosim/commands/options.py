"""Options that several commands have in common."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Literal

from cosim.master.algorithm import AUTO, EXTRAPOLATIONS, ORDERS

#: Standard of a description of a system: SSP, or that of the Open Simulation Platform.
Standard = Literal["ssp", "osp"]


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


def standard_of(text: str) -> Standard | None:
    """The standard of what a user names: an SSP, a description, or a folder; None where it is none of them."""
    path = Path(text)
    ending = path.suffix.lower()
    if ending in (".ssp", ".ssd"):
        return "ssp"
    if ending == ".xml" or (path / "OspSystemStructure.xml").is_file():
        return "osp"
    return "ssp" if path.is_dir() else None
