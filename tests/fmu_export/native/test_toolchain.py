"""C sources become shared libraries: for the host by its compiler, for other platforms by zig if it is installed."""

from __future__ import annotations

import ctypes
import math
import os
import re
import struct
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import pytest

from fmu_export.native import toolchain
from fmu_export.native.toolchain import (
    TARGETS,
    Target,
    ToolchainError,
    Unit,
    compile_library,
    find_compiler,
    host_target,
)
from tests.support.binaries import kind_and_exports, macho_commands, text_at
from tests.support.compilation import OPTIMISATION_OF_USERS

needs_zig = pytest.mark.skipif(find_spec("ziglang") is None, reason="the ziglang package is not installed")

HEADER = b"""
#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
double inner(double x);
EXPORT double gain(double x);
"""

#: Two files, a header, and the C library's mathematics and output.
SOURCES = {
    "inner.c": b'#include "gain.h"\ndouble inner(double x) { return 2.0 * x; }\n',
    "gain.c": b"""#include <math.h>
#include <stdio.h>
#include "gain.h"
double gain(double x) {
    char text[64];
    return inner(exp(x)) + pow(x, 1.5) + (double)snprintf(text, sizeof text, "%.3f", x);
}
""",
    "gain.h": HEADER,
}


def glibc_versions(data: bytes) -> set[tuple[int, ...]]:
    return {tuple(int(n) for n in found.split(b".")) for found in re.findall(rb"\0GLIBC_([0-9.]+)(?=\0)", data)}


def load(data: bytes, folder: Path) -> ctypes.CDLL:
    path = folder / f"gain{host_target().suffix}"
    path.write_bytes(data)
    library = ctypes.CDLL(str(path))
    library.gain.restype = ctypes.c_double
    library.gain.argtypes = [ctypes.c_double]
    return library


def assert_works(data: bytes, folder: Path) -> None:
    library = load(data, folder)
    assert library.gain(2.25) == pytest.approx(2.0 * math.exp(2.25) + 2.25**1.5 + 5.0, rel=1e-15)
    with pytest.raises(AttributeError):
        _ = library.inner


@pytest.fixture
def no_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", "")


