"""References that FMUs bring along (fmi-ls-ref): what is read, run and compared, and what is said of the rest."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from cosim.__main__ import main
from cosim.regression.case import CaseError
from cosim.regression.outcome import Outcome, check
from cosim.regression.run import run
from cosim.regression.shipped import FOLDER, MANIFEST, all_cases, shipped_cases
from tests.support import some
from tests.support.regression_fmus import built_fmus, make_case
from tests.support.small_fmus import compiled

pytest_plugins = ["pytester"]

#: Of the model Feedthrough: y = K u.
SSV = """<?xml version="1.0" encoding="UTF-8"?>
<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" name="set">
<ssv:Parameters><ssv:Parameter name="{name}"><ssv:Real value="{value}"/></ssv:Parameter></ssv:Parameters>
</ssv:ParameterSet>
"""

EXPERIMENTS = """<Experiments name="smoke tests">{}</Experiments>"""


def manifest(*related: str) -> str:
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiReferences xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest"
    fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-ref" fmi-ls:fmi-ls-version="1.0.0-beta.1"
    fmi-ls:fmi-ls-description="Layered Standard providing information on related files included in an FMU.">
{"".join(f"<Related {text}/>" for text in related)}
</fmiReferences>"""


def csv(header: str, *columns: np.ndarray) -> str:
    rows = [",".join(map(repr, row)) for row in np.column_stack(columns).tolist()]
    return "\n".join([header, *rows]) + "\n"


def with_members(fmu: Path, folder: Path, members: Mapping[str, str]) -> Path:
    """A copy of an FMU with files of the layered standard."""
    path = folder / fmu.name
    shutil.copyfile(fmu, path)
    with zipfile.ZipFile(path, "a") as archive:
        for name, text in members.items():
            archive.writestr(name if name.startswith("extra") else FOLDER + name, text)
    return path


def experiment(text: str, **files: str) -> dict[str, str]:
    """Members for one experiment in a file."""
    related = 'type="application/x-ma-hs-experiments" source="tests.exp" role="experiment"'
    return {MANIFEST: manifest(related), "tests.exp": EXPERIMENTS.format(text), **files}


def outcomes(fmu: Path, folder: Path, *interfaces: str) -> dict[tuple[str, str], Outcome]:
    found = shipped_cases(fmu, folder / "unpacked").cases
    return {(c.name, i): check(c, fmu, i, isolated=False) for c in found for i in interfaces}  # type: ignore[arg-type]


ONE = '<Experiment name="one">{}</Experiment>'
BOTH = ("co_simulation", "model_exchange")
TENTHS = np.arange(21) * 0.1
RESULT = 'type="text/csv" source="Dahlquist_out.csv" role="result" description="Output of the default experiment"'


def dahlquist(folder: Path, x: np.ndarray) -> Path:
    """The FMU of x' = -x, x(0) = 1, with a result as the Reference FMUs bring it along."""
    members = {MANIFEST: manifest(RESULT), "Dahlquist_out.csv": csv("time,x", TENTHS, x)}
    return with_members(built_fmus() / "Dahlquist.fmu", folder, members)


def test_a_result_is_that_of_the_default_experiment(tmp_path):
    fmu = dahlquist(tmp_path, np.exp(-TENTHS))
    found = outcomes(fmu, tmp_path, *BOTH)
    assert set(found) == {("Dahlquist_out", i) for i in BOTH}
    for outcome in some(found.values()):
        assert outcome.findings == []
        assert outcome.signals[0].distance.size == 21
        assert (outcome.notes, outcome.unclear) == ((), "")


def test_a_wrong_result_is_found_by_both_interfaces(tmp_path):
    found = outcomes(dahlquist(tmp_path, 1.001 * np.exp(-TENTHS)), tmp_path, *BOTH)
    for outcome in some(found.values()):
        assert outcome.findings[0].startswith("'x' differs at")
        assert outcome.unclear == ""


def test_model_exchange_meets_a_result_of_eulers_method_too(tmp_path):
    """Nothing says how a result was made: (1 - h)^n is what Euler's explicit method gives, and CVode does not."""
    found = outcomes(dahlquist(tmp_path, 0.9 ** np.arange(21)), tmp_path, *BOTH)
    by_exchange = found["Dahlquist_out", "model_exchange"]
    assert by_exchange.findings == []
    assert by_exchange.notes == ("met by Euler's explicit method, not by CVode",)
    assert found["Dahlquist_out", "co_simulation"].findings[0].startswith("'x' differs at 20 of 21 times")


