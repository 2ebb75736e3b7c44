"""Models by the names that command lines give: a Python file, or a module, and what in it."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

from fmu_export.errors import ArgumentError
from fmu_export.modelling.model import Model
from fmu_export.modelling.model_class import AnyModel, ModelClass


def find_model(text: str) -> AnyModel:
    """The model that a text names.

    Parameters
    ----------
    text : str
        A Python file or a module, and behind a colon the name of the class, its instance or the `Model` in it:
        ``my_controller.py``, ``models.py:Tank``, ``package.module:MODEL``. Without a name there must be only one.

    Raises
    ------
    ArgumentError
        There is no such file or module, it can't be run, or it has no such model, or several.
    """
    place, colon, name = text.rpartition(":")
    if not colon or not name.isidentifier():
        place, name = text, ""
    if place.endswith(".py") or Path(place).is_file():
        module, own = _file(Path(place)), Path(place).stem
    else:
        module = _run(lambda: importlib.import_module(place), place)
        own = module.__name__
    found: dict[str, AnyModel] = {n: v for n, v in vars(module).items() if _is_model(v)}
    if name:
        if name not in found:
            raise ArgumentError(f"{place} has no model '{name}'; {_those(found)}")
        return found[name]
    here = {n: v for n, v in found.items() if not inspect.isclass(v) or v.__module__ == own}
    if not found:
        raise ArgumentError(f"{place} has no Model and no ModelClass; name a file with one, as `cosim new` writes it")
    if len(here) != 1:
        raise ArgumentError(f"{place}: name the model, as {place}:{next(iter(here), 'NAME')}; {_those(found)}")
    return next(iter(here.values()))


def _is_model(value: Any) -> bool:
    is_class = inspect.isclass(value) and issubclass(value, ModelClass) and value is not ModelClass
    return is_class or isinstance(value, Model | ModelClass)


def _those(found: Iterable[str]) -> str:
    return f"its models are {', '.join(found) or 'none'}"


def _file(path: Path) -> ModuleType:
    """A file as a module; it finds the modules beside it, as it does when Python runs it."""
    if path.suffix != ".py":
        raise ArgumentError(f"{path} is not a Python file; give the one of the model, as my_controller.py")
    if not path.is_file():
        raise ArgumentError(f"there is no file {path}; check the path, or write one: cosim new model NAME")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    before, folder = sys.modules.get(path.stem), str(path.resolve().parent)
    sys.modules[path.stem] = module  # where dataclasses look for it
    sys.path.insert(0, folder)
    try:
        _run(lambda: spec.loader.exec_module(module), str(path))  # type: ignore[union-attr]
    finally:
        sys.path.remove(folder)
        if before is not None:
            sys.modules[path.stem] = before
    return module


def _run(load: Callable[[], Any], place: str) -> Any:
    try:
        return load()
    except ModuleNotFoundError as error:
        what = f"there is no module '{error.name}'"
        raise ArgumentError(f"{place}: {what}; give a file, as my_controller.py, or a module with a name") from error
    except (Exception, SystemExit) as error:
        line = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(line.filename).name}, line {line.lineno}"
        raise ArgumentError(f"{place} can't be run: {type(error).__name__}: {error} ({where})") from error
