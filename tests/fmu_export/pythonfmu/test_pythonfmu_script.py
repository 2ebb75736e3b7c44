"""FMUs from scripts for pythonfmu: what its own builder leaves broken is mended."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from fmu_export import build_script
from fmu_export.pythonfmu.binary import mended

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


def test_the_same_script_gives_the_same_code_and_another_one_another_name(tmp_path: Path) -> None:
    def entry(value: str) -> str:
        with zipfile.ZipFile(build_script(written(tmp_path, value), tmp_path)) as archive:
            return archive.read("resources/slavemodule.txt").decode()

    assert entry("1.0") == entry("1.0") != entry("2.0")


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
    assert not list(tmp_path.glob("*.fmu"))
