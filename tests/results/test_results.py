"""Results: names, vectors, and CSV files that round-trip bit for bit or are refused with the line named."""

from __future__ import annotations

import csv
import dataclasses
import math
import re
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim import CosimError, Results
from cosim.errors import ResultsError

ANY_FLOAT = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True)
SPECIAL = [0.0, -0.0, 5e-324, -2.2250738585072009e-308, 1.7976931348623157e308, math.inf, -math.inf, math.nan, 0.1]


def bits(array: np.ndarray) -> list[bytes]:
    """Bytes of each float, with one pattern for all NaN."""
    return [struct.pack("<d", math.nan if math.isnan(v) else v) for v in np.ravel(array).tolist()]


def results(names: list[str], values: list[list[float]] | None = None) -> Results:
    table = np.array(values if values is not None else [[float(i) for i in range(len(names))]])
    return Results(time=np.arange(len(table)) * 0.5, names=names, values=table)


@settings(deadline=None)
@given(st.lists(st.tuples(ANY_FLOAT, ANY_FLOAT, ANY_FLOAT), max_size=8))
def test_csv_round_trips_bit_for_bit(tmp_path_factory, rows):
    path = tmp_path_factory.getbasetemp() / "round_trip.csv"
    table = np.array(rows, dtype=float).reshape(-1, 3)
    Results(time=table[:, 0], names=["a.x", "a.y"], values=table[:, 1:]).to_csv(path)
    back = Results.from_csv(path)
    assert back.names == ["a.x", "a.y"]
    assert bits(back.time) == bits(table[:, 0])
    assert bits(back.values) == bits(table[:, 1:])


def test_special_values_round_trip_and_the_comparison_can_fail(tmp_path):
    results([f"c.v{i}" for i in range(len(SPECIAL))], [SPECIAL]).to_csv(tmp_path / "r.csv")
    back = Results.from_csv(tmp_path / "r.csv").values
    assert bits(back) == bits(np.array(SPECIAL))
    assert bits(np.array([0.0])) != bits(np.array([-0.0]))
    assert bits(np.nextafter(back, 1.0)) != bits(back)


#: Names, some of which end as with a unit.
NAMES = st.builds(
    "{}{}".format,
    st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1),
    st.sampled_from(["", "", " (A)", " [m]", "[m]", " []", " [1]", " (A) []", " (A) [m]"]),
)


@settings(deadline=None)
@given(st.lists(NAMES, unique=True, max_size=5), st.booleans())
def test_any_name_survives_the_header(tmp_path_factory, names, units_row):
    path = tmp_path_factory.getbasetemp() / "names.csv"
    results(names).to_csv(path, units_row=units_row)
    assert Results.from_csv(path).names == names


@pytest.mark.parametrize("ending", [".csv", ".parquet", ".npz", ".json", ".mat"])
@pytest.mark.parametrize("units", [{}, {"a.x (A)": "mA", "a.y": "m"}])
def test_names_that_end_as_with_a_unit_are_whole_in_each_format(tmp_path, ending, units):
    names = ["a.x (A)", "a.y", "a.y [m]", "a.[s]"]
    made = dataclasses.replace(results(names), info={"units": units})
    made.save(tmp_path / f"r{ending}")
    back = Results.read(tmp_path / f"r{ending}")
    assert back.names == names
    assert back.units == ({} if ending == ".csv" else units)
    made.to_csv(tmp_path / "u.csv", units_row=True)
    again = Results.read(tmp_path / "u.csv")
    assert (again.names, again.units) == (names, units)


def test_what_others_write_behind_a_name_is_still_its_unit(tmp_path):
    (tmp_path / "r.csv").write_text('"time","a.x (A)","a.y (A) []"\n0,1,2\n', encoding="utf-8")
    back = Results.from_csv(tmp_path / "r.csv")
    assert (back.names, back.units) == (["a.x", "a.y (A)"], {"a.x": "A"})


def test_header_is_one_line_of_quoted_names(tmp_path):
    results(["a.x[1,2]", "a.'say \"no\"'"]).to_csv(tmp_path / "r.csv")
    lines = (tmp_path / "r.csv").read_text(encoding="utf-8").splitlines()
    assert lines == ['"time","a.x[1,2]","a.\'say ""no""\'"', "0,0,1"]
    assert next(csv.reader(lines)) == ["time", "a.x[1,2]", "a.'say \"no\"'"]


