"""Results in the hands of others: readers of MAT files, data frames, plots, terminals and notebooks."""

from __future__ import annotations

import dataclasses
from html.parser import HTMLParser
from pathlib import Path

import duckdb
import DyMat
import matplotlib as mpl
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
from pyarrow import parquet
from scipy.io import loadmat

from cosim import CosimError, Results
from cosim.results.formats import FORMATS
from cosim.results.page.run_page import run_page
from cosim.results.recorded import Recorded
from cosim.results.stored import StoredResults, TableWriter
from tests.support import some
from tests.support.html import Elements

NAMES = ["plant.theta_a[1]", "plant.theta_a[2]", "plant.theta_a[3]", "plant.x_E", "controller.on"]
UNITS = dict(zip(NAMES[:4], ["rad", "rad", "rad", "m"], strict=True))


def made(rows: int = 40) -> Results:
    time = 0.05 * np.arange(rows)
    values = np.column_stack([np.sin(time + i) for i in range(4)] + [time > 1.0])
    return Results(time, list(NAMES), values, {"status": "completed", "units": UNITS})


@pytest.fixture(params=["in memory", "stored"])
def recorded(request: pytest.FixtureRequest, tmp_path: Path) -> Recorded:
    """The same results, in memory and in a file of several row groups."""
    results = made()
    if request.param == "in memory":
        return results
    with TableWriter([tmp_path / "long.parquet"], results.names) as writer:
        for i in range(0, len(results.time), 15):
            writer(results.time[i : i + 15], results.values[i : i + 15])
    return StoredResults(tmp_path / "long.parquet", results.info)


def table(results: Results) -> np.ndarray:
    return np.column_stack([results.time, results.values])


def test_dymat_reads_mat_files(tmp_path, recorded):
    results = made()
    recorded.save(tmp_path / "r.mat")
    file = DyMat.DyMatFile(str(tmp_path / "r.mat"))
    assert list(file.names()) == results.names
    for name in results.names:
        assert file[name].tobytes() == results[name].tobytes()
        time, abscissa, text = file.abscissa(name)
        assert (abscissa, text) == ("time", "Time in [s]")
        assert time.tobytes() == results.time.tobytes()
        assert file.description(name) == (f"[{UNITS[name]}]" if name in UNITS else "")
    assert set(file.nameTree()) == {"plant", "controller"}


def test_scipy_reads_mat_files_and_the_comparison_can_fail(tmp_path):
    results = made()
    results.save(tmp_path / "r.mat")
    data = loadmat(tmp_path / "r.mat")
    assert data["data_2"].T.tobytes() == table(results).tobytes()
    assert data["data_1"].tolist() == [[results.time[0], results.time[-1]]]
    results.values[7, 2] = np.nextafter(results.values[7, 2], 1.0)
    assert data["data_2"].T.tobytes() != table(results).tobytes()


def test_data_frames_take_results_as_they_are(recorded):
    results = made()
    columns = ["time", *NAMES]
    for names, values in (
        (pl.DataFrame(recorded).columns, pl.DataFrame(recorded).to_numpy()),
        (list(pd.DataFrame.from_arrow(recorded).columns), pd.DataFrame.from_arrow(recorded).to_numpy()),
        (pa.table(recorded).column_names, np.column_stack([c.to_numpy() for c in pa.table(recorded).columns])),
        (recorded.to_arrow().column_names, recorded.to_arrow().to_pandas().to_numpy()),
    ):
        assert names == columns
        assert np.ascontiguousarray(values).tobytes() == table(results).tobytes()


def test_duckdb_asks_results(recorded):
    results = recorded  # duckdb finds it by the name of the Python variable
    found = duckdb.sql('select max("plant.x_E"), count(*) from results where time > 1').fetchall()
    late = made().time > 1.0
    assert found == [(made()["plant.x_E"][late].max(), late.sum())]
    assert len(results.time) == 40


