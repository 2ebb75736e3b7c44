"""A Dask cluster on this machine, of processes of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from distributed import Client

from tests.support import CHECKOUT
from tests.support.patience import wait_for


class Cluster:
    """A scheduler and workers on this machine, each started as on any cluster."""

    def __init__(self, folder: Path, **settings: str) -> None:
        self.folder = folder
        self.settings = settings  # of the environment
        self.processes: list[subprocess.Popen[bytes]] = []
        file = folder / "scheduler.json"
        where = ("--host", "tls://127.0.0.1" if settings else "127.0.0.1", "--port", "0")
        self.scheduler = self._start("scheduler", *where, "--scheduler-file", str(file))
        self.address: str = wait_for(lambda: file.is_file() and json.loads(file.read_text() or "{}").get("address"))

    def worker(self, *options: str) -> subprocess.Popen[bytes]:
        """Start a worker with one thread that nobody restarts when it dies."""
        usual = ("--nthreads", "1", "--no-nanny", "--local-directory", str(self.folder / "local"))
        return self._start("worker", self.address, *usual, *options)

    def _start(self, kind: str, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *arguments, "--no-dashboard"]
        log = (self.folder / f"{kind}{len(self.processes)}.log").open("wb")
        with log:
            started = subprocess.Popen(
                command,
                stdout=log,
                stderr=log,
                cwd=self.folder,
                # the workers import the study of the tests
                env={**os.environ, **self.settings, "PYTHONPATH": str(CHECKOUT)},
            )
        self.processes.append(started)
        return started

    def ask(self, question: Callable[..., Any]) -> dict[str, object]:
        """Answers of a function on all workers."""
        with Client(self.address, set_as_default=False) as client:
            return client.run(question)

    def close(self) -> None:
        for started in self.processes:
            started.kill()
            started.wait()
