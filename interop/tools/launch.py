"""Run a tool in a process of its own, since it may crash or leave threads behind."""

from __future__ import annotations

import importlib
import subprocess
import sys
import tempfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType

from interop.tools.case import Case, ToolRun


class ToolFailed(Exception):
    """A tool did not finish; one line says why."""


def tool(name: str) -> ModuleType:
    """The module of a tool."""
    return importlib.import_module(f"interop.tools.{name}")


def run_tool(name: str, case: Case, timeout: float = 1800.0) -> ToolRun:
    """One run of a case by a tool.

    Raises
    ------
    ToolFailed
        It fails, crashes, or takes longer than `timeout` (s).
    """
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        case_file, out = Path(folder) / "case.json", Path(folder) / "out.npz"
        case.to_json(case_file)
        command = [sys.executable, "-m", "interop.tools", name, str(case_file), str(out)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout)
        except subprocess.TimeoutExpired:
            raise ToolFailed(f"not done after {timeout:g} s") from None
        if not out.is_file():
            last = (done.stderr.strip().splitlines() or [""])[-1]
            raise ToolFailed(f"ended by signal {-done.returncode}; {last}" if done.returncode < 0 else last)
        return ToolRun.from_npz(out)


def package_version(name: str) -> str:
    """Package and version of a tool; Maven packages, Rust crates and programs of ours have theirs in their name."""
    package: str = tool(name).PACKAGE
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return package
