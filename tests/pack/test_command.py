"""`cosim pack`."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from cosim import Results
from cosim.__main__ import main
from cosim.ssp import Experiment, write_ssp
from tests.support.packed_fmus import columns, run_in_fmpy, small_loop

TOML = """
title = "A loop"
[components.i]
fmu = "Integrator.fmu"
[components.g]
fmu = "Gain.fmu"
[run]
stop_time = 1.0
step_size = 0.1
[start.i]
x_start = 1.0
[start.g]
K = -1.3
[[connections]]
from = "i.x"
to = "g.u[1]"
[[connections]]
from = "g.y[1]"
to = "i.u"
[signals."g.u[2]"]
shape = "step"
time = 0.5
after = 2.0
"""


@pytest.fixture
def folder(small_fmus: dict[str, Path], tmp_path: Path) -> Path:
    for fmu in small_fmus["fmi2"].glob("*.fmu"):
        shutil.copy(fmu, tmp_path)
    (tmp_path / "loop.toml").write_text(TOML, encoding="utf-8")
    return tmp_path


def test_a_scenario(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = folder / "Whole.fmu"
    assert main(["pack", str(folder / "loop.toml"), "--out", str(out), "--set", "i.T=0.7"]) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"{out}  ")
    assert said.rstrip().endswith("0 inputs, 3 outputs, 5 parameters")
    assert main(["run", str(folder / "loop.toml"), "--set", "i.T=0.7", "--out", str(folder / "results")]) == 0
    names = ["i.x", "g.y[1]", "g.y[2]"]
    expected = columns(Results.read(folder / "results/results.csv"), names)
    assert np.array_equal(run_in_fmpy(out, 1.0, 0.1, names), expected)
    assert main(["validate", "--run", str(out)]) == 0


def test_an_ssp(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_ssp(folder / "loop.ssp", small_loop(folder), "loop", Experiment(1.0, 0.1))
    arguments = ["pack", str(folder / "loop.ssp"), "--out", str(folder / "W.fmu")]
    assert main([*arguments, "--step", "0.1", "--fmi", "3", "--outputs", "i.x", "--order", "parallel"]) == 0
    assert "FMI 3.0" in capsys.readouterr().out
    assert run_in_fmpy(folder / "W.fmu", 1.0, 0.1, ["i.x"]).shape == (11, 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--out", "W.zip"], "cosim: --out W.zip: the name of an FMU ends with .fmu"),
        (["--out", "W.fmu", "--inputs", "g.w"], "cosim: component 'g' has no variable 'w'"),
        (["--out", "W.fmu", "--ssv", "a.ssv"], "cosim: --ssv is for SSPs and OSP configurations"),
        (["--out", "nowhere/in/there/W.fmu", "--step", "-1"], "cosim: step -1.0 s must be positive"),
    ],
)
def test_errors_are_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, options: list[str], message: str
) -> None:
    monkeypatch.chdir(folder)
    assert main(["pack", "loop.toml", *options]) == 1
    assert capsys.readouterr().err.startswith(message)
    assert not list(folder.glob("W*"))
