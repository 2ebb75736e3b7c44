"""FMUs that pythonfmu's own builder made: in this master each runs its own code, and its faults end no process."""

from __future__ import annotations

import json
import os
import zipfile
from pathlib import Path

import pytest
from fmpy.model_description import read_model_description

from cosim import SetupError, System, simulate
from cosim.fmi.fmu_file import load
from fmu_export.pythonfmu.binary import mended
from tests.support import some
from tests.support.scripts import in_cosim, slave, stock


@pytest.fixture
def pair(tmp_path: Path) -> list[Path]:
    """Two FMUs of one script, which differ in a module that is imported late, and in a file."""
    step = """
    import gains, importlib, pathlib
    self.y = gains.K
    self.z = float(pathlib.Path(importlib.import_module("gains").__file__).with_name("k.txt").read_text())
    gains.steps += 1
    self.n = float(gains.steps)
    """
    script = slave(step, outputs=("y", "z", "n"))
    return [
        stock(tmp_path / f"v{k}", script, {"gains.py": f"K = {k}.0\nsteps = 0\n", "k.txt": f"{k}.5"}) for k in (1, 2)
    ]


def test_fmus_that_differ_in_a_module_run_their_own(pair: list[Path], tmp_path: Path) -> None:
    """In one system, in reruns, and with two instances of one FMU, which share nothing but its file."""
    values = json.loads(in_cosim(tmp_path / "elsewhere", *pair, pair[0]))
    expected = {"y": 1.0, "z": 1.5, "n": 2.0}, {"y": 2.0, "z": 2.5, "n": 2.0}, {"y": 1.0, "z": 1.5, "n": 2.0}
    assert values == {f"c{i}.{name}": value for i, row in enumerate(expected) for name, value in row.items()}


def test_an_fmu_that_is_rebuilt_runs_its_new_code(pair: list[Path], tmp_path: Path) -> None:
    script = """
import shutil, sys
from cosim import System, simulate
for source in sys.argv[1:]:
    shutil.copy(source, "model.fmu")
    system = System()
    system.add("m", "model.fmu")
    print(simulate(system, 0.2, 0.1)["m.y"][-1])
"""
    assert in_cosim(tmp_path / "elsewhere", *pair, pair[0], script=script) == "1.0\n2.0\n1.0\n"


def test_an_imported_checkout_does_not_stand_in(pair: list[Path], tmp_path: Path) -> None:
    """The modules of the host keep their names and are not those of the FMU."""
    folder = tmp_path / "checkout"
    folder.mkdir()
    for name in ("gains", "script"):
        (folder / f"{name}.py").write_text("K = 7.0\n")
    script = """
import sys
sys.path.insert(0, ".")
import gains, script
from cosim import System, simulate
system = System()
system.add("m", sys.argv[1])
print(simulate(system, 0.2, 0.1)["m.y"][-1], gains.K, sys.modules["gains"] is gains, sys.path[0])
"""
    assert in_cosim(folder, pair[0], script=script) == "1.0 7.0 True .\n"


def test_a_class_without_methods_lives_long(tmp_path: Path) -> None:
    """Pythonfmu's binary frees the globals of the script once for each instance."""
    script = "from base import Base\n\n\nclass Script(Base):\n    pass\n"
    fmu = stock(tmp_path / "fmu", script, {"base.py": slave("self.y = 2.0", name="Base")})
    run = """
import gc, sys
from cosim import System, simulate
for _ in range(10):
    system = System()
    for name in "abc":
        system.add(name, sys.argv[1])
    results = simulate(system, 0.2, 0.1)
    gc.collect()
print(results["c.y"][-1])
"""
    assert in_cosim(tmp_path / "elsewhere", fmu, script=run) == "2.0\n"


def test_an_exception_ends_the_run_with_its_text_and_not_the_process(tmp_path: Path) -> None:
    fmu = stock(tmp_path / "fmu", slave("if t > 0.45: raise RuntimeError('the motor is on fire')"))
    run = """
import gc, sys
from cosim import SimulationError, System, simulate
for _ in range(5):
    system = System()
    system.add("m", sys.argv[1])
    try:
        simulate(system, 1.0, 0.1)
    except SimulationError as error:
        print(error.time, error)
    gc.collect()
"""
    lines = in_cosim(tmp_path / "elsewhere", fmu, script=run).splitlines()
    assert len(lines) == 5
    for line in lines:
        assert line.startswith("0.5 ")
        assert "RuntimeError: the motor is on fire (script.py, line 15, in do_step)" in line


@pytest.mark.skipif(os.name == "nt", reason="POSIX paths may hold any character, Windows paths may not")
def test_an_fmu_runs_in_a_folder_of_any_name(pair: list[Path], tmp_path: Path) -> None:
    """The binary of pythonfmu decodes no escapes in a URI but that of the space, and crashes for a missing file."""
    folders = [tmp_path / name for name in ("ä ö", "100%", "a#b?c", "a;b&c", "a(b)@+", "%41")]
    for folder in folders:
        folder.mkdir()
    script = """
import os
import sys
from pathlib import Path
from cosim.fmi.fmu_file import load
from cosim.fmi.instance import Instance

for folder in map(Path, sys.argv[2:]):
    if os.fork() == 0:  # in a process of its own, which has the imports already
        fmu = load("m", Path(sys.argv[1]))
        fmu.unpack(folder)
        instance = Instance("m", folder, fmu.description)
        instance.instantiate()
        instance.close()
        print(folder.name)
        sys.exit()
    os.wait()
"""
    names = in_cosim(tmp_path / "elsewhere", pair[0], *folders, script=script).splitlines()
    assert names == [folder.name for folder in folders]


