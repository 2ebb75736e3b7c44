"""What a sweep adds to the runs themselves: `python benchmarks/sweep_throughput.py [--fmus DIR] [--json FILE]`.

Rates of one worker process and of one for each core against a bare loop of `Simulation.run` that records the same,
interleaved in one run; ratios are medians over rounds. Then what one task costs a scheduler, the network and the
memory, with the scheduler and each worker in a process of its own.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import psutil

from cosim.sweep import batch
from cosim.sweep.batch import Rows
from cosim.sweep.cluster import connect
from cosim.sweep.engine import sweep
from cosim.sweep.points import Points, Range, design
from cosim.sweep.store import Store, read
from parallel_robot.fmus import build_missing
from parallel_robot.scenario import load_scenario
from parallel_robot.sweep import METRICS, RobotStudy, robot_study

FACTORS = (Range("controller.alpha", 0.5, 3.0), Range("controller.beta", 1.0, 2.0))

#: Runs in a task -> tasks to measure: as in a task of 1.5 s, and of 10 s on a large cluster.
TASKS = {40: 600, 400: 100}

#: Points of a large plan.
PLANNED = 10_000_000

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def points_of(n: int, seed: int) -> Points:
    """Gains, as a user would vary them."""
    return design("lhs", FACTORS, n, seed)


def bare_loop(study: RobotStudy, files: dict[str, Path], n: int, seed: int) -> float:
    """Runs a second of a plain loop in this process, the first run excluded."""
    columns = points_of(n, seed).take(np.arange(n))
    with study.simulation(study.plan({}).variant, files.__getitem__) as simulation:
        planned = study.plan({})
        simulation.run(planned.stop_time, planned.step_size)
        began = time.perf_counter()
        for k in range(n):
            simulation.run(planned.stop_time, planned.step_size, start={name: v[k] for name, v in columns.items()})
        return n / (time.perf_counter() - began)


def bare_loops(study: RobotStudy, files: dict[str, Path], n: int, seed: int) -> float:
    """Runs a second of plain loops in as many processes as there are cores: what the machine gives."""
    with ProcessPoolExecutor(CORES, mp_context=get_context("spawn")) as pool:
        return sum(pool.map(bare_loop, *zip(*[(study, files, n, seed)] * CORES, strict=True)))


def swept(study: RobotStudy, files: dict[str, Path], n: int, seed: int, workers: int) -> float:
    """Runs a second of a sweep on this machine's own workers, from the first point sent to the last row on disk."""
    with tempfile.TemporaryDirectory() as folder:
        summary = sweep(study, files, points_of(n, seed), Path(folder) / "out", workers=workers)
    return summary.runs / summary.seconds


