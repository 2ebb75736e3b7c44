"""Options that several commands have in common."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cosim.errors import SetupError, nearest
from cosim.files.kinds import MODEL_DESCRIPTION, SSD, SSV, kind_of, not_read
from cosim.fmi.interfaces import INTERFACES
from cosim.fmi.isolation.limits import Limits, parse_bytes
from cosim.fmi.message_log import LEVELS, Log
from cosim.master.coupling.algorithm import AUTO, EXTRAPOLATIONS, LOOPS, ORDERS, SOLVERS, VARIABLE

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
        help=f"inputs between communication points: {AUTO} (in sequential order adaptive where the FMUs can, "
        f"else linear, else hold), {extrapolations}",
    )


def add_model_exchange_options(parser: argparse._ActionsContainer) -> None:
    """Add --interface, --solver and --solver-step; what is not given is None, or empty."""
    parser.add_argument(
        "--interface",
        action="append",
        default=[],
        metavar="[COMPONENT=]INTERFACE",
        help=f"interface of the FMUs, or of that of a component: {', '.join(INTERFACES)} (default auto: co-simulation "
        "where an FMU has it, else model exchange); components in model exchange are integrated together and coupled "
        "exactly; may be repeated",
    )
    parser.add_argument(
        "--solver",
        choices=SOLVERS,
        help="what integrates components in model exchange: rk4 (fixed step), dopri5 (error control by the tolerance), "
        "cvode (stiff equations), auto (default: rk4 where model exchange was chosen, dopri5 where an FMU has nothing "
        "else)",
    )
    parser.add_argument(
        "--solver-step",
        type=float,
        metavar="H",
        help="step of rk4 in s, which divides the communication step (default: that step)",
    )


def step_of(text: str) -> float | str:
    """A communication step (s), or that it is variable, as an option gives it."""
    if text == VARIABLE:
        return text
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a number (s) nor '{VARIABLE}'") from None


def _iterations(text: str) -> int | str:
    if text in (AUTO, LOOPS):
        return text
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a whole number nor '{AUTO}' or '{LOOPS}'") from None


def add_iterations_option(parser: argparse._ActionsContainer) -> None:
    """Add --iterations; None where it is not given."""
    parser.add_argument(
        "--iterations",
        type=_iterations,
        metavar="N|auto|loops",
        help="solve algebraic loops at the start and at each communication point, and repeat each step until inputs "
        "agree with the outputs at its end, by N iterations at most (auto: 50; loops: no step is repeated); by default "
        "a system with an algebraic loop is refused",
    )


def chosen_interfaces(texts: Sequence[str], components: Collection[str]) -> dict[str, str]:
    """Interfaces of components by options [COMPONENT=]INTERFACE; those that name a component count more.

    Raises
    ------
    SetupError
        An option is written otherwise, names no component, or no interface.
    """
    found: dict[str, str] = {}
    for text in sorted(texts, key=lambda text: "=" in text):
        component, equals, interface = text.rpartition("=")
        if interface not in INTERFACES:
            raise SetupError(
                f"--interface {text}: there is no interface '{interface}'; {nearest(interface, INTERFACES)}"
            )
        if equals and component not in components:
            raise SetupError(
                f"--interface {text}: there is no component '{component}'; {nearest(component, components)}"
            )
        found |= {component: interface} if equals else dict.fromkeys(components, interface)
    return found


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
        help="replace files that have the names of results but belong to no run, and remove what killed runs left",
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


def add_isolation_options(parser: argparse._ActionsContainer) -> None:
    """Add --isolated, --step-timeout and --memory-limit; what is not given is None."""
    parser.add_argument(
        "--isolated",
        action="append",
        nargs="?",
        const="",
        metavar="COMPONENT",
        help="run the FMUs in processes of their own, or that of a component: one that crashes, ends its process or "
        "never returns ends the run with what was recorded; may be repeated",
    )
    add_limit_options(parser)


def add_place_options(parser: argparse._ActionsContainer) -> None:
    """Add --place and --scheduler."""
    parser.add_argument(
        "--place",
        action="append",
        default=[],
        metavar="COMPONENT=PLACE",
        help="run the FMU of a component in a process on another machine: that of a worker of a Dask cluster, by its "
        "address or by a resource that it has; may be repeated",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="scheduler of the Dask cluster that places belong to (default: that of Dask's configuration)",
    )


def chosen_places(texts: Sequence[str], components: Collection[str]) -> dict[str, str]:
    """Places of components by options COMPONENT=PLACE.

    Raises
    ------
    SetupError
        An option is written otherwise, or names no component.
    """
    found: dict[str, str] = {}
    for text in texts:
        component, equals, place = text.partition("=")
        if not (component and equals and place):
            raise SetupError(f"--place {text}: write COMPONENT=PLACE, as plant=tcp://10.0.0.2:40001")
        if component not in components:
            raise SetupError(f"--place {text}: there is no component '{component}'; {nearest(component, components)}")
        found[component] = place
    return found


def add_limit_options(parser: argparse._ActionsContainer) -> None:
    """Add --step-timeout and --memory-limit."""
    parser.add_argument(
        "--step-timeout",
        type=float,
        metavar="S",
        help="end a run in which a call of an isolated FMU takes longer than S seconds (default: never)",
    )
    parser.add_argument(
        "--memory-limit",
        metavar="BYTES",
        help="memory that each isolated FMU may take, as 500M or 2G (default: no limit)",
    )


@dataclass(frozen=True)
class IsolationOptions:
    """Which FMUs live in processes of their own, and their limits; see `Simulation`."""

    isolate: bool | tuple[str, ...] = False
    limits: Limits | None = None

    @classmethod
    def of(cls, args: argparse.Namespace) -> IsolationOptions:
        """Those that options ask for.

        Raises
        ------
        SetupError
            A limit makes no sense.
        """
        named = tuple(args.isolated or ())
        memory = None if args.memory_limit is None else parse_bytes(args.memory_limit)
        limits = None if (args.step_timeout, memory) == (None, None) else Limits(args.step_timeout, memory)
        return cls(True if "" in named else named or False, limits)


def take_from_isolated(args: argparse.Namespace, is_one: Callable[[str], bool]) -> list[str]:
    """What stands behind --isolated and is not a component: files, and names that a function knows.

    A component has no dot in its name, and a file mostly has one.
    """
    given: list[str] = args.isolated or []
    taken = [text for text in given if "." in text or "/" in text or os.sep in text or is_one(text)]
    args.isolated = ["" if text in taken else text for text in given] or None
    return taken


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
