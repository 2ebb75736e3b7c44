"""README, examples and continuous integration: what they tell a newcomer is true."""

from __future__ import annotations

import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from cosim.__main__ import command_line, commands
from cosim.sweep.points import design, parse_factor
from parallel_robot.models import MODELS
from tests.support import some
from tests.support.native_fmus import DEFAULT_FLAVOUR

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


def described(page: str) -> dict[str, tuple[str, str]]:
    """Unit and start value of each variable in the tables of a page; a row with one cell for several gives it to all.

    A row names its variables in the first cell; unit and start value are lists of as many or one for all of them.
    """
    found: dict[str, tuple[str, str]] = {}
    head: list[str] = []
    for line in page.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")] if line.startswith("|") else []
        if not cells:
            head = []
        elif not head:
            head = cells
        elif "unit" in head and (names := re.findall(r"`([^`]+)`", cells[0])):
            row = dict(zip(head, cells, strict=True))
            units = row["unit"].split(", ")
            units = units * len(names) if len(units) == 1 else units
            starts = re.split(r", (?![^(]*\))", row["start"])
            starts = starts if len(starts) == len(names) else [row["start"]] * len(names)
            assert len(units) == len(names), f"{line}: {len(units)} units"
            for name, unit, start in zip(names, units, starts, strict=True):
                assert name not in found, f"{name} stands in two rows"
                found[name] = unit, start
    return found


@pytest.mark.parametrize("component", PAGES)
def test_model_page_gives_every_variable_with_its_unit_and_start(component: str) -> None:
    page = described((ROOT / PAGES[component] / "README.md").read_text(encoding="utf-8"))
    model, compared = MODELS[component], 0
    variables = [v for layout in (model.inputs, model.outputs, model.parameters) for v in layout.variables]
    names = {v.name if v.size is None else f"{v.name}[1..{v.size}]": v for v in variables}
    assert set(page) == {*names, *(["rtol", "max_step"] if model.states else [])}
    for name, v in names.items():
        unit, start = page[name]
        assert unit == v.unit, name
        number = re.fullmatch(r"-?[\d.]+(e\d+)?", start.removesuffix(" (none)"))
        if number:
            compared += 1
            assert v in model.outputs.variables or np.all(float(number[0]) == np.asarray(v.start)), name
    assert compared > 5


def test_two_units_for_one_variable_are_noticed() -> None:
    head = "| variable | unit | start |\n|---|---|---|\n"
    assert described(f"{head}| `a`, `b` | m, s | 1, 2 |\n| `c` | N.m.s/rad | |\n") == {
        "a": ("m", "1"),
        "b": ("s", "2"),
        "c": ("N.m.s/rad", ""),
    }
    with pytest.raises(AssertionError, match="2 units"):
        described(f"{head}| `alpha` | 1, s | 0 |\n")


@pytest.mark.parametrize("script", ["make_diagrams"])
def test_figures_are_what_their_script_draws(script: str) -> None:
    figures = runpy.run_path(str(ROOT / f"docs/{script}.py"))["FIGURES"]
    assert figures
    for path, draw in figures.items():
        assert path.read_text(encoding="utf-8") == draw(), f"{path.name}: run docs/{script}.py"


def test_the_figure_of_the_architecture_has_every_room() -> None:
    figure = (ROOT / "docs/architecture.svg").read_text(encoding="utf-8")
    rooms = [path.parent.name for path in (ROOT / "cosim").glob("*/__init__.py")]
    assert len(rooms) > 8
    assert [room for room in rooms if not re.search(rf"\b{room}\b", figure)] == []


def test_links_of_the_documents_lead_somewhere() -> None:
    pages = [page for page in ROOT.glob("**/README.md") if ".venv" not in page.parts]
    links = [(page, link) for page in pages for link in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8"))]
    for page, target in some(links):
        assert target.startswith("https://") or (page.parent / target).exists(), f"{page}: {target}"


def test_readme_names_only_commands_that_exist() -> None:
    assert set(re.findall(r"`cosim ([a-z]+)", README)) <= set(commands())


def _lines_of_commands() -> list[str]:
    """What blocks of README and pages tell to type, and README's sentences, without what stands for something."""
    pages = [page.read_text(encoding="utf-8") for page in some(sorted((ROOT / "docs").glob("*.md")))]
    found = [line for text in (README, *pages) for line in re.findall(r"^cosim [a-z].*$", text, re.MULTILINE)]
    lines = {line.partition(" #")[0].strip() for line in [*found, *re.findall(r"`(cosim [a-z][^`]*)`", README)]}
    return sorted(line for line in lines if not re.search(r"\.\.\. |\[[A-Z]|[A-Z]\.\.\.|--help", line))


def test_commands_of_the_documents_can_be_given() -> None:
    parser = command_line()
    for line in some(_lines_of_commands()):
        _, *given = shlex.split(line)
        if len(given) == 1 or given[0] not in commands():  # the name of a command, or of what another tool calls so
            continue
        try:
            options = parser.parse_args(given)
        except SystemExit:
            pytest.fail(line)
        if given[0] == "sweep" and options.vary:
            points = design(options.design, [parse_factor(text) for text in options.vary], options.points, 0)
            assert len(points) > 1, line


@pytest.mark.parametrize("name", ["Dockerfile", ".github/workflows/wheels.yml"])
def test_what_builds_elsewhere_names_extras_commands_and_files_that_exist(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    extras = set(re.findall(r"\[([a-z]+)\]", text))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert extras
    assert extras <= set(project["optional-dependencies"])
    used = set(re.findall(r"-m cosim ([a-z]+)", text)) | set(re.findall(r'CMD \["([a-z]+)"', text))
    assert used
    assert used <= set(commands())
    assert all((ROOT / script).is_file() for script in re.findall(r"python (\w+\.py)", text))
