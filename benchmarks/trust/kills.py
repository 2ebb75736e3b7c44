"""Kills at random moments, and full disks: what commands leave behind, and whether the next start makes it good.

Before each try the folder has the results of an earlier run. After it they, or those of the new one, must be there and
whole, or be on their way to their places; what the killed one had recorded can be read; the same command, once more,
leaves what it leaves when nothing has happened, and no temporary folder.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil
from tqdm import tqdm

from cosim import CosimError, Results
from cosim.files.whole import write_whole
from cosim.results.unfinished import whole_lines
from cosim.sweep import read as read_sweep
from fmu_export import ModelClass, build_native, parameter, state

#: Longest time (s) for a command to end, be it by a signal.
_PATIENCE = 600.0

PAGE = Path("docs/trust.md")
_BEGIN, _END = "<!-- table: python -m benchmarks.trust.kills --write -->", "<!-- end of the table of kills -->"

#: Signals that a program can take, which end the run with what was recorded.
_TAKEN = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Oscillator(ModelClass, step_size=1e-3, stop_time=2.0):
    """Van der Pol's oscillator."""

    mu = parameter(1.0, "1", "Damping")
    x = state(2.0, "1", "Position")
    v = state(0.0, "s-1", "Speed")

    def derivatives(m):  # noqa: D102, N805 : methods of models take m
        return dict(x=m.v, v=m.mu * (1.0 - m.x**2) * m.v - m.x)


@dataclass
class Tried:
    """What came of the tries of one kind.

    Attributes
    ----------
    kind : str
    tried : int
    found : Counter
        What was there afterwards -> how often: old results, new ones, new ones on their way.
    wrong : list of str
        What must not be: a line each.
    """

    kind: str
    tried: int = 0
    found: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Kind:
    """A command, and what it leaves.

    Attributes
    ----------
    name : str
    command : sequence of str
        After `cosim`.
    check : callable
        `check(folder, kind, tried)` looks at what is there after a kill.
    content : callable
        What a folder has to have after a whole command, to be compared.
    prepare : sequence of str, optional
        The command that made the earlier results.
    endings : sequence
        Ways to end it: signals, or "full disk".
    """

    name: str
    command: Sequence[str]
    check: Callable[[Path, Reference, Tried], None]
    content: Callable[[Path], object]
    prepare: Sequence[str] = ()
    endings: Sequence[signal.Signals | str] = (signal.SIGKILL,)


@dataclass(frozen=True)
class Reference:
    """What a command leaves when nothing happens, before and after; and how long (s) it takes."""

    old: object
    new: object
    whole: Path
    seconds: float


# What is there after a kill


def _of_run(folder: Path) -> object:
    """Names and hashes of the results; the summary has times in it."""
    return {p.name: _sha(p) for p in sorted(folder.iterdir()) if p.name.startswith("results.") and p.suffix != ".part"}


def _check_run(folder: Path, reference: Reference, tried: Tried) -> None:
    summary = folder / "summary.json"
    if summary.is_file():
        for name, sha in _listed(folder).items():
            if not (folder / name).is_file() or _sha(folder / name) != sha:
                tried.wrong.append(f"{name} is not what the summary lists")
        here = _of_run(folder)
        if here not in (reference.old, reference.new):
            tried.wrong.append(f"results are neither the old nor the new ones: {here}")
        tried.found["old results" if here == reference.old else "new results"] += 1
    elif (folder / ".unfinished" / "whole").is_dir():
        tried.found["on their way"] += 1
    else:
        tried.wrong.append("the old results are gone, and no new ones are there")
    for part in folder.glob("results.*.part"):
        if part.suffixes[-2] == ".csv":  # long ones take long to be read as numbers
            lines = whole_lines(part.read_bytes())
            tried.found["rows kept"] += lines.count(b"\n") > 1
            if not (reference.whole / part.stem).read_bytes().startswith(lines):
                tried.wrong.append(f"{part.name} has other rows than the whole run")
            continue
        try:
            found = Results.read(part)
        except CosimError:  # nothing in it is whole
            continue
        tried.found["rows kept"] += 1
        whole = Results.read(reference.whole / part.stem)
        rows = len(found.time)
        if not (np.array_equal(found.time, whole.time[:rows]) and np.array_equal(found.values, whole.values[:rows])):
            tried.wrong.append(f"{part.name} has other rows than the whole run")