def test_results_without_rows_or_columns_round_trip(tmp_path):
    for names, rows in ((["a.x"], 0), ([], 3), ([], 0)):
        Results(time=np.arange(float(rows)), names=names, values=np.zeros((rows, len(names)))).to_csv(
            tmp_path / "r.csv"
        )
        back = Results.from_csv(tmp_path / "r.csv")
        assert back.names == names
        assert back.time.tolist() == list(range(rows))
        assert back.values.shape == (rows, len(names))


def test_scalars_and_vectors_by_name():
    r = results(["g.u", "g.y[1]", "g.y[2]", "g.M[1,1]", "g.M[1,2]", "g.yy[1]"])
    assert r["time"].tolist() == [0.0]
    assert r["g.u"].tolist() == [0.0]
    assert r["g.y[2]"].tolist() == [2.0]
    assert r["g.y"].tolist() == [[1.0, 2.0]]
    assert r["g.M"].tolist() == [[3.0, 4.0]]
    assert "g.y" in r
    assert "g.y[3]" not in r
    assert "g" not in r


def test_elements_of_a_vector_come_in_the_order_of_their_indices():
    names = [f"g.y[{i}]" for i in (10, 2, 1, 3, 9, 4, 8, 5, 7, 6)]
    r = results(names, [[float(re.findall(r"\d+", n)[0]) for n in names]])
    assert r["g.y"].tolist() == [[float(i) for i in range(1, 11)]]


@pytest.mark.parametrize("name", ["plant.theta", "plnt.theta_a", "plant.theta_a[4]"])
def test_missing_name_offers_the_nearest(name):
    r = results(["plant.theta_a[1]", "plant.theta_a[2]", "controller.tau"])
    with pytest.raises(ResultsError, match=rf"'{re.escape(name)}'; did you mean 'plant\.theta_a") as refused:
        r[name]
    assert isinstance(refused.value, CosimError)


def test_missing_name_lists_what_is_there_when_nothing_is_near():
    with pytest.raises(ResultsError, match=r"'zzz'; known are a\.x, a\.y"):
        results(["a.x", "a.y"])["zzz"]
    with pytest.raises(ResultsError, match="there are none"):
        results([])["zzz"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the first column must be 'time'"),
        ("\n", "the first column must be 'time'"),
        ("T,x\n0,1\n", "the first column must be 'time'"),
        ("x,time\n0,1\n", "the first column must be 'time'"),
        ("time,x\n0,1\n1\n", "line 3 has 1 columns, the header has 2"),
        ("time,x\n0,1\n1,2,3\n", "line 3 has 3 columns, the header has 2"),
        ("time,x\n0,1\n1,two\n", "line 3: a cell 'two' is not a number"),
        ("time,x\n0,1\n1,\n", "line 3: a cell is empty"),
    ],
)
def test_bad_csv_is_refused_with_file_and_line(tmp_path, text, message):
    path = tmp_path / "bad.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ResultsError, match=re.escape(message)) as refused:
        Results.from_csv(path)
    assert "bad.csv" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_unreadable_files_are_refused(tmp_path):
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00time")
    for name, why in (("missing.csv", ": No such file"), ("binary.csv", " as CSV: "), (".", ": Is a directory")):
        with pytest.raises(ResultsError, match=f"can't be read{why}"):
            Results.from_csv(tmp_path / name)


def test_a_csv_saved_by_a_spreadsheet_is_read(tmp_path):
    # spreadsheets write a byte order mark and \r\n
    (tmp_path / "r.csv").write_bytes(b"\xef\xbb\xbftime,a.x\r\n0,1\r\n")
    back = Results.from_csv(tmp_path / "r.csv")
    assert (back.time.tolist(), back["a.x"].tolist()) == ([0.0], [1.0])


def test_writing_to_an_impossible_place_raises_oserror(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    for place in ("file/r.csv", "nowhere/r.csv", "folder"):
        with pytest.raises(OSError, match=r"folder|nowhere|file"):
            results(["a.x"]).to_csv(tmp_path / place)


def test_a_file_that_is_written_again_is_replaced_whole(tmp_path):
    results(["a.x"], [[1.0], [2.0]]).to_csv(tmp_path / "r.csv")
    results(["a.x"], [[3.0]]).to_csv(tmp_path / "r.csv")
    assert Results.from_csv(tmp_path / "r.csv")["a.x"].tolist() == [3.0]
    assert [p.name for p in tmp_path.iterdir()] == ["r.csv"]
