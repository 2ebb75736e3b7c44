"""The trees of errors in docs/errors.md, from the classes."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib import import_module
from pkgutil import walk_packages

from cosim.errors import CosimError
from fmu_export.errors import ModelError

_PACKAGES = ("cosim", "parallel_robot", "fmu_export", "controller_fmu")


def errors_tree() -> str:
    """Both roots and all that derive from them, as nested lists in Markdown."""
    for package in map(import_module, _PACKAGES):
        for found in walk_packages(package.__path__, f"{package.__name__}."):
            if not found.name.rpartition(".")[2].startswith("_"):  # the compiled loop and the program are no modules
                import_module(found.name)
    return "\n".join(line for root in (CosimError, ModelError) for line in _lines(root, 0))


def _lines(kind: type[Exception], depth: int) -> Iterator[str]:
    summary = " ".join((kind.__doc__ or "").partition("\n\n")[0].split())
    door = _door(kind)
    where = f" (`from {door} import {kind.__name__}`)" if door else ""
    yield f"{'  ' * depth}- `{kind.__name__}`{where}: {summary}"
    for below in sorted(kind.__subclasses__(), key=lambda k: k.__name__):
        yield from _lines(below, depth + 1)


def _door(kind: type[Exception]) -> str:
    """The package that exports an error; empty where it is caught by its base only."""
    packages = kind.__module__.split(".")
    names = [".".join(packages[:n]) for n in range(1, len(packages))]
    return next((n for n in names if kind.__name__ in getattr(sys.modules[n], "__all__", ())), "")
