"""Draw the figure of docs/mechanism.md: force transmission over the workspace, with three motors and with two.

python docs/make_workspace.py docs/workspace.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from parallel_robot.workspace import DRIVEN, transmission_map
from plant_fmu.model import PARAMETERS


def draw(path: Path, points: int = 161) -> None:
    """Four maps side by side, on one scale."""
    found = transmission_map(points)
    P = PARAMETERS.unpack(PARAMETERS.starts)
    figure = Figure(figsize=(11.0, 3.4), layout="constrained")
    axes = figure.subplots(1, len(DRIVEN), sharey=True)
    for ax, driven in zip(axes, DRIVEN, strict=True):
        image = ax.pcolormesh(found.x, found.y, found.values[driven], vmin=0.0, vmax=np.sqrt(1.5), cmap="cividis")
        ax.contour(found.x, found.y, found.values[driven], levels=[0.2], colors="white", linewidths=1.0)
        ax.plot(P.x_A, P.y_A, "^", color="#D55E00", markersize=6)
        ax.set_title("motors " + ", ".join(map(str, driven)), fontsize=10)
        ax.set_aspect("equal")
        ax.set_xlabel("x (m)")
    axes[0].set_ylabel("y (m)")
    figure.colorbar(image, ax=axes, label="smallest singular value (1)")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
