"""One case by one interface, judged."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass
from pathlib import Path

from cosim.errors import CosimError
from cosim.regression.case import Case
from cosim.regression.comparison import SignalComparison, compare_signals
from cosim.regression.tolerances import Interface

#: Longest time (s) that a run may take.
TIMEOUT = 600.0

#: Short names, for people and for node ids.
SHORT = {"co_simulation": "CS", "model_exchange": "ME"}


@dataclass(frozen=True)
class Outcome:
    """Findings (one line each, none where all agrees), the compared signals, and what the FMU printed."""

    case: str
    fmu: str
    interface: str
    findings: list[str]
    signals: list[SignalComparison]
    said: str
    seconds: float

    @property
    def worst(self) -> SignalComparison | None:
        """The signal that uses most of its tolerance."""
        return max(self.signals, key=share, default=None)

    def summary(self) -> list[tuple[str, str]]:
        """Name and value of what a test report should have: the largest differences."""
        pairs = [("fmu", self.fmu), ("case", self.case), ("interface", self.interface)]
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


def check(case: Case, fmu: Path, interface: Interface, *, isolated: bool = True, timeout: float = TIMEOUT) -> Outcome:
    """Run an FMU for a case and compare the results with the reference.

    Parameters
    ----------
    case : Case
    fmu : Path
    interface : {"co_simulation", "model_exchange"}
    isolated : bool
        In a process of its own, which a crash ends without harm to this one.
    timeout : float
        Longest time (s) that an isolated run may take.

    Returns
    -------
    Outcome
        Also what can't be read or run is a finding.
    """
    began = clock.perf_counter()
    findings: list[str] = []
    signals: list[SignalComparison] = []
    said = ""
    try:
        # what is wrong with the files is said before anything runs
        reference, tolerances = case.reference(), case.tolerances(interface)
        if isolated:
            from cosim.regression.isolated import run_isolated

            results, said = run_isolated(case, fmu, interface, timeout)
        else:
            from cosim.regression.run import run

            results = run(case, fmu, interface)
        comparison = compare_signals(results, reference, tolerances)
        findings, signals = comparison.findings, comparison.signals
    except CosimError as error:
        findings = [str(error)]
    seconds = clock.perf_counter() - began
    return Outcome(case.name, str(fmu), SHORT[interface], findings, signals, said, seconds)
