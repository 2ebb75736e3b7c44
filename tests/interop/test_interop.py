"""Other tools run our FMUs and agree with us; which ones, and to what tolerance, is in `interop`.

Here run the tools of the extra `test`, once for each thing that they can take; `python -m interop` runs all.
"""

from __future__ import annotations

import itertools
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fmu_export.native.backend import build_native
from interop.cases import STEP, coupled
from interop.entries import ENTRIES, Entry
from interop.matrix import Outcome, run_entries
from interop.page import markdown
from interop.recipes import SHOWN, recipes
from interop.references import References, distance, path_of
from interop.tools import TOOLS
from interop.tools.case import ToolRun
from interop.tools.launch import run_tool, tool
from interop.validators import Validation
from interop.verdict import TOLERANCES, Verdict, judge
from parallel_robot.models import closed_loop_model
from tests.support import some
from tests.support.compilation import shared_compilation

#: Tools that take seconds to start; the others have each kind of exchange and of files.
SLOW = {"pathsim", "fmu_toolbox_ssp", "ecos_ssp", "fmpy_ssp"}


def name_of(entry: Entry) -> str:
    return f"{entry.tool}-{entry.files.replace(' ', '_')}-{entry.flavour}"


QUICK = [
    pytest.param(entry, id=name_of(entry), marks=pytest.mark.slow if entry.tool in SLOW else ())
    for entry in ENTRIES
    if entry.quick
]


@pytest.fixture(scope="module")
def fmus(native_fmus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of native FMUs without pages, and of the closed loop for FMI 2.0."""
    folder = tmp_path_factory.mktemp("interop")
    for flavour in ("fmi2", "fmi3"):
        shutil.copytree(native_fmus / flavour, folder / flavour)
    with shared_compilation():
        build_native(closed_loop_model(), folder / "fmi2", "fmi2")
    return folder


@pytest.fixture(scope="module")
def references(fmus: Path) -> References:
    return References(fmus)


@pytest.mark.parametrize("entry", QUICK)
def test_tool_agrees_with_us(entry: Entry, references: References) -> None:
    (outcome,) = run_entries([entry], references)
    if outcome.status == "absent":
        pytest.skip(f"{tool(entry.tool).TITLE}: {outcome.reason}")
    assert outcome.status == "holds", (outcome.verdict, outcome.reason)


def as_run(path: np.ndarray, step: float = STEP) -> ToolRun:
    """A path as a tool gives it."""
    return ToolRun(0.0, 0.0, np.arange(len(path)) * step, *path.T, "", 2)


def test_our_own_orders_are_of_first_order(references: References) -> None:
    """What the tolerance of tools with an exchange of their own rests on."""
    for error in (distance(references.sequential, references.continuous), references.first_order_error):
        assert 1e-5 < error < 1e-3
    verdict = judge("own", lambda step: run_tool("c_host", coupled(references.fmus, "fmi2", step)), references)
    assert verdict.holds


@pytest.mark.parametrize("exchange", ["sequential", "parallel"])
def test_a_run_that_differs_is_seen(references: References, exchange: str) -> None:
    """Another order, a delay of one step, a tenth of a micrometre, or a gap."""
    ours = {"sequential": references.sequential, "parallel": references.parallel}
    path, other = ours.pop(exchange), *ours.values()
    shifted = np.vstack([path[:1], path[:-1]])
    assert judge(exchange, lambda _: as_run(path), references).holds
    for wrong in (other, shifted, path + 1e-7):
        assert not judge(exchange, lambda _, wrong=wrong: as_run(wrong), references).holds
    with pytest.raises(ValueError, match="no value at some communication points"):
        judge(exchange, lambda _: as_run(path[:-1]), references)
    with pytest.raises(ValueError, match="times are not the communication points"):
        judge(exchange, lambda _: as_run(path, 1.01 * STEP), references)


@pytest.mark.slow
def test_a_parameter_that_is_passed_over_is_seen(fmus: Path, references: References) -> None:
    """Without any one of the values the run is outside the tolerance of every kind of exchange."""
    case = coupled(fmus, "fmi2")
    for part, name in some((part, name) for part, values in case.start.items() for name in values):
        start = {p: {n: v for n, v in values.items() if (p, n) != (part, name)} for p, values in case.start.items()}
        run = run_tool("c_host", replace(case, start=start))
        error = distance(path_of(run), references.continuous)
        assert error > references.first_order_error, f"{part}.{name}"


def test_every_tool_has_an_entry_or_a_reason() -> None:
    tried = {entry.tool for entry in ENTRIES}
    for name in set(TOOLS) - tried:
        assert "no driver" in tool(name).unavailable()
    assert {entry.exchange for entry in ENTRIES} == TOLERANCES.keys()
    for a, b in itertools.combinations(ENTRIES, 2):
        assert (a.tool, a.files, a.flavour) != (b.tool, b.files, b.flavour)


def test_recipes_have_the_values_of_today(fmus: Path) -> None:
    """Up to one in the last digit, which may depend on the platform."""
    pages = (Path(__file__).parents[2] / "docs/recipes.md").read_text(encoding="utf-8"), recipes(fmus)
    number = re.compile(r"-?\d+\.\d{6}\b")
    stored, fresh = ([float(n) for n in number.findall(page)] for page in pages)
    assert len(stored) == len(SHOWN) * 3 + 2
    np.testing.assert_allclose(stored, fresh, rtol=0, atol=1.5e-6)
    assert number.sub("", pages[0]) == number.sub("", pages[1])


def test_page_has_a_row_for_every_entry(references: References) -> None:
    verdict = Verdict(2e-9, 1e-8, 1e-5)
    outcomes = [Outcome(ENTRIES[0], "holds", verdict), *(Outcome(e, "absent", reason="why") for e in ENTRIES[1:])]
    lines = markdown(outcomes, [Validation("VDMCheck2", reason="no Java")], references).splitlines()
    rows = [line for line in lines if line.startswith(f"| {tool(ENTRIES[0].tool).TITLE}")]
    assert "| yes | 2.0e-09 | 1.0e-08 | 1.0e-05 |" in rows[0]
    assert sum("| not here |" in line for line in lines) == len(ENTRIES) - 1
    assert any("not run: no Java" in line for line in lines)
