"""Examples and the code in the documentation's pages run as they stand, each in a process and folder of its own."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cosim import Results
from cosim.__main__ import main
from cosim.commands import sweep
from fmu_export import DefaultExperiment, Layout, Model, Variable, build_native
from fmu_export.package.start_values import write_start_values
from parallel_robot.wiring import CONNECTIONS
from tests.support.native_fmus import DEFAULT_FLAVOUR
from tests.support.patience import PATIENCE

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.skipif(DEFAULT_FLAVOUR != "fmi2", reason="the examples take compiled FMUs; no C compiler here")


@pytest.fixture
def folder(robot_fmus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, no_figures: None) -> Path:
    """A working folder with the FMUs, as a user's."""
    (tmp_path / "fmus").mkdir()
    (tmp_path / "fmus/fmi2").symlink_to(robot_fmus / DEFAULT_FLAVOUR, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def python(*arguments: str | Path, expected: int = 0) -> str:
    """Output of a Python process that can't see the checkout's folder."""
    environment = {**os.environ, "MPLBACKEND": "agg"}
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, check=False, env=environment, timeout=PATIENCE
    )
    assert done.returncode == expected, done.stderr
    return done.stdout if expected == 0 else done.stderr


def example(name: str) -> Path:
    return ROOT / "examples" / name


def blocks(page: str, language: str) -> list[str]:
    """Code of a page in a language."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)


def position_error(results: Results) -> np.ndarray:
    return np.hypot(
        results["plant.x_E"] - results["trajectory.x_ref"], results["plant.y_E"] - results["trajectory.y_ref"]
    )


@pytest.mark.slow
def test_own_controller_as_a_model(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(example("replace_controller.py"), "my_controller.py")
    assert python("my_controller.py") == "built PID.fmu\n"
    command = ["run", "--fmu", "controller=PID.fmu", "--stop", "3", "--step", "0.002", "--out"]
    assert main([*command, "a"]) == 0
    assert "no controller.tau_ref, so nothing is connected" in capsys.readouterr().out
    assert main([*command, "b", "--set", "controller.K_p=30", "--set", "controller.K_d=8"]) == 0
    a, b = (Results.from_csv(f"{run}/results.csv") for run in "ab")
    # the integral of the error, by the trapezoidal rule
    error = a["plant.theta_a"] - a["trajectory.theta_ref"]
    integral = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (error[1:] + error[:-1]), axis=0) * 0.002])
    np.testing.assert_allclose(a["controller.z"], integral, atol=1e-5)
    rate = a["plant.omega_a"] - a["trajectory.omega_ref"]
    np.testing.assert_allclose(a["controller.tau_a"], -6 * error - 12 * a["controller.z"] - 2 * rate, atol=1e-12)
    late = a.time > 2.0
    assert position_error(b)[late].max() < 0.5 * position_error(a)[late].max() < 0.004


def test_own_controller_in_plain_python(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(example("controller_in_plain_python.py"), folder)
    assert python("controller_in_plain_python.py") == "built LimitedPD.fmu\n"
    assert main(["run", "--fmu", "controller=LimitedPD.fmu", "--stop", "3", "--step", "0.002", "--out", "out"]) == 0
    assert "no controller.tau_ref, so nothing is connected" in capsys.readouterr().out
    results = Results.from_csv("out/results.csv")
    error = results["plant.theta_a"] - results["trajectory.theta_ref"]
    rate = results["plant.omega_a"] - results["trajectory.omega_ref"]
    np.testing.assert_allclose(results["plant.tau_a"], np.clip(-6.0 * error - 2.0 * rate, -0.2, 0.2), atol=1e-12)
    assert np.abs(results["plant.tau_a"]).max() == 0.2
    assert position_error(results)[results.time > 2.0].max() < 0.006


def test_a_function_in_the_loop(folder: Path) -> None:
    out = python(example("function_in_the_loop.py"))
    (shown,) = re.findall(r"at most ([\d.]+) mm", out)
    results = Results.from_csv("results.csv")
    assert f"{1e3 * position_error(results)[results.time > 2.0].max():.2f}" == shown
    assert float(shown) < 5.0
    # the law at its own points, and the zero-order hold in between
    error = results["plant.theta_a"] - results["trajectory.theta_ref"]
    rate = results["plant.omega_a"] - results["trajectory.omega_ref"]
    integral = 0.002 * np.cumsum(error[::2], axis=0)
    law = -6.0 * error[::2] - 12.0 * integral - 2.0 * rate[::2]
    np.testing.assert_allclose(results["controller.tau_a"][::2], law, atol=1e-12)
    np.testing.assert_array_equal(results["plant.tau_a"][1::2], results["controller.tau_a"][:-1:2])


def test_own_controller_of_a_scenario_file(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What the option does, a file does too."""
    shutil.copy(example("replace_controller.py"), "my_controller.py")
    python("my_controller.py")
    text = 'system = "parallel_robot"\n[run]\nstop_time = 0.5\n[start.plant]\ndm = 0.0\ntau_d = 0.0\n'
    Path("option.toml").write_text(text, encoding="utf-8")
    Path("file.toml").write_text(text + '[components.controller]\nfmu = "PID.fmu"\n', encoding="utf-8")
    assert main(["run", "option.toml", "--fmu", "controller=PID.fmu"]) == 0
    assert main(["run", "file.toml"]) == 0
    assert capsys.readouterr().out.count("no controller.tau_ref, so nothing is connected there") == 2
    assert Path("results/file/results.csv").read_bytes() == Path("results/option/results.csv").read_bytes()


