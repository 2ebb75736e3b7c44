"""FMUs in other people's processes: no checkout, no numpy, decoys on the path, several versions at once."""

import os
import shutil
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from controller_fmu.model import MODEL as CONTROLLER
from fmu_export.modelling.model import Model
from fmu_export.pythonfmu.backend import build_pythonfmu
from plant_fmu.model import MODEL as PLANT
from tests.support.bare_host import close, fresh, oracle, plant_torques
from trajectory_fmu.model import MODEL as TRAJECTORY


def test_fresh_notices_crashes_and_failures(tmp_path):
    with pytest.raises(AssertionError, match="exit code"):
        fresh(tmp_path, "import ctypes; ctypes.string_at(0)")
    with pytest.raises(AssertionError, match="exit code"):
        fresh(tmp_path, "import atexit, os; atexit.register(os.abort)")
    with pytest.raises(AssertionError, match="bare percent sign"):
        fresh(
            tmp_path,
            "callback = ctypes.CFUNCTYPE(None)(lambda: Host._log(None, 3, None, b'50% off')); callback()",
        )
    with pytest.raises(AssertionError, match="No module named 'plant_fmu'"):
        fresh(tmp_path, "import plant_fmu.model")  # also where this project is installed


# What the FMUs must compute, from the numpy models


RUN_PLANT = """
plant = Host(A.fmu)
assert plant.initialize() == 0
rows = plant.run(20, inputs=torques)
plant.free()
"""


def test_bare_ctypes_host_without_numpy_gets_what_the_numpy_model_gives(fmus, tmp_path):
    """No numpy, no casadi, no fmpy, no pythonfmu in the whole process: the archive needs the standard library only."""
    script = "sys.meta_path.insert(0, Blocker(('numpy', 'casadi', 'fmpy', 'pythonfmu', 'scipy')))"
    check = "\nassert not {'numpy', 'casadi', 'fmpy', 'pythonfmu'} & set(sys.modules)\nreport(rows)"
    close(
        fresh(tmp_path, script + RUN_PLANT + check, fmu=fmus / "RobotPlant.fmu"),
        oracle(PLANT, 20, plant_torques),
    )


def test_trajectory_in_a_bare_host_gets_what_the_numpy_model_gives(fmus, tmp_path):
    script = "f = Host(A.fmu); assert f.initialize() == 0; report(f.run(50, h=0.3))"
    close(fresh(tmp_path, script, fmu=fmus / "RobotTrajectory.fmu"), oracle(TRAJECTORY, 50, h=0.3))


def test_fmus_import_only_the_standard_library_and_their_own_package(fmus, tmp_path):
    script = """
before = set(sys.modules)
names = []
for fmu in A.fmus:
    host = Host(fmu)
    assert host.initialize() == 0
    host.run(1)
    names.append(host.shared_library.shared_library._name)
report(sorted({m.partition('.')[0] for m in set(sys.modules) - before}))
"""
    files = sorted(fmus.glob("*.fmu"))
    new = set(fresh(tmp_path, script, fmus=[str(f) for f in files]))
    allowed = {Path(m).stem for f in files for m in resource_modules(f)} | set(sys.stdlib_module_names)
    assert len(files) == 3
    assert new <= allowed


def resource_modules(fmu: Path) -> set[str]:
    """Top-level modules and packages in the resources of an FMU."""
    with zipfile.ZipFile(fmu) as archive:
        parts = [name.split("/") for name in archive.namelist() if name.startswith("resources/")]
    return {p[1] for p in parts if len(p) > 2 or p[1].endswith(".py")}


def test_module_names_in_the_archives_are_unlike_any_other(fmus):
    modules = [m.removesuffix(".py") for f in sorted(fmus.glob("*.fmu")) for m in sorted(resource_modules(f))]
    assert len(modules) == len(set(modules)) == 6  # a package and an entry each
    assert not {"equations", "interface", "slave", "model", "plant_fmu", "fmu_export"} & set(modules)


def test_the_path_of_the_host_is_unchanged_by_instances(fmus, tmp_path):
    script = """
before = list(sys.path)
identity = id(sys.path)
for fmu in A.fmus:
    for _ in range(3):
        host = Host(fmu)
        assert sys.path == before and id(sys.path) == identity
        assert host.initialize() == 0
        host.run(2)
        assert host.reset() == 0
        host.free()
        assert sys.path == before
"""
    fresh(tmp_path, script, fmus=[str(f) for f in sorted(fmus.glob("*.fmu"))])


def test_hooks_and_builtins_of_the_host_are_unchanged_by_instances(fmus, tmp_path):
    script = """
import builtins, locale, signal, warnings
def snapshot():
    return [list(sys.meta_path), list(sys.path_hooks), sys.excepthook, sys.displayhook, sys.stdout, sys.stderr,
            sorted(vars(builtins)), os.getcwd(), dict(os.environ), locale.setlocale(locale.LC_ALL),
            signal.getsignal(signal.SIGINT), sys.getrecursionlimit(), warnings.filters[:]]
before = snapshot()
host = Host(A.fmu)
assert host.initialize() == 0
host.run(2)
host.free()
assert snapshot() == before
"""
    fresh(tmp_path, script, fmu=fmus / "RobotPlant.fmu")


