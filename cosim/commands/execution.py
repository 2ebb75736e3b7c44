"""A run from the command line, whatever the system was read from: make it, write what it recorded, say how it went."""

from __future__ import annotations

import argparse
import copy
import dataclasses
import json
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from tqdm import tqdm

from cosim.commands.options import (
    LOG_FILE,
    IsolationOptions,
    check_signatures,
    chosen_interfaces,
    chosen_places,
    log_options,
)
from cosim.commands.supervision import has_written, works_in
from cosim.errors import CosimError, SetupError, nearest
from cosim.files.whole import PART, part_of, write_json
from cosim.fmi.message_log import Log
from cosim.fmi.messages import notes
from cosim.loop.team import Threads, checked_threads
from cosim.master.checkpoint import Checkpoint
from cosim.master.coupling.algorithm import EXTRAPOLATIONS
from cosim.master.failures import SimulationError, SimulationInterrupted
from cosim.master.simulation import Simulation, number_of_steps
from cosim.results.figure_process import FigureProcess
from cosim.results.formats import FORMATS, format_of
from cosim.results.output import SUMMARY, OutputError, ResultFolder, check_writable
from cosim.results.results import Results
from cosim.results.stored import StoredResults, TableWriter
from cosim.scenario.metrics import Metric, measured
from cosim.system.system import AsWritten, System
from cosim.terminal import screen
from cosim.versions import versions

if TYPE_CHECKING:
    from cosim.live.feed import LiveView

#: Folder of the checkpoint, in that of the results.
CHECKPOINT = "checkpoint"

#: Name of the page about a run.
REPORT = "report.html"

#: A run that records more values than this is written as it goes, and not kept in memory.
MOST_VALUES_IN_MEMORY = 10_000_000


#: So many of the connections are named that are coupled worst.
_MOST_RANKED = 3

#: A number of threads with as many digits is none that can be.
_MOST_DIGITS = 10

#: So many of the variables that were not finite are named.
_MOST_SAID = 5


class UsageError(CosimError):
    """Command-line options that make no sense."""


@dataclass(frozen=True)
class Plan:
    """Times of a run (s), how values are exchanged, and what is recorded when."""

    stop_time: float
    step_size: float | str
    start_time: float = 0.0
    order: str = "sequential"
    extrapolation: str = "auto"
    record: Sequence[str] | None = None
    record_every: int = 1
    tolerance: float | None = None
    solver: str = "auto"
    solver_step: float | None = None
    iterations: int | str | None = None

    @classmethod
    def from_options(
        cls, args: argparse.Namespace, stop_time: float, step_size: float | str, start_time: float
    ) -> Self:
        """The plan of a system that itself says no more than these times (s)."""
        keys = ("order", "extrapolation", "record", "record_every", "tolerance", "solver", "solver_step", "iterations")
        given = {key: getattr(args, key) for key in keys}
        return cls(stop_time, step_size, start_time, **{key: v for key, v in given.items() if v is not None})


@dataclass(frozen=True)
class PreparedRun:
    """A system and a run of it, ready to be made.

    Attributes
    ----------
    source, title : str
        What the user named, and one line for people.
    system : System
    plan : Plan
    folder : Path
        Of the results.
    about : mapping
        First entries of the summary.
    details : mapping
        Entries of the summary that follow those of the run.
    metrics : mapping
        Metrics by name.
    further_metrics : callable, optional
        Gives more of them, from results with at least one row.
    report : callable, optional
        Lines for people, from all metrics.
    drawing : str, optional
        `module:function` that draws the results; see `FigureProcess.write`.
    drawing_arguments : tuple
    archive_of : callable
        The file that has brought an FMU, which is the FMU itself but for those in an SSP.
    said_path : callable
        The path of an FMU file as the summary names it.
    """

    source: str
    title: str
    system: System
    plan: Plan
    folder: Path
    about: Mapping[str, Any]
    details: Mapping[str, Any] = field(default_factory=dict)
    metrics: Mapping[str, Metric] = field(default_factory=dict)
    further_metrics: Callable[[Results | StoredResults], Mapping[str, Any]] | None = None
    report: Callable[[Mapping[str, Any]], Sequence[str]] | None = None
    drawing: str | None = None
    drawing_arguments: tuple[Any, ...] = ()
    archive_of: Callable[[Path], Path] = Path
    said_path: Callable[[str], str] = str


