"""Calls of our FMUs in any order, with any arguments: what comes of them that the standards do not say.

The C of native FMUs is compiled with address and undefined-behaviour sanitisers; FMUs of the pythonfmu flavour run in a
process of their own. What must hold is in tests/support/native_calls.c and pythonfmu_calls.py.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from cosim.files.whole import write_whole
from fmu_export import build_pythonfmu
from parallel_robot.models import MODELS as ROBOT
from parallel_robot.models import closed_loop_model
from tests.support.bare_host import fresh
from tests.support.example_models import load
from tests.support.hybrid_models import SAMPLED_PI, THERMOSTAT
from tests.support.native_calls import compile_calls, make_calls
from tests.support.pythonfmu_calls import SCRIPT
from tests.support.typed_model import TYPED

PAGE = Path("docs/trust.md")
_BEGIN, _END = "<!-- table: python -m benchmarks.trust.calls --write -->", "<!-- end of the table of calls -->"

#: Longest time (s) of one program.
_PATIENCE = 36_000.0

#: Calls by pythonfmu's binary take some hundred times as long.
_FEWER = 200


@dataclass
class Kind:
    """FMUs of one flavour: how many, their calls, and what was wrong."""

    flavour: str
    fmus: int = 0
    calls: int = 0
    wrong: list[str] = field(default_factory=list)


def models() -> dict[str, Any]:
    """By name: the robot, one of each solver, those with events, sampling, types, tables, arrays."""
    found: dict[str, Any] = {model.name: model for model in (*ROBOT.values(), closed_loop_model(), TYPED)}
    found |= {solver: replace(ROBOT["controller"], solver=solver) for solver in ("dopri5", "rodas4")}
    found |= {model.name: model for model in (THERMOSTAT, SAMPLED_PI)}
    examples = {"bouncing_ball": "BouncingBall", "torque_map": "TorqueMap", "delay_line": "DelayLine"}
    return found | {name: getattr(load(module), name) for module, name in examples.items()}


def tries(calls: int, seed: int, names: list[str], folder: Path) -> Iterator[Kind]:
    """Each flavour with its share of the calls."""
    compiler = next((c for c in ("cc", "gcc", "clang") if shutil.which(c)), "cc")
    chosen = {name: model for name, model in models().items() if name in names or not names}
    share = -(-calls // (2 * len(chosen)))
    for flavour in ("fmi2", "fmi3"):
        kind = Kind(f"{flavour}, in C")
        for name, model in tqdm(chosen.items(), desc=flavour, disable=not sys.stderr.isatty()):
            place = folder / flavour / name
            place.mkdir(parents=True)
            program, resources = compile_calls(model, flavour, place, compiler, arrays=flavour == "fmi3")  # type: ignore[arg-type]
            made, wrong = make_calls(program, resources, share, seed, _PATIENCE)
            kind.fmus, kind.calls = kind.fmus + 1, kind.calls + made
            kind.wrong += [f"{name}: {wrong}"] * bool(wrong)
            shutil.rmtree(place)
        yield kind
    kind = Kind("pythonfmu")
    for name, model in ROBOT.items():
        fmu = build_pythonfmu(model, folder / "pythonfmu")
        statuses = fresh(folder, SCRIPT, fmu=fmu.resolve(), calls=max(calls // _FEWER // len(ROBOT), 1), seed=seed)
        kind.fmus, kind.calls = kind.fmus + 1, kind.calls + sum(statuses.values())
        kind.wrong += [f"{name}: no call was good"] * (not statuses.get("0"))
    yield kind


def table_of(kinds: list[Kind]) -> str:
    """The table in Markdown."""
    rows = [("flavour", "FMUs", "calls", "crashes, reports of sanitisers, and what the standards do not say")]
    rows += [("---",) * 4, *((k.flavour, str(k.fmus), f"{k.calls:,}", str(len(k.wrong))) for k in kinds)]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def main() -> int:
    """Make the calls; returns 0 when nothing is wrong."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.trust.calls", description=__doc__)
    parser.add_argument("--calls", type=int, default=10_000_000, metavar="N", help="of the C (default %(default)s)")
    parser.add_argument("--only", action="append", default=[], metavar="MODEL", help="model to try (default all)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write", action="store_true", help=f"write the table of {PAGE}")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="calls_") as folder:
        kinds = list(tries(options.calls, options.seed, options.only, Path(folder)))
    table = table_of(kinds)
    print(table)
    for kind in kinds:
        for line in kind.wrong:
            print(f"{kind.flavour}: {line}")
    if options.write:
        before, _, rest = PAGE.read_text(encoding="utf-8").partition(_BEGIN)
        text = f"{before}{_BEGIN}\n\n{table}\n\n{_END}{rest.partition(_END)[2]}"
        write_whole(PAGE, lambda part: part.write_text(text, encoding="utf-8"))
    return int(any(kind.wrong for kind in kinds))


if __name__ == "__main__":
    sys.exit(main())
