"""Strength of the tests: changes of the code, drawn at random, that a room's own tests do or do not notice.

`python -m benchmarks.mutation [ROOM...] [--sample 60] [--seed 0]`, with the extra `mutation`. Each mutant is tried in a
copy of the project, two at a time; a room takes five to thirty minutes. What the default tests do not notice, the
room's slow tests are tried against too. Writes docs/mutation.md from the last measurements of each room.
mutants_explained.toml says of survivors why no test can or need notice them.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names
from tqdm import tqdm

ROOT = Path(__file__).parents[1]
EXPLAINED = Path(__file__).with_name("mutants_explained.toml")
RESULTS = Path(__file__).with_name("mutation_results.json")
PAGE = Path("docs/mutation.md")

#: The tests of a room that a mutant is tried against, first those that continuous integration runs.
MARKERS = ("not slow", "slow")

#: Exit code of pytest for a room that has no slow tests.
NO_TESTS = 5

#: Address space of the tests of a mutant: a mutant that collects without end must not take the machine along. A process
#: of a test may lift this limit: the sanitisers need more addresses than any machine has memory.
MOST_MEMORY = 12 << 30


@dataclass(frozen=True)
class Room:
    """What is changed, folders or files, and the tests that should notice, in the order in which they are run."""

    sources: tuple[str, ...]
    tests: tuple[str, ...]


#: Which dataclasses may change is a rule for all rooms, with a test of its own.
FROZEN = "tests/house/test_frozen.py"


#: What cosmic-ray can't change, or changes too seldom.
BY_HAND = """## By hand

The loop is in C, which cosmic-ray can't change. So mutants of `loop.c` (18: derivatives, histories, jumps,
evaluation) and of algorithms, extrapolated inputs, levels, stepping by hand, states, sampling and recording (42)
were made by hand. When they were first tried 23 survived, most of them because nothing tested the extrapolation
through more than two values. Tests have been added that notice 19 of them. The other four do the same as the code:

- `extrapolate` in `loop.c`, `d + 1 >= known` as `d >= known`: with so few points known the weights of that
  derivative are 0.
- `_visit` of `cosim/system/levels.py`, without `if feeder not in level`: what has its level already is taken off
  the stack.
- `SteppedRun.restore` without forgetting what was set: values are exchanged once more, with the same result.
- `restore_history` without the time of the point: the next step writes it before an FMU asks.
"""


#: What the draws by seeds 3 to 5 found, and how they were made.
REDRAWN = """## What the last draws found

Rooms grow, also by folders within them, which the tool passed over before. So models, regression and trace were drawn
again, and at first the default tests noticed fewer than 90 %:

- models, seed 3: 36 of 60 killed. 19 of the rest were in lines that no test of the room ran: tables, internal steps,
  hybrid runs in numpy, and models by name had their tests in other rooms, where FMUs are compiled.
- trace, seed 3: 35 of 60 killed. The symbols had never been drawn: shapes, axes, signs of expressions, the points that
  the check tries, bounds of rounding errors and dependencies.
- regression, seed 3: 45 of 60 killed. Curves that are thinned, captions, times of experiments that FMUs bring along,
  jumps of inputs and options of pytest-xdist were not looked at.

Tests were added for these kinds, and then a sample by seed 4 was drawn. What was neither noticed nor explained there
(models 1, trace 1, regression 3) has tests since; the rows above have the counts after that. To take less time, these
draws tried a mutant against the tests that run the changed line, the cheapest first and a few seconds of them, and what
survived against the tests that were added. So a survivor may still be noticed by others, and slow tests were not run.

In the same way 30 mutants of master and 30 of ssp were drawn by seed 5, for rooms had grown since the samples before
them, master from 1013 places to 3664. In ssp all 30 were killed. In master 24 were killed at first. Of the other six,
five have tests since: sizes that residuals are relative to, cores that processes share, operations that fail within a
step of model exchange (two), and signals that are asked beyond a step.