def run_prepared(prepared: PreparedRun, args: argparse.Namespace, figures: FigureProcess) -> int:
    """Run, write results, summary and figures, also of a run that ends early; returns the exit code.

    Raises
    ------
    CosimError
        The run can't be made, or failed; the message says where what was recorded is.
    """
    prepared = dataclasses.replace(prepared, system=with_places(prepared.system, args.place))
    fmus = [component.fmu for component in prepared.system.components.values() if component.fmu is not None]
    check_signatures(args.require_signed, map(prepared.archive_of, fmus))
    formats = args.format or ["csv"]
    names = [f"results.{name}" for name in formats] + ([REPORT] if args.report else [])
    names += [LOG_FILE] if args.log or args.log_categories else []
    with ResultFolder(prepared.folder, names, overwrite=args.overwrite, resumes=args.resume) as folder:
        works_in(prepared.folder)
        for kept in folder.killed:
            print(f"note: a run that was killed had recorded what is in {kept}; remove it when you don't need it")
        checkpoint = _checkpoint(prepared.folder, args.checkpoint, args.resume)
        write = partial(
            _write,
            prepared,
            formats=formats,
            figures=figures,
            folder=folder,
            units_row=args.units_row,
            report=args.report,
        )
        ended: SimulationError | SimulationInterrupted | None = None
        results: Results | StoredResults | None = None
        line = ""
        try:
            with _simulation(prepared, args, log_options(args, folder.unfinished)) as simulation:
                try:
                    results = execute(simulation, prepared, args, formats, folder, checkpoint)
                except (SimulationError, SimulationInterrupted) as error:
                    ended, results = error, error.results
                    if results is None:
                        raise
                with simulation.moving_log(lambda: folder.path_of(LOG_FILE)):
                    if ended is None:
                        _leave(prepared, write, results, checkpoint, report=args.report)
                    else:
                        line = (
                            f"{ended}; {_rescued(prepared, write, results, folder, str(ended))}{_to_go_on(checkpoint)}"
                        )
                known = dict(results.info)
                has_written(0 if ended is None else 130 if isinstance(ended, SimulationInterrupted) else 1, line)
        except SetupError as error:
            raise UsageError(f"{prepared.source}: {error}{_kept_log(folder.unfinished)}") from error
        except SimulationError as error:
            raise CosimError(f"{error}{_kept_log(folder.unfinished)}") from error
        _amend(results, known, folder, report=args.report)
    if isinstance(ended, SimulationInterrupted):
        print(f"cosim: {line}", file=sys.stderr)
        return 130
    if ended is not None:
        raise CosimError(line) from ended
    return 0


def _leave(
    prepared: PreparedRun,
    write: Callable[..., bool],
    results: Results | StoredResults,
    checkpoint: Checkpoint | None,
    *,
    report: bool,
) -> None:
    """Write all of a run that has come to its end, and say what came of it, while its FMUs still live."""
    summary = _summary(prepared, results)
    print(in_words(prepared, summary), flush=True)  # tables and figures take longer than the run
    drawn = write(results, summary)
    if checkpoint is not None:  # not before its results are in their place
        checkpoint.remove()
    if report and (page := prepared.folder / REPORT).is_file():
        print(f"page: {page}")
    what = "results, summary and figures" if drawn else "results and summary"
    print(f"{what}: {prepared.folder}", flush=True)


