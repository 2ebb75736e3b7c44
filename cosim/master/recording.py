"""Memory that the stepping loop records to: an array for the whole run, or a buffer passed on chunk by chunk."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, Protocol

import numpy as np

from cosim.errors import SetupError
from cosim.fmi.types import FmiType, Texts
from cosim.results.columns import TypedColumn

#: Takes the times (n,) and the values (n, columns) of a chunk; both are only valid during the call. Values are doubles,
#: or, where something is recorded that is not a real number, objects: float, int, bool, str or bytes.
Sink = Callable[[np.ndarray, np.ndarray], None]

#: What becomes of a run with a recorded value that is not finite: it ends there, or goes on and says so.
NonFinite = Literal["error", "mark"]

#: Values in the buffer of a run that is passed on.
_BUFFERED_VALUES = 1_000_000


class RecordedColumns:
    """The columns of the records: slots of some types.

    Parameters
    ----------
    names : sequence of str
    types : sequence of FmiType
        One a name.
    texts : Texts
        Of the system.
    """

    def __init__(self, names: Sequence[str], types: Sequence[FmiType], texts: Texts) -> None:
        self._names = list(names)
        self._real = np.array([t.kind == "real" for t in types], dtype=bool)
        self._columns = [(i, n, t) for i, (n, t) in enumerate(zip(names, types, strict=True)) if t.kind != "real"]
        self._texts = texts

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return self._names

    @property
    def texts(self) -> Texts:
        """Texts of the system."""
        return self._texts

    @property
    def types(self) -> dict[str, str]:
        """Name -> type of what is not a real number; see `TypedColumn`."""
        return {name: fmi_type.column for _, name, fmi_type in self._columns}

    def typed(self, slots: np.ndarray) -> dict[str, TypedColumn]:
        """Columns of what is not a real number in slots (n, columns)."""
        return {
            name: TypedColumn(fmi_type.column, fmi_type.from_slots(slots[:, i], self._texts))
            for i, name, fmi_type in self._columns
        }

    def not_finite(self, slots: np.ndarray) -> np.ndarray | None:
        """Which values in slots (n, columns) are not finite, as truth values of that shape; None where all are."""
        if not slots.size:
            return None
        real = slots if self._real.all() else slots[:, self._real]
        # a sum is finite only if all its terms are, and takes a fraction of the time
        with np.errstate(all="ignore"):
            if np.isfinite(real.sum()):
                return None
        found = ~np.isfinite(slots) & self._real
        return found if found.any() else None

    def first_not_finite(self, slots: np.ndarray) -> tuple[int, str] | None:
        """The first row of slots (n, columns) with a value that is not finite, and its name."""
        found = self.not_finite(slots)
        if found is None:
            return None
        row, column = np.argwhere(found)[0].tolist()
        return row, self._names[column]

    def numbers(self, slots: np.ndarray, typed: Mapping[str, TypedColumn]) -> np.ndarray:
        """Real numbers (n, columns) for slots (n, columns) with these typed columns."""
        if not self._columns:
            return slots
        numbers = slots.copy()
        for i, name, _ in self._columns:
            numbers[:, i] = typed[name].numbers
        return numbers

    def values(self, slots: np.ndarray) -> np.ndarray:
        """Values (n, columns) for slots (n, columns), as a `Sink` gets them."""
        if not self._columns:
            return slots
        values = slots.astype(object)
        for i, _, fmi_type in self._columns:
            values[:, i] = fmi_type.from_slots(slots[:, i], self._texts).tolist()
        return values


class Marks:
    """Variables that were not finite: name -> time (s) of the first such row, and number of such rows."""

    def __init__(self, columns: RecordedColumns) -> None:
        self._columns = columns
        self.found: dict[str, dict[str, Any]] = {}

    def look(self, times: np.ndarray, slots: np.ndarray) -> None:
        """Look at further rows: times (n,) and slots (n, columns)."""
        not_finite = self._columns.not_finite(slots)
        if not_finite is None:
            return
        for i in np.flatnonzero(not_finite.any(axis=0)).tolist():
            rows = np.flatnonzero(not_finite[:, i])
            mark = self.found.setdefault(self._columns.names[i], {"time": float(times[rows[0]]), "rows": 0})
            mark["rows"] += len(rows)


class Recorder(Protocol):
    """Interface that the loop needs: memory for rows, and a report of how many are full.

    Attributes
    ----------
    capacity : int or None
        Rows that there is room for at once; None: for all.
    """

    capacity: int | None

    def room(self, first: int, end: int) -> tuple[np.ndarray, int]:
        """Array for the rows first ... end - 1, and the number of its first row."""
        ...

    def recorded(self, end: int) -> None:
        """All rows before `end` are recorded."""
        ...

    def result(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (n,) and values (n, columns)."""
        ...


