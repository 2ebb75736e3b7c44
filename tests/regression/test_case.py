"""Cases: where they are found, what their options say, and when an FMU is run for them."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cosim import CosimError
from cosim.regression import Case, Tolerance, check, find_cases
from cosim.regression.experiment import experiment_of
from cosim.regression.options import Options, OptionsError, read_options, write_options
from cosim.results.results import Results
from tests.support.regression_fmus import built_fmus, make_case

NOTHING = SimpleNamespace(defaultExperiment=None)
REFERENCE = Results(np.arange(3.0), ["x"], np.zeros((3, 1)))


def test_cases_are_found_beside_the_fmu_and_in_folders(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fmu = tmp_path / "build" / "my.fmu"
    assert find_cases(fmu) == []
    cases = tmp_path / "cases"
    make_case(cases, "my", REFERENCE)
    make_case(cases, "warm", REFERENCE, toml="fmu = 'my'")
    make_case(cases, "other", REFERENCE)
    make_case(cases, "broken", REFERENCE, toml="fmu = ")
    (cases / "no case").mkdir()
    assert find_cases(fmu, cases) == [Case("my", cases / "my"), Case("warm", cases / "warm")]
    assert find_cases(fmu, cases / "my") == [Case("my", cases / "my")]
    # tolerances that can't be read are a matter of the FMU of this name
    assert find_cases(Path("broken.fmu"), cases) == [Case("broken", cases / "broken")]
    cases.rename("reference")
    assert [case.name for case in find_cases(fmu)] == ["my", "warm"]
    # as in the FMI cross-check: all in one folder
    flat = make_case(tmp_path, "build", REFERENCE).folder
    (flat / "build_ref.csv").rename(flat / "my_ref.csv")
    assert find_cases(fmu) == [Case("my", flat)]


def test_options_are_those_of_the_cross_check(tmp_path):
    """The example of the rules, with its comments and what this package has no use for."""
    path = tmp_path / "case_ref.opt"
    path.write_text(
        "StartTime, 0.0         // in seconds\nStopTime, 2.5          // in seconds\n"
        "StepSize, 0.01         // in seconds, 0.0 means variable step solver\nRelTol, 0.0001\n"
        "// optional elements:\nAbsTol, 2\nSolverType, FixedStep\nOutputIntervalLength   // with this spacing\n"
    )
    options = read_options(path)
    assert options == Options(0.0, 2.5, 0.01, 1e-4)
    write_options(options, path)
    assert read_options(path) == options
    path.write_bytes(b"StartTime,\xff")
    with pytest.raises(OptionsError, match="can't be read"):
        read_options(path)


@pytest.mark.parametrize(
    ("files", "default", "expected"),
    [
        ({"reference": REFERENCE}, None, (0.0, 2.0, 1.0, 1)),
        ({"inputs": REFERENCE}, None, (0.0, 2.0, 1.0, 1)),
        ({"reference": REFERENCE, "opt": "StartTime, 0\nStopTime, 2\nStepSize, 0.25"}, None, (0.0, 2.0, 0.25, 4)),
        ({"reference": REFERENCE, "opt": "StartTime, 0\nStopTime, 2\nStepSize, 0"}, None, (0.0, 2.0, 1.0, 1)),
        ({"opt": "StartTime, 1\nStopTime, 6\nStepSize, 0"}, None, (1.0, 6.0, 0.01, 1)),
        ({"opt": "StartTime, 1\nStopTime, 6"}, (0.0, 9.0, 0.5), (1.0, 6.0, 0.5, 1)),
        ({}, (0.0, 9.0, 0.5), (0.0, 9.0, 0.5, 1)),
    ],
)
def test_what_says_when_an_fmu_runs(tmp_path, files, default, expected):
    case = make_case(tmp_path, "case", **files)
    values = dict(zip(("startTime", "stopTime", "stepSize"), map(str, default or ()), strict=False))
    described = SimpleNamespace(defaultExperiment=SimpleNamespace(**values, tolerance=None) if default else None)
    experiment = experiment_of(case, described)
    found = (experiment.start_time, experiment.stop_time, experiment.step_size, experiment.every)
    assert found == pytest.approx(expected, rel=1e-12)


def test_nothing_says_when_to_stop(tmp_path):
    with pytest.raises(Exception, match="nothing says when to stop"):
        experiment_of(Case("case", tmp_path), NOTHING)


@pytest.mark.parametrize("interface", ["co_simulation", "model_exchange"])
def test_a_reference_of_a_solver_with_variable_steps(tmp_path, interface):
    """Its own times, an event that is there twice: held against the results as a curve."""
    impact = float(np.sqrt(2.0 / 9.81))
    before = np.sort(np.append(np.random.default_rng(0).uniform(0.0, impact, 300), [0.0, impact]))
    after = np.linspace(impact, 1.0, 400)
    bounce, flight = 0.7 * 9.81 * impact, after - impact
    height = np.append(1.0 - 9.81 / 2.0 * before**2, (bounce - 9.81 / 2.0 * flight) * flight)
    speed = np.append(-9.81 * before, bounce - 9.81 * flight)
    reference = Results(np.append(before, after), ["h", "v"], np.column_stack([height, speed]))
    options = "StartTime, 0\nStopTime, 1\nStepSize, 0\nRelTol, 1e-9\n"
    case = make_case(tmp_path, "Ball", reference, toml="relative = 1e-3\ntime_shift = 1e-3", opt=options)
    assert check(case, built_fmus() / "Ball.fmu", interface, isolated=False).findings == []
    case = make_case(tmp_path, "Ball", toml="relative = 1e-3\ntime_shift = 1e-3\nstart.g = 9.9")
    found = check(case, built_fmus() / "Ball.fmu", interface, isolated=False).findings
    assert len(found) == 2
    assert all("leaves the funnel" in line for line in found)
    case = make_case(tmp_path, "Ball", toml="relative = 1e-3")
    (found,) = check(case, built_fmus() / "Ball.fmu", interface, isolated=False).findings
    assert "the reference 702" in found


def test_the_example_of_the_page_is_a_file_that_can_be_read(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "regression.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    case = make_case(tmp_path, "cold", toml=example)
    assert (case.fmu, case.between, case.start) == ("Pump", "hold", {"speed": 157.0})
    assert case.tolerances("co_simulation").of("force[2]") == Tolerance(0.0, 1e-9, 0.0, "N")
    assert case.tolerances("model_exchange").of("pressure") == Tolerance(50.0, 1e-6, 0.0, "Pa")


@pytest.mark.parametrize("ending", [".mat", ".parquet", ".json", ".npz"])
def test_a_reference_of_another_format(tmp_path, ending):
    time = np.linspace(0.0, 0.4, 5)
    drop = Results(time, ["h"], (1.0 - 9.81 / 2.0 * time**2)[:, np.newaxis])
    case = make_case(tmp_path, "Ball", drop, toml="absolute = 1e-2")
    drop.save(case.folder / f"Ball_ref{ending}")
    with pytest.raises(CosimError, match="are both there"):
        case.reference()
    (case.folder / "Ball_ref.csv").unlink()
    assert case.reference_path.suffix == ending
    assert check(case, built_fmus() / "Ball.fmu", "co_simulation", isolated=False).findings == []
    assert find_cases(Path("Ball.fmu"), tmp_path) == [case]
