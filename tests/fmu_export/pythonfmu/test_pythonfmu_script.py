"""FMUs from scripts for pythonfmu: what its own builder leaves broken is mended."""

from __future__ import annotations

import argparse
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from fmpy.model_description import read_model_description

from cosim.commands import validate
from fmu_export import ArgumentError, build_script
from fmu_export.pythonfmu.binary import mended
from tests.support import CHECKOUT

SCRIPT = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Real

class Constant(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.y = VALUE
        self.register_variable(Real("y", causality=Fmi2Causality.output))

    def do_step(self, t, h):
        return True
"""

HOST = """
import sys
from cosim import Simulation, System

system = System()
for i, fmu in enumerate(sys.argv[1:]):
    system.add(f"c{i}", fmu)
with Simulation(system) as simulation:
    for _ in range(20):
        results = simulation.run(0.2, 0.1)
print(*(float(results[name][-1]) for name in results.names))
"""


def written(folder: Path, value: str, extra: str = "") -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "constant.py").write_text(extra + SCRIPT.replace("VALUE", value))
    return folder / "constant.py"


def test_two_scripts_of_one_name_run_often_in_one_process(tmp_path: Path) -> None:
    """An FMU of pythonfmu's own builder loses its globals at a second instance; of equal names the first runs."""
    fmus = [build_script(written(tmp_path / value, value), tmp_path / value) for value in ("3.0", "4.0")]
    done = subprocess.run([sys.executable, "-c", HOST, *fmus], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "3.0 4.0\n"


def test_the_binary_is_the_mended_one(tmp_path: Path) -> None:
    with zipfile.ZipFile(build_script(written(tmp_path, "1.0"), tmp_path / "out")) as archive:
        binaries = [name for name in archive.namelist() if name.startswith("binaries/")]
        assert binaries
        for name in binaries:
            assert mended(archive.read(name)) == archive.read(name)


def test_the_same_files_give_the_same_bytes_and_others_another_guid(tmp_path: Path) -> None:
    def built(value: str) -> Path:
        return build_script(written(tmp_path, value), tmp_path)

    first = built("1.0").read_bytes()
    assert built("1.0").read_bytes() == first
    guid = read_model_description(built("1.0")).guid
    assert read_model_description(built("2.0")).guid != guid


def test_modules_of_the_script_go_along(tmp_path: Path) -> None:
    (tmp_path / "helper_of_constant.py").write_text("VALUE = 5.0\n")
    script = written(tmp_path, "VALUE", "import sys; from helper_of_constant import VALUE\n")
    fmu = build_script(script, tmp_path / "out", files=[tmp_path / "helper_of_constant.py"])
    done = subprocess.run([sys.executable, "-c", HOST, fmu], cwd=tmp_path / "out", capture_output=True, text=True)
    assert done.stdout == "5.0\n", done.stderr


def test_bad_scripts_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="there is no script"):
        build_script(tmp_path / "none.py")
    (tmp_path / "empty.py").write_text("x = 1\n")
    with pytest.raises(ValueError, match="No child class of Fmi2Slave"):
        build_script(tmp_path / "empty.py")
    (tmp_path / "broken.py").write_text("def f():\n    return 1 / 0\n\nf()\n")
    with pytest.raises(
        ArgumentError, match=r"broken.py: ZeroDivisionError: division by zero \(broken.py, line 2, in f\)"
    ):
        build_script(tmp_path / "broken.py")
    (tmp_path / "two.dots.py").write_text("")
    with pytest.raises(ArgumentError, match="without more dots"):
        build_script(tmp_path / "two.dots.py")
    with pytest.raises(ArgumentError, match=r"there is no file .*gains\.py"):
        build_script(written(tmp_path, "1.0"), files=[tmp_path / "gains.py"])
    assert not list(tmp_path.glob("*.fmu"))


def test_a_module_beside_the_script_that_is_not_among_the_files_is_named(tmp_path: Path) -> None:
    """Else the FMU is made and fails wherever it is used."""
    (tmp_path / "gains_beside.py").write_text("K = 1.0\n")
    script = written(tmp_path, "1.0", "import gains_beside\n")
    with pytest.raises(
        ArgumentError, match=r"constant.py: imports 'gains_beside', which lies beside it; list it in files"
    ):
        build_script(script, tmp_path)
    assert build_script(script, tmp_path, files=[tmp_path / "gains_beside.py"]).exists()


def test_scripts_are_described_by_their_own_modules_and_leave_the_process_alone(tmp_path: Path) -> None:
    def process() -> tuple[list[str], list[object], set[str]]:
        return list(sys.path), list(sys.meta_path), set(sys.modules) & {"gain_here", "constant", "pythonfmu"}

    starts, before = [], process()
    for value in ("1.0", "2.0"):
        folder = tmp_path / value
        script = written(folder, "gain_here.K", "import gain_here\n")
        text = script.read_text().replace("causality=Fmi2Causality.output", "causality=Fmi2Causality.parameter")
        script.write_text(text)
        (folder / "gain_here.py").write_text(f"K = {value}\n")
        fmu = build_script(script, folder, files=[folder / "gain_here.py"])
        starts += [float(v.start) for v in read_model_description(fmu).modelVariables]
    assert starts == [1.0, 2.0]
    assert process() == before


VARIABLES = """
from pythonfmu import Boolean, Fmi2Causality as C, Fmi2Initial, Fmi2Slave, Fmi2Variability as V, Integer, Real, String


class Many(Fmi2Slave):
    # variables of each type and causality, with and without what FMI wants to know

    def __init__(self, **arguments):
        super().__init__(**arguments)
        self.modelName = "Many variables"
        types = {"r": (Real, 1.0), "i": (Integer, 2), "b": (Boolean, True), "s": (String, "text")}
        for letter, (kind, value) in types.items():
            for name, options in {
                "parameter": {"causality": C.parameter},
                "tunable": {"causality": C.parameter, "variability": V.tunable},
                "input": {"causality": C.input},
                "output": {"causality": C.output},
                "exact": {"causality": C.output, "initial": Fmi2Initial.exact},
                "constant": {"causality": C.output, "variability": V.constant, "initial": Fmi2Initial.exact},
                "calculated": {"causality": C.calculatedParameter},
                "local": {"causality": C.local},
                "plain": {},
            }.items():
                setattr(self, f"{letter}_{name}", value)
                self.register_variable(kind(f"{letter}_{name}", **options))
        self.register_variable(Real("an odd name, of 1 m", causality=C.output, getter=lambda: 1.0))

    def do_step(self, t, h):
        return True
"""


def test_descriptions_are_valid(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of pythonfmu's own, InitialUnknowns are missing, and defaults of variability are wrong for most types."""
    (tmp_path / "many.py").write_text(VARIABLES)
    many = build_script(tmp_path / "many.py", tmp_path)
    assert many.name == "Many variables.fmu"
    assert validate.run(argparse.Namespace(fmu=[many], run_references=False)) == 0, capsys.readouterr().out
    description = read_model_description(many)
    variables = {v.name: v for v in description.modelVariables}
    assert variables["i_parameter"].variability == "fixed"
    assert variables["r_tunable"].variability == "tunable"
    assert variables["s_output"].variability == "discrete"
    assert variables["r_output"].variability == "continuous"
    unknown = {u.variable.name for u in description.initialUnknowns}
    calculated = {f"{letter}_{name}" for letter in "ribs" for name in ("output", "calculated")}
    assert unknown == {*calculated, "an odd name, of 1 m"}


def test_the_example_in_the_docs_is_valid(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fmu = build_script(CHECKOUT / "examples" / "controller_in_plain_python.py", tmp_path)
    assert validate.run(argparse.Namespace(fmu=[fmu], run_references=False)) == 0, capsys.readouterr().out
