"""Clusters for the runs: processes of this machine, or an existing Dask cluster; and the transfer of FMUs to them."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from cosim.cluster import client_of, quiet
from cosim.errors import needs
from cosim.sweep import stock
from cosim.sweep.errors import SweepError
from cosim.versions import versions

with needs("sweep"):
    import dask
    from dask.system import CPU_COUNT
    from distributed import Client, LocalCluster, WorkerPlugin

#: Workers that a task of a local sweep may be involved in losing before it is run in isolation.
_LOCAL_DEATHS = 1

#: Run by each worker at its start. A terminal sends Ctrl-C to all processes; here only the sweep itself ends workers.
_DEAF = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"


@contextmanager
def connect(scheduler: str | None = None, workers: int | None = None) -> Iterator[Client]:
    """A client of the scheduler at an address, or of one single-threaded process for each core of this machine.

    Raises
    ------
    SweepError
        Nothing answers at the address, there are no workers, or they have another version of this package.
    """
    if workers is not None and workers < 1:
        raise SweepError(f"{workers} workers can't run anything; use at least one")
    if scheduler is not None and workers is not None:
        raise SweepError("--workers starts processes here; a scheduler has its own: leave out --workers or --scheduler")
    with quiet():
        if scheduler is None:
            with ExitStack() as started:
                try:
                    cluster = started.enter_context(_local(workers or CPU_COUNT))
                    client = started.enter_context(Client(cluster, set_as_default=False))
                except TimeoutError as error:
                    raise SweepError(
                        "worker processes did not start in time, because this machine is busy; try again, or with "
                        "fewer of them (--workers)"
                    ) from error
                yield client
        else:
            with _remote(scheduler) as client:
                yield client


def _local(workers: int) -> LocalCluster:
    options = {
        "distributed.scheduler.allowed-failures": _LOCAL_DEATHS,
        # samples the stack 100 times a second, for a page that is not shown
        "distributed.worker.profile.enabled": False,
        # each process of Dask looks after itself so often, on the cores that run simulations; tasks take seconds
        "distributed.admin.tick.interval": "1s",
        "distributed.admin.system-monitor.interval": "5s",
        "distributed.worker.memory.monitor-interval": "1s",
    }
    with dask.config.set(options):
        return LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address="127.0.0.1:0",  # any free port, for another cluster may run here; for this machine only
            silence_logs=logging.CRITICAL,
            preload=_DEAF,
        )


def are_workers_starting(client: Client) -> bool:
    """Whether there are processes that will be workers: of those that are started here, one that ends is replaced."""
    nannies = [] if client.cluster is None else list(client.cluster.workers.values())
    return any(nanny.pid is not None for nanny in nannies)


@contextmanager
def _remote(scheduler: str) -> Iterator[Client]:
    with client_of(scheduler, SweepError) as client:
        _check_versions(client)
        yield client


def _check_versions(client: Client) -> None:
    """Workers that join later are checked by the first task they get."""
    name = "closed-chain-cosim"
    own = versions()[name]
    # a function of the standard library: one of ours could not be called where ours is missing
    for worker, found in client.run(version, name, on_error="return").items():
        if found != own:
            has = "none" if isinstance(found, BaseException) else found
            raise SweepError(f"worker {worker} has {name} {has}, here it is {own}; install the same version there")


class Parcel(WorkerPlugin):
    """Bytes on their way to each worker, named by their contents: what a cluster has already is not sent again.

    The scheduler keeps a plugin and hands it to each worker process when it registers, also to one that joins or
    restarts later. Scattered data would be lost with the worker that happens to hold it.
    """

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
    except TimeoutError as error:
        raise SweepError("the workers do not answer; check them, and continue with the same command") from error
    except OSError as error:
        raise SweepError(f"a worker can't store a file: {error}; free some space there") from error
    return parcel.sha256
