"""Sweeps of scenarios: what a point means for a scenario of any system, and which numbers of its run are kept."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, TypeVar, get_type_hints

from cosim.errors import SetupError, nearest
from cosim.fmi.fmu_file import load
from cosim.fmi.isolation.limits import Limits
from cosim.master.coupling.algorithm import fixed
from cosim.master.simulation import Simulation, number_of_steps
from cosim.results.results import Results
from cosim.scenario.metrics import Metric, measured
from cosim.scenario.own_fmus import replaced
from cosim.scenario.scenario import Scenario, ScenarioError
from cosim.scenario.signals import Shape
from cosim.sweep.batch import RowValue
from cosim.sweep.errors import SweepError
from cosim.sweep.points import Factor, Levels, Value
from cosim.sweep.study import PlannedRun, check_start
from cosim.system.system import Signal
from cosim.system.variables import Ports

#: Factors that are no variables. FMU files of a component are the factor `<component>.fmu`.
SCENARIO, SEED, STEP, FMU = "scenario", "seed", "step_size", ".fmu"

#: Column with the time (s) of the stepping loop.
LOOP_TIME = "loop_time_s"

#: Measures of each output where a scenario names no metrics; only the first one where there are many outputs.
_DEFAULT_MEASURES, _MANY_OUTPUTS = ("final", "min", "max"), 20

#: A ratio this near to a whole number (relative) is one, for rounding.
_WHOLE = 1e-9


@dataclass(frozen=True)
class ScenarioStudy:
    """Runs of scenarios; see `cosim.sweep.Study`, and `scenario_study`, which makes one.

    Factors are `scenario`, `seed`, `step_size`, `<component>.fmu`, start values `<component>.<variable>`, numbers of
    signals and disturbances `<component>.<variable>.<number>`, as `plant.tau_d.rms`, and the alternative of a family.

    Attributes
    ----------
    scenarios : mapping
        Label -> scenario without its FMU files; the first where none is varied.
    fmus : mapping
        Label -> alternative -> component -> SHA-256 of the FMU; the first alternative where none is varied.
    alternative : str
        Name of the factor whose values are the alternatives, as `flavour`; empty if there is only one.
    own_fmus : mapping
        Component -> name -> SHA-256, for components whose FMUs are those of the user.
    optional_inputs : mapping
        As of `cosim.scenario.replaced`.
    curve_period : float, optional
        Rows also have curves over time, with a point each so many seconds.
    build : bool
        Workers compile the C sources of FMUs that have no binary for their machine.
    isolate, limits
        As of `Simulation`.
    """

    scenarios: Mapping[str, Scenario]
    fmus: Mapping[str, Mapping[str, Mapping[str, str]]]
    alternative: str = ""
    own_fmus: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    optional_inputs: Mapping[str, Any] = field(default_factory=dict)
    curve_period: float | None = None
    build: bool = False
    isolate: bool | tuple[str, ...] = False
    limits: Limits | None = None
    _signals: dict[Hashable, list[Signal]] = field(default_factory=dict, init=False, repr=False, compare=False)

    #: Names of metrics that all scenarios of a family have.
    of_family: ClassVar[Sequence[str]] = ()

    @property
    def metrics(self) -> Sequence[str]:
        """Numbers of a row: those of the family, those that the scenarios name, and the time of the stepping loop."""
        named = [name for scenario in self.scenarios.values() for name in scenario.metrics]
        return tuple(dict.fromkeys([*self.of_family, *named, LOOP_TIME]))

    @property
    def curves(self) -> Sequence[str]:
        """Curves of a row."""
        return () if self.curve_period is None else tuple(map(curve_name, self._curve_variables()))

    def _curve_variables(self) -> list[str]:
        """Variables of the curves: all variables of metrics."""
        return list(dict.fromkeys(v for scenario in self.scenarios.values() for v in _variables(scenario)))

    def recorded(self, scenario: Scenario) -> list[str]:
        """The recorded variables: those of metrics and curves."""
        return _variables(scenario)

    def measured(self, scenario: Scenario, results: Results) -> Mapping[str, float | None]:
        """Metrics of a run, but for the time of the loop."""
        return measured(scenario.metrics, results)

    def curve_values(self, results: Results) -> Mapping[str, Any]:
        """Values (n,) of curves by what they are of, from results with a row for each of their points."""
        return {name: results[name] for name in self._curve_variables() if name in results}

    def simulation(self, variant: Any, fmu: Callable[[str], Path]) -> Simulation:
        """The simulation of a scenario with FMUs; a variant is both."""
        label, hashes = variant
        scenario = self.scenarios[label].with_fmus({component: fmu(sha256) for component, sha256 in hashes})
        own = {name: path for name in self.own_fmus if (path := _fmu_of(scenario, name)) is not None}
        own |= scenario.stand_ins
        system, _ = replaced(scenario.system(), own, self.optional_inputs)
        return Simulation(
            system,
            order=scenario.order,
            extrapolation=scenario.extrapolation,
            record=self.recorded(scenario),
            build=self.build,
            solver=scenario.solver,
            solver_step=scenario.solver_step,
            iterations=scenario.iterations,
            isolate=self.isolate,
            limits=self.limits,
        )

    def plan(self, point: Mapping[str, Value]) -> PlannedRun:
        """The run of a point.

        Raises
        ------
        ScenarioError
            A signal can't have such a number.
        """
        label = str(point.get(SCENARIO, next(iter(self.scenarios))))
        scenario = self.scenarios[label]
        alternatives = self.fmus[label]
        hashes = dict(alternatives[str(point.get(self.alternative, next(iter(alternatives))))])
        for component, files in self.own_fmus.items():
            if component in hashes:
                hashes[component] = files[str(point.get(component + FMU, next(iter(files))))]
        start, changes = {}, []
        for name, value in point.items():
            if self.is_setting(name):
                continue
            if scenario.shape(name.rpartition(".")[0]) is not None:
                changes.append((name, value))
            else:
                start[name] = value
        return PlannedRun(
            variant=(label, tuple(hashes.items())),
            stop_time=scenario.stop_time,
            step_size=fixed(point.get(STEP, scenario.step_size), "a sweep takes"),
            start=start,
            signals=self._signals_of(label, int(point.get(SEED, scenario.seed)), changes),
            start_time=scenario.start_time,
            record_every=scenario.record_every,
            tolerance=scenario.tolerance,
        )

    def is_setting(self, factor: str) -> bool:
        """Whether a factor is neither a start value nor a number of a signal."""
        own = [component + FMU for component in self.own_fmus]
        return factor in (SCENARIO, self.alternative, SEED, STEP, *own)

    def _signals_of(self, label: str, seed: int, changes: Sequence[tuple[str, Value]]) -> list[Signal]:
        """Signals that differ from the scenario's own; the same objects for neighbours, which are sampled once."""
        scenario = self.scenarios[label]
        key = (label, seed, *changes)
        if key not in self._signals:
            changed = dataclasses.replace(scenario, seed=seed)
            for name, value in changes:
                changed = _with_number(changed, name, value)
            self._signals.clear()
            self._signals[key] = [] if changed == scenario else _input_signals(changed)
        return self._signals[key]

    def row(self, planned: PlannedRun, results: Results) -> dict[str, RowValue]:
        """Metrics and curves of a run."""
        scenario = self.scenarios[planned.variant[0]]  # type: ignore[index]
        found = {**self.measured(scenario, results), LOOP_TIME: results.info["loop_time_s"]}
        row: dict[str, RowValue] = {name: found.get(name) for name in self.metrics}
        if self.curve_period is not None:
            every = points_each(self.curve_period, planned.step_size * planned.record_every)
            values = {curve_name(name): curve for name, curve in self.curve_values(results.thinned(every)).items()}
            row |= {name: values.get(name) for name in self.curves}
        return row

    def fingerprint(self) -> dict[str, Any]:
        """All that decides a row besides the point."""
        scenarios = {label: dataclasses.asdict(scenario) for label, scenario in self.scenarios.items()}
        found = {
            "scenarios": scenarios,
            "fmus": self.fmus,
            "own_fmus": self.own_fmus,
            "optional_inputs": self.optional_inputs,
            "curve_period": self.curve_period,
        }
        copied: dict[str, Any] = json.loads(json.dumps(found, default=_as_data))
        return copied

    def variants(self) -> Iterator[Any]:
        """Variants that hold each scenario and each FMU at least once."""
        for label, alternatives in self.fmus.items():
            for hashes in alternatives.values():
                own = {component: files for component, files in self.own_fmus.items() if component in hashes}
                first = {**hashes, **{component: next(iter(files.values())) for component, files in own.items()}}
                others = [first | {c: sha256} for c, files in own.items() for sha256 in files.values()]
                for chosen in dict.fromkeys(tuple(hashes.items()) for hashes in [first, *others]):
                    yield label, chosen


