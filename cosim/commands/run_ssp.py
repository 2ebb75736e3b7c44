"""`cosim run FILE.ssp`: couple the FMUs in an SSP, of any system, write results and summary."""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cosim.commands.execution import Plan, UsageError, check_overrides, execute, in_words, start_value
from cosim.errors import CosimError, SetupError, nearest
from cosim.master.failures import SimulationError, SimulationInterrupted
from cosim.output import OutputError, check_writable, write_json, write_somewhere
from cosim.results.results import Results
from cosim.results.stored import StoredResults
from cosim.ssp.reader import ReadSystem, read_ssp
from cosim.system.system import System
from cosim.versions import versions


def run_ssp(args: argparse.Namespace) -> int:
    """Run `cosim run FILE.ssp`; returns the exit code, raises CosimError with one line on bad input."""
    path = Path(args.scenario)
    for option, given in (("--flavour", args.flavour), ("--fmu", args.fmu), ("--seed", args.seed is not None)):
        if given:
            raise UsageError(f"{option} is for scenarios; {path} has its own FMUs and no signals")
    folder: Path = args.out if args.out is not None else Path("results") / path.stem
    check_writable(folder)
    # an FMU whose library is still in use can't be removed on Windows; that must not hide the results
    with TemporaryDirectory(prefix="cosim_ssp_", ignore_cleanup_errors=True) as unpacked:
        try:
            return _run(path, Path(unpacked), folder, args)
        except CosimError as error:
            raise CosimError(_as_in_archive(str(error), unpacked, path)) from error


def _run(path: Path, unpacked: Path, folder: Path, args: argparse.Namespace) -> int:
    found = read_ssp(path, unpacked)
    for note in found.notes:
        print(f"note: {note}")
    plan = _plan(found, path, args)
    system = _with_start_values(found.system, args.set)
    formats = args.format or ["csv"]

    def write(results: Results | StoredResults, error: str | None = None) -> dict[str, Any]:
        info = dict(results.info)
        info["fmus"] = {
            name: {**fmu, "path": _as_in_archive(fmu["path"], str(unpacked), path)}
            for name, fmu in info["fmus"].items()
        }
        summary = {"ssp": str(path), "title": found.name, **info, "error": error, "versions": versions()}
        _write(results, summary, folder, formats)
        return summary

    def rescued(results: Results | StoredResults, error: str) -> str:
        try:
            write(results, error)
        except OutputError as second:
            return str(second)
        return f"what was recorded is in {folder}"

    try:
        results = execute(system, plan, args, folder, formats)
    except SetupError as error:
        raise UsageError(f"{path}: {error}") from error
    except SimulationError as error:
        if error.results is None:
            raise
        raise CosimError(f"{error}; {rescued(error.results, str(error))}") from error
    except SimulationInterrupted as interrupt:
        print(f"cosim: {interrupt}; {rescued(interrupt.results, str(interrupt))}", file=sys.stderr)
        return 130
    summary = write(results)
    print("\n".join([found.name, *in_words(summary, plan), f"results and summary: {folder}"]))
    return 0


def _plan(found: ReadSystem, path: Path, args: argparse.Namespace) -> Plan:
    stop_time = found.stop_time if args.stop is None else args.stop
    step_size = found.step_size if args.step is None else args.step
    if stop_time is None:
        raise UsageError(f"{path} has no default stop time; give one with --stop")
    if step_size is None:
        raise UsageError(f"neither {path} nor its FMUs have a default step; give one with --step")
    return Plan(stop_time, step_size, args.order or "sequential", found.start_time)


def _with_start_values(system: System, assignments: list[str]) -> System:
    components = dict(system.components)
    for assignment in assignments:
        instance, name, value = start_value(assignment)
        if instance not in components:
            hint = nearest(instance, components)
            raise UsageError(f"--set {assignment}: the system has no component '{instance}'; {hint}")
        start = {n: v for n, v in components[instance].start.items() if n != name} | {name: value}  # the last one holds
        components[instance] = dataclasses.replace(components[instance], start=start)
    check_overrides(assignments, system, "disconnect it in the SSP")
    return dataclasses.replace(system, components=components)


def _as_in_archive(text: str, unpacked: str, path: Path) -> str:
    """A text in which files in the archive are not named after the folder that they were unpacked to."""
    return text.replace(f"{unpacked}{os.sep}", f"{path}: ")


def _write(results: Results | StoredResults, summary: dict[str, Any], folder: Path, formats: list[str]) -> None:
    """Write results, unless they are on the disk already, and summary."""

    def write(folder: Path) -> None:
        if isinstance(results, Results):
            for name in formats:
                results.save(folder / f"results.{name}")
        write_json(folder / "summary.json", summary)

    write_somewhere(write, folder)
