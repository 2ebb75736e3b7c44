"""The errors: each has its place below one of two roots, and the page shows the tree."""

from __future__ import annotations

import ast
import runpy
from importlib import import_module

import pytest

import cosim.errors
import fmu_export.errors
from cosim.errors import CosimError
from fmu_export.errors import ModelError
from tests.support import some
from tests.support.sources import CHECKOUT, PACKAGES, sources

#: Errors that are no `CosimError` for a reason: a Ctrl-C; the code inside an FMU has the standard library only.
APART = {
    "cosim.master.failures.SimulationInterrupted",
    "cosim.master.failures.InterruptedInCall",
    "fmu_export.pythonfmu.slave.SlaveError",
    "fmu_export.pythonfmu.script_slave.ScriptError",
    "fmu_export.modelling.internal_steps.NoRates",
    "fmu_export.modelling.internal_steps.TooManySteps",
}

#: Built-in errors that are Python's own answer to wrong code or to Ctrl-C, not to wrong input.
PYTHONS = {
    "AttributeError",
    "AssertionError",
    "IndexError",
    "KeyError",
    "KeyboardInterrupt",
    "StopIteration",
    "SystemExit",
    "TypeError",
}


def error_classes() -> dict[str, type[BaseException]]:
    """All exceptions that the packages define."""
    found = {}
    for name in sources():
        module = import_module(name)
        for value in vars(module).values():
            if isinstance(value, type) and issubclass(value, BaseException) and value.__module__ == name:
                found[f"{name}.{value.__name__}"] = value
    return found


def test_every_error_has_a_root() -> None:
    classes = error_classes()
    assert len(classes) > 25
    assert set(classes) >= APART
    for name, kind in classes.items():
        if name in APART:
            assert not issubclass(kind, CosimError | ModelError)
        else:
            root = ModelError if name.startswith(("fmu_export", "controller_fmu")) else CosimError
            assert issubclass(kind, root), name
        assert kind.__doc__ is not None, name
    names = [kind.__name__ for kind in classes.values()]
    twice = {name for name in names if names.count(name) > 1}
    assert twice == {"ArgumentError", "MissingExtra"}  # one for each root


def test_a_missing_extra_is_told_alike_by_both_roots() -> None:
    told = []
    for errors in (cosim.errors, fmu_export.errors):
        with pytest.raises(errors.MissingExtra) as caught, errors.needs("plot"):
            import_module("no_such_package.of_this_name")
        told.append((str(caught.value), caught.value.extra, caught.value.name))
    assert told[0] == told[1]


def raised(source: str) -> list[str]:
    """Names of what a source raises, apart from raising again."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Raise) and node.exc is not None:
            called = node.exc.func if isinstance(node.exc, ast.Call) else node.exc
            found.append(ast.unparse(called))
    return found


def test_what_is_raised_on_purpose_is_no_bare_built_in_error() -> None:
    import builtins

    assert raised("raise ValueError('x')\nraise\nraise a.B from c") == ["ValueError", "a.B"]
    wrong = {
        f"{module} raises {name}"
        for module, path in sources().items()
        for name in raised(path.read_text(encoding="utf-8"))
        if name not in PYTHONS and isinstance(getattr(builtins, name, None), type)
    }
    assert wrong == set()


def tree() -> str:
    return str(runpy.run_path(str(CHECKOUT / "docs/conf.py"))["myst_substitutions"]["errors"])


def test_the_page_shows_all_errors() -> None:
    assert "{{ errors }}" in (CHECKOUT / "docs/errors.md").read_text(encoding="utf-8")
    shown = tree()
    for name, kind in some(error_classes().items()):
        if name not in APART:
            line = next(line for line in shown.splitlines() if f"`{kind.__name__}`" in line)
            assert (kind.__doc__ or "").splitlines()[0].partition(". ")[0].rstrip(".") in line
    indented = {line.split("`")[1]: len(line) - len(line.lstrip()) for line in shown.splitlines()}
    assert indented["CosimError"] == indented["ModelError"] == 0
    assert indented["SetupError"] > indented["CosimError"]


@pytest.mark.parametrize("root", [CosimError, ModelError])
def test_the_roots_are_exported_and_plain(root: type[Exception]) -> None:
    assert root.__bases__ == (Exception,)
    assert getattr(import_module(root.__module__.partition(".")[0]), root.__name__) is root
    assert root.__module__.partition(".")[0] in PACKAGES