StudyType = TypeVar("StudyType", bound=ScenarioStudy)


def scenario_study(
    scenarios: Mapping[str, Scenario],
    own_fmus: Mapping[str, Sequence[str | PathLike[str]]] | None = None,
    *,
    curve_period: float | None = None,
    build: bool = False,
) -> tuple[ScenarioStudy, dict[str, Path]]:
    """A study of scenarios whose FMUs are files on this machine, and these files, for `sweep`.

    Parameters
    ----------
    scenarios : mapping
        Label -> scenario. Those that name no metrics get `final`, `min` and `max` of each output, those with more than
        20 outputs `final` only.
    own_fmus : mapping, optional
        Component -> FMU files in place of that of the scenario; several of them are the factor `<component>.fmu`.
    curve_period : float, optional
        Rows also have curves of all variables of metrics over time, with a point each so many seconds.
    build : bool
        Compile the C sources of FMUs that have no binary for the machine of a worker.

    Returns
    -------
    study : ScenarioStudy
    files : dict
        SHA-256 -> FMU file.

    Raises
    ------
    SweepError
        An FMU can't be read, or is of no component.
    ScenarioError
        A component has no FMU.
    """
    one = {label: {"": scenario} for label, scenario in scenarios.items()}
    own = {component: [Path(path) for path in paths] for component, paths in (own_fmus or {}).items()}
    return study_of_alternatives(ScenarioStudy, one, own, curve_period=curve_period, build=build)


