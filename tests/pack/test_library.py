"""The library of packed FMUs: compilers do not warn, and it exports the functions of the standard only."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cosim import SetupError, System
from cosim.pack import library, pack, source
from cosim.pack.source import LIBRARY, SYSTEM_LIBRARIES, library_sources
from fmu_export.native.backend import build_native
from fmu_export.native.toolchain import TARGETS, Target, compile_library, find_compiler, host_target
from tests.support import CHECKOUT
from tests.support.native_fmus import require_compiler
from tests.support.packed_fmus import run_in_fmpy, small_loop
from tests.support.patience import PATIENCE
from tests.support.small_fmus import build
from tests.support.tiny_models import GAIN, INTEGRATOR


@pytest.mark.parametrize("by_zig", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_compilers_do_not_warn(by_zig: bool) -> None:
    target: Target | None = None
    if by_zig:
        pytest.importorskip("ziglang", reason="the ziglang package, a clang, is not installed")
        target = host_target()
    else:
        require_compiler()
    assert compile_library(library_sources(), "packed", target, strict=True, libraries=SYSTEM_LIBRARIES)


@pytest.mark.skipif(sys.platform != "linux", reason="nm of another system lists names in another way")
def test_it_exports_functions_of_the_standard_only() -> None:
    done = subprocess.run(["nm", "-D", "--defined-only", str(LIBRARY)], capture_output=True, text=True, check=True)
    names = {line.split()[-1] for line in done.stdout.splitlines()}
    assert {"fmi2DoStep", "fmi3DoStep"} <= names
    assert [n for n in names if not n.startswith(("fmi2", "fmi3"))] == []


def test_a_library_of_other_sources_is_not_packed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = tmp_path / LIBRARY.name
    for content, said in ((b"", "is missing"), (b"another", "belongs to another version of its sources")):
        if content:
            other.write_bytes(content)
        monkeypatch.setattr(library, "LIBRARY", other)
        with pytest.raises(SetupError, match=f"{said}; install the package again"):
            library.library_for(host_target(), compiled_here=True)
    assert source.library_hash().encode() in LIBRARY.read_bytes()


@pytest.mark.slow
def test_other_platforms(tmp_path: Path) -> None:
    pytest.importorskip("ziglang", reason="the ziglang package is not installed")
    for model in (GAIN, INTEGRATOR):
        build_native(model, tmp_path, "fmi3", list(TARGETS.values()))
    packed = pack(small_loop(tmp_path), tmp_path / "W.fmu", 0.1, fmi=3, platforms=["all"])
    assert set(packed.platforms) == set(TARGETS)
    assert run_in_fmpy(packed.path, 1.0, 0.1, packed.outputs).shape == (11, 3)
    packed = pack(small_loop(tmp_path), tmp_path / "V.fmu", 0.1, fmi=2, platforms=["all"])
    assert set(packed.platforms) == {"x86_64-linux", "x86_64-windows", "x86_64-darwin"}


@pytest.mark.slow
def test_python_fmus_are_said(tmp_path: Path) -> None:
    build(tmp_path, "pythonfmu", GAIN)
    system = System()
    system.add("g", tmp_path / "Gain.fmu")
    packed = pack(system, tmp_path / "W.fmu", 0.1)
    assert any("runs Python in the importer's process" in note for note in packed.notes)
    assert run_in_fmpy(packed.path, 0.2, 0.1, ["g.y[1]"], {"g.u[1]": 2.0})[-1] == [4.0]


#: Packed systems of both versions and all orders, with signals, longer steps, states, resets, and a damaged plan.
RUNS = """
import sys
from pathlib import Path
import cosim.pack.library
cosim.pack.library.LIBRARY = Path(sys.argv[1])
import fmpy
from cosim.pack import pack
from cosim.scenario.signals import Ramp, ShapedSignal
from tests.support.packed_fmus import initialized, instance_of, run_in_fmpy, small_loop
fmus, folder = Path(sys.argv[2]), Path(sys.argv[3])
for version in (2, 3):
    for order in ("sequential", "parallel"):
        for every in (1, 3):
            system = small_loop(fmus, every)
            ramp = ShapedSignal(Ramp(0.2, 0.7, 1.0), 1, "g.u[2]")
            system.drive("g.u[2]", ramp, vectorized=True)
            packed = pack(system, folder / "W.fmu", 0.05, fmi=version, order=order)
            run_in_fmpy(packed.path, 1.0, 0.1, packed.outputs, {"g.K": 0.5})
packed = pack(small_loop(fmus), folder / "V.fmu", 0.1)
with instance_of(packed.path) as (instance, references):
    for i in range(3):
        initialized(instance)
        state = instance.getFMUState()
        data, time = instance.serializeFMUState(state), 0.0
        for k in range(70):
            step = 0.1 if k % 2 else 0.07
            instance.setReal([references["g.u[2]"]], [0.1 * k])
            instance.doStep(time, step)
            time += step
            instance.getReal([references["g.y[2]"]])
        instance.setFMUState(state)
        instance.freeFMUState(state)
        instance.freeFMUState(instance.deserializeFMUState(data))
        instance.reset()
print("done")
"""


@pytest.mark.slow
def test_sanitisers_find_nothing(tmp_path: Path) -> None:
    compiler = find_compiler()
    found = subprocess.run([*compiler, "-print-file-name=libasan.so"], capture_output=True, text=True, check=False)
    runtime = Path(found.stdout.strip())
    if sys.platform != "linux" or not runtime.is_absolute() or not runtime.exists():
        pytest.skip(f"{compiler[0]} has no address sanitiser that another program could load")
    for name, content in library_sources().items():
        (tmp_path / name).write_bytes(content)
    files = [name for name in library_sources() if name.endswith(".c")]
    options = ["-std=c99", "-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fPIC", "-I."]
    command = [*compiler, *options, "-fvisibility=hidden", "-shared", *files, "-o", "watched.so", "-lm", "-ldl"]
    subprocess.run(command, cwd=tmp_path, check=True)
    fmus = build(tmp_path / "fmus", "fmi2", GAIN, INTEGRATOR)
    unlimited = ["sh", "-c", 'ulimit -S -v "$(ulimit -H -v)"; exec "$@"', "sh", "env", f"LD_PRELOAD={runtime}"]
    done = subprocess.run(
        [*unlimited, sys.executable, "-c", RUNS, str(tmp_path / "watched.so"), str(fmus), str(tmp_path)],
        cwd=CHECKOUT,
        env=os.environ | {"ASAN_OPTIONS": "detect_leaks=0", "PYTHONMALLOC": "malloc"},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    assert done.stdout.strip().endswith("done")
