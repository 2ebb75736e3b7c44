"""Read scenarios from TOML files, which are checked to the last key."""

from __future__ import annotations

import dataclasses
import math
import sys
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, get_args, get_type_hints

from cosim.errors import SetupError, nearest
from cosim.files.kinds import SCENARIO, TOML, not_read
from cosim.fmi.interfaces import INTERFACES
from cosim.master.coupling.algorithm import AUTO, EXTRAPOLATIONS, ORDERS, SOLVERS, VARIABLE, most_iterations
from cosim.scenario.family import ScenarioFamily, families, family_of, named
from cosim.scenario.metrics import Metric
from cosim.scenario.scenario import Scenario, ScenarioComponent, ScenarioError
from cosim.scenario.signals import SHAPES, Shape
from cosim.system.system import Connection, Units

_TOP_LEVEL = (
    "title",
    "system",
    "components",
    "connections",
    "run",
    "start",
    "signals",
    "disturbances",
    "metrics",
)

#: Keys of [run] and their types; `record` is a list of texts.
_RUN: dict[str, Any] = {
    "start_time": float,
    "stop_time": float,
    "step_size": float,
    "order": str,
    "extrapolation": str,
    "tolerance": float,
    "seed": int,
    "record": list,
    "record_every": int,
    "interface": str,
    "solver": str,
    "solver_step": float,
}

#: Keys of a component, a connection and a metric, and their types.
_COMPONENT = {"fmu": str, "every": int, "interface": str, "isolate": bool, "place": str}
_CONNECTION = {"from": str, "to": str, "factor": float, "offset": float, "units": str, "extrapolation": str}
_METRIC = {"of": str, "minus": str, "measure": str, "after": float}


def load_scenario(name_or_path: str) -> Scenario:
    """Read a scenario that comes with an installed package by its name, or a TOML file.

    Raises
    ------
    ScenarioError
        There is none of that name, or the file is malformed; the message names the file and the key.
    """
    return load_with_family(name_or_path)[0]


def load_with_family(name_or_path: str) -> tuple[Scenario, ScenarioFamily]:
    """A scenario as `load_scenario` reads it, and its family; that of all others for systems of no family."""
    found = named(name_or_path)
    family, path = (None, Path(name_or_path)) if found is None else found
    if not path.is_file():
        names = [name for known in families().values() for name in known.scenario_names()]
        raise ScenarioError(f"there is no scenario '{name_or_path}'; {nearest(name_or_path, names)} (or a TOML file)")
    return read_scenario(path, family)


