"""`cosim run FILE.ssp`: an SSP or an OSP configuration, of any system."""

from __future__ import annotations

import argparse
import dataclasses
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cosim.commands.execution import (
    Plan,
    PreparedRun,
    refuse,
    results_folder,
    with_interfaces,
    with_start_values,
)
from cosim.commands.options import Standard
from cosim.errors import CosimError
from cosim.files.temporary import TemporaryFolder
from cosim.results.figure_process import DRAWING
from cosim.system.read import DURATION, ReadSystem


@contextmanager
def prepared_description(args: argparse.Namespace, standard: Standard) -> Iterator[PreparedRun]:
    """The run of an SSP or an OSP configuration with the options of the command line.

    Raises
    ------
    CosimError
        It is malformed, or an option makes no sense.
    """
    path = Path(args.scenario)
    further = {option: getattr(args, dest) for known in args.family_options.values() for option, dest in known.items()}
    refuse(
        {**further, "--fmu": args.fmu, "--seed": args.seed},
        f"is for scenarios; {path} has its own FMUs and no signals",
    )
    refuse({"--input": args.input}, "is for a single FMU; an SSP has no signals")
    folder = results_folder(args, path.resolve().stem if path.is_dir() else path.stem)
    with TemporaryFolder("ssp") as unpacked:

        def in_archive(text: str) -> str:
            """A text in which files in the archive are not named after the folder that they were unpacked to."""
            return text.replace(f"{unpacked}{os.sep}", f"{path}: ")

        try:
            found = read_description(path, standard, Path(unpacked), args, args.start, DURATION)
            for note in found.notes:
                print(f"note: {in_archive(note)}")
            yield PreparedRun(
                source=str(path),
                title=found.name,
                plan=_plan(found, args),
                system=with_interfaces(
                    with_start_values(found.system, args.set, f"disconnect it in the {standard.upper()}"),
                    args.interface,
                ),
                folder=folder,
                about={standard: str(path), "title": found.name},
                details={
                    "notes": [in_archive(note) for note in found.notes],
                    **({"places": dict(found.places)} if found.places else {}),
                },
                archive_of=lambda fmu: path if fmu.is_relative_to(unpacked) else fmu,
                said_path=in_archive,
                drawing=DRAWING,
                drawing_arguments=(found.name,),
            )
        except CosimError as error:
            raise CosimError(in_archive(str(error))) from error


def read_description(
    path: Path,
    standard: Standard,
    unpacked: Path,
    args: argparse.Namespace,
    start_time: float | None = None,
    duration: float | None = None,
) -> ReadSystem:
    """The system of an SSP or an OSP configuration, whose FMUs are unpacked into a folder.

    Parameters
    ----------
    path, unpacked : Path
        Of the description, and of the folder.
    standard : Standard
    args : argparse.Namespace
        Options of the command line.
    start_time : float, optional
        In place of that of the description (s).
    duration : float, optional
        How long the run is (s) where nothing says when it stops.

    Raises
    ------
    CosimError
        It is malformed, or an option makes no sense.
    """
    step_size = _fixed(args.step)
    if standard == "osp":
        from cosim.osp.reader import read_osp

        refuse({"--ssv": args.ssv}, "is for SSPs; an OSP configuration takes start values by --set")
        return read_osp(
            path,
            units=args.units or "ignore",
            step_size=step_size,
            start_time=start_time,
            stop_time=args.stop,
            duration=duration,
        )
    from cosim.ssp.reader import read_ssp

    return read_ssp(
        path,
        unpacked,
        parameter_sets=args.ssv,
        units=args.units or "convert",
        step_size=step_size,
        start_time=start_time,
        stop_time=args.stop,
        duration=duration,
    )


def _fixed(step: float | str | None) -> float | None:
    """The step that intervals of components are multiples of; none where it is variable."""
    return None if isinstance(step, str) else step


def _plan(found: ReadSystem, args: argparse.Namespace) -> Plan:
    step_size = found.step_size if args.step is None else args.step
    assert found.stop_time is not None  # which is assumed, if nothing says it
    assert step_size is not None
    plan = Plan.from_options(args, found.stop_time, step_size, found.start_time)
    order, extrapolation = args.order or found.order, args.extrapolation or found.extrapolation
    return dataclasses.replace(plan, order=order, extrapolation=extrapolation)