def _amend(results: Results | StoredResults, known: Mapping[str, Any], folder: ResultFolder, *, report: bool) -> None:
    """Have the summary say what FMUs did when they were told that the run is over, after all was written."""
    said = {key: value for key, value in results.info.items() if known.get(key) != value}
    if not said and not folder.path_of(LOG_FILE).is_file():
        return
    for line in (*said.get("not_terminated", {}).values(), *_new_notes(known["messages"], results.info["messages"])):
        print(f"note: {' '.join(line.split())}")
    log = folder.path_of(LOG_FILE)
    if "log" in said:
        said["log"] = {**said["log"], "file": LOG_FILE}

    def write(where: Path) -> None:
        if report and said:
            summary = json.loads(folder.path_of(SUMMARY).read_text(encoding="utf-8"))
            _write_page(results, {**summary, **said}, where, log)

    try:
        folder.amend(said, [LOG_FILE], write)
    except OSError as error:
        print(f"note: {folder.path_of(SUMMARY)} does not say how the FMUs ended: {error.strerror or error}")


def _new_notes(before: Mapping[str, Any], now: Mapping[str, Any]) -> Sequence[str]:
    return notes({component: about for component, about in now.items() if before.get(component) != about})


def _threads(given: str | None) -> Threads:
    """The number of threads that an option gives.

    Raises
    ------
    SetupError
        It makes no sense.
    """
    if given is None:
        return 1
    return checked_threads(int(given) if given.isdecimal() and len(given) < _MOST_DIGITS else given)


def _checkpoint(folder: Path, every: float | None, resume: bool) -> Checkpoint | None:
    """The checkpoint of a run, if it has one.

    Raises
    ------
    UsageError
        There is none to resume, or one that would be lost.
    """
    where = folder / CHECKPOINT
    exists = (where / Checkpoint.STATE).is_file()
    if resume and not exists:
        raise UsageError(f"{folder} holds no checkpoint to resume; start the run with --checkpoint EVERY")
    if exists and not resume:
        raise UsageError(
            f"{where} is the checkpoint of a run that has not ended; --resume that run, or remove the folder"
        )
    if every is None and not resume:
        return None
    return Checkpoint(where, every, resume=resume, warn=lambda line: print(f"warning: {line}", file=sys.stderr))


def _kept_log(folder: Path) -> str:
    """Save the log of a run without results, which leaves nothing in its folder; says where it is."""
    log = folder / LOG_FILE
    if not log.is_file() or not log.stat().st_size:
        return ""
    kept = Path(tempfile.mkdtemp(prefix="cosim_log_")) / LOG_FILE
    shutil.move(log, kept)
    return f"; what the FMUs said is in {kept}"


def _to_go_on(checkpoint: Checkpoint | None) -> str:
    return "" if checkpoint is None else "; --resume goes on from its last checkpoint"


def _simulation(prepared: PreparedRun, args: argparse.Namespace, log: Log | None) -> Simulation:
    plan, isolation = prepared.plan, IsolationOptions.of(args)
    return Simulation(
        prepared.system,
        order=plan.order,
        extrapolation=plan.extrapolation,
        record=plan.record,
        build=args.build,
        log=log,
        threads=_threads(args.threads),
        profile=args.profile,
        solver=plan.solver,
        solver_step=plan.solver_step,
        isolate=isolation.isolate,
        limits=isolation.limits,
        iterations=plan.iterations,
        scheduler=args.scheduler,
        terminate_late=True,
    )


