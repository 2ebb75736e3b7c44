"""Sweeps of the robot: what a point means, and which numbers of a run are kept."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_type_hints

from cosim.errors import SetupError, nearest
from cosim.master.extrapolation import Coupling
from cosim.master.simulation import Simulation, number_of_steps
from cosim.results.results import Results
from cosim.scenario.scenario import ScenarioError
from cosim.scenario.signals import Shape
from cosim.sweep.batch import RowValue
from cosim.sweep.errors import SweepError
from cosim.sweep.points import Factor, Levels, Value
from cosim.sweep.study import PlannedRun, check_start
from cosim.system.system import Signal, System
from parallel_robot.fmus import fmu_path
from parallel_robot.metrics import metrics, tracking_errors
from parallel_robot.own_fmus import replaced
from parallel_robot.scenario import RobotScenario

#: Factors that are no variables. FMU files of an instance are the factor `<instance>.fmu`.
SCENARIO, FLAVOUR, SEED, STEP, FMU = "scenario", "flavour", "seed", "step_size", ".fmu"

_ERRORS = ("x", "y", "theta_a[1]", "theta_a[2]", "theta_a[3]")
_MEASURES = ("max", "rms", "accumulated", "steady_max", "steady_rms")

#: Columns of a row, named and in units as in `parallel_robot.metrics.metrics`, and the time (s) of the stepping loop.
METRICS = (
    *(f"tracking.{error}.{measure}" for error in _ERRORS for measure in _MEASURES),
    "control_effort.max",
    "control_effort.integral",
    "closure_error_max",
    "loop_time_s",
)

#: A ratio this near to a whole number (relative) is one, for rounding.
_WHOLE = 1e-9

#: What the metrics are made of; nothing else is recorded.
_RECORDED = {
    "plant": ("x_E", "y_E", "theta_a", "tau_a", "closure_error"),
    "controller": (),
    "trajectory": ("x_ref", "y_ref", "theta_ref"),
}


@dataclass(frozen=True)
class RobotStudy:
    """Runs of scenarios of the robot; see `cosim.sweep.study`.

    Factors are `scenario`, `flavour`, `seed`, `step_size`, `<instance>.fmu`, start values `<instance>.<variable>`, and
    numbers of signals and disturbances `<instance>.<variable>.<number>`, as `plant.tau_d.rms`.

    Attributes
    ----------
    scenarios : mapping
        Name -> scenario; the first where none is varied.
    flavours : mapping
        Flavour -> instance -> SHA-256 of the FMU; the first where none is varied.
    own_fmus : mapping
        Instance -> name -> SHA-256, for instances whose FMUs are not those of a flavour.
    coupling : {"auto", "hold", "linear"}
    curve_period : float, optional
        Rows also have the tracking errors over time, as curves with a point each so many seconds.
    """

    scenarios: Mapping[str, RobotScenario]
    flavours: Mapping[str, Mapping[str, str]]
    own_fmus: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    coupling: Coupling = "auto"
    curve_period: float | None = None
    _signals: dict[Hashable, list[Signal]] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def metrics(self) -> Sequence[str]:
        """Numbers of a row."""
        return METRICS

    @property
    def curves(self) -> Sequence[str]:
        """Curves of a row: tracking errors (m, rad)."""
        return () if self.curve_period is None else tuple(map(curve_name, _ERRORS))

    def simulation(self, variant: Any, fmu: Callable[[str], Path]) -> Simulation:
        """The simulation of a scenario with FMUs; a variant is both."""
        label, hashes = variant
        scenario = self.scenarios[label]
        system = scenario.system(Path(), "")  # its paths are replaced by those of the contents
        components = {
            name: dataclasses.replace(component, fmu=fmu(dict(hashes)[name]))
            for name, component in system.components.items()
        }
        own = {name: components[name].fmu for name in self.own_fmus if name in components}
        system, _ = replaced(System(components, system.connections, system.signals), own)
        return Simulation(
            system,
            order=scenario.order,
            coupling=self.coupling,
            record=[f"{name}.{variable}" for name in components for variable in _RECORDED[name]],
        )

    def plan(self, point: Mapping[str, Value]) -> PlannedRun:
        """The run of a point.

        Raises
        ------
        ScenarioError
            A signal can't have such a number.
        """
        label = point.get(SCENARIO, next(iter(self.scenarios)))
        scenario = self.scenarios[str(label)]
        hashes = dict(self.flavours[str(point.get(FLAVOUR, next(iter(self.flavours))))])
        for instance, files in self.own_fmus.items():
            hashes[instance] = files[str(point.get(instance + FMU, next(iter(files))))]
        start, changes = {}, []
        for name, value in point.items():
            if name in (SCENARIO, FLAVOUR, SEED, STEP) or name.endswith(FMU):
                continue
            if scenario.shape(name.rpartition(".")[0]) is not None:
                changes.append((name, float(value)))
            else:
                start[name] = value
        return PlannedRun(
            variant=(label, tuple((i, hashes[i]) for i in scenario.components)),
            stop_time=scenario.stop_time,
            step_size=float(point.get(STEP, scenario.step_size)),
            start=start,
            signals=self._signals_of(str(label), int(point.get(SEED, scenario.seed)), changes),
        )

    def _signals_of(self, label: str, seed: int, changes: Sequence[tuple[str, float]]) -> list[Signal]:
        """Signals that differ from the scenario's own; the same objects for neighbours, which are sampled once."""
        scenario = self.scenarios[label]
        key = (label, seed, *changes)
        if key not in self._signals:
            changed = dataclasses.replace(scenario, seed=seed)
            for name, value in changes:
                changed = _with_number(changed, name, value)
            self._signals.clear()
            self._signals[key] = changed.system(Path(), "").signals if changed != scenario else []
        return self._signals[key]

    def row(self, planned: PlannedRun, results: Results) -> dict[str, RowValue]:
        """Metrics and curves of a run."""
        scenario = self.scenarios[planned.variant[0]]  # type: ignore[index]
        found = dict(_flat(metrics(results, scenario.steady_after)))
        row: dict[str, RowValue] = {name: found.get(name) for name in METRICS[:-1]}
        row["loop_time_s"] = results.info["loop_time_s"]
        if self.curve_period is not None:
            errors = tracking_errors(results.thinned(_ratio(self.curve_period, planned.step_size)))
            row |= {curve_name(name): errors.get(name) for name in _ERRORS}
        return row

    def fingerprint(self) -> dict[str, Any]:
        """All that decides a row besides the point."""
        scenarios = {label: dataclasses.asdict(scenario) for label, scenario in self.scenarios.items()}
        return {
            "scenarios": json.loads(json.dumps(scenarios)),
            "fmus": {flavour: dict(hashes) for flavour, hashes in self.flavours.items()},
            "own_fmus": {instance: dict(hashes) for instance, hashes in self.own_fmus.items()},
            "coupling": self.coupling,
            "curve_period": self.curve_period,
        }

    def variants(self) -> Iterator[Any]:
        """Variants that hold each scenario and each FMU at least once."""
        for label, scenario in self.scenarios.items():
            for hashes in self.flavours.values():
                first = {**hashes, **{i: next(iter(files.values())) for i, files in self.own_fmus.items()}}
                others = [first | {i: sha256} for i, files in self.own_fmus.items() for sha256 in files.values()]
                for chosen in [first, *others]:
                    yield label, tuple((i, chosen[i]) for i in scenario.components)


