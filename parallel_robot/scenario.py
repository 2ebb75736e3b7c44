"""Scenarios as data: what is simulated, from a TOML file that is checked to the last key."""

from __future__ import annotations

import dataclasses
import sys
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args, get_type_hints

from cosim.errors import CosimError, nearest
from cosim.master.operations import Order
from cosim.scenario.signals import SHAPES, Shape
from cosim.system.system import System
from parallel_robot.choices import SCENARIOS, scenario_names
from parallel_robot.fmus import fmu_path
from parallel_robot.models import MODELS
from parallel_robot.wiring import CONNECTIONS

_TOP_LEVEL = ("title", "components", "run", "start", "signals", "disturbances")
_RUN = {"stop_time": float, "step_size": float, "order": str, "seed": int, "steady_after": float}


class ScenarioError(CosimError):
    """A scenario is missing or malformed."""


@dataclass(frozen=True)
class Scenario:
    """A run of the robot.

    Attributes
    ----------
    name, title : str
        Name of the file, and one line for people.
    components : tuple of str
        Instances that take part: "plant", "controller", "trajectory".
    stop_time, step_size : float
        In s.
    steady_after : float
        From this time (s) on errors count as steady.
    order : {"sequential", "parallel"}
    seed : int
        Seed of all random signals.
    start : mapping
        Instance -> start values of its variables.
    signals : mapping
        Target `instance.variable` -> signal that feeds it.
    disturbances : mapping
        Target `instance.variable` -> signal that is added to what a connection feeds there, as sensor noise is.
    """

    name: str
    title: str
    components: tuple[str, ...]
    stop_time: float = 15.0
    step_size: float = 1e-3
    steady_after: float = 8.0
    order: Order = "sequential"
    seed: int = 1
    start: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    signals: Mapping[str, Shape] = field(default_factory=dict)
    disturbances: Mapping[str, Shape] = field(default_factory=dict)

    def system(self, folder: Path, flavour: str) -> System:
        """The system of FMUs in `<folder>/<flavour>` that this scenario describes."""
        system = System()
        for instance in self.components:
            system.add(instance, fmu_path(folder, flavour, instance), start=self.start.get(instance))
        for source, target in _connections(self.components):
            system.connect(source, target)
        for signals, feed in ((self.signals, system.drive), (self.disturbances, system.disturb)):
            for target, signal in signals.items():
                function = signal.function(_size(target), self.seed, target)
                feed(target, function, breakpoints=signal.breakpoints, vectorized=True)
        return system

    def shape(self, target: str) -> Shape | None:
        """The signal or disturbance at an input, if there is one."""
        return self.signals.get(target, self.disturbances.get(target))

    def with_shape(self, target: str, shape: Shape) -> Scenario:
        """A copy in which the signal or disturbance at an input is another one."""
        if target in self.signals:
            return dataclasses.replace(self, signals={**self.signals, target: shape})
        return dataclasses.replace(self, disturbances={**self.disturbances, target: shape})

    def with_start_value(self, instance: str, name: str, value: float) -> Scenario:
        """A copy in which one start value differs."""
        start = {i: dict(v) for i, v in self.start.items()}
        start.setdefault(instance, {})[name] = value
        return dataclasses.replace(self, start=start)


def _connections(components: Collection[str]) -> list[tuple[str, str]]:
    """Connections between components that take part."""
    return [c for c in CONNECTIONS if all(end.partition(".")[0] in components for end in c)]


def _size(target: str) -> int:
    """Number of elements of an input `instance.variable`.

    Raises
    ------
    ScenarioError
        There is no such input.
    """
    instance, _, name = target.partition(".")
    if instance not in MODELS:
        raise ScenarioError(f"there is no component '{instance}'; {nearest(instance, MODELS)}")
    inputs = MODELS[instance].inputs
    sizes = dict.fromkeys(inputs.names, 1) | {v.name: v.size or 1 for v in inputs.variables}
    if name not in sizes:
        raise ScenarioError(f"'{instance}' has no input '{name}'; {nearest(name, sizes)}")
    return sizes[name]


def load_scenario(name_or_path: str) -> Scenario:
    """Read a scenario by name, or from a TOML file.

    Raises
    ------
    ScenarioError
        There is none of that name, or the file is malformed; the message names the file and the key.
    """
    path = SCENARIOS / f"{name_or_path}.toml" if name_or_path in scenario_names() else Path(name_or_path)
    if not path.is_file():
        raise ScenarioError(
            f"there is no scenario '{name_or_path}'; {nearest(name_or_path, scenario_names())} (or a TOML file)"
        )
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ScenarioError(f"{path}: can't be read as TOML: {error}") from error
    try:
        return _scenario(path.stem, data)
    except ScenarioError as error:
        raise ScenarioError(f"{path}: {error}") from None


