"""`cosim run`: couple the FMUs in a scenario or an SSP."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cosim.results.formats import FORMATS, option_help
from parallel_robot.choices import FLAVOURS, scenario_names
from parallel_robot.figure_process import FigureProcess


def register(subparsers: Any) -> None:
    """Add the parser of `cosim run`."""
    parser = subparsers.add_parser(
        "run",
        help="run a scenario of the coupled FMUs, or an SSP",
        description=f"Couple the FMUs in a scenario. Scenarios: {', '.join(scenario_names())}, or a TOML file. Or "
        "couple those in an SSP, of any system.",
    )
    parser.add_argument("scenario", nargs="?", default="tracking", help="name or path (default %(default)s)")
    parser.add_argument(
        "--flavour", choices=FLAVOURS, help="default fmi2; pythonfmu where there is no C compiler to build it"
    )
    parser.add_argument("--fmus", type=Path, default=Path("fmus"), metavar="DIR", help="FMU folder (default fmus)")
    parser.add_argument(
        "--fmu",
        action="append",
        default=[],
        metavar="INSTANCE=FILE",
        help="FMU of your own for an instance, as controller=PID.fmu; may be repeated",
    )
    parser.add_argument("--step", type=float, metavar="H", help="communication step in s")
    parser.add_argument("--stop", type=float, metavar="T", help="stop time in s")
    parser.add_argument("--order", choices=("sequential", "parallel"), help="order of the value exchange")
    parser.add_argument(
        "--coupling",
        choices=("auto", "hold", "linear"),
        default="auto",
        help="inputs between communication points: held, or linear (auto: linear where the FMU can)",
    )
    parser.add_argument("--record", action="append", metavar="NAME", help="record this variable only; may be repeated")
    parser.add_argument(
        "--record-every", type=int, default=1, metavar="N", help="record at every N-th communication point"
    )
    parser.add_argument(
        "--format",
        action="append",
        choices=FORMATS,
        help=option_help(),
    )
    parser.add_argument(
        "--realtime", type=float, metavar="FACTOR", help="pace the run: simulated seconds in a second (1: real time)"
    )
    parser.add_argument("--seed", type=int, help="seed of the random signals")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the results (default results/<scenario>)")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="INSTANCE.NAME=VALUE",
        help="start value of a variable, as controller.alpha=2; may be repeated",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `cosim run`; returns the exit code, raises CosimError with one line on bad input."""
    if args.scenario.lower().endswith(".ssp"):
        from cosim.commands.run_ssp import run_ssp

        return run_ssp(args)
    with FigureProcess() as figures:
        if args.realtime is None:  # its start would make the first points late
            figures.start()
        # NumPy and FMPy take a while to import, meanwhile the other process imports matplotlib
        from cosim.commands.run_scenario import run_scenario

        return run_scenario(args, figures)
