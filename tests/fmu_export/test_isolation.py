"""FMUs in other people's processes: no checkout, no numpy, decoys on the path, several versions at once.

`fresh` runs a script in a new process that can't import this project, and `HOST` gives that script an importer written
with ctypes alone: an oracle that shares no code with fmpy or with `cosim`. Other test files use both.
"""

import json
import os
import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from controller_fmu.model import MODEL as CONTROLLER
from fmu_export.modelling.functions import rk4_step
from fmu_export.modelling.model import Model
from fmu_export.pythonfmu.backend import build_pythonfmu
from plant_fmu.model import MODEL as PLANT
from trajectory_fmu.model import MODEL as TRAJECTORY

HOST = '''
import ctypes, importlib.util, json, os, sys, tempfile, zipfile
from types import SimpleNamespace
from xml.etree import ElementTree

PROJECT = ("plant_fmu", "controller_fmu", "fmu_export", "cosim", "tests")


class Blocker:
    """Import hook: these packages are not installed here, whatever the environment holds."""

    def __init__(self, names):
        self.names = names

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in self.names:
            raise ModuleNotFoundError(f"No module named {name!r} (blocked)")
        return None


sys.meta_path.insert(0, Blocker(PROJECT))
for name in PROJECT:
    try:
        __import__(name)
    except ModuleNotFoundError:
        continue
    raise SystemExit(f"{name} can be imported")

A = SimpleNamespace(**json.load(sys.stdin))


def report(value):
    with open("report.json", "w") as stream:
        json.dump(value, stream)


class Library:
    """The C functions of an FMU by ctypes alone; `call` returns the status of a function."""

    LOGGER = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
    ALLOCATE = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t)
    FREE = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
    ARGUMENTS = {
        "SetupExperiment": "iddid", "EnterInitializationMode": "", "ExitInitializationMode": "", "Terminate": "",
        "Reset": "", "DoStep": "ddi", "GetReal": "pnp", "SetReal": "pnp", "GetInteger": "pnp", "SetInteger": "pnp",
        "GetBoolean": "pnp", "SetBoolean": "pnp", "GetString": "pnp", "SetString": "pnp", "GetFMUstate": "p",
        "SetFMUstate": "p", "FreeFMUstate": "p", "SerializedFMUstateSize": "pp", "SerializeFMUstate": "ppn",
        "DeSerializeFMUstate": "pnp", "GetRealStatus": "ip", "GetBooleanStatus": "ip",
    }
    TYPES = {"i": ctypes.c_int, "d": ctypes.c_double, "p": ctypes.c_void_p, "n": ctypes.c_size_t}

    def __init__(self, folder, identifier, guid, name, log):
        platform, suffix = ("win64", ".dll") if os.name == "nt" else ("linux64", ".so")
        self.shared_library = ctypes.CDLL(os.path.join(folder, "binaries", platform, identifier + suffix))

        class Callbacks(ctypes.Structure):
            _fields_ = [("logger", self.LOGGER), ("allocate", self.ALLOCATE), ("free", self.FREE),
                        ("finished", ctypes.c_void_p), ("environment", ctypes.c_void_p)]

        # the format comes without its arguments: this logger sees what a printf would be given
        logger = lambda environment, instance, status, category, message: log(status, category, message)
        c = ctypes.CDLL(None if os.name != "nt" else "msvcrt")
        c.calloc.restype = ctypes.c_void_p
        self.callbacks = Callbacks(
            self.LOGGER(logger),
            self.ALLOCATE(lambda n, size: c.calloc(ctypes.c_size_t(n), ctypes.c_size_t(size))),
            self.FREE(lambda p: c.free(ctypes.c_void_p(p))), None, None,
        )
        instantiate = self.shared_library.fmi2Instantiate
        instantiate.restype = ctypes.c_void_p
        uri = "file://" + ("/" if os.name == "nt" else "") + os.path.join(folder, "resources").replace(os.sep, "/")
        self.component = instantiate(
            name.encode(), 1, guid.encode(), uri.encode(), ctypes.byref(self.callbacks), 0, 1
        )
        if not self.component:
            raise RuntimeError("fmi2Instantiate returned NULL")
        self.component = ctypes.c_void_p(self.component)

    def call(self, name, *arguments):
        f = getattr(self.shared_library, "fmi2" + name)
        f.restype = ctypes.c_int
        f.argtypes = [ctypes.c_void_p, *(self.TYPES[t] for t in self.ARGUMENTS[name])]
        return f(self.component, *arguments)

    def free(self):
        self.shared_library.fmi2FreeInstance.restype = None
        self.shared_library.fmi2FreeInstance(self.component)


class Host:
    """An instance of an FMU; everything returns FMI statuses, nothing raises but a failed get."""

    def __init__(self, fmu, folder=None, library=Library, name="instance"):
        self.folder = folder or tempfile.mkdtemp(dir=".")
        self.folder = os.path.abspath(self.folder)
        if fmu is not None:
            with zipfile.ZipFile(fmu) as archive:
                archive.extractall(self.folder)
        root = ElementTree.parse(os.path.join(self.folder, "modelDescription.xml")).getroot()
        self.vr = {v.get("name"): int(v.get("valueReference")) for v in root.iter("ScalarVariable")}
        self.causality = {v.get("name"): v.get("causality") for v in root.iter("ScalarVariable")}
        self.outputs = [n for n, c in self.causality.items() if c == "output"]
        self.messages = []
        identifier = root.find("CoSimulation").get("modelIdentifier")
        self.shared_library = library(self.folder, identifier, root.get("guid"), name, self._log)
        self.call = self.shared_library.call

    def _log(self, status, category, message):
        text = message.decode()
        assert "%" not in text.replace("%%", ""), f"bare percent sign in {text!r}"
        self.messages.append(text)

    def said(self):
        """The messages since the last call, as one text."""
        text, self.messages = "\\n".join(self.messages), []
        return text

    def _references(self, names):
        return (ctypes.c_uint * len(names))(*(n if isinstance(n, int) else self.vr[n] for n in names))

    def get(self, *names):
        names = names or self.outputs
        values = (ctypes.c_double * len(names))()
        status = self.call("GetReal", self._references(names), len(names), values)
        assert status == 0, f"fmi2GetReal: status {status}, {self.said()}"
        return list(values)

    def set(self, values):
        array = (ctypes.c_double * len(values))(*values.values())
        return self.call("SetReal", self._references(list(values)), len(values), array)

    def setup(self, start=0.0):
        return self.call("SetupExperiment", 0, 0.0, start, 0, 0.0)

    def enter(self):
        return self.call("EnterInitializationMode")

    def leave(self):
        return self.call("ExitInitializationMode")

    def initialize(self, values=None, start=0.0):
        """The worst status of all calls up to the end of the initialisation."""
        statuses = [self.setup(start), self.enter()]
        if values:
            statuses.append(self.set(values))
        return max([*statuses, self.leave()])

    def step(self, t, h):
        return self.call("DoStep", t, h, 1)

    def run(self, n, h=1e-3, start=0, inputs=None):
        """Outputs after each of n steps; `inputs(t)` are set before each."""
        rows = []
        for i in range(start, start + n):
            if inputs is not None:
                assert self.set(inputs(i * h)) == 0
            assert self.step(i * h, h) == 0, self.said()
            rows.append(self.get())
        return rows

    def reset(self):
        return self.call("Reset")

    def save(self):
        state = ctypes.c_void_p()
        assert self.call("GetFMUstate", ctypes.byref(state)) == 0
        return state

    def restore(self, state):
        return self.call("SetFMUstate", state)

    def drop(self, state):
        return self.call("FreeFMUstate", ctypes.byref(state))

    def to_bytes(self, state):
        size = ctypes.c_size_t()
        assert self.call("SerializedFMUstateSize", state, ctypes.byref(size)) == 0
        data = (ctypes.c_char * size.value)()
        assert self.call("SerializeFMUstate", state, data, size) == 0
        return bytes(data)

    def from_bytes(self, data):
        state = ctypes.c_void_p()
        status = self.call("DeSerializeFMUstate", ctypes.create_string_buffer(data, len(data)), len(data),
                           ctypes.byref(state))
        return status, state

    def free(self):
        self.shared_library.free()


def torques(t):
    """Some smooth input of the plant."""
    from math import cos, sin
    return {"tau_a[1]": 0.2 * sin(3 * t), "tau_a[2]": -0.1 * cos(2 * t), "tau_d[3]": 0.05, "dm": 0.1 * sin(t)}


def measurements(t):
    """Some smooth input of the controller."""
    from math import cos, sin
    return {"theta_a[1]": 0.3 * sin(3 * t), "omega_a[1]": 0.9 * cos(3 * t), "theta_ref[2]": 0.2, "omega_ref[3]": -t}
'''


