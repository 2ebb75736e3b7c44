"""What FMUs alone cost: the calls of one communication step in a C loop, on one FMU after the other."""

from __future__ import annotations

import ctypes
import tempfile
from functools import cache
from pathlib import Path

import fmpy
from fmpy.fmi2 import FMU2Slave

from cosim.robot.coupling import CONNECTIONS
from cosim.robot.fmus import fmu_path
from cosim.robot.models import MODELS
from fmu_export.toolchain import compile_library, host_target

_LOOP = b"""
#include <stddef.h>
typedef int Exchange(void *, const unsigned *, size_t, double *);
typedef int Step(void *, double, double, int);
#ifdef _WIN32
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
int steps(void *c, Exchange *set, Exchange *get, Step *step, const unsigned *inputs, size_t n_inputs,
          const unsigned *outputs, size_t n_outputs, const unsigned *late, size_t n_late, double *u, double *y,
          double h, long n) {
    int status = 0;
    for (long i = 0; i < n && !status; i++) {
        if (n_outputs) status |= get(c, outputs, n_outputs, y);
        if (n_inputs) status |= set(c, inputs, n_inputs, u);
        if (n_late) status |= get(c, late, n_late, y);
        status |= step(c, i * h, h, 1);
    }
    return status;
}
"""


@cache
def _loop() -> ctypes.CDLL:
    path = Path(tempfile.mkdtemp(prefix="bare_")) / f"steps{host_target().suffix}"
    path.write_bytes(compile_library({"steps.c": _LOOP}, "steps"))
    return ctypes.CDLL(str(path))


def bare_times(folder: Path, flavour: str, n: int, step: float = 1e-3) -> float:
    """Seconds that n steps (s) of plant, controller and trajectory take, summed, by the calls our master makes."""
    import time

    sources = {source for source, _ in CONNECTIONS}
    total = 0.0
    for name, model in MODELS.items():
        description = fmpy.read_model_description(fmu_path(folder, flavour, name))
        references = {v.name: v.valueReference for v in description.modelVariables}
        feeding = [n for v in model.outputs.variables for n in v.names if f"{name}.{v.name}" in sources]
        rest = [n for n in model.outputs.names if n not in feeding]
        early, late = (feeding, rest) if name == "plant" else ([], [*feeding, *rest])
        with tempfile.TemporaryDirectory() as unpacked:
            fmpy.extract(fmu_path(folder, flavour, name), unpacked)
            slave = FMU2Slave(
                guid=description.guid, unzipDirectory=unpacked, modelIdentifier=description.modelName, instanceName=name
            )
            slave.instantiate()
            slave.setupExperiment(startTime=0.0)
            slave.enterInitializationMode()
            slave.exitInitializationMode()
            vrs = [
                (ctypes.c_uint * max(1, len(ns)))(*(references[n] for n in ns))
                for ns in (model.inputs.names, early, late)
            ]
            u, y = (ctypes.c_double * 64)(), (ctypes.c_double * 64)()
            functions = [
                ctypes.cast(getattr(slave.dll, f), ctypes.c_void_p)
                for f in ("fmi2SetReal", "fmi2GetReal", "fmi2DoStep")
            ]
            arguments = [ctypes.c_void_p(slave.component), *functions]
            for vr, ns in zip(vrs, (model.inputs.names, early, late), strict=True):
                arguments += [vr, ctypes.c_size_t(len(ns))]
            began = time.perf_counter()
            status = _loop().steps(*arguments, u, y, ctypes.c_double(step), ctypes.c_long(n))
            total += time.perf_counter() - began
            slave.terminate()
            slave.freeInstance()
            if status:
                raise RuntimeError(f"{name}: a call returned {status}")
    return total
