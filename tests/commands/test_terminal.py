"""What the program prints of others: shown, and not obeyed by a terminal."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from cosim.__main__ import main
from cosim.terminal import filtered_output, printable, screen


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain, ä, 模型\n\tmore", "plain, ä, 模型\n\tmore"),
        ("\x1b[31mred", r"\x1b[31mred"),
        ("\x9b31m", r"\x9b31m"),
        ("over\rwritten", r"over\rwritten"),
        ("a\u202eb", r"a\u202eb"),
        ("bell\a", r"bell\x07"),
        ("lone \udc80", r"lone \udc80"),
    ],
)
def test_codes_are_shown(text: str, shown: str) -> None:
    assert printable(text) == shown


def test_all_that_is_printed_is_filtered_and_progress_bars_are_not(capsys: pytest.CaptureFixture[str]) -> None:
    stream = sys.stderr
    with filtered_output():
        print("\x1b[2J")
        print("\x1b]0;title\a", file=sys.stderr)
        screen().write("\x1b[A")
        assert screen() is stream
    assert capsys.readouterr() == ("\\x1b[2J\n", "\\x1b]0;title\\x07\n\x1b[A")
    assert sys.stderr is stream


def test_names_of_files_are_filtered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["validate", "no\x1b[31m.fmu"]) == 1
    assert capsys.readouterr().out == "no\\x1b[31m.fmu: there is no such file\n"
