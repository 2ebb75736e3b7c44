"""Results that a tool wrote as CSV."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np


def read_columns(file: Path) -> dict[str, np.ndarray]:
    """Column name -> values (n,).

    Raises
    ------
    RuntimeError
        There is no such file: the tool that should have written it failed.
    """
    if not file.is_file():
        raise RuntimeError("it ended without results")
    with file.open(encoding="utf-8", newline="") as lines:
        header, *rows = csv.reader(lines)
    table = np.array([[float(cell) for cell in row] for row in rows])
    return dict(zip(header, table.T, strict=True))
