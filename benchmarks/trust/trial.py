"""One case of the corpus given to one master in a process of its own, and what came of it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.support.corpus import RUNS, STOPS, Case

#: A master that takes longer for a case (s) hangs; none of them needs more than some seconds.
PATIENCE = 30.0

#: A process that was told to end may take so long (s).
_GRACE = 15.0

#: Names of files that archives of the corpus try to write elsewhere.
_ESCAPED = "escaped*"


@dataclass(frozen=True)
class Trial:
    """What came of a case.

    Attributes
    ----------
    case : str
    outcome : str
        refused, ran, stopped (with the results so far), accepted (though it is broken), lost (its results), silent (a
        success without results), hung, crashed (with the process of the master), or outside (files in other folders).
    in_one_line : bool
        Whether a case that was refused or stopped was so in one line.
    line : str
        The last line that was said.
    """

    case: str
    outcome: str
    in_one_line: bool
    line: str


@dataclass(frozen=True)
class Master:
    """A master, and how it is given a case.

    Attributes
    ----------
    name : str
    kinds : tuple of str
        Of cases that it can be given.
    command : callable
        Case, its path, and the file or folder of results -> command.
    results : str
        Pattern of the files of results in that folder.
    """

    name: str
    kinds: tuple[str, ...]
    command: Callable[[Case, Path, Path], Sequence[str]]
    results: str = "results.csv"


def trial(master: Master, case: Case, path: Path, folder: Path, patience: float = PATIENCE) -> Trial:
    """Give a master a case.

    Parameters
    ----------
    master : Master
    case : Case
    path : Path
        What `case.make` has written.
    folder : Path
        An empty folder to work in.
    patience : float
        How long (s) it may take.
    """
    out, temporary = folder / "out", folder / "tmp"
    temporary.mkdir()
    before = _elsewhere(folder)
    process = subprocess.Popen(
        master.command(case, path, out),
        cwd=folder,
        env=os.environ | {"TMPDIR": str(temporary), "PYTHONPATH": str(Path.cwd())},
        stdin=subprocess.DEVNULL,
        stdout=(stdout := (folder / "stdout").open("wb")),
        stderr=(stderr := (folder / "stderr").open("wb")),
        start_new_session=True,
    )
    with stdout, stderr:
        hung = _hangs(process, patience)
    said = (folder / "stderr").read_text(encoding="utf-8", errors="replace")
    lines = [line for line in said.splitlines() if line.strip()] or _last_lines(folder / "stdout")
    results = any(_has_rows(file) for file in out.rglob(master.results)) if out.is_dir() else _has_rows(out)
    outcome = _outcome(case, process.returncode, results=results)
    if hung:
        outcome = "hung"
    if _elsewhere(folder) - before:
        outcome = "outside"
    in_one_line = len(lines) == 1 and "Traceback" not in said
    return Trial(case.name, outcome, in_one_line, lines[-1][:200] if lines else "")


def _outcome(case: Case, code: int, *, results: bool) -> str:
    if code < 0:
        return "crashed"
    if code == 0:
        if not results and case.kind != "reference":
            return "silent"
        return "ran" if case.expected == RUNS else "accepted"
    if case.expected == STOPS or (case.expected == RUNS and case.is_hostile):
        return "stopped" if results else "lost"
    return "refused"


def _hangs(process: subprocess.Popen[bytes], patience: float) -> bool:
    """Wait for a process, and end it if it takes too long; it has a session of its own."""
    try:
        process.wait(patience)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGTERM)
        end = time.monotonic() + _GRACE
        while process.poll() is None and time.monotonic() < end:
            time.sleep(0.05)
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        return True
    return False


def _has_rows(file: Path) -> bool:
    """Whether a table has a row below its header."""
    if not file.is_file():
        return False
    text = file.read_text(encoding="utf-8", errors="replace")
    return len(re.findall(r"\n[-\d\"]", text)) > 0


def _last_lines(file: Path) -> list[str]:
    lines = [line for line in file.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    return lines[-1:]


def _elsewhere(folder: Path) -> set[Path]:
    """Files of the names that archives try to write, in all folders above, and where temporary files are."""
    places = {*folder.parents, folder, Path("/tmp")}
    return {file for place in places for file in place.glob(_ESCAPED)}


def python(*arguments: object) -> list[str]:
    """A command of this interpreter."""
    return [sys.executable, *map(str, arguments)]
