"""Time of one 1 ms step of the plant FMU, by flavour, interleaved in one run: `python benchmarks/plant_step.py [FMUS]`.

The calls go through ctypes, whose own cost (an fmi2GetVersion call) is measured beside and subtracted.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import fmpy
from fmpy.fmi2 import FMU2Slave

FLAVOURS = ("fmi2", "pythonfmu")
ROUNDS = 7
CALLS = {"fmi2": 20_000, "pythonfmu": 500}


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


def time_per_call(call: Callable[[int], object], n: int) -> float:
    """Seconds a call, over n calls."""
    began = time.perf_counter()
    for i in range(n):
        call(i)
    return (time.perf_counter() - began) / n


def one_step(do_step: Callable[..., int], component: int, i: int) -> None:
    """One step of 1 ms."""
    do_step(component, i * 1e-3, 1e-3, 1)


def no_step(function: Callable[[], object], _: int) -> None:
    """A call that does nothing, through the same wrapper."""
    function()


def main(fmus: Path) -> None:
    """Measure and print medians."""
    with tempfile.TemporaryDirectory() as temporary:
        instances = {f: plant(fmus / f / "RobotPlant.fmu", Path(temporary) / f) for f in FLAVOURS}
        times: dict[str, list[float]] = {f: [] for f in (*FLAVOURS, "ctypes")}
        version = instances["fmi2"].dll.fmi2GetVersion
        for _ in range(ROUNDS):
            for flavour, instance in instances.items():
                times[flavour].append(
                    time_per_call(partial(one_step, instance.dll.fmi2DoStep, instance.component), CALLS[flavour])
                )
            times["ctypes"].append(time_per_call(partial(no_step, version), CALLS["fmi2"]))
        medians = {name: statistics.median(values) for name, values in times.items()}
        steps = {f: medians[f] - medians["ctypes"] for f in FLAVOURS}
        for flavour, seconds in steps.items():
            print(f"{flavour:<10} {seconds * 1e6:8.2f} us a step of 1 ms")
        print(f"ratio      {steps['pythonfmu'] / steps['fmi2']:8.1f}")
        for instance in instances.values():
            instance.terminate()
            instance.freeInstance()


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "fmus"))
