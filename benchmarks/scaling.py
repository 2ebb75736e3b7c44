"""How cost grows: with the number of FMUs, the length of a run, and at the start of the program."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import psutil

from benchmarks.measure import Section
from cosim import Simulation, System
from fmu_export.modelling.model import DefaultExperiment, Model
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.native.backend import build_native
from parallel_robot.fmus import fmu_path

GAIN = Model(
    name="Gain",
    description="y = 0.5 u",
    parameters=Layout([Variable("K", "1", "Gain", start=0.5)]),
    inputs=Layout([Variable("u", "1", "Input")]),
    outputs=Layout([Variable("y", "1", "Output")]),
    states=(),
    initial_state=lambda p: p[:0],
    derivatives=lambda t, x, u, p: x,
    output_values=lambda t, x, u, p: p[:1] * u,
    default_experiment=DefaultExperiment(stop_time=1.0, step_size=1e-3),
)


def measure_chain() -> Section:
    """A chain of gains."""
    counts, times = (1, 10, 100, 1000), {}
    with tempfile.TemporaryDirectory() as folder:
        fmu = build_native(GAIN, Path(folder), "fmi2")
        for n in counts:
            system = System()
            for i in range(n):
                system.add(f"g{i}", fmu, start={"u": 1.0} if i == 0 else None)
                if i:
                    system.connect(f"g{i - 1}.y", f"g{i}.u")
            steps = 2_000_000 // n // 10 if n > 1 else 100_000
            with Simulation(system, extrapolation="hold", record=[f"g{n - 1}.y"]) as simulation:
                loops = [simulation.run(steps * 1e-3, 1e-3).info["loop_time_s"] / steps for _ in range(7)]
            times[n] = statistics.median(loops)
    each = {n: t / n for n, t in times.items()}
    factor = each[1000] / each[10]
    return Section(
        "Number of FMUs",
        "A chain of gains, one instance each of one FMI 2.0 FMU; medians of 7 runs.",
        ("instances", "us a step", "ns a step and instance"),
        [(str(n), f"{times[n] * 1e6:.2f}", f"{each[n] * 1e9:.1f}") for n in counts],
        {"seconds_per_step": {str(n): t for n, t in times.items()}},
        [(f"cost of a connection, 1000 instances / 10 instances: {factor:.2f}, at most 1.5", factor <= 1.5)],
    )


def measure_many(folder: Path) -> Section:
    """900 FMUs of three files: the robot 300 times."""
    n, system = 300, System()
    for i in range(n):
        for name in ("plant", "controller", "trajectory"):
            system.add(f"{name}{i}", fmu_path(folder, "fmi2", name))
        for vector in ("theta_a", "omega_a"):
            system.connect(f"plant{i}.{vector}", f"controller{i}.{vector}")
        for vector in ("theta_ref", "omega_ref", "tau_ref"):
            system.connect(f"trajectory{i}.{vector}", f"controller{i}.{vector}")
        system.connect(f"controller{i}.tau_a", f"plant{i}.tau_a")
    resolved, loaded = [], []
    for _ in range(5):
        began = time.perf_counter()
        simulation = Simulation(system)
        resolved.append((time.perf_counter() - began) / 3 / n)
        began = time.perf_counter()
        with simulation:
            loaded.append((time.perf_counter() - began) / 3 / n)
    resolve, load = statistics.median(resolved), statistics.median(loaded)
    return Section(
        "Many FMUs",
        f"{3 * n} FMUs of three files, with the connections of {n} robots; medians of 5.",
        ("what", "ms an FMU"),
        [
            ("resolve: names, types, units, levels", f"{resolve * 1e3:.2f}"),
            ("load and instantiate", f"{load * 1e3:.2f}"),
        ],
        {"resolve_s": resolved, "load_s": loaded},
        [
            (f"resolve: {resolve * 1e3:.2f} ms an FMU, at most 0.3", resolve <= 3e-4),
            (f"load: {load * 1e3:.2f} ms an FMU, at most 0.5", load <= 5e-4),
        ],
    )


def _cosim(arguments: list[str], folder: Path) -> tuple[float, float]:
    """Wall time (s) and largest resident memory (MB) of a call of the program, all its processes together."""
    began = time.perf_counter()
    with psutil.Popen([sys.executable, "-m", "cosim", *arguments], cwd=folder, stdout=subprocess.DEVNULL) as program:
        memory = 0
        while True:
            try:
                program.wait(0.02)
            except psutil.TimeoutExpired:
                memory = max(memory, _resident(program))
            else:
                break
        seconds = time.perf_counter() - began
    if program.returncode:
        raise subprocess.CalledProcessError(program.returncode, program.args)
    return seconds, memory / 2**20


def _resident(program: psutil.Process) -> int:
    total = 0
    for process in (program, *program.children()):
        with suppress(psutil.NoSuchProcess):  # it has just ended
            total += process.memory_info().rss
    return total


def measure_program(fmus: Path) -> Section:
    """`cosim run` as its users start it, and an hour of simulated time."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        options = ["run", "--fmus", str(fmus.resolve()), "--flavour", "fmi2"]
        starts = [_cosim([*options, "--out", "warm"], folder) for _ in range(6)][1:]
        loop = json.loads((folder / "warm/summary.json").read_text(encoding="utf-8"))["loop_time_s"]
        hour, memory = _cosim([*options, "--stop", "3600", "--format", "parquet", "--out", "hour"], folder)
        size = (folder / "hour/results.parquet").stat().st_size
    warm = statistics.median(t for t, _ in starts)
    return Section(
        "The program",
        "`cosim run` from the start of the process to results, summary and figures on the disk, median of 5 after "
        "a first one; and an hour of simulated time, 3.6 million steps, everything recorded in a Parquet file. "
        "Memory is that of the program and the process that draws, together.",
        ("what", "seconds", "largest memory (MB)"),
        [
            ("cosim run", f"{warm:.2f} (loop {loop:.3f})", f"{statistics.median(m for _, m in starts):.0f}"),
            (f"cosim run --stop 3600 --format parquet ({size / 1e9:.1f} GB)", f"{hour:.1f}", f"{memory:.0f}"),
        ],
        {"warm_s": [t for t, _ in starts], "loop_s": loop, "hour_s": hour, "hour_MB": memory},
        [
            (f"cosim run from a warm start: {warm:.2f} s, under 2 s", warm < 2.0),
            (f"its loop: {loop:.3f} s, under 0.1 s", loop < 0.1),
            (f"an hour: {hour:.0f} s, well under a minute", hour < 45.0),
            (f"memory of the hour: {memory:.0f} MB, under 500 MB", memory < 500.0),
        ],
    )
