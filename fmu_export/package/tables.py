"""Lookup tables are data inside an FMU: its instances read them from `resources/tables`."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from fmu_export.errors import ArgumentError, ModelError
from fmu_export.modelling.tables import Table, table_of_text
from fmu_export.package.archive import replace_members

FOLDER = "resources/tables/"


class TableError(ModelError, ValueError):
    """A lookup table can't be written into an FMU; the message says why, and the file is unchanged."""


def table_members(tables: Iterable[Table]) -> dict[str, bytes]:
    """Members of an archive that hold tables."""
    return {f"{FOLDER}{table.name}.csv": table.text.encode() for table in tables}


def write_table(
    fmu: str | PathLike[str],
    name: str,
    x: Sequence[float] | Any,
    y: Sequence[float] | Any,
    z: Sequence[Sequence[float]] | Any = None,
) -> None:
    """Replace the data of a lookup table in an FMU file, atomically; the number of breakpoints may be another.

    Parameters
    ----------
    fmu : path
        An FMU that `build_native` wrote.
    name : str
        Of the table; one that `np.interp` has made is `interp_1` and so on.
    x : sequence of float
        Breakpoints (n,), increasing.
    y : sequence of float
        Values (n,), or the breakpoints (m,) of the second variable.
    z : sequence of sequence of float, optional
        Values (n, m) of a table over two variables.

    Raises
    ------
    TableError
        Not an FMU of this kind, no table of this name or with this number of variables, or data that are no table.
    OSError
        The file can't be read or written; it is unchanged.
    """
    path = Path(fmu)
    try:
        with zipfile.ZipFile(path) as archive:
            known = sorted(n.removeprefix(FOLDER) for n in archive.namelist() if n.startswith(FOLDER))
            member = f"{FOLDER}{name}.csv"
            if f"{name}.csv" not in known:
                tables = ", ".join(n.removesuffix(".csv") for n in known) or "none"
                raise TableError(f"{path}: no table '{name}'; its tables are {tables}")
            before = table_of_text(archive.read(member).decode("utf-8-sig"), name, f"{path}: {member}")
        table = Table(name, x, y, z)
        if table.n_variables != before.n_variables:
            raise TableError(f"{path}: table '{name}' has {before.n_variables} variables, not {table.n_variables}")
        replace_members(path, {member: table.text.encode()})
    except (zipfile.BadZipFile, zlib.error):
        raise TableError(f"{path}: not an FMU (not a zip archive, or a damaged one)") from None
    except (ArgumentError, UnicodeDecodeError) as error:
        raise TableError(f"{path}: {error}") from None
