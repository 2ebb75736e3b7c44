"""The elementary functions that FMUs bring along: right to their last digits, and the same from every compiler.

Oracles: sine and cosine by integers of 400 digits, the others by the platform's own functions, which others wrote.
"""

from __future__ import annotations

import ctypes
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from fmu_export.native.c_source import c_function
from fmu_export.native.elementary import FUNCTIONS, declarations, elementary_sources, licences
from fmu_export.native.toolchain import compile_library, find_compiler, host_target
from tests.support.native_fmus import require_compiler
from tests.support.patience import PATIENCE
from tests.support.zoo import N, all_functions, program

#: Digits of the oracle after the binary point.
BITS = 1400


def arctan_of_inverse(n: int) -> int:
    """arctan(1/n), times 2^BITS."""
    total, term, k = 0, (1 << BITS) // n, 1
    while term:
        total += term // k if k % 4 == 1 else -(term // k)
        term //= n * n
        k += 2
    return total


HALF_PI = 2 * (4 * arctan_of_inverse(5) - arctan_of_inverse(239))  # Machin


def sine_and_cosine(x: float) -> tuple[Fraction, Fraction]:
    """To more than 300 bits after the first that is not zero."""
    numerator, denominator = x.as_integer_ratio()
    angle = (numerator << BITS) // denominator
    quarter, rest = divmod(angle + HALF_PI // 2, HALF_PI)
    rest -= HALF_PI // 2
    sums, term, k = [0, 0], 1 << BITS, 0
    while term:
        sums[k % 2] += term if k % 4 < 2 else -term
        k += 1
        term = term * rest // k >> BITS
    cosine, sine = sums
    turned = [(sine, cosine), (cosine, -sine), (-sine, -cosine), (-cosine, sine)][quarter % 4]
    return Fraction(turned[0], 1 << BITS), Fraction(turned[1], 1 << BITS)


def test_the_oracle_is_right() -> None:
    assert sine_and_cosine(1.0) == pytest.approx((math.sin(1.0), math.cos(1.0)), rel=1e-15)
    sine, cosine = sine_and_cosine(1e300)
    assert float(sine * sine + cosine * cosine - 1) == pytest.approx(0.0, abs=1e-80)
    # Kahan's: of all doubles the one that lies nearest to a multiple of pi/2
    assert float(sine_and_cosine(6381956970095103.0 * 2.0**797)[1]) == pytest.approx(-4.68716592425462761112e-19)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., np.ndarray]:
    """All functions by name, of arrays of numbers."""
    require_compiler()
    functions = all_functions()
    export = '#ifdef _WIN32\n__declspec(dllexport)\n#else\n__attribute__((visibility("default")))\n#endif\n'
    text = declarations(functions) + "".join(export + c_function(f, ("x", "second"), "zoo") for f in functions)
    path = tmp_path_factory.mktemp("elementary") / f"all{host_target().suffix}"
    sources = {"all.c": text.encode(), **elementary_sources(text.encode())}
    path.write_bytes(compile_library(sources, "all", strict=True))
    loaded = ctypes.CDLL(str(path))

    def call(name: str, x: np.ndarray, second: np.ndarray | None = None) -> np.ndarray:
        n = len(x)
        padded = [np.resize(np.asarray(v, dtype=float), (-(-n // N), N)) for v in (x, x if second is None else second)]
        y = np.full_like(padded[0], 7.0)
        for rows in zip(*padded, y, strict=True):
            getattr(loaded, f"zoo_all_{name}")(*(row.ctypes.data_as(ctypes.c_void_p) for row in rows))
        return y.ravel()[:n]

    return call


def angles() -> np.ndarray:
    rng = np.random.default_rng(1)
    multiples = [HALF_PI * int(k) / (1 << BITS) for k in (*range(1, 200), *rng.integers(200, 30_000, 300))]
    large = [float(Fraction(HALF_PI * int(k), 1 << BITS)) for k in rng.integers(30_000, 2**52, 200)]
    return np.array(
        [
            *rng.uniform(-4.0, 4.0, 1000),
            *rng.uniform(-4e4, 4e4, 1000),
            *(rng.choice([-1.0, 1.0], 600) * 10.0 ** rng.uniform(-320.0, 308.0, 600)),
            *multiples,
            *large,
            *(2.0**15, np.nextafter(2.0**15, 0.0), np.nextafter(2.0**15, np.inf)),
            *(6381956970095103.0 * 2.0**797, sys.float_info.max, -sys.float_info.max, 5e-324, 2.2e-308),
        ]
    )


@pytest.mark.parametrize(("name", "which"), [("sin", 0), ("cos", 1)])
def test_sine_and_cosine_are_within_one_unit_of_the_last_place(library, name: str, which: int) -> None:
    x = angles()
    for angle, found in zip(x, library(name, x), strict=True):
        right = sine_and_cosine(float(angle))[which]
        if angle and abs(angle) < 1e-300 and which == 0:  # fewer bits than the oracle has
            assert found == angle
            continue
        error = abs(Fraction(float(found)) - right) / Fraction(math.ulp(float(right)))
        assert error < 1, (angle, found)


def test_sine_and_cosine_of_what_is_no_angle(library) -> None:
    x = np.array([np.inf, -np.inf, np.nan, 0.0, -0.0])
    assert np.isnan(library("sin", x)[:3]).all()
    assert np.isnan(library("cos", x)[:3]).all()
    assert library("sin", x)[3:].tobytes() == np.array([0.0, -0.0]).tobytes()
    assert library("cos", x)[3:].tolist() == [1.0, 1.0]


def test_a_large_angle_leaves_its_neighbours_alone(library) -> None:
    x = np.linspace(0.1, 1.3, N)
    alone = library("sin", x)
    for k in range(N):
        with_large = x.copy()
        with_large[k] = 1e300
        found = library("sin", with_large)
        assert found[k] == pytest.approx(float(sine_and_cosine(1e300)[0]), rel=1e-15)
        assert np.delete(found, k).tolist() == np.delete(alone, k).tolist()


SPECIAL = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    -0.5,
    2.0,
    3.0,
    -3.0,
    np.inf,
    -np.inf,
    np.nan,
    5e-324,
    1e-310,
    1e308,
    709.7,
    -745.0,
]


def of_platform(name: str) -> Callable[..., float]:
    """The platform's function, with IEEE's answers where Python raises."""
    of_numpy = {"acos": "arccos", "asin": "arcsin", "atan": "arctan", "acosh": "arccosh", "asinh": "arcsinh"}
    of_numpy |= {"atanh": "arctanh", "atan2": "arctan2", "pow": "power"}
    special = getattr(np, of_numpy.get(name, name))

    def value(*arguments: float) -> float:
        try:
            return float(getattr(math, name)(*arguments))
        except (ValueError, OverflowError):
            with np.errstate(all="ignore"):
                return float(special(*map(np.float64, arguments)))

    return value


@pytest.mark.parametrize("name", sorted(set(FUNCTIONS.values())))
def test_others_are_those_of_the_platform_but_for_two_units_of_the_last_place(library, name: str) -> None:
    rng = np.random.default_rng(2)
    x = np.concatenate(
        [
            *(rng.uniform(-size, size, 400) for size in (1.0, 30.0, 1e3)),
            rng.choice([-1.0, 1.0], 400) * 10.0 ** rng.uniform(-300.0, 300.0, 400),
            np.repeat(SPECIAL, len(SPECIAL)),
        ]
    )
    two = name in ("atan2", "hypot", "pow")
    second = rng.permutation(x)
    second[-(len(SPECIAL) ** 2) :] = np.tile(SPECIAL, len(SPECIAL))
    of_both = of_platform(name)
    compared = 0
    for *arguments, found in zip(x, *([second] if two else []), library(name, x, second), strict=True):
        expected = of_both(*map(float, arguments))
        if math.isnan(expected) or math.isinf(expected) or expected == 0.0:
            assert np.array_equal(found, expected, equal_nan=True), arguments
            if not math.isnan(expected):
                assert math.copysign(1.0, found) == math.copysign(1.0, expected), arguments
        else:
            assert abs(found - expected) <= 2.0 * math.ulp(expected), arguments
            compared += 1
    assert compared > 300


def test_an_fmu_has_the_files_that_it_needs_and_their_licence() -> None:
    assert elementary_sources(b"") == {}
    sines = elementary_sources(b'#include "sines.h"\n')
    assert list(sines) == ["sines.h"]
    assert licences(sines) == {}
    for f in all_functions():
        sources = elementary_sources(declarations([f]).encode())
        name = f.name().removeprefix("all_")
        assert ("sines.h" if name in ("sin", "cos") else f"{name}.inc") in sources
        assert ("documentation/licenses/musl.txt" in licences(sources)) == (name not in ("sin", "cos"))
        for content in sources.values():  # what one includes is there
            for line in content.decode().splitlines():
                if line.startswith('#include "'):
                    assert line.split('"')[1] in sources, (name, line)


# The same bits everywhere


OPTIONS = ["-std=c99", "-ffp-contract=off", "-fno-math-errno", "-I."]


def build(folder: Path, sources: dict[str, bytes], compiler: list[str], options: list[str]) -> Path:
    folder.mkdir()
    for name, content in sources.items():
        (folder / name).write_bytes(content)
    out = folder / "zoo.exe"
    files = [name for name in sources if name.endswith(".c")]
    libraries = [] if any("windows" in option for option in options) else ["-lm"]
    command = [*compiler, *OPTIONS, *options, *files, "-o", out.name, *libraries]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return out


def printed(*command: str | Path, **environment: str) -> list[str]:
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=PATIENCE, check=False, env=os.environ | environment
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.splitlines()


@pytest.fixture(scope="module")
def sources() -> dict[str, bytes]:
    return program()


@pytest.fixture(scope="module")
def expected(sources: dict[str, bytes], tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """What the program prints without optimisation."""
    require_compiler()
    if Path(find_compiler()[0]).stem.lower() == "cl":
        pytest.skip("the options are those of gcc and clang")
    lines = printed(build(tmp_path_factory.mktemp("zoo") / "plain", sources, find_compiler(), ["-O0"]))
    assert len(lines) == len({line.split()[-1] for line in lines}) > 30
    return lines


@pytest.mark.slow
@pytest.mark.parametrize("optimisation", ["-O2", "-O3 -march=native"])
def test_optimisation_keeps_all_bits(sources, expected, tmp_path: Path, optimisation: str) -> None:
    program = build(tmp_path / "zoo", sources, find_compiler(), optimisation.split())
    assert printed(program) == expected


def run_here(program: Path) -> list[str]:
    return printed(program)


def run_by_qemu(program: Path) -> list[str]:
    emulator = shutil.which("qemu-aarch64")
    assert emulator
    return printed(emulator, program)


def run_by_wasmtime(program: Path) -> list[str]:
    import wasmtime

    output = program.with_suffix(".txt")
    engine = wasmtime.Engine()
    store, linker = wasmtime.Store(engine), wasmtime.Linker(engine)
    configuration = wasmtime.WasiConfig()
    configuration.stdout_file = str(output)
    store.set_wasi(configuration)
    linker.define_wasi()
    instance = linker.instantiate(store, wasmtime.Module.from_file(engine, str(program)))
    start = instance.exports(store)["_start"]
    with suppress(wasmtime.ExitTrap):  # how a program ends
        start(store)  # type: ignore[operator]
    return output.read_text().splitlines()


def run_by_wine(program: Path) -> list[str]:
    wine = next(filter(None, map(shutil.which, ("wine64", "wine", "/usr/lib/wine/wine64"))))
    prefix = program.parent / "prefix"
    return printed(
        wine, program, WINEPREFIX=str(prefix), WINEARCH="win64", WINEDEBUG="-all", WINEDLLOVERRIDES="mscoree=;mshtml="
    )


#: zig's name of a platform, what can run its programs, and how to find out whether it is here.
PLATFORMS = {
    "x86_64-linux-musl": (run_here, lambda: sys.platform == "linux" and os.uname().machine == "x86_64"),
    "aarch64-linux-musl": (run_by_qemu, lambda: shutil.which("qemu-aarch64")),
    "wasm32-wasi": (run_by_wasmtime, lambda: find_spec("wasmtime")),
    "x86_64-windows-gnu": (
        run_by_wine,
        lambda: any(map(shutil.which, ("wine64", "wine", "/usr/lib/wine/wine64"))),
    ),
}


@pytest.mark.slow
@pytest.mark.skipif(find_spec("ziglang") is None, reason="the ziglang package is not installed")
@pytest.mark.parametrize("optimisation", ["-O0", "-O3"])
@pytest.mark.parametrize("platform", PLATFORMS)
def test_other_platforms_compute_the_same_bits(
    sources, expected, tmp_path: Path, platform: str, optimisation: str
) -> None:
    """By another compiler too: zig is clang. The first program for a platform makes its C library, which takes long."""
    run, is_here = PLATFORMS[platform]
    if not is_here():
        pytest.skip(f"nothing here runs programs for {platform}")
    zig = [sys.executable, "-m", "ziglang", "cc"]
    program = build(tmp_path / "zoo", sources, zig, ["-target", platform, optimisation])
    assert run(program) == expected
