"""The robot's runs have the same bits, however they are run."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from pathlib import Path

import pytest

from parallel_robot.wiring import COMPONENTS
from tests.support.native_fmus import FLAVOURS
from tests.support.patience import PATIENCE
from tests.support.robot_runs import digest_of_run

CHECKOUT = Path(__file__).resolve().parents[2]
SCRIPT = """
import sys
from pathlib import Path
from tests.support.robot_runs import digest_of_run
print(digest_of_run(Path(sys.argv[1]), sys.argv[2]))
"""


@pytest.mark.parametrize(
    ("flavour", "order"),
    [
        pytest.param(f, o, marks=() if (f, o) == ("fmi2", "sequential") else pytest.mark.slow)
        for f in FLAVOURS
        for o in ("sequential", "parallel")
    ],
)
def test_runs_have_the_same_bits(native_fmus: Path, flavour: str, order: str) -> None:
    """In each order of the components in the system, with threads, isolated, again, and in another process."""
    folder = native_fmus / flavour
    expected = digest_of_run(folder, order)
    orders = list(itertools.permutations(COMPONENTS))
    for components in orders[-1:] if (flavour, order) == ("fmi2", "sequential") else orders:
        assert digest_of_run(folder, order, components) == expected, components
    assert digest_of_run(folder, order, threads=2) == expected
    assert digest_of_run(folder, order, isolate=COMPONENTS) == expected
    assert digest_of_run(folder, order, isolate=["controller"], threads=2) == expected
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(folder), order],
        cwd=CHECKOUT,
        env=os.environ | {"PYTHONPATH": str(CHECKOUT), "PYTHONHASHSEED": "7", "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.split()[-1] == expected


def test_another_last_bit_is_found(native_fmus: Path) -> None:
    expected = digest_of_run(native_fmus / "fmi2", "sequential")
    assert digest_of_run(native_fmus / "fmi2", "sequential", start={"dm": 0.1 + 2.0**-56}) != expected
