"""`cosim run`: couple the FMUs in a scenario or an SSP, or run a single one."""

from __future__ import annotations

import argparse
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.commands.options import (
    Standard,
    add_algorithm_options,
    add_isolation_options,
    add_iterations_option,
    add_log_options,
    add_model_exchange_options,
    add_overwrite_option,
    add_place_options,
    add_signature_option,
    standard_of,
    step_of,
    take_from_isolated,
)
from cosim.errors import SetupError
from cosim.results.figure_process import FigureProcess
from cosim.results.formats import FORMATS, option_help
from cosim.scenario.family import default_scenario, families, named

if TYPE_CHECKING:
    from cosim.commands.execution import PreparedRun

_EXAMPLES = """\
examples:
  cosim run Model.fmu --stop 10 --input inputs.csv --report
  cosim run theirs.ssp --report --out theirs
  cosim run tanks.toml --set controller.K_p=0.2 --format parquet
  cosim run tanks.toml --live --realtime 1
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim run`."""
    known = families()
    names = [name for family in known.values() for name in family.scenario_names()]
    defaults = [family.default for family in known.values() if family.default is not None]
    parser = subparsers.add_parser(
        "run",
        help="run a scenario, an SSP, an OSP configuration, or a single FMU",
        epilog=_EXAMPLES,
        description="Couple the FMUs in a scenario, an SSP or an OSP configuration, or run a single FMU. Scenarios: "
        f"{', '.join([*names, 'or a TOML file'])}.",
    )
    parser.add_argument(
        "scenario",
        nargs="?",
        help="name of a scenario, or path of a TOML file, an SSP, a folder with SystemStructure.ssd or "
        "OspSystemStructure.xml, one of these files, or an FMU"
        + (f" (default {defaults[0]})" if len(defaults) == 1 else ""),
    )
    parser.add_argument(
        "--fmu",
        action="append",
        default=[],
        metavar="COMPONENT=FILE",
        help="FMU of your own for a component, as controller=PID.fmu; may be repeated",
    )
    parser.add_argument(
        "--build", action="store_true", help="compile the C sources of FMUs that have no binary for this machine"
    )
    parser.add_argument(
        "--step",
        type=step_of,
        metavar="H|variable",
        help="communication step in s; variable: as long as the coupling tolerance allows (1e-4 by default)",
    )
    parser.add_argument("--start", type=float, metavar="T", help="start time in s")
    parser.add_argument("--stop", type=float, metavar="T", help="stop time in s")
    parser.add_argument(
        "--tolerance",
        type=float,
        metavar="T",
        help="relative tolerance that the FMUs are told (default: that of each one's default experiment)",
    )
    add_algorithm_options(parser)
    add_model_exchange_options(parser)
    add_iterations_option(parser)
    parser.add_argument(
        "--coupling-tolerance",
        type=float,
        metavar="TOL",
        help="find the longest communication step whose coupling error, relative to the largest magnitude of each "
        "variable, stays below TOL; --step is where the search begins",
    )
    parser.add_argument(
        "--threads",
        metavar="N",
        help="threads that step components at the same time; auto: as many as save time (default 1); equal results",
    )
    add_isolation_options(parser)
    add_place_options(parser)
    parser.add_argument(
        "--profile", action="store_true", help="report how long the steps and the exchange of each component took"
    )
    parser.add_argument("--record", action="append", metavar="NAME", help="record this variable only; may be repeated")
    parser.add_argument("--record-every", type=int, metavar="N", help="record at every N-th communication point")
    parser.add_argument(
        "--format",
        action="append",
        choices=FORMATS,
        help=option_help(),
    )
    parser.add_argument(
        "--units-row", action="store_true", help="write the units into CSV results, in a row below the names"
    )
    parser.add_argument(
        "--report", action="store_true", help="write a page about the run, report.html, among the results"
    )
    parser.add_argument(
        "--realtime", type=float, metavar="FACTOR", help="pace the run: simulated seconds in a second (1: real time)"
    )
    parser.add_argument(
        "--live",
        action="store_true",
        help="show the run live in a page that this machine serves, from which it can be steered",
    )
    parser.add_argument(
        "--checkpoint",
        type=float,
        metavar="EVERY",
        help="save the state of the run in the folder of the results, every EVERY simulated seconds and at Ctrl-C",
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="resume from the checkpoint in the folder of the results; the results are equal to the last bit",
    )
    parser.add_argument(
        "--nonfinite",
        choices=("error", "mark"),
        default="mark",
        help="a recorded output that is NaN or infinite ends the run (error), or the summary says which one, and from "
        "when on (mark, the default); one that feeds another component always ends it",
    )
    add_signature_option(parser)
    add_log_options(parser)
    parser.add_argument("--seed", type=int, help="seed of the random signals")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the results (default results/<scenario>)")
    add_overwrite_option(parser)
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="COMPONENT.NAME=VALUE",
        help="start value of a variable, as controller.alpha=2: a number, true or false, an item of an enumeration, a "
        "text, or numbers of a vector, as controller.S=2,2,3; may be repeated",
    )
    parser.add_argument(
        "--input",
        type=Path,
        metavar="FILE",
        help="inputs of a single FMU: a table (CSV, Parquet, MAT, .npz, JSON) with the time and columns of their names",
    )
    parser.add_argument(
        "--ssv",
        action="append",
        default=[],
        metavar="[COMPONENT=]FILE",
        help="parameter set (SSV) for an SSP, beside its own or, as SOURCE=FILE, in place of one; may be repeated",
    )
    parser.add_argument(
        "--units",
        choices=("convert", "ignore"),
        help="what an SSP or OSP configuration does where units differ: convert the values (default for SSPs), or take "
        "the numbers as they are (default for OSP)",
    )
    options = {}
    for name, family in known.items():
        group = parser.add_argument_group(f"scenarios of {name}", family.system)
        family.add_options(group)
        options[name] = {action.option_strings[0]: action.dest for action in group._group_actions}
    parser.set_defaults(run=run, runs_fmus=True, family_options=options)


def run(args: argparse.Namespace) -> int:
    """Run `cosim run`; returns the exit code, raises CosimError with one line on bad input."""
    if args.scenario is None:
        behind = take_from_isolated(args, lambda text: named(text) is not None or Path(text).is_dir())
        if len(behind) > 1:
            raise SetupError(f"--isolated {' '.join(behind)}: name one scenario, and components, which have no dot")
        args.scenario = behind[0] if behind else default_scenario()
    ending = Path(args.scenario).suffix.lower()
    standard = None if ending == ".fmu" or named(args.scenario) is not None else standard_of(args.scenario)
    with FigureProcess() as figures:
        if args.realtime is None:  # its start would make the first points late
            found = named(args.scenario)
            figures.start("" if found is None else found[0].drawing)
        # NumPy and FMPy take a while to import, meanwhile the other process imports matplotlib
        from cosim.commands.execution import run_prepared

        with _prepared(ending, standard, args) as prepared:
            return run_prepared(prepared, args, figures)


def _prepared(ending: str, standard: Standard | None, args: argparse.Namespace) -> AbstractContextManager[PreparedRun]:
    if standard is not None:
        from cosim.commands.run_ssp import prepared_description

        return prepared_description(args, standard)
    from cosim.commands.execution import refuse

    refuse({"--ssv": args.ssv, "--units": args.units}, "is for SSPs and OSP configurations")
    if ending == ".fmu":
        from cosim.commands.run_fmu import prepared_fmu

        return prepared_fmu(args)
    from cosim.commands.run_scenario import prepared_scenario

    return prepared_scenario(args)
