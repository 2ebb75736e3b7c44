"""Run the entries of the matrix."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from interop.cases import coupled, one_fmu, packaged
from interop.entries import Entry
from interop.references import References
from interop.tools.case import Case, ToolRun
from interop.tools.launch import ToolFailed, run_tool, tool
from interop.verdict import Verdict, judge

#: holds: within its tolerance; outside: not so; failed: no result; known: it fails as the entry says; mended: it runs,
#: and the entry says it would not; absent: the tool is not here.
Status = Literal["holds", "outside", "failed", "known", "mended", "absent"]

_CASES: dict[str, Callable[[Path, str, float], Case]] = {
    "three FMUs": coupled,
    "one FMU": one_fmu,
    "SSP": packaged,
}
_TIMEOUT = 600.0  # s


@dataclass(frozen=True)
class Outcome:
    """What became of an entry; `reason` is one line where there is no verdict."""

    entry: Entry
    status: Status
    verdict: Verdict | None = None
    reason: str = ""

    @property
    def is_good(self) -> bool:
        """Whether nothing has to be looked at."""
        return self.status in ("holds", "known", "absent")


def run_entries(entries: Iterable[Entry], references: References) -> Iterator[Outcome]:
    """Run entries one after the other.

    Parameters
    ----------
    entries : iterable of Entry
    references : References
        Of the FMUs to run.
    """
    absent: dict[str, str | None] = {}
    for entry in entries:
        if entry.tool not in absent:
            absent[entry.tool] = tool(entry.tool).unavailable()
        if reason := absent[entry.tool]:
            yield Outcome(entry, "absent", reason=reason)
        else:
            yield _run(entry, references)


def _run(entry: Entry, references: References) -> Outcome:
    def run(step: float) -> ToolRun:
        return run_tool(entry.tool, _CASES[entry.files](references.fmus, entry.flavour, step), _TIMEOUT)

    try:
        verdict = judge(entry.exchange, run, references)
    except (ToolFailed, ValueError) as failure:
        return Outcome(entry, "known" if entry.fails else "failed", reason=str(failure))
    if entry.fails:
        return Outcome(entry, "mended", verdict, "it runs now; take its failure out of interop/entries.py")
    return Outcome(entry, "holds" if verdict.holds else "outside", verdict)
