"""The tests themselves: where they stand, who imports whom, and that their loops loop."""

import ast
import re
from pathlib import Path

from tests.support import CHECKOUT, SUPPORT
from tests.support.sources import PACKAGES

TESTS = CHECKOUT / "tests"
MODULES = sorted(TESTS.rglob("*.py"))

#: Rooms whose tests stand in folders of other names.
ELSEWHERE = {"plant_fmu": "models", "controller_fmu": "models", "trajectory_fmu": "models"}

#: Folders of tests that belong to no package: what concerns all of them, and the other tools.
OTHERS = {"house", "interop", "models", "support"}


def text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def test_no_test_module_imports_another():
    """Also in scripts that tests write, and no conftest either: what several need is in tests/support."""
    assert len(MODULES) > 100
    named = re.compile(r"\btests(?:\.\w+)*(?:\.| import )(?:test_\w+|conftest\b)")
    assert {str(p.relative_to(CHECKOUT)): found for p in MODULES if (found := named.findall(text(p)))} == {}


def test_helpers_are_in_support_and_support_has_no_tests():
    helpers = [p for p in MODULES if not p.name.startswith("test_") and SUPPORT not in p.parents]
    assert {p.name for p in helpers} == {"__init__.py", "__main__.py", "conftest.py"}
    support = sorted(SUPPORT.rglob("*.py"))
    assert support
    assert [p.name for p in support if re.search(r"^\s*def test_", text(p), re.MULTILINE)] == []
    assert {p.suffix for p in SUPPORT.rglob("*") if p.is_file() and "__pycache__" not in p.parts} == {".py", ".c", ".h"}


def test_every_folder_of_tests_is_a_room():
    """<package>/<room>, or <room> alone for those of `cosim`."""
    folders = {p.parent.relative_to(TESTS).as_posix() for p in MODULES if p.name.startswith("test_")}
    assert {"master", "fmu_export/trace", "parallel_robot"} <= folders
    rooms = {ELSEWHERE.get(p, p) for p in PACKAGES}
    for package in PACKAGES:
        inner = [p.parent.relative_to(CHECKOUT / package).as_posix() for p in (CHECKOUT / package).rglob("__init__.py")]
        rooms |= {room if package == "cosim" else f"{package}/{room}" for room in inner}
    assert folders - rooms - OTHERS == set()


#: What searches, and may find nothing.
SEARCHES = {"glob", "rglob", "iterdir", "findall", "finditer", "iter", "iterfind"}


def searching_loops(tree: ast.AST) -> list[int]:
    """Lines of loops over a search that hold assertions."""
    return [
        loop.lineno
        for loop in ast.walk(tree)
        if isinstance(loop, ast.For)
        and isinstance(loop.iter, ast.Call)
        and isinstance(loop.iter.func, ast.Attribute)
        and loop.iter.func.attr in SEARCHES
        and any(isinstance(node, ast.Assert) for node in ast.walk(loop))
    ]


def test_a_loop_over_a_search_asserts_that_something_was_found():
    """By `some` of tests/support, or by a list whose length is asserted."""
    assert {
        str(path.relative_to(CHECKOUT)): lines for path in MODULES if (lines := searching_loops(ast.parse(text(path))))
    } == {}
    assert searching_loops(ast.parse("for x in p.glob('*'):\n    assert x")) == [1]
    assert searching_loops(ast.parse("for x in some(p.glob('*')):\n    assert x")) == []
