"""The build hook: compiles the stepping loop, and asks for a compiler where there is none."""

from __future__ import annotations

import ctypes
import importlib.util
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

import fmu_export.native.toolchain
from cosim.loop.source import LIBRARY, loop_sources, source_hash
from cosim.pack.source import LIBRARY as PACKED_LIBRARY
from fmu_export.native.toolchain import ToolchainError
from tests.support.native_fmus import require_compiler

ROOT = Path(__file__).parents[2]


@pytest.fixture
def hook(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The module hatch_build, with a search path of its own: it puts the checkout in front."""
    monkeypatch.setattr(sys, "path", sys.path.copy())
    specification = importlib.util.spec_from_file_location("hatch_build_under_test", ROOT / "hatch_build.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.fixture
def elsewhere(hook: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the library goes instead of beside its source: other tests have that loaded."""
    path = tmp_path / "cosim" / "loop" / LIBRARY.name
    packed = tmp_path / "cosim" / "pack" / PACKED_LIBRARY.name
    for library in (path, packed):
        library.parent.mkdir(parents=True)
    monkeypatch.setattr(hook, "LIBRARY", path)
    monkeypatch.setattr(hook, "PACKED_LIBRARY", packed)
    return path


def build_hook(hook: ModuleType, root: Path = ROOT, target: str = "wheel") -> object:
    """The hook as hatchling would make it, but without hatchling, which need not be installed."""

    class Alone(hook.LoopBuildHook):
        target_name = target
        root = None

        def __init__(self) -> None:
            pass

    Alone.root = str(root)
    return Alone()


def load(path: Path, *, loop: bool = True) -> ctypes.CDLL:
    library = ctypes.CDLL(str(path))
    if not loop:
        return library
    library.loop_hash.restype = ctypes.c_char_p
    return library


# Compiling


def test_the_library_can_be_loaded_and_carries_the_hash_of_its_source(hook: ModuleType, elsewhere: Path) -> None:
    require_compiler()
    assert hook.compile_loop() == elsewhere
    library = load(elsewhere)
    assert library.loop_hash().decode() == source_hash()
    for function in ("loop_perform", "loop_run", "loop_layout", "intermediate_update"):
        assert getattr(library, function)
    assert [p.name for p in elsewhere.parent.iterdir()] == [LIBRARY.name]


def test_a_library_in_use_is_replaced_not_written_into(hook: ModuleType, elsewhere: Path) -> None:
    require_compiler()
    hook.compile_loop()
    before = elsewhere.stat().st_ino
    used = load(elsewhere)
    hook.compile_loop()
    assert elsewhere.stat().st_ino != before
    assert used.loop_hash().decode() == source_hash()


def test_a_source_that_cannot_be_compiled_leaves_the_old_library(
    hook: ModuleType, elsewhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    require_compiler()
    elsewhere.write_bytes(b"the old one")
    broken = {**loop_sources(), "loop.c": loop_sources()["loop.c"] + b"\nint wrong(void) { return nothing; }\n"}
    monkeypatch.setattr(hook, "loop_sources", lambda: broken)
    with pytest.raises(ToolchainError, match="nothing"):
        hook.compile_loop()
    assert elsewhere.read_bytes() == b"the old one"


def test_the_hash_is_that_of_the_text_whatever_ends_its_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Git may check the source out with the line ends of Windows."""
    import cosim.loop.source

    for name, content in loop_sources().items():
        if name != "loop_hash.h":
            (tmp_path / name).write_bytes(content.replace(b"\n", b"\r\n"))
    expected = source_hash()
    monkeypatch.setattr(cosim.loop.source, "_FOLDER", tmp_path)
    assert source_hash() == expected
    windows = tmp_path / "current_calls.h"
    windows.write_bytes(windows.read_bytes() + b"/* changed */")
    assert source_hash() != expected


@pytest.mark.slow
def test_the_script_compiles_in_a_checkout(tmp_path: Path) -> None:
    """`python hatch_build.py`, in a copy; it needs neither hatchling nor what the package depends on."""
    require_compiler()
    checkout = copied(tmp_path / "checkout")
    library = checkout / "cosim" / "loop" / LIBRARY.name
    assert not library.exists()
    command = [sys.executable, "-S", str(checkout / "hatch_build.py")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    packed = checkout / "cosim" / "pack" / PACKED_LIBRARY.name
    assert [Path(line) for line in done.stdout.split()] == [library, packed]
    assert load(packed, loop=False).fmi2GetVersion
    assert load(library).loop_hash().decode() == source_hash()


def copied(checkout: Path) -> Path:
    """A copy of what a build needs, without what was built."""
    for package in ("plant_fmu", "controller_fmu", "fmu_export", "cosim"):
        ignored = shutil.ignore_patterns("__pycache__", "_loop.*", "_packed.*")
        shutil.copytree(ROOT / package, checkout / package, ignore=ignored)
    for name in ("pyproject.toml", "README.md", "LICENSE", "hatch_build.py"):
        shutil.copy(ROOT / name, checkout / name)
    return checkout


# Asking for a compiler


def without_compilers(hook: ModuleType, monkeypatch: pytest.MonkeyPatch, *, ziglang: bool) -> None:
    def find_spec(name: str) -> object:
        assert name == "ziglang"
        return SimpleNamespace() if ziglang else None

    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    for module in (hook, fmu_export.native.toolchain):
        monkeypatch.setattr(module, "find_spec", find_spec)


def test_zig_is_asked_for_where_there_is_no_compiler(hook: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    without_compilers(hook, monkeypatch, ziglang=False)
    assert build_hook(hook).dependencies() == ["ziglang>=0.13"]


def test_zig_is_still_asked_for_once_pip_has_brought_it(hook: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """The build asks anew in the environment that pip has made: the answer must stay the same."""
    without_compilers(hook, monkeypatch, ziglang=True)
    assert build_hook(hook).dependencies() == ["ziglang>=0.13"]


def test_nothing_is_asked_for_where_there_is_a_compiler(
    hook: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    without_compilers(hook, monkeypatch, ziglang=False)
    compiler = tmp_path / "cc"
    compiler.write_text("#!/bin/sh\n")
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", str(compiler))
    assert build_hook(hook).dependencies() == []


def test_without_any_compiler_the_compilation_says_what_to_install(
    hook: ModuleType, elsewhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_compilers(hook, monkeypatch, ziglang=False)
    with pytest.raises(ToolchainError, match=r"no C compiler found .*pip install ziglang"):
        hook.compile_loop()
    assert not elsewhere.exists()


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="the ziglang package is not installed")
def test_zig_compiles_a_library_that_can_be_loaded(
    hook: ModuleType, elsewhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    hook.compile_loop()
    assert load(elsewhere).loop_hash().decode() == source_hash()


# What goes into the wheel


def test_the_wheel_is_of_this_platform_and_of_no_version_of_python(
    hook: ModuleType, elsewhere: Path, tmp_path: Path
) -> None:
    require_compiler()
    data: dict = {"artifacts": []}
    build_hook(hook, tmp_path).initialize("standard", data)
    platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    assert data == {
        "artifacts": [f"cosim/loop/{LIBRARY.name}", f"cosim/pack/{PACKED_LIBRARY.name}"],
        "pure_python": False,
        "tag": f"py3-none-{platform}",
    }
    assert elsewhere.exists()


def test_a_source_distribution_compiles_nothing(hook: ModuleType, elsewhere: Path, tmp_path: Path) -> None:
    data: dict = {"artifacts": []}
    build_hook(hook, tmp_path, "sdist").initialize("standard", data)
    assert data == {"artifacts": []}
    assert not elsewhere.exists()


@pytest.mark.skipif(
    importlib.util.find_spec("hatchling") is None,
    reason="hatchling, which builds the wheel, is not installed here: pip install 'hatchling>=1.25'",
)
@pytest.mark.slow
def test_pip_builds_a_wheel_with_the_library_and_its_source(tmp_path: Path) -> None:
    require_compiler()
    checkout = copied(tmp_path / "checkout")
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet", "--wheel-dir", str(tmp_path)]
    subprocess.run([sys.executable, "-m", "pip", "wheel", str(checkout), *options], check=True)
    (wheel,) = tmp_path.glob("*.whl")
    platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    assert wheel.name.endswith(f"-py3-none-{platform}.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        metadata = archive.read(next(n for n in names if n.endswith(".dist-info/WHEEL"))).decode()
        archive.extractall(tmp_path / "installed")
    assert f"cosim/loop/{LIBRARY.name}" in names
    assert f"cosim/pack/{PACKED_LIBRARY.name}" in names
    assert {"cosim/loop/loop.c", "cosim/loop/loop.h", "cosim/pack/c/packed.c"} <= set(names)
    assert "Root-Is-Purelib: false" in metadata
    assert f"Tag: py3-none-{platform}" in metadata
    assert load(tmp_path / "installed" / "cosim" / "loop" / LIBRARY.name).loop_hash().decode() == source_hash()
    # what another source has left behind does not count
    assert not [n for n in names if n.endswith(".part") or n.startswith("tests/")]