def _scenario(name: str, data: Mapping[str, Any]) -> Scenario:
    _check_keys("the scenario", data, _TOP_LEVEL)
    title = data.get("title", name)
    if not isinstance(title, str):
        raise ScenarioError(f"title = {title!r} must be a text")
    components = data.get("components", list(MODELS))
    if not isinstance(components, list) or not components:
        raise ScenarioError(f"components = {components!r} must be a list of names")
    for component in components:
        if not isinstance(component, str) or component not in MODELS:
            raise ScenarioError(f"components: there is no {component!r}; {nearest(str(component), MODELS)}")
    if len(set(components)) < len(components):
        raise ScenarioError(f"components = {components!r} names one twice")
    run = _table(data, "run")
    _check_keys("[run]", run, _RUN)
    start = _table(data, "start")
    _check_keys("[start]", start, components)
    for component, values in start.items():
        if not isinstance(values, Mapping):
            raise ScenarioError(f"[start] {component} must be a table of start values")
    signals, disturbances = (_shapes(table, data, components) for table in ("signals", "disturbances"))
    connected = [target for _, target in _connections(components)]
    for target in disturbances:
        if target not in connected:
            raise ScenarioError(
                f'[disturbances."{target}"]: no connection feeds it; {nearest(target, connected)}, '
                "or feed it from [signals]"
            )
    values = {key: _value(f"[run] {key}", value, _RUN[key]) for key, value in run.items()}
    if values.get("order", "sequential") not in get_args(Order):
        raise ScenarioError(
            f"[run] order = {values['order']!r} is unknown; {nearest(values['order'], get_args(Order))}"
        )
    if values.get("seed", 0) < 0:
        raise ScenarioError(f"[run] seed = {values['seed']!r} must be 0 or greater")
    return Scenario(
        name=name,
        title=title,
        components=tuple(components),
        start=start,
        signals=signals,
        disturbances=disturbances,
        **values,
    )


def _table(data: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    table = data.get(key, {})
    if not isinstance(table, Mapping):
        raise ScenarioError(f"{key} = {table!r} must be a table")
    return table


def _check_keys(where: str, table: Mapping[str, Any], known: Collection[str]) -> None:
    for key in table:
        if key not in known:
            raise ScenarioError(f"{where} has an unknown key '{key}'; {nearest(key, known)}")


def _shapes(table: str, data: Mapping[str, Any], components: Collection[str]) -> dict[str, Shape]:
    """Signals of a table, by target."""
    shapes = {}
    for target, spec in _table(data, table).items():
        where = f'[{table}."{target}"]'
        shapes[target] = _shape(where, target, spec)
        if target.partition(".")[0] not in components:
            raise ScenarioError(f"{where}: its component does not take part; known are {', '.join(components)}")
    return shapes


def _shape(where: str, target: str, spec: Any) -> Shape:
    if not isinstance(spec, Mapping):
        raise ScenarioError(f"{where} must be a table")
    if "shape" not in spec:
        raise ScenarioError(f"{where} lacks shape; known are {', '.join(SHAPES)}")
    shape = spec["shape"]
    if not isinstance(shape, str) or shape not in SHAPES:
        raise ScenarioError(f"{where} shape = {shape!r} is unknown; {nearest(str(shape), SHAPES)}")
    try:
        _size(target)
    except ScenarioError as error:
        raise ScenarioError(f"{where}: {error}") from None
    kind = SHAPES[shape]
    types = get_type_hints(kind)
    fields = {f.name: f for f in dataclasses.fields(kind)}
    _check_keys(where, spec, ("shape", *fields))
    missing = [n for n, f in fields.items() if f.default is dataclasses.MISSING and n not in spec]
    if missing:
        raise ScenarioError(f"{where} lacks {', '.join(missing)}")
    values = {key: _value(f"{where} {key}", value, types[key]) for key, value in spec.items() if key != "shape"}
    try:
        return kind(**values)
    except ValueError as error:
        raise ScenarioError(f"{where}: {error}") from None


def _value(where: str, value: Any, kind: type) -> Any:
    """A value of a TOML file, of the type that its key demands."""
    right = isinstance(value, (int, float) if kind is float else kind) and not isinstance(value, bool)
    if not right:
        what = {float: "a number", int: "a whole number", str: "a text"}[kind]
        raise ScenarioError(f"{where} = {value!r} must be {what}")
    if kind is float and not abs(value) <= sys.float_info.max:
        raise ScenarioError(f"{where} = {value!r} must be finite")
    return kind(value)
