"""A run whose FMU lives in a process of its own, which it may crash or block without harm to the other cases."""

from __future__ import annotations

import dataclasses
import logging
import time as clock
from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path

from cosim.errors import CosimError
from cosim.files.temporary import TemporaryFolder
from cosim.fmi.instance import ProcessEnded
from cosim.fmi.isolation.limits import Limits
from cosim.regression.case import Case, Method, RunError
from cosim.regression.run import RunOptions, run
from cosim.regression.tolerances import Interface
from cosim.results.results import Results

#: So much of what an FMU prints is kept (characters).
_MOST_OUTPUT = 10_000


def run_isolated(
    case: Case,
    path: Path,
    interface: Interface,
    timeout: float,
    method: Method = "CVode",
    options: RunOptions = RunOptions(),  # noqa: B008 (frozen)
) -> tuple[Results, str]:
    """The same as `run`, with an isolated FMU; also what it printed and logged.

    Raises
    ------
    RunError
        The run failed, the FMU ended its process, or it took longer than `timeout` (s).
    """
    began = clock.monotonic()
    with TemporaryFolder() as folder, _logged(options.log) as log:
        output = Path(folder) / "output"
        limits = Limits(lifetime=timeout, output=output)
        chosen = dataclasses.replace(options, isolate=True, limits=limits, timeout=timeout)
        late = RunError(f"{path}: did not end within {timeout:g} s; allow more with --fmu-timeout")
        try:
            results = run(case, path, interface, method, chosen)
        except CosimError as error:
            if clock.monotonic() - began > timeout:
                raise late from error
            if isinstance(error.__cause__, ProcessEnded):
                raise RunError(f"{path}: {error}") from error
            raise
        if clock.monotonic() - began > timeout:
            raise late
        printed = output.read_text(errors="replace") if output.is_file() else ""
    return results, "\n".join(filter(None, (printed.strip(), log.getvalue().strip())))[-_MOST_OUTPUT:]


@contextmanager
def _logged(level: str | None) -> Iterator[StringIO]:
    """What comes to the log of messages, if any is wanted."""
    text, logger = StringIO(), logging.getLogger("cosim.messages")
    handler, before = logging.StreamHandler(text), logger.level
    if level is not None:
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
    try:
        yield text
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