def test_what_only_co_simulation_meets_is_unclear_and_a_user_can_say_more(tmp_path):
    fmu = dahlquist(tmp_path, np.exp(-TENTHS))
    toml = tmp_path / "Dahlquist_out_ref.toml"
    for text, findings, unclear in (
        ("relative = 1e-10", 0, True),
        ('relative = 1e-10\nsolver = "CVode"', 1, False),
        ("model_exchange.relative = 1e-3", 0, False),
        ('solver = "Euler"\nmodel_exchange.relative = 1e-3', 1, False),
        ('solver = "Euler"\nsolver_step = 1e-3\nmodel_exchange.relative = 1e-3', 0, False),
    ):
        toml.write_text(text, encoding="utf-8")
        (case,) = all_cases(fmu, None, tmp_path / f"unpacked{len(text)}").cases
        outcome = check(case, fmu, "model_exchange", isolated=False)
        assert len(outcome.findings) == findings, text
        assert bool(outcome.unclear) == unclear, text
        assert check(case, fmu, "co_simulation", isolated=False).findings == []
        if unclear:
            assert "co-simulation meets the reference, model exchange does not: 'x' differs" in outcome.unclear
            assert outcome.unclear.endswith("in Dahlquist_out_ref.toml")


@pytest.mark.parametrize(
    "form",
    [
        '<Experiment name="warm start"><TransientSimulation startTime="0.5" stopTime="1.5" stepSize="0.05"/>'
        "{}</Experiment>",
        '<Experiment name="warm start" startTime="0.5" stopTime="1.5" stepSize="0.05">{}</Experiment>',
    ],
    ids=["element", "attributes"],
)
def test_an_experiment_has_times_parameters_and_stimuli(tmp_path, form):
    """It is y = K u with K = 2 of a parameter set, and u a ramp."""
    time = 0.5 + np.arange(11) * 0.1
    parts = '<Parameters source="sets/two.ssv"/><Stimuli source="u%20in.csv"/><References source="y.csv"/>'
    members = experiment(
        form.format(parts),
        **{
            "sets/two.ssv": SSV.format(name="K", value=2.0),
            "u in.csv": csv("Time,u", np.array([0.5, 1.5]), np.array([1.0, 3.0])),
            "y.csv": csv("time,y", time, 2.0 * (1.0 + 2.0 * (time - 0.5))),
        },
    )
    fmu = with_members(built_fmus() / "Feedthrough.fmu", tmp_path, members)
    (case,) = shipped_cases(fmu, tmp_path / "of the case").cases
    assert (case.name, dict(case.start)) == ("warm_start", {"K": 2.0})
    options = case.options()
    assert (options.start_time, options.stop_time, options.step_size) == (0.5, 1.5, 0.05)
    for outcome in some(outcomes(fmu, tmp_path, *BOTH).values()):
        assert outcome.findings == []
        assert [s.name for s in outcome.signals] == ["y"]
        assert float(outcome.signals[0].distance.max()) < 1e-9


