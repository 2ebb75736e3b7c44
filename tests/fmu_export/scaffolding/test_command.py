"""`cosim new`: what it writes works at once, and nothing is overwritten."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from cosim.__main__ import main
from tests.support.native_fmus import require_compiler
from tests.support.patience import PATIENCE


def python(*arguments: str | Path) -> str:
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False, timeout=PATIENCE)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["controller", "model", "plant"])
def test_what_it_writes_builds_runs_and_passes_its_test(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    require_compiler()
    monkeypatch.chdir(tmp_path)
    assert main(["new", kind, f"my_{kind}", "--folder", "models/new"]) == 0
    shown = capsys.readouterr().out
    written = {path.name for path in (tmp_path / "models/new").iterdir()}
    assert written == {f"my_{kind}.py", f"test_my_{kind}.py"}
    commands = [line.split("   ")[0].split() for line in shown.splitlines()[1:]]
    assert [command[0] for command in commands] == ["python", "pytest", "cosim"]
    name = f"My{kind.capitalize()}.fmu"
    assert python(*commands[0][1:]).split() == ["built", name]
    assert "passed" in python("-m", "pytest", "-q", "-p", "no:cacheprovider", *commands[1][1:])
    assert main([*commands[2][1:], "--stop", "0.1"]) == 0
    assert commands[2][2] == name


def test_what_it_writes_has_the_style_of_the_house(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also for those who check with ruff's own rules, with longer lines."""
    monkeypatch.chdir(tmp_path)
    for kind in ("model", "plant", "controller"):
        assert main(["new", kind, f"{kind}_of_mine"]) == 0
    options = ["--no-cache", "--isolated", "--line-length", "120"]
    python("-m", "ruff", "check", *options, "--select", "E,F,W,I,UP,B,RET,RUF,PT,SIM", "--ignore", "A", ".")
    python("-m", "ruff", "format", "--no-cache", "--isolated", "--line-length", "120", "--check", ".")


@pytest.mark.parametrize(
    ("name", "module", "fmu"),
    [("MyController", "my_controller", "MyController"), ("pi2", "pi2", "Pi2"), ("PIDLaw", "pidlaw", "Pidlaw")],
)
def test_names(name: str, module: str, fmu: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "model", name]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"{module}.py", f"test_{module}.py"]
    assert f"class {fmu}(ModelClass" in (tmp_path / f"{module}.py").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("my-model", "'my-model' can't be the name of a Python file and a class; take letters, digits and underscores"),
        ("2nd", "'2nd' can't be the name"),
        ("../x", "'../x' can't be the name"),
        ("Lambda", "'Lambda' can't be the name"),
        ("_x", "'_x' can't be the name"),
        ("größe", "'größe' can't be the name"),
        ("numpy", "Python has a module 'numpy' already"),
        ("model_class", "fmu_export has a class 'ModelClass' already"),
    ],
)
def test_names_that_can_not_be_taken(
    name: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "model", name]) == 1
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("existing", ["a_plant.py", "test_a_plant.py"])
def test_nothing_is_overwritten(
    existing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / existing).write_text("mine\n", encoding="utf-8")
    assert main(["new", "plant", "a_plant"]) == 1
    assert (
        capsys.readouterr().err == f"cosim: {existing} exists and is not overwritten; take another name or --folder\n"
    )
    assert [path.name for path in tmp_path.iterdir()] == [existing]
    assert (tmp_path / existing).read_text(encoding="utf-8") == "mine\n"
