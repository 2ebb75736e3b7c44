"""Lookup tables in numpy: values and slopes worked out by hand, text files, and data that are no table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fmu_export import Table
from fmu_export.errors import ArgumentError
from fmu_export.modelling.tables import table_of_text

#: Slopes 2, then -1.
CURVE = Table("curve", [0.0, 1.0, 3.0], [1.0, 3.0, 1.0])

#: x + 10 y + x y in each cell: bilinear interpolation is exact. The cells differ in width and in height.
X, Y = np.array([0.0, 1.0, 3.0]), np.array([-1.0, 1.0, 2.0, 6.0])
MAP = Table("map", X, Y, X[:, None] + 10.0 * Y + X[:, None] * Y)

#: Texts of the two.
CURVE_TEXT = "x,y\n0.0,1.0\n1.0,3.0\n3.0,1.0\n"
MAP_TEXT = "x\\y,-1.0,1.0,2.0,6.0\n0.0,-10.0,10.0,20.0,60.0\n1.0,-10.0,12.0,23.0,67.0\n3.0,-10.0,16.0,29.0,81.0\n"


def test_values_lie_on_the_lines_between_breakpoints_and_stay_beyond_the_ends() -> None:
    np.testing.assert_allclose(CURVE([-5.0, 0.0, 0.5, 1.0, 2.5, 3.0, 9.0]), [1.0, 1.0, 2.0, 3.0, 1.5, 1.0, 1.0])
    assert CURVE(0.25) == 1.5
    x, y = np.meshgrid([0.0, 0.25, 1.0, 2.5, 3.0], [-1.0, 0.5, 1.0, 1.75, 5.0, 6.0])
    np.testing.assert_allclose(MAP(x, y), x + 10.0 * y + x * y, rtol=1e-14)
    assert MAP(-7.0, 9.0) == 60.0
    assert MAP(9.0, -7.0) == -10.0
    assert MAP(2.0, 9.0) == 74.0


def test_slopes_are_those_to_the_right_and_zero_beyond_the_ends() -> None:
    (slope,) = CURVE.slopes(np.array([-0.1, 0.0, 0.5, 1.0, 2.9, 3.0, 4.0]))
    np.testing.assert_allclose(slope, [0.0, 2.0, 2.0, -1.0, -1.0, 0.0, 0.0])
    x, y = np.meshgrid([0.0, 0.25, 1.0, 2.5], [-1.0, 0.5, 1.0, 1.75, 5.0])
    by_x, by_y = MAP.slopes(x, y)
    np.testing.assert_allclose(by_x, 1.0 + y, atol=1e-13)
    np.testing.assert_allclose(by_y, 10.0 + x, rtol=1e-13)
    for place, slopes in (((-1.0, 2.0), (0.0, 10.0)), ((3.0, 2.0), (0.0, 13.0)), ((2.0, 6.0), (7.0, 0.0))):
        np.testing.assert_allclose(MAP.slopes(*place), slopes, rtol=1e-13, err_msg=str(place))
    assert np.isnan(CURVE.slopes(np.nan)).all()
    assert np.isnan(MAP.slopes(np.nan, 0.0)).all()
    assert np.isnan(MAP.slopes(0.0, np.nan)).all()


@pytest.mark.parametrize(("table", "text"), [(CURVE, CURVE_TEXT), (MAP, MAP_TEXT)], ids=["curve", "map"])
def test_a_table_is_written_as_it_is_read(table: Table, text: str, tmp_path: Path) -> None:
    assert table.text == text
    path = tmp_path / "other.csv"
    path.write_text(text, encoding="utf-8-sig")
    read = Table.from_file(path)
    assert read.name == "other"
    assert Table.from_file(path, "own").name == "own"
    assert read.has_data_of(table)
    assert read.n_variables == len(table.breakpoints)
    spaced = table_of_text(text.replace("\n", "\n \n").replace(",", " , "), "spaced", "spaced.csv")
    assert spaced.has_data_of(table)


def test_a_table_over_one_variable_needs_no_headings() -> None:
    read = table_of_text("0,1\n\n1,3\n3,1\n", "curve", "curve.csv")
    assert read.has_data_of(CURVE)


@pytest.mark.parametrize(
    "other",
    [
        Table("curve", [0.0, 1.0, 3.0], [1.0, 3.0, np.nextafter(1.0, 2.0)]),
        Table("curve", [0.0, 1.0, np.nextafter(3.0, 4.0)], [1.0, 3.0, 1.0]),
        Table("curve", [-0.0, 1.0, 3.0], [1.0, 3.0, 1.0]),
        Table("curve", [0.0, 1.0], [1.0, 3.0]),
        MAP,
    ],
    ids=["value", "breakpoint", "sign of zero", "fewer", "two variables"],
)
def test_other_data_are_others(other: Table) -> None:
    assert not CURVE.has_data_of(other)
    assert not other.has_data_of(CURVE)


def test_data_are_copied_and_do_not_change() -> None:
    x, y = np.array([0.0, 1.0]), np.array([0.0, 1.0])
    table = Table("t", x, y)
    y[1] = 5.0
    assert table(1.0) == 1.0
    for array in (table.x, table.values, *MAP.breakpoints, MAP.values):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 2.0


@pytest.mark.parametrize(
    ("x", "y", "z", "said"),
    [
        ([0.0], [1.0], None, r"table 't': x has the shape \(1,\); give at least two breakpoints"),
        ([[0.0, 1.0]], [1.0, 2.0], None, r"x has the shape \(1, 2\)"),
        ([0.0, 1.0, 1.0], [1.0, 2.0, 3.0], None, r"table 't': x does not increase: 1\.0 follows 1\.0"),
        ([0.0, 2.0, 1.0], [1.0, 2.0, 3.0], None, r"x does not increase: 1\.0 follows 2\.0"),
        ([0.0, 1.0], [3.0, 2.0], [[0.0, 0.0]] * 2, r"y does not increase: 2\.0 follows 3\.0"),
        ([0.0, 1.0], [3.0], [[0.0]] * 2, r"y has the shape \(1,\)"),
        ([0.0, 1.0], [1.0, 2.0, 3.0], None, r"its values have the shape \(3,\); \(2,\) fits"),
        ([0.0, 1.0], [0.0, 1.0, 2.0], [[0.0] * 2] * 3, r"its values have the shape \(3, 2\); \(2, 3\) fits"),
        ([0.0, np.inf], [1.0, 2.0], None, "table 't' has a number that is not finite"),
        ([0.0, 1.0], [1.0, np.nan], None, "not finite"),
        ([0.0, 1.0], [1.0, 2.0], [[0.0, 0.0], [0.0, np.nan]], "not finite"),
        ([0.0, "a"], [1.0, 2.0], None, "table 't': its data are not arrays of numbers"),
    ],
)
def test_what_is_no_table_is_named(x: list, y: list, z: list | None, said: str) -> None:
    with pytest.raises(ArgumentError, match=said):
        Table("t", x, y, z)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "t.csv is not a table: separate numbers by commas, at least two in a line"),
        ("\n \n", "t.csv is not a table"),
        ("x\n1\n2\n", "t.csv is not a table"),
        ("x,y\n1,2\nx,y\n", "t.csv, line 3: 'x' is not a number"),
        ("0,1\n1, two\n", "t.csv, line 2: 'two' is not a number"),
        ("x,0,one\n0,1,2\n1,2,3\n", "t.csv, line 1: 'one' is not a number"),
        ("x,y\n\n0,1\n1,2,3\n", "t.csv, line 4 has 3 cells; the first line has 2"),
        ("x,0,1\n0,1,2\n1,2\n", "t.csv, line 3 has 2 cells; the first line has 3"),
    ],
)
def test_a_text_that_is_no_table_is_named(text: str, said: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        table_of_text(text, "t", "t.csv")
    assert said in str(caught.value)


def test_a_table_is_called_with_as_many_values_as_it_has_variables() -> None:
    with pytest.raises(ArgumentError, match=r"table 'curve' is called with 2 values; it has 1"):
        CURVE(0.0, 1.0)
    with pytest.raises(ArgumentError, match=r"table 'map' is called with 1 values; it has 2"):
        MAP(0.0)
