"""The corpus of broken and hostile files, given to this project and to other masters: `python -m benchmarks.trust`.

Takes about an hour for all; `--only NAME` runs some cases, `--master NAME` one master, `--write` writes the table of
docs/trust.md. Ends with 1 where a case of ours ends in another way than it should.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

from tqdm import tqdm

from benchmarks.trust.masters import masters
from benchmarks.trust.trial import PATIENCE, Master, Trial, trial
from tests.support.corpus import RUNS, STOPS, Case, Materials, all_cases

RESULTS = Path("benchmarks/results/trust.json")
PAGE = Path("docs/trust.md")
_BEGIN, _END = "<!-- table: python -m benchmarks.trust --write -->", "<!-- end of the table -->"

#: Outcomes and their columns.
_COLUMNS = {
    "refused": "refused",
    "ran": "ran",
    "stopped": "stopped, results kept",
    "accepted": "accepted though broken",
    "lost": "results lost",
    "silent": "success without results",
    "hung": "hung",
    "crashed": "master crashed",
    "outside": "files elsewhere",
}


def main() -> int:
    """Try everything; returns 0 when each case of ours came out as it should."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.trust", description=__doc__)
    parser.add_argument("--only", action="append", metavar="TEXT", help="cases whose names contain it")
    parser.add_argument("--master", action="append", metavar="NAME", help="masters whose names contain it")
    parser.add_argument("--write", action="store_true", help=f"write {RESULTS} and the table of {PAGE}")
    parser.add_argument(
        "--patience",
        type=float,
        default=PATIENCE,
        metavar="S",
        help="who takes longer (s) hangs; longer where others compute",
    )
    options = parser.parse_args()
    known, missing = masters()
    chosen = [m for m in known if not options.master or any(text in m.name for text in options.master)]
    cases = [c for c in all_cases() if not options.only or any(text in c.name for text in options.only)]
    found: dict[str, list[Trial]] = {}
    wrong = 0
    with TemporaryDirectory(prefix="trust_") as folder:
        materials = Materials(Path(folder))
        _ = materials.fmi2, materials.fmi3  # before threads need them
        for master in chosen:
            taken = [case for case in cases if _takes(master, case)]
            found[master.name] = tried(master, taken, materials, Path(folder), options.patience)
            for case, result in zip(taken, found[master.name], strict=True):
                if is_ours(master, case) and not came_out(case, result):
                    wrong += 1
                    print(f"{master.name}: {case.name}: wanted {case.expected}, {result.outcome}: {result.line}")
    table = _table(found)
    print(table)
    for name, why in missing.items():
        print(f"not tried: {name}: {why}")
    if options.write:
        _write(found, table)
    if not options.only and not options.master:
        wrong += subprocess.run([sys.executable, "-m", "benchmarks.trust.kills"], check=False).returncode != 0
    return int(wrong > 0)


def tried(
    master: Master, cases: Sequence[Case], materials: Materials, folder: Path, patience: float = PATIENCE
) -> list[Trial]:
    """What came of cases; two at a time."""

    def one(case: Case) -> Trial:
        with TemporaryDirectory(prefix="case_", dir=folder, ignore_cleanup_errors=True) as place:
            (made := Path(place) / "made").mkdir()
            (here := Path(place) / "here").mkdir()
            return trial(master, case, case.make(made, materials), here, patience)

    with ThreadPoolExecutor(2) as pool:
        return list(tqdm(pool.map(one, cases), total=len(cases), desc=master.name, disable=None))


def is_ours(master: Master, case: Case) -> bool:
    """Whether this project promises what comes of a case: with isolation of all, else of those that do no harm."""
    return master.name.startswith("cosim") and ("--isolated" in master.name or not case.is_hostile)


def came_out(case: Case, result: Trial) -> bool:
    """Whether a case came out as it should."""
    wanted = {RUNS: "ran", STOPS: "stopped"}.get(case.expected, "refused")
    said = case.expected == RUNS or case.kind == "reference" or result.in_one_line
    return result.outcome == wanted and said


def _takes(master: Master, case: Case) -> bool:
    kind = "ssp" if case.kind == "system" and case.name.startswith("SSP") else case.kind
    return case.kind in master.kinds or kind in master.kinds


def _table(found: dict[str, list[Trial]]) -> str:
    """The table in Markdown."""
    head = ("master", "tried", *_COLUMNS.values(), "said in one line")
    rows = [head, tuple("---" for _ in head)]
    for name, results in found.items():
        counts = Counter(result.outcome for result in results)
        ended = [r for r in results if r.outcome in ("refused", "stopped", "lost", "crashed")]
        told = f"{sum(r.in_one_line for r in ended)} of {len(ended)}"
        rows.append((name, str(len(results)), *(str(counts[outcome]) for outcome in _COLUMNS), told))
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _write(found: dict[str, list[Trial]], table: str) -> None:
    RESULTS.parent.mkdir(parents=True, exist_ok=True)
    data = {name: {r.case: [r.outcome, r.in_one_line, r.line] for r in results} for name, results in found.items()}
    RESULTS.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    text = PAGE.read_text(encoding="utf-8")
    before, _, rest = text.partition(_BEGIN)
    PAGE.write_text(f"{before}{_BEGIN}\n\n{table}\n\n{_END}{rest.partition(_END)[2]}", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
