"""`cosim tune`: what it prints and what it refuses."""

import argparse
import json

import pytest

from controller_fmu.membership import Trapezoid, psi_moments
from controller_fmu.optimal_gains import NoMinimum, PerformanceIndex, optimal_gains
from parallel_robot.commands import tune


def run(*arguments):
    parser = argparse.ArgumentParser()
    tune.register(parser.add_subparsers())
    args = parser.parse_args(["tune", *arguments])
    return args.run(args)


def record(capsys, *arguments):
    assert run(*arguments, "--json") == 0
    return json.loads(capsys.readouterr().out)


def test_default_is_the_first_row_of_table_1(capsys):
    assert run() == 0
    lines = capsys.readouterr().out.splitlines()
    shown = {line.split()[0]: line.split()[1] for line in lines}
    assert shown["alpha"].startswith("1.35976")
    assert shown["beta"].startswith("1.6620")
    assert shown["J_min"].startswith("9.1328")
    assert "unique       over all alpha, beta > 0" in "\n".join(lines)
    assert "note" not in shown


def test_json_floats_round_trip(capsys):
    gains = optimal_gains(PerformanceIndex(5, 1))
    shown = record(capsys, "--mu", "5")
    assert (shown["alpha"], shown["beta"], shown["J"]) == (gains.alpha, gains.beta, gains.J)
    assert shown["unique_minimum"] is True
    assert shown["covered_by_theorem_1"] is True
    assert shown["written"] is None


def test_table_prints_all_rows(capsys):
    assert run("--table") == 0
    header, *rows = capsys.readouterr().out.splitlines()
    assert header.split() == ["mu", "nu", "alpha", "beta", "J"]
    assert [row.split()[:2] for row in rows] == [["1", "1"], ["5", "1"], ["10", "1"], ["1", "10"], ["1", "5"]]
    printed = [[1.35976, 1.6620, 9.1329], [1.7839, 1.9337, 18.9766], [2.0655, 2.1671, 29.3006]]
    printed += [[0.9419, 1.1195, 34.1584], [1.0503, 1.2535, 22.3282]]
    for row, expected in zip(rows, printed, strict=True):
        assert [float(field) for field in row.split()[2:]] == pytest.approx(expected, abs=6e-5)


def test_table_as_json_is_a_list(capsys):
    assert [(r["mu"], r["nu"]) for r in record(capsys, "--table")] == list(tune.TABLE_1_WEIGHTS)


def test_every_option_reaches_the_index(capsys):
    options = ["--mu", "2", "--nu", "3", "--k", "15", "--S", "3", "0.5", "2", "--s-a", "0.4", "--s-b", "0.1"]
    shown = record(capsys, *options, "--membership", "trapezoid:0,0.1,0.2,0.3", "--independent")
    D2, D4 = psi_moments(Trapezoid(0, 0.1, 0.2, 0.3), shared=False)
    gains = optimal_gains(PerformanceIndex(2, 3, 15, 0.5, 0.4, 0.1, D2, D4))
    assert shown["alpha"] == gains.alpha
    assert shown["lambda_3"] == 0.5
    assert shown["S"] == [3.0, 0.5, 2.0]
    assert shown["k_required"] == pytest.approx(6 * gains.beta)


def test_one_number_for_S_stands_for_all_joints_and_caps_lambda_3_at_one(capsys):
    shown = record(capsys, "--S", "4")
    assert shown["S"] == [4.0, 4.0, 4.0]
    assert shown["lambda_3"] == 1.0


def test_gains_outside_the_theorem_are_noted(capsys):
    assert run("--S", "2", "4", "2") == 0
    assert "note: for mu = 1, nu = 1, k = 12 is below 2 beta max(S_ii) = 13.296" in capsys.readouterr().out
    assert record(capsys, "--S", "2", "4", "2")["covered_by_theorem_1"] is False
    assert run("--S", "4", "--table") == 0
    notes = [line for line in capsys.readouterr().out.splitlines() if line.startswith("note")]
    assert ["mu = 1," in notes[0], "mu = 5," in notes[1], "mu = 10," in notes[2], len(notes)] == [True] * 3 + [3]


def test_zero_weight_is_not_taken_for_the_default(capsys):
    assert record(capsys, "--mu", "0")["mu"] == 0
    with pytest.raises(NoMinimum, match="nu = 0"):
        run("--nu", "0")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--mu", "nan"], "mu = nan must be a finite number"),
        (["--nu", "-1"], r"nu = -1.0 must be a finite number, 0 or greater"),
        (["--k", "0"], "k = 0 must be greater than 0"),
        (["--s-a", "-1"], "s_a = -1.0 must be a finite number, 0 or greater"),
        (["--S", "1", "2"], "--S has 2 numbers; give one for all joints, or three"),
        (["--S", "1", "2", "0"], "--S 1.0 2.0 0.0: every S_ii must be a finite number greater than 0"),
        (["--S", "nan"], "every S_ii must be"),
        (["--membership", "cosine"], "known: sine, triangle, trapezoid, gaussian, points"),
        (["--membership", "triangle:1,1,1"], "has no area"),
        (["--table", "--mu", "1"], "--table takes mu and nu from the paper"),
        (["--table", "--write", "x.fmu"], "leave out --mu, --nu and --write, or --table"),
        (["--from-plant", "--s-a", "1"], "leave out --s-a and --s-b, or --from-plant"),
        (["--from-plant", "--s-b", "1"], "leave out --s-a and --s-b, or --from-plant"),
    ],
)
def test_bad_options_are_refused_in_one_line_before_any_output(capsys, options, message):
    with pytest.raises(ValueError, match=message) as refused:
        run(*options)
    assert "\n" not in str(refused.value)
    assert capsys.readouterr().out == ""
