"""`cosim run FILE.fmu`: one FMU, its default experiment, and inputs from a table."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import numpy as np
from fmpy.model_description import ModelDescription

from cosim.commands.execution import (
    Plan,
    PreparedRun,
    UsageError,
    refuse,
    results_folder,
    with_interfaces,
    with_start_values,
)
from cosim.errors import nearest
from cosim.fmi.fmu_file import load
from cosim.results.figure_process import DRAWING
from cosim.results.flat_arrays import with_names_of, with_other_names
from cosim.results.results import Results
from cosim.scenario.signals import interpolated
from cosim.system.read import DURATION, STEPS, fitting_step
from cosim.system.system import Signal, System
from cosim.system.variables import Element, Ports


@contextmanager
def prepared_fmu(args: argparse.Namespace) -> Iterator[PreparedRun]:
    """The run of one FMU with the options of the command line.

    Raises
    ------
    CosimError
        The FMU can't be run, or an option makes no sense.
    """
    path = Path(args.scenario)
    further = {option: getattr(args, dest) for known in args.family_options.values() for option, dest in known.items()}
    refuse({**further, "--fmu": args.fmu, "--seed": args.seed}, f"is for scenarios; {path} is a single FMU")
    component = path.stem.replace(".", "_")
    folder = results_folder(args, component)
    description = load(component, path).description
    plan, notes = _plan(component, description, path, args)
    system = System()
    system.add(component, path)
    remedy = f"take it out of {args.input}"
    ports = Ports(
        component, description, with_start_values(system, args.set, remedy, component).components[component].start
    )
    driven = _driven(ports, args.input, plan) if args.input is not None else []
    targets = [signal.target.partition(".")[2] for signal in driven]
    system.signals.extend(driven)
    title = description.modelName or path.stem
    yield PreparedRun(
        source=str(path),
        title=title,
        system=with_interfaces(with_start_values(system, args.set, remedy, component), args.interface),
        plan=plan,
        folder=folder,
        about={"fmu": str(path), "title": title},
        details={"notes": notes, "input": None if args.input is None else str(args.input), "driven": targets},
        drawing=DRAWING,
        drawing_arguments=(title,),
    )


def _plan(
    component: str, description: ModelDescription, path: Path, args: argparse.Namespace
) -> tuple[Plan, list[str]]:
    """The options, and where they say nothing, the default experiment of the FMU; and notes on what was assumed.

    Names to record need not name the component, as those of start values.
    """
    notes: list[str] = []
    start_time = args.start
    if start_time is None:
        start_time = _default(description, path, "startTime", notes) or 0.0
    stop_time = args.stop
    if stop_time is None:
        stop_time = _default(description, path, "stopTime", notes, after=start_time)
    if stop_time is None:
        stop_time = start_time + DURATION
        notes.append(
            f"{path} has no default stop time; it is {stop_time:g} s here, {DURATION:g} s after the start (--stop)"
        )
    step_size = args.step
    if step_size is None:
        asked = _default(description, path, "stepSize", notes, after=0.0)
        step_size = (stop_time - start_time) / STEPS if asked is None else fitting_step(stop_time - start_time, asked)
        if asked is None:
            notes.append(f"{path} has no default step; it is {step_size:g} s here, {STEPS} steps in all (--step)")
        elif step_size != asked:
            notes.append(
                f"{path} asks for steps of {asked:g} s, of which the run is not a whole number; it is {step_size:g} s "
                "here (--step)"
            )
    for note in notes:
        print(f"note: {note}")
    plan = Plan.from_options(args, stop_time, step_size, start_time)
    if plan.record is None:
        return plan, notes
    whole = [name if name.partition(".")[0] == component else f"{component}.{name}" for name in plan.record]
    return dataclasses.replace(plan, record=whole), notes


def _default(
    description: ModelDescription, path: Path, name: str, notes: list[str], after: float = -math.inf
) -> float | None:
    """A time (s) of the default experiment; None where it has none, or one that is not after another."""
    text = getattr(description.defaultExperiment, name, None)
    if text is None:
        return None
    if float(text) > after:
        return float(text)
    notes.append(f'{path} has {name}="{text}" in its default experiment, which makes no sense and is left out')
    return None


def _driven(ports: Ports, path: Path, plan: Plan) -> list[Signal]:
    """A signal for each column of a table: linear between rows for continuous real inputs, held for others."""
    inputs = {element.name: element for element in ports.of_causality("input")}
    table = _of_inputs(Results.read(path), path, ports.component, inputs)
    if not len(table.time):
        raise UsageError(f"{path}: has no rows")
    texts = [name for name in table.names if name in table.typed and table.typed[name].is_text]
    wrong = [name for name in texts if name in inputs and inputs[name].kind != "string"]
    if wrong:
        raise UsageError(
            f"{path}: column '{wrong[0]}' is text, but the input is of type {inputs[wrong[0]].variable.type}"
        )
    numeric = [n for n in table.names if n in inputs and inputs[n].kind in ("string", "binary") and n not in texts]
    if numeric:
        raise UsageError(
            f"{path}: column '{numeric[0]}' has numbers, but the input is of type {inputs[numeric[0]].variable.type}"
        )
    numbers = table.values[:, [name not in texts for name in table.names]]
    if not np.isfinite(numbers).all() or not (np.diff(table.time) >= 0.0).all():
        raise UsageError(f"{path}: values must be finite numbers, and times must not descend")
    if table.time[0] > plan.start_time or table.time[-1] < plan.stop_time:
        first, last = table.time[[0, -1]].tolist()
        print(f"note: {path} goes from {first:g} s to {last:g} s; its first and last rows hold outside")
    signals = []
    for name in table.names:
        if name not in inputs:
            raise UsageError(f"{path}: the FMU has no input '{name}'; {nearest(name, inputs)}")
        _check_unit(path, name, table.units.get(name, ""), ports, inputs[name])
        column = table.values[:, table.names.index(name)] if inputs[name].kind == "real" else table[name]
        values = column[:, np.newaxis]
        between = _between(inputs[name])
        differs = values[1:, 0] != values[:-1, 0]
        jumps = differs if between == "hold" else differs & (np.diff(table.time) == 0.0)
        signals.append(
            Signal(
                f"{ports.component}.{name}",
                interpolated(table.time, values, between),
                tuple(np.unique(table.time[1:][jumps]).tolist()),
                vectorized=True,
            )
        )
    return signals


def _of_inputs(table: Results, path: Path, component: str, inputs: Mapping[str, Element]) -> Results:
    """A table; of a trajectory or of results of a run, which have outputs too, the inputs only."""
    prefix = f"{component}."
    own = {n: n.removeprefix(prefix) for n in table.names if n.startswith(prefix) and n not in inputs}
    table = with_names_of(with_other_names(table, own), inputs)
    if not (own or path.suffix.lower() == ".mat") or not inputs.keys() & set(table.names):
        return table
    kept = [i for i, name in enumerate(table.names) if name in inputs]
    if others := len(table.names) - len(kept):
        print(f"note: {path} has {others} more columns, which are not inputs of the FMU")
    return dataclasses.replace(table, names=[table.names[i] for i in kept], values=table.values[:, kept])


def _check_unit(path: Path, name: str, unit: str, ports: Ports, element: Element) -> None:
    declared = element.variable.declaredType
    known = element.variable.unit or (declared.unit if declared is not None else None)
    defined = ports.unit(element)
    own = known if defined is None else defined.name
    if unit and own and unit != own:
        raise UsageError(f"{path}: column '{name}' is in '{unit}', the input in '{own}'; convert the column")


def _between(element: Element) -> Literal["linear", "hold"]:
    continuous = element.kind == "real" and element.variable.variability in (None, "continuous")
    return "linear" if continuous else "hold"