"""


def _first(folder: str, *quick: str) -> tuple[str, ...]:
    """The tests of a folder, some files first: those that build no FMU notice most mutants in a second."""
    return (*(f"{folder}/test_{name}.py" for name in quick), FROZEN, folder)


ROOMS = {
    "models": Room(
        ("plant_fmu", "controller_fmu", "trajectory_fmu", "fmu_export/modelling"),
        ("tests/fmu_export/modelling", *_first("tests/models", "declarations", "controller", "membership")),
    ),
    "system": Room(("cosim/system",), _first("tests/system", "resolution", "variables", "levels", "read", "function")),
    "master": Room(
        ("cosim/master", "cosim/loop"),
        (*_first("tests/master", "sampling", "value_layout", "recording", "coupling", "stepping"), "tests/loop"),
    ),
    "ssp": Room(("cosim/ssp",), _first("tests/ssp", "values", "diagram", "description")),
    "regression": Room(("cosim/regression",), _first("tests/regression", "compare", "funnel", "page", "case")),
    "trace": Room(("fmu_export/trace",), _first("tests/fmu_export/trace")),
}


@dataclass(frozen=True)
class Mutant:
    """A change of one line or more of a file.

    Attributes
    ----------
    file : str
        Relative to the project.
    line : int
    before, after : str
        The lines that differ.
    """

    file: str
    line: int
    before: str
    after: str


@dataclass(frozen=True)
class Measurement:
    """What became of the mutants that were drawn in a room.

    Attributes
    ----------
    places : int
        Number of places that they were drawn from.
    seed : int
    date : str
    killed, time_limit : int
        How many made a test fail, or the tests run into the time limit.
    survivors : tuple of Mutant
        Those that no test noticed.
    killed_slow : int
        How many made no default test fail, but one of those that are marked slow.
    """

    places: int
    seed: int
    date: str
    killed: int
    time_limit: int
    survivors: tuple[Mutant, ...]
    killed_slow: int = 0

    @property
    def drawn(self) -> int:
        """How many mutants were tried."""
        return self.killed + self.killed_slow + self.time_limit + len(self.survivors)


def main() -> int:
    """Measure rooms and write the page; returns 0 when 90 % of the mutants of each are killed or explained."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutation", description=__doc__)
    parser.add_argument("rooms", nargs="*", metavar="ROOM", help=f"{', '.join(ROOMS)} (default all)")
    parser.add_argument("--sample", type=int, default=60, help="mutants a room (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the sample (default %(default)s)")
    parser.add_argument(
        "--again", action="store_true", help="try the survivors of the last measurement again, no others"
    )
    parser.add_argument(
        "--check", action="store_true", help="keep the last measurement beside this one, a check by another seed"
    )
    parser.add_argument("--jobs", type=int, default=2, help="mutants at a time (default %(default)s)")
    options = parser.parse_args()
    unknown = [name for name in options.rooms if name not in ROOMS]
    if unknown:
        parser.error(f"there is no room '{unknown[0]}'; rooms are {', '.join(ROOMS)}")
    os.chdir(ROOT)
    explained = tomllib.loads(EXPLAINED.read_text(encoding="utf-8"))["mutants"]
    for name in options.rooms or ROOMS:
        if options.again:
            *before, last = saved()[name]
            measured = measure_again(name, last, options.jobs)
        else:
            before = saved().get(name, []) if options.check else []
            measured = measure(name, options.sample, options.seed, options.jobs)
        print(text_of(name, measured, explained), flush=True)
        save(name, [*before, measured])
    measurements = saved()
    PAGE.write_text(page(measurements, explained), encoding="utf-8")
    return int(any(_noticed(m, explained) < 0.9 * m.drawn for drawn in measurements.values() for m in drawn))


def measure(name: str, sample: int, seed: int, jobs: int) -> Measurement:
    """Draw mutants of a room and run the room's tests against each.

    Raises
    ------
    SystemExit
        The tests fail without any mutant.
    """
    places, mutants = draw(ROOMS[name], sample, random.Random(f"{name} {seed}"))
    verdicts = _tried(name, mutants, jobs)
    return Measurement(
        places,
        seed,
        time.strftime("%Y-%m-%d"),
        verdicts.count("killed"),
        verdicts.count("time limit"),
        _survivors(mutants, verdicts),
        verdicts.count("killed by a slow test"),
    )