class InMemory:
    """All rows in one array."""

    capacity: int | None = None

    def __init__(self, times: Callable[[int, int], np.ndarray], rows: int, columns: int) -> None:
        self._times = times
        try:
            self._values = np.empty((rows, columns))
        except MemoryError:
            raise SetupError(
                f"{columns} values at {rows} communication points need {8e-9 * rows * columns:.3g} GB of memory; "
                "make the step longer, record less (record, record_every), or pass a sink"
            ) from None
        self._end = 0

    def room(self, first: int, end: int) -> tuple[np.ndarray, int]:  # noqa: ARG002
        """See `Recorder`."""
        return self._values, 0

    def recorded(self, end: int) -> None:
        """See `Recorder`."""
        self._end = end

    def result(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Recorder`."""
        return self._times(0, self._end), self._values[: self._end]


class Growing:
    """All rows in one array, which grows: for runs whose end is not known."""

    capacity: int | None = None

    def __init__(self, times: Callable[[int, int], np.ndarray], columns: int) -> None:
        self._times = times
        self._values = np.empty((64, columns))
        self._first = self._end = 0

    @property
    def size(self) -> int:
        """Number of values in memory."""
        return (self._end - self._first) * self._values.shape[1]

    def room(self, first: int, end: int) -> tuple[np.ndarray, int]:  # noqa: ARG002
        """See `Recorder`."""
        needed = end - self._first
        if needed > len(self._values):
            grown = np.empty((max(needed, 2 * len(self._values)), self._values.shape[1]))
            grown[: self._end - self._first] = self._values[: self._end - self._first]
            self._values = grown
        return self._values, self._first

    def recorded(self, end: int) -> None:
        """See `Recorder`."""
        self._end = end

    def result(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Recorder`."""
        return self._times(self._first, self._end), self._values[: self._end - self._first]

    def replace(self, values: np.ndarray) -> None:
        """Take over the rows (n, columns) of another run."""
        self._values, self._first, self._end = values.copy(), 0, len(values)

    def begin_at(self, row: int) -> None:
        """Forget all rows, which are kept elsewhere; the next one has this number."""
        self._first = self._end = row


class PassedOn:
    """Rows in a buffer that goes to a sink when it is full."""

    def __init__(self, times: Callable[[int, int], np.ndarray], rows: int, columns: int, sink: Sink) -> None:
        self._times, self._sink = times, sink
        self._buffer = np.empty((min(rows, max(1, _BUFFERED_VALUES // max(1, columns))), columns))
        self._first = self._end = 0
        self.capacity: int | None = len(self._buffer)

    def room(self, first: int, end: int) -> tuple[np.ndarray, int]:
        """See `Recorder`; `end - first` must not be more than `capacity`."""
        if end - self._first > len(self._buffer):
            self._pass_on()
            self._first = first
        return self._buffer, self._first

    def recorded(self, end: int) -> None:
        """See `Recorder`."""
        self._end = end

    def result(self) -> tuple[np.ndarray, np.ndarray]:
        """Nothing is left: the sink has it all."""
        self._pass_on()
        self._first = self._end
        return np.empty(0), np.empty((0, self._buffer.shape[1]))

    def _pass_on(self) -> None:
        if self._end > self._first:
            self._sink(self._times(self._first, self._end), self._buffer[: self._end - self._first])


class Observed:
    """A recorder that shows further rows to somebody as they come.

    Parameters
    ----------
    recorder : Recorder
        Keeps the rows, or passes them on.
    times : callable
        Times (n,) of the rows first ... end - 1.
    values : callable
        Values of slots, as `observe` gets them.
    observe : callable
        Takes times (n,) and values (n, columns); both are only valid during the call.
    """

    def __init__(
        self,
        recorder: Recorder,
        times: Callable[[int, int], np.ndarray],
        values: Callable[[np.ndarray], np.ndarray],
        observe: Sink,
    ) -> None:
        self._recorder, self._times, self._values, self._observe = recorder, times, values, observe
        self._seen = self._first = 0
        self._rows = np.empty((0, 0))
        self.capacity = recorder.capacity

    def room(self, first: int, end: int) -> tuple[np.ndarray, int]:
        """See `Recorder`."""
        self._rows, self._first = self._recorder.room(first, end)
        return self._rows, self._first

    def recorded(self, end: int) -> None:
        """See `Recorder`."""
        self._recorder.recorded(end)
        if end > self._seen:
            first, self._seen = self._seen, end
            self._observe(self._times(first, end), self._values(self._rows[first - self._first : end - self._first]))

    def result(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Recorder`."""
        return self._recorder.result()
