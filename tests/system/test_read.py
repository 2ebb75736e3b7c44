"""What is found while the description of a system is read: notes, problems, steps that are no multiple."""

from __future__ import annotations

import math

import pytest

from cosim import SetupError
from cosim.errors import CosimError
from cosim.system.read import Findings, multiple_of_step


def refused(findings: Findings, *others: str) -> str:
    with pytest.raises(CosimError) as error:
        findings.raise_problems("file", *others)
    assert type(error.value) is findings.error
    return str(error.value)


def test_a_note_is_made_once_and_in_order() -> None:
    findings = Findings()
    assert findings.notes() == ()
    for text in ("b", "a", "b"):
        findings.note(text)
    assert findings.notes() == ("b", "a")


@pytest.mark.parametrize(
    ("n", "more"), [(2, ""), (3, ""), (4, " (and 1 more of this kind)"), (9, " (and 6 more of this kind)")]
)
def test_three_notes_of_a_kind_are_shown_and_the_others_counted(n: int, more: str) -> None:
    findings = Findings()
    for k in range(n):
        findings.note(f"note {k}", "kind")
    findings.note("note 0", "kind")
    findings.note("another")
    shown = [f"note {k}" for k in range(min(n, 3))]
    assert findings.notes() == (*shown[:-1], shown[-1] + more, "another")


def test_without_problems_nothing_is_raised() -> None:
    Findings().raise_problems("file")


def test_one_problem_is_the_error_itself() -> None:
    findings = Findings(SetupError)
    for _ in range(2):
        findings.problem("file: it is wrong")
    assert refused(findings) == "file: it is wrong"


def test_several_problems_are_one_line_without_what_it_begins_with() -> None:
    findings = Findings(SetupError)
    findings.problem("file: one")
    with findings.collecting():
        raise SetupError("part: two")
    with findings.collecting():
        findings.problem("three")
    assert refused(findings, "part") == "file: 3 things are wrong: (1) one; (2) two; (3) three"


def test_an_error_that_is_no_problem_of_the_system_is_raised() -> None:
    with pytest.raises(ZeroDivisionError), Findings().collecting():
        raise ZeroDivisionError


@pytest.mark.parametrize(("n", "rest"), [(20, "(20) 20"), (21, "(20) 20; and 1 more"), (50, "(20) 20; and 30 more")])
def test_twenty_problems_are_shown_and_the_others_counted(n: int, rest: str) -> None:
    findings = Findings()
    for k in range(n):
        findings.problem(str(k + 1))
    message = refused(findings)
    assert message.startswith(f"file: {n} things are wrong: (1) 1; (2) 2; ")
    assert message.endswith(f"; {rest}")


@pytest.mark.parametrize(
    ("step", "communication_step", "every", "taken"),
    [
        (0.0, 0.1, 1, None),  # that of all
        (0.1, 0.1, 1, None),
        (0.3, 0.1, 3, None),  # but for rounding
        (0.3, None, 1, None),  # there is nothing that it could be a multiple of
        (0.3, 0.0, 1, None),
        (0.25, 0.1, 2, "0.2"),
        (0.27, 0.1, 3, "0.3"),
        (0.01, 0.1, 1, "0.1"),
        (0.5 + 1e-8, 0.25, 2, "0.5"),
    ],
)
def test_a_step_is_so_many_communication_steps(
    step: float, communication_step: float | None, every: int, taken: str | None
) -> None:
    findings = Findings()
    assert multiple_of_step(step, communication_step, "its step", findings) == every
    findings.raise_problems("file")
    note = f"its step {step!r} s is not a multiple of {communication_step!r} s; {taken} s is taken, as libcosim does"
    assert findings.notes() == (() if taken is None else (note,))


@pytest.mark.parametrize("step", [-0.1, math.nan, math.inf])
def test_a_step_that_is_no_time_is_a_problem(step: float) -> None:
    findings = Findings()
    assert multiple_of_step(step, 0.1, "its step", findings) == 1
    assert refused(findings) == f"its step is {step!r}; it must be a positive number of seconds"
