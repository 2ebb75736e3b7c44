"""The robot's FMUs in model exchange, and as black boxes, against one C program that holds all of their equations.

Both integrate the same equations by RK4 at the same steps, signals linear between communication points. The program is
generated from the composed model: one function for the rates of all states, no FMUs, no tables.
"""

from __future__ import annotations

import ctypes
import math
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.measure import Section, interleaved, ratio
from benchmarks.system import STOP_TIME, disturbed
from cosim import Simulation, SimulationError
from fmu_export.native.c_source import c_function
from fmu_export.native.elementary import declarations, elementary_sources
from fmu_export.native.runge_kutta import LINEAR_INPUTS, runge_kutta_source
from fmu_export.native.toolchain import compile_library, host_target
from fmu_export.trace.trace import TracedModel, trace
from parallel_robot.models import closed_loop_model
from tests.support.continuous_loop import end_effector, solve

ROUNDS = 31

#: Errors are looked at so often, in s.
EVERY = 0.2

#: Steps (s) among which the longest is found that keeps an error.
STEPS = tuple(EVERY / n for n in (5, 8, 10, 12, 14, 16, 18, 20, 25, 32, 40, 45, 50, 52, 56, 64, 80, 100, 200))

#: Errors (m) of the end effector that are asked for.
ERRORS = (1e-6, 1e-8)

_LOOP = """
#include <string.h>
#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

EXPORT void run(long n, double h, const double p[], const double signals[], const unsigned char jumps[], double *row) {
    double x[N_X], next[N_X], u[N_U], last[N_U], rate[N_U], y[N_ALL], stages[3 * N_ALL], middle[N_U], end[N_U];
    double per_second = 1.0 / h;
    loop_initial_state(p, x);
    for (long i = 0; i <= n; i++, row += N_Y) {
        double t = i * h;
        memcpy(u, signals + i * N_U, sizeof u);
        loop_everything(t, x, u, p, y);
        memcpy(row, y, N_Y * sizeof *row);
        if (i == n) break;
        for (int j = 0; j < N_U; j++) { /* before a jump signals go on as they did */
            double before = jumps[i] ? 0.0 : (u[j] - last[j]) * per_second;
            rate[j] = jumps[i + 1] ? before : (signals[(i + 1) * N_U + j] - u[j]) * per_second;
            last[j] = u[j];
        }
        between(u, rate, h, N_U, middle, end);
        loop_step(t, h, x, middle, end, p, y + N_Y, next, stages);
        memcpy(x, next, sizeof x);
    }
}
"""


class Program:
    """The compiled program of the composed model."""

    def __init__(self) -> None:
        self.traced = trace(closed_loop_model())
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"equations{host_target().suffix}"
            path.write_bytes(compile_library(_sources(self.traced), "equations"))
            self._run = ctypes.CDLL(str(path)).run

    def run(self, n: int, step: float, signals: np.ndarray, jumps: np.ndarray) -> np.ndarray:
        """Outputs (n + 1, n_y) of n steps (s) under signals (n + 1, n_u) that jump at some points (n + 1,) uint8."""
        model = self.traced.model
        record = np.empty((n + 1, len(model.outputs.names)))
        parameters = np.append(model.parameters.starts, 1e-3)
        arrays = [parameters, np.ascontiguousarray(signals), np.ascontiguousarray(jumps), record]
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in arrays]
        self._run(ctypes.c_long(n), ctypes.c_double(step), *pointers)
        return record


def _sources(traced: TracedModel) -> dict[str, bytes]:
    arguments = {
        "initial_state": ("p",),
        "everything": ("t", "x", "u", "p"),
        "rates": ("t", "x", "u", "p"),
    }
    model = traced.model
    everything = traced.everything
    sizes = {"N_X": everything.numel_in(1), "N_U": everything.numel_in(2), "N_Y": len(model.outputs.names)}
    sizes["N_ALL"] = everything.numel_out(0)  # outputs, rates, and what must hold at a step
    head = "#include <math.h>\n" + declarations(getattr(traced, f) for f in arguments)
    head += "".join(f"#define {name} {size}\n" for name, size in sizes.items())
    functions = [c_function(getattr(traced, f), names, "loop") for f, names in arguments.items()]
    functions.append(runge_kutta_source(traced.rates, "loop"))
    files = {"equations.c": (head + "".join(functions) + LINEAR_INPUTS + _LOOP).encode()}
    return files | elementary_sources(*files.values())


