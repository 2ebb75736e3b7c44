"""Modules and files of a script's FMU belong to each instance alone, whatever Python keeps by name and by path."""

from __future__ import annotations

import importlib.util
import json
import pickle
import shutil
import sys
import types
from pathlib import Path

import pytest

from fmu_export import build_script
from tests.support.bare_host import fresh
from tests.support.scripts import in_cosim, scripted, slave, written

#: One instance in a host of ctypes alone, and what it gives after a step.
ONE = """
host = Host(A.fmu)
assert host.initialize() == 0, host.said()
assert host.step(0.0, 0.1) == 0, host.said()
report(host.get())
"""


@pytest.fixture
def pair(tmp_path: Path) -> list[Path]:
    """Two FMUs of one script, which differ in a module."""
    script = slave("self.y = gains.K; self.z = helper.twice()", "import gains\nimport helper", outputs=("y", "z"))
    helper = "import logging\nlogging.getLogger(__name__)\ndef twice():\n    from gains import K\n    return 2 * K\n"
    return [scripted(tmp_path / f"v{k}", script, {"gains.py": f"K = {k}.0\n", "helper.py": helper}) for k in (1, 2)]


def test_fmus_that_differ_in_a_module_run_their_own_in_a_bare_host(pair: list[Path], tmp_path: Path) -> None:
    script = """
hosts = [Host(fmu) for fmu in A.fmus]
for host in hosts:
    assert host.initialize() == 0
for host in reversed(hosts):
    assert host.step(0.0, 0.1) == 0
report([host.get() for host in hosts])
"""
    order = [pair[i] for i in (0, 1, 0, 1)]
    assert fresh(tmp_path, script, fmus=[str(f) for f in order]) == [[1.0, 2.0], [2.0, 4.0]] * 2


def test_fmus_that_differ_in_a_module_run_their_own_in_fmpy(pair: list[Path], tmp_path: Path) -> None:
    script = """
import fmpy
rows = []
for fmu in (*A.fmus, *A.fmus):
    result = fmpy.simulate_fmu(fmu, stop_time=0.2, output_interval=0.1)
    rows.append([float(result[name][-1]) for name in ("y", "z")])
report(rows)
"""
    assert fresh(tmp_path, script, fmus=[str(f) for f in pair]) == [[1.0, 2.0], [2.0, 4.0]] * 2


def test_fmus_that_differ_in_a_module_run_their_own_in_cosim(pair: list[Path], tmp_path: Path) -> None:
    values = json.loads(in_cosim(tmp_path / "elsewhere", *pair))
    assert values == {"c0.y": 1.0, "c0.z": 2.0, "c1.y": 2.0, "c1.z": 4.0}


IMPORTS = {
    "statement": "import package.sub\n    return package.sub.V",
    "statement with a name": "import package.sub as s\n    return s.V",
    "from a package": "from package import sub\n    return sub.V",
    "from a module": "from package.sub import V\n    return V",
    "relative": "import package\n    return package.relative()",
    "all names": "return package_all.V",
    "import_module": "import importlib\n    return importlib.import_module('package.sub').V",
    "import_module of its own": "from importlib import import_module\n    return import_module('package.sub').V",
    "relative import_module": "import package\n    return package.by_name()",
    "__import__": "return __import__('package.sub').sub.V",
    "by an expression": "return eval(\"__import__('package.sub').sub.V\")",
    "in a thread": "import threading, package\n    t = threading.Thread(target=package.late); t.start(); t.join()\n"
    "    return package.found",
    "sys.modules": "import sys, package.sub\n    return sys.modules[package.sub.__name__].V",
    "reload": "import importlib, package.sub\n    return importlib.reload(package.sub).V",
    "a folder without __init__": "from folder.module import V\n    return V",
    "find_spec": "import importlib.util, package\n    assert importlib.util.find_spec('no_such_module') is None\n"
    "    return 7.0 if importlib.util.find_spec('package.sub') else 0.0",
    "library code": "import runpy\n    return runpy.run_module('package.sub')['V']",
    "pkgutil": "import pkgutil, json\n    return float(pkgutil.get_data('package', 'v.txt'))",
    "resources by name": "from importlib.resources import files\n"
    "    return float((files('package') / 'v.txt').read_text())",
    "resources of a module": "import package\n    from importlib.resources import files\n"
    "    return float((files(package) / 'v.txt').read_text())",
    "__file__": "import package\n    from pathlib import Path\n"
    "    return float(Path(package.__file__).with_name('v.txt').read_text())",
}