def rates(study: RobotStudy, files: dict[str, Path], n: int, rounds: int) -> dict[str, list[float]]:
    """Runs a second of each way, round by round."""
    ways: dict[str, Callable[[int], float]] = {
        "bare loop": lambda seed: bare_loop(study, files, n // 2, seed),
        "sweep, 1 worker": lambda seed: swept(study, files, n, seed, 1),
        f"bare loops, {CORES} processes": lambda seed: bare_loops(study, files, n // 2, seed),
        f"sweep, {CORES} workers": lambda seed: swept(study, files, CORES * n, seed, CORES),
    }
    found: dict[str, list[float]] = {way: [] for way in ways}
    for seed in range(rounds):
        for way, rate in ways.items():
            found[way].append(rate(seed))
    return found


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[tuple[str, psutil.Process, list[psutil.Process]]]:
    """A scheduler and workers in processes of their own."""
    file = folder / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    python = [sys.executable, "-m"]
    scheduler = [*python, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    worker = [*python, "distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    started = [subprocess.Popen([*scheduler, "--scheduler-file", str(file)], **quiet)]
    try:
        while not file.is_file() or not file.read_text():
            time.sleep(0.05)
        address = json.loads(file.read_text())["address"]
        command = [*worker, "--local-directory", str(folder), address]
        started += [subprocess.Popen(command, **quiet) for _ in range(workers)]
        processes = [psutil.Process(p.pid) for p in started]
        yield address, processes[0], processes[1:]
    finally:
        for process in started:
            process.kill()
            process.wait()


def cpu(process: psutil.Process) -> float:
    """CPU time (s) that a process has used."""
    times = process.cpu_times()
    return float(times.user + times.system)


def loopback() -> int:
    """Bytes that have gone over the loopback interface, whoever sent them."""
    return psutil.net_io_counters(pernic=True)["lo"].bytes_sent if "lo" in psutil.net_if_stats() else 0


def loads(study: RobotStudy, files: dict[str, Path], runs: int, tasks: int) -> dict[str, float]:
    """What tasks of so many runs cost besides the runs, above what scheduler and client use when nothing happens.

    It is the same whatever the runs take, so short ones show it soon.
    """
    scenarios = {name: dataclasses.replace(s, stop_time=0.01) for name, s in study.scenarios.items()}
    short = dataclasses.replace(study, scenarios=scenarios)
    batch._BATCH_TIME, batch._MOST_RUNS = 1e9, runs
    points = points_of(tasks * runs, 1)
    own = psutil.Process()
    with tempfile.TemporaryDirectory() as name, cluster(Path(name), CORES) as (address, scheduler, workers):

        def counters() -> np.ndarray:
            return np.array([time.perf_counter(), 1e3 * cpu(scheduler), 1e3 * cpu(own), 1e-3 * loopback()])

        sweep(short, files, points_of(CORES, 0), Path(name) / "first", scheduler=address)  # all have started
        with connect(address):
            before = counters()
            time.sleep(5.0)
            idle = counters() - before
        before = counters()
        sweep(short, files, points, Path(name) / "second", scheduler=address)
        used = counters() - before
        _, by_scheduler, by_client, sent = ((used - idle * used[0] / idle[0]) / tasks).tolist()
        return {
            "scheduler CPU, ms a task": by_scheduler,
            "submitting process CPU, ms a task": by_client,
            "network, kB a task": sent,
            "scheduler CPU when idle, ms a second": float(idle[1] / idle[0]),
            "scheduler memory, MB": 1e-6 * scheduler.memory_info().rss,
            "worker memory after short runs, MB": 1e-6 * max(w.memory_info().rss for w in workers),
        }


def worker_memory(study: RobotStudy, files: dict[str, Path], n: int) -> float:
    """Largest resident memory (MB) of a worker in a sweep of full runs."""
    with tempfile.TemporaryDirectory() as name, cluster(Path(name), CORES) as (address, _, workers):
        largest = [0.0]

        def look(*_: int) -> None:
            largest[0] = max(largest[0], *(1e-6 * w.memory_info().rss for w in workers))

        sweep(study, files, points_of(n, 0), Path(name) / "out", scheduler=address, progress=look)
        return largest[0]


def cpu_of_runs(study: RobotStudy, files: dict[str, Path], n: int, rounds: int) -> list[tuple[float, float]]:
    """CPU time (ms) of a run in a bare loop, and in a sweep of one worker with all its processes.

    Busy neighbours matter less to it than to the rates.
    """
    own, found = psutil.Process(), []
    with tempfile.TemporaryDirectory() as name, cluster(Path(name), 1) as (address, scheduler, workers):
        sweep(study, files, points_of(4, 0), Path(name) / "first", scheduler=address)  # all have started
        for seed in range(rounds):
            before = cpu(own)
            bare_loop(study, files, n, seed)
            bare = 1e3 * (cpu(own) - before) / n
            before = sum(map(cpu, [own, scheduler, *workers]))
            sweep(study, files, points_of(n, seed), Path(name) / str(seed), scheduler=address)
            found.append((bare, 1e3 * (sum(map(cpu, [own, scheduler, *workers])) - before) / n))
    return found


def on_disk(rows: int) -> dict[str, float]:
    """What rows of random metrics, which don't compress, take on disk, and how fast they are read."""
    values = np.random.default_rng(0).random((rows, len(METRICS)))
    with tempfile.TemporaryDirectory() as name:
        store = Store(Path(name), points_of(rows, 0), METRICS, {})
        for indices in np.array_split(np.arange(rows), 100):
            columns = {metric: values[indices, k].tolist() for k, metric in enumerate(METRICS)}
            store.add(Rows(indices.tolist(), columns, [None] * len(indices), 1.0))
            store.flush()
        began = time.perf_counter()
        read(Path(name))
        seconds = time.perf_counter() - began
        size = sum(p.stat().st_size for p in (Path(name) / "results").iterdir())
    return {"result files, bytes a row": size / rows, "reading 100 files of 1,000 rows, s": seconds}


def large_plan(n: int) -> dict[str, float]:
    """What a plan of so many points costs the submitting process, which is this one, before anything runs."""
    with tempfile.TemporaryDirectory() as name:
        began = time.perf_counter()
        store = Store(Path(name), design("sobol", FACTORS, n), METRICS, {})
        store.missing()
        seconds = time.perf_counter() - began
        size = (Path(name) / "plan.parquet").stat().st_size
    return {
        f"plan of {n:,} points, s": seconds,
        f"plan of {n:,} points, MB on disk": 1e-6 * size,
        f"plan of {n:,} points, largest memory, MB": 1e-3 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fmus", type=Path, default=Path("fmus"), metavar="DIR")
    parser.add_argument("--points", type=int, default=400, help="runs of a sweep for each worker (default %(default)s)")
    parser.add_argument("--rounds", type=int, default=7, help="default %(default)s")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    options = parser.parse_args()
    build_missing(options.fmus, "fmi2")
    study, files = robot_study({"tracking": load_scenario("tracking")}, options.fmus, ["fmi2"])
    found = rates(study, files, options.points, options.rounds)
    one, many = (found[way] for way in ("sweep, 1 worker", f"sweep, {CORES} workers"))
    bare, bares = found["bare loop"], found[f"bare loops, {CORES} processes"]
    print(f"{'runs of 15,000 steps a second':<44}{'median':>9}{'least':>9}{'most':>9}")
    for way, values in found.items():
        print(f"{way:<44}{statistics.median(values):>9.1f}{min(values):>9.1f}{max(values):>9.1f}")
    ratios = {
        f"sweep, {CORES} workers / sweep, 1 worker": [b / a for a, b in zip(one, many, strict=True)],
        f"bare loops, {CORES} processes / bare loop": [b / a for a, b in zip(bare, bares, strict=True)],
        "sweep, 1 worker / bare loop": [b / a for a, b in zip(bare, one, strict=True)],
        f"sweep, {CORES} workers / bare loops, {CORES} processes": [b / a for a, b in zip(bares, many, strict=True)],
        f"sweep, {CORES} workers / ({CORES} x bare loop)": [b / a / CORES for a, b in zip(bare, many, strict=True)],
    }
    by_cpu = cpu_of_runs(study, files, options.points, options.rounds)
    ratios["CPU time of a run, bare loop / sweep"] = [bare / swept for bare, swept in by_cpu]
    print(f"\n{'ratios, median over rounds':<44}{'median':>9}{'least':>9}{'most':>9}")
    for name, values in ratios.items():
        print(f"{name:<44}{statistics.median(values):>9.3f}{min(values):>9.3f}{max(values):>9.3f}")
    figures = {
        "FMUs, kB a worker": 1e-3 * sum(p.stat().st_size for p in files.values()),
        "worker memory, MB": worker_memory(study, files, 100),
    }
    for runs, tasks in TASKS.items():
        figures |= {f"tasks of {runs} runs: {k}": v for k, v in loads(study, files, runs, tasks).items()}
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        figures |= on_disk(100_000) | pool.submit(large_plan, PLANNED).result()
    print()
    for name, value in figures.items():
        print(f"{name:<64}{value:>9.3g}")
    if options.json:
        options.json.write_text(json.dumps({"rates": found, "ratios": ratios, "figures": figures}, indent=2) + "\n")


if __name__ == "__main__":
    main()