def test_fields_of_arrow_know_their_unit(tmp_path, recorded):
    def units(schema: pa.Schema) -> list[bytes | None]:
        return [(field.metadata or {}).get(b"unit") for field in schema]

    expected = [b"s", b"rad", b"rad", b"rad", b"m", None]
    assert units(recorded.to_arrow().schema) == expected
    made().save(tmp_path / "r.parquet")
    assert units(parquet.read_schema(tmp_path / "r.parquet")) == expected
    made().save(tmp_path / "r.npz")
    assert np.load(tmp_path / "r.npz")["units"].tolist() == ["rad", "rad", "rad", "m", ""]


def test_stored_results_write_the_same_files(tmp_path):
    results = made()
    results.save(tmp_path / "long.parquet")
    stored = StoredResults(tmp_path / "long.parquet", results.info)
    for name in FORMATS:
        stored.save(tmp_path / f"stored.{name}")
        results.save(tmp_path / f"memory.{name}")
    assert (tmp_path / "stored.csv").read_bytes() == (tmp_path / "memory.csv").read_bytes()
    assert parquet.read_table(tmp_path / "stored.parquet").equals(results.to_arrow())
    for load in (np.load, loadmat):
        a, b = (load(tmp_path / f"{who}.{'npz' if load is np.load else 'mat'}") for who in ("stored", "memory"))
        for key in some(b):
            assert np.array_equal(a[key], b[key]) or key.startswith("__"), key


def test_repr_is_short_and_says_what_there_is(recorded):
    kind = type(recorded).__name__
    assert repr(recorded).splitlines() == [
        f"{kind}: 40 rows, 0 to 1.95 s, 5 columns, completed",
        "  plant: theta_a[1..3], x_E",
        "  controller: on",
    ]


def test_repr_of_odd_results():
    assert repr(Results(np.empty(0), [], np.empty((0, 0)))) == "Results: 0 rows, 0 columns"
    names = [f"component{i % 30}.a_rather_long_name_{i}" for i in range(500)]
    many = repr(Results(np.zeros(1), names, np.zeros((1, 500)))).splitlines()
    assert len(many) == 12
    assert max(len(line) for line in many) <= 100
    assert all(line.endswith(", ...") for line in many[1:-1])
    assert many[-1] == "  and 20 more components"
    matrix = Results(np.zeros(1), ["g.M[1,1]", "g.M[1,2]", "g.M[2,1]", "g.M[2,2]"], np.zeros((1, 4)))
    assert repr(matrix).endswith("  g: M[1,1..2,2]")
    foreign = Results(np.zeros(1), ["x", "y"], np.zeros((1, 2)))  # a CSV file of another tool
    assert repr(foreign).endswith("\n  x, y")


class Cells(HTMLParser):
    """Rows of a table; fails on tags that don't close in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.rows: list[list[str]] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):  # noqa: ARG002
        self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if {"td", "th"} & set(self.open):
            self.rows[-1][-1] += data


def page_in(cell: str) -> str:
    """The page in the frame of a notebook's cell."""
    ((tag, attributes, _),) = Elements(cell).all
    assert (tag, attributes["sandbox"]) == ("iframe", "allow-scripts")
    return attributes["srcdoc"]


def test_notebooks_get_the_page_of_a_run(recorded):
    page = page_in(recorded._repr_html_())
    assert page == run_page(recorded, budget=600_000)
    assert Elements(page).open == []
    assert "plant.theta_a" in page
    odd = page_in(Results(np.zeros(1), ["<b>.x&y"], np.zeros((1, 1)))._repr_html_())
    assert Elements(odd).open == []
    assert "<b>" not in odd


@pytest.mark.parametrize("shape", [(100_000, 30), (2, 1500)])
def test_a_cell_has_a_megabyte_at_most(shape):
    """Values that are too many are reduced to extremes; a run whose page has no room is a table."""
    values = np.random.default_rng(1).standard_normal(shape)
    names = [f"component.a_long_name_of_a_variable_{i}" for i in range(shape[1])]
    page = page_in(Results(np.arange(float(shape[0])), names, values)._repr_html_())
    assert ("too many values for a page" in page) == (shape[0] > 2)
    assert 300_000 < len(page.encode()) < 1_000_000


