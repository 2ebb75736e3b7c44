"""FMUs run alone by both interfaces: against closed forms and scipy, with inputs linear and held, and with events."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cosim.errors import CosimError
from cosim.regression import Tolerances, compare
from cosim.regression.inputs import input_function
from cosim.regression.run import run
from cosim.results.results import Results
from cosim.system.system import System
from tests.support.regression_fmus import DAHLQUIST, VAN_DER_POL, built_fmus, make_case
from tests.support.small_fmus import build
from tests.support.tiny_models import FRAGILE, FRAGILE_MESSAGE

INTERFACES = ("co_simulation", "model_exchange")
TIGHT = "StartTime, 0\nStopTime, {stop}\nStepSize, {step}\nRelTol, 1e-10\n"


@pytest.fixture
def fmus() -> Path:
    return built_fmus()


@pytest.mark.parametrize("interface", INTERFACES)
def test_dahlquist_is_its_closed_form(fmus, tmp_path, interface):
    case = make_case(tmp_path, "Dahlquist", toml="start.k = 2.0", opt=TIGHT.format(stop=2.0, step=0.01))
    result = run(case, fmus / "Dahlquist.fmu", interface)
    assert result.names == ["x"]
    assert result.info["units"] == {"x": "m"}
    np.testing.assert_allclose(result.time, np.arange(201) * 0.01, rtol=0, atol=1e-14)
    np.testing.assert_allclose(result["x"], np.exp(-2.0 * result.time), rtol=0, atol=1e-8)


def test_both_interfaces_agree_with_another_solver(fmus, tmp_path):
    case = make_case(tmp_path, "VanDerPol", opt=TIGHT.format(stop=10.0, step=0.01))
    times = np.arange(1001) * 0.01
    expected = solve_ivp(
        lambda t, x: VAN_DER_POL.derivatives(t, x, None, np.ones(1)), (0, 10), [2.0, 0.0], "DOP853", times, rtol=1e-11,
        atol=1e-12,
    )  # fmt: skip
    for interface in INTERFACES:
        result = run(case, fmus / "VanDerPol.fmu", interface)
        assert np.abs(result.values.T - expected.y).max() < 1e-6, interface


@pytest.mark.parametrize("interface", INTERFACES)
@pytest.mark.parametrize("flavour", ["fmi2", "fmi3"])
@pytest.mark.parametrize("between", ["linear", "hold"])
def test_inputs_are_those_of_the_file(fmus, tmp_path, interface, flavour, between):
    """Output y = u at rows between those of the file: on the line or as the row before, and behind a jump."""
    time = np.array([0.0, 0.2, 0.5, 0.5, 1.0])
    inputs = Results(time, ["u"], np.array([[0.0], [1.0], [2.0], [-1.0], [3.0]]))
    toml, opt = f"inputs = '{between}'", TIGHT.format(stop=1.0, step=0.05)
    case = make_case(tmp_path, "Feedthrough", toml=toml, opt=opt, inputs=inputs)
    result = run(case, (fmus if flavour == "fmi2" else fmus / "fmi3") / "Feedthrough.fmu", interface)
    t = np.arange(21) * 0.05
    if between == "linear":
        expected = np.where(t < 0.4999, np.interp(t, time[:3], [0.0, 1.0, 2.0]), np.interp(t, time[3:], [-1.0, 3.0]))
    else:
        expected = np.select([t < 0.1999, t < 0.4999, t < 0.9999], [0.0, 1.0, -1.0], 3.0)
    np.testing.assert_allclose(result["y"], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("interface", INTERFACES)
def test_inputs_without_a_column_keep_their_start_values(fmus, tmp_path, interface):
    case = make_case(tmp_path, "Feedthrough", toml="start.K = 2.0")
    np.testing.assert_array_equal(run(case, fmus / "Feedthrough.fmu", interface)["y"], 0.5)


def test_an_input_jumps_where_it_should():
    function = input_function(np.array([0.0, 0.5, 0.5, 1.0]), np.array([0.0, 1.0, 5.0, 6.0]), "linear")
    np.testing.assert_allclose(function(np.array([-1.0, 0.0, 0.25, 0.5, 0.75, 1.0, 2.0])), [0, 0, 0.5, 5, 5.5, 6, 6])
    # the last digit of a communication point does not decide which row is held
    held = input_function(np.arange(11) * 0.1, np.arange(11.0), "hold")
    np.testing.assert_allclose(held(np.nextafter(np.arange(11) * 0.1, -1.0)), np.arange(11))


@pytest.mark.parametrize(("time", "jumps"), [((0.0, 0.5, 0.5, 1.0), [0.5]), ((0.0, 0.4, 0.5, 1.0), [])])
def test_the_master_is_told_where_inputs_jump(fmus, tmp_path, monkeypatch, time, jumps):
    """Linear extrapolation then starts anew, instead of going on with the slope of the jump."""
    driven = {}

    class Watched(System):
        def drive(self, target, function, *, breakpoints=(), vectorized=False):
            driven[target] = list(breakpoints)
            super().drive(target, function, breakpoints=breakpoints, vectorized=vectorized)

    monkeypatch.setattr("cosim.regression.run.System", Watched)
    inputs = Results(np.array(time), ["u"], np.array([[0.0], [1.0], [5.0], [6.0]]))
    case = make_case(tmp_path, "Feedthrough", opt=TIGHT.format(stop=1.0, step=0.1), inputs=inputs)
    run(case, fmus / "Feedthrough.fmu", "co_simulation")
    assert driven == {"fmu.u": jumps}


def test_a_bouncing_ball_by_root_finding_is_that_of_the_closed_form(fmus, tmp_path):
    """State events: CVode's root finding in model exchange, the closed form of each flight inside co-simulation."""
    case = make_case(tmp_path, "Ball", opt=TIGHT.format(stop=2.0, step=0.01))
    exact, solved = (run(case, fmus / "Ball.fmu", interface) for interface in INTERFACES)
    first = np.sqrt(2.0 / 9.81)  # s, the first impact
    assert np.ptp(np.sign(exact["v"][np.abs(exact.time - first) < 0.011])) == 2.0
    loose = Tolerances(absolute=1e-6, time_shift=1e-6)
    assert compare(solved, exact, loose) == []
    # six bounces, each of which could be late
    later = make_case(tmp_path / "later", "Ball", toml="start.e = 0.7001", opt=TIGHT.format(stop=2.0, step=0.01))
    assert len(compare(run(later, fmus / "Ball.fmu", "model_exchange"), exact, loose)) == 2


