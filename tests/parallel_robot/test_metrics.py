"""Metrics of hand-made results whose numbers are known in closed form."""

from __future__ import annotations

import math
import os
import subprocess
import sys

import numpy as np
import pytest

from cosim.results.results import Results
from parallel_robot.metrics import metrics, tracking_errors

PLANT = ["plant.tau_a[1]", "plant.tau_a[2]", "plant.tau_a[3]", "plant.closure_error", "plant.x_E", "plant.y_E"]
JOINTS = [f"plant.theta_a[{i}]" for i in (1, 2, 3)]
DESIRED = ["trajectory.x_ref", "trajectory.y_ref", *(f"trajectory.theta_ref[{i}]" for i in (1, 2, 3))]


def made(time: np.ndarray, columns: dict[str, object], names: list[str]) -> Results:
    """Results with these columns; those that are not given are zero."""
    values = np.zeros((len(time), len(names)))
    for name, column in columns.items():
        values[:, names.index(name)] = column
    return Results(time=time, names=names, values=values)


def tracked(time, **columns) -> Results:
    return made(time, {k.replace("__", "."): v for k, v in columns.items()}, PLANT + JOINTS + DESIRED)


TIME = np.linspace(0.0, 2.0, 2001)  # two periods of sin(2 pi t)
STEP = TIME[1]


def test_a_sine_error_has_the_numbers_of_a_sine():
    amplitude, offset = 0.003, 0.2  # m
    error = amplitude * np.sin(2.0 * np.pi * TIME)
    found = metrics(tracked(TIME, plant__x_E=offset + error, trajectory__x_ref=offset), steady_after=1.0)["tracking"]
    x = found["x"]
    assert x["max"] == pytest.approx(amplitude, rel=1e-9)
    # the mean square of 2001 samples of a whole number of periods counts the zero at the end once too often
    assert x["rms"] == pytest.approx(amplitude / math.sqrt(2.0), rel=1.0 / len(TIME))
    # integral of |sin(2 pi t)| over two periods: 4/pi; trapezoids miss h^2/12 (f'(b) - f'(a)) a half wave
    accumulated = amplitude * 4.0 / math.pi
    assert x["accumulated"] == pytest.approx(accumulated, abs=amplitude * 4 * STEP**2 / 12 * 4 * math.pi * 1.1)
    assert x["steady_max"] == pytest.approx(amplitude, rel=1e-9)
    assert x["steady_rms"] == pytest.approx(amplitude / math.sqrt(2.0), rel=1.0 / 1001)
    assert set(found) == {"x", "y", "theta_a[1]", "theta_a[2]", "theta_a[3]"}
    assert found["y"] == {"max": 0.0, "rms": 0.0, "accumulated": 0.0, "steady_max": 0.0, "steady_rms": 0.0}


def test_the_sine_comparison_can_fail():
    error = 0.003 * np.sin(2.0 * np.pi * TIME)
    x = metrics(tracked(TIME, plant__x_E=1.01 * error), steady_after=1.0)["tracking"]["x"]
    assert x["max"] != pytest.approx(0.003, rel=1e-3)
    assert x["rms"] != pytest.approx(0.003 / math.sqrt(2.0), rel=1e-3)
    assert x["accumulated"] != pytest.approx(0.003 * 4.0 / math.pi, rel=1e-3)


def test_each_error_is_actual_minus_desired_of_its_own_pair():
    values = {"plant.x_E": 1.0, "plant.y_E": 2.0, "trajectory.x_ref": 0.5, "trajectory.y_ref": 4.0}
    for i in (1, 2, 3):
        values |= {f"plant.theta_a[{i}]": 10.0 * i, f"trajectory.theta_ref[{i}]": float(i)}
    errors = tracking_errors(made(np.arange(2.0), values, PLANT + JOINTS + DESIRED))
    assert {name: error.tolist() for name, error in errors.items()} == {
        "x": [0.5, 0.5],
        "y": [-2.0, -2.0],
        "theta_a[1]": [9.0, 9.0],
        "theta_a[2]": [18.0, 18.0],
        "theta_a[3]": [27.0, 27.0],
    }


def test_a_negative_error_counts_by_its_size():
    y = metrics(tracked(np.array([0.0, 1.0, 2.0]), plant__y_E=[0.0, -4.0, 2.0]), steady_after=2.0)["tracking"]["y"]
    assert y["max"] == 4.0
    assert y["rms"] == pytest.approx(math.sqrt(20.0 / 3.0), rel=1e-15)
    assert y["accumulated"] == 2.0 + 3.0
    assert (y["steady_max"], y["steady_rms"]) == (2.0, 2.0)


