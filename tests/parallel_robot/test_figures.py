"""Figures: which are written, that they are images, and what stands at their axes."""

from __future__ import annotations

import math
import re

import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure

from cosim.results.results import Results
from parallel_robot import figures
from parallel_robot.figures import write_figures
from tests.support import some
from tests.support.robot_results import made

ALL = ["path", "tracking_errors", "torques", "psi", "closure_error"]
DRAWINGS = {
    "path": figures._path,
    "tracking_errors": figures._tracking_errors,
    "torques": figures._torques,
    "psi": figures._psi,
    "closure_error": figures._closure_error,
}


def drawn(name: str, results: Results, steady_after: float = 8.0) -> Figure:
    figure = Figure()
    DRAWINGS[name](figure, results, steady_after)
    return figure


def has_unit(label: str) -> bool:
    return re.search(r"\((m|mm|mrad|s|N m|1)\)$", label) is not None


def test_all_figures_are_written_as_images_of_a_sane_size(tmp_path):
    paths = write_figures(made(), "a title", 8.0, tmp_path)
    assert paths == [tmp_path / f"{name}.png" for name in ALL]
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(p.name for p in paths)
    for path in paths:
        image = matplotlib.image.imread(path)
        assert image.shape[:2] == (720, 1080)  # 9 x 6 inches at 150 dots an inch
        ink = np.mean(image[..., :3].min(axis=2) < 0.9)
        assert 0.005 < ink < 0.5, path.name
        assert path.stat().st_size < 500_000


@pytest.mark.parametrize(
    ("components", "expected"),
    [
        (("plant",), ["path", "torques", "closure_error"]),
        (("plant", "trajectory"), ["path", "tracking_errors", "torques", "closure_error"]),
        (("controller",), ["psi"]),
        (("trajectory",), []),
        (("trajectory", "controller"), ["psi"]),
        ((), []),
    ],
)
def test_what_was_not_recorded_is_left_out(tmp_path, components, expected):
    assert [p.stem for p in write_figures(made(20, components), "t", 8.0, tmp_path)] == expected
    assert sorted(p.stem for p in tmp_path.iterdir()) == sorted(expected)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("steady_after", [8.0, 99.0])
def test_every_axis_has_a_label_with_its_unit(name, steady_after):
    figure = drawn(name, made(), steady_after)
    assert figure.axes
    for axes in figure.axes:
        shares_x = any(axes.get_shared_x_axes().joined(axes, other) for other in figure.axes if other is not axes)
        if not shares_x or axes is figure.axes[-1]:
            assert has_unit(axes.get_xlabel()), axes.get_xlabel()
    # of axes side by side only the first repeats what both show
    first_column = [axes for axes in figure.axes if axes.get_subplotspec().is_first_col()]
    for axes in some(first_column):
        assert has_unit(axes.get_ylabel()), axes.get_ylabel()
    assert not has_unit("Time")


@pytest.mark.parametrize("name", [n for n in ALL if n != "closure_error"])
def test_every_curve_is_named_once(name):
    for axes in some(drawn(name, made()).axes):
        labels = [line.get_label() for line in axes.lines]
        # of axes side by side, the first has the legend for both
        legend = axes.get_legend()
        assert (legend is not None) == axes.get_subplotspec().is_first_col()
        assert legend is None or [text.get_text() for text in legend.get_texts()] == labels
        assert len(set(labels)) == len(labels)
        assert not any(label.startswith("_") for label in labels)
        # told apart without colour, too
        styles = [(line.get_linestyle(), line.get_marker()) for line in axes.lines]
        assert len(set(styles)) == len(styles)


def curve(axes, label: str) -> np.ndarray:
    (line,) = [line for line in axes.lines if line.get_label() == label]
    return np.column_stack(line.get_data())


def test_the_path_is_the_recorded_one():
    results = made()
    axes = drawn("path", results).axes[0]
    assert curve(axes, "actual").tolist() == np.column_stack([results["plant.x_E"], results["plant.y_E"]]).tolist()
    desired = np.column_stack([results["trajectory.x_ref"], results["trajectory.y_ref"]])
    assert curve(axes, "desired").tolist() == desired.tolist()
    assert curve(axes, "start").tolist() == [[results["plant.x_E"][0], results["plant.y_E"][0]]]
    assert axes.get_aspect() == 1.0


def test_the_path_without_a_trajectory_is_the_actual_one_alone():
    axes = drawn("path", made(components=("plant",))).axes[0]
    assert [line.get_label() for line in axes.lines] == ["actual", "start"]


def test_tracking_errors_are_in_thousandths_and_the_zoom_is_the_steady_part():
    results = made()
    axes = drawn("tracking_errors", results, steady_after=8.0).axes
    assert len(axes) == 4
    error = results["plant.x_E"] - results["trajectory.x_ref"]
    assert curve(axes[0], "x")[:, 1] == pytest.approx(1e3 * error, rel=1e-12)
    assert (axes[0].get_ylabel(), axes[2].get_ylabel()) == ("Position error (mm)", "Joint error (mrad)")
    steady = results.time >= 8.0
    assert curve(axes[1], "x")[:, 0].tolist() == results.time[steady].tolist()
    joint = 1e3 * (results["plant.theta_a"] - results["trajectory.theta_ref"])
    assert curve(axes[3], "joint 3")[:, 1] == pytest.approx(joint[steady, 2], rel=1e-12)
    assert any("8 s" in axes[1].get_title(loc=place) for place in ("left", "center", "right"))


def test_a_run_without_a_steady_part_has_no_zoom():
    assert len(drawn("tracking_errors", made(), steady_after=10.5).axes) == 2


def test_torques_of_motor_and_disturbance_are_told_apart():
    results = made()
    upper, lower = drawn("torques", results).axes
    assert curve(upper, "joint 2")[:, 1].tolist() == results["plant.tau_a[2]"].tolist()
    assert curve(lower, "joint 2")[:, 1].tolist() == results["plant.tau_d[2]"].tolist()
    assert upper.get_ylabel() != lower.get_ylabel()


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("value", [math.nan, math.inf, pytest.param(-math.inf, marks=pytest.mark.slow)])
@pytest.mark.parametrize("rows", [slice(50, 52), slice(None)], ids=["some", "all"])
def test_values_that_are_no_numbers_do_no_harm(tmp_path, name, value, rows):
    results = made()
    measured = np.array([not n.startswith("trajectory") for n in results.names])
    results.values[rows, measured] = value
    figure = drawn(name, results)
    figure.savefig(tmp_path / "figure.png", dpi=30)
    assert matplotlib.image.imread(tmp_path / "figure.png").ndim == 3


def test_two_rows_are_enough(tmp_path):
    assert len(write_figures(made(2), "t", 8.0, tmp_path)) == 5


def test_a_title_is_a_text_and_no_formula(tmp_path):
    results = made(20, ("controller",))
    assert write_figures(results, r"gain $\nothing$ and 5", 8.0, tmp_path) == [tmp_path / "psi.png"]


def test_a_folder_that_can_t_be_written_is_an_oserror(tmp_path):
    with pytest.raises(OSError, match="nowhere"):
        write_figures(made(20, ("controller",)), "t", 8.0, tmp_path / "nowhere")
