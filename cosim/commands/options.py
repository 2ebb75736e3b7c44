"""Options that several commands have in common."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

from cosim.errors import SetupError
from cosim.file_kinds import MODEL_DESCRIPTION, SSD, SSV, kind_of, not_read
from cosim.fmi.message_log import LEVELS, Log
from cosim.master.algorithm import AUTO, EXTRAPOLATIONS, ORDERS

#: Name of the log among the results.
LOG_FILE = "messages.log"

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


def add_log_options(parser: argparse._ActionsContainer) -> None:
    """Add --log and --log-categories; what is not given is None."""
    parser.add_argument(
        "--log",
        choices=tuple(LEVELS),
        metavar="LEVEL",
        help=f"write what the FMUs say into {LOG_FILE} among the results: {', '.join(LEVELS)} ('all' asks the FMUs to "
        "say all that they can; default none)",
    )
    parser.add_argument(
        "--log-categories",
        type=lambda text: [name for part in text.split(",") if (name := part.strip())],
        metavar="NAME,...",
        help="log these categories of the FMUs only, and errors; FMUs that have them are asked for them",
    )


def add_overwrite_option(parser: argparse._ActionsContainer) -> None:
    """Add --overwrite, for commands that write into a `ResultFolder`."""
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="replace files of the names of results that belong to no run, and remove what runs left that were killed",
    )


def add_signature_option(parser: argparse._ActionsContainer) -> None:
    """Add --require-signed."""
    parser.add_argument(
        "--require-signed",
        action="append",
        default=[],
        type=Path,
        metavar="KEY",
        help="run only FMUs, or an SSP, that the owner of this public key has signed (cosim sign); may be repeated",
    )


def check_signatures(keys: Sequence[Path], archives: Iterable[Path]) -> None:
    """Check, where keys are required, that archives are signed with one of them.

    Raises
    ------
    CosimError
        One is not.
    """
    if keys:
        from cosim.signing import check_signed

        check_signed(archives, keys)


def log_options(args: argparse.Namespace, folder: Path) -> Log | None:
    """The log that options ask for, in a folder; None where they ask for none.

    Raises
    ------
    SetupError
        Categories are given with the level 'none'.
    """
    if args.log is None and not args.log_categories:
        return None
    log = Log(args.log or "info", tuple(args.log_categories or ()), folder / LOG_FILE)
    return None if log.level == "none" else log


def standard_of(text: str) -> Standard | None:
    """The standard of what a user names: an SSP, a description, or a folder; None where it is none of them.

    Raises
    ------
    SetupError
        It is an XML file of another kind.
    """
    path = Path(text)
    ending = path.suffix.lower()
    if ending in (".ssp", ".ssd"):
        return "ssp"
    if ending == ".xml" and kind_of(path) in (SSD, SSV, MODEL_DESCRIPTION):
        raise SetupError(not_read(path, "an OSP configuration", ""))
    if ending == ".xml" or (path / "OspSystemStructure.xml").is_file():
        return "osp"
    return "ssp" if path.is_dir() else None