DECOYS = (
    "plant_fmu",
    "fmu_export",
    "controller_fmu",
    "equations",
    "interface",
    "slave",
    "slavemodule",
    "pythonfmu",
)


def test_decoys_on_the_path_and_in_sys_modules_do_not_stand_in(fmus, tmp_path):
    decoys = tmp_path / "decoys"
    for name in (*DECOYS, "RobotPlant", "model"):
        (decoys / name).mkdir(parents=True)
        (decoys / name / "__init__.py").write_text("raise RuntimeError('a decoy was imported')\n")
    script = """
import types
sys.meta_path[:] = [hook for hook in sys.meta_path if not isinstance(hook, Blocker)]
sys.path.insert(0, A.decoys)
try:
    import model
except RuntimeError:
    pass
else:
    raise SystemExit("the decoys don't work")


class Rubbish(types.ModuleType):
    def __getattr__(self, name):
        return lambda *arguments: [7.0] * 100


for name in A.names:
    sys.modules[name] = Rubbish(name)
import slave
assert slave.anything()[0] == 7.0
"""
    rows = fresh(
        tmp_path,
        script + RUN_PLANT + "report(rows)",
        fmu=fmus / "RobotPlant.fmu",
        decoys=decoys,
        names=[*DECOYS, "RobotPlant"],
    )
    close(rows, oracle(PLANT, 20, plant_torques))


def test_an_imported_checkout_does_not_shadow_the_archive(tmp_path):
    """The checkout's own class and equations are imported first; an FMU of other equations still runs its own."""
    fmu = build_pythonfmu(doubled_output(CONTROLLER), tmp_path)
    script = """
sys.meta_path[:] = [hook for hook in sys.meta_path if not isinstance(hook, Blocker)]
sys.path.insert(0, A.checkout)
import controller_fmu.model, fmu_export.pythonfmu.slave
controller = Host(A.fmu)
assert controller.initialize() == 0
report(controller.run(5, inputs=measurements))
"""
    rows = fresh(tmp_path, script, fmu=fmu, checkout=Path(__file__).resolve().parents[3])
    solo = fresh(tmp_path, SOLO_CONTROLLER, fmu=fmu)
    assert rows == solo


# Several versions of one FMU


#: Of the controller's outputs the last two are states, which stay the states.
TWICE = np.array([2.0, 2.0, 2.0, 1.0, 1.0])


def doubled_output(model: Model) -> Model:
    """The controller with one changed equation: the torques are doubled."""
    return replace(model, output_values=lambda t, x, u, p: TWICE * model.output_values(t, x, u, p))


def slower_adaptation(model: Model) -> Model:
    """The controller with one changed parameter semantics: k counts twice."""

    def derivatives(t, x, u, p):
        k = model.parameters.names.index("k")
        twice = np.concatenate([p[:k], 2.0 * p[k : k + 1], p[k + 1 :]])
        return model.derivatives(t, x, u, twice)

    return replace(model, derivatives=derivatives)


SOLO_CONTROLLER = """
controller = Host(A.fmu)
assert controller.initialize() == 0
report(controller.run(5, inputs=measurements))
"""


def test_versions_of_one_fmu_in_one_process_run_their_own_code(tmp_path):
    versions = [CONTROLLER, doubled_output(CONTROLLER), slower_adaptation(CONTROLLER)]
    files = [str(build_pythonfmu(model, tmp_path / f"v{i}")) for i, model in enumerate(versions)]
    solo = [fresh(tmp_path, SOLO_CONTROLLER, fmu=f) for f in files]
    assert solo[0] != solo[1] != solo[2] != solo[0]
    np.testing.assert_array_equal(TWICE * np.array(solo[0]), solo[1])
    script = """
hosts = [Host(f) for f in A.files]
assert all(h.initialize() == 0 for h in hosts)
rows = [[] for _ in hosts]
for i in range(5):  # interleaved
    for host, own in zip(hosts, rows):
        own += host.run(1, start=i, inputs=measurements)
report(rows)
"""
    for order in ([0, 1, 2], [2, 1, 0, 1]):
        together = fresh(tmp_path, script, files=[files[i] for i in order])
        assert together == [solo[i] for i in order]


