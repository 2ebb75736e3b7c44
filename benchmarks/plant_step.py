"""Time of one 1 ms step of the plant FMU, by flavour, interleaved in one run: `python benchmarks/plant_step.py [FMUS]`.

The calls come from a loop in C, as in a simulation tool; in a Python process, for the pythonfmu flavour needs one.
"""

from __future__ import annotations

import ctypes
import statistics
import sys
import tempfile
import time
from pathlib import Path

import fmpy
from fmpy.fmi2 import FMU2Slave

from fmu_export.toolchain import compile_library, host_target

FLAVOURS = ("fmi2", "pythonfmu")
ROUNDS = 11
CALLS = {"fmi2": 20_000, "pythonfmu": 400}

LOOP = b"""
#ifdef _WIN32
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
int steps(int (*do_step)(void *, double, double, int), void *component, double step, long n) {
    int status = 0;
    for (long i = 0; i < n && !status; i++) status = do_step(component, i * step, step, 1);
    return status;
}
"""


def plant(fmu: Path, folder: Path) -> FMU2Slave:
    """An initialised instance under a constant torque."""
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
    return instance


def time_per_step(loop: ctypes.CDLL, instance: FMU2Slave, n: int) -> float:
    """Seconds a step, over n steps from where the instance is."""
    do_step = ctypes.cast(instance.dll.fmi2DoStep, ctypes.c_void_p)
    began = time.perf_counter()
    status = loop.steps(do_step, ctypes.c_void_p(instance.component), ctypes.c_double(1e-3), ctypes.c_long(n))
    seconds = time.perf_counter() - began
    if status:
        raise RuntimeError(f"fmi2DoStep returned {status}")
    return seconds / n


def main(fmus: Path) -> None:
    """Measure and print medians."""
    with tempfile.TemporaryDirectory() as temporary:
        instances = {f: plant(fmus / f / "RobotPlant.fmu", Path(temporary) / f) for f in FLAVOURS}
        library = Path(temporary) / f"steps{host_target().suffix}"
        library.write_bytes(compile_library({"steps.c": LOOP}, "steps"))
        loop = ctypes.CDLL(str(library))
        times: dict[str, list[float]] = {f: [] for f in FLAVOURS}
        for _ in range(ROUNDS):
            for flavour, instance in instances.items():
                times[flavour].append(time_per_step(loop, instance, CALLS[flavour]))
        steps = {flavour: statistics.median(values) for flavour, values in times.items()}
        for flavour, seconds in steps.items():
            print(f"{flavour:<10} {seconds * 1e6:8.2f} us a step of 1 ms")
        ratios = [slow / fast for slow, fast in zip(times["pythonfmu"], times["fmi2"], strict=True)]
        print(f"ratio      {statistics.median(ratios):8.1f}")
        for instance in instances.values():
            instance.terminate()
            instance.freeInstance()


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "fmus"))
