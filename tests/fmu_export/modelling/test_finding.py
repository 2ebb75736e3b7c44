"""Models by the names of command lines: files, modules, and what is said where there is none or more than one."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from fmu_export.errors import ArgumentError
from fmu_export.modelling.finding import find_model
from fmu_export.modelling.model import Model
from fmu_export.modelling.model_class import ModelClass

OWN = """
from fmu_export import ModelClass, state

class {name}(ModelClass):
    x = state(1.0)

    def derivatives(m):
        return dict(x=-m.x)
"""


@pytest.fixture(autouse=True)
def _forget(monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules of files stay known; here they don't."""
    monkeypatch.setattr(sys, "modules", dict(sys.modules))


def written(folder: Path, name: str, text: str) -> str:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return str(path)


def said_of(text: str) -> str:
    with pytest.raises(ArgumentError) as caught:
        find_model(text)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_model_is_a_class_its_instance_or_a_model_object(tmp_path: Path) -> None:
    path = written(tmp_path, "kinds_of_model.py", OWN.format(name="Tank") + "TANK = Tank()\nMODEL = TANK.model()\n")
    found = find_model(f"{path}:Tank")
    assert isinstance(found, type)
    assert issubclass(found, ModelClass)
    assert isinstance(find_model(f"{path}:TANK"), ModelClass)
    assert isinstance(find_model(f"{path}:MODEL"), Model)
    for name in ("state", "Other", "ModelClass"):
        assert said_of(f"{path}:{name}") == f"{path} has no model '{name}'; its models are Tank, TANK, MODEL"
    assert said_of(path) == f"{path}: name the model, as {path}:Tank; its models are Tank, TANK, MODEL"


def test_without_a_name_a_file_has_one_model_of_its_own(tmp_path: Path) -> None:
    base = written(tmp_path, "base_of_models.py", OWN.format(name="Base"))
    path = written(tmp_path, "user_of_base.py", "from base_of_models import Base\n\nclass Own(Base):\n    pass\n")
    assert find_model(base).__name__ == "Base"  # type: ignore[union-attr]
    assert find_model(path).__name__ == "Own"  # type: ignore[union-attr]
    assert find_model(f"{path}:Base").__name__ == "Base"  # type: ignore[union-attr]
    only = written(tmp_path, "imports_only.py", "from base_of_models import Base\n")
    assert said_of(only) == f"{only}: name the model, as {only}:NAME; its models are Base"
    assert str(tmp_path) not in sys.path


def test_a_file_takes_no_other_modules_place(tmp_path: Path) -> None:
    import json

    path = written(tmp_path, "json.py", OWN.format(name="Json"))
    assert find_model(path).__name__ == "Json"  # type: ignore[union-attr]
    assert sys.modules["json"] is json


def test_a_module_has_its_models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    written(tmp_path, "module_of_models.py", OWN.format(name="Own"))
    assert find_model("module_of_models").__name__ == "Own"  # type: ignore[union-attr]
    assert find_model("module_of_models:Own") is find_model("module_of_models")
    assert said_of("tests.support").startswith("tests.support has no Model and no ModelClass; name a file with one")
    assert said_of("no_such_module_here") == (
        "no_such_module_here: there is no module 'no_such_module_here'; give a file, as my_controller.py, or a module "
        "with a name"
    )


def test_what_is_no_file_with_a_model_is_said(tmp_path: Path) -> None:
    assert said_of(f"{tmp_path}/none.py") == (
        f"there is no file {tmp_path}/none.py; check the path, or write one: cosim new model NAME"
    )
    text = written(tmp_path, "model.txt", "")
    assert said_of(text) == f"{text} is not a Python file; give the one of the model, as my_controller.py"
    raises = written(tmp_path, "raises_at_line_2.py", "\nvalue = 1 / 0\n")
    assert said_of(raises) == (
        f"{raises} can't be run: ZeroDivisionError: division by zero (raises_at_line_2.py, line 2)"
    )
    leaves = written(tmp_path, "leaves.py", "raise SystemExit(3)\n")
    assert said_of(leaves) == f"{leaves} can't be run: SystemExit: 3 (leaves.py, line 1)"
    lacks = written(tmp_path, "lacks.py", "import no_such_package_here\n")
    assert said_of(lacks).startswith(f"{lacks}: there is no module 'no_such_package_here'")
    assert str(tmp_path) not in sys.path