def measure_equations(folder: Path) -> Section:
    """Time at equal steps, and at the longest step that keeps an error."""
    scenario, program = disturbed(), Program()
    model = program.traced.model
    parts = [scenario.signals[n].function(size, scenario.seed, n) for n, size in (("plant.tau_d", 3), ("plant.dm", 1))]
    times = np.arange(round(STOP_TIME / EVERY) + 1) * EVERY
    exact = end_effector(solve(times, lambda t: np.concatenate([*(f(t) for f in parts), [0.0]]), [4.0], rtol=1e-12))
    names = [name for name in model.outputs.names if not name.startswith("loop.")]
    system = scenario.system(folder, "fmi2")

    def error(simulation: Simulation, step: float) -> float:
        try:
            results = simulation.run(STOP_TIME, step)
        except SimulationError:  # it diverges
            return math.inf
        path = np.column_stack([results["plant.x_E"], results["plant.y_E"]])[:: round(EVERY / step)]
        return float(np.hypot(*(path - exact).T).max())

    rows, data, verdicts = [], {}, []
    recorded = [*names, *_INPUTS]
    with (
        Simulation(system, interface="model-exchange", solver="rk4", record=recorded) as ours,
        Simulation(system, record=recorded) as boxes,
    ):
        errors, of_boxes = ({step: error(each, step) for step in STEPS} for each in (ours, boxes))
        chosen, within = {1e-3: "1 ms"}, {1e-3: 1e-3}
        for wanted in ERRORS:
            step = max((s for s, e in errors.items() if e <= wanted), default=min(STEPS))
            chosen[step] = "; ".join([*([chosen[step]] if step in chosen else []), f"longest to {wanted:g} m"])
            within[step] = max((s for s, e in of_boxes.items() if e <= wanted), default=min(STEPS))
        for step, what in chosen.items():
            results = ours.run(STOP_TIME, step)
            signals = np.zeros((len(results.time), len(model.inputs.names)))
            for i, name in enumerate(model.inputs.names):
                signals[:, i] = results[name] if name in _INPUTS else 0.0
            n, jumps = len(results.time) - 1, np.zeros(len(results.time), dtype=np.uint8)
            jumps[[0, round(4.0 / step)]] = 1
            record = program.run(n, step, signals, jumps)
            difference = max(np.abs(record[:, i] - results[name]).max() for i, name in enumerate(names))

            def one_program(n: int = n, step: float = step, s: np.ndarray = signals, j: np.ndarray = jumps) -> float:
                began = time.perf_counter()
                program.run(n, step, s, j)
                return time.perf_counter() - began

            def coupled(step: float = step) -> float:
                return float(ours.run(STOP_TIME, step).info["loop_time_s"])

            def by_values(step: float = within[step]) -> float:
                return float(boxes.run(STOP_TIME, step).info["loop_time_s"])

            seconds = interleaved({"program": one_program, "coupled": coupled, "boxes": by_values}, ROUNDS)
            against, apart = (ratio(seconds[name], seconds["program"]) for name in ("coupled", "boxes"))
            medians = {name: statistics.median(values) * 1e3 for name, values in seconds.items()}
            rows.append(
                (
                    what,
                    f"{step * 1e3:g} ms",
                    f"{errors[step]:.1e}",
                    *(f"{medians[name]:.2f}" for name in ("program", "coupled")),
                    f"{against:.2f}",
                    f"{difference:.0e}",
                    f"{within[step] * 1e3:g} ms",
                    f"{of_boxes[within[step]]:.1e}",
                    f"{medians['boxes']:.2f}",
                    f"{apart:.2f}",
                )
            )
            data[f"{step:g}"] = {
                "error": errors[step],
                "ratio": against,
                "difference": difference,
                "seconds": seconds,
                "ratio_of_black_boxes": apart,
                "step_of_black_boxes": within[step],
            }
            for wanted, most in ((1e-6, 3.5), (1e-8, 4.0)):
                if f"{wanted:g}" in what:
                    said = f"black boxes / one program, each with its longest step to {wanted:g} m: {apart:.2f}"
                    verdicts.append((f"{said}, at most {most}", apart <= most))
            limit = 1.3 if step == 1e-3 else 1.4
            verdicts.append((f"model exchange / one program, {what}: {against:.2f}, at most {limit}", against <= limit))
            verdicts.append(
                (f"largest difference between the two at {step * 1e3:g} ms: {difference:.0e}", difference < 1e-12)
            )
    return Section(
        "Model exchange against one C program of all equations",
        "15 s of the robot with mass change and disturbance; three FMUs of FMI 2.0, integrated together by RK4, and a "
        "C program generated from the composed model, the same method and outputs recorded; in both signals are "
        "straight between points. Errors (m) of the end effector against DOP853, 1e-12. Black boxes: the same FMUs by "
        f"co-simulation, coupled as by default, with their longest step. Medians of {ROUNDS} interleaved runs.",
        (
            *("what", "step", "error", "program, ms", "model exchange, ms", "ratio", "difference"),
            *("black boxes: step", "error", "ms", "ratio to the program"),
        ),
        rows,
        data,
        verdicts,
    )


_INPUTS = ("plant.tau_d[1]", "plant.tau_d[2]", "plant.tau_d[3]", "plant.dm")
