"""All measures that `claims.toml` names: functions of `Material` that return what they `Measured`."""

from __future__ import annotations

import inspect
from collections.abc import Callable

from parallel_robot.paper.reproduce import measure_gains, measure_model, measure_proof, measure_tracking
from parallel_robot.paper.reproduce.content import Measured
from parallel_robot.paper.reproduce.material import Material

Measure = Callable[[Material], Measured]


def _measures_of(module: object) -> dict[str, Measure]:
    functions = inspect.getmembers(module, inspect.isfunction)
    return {n: f for n, f in functions if inspect.signature(f).return_annotation == "Measured" and n[0] != "_"}


MEASURES: dict[str, Measure] = {
    name: function
    for module in (measure_model, measure_gains, measure_tracking, measure_proof)
    for name, function in _measures_of(module).items()
}