def execute(
    simulation: Simulation,
    prepared: PreparedRun,
    args: argparse.Namespace,
    formats: Sequence[str],
    folder: ResultFolder,
    checkpoint: Checkpoint | None,
) -> Results | StoredResults:
    """Run a system; a run that is too long for memory goes to the disk as it comes, into a folder.

    Raises
    ------
    SetupError, SimulationError, SimulationInterrupted
        As `Simulation.run`; their results are those on the disk for a long run.
    OutputError
        The disk takes no more; what was written stays.
    """
    plan = prepared.plan
    with _progress(plan) as progress:
        _check_metrics(prepared.metrics, simulation.names)
        run = partial(
            simulation.run,
            plan.stop_time,
            plan.step_size,
            start_time=plan.start_time,
            record_every=plan.record_every,
            tolerance=plan.tolerance,
            realtime=args.realtime,
            progress=progress,
            checkpoint=checkpoint,
            coupling_tolerance=args.coupling_tolerance,
            nonfinite=args.nonfinite,
        )
        with _shown_live(prepared.title, plan, simulation) if args.live else nullcontext() as view:
            if view is not None:
                run = partial(run, observe=view.observe, steering=view.steering)
            if isinstance(plan.step_size, str):  # how long it will be is not known
                return run()
            points = number_of_steps(plan.start_time, plan.stop_time, plan.step_size) + 1
            n_values = points // max(1, plan.record_every) * (len(simulation.names) + 1)
            if args.coupling_tolerance is not None:  # nor here
                return run()
            if n_values <= MOST_VALUES_IN_MEMORY:
                return run()
            path = folder.unfinished / "results.parquet"
            files = sorted({folder.unfinished / f"results.{name}" for name in formats} | {path})
            _check_room(folder.folder, n_values, files, checkpoint)
            while True:
                names = simulation.names
                try:
                    return _streamed(simulation, run, files, folder, units_row=args.units_row)
                except SetupError:
                    if simulation.names == names:
                        raise
                    continue  # without what FMUs have refused to give


@contextmanager
def _shown_live(title: str, plan: Plan, simulation: Simulation) -> Iterator[LiveView]:
    """A page that shows a run as it goes on, opened in the browser."""
    import webbrowser

    from cosim.live.feed import LiveView

    def show(address: str) -> bool:
        print(f"live: {address}", flush=True)
        return webbrowser.open(address)

    given = (simulation.names, simulation.types, simulation.units, simulation.settable)
    with LiveView(title, *given, plan.start_time, plan.stop_time, open_page=show) as view:
        yield view


def _streamed(
    simulation: Simulation, run: Callable[..., Results], files: Sequence[Path], folder: ResultFolder, *, units_row: bool
) -> StoredResults:
    """Run into files as they come; what a run that ends early has recorded is in its results, too."""
    path = folder.unfinished / "results.parquet"
    ended: SimulationError | SimulationInterrupted | None = None
    results: Results | StoredResults
    kept = ", ".join(str(part_of(folder.folder / each.name)) for each in files)
    try:
        with TableWriter(
            files,
            simulation.names,
            simulation.types,
            simulation.units,
            units_row=units_row,
            growing_in=folder.grow(),
        ) as writer:
            try:
                results = run(sink=writer)
            except (SimulationError, SimulationInterrupted) as error:
                if error.results is None:
                    raise
                ended, results = error, error.results
    except OSError as error:
        raise OutputError(f"{error.strerror or error}; what was recorded until then is in {kept}") from error
    stored = StoredResults(path, results.info)
    stored.info = results.info  # which has yet to say how the FMUs end
    if ended is not None:
        ended.results = stored
        raise ended
    return stored


def _check_metrics(metrics: Mapping[str, Metric], recorded: Sequence[str]) -> None:
    """What a metric is computed from must be recorded, which is known before anything runs."""
    for name, metric in metrics.items():
        for variable in metric.variables:
            if variable not in recorded:
                raise SetupError(
                    f"metric '{name}': '{variable}' is not recorded, or is not a scalar; {nearest(variable, recorded)}"
                )


def _check_room(folder: Path, n_values: int, files: Sequence[Path], checkpoint: Checkpoint | None) -> None:
    """A long run must not find out after hours that the disk is full."""
    rows = Checkpoint.BYTES_PER_VALUE if checkpoint is not None else 0
    size = n_values * (sum(format_of(path).bytes_per_value for path in files) + rows)
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
    with tqdm(
        file=screen(), total=total, desc="running", delay=2.0, leave=False, bar_format=layout, disable=no_terminal
    ) as bar:

        def report(time: float) -> None:
            bar.update(time - plan.start_time - bar.n)

        yield report


# What a run leaves