def read_scenario(path: Path, family: ScenarioFamily | None = None) -> tuple[Scenario, ScenarioFamily]:
    """Read a TOML file.

    Parameters
    ----------
    path : Path
        Paths in the file are relative to its folder.
    family : ScenarioFamily, optional
        The family that a file belongs to which names no other `system`; by default the only one that is registered,
        unless the file has components of its own.

    Raises
    ------
    ScenarioError
        The file is malformed; the message names the file and the key.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        why = f"can't be read as TOML: {error}"
        raise ScenarioError(not_read(path, "a scenario in TOML", why, SCENARIO, TOML)) from error
    try:
        family = _family(data, family)
        return scenario_from(data, path.stem, path.parent, family), family
    except ScenarioError as error:
        raise ScenarioError(not_read(path, "a scenario in TOML", str(error), SCENARIO, TOML)) from None


def _family(data: Mapping[str, Any], family: ScenarioFamily | None) -> ScenarioFamily:
    system = data.get("system")
    if system is not None and not isinstance(system, str):
        raise ScenarioError(f"system = {system!r} must be a text")
    if system is None and family is not None:
        return family
    return family_of(system, own=isinstance(data.get("components"), Mapping)) or ScenarioFamily()


def scenario_from(data: Mapping[str, Any], name: str, folder: Path, family: ScenarioFamily) -> Scenario:
    """The scenario that the data of a TOML file describe.

    Parameters
    ----------
    data : mapping
    name : str
        Of the scenario.
    folder : Path
        What paths are relative to.
    family : ScenarioFamily

    Raises
    ------
    ScenarioError
        The data are malformed; the message names the key.
    """
    _check_keys("the scenario", data, _TOP_LEVEL)
    components = _components(data, folder, family)
    connections = _connections(data, components, family)
    start = _table(data, "start")
    _check_keys("[start]", start, components)
    for component, values in start.items():
        if not isinstance(values, Mapping):
            raise ScenarioError(f"[start] {component} must be a table of start values")
    signals, disturbances = (_shapes(t, data, components, folder, family) for t in ("signals", "disturbances"))
    _check_disturbances(disturbances, connections)
    return family.scenario(
        name=name,
        title=_value("title", data.get("title", name), str),
        components=components,
        connections=tuple(connections),
        start=start,
        signals=signals,
        disturbances=disturbances,
        metrics=_metrics(data, components, family),
        **_run(data, family.scenario),
    )


def _components(data: Mapping[str, Any], folder: Path, family: ScenarioFamily) -> dict[str, ScenarioComponent]:
    """Components that take part: those that a list names, or all of the family and those of a table."""
    known = dict(family.components)
    given = data.get("components", list(known))
    if isinstance(given, Mapping):
        for name, spec in given.items():
            known[name] = _component(f"[components.{name}]", name, spec, folder, known.get(name))
        given = list(known)
    if not isinstance(given, list) or not given:
        what = "a list of names, or a table" if family.components else "a table of components"
        raise ScenarioError(f"components = {given!r} must be {what}")
    for name in given:
        if not isinstance(name, str) or name not in known:
            raise ScenarioError(f"components: there is no {name!r}; {nearest(str(name), known)}")
    if len(set(given)) < len(given):
        raise ScenarioError(f"components = {given!r} names one twice")
    return {name: known[name] for name in given}


def _component(where: str, name: str, spec: Any, folder: Path, known: ScenarioComponent | None) -> ScenarioComponent:
    values = _fields(where, spec, _COMPONENT, required=() if known else ("fmu",))
    if not name or "." in name:
        raise ScenarioError(f"{where}: the name must be a text without a dot")
    if values.get("every", 1) < 1:
        raise ScenarioError(f"{where} every = {values['every']!r} must be at least 1")
    if not values.get("place", "somewhere"):
        raise ScenarioError(f"{where} place is empty; write the address of a worker, or the name of a resource of one")
    _check_interface(where, values)
    if "fmu" in values:
        values |= {"fmu": folder / values["fmu"], "stands_in": known is not None}
    return dataclasses.replace(known or ScenarioComponent(), **values)


def _check_interface(where: str, values: Mapping[str, Any]) -> None:
    interface = values.get("interface", INTERFACES[0])
    if interface not in INTERFACES:
        raise ScenarioError(f"{where} interface = {interface!r} is unknown; {nearest(interface, INTERFACES)}")


def _connections(data: Mapping[str, Any], components: Collection[str], family: ScenarioFamily) -> list[Connection]:
    """Connections of the family between components that take part, but for inputs that those of the file feed."""
    specs = data.get("connections", [])
    if not isinstance(specs, list):
        raise ScenarioError(f"connections = {specs!r} must be a list of tables: [[connections]]")
    own = []
    for number, spec in enumerate(specs, start=1):
        where = f"[[connections]] number {number}"
        values = _fields(where, spec, _CONNECTION, required=("from", "to"))
        for key in ("from", "to"):
            _check_path(f"{where} {key} = {values[key]!r}", values[key], components, family)
        if values.get("units", "equal") not in get_args(Units):
            raise ScenarioError(
                f"{where} units = {values['units']!r} is unknown; {nearest(values['units'], get_args(Units))}"
            )
        if (name := values.get("extrapolation", AUTO)) not in (AUTO, *EXTRAPOLATIONS):
            raise ScenarioError(
                f"{where} extrapolation = {name!r} is unknown; {nearest(name, (AUTO, *EXTRAPOLATIONS))}"
            )
        own.append(Connection(values.pop("from"), values.pop("to"), **values))
    fed = {connection.target for connection in own}
    of_family = [
        connection
        for connection in family.connections
        if connection.target not in fed
        and all(end.partition(".")[0] in components for end in (connection.source, connection.target))
    ]
    return of_family + own


def _check_path(where: str, path: str, components: Collection[str], family: ScenarioFamily) -> None:
    """Refuse what is not `component.variable` of a component that takes part."""
    component, dot, variable = path.partition(".")
    if not (dot and variable):
        raise ScenarioError(f"{where} must be written as component.variable")
    if component in components:
        return
    if component in family.components:
        raise ScenarioError(f"{where}: its component does not take part; known are {', '.join(components)}")
    raise ScenarioError(f"{where}: there is no component '{component}'; {nearest(component, components)}")


def _run(data: Mapping[str, Any], kind: type[Scenario]) -> dict[str, Any]:
    """Fields of the scenario's class that describe its run."""
    of_all = {field.name for field in dataclasses.fields(Scenario)}
    further = {field.name: float for field in dataclasses.fields(kind) if field.name not in of_all}
    demanded = {field.name for field in dataclasses.fields(kind) if field.default is dataclasses.MISSING}
    known = _RUN | further
    given = dict(_table(data, "run"))
    iterations = given.pop("iterations", None)
    is_variable = given.get("step_size") == VARIABLE
    if is_variable:
        del given["step_size"]
    required = [key for key in known if key in demanded and not (is_variable and key == "step_size")]
    values = _fields("[run]", given, known, required=required)
    if is_variable:
        values["step_size"] = VARIABLE
    if iterations is not None:
        try:
            most_iterations(iterations)
        except SetupError as error:
            raise ScenarioError(f"[run] {error}") from error
        values["iterations"] = iterations
    _check_interface("[run]", values)
    known_names = (("order", tuple(ORDERS)), ("extrapolation", (AUTO, *EXTRAPOLATIONS)), ("solver", SOLVERS))
    for key, choices in known_names:
        if key in values and values[key] not in choices:
            raise ScenarioError(f"[run] {key} = {values[key]!r} is unknown; {nearest(values[key], choices)}")
    for key, least in (("seed", 0), ("record_every", 1)):
        if values.get(key, least) < least:
            raise ScenarioError(f"[run] {key} = {values[key]!r} must be {least} or greater")
    if "record" in values:
        values["record"] = tuple(_value("[run] record", name, str) for name in values["record"])
        if not values["record"]:
            raise ScenarioError("[run] record = [] records nothing; leave it out to record all inputs and outputs")
    return values