def test_the_integral_heeds_uneven_times():
    time = np.array([0.0, 1.0, 5.0])
    assert metrics(tracked(time, plant__x_E=[1.0, 1.0, 3.0]), 9.0)["tracking"]["x"]["accumulated"] == 1.0 + 8.0


def test_the_steady_part_includes_its_first_point():
    columns = {"plant__x_E": [9.0, 5.0, 1.0, 1.0]}
    time = np.array([0.0, 1.0, 2.0, 3.0])
    assert metrics(tracked(time, **columns), steady_after=1.0)["tracking"]["x"]["steady_max"] == 5.0
    assert metrics(tracked(time, **columns), steady_after=1.5)["tracking"]["x"]["steady_max"] == 1.0


@pytest.mark.parametrize("steady_after", [2.0000001, 8.0])
def test_a_run_that_ends_before_the_steady_part_has_none(steady_after):
    found = metrics(tracked(TIME, plant__x_E=0.1), steady_after)
    assert found["steady_after"] == steady_after
    for error in found["tracking"].values():
        assert error["steady_max"] is None
        assert error["steady_rms"] is None
    assert found["tracking"]["x"]["max"] == 0.1


def test_without_a_trajectory_nothing_is_tracked():
    found = metrics(made(TIME, {"plant.tau_a[1]": 0.1}, PLANT), steady_after=1.0)
    assert found["tracking"] == {}
    assert found["control_effort"]["max"] == 0.1


def test_control_effort_of_cosines():
    # 0.1 cos(2 pi t) on all three joints: the integral of the squares over two periods is 3 * 0.1^2 * 2 / 2; trapezoids
    # are exact here but for rounding
    torque = 0.1 * np.cos(2.0 * np.pi * TIME)
    effort = metrics(made(TIME, dict.fromkeys(PLANT[:3], torque), PLANT), 1.0)["control_effort"]
    assert effort["max"] == pytest.approx(0.1, rel=1e-12)
    assert effort["integral"] == pytest.approx(0.03, rel=1e-12)


def test_control_effort_takes_the_largest_joint_by_its_size():
    torque = {"plant.tau_a[1]": [1.0, 0.0], "plant.tau_a[2]": [0.0, -7.0], "plant.tau_a[3]": [2.0, 2.0]}
    effort = metrics(made(np.arange(2.0), torque, PLANT), 1.0)["control_effort"]
    assert effort["max"] == 7.0
    assert effort["integral"] == (5.0 + 53.0) / 2.0


def test_the_largest_closure_error_is_found_wherever_it_is():
    closure = np.zeros(len(TIME))
    closure[777] = 3e-9
    assert metrics(made(TIME, {"plant.closure_error": closure}, PLANT), 1.0)["closure_error_max"] == 3e-9


def test_one_row_is_enough():
    found = metrics(tracked(np.array([0.0]), plant__x_E=[0.005], plant__closure_error=[1e-16]), steady_after=8.0)
    assert found["tracking"]["x"] == {
        "max": 0.005,
        "rms": 0.005,
        "accumulated": 0.0,
        "steady_max": None,
        "steady_rms": None,
    }
    assert found["control_effort"] == {"max": 0.0, "integral": 0.0}
    assert found["closure_error_max"] == 1e-16


def test_a_system_without_the_plant_has_no_metrics_of_the_plant():
    # a scenario may leave the plant out; its run must not end in an error after the work is done
    found = metrics(made(TIME, {"trajectory.x_ref": 0.2}, DESIRED), steady_after=1.0)
    assert found["tracking"] == {}


@pytest.mark.parametrize("rows", [1, 10_000, 10_001, 50_001])
def test_the_rms_of_so_many_rows_is_that_of_their_exact_sum(rows: int):
    """Also where the rows are summed in pieces."""
    time = np.linspace(0.0, 1.0, rows)
    error = np.random.default_rng(rows).standard_normal(rows)
    x = metrics(tracked(time, plant__x_E=error), steady_after=2.0)["tracking"]["x"]
    assert x["rms"] == pytest.approx(math.sqrt(math.fsum(error * error) / rows), rel=1e-14)


def test_metrics_are_the_same_to_the_last_bit_with_any_number_of_threads():
    script = (
        "import numpy as np\n"
        "from cosim.results.results import Results\n"
        "from parallel_robot.metrics import metrics\n"
        "time, names = np.linspace(0.0, 1.0, 50_001), ['plant.x_E', 'trajectory.x_ref']\n"
        "for seed in range(8):\n"
        "    values = np.random.default_rng(seed).standard_normal((len(time), 2))\n"
        "    print(metrics(Results(time=time, names=names, values=values), 0.5)['tracking'])\n"
    )

    def printed(threads: str) -> str:
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": threads}
        return subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
        ).stdout

    one = printed("1")
    assert one.count("steady_rms") == 8
    assert printed("2") == one
