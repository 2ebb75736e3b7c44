"""Write what a run computed, and lose nothing when the chosen folder can't take it."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cosim.errors import CosimError


class OutputError(CosimError):
    """Results can't be written where they should; the message says where they are instead."""


def check_writable(folder: Path) -> None:
    """Make a folder and write into it, before anything is computed.

    Raises
    ------
    OutputError
        It can't be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as stream:
            stream.write(b"can this folder be written?")
    except OSError as error:
        raise OutputError(f"can't write into {folder}: {error.strerror or error}; choose another --out") from error


def write_somewhere(write: Callable[[Path], None], folder: Path) -> None:
    """Call `write(folder)`; when that fails, write into a fresh folder among the temporary files instead.

    Raises
    ------
    OutputError
        `folder` failed; the message names the folder that holds everything, or that none could be written.
    """
    try:
        write(folder)
    except OSError as error:
        problem = f"can't write into {folder}: {error.strerror or error}"
        try:
            rescue = Path(tempfile.mkdtemp(prefix="cosim_results_"))
            write(rescue)
        except OSError as second:
            raise OutputError(f"{problem}; nor among the temporary files: {second}; free some space") from error
        raise OutputError(f"{problem}; the results are in {rescue}") from error


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write indented JSON; floats round-trip.

    Raises
    ------
    OSError
        The file can't be written.
    """
    path.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
