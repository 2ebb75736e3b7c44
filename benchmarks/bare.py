"""What FMUs alone cost: the calls of one communication step after the other, in a C loop with nothing between them."""

from __future__ import annotations

import ctypes
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path

import fmpy
from fmpy.fmi2 import FMU2Slave

from fmu_export.modelling.model import Model
from fmu_export.native.toolchain import compile_library, host_target
from parallel_robot.fmus import fmu_path
from parallel_robot.models import MODELS
from parallel_robot.wiring import CONNECTIONS

_LOOP = b"""
#include <stddef.h>
typedef int Exchange(void *, const unsigned *, size_t, double *);
typedef int Step(void *, double, double, int);
typedef struct { void *function, *instance; const unsigned *references; size_t n; double *values; } Call;
#ifdef _WIN32
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
int steps(const Call calls[], int n_calls, double h, long n) {
    int status = 0;
    for (long i = 0; i < n && !status; i++)
        for (const Call *c = calls; c < calls + n_calls; c++)
            status |= c->n ? ((Exchange *)c->function)(c->instance, c->references, c->n, c->values)
                           : ((Step *)c->function)(c->instance, i * h, h, 1);
    return status;
}
"""


class _Call(ctypes.Structure):
    _fields_ = (
        ("function", ctypes.c_void_p),
        ("instance", ctypes.c_void_p),
        ("references", ctypes.POINTER(ctypes.c_uint)),
        ("n", ctypes.c_size_t),
        ("values", ctypes.POINTER(ctypes.c_double)),
    )


@cache
def _loop() -> ctypes.CDLL:
    path = Path(tempfile.mkdtemp(prefix="bare_")) / f"steps{host_target().suffix}"
    path.write_bytes(compile_library({"steps.c": _LOOP}, "steps"))
    return ctypes.CDLL(str(path))


@contextmanager
def _slave(fmu: Path, name: str) -> Iterator[tuple[FMU2Slave, dict[str, int]]]:
    """An FMU that is ready to step, and its value references."""
    description = fmpy.read_model_description(fmu)
    with tempfile.TemporaryDirectory() as folder:
        fmpy.extract(fmu, folder)
        slave = FMU2Slave(
            guid=description.guid, unzipDirectory=folder, modelIdentifier=description.modelName, instanceName=name
        )
        slave.instantiate()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        yield slave, {v.name: v.valueReference for v in description.modelVariables}
        slave.terminate()
        slave.freeInstance()


def _exchanges(name: str, model: Model) -> list[tuple[str, list[str]]]:
    """What our master gets and sets of an FMU at a communication point, in order."""
    sources = {source for source, _ in CONNECTIONS}
    feeding = [n for v in model.outputs.variables for n in v.names if f"{name}.{v.name}" in sources]
    rest = [n for n in model.outputs.names if n not in feeding]
    if name == "plant":  # it feeds the controller before it gets its torques
        return [("Get", feeding), ("Set", model.inputs.names), ("Get", rest)]
    return [("Set", model.inputs.names), ("Get", [*feeding, *rest])]


def bare_time(folder: Path, flavour: str, n: int, step: float = 1e-3) -> float:
    """Seconds that n steps (s) of plant, controller and trajectory take, by the calls our master makes."""
    exchanges, steps = [], []
    inputs, outputs = (ctypes.c_double * 64)(), (ctypes.c_double * 64)()
    with ExitStack() as stack:
        for name, model in MODELS.items():
            slave, references = stack.enter_context(_slave(fmu_path(folder, flavour, name), name))

            def call(function: str, names: list[str], slave: FMU2Slave = slave, of: dict = references) -> _Call:
                address = ctypes.cast(getattr(slave.dll, f"fmi2{function}"), ctypes.c_void_p).value
                numbers = (ctypes.c_uint * max(1, len(names)))(*(of[n] for n in names))
                values = inputs if function == "SetReal" else outputs
                return _Call(address, slave.component, numbers, len(names), values)

            exchanges += [call(f"{kind}Real", names) for kind, names in _exchanges(name, model) if names]
            steps.append(call("DoStep", []))
        calls = (_Call * (len(exchanges) + len(steps)))(*exchanges, *steps)
        began = time.perf_counter()
        status = _loop().steps(calls, len(calls), ctypes.c_double(step), ctypes.c_long(n))
        total = time.perf_counter() - began
    if status:
        raise RuntimeError(f"a call returned {status}")
    return total
