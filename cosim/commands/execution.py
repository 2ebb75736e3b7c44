"""A run from the command line: with a progress bar, and on the disk where it is too long for memory."""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from cosim.errors import CosimError
from cosim.master.failures import SimulationError, SimulationInterrupted
from cosim.master.operations import Order
from cosim.master.simulation import Simulation, number_of_steps
from cosim.results.formats import format_of
from cosim.results.results import Results
from cosim.results.stored import StoredResults, TableWriter
from cosim.system.system import System

#: A run that records more values than this is written as it goes, and not kept in memory.
MOST_VALUES_IN_MEMORY = 10_000_000


class UsageError(CosimError):
    """Command-line options that make no sense."""


@dataclass(frozen=True)
class Plan:
    """Times of a run (s), and the order of its value exchange."""

    stop_time: float
    step_size: float
    order: Order
    start_time: float = 0.0


def execute(
    system: System, plan: Plan, args: argparse.Namespace, folder: Path, formats: list[str]
) -> Results | StoredResults:
    """Run a system; a run that is too long for memory goes to the disk as it comes.

    Raises
    ------
    SetupError, SimulationError, SimulationInterrupted
        As `Simulation.run`; their results are those on the disk for a long run.
    """
    with (
        Simulation(system, order=plan.order, coupling=args.coupling, record=args.record) as simulation,
        _progress(plan) as progress,
    ):
        run = partial(
            simulation.run,
            plan.stop_time,
            plan.step_size,
            start_time=plan.start_time,
            record_every=args.record_every,
            realtime=args.realtime,
            progress=progress,
        )
        points = number_of_steps(plan.start_time, plan.stop_time, plan.step_size) + 1
        n_values = points // max(1, args.record_every) * (len(simulation.names) + 1)
        if n_values <= MOST_VALUES_IN_MEMORY:
            return run()
        path = folder / "results.parquet"
        files = {folder / f"results.{name}" for name in formats} | {path}
        _check_room(folder, n_values, files)
        try:
            with TableWriter(sorted(files), simulation.names) as writer:
                results = run(sink=writer)
        except (SimulationError, SimulationInterrupted) as error:
            if error.results is not None:
                error.results = StoredResults(path, error.results.info)
            raise
        return StoredResults(path, results.info)


def _check_room(folder: Path, n_values: int, files: set[Path]) -> None:
    """A long run must not find out after hours that the disk is full."""
    size = n_values * sum(format_of(path).bytes_per_value for path in files)
    free = shutil.disk_usage(folder).free
    if size > free:
        raise UsageError(
            f"the results need about {size / 1e9:.3g} GB, but {folder} has {free / 1e9:.3g} GB of free space; "
            "record less (--record, --record-every), or make the step longer"
        )


@contextmanager
def _progress(plan: Plan) -> Iterator[Callable[[float], None]]:
    """A progress bar in simulated seconds, for runs that take more than two seconds."""
    layout = "{desc} {percentage:3.0f}%|{bar}| {n:.1f}/{total:.1f} s simulated [{elapsed}<{remaining}]"
    no_terminal = None  # tqdm's word for: no bar where there is no terminal to draw it on
    total = plan.stop_time - plan.start_time
    with tqdm(total=total, desc="running", delay=2.0, leave=False, bar_format=layout, disable=no_terminal) as bar:

        def report(time: float) -> None:
            bar.update(time - plan.start_time - bar.n)

        yield report


def start_value(assignment: str) -> tuple[str, str, float]:
    """Instance, variable and number of an option INSTANCE.NAME=VALUE.

    Raises
    ------
    UsageError
        It is written otherwise.
    """
    path, equals, text = assignment.partition("=")
    instance, dot, name = path.partition(".")
    try:
        value = float(text)
    except ValueError:
        equals = ""
    if not (equals and dot and name):
        raise UsageError(f"--set {assignment}: write INSTANCE.NAME=NUMBER, as controller.alpha=2")
    return instance, name, value


def check_overrides(assignments: list[str], system: System, remedy: str) -> None:
    """A start value of an input that something feeds would have no effect, and no one would notice."""
    fed = {c.target for c in system.connections} | {s.target for s in system.signals}
    for assignment in assignments:
        path = assignment.partition("=")[0]
        if {path, path.partition("[")[0]} & fed:
            raise UsageError(f"--set {assignment}: '{path}' is fed by a connection or a signal; {remedy}")


def in_words(info: dict[str, Any], plan: Plan) -> list[str]:
    """What ran, and how, for people; one line each."""
    duration = plan.stop_time - plan.start_time
    lines = [
        f"{duration:g} s at {plan.step_size * 1e3:g} ms, {plan.order} order: loop {info['loop_time_s']:.2f} s",
        _coupling(info["coupling"]),
    ]
    if pace := info.get("realtime"):
        lines.append(
            f"real time times {pace['factor']:g}: {pace['overruns']} overruns, points late by at most "
            f"{pace['lateness_max_s'] * 1e3:.3g} ms, jitter {pace['jitter_rms_s'] * 1e3:.3g} ms rms"
        )
    return lines


def _coupling(coupling: dict[str, Any]) -> str:
    """In words what inputs do between communication points."""
    linear, held = coupling["linear"], coupling["held"]
    if not linear:
        return "inputs held between communication points (first-order coupling)"
    if not held:
        return "inputs linear between communication points (second-order coupling)"
    return f"inputs linear between communication points, but for {len(held)} held ones (see summary.json)"