@pytest.mark.parametrize(
    ("times", "rows", "expected"),
    [
        ("", TENTHS, (0.0, 2.0, 0.0)),
        ("", TENTHS + 1.0, (1.0, 3.0, 0.0)),
        ('stopTime="1.5"', TENTHS, (0.0, 1.5, 0.0)),
        ('stopTime="2.5"', TENTHS, (0.0, 2.0, 0.0)),
        ('startTime="0.5" stopTime="1.5"', TENTHS, (0.5, 2.0, 0.0)),
        ('startTime="-1" stopTime="1.5"', TENTHS, (-1.0, 1.5, 0.0)),
        ('startTime="0" stopTime="1"', None, (0.0, 1.0, 0.0)),
        ('startTime="0.5" stopTime="1"', None, (0.5, 1.0, 0.0)),
        ('stopTime="1" stepSize="0.7"', None, (0.0, 1.0, 0.7)),
        ('startTime="1"', None, None),
        ('stopTime="2" stepSize="0.05"', TENTHS, (0.0, 2.0, 0.05)),
        ('stopTime="2" stepSize="0.1"', TENTHS, (0.0, 2.0, 0.1)),
        ('stopTime="2" stepSize="0.101"', TENTHS, (0.0, 2.0, 0.0)),
        ('stopTime="2" stepSize="0.101"', TENTHS[:2], (0.0, 0.1, 0.0)),
        ('stopTime="2" stepSize="0.099"', TENTHS[:2], (0.0, 0.1, 0.099)),
        ('stopTime="2" stepSize="0.3"', TENTHS[:1], (0.0, 0.0, 0.3)),
    ],
)
def test_times_are_those_of_the_experiment_as_far_as_there_are_rows(tmp_path, times, rows, expected):
    """Start, stop, step; a step of 0 is from row to row."""
    files = {} if rows is None else {"x.csv": csv("time,x", rows, np.exp(-rows))}
    references = "" if rows is None else '<References source="x.csv"/>'
    members = experiment(ONE.format(f"<TransientSimulation {times}/>{references}"), **files)
    fmu = with_members(built_fmus() / "Dahlquist.fmu", tmp_path, members)
    (case,) = shipped_cases(fmu, tmp_path / "unpacked").cases
    assert case.options_path.is_file() == (expected is not None)
    if expected is not None:
        options = case.options()
        assert (options.start_time, options.stop_time, options.step_size) == pytest.approx(expected, rel=1e-12)


def test_the_tolerance_of_an_experiment_is_that_of_solver_and_comparison(tmp_path):
    x = 1.003 * np.exp(-TENTHS)
    inside = '<TransientSimulation stopTime="2"/><References source="x.csv"/>'
    text = f'<Experiment name="one" tolerance="{{}}">{inside}</Experiment>'
    for tolerance, findings in ((0.004, 0), (0.001, 1)):
        (tmp_path / str(tolerance)).mkdir()
        members = experiment(text.format(tolerance), **{"x.csv": csv("time,x", TENTHS, x)})
        fmu = with_members(built_fmus() / "Dahlquist.fmu", tmp_path / str(tolerance), members)
        (case,) = shipped_cases(fmu, tmp_path / f"unpacked{tolerance}").cases
        assert case.options().relative_tolerance == tolerance
        assert len(check(case, fmu, "co_simulation", isolated=False).findings) == findings


def test_an_experiment_without_references_has_to_run_to_its_end(tmp_path):
    ball = built_fmus() / "Ball.fmu"
    text = '<Experiment name="run"><TransientSimulation stopTime="1"/><Parameters source="p.ssv"/></Experiment>'
    for value, fails in ((1e9, False), (0.5, True)):
        (tmp_path / str(fails)).mkdir()
        members = experiment(text, **{"p.ssv": SSV.format(name="nan_at", value=value)})
        fmu = with_members(ball, tmp_path / str(fails), members)
        found = outcomes(fmu, tmp_path / str(fails), "co_simulation")
        assert bool(found["run", "co_simulation"].findings) == fails


def test_a_result_that_an_experiment_uses_is_no_case_of_its_own(tmp_path):
    members = experiment(ONE.format('<TransientSimulation stopTime="2"/><References source="Dahlquist_out.csv"/>'))
    related = 'type="application/x-ma-hs-experiments" source="tests.exp" role="experiment/validation"'
    members |= {MANIFEST: manifest(RESULT, related), "Dahlquist_out.csv": csv("time,x", TENTHS, np.exp(-TENTHS))}
    fmu = with_members(built_fmus() / "Dahlquist.fmu", tmp_path, members)
    found = shipped_cases(fmu, tmp_path / "unpacked")
    assert ([case.name for case in found.cases], found.notes) == (["one"], [])