def _rescued(
    prepared: PreparedRun,
    write: Callable[..., Any],
    results: Results | StoredResults,
    folder: ResultFolder,
    error: str,
) -> str:
    """Write what a run had recorded when it ended early; says where, or why not."""
    keeps = folder.holds_whole_run
    try:
        write(results, _summary(prepared, results, error))
    except OutputError as second:
        return str(second)
    if keeps:
        return f"what was recorded is in {folder.folder} as *{PART}, beside the results of the run before"
    return f"what was recorded is in {folder.folder}"


def _summary(prepared: PreparedRun, results: Results | StoredResults, error: str | None = None) -> dict[str, Any]:
    """What `summary.json` says of a run; what was out of the ordinary is printed."""
    info = dict(results.info)
    if "log" in info:
        info["log"] = {**info["log"], "file": LOG_FILE}
    for line in (*_out_of_the_ordinary(info), *notes(info["messages"])):
        print(f"note: {' '.join(line.split())}")
    info["fmus"] = {name: {**fmu, "path": prepared.said_path(fmu["path"])} for name, fmu in info["fmus"].items()}
    return {
        **prepared.about,
        **info,
        **prepared.details,
        "error": error,
        "metrics": _metrics(prepared, results) if len(results.time) else None,
    }


def _write(
    prepared: PreparedRun,
    results: Results | StoredResults,
    summary: Mapping[str, Any],
    formats: Sequence[str],
    figures: FigureProcess,
    folder: ResultFolder,
    *,
    units_row: bool = False,
    report: bool = False,
) -> bool:
    """Write results, unless they are on the disk already, summary and figures, and a page if one is asked for.

    Returns whether figures were drawn.
    """
    summary = {**summary, "versions": versions()}
    error = summary["error"]
    without_texts = [f".{name}" for name in formats if not FORMATS[name].has_texts]
    texts = [name for name, kind in results.types.items() if kind in ("string", "binary")]
    if without_texts and texts:
        print(f"note: {', '.join(without_texts)} has no room for texts and leaves out {', '.join(texts)}")
    drawn, beside = False, error is not None and folder.holds_whole_run

    def save(where: Path) -> None:
        if isinstance(results, Results):
            for name in formats:
                path = where / f"results.{name}"
                if name == "csv":
                    results.to_csv(path, units_row=units_row)
                else:
                    results.save(path)
                folder.finish(path)

    def write(where: Path) -> None:
        nonlocal drawn
        write_json(where / SUMMARY, summary)
        with ThreadPoolExecutor(max_workers=1) as pool:  # tables are written by C++, which lets Python go on
            saved = pool.submit(save, where)
            if prepared.drawing is not None and len(results.time) > 1 and not beside:
                drawn = bool(_drawn(prepared, results, figures, where))
            if report:
                _write_page(results, summary, where, where / LOG_FILE)
        saved.result()

    folder.put(write, whole=error is None)
    return drawn


def _write_page(results: Results | StoredResults, summary: Mapping[str, Any], where: Path, log: Path) -> None:
    """The page about a run, with all that its summary says; whatever fails but the disk, the user gets a note."""
    from cosim.results.page.run_page import write_run_page

    said = log.read_text(encoding="utf-8", errors="replace") if log.is_file() else ""
    described = copy.copy(results)
    described.info = dict(summary)
    try:
        write_run_page(described, where / REPORT, log=said)
    except OSError:
        raise
    except Exception as error:  # the run has its results
        print(f"note: there is no {REPORT}, because {_in_one_line(error)}")


def _drawn(
    prepared: PreparedRun, results: Results | StoredResults, figures: FigureProcess, where: Path
) -> Sequence[Path]:
    """Figures of a run; whatever fails but the disk, the run has its results, and the user a note."""
    assert prepared.drawing is not None
    try:
        return figures.write(prepared.drawing, results, prepared.drawing_arguments, where)
    except OSError:
        raise
    except Exception as error:
        print(f"note: there are no figures, because {_in_one_line(error)}")
        return ()


