"""Files whose writing was cut off anywhere: what was whole by then is read, and nothing else is."""

from __future__ import annotations

import random
import resource
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

from cosim import CosimError, Results, StoredResults, TableWriter
from cosim.files.whole import part_of
from cosim.results import formats
from cosim.results.columns import TypedColumn

#: Rows in a group, and in all.
GROUP, ROWS = 10, 95


@pytest.fixture(autouse=True)
def small_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(formats, "_GROUPED_VALUES", GROUP * 4)


def made() -> Results:
    time = 0.1 * np.arange(ROWS)
    texts = np.array([*('one "two"\nthree' if i % 3 else "" for i in range(ROWS)), None], dtype=object)[:-1]
    values = np.column_stack([np.sin(time), np.full(ROWS, np.nan), 1e300 * time])
    return Results(time, ["a.x", "a.text", "b.y"], values, {}, {"a.text": TypedColumn("string", texts)})


def ends_of_groups(path: Path) -> list[int]:
    """Sizes of a growing file after each group."""
    results, sizes = made(), []
    with TableWriter([path], results.names, results.types) as writer:
        for row in range(ROWS):
            writer(results.time[row : row + 1], rows(results, slice(row, row + 1)))
            size = part_of(path).stat().st_size
            if (row + 1) % GROUP == 0:
                sizes.append(size)
    return sizes


def rows(results: Results, which: slice) -> np.ndarray:
    values = results.values[which].astype(object)
    values[:, 1] = results["a.text"][which]
    return values


def same(part: Results | StoredResults, n: int) -> None:
    whole = made()
    assert len(part.time) == n
    for name in ("time", *whole.names):
        assert part[name].tolist() == whole[name][:n].tolist()


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_a_file_that_is_cut_off_anywhere_is_read_up_to_its_last_group(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"r.{ending}"
    sizes = ends_of_groups(path)
    whole, part = path.read_bytes(), part_of(path)
    assert len(sizes) == ROWS // GROUP
    chosen = random.Random(1).sample(range(sizes[0], len(whole)), 60)
    for cut in [*chosen, *sizes, *(size - 1 for size in sizes[1:])]:
        part.write_bytes(whole[:cut])
        groups = sum(size <= cut for size in sizes)
        found = Results.read(part)
        if ending == "parquet":
            same(found, ROWS if cut == len(whole) else len(found.time))
            same(StoredResults(part, {}), len(found.time))
            assert len(found.time) in (GROUP * groups, ROWS)
            assert len(found.time) < ROWS or cut > sizes[-1]
        else:  # each whole line
            assert GROUP * groups <= len(found.time) <= min(ROWS, GROUP * (groups + 1))
            same(found, len(found.time))


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_what_is_cut_off_before_anything_is_whole_is_refused_in_a_line(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"r.{ending}"
    first = ends_of_groups(path)[0]
    part, whole = part_of(path), path.read_bytes()
    for cut in (0, 3, 4, 10, first - 1) if ending == "parquet" else (0, 3, 5):
        part.write_bytes(whole[:cut])
        with pytest.raises(CosimError, match=r"r\.\w+\.part: ") as refused:
            Results.read(part)
        assert "\n" not in str(refused.value)


def test_a_file_that_is_damaged_in_its_middle_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "r.parquet"
    sizes = ends_of_groups(path)
    content = bytearray(path.read_bytes()[: sizes[4]])
    content[sizes[1] - 8 : sizes[1]] = b"\0" * 8  # the end of the second footer
    part_of(path).write_bytes(content)
    with pytest.raises(CosimError, match="can't be read as Parquet"):
        Results.read(part_of(path))


def test_another_reader_takes_files_of_many_groups(tmp_path: Path) -> None:
    path = tmp_path / "r.parquet"
    ends_of_groups(path)
    assert parquet.ParquetFile(path).metadata.num_row_groups == 10
    assert parquet.read_table(path)["a.x"].to_pylist() == made()["a.x"].tolist()


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_an_older_file_outlives_whatever_goes_wrong(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"r.{ending}"
    made().thinned(7).save(path)
    before = path.read_bytes()
    results = made()
    with suppress(ZeroDivisionError), TableWriter([path], results.names, results.types) as writer:
        writer(results.time[:33], rows(results, slice(33)))
        raise ZeroDivisionError
    assert path.read_bytes() == before
    same(Results.read(part_of(path)), 33)
    made().save(path)
    same(Results.read(path), ROWS)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


#: Writes rows into files until the process may write no more; then says what it raised.
FULL = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from cosim import Results, TableWriter
from cosim.results import formats
formats._GROUPED_VALUES = 3000
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
path, whole = Path(sys.argv[1]), sys.argv[2] == "whole"
rows = np.arange(30_000.0).reshape(-1, 2)
limit = len(rows) * 3 * 8 // 2
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
try:
    if whole:
        Results(rows[:, 0], ["a.x", "a.y"], rows).save(path)
    else:
        with TableWriter([path], ["a.x", "a.y"]) as writer:
            for first in range(0, len(rows), 100):
                writer(rows[first : first + 100, 0], rows[first : first + 100])
except OSError as error:
    print(type(error).__name__, error)
"""


@pytest.mark.skipif(not hasattr(resource, "RLIMIT_FSIZE"), reason="the system limits no files")
@pytest.mark.parametrize("how", ["whole", "growing"])
def test_a_full_disk_costs_neither_the_older_file_nor_what_was_whole_of_the_new_one(tmp_path: Path, how: str) -> None:
    for ending in ("parquet", "csv"):
        path = tmp_path / f"r.{ending}"
        path.write_text("older")
        done = subprocess.run([sys.executable, "-c", FULL, path, how], capture_output=True, text=True, check=True)
        assert "File too large" in done.stdout, done.stderr
        assert path.read_text() == "older"
        found = Results.read(part_of(path))
        assert 4000 < len(found.time) < 15_000
        assert found["a.y"].tolist() == (1.0 + 2.0 * np.arange(len(found.time))).tolist()
        assert ending == "parquet" or part_of(path).read_bytes().endswith(b"\n")