def test_a_controller_with_other_signals(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The scenario file of the page, with a controller that pulls the end effector to a point."""
    model = Model(
        name="theirs",
        description="Torque in proportion to a position",
        parameters=Layout([Variable("K", "N", "Gain", start=0.1)]),
        inputs=Layout([Variable("x", "m", "Position"), Variable("y", "m", "Position")]),
        outputs=Layout([Variable("torque", "N.m", "Torque", size=3)]),
        states=(),
        initial_state=lambda p: np.zeros(0),
        derivatives=lambda t, x, u, p: np.zeros(0),
        output_values=lambda t, x, u, p: p[0] * np.stack([u[0], u[1], u[0] + u[1]]),
        default_experiment=DefaultExperiment(stop_time=1.0, step_size=1e-3),
    )
    build_native(model, folder, "fmi2")
    (text,) = (text for text in blocks("replace_controller.md", "toml") if "theirs.fmu" in text)
    Path("theirs.toml").write_text(text, encoding="utf-8")
    assert main(["run", "theirs.toml", "--stop", "0.1"]) == 0
    assert "the FMUs given have no controller.theta_a, " in capsys.readouterr().out
    results = Results.from_csv("results/theirs/results.csv")
    assert results["controller.x"].tolist() == results["plant.x_E"].tolist()
    np.testing.assert_array_equal(results["plant.tau_a"], results["controller.torque"])
    x, y = results["plant.x_E"], results["plant.y_E"]
    np.testing.assert_allclose(results["plant.tau_a"], 0.1 * np.column_stack([x, y, x + y]), atol=1e-15)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("controller", "--fmu controller: write COMPONENT=FILE"),
        ("ctrl=fmus/fmi2/RobotController.fmu", "the scenario has no component 'ctrl'; did you mean 'controller'"),
        ("controller=none.fmu", "component 'controller': none.fmu: there is no such FMU file"),
        ("controller=fmus/fmi2/RobotTrajectory.fmu", "'controller.theta_ref' is an output and can't be the target"),
    ],
)
@pytest.mark.usefixtures("folder")
def test_an_fmu_that_does_not_fit_is_refused(capsys: pytest.CaptureFixture[str], given: str, message: str) -> None:
    assert main(["run", "--fmu", given, "--stop", "1"]) == 1
    assert message in capsys.readouterr().err


@pytest.mark.usefixtures("folder")
def test_sweep() -> None:
    found = re.findall(r"alpha = (\d): steady error ([\d.]+) mm", python(example("sweep.py")))
    assert [alpha for alpha, _ in found] == ["0", "1", "2", "4"] * 2
    errors = np.array([float(error) for _, error in found]).reshape(2, 4)
    assert (np.diff(errors) < 0.0).all()  # the robust part makes them smaller


@pytest.mark.slow
def test_tanks(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A system without a robot, whose FMUs are made on the spot."""
    for name in ("build.py", "tanks.toml"):
        shutil.copy(example(f"tanks/{name}"), folder)
    assert python("build.py") == "built Tank.fmu\nbuilt LevelController.fmu\n"
    assert main(["run", "tanks.toml", "--out", "a"]) == 0
    shown = capsys.readouterr().out
    page = (ROOT / "docs/scenarios.md").read_text(encoding="utf-8")
    for metric in ("error_rms", "highest_level", "pumped"):  # as the page says
        (line,) = (line for line in shown.splitlines() if line.startswith(metric))
        assert line in page
    # Torricelli's law and the leak, from what was recorded
    results = Results.from_csv("a/results.csv")
    outflow = 0.01 * np.sqrt(2.0 * 9.81 * results["upper.level"])
    volume = 0.5 * (results["upper.level"][-1] - results["upper.level"][0])
    flow = results["controller.flow"]  # it jumps once, between two rows, of which the trapezoid knows nothing
    within = 0.1 * np.abs(np.diff(flow)).max()
    assert volume == pytest.approx(np.trapezoid(flow - outflow, results.time), abs=within)
    lower = 0.01 * np.sqrt(2.0 * 9.81 * results["lower.level"])
    volume = 0.5 * (results["lower.level"][-1] - results["lower.level"][0])
    assert volume == pytest.approx(np.trapezoid(0.9 * outflow - lower, results.time), abs=2e-4)
    # the code of the page, in the same folder
    (code,) = blocks("scenarios.md", "python")
    Path("page.py").write_text(code + "print(results['lower.level'][-1])\n", encoding="utf-8")
    assert float(python("page.py")) == results["lower.level"][-1]


@pytest.mark.slow
def test_plant_in_python_control() -> None:
    out = python(example("plant_in_python_control.py"))
    poles = [complex(p) for p in out.split("poles (1/s): ")[1].splitlines()[0].split()]
    assert len(poles) == 12
    assert sum(abs(p + 10.0) < 0.06 for p in poles) == 8
    assert all(p.real < 0.0 for p in poles)
    step, static = (float(value) for value in re.findall(r"(-?[\d.]+) mm", out))
    assert step == pytest.approx(static, abs=0.001)


def test_without_omsimulator_its_example_says_so(folder: Path) -> None:
    (folder / "OMSimulator.py").write_text("raise ImportError")
    error = python("-c", f"import runpy; runpy.run_path({str(example('load_in_omsimulator.py'))!r})", expected=1)
    assert error.startswith("OMSimulator is not installed")
    assert error.count("\n") == 1


def test_omsimulator_is_asked_for_our_connections(folder: Path) -> None:
    """It can't be installed here; a stand-in writes down what it is asked for."""
    (folder / "OMSimulator.py").write_text(
        "class Any:\n"
        "    def __getattr__(self, name):\n"
        "        return lambda *a, **k: (print(name, *a), Any())[1]\n"
        "SSP = Any\n"
        "def CRef(*parts): return '.'.join(parts)\n"
    )
    out = python("-c", f"import runpy; runpy.run_path({str(example('load_in_omsimulator.py'))!r})").splitlines()
    asked = {tuple(line.split()[1:]) for line in out if line.startswith("addConnection")}
    assert asked == {
        (f"default.{source}[{i}]", f"default.{target}[{i}]")
        for source, target in CONNECTIONS
        for i in (1, 2, 3)
        if not source.endswith("tau_ref")  # used by the feedforward only, which is off
    }
    assert {line.split()[1] for line in out if line.startswith("addResource")} <= {
        f"fmus/fmi2/{path.name}" for path in (folder / "fmus/fmi2").iterdir()
    }


@pytest.mark.slow
def test_regression_test_of_an_fmu(folder: Path) -> None:
    file = example("regression_test_of_an_fmu.py")
    command = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull, file]
    assert "2 passed" in python(*command)
    wrong = folder / "fmus" / "fmi2"
    copies = {path.name: path.read_bytes() for path in wrong.resolve().glob("*.fmu")}
    wrong.unlink()
    wrong.mkdir()
    for name, content in copies.items():
        (wrong / name).write_bytes(content)
    write_start_values(wrong / "RobotPlant.fmu", {"Z": 0.0427})
    python(*command, expected=1)


