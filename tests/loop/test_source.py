"""The C source of the loop: compilers do not warn of it, and sanitisers find nothing while it runs."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.loop.source import loop_sources
from fmu_export.native.toolchain import TARGETS, Target, compile_library, find_compiler, host_target
from tests.support import CHECKOUT
from tests.support.native_fmus import require_compiler
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
    assert compile_library(loop_sources(), "loop", target, strict=True)


@pytest.mark.parametrize(
    "platform",
    [pytest.param(p, marks=() if p in ("x86_64-windows", "aarch64-linux") else pytest.mark.slow) for p in TARGETS],
)
def test_the_loop_compiles_for_every_platform(platform: str) -> None:
    pytest.importorskip("ziglang", reason="the ziglang package, a clang for all platforms, is not installed")
    assert compile_library(loop_sources(), "loop", TARGETS[platform], strict=True)


#: Runs of all orders and extrapolations, with samples at every point, at jumps and behind cuts, and with components
#: and rows at every so many points.
RUNS = """
import math, sys
from pathlib import Path
import cosim.loop.binding
cosim.loop.binding.LIBRARY = Path(sys.argv[1])
from cosim import System, simulate
import cosim.master.sampling
fmus = Path(sys.argv[2])
for longest in (cosim.master.sampling._LONGEST, 0.0):
    cosim.master.sampling._LONGEST = longest
    for order in ("sequential", "parallel"):
        for coupling in ("hold", "auto"):
            for every in (1, 3):
                system = System()
                system.add("i", fmus / "Integrator.fmu", every=every)
                system.add("g", fmus / "Gain.fmu", start={"K": -1.3})
                system.connect("i.x", "g.u[1]")
                system.connect("g.y[1]", "i.u")
                system.drive("g.u[2]", math.sin, breakpoints=[0.5])
                variables = {"x": 2, "n": int, "on": (bool, 3)}
                system.add_function("f", lambda t, u: (u, 7, [True] * 3), inputs=["u[1..2]"], outputs=variables)
                system.add_function("end", lambda t, *inputs: None, inputs=variables, every=every)
                system.connect("g.y", "f.u")
                for name in variables:
                    system.connect(f"f.{name}", f"end.{name}")
                simulate(system, 3.0, 0.1, order=order, extrapolation=coupling, record_every=every, threads=every)
print("done")
"""


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("source"), "fmi2", GAIN, INTEGRATOR)


def sanitised_runs(folder: Path, fmus: Path, source: bytes) -> subprocess.CompletedProcess[str]:
    """The runs by a loop of this source, in a process whose memory is watched."""
    compiler = find_compiler()
    runtime = subprocess.run([*compiler, "-print-file-name=libasan.so"], capture_output=True, text=True, check=False)
    library = Path(runtime.stdout.strip())
    if sys.platform != "linux" or not library.is_absolute() or not library.exists():
        pytest.skip(f"{compiler[0]} has no address sanitiser that another program could load")
    for name, content in (loop_sources() | {"loop.c": source}).items():
        (folder / name).write_bytes(content)
    options = ["-std=c99", "-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    subprocess.run(
        [*compiler, *options, "-shared", "-fPIC", *sorted(p.name for p in folder.glob("*.c")), "-o", "loop.so"],
        cwd=folder,
        check=True,
    )
    # the sanitiser reserves terabytes of addresses, which a limit on them (ulimit -v) forbids
    unlimited = ["sh", "-c", 'ulimit -S -v "$(ulimit -H -v)"; exec "$@"', "sh"]
    return subprocess.run(
        [*unlimited, "env", f"LD_PRELOAD={library}", sys.executable, "-c", RUNS, str(folder / "loop.so"), str(fmus)],
        cwd=CHECKOUT,
        # Python itself keeps memory to its end; its allocator would hide what is read past an array
        env=os.environ | {"ASAN_OPTIONS": "detect_leaks=0", "PYTHONMALLOC": "malloc"},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )


@pytest.mark.slow
def test_sanitisers_find_nothing(fmus: Path, tmp_path: Path) -> None:
    done = sanitised_runs(tmp_path, fmus, loop_sources()["loop.c"])
    assert done.returncode == 0, done.stderr[-4000:]
    assert done.stdout == "done\n"


@pytest.mark.slow
def test_a_read_past_the_samples_would_be_noticed(fmus: Path, tmp_path: Path) -> None:
    source = loop_sources()["loop.c"]
    right = b"(point - loop->first_sample) * loop->n_samples"
    assert source.count(right) == 1
    done = sanitised_runs(tmp_path, fmus, source.replace(right, b"(point + 1 - loop->first_sample) * loop->n_samples"))
    assert done.returncode != 0
    assert "heap-buffer-overflow" in done.stderr
