"""Tables in MAT files: trajectories of Dymola and OpenModelica, and vectors that MATLAB saved beside their time."""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from cosim.errors import ResultsError, needs
from cosim.results.assembly import assembled, check_seconds, is_time
from cosim.results.formats import Contents

#: Precisions of matrices in a MAT file of version 4, by the tens of their type.
_PRECISIONS = ("f8", "f4", "i4", "i2", "u2", "u1")

#: Length of the header of a matrix.
_HEADER = 20


def read_mat(path: Path) -> Contents:
    """Read a MAT file.

    Raises
    ------
    ResultsError
        It is none, or no trajectory and without a vector `time`.
    MissingExtra
        It is one of version 5 or later, and SciPy is not installed.
    """
    data = path.read_bytes()
    if data.startswith(b"MATLAB 7.3"):
        raise ResultsError(f"{path}: is a MAT file of version 7.3 (HDF5); save it with -v7")
    matrices = _version_5(path) if data.startswith(b"MATLAB") else _version_4(path, data)
    if {"Aclass", "name", "dataInfo"} <= matrices.keys():
        return _trajectory(path, matrices)
    times = [name for name in matrices if is_time(name)]
    if len(times) != 1:
        raise ResultsError(f"{path}: has {len(times) or 'no'} variables of the name 'time'; save one, in s")
    time = np.squeeze(matrices.pop(times[0]))
    columns = []
    for name, matrix in matrices.items():
        if matrix.dtype.kind not in "biuf" or matrix.ndim != 2 or time.ndim != 1 or len(time) not in matrix.shape:
            raise ResultsError(f"{path}: '{name}' has no row for each time; save vectors of the length of '{times[0]}'")
        if matrix.shape[0] != len(time):
            matrix = matrix.T
        columns.append((name, matrix[:, 0] if matrix.shape[1] == 1 else matrix))
    return assembled(path, time, columns)


def _version_5(path: Path) -> dict[str, np.ndarray]:
    with needs("sweep"):
        from scipy.io import loadmat
    try:
        found: dict[str, Any] = loadmat(path)
    except Exception as error:  # whatever SciPy raises on broken files
        raise ResultsError(f"{path}: can't be read as a MAT file: {' '.join(str(error).split())}") from error
    return {name: np.asarray(matrix) for name, matrix in found.items() if not name.startswith("__")}


def _version_4(path: Path, data: bytes) -> dict[str, np.ndarray]:
    """Matrices of a file ("MAT-File Format", MathWorks); those of text as their characters."""
    matrices: dict[str, np.ndarray] = {}
    position = 0
    while position < len(data):
        if position + _HEADER > len(data):
            raise ResultsError(f"{path}: is not a MAT file, or ends early")
        order = "<" if struct.unpack_from("<i", data, position)[0] < 1000 else ">"
        kind, rows, columns, imaginary, length = struct.unpack_from(f"{order}5i", data, position)
        big, rest = divmod(kind, 1000)
        precision, text = rest // 10, rest % 10
        first = position + _HEADER + length
        sound = big == (order == ">") and precision < len(_PRECISIONS) and text < 2 and min(rows, columns) >= 0
        if not sound or imaginary or not 0 < length <= 1024:
            raise ResultsError(f"{path}: is not a MAT file with matrices of real numbers and texts")
        stored = np.dtype(f"{order}{_PRECISIONS[precision]}")
        position = first + rows * columns * stored.itemsize
        if position > len(data):
            raise ResultsError(f"{path}: ends early; it was not written to its end")
        name = data[first - length : first].split(b"\0")[0].decode("latin-1")
        matrix = np.frombuffer(data, stored, rows * columns, first).reshape(rows, columns, order="F")
        matrices[name] = matrix.astype(np.uint8) if text else matrix.astype(stored.newbyteorder("="))
    return matrices


def _texts(matrix: np.ndarray) -> list[str]:
    """Texts of a matrix of characters, one a row."""
    rows = [bytes(row.tolist()).rstrip(b" \0") for row in matrix]
    try:
        return [row.decode("utf-8") for row in rows]
    except UnicodeDecodeError:
        return [row.decode("latin-1") for row in rows]


def _trajectory(path: Path, matrices: dict[str, np.ndarray]) -> Contents:
    """A trajectory of version 1.1 (Dymola User Manual, "Matlab result files")."""
    kind = [*_texts(matrices["Aclass"]), "", "", ""]
    transposed = kind[3].lower() == "bintrans"
    turned = {name: matrix.T if transposed else matrix for name, matrix in matrices.items()}
    if kind[0] != "Atrajectory":
        raise ResultsError(f"{path}: is not a trajectory, but '{kind[0]}'")
    names = _texts(turned["name"])
    described = _texts(turned["description"]) if "description" in turned else [""] * len(names)
    info = turned["dataInfo"].astype(int)
    number = max(int(found[1]) for name in [*matrices, "data_1"] if (found := re.fullmatch(r"data_(\d+)", name)))
    if len(names) != len(info) or len(described) != len(names):
        raise ResultsError(f"{path}: names, descriptions and data of the trajectory don't fit each other")
    try:
        data = {i: turned[f"data_{i}"] for i in range(1, number + 1)}
        time = data[number][:, 0]
        constant = {i for i, matrix in data.items() if i != number}
        units = {n: u for n, text in zip(names, described, strict=True) if (u := _unit(text))}
        columns: list[tuple[str, np.ndarray]] = []
        for name, (which, place, *_) in zip(names, info.tolist(), strict=True):
            if which == 0 or (is_time(name) and abs(place) == 1):
                check_seconds(path, units.pop(name, "s"))
                continue
            own = data[which][:, abs(place) - 1] * (1 if place > 0 else -1)
            if which in constant and len(own) != len(time):
                if not (own == own[0]).all():
                    raise ResultsError(f"{path}: '{name}' has times of its own")
                own = np.full(len(time), own[0])
            columns.append((name, own))
    except (KeyError, IndexError) as error:
        raise ResultsError(f"{path}: the trajectory lacks {error}") from error
    return assembled(path, time, columns, units)


def _unit(description: str) -> str:
    """Unit at the end of a description: `angle [rad|deg]` is in rad."""
    found = re.search(r"\[([^\[\]]*)\]\s*$", description)
    return found[1].partition(":#")[0].partition("|")[0].strip() if found else ""
