"""The section of run pages that shows the robot, for whatever controller it ran with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from cosim.page.document import Section
from parallel_robot.animation.motion import motion_of
from parallel_robot.animation.player import SCRIPTS, STYLES, player_data, player_html

if TYPE_CHECKING:
    from cosim.results.recorded import Recorded


def robot_section(runs: Mapping[str, Recorded]) -> Section | None:
    """The robot in motion, of several runs two side by side; None where no run has it."""
    found = [motion_of(results, str(k), label) for k, (label, results) in enumerate(runs.items())]
    motions = [motion for motion in found if motion is not None]
    if not motions:
        return None
    data, blocks = player_data(motions)
    html = player_html(motions, (motions[0].key, motions[-1].key), {"": motions})
    return Section("robot", "The robot in motion", html, STYLES, SCRIPTS, {"robot": data}, blocks)