def study_of_alternatives(
    kind: type[StudyType],
    scenarios: Mapping[str, Mapping[str, Scenario]],
    own_fmus: Mapping[str, Sequence[Path]],
    *,
    alternative: str = "",
    optional_inputs: Mapping[str, Any] | None = None,
    curve_period: float | None = None,
    build: bool = False,
) -> tuple[StudyType, dict[str, Path]]:
    """A study of scenarios that differ in their FMUs only, by alternative, and all FMU files by SHA-256.

    Parameters
    ----------
    kind : type
        Class of the study.
    scenarios : mapping
        Label -> alternative -> scenario.
    own_fmus, alternative, optional_inputs, curve_period, build
        As `ScenarioStudy` has them, with files in place of their contents.

    Raises
    ------
    SweepError, ScenarioError
        As `scenario_study`.
    """
    files: dict[str, Path] = {}

    def known(path: Path) -> str:
        try:
            sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
        except OSError as error:
            raise SweepError(f"{path}: {error.strerror or error}; check the path, or build the FMU") from error
        files[sha256] = path
        return sha256

    components = list(dict.fromkeys(c for of in scenarios.values() for s in of.values() for c in s.components))
    for component in own_fmus:
        if component not in components:
            raise SweepError(f"--fmu {component}=...: there is no such component; {nearest(component, components)}")
    fmus = {
        label: {name: {c: known(_file(scenario, c)) for c in scenario.components} for name, scenario in of.items()}
        for label, of in scenarios.items()
    }
    own = {component: {str(path): known(path) for path in paths} for component, paths in own_fmus.items()}
    measured = {label: _with_metrics(next(iter(of.values())), kind) for label, of in scenarios.items()}
    bare = {label: _without_files(scenario) for label, scenario in measured.items()}
    return kind(bare, fmus, alternative, own, dict(optional_inputs or {}), curve_period, build), files


def check(study: ScenarioStudy, files: Mapping[str, str | PathLike[str]], factors: Sequence[Factor]) -> None:
    """Check scenarios, FMUs and what is varied, before anything runs.

    Parameters
    ----------
    study : ScenarioStudy
    files : mapping
        SHA-256 -> FMU file.
    factors : sequence of Factor
        Those that are no scenarios, FMUs or seeds.

    Raises
    ------
    SweepError
        Something would make all runs fail that share it.
    """
    for variant in study.variants():
        scenario = study.scenarios[variant[0]]
        try:
            for step_size in _steps(scenario, factors):
                number_of_steps(scenario.start_time, scenario.stop_time, step_size)
                if study.curve_period is not None:
                    points_each(study.curve_period, step_size * scenario.record_every)
            simulation = study.simulation(variant, lambda sha256: Path(files[sha256]))
            for factor in factors:
                if factor.name == STEP:
                    continue
                if scenario.shape(factor.name.rpartition(".")[0]) is not None:
                    _check_number(scenario, factor)
                else:
                    check_start(simulation, factor)
        except (SetupError, SweepError, ScenarioError) as error:
            raise SweepError(f"scenario {variant[0]}: {error}") from error