def _out_of_the_ordinary(info: Mapping[str, Any]) -> Iterator[str]:
    """What a run assumed or met, a line each."""
    if kept := info["inputs_kept"]:
        yield f"nothing feeds these inputs, which keep the start values of their FMUs: {', '.join(kept)}"
    if unticked := info.get("clocks_without_source"):
        yield f"nothing ticks these clocks, which need a connection or a signal: {', '.join(unticked)}"
    for component in info.get("tolerance_assumed", ()):
        tolerance = info["fmus"][component]["tolerance"]
        yield f"the FMU of '{component}' fails without a tolerance; it was told {tolerance:g}"
    for component, why in info.get("derivatives_refused", {}).items():
        yield (
            f"the FMU of '{component}' says that it interpolates inputs, but {why}; they are held between "
            "communication points (--extrapolation hold)"
        )
    if large := info.get("arrays_not_recorded"):
        yield f"large arrays are recorded only where they, or elements, are named (--record): {', '.join(large)}"
    for component in info.get("extrapolation", {}).get("order_assumed", ()):
        yield (
            f"the FMU of '{component}' does not say up to which order it takes derivatives of its inputs (FMI 2.0 has "
            "no attribute for it); if it ignores the higher ones, linear extrapolation is as accurate and more stable"
        )
    if refused := info.get("not_recorded", {}):
        names = ", ".join(f"{name} ({why})" for name, why in refused.items())
        yield f"FMUs refuse to give these outputs, which are not in the results: {names}"
    if marks := info.get("nonfinite", {}):
        said = [f"{name} (from t = {m['time']:.9g} s on, {m['rows']} times)" for name, m in marks.items()]
        more = f" and {len(said) - _MOST_SAID} more (see {SUMMARY})" if len(said) > _MOST_SAID else ""
        yield f"these were NaN or infinite: {', '.join(said[:_MOST_SAID])}{more} (--nonfinite error ends there)"
    for component, number in info.get("steps_repeated", {}).items():
        yield f"the FMU of '{component}' discarded {number} steps, which were repeated in shorter ones"
    if ended_by := info.get("ended_by"):
        yield f"the FMU of '{ended_by['component']}' ended the simulation at t = {ended_by['time']:.9g} s"
    yield from info.get("not_terminated", {}).values()


def _metrics(prepared: PreparedRun, results: Results | StoredResults) -> dict[str, Any]:
    further: Mapping[str, Any] = {}
    if prepared.further_metrics is not None:
        try:
            further = prepared.further_metrics(results)
        except Exception as error:  # of another package; the run has its results
            print(f"note: metrics are missing, because {_in_one_line(error)}")
    return {**further, **measured(prepared.metrics, results)}