def fresh(root: Path, script: str, /, **arguments):
    """Run a script behind `HOST` in a new process, in an empty folder, and return what it reported.

    The process must end by itself with exit code 0: a crash at the exit of the interpreter counts as well.
    """
    work = root / f"process_{len(list(root.glob('process_*')))}"
    work.mkdir(parents=True)
    command = [sys.executable, "-I", "-X", "faulthandler", "-c", HOST + script]
    texts = {k: str(v) if isinstance(v, Path) else v for k, v in arguments.items()}
    process = subprocess.run(command, input=json.dumps(texts), cwd=work, capture_output=True, text=True, timeout=120)
    said = f"exit code {process.returncode}\n{process.stdout[-2000:]}\n{process.stderr[-4000:]}"
    assert process.returncode == 0, said
    assert "Exception ignored" not in process.stderr, said  # raised in a callback or a destructor
    written = work / "report.json"
    return json.loads(written.read_text()) if written.exists() else None


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


def plant_torques(t: float) -> dict[str, float]:
    return {
        "tau_a[1]": 0.2 * np.sin(3 * t),
        "tau_a[2]": -0.1 * np.cos(2 * t),
        "tau_d[3]": 0.05,
        "dm": 0.1 * np.sin(t),
    }


def oracle(model: Model, n: int, inputs=None, h: float = 1e-3, **parameters: float) -> np.ndarray:
    """Outputs after each of n steps by the model's own numpy functions."""
    p = model.parameters.starts.copy()
    for name, value in parameters.items():
        p[model.parameters.names.index(name)] = value
    x, rows = model.initial_state(p), []
    for i in range(n):
        u = model.inputs.starts.copy()
        for name, value in (inputs(i * h) if inputs else {}).items():
            u[model.inputs.names.index(name)] = value
        x = rk4_step(model.derivatives, i * h, x, u, p, h) if len(x) else x
        rows.append(model.output_values(i * h + h, x, u, p))
    return np.array(rows)


