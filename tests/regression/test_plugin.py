"""`pytest --fmu`, tried in sessions of its own: what it collects, reports, refuses and survives."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import entry_points
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from cosim.regression import check
from cosim.regression.case import RunError
from cosim.regression.isolated import run_isolated
from cosim.regression.rebaseline import RebaselineError, _tolerances, reason_against, rebaseline
from cosim.results.results import Results
from cosim.signing import new_key, sign
from tests.support.c_fmus import sources_of_tank, talker
from tests.support.regression_fmus import built_fmus, make_case
from tests.support.small_fmus import redescribed

pytest_plugins = ["pytester"]


@pytest.fixture
def built() -> Path:
    return built_fmus()


@pytest.fixture
def session(pytester, monkeypatch, built):
    """Runs pytest with the plugin in a folder with the FMUs, in this process, or in one of its own."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    for name in ("CI", "PYTEST_ADDOPTS"):
        monkeypatch.delenv(name, raising=False)
    (pytester.path / "fmus").mkdir()
    for name in ("Ball", "Dahlquist", "Feedthrough"):
        (pytester.path / "fmus" / f"{name}.fmu").write_bytes((built / f"{name}.fmu").read_bytes())

    def run(*arguments: str, alone: bool = False) -> pytest.RunResult:
        call = pytester.runpytest_subprocess if alone else pytester.runpytest_inprocess
        return call("-p", "cosim.regression.plugin", "-p", "no:cacheprovider", *arguments)

    return run


def dahlquist(folder: Path, toml: str = "relative = 1e-6\n[signals]\nx = { unit = 'm' }", factor: float = 1.0) -> None:
    time = np.arange(201) * 0.01
    reference = Results(time, ["x"], factor * np.exp(-time)[:, None])
    make_case(folder, "Dahlquist", reference, toml=toml, opt="StartTime, 0\nStopTime, 2\nStepSize, 0.01\nRelTol, 1e-9")


def test_the_plugin_is_announced():
    (plugin,) = [p for p in entry_points(group="pytest11") if p.name == "cosim_fmu"]
    assert plugin.value == "cosim.regression.plugin"


