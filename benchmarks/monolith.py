"""The paper's closed loop as one C program, from the same models: what a master without FMUs could do at best.

Same arithmetic as the coupled FMUs in the sequential order, inputs linear between communication points, everything
recorded; no checks, no function pointers, no tables. There are two: one calls the models' functions one after the
other, outputs, derivatives, integrator step; the other computes outputs and derivatives together, as the FMUs do.
"""

from __future__ import annotations

import ctypes
import re
import tempfile
from pathlib import Path

import numpy as np

from fmu_export.native.c_source import c_function
from fmu_export.native.elementary import declarations, elementary_sources
from fmu_export.native.runge_kutta import LINEAR_INPUTS, runge_kutta_source
from fmu_export.native.toolchain import compile_library, host_target
from fmu_export.trace.trace import trace
from parallel_robot.models import MODELS

#: Columns of the record: outputs of plant, controller and trajectory, inputs of plant and controller.
COLUMNS = [
    *(f"plant.{n}" for n in MODELS["plant"].outputs.names),
    *(f"controller.{n}" for n in MODELS["controller"].outputs.names),
    *(f"trajectory.{n}" for n in MODELS["trajectory"].outputs.names),
    *(f"plant.{n}" for n in MODELS["plant"].inputs.names),
    *(f"controller.{n}" for n in MODELS["controller"].inputs.names),
]

_HEAD = f"""
#include <string.h>
#define COLUMNS {len(COLUMNS)}
#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
"""

_LOOP = """
#define RATES(rate, now, last, n) \\
    for (int j = 0; j < n; j++) { \\
        rate[j] = fresh ? 0.0 : (now[j] - last[j]) * per_second; \\
        last[j] = now[j]; \\
    }

EXPORT void run(long n, double h, const double p[], const double c[], const double r[], const double signals[],
                const unsigned char jumps[], double *row) {
    /* plant: u = tau_a, tau_d, dm, dm_rate (0); controller: v = theta_a, omega_a, theta_ref, omega_ref, tau_ref */
    double x[12], x_next[12], psi[2], psi_next[2], u[8] = {0}, v[15], y[22 + 16], z[5 + 2], w[11];
    double u_rate[8] = {0}, v_rate[15], last_u[8], last_v[15], stages[3 * 16], middle[15], end[15];
    double per_second = 1.0 / h;
    plant_initial_state(p, x);
    controller_initial_state(c, psi);
    for (long i = 0; i <= n; i++, row += COLUMNS) {
        double t = i * h;
        int fresh = jumps[i];
        for (int j = 0; j < 4; j++) u[3 + j] = signals[4 * i + j];
        trajectory_outputs(t, 0, 0, r, w);
        for (int j = 0; j < 3; j++)
            v[j] = x[j], v[3 + j] = x[6 + j], v[6 + j] = w[j], v[9 + j] = w[3 + j], v[12 + j] = w[8 + j];
        AT_POINT(controller, t, psi, v, c, z, 5);
        for (int j = 0; j < 3; j++) u[j] = z[j];
        AT_POINT(plant, t, x, u, p, y, 22);
        memcpy(row, y, 22 * sizeof *y), memcpy(row + 22, z, 5 * sizeof *z), memcpy(row + 27, w, sizeof w);
        memcpy(row + 38, u, sizeof u), memcpy(row + 46, v, sizeof v);
        if (i == n) break;
        RATES(v_rate, v, last_v, 15)
        RATES(u_rate, u, last_u, 3)
        if (!jumps[i + 1])
            for (int j = 0; j < 4; j++)
                u_rate[3 + j] = (signals[4 * (i + 1) + j] - u[3 + j]) * per_second, last_u[3 + j] = u[3 + j];
        else
            for (int j = 3; j < 7; j++) { u_rate[j] = fresh ? 0.0 : (u[j] - last_u[j]) * per_second; last_u[j] = u[j]; }
        between(u, u_rate, h, 8, middle, end);
        plant_step(t, h, x, middle, end, p, y + 22, x_next, stages);
        between(v, v_rate, h, 15, middle, end);
        controller_step(t, h, psi, middle, end, c, z + 5, psi_next, stages);
        memcpy(x, x_next, sizeof x), memcpy(psi, psi_next, sizeof psi);
    }
}
"""


#: What is computed at a communication point, as macros of the models' names.
_AT_POINT = {
    "separate": "model##_outputs(t, x, u, p, y), model##_derivatives(t, x, u, p, y + n)",
    "shared": "model##_everything(t, x, u, p, y)",
}

_ARGUMENTS = {
    "initial_state": ("p",),
    "outputs": ("t", "x", "u", "p"),
    "derivatives": ("t", "x", "u", "p"),
    "everything": ("t", "x", "u", "p"),
    "rates": ("t", "x", "u", "p"),
}


def sources(kind: str) -> dict[str, bytes]:
    """The program: a file for each model, as a programmer would have it, and one with the loop."""
    files, prototypes = {}, []
    for name, model in MODELS.items():
        traced = trace(model)
        functions = [c_function(getattr(traced, f), arguments, name) for f, arguments in _ARGUMENTS.items()]
        functions += [runge_kutta_source(traced.rates, name)] if model.states else []
        head = "#include <math.h>\n" + declarations(getattr(traced, f) for f in _ARGUMENTS)
        files[f"{name}.c"] = (head + "".join(functions)).encode()
        prototypes += [re.search(r"^void .*", f, re.M)[0] + ";\n" for f in functions]
    at_point = f"#define AT_POINT(model, t, x, u, p, y, n) {_AT_POINT[kind]}\n"
    files["loop.c"] = (_HEAD + at_point + "".join(prototypes) + LINEAR_INPUTS + _LOOP).encode()
    return files | elementary_sources(*files.values())


class Monolith:
    """The compiled program; `kind` is "separate" or "shared"."""

    def __init__(self, kind: str = "separate") -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"monolith{host_target().suffix}"
            path.write_bytes(compile_library(sources(kind), "monolith"))
            self._run = ctypes.CDLL(str(path)).run

    def run(self, n: int, step: float, signals: np.ndarray, jumps: np.ndarray) -> np.ndarray:
        """Record (n + 1, columns) of n steps (s); `signals` (n + 1, 4) are tau_d and dm, `jumps` (n + 1,) uint8."""
        record = np.empty((n + 1, len(COLUMNS)))
        parameters = [np.append(model.parameters.starts, 1e-3) for model in MODELS.values()]
        arrays = [*parameters, np.ascontiguousarray(signals), np.ascontiguousarray(jumps), record]
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in arrays]
        self._run(ctypes.c_long(n), ctypes.c_double(step), *pointers)
        return record
