"""Generated C99 compiled into the shared libraries of FMUs, for the host by its compiler and for others by zig.

The same sources give the same bytes, and arithmetic is that of the source: no contraction into fused
multiply-adds, no instructions beyond the architecture's baseline. What a library exports, its source marks.
"""

from __future__ import annotations

import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from fmu_export.errors import ModelError


class ToolchainError(ModelError):
    """There is no compiler, or it refused the sources; one line says which and why."""


@dataclass(frozen=True)
class Target:
    """A platform that an FMU can hold a binary for."""

    name: str
    #: zig's name; it carries the oldest system that can load the library.
    triple: str
    suffix: str
    #: Folder below binaries/ in an FMI 2.0 FMU; None where FMI 2.0 has none of its own.
    fmi2_folder: str | None

    @property
    def fmi3_folder(self) -> str:
        """Folder below binaries/ in an FMI 3.0 FMU."""
        return self.name

    @property
    def system(self) -> str:
        """Operating system: linux, windows or darwin."""
        return self.name.partition("-")[2]


@dataclass(frozen=True)
class Unit:
    """C files that are compiled as one, so that their headers are read once and calls among them cost nothing."""

    files: tuple[str, ...]
    #: How far gcc and clang optimise them at most, as in -O3: what has no loops over states, or is called seldom, is
    #: not worth all of the compiler's time.
    level: int = 3


#: glibc 2.17 is that of manylinux2014, macOS 11 the first on aarch64. FMI 2.0 knows no aarch64; its darwin64 could
#: hold a universal binary, which is not made here.
TARGETS: dict[str, Target] = {
    target.name: target
    for target in (
        Target("x86_64-linux", "x86_64-linux-gnu.2.17", ".so", "linux64"),
        Target("x86_64-windows", "x86_64-windows-gnu", ".dll", "win64"),
        Target("x86_64-darwin", "x86_64-macos.11.0", ".dylib", "darwin64"),
        Target("aarch64-darwin", "aarch64-macos.11.0", ".dylib", None),
        Target("aarch64-linux", "aarch64-linux-gnu.2.17", ".so", None),
    )
}

_COMPILERS = ("cc", "gcc", "clang")

#: How far gcc and clang optimise; the bits of the results are the same at any level.
OPTIMISATION = "-O3"

#: What gcc, clang and zig are told for any target, beside how far they optimise.
_OPTIONS = (
    "-std=c99",
    "-ffp-contract=off",
    "-fno-fast-math",
    "-fno-math-errno",
    "-g0",
    "-Wall",
    "-Wextra",
)

#: zig's name of WebAssembly without a system below it.
_WEBASSEMBLY = "wasm32-freestanding"

#: What tells an error from the lines around it, for gcc, clang, zig, cl and the linkers.
_ERROR = re.compile(r"\b(error(?! generated)|undefined reference|undefined symbol)\b", re.IGNORECASE)
_MAX_ERRORS = 3


def host_target() -> Target:
    """The platform this process runs on.

    Raises
    ------
    ToolchainError
        It is none of `TARGETS`.
    """
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    name = f"{machine}-{platform.system().lower()}"
    if name not in TARGETS or sys.maxsize < 2**32:  # a 32-bit Python can't load a 64-bit library
        bits = 64 if sys.maxsize > 2**32 else 32
        raise ToolchainError(f"no native FMUs for this machine ({name}, {bits}-bit Python); there are: {_names()}")
    return TARGETS[name]


def find_compiler() -> list[str]:
    """The command that compiles C for this machine: $CC, or the first found of cc, gcc, clang, cl and ziglang.

    Raises
    ------
    ToolchainError
        There is none, or $CC names none.
    """
    if named := os.environ.get("CC", "").strip():
        for words in ([named], _words(named)):  # a path may hold spaces, and $CC may hold options
            if found := _program(words[0]):
                return [found, *words[1:]]
        raise ToolchainError(f"CC={named}: no such program; set CC to a C compiler, or unset it")
    for program in (*_COMPILERS, "cl") if platform.system() == "Windows" else _COMPILERS:
        if found := _program(program):
            return [found]
    if find_spec("ziglang"):
        return _zig()
    raise ToolchainError(
        "no C compiler found (looked for cc, gcc, clang, cl, and the ziglang package); install one, or: "
        "pip install ziglang"
    )