def measure_again(name: str, last: Measurement, jobs: int) -> Measurement:
    """Run a room's tests against what survived them last time, after tests have been added.

    Raises
    ------
    SystemExit
        The tests fail without any mutant, or the code has changed, so that a mutant can't be made again.
    """
    mutants = [_made_again(mutant) for mutant in last.survivors]
    verdicts = _tried(name, mutants, jobs)
    return replace(
        last,
        date=time.strftime("%Y-%m-%d"),
        killed=last.killed + verdicts.count("killed"),
        time_limit=last.time_limit + verdicts.count("time limit"),
        survivors=_survivors(mutants, verdicts),
        killed_slow=last.killed_slow + verdicts.count("killed by a slow test"),
    )


def _survivors(mutants: Sequence[_Drawn], verdicts: Sequence[str]) -> tuple[Mutant, ...]:
    return tuple(mutant.shown for mutant, verdict in zip(mutants, verdicts, strict=True) if verdict == "survived")


def _made_again(mutant: Mutant) -> _Drawn:
    """The same change of the code as it is now: of the first such lines from its line on, else from the beginning."""
    code = Path(mutant.file).read_text(encoding="utf-8")
    lines, before = code.splitlines(keepends=True), mutant.before.split("\n")
    for first in (*range(mutant.line - 1, len(lines)), *range(mutant.line - 1)):
        old = lines[first : first + len(before)]
        if [line.strip() for line in old] == before:
            margin = old[0][: len(old[0]) - len(old[0].lstrip())]
            new = [f"{margin}{line}\n" for line in mutant.after.split("\n")]
            changed = "".join([*lines[:first], *new, *lines[first + len(before) :]])
            return _Drawn(replace(mutant, line=first + 1), code, changed)
    raise SystemExit(f"{mutant.file} has changed: it has no line '{mutant.before}'; measure without --again")


def _tried(name: str, mutants: Sequence[_Drawn], jobs: int) -> list[str]:
    """What became of mutants of a room, each in one of so many copies of the project."""
    tests = ROOMS[name].tests
    with TemporaryDirectory(prefix="mutation_") as temporary, ThreadPoolExecutor(jobs) as pool:
        copies: SimpleQueue[Path] = SimpleQueue()
        for i in range(jobs):
            copies.put(_copy(Path(temporary) / str(i)))
        copy = copies.get()
        limits: list[float] = []
        for marker in MARKERS:
            began = time.monotonic()
            if _run_tests(copy, tests, marker, 3600.0) != "survived":
                raise SystemExit(f"the tests of room '{name}' ({marker}) fail without any mutant: {' '.join(tests)}")
            limits.append(60.0 + 5.0 * (time.monotonic() - began))
        copies.put(copy)

        def verdict(mutant: _Drawn) -> str:
            copy = copies.get()
            try:
                path = copy / mutant.shown.file
                path.write_text(mutant.changed, encoding="utf-8")
                try:
                    default, slow = limits
                    found = _run_tests(copy, tests, MARKERS[0], default)
                    if found == "survived":
                        found = _run_tests(copy, tests, MARKERS[1], slow)
                        found = "killed by a slow test" if found == "killed" else found
                    # at once, so that a measurement that is broken off was not in vain
                    shown = mutant.shown
                    tqdm.write(f"{found}: {shown.file}, line {shown.line}\n- {shown.before}\n+ {shown.after}")
                    return found
                finally:
                    path.write_text(mutant.code, encoding="utf-8")
            finally:
                copies.put(copy)

        return list(tqdm(pool.map(verdict, mutants), desc=name, total=len(mutants), disable=None))


@dataclass(frozen=True)
class _Drawn:
    """A mutant, and the whole text of its file without and with it."""

    shown: Mutant
    code: str
    changed: str


