"""The points of a sweep: counts, ranges, reproducible, and refused where they make no sense."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from cosim.sweep.batch import BatchSize
from cosim.sweep.errors import SweepError
from cosim.sweep.points import MOST_POINTS, Levels, Range, advice, design, parse_factor, parse_whole_numbers

ALPHA, BETA = Range("controller.alpha", 0.5, 3.0), Levels("controller.beta", (1.0, 1.5, 2.0))
SCENARIO = Levels("scenario", ("tracking", "pd"))


def one_line(error: pytest.ExceptionInfo) -> str:
    assert "\n" not in str(error.value)
    return str(error.value)


# Factors as text


def test_a_factor_is_a_range_levels_or_a_list():
    assert parse_factor("a.x=0.5:3") == Range("a.x", 0.5, 3.0)
    assert parse_factor("a.x=-1:1:5") == Levels("a.x", (-1.0, -0.5, 0.0, 0.5, 1.0))
    assert parse_factor("a.x[1]=1,1.5,2e-3") == Levels("a.x[1]", (1.0, 1.5, 0.002))
    assert parse_factor("a.x=7") == Levels("a.x", (7.0,))
    assert parse_factor("a.b=true,false") == Levels("a.b", ("true", "false"))
    assert parse_factor("a.mode=low,2") == Levels("a.mode", ("low", "2"))
    assert parse_factor('a.name="3","1,5:2"') == Levels("a.name", ("3", "1,5:2"))
    assert parse_whole_numbers("seed", "3:6") == Levels("seed", (3, 4, 5, 6))
    assert parse_whole_numbers("seed", "9,2") == Levels("seed", (9, 2))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a.x", "is not a factor"),
        ("=1", "is not a factor"),
        ("a.x=", "is not a factor"),
        ("a.x=one:2", "'one' is not a number"),
        ("a.x=1,,2", "empty value"),
        ("a.x=1,", "empty value"),
        ('a.x="",1', "empty value"),
        ("a.x=on,off,on", "'on' twice"),
        ("a.x=3:0.5", "empty"),
        ("a.x=1:1", "empty"),
        ("a.x=nan", "not a finite number"),
        ("a.x=nan:1", "not a finite number"),
        ("a.x=0:inf", "not a finite number"),
        ("a.x=-1.7e308:1.7e308", "too wide"),
        ("a.x=1:2:3:4", "4 numbers"),
        ("a.x=0:1:1", "1 levels"),
        ("a.x=0:1:2.5", "not a whole number"),
        ("a.x=0:1:99999999999", "levels of a range"),
        ("a.x=1,2,1", "1.0 twice"),
    ],
)
def test_a_factor_that_makes_no_sense_is_refused_in_one_line(text, says):
    with pytest.raises(SweepError) as error:
        parse_factor(text)
    assert says in one_line(error)
    assert text.partition("=")[0] in str(error.value)


@pytest.mark.parametrize("text", ["", "1.5", "5:3", "1:2:3", "a", "1,1", "0:99999999999"])
def test_seeds_that_make_no_sense_are_refused_in_one_line(text):
    with pytest.raises(SweepError) as error:
        parse_whole_numbers("seed", text)
    one_line(error)


# Designs


def test_a_grid_has_all_combinations_and_the_last_factor_varies_fastest():
    points = design("grid", [SCENARIO, BETA, Levels("seed", (1, 2))])
    assert len(points) == 12
    columns = points.take(np.arange(12))
    assert list(zip(*columns.values(), strict=True)) == list(itertools.product(SCENARIO.values, BETA.values, (1, 2)))
    assert [type(columns[name][0]) for name in ("scenario", "controller.beta", "seed")] == [str, float, int]


def test_a_latin_hypercube_has_one_value_in_each_stratum_and_levels_evenly():
    points = design("lhs", [ALPHA, BETA, SCENARIO], 60, seed=3)
    alpha, beta, scenario = points.take(np.arange(60)).values()
    assert sorted(math.floor((a - 0.5) / 2.5 * 60) for a in alpha) == list(range(60))
    assert [beta.count(b) for b in BETA.values] == [20, 20, 20]
    assert [scenario.count(s) for s in SCENARIO.values] == [30, 30]


def test_sobol_points_are_in_range_and_the_first_of_a_longer_sequence():
    points = design("sobol", [ALPHA, BETA], 100, seed=3)
    alpha, beta = points.take(np.arange(100)).values()
    assert min(alpha) >= 0.5
    assert max(alpha) < 3.0
    assert set(beta) == set(BETA.values)
    longer = design("sobol", [ALPHA, BETA], 128, seed=3)
    assert longer.take(np.arange(100)) == {"controller.alpha": alpha, "controller.beta": beta}
    assert sorted(math.floor((a - 0.5) / 2.5 * 128) for a in longer.take(np.arange(128))["controller.alpha"]) == list(
        range(128)
    )
    assert len(design("sobol", [ALPHA], 1)) == 1


@pytest.mark.parametrize("kind", ["lhs", "sobol"])
def test_a_design_is_the_same_for_the_same_seed_only(kind):
    first, again, other = (design(kind, [ALPHA, BETA], 50, seed).sha256() for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_a_power_of_two_is_recommended_for_sobol_only():
    assert "512 or 1024" in advice("sobol", 1000)
    assert [advice("sobol", 1024), advice("sobol", 1), advice("lhs", 1000), advice("grid", 1000)] == [""] * 4


@pytest.mark.parametrize(
    ("kind", "factors", "points", "seed", "says"),
    [
        ("random", [ALPHA], 5, 0, "design 'random' is unknown"),
        ("grid", [], None, 0, "nothing is varied"),
        ("lhs", [ALPHA, ALPHA], 5, 0, "controller.alpha is varied twice"),
        ("grid", [BETA, ALPHA], None, 0, "a grid needs levels of controller.alpha"),
        ("grid", [BETA], 5, 0, "leave out --points"),
        ("grid", [Levels(n, tuple(range(10_000))) for n in "abc"], None, 0, "split it"),
        ("lhs", [ALPHA], None, 0, "--points"),
        ("sobol", [ALPHA], 0, 0, "at least one"),
        ("sobol", [ALPHA], MOST_POINTS + 1, 0, "split it"),
        ("lhs", [ALPHA], 5, -1, "design seed -1"),
        ("sobol", [Levels(f"x{i}", (0, 1)) for i in range(21_202)], 2, 0, "at most"),
    ],
)
def test_designs_that_make_no_sense_are_refused_in_one_line(kind, factors, points, seed, says):
    with pytest.raises(SweepError) as error:
        design(kind, factors, points, seed)
    assert says in one_line(error)


def test_empty_levels_are_refused():
    with pytest.raises(SweepError, match="no values"):
        Levels("a.x", ())


def test_the_fingerprint_of_points_depends_on_names_and_values():
    prints = {
        design("grid", factors).sha256()
        for factors in ([BETA], [Levels("controller.beta", (1.0, 1.5))], [Levels("other", BETA.values)])
    }
    assert len(prints) == 3


def test_millions_of_points_take_little_memory():
    points = design("grid", [Levels(n, tuple(range(100))) for n in "abc"])
    assert len(points) == 1_000_000
    assert sum(column.nbytes for column in points.columns) == 12_000_000
    assert points.take(np.array([999_999])) == {"a": [99], "b": [99], "c": [99]}


# Batches


def test_batches_take_about_a_second_and_become_single_runs_at_the_end():
    sizes = BatchSize()
    assert sizes.next(10_000, 2) == 1  # nothing is known yet
    sizes.learn(1, 0.05)
    assert 20 <= sizes.next(10_000, 2) <= 40
    assert sizes.next(20, 2) == 5
    assert sizes.next(10_000_000, 1000) == 200  # 10 s: a scheduler takes a hundred tasks a second
    assert sizes.next(1, 2) == 1
    for _ in range(100):
        sizes.learn(1, 8.0)
    assert sizes.next(10_000, 2) == 1
    for _ in range(100):
        sizes.learn(1000, 0.0)
    assert 1000 <= sizes.next(10_000_000, 2) <= 10_000