def compiler_identity(*, all_platforms: bool) -> str:
    """What changes when other binaries are to be expected from the same sources: the compiler, its release, platforms.

    Raises
    ------
    ToolchainError
        There is no compiler.
    """
    if all_platforms:
        return f"zig {_zig_version()} for {_names()}"
    compiler = find_compiler()
    if _is_zig(compiler):
        return f"zig {_zig_version()}"
    program = Path(compiler[0]).stat()
    return f"{shlex.join(compiler)} {program.st_size} {program.st_mtime_ns}"


def _zig_version() -> str:
    return version("ziglang") if find_spec("ziglang") else "missing"


def compile_library(
    sources: Mapping[str, bytes],
    name: str,
    target: Target | None = None,
    *,
    strict: bool = False,
    libraries: Sequence[str] = (),
    units: Sequence[Unit] = (),
) -> bytes:
    """Compile C99 sources into a shared library and return its bytes.

    Parameters
    ----------
    sources
        Contents by relative name; each .c file is compiled, and .h files are found from the common folder.
    name
        Name of the library without suffix.
    target
        Platform; None is this machine and its own compiler, any other (also the host, if named) takes zig.
    strict
        Whether a warning is an error; for tests, since a later compiler may warn of more.
    libraries
        System libraries, by the names that -l takes, besides that of the mathematical functions; none on Windows.
    units
        Files that are compiled as one; each other file is compiled for itself. gcc and clang compile the units at the
        same time.

    Raises
    ------
    ToolchainError
        There is no compiler, or it refused the sources.
    """
    if target is None:
        target, compiler = host_target(), find_compiler()
    elif find_spec("ziglang"):
        compiler = _zig()
    else:
        raise ToolchainError(
            f"no compiler for {target.name} found (looked for the ziglang package); get it by: pip install ziglang"
        )
    library = name + target.suffix
    in_units = {file for unit in units for file in unit.files}
    others = sorted(source for source in sources if source.endswith(".c") and source not in in_units)
    wholes = {f"unit_{i}.c": unit for i, unit in enumerate(units)}
    sources = {**sources, **{name: _as_one(unit) for name, unit in wholes.items()}}
    if _is(compiler, "cl"):  # no C99 by name: it is cl's default; /Brepro: no time stamps
        options = ["/nologo", "/LD", "/MT", "/O2", "/fp:precise", "/W3", "/utf-8", "/Brepro", "/I."]
        options += ["/WX"] if strict else []
        command = [*compiler, *options, *others, *wholes, f"/Fe:{library}", "/link", "/Brepro"]
        return _compile(sources, [command], library)
    options, linking = _options(compiler, target, library, strict)
    linked = [] if target.system == "windows" else [f"-l{name}" for name in ("m", *libraries)]
    linked = ["-o", library, *linked]
    if not units or _is_zig(compiler):  # which takes long to start
        return _compile(sources, [[*compiler, *options, OPTIMISATION, *linking, *others, *wholes, *linked]], library)
    commands = [[*compiler, *options, OPTIMISATION, "-c", *others]] if others else []
    for whole, unit in wholes.items():
        commands.append([*compiler, *options, min(OPTIMISATION, f"-O{unit.level}"), "-c", whole])
    objects = [Path(source).stem + ".o" for source in (*others, *wholes)]
    return _compile(sources, commands, library, [*compiler, *linking, *objects, *linked])


def _as_one(unit: Unit) -> bytes:
    """A source that includes those of a unit."""
    return "".join(f'#include "{file}"\n' for file in unit.files).encode()


def compile_module(sources: Mapping[str, bytes], name: str, *, strict: bool = False) -> bytes:
    """Compile C99 sources into a WebAssembly module that imports nothing, by zig, and return its bytes.

    Parameters
    ----------
    sources
        Contents by relative name; there is no C library, and headers are found from the common folder only.
    name
        Name of the module without suffix.
    strict
        Whether a warning is an error; for tests, since a later compiler may warn of more.

    Raises
    ------
    ToolchainError
        There is no zig, or it refused the sources.
    """
    if not find_spec("ziglang"):
        raise ToolchainError(
            "no compiler for WebAssembly found (looked for the ziglang package); get it by: pip install ziglang"
        )
    module = f"{name}.wasm"
    files = sorted(source for source in sources if source.endswith(".c"))
    # without optimisation zig adds checks that need a library
    options = [*_OPTIONS, "-O3", *(["-Werror"] if strict else []), "-fvisibility=hidden", "-I."]
    options += ["-target", _WEBASSEMBLY]
    options += ["-nostdlib", "-mbulk-memory", "-s", "-Wl,--no-entry", "-Wl,-z,stack-size=1048576"]
    return _compile(sources, [[*_zig(), *options, *files, "-o", module]], module)


