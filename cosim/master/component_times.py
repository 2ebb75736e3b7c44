"""Where the time of a run goes: steps and exchange of each component, measured at some of its communication points."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping, Sequence
from typing import Any

from cosim.loop.binding import Operation, OperationKind, Predicted, Profile
from cosim.master.operations import Exchange, NamedOperation

#: One point in so many is measured: rare enough to cost nothing, and a prime number, so that components with a
#: communication point at every so many are seen as often as they take part.
_ONE_IN = 61

#: A run with fewer points than this times that has more of them measured.
_AT_LEAST = 10

#: What a component does, in the words of the summary.
_STEPPING = (OperationKind.STEP, OperationKind.CALL, OperationKind.GROUP)

#: What components in model exchange, which are integrated together, are called.
_TOGETHER = "model exchange"


class ComponentTimes:
    """Times of the operations of a run, which the loop measures.

    Parameters
    ----------
    exchange : Exchange
        The operations of the run.
    n_points : int
        Number of its communication points.

    Attributes
    ----------
    profile : Profile
        What the loop takes.
    """

    def __init__(self, exchange: Exchange, n_points: int) -> None:
        self._exchange = exchange
        self._at_point = (ctypes.c_int64 * max(1, len(exchange.at_point)))()
        self._at_step = (ctypes.c_int64 * max(1, len(exchange.at_step)))()
        self._predicted = _Predicted(exchange)
        self.profile = Profile(
            max(1, min(_ONE_IN, n_points // _AT_LEAST)), self._at_point, self._at_step, 0, 0, self._predicted.pointer
        )

    def summary(self, n_points: int, repeated: Mapping[str, int]) -> dict[str, Any]:
        """Seconds of each component, extrapolated from the measured points to all.

        Parameters
        ----------
        n_points : int
            Number of communication points of the run up to now.
        repeated : mapping
            Component -> number of communication steps that it discarded.

        Returns
        -------
        dict
            "measured_points", and "components": for each "steps", "steps_s", "exchange_s", "steps_repeated". And
            "connections", the worst first: "source", "target", and "error", by how much the target was not what it was
            predicted to be a step before (rms, relative to its largest magnitude).
        """
        every = {name: component.every for name, component in self._exchange.components.items()}
        found: dict[str, dict[str, Any]] = {
            name: {
                "steps": max(0, n_points - 1) // n if n_points else 0,
                "steps_s": 0.0,
                "exchange_s": 0.0,
                "steps_repeated": repeated.get(name, 0),
            }
            for name, n in every.items()
        }
        if any(row.integrates for row in self._exchange.at_step.rows):
            steps = max(0, n_points - 1)
            found[_TOGETHER] = {"steps": steps, "steps_s": 0.0, "exchange_s": 0.0, "steps_repeated": 0}
        _add(found, self._exchange.at_point.rows, self._at_point, n_points / max(1, self.profile.n_points))
        _add(found, self._exchange.at_step.rows, self._at_step, max(0, n_points - 1) / max(1, self.profile.n_steps))
        return {
            "measured_points": self.profile.n_points,
            "components": found,
            "connections": self._predicted.summary(),
        }


class _Predicted:
    """How well inputs go to what comes out: predictor against corrector, at the points that are measured.

    It ranks connections, and does not measure the coupling error: a torque that is wrong by a per mille may move a
    robot by a millionth.
    """

    def __init__(self, exchange: Exchange) -> None:
        self._links = exchange.predicted_links()
        n = len(self._links)
        positions = (ctypes.c_int32 * max(1, n))(*(position for _, position in self._links))
        self._values = (ctypes.c_double * max(1, len(exchange.values)))()
        self._squares, self._sizes = (ctypes.c_double * max(1, n))(), (ctypes.c_double * max(1, n))()
        steps = ctypes.cast(exchange.steps.operations, ctypes.POINTER(Operation))
        self._told = Predicted(
            *(steps, len(exchange.steps), positions, self._values, self._squares, self._sizes),
            *(len(exchange.values), 0, n, 0),
        )

    @property
    def pointer(self) -> Any:
        """What the loop takes."""
        return ctypes.pointer(self._told) if self._links else None

    def summary(self) -> list[dict[str, Any]]:
        """Connections with their errors, the largest first."""
        points = max(1, self._told.n_points)
        found = [
            {
                "source": f"{link.source_component}.{link.source.name}",
                "target": f"{link.target_component}.{link.target.name}",
                "error": math.sqrt(square / points) / size if size else 0.0,
            }
            for (link, _), square, size in zip(self._links, self._squares, self._sizes, strict=False)
        ]
        return sorted(found, key=lambda each: -each["error"])


def _add(found: dict[str, dict[str, Any]], rows: Sequence[NamedOperation], times: Any, times_as_many: float) -> None:
    for row, nanoseconds in zip(rows, times, strict=False):
        name = row.component or (_TOGETHER if row.integrates else "")
        if name:
            key = "steps_s" if row.operation.kind in _STEPPING else "exchange_s"
            found[name][key] += nanoseconds * 1e-9 * times_as_many
