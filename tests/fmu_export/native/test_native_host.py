"""The C of the native FMUs under sanitisers and valgrind: hosts call every function in every state and order.

The hosts, native_host_fmi2.c and native_host_fmi3.c, are linked with the sources that an FMU holds.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pytest

from controller_fmu.model import MODEL as CONTROLLER
from fmu_export.modelling.model import Model
from fmu_export.native.backend import _adapter_sources, _model_sources
from fmu_export.package.interface import interface_of
from fmu_export.package.start_values import start_values_text
from fmu_export.trace.trace import trace
from plant_fmu.model import MODEL as PLANT
from tests.support import SUPPORT
from tests.support.hybrid_models import SAMPLED_PI, THERMOSTAT
from tests.support.patience import PATIENCE
from trajectory_fmu.model import MODEL as TRAJECTORY

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="the hosts are built by the options of gcc and clang"),
]

MODELS = {model.name: model for model in (CONTROLLER, TRAJECTORY, PLANT, THERMOSTAT, SAMPLED_PI)}
MODELS |= {solver: replace(CONTROLLER, solver=solver) for solver in ("dopri5", "rodas4")}
FLAVOURS = ("fmi2", "fmi3")
SANITISERS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g"]
STRICT = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror"]

#: Folders of start values that the hosts look for; one that they break, and names that URIs escape.
FOLDERS = ("good", "broken", "a b", "ü", "%zz", "50%")


def run(command: list[str], folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command,
        cwd=folder,
        env=os.environ | {"LC_ALL": "C"} | environment,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=PATIENCE,
        check=False,
    )


class Sources(NamedTuple):
    """Sources of an FMU and its host in a folder; `resources` is the folder that the host takes."""

    folder: Path
    host: Path
    resources: Path
    others: tuple[str, ...]

    def build(self, compiler: str, program: str, options: list[str], model_options: list[str]) -> Path:
        """Compile the host; the model, which needs the most time, has options of its own."""
        common = [compiler, "-std=c99", *options, "-I."]
        for command in (
            [*common, *model_options, "-c", "model.c", "-o", f"{program}.o"],
            [*common, "-O0", *self.others, str(self.host), f"{program}.o", "-o", program, "-lm"],
        ):
            done = run(command, self.folder)
            assert done.returncode == 0, done.stderr
        return self.folder / program

    def walk(self, command: list[str], **environment: str) -> None:
        done = run([*command, str(self.resources)], self.folder, **environment)
        assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-6000:]
        calls = re.search(r"(\d+) calls, \d+ messages, 0 not as expected", done.stdout)
        assert calls, done.stdout
        assert int(calls[1]) > 10_000
        print(done.stdout)


@pytest.fixture(scope="module")
def compiler() -> str:
    for name in ("cc", "gcc", "clang"):
        if found := shutil.which(name):
            return found
    pytest.skip("no C compiler (cc, gcc, clang) on the path")


def write_sources(folder: Path, model: Model, flavour: str) -> Sources:
    traced = trace(model)
    interface = interface_of(traced)
    sources = _adapter_sources(flavour, model.solver, hybrid=not model.is_continuous)
    sources |= _model_sources(traced, interface, flavour, "{the guid}")
    for name, content in sources.items():
        (folder / name).write_bytes(content)
    resources = folder / "resources"
    for name in FOLDERS:
        (resources / name).mkdir(parents=True)
        (resources / name / "start_values.txt").write_bytes(start_values_text(interface))
    host = SUPPORT / f"native_host_{flavour}.c"
    return Sources(folder, host, resources, tuple({n for n in sources if n.endswith(".c")} - {"model.c"}))


@pytest.fixture
def sources(tmp_path: Path, request: pytest.FixtureRequest) -> Sources:
    name, flavour = request.param
    return write_sources(tmp_path, MODELS[name], flavour)


def hosts(models: Iterable[str], always: set[tuple[str, str]]) -> list[object]:
    """Model and flavour of every host; those that are not tried always are slow."""
    return [
        pytest.param((m, f), id=f"{m}-{f}", marks=() if (m, f) in always else pytest.mark.slow)
        for m in models
        for f in FLAVOURS
    ]


#: Both adapters, with a model that has states, one that has none, and one with events.
@pytest.mark.parametrize(
    "sources",
    hosts(
        MODELS,
        {
            (THERMOSTAT.name, "fmi2"),
        },
    ),
    indirect=True,
)
def test_sanitisers_find_nothing(sources: Sources, compiler: str) -> None:
    (sources.folder / "probe.c").write_text("int main(void) { return 0; }\n")
    probe = run([compiler, *SANITISERS, "probe.c", "-o", "probe"], sources.folder)
    leaks = {"ASAN_OPTIONS": "detect_leaks=1" if sys.platform == "linux" else "detect_leaks=0"}
    if probe.returncode or run([str(sources.folder / "probe")], sources.folder, **leaks).returncode:
        pytest.skip(f"{compiler} has no address and undefined-behaviour sanitisers here: {probe.stderr[:200]}")
    # the equations are straight lines without memory of their own
    optimise = "-O0" if sources.folder.joinpath("model.c").stat().st_size > 100_000 else "-O1"
    host = sources.build(compiler, "sanitised", SANITISERS, [optimise])
    sources.walk([str(host)], UBSAN_OPTIONS="print_stacktrace=1", **leaks)


@pytest.mark.slow
@pytest.mark.parametrize("sources", hosts([CONTROLLER.name], {(CONTROLLER.name, "fmi2")}), indirect=True)
def test_valgrind_finds_nothing(sources: Sources, compiler: str) -> None:
    if not shutil.which("valgrind"):
        pytest.skip("valgrind is not installed")
    host = sources.build(compiler, "plain", ["-g"], ["-O1"])
    sources.walk(["valgrind", "--quiet", "--error-exitcode=9", "--leak-check=full", str(host)])


@pytest.mark.slow
@pytest.mark.parametrize("sources", [(CONTROLLER.name, "fmi2")], ids=lambda p: "-".join(p), indirect=True)
def test_decimal_point_of_the_importer_has_no_effect(sources: Sources, compiler: str, tmp_path: Path) -> None:
    locales = tmp_path / "locales"
    locales.mkdir()
    if (
        not shutil.which("localedef")
        or run(["localedef", "-i", "de_DE", "-f", "UTF-8", str(locales / "de_DE.UTF-8")], tmp_path).returncode
    ):
        pytest.skip("localedef can't make a locale with a decimal comma here")
    host = sources.build(compiler, "plain", [], ["-O1"])
    done = run([str(host), str(sources.resources)], tmp_path, LOCPATH=str(locales))
    assert done.returncode == 0, done.stdout
    assert "with a decimal comma" in done.stdout


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("name", MODELS)
def test_sources_are_strict_c99(name: str, flavour: str, compiler: str, tmp_path: Path) -> None:
    sources = write_sources(tmp_path, MODELS[name], flavour)
    files = sorted(path.name for path in tmp_path.glob("*.c"))
    done = run([compiler, *STRICT, "-Wconversion", "-Wshadow", "-fsyntax-only", "-I.", *files], tmp_path)
    assert done.returncode == 0, done.stderr
    done = run([compiler, *STRICT, "-fsyntax-only", "-I.", str(sources.host)], tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_hosts_call_every_function(flavour: str) -> None:
    header = _adapter_sources(flavour)[f"{flavour}Functions.h"].decode()
    functions = re.findall(rf"_Export\s+\w+TYPE\s+({flavour}\w+);", header)
    host = (SUPPORT / f"native_host_{flavour}.c").read_text(encoding="utf-8")
    assert len(functions) > 40
    assert [f for f in functions if f"{f}(" not in host] == []
