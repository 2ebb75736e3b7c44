"""Archives of `build_fmus.py --all-platforms`: what other systems would load, read from its bytes, and run under Wine.

The readers take what the tests ask about and no more. Their documents: for ELF the System V ABI (chapters 4 and 5) and
for symbol versions the Linux Standard Base Core 5.0 (10.7); for PE Microsoft's "PE Format"; for Mach-O mach-o/loader.h,
which describes the tree of exported names at dyld_info_command, and cs_blobs.h of Apple's kernel, xnu.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any
from urllib.parse import quote

import fmpy
import pytest
from fmpy.build import build_platform_binary

from fmu_export.native import backend as native_backend
from fmu_export.native import toolchain
from fmu_export.native.toolchain import find_compiler
from parallel_robot.fmus import build, fmu_path
from parallel_robot.models import MODELS
from tests.support import SUPPORT
from tests.support.binaries import kind_and_exports, text_at
from tests.support.compilation import OPTIMISATION_OF_USERS
from tests.support.native_fmus import FLAVOURS, Host, require_compiler, unpack
from tests.support.patience import PATIENCE

#: Each FMU is compiled for five platforms, in minutes; tests of the toolchain compile a small library for each.
pytestmark = pytest.mark.slow

pytest.importorskip("ziglang", reason="the ziglang package, which compiles for other platforms, is not installed")

CHECKOUT = Path(__file__).resolve().parents[3]
HEADERS = Path(fmpy.__file__).parent / "c-code"

#: Folders below binaries/, by flavour, and our names of their platforms.
PLATFORMS = {
    "fmi2": {"linux64": "x86_64-linux", "win64": "x86_64-windows", "darwin64": "x86_64-darwin"},
    "fmi3": {
        name: name for name in ("x86_64-linux", "aarch64-linux", "x86_64-windows", "x86_64-darwin", "aarch64-darwin")
    },
}
SUFFIXES = {"linux": ".so", "windows": ".dll", "darwin": ".dylib"}

#: Zig's linker for macOS exports these of its own accord; no importer asks for them.
LINKERS_OWN = {"_mh_dylib_header", "__dso_handle"}

BOTH = pytest.mark.parametrize("flavour", FLAVOURS)
ALL = pytest.mark.parametrize("instance", MODELS)
TORQUES = {"tau_a[1]": 0.05, "tau_a[2]": -0.03, "tau_a[3]": 0.04}


def of_system(*systems: str) -> pytest.MarkDecorator:
    """A test takes the libraries of these systems, each as `library`."""
    cases = [
        (flavour, instance, folder)
        for flavour, folders in PLATFORMS.items()
        for instance in MODELS
        for folder, platform in folders.items()
        if platform.partition("-")[2] in systems
    ]
    return pytest.mark.parametrize("library", cases, ids="-".join, indirect=True)


class Library:
    """A shared library in an archive."""

    def __init__(self, archives: Path, flavour: str, instance: str, folder: str) -> None:
        self.flavour = flavour
        self.platform = PLATFORMS[flavour][folder]
        self.name = MODELS[instance].name + SUFFIXES[self.platform.partition("-")[2]]
        with zipfile.ZipFile(fmu_path(archives, flavour, instance)) as archive:
            self.data = archive.read(f"binaries/{folder}/{self.name}")


@pytest.fixture(scope="module", autouse=True)
def as_for_users() -> Iterator[None]:
    """Without optimisation Zig adds checks of its own, which need more libraries."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(toolchain, "OPTIMISATION", OPTIMISATION_OF_USERS)
        yield


@pytest.fixture(scope="module")
def archives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the FMUs for all platforms; the first build for Windows makes its C library too, in minutes."""
    folder = tmp_path_factory.mktemp("all platforms")
    for flavour in FLAVOURS:
        build(folder, flavour, all_platforms=True)
    return folder


@pytest.fixture(scope="module")
def host_built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the FMUs for this machine, made by its own compiler."""
    require_compiler()
    folder = tmp_path_factory.mktemp("host")
    for flavour in FLAVOURS:
        build(folder, flavour)
    return folder