def curve_name(variable: str) -> str:
    """Column that holds a variable over time."""
    return f"{variable}.curve"


def points_each(curve_period: float, pause: float) -> int:
    """Recorded points between two points of a curve, if they are so far (s) apart.

    Raises
    ------
    SweepError
        They are no whole number.
    """
    ratio = curve_period / pause
    if not 0.5 < ratio < math.inf or abs(ratio - round(ratio)) > _WHOLE * ratio:
        raise SweepError(f"curves with a point each {curve_period!r} s need steps that divide it, not {pause!r} s")
    return round(ratio)


def _variables(scenario: Scenario) -> list[str]:
    """Variables of all metrics of a scenario, each once."""
    return list(dict.fromkeys(variable for metric in scenario.metrics.values() for variable in metric.variables))


def _fmu_of(scenario: Scenario, component: str) -> Path | None:
    return scenario.components[component].fmu if component in scenario.components else None


def _input_signals(scenario: Scenario) -> list[Signal]:
    """Signals of the system; its FMUs are not looked at."""
    return scenario.with_fmus(dict.fromkeys(scenario.components, Path())).system().signals


def _file(scenario: Scenario, component: str) -> Path:
    path = scenario.components[component].fmu
    if path is None:
        raise ScenarioError(
            f"{scenario.name}: component '{component}' has no FMU; name its file: [components.{component}] fmu = ..."
        )
    return path


def _without_files(scenario: Scenario) -> Scenario:
    """A copy that is the same on every machine."""
    components = {name: dataclasses.replace(c, fmu=None) for name, c in scenario.components.items()}
    return dataclasses.replace(scenario, components=components)


def _with_metrics(scenario: Scenario, kind: type[ScenarioStudy]) -> Scenario:
    """The scenario with metrics of its outputs, if nothing says what is to be measured."""
    if scenario.metrics or kind.of_family:
        return scenario
    outputs = []
    for name in scenario.components:
        ports = Ports(name, load(name, _file(scenario, name)).description, scenario.start.get(name))
        outputs += [f"{name}.{e.name}" for e in ports.of_causality("output") if e.kind in _MEASURABLE]
    if not outputs:
        raise SweepError(f"{scenario.name}: there is nothing to measure: no FMU has an output of numbers")
    measures = _DEFAULT_MEASURES if len(outputs) <= _MANY_OUTPUTS else _DEFAULT_MEASURES[:1]
    metrics = {f"{output}.{measure}": Metric(output, measure) for output in outputs for measure in measures}
    return dataclasses.replace(scenario, metrics=metrics)


#: Kinds of values that can be recorded.
_MEASURABLE = ("real", "integer", "enumeration", "boolean")


def _as_data(value: Any) -> Any:
    """What JSON has no word for, as plain data."""
    return dict(value) if isinstance(value, Mapping) else str(value)


def _steps(scenario: Scenario, factors: Sequence[Factor]) -> list[float]:
    """All communication steps (s) of a scenario."""
    levels = [f.values for f in factors if isinstance(f, Levels) and f.name == STEP]
    return [float(value) for values in levels for value in values] or [fixed(scenario.step_size, "a sweep takes")]


def _with_number(scenario: Scenario, name: str, value: Value) -> Scenario:
    """A copy in which one number of a signal differs.

    Raises
    ------
    ScenarioError
        There is no such number, or it can't have this value.
    """
    target, shape, number, kind = _number_of_signal(scenario, name)
    if isinstance(value, str):
        raise ScenarioError(f"{name} = {value!r} must be a number")
    if kind is int and not float(value).is_integer():
        raise ScenarioError(f"{name} = {value!r} must be a whole number")
    try:
        return scenario.with_shape(target, dataclasses.replace(shape, **{number: kind(value)}))
    except ValueError as error:
        raise ScenarioError(f"{name}: {error}") from error


def _check_number(scenario: Scenario, factor: Factor) -> None:
    """Whether a number of a signal can be varied; values that it can't have are rows with an error.

    Raises
    ------
    ScenarioError
        The signal has no such number.
    """
    _number_of_signal(scenario, factor.name)
    if isinstance(factor, Levels) and all(isinstance(value, str) for value in factor.values):
        raise ScenarioError(f"{factor.name} = {factor.values[0]!r} must be a number")


def _number_of_signal(scenario: Scenario, name: str) -> tuple[str, Shape, str, type]:
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
        raise ScenarioError(f"{name}: a {shape.name} has no number '{number}'; {nearest(number, numbers)}")
    return target, shape, number, numbers[number]
