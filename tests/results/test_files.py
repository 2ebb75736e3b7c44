"""Files of results: every format gives back the same bits, and long runs go to the disk as they come."""

from __future__ import annotations

import json
import re
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet
from scipy.io import loadmat

from cosim import CosimError, Results
from cosim.files.whole import part_of
from cosim.results import formats
from cosim.results.formats import FORMATS
from cosim.results.stored import StoredResults, TableWriter
from cosim.results.streams import descriptor_of
from tests.support import some

SPECIAL = [0.1 + 0.2, 5e-324, 1.7976931348623157e308, -0.0, np.pi, 1e-300]


def made(rows: int = 7) -> Results:
    time = 0.1 * np.arange(rows)
    names = ["a.v[10]", "a.v[2]", "a.x", "b.y"]
    values = np.column_stack([np.resize(SPECIAL, rows), time**2, -time, np.full(rows, 3.0)])
    return Results(time, names, values, {"step_size": 0.1})


def read(path: Path) -> tuple[list[str], np.ndarray]:
    """Names and table, the time included, by readers that are not ours."""
    if path.suffix == ".csv":
        header, *rows = path.read_text(encoding="utf-8").splitlines()
        return [n.strip('"') for n in header.split(",")], np.array([[float(v) for v in r.split(",")] for r in rows])
    if path.suffix == ".parquet":
        table = parquet.read_table(path)
        return table.schema.names, np.column_stack([c.to_numpy() for c in table.columns])
    if path.suffix == ".npz":
        archive = np.load(path)
        return ["time", *archive["names"]], np.column_stack([archive["time"], archive["values"]])
    if path.suffix == ".json":
        columns = json.loads(path.read_text(encoding="utf-8"))["values"]
        return list(columns), np.column_stack(list(columns.values()))
    data = loadmat(path, chars_as_strings=False)
    names = ["".join(column).rstrip() for column in data["name"].T]
    return names, data["data_2"].T


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_back_the_same_bits(tmp_path, name):
    results = made()
    path = tmp_path / f"r.{name}"
    results.save(path)
    names, table = read(path)
    assert names == ["time", *results.names]
    assert table.tobytes() == np.column_stack([results.time, results.values]).tobytes()
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_mat_files_are_trajectories_of_dymola(tmp_path):
    made().save(tmp_path / "r.mat")
    data = loadmat(tmp_path / "r.mat")
    assert [text.rstrip() for text in data["Aclass"]] == ["Atrajectory", "1.1", "", "binTrans"]
    matrix, column, interpolation, outside = data["dataInfo"]
    assert matrix.tolist() == [0, 2, 2, 2, 2]
    assert column.tolist() == [1, 2, 3, 4, 5]
    assert set(interpolation) == {0}
    assert set(outside) == {-1}


def test_an_unknown_format_is_refused_by_name(tmp_path):
    with pytest.raises(CosimError, match=r"unknown format '\.xls'; use \.csv, ") as refused:
        made().save(tmp_path / "r.xls")
    assert re.findall(r"\.([a-z]+)(?=,| or|$)", str(refused.value).partition("use ")[2]) == list(FORMATS)
    with pytest.raises(CosimError, match=r"can't be written as it grows; use \.csv or \.parquet"):
        TableWriter([tmp_path / "r.mat"], ["a"])
    assert list(tmp_path.iterdir()) == []


def written_in_chunks(folder: Path, results: Results, size: int) -> list[Path]:
    paths = [folder / "r.csv", folder / "r.parquet"]
    with TableWriter(paths, results.names) as writer:
        for i in range(0, len(results.time), size):
            writer(results.time[i : i + size], results.values[i : i + size])
            assert not any(path.exists() for path in paths)  # none that looks finished
    return paths


def test_chunks_make_the_same_table(tmp_path):
    results = made(20)
    for path in some(written_in_chunks(tmp_path, results, 6)):
        names, table = read(path)
        assert names == ["time", *results.names]
        assert table.tobytes() == np.column_stack([results.time, results.values]).tobytes()


@pytest.mark.parametrize("sizes", [(1, 2), (3, 20), (7, 50), (20, 1000)])
def test_files_do_not_tell_the_chunks_that_their_rows_came_in(tmp_path, monkeypatch, sizes):
    monkeypatch.setattr(formats, "_GROUPED_VALUES", 50)  # 10 rows
    results = made(137)
    files = []
    for size in sizes:
        folder = tmp_path / str(size)
        folder.mkdir()
        files.append([path.read_bytes() for path in written_in_chunks(folder, results, size)])
    assert files[0] == files[1]
    results.save(tmp_path / "whole.parquet")
    assert files[0][1] == (tmp_path / "whole.parquet").read_bytes()
    groups = parquet.ParquetFile(folder / "r.parquet")
    assert [groups.metadata.row_group(i).num_rows for i in range(groups.num_row_groups)] == [10] * 13 + [7]
    _, table = read(folder / "r.parquet")
    assert table.tobytes() == np.column_stack([results.time, results.values]).tobytes()


def test_stored_results_answer_as_those_in_memory(tmp_path):
    results = made(20)
    _, path = written_in_chunks(tmp_path, results, 6)
    kept = StoredResults(path, results.info)
    assert kept.names == results.names
    assert kept.info == results.info
    for name in ("time", "a.x", "a.v", "b.y", "a.v[10]"):
        assert name in kept
        assert (kept[name] == results[name]).all()
    assert "a.z" not in kept
    with pytest.raises(CosimError, match=r"nothing was recorded as 'a\.z'; did you mean"):
        _ = kept["a.z"]
    for every in (1, 3, 7, 50):
        assert (kept.thinned(every).values == results.thinned(every).values).all()
        assert (kept.thinned(every).time == results.time[::every]).all()


def test_rows_before_a_failure_are_kept(tmp_path):
    results = made(6)
    path = tmp_path / "r.parquet"
    writer = TableWriter([path], results.names)
    with suppress(RuntimeError), writer:
        writer(results.time[:4], results.values[:4])
        raise RuntimeError("the run failed")
    assert not path.exists()
    assert (StoredResults(part_of(path), {})["a.x"] == results["a.x"][:4]).all()


def test_the_descriptor_of_a_file_is_found_where_pyarrow_does_not_say_it(tmp_path: Path) -> None:
    """As versions 17 to 24 do not."""
    path = tmp_path / "f.parquet"
    with path.open("wb") as written, path.open("rb"), (tmp_path / "other").open("wb"):
        assert descriptor_of(object(), path) == written.fileno()
    with pytest.raises(CosimError, match="update it"):
        descriptor_of(object(), path)
