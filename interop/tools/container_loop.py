"""Run and record an FMU that couples others inside: two calls of its C functions a step, with prepared buffers."""

from __future__ import annotations

import ctypes
import time
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave

from interop.tools.case import Case
from interop.tools.fmpy_loop import instance

#: What a reader of the figures has to know.
NOTE = "C functions of the container called by ctypes; FMPy's doStep and getReal take three times as long"


def run_container(file: Path, folder: Path, case: Case, recorded: list[str]) -> tuple[np.ndarray, float]:
    """Run a container FMU whose variables have the names of the case.

    Returns
    -------
    table : array (steps + 1, len(recorded))
    loop_time : float
        In s.
    """
    container = instance("container", file, folder)
    container.setupExperiment(startTime=0.0, stopTime=case.stop_time)
    container.enterInitializationMode()
    container.exitInitializationMode()
    names = {v.name: v.valueReference for v in fmpy.read_model_description(file).modelVariables}
    table = np.zeros((case.steps + 1, len(recorded)))
    loop_time = _fill(table, container, [names[name] for name in recorded], case.step_size)
    container.terminate()
    container.freeInstance()
    return table, loop_time


def _fill(table: np.ndarray, container: FMU2Slave, references: list[int], step_size: float) -> float:
    """Step and record one row a communication point; returns the seconds that took."""
    n = len(references)
    do_step, get_real = container.dll.fmi2DoStep, container.dll.fmi2GetReal
    do_step.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int]
    get_real.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p]
    component, array = container.component, (ctypes.c_uint * n)(*references)
    row, stride = table.ctypes.data, table.strides[0]
    failures = get_real(component, array, n, row)
    began = time.perf_counter()
    for i in range(len(table) - 1):
        row += stride
        failures |= do_step(component, i * step_size, step_size, 1) | get_real(component, array, n, row)
    loop_time = time.perf_counter() - began
    if failures:
        raise RuntimeError("the container did not return OK at every step")
    return loop_time
