"""A small study for the tests of sweeps, in a module of its own: worker processes import it."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.master.simulation import Simulation
from cosim.results.results import Results
from cosim.sweep import stock
from cosim.sweep.study import PlannedRun
from cosim.system.system import System

#: An FMU of someone else: counts up; raises from `limit` on; takes its process down when `deadly`.
SLAVE = """
import ctypes

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class Counter(Fmi2Slave):
    def __init__(self, **arguments):
        super().__init__(**arguments)
        self.y, self.rate, self.limit, self.deadly = 0.0, 1.0, 1e9, 0.0
        self.register_variable(Real("y", causality=Fmi2Causality.output))
        for name in ("rate", "limit", "deadly"):
            self.register_variable(
                Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable)
            )

    def do_step(self, time, step):
        if self.deadly:
            ctypes.string_at(0)
        self.y += self.rate * step
        if self.y > self.limit:
            raise RuntimeError("over the limit")
        return True
"""


def build_counter(folder: Path) -> Path:
    """The FMU; pythonfmu's own builder would make one that now and then aborts its host at exit."""
    (folder / "counter.py").write_text(SLAVE)
    command = [sys.executable, "-c", "from fmu_export import build_script; build_script('counter.py')"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder / "Counter.fmu"


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@dataclass(frozen=True)
class CounterStudy:
    """Factors are start values of the counter; the one metric is where it ends."""

    fmu: str
    stop_time: float = 1.0

    @property
    def metrics(self) -> tuple[str, ...]:
        return ("y",)

    @property
    def curves(self) -> tuple[str, ...]:
        return ()

    def simulation(self, variant: Any, fmu: Callable[[str], Path]) -> Simulation:  # noqa: ARG002
        system = System()
        system.add("counter", fmu(self.fmu))
        return Simulation(system)

    def plan(self, point: Mapping[str, Any]) -> PlannedRun:
        return PlannedRun("counter", self.stop_time, 0.125, point)

    def row(self, planned: PlannedRun, results: Results) -> dict[str, float | None]:  # noqa: ARG002
        return {"y": float(results["counter.y"][-1])}

    def fingerprint(self) -> dict[str, Any]:
        return {"fmu": self.fmu, "stop_time": self.stop_time}


def arrivals() -> dict[str, int]:
    """How often each parcel has arrived at this worker process."""
    return dict(stock.arrivals)


def process() -> int:
    """Number of this process."""
    return os.getpid()
