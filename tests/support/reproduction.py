"""Which runs the tests of the reproduction are made with: few by default, all of them in the slow tests."""

from __future__ import annotations

import pytest

from parallel_robot.paper.reproduce.readings import ASSUMPTIONS
from parallel_robot.paper.reproduce.runs import Plan
from parallel_robot.paper.reproduce.table import controllers

#: All that `cosim reproduce` runs.
WHOLE = Plan()

#: Three of the proposed controllers, four other torques, the assumptions that need short runs.
FEW = Plan(
    controllers=tuple(c for c in controllers() if c.key in ("pd", "0.1", "1", "10")),
    seeds=(1, 2),
    assumptions=tuple(a for a in ASSUMPTIONS if a.step_size is None and a.stop_time is None and not a.continuous),
    events=(("multisine", 0.01), ("multisine", 0.2), ("pulse of 0.2 s", 0.2)),
    stiff=(),
)

#: Mark of a test that needs all runs.
needs_whole = pytest.mark.parametrize(
    "plan", [pytest.param(WHOLE, id="whole", marks=pytest.mark.slow)], indirect=True, scope="session"
)
