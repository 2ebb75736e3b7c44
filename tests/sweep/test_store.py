"""The folder of a sweep: rows come back as they went in, whole files only, and never those of another sweep."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

import cosim.sweep.store
from cosim.results.output import OutputError
from cosim.sweep.batch import Row, Rows
from cosim.sweep.errors import SweepError
from cosim.sweep.points import Levels, Points, Range, design
from cosim.sweep.store import Store, read

QUESTION = {"version": "1", "coupling": "auto"}


def small() -> Points:
    return design("grid", [Levels("scenario", ("one", "two")), Levels("a.x", (0.1, 0.2, 0.3)), Levels("seed", (1, 2))])


def rows(*indices: int, error: str | None = None) -> Rows:
    metrics = (lambda i: None) if error else (lambda i: {"m": i / 3.0, "n": None})
    return Rows.of(["m", "n"], [Row(i, metrics(i), error) for i in indices], 0.1)


def store(folder: Path, points: Points | None = None, question: dict | None = None, **options) -> Store:
    return Store(folder, points or small(), ["m", "n"], question or QUESTION, **options)


def test_rows_come_back_in_order_with_their_factors(tmp_path):
    opened = store(tmp_path)
    assert opened.missing().tolist() == list(range(12))
    opened.add(rows(7, 3))
    opened.add(rows(11, error="no\u00a0luck"))
    opened.flush()
    table = read(tmp_path)
    assert table.column_names == ["index", "scenario", "a.x", "seed", "m", "n", "error"]
    assert table.to_pylist() == [
        {"index": 3, "scenario": "one", "a.x": 0.2, "seed": 2, "m": 1.0, "n": None, "error": None},
        {"index": 7, "scenario": "two", "a.x": 0.1, "seed": 2, "m": 7 / 3.0, "n": None, "error": None},
        {"index": 11, "scenario": "two", "a.x": 0.3, "seed": 2, "m": None, "n": None, "error": "no\u00a0luck"},
    ]
    assert opened.missing().tolist() == [0, 1, 2, 4, 5, 6, 8, 9, 10]
    summary = opened.summary()
    assert (summary.points, summary.done, summary.failed) == (12, 3, 1)
    assert summary.first_error == "point 11: no\u00a0luck"


def test_columns_can_be_chosen(tmp_path):
    opened = store(tmp_path)
    opened.add(rows(7, 3))
    opened.flush()
    assert read(tmp_path, ["seed", "m"]).to_pydict() == {"index": [3, 7], "seed": [2, 2], "m": [1.0, 7 / 3.0]}
    with pytest.raises(SweepError, match="no column 'sed'; did you mean 'seed'"):
        read(tmp_path, ["sed"])


def test_numbers_come_back_to_the_last_bit(tmp_path):
    values = [0.1 + 0.2, -0.0, 5e-324, 1.7976931348623157e308, math.inf, -math.inf, math.nan]
    points = Points((Range("a.x", 0.0, 1.0),), (np.linspace(0.0, 1.0, 7),))
    opened = Store(tmp_path, points, ["m"], QUESTION)
    opened.add(Rows.of(["m"], [Row(i, {"m": v}, None) for i, v in enumerate(values)], 1.0))
    opened.flush()
    table = read(tmp_path)
    assert table["m"].to_numpy().tobytes() == np.array(values).tobytes()
    assert table["a.x"].to_numpy().tobytes() == points.columns[0].tobytes()


def test_curves_come_back_with_the_rows_also_where_all_runs_have_failed(tmp_path):
    opened = Store(tmp_path, small(), ["m"], QUESTION, curves=["a.curve"])
    curve = np.array([0.5, -1.25, math.inf], dtype=np.float32)
    names = ["m", "a.curve"]
    opened.add(Rows.of(names, [Row(5, {"m": 1.0, "a.curve": curve}, None), Row(2, None, "no luck")], 1.0))
    opened.flush()
    opened.add(Rows.of(names, [Row(0, None, "no luck")], 1.0))
    opened.flush()
    table = read(tmp_path)
    assert table.column_names == ["index", "scenario", "a.x", "seed", "m", "a.curve", "error"]
    assert table["index"].to_pylist() == [0, 2, 5]
    assert table["a.curve"].to_pylist() == [None, None, curve.tolist()]
    assert read(tmp_path, ["a.curve"]).column_names == ["index", "a.curve"]


def test_what_is_not_finished_is_not_read(tmp_path):
    opened = store(tmp_path)
    opened.add(rows(0, 1))
    opened.flush()
    part = next((tmp_path / "results").glob("part-*"))
    (tmp_path / "results" / f".{part.name}x.part").write_bytes(part.read_bytes()[:100])
    assert read(tmp_path)["index"].to_pylist() == [0, 1]
    assert store(tmp_path).missing().tolist() == list(range(2, 12))


def test_parts_are_written_every_few_seconds_and_less_often_in_a_long_sweep(tmp_path):
    now = [0.0]
    opened = store(tmp_path, now=lambda: now[0])

    def parts_after(seconds: float) -> int:
        now[0] += seconds
        opened.add(rows(0))
        return len(list((tmp_path / "results").glob("part-*")))

    assert [parts_after(s) for s in (0.5, 0.5, 1.1, 1.0, 1.1)] == [1, 1, 1, 2, 2]
    now[0] += 1000.0
    assert [parts_after(s) for s in (0.0, 5.0, 10.0, 10.0)] == [3, 3, 3, 4]
    now[0] += 1e6
    assert [parts_after(s) for s in (0.0, 59.0, 2.0)] == [5, 5, 6]


def test_a_point_that_was_run_twice_comes_once(tmp_path):
    for _ in range(2):
        opened = store(tmp_path)
        opened.add(rows(5, 4))
        opened.flush()
    assert read(tmp_path)["index"].to_pylist() == [4, 5]
    assert opened.summary().done == 2


def test_an_empty_sweep_reads_as_an_empty_table(tmp_path):
    store(tmp_path)
    table = read(tmp_path)
    assert (table.num_rows, table.column_names) == (0, ["index", "scenario", "a.x", "seed", "error"])


@pytest.mark.parametrize(
    ("points", "question", "says"),
    [
        (design("grid", [Levels("a.x", (1.0,))]), QUESTION, "factors, points, points_sha256"),
        (small(), {**QUESTION, "coupling": "hold"}, "(other coupling)"),
        (small(), {**QUESTION, "version": "2"}, "(other version)"),
    ],
)
def test_the_folder_of_another_sweep_is_refused_in_one_line(tmp_path, points, question, says):
    opened = store(tmp_path)
    opened.add(rows(1))
    opened.flush()
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    with pytest.raises(SweepError) as error:
        store(tmp_path, points, question)
    assert says in str(error.value)
    assert str(tmp_path) in str(error.value)
    assert "choose another --out" in str(error.value)
    assert "\n" not in str(error.value)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


def test_results_without_their_question_are_refused(tmp_path):
    opened = store(tmp_path)
    opened.add(rows(1))
    opened.flush()
    (tmp_path / "sweep.json").unlink()
    with pytest.raises(SweepError, match=r"without their sweep\.json"):
        store(tmp_path)


@pytest.mark.parametrize("text", ["", "no json", "[1]"])
def test_a_damaged_question_is_refused(tmp_path, text):
    store(tmp_path)
    (tmp_path / "sweep.json").write_text(text)
    with pytest.raises(SweepError, match="choose another --out"):
        store(tmp_path)


def test_a_start_that_was_killed_before_its_question_was_written_is_no_obstacle(tmp_path):
    store(tmp_path)
    (tmp_path / "sweep.json").unlink()
    assert len(store(tmp_path).missing()) == 12


def test_reading_what_is_no_sweep_or_damaged_is_one_line(tmp_path):
    with pytest.raises(SweepError, match=r"no sweep\.json"):
        read(tmp_path)
    opened = store(tmp_path)
    opened.add(rows(1))
    opened.flush()
    part = next((tmp_path / "results").glob("part-*"))
    part.write_bytes(part.read_bytes()[:-20])
    with pytest.raises(SweepError) as error:
        read(tmp_path)
    assert "\n" not in str(error.value)
    assert "delete it" in str(error.value)


def test_a_full_disk_is_one_line_and_leaves_no_half_part(tmp_path, monkeypatch):
    opened = store(tmp_path)

    def full(table: object, path: Path, **_: object) -> None:
        path.write_bytes(b"half a")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cosim.sweep.store.pq, "write_table", full)
    with pytest.raises(SweepError, match="No space left on device; free some space and start again"):
        opened.add(rows(1))
    assert read(tmp_path).num_rows == 0


def test_a_folder_that_can_not_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="choose another --out"):
        store(tmp_path / "file" / "out")


def test_the_question_is_kept_for_people(tmp_path):
    store(tmp_path)
    kept = json.loads((tmp_path / "sweep.json").read_text())
    assert kept["coupling"] == "auto"
    assert kept["factors"] == ["scenario", "a.x", "seed"]
    assert kept["points"] == 12


def test_reading_rows_calls_no_python_for_each_of_them(tmp_path):
    """Arrow reads, joins and sorts them, so that a hundred thousand take less than a second (docs/benchmarks.md)."""
    names = [f"m{i}" for i in range(29)]

    def calls_to_read(n: int, parts: int = 20) -> int:
        folder = tmp_path / str(n)
        points = design("sobol", [Range("controller.alpha", 0.5, 3.0), Range("controller.beta", 1.0, 2.0)], n)
        opened = Store(folder, points, names, QUESTION)
        values = np.random.default_rng(0).random((n, len(names)))
        for indices in np.array_split(np.random.default_rng(1).permutation(n), parts):
            columns = {name: values[indices, k].tolist() for k, name in enumerate(names)}
            opened.add(Rows(indices.tolist(), columns, [None] * len(indices), 1.0))
            opened.flush()
        calls = []
        sys.setprofile(lambda frame, event, argument: calls.append(event))
        try:
            table = read(folder)
        finally:
            sys.setprofile(None)
        assert table["index"].to_numpy().tolist() == list(range(n))
        assert table["m3"].to_numpy().tobytes() == np.ascontiguousarray(values[:, 3]).tobytes()
        return len(calls)

    calls_to_read(40)  # what is only loaded once
    few, many = calls_to_read(100), calls_to_read(10_000)
    assert 0 < many < few + 100
