"""Time of one 1 ms step of the plant FMU, by flavour.

The calls come from a loop in C, as in a simulation tool; in a Python process, for the pythonfmu flavour needs one.
"""

from __future__ import annotations

import ctypes
import statistics
import tempfile
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import fmpy
from fmpy.fmi2 import FMU2Slave

from benchmarks.measure import Section, interleaved, ratio
from fmu_export.native.toolchain import compile_library, host_target

FLAVOURS = ("fmi2", "pythonfmu")
ROUNDS = 11
CALLS = {"fmi2": 20_000, "pythonfmu": 400}

LOOP = b"""
#ifdef _WIN32
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
int steps(int (*do_step)(void *, double, double, int), void *component, double step, long first, long n) {
    int status = 0;
    for (long i = first; i < first + n && !status; i++) status = do_step(component, i * step, step, 1);
    return status;
}
"""


@dataclass
class Plant:
    """An initialised instance under a constant torque, and how many steps it has made."""

    instance: FMU2Slave
    n_steps: int = 0


def plant(fmu: Path, folder: Path) -> Plant:
    """A plant that has made no step yet."""
    description = fmpy.read_model_description(fmu)
    fmpy.extract(fmu, folder)
    instance = FMU2Slave(
        guid=description.guid,
        unzipDirectory=folder,
        modelIdentifier=description.modelName,
        instanceName="plant",
    )
    instance.instantiate()
    references = [v.valueReference for v in description.modelVariables if v.name.startswith("tau_a")]
    instance.setReal(references, [0.05, -0.02, 0.03])
    instance.setupExperiment(startTime=0.0)
    instance.enterInitializationMode()
    instance.exitInitializationMode()
    return Plant(instance)


def time_per_step(loop: ctypes.CDLL, plant: Plant, n: int) -> float:
    """Seconds a step, over n steps from where the instance is."""
    instance = plant.instance
    do_step = ctypes.cast(instance.dll.fmi2DoStep, ctypes.c_void_p)
    began = time.perf_counter()
    first, count = ctypes.c_long(plant.n_steps), ctypes.c_long(n)
    status = loop.steps(do_step, ctypes.c_void_p(instance.component), ctypes.c_double(1e-3), first, count)
    seconds = time.perf_counter() - began
    if status:
        raise RuntimeError(f"fmi2DoStep returned {status}")
    plant.n_steps += n
    return seconds / n


def measure_plant_step(fmus: Path) -> Section:
    """One step of the plant in each flavour."""
    with tempfile.TemporaryDirectory() as temporary:
        plants = {f: plant(fmus / f / "RobotPlant.fmu", Path(temporary) / f) for f in FLAVOURS}
        library = Path(temporary) / f"steps{host_target().suffix}"
        library.write_bytes(compile_library({"steps.c": LOOP}, "steps"))
        loop = ctypes.CDLL(str(library))
        seconds = interleaved({f: partial(time_per_step, loop, each, CALLS[f]) for f, each in plants.items()}, ROUNDS)
        for each in plants.values():
            each.instance.terminate()
            each.instance.freeInstance()
    native, times = statistics.median(seconds["fmi2"]), ratio(seconds["pythonfmu"], seconds["fmi2"])
    return Section(
        "One step of the plant",
        f"fmi2DoStep over 1 ms in a loop in C, medians of {ROUNDS} interleaved rounds.",
        ("flavour", "us a step"),
        [(f, f"{statistics.median(v) * 1e6:.2f}") for f, v in seconds.items()],
        {"seconds": seconds, "ratio": times},
        [
            (f"native: {native * 1e6:.2f} us, under 2 us", native < 2e-6),
            (f"pythonfmu / native: {times:.1f}, at least 50", times >= 50.0),
        ],
    )