def test_local_variables_of_a_reference_are_recorded(fmus, tmp_path):
    reference = Results(np.arange(3) * 0.01, ["der(h)", "nothing"], np.zeros((3, 2)))
    result = run(make_case(tmp_path, "Ball", reference), fmus / "Ball.fmu", "model_exchange")
    assert result.names == ["der(h)"]
    np.testing.assert_allclose(result["der(h)"], -9.81 * result.time, atol=1e-6)


@pytest.mark.parametrize(
    ("toml", "opt", "inputs", "message"),
    [
        ("start.q = 1.0", "", None, "has no variable 'q'"),
        ("start = 3", "", None, "start = 3 must be a table"),
        ("inputs = 'lineal'", "", None, "did you mean 'linear'?"),
        ("", "StartTime, 0\nStopTime, 1\nStepSize, 0.03\n", None, "is not a whole number of steps of 0.03 s"),
        ("", "StartTime, 0\n", None, "StopTime is missing"),
        ("", "StartTime, 0\nStopTime, soon\n", None, "line 2: StopTime = 'soon' must be a number"),
        ("", "StartTime, 0\nStopTime, 1\nStepSize, -1\n", None, "line 3: StepSize = -1 must be finite"),
        ("", "", Results(np.arange(2.0), ["v"], np.ones((2, 1))), "has no variable 'v'"),
        ("", "", Results(np.arange(2.0), ["y"], np.ones((2, 1))), "'y' is not an input"),
        ("", "", Results(np.arange(2.0), ["u"], np.full((2, 1), np.nan)), "not finite"),
    ],
)
def test_a_wrong_case_is_refused_in_one_line(fmus, tmp_path, toml, opt, inputs, message):
    case = make_case(tmp_path, "Feedthrough", toml=toml, opt=opt, inputs=inputs)
    for interface in INTERFACES:
        if "not finite" in message and interface == "model_exchange":
            continue  # its result is not finite then
        if "whole number" in message and interface == "model_exchange":
            continue  # it needs no fixed step
        with pytest.raises(CosimError) as refused:
            run(case, fmus / "Feedthrough.fmu", interface)
        assert message in str(refused.value)
        assert "\n" not in str(refused.value)


def test_a_reference_gives_the_times_where_there_are_no_options(fmus, tmp_path):
    time = 1.0 + np.arange(11) * 0.04
    case = make_case(tmp_path, "Dahlquist", Results(time, ["x"], np.zeros((11, 1))))
    for interface in INTERFACES:
        result = run(case, fmus / "Dahlquist.fmu", interface)
        np.testing.assert_allclose(result.time, time, rtol=1e-15)
    options = "StartTime, 1\nStopTime, 1.4\nStepSize, 0.01\nRelTol, 1e-10"
    case = make_case(tmp_path, "Dahlquist", Results(time, ["x"], np.zeros((11, 1))), opt=options)
    for interface in INTERFACES:
        result = run(case, fmus / "Dahlquist.fmu", interface)
        np.testing.assert_allclose(result["x"], np.exp(-DAHLQUIST.parameters.starts[0] * (time - 1.0)), atol=1e-9)
    case.options_path.write_text(options.replace("0.01", "0.03"))
    with pytest.raises(CosimError, match=r"rows 0\.04 s apart are not a whole number of steps of 0\.03 s"):
        run(case, fmus / "Dahlquist.fmu", "co_simulation")


@pytest.mark.parametrize("flavour", ["fmi2", "fmi3"])
def test_what_an_fmu_logs_says_why_its_model_exchange_failed(tmp_path, flavour):
    fmu = build(tmp_path, flavour, FRAGILE) / "Fragile.fmu"
    case = make_case(tmp_path, "Fragile", toml="start.u = -1.0")
    with pytest.raises(CosimError, match=f"model exchange with CVode failed: .*{FRAGILE_MESSAGE}"):
        run(case, fmu, "model_exchange")
