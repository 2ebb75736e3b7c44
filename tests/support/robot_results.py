"""Results of the robot that no run has made."""

import numpy as np

from cosim import Results

SIZES = {
    "plant": {"x_E": 1, "y_E": 1, "theta_a": 3, "tau_a": 3, "tau_d": 3, "closure_error": 1},
    "trajectory": {"x_ref": 1, "y_ref": 1, "theta_ref": 3},
    "controller": {"psi": 2},
}


def made(rows: int = 200, components: tuple[str, ...] = ("plant", "trajectory", "controller")) -> Results:
    """Each variable a sine of its own over 10 s."""
    names = [
        f"{c}.{name}" + (f"[{i + 1}]" if size > 1 else "")
        for c in components
        for name, size in SIZES[c].items()
        for i in range(size)
    ]
    time = np.linspace(0.0, 10.0, rows)
    values = np.sin(time[:, None] + np.arange(len(names)))
    return Results(time=time, names=names, values=values)
