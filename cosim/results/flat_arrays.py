"""Arrays of several dimensions in tables that count their elements in one."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Collection, Mapping

from cosim.results.names import grouped, vectors
from cosim.results.results import Results


def with_names_of(table: Results, known: Collection[str]) -> Results:
    """A table whose columns `M[1]`, `M[2]`, ... have the names `M[1,1]`, `M[1,2]`, ... where those are known.

    Tables with the elements of an array in one cell say nothing of its shape. Columns that are not as many as the
    elements keep their names.
    """
    names = [name for name in known if re.search(r"\[\d+,", name)]
    known_vectors, renamed = vectors(names), dict[str, str]()
    for stem, positions in grouped(table.names).items() if names else ():
        flat = [f"{stem}[{i + 1}]" for i in range(len(positions))]
        found = known_vectors.get(stem, [])
        if [table.names[i] for i in positions] == flat and len(found) == len(flat):
            renamed |= zip(flat, (names[i] for i in found), strict=True)
    return with_other_names(table, renamed) if renamed else table


def with_other_names(table: Results, renamed: Mapping[str, str]) -> Results:
    """A table with other names for some columns."""
    return dataclasses.replace(
        table,
        names=[renamed.get(name, name) for name in table.names],
        info={**table.info, "units": {renamed.get(name, name): unit for name, unit in table.units.items()}},
        typed={renamed.get(name, name): column for name, column in table.typed.items()},
    )