def test_modules_are_found_whenever_and_however_they_are_imported(tmp_path: Path) -> None:
    """Also where the host has modules of these names, and its own folder has them, too."""
    names = tuple(f"y{i}" for i in range(len(IMPORTS)))
    files = {
        "ways.py": "from package_all import *\nimport package_all\n"
        + "".join(f"def y{i}():\n    {body}\n" for i, body in enumerate(IMPORTS.values())),
        "package/__init__.py": "def relative():\n    from . import sub\n    return sub.V\n"
        "def by_name():\n    import importlib\n    return importlib.import_module('.sub', __package__).V\n"
        "found = 0.0\n"
        "def late():\n    global found\n    from package.sub import V\n    found = V\n",
        "package/sub.py": "V = 7.0\n",
        "package/v.txt": "7.0",
        "package_all.py": "V = 7.0\n",
        "folder/module.py": "V = 7.0\n",
    }
    init = "import ways"
    step = "\n".join(["import ways", *(f"self.{name} = ways.{name}()" for name in names)])
    fmu = scripted(tmp_path / "fmu", slave(step, init=init, outputs=names), files)
    values = fresh(tmp_path, ONE, fmu=fmu)
    assert dict(zip(IMPORTS, values, strict=True)) == dict.fromkeys(IMPORTS, 7.0)

    decoys = tmp_path / "decoys"
    for name in ("package", "ways", "package_all", "folder", "script"):
        written(decoys, "", {f"{name}/__init__.py": "", f"{name}/sub.py": "V = 0.0\n", f"{name}/v.txt": "0.0"})
    script = "sys.path.insert(0, A.decoys); import script\n" + ONE
    values = fresh(tmp_path, script, fmu=fmu, decoys=decoys)
    assert dict(zip(IMPORTS, values, strict=True)) == dict.fromkeys(IMPORTS, 7.0)


def test_modules_of_the_host_stay_its_own(tmp_path: Path) -> None:
    """The host's module of the same name is neither used by the FMU nor replaced, imported before, between or after."""
    step = """
    import gains, importlib, pickle
    self.y = gains.K
    assert importlib.import_module("gains") is gains
    assert pickle.loads(pickle.dumps(gains.Gain())).k == 1.0
    """
    gains = "K = 1.0\nclass Gain:\n    k = K\n"
    fmu = scripted(tmp_path / "fmu", slave(step), {"gains.py": gains, "other.py": "K = 1.0\n"})
    (tmp_path / "mine").mkdir()
    for name in ("gains", "other"):
        (tmp_path / "mine" / f"{name}.py").write_text("K = 5.0\n")
    script = """
sys.path.insert(0, A.mine)
import gains
host = Host(A.fmu)
assert host.initialize() == 0
for i in range(3):
    assert host.step(i * 0.1, 0.1) == 0, host.said()
    import other
    assert (sys.modules["gains"], gains.K, other.K) == (gains, 5.0, 5.0)
host.free()
import gains as again
assert again is gains
report(host is not None)
"""
    assert fresh(tmp_path, script, fmu=fmu, mine=tmp_path / "mine")