def close(rows, expected):
    np.testing.assert_allclose(np.array(rows), expected, rtol=1e-10, atol=1e-12)


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
    rows = fresh(tmp_path, script, fmu=fmu, checkout=Path(__file__).resolve().parents[2])
    solo = fresh(tmp_path, SOLO_CONTROLLER, fmu=fmu)
    assert rows == solo


# Several versions of one FMU


def doubled_output(model: Model) -> Model:
    """The model of the same name with one changed equation: all outputs are doubled."""
    return replace(model, output_values=lambda t, x, u, p: 2.0 * model.output_values(t, x, u, p))


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
    np.testing.assert_array_equal(2 * np.array(solo[0]), solo[1])
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
    np.testing.assert_array_equal(2 * both[0][:, 1:], both[1][:, 1:])
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
    np.testing.assert_array_equal(2 * old_rows, new_rows)
    assert np.any(old_rows)


def test_two_unpacked_copies_that_differ_in_start_values_keep_their_own(fmus, tmp_path):
    """Code may be shared between copies of one version, data must not be; also after a copy is gone."""
    from fmu_export.package.start_values import write_start_values

    other = Path(shutil.copy(fmus / "RobotController.fmu", tmp_path / "other.fmu"))
    write_start_values(other, {"alpha": 0.125})
    script = """
import shutil
first, second, third = Host(A.one), Host(A.other), Host(A.one)
values = [host.get("alpha")[0] for host in (first, second, third)]
first.free()
shutil.rmtree(first.folder)
fourth = Host(A.other)
assert [h.reset() for h in (second, third, fourth)] == [0, 0, 0]
values += [host.get("alpha")[0] for host in (second, third, fourth)]
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