def _shapes(
    table: str, data: Mapping[str, Any], components: Collection[str], folder: Path, family: ScenarioFamily
) -> dict[str, Shape]:
    """Signals of a table, by target."""
    shapes = {}
    for target, spec in _table(data, table).items():
        where = f'[{table}."{target}"]'
        if not isinstance(spec, Mapping):
            raise ScenarioError(f"{where} must be a table")
        _check_path(where, target, components, family)
        shapes[target] = _shape(where, spec, folder)
    return shapes


def _shape(where: str, spec: Mapping[str, Any], folder: Path) -> Shape:
    if "shape" not in spec:
        raise ScenarioError(f"{where} lacks shape; known are {', '.join(SHAPES)}")
    name = spec["shape"]
    if not isinstance(name, str) or name not in SHAPES:
        raise ScenarioError(f"{where} shape = {name!r} is unknown; {nearest(str(name), SHAPES)}")
    kind = SHAPES[name]
    hints = get_type_hints(kind)
    fields = {field.name: field for field in dataclasses.fields(kind) if field.init}
    required = [name for name, field in fields.items() if field.default is dataclasses.MISSING]
    types = {name: hints[name] if hints[name] in (int, float) else str for name in fields}
    for key, value in spec.items():
        if isinstance(value, bool) and types.get(key) is float:
            raise ScenarioError(
                f"{where} {key} = {str(value).lower()} must be a number; a Boolean input is true at 1, false at 0"
            )
    values = _fields(where, {k: v for k, v in spec.items() if k != "shape"}, types, required, further=("shape",))
    for path in set(kind.paths) & set(values):
        values[path] = str(folder / values[path])
    try:
        return kind(**values)
    except ValueError as error:
        raise ScenarioError(f"{where}: {error}") from None


def _check_disturbances(disturbances: Collection[str], connections: Collection[Connection]) -> None:
    """A disturbance is added to what a connection feeds."""
    connected = [connection.target for connection in connections]
    for target in disturbances:
        # whole vectors and their elements answer to each other; which elements there are, the FMU says
        if target.partition("[")[0] not in {other.partition("[")[0] for other in connected}:
            raise ScenarioError(
                f'[disturbances."{target}"]: no connection feeds it; {nearest(target, connected)}, '
                "or feed it from [signals]"
            )


def _metrics(data: Mapping[str, Any], components: Collection[str], family: ScenarioFamily) -> dict[str, Metric]:
    metrics = {}
    for name, spec in _table(data, "metrics").items():
        where = f"[metrics.{name}]"
        if name in family.metric_names:
            raise ScenarioError(f"{where}: all scenarios of this system have a metric of this name; choose another one")
        values = _fields(where, spec, _METRIC, required=("of", "measure"))
        for key in ("of", "minus"):
            if key in values:
                _check_path(f"{where} {key} = {values[key]!r}", values[key], components, family)
        try:
            metrics[name] = Metric(**values)
        except ValueError as error:
            raise ScenarioError(f"{where} {error}") from None
    return metrics


def _table(data: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    table = data.get(key, {})
    if not isinstance(table, Mapping):
        raise ScenarioError(f"{key} = {table!r} must be a table")
    return table


def _check_keys(where: str, table: Mapping[str, Any], known: Collection[str]) -> None:
    for key in table:
        if key not in known:
            raise ScenarioError(f"{where} has an unknown key '{key}'; {nearest(key, known)}")


def _fields(
    where: str,
    table: Any,
    types: Mapping[str, Any],
    required: Collection[str] = (),
    further: Collection[str] = (),
) -> dict[str, Any]:
    """Values of a table of known keys; further ones are known and have been read."""
    if not isinstance(table, Mapping):
        raise ScenarioError(f"{where} = {table!r} must be a table")
    _check_keys(where, table, (*further, *types))
    missing = [key for key in required if key not in table]
    if missing:
        raise ScenarioError(f"{where} lacks {', '.join(missing)}")
    return {key: _value(f"{where} {key}", value, types[key]) for key, value in table.items()}


def _value(where: str, value: Any, kind: type) -> Any:
    """A value of a TOML file, of the type that its key demands."""
    right = isinstance(value, (int, float) if kind is float else kind) and isinstance(value, bool) == (kind is bool)
    if not right:
        words = {
            float: "a number",
            int: "a whole number",
            str: "a text",
            list: "a list of names",
            bool: "true or false",
        }
        said = str(value).lower() if isinstance(value, bool) else repr(value)
        raise ScenarioError(f"{where} = {said} must be {words[kind]}")
    if kind is float and not (math.isfinite(value) if isinstance(value, float) else abs(value) <= sys.float_info.max):
        raise ScenarioError(f"{where} = {value!r} must be finite")
    return kind(value)
