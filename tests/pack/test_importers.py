"""A packed system in importers that share no code with ours: the numbers are those of our master with its FMUs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim import simulate
from cosim.pack import pack
from interop.tools.case import Case
from interop.tools.launch import run_tool, tool
from tests.support.packed_fmus import small_loop


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("c_host", 3),
        ("libcosim", 2),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in (("c_host", 2), ("ecos", 2), ("ecos", 3))),
    ],
)
def test_the_numbers_are_ours(small_fmus: dict[str, Path], tmp_path: Path, name: str, version: int) -> None:
    if (reason := tool(name).unavailable()) is not None:
        pytest.skip(reason)
    system = small_loop(small_fmus[f"fmi{version}"])
    packed = pack(system, tmp_path / "W.fmu", 0.125, fmi=version)
    path = ("whole.i.x", "whole.g.y[1]")
    found = run_tool(name, Case({"whole": packed.path}, [], {}, 8.0, 0.5, list(path), path))
    expected = simulate(system, 8.0, 0.125, record_every=4)
    assert np.array_equal(found.time, expected.time)
    assert np.array_equal(found.x_E, expected["i.x"])
    assert np.array_equal(found.y_E, expected["g.y[1]"])