def robot_study(
    scenarios: Mapping[str, RobotScenario],
    folder: Path,
    flavours: Sequence[str],
    own_fmus: Mapping[str, Sequence[Path]],
    coupling: Coupling,
    curve_period: float | None = None,
) -> tuple[RobotStudy, dict[str, Path]]:
    """A study of FMUs on this machine, and their files by SHA-256.

    Raises
    ------
    SweepError
        An FMU can't be read, or is of no instance.
    """
    files: dict[str, Path] = {}

    def known(path: Path) -> str:
        try:
            sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
        except OSError as error:
            raise SweepError(f"{path}: {error.strerror or error}; check the path, or build the FMU") from error
        files[sha256] = path
        return sha256

    instances = list(dict.fromkeys(i for scenario in scenarios.values() for i in scenario.components))
    for instance in own_fmus:
        if instance not in instances:
            raise SweepError(f"--fmu {instance}=...: there is no such component; {nearest(instance, instances)}")
    of_flavour = {f: {i: known(fmu_path(folder, f, i)) for i in instances} for f in flavours}
    own = {instance: {str(path): known(path) for path in paths} for instance, paths in own_fmus.items()}
    return RobotStudy(scenarios, of_flavour, own, coupling, curve_period), files


def check(study: RobotStudy, files: Mapping[str, Path], factors: Sequence[Factor]) -> None:
    """Check scenarios, FMUs and what is varied, before anything runs.

    Raises
    ------
    SweepError
        Something would make all runs fail that share it.
    """
    for variant in study.variants():
        scenario = study.scenarios[variant[0]]
        try:
            for step_size in _steps(scenario, factors):
                number_of_steps(0.0, scenario.stop_time, step_size)
                if study.curve_period is not None:
                    _ratio(study.curve_period, step_size)
            simulation = study.simulation(variant, files.__getitem__)
            for factor in factors:
                if factor.name == STEP:
                    continue
                if scenario.shape(factor.name.rpartition(".")[0]) is not None:
                    _number_of_signal(scenario, factor.name)
                else:
                    check_start(simulation, factor)
        except (SetupError, SweepError, ScenarioError) as error:
            raise SweepError(f"scenario {variant[0]}: {error}") from error


