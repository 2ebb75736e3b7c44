"""The small install: the base couples FMUs alone, and whoever needs an extra is told which, in one line."""

from __future__ import annotations

import ast
import os
import pickle
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import cosim.errors
import fmu_export.errors
from tests.support import some
from tests.support.native_fmus import DEFAULT_FLAVOUR
from tests.support.sources import CHECKOUT, sources

#: Each starts an interpreter that has to do without many packages.
slow = pytest.mark.slow

PROJECT = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
NAME = PROJECT["name"]
PACKAGES = ("plant_fmu", "controller_fmu", "trajectory_fmu", "fmu_export", "cosim", "parallel_robot")

#: Extras for those who use the packages; the others are for tests, documentation and comparisons.
FOR_USERS = ("export", "control", "plot", "sweep", "ssp", "robot", "regression", "live", "shell", "sign", "all")


#: Packages that are imported under another name than they are installed by.
_MODULES = {"pillow": "PIL"}


def modules_of(requirements: list[str]) -> set[str]:
    """Names under which the packages of requirements are imported, those of other extras included."""
    found = set()
    for requirement in requirements:
        name, extras = re.fullmatch(r"([\w.-]+)(?:\[([\w,]+)\])?.*", requirement).groups()
        if name == NAME:
            for extra in extras.split(","):
                found |= modules_of(PROJECT["optional-dependencies"][extra])
        else:
            found.add(_MODULES.get(name, name.lower().replace("-", "_")))
    return found


BASE = modules_of(PROJECT["dependencies"])
EXTRAS = {extra: modules_of(PROJECT["optional-dependencies"][extra]) for extra in FOR_USERS}
OPTIONAL = set().union(*EXTRAS.values()) - BASE

#: Run at the start of a process and of those that it starts: packages that can't be imported, as if not installed.
WITHOUT = """
import importlib.metadata
from importlib.machinery import PathFinder

find_spec = PathFinder.find_spec

def find_none(name, path=None, target=None):
    return None if name.partition(".")[0] in ABSENT else find_spec(name, path, target)

PathFinder.find_spec = find_none
installed = importlib.metadata.Distribution.from_name

def from_name(name):
    if name.replace("-", "_") in ABSENT:
        raise importlib.metadata.PackageNotFoundError(name)
    return installed(name)

importlib.metadata.Distribution.from_name = from_name
"""

PROGRAM = "import sys\nfrom cosim.__main__ import main\nsys.exit(main(sys.argv[1:]))\n"


def process(
    code: str, folder: Path, *arguments: str | Path, absent: set[str] = OPTIONAL
) -> subprocess.CompletedProcess[str]:
    """A process in which some packages are not installed."""
    site = folder / "without"
    site.mkdir(exist_ok=True)
    (site / "sitecustomize.py").write_text(f"ABSENT = {sorted(absent)!r}\n{WITHOUT}")
    environment = {k: v for k, v in os.environ.items() if not k.startswith("COV")} | {"PYTHONPATH": str(site)}
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, env=environment)


@pytest.fixture
def folder(robot_fmus: Path, tmp_path: Path) -> Path:
    """A working folder with the robot's FMUs."""
    (tmp_path / "fmus").mkdir()
    (tmp_path / "fmus/fmi2").symlink_to(robot_fmus / DEFAULT_FLAVOUR, target_is_directory=True)
    return tmp_path


def test_the_extras_hold_what_they_are_named_after():
    assert {"numpy", "fmpy", "lxml", "pyarrow", "tqdm"} == BASE
    assert {"casadi", "pythonfmu"} <= EXTRAS["export"]
    assert "control" in EXTRAS["control"]
    assert EXTRAS["plot"] == {"matplotlib"}
    assert {"dask", "distributed"} <= EXTRAS["sweep"]
    assert "xmlschema" in EXTRAS["ssp"]
    assert EXTRAS["all"] == OPTIONAL
    everything = modules_of(PROJECT["optional-dependencies"]["test"])
    assert everything >= OPTIONAL  # no test is skipped for an extra


COUPLE = """
from pathlib import Path
import numpy as np
from cosim import Results, Simulation, System

system = System()
system.add("plant", "fmus/fmi2/RobotPlant.fmu", start={"tau_d": [0, 0, 0], "dm": 0})
system.add("controller", "fmus/fmi2/RobotController.fmu")
system.add("trajectory", "fmus/fmi2/RobotTrajectory.fmu")
for name in ("theta_a", "omega_a"):
    system.connect(f"plant.{name}", f"controller.{name}")
for name in ("theta_ref", "omega_ref", "tau_ref"):
    system.connect(f"trajectory.{name}", f"controller.{name}")
system.connect("controller.tau_a", "plant.tau_a")
with Simulation(system) as simulation:
    results = simulation.run(0.1, 1e-3)
from cosim.results.formats import FORMATS
for name in FORMATS:
    results.save(f"r.{name}")
assert Results.from_csv("r.csv").values.tobytes() == results.values.tobytes()
assert results.to_arrow().num_rows == len(results.time) == 101
print(repr(results), results._repr_html_()[:7], results.values.tobytes() == np.load("r.npz")["values"].tobytes())
"""