def draw(room: Room, sample: int, generator: random.Random) -> tuple[int, list[_Drawn]]:
    """The number of places where the room can be changed, and mutants at some of them, one a place at most.

    A place is drawn first and then what happens there: else the operators for which cosmic-ray knows ten replacements
    would be drawn ten times as often as a Boolean.
    """
    places = sorted(
        (str(file), position, tuple(found))
        for source in room.sources
        for file in ([Path(source)] if source.endswith(".py") else sorted(Path(source).rglob("*.py")))
        for position, found in _places(file.read_text(encoding="utf-8")).items()
    )
    generator.shuffle(places)
    mutants: list[_Drawn] = []
    changeable = 0
    for file, _, found in places:
        operator, occurrence = generator.choice(found)
        code = Path(file).read_text(encoding="utf-8")
        try:
            changed = mutate_code(code, get_operator(operator)(), occurrence)
        except AttributeError:  # cosmic-ray can't replace an exception with a dot in its name
            continue
        if changed is None or not _differs(code, changed):
            continue
        changeable += 1
        if len(mutants) < sample:
            mutants.append(_Drawn(_shown(file, code, changed), code, changed))
    return changeable, mutants


def _places(code: str) -> dict[tuple[int, int], list[tuple[str, int]]]:
    """Position in a file -> the mutations there, as operator and the number of its occurrence."""
    nodes = list(ast_nodes(get_ast(code)))
    places: dict[tuple[int, int], list[tuple[str, int]]] = {}
    for name in sorted(operator_names()):
        operator_class = get_operator(name)
        if operator_class.arguments():  # needs to be told which variable
            continue
        operator = operator_class()
        positions = (start for node in nodes for start, _ in operator.mutation_positions(node))
        for occurrence, start in enumerate(positions):
            places.setdefault(start, []).append((name, occurrence))
    return places


def _differs(before: str, after: str) -> bool:
    """Whether a change is one: it compiles, and is not to an annotation, which nothing evaluates here."""
    try:
        return _meaning(before) != _meaning(after)
    except SyntaxError:
        return False


@lru_cache(4)
def _meaning(code: str) -> str:
    tree = ast.parse(code)
    for node in ast.walk(tree):
        if isinstance(node, ast.arg | ast.AnnAssign):
            node.annotation = ast.Constant(None)
        elif isinstance(node, ast.FunctionDef):
            node.returns = None
    return ast.dump(tree)


def _shown(file: str, before: str, after: str) -> Mutant:
    old, new = before.splitlines(), after.splitlines()
    first = next(i for i, (a, b) in enumerate(zip(old, new, strict=False)) if a != b)
    last = next(i for i, (a, b) in enumerate(zip(old[::-1], new[::-1], strict=False)) if a != b)
    return Mutant(file, first + 1, *(_lines(text[first : len(text) - last]) for text in (old, new)))


def _lines(lines: Sequence[str]) -> str:
    return "\n".join(line.strip() for line in lines)


def _copy(folder: Path) -> Path:
    """A copy of what git knows or would know of, with the loop compiled."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], capture_output=True, check=True
    )
    for name in filter(None, listed.stdout.decode().split("\0")):
        if Path(name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(name, folder / name)
    subprocess.run([sys.executable, "hatch_build.py"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    return folder


def _run_tests(copy: Path, tests: Sequence[str], marker: str, limit: float) -> str:
    """What became of a mutant with the tests of a marker: "killed", "time limit" or "survived"."""
    quiet = ("-x", "-q", "--no-header", "--tb=no", "-p", "no:cacheprovider")
    command = [sys.executable, "-m", "pytest", *quiet, "-m", marker, *tests]
    # no .pyc: two mutants of one size within a second would be taken for each other
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    process = subprocess.Popen(
        command,
        cwd=copy,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    resource.prlimit(process.pid, resource.RLIMIT_AS, (MOST_MEMORY, resource.RLIM_INFINITY))
    try:
        return "survived" if process.wait(limit) in (0, NO_TESTS) else "killed"
    except subprocess.TimeoutExpired:
        return "time limit"
    finally:
        _end(process)


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the tests and whatever they have started."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def reason_of(mutant: Mutant, explained: Sequence[dict[str, str]]) -> str:
    """Why no test can or need notice a mutant; empty where nobody has said so.

    An explanation is for one file or, without one, for all; its `before` and `after` are what differs, lines or a part
    of one.
    """
    for one in explained:
        before, after = one["before"], one["after"]
        changed = {mutant.before.replace(before, after), mutant.before.replace(before, after, 1)}
        if one.get("file", mutant.file) == mutant.file and before in mutant.before and mutant.after in changed:
            return one["reason"]
    return ""


def _noticed(measured: Measurement, explained: Sequence[dict[str, str]]) -> int:
    return measured.drawn - sum(not reason_of(mutant, explained) for mutant in measured.survivors)


def text_of(name: str, measured: Measurement, explained: Sequence[dict[str, str]]) -> str:
    """A room's result for the terminal: the count, and each survivor."""
    lines = [f"{name}: {_noticed(measured, explained)} of {measured.drawn} killed or explained"]
    return "\n".join([*lines, "", *_listed(measured, explained)])


