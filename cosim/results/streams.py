"""Files that grow by batches of rows, and can be read up to the last batch whenever their writing ends.

CSV is cut back to its last whole line. Parquet says only at its very end where its columns are; here each group of rows
is followed by a footer of its own, so that a file which a kill or a full disk has cut off can be read
(`cosim.results.unfinished`). To other readers these footers are gaps between groups.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from cosim.errors import ResultsError
from cosim.results.headings import heading

if TYPE_CHECKING:
    import pyarrow as pa

#: How much of the end of a CSV file is searched for its last line.
_TAIL = 1 << 20

#: Bytes at the beginning of a Parquet file, and at the end of each footer.
MAGIC = b"PAR1"


class StreamWriter(Protocol):
    """A file that grows by batches of rows."""

    def write(self, batch: pa.RecordBatch) -> None:
        """Append rows."""

    def close(self) -> None:
        """Finish the file."""

    def abandon(self) -> None:
        """Close the file after a failure, with the rows that are whole; never fails itself."""


class CsvStream:
    """A CSV file that grows, if wanted with a row of units; binary values are written with digits of base 16.

    Raises
    ------
    OSError
        It can't be written.
    """

    def __init__(self, path: Path, schema: pa.Schema, *, units_row: bool = False) -> None:
        import pyarrow as pa
        from pyarrow import csv

        self._path = path
        self._binary = [i for i, kind in enumerate(schema.types) if pa.types.is_binary(kind)]
        for i in self._binary:
            schema = schema.set(i, schema.field(i).with_type(pa.string()))
        schema = pa.schema(field.with_name(heading(field.name)) for field in schema)
        self._schema = schema
        self._has_texts = any(pa.types.is_string(kind) for kind in schema.types)
        self._file = pa.OSFile(str(path), "wb")
        if units_row:
            units = [(field.metadata or {}).get(b"unit", b"").decode() for field in schema]
            for row in (schema.names, ["s", *units[1:]]):
                cells = ('"{}"'.format(cell.replace('"', '""')) for cell in row)
                self._file.write((",".join(cells) + "\n").encode())
        options = csv.WriteOptions(include_header=not units_row)
        # the shortest digits that read back to the same number
        self._writer = csv.CSVWriter(self._file, schema, write_options=options)
        self._end = self._file.tell()  # of what is whole

    def write(self, batch: pa.RecordBatch) -> None:
        """See `StreamWriter`."""
        import pyarrow as pa

        columns = batch.columns
        for i in self._binary:
            columns[i] = pa.array([value.hex() for value in columns[i].to_pylist()], pa.string())
        self._writer.write(pa.record_batch(columns, schema=self._schema))
        self._end = self._file.tell()

    def close(self) -> None:
        """See `StreamWriter`."""
        self._writer.close()
        self._file.close()

    def abandon(self) -> None:
        """See `StreamWriter`."""
        for close in (self._writer.close, self._file.close):
            with suppress(OSError, ValueError):
                close()
        with suppress(OSError):
            os.truncate(self._path, self._end if self._has_texts else _end_of_lines(self._path, self._end))


def _end_of_lines(path: Path, whole: int) -> int:
    """Where the last whole line of a file ends whose first bytes are `whole`."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        first = file.seek(max(whole, size - _TAIL))
        return max(whole, first + file.read().rfind(b"\n") + 1)


def descriptor_of(file: Any, path: Path) -> int:
    """The descriptor of a file that pyarrow has open for writing.

    `fileno` of pyarrow's files fails in many versions, at least from 17 to 24; it is then searched for.

    Raises
    ------
    ResultsError
        It is not found.
    """
    with suppress(AttributeError):
        return int(file.fileno())
    written, open_ones = path.stat(), Path("/dev/fd")
    for name in os.listdir(open_ones) if open_ones.is_dir() else ():  # noqa: PTH208 -- their targets do not matter
        import fcntl

        with suppress(OSError):  # the one that listed them is closed
            number = int(name)
            writes = fcntl.fcntl(number, fcntl.F_GETFL) & os.O_ACCMODE != os.O_RDONLY
            if writes and os.path.samestat(os.fstat(number), written):
                return number
    raise ResultsError(
        "this version of pyarrow can't go on with a Parquet file; update it: pip install --upgrade pyarrow"
    )


class ParquetStream:
    """A Parquet file that grows by a group of rows at each `write`.

    Raises
    ------
    OSError
        It can't be written.
    """

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        import pyarrow as pa

        self._path, self._schema = path, schema
        self._file = pa.OSFile(str(path), "wb")
        self._descriptor = descriptor_of(self._file, path)
        self._end = 0  # of the groups that are whole
        self._metadata: Any = None  # of all of them
        self._groups = 0

    def write(self, batch: pa.RecordBatch) -> None:
        """See `StreamWriter`."""
        self._write([batch] if batch.num_rows else [])

    def _write(self, batches: list[pa.RecordBatch]) -> None:
        from pyarrow import parquet

        # pyarrow begins a file at its beginning only, and writes there what stands there already
        os.lseek(self._descriptor, 0, os.SEEK_SET)
        # numbers of a simulation hardly repeat: dictionaries and compression cost more than they save
        writer = parquet.ParquetWriter(self._file, self._schema, use_dictionary=False, compression="none")
        os.lseek(self._descriptor, max(self._end, len(MAGIC)), os.SEEK_SET)
        try:
            for batch in batches:
                writer.write_batch(batch)
        except BaseException:
            with suppress(Exception):  # else it would write when its memory is freed, wherever the file is then
                writer.close()
            raise
        writer.close()
        self._end = self._file.tell()
        if self._metadata is None:
            self._metadata = writer.writer.metadata
        else:
            self._metadata.append_row_groups(writer.writer.metadata)
        self._groups += 1

    def close(self) -> None:
        """See `StreamWriter`."""
        if not self._groups:
            self._write([])
        if self._groups > 1:
            self._metadata.write_metadata_file(self._file)
        self._file.close()

    def abandon(self) -> None:
        """See `StreamWriter`."""
        with suppress(OSError):
            os.lseek(self._descriptor, self._end, os.SEEK_SET)
            self._file.close()
        with suppress(OSError):
            os.truncate(self._path, self._end)