#: What is not built in the page is traced, and so compared with numpy.
TRACE_CLASSES = """
from fmu_export.trace.trace import trace

classes = [c for c in dict(globals()).values() if isinstance(c, type) and issubclass(c, ModelClass)]
assert len([trace(c) for c in classes if c is not ModelClass]) > 8
"""


#: The same bits, in a third of the time.
COMPILE_FAST = """from fmu_export.native import toolchain
toolchain.OPTIMISATION = "-O0"
"""


#: Pages whose code takes longer, or needs packages that are not small.
_OTHERS = (
    *("models.md", "coupling.md", "errors.md", "extending.md", "importing_fmus.md", "isolation.md", "mechanism.md"),
    *("optimisation.md", "packing.md", "python_control.md", "stability.md"),
)


@pytest.mark.parametrize(
    "page",
    [
        *("tutorial.md", "results.md", "couple_fmus.md"),
        *(pytest.param(page, marks=pytest.mark.slow) for page in _OTHERS),
    ],
)
def test_code_of_a_page_runs(folder: Path, page: str) -> None:
    code = blocks(page, "python")
    assert code
    before = example("couple_fmus.py").read_text(encoding="utf-8") if page == "couple_fmus.md" else COMPILE_FAST
    after = TRACE_CLASSES if page == "models.md" else ""
    (folder / "page.py").write_text("\n".join([before, *code, after]), encoding="utf-8")
    out = python("page.py")
    if page == "tutorial.md":  # prints what the page says it does
        printed = next(text for text in blocks(page, "text") if text.startswith("Results"))
        assert printed in out


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_octave_reads_results_as_the_page_says() -> None:
    octave = shutil.which("octave-cli") or pytest.skip("MATLAB's code is not tried: no octave-cli on the path")
    (code,) = blocks("results.md", "matlab")
    assert main(["run", "--stop", "0.1", "--format", "mat", "--format", "csv"]) == 0
    checks = r'printf("%.17g\n", time(end), x(end), theta(end, :), run.parameters.controller_alpha)'
    lines = [line for line in code.splitlines() if not line.startswith("plot(")]  # Octave may have no window here
    Path("page.m").write_text("\n".join([*lines, checks]), encoding="utf-8")
    done = subprocess.run([octave, "page.m"], capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr
    results = Results.from_csv("results/tracking/results.csv")
    summary = json.loads(Path("results/tracking/summary.json").read_text(encoding="utf-8"))
    alpha = summary["parameters"]["controller.alpha"]
    last = [results.time[-1], results["plant.x_E"][-1], *results["plant.theta_a"][-1]]
    *found, found_alpha = (float(line) for line in done.stdout.split()[-6:])
    assert found == last
    assert found_alpha == pytest.approx(alpha, rel=1e-15)  # Octave's reader of JSON rounds


@pytest.mark.parametrize("page", ["tutorial.md", "replace_controller.md"])
def test_commands_of_a_page_run(folder: Path, page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With shorter runs; sweeps are only parsed."""
    monkeypatch.setattr(sweep, "run", lambda args: 0)
    for text in blocks(page, "toml"):
        Path("mine.toml").write_text(text, encoding="utf-8")
    if page == "replace_controller.md":
        python(example("replace_controller.py"))
        python(example("controller_in_plain_python.py"))
    lines = [line for text in blocks(page, "sh") for line in text.splitlines() if line.startswith("cosim ")]
    assert len(lines) >= 4
    for line in lines:
        short = [] if line.startswith("cosim sweep") else ["--stop", "0.1"]
        assert main([*shlex.split(line, comments=True)[1:], *short]) == 0, line
