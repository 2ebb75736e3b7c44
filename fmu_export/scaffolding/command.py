"""`cosim new`: writes the first version of a model, a plant or a controller, with a test that passes."""

from __future__ import annotations

import argparse
import keyword
import re
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from string import Template
from typing import Any

import fmu_export
from fmu_export.errors import ArgumentError
from fmu_export.modelling.names import check_identifier

KINDS = ("model", "plant", "controller")

_EXAMPLES = """\
examples:
  cosim new controller my_controller
  cosim new plant pump --folder models
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim new`."""
    parser = subparsers.add_parser(
        "new",
        help="write the first version of a model, a plant or a controller, with a test",
        epilog=_EXAMPLES,
        description="Write a Python file with a model as a class, which builds its FMU, and a test of that FMU. "
        "Existing files are not overwritten.",
    )
    parser.add_argument("kind", choices=KINDS, help="what to begin with: a lag, a mass on a spring, a sampled PI law")
    parser.add_argument("name", metavar="NAME", help="name of the file, as my_controller; its class is MyController")
    parser.add_argument("--folder", type=Path, default=Path(), help="where to write it (default: here)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `cosim new`; returns the exit code."""
    model, test = write(args.kind, args.name, args.folder)
    fmu = f"{class_name(args.name)}.fmu"
    print(f"wrote {model} and {test}")
    print(f"  python {model}    builds {fmu}")
    print(f"  pytest {test}    tests it")
    print(f"  cosim run {fmu}    runs it")
    return 0


def write(kind: str, name: str, folder: Path) -> tuple[Path, Path]:
    """Write `<name>.py` and `test_<name>.py` into a folder, which is made if there is none.

    Parameters
    ----------
    kind : {"model", "plant", "controller"}
    name : str
        Name of the module, as ``my_controller``, or of the class, as ``MyController``.
    folder : Path

    Returns
    -------
    (Path, Path)
        The file of the model, and that of the test.

    Raises
    ------
    ArgumentError
        The name can't be that of a module and a class, or a file of it exists.
    OSError
        A file can't be written.
    """
    module, title = module_name(name), class_name(name)
    paths = folder / f"{module}.py", folder / f"test_{module}.py"
    for path in paths:
        if path.exists():
            raise ArgumentError(f"{path} exists and is not overwritten; take another name or --folder")
    _check_not_taken(module, title)
    words = {"module": module, "name": title, "title": f"{module.replace('_', ' ').capitalize()}"}
    folder.mkdir(parents=True, exist_ok=True)
    for path, template in zip(paths, (f"{kind}.py.in", f"test_{kind}.py.in"), strict=True):
        text = (files("fmu_export.scaffolding") / template).read_text(encoding="utf-8")
        with path.open("x", encoding="utf-8") as file:
            file.write(Template(text).substitute(words))
    return paths


def module_name(name: str) -> str:
    """Name of the module, in lower case with underscores.

    Raises
    ------
    ArgumentError
        It can't be a name in Python.
    """
    module = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
    if not (name.isascii() and name.isidentifier()) or name.startswith("_") or keyword.iskeyword(module):
        raise ArgumentError(
            f"{name!r} can't be the name of a Python file and a class; take letters, digits and underscores, as "
            "my_controller"
        )
    return module


def class_name(name: str) -> str:
    """Name of the class and of the FMU."""
    return "".join(word[:1].upper() + word[1:] for word in module_name(name).split("_"))


def _check_not_taken(module: str, title: str) -> None:
    check_identifier("model", title)
    if title in fmu_export.__all__:
        raise ArgumentError(f"fmu_export has a class '{title}' already; take another name")
    if find_spec(module) is not None:
        raise ArgumentError(
            f"Python has a module '{module}' already, which a file of that name would hide; take another"
        )