NOT_TRIED = {
    "steady state": (experiment(ONE.format("<SteadyState/>")), "is not a transient simulation, but <SteadyState>"),
    "hdf5": (
        experiment(ONE.format('<References type="application/hdf5" source="x.h5"/>'), **{"x.h5": ""}),
        "its references are of type application/hdf5, and CSV files only are read",
    ),
    "missing file": (experiment(ONE.format('<References source="x.csv"/>')), "names 'x.csv', which the FMU lacks"),
    "outside": (experiment(ONE.format('<Stimuli source="../../../x.csv"/>')), "which the FMU lacks"),
    "elsewhere": (
        {MANIFEST: manifest('type="text/csv" source="https://example.org/x.csv" role="result"')},
        "https://example.org/x.csv is not a file of the FMU; it is not fetched",
    ),
    "uncertainty": (
        {MANIFEST: manifest('source="u.exp" role="experiment/uncertainty-analysis"')},
        "is for an uncertainty analysis",
    ),
    "another format": (
        {MANIFEST: manifest('type="text/x-python" source="run.py" role="experiment"'), "run.py": ""},
        "run.py is of type text/x-python, which is not read",
    ),
    "several results": (
        {
            MANIFEST: manifest(*(f'type="text/csv" source="{n}.csv" role="result"' for n in "ab")),
            "a.csv": "",
            "b.csv": "",
        },
        "a.csv is one of several results, and no experiment says of which run it is",
    ),
}


@pytest.mark.parametrize("name", NOT_TRIED)
def test_what_is_not_tried_is_said(tmp_path, name):
    members, words = NOT_TRIED[name]
    found = shipped_cases(with_members(built_fmus() / "Dahlquist.fmu", tmp_path, members), tmp_path / "unpacked")
    assert found.cases == []
    assert words in " | ".join(found.notes)


