"""`cosim run SCENARIO`: a scenario of an installed package, or a TOML file."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from cosim.commands.execution import (
    Plan,
    PreparedRun,
    UsageError,
    refuse,
    results_folder,
    start_value,
    with_start_values,
)
from cosim.commands.options import chosen_interfaces
from cosim.errors import nearest
from cosim.scenario.family import ScenarioFamily, families
from cosim.scenario.metrics import Metric
from cosim.scenario.own_fmus import replaced
from cosim.scenario.reading import load_with_family
from cosim.scenario.scenario import Scenario
from cosim.system.system import System


@contextmanager
def prepared_scenario(args: argparse.Namespace) -> Iterator[PreparedRun]:
    """The run of a scenario with the options of the command line.

    Raises
    ------
    CosimError
        The scenario is malformed, an option makes no sense, or an FMU can't be had.
    """
    scenario, family = scenario_of(args)
    folder = results_folder(args, scenario.name)
    scenario, system = system_of(scenario, family, args)
    yield PreparedRun(
        source=args.scenario,
        title=scenario.title,
        system=system,
        plan=Plan(
            scenario.stop_time,
            scenario.step_size,
            scenario.start_time,
            scenario.order,
            scenario.extrapolation,
            scenario.record,
            scenario.record_every,
            scenario.tolerance,
            scenario.solver,
            scenario.solver_step,
            scenario.iterations,
        ),
        folder=folder,
        about={"scenario": scenario.name, "title": scenario.title, "seed": scenario.seed},
        details={
            "signals": {target: shape.as_data() for target, shape in scenario.signals.items()},
            "disturbances": {target: shape.as_data() for target, shape in scenario.disturbances.items()},
        },
        metrics=scenario.metrics,
        further_metrics=partial(family.metrics, scenario),
        report=partial(family.report, scenario),
        drawing=family.drawing,
        drawing_arguments=family.drawing_arguments(scenario),
    )


def scenario_of(args: argparse.Namespace) -> tuple[Scenario, ScenarioFamily]:
    """The scenario that a user names, with the options of the command line, and its family.

    Raises
    ------
    CosimError
        It is malformed, or an option makes no sense.
    """
    scenario, family = load_with_family(args.scenario)
    refuse({"--input": args.input}, "is for a single FMU; a scenario has signals of shape = 'table'")
    for name, other in families().items():
        if other is not family:
            refuse({o: getattr(args, d) for o, d in args.family_options[name].items()}, f"is for scenarios of {name}")
    scenario = _with_options(scenario, args)
    for assignment in args.set:
        start_value(assignment, list(scenario.components))
    return scenario, family


def system_of(scenario: Scenario, family: ScenarioFamily, args: argparse.Namespace) -> tuple[Scenario, System]:
    """A scenario with all its FMUs, and its system with the user's FMUs and start values.

    Raises
    ------
    CosimError
        An FMU can't be had, or an option makes no sense.
    """
    scenario = family.prepared(scenario, args)
    system = _with_own_fmus(args.fmu, scenario, family)
    return scenario, with_start_values(system, args.set, "change the scenario's TOML")


def _with_options(scenario: Scenario, args: argparse.Namespace) -> Scenario:
    """The scenario with the options of the command line."""
    if args.seed is not None and args.seed < 0:
        raise UsageError(f"--seed {args.seed}: must be 0 or greater")
    given = {
        "step_size": args.step,
        "start_time": args.start,
        "stop_time": args.stop,
        "order": args.order,
        "extrapolation": args.extrapolation,
        "tolerance": args.tolerance,
        "record": args.record,
        "record_every": args.record_every,
        "seed": args.seed,
        "solver": args.solver,
        "solver_step": args.solver_step,
        "iterations": args.iterations,
    }
    scenario = dataclasses.replace(scenario, **{key: value for key, value in given.items() if value is not None})
    scenario = scenario.with_interfaces(chosen_interfaces(args.interface, scenario.components))
    if args.record is not None and (lost := [n for n, m in scenario.metrics.items() if not _recorded(m, args.record)]):
        print(f"note: --record leaves out what these metrics need: {', '.join(lost)}")
        return dataclasses.replace(scenario, metrics={n: m for n, m in scenario.metrics.items() if n not in lost})
    return scenario


def _recorded(metric: Metric, record: list[str]) -> bool:
    """Whether what a metric needs is among the names of --record, or the vectors there."""
    return all({variable, variable.rpartition("[")[0]} & set(record) for variable in metric.variables)


def _with_own_fmus(assignments: list[str], scenario: Scenario, family: ScenarioFamily) -> System:
    """The system with the user's own FMU files for some of the components."""
    own = scenario.stand_ins
    for assignment in assignments:
        component, equals, path = assignment.partition("=")
        if not (component and equals and path):
            raise UsageError(f"--fmu {assignment}: write COMPONENT=FILE, as controller=PID.fmu")
        if component not in scenario.components:
            hint = nearest(component, scenario.components)
            raise UsageError(f"--fmu {assignment}: the scenario has no component '{component}'; {hint}")
        own[component] = Path(path)
    system, missing = replaced(scenario.system(), own, family.optional_inputs)
    if missing:
        print(f"note: the FMUs given have no {', '.join(missing)}, so nothing is connected there")
    return system