@pytest.fixture
def no_zig(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(toolchain, "find_spec", lambda name: None)


@pytest.fixture(scope="module")
def host_library() -> bytes:
    try:
        find_compiler()
    except ToolchainError as error:
        pytest.skip(str(error))
    return compile_library(SOURCES, "gain", strict=True)


def test_library_for_the_host_is_loaded_and_called(host_library: bytes, tmp_path: Path) -> None:
    assert_works(host_library, tmp_path)


def test_only_marked_functions_are_exported(host_library: bytes) -> None:
    assert kind_and_exports(host_library) == (host_target().name, {"gain"})


def test_same_sources_give_the_same_bytes(host_library: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In another folder, and with a comment that keeps a compiler's cache from answering."""
    deep = tmp_path / "another" / "place"
    deep.mkdir(parents=True)
    monkeypatch.setattr(tempfile, "tempdir", str(deep))
    again = compile_library(SOURCES | {"gain.c": SOURCES["gain.c"] + b"/* again */\n"}, "gain")
    assert again == host_library
    assert b"toolchain-" not in again
    assert list(deep.iterdir()) == []


def test_optimisation_is_that_of_the_moment(host_library: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests of models compile without, which takes a third of the time."""
    monkeypatch.setattr(toolchain, "OPTIMISATION", OPTIMISATION_OF_USERS)
    assert compile_library(SOURCES, "gain") != host_library


@pytest.mark.parametrize("level", [1, 3])
def test_files_of_a_unit_are_compiled_as_one(host_library: bytes, level: int, tmp_path: Path) -> None:
    """What one of them keeps to itself the next one sees, beside files that are compiled for themselves."""
    second = b'#include "gain.h"\ndouble gain(double x) { return five() * inner(x); }\n'
    sources = SOURCES | {"first.c": b"static double five(void) { return 5.0; }\n", "gain.c": second}
    units = [Unit(("first.c", "gain.c"), level=level)]
    library = compile_library(sources, "gain", units=units)
    assert load(library, tmp_path).gain(2.0) == 20.0
    assert compile_library(sources, "gain", units=units) == library
    with pytest.raises(ToolchainError, match=r"gain\.c:2.*five"):
        compile_library(sources, "gain", strict=True)
    with pytest.raises(ToolchainError, match=r"^gain\.\w+: .*gain\.c:2:.*error"):
        compile_library(sources | {"gain.c": second.replace(b"five()", b"five(")}, "gain", units=units)


def test_sources_may_lie_in_folders(host_library: bytes, tmp_path: Path) -> None:
    assert_works(
        compile_library({"gain.h": SOURCES["gain.h"]} | {f"src/{n}": SOURCES[n] for n in SOURCES}, "gain"), tmp_path
    )


@pytest.mark.parametrize(
    ("source", "strict", "expected"),
    [
        (b"int f(void) { return 1 }\n", False, r"model\.c.*error"),
        (b'#include "missing.h"\nint f(void) { return 1; }\n', False, r"missing\.h"),
        (HEADER + b"double gain(double x) { return inner(x); }\n", False, r"\binner\b"),
        (b"int f(void);\nint f(void) { int unused; return 1; }\n", True, r"model\.c.*unused"),
        (b"int f(void) { return a + b + c + d + e; }\n", False, r"; and \d more$"),
    ],
    ids=["syntax", "header", "link", "warning", "many"],
)
def test_refused_sources_are_one_line(host_library: bytes, source: bytes, strict: bool, expected: str) -> None:
    with pytest.raises(ToolchainError, match=expected) as caught:
        compile_library({"model.c": source}, "model", strict=strict)
    message = str(caught.value)
    assert message.startswith("model" + host_target().suffix + ": ")
    assert "\n" not in message
    assert "toolchain-" not in message


def test_a_warning_alone_is_no_error(host_library: bytes) -> None:
    assert compile_library({"m.c": b"int f(void);\nint f(void) { int unused; return 1; }\n"}, "m")


def test_without_a_compiler_the_message_says_how_to_get_one(no_compiler: None, no_zig: None) -> None:
    with pytest.raises(ToolchainError) as caught:
        compile_library(SOURCES, "gain")
    assert str(caught.value) == (
        "no C compiler found (looked for cc, gcc, clang, cl, and the ziglang package); install one, or: "
        "pip install ziglang"
    )


def test_other_platforms_need_zig(no_zig: None) -> None:
    with pytest.raises(ToolchainError, match=r"^no compiler for aarch64-darwin found .*: pip install ziglang$"):
        compile_library(SOURCES, "gain", TARGETS["aarch64-darwin"])


def test_zig_stands_in_where_there_is_no_compiler(no_compiler: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(toolchain, "find_spec", lambda name: object())
    assert find_compiler() == [sys.executable, "-m", "ziglang", "cc"]


def test_cc_names_the_compiler_and_its_options(host_library: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    command = find_compiler()
    monkeypatch.setenv("CC", " ".join([*command, "-DFIVE=5"]))
    assert find_compiler() == [*command, "-DFIVE=5"]
    assert compile_library({"m.c": b"int f(void);\nint f(void) { return FIVE; }\n"}, "m", strict=True)


@pytest.mark.skipif(os.name == "nt", reason="a shell script stands for the compiler")
def test_cc_may_be_a_path_with_spaces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = tmp_path / "my compiler"
    script.write_text("#!/bin/sh\necho 'out of luck' >&2\nexit 3\n")
    script.chmod(0o755)
    monkeypatch.chdir(tmp_path)
    for name in (str(script), "./my compiler"):  # the second is found from another folder too
        monkeypatch.setenv("CC", name)
        with pytest.raises(ToolchainError, match=r"my compiler failed: out of luck$"):
            compile_library(SOURCES, "gain")


@pytest.mark.parametrize("cc", ["no-such-compiler -O3", '"no-such'])
def test_cc_that_is_not_there_is_named(cc: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", cc)
    with pytest.raises(ToolchainError, match=re.escape(f"CC={cc}: no such program")):
        find_compiler()


@pytest.mark.skipif(os.name == "nt", reason="a text without #! stands for the compiler")
def test_a_compiler_that_does_not_start_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = tmp_path / "broken"
    broken.write_bytes(b"\x7fELF")
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    with pytest.raises(ToolchainError, match=r"can't run the compiler .*broken"):
        compile_library(SOURCES, "gain")


@pytest.mark.parametrize(
    ("machine", "system", "expected"),
    [
        ("x86_64", "Linux", "x86_64-linux"),
        ("aarch64", "Linux", "aarch64-linux"),
        ("AMD64", "Windows", "x86_64-windows"),
        ("arm64", "Darwin", "aarch64-darwin"),
        ("x86_64", "Darwin", "x86_64-darwin"),
    ],
)
def test_host_is_known_by_our_name(machine: str, system: str, expected: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(toolchain.platform, "machine", lambda: machine)
    monkeypatch.setattr(toolchain.platform, "system", lambda: system)
    assert host_target() is TARGETS[expected]


@pytest.mark.parametrize(("machine", "maxsize"), [("riscv64", 2**63 - 1), ("x86_64", 2**31 - 1)])
def test_other_machines_are_refused(machine: str, maxsize: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(toolchain.platform, "machine", lambda: machine)
    monkeypatch.setattr(toolchain.sys, "maxsize", maxsize)
    with pytest.raises(ToolchainError, match=rf"^no native FMUs for this machine \({machine}-.*there are: x86_64"):
        host_target()


def test_folders_are_those_of_the_standards() -> None:
    assert {t.name: (t.suffix, t.fmi2_folder, t.fmi3_folder) for t in TARGETS.values()} == {
        "x86_64-linux": (".so", "linux64", "x86_64-linux"),
        "x86_64-windows": (".dll", "win64", "x86_64-windows"),
        "x86_64-darwin": (".dylib", "darwin64", "x86_64-darwin"),
        "aarch64-darwin": (".dylib", None, "aarch64-darwin"),
        "aarch64-linux": (".so", None, "aarch64-linux"),
    }


@needs_zig
@pytest.mark.parametrize(
    "target",
    [pytest.param(t, id=name, marks=pytest.mark.slow if "linux" in name else ()) for name, t in TARGETS.items()],
)
def test_zig_compiles_for_every_platform(target: Target, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first library for a platform makes its C library too: seconds, for Windows two minutes.

    As users do: without optimisation zig writes the time into a library for Windows.
    """
    monkeypatch.setattr(toolchain, "OPTIMISATION", OPTIMISATION_OF_USERS)
    library = compile_library(SOURCES, "gain", target, strict=True)
    assert kind_and_exports(library) == (target.name, {"gain"})
    again = SOURCES | {"gain.c": SOURCES["gain.c"] + f"/* {os.urandom(8).hex()} */\n".encode()}
    assert compile_library(again, "gain", target) == library
    assert b"toolchain-" not in library
    assert b"inner" not in library
    if target.suffix == ".so":
        assert glibc_versions(library)
        assert max(glibc_versions(library)) <= (2, 17)
    if target.suffix == ".dylib":
        commands = macho_commands(library)
        assert text_at(library, commands[0xD] + 24) == "@rpath/gain.dylib"  # LC_ID_DYLIB
        assert struct.unpack_from("<I", library, commands[0x32] + 12)[0] == 11 << 16  # LC_BUILD_VERSION
    if target is host_target():
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            assert_works(library, Path(folder))


@needs_zig
def test_zig_for_the_host_uses_no_more_than_the_platform_has(no_compiler: None, tmp_path: Path) -> None:
    """By itself zig compiles for this very machine: all its instructions, and its glibc."""
    library = compile_library(SOURCES, "gain")
    assert library == compile_library(SOURCES, "gain", host_target())
    assert_works(library, tmp_path)


@needs_zig
def test_products_and_sums_are_rounded_apart() -> None:
    """On aarch64, where every machine has fused multiply-add, and compilers like to use it."""
    source = b'__attribute__((visibility("default"))) double f(double a, double b, double c) { return a * b + c; }\n'

    def fused(source: bytes) -> bool:
        library = compile_library({"f.c": source}, "f", TARGETS["aarch64-linux"])
        words = struct.iter_unpack("<I", library[: len(library) // 4 * 4])
        return any(word & 0xFFE08000 == 0x1F400000 for (word,) in words)  # FMADD of doubles

    assert not fused(source)
    assert fused(b"#pragma STDC FP_CONTRACT ON\n" + source)


@needs_zig
def test_zig_refuses_in_one_line() -> None:
    with pytest.raises(
        ToolchainError, match=r"^model\.dll: zig failed: model\.c:1:.*expected ';' after return statement$"
    ) as caught:
        compile_library({"model.c": b"int f(void) { return 1 }\n"}, "model", TARGETS["x86_64-windows"])
    assert "\n" not in str(caught.value)
