"""`cosim info` and `cosim scenarios`."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from cosim.__main__ import main
from cosim.scenario.family import families
from tests.support.c_fmus import binary, description_of_tank, packed
from tests.support.small_fmus import build
from tests.support.tiny_models import GAIN


@pytest.mark.parametrize("flavour", ["fmi2", "fmi3", "pythonfmu"])
def test_it_says_what_an_fmu_is_and_has(tmp_path: Path, capsys: pytest.CaptureFixture[str], flavour: str) -> None:
    fmu = build(tmp_path, flavour, GAIN) / "Gain.fmu"
    assert main(["info", str(fmu)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"Gain (FMI {'3' if flavour == 'fmi3' else '2'}.0): ")
    groups = [line for line in lines if line and not line.startswith((" ", "and "))]
    assert [g.split(" ")[0] for g in groups[1:]] == ["inputs", "outputs", "parameters"]
    [row] = [line.split() for line in lines if line.split()[:1] == ["K"]]
    assert row[1] in ("Real", "Float64")
    assert any("co-simulation" in line and "interpolates inputs" in line for line in lines) or flavour != "fmi2"

    assert main(["info", str(fmu), "--json"]) == 0
    about = json.loads(capsys.readouterr().out)
    assert about["model"] == "Gain"
    assert "co-simulation" in about["interfaces"]
    assert {v["name"]: v["causality"] for v in about["variables"]}["K"] == "parameter"
    assert about["default_experiment"]["stopTime"]


def test_local_variables_are_listed_on_demand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fmu = packed(tmp_path / "t.fmu", description_of_tank(), {binary("tank"): b"no library"})
    assert main(["info", str(fmu)]) == 0
    out = capsys.readouterr().out
    assert "and 1 local; --all lists them" in out
    assert main(["info", str(fmu), "--all"]) == 0
    assert "locals (1)" in capsys.readouterr().out


def test_what_a_terminal_would_obey_is_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = description_of_tank().replace('modelName="Tank"', 'modelName="Tank" description="a&#133;b\u200e\u009bc"')
    fmu = packed(tmp_path / "t.fmu", text, {binary("tank"): b"no library"})
    assert main(["info", str(fmu)]) == 0
    assert capsys.readouterr().out.replace("\n", "").isprintable()


def test_what_is_no_fmu_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(tmp_path / "none.fmu")]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    (tmp_path / "a.fmu").write_text("nothing")
    assert main(["info", str(tmp_path / "a.fmu")]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_scenarios_are_listed_and_copied(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["scenarios"]) == 0
    out = capsys.readouterr().out
    for family in families().values():
        for name in family.scenario_names():
            assert f"\n  {name} " in out
    assert out.count("(default)") == 1
    system, name = next((system, name) for system, family in families().items() for name in family.scenario_names())
    assert main(["scenarios", "--copy", name]) == 0
    assert (tmp_path / f"{name}.toml").read_text().count("[run]") == 1
    copy = tomllib.loads((tmp_path / f"{name}.toml").read_text())  # names its system, whatever else is installed
    assert copy == {"system": system, **tomllib.loads((families()[system].folder / f"{name}.toml").read_text())}
    assert main(["scenarios", "--copy", name]) == 1
    assert "already exists" in capsys.readouterr().err
    assert main(["scenarios", "--copy", name, "--to", "mine.toml"]) == 0
    assert (tmp_path / "mine.toml").read_bytes() == (tmp_path / f"{name}.toml").read_bytes()
    assert main(["scenarios", "--copy", "nothing"]) == 1
    assert "there is no scenario 'nothing'" in capsys.readouterr().err
    assert main(["scenarios", "--to", "x.toml"]) == 1
