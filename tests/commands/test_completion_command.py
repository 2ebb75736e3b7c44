"""`cosim completion`."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from cosim.__main__ import commands, main
from tests.support.patience import PATIENCE

ASK = """
source "$1"
COMP_WORDS=($2) COMP_CWORD=$(($# - 2))
COMP_WORDS=("${@:2}")
compopt() { :; }
_shtab_cosim
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.mark.parametrize(("words", "expected"), [(("va",), "validate"), (("run", "--extrap"), "--extrapolation")])
def test_bash_completes(tmp_path, capsys, words, expected):
    if shutil.which("bash") is None:
        pytest.skip("there is no bash here")
    assert main(["completion", "bash"]) == 0
    script = tmp_path / "completion"
    script.write_text(capsys.readouterr().out)
    done = subprocess.run(
        ["bash", "-c", ASK, "bash", str(script), "cosim", *words],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=True,
    )
    assert expected in done.stdout.split()


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_each_script_knows_all_commands(capsys, shell):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(command in script for command in commands())
