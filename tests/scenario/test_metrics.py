"""Metrics that scenarios name, against numbers on paper."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.results.results import Results
from cosim.scenario.metrics import MEASURES, Metric, measured

TIME = np.array([0.0, 1.0, 2.0, 4.0])
RESULTS = Results(TIME, ["a.x", "a.y"], np.array([[1.0, 0.0], [-5.0, 1.0], [3.0, 1.0], [2.0, 3.0]]))

#: measure -> of a.x, of a.x - a.y = (1, -6, 2, -1), of a.x from 1.5 s on
EXPECTED = {
    "max": (3.0, 2.0, 3.0),
    "min": (-5.0, -6.0, 2.0),
    "max_abs": (5.0, 6.0, 3.0),
    "mean": (0.25, -1.0, 2.5),
    "rms": ((39 / 4) ** 0.5, (42 / 4) ** 0.5, (13 / 2) ** 0.5),
    "std": ((39 / 4 - 1 / 16) ** 0.5, (42 / 4 - 1) ** 0.5, 0.5),
    "initial": (1.0, 1.0, 3.0),
    "final": (2.0, -1.0, 2.0),
    "integral": (-2.0 - 1.0 + 5.0, -2.5 - 2.0 + 1.0, 5.0),
    "integral_abs": (3.0 + 4.0 + 5.0, 3.5 + 4.0 + 3.0, 5.0),
    "integral_squared": (13.0 + 17.0 + 13.0, 18.5 + 20.0 + 5.0, 13.0),
}


def test_every_measure_is_tested() -> None:
    assert set(EXPECTED) == set(MEASURES)


@pytest.mark.parametrize("measure", EXPECTED)
def test_measures_on_paper(measure: str) -> None:
    metrics = {
        "whole": Metric("a.x", measure),
        "difference": Metric("a.x", measure, minus="a.y"),
        "late": Metric("a.x", measure, after=1.5),
    }
    found = measured(metrics, RESULTS)
    assert list(found) == ["whole", "difference", "late"]
    assert tuple(found.values()) == pytest.approx(EXPECTED[measure], rel=1e-14)


def test_a_point_at_the_time_itself_counts() -> None:
    assert Metric("a.x", "initial", after=2.0).value(RESULTS) == 3.0
    assert Metric("a.x", "initial", after=2.0000001).value(RESULTS) == 2.0


def test_what_can_t_be_computed_is_none() -> None:
    assert Metric("a.x", "max", after=5.0).value(RESULTS) is None
    assert Metric("a.z", "max").value(RESULTS) is None
    assert Metric("a.x", "max", minus="a.z").value(RESULTS) is None
    huge = Results(TIME, ["a.x"], np.full((4, 1), 1e200))
    assert Metric("a.x", "rms").value(huge) is None
    assert Metric("a.x", "max").value(huge) == 1e200


def test_an_unknown_measure_offers_the_nearest() -> None:
    with pytest.raises(ValueError, match="measure = 'meen' is unknown; did you mean 'mean'"):
        Metric("a.x", "meen")
