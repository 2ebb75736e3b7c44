"""Files whose writing was cut off, by a kill or a full disk: all that is whole in them can be read.

Their names end in `.part`; see `cosim.files.whole`.
"""

from __future__ import annotations

import mmap
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.files.whole import is_part
from cosim.results.streams import MAGIC

if TYPE_CHECKING:
    from pyarrow import parquet


def whole_lines(content: bytes) -> bytes:
    """The lines of CSV that are whole; a text between quotes may have several."""
    end = content.rfind(b"\n") + 1
    quotes = content.count(b'"', 0, end)
    while quotes % 2:
        before = content.rfind(b"\n", 0, end - 1) + 1
        quotes -= content.count(b'"', before, end)
        end = before
    return content[:end]


def open_parquet(path: Path) -> parquet.ParquetFile:
    """A Parquet file; of one with `.part`, which `cosim.results.streams` has not finished, all groups that are whole.

    Raises
    ------
    OSError
        It can't be opened.
    pyarrow.ArrowInvalid
        It is not a Parquet file, or nothing in it is whole.
    """
    from pyarrow import parquet

    metadata = _recovered(path) if is_part(path) else None
    return parquet.ParquetFile(path, metadata=metadata)


def _recovered(path: Path) -> Any:
    """Metadata of all groups of a file that are whole; None where there are none.

    The last whole footer is searched for. It says where its group begins, which is where the footer before ends.
    """
    import pyarrow as pa

    if path.stat().st_size < len(MAGIC):
        return None
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        metadata, place = None, len(content)
        while metadata is None and (place := content.rfind(MAGIC, len(MAGIC), place)) >= 0:
            metadata = _footer(content, place + len(MAGIC))
        if metadata is None:
            return None
        found = [metadata]
        while (begin := found[-1].row_group(0).column(0).data_page_offset) > len(MAGIC):
            metadata = _footer(content, begin)
            if metadata is None:
                raise pa.ArrowInvalid(f"it is damaged before byte {begin}")
            found.append(metadata)
    whole = found.pop()
    while found:
        whole.append_row_groups(found.pop())
    return whole


def _footer(content: mmap.mmap, end: int) -> Any:
    """Metadata in the footer that ends there; None where there is none that describes rows."""
    import pyarrow as pa
    from pyarrow import parquet

    first = end - len(MAGIC) - 4
    length = int.from_bytes(content[first : first + 4], "little")
    if not 0 < length <= first - len(MAGIC):
        return None
    try:
        metadata = parquet.read_metadata(pa.BufferReader(MAGIC + content[first - length : end]))
    except (pa.ArrowException, OSError):
        return None
    return metadata if metadata.num_row_groups else None
