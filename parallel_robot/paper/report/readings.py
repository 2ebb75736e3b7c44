"""Which assumption would give the steady errors that the paper prints: a table of runs."""

from __future__ import annotations

import math
from collections.abc import Sequence

from parallel_robot.paper.report.claims import table
from parallel_robot.paper.report.prose import number, prose
from parallel_robot.paper.report.series import CONDITION_NAMES
from parallel_robot.paper.reproduce.content import PRINTED_STEADY_ERROR, Reading

#: Ends of the scale of errors, as powers of ten (m), and its size (px).
_LEAST, _MOST = -9, -1
_WIDTH, _HEIGHT = 136, 14


def readings_section(readings: Sequence[Reading]) -> str:
    """Steady errors and torques under each assumption."""
    heads = (
        "The law",
        "what acts on the robot",
        "largest steady error in x, y (m)",
        "steady torque: rms, largest (N&nbsp;m)",
        "largest torque of the run (N&nbsp;m)",
    )
    cells = [
        (
            prose(r.assumption),
            CONDITION_NAMES[r.condition],
            _errors(r),
            f"{number(r.torque_rms, 3)}, {number(r.torque_steady, 3)}",
            number(r.torque_max, 4),
        )
        for r in readings
    ]
    reached = sum(r.reaches_printed for r in readings)
    return f"""<section id="readings" aria-labelledby="readings-title">
<h2 id="readings-title">What would give the printed {prose("1e-6")} m</h2>
<p>The insets of Figs. 8 and 9 show steady errors of {prose("1e-6")} m. One assumption a row, a run each, with the gains
of row (1, 1) where nothing else is said: {reached} of {len(readings)} come as low. Feedforward adds to (38) the torque
that the nominal robot of (27) needs for the desired motion, the least that its three motors can do it with; it is an
option of the controller FMU, as are torque limits, both off by default. Bars: the larger error on a
logarithmic scale from {prose(f"1e{_LEAST}")} to {prose(f"1e{_MOST}")} m; the line is the printed size.</p>
{table(heads, cells, "Steady errors and torques by assumption", "cards readings")}
</section>"""


def _errors(reading: Reading) -> str:
    """Both errors, the larger one as a bar, and the verdict."""
    numbers = ", ".join(prose(f"{error:.2e}") for error in (reading.steady_x, reading.steady_y))
    return f"<span>{numbers}</span>{_scale(max(reading.steady_x, reading.steady_y))}{_verdict(reading)}"


def _verdict(reading: Reading) -> str:
    look, icon, text = ("good", "✓", "reached") if reading.reaches_printed else ("bad", "✗", "not reached")
    return f'<span class="badge {look}"><span aria-hidden="true">{icon}</span> {text}</span>'


def _scale(error: float) -> str:
    """A bar on a scale of powers of ten, with a line at the printed size; what it shows stands beside it in numbers."""
    printed = _place(PRINTED_STEADY_ERROR)
    return (
        f'<svg class="scale" viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" height="{_HEIGHT}" aria-hidden="true">'
        f'<rect class="track" y="4" width="{_WIDTH}" height="6" rx="3"/>'
        f'<rect class="bar" y="4" width="{_place(error):.1f}" height="6" rx="3"/>'
        f'<path d="M{printed:.1f} 0V{_HEIGHT}"/></svg>'
    )


def _place(error: float) -> float:
    share = (math.log10(max(error, 10.0**_LEAST)) - _LEAST) / (_MOST - _LEAST)
    return _WIDTH * min(share, 1.0)