def test_modules_on_paths_that_scripts_add_stay_apart(tmp_path: Path) -> None:
    """A folder of the archive on `sys.path`: the modules in it are the instance's, and the path goes with it."""
    head = """
    import sys
    from pathlib import Path
    sys.path.insert(0, str(Path(__file__).resolve().parent / "lib"))
    import in_lib
    assert sys.path[0].endswith("lib")  # it may take it off itself
    """
    step = "import late_in_lib; self.y = in_lib.K + late_in_lib.twice()"
    fmus = []
    for k in (1, 2):
        late = "import in_lib\ndef twice(): return 2 * in_lib.K\n"
        files = {"lib/in_lib.py": f"K = {k}.0\n", "lib/late_in_lib.py": late}
        fmus.append(scripted(tmp_path / f"v{k}", slave(step, head), files))
    script = """
before = list(sys.path)
hosts = [Host(fmu) for fmu in A.fmus]
assert sys.path == before
values = []
for host in hosts:
    assert host.initialize() == 0 and host.step(0.0, 0.1) == 0, host.said()
    values += host.get()
for host in hosts:
    host.free()
assert sys.path == before
assert not {"in_lib", "late_in_lib"} & set(sys.modules)
report(values)
"""
    assert fresh(tmp_path, script, fmus=[str(f) for f in fmus]) == [3.0, 6.0]


CLASSES = """
from __future__ import annotations
import dataclasses, enum, pickle, typing

@dataclasses.dataclass
class Point:
    x: float
    count: typing.ClassVar[int] = 3
    steps: list[Step] = dataclasses.field(default_factory=list)

class Step(enum.Enum):
    UP = 1.0

class Tuple(typing.NamedTuple):
    point: Point

def check():
    there = Tuple(Point(2.0, [Step.UP]))
    back = pickle.loads(pickle.dumps(there))
    assert back == there and type(back) is Tuple and back.point.steps[0] is Step.UP
    assert typing.get_type_hints(Point)["steps"] == list[Step]
    assert [f.name for f in dataclasses.fields(Point)] == ["x", "steps"]
    return back.point.x
"""


def test_classes_of_bundled_modules_work_with_what_looks_them_up_by_module(tmp_path: Path) -> None:
    """Data classes, enumerations, type hints, pickles, also one from outside, read by C code and by Python code."""
    step = """
    import classes, pickle, pathlib
    data = pathlib.Path(self.resources, "data.pickle").read_bytes()
    point = pickle.loads(data)
    assert type(point) is classes.Point
    import io
    other = pickle._Unpickler(io.BytesIO(data)).load()
    assert type(other) is classes.Point
    self.y = classes.check() + point.x + other.x
    """
    folder = tmp_path / "fmu"
    script, files = written(folder, slave(step), {"classes.py": CLASSES})
    outside = types.ModuleType("classes")
    sys.modules["classes"] = outside
    try:
        exec(CLASSES, outside.__dict__)
        (folder / "data.pickle").write_bytes(pickle.dumps(outside.Point(3.0)))
    finally:
        del sys.modules["classes"]
    fmu = build_script(script, folder / "built", files=[*files, folder / "data.pickle"])
    check = "\nassert not [m for m in sys.modules if m == 'classes' or m == 'script'], 'left behind'"
    assert fresh(tmp_path, ONE + check, fmu=fmu) == [8.0]


def test_instances_and_resets_begin_with_modules_of_their_own(tmp_path: Path) -> None:
    """What a module keeps, as a counter or a list, is that of one instance, and gone with a reset."""
    files = {"counter.py": "import itertools\nnumbers = itertools.count(1)\n"}
    fmu = scripted(tmp_path / "fmu", slave("self.y = float(next(counter.numbers))", "import counter"), files)
    script = """
a, b = Host(A.fmu), Host(A.fmu)
values = []
for host in (a, b):
    assert host.initialize() == 0
for host, time in ((a, 0.0), (a, 0.1), (b, 0.0), (a, 0.2)):
    assert host.step(time, 0.1) == 0
    values += host.get()
assert a.reset() == 0 and a.initialize() == 0 and a.step(0.0, 0.1) == 0
report(values + a.get())
"""
    assert fresh(tmp_path, script, fmu=fmu) == [1.0, 2.0, 1.0, 3.0, 1.0]


