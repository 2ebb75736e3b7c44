"""Files that are there whole or not at all: until they are whole, their names end in `.part`."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

#: Ending of the name of a file that is not whole, behind the usual one.
PART = ".part"


def part_of(path: Path) -> Path:
    """Name of a file until it is whole."""
    return path.with_name(f"{path.name}{PART}")


def is_part(path: Path) -> bool:
    """Whether a file is not whole, by its name."""
    return path.suffix == PART


def whole_of(path: Path) -> Path:
    """Name that a file has, or would have got when it was whole."""
    return path.with_suffix("") if is_part(path) else path


def publish(part: Path, path: Path) -> None:
    """Have a file that is whole on the disk, and give it its name; an older one of that name goes.

    Raises
    ------
    OSError
        That fails; an older file is as it was.
    """
    sync(part)
    part.replace(path)
    sync(path.parent)


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Call `write` with another name, and give the file its name when it is whole.

    Raises
    ------
    OSError
        The file can't be written; one of that name is as it was.
    """
    part = part_of(path)
    try:
        write(part)
        publish(part, path)
    except BaseException:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write indented JSON; floats round-trip, and those that are not finite, which JSON lacks, become null.

    Raises
    ------
    OSError
        The file can't be written.
    """
    try:
        text = json.dumps(data, indent=2, allow_nan=False)
    except ValueError:
        text = json.dumps(_without_nonfinite(data), indent=2)
    path.write_text(text + "\n", encoding="utf-8")


def _without_nonfinite(data: Any) -> Any:
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, Mapping):
        return {key: _without_nonfinite(value) for key, value in data.items()}
    return [_without_nonfinite(value) for value in data] if isinstance(data, list | tuple) else data


def sync(path: Path) -> None:
    """Have a file, or the names in a folder, on the disk.

    Raises
    ------
    OSError
        The system can't.
    """
    folder = path.is_dir()
    if folder and os.name == "nt":  # there a folder can't be opened
        return
    handle = os.open(path, os.O_RDONLY if folder else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