def _in_one_line(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if isinstance(error, CosimError) else f"{type(error).__name__}: {text}"


def in_words(prepared: PreparedRun, summary: Mapping[str, Any]) -> str:
    """What ran, how, and what came of it, for people."""
    plan = prepared.plan
    duration = plan.stop_time - plan.start_time
    lines = [
        prepared.title,
        f"{duration:g} s at {_step(summary)}, {plan.order} order: loop {summary['loop_time_s']:.2f} s",
        _extrapolation(summary["extrapolation"]),
        *_model_exchange(summary),
        *_iterations(summary),
    ]
    if found := summary.get("coupling"):
        lines.append(
            f"coupling error: about {found['error']:.2g} of {found['variable']}'s largest magnitude (t = "
            f"{found['time']:.4g} s), order {found['order']:.1f}; the step was found by {found['runs']} runs"
        )
    if pace := summary.get("realtime"):
        lines.append(
            f"real time times {pace['factor']:g}: {pace['overruns']} overruns, points late by at most "
            f"{pace['lateness_max_s'] * 1e3:.3g} ms, jitter {pace['jitter_rms_s'] * 1e3:.3g} ms rms"
        )
    lines += _profile(summary)
    if prepared.report is not None and set(summary["metrics"]) - set(prepared.metrics):
        lines += prepared.report(summary["metrics"])
    if prepared.metrics:
        values = {name: summary["metrics"][name] for name in prepared.metrics}
        lines += ["", *(f"{name:<40}{'-' if v is None else f'{v:.6g}':>14}" for name, v in values.items())]
    return "\n".join(lines)


def _step(summary: Mapping[str, Any]) -> str:
    """The communication step, or what variable ones were like."""
    if found := summary.get("variable_steps"):
        if not found["steps"]:
            return "variable steps"
        return (
            f"{found['steps']} variable steps of {found['shortest'] * 1e3:.3g} to {found['longest'] * 1e3:.3g} ms for "
            f"a coupling error of {found['tolerance']:g} ({found['rejected']} rejected)"
        )
    return f"{summary['step_size'] * 1e3:g} ms"


def _iterations(summary: Mapping[str, Any]) -> list[str]:
    """What it took to solve algebraic loops, and to repeat steps."""
    lines = []
    if found := summary.get("iterations"):
        lines.append(
            f"algebraic loops: {len(found['torn'])} values, {found['iterations']} iterations at {found['points']} "
            f"points, largest residual {found['largest_residual']:.1e}"
        )
    if found := summary.get("iterated_steps"):
        left = f"; {found['not_converged']} steps did not get to {found['tolerance']:g}"
        lines.append(
            f"iterated steps: {len(found['inputs'])} inputs, {found['iterations'] / max(1, found['steps']):.1f} "
            f"iterations a step, at most {found['most_iterations']}, largest residual {found['largest_residual']:.1e}"
            + (left if found["not_converged"] else "")
        )
    if why := summary.get("steps_not_iterated"):
        lines.append(f"steps are not iterated, algebraic loops are: {why}")
    return lines


def _model_exchange(summary: Mapping[str, Any]) -> list[str]:
    """What was integrated together, and how."""
    if "model_exchange" not in summary:
        return []
    found = summary["model_exchange"]
    names = found["components"]
    who = f"components {', '.join(names)}" if len(names) <= _MOST_SAID else f"{len(names)} components"
    how = f"tolerance {found['tolerance']:g}, " if "tolerance" in found else ""
    return [f"model exchange: {who} by {found['solver']}, {how}{found['steps']} steps, {found['events']} events"]


def _profile(summary: Mapping[str, Any]) -> list[str]:
    """How long components took, the slowest first."""
    if "profile" not in summary:
        return []
    whole = summary["loop_time_s"]
    rows = [(c["steps_s"] + c["exchange_s"], name, c) for name, c in summary["profile"]["components"].items()]
    width = max(len("component"), *(len(name) for _, name, _ in rows))
    return [
        f"{'component':<{width}}{'time':>12}{'share':>8}{'steps':>12}{'exchange':>12}{'number':>10}{'repeated':>10}",
        *(
            f"{name:<{width}}{total:>10.3g} s{total / whole if whole else 0.0:>8.0%}{c['steps_s']:>10.3g} s"
            f"{c['exchange_s']:>10.3g} s{c['steps']:>10}{c['steps_repeated']:>10}"
            for total, name, c in sorted(rows, key=lambda row: -row[0])
        ),
        *_predicted(summary["profile"].get("connections", ())),
    ]


def _predicted(connections: Sequence[Mapping[str, Any]]) -> list[str]:
    """Which connections are coupled worst, in a line."""
    worst = [f"{c['source']} -> {c['target']} {c['error']:.1e}" for c in connections[:_MOST_RANKED] if c["error"] > 0.0]
    return [f"worst coupled (what inputs were predicted, rms): {', '.join(worst)}"] if worst else []


#: Order of accuracy of a coupling by extrapolation of degree 0, 1, 2, 3.
_ORDINALS = ("first", "second", "third", "fourth")


def _extrapolation(found: dict[str, Any]) -> str:
    """What inputs do between communication points, in words."""
    held, exact = found["hold"], found.get("model_exchange", ())
    names = sorted((n for n in found if n in EXTRAPOLATIONS and n != "hold" and found[n]), key=lambda n: -len(found[n]))
    if exact and not held and not names:
        return "all connected inputs are coupled exactly"
    if exact:
        rest = {key: value for key, value in found.items() if key != "model_exchange"}
        return f"{len(exact)} inputs coupled exactly; other {_extrapolation(rest)}"
    if not names:
        return "inputs held between communication points (zero-order hold, first-order coupling)"
    accuracy = f"{_ORDINALS[min(EXTRAPOLATIONS[name].degree for name in names)]}-order coupling"
    main, *others = names
    if not held and not others:
        return f"inputs {main} between communication points ({accuracy})"
    counts = [(len(found[name]), name) for name in others] + [(len(held), "held")]
    exceptions = [f"{count} that {'is' if count == 1 else 'are'} {name}" for count, name in counts if count]
    return f"inputs {main} between communication points, except {' and '.join(exceptions)} (see summary.json)"


# Options that all kinds of systems have in common


def results_folder(args: argparse.Namespace, name: str) -> Path:
    """The folder of the results, which can be written.

    Raises
    ------
    OutputError
        It can't be.
    """
    folder: Path = args.out if args.out is not None else Path("results") / name
    check_writable(folder)
    return folder


def start_value(assignment: str, components: Sequence[str], only: str | None = None) -> tuple[str, str, AsWritten]:
    """Component, variable and value of an option COMPONENT.NAME=VALUE; NAME=VALUE is one of the `only` component.

    Raises
    ------
    UsageError
        It is written otherwise, or there is no such component.
    """
    path, equals, text = assignment.partition("=")
    component, dot, name = path.partition(".")
    if only is not None and equals and path and component != only:
        return only, path, AsWritten(text)
    if not (equals and dot and name):
        raise UsageError(f"--set {assignment}: write COMPONENT.NAME=VALUE, as controller.alpha=2")
    if component not in components:
        hint = nearest(component, components)
        raise UsageError(f"--set {assignment}: the system has no component '{component}'; {hint}")
    return component, name, AsWritten(text)


def with_start_values(system: System, assignments: Sequence[str], remedy: str, only: str | None = None) -> System:
    """A copy of a system with start values of options COMPONENT.NAME=VALUE; the last one of a name holds.

    Those that name no component are for the `only` one, if there is one. A start value of an input that something feeds
    would have no effect, and no one would notice.

    Raises
    ------
    UsageError
        An option is written otherwise, names no component, or an input that is fed; `remedy` says what to do then.
    """
    components = dict(system.components)
    fed = {c.target for c in system.connections} | {s.target for s in system.signals}
    for assignment in assignments:
        component, name, value = start_value(assignment, list(components), only)
        path = f"{component}.{name}"
        if {path, path.partition("[")[0]} & fed:
            raise UsageError(f"--set {assignment}: '{path}' is fed by a connection or a signal; {remedy}")
        start = {n: v for n, v in components[component].start.items() if n != name} | {name: value}
        components[component] = dataclasses.replace(components[component], start=start)
    return dataclasses.replace(system, components=components)


def with_interfaces(system: System, texts: Sequence[str]) -> System:
    """A copy of a system with the interfaces of options [COMPONENT=]INTERFACE.

    Raises
    ------
    SetupError
        An option makes no sense.
    """
    return _with_each(system, "interface", chosen_interfaces(texts, _with_fmus(system)))


def with_places(system: System, texts: Sequence[str]) -> System:
    """A copy of a system with the places of options COMPONENT=PLACE.

    Raises
    ------
    SetupError
        An option makes no sense.
    """
    return _with_each(system, "place", chosen_places(texts, _with_fmus(system)))


def _with_fmus(system: System) -> list[str]:
    return [name for name, component in system.components.items() if component.fmu is not None]


def _with_each(system: System, attribute: str, chosen: Mapping[str, Any]) -> System:
    """A copy of a system in which components have these values of an attribute."""
    changed = {n: dataclasses.replace(system.components[n], **{attribute: value}) for n, value in chosen.items()}
    return dataclasses.replace(system, components={**system.components, **changed})


def refuse(options: Mapping[str, Any], why: str) -> None:
    """Refuse options that are given and have no meaning for what is run.

    Raises
    ------
    UsageError
        One of them is given.
    """
    for option, value in options.items():
        if value not in (None, [], False):
            raise UsageError(f"{option} {why}")
