"""Tables of other tools: read as what they mean, or refused where they could mean two things."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from scipy.io import savemat

from cosim import CosimError, Results, StoredResults, TableWriter
from cosim.results.formats import FORMATS

PLAIN = "time,m.u,m.y\n0,0.5,1\n1,1.5,2\n"


def read(folder: Path, text: str, encoding: str = "utf-8") -> Results:
    path = folder / "table.csv"
    path.write_bytes(text.encode(encoding))
    return Results.read(path)


@pytest.mark.parametrize(
    "text",
    [
        PLAIN,
        "time;m.u;m.y\n0;0.5;1\n1;1.5;2\n",
        "time;m.u;m.y\n0;0,5;1\n1;1,5;2,0\n",
        "time\tm.u\tm.y\n0\t0,5\t1\n1\t1,5\t2\n",
        "time\tm.u\tm.y\n0\t5e-1\t1\n1\t1.5\t2\n",
        'time,m.u,m.y\n0,"0,5",1\n1,"1,5",2\n',
        "sep=;\ntime;m.u;m.y\n0;0,5;1\n1;1,5;2\n",
        "time,m.u,m.y\n0,0.5,1\n1,1.5,2\n\n",
        "\n\ntime,m.u,m.y\n0,0.5,1\n\n1,1.5,2\n,,\n \n",
        "time,m.u,m.y,\n0,0.5,1,\n1,1.5,2,\n",
        "time,m.u,m.y\n0,0.5,1,\n1,1.5,2,\n",
        "time,m.u,m.y,\n0,0.5,1\n1,1.5,2\n",
        "Time,m.u,m.y\n0,0.5,1\n1,1.5,2",
        '"TIME","m.u","m.y"\r\n"0","0.5","1"\r\n"1","1.5","2"\r\n',
        "time,m.u,m.y\r0,0.5,1\r1,1.5,2\r",
        "t, m.u , m.y\n0, 0.5, 1\n1, 1.5 ,2\n",
        "\ufefftime,m.u,m.y\n0,0.5,1\n1,1.5,2\n",
        "# made by a tool\n#\n# on a day\ntime,m.u,m.y\n0,0.5,1\n1,1.5,2\n",
        "# time,m.u,m.y\n0.0e+00,5.0e-01,1.0e+00\n1.0e+00,1.5e+00,2.0e+00\n",
    ],
)
def test_one_table_in_many_dialects(tmp_path: Path, text: str) -> None:
    found = read(tmp_path, text)
    assert (found.time.tolist(), found.names) == ([0.0, 1.0], ["m.u", "m.y"])
    assert found.values.tolist() == [[0.5, 1.0], [1.5, 2.0]]
    assert not found.units
    assert not found.typed


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le"])
def test_unicode_text_of_spreadsheets(tmp_path: Path, encoding: str) -> None:
    text = "time;Öl\n0;1,5\n" if encoding == "utf-16" else "\ufefftime;Öl\n0;1,5\n"
    assert read(tmp_path, text, encoding)["Öl"].tolist() == [1.5]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time,x\n0,0,1,5\n", "line 2 has 4 columns, the header has 2"),
        ("time;x;y\n0;1.5;2\n1;1;2,5\n", "line 3 has '2,5' and line 2 has '1.5'"),
        ("time;x\n0,5;1.5\n", "line 2 has '0,5' and line 2 has '1.5'"),
        ("time;x\n0;1,234\n1;2,000\n", "line 2: '1,234' may be 1.234 or 1234"),
        ('time,x\n0,"1,234"\n', "line 2: '1,234' may be 1.234 or 1234"),
        ("time;x\n0;1.234,5\n1;2\n", "line 2: a cell '1.234,5' is not a number"),
        ("time,x\n0,1 2 3\n1,1 2\n", "line 3: '1 2' has 2 elements, line 2 has 3"),
        ("time,x\n0,true\n1,0\n", "line 2: a cell 'true' is not a number"),
        ("time,x\n0,1\n1, \n", "line 3: a cell is empty"),
        ("time,x\n\n0,1\n1,one\n", "line 4: a cell 'one' is not a number"),
        ("time,x,y,x\n0,1,2,3\n", "line 1: column 'x' is there twice"),
        ("time,x,Time,time\n0,1,2,3\n", "column 'time' is there twice"),
        ("time,,x\n0,1,2\n", "line 1: column 2 has no name"),
        ("time,x\n0,inf\n1,1e400\n", "line 3: '1e400' is larger than any number that can be kept"),
        ('time,"x\n0,1\n1,2\n', "line 3: can't be read as CSV: unexpected end of data"),
        ("time,x\n2026-11-30,1\n", "line 2: column 'time' has '2026-11-30', which is not a number"),
        ("time [ms],x\n0,1\n", "the time is in 'ms'; it must be in s"),
        ("time,x\nmin,m\n0,1\n", "line 2: the time is in 'min'; it must be in s"),
        ("time x\n0 1\n", "columns be separated by comma, semicolon or tab"),
        (",time,x\n0,0,1\n", "write the file without an index before it"),
        ("T,x\n0,1\n", "the first column must be 'time'"),
        ("x,time\n0,1\n", "the first column must be 'time'"),
    ],
)
def test_what_could_mean_two_things_or_nothing_is_one_line(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(CosimError) as refused:
        read(tmp_path, text)
    message = str(refused.value)
    assert message.startswith(f"{tmp_path / 'table.csv'}: ")
    assert says in message
    assert "\n" not in message


def test_a_file_in_an_old_encoding_is_not_guessed(tmp_path: Path) -> None:
    with pytest.raises(CosimError, match="save it as UTF-8"):
        read(tmp_path, "time;T [°C]\n0;1\n", "cp1252")


def test_units_behind_names_and_in_a_row_below(tmp_path: Path) -> None:
    units = {"m.x": "m", "m.w": "rad/s"}
    found = read(tmp_path, 'Time [s];m.x [m];"m.w (rad/s)";m.v[2];m.b\n0;1;2;3;4\n')
    assert (found.names, found.units) == (["m.x", "m.w", "m.v[2]", "m.b"], units)
    found = read(tmp_path, '"time","m.x","m.w","m.v[2]"\n"s","m","[rad/s]",""\n0,1,2,3\n')
    assert (found.names, found.units, found.values.tolist()) == (["m.x", "m.w", "m.v[2]"], units, [[1.0, 2.0, 3.0]])
    assert read(tmp_path, "time,m.x [-]\n0,1\n").units == read(tmp_path, "time,m.x\ns,-\n0,1\n").units == {"m.x": "1"}
    # without the brackets the names would be the same
    assert read(tmp_path, "time,x [a],x [b]\n0,1,2\n").names == ["x [a]", "x [b]"]


@pytest.mark.parametrize("ending", ["csv", "parquet", "json", "npz", "mat"])
def test_names_that_end_in_brackets_come_back(ending: str, tmp_path: Path) -> None:
    """An index by a name is no unit, in files of ours whatever its letters are."""
    names = ["m.a[k]", "m.a[m]", "m.b[axis.x]", "m.c(N)"]
    written = Results(np.array([0.0, 1.0]), names, np.arange(8.0).reshape(2, 4), {"units": {"m.a[k]": "N.m"}})
    written.save(tmp_path / f"table.{ending}")
    found = Results.read(tmp_path / f"table.{ending}")
    assert found.names == names
    np.testing.assert_array_equal(found.values, written.values)


def test_an_index_by_a_letter_is_no_unit_in_files_of_others(tmp_path: Path) -> None:
    found = read(tmp_path, "time,a[k],b[m],c[kg]\n0,1,2,3\n")
    assert (found.names, found.units) == (["a[k]", "b", "c"], {"b": "m", "c": "kg"})


def test_columns_of_other_types(tmp_path: Path) -> None:
    found = read(tmp_path, 'time,on,mode,"a, b"\n0,True,idle,1\n1,FALSE,"on, slow",2\n')
    assert found.types == {"on": "bool", "mode": "string"}
    assert found["on"].tolist() == [True, False]
    assert found["mode"].tolist() == ["idle", "on, slow"]
    assert found["a, b"].tolist() == [1.0, 2.0]


def test_whole_numbers_that_are_no_doubles_are_exact(tmp_path: Path) -> None:
    large = [2**53 + 1, -(2**63), 2**63 - 1]
    found = read(tmp_path, "time,n,m\n" + "".join(f"{i},{n},{2**64 - 1 - i}\n" for i, n in enumerate(large)))
    assert found.types == {"n": "int64", "m": "uint64"}
    assert found["n"].tolist() == large
    assert found["m"].tolist() == [2**64 - 1 - i for i in range(3)]


def test_arrays_in_cells_and_indices_in_names(tmp_path: Path) -> None:
    found = read(tmp_path, 'time,"v","b"\n0.0,1 2 3,true false\n1.0,4 5 6,true true\n')
    assert found["v"].tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert found["b"].tolist() == [[True, False], [True, True]]
    assert read(tmp_path, "time;v\n0;1,5 2\n1;3 4,5\n")["v"].tolist() == [[1.5, 2.0], [3.0, 4.5]]
    assert read(tmp_path, "time,M[1,1],M[1,2],x\n0,1,2,3\n").names == ["M[1,1]", "M[1,2]", "x"]


def made(folder: Path) -> Results:
    (folder / "own.csv").write_text("time,a.x,a.on,a.mode\n0,0.1,true,idle\n1,0.2,false,on\n", encoding="utf-8")
    own = Results.read(folder / "own.csv")
    own.info["units"] = {"a.x": "m"}
    return own


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_saved_is_read(tmp_path: Path, name: str) -> None:
    own, known = made(tmp_path), FORMATS[name]
    own.save(tmp_path / f"r.{name}")
    back = Results.read(tmp_path / f"r.{name}")
    names = own.names if known.has_texts else ["a.x", "a.on"]
    assert back.names == names
    assert back.time.tolist() == own.time.tolist()
    for column in names:
        assert back[column].tolist() == own[column].tolist()
    assert back.units == ({} if name == "csv" else {"a.x": "m"})


def test_a_row_of_units_is_written_where_it_is_asked_for(tmp_path: Path) -> None:
    own = made(tmp_path)
    own.to_csv(tmp_path / "r.csv", units_row=True)
    lines = (tmp_path / "r.csv").read_text(encoding="utf-8").splitlines()
    assert lines[:3] == ['"time","a.x","a.on","a.mode"', '"s","m","",""', '0,0.1,true,"idle"']
    back = Results.read(tmp_path / "r.csv")
    assert (back.units, back["a.mode"].tolist()) == ({"a.x": "m"}, ["idle", "on"])
    with TableWriter([tmp_path / "s.csv", tmp_path / "s.parquet"], ["a.x"], None, {"a.x": "m"}, units_row=True) as rows:
        rows(np.zeros(1), np.ones((1, 1)))
    assert (tmp_path / "s.csv").read_text(encoding="utf-8") == '"time","a.x"\n"s","m"\n0,1\n'
    assert Results.read(tmp_path / "s.parquet").units == {"a.x": "m"}
    assert StoredResults(tmp_path / "s.parquet", {})["a.x"].tolist() == [1.0]


def test_tables_of_data_frames(tmp_path: Path) -> None:
    table = {"x": [1.0, None], "n": [2**53 + 1, 3], "v": [[1.0, 2.0], [3.0, 4.0]], "Time": [0, 1]}
    frame = pa.table({**table, "__index_level_0__": [0, 1]})
    parquet.write_table(frame, tmp_path / "f.parquet")
    (tmp_path / "lists.json").write_text(json.dumps(table), encoding="utf-8")
    rows = [dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True)]
    (tmp_path / "rows.json").write_text(json.dumps(rows), encoding="utf-8")
    for name in ("f.parquet", "lists.json", "rows.json"):
        found = Results.read(tmp_path / name)
        assert found.names == ["x", "n", "v[1]", "v[2]"], name
        assert found.time.tolist() == [0.0, 1.0]
        assert found["x"][0] == 1.0
        assert np.isnan(found["x"][1])
        assert found["n"].tolist() == [2**53 + 1, 3]
        assert found["v"].tolist() == [[1.0, 2.0], [3.0, 4.0]]
    np.savez(tmp_path / "a.npz", time=np.arange(2.0), v=np.ones((2, 3)))
    assert Results.read(tmp_path / "a.npz").names == ["v[1]", "v[2]", "v[3]"]


@pytest.mark.parametrize("version", ["4", "5"])
def test_vectors_that_matlab_saved(tmp_path: Path, version: str) -> None:
    data = {"t": np.arange(3.0)[:, np.newaxis], "x": np.array([[1.0, 2.0, 3.0]]), "M": np.arange(6.0).reshape(3, 2)}
    savemat(tmp_path / "m.mat", data, format=version)
    found = Results.read(tmp_path / "m.mat")
    assert found.time.tolist() == [0.0, 1.0, 2.0]
    assert found["x"].tolist() == [1.0, 2.0, 3.0]
    assert found["M"].tolist() == data["M"].tolist()
    savemat(tmp_path / "m.mat", {**data, "p": np.ones((2, 2))}, format=version)
    with pytest.raises(CosimError, match="'p' has no row for each time"):
        Results.read(tmp_path / "m.mat")
    savemat(tmp_path / "m.mat", {"x": np.ones((3, 1))}, format=version)
    with pytest.raises(CosimError, match="has no variables of the name 'time'"):
        Results.read(tmp_path / "m.mat")


def characters(texts: list[str]) -> np.ndarray:
    width = max(map(len, texts))
    return np.array([list(text.ljust(width)) for text in texts])


@pytest.mark.parametrize("layout", ["binTrans", "binNormal"])
def test_trajectories_with_parameters_and_aliases(tmp_path: Path, layout: str) -> None:
    """As Dymola and OpenModelica write them: parameters have two rows, an alias is a column with its sign."""
    data = {
        "name": characters(["Time", "body.x", "body.m", "minus.x"]),
        "description": characters(["Time in [s]", "place [m|mm]", "mass [kg]", "[m]"]),
        "dataInfo": np.array([[0, 1, 0, -1], [2, 2, 0, -1], [1, 2, 0, 0], [2, -2, 0, -1]], dtype=np.int32),
        "data_1": np.array([[0.0, 7.0], [2.0, 7.0]]),
        "data_2": np.array([[0.0, 0.5], [1.0, 1.5], [2.0, 2.5]], dtype=np.float32),
    }
    turned = {name: np.ascontiguousarray(m.T) if layout == "binTrans" else m for name, m in data.items()}
    savemat(tmp_path / "r.mat", {"Aclass": characters(["Atrajectory", "1.1", "", layout]), **turned}, format="4")
    found = Results.read(tmp_path / "r.mat")
    assert found.names == ["body.x", "body.m", "minus.x"]
    assert found.time.tolist() == [0.0, 1.0, 2.0]
    assert found.values.tolist() == [[0.5, 7.0, -0.5], [1.5, 7.0, -1.5], [2.5, 7.0, -2.5]]
    assert found.units == {"body.x": "m", "body.m": "kg", "minus.x": "m"}
    whole = (tmp_path / "r.mat").read_bytes()
    (tmp_path / "r.mat").write_bytes(whole[:-1])
    with pytest.raises(CosimError, match="ends early"):
        Results.read(tmp_path / "r.mat")


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.json", b'{"x": [1]}', "no column 'time'"),
        ("a.json", b'{"time": {"0": 1}}', "must be an object with a list for each name"),
        ("a.json", b'{"time": [0, 1], "x": [1]}', "'x' has 1 values for 2 times"),
        ("a.json", b'{"time": [0], "x": ["a", 1]', "can't be read as JSON"),
        ("a.json", b'{"time": [0, 1], "x": ["a", 1]}', "'x' has values of several kinds"),
        ("a.mat", struct.pack("<5i", 77, 1, 1, 0, 2) + b"x\0", "is not a MAT file"),
        ("a.mat", b"MATLAB 7.3 MAT-file", "save it with -v7"),
        ("a.csv", b"PAR1....", "is a table in Parquet; let its name end in .parquet"),
        ("a.npz", b"time,x\n0,1\n", "is a table in CSV; let its name end in .csv"),
        ("a.parquet", b"", "can't be read as Parquet"),
    ],
)
def test_files_that_are_no_tables_are_one_line(tmp_path: Path, name: str, content: bytes, says: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CosimError) as refused:
        Results.read(tmp_path / name)
    assert says in str(refused.value)
    assert str(refused.value).startswith(str(tmp_path / name))
    assert "\n" not in str(refused.value)


def test_a_name_must_not_stand_twice_in_any_format(tmp_path: Path) -> None:
    parquet.write_table(pa.table([[0.0], [1.0], [2.0]], names=["time", "x", "x"]), tmp_path / "a.parquet")
    np.savez(tmp_path / "b.npz", **{"time": np.zeros(1), "v": np.zeros((1, 1)), "v[1]": np.zeros(1)})
    for name in ("a.parquet", "b.npz"):
        with pytest.raises(CosimError, match="is there twice"):
            Results.read(tmp_path / name)
