"""The library of packed FMUs: compilers do not warn, and it exports the functions of the standard only."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from cosim import SetupError, System
from cosim.pack import library, pack, source
from cosim.pack.source import LIBRARY, SYSTEM_LIBRARIES, library_sources
from fmu_export.native.backend import build_native
from fmu_export.native.toolchain import TARGETS, Target, compile_library, host_target
from tests.support.native_fmus import require_compiler
from tests.support.packed_fmus import run_in_fmpy, small_loop
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