@pytest.mark.skipif(os.name == "nt", reason="POSIX paths may hold any character, Windows paths may not")
def test_a_folder_whose_name_holds_an_escaped_space_is_refused(pair: list[Path], tmp_path: Path) -> None:
    with pytest.raises(SetupError, match=r"takes '%20' for a space; set TMPDIR to another folder"):
        load("m", pair[0]).unpack(tmp_path / "a%20b")


def test_what_is_unpacked_has_an_entry_and_the_mended_binary(pair: list[Path], tmp_path: Path) -> None:
    load("m", pair[0]).unpack(tmp_path / "unpacked")
    resources = tmp_path / "unpacked" / "resources"
    entry = (resources / "slavemodule.txt").read_text()
    assert entry != "script"
    assert "script = 'script'" in (resources / f"{entry}.py").read_text()
    for binary in some((tmp_path / "unpacked" / "binaries").rglob("*.so")):
        assert mended(binary.read_bytes()) == binary.read_bytes()


def changed(fmu: Path, path: Path, replace: dict[str, tuple[bytes, bytes]], without: str = "") -> Path:
    """A copy of an FMU without a member, and with bytes of others replaced."""
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            if name != without:
                before, after = replace.get(Path(name).suffix, (b"", b""))
                new.writestr(name, old.read(name).replace(before, after) if before else old.read(name))
    return path


def test_an_fmu_whose_binary_is_not_pythonfmus_is_left_alone(pair: list[Path], tmp_path: Path) -> None:
    other = changed(pair[0], tmp_path / "other.fmu", {".so": (b"PyImport_ImportModule", b"PyImport_ImportModulf")})
    load("m", other).unpack(tmp_path / "unpacked")
    assert (tmp_path / "unpacked/resources/slavemodule.txt").read_text() == "script"


def test_an_fmu_without_its_script_is_refused(pair: list[Path], tmp_path: Path) -> None:
    """The binary would crash."""
    fmu = changed(pair[0], tmp_path / "empty.fmu", {}, without="resources/script.py")
    system = System()
    system.add("m", fmu)
    with pytest.raises(SetupError, match=r"empty\.fmu: its script resources/script\.py is missing; get a complete FMU"):
        simulate(system, 0.2, 0.1)


#: What pythonfmu up to 0.6.3 links; here in place of another text of the same length.
TIED = {".so": (b"libpythonfmu-export", b"libpython3.6.so.1.0")}


def test_a_binary_that_is_tied_to_another_python_gives_way_to_the_installed_one(
    pair: list[Path], tmp_path: Path
) -> None:
    fmu = changed(pair[0], tmp_path / "old.fmu", TIED)
    system = System()
    system.add("m", fmu)
    assert simulate(system, 0.2, 0.1)["m.y"][-1] == 1.0
    load("m", fmu).unpack(tmp_path / "unpacked")
    (binary,) = (tmp_path / "unpacked/binaries/linux64").iterdir()
    assert b"libpython3" not in binary.read_bytes()


def test_a_binary_that_is_tied_to_another_python_is_refused_where_there_is_no_other(
    pair: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from importlib.metadata import PackageNotFoundError

    def distribution(name: str) -> None:
        raise PackageNotFoundError(name)

    monkeypatch.setattr("fmu_export.pythonfmu.binary.distribution", distribution)
    fmu = changed(pair[0], tmp_path / "old.fmu", TIED)
    with pytest.raises(
        SetupError, match=r"old\.fmu: needs Python 3\.6, and this is Python 3\.\d+; .*pip install pythonfmu"
    ):
        load("m", fmu).unpack(tmp_path / "unpacked")


def test_the_slave_is_that_of_the_model_identifier(tmp_path: Path) -> None:
    """Builders of several releases choose among several classes by other rules; the description has the outcome."""
    script = slave("self.y = 1.0") + slave("self.y = 2.0", name="Other")
    path = tmp_path / "fmu"
    path.mkdir()
    only = stock(path, slave("self.y = 1.0"))
    both = changed(only, tmp_path / "both.fmu", {}, without="resources/script.py")
    with zipfile.ZipFile(both, "a") as archive:
        archive.writestr("resources/script.py", script.replace("class Other(Fmi2Slave)", "class Other(Script)"))
    assert read_model_description(both).coSimulation.modelIdentifier == "Script"
    assert json.loads(in_cosim(tmp_path / "elsewhere", both))["c0.y"] == 1.0


def test_scripts_for_older_releases_get_the_start_time_only(tmp_path: Path) -> None:
    head = "    def setup_experiment(self, start_time):\n        self.start = start_time\n"
    fmu = stock(tmp_path / "fmu", slave("self.y = 1.0 + self.start") + head)
    assert json.loads(in_cosim(tmp_path / "elsewhere", fmu))["c0.y"] == 1.0