@slow
def test_the_base_couples_fmus_and_writes_all_formats(folder: Path) -> None:
    done = process(COUPLE, folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Results: 101 rows")
    assert done.stdout.endswith("<iframe True\n")


@slow
def test_every_module_of_the_base_is_imported(tmp_path: Path) -> None:
    """The packages themselves, and all of cosim that is not about an extra."""
    about_extras = (
        "cosim.fmi.isolation.host",
        "cosim.live.server",
        "cosim.page.server",
        "cosim.ssp",
        "cosim.sweep",
        "cosim.regression",
        "cosim.results.plot",
    )
    modules = [*PACKAGES, "cosim.sweep.points", "cosim.regression"]
    modules += [m for m in sources() if m.startswith("cosim.") and not m.startswith((*about_extras, "cosim.__main__"))]
    modules = [m for m in modules if m != "cosim.commands.run_ssp"]
    assert len(modules) > 30
    done = process(f"for module in {modules!r}:\n    __import__(module)", tmp_path)
    assert done.returncode == 0, done.stderr


@slow
@pytest.mark.parametrize(
    "command",
    [
        ["--help"],
        ["run", "--help"],
        ["sweep", "--help"],
        ["--version"],
        ["validate", "fmus/fmi2/RobotPlant.fmu"],
        ["compare", "a.csv", "a.csv"],
    ],
)
def test_commands_of_the_base_run(folder: Path, command: list[str]) -> None:
    (folder / "a.csv").write_text('"time","a.x"\n0,1\n1,2\n')
    done = process(PROGRAM, folder, *command)
    assert done.returncode == 0, done.stderr
    assert done.stdout


@slow
@pytest.mark.parametrize("command", [["run", "fmus/fmi2/RobotTrajectory.fmu"], ["run", "tracking"], ["run", "my.toml"]])
def test_runs_of_the_base_write_all_but_figures(folder: Path, command: list[str]) -> None:
    (folder / "my.toml").write_text(
        '[run]\nstop_time = 0.1\nstep_size = 1e-3\n[components.path]\nfmu = "fmus/fmi2/RobotTrajectory.fmu"\n'
    )
    done = process(PROGRAM, folder, *command, "--stop", "0.1", "--out", "out")
    assert done.returncode == 0, done.stderr
    assert {"results.csv", "summary.json"} == {path.name for path in (folder / "out").iterdir()}
    note = "note: there are no figures, because matplotlib is not installed"
    assert f'{note}; install it with: pip install "{NAME}[plot]"\n' in done.stdout, done.stdout
    assert done.stdout.endswith("\nresults and summary: out\n")
    assert done.stderr == ""


#: Extra -> code that needs it, and a package that it lacks then.
FROM_PYTHON = {
    "plot": ("import numpy; cosim.Results(numpy.zeros(1), ['a.x'], numpy.zeros((1, 1))).plot()", "matplotlib"),
    "ssp": ("from cosim.ssp.reader import read_ssp", "xmlschema"),
    "sweep": ("from cosim.sweep import sweep", "dask"),
    "export": ("fmu_export.build_native", "casadi"),
    "control": ("fmu_export.to_control", "control"),
    "robot": ("import controller_fmu.optimal_gains", "scipy"),
    "regression": (
        "from cosim.regression import Tolerances, compare\nimport numpy\n"
        "curves = [cosim.Results(numpy.arange(3.0), ['x'], numpy.array([[0.0], [1.0], [y]])) for y in (0.0, 0.5)]\n"
        "compare(*curves, Tolerances(time_shift=0.1))",
        "pyfunnel",
    ),
    "live": ("import cosim.page.server", "tornado"),
    "shell": (
        "import argparse\nfrom cosim.commands.completion import run\nrun(argparse.Namespace(shell='bash'))",
        "shtab",
    ),
    "sign": ("from pathlib import Path\nfrom cosim.signing.keys import new_key\nnew_key(Path('key'))", "cryptography"),
}


@slow
@pytest.mark.parametrize("extra", FROM_PYTHON)
def test_from_python_a_missing_extra_is_an_error_with_one_line(tmp_path: Path, extra: str) -> None:
    code, package = FROM_PYTHON[extra]
    assert package in EXTRAS[extra]
    root = "fmu_export" if extra in ("export", "control", "robot") else "cosim"
    remedy = f'{package} is not installed; install it with: pip install "{NAME}[{extra}]"'
    caught = f"import cosim, fmu_export, {root}.errors as errors\ntry:\n" + "".join(
        f"    {line}\n" for line in code.split("\n")
    )
    caught += "except errors.MissingExtra as error:\n    print(error.extra, error.name, flush=True)\n    raise"
    done = process(caught, tmp_path)
    assert done.stdout == f"{extra} {package}\n", done.stderr
    assert done.stderr.splitlines()[-1] == f"{root}.errors.MissingExtra: {remedy}"


def test_every_extra_of_the_users_is_tried() -> None:
    assert {*FROM_PYTHON, "all"} == set(FOR_USERS)


@slow
@pytest.mark.parametrize(
    ("command", "extra"),
    [
        (["run", "any.ssp"], "ssp"),
        (["sweep", "tracking", "--vary", "controller.alpha=1,2", "--stop", "0.1"], "sweep"),
        (["sweep", "tracking", "--vary", "controller.alpha=1:2", "--design", "lhs", "--points", "2"], "sweep"),
        (["run", "tracking", "--fmus", "none", "--flavour", "pythonfmu"], "export"),
        (["tune"], "robot"),
        (["reproduce"], "robot"),
        (["robustness"], "sweep"),
        (["ssp"], "ssp"),
        (["compare", "a.csv", "b.csv", "--tolerances", "t.toml"], "regression"),
    ],
)
def test_on_the_command_line_a_missing_extra_is_one_line(folder: Path, command: list[str], extra: str) -> None:
    (folder / "a.csv").write_text('"time","a.x"\n0,1\n1,2\n')
    (folder / "b.csv").write_text('"time","a.x"\n0,1\n1,3\n')
    (folder / "t.toml").write_text("time_shift = 0.1\n")
    (folder / "any.ssp").write_bytes(b"")
    done = process(PROGRAM, folder, *command)
    assert done.returncode == 1
    assert re.fullmatch(
        rf'cosim: \w+ is not installed; install it with: pip install "{NAME}\[{extra}\]"\n', done.stderr
    ), done.stderr


def optional_imports(path: Path, module: str) -> list[tuple[str, str | None]]:
    """Optional packages that a file imports outside of type checking, and the extra that the context there names."""
    found: list[tuple[str, str | None]] = []

    def visit(node: ast.AST, extra: str | None) -> None:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            return
        if isinstance(node, ast.With) and ast.unparse(node.items[0].context_expr).startswith("needs("):
            extra = ast.literal_eval(node.items[0].context_expr.args[0])
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            found.extend((n.partition(".")[0], extra) for n in names if n.partition(".")[0] in OPTIONAL)
        for child in ast.iter_child_nodes(node):
            visit(child, extra)

    visit(ast.parse(path.read_text(encoding="utf-8")), None)
    return found


def test_every_import_of_an_optional_package_names_an_extra_that_has_it() -> None:
    """But for what pytest itself loads, and the robot, whose commands and names ask for the extra as a whole."""
    checked = 0
    for module, path in some(sources().items()):
        for package, extra in optional_imports(path, module):
            if package == "pytest" or module.startswith("parallel_robot"):
                continue
            assert extra is not None, f"{module} imports {package} without saying which extra has it"
            assert package in EXTRAS[extra], f"{module}: the extra {extra} does not have {package}"
            checked += 1
    assert checked > 15


def test_every_import_is_of_the_base_or_an_extra() -> None:
    """No package is used that is only there because another one needs it."""
    known = {*BASE, *OPTIONAL, *PACKAGES, *sys.stdlib_module_names}
    strange = {
        f"{module} imports {name}"
        for module, path in sources().items()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Import | ast.ImportFrom) and not getattr(node, "level", 0)
        for name in ([a.name for a in node.names] if isinstance(node, ast.Import) else [node.module or ""])
        if name.partition(".")[0] not in known
    }
    assert strange == set()


@pytest.mark.parametrize("module", [cosim.errors, fmu_export.errors])
def test_the_error_is_an_import_error_and_survives_a_pickle(module: type(cosim.errors)) -> None:
    with pytest.raises(ImportError) as caught, module.needs("sweep"):
        import no_such_package.inside  # noqa: F401
    error = pickle.loads(pickle.dumps(caught.value))
    assert (type(error), str(error), error.extra, error.name) == (
        module.MissingExtra,
        f'no_such_package is not installed; install it with: pip install "{NAME}[sweep]"',
        "sweep",
        "no_such_package",
    )
    assert isinstance(error, cosim.errors.CosimError | fmu_export.errors.ModelError)
    with pytest.raises(ValueError, match="as it is"), module.needs("sweep"):
        raise ValueError("as it is")