def _of_sweep(folder: Path) -> object:
    table = read_sweep(folder).sort_by("index")
    return table.select([name for name in table.column_names if name != "loop_time_s"]).to_pydict()


def _check_sweep(folder: Path, reference: Reference, tried: Tried) -> None:
    if not (folder / "sweep.json").is_file():
        tried.found["nothing yet"] += 1
        return
    rows = _of_sweep(folder)
    assert isinstance(rows, dict)
    assert isinstance(reference.new, dict)
    indices = rows["index"]
    if len(set(indices)) < len(indices):
        tried.wrong.append("a point was run twice")
    if any(rows["x"][k] != reference.new["x"][i] for k, i in enumerate(indices)):
        tried.wrong.append("rows differ from those of a whole sweep")
    tried.found["all rows" if len(indices) == len(reference.new["index"]) else "some rows"] += 1


def _of_fmu(folder: Path) -> object:
    with zipfile.ZipFile(folder / "controller.fmu") as archive:
        assert archive.testzip() is None
        return {name: archive.read(name) for name in archive.namelist()}


def _check_fmu(folder: Path, reference: Reference, tried: Tried) -> None:
    here = _of_fmu(folder)
    if here not in (reference.old, reference.new):
        tried.wrong.append("the FMU is neither the old nor the new one")
    tried.found["old results" if here == reference.old else "new results"] += 1


def _of_page(folder: Path) -> object:
    page = folder / "page.html"
    return page.read_text(encoding="utf-8").rstrip().endswith("</html>") if page.is_file() else None


def _check_page(folder: Path, reference: Reference, tried: Tried) -> None:  # noqa: ARG001
    if _of_page(folder) is False:
        tried.wrong.append("the page ends early")
    tried.found["new results" if _of_page(folder) else "nothing yet"] += 1


def _of_study(folder: Path) -> object:
    """Files of a reproduction, but those that say when it was made."""
    return {name: sha for name, sha in _listed(folder).items() if name.startswith("figures/")}


def _check_study(folder: Path, reference: Reference, tried: Tried) -> None:
    if not (folder / "summary.json").is_file():  # the next run places what is whole
        tried.found["on their way" if (folder / ".unfinished" / "whole").is_dir() else "nothing yet"] += 1
        return
    tried.wrong += [
        f"{name} is not what the summary lists"
        for name, sha in _listed(folder).items()
        if not (folder / name).is_file() or _sha(folder / name) != sha
    ]
    if _of_study(folder) != reference.new:
        tried.wrong.append("figures differ from those of a whole reproduction")
    tried.found["new results"] += 1


def _listed(folder: Path) -> dict[str, str]:
    """Files that a summary lists, and their hashes."""
    listed: dict[str, str] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))["files"]
    return listed


