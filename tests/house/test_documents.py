"""README, examples and continuous integration: what they tell a newcomer is true."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.__main__ import commands
from parallel_robot.models import MODELS
from tests.conftest import DEFAULT_FLAVOUR

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")

PAGES = {"plant": "plant_fmu", "controller": "controller_fmu", "trajectory": "trajectory_fmu"}


def test_ci_runs_the_test_command_of_the_readme(tmp_path: Path) -> None:
    """The script is run on a copy whose README has a harmless command in that place."""
    (tmp_path / ".ci").mkdir()
    (tmp_path / ".ci/run").write_bytes((ROOT / ".ci/run").read_bytes())
    marker = "<!-- the tests -->\n```sh\n"
    assert README.count(marker) == 1
    (tmp_path / "README.md").write_text(f"```sh\nfalse\n```\n{marker}echo it is this one\n```\n```sh\nfalse\n```\n")
    done = subprocess.run(["bash", tmp_path / ".ci/run"], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "it is this one"


def test_example_is_short_and_runs(robot_fmus: Path, tmp_path: Path) -> None:
    example = ROOT / "examples/couple_fmus.py"
    source = example.read_text(encoding="utf-8")
    code = [line for line in source.splitlines() if line.strip() and not line.startswith(('"""', "#"))]
    assert len(code) <= 20
    (tmp_path / "fmus").mkdir()
    (tmp_path / "fmus/fmi2").symlink_to(robot_fmus / DEFAULT_FLAVOUR, target_is_directory=True)
    done = subprocess.run([sys.executable, example], cwd=tmp_path, capture_output=True, text=True, check=True)
    found = re.search(r"at most ([\d.]+) mm", done.stdout)
    assert found is not None
    assert 1.0 < float(found[1]) < 10.0
    assert (tmp_path / "results.csv").is_file()


@pytest.mark.parametrize("instance", PAGES)
def test_model_page_names_every_variable_with_its_unit(instance: str) -> None:
    page = (ROOT / PAGES[instance] / "README.md").read_text(encoding="utf-8")
    for layout in (MODELS[instance].inputs, MODELS[instance].outputs, MODELS[instance].parameters):
        for v in layout.variables:
            name = v.name if v.size is None else f"{v.name}[1..{v.size}]"
            rows = [line for line in page.splitlines() if line.startswith("|") and f"`{name}`" in line]
            assert len(rows) == 1, name
            assert v.unit in rows[0], name


def test_links_of_the_documents_lead_somewhere() -> None:
    for page in ROOT.glob("**/README.md"):
        if ".venv" in page.parts:
            continue
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
            assert target.startswith("https://") or (page.parent / target).exists(), f"{page}: {target}"


def test_readme_names_only_commands_that_exist() -> None:
    assert set(re.findall(r"`cosim ([a-z]+)", README)) <= set(commands())
