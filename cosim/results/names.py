"""Scalar names `component.variable[i]`, and the vectors whose elements they are."""

from __future__ import annotations

import re
from collections.abc import Sequence

#: At the end of the name of an element; no vector has so many that an index has more digits.
_INDICES = re.compile(r"\[\d{1,18}(,\d{1,18})*\]$")


def grouped(names: Sequence[str]) -> dict[str, list[int]]:
    """Scalars and vectors -> positions of their elements, in the order of their first ones.

    >>> grouped(["a.x", "a.v[1]", "a.v[2]", "b.y"])
    {'a.x': [0], 'a.v': [1, 2], 'b.y': [3]}
    """
    groups: dict[str, list[int]] = {}
    known = set(names)
    for i, name in enumerate(names):
        stem = _INDICES.sub("", name)
        groups.setdefault(name if stem in known else stem, []).append(i)
    return groups


def labels(names: Sequence[str]) -> dict[str, list[int]]:
    """As `grouped`, but a vector's label has its range of indices.

    >>> labels(["a.x", "a.v[1]", "a.v[2]"])
    {'a.x': [0], 'a.v[1..2]': [1, 2]}
    """
    found = {}
    for name, positions in grouped(names).items():
        first, last = (names[positions[i]] for i in (0, -1))
        vector = len(positions) > 1
        found[f"{first[:-1]}..{last.removeprefix(name + '[')}" if vector else first] = positions
    return found


def vectors(names: Sequence[str]) -> dict[str, list[int]]:
    """Vectors -> positions of their elements, in the order of their indices.

    >>> vectors(["a.x", "a.v[2]", "a.v[1]"])
    {'a.v': [2, 1]}
    """
    found: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        if indices := _INDICES.search(name):
            found.setdefault(name[: indices.start()], []).append(i)
    for stem, positions in found.items():
        positions.sort(key=lambda i: [int(k) for k in re.findall(r"\d+", names[i][len(stem) :])])
    return found
