"""One case by one interface, judged."""

from __future__ import annotations

import time as clock
from contextlib import suppress
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from cosim.errors import CosimError
from cosim.regression.case import Case, Method, Solver
from cosim.regression.comparison import SignalComparison, compare_signals
from cosim.regression.tolerances import Interface
from cosim.results.results import Results

#: Longest time (s) that a run may take.
TIMEOUT = 600.0

#: Short names, for people and for node ids.
SHORT = {"co_simulation": "CS", "model_exchange": "ME"}


@dataclass(frozen=True)
class Outcome:
    """Findings (one line each, none where all agrees), the compared signals, and what the FMU printed.

    `notes` say how a reference was met, or what was not compared. `unclear` says why a difference is no finding.
    """

    case: str
    fmu: str
    interface: str
    findings: list[str]
    signals: list[SignalComparison]
    said: str
    seconds: float
    notes: tuple[str, ...] = ()
    unclear: str = ""

    @property
    def worst(self) -> SignalComparison | None:
        """The signal that uses most of its tolerance."""
        return max(self.signals, key=share, default=None)

    def summary(self) -> list[tuple[str, str]]:
        """Name and value of what a test report should have: the largest differences."""
        pairs = [("fmu", self.fmu), ("case", self.case), ("interface", self.interface)]
        pairs += [("note", note) for note in self.notes]
        for signal in self.signals:
            unit = f" ({signal.unit})" if signal.unit else ""
            shifted = " from its funnel" if signal.tolerance.time_shift else ""
            pairs.append(
                (f"largest difference of {signal.name}{shifted}{unit}", f"{signal.distance[signal.worst]:.6g}")
            )
        return pairs


def share(signal: SignalComparison) -> float:
    """Largest part of its tolerance that a signal uses; infinite where it has none to use."""
    distance = float(signal.distance[signal.worst])
    if distance == 0.0:
        return 0.0
    return distance / signal.allowed if signal.allowed and distance == distance else float("inf")


def check(
    case: Case,
    fmu: str | PathLike[str],
    interface: Interface,
    *,
    isolated: bool = True,
    timeout: float = TIMEOUT,
    build: bool = False,
    log: str | None = None,
) -> Outcome:
    """Run an FMU for a case and compare the results with the reference.

    Parameters
    ----------
    case : Case
    fmu : path
    interface : {"co_simulation", "model_exchange"}
    isolated : bool
        In a process of its own, which a crash ends without harm to this one.
    timeout : float
        Longest time (s) that an isolated run may take.
    build : bool
        Compile the C sources of an FMU that has no binary for this machine.
    log : str, optional
        Level of the messages of the FMU that are written, to the output of the run; see `cosim.Log`.

    Returns
    -------
    Outcome
        Also what can't be read or run is a finding.
    """
    began = clock.perf_counter()
    fmu = Path(fmu)

    from cosim.fmi.isolation.process import can_isolate  # takes a while to import
    from cosim.regression.isolated import run_isolated
    from cosim.regression.run import RunOptions, run

    options = RunOptions(build, log)

    def attempt(interface: Interface, method: Method) -> tuple[list[str], list[SignalComparison], str]:
        try:
            # what is wrong with the files is said before anything runs
            reference = case.reference() if case.is_compared else None
            tolerances = case.tolerances(interface)
            if isolated and can_isolate():
                results, said = run_isolated(case, fmu, interface, timeout, method, options)
            else:
                results, said = run(case, fmu, interface, method, options), ""
            if reference is None:
                return _not_finite(results), [], said
            if interface == "model_exchange":
                reference = _without_texts(reference)
            comparison = compare_signals(results, reference, tolerances)
        except CosimError as error:
            return [str(error)], [], ""
        return comparison.findings, comparison.signals, said

    solver: Solver = "CVode"
    notes: tuple[str, ...] = ()
    unclear = ""
    with suppress(CosimError):  # which the attempt below finds, too
        solver = case.solver
    found = attempt(interface, "Euler" if solver == "Euler" else "CVode")
    if found[0] and interface == "model_exchange" and solver == "either":
        by_euler = attempt(interface, "Euler")
        if not by_euler[0]:
            found, notes = by_euler, ("met by Euler's explicit method, not by CVode",)
        elif by_euler[1] and "co_simulation" in _interfaces(fmu) and not attempt("co_simulation", "CVode")[0]:
            unclear = (
                f"co-simulation meets the reference, model exchange does not: {found[0][0]}; nothing says by which "
                f"solver it was made: give solver, solver_step or tolerances in {case.tolerances_path.name}"
            )
    findings, signals, said = found
    seconds = clock.perf_counter() - began
    return Outcome(
        case.name, str(fmu), SHORT[interface], [] if unclear else findings, signals, said, seconds, notes, unclear
    )


def _interfaces(fmu: Path) -> list[Interface]:
    from cosim.fmi.fmu_file import read_fmu
    from cosim.regression.run import interfaces_of

    return interfaces_of(read_fmu(fmu, str(fmu)))


def _not_finite(results: Results) -> list[str]:
    """Signals of a run without a reference that are not finite."""
    return [
        f"'{name}' is {values[~np.isfinite(values)][0]:.9g} at t = {results.time[~np.isfinite(values)][0]:.9g} s"
        for name in results.names
        if name not in results.typed and not np.isfinite(values := np.asarray(results[name], dtype=float)).all()
    ]


def _without_texts(reference: Results) -> Results:
    """The signals that model exchange has: it records numbers only."""
    kept = [i for i, n in enumerate(reference.names) if n not in reference.typed or not reference.typed[n].is_text]
    names = [reference.names[i] for i in kept]
    typed = {n: c for n, c in reference.typed.items() if n in names}
    return Results(reference.time, names, reference.values[:, kept], reference.info, typed)