def _compile(
    sources: Mapping[str, bytes], commands: Sequence[list[str]], output: str, link: list[str] | None = None
) -> bytes:
    """Run a compiler in a folder of its own with these sources, and return the bytes of its output.

    The commands run at the same time, then that which links what they made.
    """
    with tempfile.TemporaryDirectory(prefix="toolchain-") as temporary:
        folder = Path(temporary)
        for source, content in sources.items():
            (folder / source).parent.mkdir(parents=True, exist_ok=True)
            (folder / source).write_bytes(content)
        # relative names only, so that no name of the temporary folder gets into the library
        with ThreadPoolExecutor() as pool:
            list(pool.map(lambda command: _run(command, folder, output), commands))
        if link:
            _run(link, folder, output)
        if not (folder / output).is_file():
            raise ToolchainError(f"{output}: {_compiler_name(commands[0])} wrote no library")
        return (folder / output).read_bytes()


def _names() -> str:
    return ", ".join(TARGETS)


def _zig() -> list[str]:
    return [sys.executable, "-m", "ziglang", "cc"]


def _program(name: str) -> str | None:
    """Absolute path of a program: compilers are run in another folder."""
    found = shutil.which(name)
    return found and str(Path(found).absolute())


def _words(command: str) -> list[str]:
    try:
        return shlex.split(command, posix=os.name != "nt")  # backslashes are part of paths there
    except ValueError:  # an open quotation
        return [command]


def _is(compiler: list[str], *names: str) -> bool:
    """Whether a compiler is one of these, be it below a wrapper such as ccache."""
    return any(Path(word).stem.lower() in names for word in compiler)


def _is_zig(compiler: list[str]) -> bool:
    return _is(compiler, "zig", "ziglang", "python-zig")


def _options(compiler: list[str], target: Target, library: str, strict: bool) -> tuple[list[str], list[str]]:
    """What gcc, clang and zig are told for a platform when they compile, and when they link."""
    options = [*_OPTIONS, *(["-Werror"] if strict else []), "-fvisibility=hidden", "-I."]
    linking = ["-shared"]
    if _is_zig(compiler):
        options += ["-target", target.triple]  # without it zig would use all instructions of this very machine
    if target.system != "windows":  # whose code is position-independent without
        options += ["-fPIC"]
    if target.system == "linux":
        # a missing function is an error here, not when the FMU is loaded; -fno-plt: libm is called without a detour
        options += ["-fno-plt"]
        linking += ["-s", "-Wl,--build-id=none", "-Wl,-z,defs"]
    elif target.system == "darwin":  # Apple's linker ignores -s; -x drops all but the exported names
        linking += ["-Wl,-x", f"-Wl,-install_name,@rpath/{library}"]
        oldest = [] if _is_zig(compiler) else ["-mmacosx-version-min=11.0"]
        options, linking = options + oldest, linking + oldest
    else:
        linking += ["-s"] if _is_zig(compiler) else ["-s", "-static-libgcc", "-Wl,--no-insert-timestamp"]
    return options, linking


def _run(command: list[str], folder: Path, library: str) -> None:
    """Run a compiler in a folder; its first errors, joined in one line, are the `ToolchainError`."""
    environment = os.environ | {"LC_ALL": "C"}  # English and plain quotes, whatever the user speaks
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, stdin=subprocess.DEVNULL, capture_output=True, check=False
        )
    except OSError as error:
        raise ToolchainError(f"{library}: can't run the compiler {command[0]}: {error.strerror}") from error
    if done.returncode == 0:
        return
    # cl writes its errors to the standard output
    output = (done.stderr + b"\n" + done.stdout).decode("utf-8", errors="replace")
    lines = [" ".join(line.split()) for line in output.splitlines() if line.strip()]
    errors = [line for line in lines if _ERROR.search(line)] or lines or [f"exit code {done.returncode}"]
    more = f"; and {len(errors) - _MAX_ERRORS} more" if len(errors) > _MAX_ERRORS else ""
    raise ToolchainError(f"{library}: {_compiler_name(command)} failed: {'; '.join(errors[:_MAX_ERRORS])}{more}")


def _compiler_name(command: list[str]) -> str:
    return "zig" if _is_zig(command) else Path(command[0]).stem
