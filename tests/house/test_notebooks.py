"""The notebooks among the examples: kept without outputs, in step with the packages, and run as they stand."""

from __future__ import annotations

import ast
import json
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from tests.support import CHECKOUT, some
from tests.support.html import Elements
from tests.support.native_fmus import DEFAULT_FLAVOUR
from tests.support.patience import PATIENCE

NOTEBOOKS = sorted((CHECKOUT / "examples").glob("*.ipynb"))

#: Notebook -> what it prints, and how many frames with pages it shows.
EXPECTED = {
    "follow_a_path": (["position error: at most", "alpha = 4: at most", "mass change (kg): 0.0 0.0 -0.25 -0.25"], 2),
    "model_of_your_own": (["the level is off by at most"], 2),
}


def read(path: Path) -> dict[str, Any]:
    text = path.read_text(encoding="utf-8")
    notebook = json.loads(text)
    assert text == json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"  # as editors write it
    return notebook


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_they_are_clean_and_what_they_import_is_there(path: Path) -> None:
    cells = read(path)["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in some(code))
    assert all(cell["metadata"] == {} for cell in cells)
    trees = [ast.parse("".join(cell["source"])) for cell in code]
    names = [
        (node.module, a.name)
        for t in trees
        for node in ast.walk(t)
        if isinstance(node, ast.ImportFrom)
        for a in node.names
    ]
    for module, name in some(names):
        assert hasattr(import_module(module), name), f"{module}.{name}"


def test_each_has_what_it_should_say() -> None:
    assert [path.stem for path in NOTEBOOKS] == list(EXPECTED)


@pytest.mark.slow
@pytest.mark.skipif(DEFAULT_FLAVOUR != "fmi2", reason="the notebooks take compiled FMUs; no C compiler here")
@pytest.mark.parametrize("name", EXPECTED)
def test_they_run(name: str, robot_fmus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbformat = pytest.importorskip("nbformat", reason="notebooks are not executed: pip install nbclient ipykernel")
    nbclient = pytest.importorskip("nbclient", reason="notebooks are not executed: pip install nbclient ipykernel")
    pytest.importorskip("ipykernel", reason="notebooks are not executed: pip install nbclient ipykernel")
    (tmp_path / "fmus").mkdir()
    (tmp_path / "fmus/fmi2").symlink_to(robot_fmus / DEFAULT_FLAVOUR, target_is_directory=True)
    (tmp_path / "examples").mkdir()
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))  # not the user's
    monkeypatch.delenv("MPLBACKEND", raising=False)
    notebook = nbformat.read(CHECKOUT / f"examples/{name}.ipynb", 4)
    where = {"metadata": {"path": str(tmp_path / "examples")}}
    nbclient.NotebookClient(notebook, timeout=PATIENCE, kernel_name="python3", resources=where).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    said = "".join(output.get("text", "") for output in outputs)
    texts, n_frames = EXPECTED[name]
    assert [text for text in texts if text not in said] == []
    frames = [output.data["text/html"] for output in outputs if "text/html" in output.get("data", {})]
    assert [Elements(frame).all[0][0] for frame in frames] == ["iframe"] * n_frames
    assert max(len(frame) for frame in frames) < 1_000_000
    if name == "model_of_your_own":
        assert float(said.partition("off by at most ")[2].split()[0]) < 1e-12
    else:
        errors = [float(line.split()[5]) for line in said.splitlines() if line.startswith("alpha")]
        assert errors == sorted(errors, reverse=True)
        assert len(set(errors)) == 3
