"""The matrix as a page."""

from __future__ import annotations

import platform
import re
from collections.abc import Iterable, Sequence
from importlib.metadata import version

from interop.cases import START, STEP, STOP_TIME
from interop.entries import IMPORTERS
from interop.matrix import Outcome
from interop.references import References, distance
from interop.tools.launch import package_version, tool
from interop.validators import VDMCHECK, Validation
from interop.verdict import TOLERANCES

_STATUS = {
    "holds": "yes",
    "outside": "**outside its tolerance**",
    "failed": "**failed**",
    "known": "no",
    "mended": "**runs, though noted as failing**",
    "absent": "not here",
}
_FLAVOURS = {"fmi2": "FMI 2.0", "fmi3": "FMI 3.0", "pythonfmu": "pythonfmu"}


def markdown(outcomes: Sequence[Outcome], validations: Sequence[Validation], references: References) -> str:
    """The page; it is the same for the same outcomes."""
    return "\n".join([*_head(references), *_matrix(outcomes), *_traps(outcomes), *_validators(validations), ""])


def _head(references: References) -> Iterable[str]:
    start = ", ".join(f"`{part}.{n}` = {value:g}" for part, values in START.items() for n, value in values.items())
    yield from (
        "# In other tools",
        "",
        "Written by `python -m interop`, which names tools that are not installed with the way to get them; do not "
        "edit. The tests run part of it: tests/test_interop.py. "
        f"Python {platform.python_version()}, {platform.system()} {platform.machine()}.",
        "",
        f"Every tool runs the closed loop for {STOP_TIME:g} s with a communication step of {STEP * 1e3:g} ms, with "
        f"these values, none of which is the start value in the files: {start}. A tool that passes one over runs "
        "another system, and is far outside its tolerance.",
        "",
        "Compared is the position of the end effector at every communication point: the largest distance, in m, over "
        "the run. What to expect follows from how a tool exchanges values:",
        "",
        "| exchange | compared with, tolerance |",
        "|---|---|",
        *(f"| {name} | {text} |" for name, text in TOLERANCES.items()),
        "",
        f"Our own runs are {_number(distance(references.sequential, references.continuous))} m (sequential) and "
        f"{_number(references.first_order_error)} m (parallel) away from the continuous loop, both of first order in "
        "the step. With inputs that change linearly (`--extrapolation linear`), which no tool here does, it is "
        "second order and a hundred times less.",
        "",
    )


def _matrix(outcomes: Sequence[Outcome]) -> Iterable[str]:
    yield from (
        "## Matrix",
        "",
        _summary(outcomes),
        "The error is the distance from the continuous loop.",
        "",
        "| tool | files | exchange | runs | difference (m) | tolerance (m) | error (m) |",
        "|---|---|---|---|---|---|---|",
    )
    for o in outcomes:
        e, v = o.entry, o.verdict
        numbers = ["", "", ""]
        if v is not None:
            numbers = [_number(v.difference), f"{v.tolerance:.1e}", _number(v.error)]
            if v.remainder is not None:
                numbers[0] += f"; {_number(v.remainder)} at step 0"
                numbers[1] += f"; {v.remainder_tolerance:.1e}"
        cells = (tool(e.tool).TITLE, f"{e.files}, {_FLAVOURS[e.flavour]}", e.exchange, _STATUS[o.status], *numbers)
        yield "| " + " | ".join(cells) + " |"
    yield from ("", "| tool | version |", "|---|---|")
    yield from (
        f"| {tool(name).TITLE} | {package_version(name)} |" for name in dict.fromkeys(o.entry.tool for o in outcomes)
    )
    yield ""


def _summary(outcomes: Sequence[Outcome]) -> str:
    """How many independent importers agree."""

    def agreeing(*, ssp: bool) -> list[str]:
        native = (o.entry for o in outcomes if o.status == "holds" and o.entry.flavour != "pythonfmu")
        return list(
            dict.fromkeys(IMPORTERS[e.tool] for e in native if (e.files == "SSP") == ssp and e.tool in IMPORTERS)
        )

    importers, masters = agreeing(ssp=False), agreeing(ssp=True)
    return (
        f"{len(importers)} importers, each with its own code that loads and calls FMUs, run the native FMUs within the "
        f"tolerance: {', '.join(importers)}. CoFmuPy and PathSim call FMUs through FMPy. {len(masters)} other masters "
        f"run the SSP: {', '.join(masters)}."
    )


def _traps(outcomes: Sequence[Outcome]) -> Iterable[str]:
    """Failures of tools, and traps that the drivers avoid."""
    yield from ("## Failures and remedies", "")
    for o in outcomes:
        title = f"{tool(o.entry.tool).TITLE}, {o.entry.files}, {_FLAVOURS[o.entry.flavour]}"
        if o.status == "known":
            yield f"- {title}: {o.entry.fails}. Seen: `{_short(o.reason)}`"
        elif o.reason and o.status != "absent":
            yield f"- {title}: {_short(o.reason)}"
    absent = {tool(o.entry.tool).TITLE: o.reason for o in outcomes if o.status == "absent"}
    yield from (f"- {title}: {reason}" for title, reason in absent.items())
    yield from ("", "## Traps, and how the drivers avoid them", "")
    seen = dict.fromkeys(o.entry.tool for o in outcomes)
    for name in seen:
        text = " ".join((tool(name).__doc__ or "").split("\n\n", 1)[-1].split())
        if text.startswith("Trap") or "Trap" in text:
            yield f"- {tool(name).TITLE}: {text[text.index('Trap') :].partition(':')[2].strip()}"
    yield ""


def _validators(validations: Iterable[Validation]) -> Iterable[str]:
    yield from (
        "## Validators",
        "",
        "| validator | version | FMUs without findings | refuses a broken one |",
        "|---|---|---|---|",
    )
    for v in validations:
        found = VDMCHECK if v.validator == "VDMCheck2" else f"fmpy {version('fmpy')}"
        if v.reason:
            yield f"| {v.validator} | {found} | not run: {v.reason} | |"
            continue
        names = ", ".join(f"{path.parent.name}/{path.stem}" for path in v.passed)
        yield f"| {v.validator} | {found} | {len(v.passed)}: {names} | {'yes' if v.catches else '**no**'} |"
        yield from (f"| | | **{finding}** | |" for finding in v.findings)


def _number(value: float) -> str:
    return "0" if value == 0.0 else f"{value:.1e}"


def _short(text: str) -> str:
    """Without names of temporary files, which are others each time."""
    return re.sub(r"/\S*/", "", text)[:200]
