"""The curves of a run as SVG: read back by the labels of their axes they are the values."""

from __future__ import annotations

import numpy as np
import pytest
from lxml import etree

from fmu_export.modelling.variables import Layout, Variable
from fmu_export.package.plot import curves

SVG = "{http://www.w3.org/2000/svg}"
TIME = np.linspace(2.0, 5.0, 31)


def drawn(values: np.ndarray, *variables: Variable) -> etree._Element:
    return etree.fromstring(curves(Layout(variables), TIME, values))


def numbers_along(texts: list[etree._Element], coordinate: str) -> np.poly1d:
    """Number of a place (px), by the labels of an axis; one step between labels is a step everywhere."""
    places = [float(text.get(coordinate)) for text in texts]
    numbers = [float(text.text) for text in texts]
    assert len(numbers) > 1
    line = np.polyfit(places, numbers, 1)
    assert np.polyval(line, places) == pytest.approx(numbers, abs=2e-3 * (max(numbers) - min(numbers)))
    return np.poly1d(line)


@pytest.mark.parametrize(("offset", "size"), [(0.0, 1.0), (1e4, 3.0), (-0.2, 1e-7), (5.0, 2e9)])
def test_curves_are_the_values(offset: float, size: float):
    values = offset + size * np.sin(TIME)
    root = drawn(values[:, None], Variable("height", "m", "Height"))
    texts = root.findall(f"{SVG}text")
    assert {"height (m)", "time (s)"} <= {text.text for text in texts}
    (path,) = root.findall(f"{SVG}path")
    x, y = np.array([pair.split(",") for pair in path.get("d")[1:].split()], dtype=float).T
    across = numbers_along([t for t in texts if t.get("class") == "x" and t.text != "time (s)"], "x")
    up = numbers_along([t for t in texts if t.get("class") == "y"], "y")
    assert across(x) == pytest.approx(TIME, abs=0.01 * 3.0)
    # the labels stand a little below their lines
    assert up(y + 3.5) == pytest.approx(values, abs=0.01 * np.ptp(values))


def test_each_element_of_a_vector_has_a_curve_and_a_label():
    values = np.stack([np.sin(TIME), np.cos(TIME), TIME, np.full(31, 7.0)], axis=1)
    root = drawn(values, Variable("x", "m", "Place", size=3), Variable("y", "1", "Constant"))
    texts = [text.text for text in root.findall(f"{SVG}text")]
    assert [text for text in texts if text.startswith("[")] == ["[1]", "[2]", "[3]"]
    assert {"x (m)", "y"} <= set(texts)
    colours = [path.get("stroke") for path in root.findall(f"{SVG}path")]
    assert len(colours) == 3 * 2 + 1
    assert len(set(colours)) == 3


@pytest.mark.parametrize("value", [0.0, 1e300, -3.0])
def test_a_constant_stands_in_the_middle(value: float):
    root = drawn(np.full((31, 1), value), Variable("y", "1", "Constant"))
    (frame,) = root.findall(f"{SVG}rect")
    (path,) = root.findall(f"{SVG}path")
    middle = float(frame.get("y")) + float(frame.get("height")) / 2
    heights = {float(pair.split(",")[1]) for pair in path.get("d")[1:].split()}
    (height,) = heights
    assert height == pytest.approx(middle, abs=0.1)
