"""CoFmuPy: a system described in JSON, stepped by its coordinator; its master keeps all outputs in memory.

Traps: it exchanges nothing before the first step, for which connected inputs are 0; it files the outputs at the end of
a step under the time of its start; the order of FMUs in a loop is that of a set of texts, which changes from process to
process. Of its methods, Gauss-Seidel is the more accurate at the same cost.
"""

from __future__ import annotations

import json
import tempfile
import time
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import fmpy
import numpy as np
from fmpy.model_description import ModelDescription

from interop.tools.availability import missing
from interop.tools.case import Case, ToolRun, split

NAME = "cofmupy"
TITLE = "CoFmuPy, Gauss-Seidel"
PACKAGE = "cofmupy"


def unavailable() -> str | None:
    """It demands exact versions of packages of ours, so that pip can't install it beside them as it is."""
    return missing("cofmupy", "pip install --no-deps cofmupy && pip install confluent-kafka networkx pandas plotly")


def run(case: Case, folder: Path) -> ToolRun:
    """One call of the coordinator a step; its `run_simulation` is the same loop, but ends by a sum of rounded times."""
    with redirect_stdout(StringIO()):
        from cofmupy import Coordinator, wrappers

    wrappers.read_model_description = _read_model_description
    tempfile.tempdir = str(folder)  # it unpacks FMUs there and leaves them behind
    began = time.perf_counter()
    system = folder / "system.json"
    system.write_text(json.dumps(_system(case)), encoding="utf-8")
    with redirect_stdout(StringIO()):
        coordinator = Coordinator()
        coordinator.start(str(system))
    rank = list(dict.fromkeys([*(split(source)[0] for source, _ in case.connections), *case.fmus])).index
    master = coordinator.master
    master.sequence_order = [sorted(loop, key=rank) for loop in master.sequence_order]
    loop_began = time.perf_counter()
    for _ in range(case.steps):
        coordinator.do_step(case.step_size)
    loop_time = time.perf_counter() - loop_began
    results = coordinator.get_results()
    x_E, y_E = (np.array(results[split(name)]) for name in case.path)
    total = time.perf_counter() - began
    recorded = len(results) - 1  # one is the time
    return ToolRun(loop_time, total, case.times[1:], x_E, y_E, "Gauss-Seidel", recorded, "records outputs only")


def _system(case: Case) -> dict[str, object]:
    return {
        "cosim_method": "gauss_seidel",
        "iterative": False,
        "fmus": [
            {"id": instance, "path": str(fmu), "initialization": dict(case.start.get(instance, {}))}
            for instance, fmu in case.fmus.items()
        ],
        "connections": [{"source": _end(source), "target": _end(target)} for source, target in case.connections],
    }


def _end(path: str) -> dict[str, str]:
    instance, variable = split(path)
    return {"type": "fmu", "id": instance, "variable": variable}


def _read_model_description(fmu: str) -> ModelDescription:
    """As FMPy's, with the default step as a number: CoFmuPy 1.0.0 looks for the smallest and fails on texts."""
    description = fmpy.read_model_description(fmu)
    experiment = description.defaultExperiment
    if experiment and experiment.stepSize:
        experiment.stepSize = float(experiment.stepSize)
    return description
