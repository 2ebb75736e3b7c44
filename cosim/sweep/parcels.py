"""How FMUs and the study reach the workers: once each, also those that join or restart later.

Dask's worker plugins do just that: the scheduler keeps their bytes and hands them to each worker process when it
registers. Scattered data would be lost with the worker that happens to hold it.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from distributed import Client, WorkerPlugin

from cosim.sweep import stock
from cosim.sweep.errors import SweepError


class Parcel(WorkerPlugin):
    """Bytes on their way to each worker, named by their contents: what a cluster has already is not sent again."""

    idempotent = True

    def __init__(self, data: bytes) -> None:
        self.sha256 = hashlib.sha256(data).hexdigest()
        self.name = f"cosim-parcel-{self.sha256}"
        self._data = data

    def setup(self, worker: Any) -> None:
        """Put the bytes on the worker's disk."""
        stock.put(self.sha256, self._data, Path(worker.local_directory) / "cosim")
        self._data = b""  # the plugin lives as long as the worker


def deliver(client: Client, data: bytes) -> str:
    """Send bytes to all workers, present and future; returns their SHA-256.

    Raises
    ------
    SweepError
        A worker can't take them.
    """
    parcel = Parcel(data)
    try:
        client.register_plugin(parcel)
    except OSError as error:
        raise SweepError(f"a worker can't store a file: {error}; free some space there") from error
    return parcel.sha256
