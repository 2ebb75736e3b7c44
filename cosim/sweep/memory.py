"""A worker that runs one simulation after the other keeps its memory for the next one."""

from __future__ import annotations

import ctypes
import gc
import sys
from functools import cache

#: Parameters of glibc's mallopt, and the largest block (bytes) that it lets come from the heap.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _LARGEST = -1, -3, 32 << 20


@cache  # once in each process
def keep_memory() -> None:
    """Have freed memory kept, and leave what is imported out of the garbage collections.

    Dask starts its workers with `MALLOC_TRIM_THRESHOLD_`: glibc then returns each large array to the system as soon as
    it is freed, and a run gets its memory page by page again; that took an eighth of the time of a run. A worker keeps
    no more than its largest run needs.
    """
    gc.freeze()
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # not every libc is glibc
        if mallopt is not None:
            mallopt(_M_MMAP_THRESHOLD, _LARGEST)
            mallopt(_M_TRIM_THRESHOLD, 8 * _LARGEST)
