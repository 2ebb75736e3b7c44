"""Short runs of the robot in closed loop, and what tells one run from another to the last bit."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from cosim import System, simulate
from parallel_robot.models import MODELS
from parallel_robot.wiring import COMPONENTS, CONNECTIONS

#: So that disturbance, mass change and saturation take part.
START: dict[str, dict[str, float]] = {"plant": {"tau_d[2]": 0.05, "dm": 0.1}, "controller": {"tau_max[1]": 0.02}}


def closed_loop(
    folder: Path, components: Sequence[str] = COMPONENTS, isolate: Collection[str] = (), **start: float
) -> System:
    """The three FMUs of a folder, added and connected in an order of the components; `start` is for the plant."""
    system = System()
    for component in components:
        fmu = folder / f"{MODELS[component].name}.fmu"
        values = START.get(component, {}) | (start if component == "plant" else {})
        system.add(component, fmu, start=values, isolate=component in isolate)
    for source, target in sorted(CONNECTIONS, key=lambda pair: components.index(pair[1].partition(".")[0])):
        system.connect(source, target)
    return system


def digest_of_run(
    folder: Path,
    order: str,
    components: Sequence[str] = COMPONENTS,
    isolate: Collection[str] = (),
    start: dict[str, float] | None = None,
    **options: Any,
) -> str:
    """A hash of all columns of 0.1 s, in the order of their names."""
    results = simulate(closed_loop(folder, components, isolate, **start or {}), 0.1, 1e-3, order=order, **options)
    columns = [results[name].tobytes() for name in sorted(results.names)]
    return hashlib.sha256(b"".join(columns)).hexdigest()