def _listed(measured: Measurement, explained: Sequence[dict[str, str]]) -> Iterator[str]:
    for mutant in measured.survivors:
        lines = [("-", line) for line in mutant.before.split("\n")] + [("+", line) for line in mutant.after.split("\n")]
        yield f"`{mutant.file}`, line {mutant.line}: {reason_of(mutant, explained) or 'not explained.'}"
        yield from ("", "```diff", *(f"{sign} {line}" for sign, line in lines), "```", "")


def save(name: str, measured: Sequence[Measurement]) -> None:
    """Keep the measurements of a room beside those of the others."""
    data = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    data[name] = [asdict(m) for m in measured]
    RESULTS.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def saved() -> dict[str, list[Measurement]]:
    """The last measurement of each room, and the checks by other seeds that followed it."""
    data = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    return {
        name: [Measurement(**m | {"survivors": tuple(Mutant(**s) for s in m["survivors"])}) for m in data[name]]
        for name in ROOMS
        if name in data
    }


def page(measurements: dict[str, list[Measurement]], explained: Sequence[dict[str, str]]) -> str:
    """docs/mutation.md."""
    rows = []
    for name, m in ((name, m) for name, drawn in measurements.items() for m in drawn):
        told = sum(reason_of(mutant, explained) != "" for mutant in m.survivors)
        counts = (m.places, m.drawn, m.killed, m.killed_slow, m.time_limit, len(m.survivors), told)
        share = f"{100.0 * _noticed(m, explained) / m.drawn:.0f} %"
        rows.append(" | ".join(map(str, [name, m.seed, *counts, share, m.date])))
    header = (
        *("room", "seed", "places to change", "drawn", "killed", "killed by slow tests only", "time limit"),
        *("survived", "of these explained", "killed or explained", "date"),
    )
    table = "\n".join(f"| {row} |" for row in (" | ".join(header), " | ".join("---" for _ in header), *rows))
    absent = [name for name in ROOMS if name not in measurements]
    missing = f"\nNot measured yet: {', '.join(absent)}.\n" if absent else ""
    lists = "\n".join(
        f"### {name}, seed {m.seed}\n\n" + ("\n".join(_listed(m, explained)) or "None.\n")
        for name, drawn in measurements.items()
        for m in drawn
    )
    tests = "\n".join(f"- {name}: {' '.join(f'`{test}`' for test in room.tests)}" for name, room in ROOMS.items())
    return f"""# Strength of the tests

```sh
pip install -e ".[mutation]"
python -m benchmarks.mutation            # all rooms, two hours; or: python -m benchmarks.mutation ssp trace --seed 3
```

A mutant is the project with one small change: another operator, another number, a condition the other way round, a loop
that is never entered, a missing decorator. Tests that pass with a mutant do not test what was changed. The tool draws
mutants with a seed, runs the tests of the changed room against each in a copy of the project, and writes this page;
[cosmic-ray](https://cosmic-ray.readthedocs.io) makes the mutants. Changes of annotations do not count, since nothing
evaluates them. A mutant with which the tests run into a time limit is noticed too. `benchmarks/mutants_explained.toml`
says of a survivor why no test can or need notice it.

What the default tests do not notice is tried against the room's slow tests too: continuous integration does not see
such a change, a release does. With `--again` only what survived last time is tried, after tests have been added; that
changes the counts of its sample. With `--check` a sample of another seed, drawn after that, stands beside it: the rows
of a room are in the order in which they were drawn.

## The last measurements

{table}
{missing}
These tests are run, in this order:

{tests}

{REDRAWN}{BY_HAND}
## Survivors

{lists}"""


if __name__ == "__main__":
    sys.exit(main())
