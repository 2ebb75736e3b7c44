"""Tables in CSV files, whoever wrote them: what separates columns and what the decimal sign is, is found out.

What a file means is never guessed where it could mean two things: such a file is refused.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from cosim.errors import ResultsError
from cosim.files.whole import is_part
from cosim.results.assembly import (
    TIME_UNITS,
    assembled,
    check_once,
    check_seconds,
    is_time,
    time_unit,
)
from cosim.results.formats import TIME, Contents
from cosim.results.headings import name_and_unit, unit_of
from cosim.results.unfinished import whole_lines

_SEPARATORS = (",", ";", "\t")

_POINT = re.compile(r"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?|nan|inf|infinity)", re.IGNORECASE | re.ASCII)
_COMMA = re.compile(r"[+-]?(?:\d+,\d*|,\d+)(?:e[+-]?\d+)?", re.IGNORECASE | re.ASCII)
#: What may be a whole number with a comma between its thousands.
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}", re.ASCII)
_WHOLE = re.compile(r"[+-]?\d+", re.ASCII)
_TRUTH = {"true": True, "false": False}

#: Whole numbers below this are doubles too.
_EXACT = 2**53


@dataclass(frozen=True)
class _Row:
    """The cells of a row, and the number of its line."""

    line: int
    cells: Sequence[str]


def read_csv(path: str | PathLike[str]) -> Contents:
    """Read a CSV file whose first column is the time (s).

    Columns are separated by comma, semicolon or tab; the decimal sign is point or comma. Units may stand in the names,
    as `x [m]`, or in a row of their own below them. Columns have numbers, true and false, texts, or arrays of one
    size with spaces between their elements.

    Raises
    ------
    ResultsError
        The file is missing, not such a table, or could mean two things; the message names the line.
    """
    text, before = _text(path)
    header_line = text.partition("\n")[0].rstrip("\r")
    separator = _separator(path, header_line)
    try:
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, skipinitialspace=True, strict=True)
        header, *rows = [_Row(before + reader.line_num, cells) for cells in reader if any(map(str.strip, cells))]
    except csv.Error as error:
        raise ResultsError(f"{path}: line {before + reader.line_num}: can't be read as CSV: {error}") from error
    names, units = _names(path, header, header_line, separator)
    if rows and (own := _units_row(path, rows[0], len(names))) is not None:
        units = {name: unit or units.get(name, "") for name, unit in zip(names, own, strict=True)}
        rows = rows[1:]
    lines = [row.line for row in rows]
    cells = list(zip(*_whole_rows(path, rows, len(names)), strict=True)) or [()] * len(names)
    columns = _columns(path, lines, cells)
    return assembled(path, columns[0], list(zip(names[1:], columns[1:], strict=True)), _known(units))


def _known(units: dict[str, str]) -> dict[str, str]:
    return {name: unit for name, unit in units.items() if unit and name != TIME}


def _text(path: str | PathLike[str]) -> tuple[str, int]:
    """The text from the line of the names on, and how many lines stand before it."""
    try:
        content = Path(path).read_bytes()
        if is_part(Path(path)):
            content = whole_lines(content)
        wide = content[:2] in (b"\xff\xfe", b"\xfe\xff")  # spreadsheets write "Unicode text" so
        text = content.decode("utf-16" if wide else "utf-8-sig")
        text = text if "\n" in text else text.replace("\r", "\n")  # as old Macs end lines
    except UnicodeDecodeError as error:
        raise ResultsError(f"{path}: can't be read as CSV: {error}; save it as UTF-8") from error
    except OSError as error:
        raise ResultsError(f"{path}: can't be read: {error.strerror or error}; check the path") from error
    before = 0
    while text:
        line, _, rest = text.partition("\n")
        if names := re.match(r"\s*#+\s*(?=[\"']?\w)", line):  # a comment, or the names, as numpy.savetxt writes them
            if is_time(re.split(r"[,;\t]", line[names.end() :])[0].strip().strip('"')):
                return text[names.end() :], before
        elif line.strip() and not re.fullmatch(r"\s*(sep=.|#.*)\s*", line):
            break
        text, before = rest, before + 1
    return text, before


def _separator(path: str | PathLike[str], header: str) -> str:
    """What stands behind the first name, which has to be the time."""
    for separator in _SEPARATORS:
        first, *_ = next(csv.reader([header], delimiter=separator, skipinitialspace=True), None) or [""]
        if is_time(first):
            return separator
    names = re.split(r"[,;\t]", header)
    why = ""
    if not names[0].strip(' "') and len(names) > 1 and is_time(names[1].strip('"')):
        why = "; write the file without an index before it"
    elif is_time(re.split(r"[\s|:]", header.strip(' "'))[0]):
        why = ", and columns be separated by comma, semicolon or tab"
    raise ResultsError(f"{path}: the first column must be '{TIME}'{why}")


def _names(path: str | PathLike[str], header: _Row, line: str, separator: str) -> tuple[list[str], dict[str, str]]:
    """Names of the columns, and units that stand behind them."""
    in_quotes = set(re.findall(r'"((?:[^"]|"")*)"', line))

    def quoted(cell: str) -> bool:
        return cell.replace('"', '""') in in_quotes

    cells = list(header.cells)
    while not cells[-1].strip() and not quoted(cells[-1]):
        cells.pop()
    found: list[str] = []
    for cell in cells:
        inside = separator == "," and found and re.search(r"\[\d+(,\d+)*$", found[-1]) and not quoted(found[-1])
        if inside and re.match(r"\d+(\]|$)", cell):  # the comma is one between indices
            found[-1] += f",{cell}"
        else:
            found.append(cell if quoted(cell) else cell.strip())
    if "" in found:
        raise ResultsError(f"{path}: line {header.line}: column {found.index('') + 1} has no name")
    check_seconds(path, time_unit(found[0]))
    ours = found[0] == TIME and all(map(quoted, found))
    parts = [(TIME, ""), *(name_and_unit(name, apart=ours) for name in found[1:])]
    if len({name for name, _ in parts}) < len(parts):  # then what looks as a unit tells names apart
        parts = [(TIME, ""), *((name, "") for name in found[1:])]
    names = [name for name, _ in parts]
    check_once(f"{path}: line {header.line}", names)
    return names, dict(parts)


def _units_row(path: str | PathLike[str], row: _Row, n: int) -> list[str] | None:
    """Units in a row of their own, the first of which is that of the time; None where the row is none of units."""
    units = [unit_of(cell) for cell in row.cells]
    if len(units) < n or any(units[n:]) or units[0] not in TIME_UNITS:
        return None
    check_seconds(f"{path}: line {row.line}", units[0])
    return units[:n]


def _whole_rows(path: str | PathLike[str], rows: Sequence[_Row], n: int) -> list[Sequence[str]]:
    """Rows with a cell for each name; all of them may end in the same number of empty cells."""
    widths = {len(row.cells) for row in rows}
    for row in rows:
        if len(row.cells) != n and (len(widths) > 1 or len(row.cells) < n or any(map(str.strip, row.cells[n:]))):
            raise ResultsError(f"{path}: line {row.line} has {len(row.cells)} columns, the header has {n}")
    return [row.cells[:n] for row in rows]


def _columns(path: str | PathLike[str], lines: Sequence[int], cells: Sequence[Sequence[str]]) -> list[np.ndarray]:
    """Values of all columns, whose decimal sign is the same."""
    numbers = [_numbers(column) for column in cells]
    with_commas = [i for i, found in enumerate(numbers) if found is None and _has_decimal_commas(cells[i])]
    if with_commas:
        with_points = [column for column, found in zip(cells, numbers, strict=True) if found is not None]
        _check_decimal_commas(path, lines, [cells[i] for i in with_commas], with_points)
    columns = []
    for i, (column, found) in enumerate(zip(cells, numbers, strict=True)):
        values = found
        if values is not None:
            _refuse_overflow(path, lines, values, column)
        if i in with_commas:
            pointed = [cell.replace(",", ".") for cell in column]
            values = _numbers(pointed)
            columns.append(_other(path, lines, pointed) if values is None else values)
        elif values is None:
            columns.append(_other(path, lines, column))
        else:
            columns.append(_exact(values, column) if i else values)
    if columns[0].dtype.kind != "f":
        i = next((i for i, cell in enumerate(cells[0]) if not _is_number(cell)), 0)
        raise ResultsError(f"{path}: line {lines[i]}: column '{TIME}' has {cells[0][i]!r}, which is not a number")
    return columns


def _is_number(cell: str) -> bool:
    return bool(_POINT.fullmatch(cell.strip()))


def _numbers(cells: Sequence[str]) -> np.ndarray | None:
    """A column of numbers with decimal points; None where it is none."""
    try:
        values = np.array([float(cell) for cell in cells])
    except ValueError:
        return None
    # Python takes underscores and digits of other scripts too
    return values if all(cell.isascii() and "_" not in cell for cell in cells) else None


def _refuse_overflow(path: str | PathLike[str], lines: Sequence[int], values: np.ndarray, cells: Sequence[str]) -> None:
    """Refuse a number that is infinite only because no real number here is as large."""
    for line, value, cell in zip(lines, values.tolist(), cells, strict=True) if np.isinf(values).any() else ():
        if math.isinf(value) and "inf" not in cell.lower():
            raise ResultsError(f"{path}: line {line}: {cell.strip()!r} is larger than any number that can be kept")


def _exact(values: np.ndarray, cells: Sequence[str]) -> np.ndarray:
    """A column as whole numbers, where these would not be exact as real ones."""
    if not (np.abs(values) >= _EXACT).any() or not all(_WHOLE.fullmatch(cell.strip()) for cell in cells):
        return values
    whole = [int(cell) for cell in cells]
    if all(int(value) == number for value, number in zip(values.tolist(), whole, strict=True)):
        return values
    smallest, largest = min(whole), max(whole)
    if smallest >= -(2**63) and largest < 2**63:
        return np.array(whole, dtype=np.int64)
    return np.array(whole, dtype=np.uint64) if smallest >= 0 and largest < 2**64 else values


def _split(cell: str) -> list[str]:
    """Elements of an array; a space that may stand between thousands separates none."""
    return [element for element in cell.split(" ") if element]


def _has_decimal_commas(cells: Sequence[str]) -> bool:
    """Whether all cells, or elements in them, are numbers, and some have a decimal comma."""
    elements = [element for cell in cells for element in _split(cell)]
    commas = [bool(_COMMA.fullmatch(element)) for element in elements]
    return any(commas) and all(c or _POINT.fullmatch(e) for c, e in zip(commas, elements, strict=True))


def _check_decimal_commas(
    path: str | PathLike[str],
    lines: Sequence[int],
    with_commas: Sequence[Sequence[str]],
    others: Sequence[Sequence[str]],
) -> None:
    """Refuse a file in which commas may stand between thousands."""
    elements = [(line, e) for column in with_commas for line, c in zip(lines, column, strict=True) for e in _split(c)]
    line, comma = next((line, element) for line, element in elements if "," in element)
    for column in others:
        elements += zip(lines, column, strict=True)
    for other, element in elements:
        if "." in element:
            raise ResultsError(
                f"{path}: line {line} has '{comma}' and line {other} has '{element.strip()}'; "
                "write all numbers with decimal points"
            )
    if all(_THOUSANDS.fullmatch(element) for _, element in elements if "," in element):
        raise ResultsError(
            f"{path}: line {line}: '{comma}' may be {comma.replace(',', '.')} or {comma.replace(',', '')}; "
            "write numbers with decimal points"
        )


def _other(path: str | PathLike[str], lines: Sequence[int], cells: Sequence[str]) -> np.ndarray:
    """A column of true and false, of arrays, or of texts."""
    truths = [_TRUTH.get(cell.strip().lower()) for cell in cells]
    if None not in truths:
        return np.array(truths, dtype=bool)
    arrays = [_split(cell) for cell in cells]
    for known in (lambda e: _is_number(e), lambda e: e.lower() in _TRUTH):
        if all(elements and all(map(known, elements)) for elements in arrays) and max(map(len, arrays)) > 1:
            sizes = [len(elements) for elements in arrays]
            if len(set(sizes)) > 1:
                i = next(i for i, size in enumerate(sizes) if size != sizes[0])
                raise ResultsError(
                    f"{path}: line {lines[i]}: '{cells[i]}' has {sizes[i]} elements, line {lines[0]} has {sizes[0]}"
                )
            values = [[_TRUTH[e.lower()] if e.lower() in _TRUTH else float(e) for e in elements] for elements in arrays]
            return np.array(values)
    if any(_is_number(cell) for cell in cells):  # a mistake in a column of numbers, rather than one of texts
        i = next(i for i, cell in enumerate(cells) if not _is_number(cell))
        what = "is empty" if not cells[i].strip() else f"{cells[i]!r} is not a number"
        raise ResultsError(f"{path}: line {lines[i]}: a cell {what}, as others of its column are")
    return np.array(cells, dtype=object)
