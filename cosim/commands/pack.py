"""`cosim pack`: a system as one FMU."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.commands.options import add_algorithm_options, add_signature_option, check_signatures, standard_of
from cosim.errors import CosimError
from cosim.files.temporary import TemporaryFolder
from cosim.master.coupling.algorithm import fixed
from cosim.scenario.family import families
from cosim.system.system import System

_EXAMPLES = """\
examples:
  cosim pack tanks.toml --out Tanks.fmu
  cosim pack theirs.ssp --out Theirs.fmu --fmi 3 --outputs plant.x plant.y
  cosim pack tanks.toml --out Tanks.fmu --platforms all
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim pack`."""
    parser = subparsers.add_parser(
        "pack",
        help="pack a system into one FMU",
        epilog=_EXAMPLES,
        description="Write a scenario, an SSP or an OSP configuration as one FMU for co-simulation that needs no "
        "Python: its FMUs, their couplings and the compiled stepping loop.",
    )
    parser.add_argument("scenario", metavar="SYSTEM", help="TOML file or name of a scenario, SSP, or OSP configuration")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="FMU file to be written")
    parser.add_argument(
        "--fmi", type=int, choices=(2, 3), default=2, help="version of FMI of the packed FMU (default 2)"
    )
    parser.add_argument(
        "--step",
        type=float,
        metavar="H",
        help="longest internal communication step in s, the start of the parameter max_step (default: the system's)",
    )
    parser.add_argument(
        "--inputs",
        nargs="*",
        metavar="COMPONENT.NAME",
        help="inputs of the packed FMU (default: all that nothing feeds)",
    )
    parser.add_argument(
        "--outputs",
        nargs="*",
        metavar="COMPONENT.NAME",
        help="outputs of the packed FMU: outputs and local variables of components (default: all outputs)",
    )
    parser.add_argument(
        "--platforms",
        nargs="+",
        metavar="PLATFORM",
        help="platforms as x86_64-linux, compiled by zig (pip install ziglang), or 'all' that the FMUs allow (default: "
        "this machine, without a compiler)",
    )
    add_algorithm_options(parser)
    parser.add_argument("--start", type=float, metavar="T", help="start time of the default experiment in s")
    parser.add_argument("--stop", type=float, metavar="T", help="stop time of the default experiment in s")
    parser.add_argument("--tolerance", type=float, metavar="T", help="relative tolerance of the default experiment")
    parser.add_argument("--name", help="name of the model (default: that of the file)")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="COMPONENT.NAME=VALUE",
        help="start value of a variable, as controller.alpha=2; may be repeated",
    )
    parser.add_argument(
        "--fmu",
        action="append",
        default=[],
        metavar="COMPONENT=FILE",
        help="FMU of your own for a component of a scenario; may be repeated",
    )
    parser.add_argument("--seed", type=int, help="seed of the random signals of a scenario")
    parser.add_argument(
        "--ssv",
        action="append",
        default=[],
        metavar="[COMPONENT=]FILE",
        help="parameter set (SSV) for an SSP; may be repeated",
    )
    parser.add_argument(
        "--units", choices=("convert", "ignore"), help="what an SSP or OSP configuration does where units differ"
    )
    add_signature_option(parser)
    options = {}
    for name, family in families().items():
        group = parser.add_argument_group(f"scenarios of {name}", family.system)
        family.add_options(group)
        options[name] = {action.option_strings[0]: action.dest for action in group._group_actions}
    of_runs = dict.fromkeys(("input", "record", "record_every", "solver", "solver_step", "iterations"))
    parser.set_defaults(run=run, family_options=options, interface=[], **of_runs)


@dataclass(frozen=True)
class _Read:
    """A system as it was read, with what there is of its run: times (s), algorithm, tolerance."""

    title: str
    system: System
    step_size: float | None
    start_time: float
    stop_time: float | None
    order: str
    extrapolation: str
    tolerance: float | None


def run(args: argparse.Namespace) -> int:
    """Run `cosim pack`; returns the exit code, raises CosimError with one line on bad input."""
    from cosim.commands.execution import UsageError  # NumPy and FMPy take a while to import
    from cosim.pack import pack

    if args.out.suffix.lower() != ".fmu":
        raise UsageError(f"--out {args.out}: the name of an FMU ends with .fmu")
    with _reading(args) as read:
        if read.step_size is None:
            raise UsageError(f"neither {args.scenario} nor its FMUs have a default step; give one with --step")
        packed = pack(
            read.system,
            args.out,
            read.step_size,
            fmi=args.fmi,
            order=read.order,
            extrapolation=read.extrapolation,
            inputs=args.inputs,
            outputs=args.outputs,
            platforms=args.platforms,
            start_time=read.start_time,
            stop_time=read.stop_time,
            tolerance=read.tolerance,
            name=args.name,
            description=read.title,
        )
    for note in packed.notes:
        print(f"note: {note}")
    size = packed.path.stat().st_size / 1024
    print(
        f"{packed.path}  {size:.0f} kB, FMI {args.fmi}.0 for {', '.join(packed.platforms)}: "
        f"{len(packed.inputs)} inputs, {len(packed.outputs)} outputs, {len(packed.parameters)} parameters"
    )
    return 0


@contextmanager
def _reading(args: argparse.Namespace) -> Iterator[_Read]:
    """The system that a user names; its FMUs are there as long as the context."""
    from cosim.commands.execution import refuse, with_start_values

    standard = standard_of(args.scenario)
    if standard is None:
        from cosim.commands.run_scenario import scenario_of, system_of

        refuse({"--ssv": args.ssv, "--units": args.units}, "is for SSPs and OSP configurations")
        scenario, family = scenario_of(args)
        scenario, system = system_of(scenario, family, args)
        check_signatures(args.require_signed, _fmus(system))
        yield _Read(
            scenario.title,
            system,
            fixed(scenario.step_size, "a packed system takes"),
            scenario.start_time,
            scenario.stop_time,
            *(scenario.order, scenario.extrapolation, scenario.tolerance),
        )
        return
    from cosim.commands.run_ssp import read_description

    further = {option: getattr(args, dest) for known in args.family_options.values() for option, dest in known.items()}
    refuse({**further, "--fmu": args.fmu, "--seed": args.seed}, "is for scenarios")
    path = Path(args.scenario)
    with TemporaryFolder("ssp") as unpacked:
        try:
            found = read_description(path, standard, Path(unpacked), args)
            brought = [path if fmu.is_relative_to(unpacked) else fmu for fmu in _fmus(found.system)]
            check_signatures(args.require_signed, brought)
            for note in found.notes:
                print(f"note: {note}")
            yield _Read(
                found.name,
                with_start_values(found.system, args.set, f"disconnect it in the {standard.upper()}"),
                found.step_size if args.step is None else args.step,
                found.start_time if args.start is None else args.start,
                found.stop_time if args.stop is None else args.stop,
                args.order or "sequential",
                args.extrapolation or "auto",
                args.tolerance,
            )
        except CosimError as error:
            raise CosimError(str(error).replace(f"{unpacked}{os.sep}", f"{path}: ")) from error


def _fmus(system: System) -> list[Path]:
    return [component.fmu for component in system.components.values() if component.fmu is not None]