def test_an_fmu_rebuilt_at_the_same_place_runs_its_new_code(tmp_path: Path) -> None:
    """Sources of the same size and time, beside the __pycache__ of the first and what Python keeps about the folder."""
    fmus = []
    for k in (1, 2):
        script = slave("import late; self.y = late.K", f"HEAD = {k}.0")
        fmus.append(scripted(tmp_path / f"v{k}", script, {"late.py": f"K = {k}.0\n"}))
    script = """
import compileall, shutil, zipfile
from pathlib import Path
values = []
for fmu in A.fmus:
    kept = Path("unpacked/resources/__pycache__")
    if kept.exists():
        kept.rename("kept")
        shutil.rmtree("unpacked")
    zipfile.ZipFile(fmu).extractall("unpacked")
    if Path("kept").exists():
        Path("kept").rename(kept)
    for path in Path("unpacked").rglob("*.py"):
        os.utime(path, (1e9, 1e9))
    host = Host(None, folder="unpacked")
    assert host.initialize() == 0 and host.step(0.0, 0.1) == 0
    values += host.get()
    host.free()
    compileall.compile_dir("unpacked", quiet=1)
report(values)
"""
    assert fresh(tmp_path, script, fmus=[str(f) for f in fmus]) == [1.0, 2.0]


def test_files_are_those_of_the_instance_when_others_are_gone(tmp_path: Path) -> None:
    read = "float(Path(__file__).with_name('k.txt').read_text())"
    step = f"import files; from pathlib import Path; self.y = files.read(); self.z = {read}"
    files = {"files.py": f"from pathlib import Path\ndef read():\n    return {read}\n", "k.txt": "3.5"}
    fmu = scripted(tmp_path / "fmu", slave(step, outputs=("y", "z")), files)
    script = """
import shutil
values = []
for _ in range(3):
    host = Host(A.fmu)
    assert host.initialize() == 0 and host.step(0.0, 0.1) == 0, host.said()
    values += host.get()
    host.free()
    shutil.rmtree(host.folder)
report(values)
"""
    assert fresh(tmp_path, script, fmu=fmu) == [3.5] * 6


def test_a_part_of_pythonfmu_is_imported_after_the_first_folder_is_gone(tmp_path: Path) -> None:
    fmu = scripted(tmp_path / "fmu", slave("from pythonfmu import deploy; self.y = 1.0"))
    script = (
        """
import shutil
first = Host(A.fmu)
assert first.initialize() == 0
first.free()
shutil.rmtree(first.folder)
"""
        + ONE
    )
    assert fresh(tmp_path, script, fmu=fmu) == [1.0]


def test_a_class_without_methods_lives_long(tmp_path: Path) -> None:
    """Nothing but the class holds the globals of such a script, which the binary frees once too often."""
    base = slave("self.y = 2.0", name="Base")
    script = "from base import Base\n\n\nclass Script(Base):\n    pass\n"
    fmu = scripted(tmp_path / "fmu", script, {"base.py": base})
    run = """
import gc
for i in range(20):
    host = Host(A.fmu)
    assert host.initialize() == 0 and host.step(0.0, 0.1) == 0
    values = host.get()
    if i % 2:
        host.free()
    gc.collect()
report(values)
"""
    assert fresh(tmp_path, run, fmu=fmu) == [2.0]


def test_the_process_is_left_as_it_was(pair: list[Path], tmp_path: Path) -> None:
    """But for modules whose names say what is in them, and which the next instance uses again."""
    script = """
import builtins, gc, linecache, locale, signal, warnings, logging
def snapshot():
    return [list(sys.path), list(sys.meta_path), list(sys.path_hooks), builtins.__import__, sorted(vars(builtins)),
            sys.excepthook, os.getcwd(), dict(os.environ), locale.setlocale(locale.LC_ALL),
            signal.getsignal(signal.SIGINT), warnings.filters[:], set(linecache.cache)]
def names():
    return set(sys.modules), set(logging.Logger.manager.loggerDict)
def run(fmu):
    host = Host(fmu)
    assert host.initialize() == 0 and host.step(0.0, 0.1) == 0
    assert host.reset() == 0 and host.initialize() == 0
    host.free()
    return host.folder
before = snapshot()
for fmu in A.fmus:
    run(fmu)
assert snapshot() == before
kept = names()
folder = run(A.fmus[0])
assert snapshot() == before
assert names() == kept
assert not [p for p in sys.path_importer_cache if p.startswith(folder)]
assert not {"gains", "helper", "script", "pythonfmu"} & set(sys.modules)
"""
    fresh(tmp_path, script, fmus=[str(f) for f in pair])