def test_notebooks_get_a_table_where_there_is_no_room_for_a_page():
    names = [f"plant.theta_a[{i}]" for i in (1, 2, 3)] + [f"a.x{i}" for i in range(5000)]
    info = {"units": dict.fromkeys(names[:3], "rad"), "parameters": {"a.<b>": 1.0}}
    many = Results(np.array([0.0, 1.5]), names, np.arange(2.0 * len(names)).reshape(2, -1), info)
    rows = Cells(many._repr_html_()).rows
    assert rows[:2] == [
        ["name", "unit", "at 0 s", "at 1.5 s"],
        ["plant.theta_a[1..3]", "rad", "0, 1, 2", "5003, 5004, 5005"],
    ]
    assert len(rows) == 41
    assert "and 4961 more" in many._repr_html_()
    many.info["parameters"] = {f"a.parameter_{i}": float(i) for i in range(20_000)}
    few = Results(many.time, names[:3], many.values[:, :3], many.info)
    assert [row[0] for row in Cells(few._repr_html_()).rows] == ["name", "plant.theta_a[1..3]"]


@pytest.fixture
def no_windows():
    with mpl.rc_context({"backend": "agg"}):
        yield
        mpl.pyplot.close("all")


@pytest.mark.usefixtures("no_windows")
def test_plot_has_a_panel_for_each_name_with_its_unit(recorded):
    results = made()
    axes = recorded.plot("plant.theta_a", "plant.x_E")
    assert [a.get_title(loc="left") for a in axes] == ["plant.theta_a", "plant.x_E"]
    assert [a.get_ylabel() for a in axes] == ["rad", "m"]
    assert [a.get_xlabel() for a in axes] == ["", "time (s)"]
    drawn = np.column_stack([line.get_ydata() for line in axes[0].lines])
    assert (drawn == results["plant.theta_a"]).all()
    assert (axes[1].lines[0].get_xdata() == results.time).all()
    assert [t.get_text() for t in axes[0].get_legend().get_texts()] == ["[1]", "[2]", "[3]"]
    assert len({(line.get_color(), str(line.get_linestyle())) for line in axes[0].lines}) == 3


@pytest.mark.usefixtures("no_windows")
def test_plot_has_room_for_any_name():
    long = f"a.{'y' * 1_000_000}{'z' * 20}"
    (axes,) = Results(np.zeros(1), [long], np.zeros((1, 1)), {"units": {long: "m" * 1000}}).plot()
    title = axes.get_title(loc="left")
    assert (len(title), title[:3], title[-22:]) == (120, "a.y", f"… {'z' * 20}")
    assert len(axes.get_ylabel()) == 120


@pytest.mark.usefixtures("no_windows")
def test_plot_draws_all_or_refuses(recorded):
    assert [a.get_title(loc="left") for a in recorded.plot()] == ["plant.theta_a", "plant.x_E", "controller.on"]
    with pytest.raises(CosimError, match=r"nothing was recorded as 'plant\.xE'; did you mean 'plant\.x_E'"):
        recorded.plot("plant.xE")
    many = Results(np.zeros(1), [f"a.x{i}" for i in range(500)], np.zeros((1, 500)))
    with pytest.raises(CosimError, match=r"500 variables are too many for one figure; name some, as results\.plot"):
        many.plot()
    with pytest.raises(CosimError, match="nothing was recorded"):
        Results(np.empty(0), [], np.empty((0, 0))).plot()


@pytest.mark.usefixtures("no_windows")
@pytest.mark.parametrize("n", [1, 2, 6, 7, 13, 36])
def test_each_column_of_panels_has_a_time_axis(n):
    results = Results(np.zeros(1), [f"a.x{i}" for i in range(n)], np.zeros((1, n)))
    panels = results.plot()
    assert len(panels) == n
    lowest = {a.get_subplotspec().colspan.start: a for a in panels}
    assert {a.get_xlabel() for a in lowest.values()} == {"time (s)"}
    assert sum(a.get_xlabel() != "" for a in panels) == len(lowest)


def test_results_compare_by_their_fields_and_show_no_arrays():
    fields = [f.name for f in dataclasses.fields(Results)]
    assert fields == ["time", "names", "values", "info", "typed"]
    assert "array" not in repr(made())