def curve_name(error: str) -> str:
    """Column that holds a tracking error (m, rad) over time."""
    return f"tracking.{error}.curve"


def _steps(scenario: RobotScenario, factors: Sequence[Factor]) -> list[float]:
    """All communication steps (s) of a scenario."""
    levels = [f.values for f in factors if isinstance(f, Levels) and f.name == STEP]
    return [float(value) for values in levels for value in values] or [scenario.step_size]


def _ratio(curve_period: float, step_size: float) -> int:
    """Steps between two points of a curve.

    Raises
    ------
    SweepError
        They are no whole number.
    """
    ratio = curve_period / step_size
    if not 0.5 < ratio < math.inf or abs(ratio - round(ratio)) > _WHOLE * ratio:
        raise SweepError(f"curves with a point each {curve_period!r} s need steps that divide it, not {step_size!r} s")
    return round(ratio)


def _with_number(scenario: RobotScenario, name: str, value: float) -> RobotScenario:
    """A copy in which one number of a signal differs.

    Raises
    ------
    ScenarioError
        There is no such number, or it can't have this value.
    """
    target, shape, number, kind = _number_of_signal(scenario, name)
    if kind is int and not value.is_integer():
        raise ScenarioError(f"{name} = {value!r} must be a whole number")
    try:
        return scenario.with_shape(target, dataclasses.replace(shape, **{number: kind(value)}))
    except ValueError as error:
        raise ScenarioError(f"{name}: {error}") from error


def _number_of_signal(scenario: RobotScenario, name: str) -> tuple[str, Shape, str, type]:
    """Target, signal, number and its type, of `<target>.<number>`.

    Raises
    ------
    ScenarioError
        The signal has no such number.
    """
    target, _, number = name.rpartition(".")
    shape = scenario.shape(target)
    assert shape is not None
    numbers = {n: kind for n, kind in get_type_hints(type(shape)).items() if kind in (int, float)}
    if number not in numbers:
        what = type(shape).__name__.lower()
        raise ScenarioError(f"{name}: a {what} has no number '{number}'; {nearest(number, numbers)}")
    return target, shape, number, numbers[number]


def _flat(tree: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, float | None]]:
    """Leaves of nested mappings, names joined by dots."""
    for name, value in tree.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield before + name, value