@pytest.fixture
def library(archives: Path, request: pytest.FixtureRequest) -> Library:
    return Library(archives, *request.param)


# What an archive holds


def members(fmu: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(fmu) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@BOTH
@ALL
def test_archive_has_one_library_for_each_platform_and_no_other_file(
    archives: Path, host_built: Path, flavour: str, instance: str
) -> None:
    found, expected = (members(fmu_path(folder, flavour, instance)) for folder in (archives, host_built))
    libraries = {name for name in found if name.startswith("binaries/")}
    assert libraries == {
        f"binaries/{folder}/{MODELS[instance].name}{SUFFIXES[platform.partition('-')[2]]}"
        for folder, platform in PLATFORMS[flavour].items()
    }
    rest = {name: content for name, content in expected.items() if not name.startswith("binaries/")}
    assert {name: found[name] for name in found.keys() - libraries} == rest


def test_same_sources_give_the_same_bytes(archives: Path, tmp_path: Path) -> None:
    """From the command line, with another hash seed, in another folder and with temporary files elsewhere."""
    temporary = tmp_path / "a longer name of the" / "temporary folder"
    temporary.mkdir(parents=True)
    command = [sys.executable, str(CHECKOUT / "build_fmus.py"), "--all-platforms", "--fmus", str(tmp_path / "again")]
    environment = os.environ | {"PYTHONHASHSEED": "1", "TMPDIR": str(temporary)}
    options = [word for flavour in FLAVOURS for word in ("--flavour", flavour)]
    options += [word for instance in MODELS for word in ("--fmu", instance)]
    subprocess.run([*command, *options], cwd=tmp_path, env=environment, check=True)
    for flavour in FLAVOURS:
        for instance in MODELS:
            first, second = (fmu_path(folder, flavour, instance) for folder in (archives, tmp_path / "again"))
            assert first.read_bytes() == second.read_bytes(), second.name


@BOTH
def test_nothing_is_compiled_again(archives: Path, flavour: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> bytes:
        raise AssertionError("compiled again")

    before = [fmu_path(archives, flavour, instance).read_bytes() for instance in MODELS]
    monkeypatch.setattr(native_backend, "compile_library", refuse)
    assert [path.read_bytes() for path in build(archives, flavour, all_platforms=True)] == before


# What the libraries export


def demanded(flavour: str) -> set[str]:
    """Functions that the header of the standard declares."""
    header = (HEADERS / f"{flavour}Functions.h").read_text(encoding="utf-8")
    names = re.findall(rf"^\s*{flavour.upper()}_Export\s+\w+TYPE\s+({flavour}\w+)\s*;", header, re.MULTILINE)
    assert len(names) > 40
    return set(names)


def exports(data: bytes) -> set[str]:
    platform, names = kind_and_exports(data)
    if platform.endswith("-darwin"):
        tree = macho_exports(data)  # dyld looks names up in the tree, other tools in the symbol table
        assert tree - LINKERS_OWN == names
        return tree - LINKERS_OWN
    return names


@of_system("linux", "windows", "darwin")
def test_exports_are_the_functions_of_the_standard(library: Library) -> None:
    assert kind_and_exports(library.data)[0] == library.platform  # format, machine, and that it is a shared library
    assert exports(library.data) == demanded(library.flavour)


@of_system("linux", "windows", "darwin")
def test_another_export_would_be_noticed(library: Library) -> None:
    right, wrong = f"{library.flavour}GetVersion", f"{library.flavour}GetVersian"
    altered = library.data.replace(b"ersion\0", b"ersian\0")
    assert exports(altered) == demanded(library.flavour) - {right} | {wrong}


# Linux


def elf_sections(data: bytes, kind: int) -> list[tuple[int, int, int]]:
    """Offset, size, and offset of the names, of the sections of a type."""
    (headers,) = struct.unpack_from("<Q", data, 40)
    size, count = struct.unpack_from("<HH", data, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", data, headers + size * i) for i in range(count)]
    return [(s[4], s[5], sections[s[6]][4]) for s in sections if s[1] == kind]


def elf_dynamic(data: bytes) -> list[tuple[int, int | str]]:
    """Tags and values of the dynamic section; texts where the value is one."""
    ((start, size, names),) = elf_sections(data, 6)  # SHT_DYNAMIC
    texts = {1, 14, 15, 29}  # DT_NEEDED, DT_SONAME, DT_RPATH, DT_RUNPATH
    entries = struct.iter_unpack("<QQ", data[start : start + size])
    return [(tag, text_at(data, names + value) if tag in texts else value) for tag, value in entries]


def elf_versions(data: bytes) -> set[tuple[str, str]]:
    """Libraries and the versions of their symbols that are needed."""
    ((at, _, names),) = elf_sections(data, 0x6FFFFFFE)  # SHT_GNU_verneed
    found = set()
    while True:
        _, count, file, first, following = struct.unpack_from("<HHIII", data, at)
        entry = at + first
        for _ in range(count):
            _, _, _, name, step = struct.unpack_from("<IHHII", data, entry)
            found.add((text_at(data, names + file), text_at(data, names + name)))
            entry += step
        if not following:
            return found
        at += following


def number(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.removeprefix("GLIBC_").split("."))


@of_system("linux")
def test_linux_library_needs_an_old_glibc_and_nothing_else(library: Library) -> None:
    """2.17 is the glibc of manylinux2014, and the first for aarch64."""
    dynamic = elf_dynamic(library.data)
    assert {value for tag, value in dynamic if tag == 1} <= {"libc.so.6", "libm.so.6"}  # DT_NEEDED
    assert not {15, 29} & {tag for tag, _ in dynamic}  # DT_RPATH, DT_RUNPATH
    versions = elf_versions(library.data)
    assert {file for file, _ in versions} <= {"libc.so.6", "libm.so.6"}
    assert max(number(version) for _, version in versions) <= (2, 17)


# macOS

LOADS = {0xC, 0x80000018, 0x8000001F, 0x20, 0x80000023}  # LC_LOAD_DYLIB; _WEAK_, LC_REEXPORT_, _LAZY_, _UPWARD_


def load_commands(data: bytes, *numbers: int) -> list[int]:
    """Offsets of the load commands that have one of these numbers."""
    found, at = [], 32
    for _ in range(struct.unpack_from("<I", data, 16)[0]):
        number, size = struct.unpack_from("<II", data, at)
        found += [at] if number in numbers else []
        at += size
    return found


def named_by(data: bytes, *numbers: int) -> list[str]:
    """Texts whose offset is the first field of load commands."""
    return [text_at(data, at + struct.unpack_from("<I", data, at + 8)[0]) for at in load_commands(data, *numbers)]


def macho_exports(data: bytes) -> set[str]:
    (command,) = load_commands(data, 0x80000022)  # LC_DYLD_INFO_ONLY
    (tree,) = struct.unpack_from("<I", data, command + 40)

    def uleb128(at: int) -> tuple[int, int]:
        value = shift = 0
        while True:
            value |= (data[at] & 0x7F) << shift
            shift += 7
            at += 1
            if data[at - 1] < 0x80:
                return value, at

    def below(node: int, prefix: str) -> Iterator[str]:
        size, at = uleb128(node)
        if size:  # a name ends here
            yield prefix
        at += size
        children = data[at]
        at += 1
        for _ in range(children):
            part = text_at(data, at)
            child, at = uleb128(at + len(part) + 1)
            yield from below(tree + child, prefix + part)

    return {name.removeprefix("_") for name in below(tree, "")}


def signature_problem(data: bytes) -> str:
    """Why the kernel of macOS would refuse the pages of a library, else empty."""
    commands = load_commands(data, 0x1D)  # LC_CODE_SIGNATURE
    if not commands:
        return "not signed"
    (start,) = struct.unpack_from("<I", data, commands[0] + 8)
    magic, _, count = struct.unpack_from(">III", data, start)
    slots = dict(struct.iter_unpack(">II", data[start + 12 : start + 12 + 8 * count]))
    directory = start + slots[0]  # CSSLOT_CODEDIRECTORY
    kind, _, _, _, hashes, _, _, n_pages, end, size, algorithm, _, page = struct.unpack_from(">9I4B", data, directory)
    if (magic, kind, size, algorithm) != (0xFADE0CC0, 0xFADE0C02, 32, 2):  # 2 is SHA-256
        return "an unknown kind of signature"
    if end != start:
        return "signed only in part"
    stored = data[directory + hashes : directory + hashes + size * n_pages]
    found = [hashlib.sha256(data[i : min(i + (1 << page), end)]).digest() for i in range(0, end, 1 << page)]
    return "" if stored == b"".join(found) else "changed after it was signed"


@of_system("darwin")
def test_macos_library_can_be_loaded(library: Library) -> None:
    data = library.data
    assert named_by(data, 0xD) == [f"@rpath/{library.name}"]  # LC_ID_DYLIB
    assert named_by(data, *LOADS) == ["/usr/lib/libSystem.B.dylib"]
    assert named_by(data, 0x8000001C) == []  # LC_RPATH
    (command,) = load_commands(data, 0x32)  # LC_BUILD_VERSION
    assert struct.unpack_from("<II", data, command + 8) == (1, 11 << 16)  # PLATFORM_MACOS 11.0.0
    # a Mac of aarch64 loads nothing unsigned; a signature without a certificate is enough
    assert signature_problem(data) in ({""} if library.platform == "aarch64-darwin" else {"", "not signed"})


@ALL
def test_a_change_after_signing_would_be_noticed(archives: Path, instance: str) -> None:
    data = bytearray(Library(archives, "fmi3", instance, "aarch64-darwin").data)
    data[len(data) // 2] ^= 1
    assert signature_problem(bytes(data)) == "changed after it was signed"


# Windows


def pe_imports(data: bytes) -> set[str]:
    """Names of the DLLs that are loaded along, at once or at the first call."""
    (start,) = struct.unpack_from("<I", data, 0x3C)
    (n_sections,) = struct.unpack_from("<H", data, start + 6)
    (optional,) = struct.unpack_from("<H", data, start + 20)
    headers = [struct.unpack_from("<IIII", data, start + 24 + optional + 40 * i + 8) for i in range(n_sections)]

    def offset(address: int) -> int:
        return next(raw + address - base for size, base, _, raw in headers if base <= address < base + size)

    found = set()
    for index, size, field in ((1, 20, 12), (13, 32, 4)):  # import and delay-import table; a row, and the name in it
        (table,) = struct.unpack_from("<I", data, start + 24 + 112 + 8 * index)
        while table and (name := struct.unpack_from("<I", data, offset(table) + field)[0]):
            found.add(text_at(data, offset(name)))
            table += size
    return found


@of_system("windows")
def test_windows_library_needs_only_the_system(library: Library) -> None:
    """The universal C runtime (api-ms-win-crt-...) is part of Windows 10 and later."""
    imports = pe_imports(library.data)
    system = re.compile(r"(kernel32|msvcrt|ucrtbase|api-ms-win-crt-[a-z]+-l1-1-0)\.dll", re.IGNORECASE)
    assert "kernel32.dll" in {name.lower() for name in imports}
    assert [name for name in imports if not system.fullmatch(name)] == []


@pytest.fixture(scope="module")
def wine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., str]]:
    """Runs a Windows program and returns what it printed."""
    program = next(filter(None, map(shutil.which, ("wine64", "wine", "/usr/lib/wine/wine64"))), None)
    if program is None:
        pytest.skip("Wine is not installed")
    folder = tmp_path_factory.mktemp("wine")
    environment = os.environ | {
        "WINEPREFIX": str(folder / "prefix"),
        "WINEARCH": "win64",
        "WINEDEBUG": "-all",
        "WINEDLLOVERRIDES": "mscoree=;mshtml=",  # else a new prefix asks for downloads
        "LC_ALL": "C.UTF-8",  # the encoding of file names and arguments
    }

    def run(*command: str | Path) -> str:
        # files, since Wine's server outlives the program and would keep pipes open
        with TemporaryFile() as output, TemporaryFile() as messages:
            done = subprocess.run(
                [program, *command], env=environment, stdout=output, stderr=messages, timeout=PATIENCE, check=False
            )
            for file in (output, messages):
                file.seek(0)
            assert done.returncode == 0, messages.read().decode(errors="replace")
            return output.read().decode()

    run("wineboot", "--init")
    yield run
    run("wineboot", "--kill")
    shutil.rmtree(folder, ignore_errors=True)  # hundreds of megabytes


@pytest.fixture(scope="module")
def windows_host(wine: Callable[..., str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = tmp_path_factory.mktemp("windows host") / "host.exe"
    source = SUPPORT / "platform_host.c"
    command = [sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-windows-gnu", "-municode", "-std=c99", "-O2"]
    command += ["-g0", "-s", "-Wall", "-Wextra", "-Werror", f"-I{HEADERS}", str(source), "-o", str(program)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program


def host_run(folder: Path, outputs: list[str]) -> list[float]:
    """A second in steps of 1 ms, by the library for this machine in an unpacked archive."""
    with Host(folder) as host:
        host.run_up(TORQUES)
        for i in range(1000):
            host.must(host.step(i * 1e-3, 1e-3))
        return host.get(outputs)


@BOTH
@pytest.mark.parametrize("name", ["plain", "Prüfstand ä 試"], ids=["plain", "foreign"])
def test_windows_library_gives_the_same_bits(
    archives: Path, wine: Callable[..., str], windows_host: Path, flavour: str, name: str, tmp_path: Path
) -> None:
    folder = unpack(fmu_path(archives, flavour, "plant"), tmp_path / name)
    description = fmpy.read_model_description(str(folder))
    outputs = [v.name for v in description.modelVariables if v.causality == "output"]
    references = {v.name: v.valueReference for v in description.modelVariables}
    place = next(place for place, platform in PLATFORMS[flavour].items() if platform == "x86_64-windows")

    drive = f"Z:{folder}"  # Wine's name of the root folder
    resources = "file:///" + quote(f"{drive}/resources", safe="/:")
    if flavour == "fmi3":
        resources = f"{drive}/resources/".replace("/", "\\")
    printed = wine(
        windows_host,
        flavour[-1],
        f"{drive}/binaries/{place}/{description.modelName}.dll".replace("/", "\\"),
        resources,
        description.guid,
        *(f"{references[name]}={value!r}" for name, value in TORQUES.items()),
        *(str(references[name]) for name in outputs),
    )
    found = dict(zip(outputs, map(float, printed.split()), strict=True))
    expected = dict(zip(outputs, host_run(folder, outputs), strict=True))
    assert abs(expected["omega_a[1]"]) > 0.1  # it moves
    assert found == expected


# The sources


@BOTH
def test_fmpy_compiles_the_packaged_sources(archives: Path, host_built: Path, flavour: str, tmp_path: Path) -> None:
    for tool in ("cmake",) if sys.platform == "win32" else ("cmake", "make"):
        if not shutil.which(tool):
            pytest.skip(f"{tool}, which fmpy compiles by, is not installed")
    if "ziglang" in find_compiler():
        pytest.skip("this machine has no C compiler of its own")
    folder = unpack(fmu_path(archives, flavour, "plant"), tmp_path / "fmu")
    shutil.rmtree(folder / "binaries")
    (tmp_path / "build").mkdir()
    # the baseline of x86_64 has no fused multiply-add; elsewhere compilers use it unless told not to, as ours is
    x86_64 = fmpy.platform_tuple.startswith("x86_64")
    build_platform_binary(
        folder, tmp_path / "build", cmake_options={} if x86_64 else {"CMAKE_C_FLAGS:STRING": "-ffp-contract=off"}
    )
    rebuilt = shutil.make_archive(str(tmp_path / "rebuilt"), "zip", folder)
    for kind in ("CoSimulation", "ModelExchange"):
        first, second = (
            fmpy.simulate_fmu(str(fmu), stop_time=1.0, fmi_type=kind, start_values=TORQUES)
            for fmu in (fmu_path(host_built, flavour, "plant"), rebuilt)
        )
        assert first["x_E"].max() - first["x_E"].min() > 0.01
        assert first.dtype == second.dtype
        assert first.tobytes() == second.tobytes()