def _sha(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


# The commands


def kinds(fmus: Path) -> list[Kind]:
    """All commands that leave something; `{to}` is the folder where, `{work}` has the FMU and a scenario of it."""
    run = ["run", "{work}/Oscillator.fmu", "--out", "{to}"]
    short = [*run, "--stop", "20", "--set", "mu=2"]
    long = [*run, "--stop", "450", "--step", "1e-4", "--set", "mu=2"]
    sweep = ["sweep", "{work}/oscillator.toml", "--vary", "f.mu=0.5:2:200", "--workers", "2", "--out", "{to}"]
    page = ["{work}/Oscillator.fmu", "--fmu-report", "{to}/page.html", "-q", "-p", "no:cacheprovider"]
    return [
        *(
            Kind(f"run, {name}", [*short, "--format", name], _check_run, _of_run, [*run, "--format", name])
            for name in ("csv", "parquet", "npz", "mat", "json")
        ),
        Kind("run, signals", [*short, "--realtime", "20"], _check_run, _of_run, run, (*_TAKEN, signal.SIGKILL)),
        Kind("run, full disk", short, _check_run, _of_run, run, ("full disk",)),
        Kind("long run, csv and parquet", long, _check_run, _of_run, [*run, "--format", "parquet", "--format", "csv"]),
        Kind("long run, full disk", long, _check_run, _of_run, [*run, "--format", "parquet"], ("full disk",)),
        Kind("sweep", sweep, _check_sweep, _of_sweep),
        Kind(
            "tune",
            ["tune", "--mu", "2", "--nu", "1", "--write", "{to}/controller.fmu"],
            _check_fmu,
            _of_fmu,
            ["copy", str(fmus / "fmi2/RobotController.fmu"), "{to}/controller.fmu"],
        ),
        Kind("regression", ["pytest", "--fmu", *page], _check_page, _of_page),
        Kind("reproduce", ["reproduce", "--fmus", str(fmus), "--out", "{to}"], _check_study, _of_study),
    ]


_SCENARIO = """
title = "an oscillator"
[components.f]
fmu = "Oscillator.fmu"
[run]
stop_time = 20.0
step_size = 1e-3
[metrics]
x = {measure = "final", of = "f.x"}
"""


class Tries:
    """Tries of commands, each in a folder of its own.

    Parameters
    ----------
    folder : Path
        Empty; for everything.
    seed : int
        Of the moments.
    """

    def __init__(self, folder: Path, seed: int = 0) -> None:
        self._folder, self._random = folder, random.Random(seed)
        self._temporary = folder / "temporary"
        self._temporary.mkdir()
        self._work = folder / "work"
        build_native(Oscillator, self._work, "fmi2")
        (self._work / "oscillator.toml").write_text(_SCENARIO, encoding="utf-8")

    def of(self, kind: Kind, number: int) -> Tried:
        """Try a command so many times."""
        tried, reference = Tried(kind.name), self._reference(kind)
        for _ in tqdm(range(number), desc=kind.name, leave=False, disable=None):
            self._try(kind, reference, tried)
        return tried

    def _reference(self, kind: Kind) -> Reference:
        """What a command leaves that nothing disturbs, in a folder where the earlier results are, too."""
        to = self._fresh("whole")
        old = None
        if kind.prepare:
            self._run(kind.prepare, to)
            old = kind.content(to)
        began = time.perf_counter()
        code, said = self._run(kind.command, to)
        seconds = time.perf_counter() - began
        if code:
            raise RuntimeError(f"{kind.name}: {said}")
        whole = self._folder / f"whole of {kind.name}"
        shutil.copytree(to, whole)
        return Reference(old, kind.content(to), whole, seconds)

    def _fresh(self, name: str) -> Path:
        to = self._folder / name
        shutil.rmtree(to, ignore_errors=True)
        to.mkdir()
        return to

    def _try(self, kind: Kind, reference: Reference, tried: Tried) -> None:
        to = self._fresh("tried")
        if kind.prepare:
            self._run(kind.prepare, to)
        how = self._random.choice(kind.endings)
        tried.tried += 1
        moment = self._random.uniform(0.0, 1.05)
        if how == "full disk":
            code, said = self._run(kind.command, to, limit=int(moment * _size(reference.whole)))
            if code not in (0, 1):
                tried.wrong.append(f"full disk: exit code {code}: {said}")
        else:
            said = self._ended(kind, to, how, moment * reference.seconds, tried)
        if "Traceback" in said:
            tried.wrong.append(f"{how}: {said}")
        before = set(to.glob("results.*.part"))
        if how != signal.SIGKILL and any(not part.read_bytes().endswith(b"\n") for part in to.glob("*.csv.part")):
            tried.wrong.append(f"{how}: a CSV file ends within a line")
        kind.check(to, reference, tried)
        code, said = self._run(kind.command, to)
        if code or kind.content(to) != reference.new:
            tried.wrong.append(f"{how}: once more, exit code {code}: {said}")
        if (to / ".unfinished").exists():
            tried.wrong.append(f"{how}: .unfinished stays")
        if how == signal.SIGKILL and before and not list(to.glob("killed-*")):
            tried.wrong.append("rows of a killed run are gone")
        if left := list(self._temporary.glob("cosim_*")):
            tried.wrong.append(f"{how}: {left} stay")
            shutil.rmtree(self._temporary)
            self._temporary.mkdir()

    def _ended(self, kind: Kind, to: Path, how: signal.Signals | str, moment: float, tried: Tried) -> str:
        """End a command by a signal after some time (s); returns what it said."""
        assert isinstance(how, signal.Signals)
        with (self._folder / "said").open("w+", encoding="utf-8") as said:
            program = subprocess.Popen(self._command(kind.command, to), stdout=said, stderr=said, env=self._environment)
            time.sleep(moment)
            try:
                family = [psutil.Process(program.pid), *psutil.Process(program.pid).children(recursive=True)]
            except psutil.Error:
                family = []
            program.send_signal(how)
            try:
                code = program.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                tried.wrong.append(f"{how.name} at {moment:.3f} s did not end it")
                program.kill()
                code = program.wait()
            _, alive = psutil.wait_procs(family, timeout=20.0)
            if alive:
                tried.wrong.append(f"{how.name} at {moment:.3f} s: {len(alive)} processes outlive the program")
            said.seek(0)
            text = said.read()
        early = {-how, 0} if how == signal.SIGKILL else {-how, 0, 130}  # before Python listens, and after the end
        if code not in early:
            tried.wrong.append(f"{how.name} at {moment:.3f} s: exit code {code}: {text}")
        return text

    def _command(self, command: Sequence[str], to: Path) -> list[str]:
        words = [word.replace("{to}", str(to)).replace("{work}", str(self._work)) for word in command]
        return [sys.executable, "-m", *([] if words[0] == "pytest" else ["cosim"]), *words]

    @property
    def _environment(self) -> dict[str, str]:
        return {**os.environ, "TMPDIR": str(self._temporary)}

    def _run(self, command: Sequence[str], to: Path, limit: int | None = None) -> tuple[int, str]:
        """Exit code of a command, and what it said; files can't become larger than a limit (bytes)."""
        if command[0] == "copy":
            shutil.copy(command[1], command[2].replace("{to}", str(to)))
            return 0, ""

        def set_limit() -> None:
            assert limit is not None
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

        done = subprocess.run(
            self._command(command, to),
            capture_output=True,
            text=True,
            check=False,
            env=self._environment,
            timeout=_PATIENCE,
            preexec_fn=None if limit is None else set_limit,
        )
        return done.returncode, (done.stdout + done.stderr).strip()


def _size(folder: Path) -> int:
    return max(path.stat().st_size for path in folder.glob("results.*"))


#: How often each kind is tried: about 140 times.
NUMBERS = {
    "run, csv": 25,
    "run, parquet": 10,
    "run, npz": 10,
    "run, mat": 10,
    "run, json": 5,
    "run, signals": 20,
    "run, full disk": 10,
    "long run, csv and parquet": 15,
    "long run, full disk": 5,
    "sweep": 10,
    "tune": 10,
    "regression": 8,
    "reproduce": 3,
}


def tries(fmus: Path, numbers: dict[str, int], seed: int = 0) -> list[Tried]:
    """Kill commands at random moments.

    Parameters
    ----------
    fmus : Path
        Folder of the robot's FMUs, which are there.
    numbers : dict
        Kind -> number of tries.
    seed : int
    """
    with tempfile.TemporaryDirectory(prefix="kills-") as name:
        tried = Tries(Path(name), seed)
        return [tried.of(kind, numbers[kind.name]) for kind in kinds(fmus.absolute()) if numbers.get(kind.name)]


#: What was there afterwards, and its column.
_COLUMNS = {
    "old results": "the earlier results",
    "new results": "the new results",
    "on their way": "the new ones, placed by the next run",
    "some rows": "rows so far",
    "all rows": "all rows",
    "nothing yet": "nothing yet",
    "rows kept": "besides, rows of the ended run",
}


def table_of(found: Sequence[Tried]) -> str:
    """The table in Markdown."""
    head = ("command", "ended", *_COLUMNS.values(), "lost or wrong")
    rows = [head, tuple("---" for _ in head)]
    for kind in found:
        counts = (str(kind.found[state] or "") for state in _COLUMNS)
        rows.append((kind.kind, str(kind.tried), *counts, str(len(kind.wrong))))
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def main() -> int:
    """Try all kinds, or those that are named; returns 0 when nothing is wrong."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.trust.kills", description=__doc__)
    parser.add_argument("--fmus", type=Path, default=Path("fmus"), metavar="DIR")
    parser.add_argument("--only", choices=NUMBERS, action="append", help="kind to try (default all)")
    parser.add_argument("--number", type=int, metavar="N", help="tries of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write", action="store_true", help=f"write the table of {PAGE}")
    options = parser.parse_args()
    chosen = {kind: options.number or NUMBERS[kind] for kind in options.only or NUMBERS}
    found = tries(options.fmus, chosen, options.seed)
    table = table_of(found)
    print(table)
    for kind in found:
        for line in kind.wrong:
            print(f"{kind.kind}: {line}")
    if options.write:
        before, _, rest = PAGE.read_text(encoding="utf-8").partition(_BEGIN)
        text = f"{before}{_BEGIN}\n\n{table}\n\n{_END}{rest.partition(_END)[2]}"
        write_whole(PAGE, lambda part: part.write_text(text, encoding="utf-8"))
    return int(any(kind.wrong for kind in found))


if __name__ == "__main__":
    sys.exit(main())
