"""The public surface: documentation and examples import from the doors only, and each door shows what it says."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import textwrap
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import pytest

import cosim
from tests.support import some
from tests.support.sources import CHECKOUT, PACKAGES, sources

#: Packages that export names; what is not exported is private, as docs/api says.
DOORS = [
    module
    for module, path in sources().items()
    if path.name == "__init__.py" and "\n__all__ = [" in path.read_text(encoding="utf-8")
]

PAGES = [
    *(CHECKOUT / name for name in ("README.md", "CONTRIBUTING.md")),
    *sorted((CHECKOUT / "docs").rglob("*.md")),
    *(path for package in PACKAGES for path in sorted((CHECKOUT / package).glob("*.md"))),
]
EXAMPLES = sorted(path for where in ("*.py", "models/*.py") for path in (CHECKOUT / "examples").glob(where))

#: Names of entry-point groups, which look like modules.
GROUPS = ("cosim.commands", "cosim.pages", "cosim.scenarios")


def code_of(path: Path) -> Iterator[str]:
    """Python code of a page or of an example."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        yield text
        return
    for block in re.findall(r"^ *```python\n(.*?)^ *```$", text, flags=re.DOTALL | re.MULTILINE):
        yield textwrap.dedent(block)


def foreign_imports(code: str) -> Iterator[str]:
    """What a piece of code imports from this project otherwise than from a door."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.partition(".")[0] in PACKAGES and alias.name not in DOORS:
                    yield f"import {alias.name}"
        elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in PACKAGES:
            exported = import_module(node.module).__all__ if node.module in DOORS else []
            for alias in node.names:
                if alias.name not in exported and f"{node.module}.{alias.name}" not in DOORS:
                    yield f"from {node.module} import {alias.name}"


def test_there_is_something_to_check() -> None:
    assert {
        "cosim",
        "cosim.ssp",
        "cosim.sweep",
        "cosim.scenario",
        "cosim.regression",
        "fmu_export",
        "parallel_robot",
    } <= set(DOORS)
    assert sum(len(list(code_of(path))) for path in PAGES if path.is_file()) > 10
    assert len(EXAMPLES) > 5
    code = "import cosim, cosim.errors\nfrom cosim import System, nothing\nfrom fmu_export.trace import trace"
    assert list(foreign_imports(code)) == [
        "import cosim.errors",
        "from cosim import nothing",
        "from fmu_export.trace import trace",
    ]


def test_documentation_and_examples_import_from_the_doors() -> None:
    """But for folders of models, whose pages are about what is in them."""
    wrong = [
        f"{path.relative_to(CHECKOUT)}: {found}"
        for path in [*PAGES, *EXAMPLES]
        if path.is_file()
        for code in code_of(path)
        for found in foreign_imports(code)
    ]
    assert wrong == []


def dotted_names(text: str) -> Iterator[str]:
    """Names of this project in single backticks, as `cosim.sweep.read`."""
    packages = "|".join(PACKAGES)
    yield from re.findall(rf"(?<!`)`((?:{packages})(?:\.\w+)+)(?:\(|`)", text)


def test_names_in_the_text_of_pages_are_public() -> None:
    checked = 0
    for path in some(filter(Path.is_file, PAGES)):
        if path.name in ("CONTRIBUTING.md", "architecture.md", "extending.md", "glossary.md"):  # about what is inside
            continue
        for name in dotted_names(path.read_text(encoding="utf-8")):
            if name in GROUPS or name in DOORS or (CHECKOUT / name.replace("_fmu.", "_fmu/")).exists():
                continue
            door = max((d for d in DOORS if name.startswith(f"{d}.")), key=len)
            first = name.removeprefix(f"{door}.").partition(".")[0]
            assert first in import_module(door).__all__, f"{path.relative_to(CHECKOUT)}: {name}"
            checked += 1
    assert checked > 3


def typed_names(door: str) -> dict[str, str]:
    """Name -> module of what type checkers and editors see behind a door."""
    tree = ast.parse(sources()[door].read_text(encoding="utf-8"))
    blocks = (n for n in tree.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING")
    imports = [n for block in blocks for n in block.body if isinstance(n, ast.ImportFrom)]
    return {alias.name: node.module or "" for node in imports for alias in node.names}


@pytest.mark.parametrize("door", DOORS)
def test_a_door_shows_what_it_says(door: str) -> None:
    module = import_module(door)
    names = module.__all__
    assert len(set(names)) == len(names) > 0
    assert sorted(name for name in names if not name.startswith("__")) == sorted(module._MODULES)
    assert typed_names(door) == {name: module._MODULES[name] for name in names if name != "__version__"}
    for name in names:
        found = getattr(module, name)
        if inspect.isclass(found) or inspect.isfunction(found):
            assert inspect.getdoc(found), f"{door}.{name} has no docstring"
            assert found.__module__.partition(".")[0] == door.partition(".")[0]
    with pytest.raises(AttributeError, match=f"module '{door}' has no attribute 'nothing'"):
        _ = module.nothing


def public_functions(door: str) -> Iterator[tuple[str, inspect.Signature]]:
    """Functions behind a door, and what makes and does the methods of its classes; not those that hand out results."""
    module = import_module(door)
    for name in module.__all__:
        found = getattr(module, name)
        if inspect.isfunction(found):
            yield name, inspect.signature(found)
        elif inspect.isclass(found) and not dataclasses.is_dataclass(found):
            for method, function in vars(found).items():
                function = getattr(function, "__func__", function)
                if inspect.isfunction(function) and (method == "__init__" or not method.startswith("_")):
                    yield f"{name}.{method}", inspect.signature(function)


def test_whoever_has_the_name_of_a_file_as_text_gives_it_as_text() -> None:
    """All functions take paths alike."""
    paths = {
        f"{door}.{name}({parameter.name})": str(parameter.annotation)
        for door in DOORS
        for name, signature in public_functions(door)
        for parameter in signature.parameters.values()
        if re.search(r"\bPath\b|PathLike", str(parameter.annotation)) and "Callable" not in str(parameter.annotation)
    }
    assert len(paths) > 40
    assert {name for name, kind in paths.items() if not re.search(r"\bstr \| (os\.)?PathLike\[str\]", kind)} == set()


def reference() -> str:
    return "\n".join(path.read_text(encoding="utf-8") for path in sorted((CHECKOUT / "docs/api").glob("*.md")))


@pytest.mark.parametrize("door", DOORS)
def test_every_public_name_stands_in_the_reference(door: str) -> None:
    documented = set(re.findall(r"^\.\. (?:auto\w+|py:\w+):: (\S+)$", reference(), flags=re.MULTILINE))
    missing = {f"{door}.{name}" for name in import_module(door).__all__} - documented
    assert missing == set()


def test_the_reference_has_nothing_else() -> None:
    documented = re.findall(r"^\.\. (?:auto\w+|py:\w+):: (\S+)$", reference(), flags=re.MULTILINE)
    assert len(documented) == len(set(documented)) > 50
    known = {f"{door}.{name}" for door in DOORS for name in import_module(door).__all__}
    assert set(documented) - known == set()


def test_the_version_is_that_of_the_distribution() -> None:
    assert cosim.__version__ == version("closed-chain-cosim")
