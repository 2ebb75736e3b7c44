"""Iterated steps: inputs do not run ahead of what feeds them, they go to what comes out at the end of the step.

All components keep their states and step with extrapolated inputs. What is then exchanged says what the inputs should
have gone to: the components go back and step again with inputs interpolated up to there (those that are held have
their value of the end of the step), until what comes out is what the inputs went to. From the trials of this step and
of the last ones a quasi-Newton method learns how what comes out depends on what the inputs go to (interface
quasi-Newton by least squares), so that the iteration converges where a plain one diverges. The compiled loop does the
work, see cosim/loop/iterated_step.c.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cosim.fmi.instance import CallFailed, Instance, check_kept
from cosim.fmi.interfaces import used_interface
from cosim.loop.arena import Arena
from cosim.loop.binding import RETURNED_EARLY, WANTS_TO_END, Operation, OperationKind
from cosim.loop.iterated_step import NOT_CONVERGED, Doing, IteratedStep, KeptState, iterated_step_library
from cosim.master.coupling.algorithm import AUTO, LOOPS, MOST_ITERATIONS
from cosim.master.coupling.extrapolated_inputs import ExtrapolatedInputs
from cosim.master.function_instance import FunctionInstance
from cosim.master.value_layout import ValueLayout
from cosim.system.function import PythonFunction
from cosim.system.resolution import Link, ResolvedSystem

#: Residual at which an iteration ends, and with which a step is accepted where it does not get there, relative to the
#: largest magnitudes of the run: FMUs that choose their internal steps compute no more digits.
_TOLERANCE, _ACCEPTABLE = 1e-8, 1e-4

#: Trials that the quasi-Newton method learns from, at most.
_MOST_COLUMNS = 24

#: Degree of polynomials from which on they go to a rate at the end of the step, too.
_WITH_RATE = 3

#: What is counted over a run.
_COUNTS = ("n_points", "n_iterations", "n_unsolved", "most_taken")

#: Statuses of a step that has not come to its end.
_UNFINISHED = {2: "discards a step", 5: "computes a step by itself (pending)"} | {
    WANTS_TO_END: "ends the simulation",
    RETURNED_EARLY: "returns early from a step",
}


@dataclass(frozen=True)
class Iteration:
    """How often steps are repeated.

    Attributes
    ----------
    most : int
        Iterations of a step at most; 0 where steps are not repeated.
    must_converge : bool
        A step that is not solved by so many is an error.
    """

    most: int = 0
    must_converge: bool = False


def iteration_of_steps(iterations: int | str | None) -> Iteration:
    """How often steps are repeated, by a number that makes sense, see `most_iterations`."""
    if iterations is None or iterations == LOOPS:
        return Iteration()
    return Iteration(MOST_ITERATIONS, must_converge=True) if iterations == AUTO else Iteration(int(iterations))


def why_not_repeated(
    system: ResolvedSystem, functions: Mapping[str, PythonFunction], *, to_other_points: bool = False
) -> str:
    """Why steps of a system can't be repeated, in words that begin with a component; empty where they can.

    `to_other_points`: steps of other lengths are tried.
    """
    for name, port in system.ports.items():
        function = functions.get(name)
        if function is not None:
            is_called_again = to_other_points or (function.inputs and function.direct_feedthrough)
            if function.owner is not None and is_called_again and not function.can_save:
                return f"component '{name}': a {type(function.owner).__qualname__} has no save() and restore()"
            continue
        try:
            check_kept(used_interface(port.description))
        except CallFailed as error:
            return f"component '{name}': its FMU {error}"
        if port.is_model_exchange:
            return f"component '{name}' is in model exchange, whose solver chooses its steps"
        if port.uses_events:
            return f"component '{name}' has events that the master handles"
        if system.components[name].every != 1:
            return f"component '{name}' has a communication step of its own ({system.components[name].every} steps)"
    return ""


class Iterated:
    """What of a system is iterated: positions of values.

    Attributes
    ----------
    links : list of Link
        Those whose inputs go to what comes out at the end of a step.
    held : list of int
        Positions of those inputs that are held over a step.
    positions : list of int
        Those of all inputs that are iterated, and of the rates of some.
    """

    def __init__(self, system: ResolvedSystem, extrapolated: ExtrapolatedInputs, layout: ValueLayout) -> None:
        self.links: list[Link] = []
        self.held: list[int] = []
        self.positions: list[int] = []
        rates: list[int] = []
        for link in system.links:
            key = (link.target_component, link.target.name)
            used = extrapolated.moving.get(key)
            if system.components[link.target_component].function is not None:
                continue
            if used is None and not _goes_on(link):
                continue
            self.links.append(link)
            self.positions.append(layout.positions[key])
            if used is None:
                self.held.append(layout.positions[key])
            elif used.uses_rates and used.degree >= _WITH_RATE:
                rates.append(layout.rates[key])
        self.positions += rates


def _goes_on(link: Link) -> bool:
    """Whether what a link carries to a held input changes during a step, and is not held on purpose."""
    is_real = link.target.kind == "real" and link.source.kind == "real"
    changes = [e.variable.variability in (None, "continuous") for e in (link.source, link.target)]
    return is_real and all(changes) and link.extrapolation != "hold"


class IteratedSteps:
    """Performs the steps of all components, again and again.

    Parameters
    ----------
    iterated : Iterated
        What is iterated; not empty.
    instances : mapping
        Component -> instance.
    tables : mapping
        The operations of what an iterated step performs, each with `operations`, `codes` and `rows`: STEPPING,
        EXCHANGING, SETTING.
    n_values : int
        Number of all values.
    asked : Iteration
    demanded : bool
        An FMU that refuses what its inputs do during a step is an error.
    arena : Arena
    """

    def __init__(
        self,
        iterated: Iterated,
        instances: Mapping[str, Instance],
        tables: Mapping[Doing, Any],
        n_values: int,
        asked: Iteration,
        arena: Arena,
        *,
        demanded: bool,
    ) -> None:
        self._iterated, self._tables = iterated, tables
        self._stepped = [name for name, i in instances.items() if not isinstance(i, FunctionInstance)]
        step = self._step = arena.structure(IteratedStep)
        for name, doing in (("steps", Doing.STEPPING), ("exchange", Doing.EXCHANGING), ("sets", Doing.SETTING)):
            table = tables[doing]
            setattr(step, name, ctypes.cast(table.operations, ctypes.POINTER(Operation)))
            setattr(step, f"codes_of_{name}", ctypes.cast(table.codes, ctypes.POINTER(ctypes.c_uint32)))
            setattr(step, f"n_{name}", len(table))
        self._states = [instances[name].kept_state() for name in self._stepped]
        step.states = arena.structure(KeptState * len(self._states))
        for i, state in enumerate(self._states):
            step.states[i] = state
        n, held = len(iterated.positions), len(iterated.held)
        self._columns = min(max(4, 2 * n), _MOST_COLUMNS)
        step.positions = arena.integers([*iterated.positions, *iterated.held])
        step.before, step.ahead = arena.zeros(n_values), arena.zeros(n_values)
        for name in ("found", "residuals", "best", "sizes", "last_found", "last_residuals", "room"):
            setattr(step, name, arena.zeros(n))
        step.differences, step.basis = arena.zeros(self._columns * 2 * n), arena.zeros(self._columns * n)
        step.weights = arena.zeros(self._columns * (self._columns + 1))
        step.chosen = arena.integers([0] * self._columns)
        step.tolerance, step.acceptable = _TOLERANCE, _ACCEPTABLE
        step.n_values, step.n, step.n_held, step.n_states = n_values, n, held, len(self._states)
        step.most, step.columns = asked.most, self._columns
        step.must_converge, step.demanded = asked.must_converge, demanded
        self._rows_of_states = [functions_of_states(instances[name]) for name in self._stepped]

    def operation(self) -> Operation:
        """What is to be done to go on to the next communication point."""
        function = iterated_step_library().step_iterated
        return Operation(
            kind=OperationKind.GROUP,
            every=1,
            version=3,
            function=ctypes.cast(function, ctypes.c_void_p).value,
            data=ctypes.addressof(self._step),
        )

    def begin(self) -> None:
        """Begin a run."""
        step = self._step
        step.n_points = step.n_iterations = step.n_unsolved = step.n_columns = step.most_taken = 0
        step.largest_residual = step.residual = 0.0
        for i in range(step.n):
            step.sizes[i] = 0.0

    def numbers(self) -> list[float]:
        """What of it belongs to the state of a run."""
        step, n = self._step, self._step.n
        sizes, learnt = (step.sizes[i] for i in range(n)), (step.differences[i] for i in range(self._columns * 2 * n))
        counts = (float(getattr(step, name)) for name in _COUNTS)
        return [float(step.n_columns), *sizes, *learnt, *counts, step.largest_residual]

    def restore(self, numbers: list[float]) -> None:
        """Take what `numbers` gave, and more, from the front of a list."""
        step, n = self._step, self._step.n
        step.n_columns = int(numbers.pop(0))
        for array, length in ((step.sizes, n), (step.differences, self._columns * 2 * n)):
            for i in range(length):
                array[i] = numbers.pop(0)
        for name in _COUNTS:
            setattr(step, name, int(numbers.pop(0)))
        step.largest_residual = numbers.pop(0)

    def summary(self) -> dict[str, Any]:
        """For people: what was iterated, and what it took."""
        step = self._step
        return {
            "inputs": [f"{k.target_component}.{k.target.name}" for k in self._iterated.links],
            "steps": step.n_points,
            "iterations": step.n_iterations,
            "most_iterations": step.most_taken,
            "not_converged": step.n_unsolved,
            "tolerance": step.tolerance,
            "largest_residual": step.largest_residual,
        }

    # Failures

    def failed(self, status: int) -> Any:
        """The row of a table that has failed; None where it was none, see `failure`."""
        doing = Doing(self._step.failed_in)
        if status == NOT_CONVERGED or doing in (Doing.KEEPING, Doing.GOING_BACK):
            return None
        row = self._tables[doing].rows[self._step.failed]
        return None if self._is_unfinished(row, status) else row

    def failure(self, status: int, instances: Mapping[str, Instance]) -> tuple[str, str]:
        """Components and what went wrong, where it was no row of a table."""
        step, doing = self._step, Doing(self._step.failed_in)
        if status == NOT_CONVERGED:
            names = [f"'{k.target_component}.{k.target.name}'" for k in self._iterated.links]
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            components = dict.fromkeys(k.target_component for k in self._iterated.links)
            return ", ".join(components), (
                f"no step to the next communication point was found by {step.most} iterations in which inputs "
                f"{', '.join(names[:3])}{more} go to what comes out: the residual is {step.residual:.3g} of what they "
                "carry; make the step shorter, or couple these components by model exchange"
            )
        if doing in (Doing.KEEPING, Doing.GOING_BACK):
            component, names_of = self._stepped[step.failed], self._rows_of_states[step.failed]
            return component, str(instances[component].failure(names_of[doing], status))
        row = self._tables[doing].rows[step.failed]
        return row.component, (
            f"it {_UNFINISHED[status]}, which can't be repeated; leave iterations out (option --iterations)"
        )

    @staticmethod
    def _is_unfinished(row: Any, status: int) -> bool:
        return row.operation.kind == OperationKind.STEP and status in _UNFINISHED


def functions_of_states(instance: Instance) -> dict[Doing, str]:
    """Names of the functions that keep the state of an FMU, and go back to it."""
    word = "state" if instance.version == 2 else "State"
    return {
        Doing.KEEPING: f"fmi{instance.version}GetFMU{word}",
        Doing.GOING_BACK: f"fmi{instance.version}SetFMU{word}",
    }
