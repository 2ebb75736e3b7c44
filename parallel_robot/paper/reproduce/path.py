"""Centre and phase of the desired path (93), which the paper does not print: what speaks for which."""

from __future__ import annotations

import numpy as np

from parallel_robot.paper.reproduce.content import (
    PRINTED_INSET_X,
    PRINTED_INSET_Y,
    PRINTED_PATH_X,
    PRINTED_PATH_Y,
    Erratum,
)
from parallel_robot.paper.reproduce.material import Material
from trajectory_fmu.model import PARAMETERS as TRAJECTORY
from trajectory_fmu.model import desired_path


def path_not_printed(material: Material) -> Erratum:
    """Centre and phase of (93), which the paper leaves out.

    All that is printed about the path: the start at which the errors of Figs. 8-12 begin, the axes of Fig. 7, its
    inset at the disturbance, and the main axes and insets of Figs. 8-12, which runs on it should keep to. A number
    that is fitted has to meet a piece beside the one it is fitted to. The phase that enters the inset does not: runs on
    both paths leave the main axes by as much, and the insets too. So the default stays: the start at the lowest point,
    a phase that needs no number.
    """
    default = TRAJECTORY.unpack(TRAJECTORY.starts)
    own, other = path_evidence(float(default.phase)), path_evidence(PHASE_OF_INSET)
    x_c, y_c = centre_for(PHASE_OF_INSET)
    return Erratum(
        "path-not-printed",
        "(93), Fig. 7",
        "neither centre nor phase",
        "open: ours, (0.225, 0.355) m and -pi/2 rad, meet start and axes; a phase of -1.4585 to -1.3585 rad, with "
        f"the centre at ({x_c:.4f}, {y_c:.4f}) m for its middle, meets the inset too, to which it is fitted, and "
        "leaves the main axes and the insets of Figs. 8-12 by as much. A fitted number has to meet one piece of "
        "evidence more than the one it is fitted to, so the default stays",
        "The desired path is computed with both; the inset is that of Fig. 7 where the disturbance sets in. The "
        "runs are readings.",
        {
            "distance of ours from the inset after 4 s (m)": own[0],
            "distance of the other (m)": other[0],
            "the other enters it at (s)": other[1],
            "axes of Fig. 7 hold ours (1)": float(own[2]),
            "axes of Fig. 7 hold the other (1)": float(other[2]),
            **_beyond_axes(material),
        },
        own[0] > 0.005 and other[0] == 0.0,
    )


def _beyond_axes(material: Material) -> dict[str, float]:
    """By how much runs on both paths leave the main axes of Figs. 8-12, where both have been run."""
    found = {r.assumption.partition(":")[0]: r.beyond_axes for r in material.runs.readings}
    labels = {"ours": "as printed", "the other": THROUGH_INSET}
    if not all(label in found for label in labels.values()):
        return {}
    return {f"{name} leaves a main axis by (share of it)": found[label] for name, label in labels.items()}


#: What the reading with the other path is called, up to its numbers.
THROUGH_INSET = "path through the inset of Fig. 7"

#: The middle of the phases (rad) with which the path enters the inset of Fig. 7 at the disturbance.
PHASE_OF_INSET = -1.4085


def centre_for(phase: float) -> tuple[float, float]:
    """Centre of the path (m) that begins where ours does, with another phase (rad)."""
    P = TRAJECTORY.unpack(TRAJECTORY.starts)
    radius = P.b * (P.a + P.R)
    return (
        float(P.x_c + radius * (np.cos(P.phase) - np.cos(phase))),
        float(P.y_c + radius * (np.sin(P.phase) - np.sin(phase))),
    )


def path_evidence(phase: float) -> tuple[float, float, bool]:
    """Least distance (m) from the inset of Fig. 7 in 4 to 5 s, when that is (s), and whether its axes hold the path."""
    x_c, y_c = centre_for(phase)
    p = TRAJECTORY.pack(**vars(TRAJECTORY.unpack(TRAJECTORY.starts)) | {"x_c": x_c, "y_c": y_c, "phase": phase})
    times = np.arange(4.0, 5.0, 1e-3)
    points, lap = (np.array([desired_path(t, p)[0] for t in of]) for of in (times, np.arange(0.0, 6.29, 0.01)))
    outside = [
        np.maximum(np.maximum(low - values, values - high), 0.0)
        for values, (low, high) in zip(points.T, (PRINTED_INSET_X, PRINTED_INSET_Y), strict=True)
    ]
    distance = np.hypot(*outside)
    held = all(
        low <= values.min() and values.max() <= high
        for values, (low, high) in zip(lap.T, (PRINTED_PATH_X, PRINTED_PATH_Y), strict=True)
    )
    return float(distance.min()), float(times[np.argmin(distance)]), held