def test_state_is_saved_and_restored_in_another_instance(tmp_path: Path) -> None:
    fmu = scripted(tmp_path / "fmu", slave("self.y += 1.0"))
    script = """
a = Host(A.fmu)
assert a.initialize() == 0 and a.step(0.0, 0.1) == 0
data = a.to_bytes(a.save())
kept = a.save()
assert a.step(0.1, 0.1) == 0
b = Host(A.fmu)
assert b.initialize() == 0
status, state = b.from_bytes(data)
assert status == 0 and b.restore(state) == 0 and b.to_bytes(state) == data
values = a.get() + b.get()
assert a.restore(kept) == 0
report(values + a.get())
"""
    assert fresh(tmp_path, script, fmu=fmu) == [2.0, 1.0, 1.0]


def test_threads_with_other_fmus_see_their_own_modules(pair: list[Path], tmp_path: Path) -> None:
    script = """
import threading
wrong, made = [], []
def work(fmu, expected):
    for _ in range(10):
        host = Host(fmu)
        if host.initialize() != 0 or host.step(0.0, 0.1) != 0 or host.get() != expected:
            wrong.append(host.said())
        made.append(host)
        host.free()
threads = [threading.Thread(target=work, args=(A.fmus[i % 2], [[1.0, 2.0], [2.0, 4.0]][i % 2])) for i in range(4)]
for thread in threads: thread.start()
for thread in threads: thread.join()
report([wrong, len(made)])
"""
    assert fresh(tmp_path, script, fmus=[str(f) for f in pair]) == [[], 40]


def test_an_unpacked_fmu_runs_from_a_folder_that_cannot_be_written(pair: list[Path], tmp_path: Path) -> None:
    folder = tmp_path / "read only"
    shutil.unpack_archive(pair[0], folder, "zip")
    for path in [folder, *folder.rglob("*")]:
        path.chmod(0o555)
    try:
        assert fresh(tmp_path, ONE.replace("A.fmu", "None, folder=A.folder"), folder=folder) == [1.0, 2.0]
    finally:
        for path in [folder, *folder.rglob("*")]:
            path.chmod(0o755)


# Compiled modules: Python loads one of a name in a process


def with_compiled(folder: Path, appended: bytes) -> Path:
    """The FMU of a script that brings a compiled module, here a copy of one of Python's own."""
    step = "import _statistics, os\nself.y = float(os.path.dirname(_statistics.__file__) == self.resources)"
    script, _ = written(folder, slave(step))
    module = Path(importlib.util.find_spec("_statistics").origin)
    (folder / module.name).write_bytes(module.read_bytes() + appended)
    return build_script(script, folder / "built", files=[folder / module.name])


@pytest.mark.skipif("_statistics" in sys.builtin_module_names, reason="this Python has no compiled module to copy")
def test_a_compiled_module_comes_from_the_archive(tmp_path: Path) -> None:
    fmu = with_compiled(tmp_path / "fmu", b"")
    assert fresh(tmp_path, ONE + "\nassert Host(A.fmu).initialize() == 0", fmu=fmu) == [1.0]


@pytest.mark.skipif("_statistics" in sys.builtin_module_names, reason="this Python has no compiled module to copy")
def test_a_compiled_module_that_differs_from_another_fmus_is_refused(tmp_path: Path) -> None:
    fmus = [with_compiled(tmp_path / name, name.encode()) for name in ("one", "other")]
    script = """
said = []
class Quiet(Host):
    def _log(self, status, category, message):
        said.append(message.decode())
first = Quiet(A.fmus[0])
try:
    Quiet(A.fmus[1])
except RuntimeError:
    pass
report(said)
"""
    (said,) = fresh(tmp_path, script, fmus=[str(f) for f in fmus])
    assert "the compiled module '_statistics' differs from that of another FMU in this process" in said
    assert "run the FMUs in processes of their own" in said
