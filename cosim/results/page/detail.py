"""A part of curves with all their values, for a page that has no room for them."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.page.encoding import block, column_of, extremes, times

if TYPE_CHECKING:
    from cosim.results.recorded import Recorded

#: A part of a curve has at most twice so many points: more are not seen.
_MOST_BUCKETS = 2000


def detail(runs: Mapping[str, Recorded], query: Mapping[str, str]) -> dict[str, Any]:
    """Scalars of runs between two times, as the script of a page asks for them.

    Parameters
    ----------
    runs : mapping
        Label -> results, in the order of the page.
    query : mapping
        `names`: scalars as "run:name", one a line; `from` and `to`: times (s).

    Returns
    -------
    dict
        `curves`: for each scalar its `time`, `rows`, `offset`, `scale`, and how many seconds a pair of values stands
        for (`resolution`, None where all are there); `bytes` and `times`: deflated blocks in base64.

    Raises
    ------
    KeyError, ValueError
        The query is not such a one.
    """
    results = list(runs.values())
    first, last = float(query["from"]), float(query["to"])
    columns, curves, irregular = [], [], []
    for line in query["names"].split("\n"):
        number, _, name = line.partition(":")
        run = results[int(number)]
        if name not in run.names:
            raise KeyError(name)
        low = max(int(np.searchsorted(run.time, first)) - 1, 0)
        high = int(np.searchsorted(run.time, last, side="right")) + 1
        values = np.asarray(run[name], dtype=np.float64)[low:high]
        time = run.time[low:high]
        every = -(-len(time) // _MOST_BUCKETS) if len(time) > 2 * _MOST_BUCKETS else 1
        column = column_of(values if every == 1 else extremes(values, every))
        described, content = times(time, every)
        irregular.append(None if content is None else b64encode(content).decode())
        columns.append(column.numbers)
        step = float(time[-1] - time[0]) / max(len(time) - 1, 1)
        curves.append(
            {
                "time": described,
                "rows": len(column.numbers),
                "offset": column.offset,
                "scale": column.scale,
                "resolution": every * step if every > 1 else None,
            }
        )
    return {"curves": curves, "bytes": b64encode(block(columns)).decode(), "times": irregular}