def test_the_plugin_loads_nothing_before_it_is_used():
    code = (
        "import sys, cosim.regression.plugin; print(*(m for m in sys.modules if m.partition('.')[0] in sys.argv[1:]))"
    )
    heavy = ("numpy", "scipy", "fmpy", "pyarrow", "matplotlib", "pyfunnel")
    done = subprocess.run([sys.executable, "-c", code, *heavy], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == ""


def test_a_folder_is_run_by_all_interfaces_and_reported(session, pytester):
    """One FMU passes, one fails, one has no reference; with a page and JUnit's file."""
    dahlquist(pytester.path / "reference")
    ball = Results(np.arange(3) * 0.01, ["h"], np.array([[1.0], [0.9995095], [0.5]]))
    make_case(pytester.path / "reference", "Ball", ball, toml="absolute = 1e-6")
    options = ("--fmu-in-process", "--fmu-report", "out/page.html", "--junitxml", "junit.xml", "-rs")
    done = session("--fmu", "fmus", *options, alone=True)
    done.assert_outcomes(passed=2, failed=2, skipped=1)
    done.stdout.fnmatch_lines(
        [
            "*'h' differs at 1 of 3 times, most at t = 0.02 s: 0.998038 instead of 0.5 (tolerance 1e-06)",
            "report of the FMUs: *page.html",
            "SKIPPED*Feedthrough.fmu: no reference of it in *",
        ]
    )
    suite = ElementTree.parse(pytester.path / "junit.xml").getroot()[0]
    tests = {test.get("name"): test for test in suite.iterfind("testcase")}
    assert set(tests) == {"Ball-CS", "Ball-ME", "Dahlquist-CS", "Dahlquist-ME", "reference"}
    assert tests["Dahlquist-CS"].get("classname") == "fmus.Dahlquist.fmu"
    properties = {p.get("name"): p.get("value") for p in tests["Dahlquist-ME"].iter("property")}
    assert properties["interface"] == "ME"
    assert float(properties["largest difference of x (m)"]) < 1e-6
    assert "differs at 1 of 3 times" in tests["Ball-CS"].find("failure").text
    page = (pytester.path / "out" / "page.html").read_text(encoding="utf-8")
    assert page.count('<section id="run-') == 4
    assert "2 of 4 runs failed" in page


def test_an_fmu_above_the_working_folder_is_run(session, pytester):
    dahlquist(pytester.path / "reference")
    done = session("--fmu", f"../{pytester.path.name}/fmus/Dahlquist.fmu", "--fmu-in-process")
    done.assert_outcomes(passed=2)


@pytest.mark.slow
def test_in_parallel_the_same(session, pytester):
    dahlquist(pytester.path / "reference", factor=1.001)
    pytester.makeini("[pytest]\ntestpaths = tests")  # which are not run
    (pytester.mkdir("tests") / "test_other.py").write_text("def test_other(): raise ValueError")
    fmus = ("--fmu", "fmus/Dahlquist.fmu", "--fmu", "none", "--fmu-in-process")
    done = session("-p", "xdist.plugin", "-n", "2", *fmus, "--fmu-report", "page.html", alone=True)
    done.assert_outcomes(failed=3)
    done.stdout.fnmatch_lines(["--fmu none: there is no such file or folder"])
    assert (pytester.path / "page.html").read_text(encoding="utf-8").count('<section id="run-') == 2


def test_what_is_broken_fails_in_one_line_and_the_rest_runs(session, pytester):
    """A crash, an FMU that refuses, a broken CSV, unreadable tolerances, no FMU, an empty folder, a wrong name."""
    reference, fmus = pytester.path / "reference", pytester.path / "fmus"
    dahlquist(reference)
    times = Results(np.arange(3) * 0.01, ["h"], np.ones((3, 1)))
    make_case(reference, "Crash", times, toml="fmu = 'Ball'\nstart.crash_at = 0.0")
    make_case(reference, "Csv", times, toml="fmu = 'Ball'").reference_path.write_text('"time","h"\n0.0,x\n0.01,1.0\n')
    make_case(reference, "Toml", times, toml="relative = ")
    make_case(reference, "Refuses", times)
    (fmus / "Toml.fmu").write_bytes((fmus / "Ball.fmu").read_bytes())
    redescribed(fmus / "Ball.fmu", fmus / "Refuses.fmu", {"{ball}": "{other}"})
    (fmus / "NoZip.fmu").write_text("nothing")
    (pytester.path / "empty").mkdir()
    (pytester.path / "text.txt").touch()
    done = session("--fmu", "fmus", "--fmu", "empty", "--fmu", "text.txt", "-k", "not ME", "--tb=short")
    done.assert_outcomes(passed=1, failed=7, skipped=1, deselected=5)
    done.stdout.fnmatch_lines_random(
        [
            "fmus?Ball.fmu: fmu failed at t = 0 s: its process was ended (*",
            "*fmus?Refuses.fmu *nstantiate*",
            "*Toml_ref.toml: can't be read as TOML: *",
            "*Csv_ref.csv: line 2: a cell 'x' is not a number, as others of its column are",
            "fmus?NoZip.fmu: is a text, not an FMU (not a zip archive); *",
            "--fmu empty: there is no FMU file in this folder",
            "--fmu text.txt: the name of an FMU file ends with .fmu",
        ]
    )
    done.stdout.no_fnmatch_line("*Traceback*")


def test_an_endless_loop_ends(built, tmp_path):
    case = make_case(tmp_path, "Ball", toml="start.g = -1.0")
    with pytest.raises(RunError, match=r"did not end within 1 s; allow more with --fmu-timeout"):
        run_isolated(case, built / "Ball.fmu", "co_simulation", timeout=1.0)


def test_an_fmu_that_was_named_must_have_a_reference(session, pytester):
    done = session("--fmu", "fmus/Ball.fmu", "--fmu-reference", "nowhere")
    done.assert_outcomes(failed=1)
    done.stdout.fnmatch_lines(["--fmu-reference nowhere: there is no such folder"])
    pytester.mkdir("elsewhere")
    done = session("--fmu", "fmus/Ball.fmu", "--fmu-reference", "elsewhere")
    done.assert_outcomes(failed=1)
    done.stdout.fnmatch_lines(["Ball.fmu: no reference of it in elsewhere; make one with --fmu-rebaseline Ball"])


def test_the_fixture_runs_an_fmu_in_a_test_of_ones_own(session, pytester):
    dahlquist(pytester.path / "cases", toml="relative = 1e-15\n[model_exchange]\nrelative = 1e-3")
    pytester.makepyfile(
        """
        def test_model_exchange(fmu_regression):
            fmu_regression("fmus/Dahlquist.fmu", reference="cases", interface="model_exchange")

        def test_all(fmu_regression):
            fmu_regression("fmus/Dahlquist.fmu", reference="cases/Dahlquist")
        """
    )
    done = session("--fmu-in-process", "--fmu-report", "page.html")
    done.assert_outcomes(passed=1, failed=1)
    done.stdout.fnmatch_lines(["Dahlquist CS: 'x' differs at * of 201 times, *"])
    assert "1 of 3 runs failed" in (pytester.path / "page.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def signed(tmp_path_factory) -> Path:
    """A signed FMU beside its key; made before `pytester` begins, which has modules forgotten that load once only."""
    folder = tmp_path_factory.mktemp("signed")
    shutil.copy(built_fmus() / "Dahlquist.fmu", folder)
    new_key(folder / "maker")
    sign(folder / "Dahlquist.fmu", folder / "maker")
    return folder


def test_a_session_can_demand_signatures(signed, session, pytester):
    dahlquist(pytester.path / "fmus")
    shutil.copy("fmus/Dahlquist.fmu", "fmus/Unsigned.fmu")
    shutil.copytree("fmus/Dahlquist", "fmus/Unsigned")
    for file in Path("fmus/Unsigned").iterdir():
        file.rename(file.with_name(file.name.replace("Dahlquist", "Unsigned")))
    shutil.copy(signed / "Dahlquist.fmu.sig", "fmus")
    pytester.makepyfile("def test_it(fmu_regression): fmu_regression('fmus/Unsigned.fmu')")
    options = ("--fmu-require-signed", str(signed / "maker.pub"), "--fmu-in-process")
    for done in (session("--fmu", "fmus/Dahlquist.fmu", "--fmu", "fmus/Unsigned.fmu", *options), session(*options)):
        done.stdout.fnmatch_lines(["*Unsigned.fmu: is not signed: there is no Unsigned.fmu.sig beside it*"])
        passed = done.parseoutcomes().get("passed", 0)
        assert (passed, done.parseoutcomes()["failed"]) in ((2, 2), (0, 1))


def git(folder: Path, *arguments: str) -> None:
    options = ["-c", "user.name=tests", "-c", "user.email=tests@example.org"]
    subprocess.run(["git", *options, *arguments], cwd=folder, check=True, capture_output=True)


def test_a_reference_is_made(session, pytester):
    folder = pytester.path / "reference" / "Ball"
    options = ("--fmu", "fmus/Ball.fmu", "--fmu-reference", "reference", "--fmu-in-process")
    done = session(*options, "--fmu-rebaseline", "Ball")
    done.assert_outcomes(skipped=1, passed=1)  # model exchange is held against the new reference
    done.stdout.fnmatch_lines(["wrote *Ball_ref.csv, *Ball_ref.opt, *Ball_ref.toml: look at the changes*"])
    assert '\nh = { unit = "m" }\n' in (folder / "Ball_ref.toml").read_text()
    session(*options).assert_outcomes(passed=2)


def test_a_reference_is_made_anew_only_where_git_has_the_old_one(built, tmp_path):
    case = make_case(tmp_path, "Ball", Results(np.arange(201) * 0.01, ["v"], np.ones((201, 1))), toml="start.e = 0.65")
    old = case.reference_path.read_bytes()
    with pytest.raises(RebaselineError, match="git does not know it; commit it, or move it away to start over"):
        rebaseline(case, built / "Ball.fmu", "co_simulation", 60.0)
    for arguments in (("init",), ("add", "."), ("commit", "-m", "all")):
        git(tmp_path, *arguments)
    assert case.reference_path.read_bytes() == old
    said = rebaseline(case, built / "Ball.fmu", "co_simulation", 60.0)
    assert "Ball_ref.csv" in said
    assert "Ball_ref.toml" not in said
    assert case.reference().names == ["v"]  # the signals, and what people wrote, stay
    assert case.tolerances_path.read_text() == "start.e = 0.65"
    assert check(case, built / "Ball.fmu", "co_simulation", isolated=False).findings == []
    new = case.reference_path.read_bytes()
    assert new != old
    with pytest.raises(RebaselineError, match="has changes that are not committed"):
        rebaseline(case, built / "Ball.fmu", "co_simulation", 60.0)
    assert case.reference_path.read_bytes() == new


def test_new_tolerances_have_the_unit_of_a_vector_or_those_of_its_elements():
    units = {"x": "m", "v[1]": "m/s", "v[2]": "m/s", "q[1]": "rad", "q[2]": "m", "no unit": "", "der(x)": "m/s"}
    results = Results(np.zeros(1), list(units), np.zeros((1, 7)), {"units": units})
    written = {both: tomllib.loads(_tolerances(results, both=both)) for both in (False, True)}
    expected = {"x": "m", "v": "m/s", "q[1]": "rad", "q[2]": "m", "no unit": "", "der(x)": "m/s"}
    for both, data in written.items():
        assert {name: table["unit"] for name, table in data["signals"].items()} == expected
        assert (data["relative"], data["absolute"]) == (1e-9, 1e-9)
        assert data.get("model_exchange") == ({"relative": 1e-4, "absolute": 1e-6} if both else None)


@pytest.mark.parametrize(
    ("arguments", "environment", "parallel", "fmus", "reason"),
    [
        (["--fmu-rebaseline", "a"], {}, False, 1, ""),
        (["--fmu-rebaseline=a"], {"CI": "false"}, False, 1, ""),
        (["--fmu", "a.fmu"], {}, False, 1, "typed on the command line"),
        (["--fmu-rebaseline", "a"], {"CI": "true"}, False, 1, "not in CI"),
        (["--fmu-rebaseline", "a"], {"CI": "1"}, False, 1, "not in CI"),
        (["--fmu-rebaseline", "a"], {}, True, 1, "not in parallel"),
        (["--fmu-rebaseline", "a"], {}, False, 0, "takes one FMU, not 0"),
        (["--fmu-rebaseline", "a"], {}, False, 2, "takes one FMU, not 2"),
    ],
)
def test_no_reference_is_made_anew_by_accident(arguments, environment, parallel, fmus, reason):
    found = reason_against(arguments, environment, parallel=parallel, fmus=fmus)
    assert reason in found
    assert bool(found) == bool(reason)


def test_a_configuration_cannot_make_references_anew(session, pytester, monkeypatch):
    monkeypatch.setenv("PYTEST_ADDOPTS", "--fmu-rebaseline Ball")
    done = session("--fmu", "fmus/Ball.fmu")
    assert done.ret == pytest.ExitCode.USAGE_ERROR
    done.stderr.fnmatch_lines(["ERROR: --fmu-rebaseline Ball: must be typed on the command line, not be set elsewhere"])
    assert not (pytester.path / "reference").exists()


@pytest.mark.parametrize(
    ("arguments", "refused"), [(("-n", "2"), True), (("--tx", "popen"), True), (("-n", "0"), False)]
)
def test_processes_of_pytest_xdist_make_no_references_anew(session, arguments, refused):
    done = session("-p", "xdist.plugin", *arguments, "--fmu", "fmus/Ball.fmu", "--fmu-rebaseline", "Ball", "--co")
    said = "ERROR: --fmu-rebaseline Ball: not in parallel; leave -n away"
    assert (said in done.errlines) == refused


def test_parts_of_the_page_can_travel_between_processes():
    """What pytest-xdist sends has to be plain."""
    from cosim.regression.outcome import Outcome
    from cosim.regression.page import part

    made = part(Outcome("case", "my.fmu", "CS", ["<broken>"], [], "", 0.1))
    assert json.loads(json.dumps(made)) == made
    assert "&lt;broken&gt;" in made["section"]


def test_c_sources_are_not_compiled_unasked(tmp_path) -> None:
    fmu = sources_of_tank(tmp_path / "tank.fmu")
    reference = Results(np.arange(3) * 0.5, ["y"], np.arange(3)[:, None] * 0.5)
    case = make_case(tmp_path / "reference", "tank", reference, toml="start.u = 1.0", opt=OPTIONS)
    (finding,) = check(case, fmu, "co_simulation", isolated=False).findings
    assert "or compile its C sources: --build" in finding


@pytest.mark.slow
def test_c_sources_are_compiled_where_asked(session, pytester) -> None:
    fmu = sources_of_tank(pytester.path / "fmus" / "tank.fmu")
    reference = Results(np.arange(3) * 0.5, ["y"], np.arange(3)[:, None] * 0.5)
    make_case(pytester.path / "reference", "tank", reference, toml="start.u = 1.0", opt=OPTIONS)
    refused = session("--fmu", str(fmu))
    refused.assert_outcomes(failed=1)
    refused.stdout.fnmatch_lines(["*or compile its C sources: --build (pytest: --fmu-build; in Python: build=True)"])
    session("--fmu", str(fmu), "--fmu-build").assert_outcomes(passed=1)
    session("--fmu", str(fmu), "--fmu-build", "--fmu-in-process").assert_outcomes(passed=1)


@pytest.mark.parametrize("options", [(), ("--fmu-in-process",)])
def test_what_fmus_say_is_shown_where_asked(session, pytester, options: tuple[str, ...]) -> None:
    fmu = talker(pytester.path / "fmus" / "talker.fmu", "WARNS")
    counted = Results(np.arange(3) * 0.5, ["y"], np.arange(3.0)[:, None])
    make_case(pytester.path / "reference", "talker", counted, opt=OPTIONS)
    quiet, loud = (session("--fmu", str(fmu), *options, "-rP", *more) for more in ((), ("--fmu-log", "info")))
    for result in (quiet, loud):
        result.assert_outcomes(passed=1)
    assert "fmu: warning" not in quiet.stdout.str()
    loud.stdout.fnmatch_lines(["*t = * s: fmu: warning: *"])


OPTIONS = "StartTime, 0\nStopTime, 1\nStepSize, 0.5\n"
