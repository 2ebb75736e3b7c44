"""Fig. 4: the open loop."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from parallel_robot.paper.reproduce.content import PRINTED_X, PRINTED_Y, Runs
from parallel_robot.paper.reproduce.figures import style
from parallel_robot.paper.reproduce.model import ends, seconds_in_printed_axes


def fig_4(runs: Runs) -> style.Drawing:
    """Fig. 4: the ends of the three chains on one path, and how far they are apart."""
    results = runs.open_loop
    duration = seconds_in_printed_axes(results)
    inside = results.time <= duration
    gap = results["plant.closure_error"]

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
        x, y = (end[inside] for end in ends(results))
        widths, colours = (6.0, 3.2, 1.2), (style.SKY, style.ORANGE, style.BLACK)
        for i in range(3):
            dashes = "-" if i < 2 else (0, (3, 2))
            left.plot(x[:, i], y[:, i], color=colours[i], linewidth=widths[i], linestyle=dashes, label=f"chain {i + 1}")
        left.plot(x[0, 0], y[0, 0], "o", color=style.BLACK, markersize=6, label="start")
        left.set(xlabel="x (m)", ylabel="y (m)", xlim=PRINTED_X, ylim=(PRINTED_Y[0], 0.3005))
        left.set_title(f"Ends of the chains, 0 to {duration:.2f} s")
        left.legend(loc="lower right")
        every = max(1, len(results.time) // style.MOST_POINTS)
        positive = np.where(gap > 0.0, gap, np.nan)
        right.plot(results.time[::every], positive[::every], color=style.BLUE, linewidth=0.9)
        right.axvline(duration, color=style.BLACK, linestyle=":", linewidth=1.0)
        right.set(xlabel="Time (s)", ylabel="Closure error (m)", yscale="log", xlim=(0.0, results.time[-1]))
        right.set_title("Norm of the loop closure (16)")

    return style.Drawing(
        4,
        "The robot's response to an open-loop torque",
        "Ends of the three chains under tau_a = 0.1 cos(pi t) N m on every active joint, from rest at (0.22, 0.30) m, "
        f"in the paper's axes; right, the norm of the loop closure over 15 s. The path leaves these axes at "
        f"{duration:.2f} "
        "s (dotted line), so the paper's run, whose duration is not printed, cannot have been longer.",
        "Left: three curves of different widths lie on one another; from (0.22, 0.30) m the end effector moves "
        "through a "
        f"path that stays in the printed axes for {duration:.2f} seconds. Right: the closure error stays below "
        f"{gap.max():.1e} m for 15 seconds.",
        draw,
        (7.5, 3.6),
    )
