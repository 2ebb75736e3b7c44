"""Analysis of the rows of both sweeps, and the files of the study."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from cosim.files.whole import write_json
from cosim.versions import versions
from parallel_robot.paper.reproduce.table import controllers
from parallel_robot.paper.robustness import draw, rows
from parallel_robot.paper.robustness.content import BANDS, DATA, FIGURES, TEXT, Robustness, SourceRow
from parallel_robot.paper.robustness.front import fronts, in_condition
from parallel_robot.paper.robustness.spread import QUANTILES, bands, sensitivities, spreads
from parallel_robot.paper.robustness.study import CONDITIONS, SCENARIO, sources
from parallel_robot.paper.robustness.text import findings, in_markdown
from parallel_robot.scenario import load_scenario

#: Sizes of the figures (inches).
_SIZES = {"bands": (8.2, 6.2), "sensitivity": (8.2, 3.4), "pareto": (8.2, 6.8)}

#: How often `analyse` reports progress.
STEPS = len(_SIZES) + 1


def analyse(
    sweeps: Path, folder: Path, seed: int, levels: int, progress: Callable[[], object] = lambda: None
) -> Robustness:
    """Analyse the rows of both sweeps below a folder, and write figures, tables and text into another.

    `progress` is called `STEPS` times.

    Raises
    ------
    SweepError
        There are no such sweeps, or too many runs have failed.
    OSError
        A file can't be written.
    """
    scenario = load_scenario(SCENARIO)
    known = sources(scenario)
    uncertain = [source.uncertain for source in known]
    uncertain_runs = rows.monte_carlo(sweeps, [u.factor.name for u in uncertain])
    gain_runs = rows.gains(sweeps)
    which = int(in_condition(gain_runs, CONDITIONS[0])[0][[c.key for c in controllers()].index("1")])
    nominal = {name: curves[which] for name, curves in gain_runs.curves.items()}
    failed = int(np.isnan(uncertain_runs.error).sum())
    quantiles = bands(uncertain_runs)
    spread = spreads(uncertain_runs, gain_runs, which)
    sensitivity = sensitivities(uncertain_runs, uncertain, seed)
    front = fronts(gain_runs)
    disturbed_from = max(getattr(shape, "start_time", 0.0) for shape in scenario.signals.values())
    drawings = (
        draw.bands(uncertain_runs, quantiles, nominal, disturbed_from),
        draw.sensitivities(sensitivity, len(uncertain_runs.error)),
        draw.pareto(gain_runs, front),
    )
    study = Robustness(
        runs=len(uncertain_runs.error),
        failed=failed,
        seed=seed,
        levels=levels,
        sources=tuple(SourceRow(s.uncertain.factor.name, s.uncertain.group, s.unit, s.distribution) for s in known),
        spreads=spread,
        sensitivities=sensitivity,
        fronts=front,
        findings=findings(uncertain_runs, failed, spread, sensitivity, front),
        figures=tuple(figure for _, figure in drawings),
        versions=versions(),
    )
    (folder / FIGURES).mkdir(parents=True, exist_ok=True)
    for drawing, figure in drawings:
        progress()
        draw.save(drawing, figure, folder / FIGURES, _SIZES[figure.name])
    _write_bands(folder / BANDS, uncertain_runs.times, quantiles, nominal)
    (folder / TEXT).write_text(in_markdown(study), encoding="utf-8", newline="\n")
    progress()
    write_json(folder / DATA, dataclasses.asdict(study))  # last: with it the study is whole
    return study


def _write_bands(
    path: Path, times: np.ndarray, quantiles: Mapping[str, np.ndarray], nominal: Mapping[str, np.ndarray]
) -> None:
    """Bands as a table: time (s), then for each error (mm, mrad) its quantiles and the paper's case."""
    heads, columns = ["time"], [times]
    for name, values in quantiles.items():
        heads += [*(f"{name}.{100 * q:g}%" for q in QUANTILES), f"{name}.nominal"]
        columns += [*values, nominal[name]]
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(heads)
        writer.writerows(np.round(np.stack(columns, axis=1), 9).tolist())
