"""Dask clusters that are there already: the client of a scheduler, and silence about what it reports at length."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from cosim.errors import CosimError, needs

if TYPE_CHECKING:
    from distributed import Client

#: Longest time (s) to wait for an answer of the scheduler, and for a first worker.
_ANSWER, _FIRST_WORKER = 30.0, 30.0


def client_of(scheduler: str, error: type[CosimError]) -> Client:
    """A client of the scheduler at an address, which has workers; to be closed.

    Parameters
    ----------
    scheduler : str
        Address, as tcp://host:8786.
    error : type
        What is raised.

    Raises
    ------
    CosimError
        Nothing answers at the address, or there are no workers; or `distributed` is not installed.
    """
    with needs("sweep"):
        from distributed import Client
    try:
        client = Client(scheduler, timeout=_ANSWER, set_as_default=False)
    except (OSError, ValueError) as no_answer:
        raise error(f"--scheduler {scheduler}: no answer: {' '.join(str(no_answer).split())}") from no_answer
    try:
        client.wait_for_workers(1, timeout=_FIRST_WORKER)
    except TimeoutError:
        client.close()
        raise error(
            f"--scheduler {scheduler} has no workers; start some: dask worker {scheduler} --nthreads 1"
        ) from None
    except BaseException:
        client.close()
        raise
    return client


def workers_of(client: Client) -> dict[str, dict[str, Any]]:
    """What the scheduler knows of each worker, by its address."""
    scheduler: Any = client.scheduler
    known: dict[str, dict[str, Any]] = client.sync(scheduler.identity)["workers"]
    return known


@contextmanager
def quiet() -> Iterator[None]:
    """Dask reports each lost worker and connection at length; here they are no failure, or an error of one line."""
    loggers = [logging.getLogger(name) for name in logging.root.manager.loggerDict if name.startswith("distributed")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)