def test_versions_through_fmpy_run_their_own_code(tmp_path):
    """The same with the tool most people use."""
    files = [
        str(build_pythonfmu(model, tmp_path / f"v{i}"))
        for i, model in enumerate([CONTROLLER, doubled_output(CONTROLLER)])
    ]
    script = """
import fmpy
values = []
for fmu in A.files:
    result = fmpy.simulate_fmu(fmu, stop_time=0.01, output_interval=0.001, start_values={"psi_start[1]": 0.5})
    values.append([list(map(float, row)) for row in result])
report(values)
"""
    both = np.array(fresh(tmp_path, script, files=files))
    for i, file in enumerate(files):
        np.testing.assert_array_equal(both[i], np.array(fresh(tmp_path, script, files=[file]))[0])
    np.testing.assert_array_equal(TWICE * both[0][:, 1:], both[1][:, 1:])
    assert np.any(both[0][:, 1:])


def test_an_fmu_rebuilt_at_the_same_path_runs_its_new_code_in_the_same_process(tmp_path):
    here = build_pythonfmu(CONTROLLER, tmp_path / "here")
    new = build_pythonfmu(doubled_output(CONTROLLER), tmp_path / "new")
    script = """
import shutil
rows = []
for fmu in (None, A.new):
    if fmu is not None:
        shutil.copy(fmu, A.here)
        shutil.rmtree("unpacked")
    host = Host(A.here, folder="unpacked")
    assert host.initialize() == 0
    rows.append(host.run(3, inputs=measurements))
    host.free()
report(rows)
"""
    old_rows, new_rows = np.array(fresh(tmp_path, script, here=here, new=new))
    np.testing.assert_array_equal(TWICE * old_rows, new_rows)
    assert np.any(old_rows)


def test_two_unpacked_copies_that_differ_in_start_values_keep_their_own(fmus, tmp_path):
    """Code may be shared between copies of one version, data must not be; also after a copy is gone."""
    from fmu_export.package.start_values import write_start_values

    other = Path(shutil.copy(fmus / "RobotController.fmu", tmp_path / "other.fmu"))
    write_start_values(other, {"alpha": 0.125})
    script = """
import shutil
first, second, third = Host(A.one), Host(A.other), Host(A.one)
values = [host.setup() or host.enter() or host.get("alpha")[0] for host in (first, second, third)]
first.free()
shutil.rmtree(first.folder)
fourth = Host(A.other)
assert [h.reset() for h in (second, third, fourth)] == [0, 0, 0]
values += [host.setup() or host.enter() or host.get("alpha")[0] for host in (second, third, fourth)]
report(values)
"""
    one = CONTROLLER.parameters.starts[CONTROLLER.parameters.names.index("alpha")]
    values = fresh(tmp_path, script, one=fmus / "RobotController.fmu", other=other)
    assert values == [one, 0.125, one, 0.125, one, 0.125]


def test_two_different_fmus_of_this_project_live_together(fmus, tmp_path):
    script = """
plant, controller, trajectory = (Host(f) for f in A.fmus)
assert [h.initialize() for h in (plant, controller, trajectory)] == [0, 0, 0]
rows = [[], [], []]
for i in range(20):
    rows[0] += plant.run(1, start=i, inputs=torques)
    rows[1] += controller.run(1, start=i, inputs=measurements)
    rows[2] += trajectory.run(1, start=i)
report(rows)
"""
    names = ("RobotPlant", "RobotController", "RobotTrajectory")
    plant, controller, trajectory = fresh(tmp_path, script, fmus=[str(fmus / f"{n}.fmu") for n in names])
    close(plant, oracle(PLANT, 20, plant_torques))
    close(trajectory, oracle(TRAJECTORY, 20))
    assert controller[:5] == fresh(tmp_path, SOLO_CONTROLLER, fmu=fmus / "RobotController.fmu")


def test_unpacked_fmu_in_a_read_only_folder_with_a_space(fmus, tmp_path):
    folder = tmp_path / "a folder with spaces"
    folder.mkdir()
    with zipfile.ZipFile(fmus / "RobotPlant.fmu") as archive:
        archive.extractall(folder)
    for path in [folder, *folder.rglob("*")]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    try:
        rows = fresh(tmp_path, RUN_PLANT.replace("A.fmu", "None, folder=A.folder") + "report(rows)", folder=folder)
    finally:
        for path in [folder, *folder.rglob("*")]:
            path.chmod(0o755)
    close(rows, oracle(PLANT, 20, plant_torques))


@pytest.mark.skipif(os.name == "nt", reason="POSIX paths may hold any character, Windows paths may not")
def test_percent_signs_in_a_path_reach_no_printf(fmus, tmp_path):
    """The message names the file; its path is a format string's nightmare."""
    folder = tmp_path / "100%s%n%d"
    with zipfile.ZipFile(fmus / "RobotPlant.fmu") as archive:
        archive.extractall(folder)
    (folder / "resources" / "start_values.txt").unlink()
    script = """
plant = Host(None, folder=A.folder)
status = plant.initialize()  # the logger of the host refuses a bare percent sign
report([status, plant.said()])
plant.free()
"""
    status, said = fresh(tmp_path, script, folder=folder)
    assert status >= 3
    assert "start_values.txt" in said
    assert "100%%s%%n%%d" in said
