"""`cosim run FILE.ssp`: an SSP, of any system."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from cosim.commands.execution import Plan, PreparedRun, UsageError, refuse, results_folder, with_start_values
from cosim.errors import CosimError
from cosim.ssp.reader import ReadSystem, read_ssp


@contextmanager
def prepared_ssp(args: argparse.Namespace) -> Iterator[PreparedRun]:
    """The run of an SSP with the options of the command line.

    Raises
    ------
    CosimError
        The SSP is malformed, or an option makes no sense.
    """
    path = Path(args.scenario)
    further = {option: getattr(args, dest) for known in args.family_options.values() for option, dest in known.items()}
    refuse(
        {**further, "--fmu": args.fmu, "--seed": args.seed},
        f"is for scenarios; {path} has its own FMUs and no signals",
    )
    refuse({"--input": args.input}, "is for a single FMU; an SSP has no signals")
    folder = results_folder(args, path.stem)
    # an FMU whose library is still in use can't be removed on Windows; that must not hide the results
    with TemporaryDirectory(prefix="cosim_ssp_", ignore_cleanup_errors=True) as unpacked:

        def in_archive(text: str) -> str:
            """A text in which files in the archive are not named after the folder that they were unpacked to."""
            return text.replace(f"{unpacked}{os.sep}", f"{path}: ")

        try:
            found = read_ssp(path, Path(unpacked))
            for note in found.notes:
                print(f"note: {note}")
            yield PreparedRun(
                source=str(path),
                title=found.name,
                plan=_plan(found, path, args),
                system=with_start_values(found.system, args.set, "disconnect it in the SSP"),
                folder=folder,
                about={"ssp": str(path), "title": found.name},
                said_path=in_archive,
            )
        except CosimError as error:
            raise CosimError(in_archive(str(error))) from error


def _plan(found: ReadSystem, path: Path, args: argparse.Namespace) -> Plan:
    stop_time = found.stop_time if args.stop is None else args.stop
    step_size = found.step_size if args.step is None else args.step
    if stop_time is None:
        raise UsageError(f"{path} has no default stop time; give one with --stop")
    if step_size is None:
        raise UsageError(f"neither {path} nor its FMUs have a default step; give one with --step")
    start_time = found.start_time if args.start is None else args.start
    return Plan.from_options(args, stop_time, step_size, start_time)