BROKEN = {
    "no XML": ({MANIFEST: "<fmiReferences"}, "fmi-ls-manifest.xml: is not XML"),
    "other root": ({**experiment(""), "tests.exp": "<Tests/>"}, "tests.exp: <Tests> is not <Experiments>"),
    "no number": (
        experiment(ONE.format('<TransientSimulation stopTime="soon"/>')),
        "tests.exp: experiment 'one': stopTime=\"soon\" is not a number",
    ),
    "no rows": ({MANIFEST: manifest(RESULT), "Dahlquist_out.csv": ""}, "Dahlquist_out.csv: has no rows"),
    "ragged": (
        {MANIFEST: manifest(RESULT), "Dahlquist_out.csv": "time,x\n0,1\n1\n"},
        "differ in their number of columns",
    ),
    "other variables": (
        {MANIFEST: manifest(RESULT), "Dahlquist_out.csv": "time,q\n0,1\n"},
        "the FMU has none of its variables, such as 'q'",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_malformed_is_named(tmp_path, name):
    members, words = BROKEN[name]
    fmu = with_members(built_fmus() / "Dahlquist.fmu", tmp_path, members)
    with pytest.raises(CaseError) as caught:
        shipped_cases(fmu, tmp_path / "unpacked")
    assert words in str(caught.value)
    assert str(fmu) in str(caught.value)


@pytest.mark.parametrize("heading", ["time", "Time", " TIME "])
def test_the_time_is_named_so(tmp_path, heading):
    members = {MANIFEST: manifest(RESULT), "Dahlquist_out.csv": csv(f"{heading},x", TENTHS, np.exp(-TENTHS))}
    (case,) = shipped_cases(with_members(built_fmus() / "Dahlquist.fmu", tmp_path, members), tmp_path / "of it").cases
    assert case.reference_path.read_text(encoding="utf-8").startswith("time,x\n")


def test_a_result_of_headings_alone_is_a_finding(tmp_path):
    members = {MANIFEST: manifest(RESULT), "Dahlquist_out.csv": "time,x\n"}
    found = outcomes(with_members(built_fmus() / "Dahlquist.fmu", tmp_path, members), tmp_path, *BOTH)
    for outcome in some(found.values()):
        (finding,) = outcome.findings
        assert " rows, the reference 0; " in finding


def test_a_parameter_that_the_fmu_lacks_is_said(tmp_path):
    """By the standard a set is applied to the variables of the same names."""
    text = ONE.format('<TransientSimulation stopTime="1"/><Parameters source="p.ssv"/>')
    members = experiment(text, **{"p.ssv": SSV.format(name="none", value=1.0)})
    found = shipped_cases(with_members(built_fmus() / "Dahlquist.fmu", tmp_path, members), tmp_path / "unpacked")
    assert found.notes == ["p.ssv: nothing is named 'none', which is ignored; known are k, max_step, x, der(x)"]
    assert dict(found.cases[0].start) == {}


def test_an_fmu_without_a_manifest_has_none(tmp_path):
    found = shipped_cases(built_fmus() / "Dahlquist.fmu", tmp_path / "unpacked")
    assert (found.cases, found.notes) == ([], [])


def test_arrays_texts_binary_values_and_columns_of_other_versions(tmp_path):
    """Cells with several numbers are elements; texts must be equal; columns without a variable are left out."""
    types = compiled(tmp_path, "fmi3_types")
    header = "time,Float64_out,Int64_out,Boolean_out,other,String_out,Binary_out"
    row = "{},0 0,0 0,false false,3,{},{}"
    for text, binary, findings in (("first", "00FF", 0), ("other", "00ff", 1), ("first", "00fe", 1)):
        folder = tmp_path / f"case{text}{binary}"
        folder.mkdir()
        rows = [row.format(t, text, binary) for t in (0, 1, 2)]
        members = {MANIFEST: manifest(RESULT), "Dahlquist_out.csv": "\n".join([header, *rows]) + "\n"}
        fmu = with_members(types, folder, members)
        found = shipped_cases(fmu, folder / "unpacked")
        assert "columns for which the FMU has no variables: other" in found.notes[0]
        lines = check(found.cases[0], fmu, "co_simulation", isolated=False).findings
        assert len(lines) == findings
        for line in lines:
            assert "differs at 3 of 3 times, first at t = 0 s" in line


def test_without_a_reference_the_outputs_that_are_numbers_are_recorded(tmp_path):
    """Such a run has to stay finite, which texts and binary values always are."""
    case = make_case(tmp_path, "types", opt="StartTime, 0\nStopTime, 1\nStepSize, 0.5\n")
    names = run(case, compiled(tmp_path, "fmi3_types"), "co_simulation").names
    assert {"Float64_out[1]", "Int64_out[2]", "Boolean_out[1]"} <= set(names)
    assert not {"String_out", "words_out[1]", "Binary_out"} & set(names)


@pytest.mark.slow
def test_pytest_runs_them_without_a_folder_of_references(pytester, monkeypatch):
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    dahlquist(pytester.path, np.exp(-TENTHS))
    run = ("-p", "cosim.regression.plugin", "-p", "no:cacheprovider", "-v", "-rs", "--fmu", "Dahlquist.fmu")
    done = pytester.runpytest_subprocess(*run)
    done.assert_outcomes(passed=2)
    done.stdout.fnmatch_lines(["*Dahlquist.fmu::Dahlquist_out-CS PASSED*", "*Dahlquist.fmu::Dahlquist_out-ME PASSED*"])
    (pytester.path / "Dahlquist_out_ref.toml").write_text("relative = 1e-10", encoding="utf-8")
    done = pytester.runpytest_subprocess(*run, "--fmu-in-process")
    done.assert_outcomes(passed=1, skipped=1)
    done.stdout.fnmatch_lines(["SKIPPED*co-simulation meets the reference, model exchange does not*"])
    pytester.makepyfile("def test_it(fmu_regression): fmu_regression('Dahlquist.fmu', interface='co_simulation')")
    done = pytester.runpytest_subprocess("-p", "cosim.regression.plugin", "-p", "no:cacheprovider")
    done.assert_outcomes(passed=1)


def test_the_validator_runs_them(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    dahlquist(tmp_path, np.exp(-TENTHS))
    assert main(["validate", "--run", "Dahlquist.fmu"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "Dahlquist.fmu: ok",
        "Dahlquist.fmu: Dahlquist_out, co-simulation: ok",
        "Dahlquist.fmu: Dahlquist_out, model exchange: ok",
    ]
    dahlquist(tmp_path, 1.001 * np.exp(-TENTHS))
    assert main(["validate", "Dahlquist.fmu"]) == 0
    capsys.readouterr()
    assert main(["validate", "--run", "Dahlquist.fmu"]) == 1
    assert "Dahlquist.fmu: Dahlquist_out, co-simulation: 'x' differs at" in capsys.readouterr().out
    shutil.copyfile(built_fmus() / "Ball.fmu", tmp_path / "Ball.fmu")
    main(["validate", "--run", "Ball.fmu"])
    assert "Ball.fmu: brings no references along that can be run" in capsys.readouterr().out
    with_members(built_fmus() / "Dahlquist.fmu", tmp_path, BROKEN["no XML"][0])
    assert main(["validate", "--run", "Dahlquist.fmu"]) == 1
    assert "is not XML" in capsys.readouterr().out
