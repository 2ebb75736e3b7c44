"""Long builds say on a terminal what they are doing; short ones, and what is no terminal, show nothing."""

from __future__ import annotations

import io

import pytest

from fmu_export.progress import Progress
from tests.support.patience import PATIENCE, wait_for


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_long_build_shows_its_stage_and_clears_the_line() -> None:
    stream = Terminal()
    with Progress("Heat, fmi2", after=0.0, stream=stream) as progress:
        progress.stage = "compiling"
        wait_for(lambda: "compiling" in stream.getvalue())
    shown = stream.getvalue()
    assert "\rHeat, fmi2: " in shown
    assert "compiling, " in shown
    assert shown.endswith("\r")
    assert shown.rpartition("\r")[0].rpartition("\r")[2].strip() == ""


@pytest.mark.parametrize("stream", [io.StringIO(), Terminal()], ids=["file", "short"])
def test_nothing_is_shown(stream: io.StringIO) -> None:
    with Progress("Heat", after=0.0 if type(stream) is io.StringIO else PATIENCE, stream=stream) as progress:
        progress.stage = "tracing"
    assert stream.getvalue() == ""


def test_an_error_passes_and_ends_the_line() -> None:
    with pytest.raises(ValueError, match="it"), Progress("Heat", after=0.0, stream=Terminal()):
        raise ValueError("it")
