"""Recipes for tools that can't be run here, with values to check them against: `python -m interop.recipes`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cosim import Results, System, simulate
from interop.references import distance
from parallel_robot.fmus import BUILDABLE, CLOSED_LOOP, build, fmu_path
from parallel_robot.models import MODELS
from parallel_robot.wiring import CONNECTIONS

#: What a reader compares, all at the stop time.
SHOWN = (
    *("plant.x_E", "plant.y_E", "plant.theta_a[1]", "plant.theta_a[2]", "plant.theta_a[3]"),
    *("controller.psi[1]", "controller.tau_a[1]"),
)
DIGITS = 6
#: Of the values of one FMU: rounding to the digits shown, and a solver with a relative tolerance of 1e-8.
TOLERANCE = 1e-6


def recipes(fmus: Path) -> str:
    """The page.

    Parameters
    ----------
    fmus : Path
        Folder of native FMUs, `<fmus>/fmi2/*.fmu`.
    """
    experiment = MODELS["plant"].default_experiment
    stop, step = experiment.stop_time, experiment.step_size
    one = _one(fmus, {}, stop, step)
    pd = _one(fmus, {"controller.alpha": 0.0}, stop, step)
    coupled: dict[str, Results] = {order: _coupled(fmus, order, stop, step) for order in ("sequential", "parallel")}
    units = {f"{part}.{n}": v.unit for part, m in MODELS.items() for v in m.outputs.variables for n in v.names}
    errors = {order: f"{distance(_path(results), _path(one, 'loop.')):.1e}" for order, results in coupled.items()}
    runs = {"one FMU": one, **coupled}
    prefix = {"one FMU": "loop."}
    table = "\n".join(
        f"| `{name}` | {units[name]} | "
        + " | ".join(f"{r[prefix.get(n, '') + name][-1]:.{DIGITS}f}" for n, r in runs.items())
        + " |"
        for name in SHOWN
    )
    text = Path(__file__).with_suffix(".md").read_text(encoding="utf-8")
    return text.format(
        connections="\n".join(f"  - `{source}` to `{target}`" for source, target in CONNECTIONS),
        values=table,
        stop=stop,
        step=step,
        step_ms=step * 1e3,
        tolerance_one=TOLERANCE,
        error_sequential=errors["sequential"],
        error_parallel=errors["parallel"],
        pd_x=f"{pd['loop.plant.x_E'][-1]:.{DIGITS}f}",
        pd_y=f"{pd['loop.plant.y_E'][-1]:.{DIGITS}f}",
    )


def _one(fmus: Path, start: Mapping[str, float], stop: float, step: float) -> Results:
    system = System()
    system.add(
        "loop", fmu_path(fmus, "fmi2", CLOSED_LOOP), start={"plant.tau_d": [0.0, 0.0, 0.0], "plant.dm": 0.0, **start}
    )
    return simulate(system, stop, step)


def _coupled(fmus: Path, order: str, stop: float, step: float) -> Results:
    system = System()
    for name in MODELS:
        system.add(name, fmu_path(fmus, "fmi2", name), {"tau_d": [0.0, 0.0, 0.0], "dm": 0.0} if name == "plant" else {})
    for source, target in CONNECTIONS:
        system.connect(source, target)
    return simulate(system, stop, step, order=order, extrapolation="hold")


def _path(results: Results, prefix: str = "") -> np.ndarray:
    return np.column_stack([results[f"{prefix}plant.x_E"], results[f"{prefix}plant.y_E"]])


def main(arguments: list[str] | None = None) -> int:
    """Write the page."""
    parser = argparse.ArgumentParser(prog="python -m interop.recipes", description=__doc__)
    parser.add_argument("--fmus", type=Path, default=Path("fmus"), help="folder of the FMUs (default: fmus)")
    parser.add_argument("--page", type=Path, default=Path("docs/recipes.md"), help="page to write")
    options = parser.parse_args(arguments)
    build(options.fmus, "fmi2", BUILDABLE)
    options.page.write_text(recipes(options.fmus), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
