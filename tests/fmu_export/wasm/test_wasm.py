"""The WebAssembly flavour: the same bits and messages as the native FMU, and the C library that it brings along.

Oracles: the native FMU, by the compiler of this machine; Python's own formatting and remainder.
"""

from __future__ import annotations

import math
import sys
import zlib
from base64 import b64encode
from collections.abc import Mapping
from ctypes import c_int
from pathlib import Path

import numpy as np
import pytest

from fmu_export import ModelClass, ToolchainError, build_native, build_wasm
from fmu_export.modelling.model import Model
from fmu_export.native import toolchain
from fmu_export.native.toolchain import compile_module
from fmu_export.package.interface import interface_of
from fmu_export.trace.trace import trace
from fmu_export.wasm import backend
from fmu_export.wasm.backend import SCRIPT, WasmModel, script, wasm_model
from parallel_robot.models import MODELS, closed_loop_model
from tests.support.browser import chromium
from tests.support.compilation import shared_compilation
from tests.support.example_models import FOLDER, model_of
from tests.support.native_fmus import Host, doubles, require_compiler, unpack
from tests.support.wasm_host import WasmHost, json_of
from tests.support.wasm_models import Swing, Typed

pytest.importorskip("ziglang", reason="nothing here compiles WebAssembly: pip install ziglang")

OK, ERROR = 0, 3


def reals(made: WasmModel, *causalities: str) -> list[str]:
    return [v["name"] for v in made.description["variables"] if v["causality"] in causalities and v["type"] == "real"]


def random_settings(made: WasmModel, rng: np.random.Generator) -> dict[str, float]:
    """Values of all real parameters, near their start values and within their limits."""
    found = {}
    for v in made.description["variables"]:
        if v["causality"] == "parameter" and v["type"] == "real":
            value = v["start"] * rng.uniform(0.9, 1.1) + (v["start"] == 0.0) * rng.uniform(0.0, 0.05)
            found[v["name"]] = float(np.clip(value, v.get("min", -np.inf), v.get("max", np.inf)))
    return found


def native_rows(
    host: Host, start: Mapping[str, float], inputs: dict[str, np.ndarray], recorded: list[str], size: float, n: int
) -> np.ndarray:
    """Rows of the points that a native FMU completes, with inputs that are linear between them."""
    rows: list[list[float]] = []
    host.must(host.call("Reset"))
    host.must(host.set(dict(start)))
    if host.enter() or host.exit():
        return np.array(rows)
    orders = (c_int * len(inputs))(*[1] * len(inputs))
    for i in range(n + 1):
        host.must(host.set({name: float(u[i]) for name, u in inputs.items()}))
        rows.append(host.get(recorded))
        if i < n:
            rates = doubles(float((u[i + 1] - u[i]) / size) for u in inputs.values())
            host.must(host.call("SetRealInputDerivatives", host.vr(list(inputs)), len(inputs), orders, rates))
            if host.step(i * size, size):
                break
    return np.array(rows)


def check_bits(model: type[ModelClass] | Model, folder: Path, size: float, n: int, settings: int, seed: int) -> int:
    """Compare module and native FMU over random settings; returns in how many both went on to the end."""
    require_compiler()
    made = wasm_model(model)
    with shared_compilation():
        fmu = build_native(model, folder, "fmi2", reference=False)
    rng, module, whole = np.random.default_rng(seed), WasmHost(made), 0
    recorded, driven = reals(made, "output", "local"), reals(made, "input")
    with Host(unpack(fmu, folder / "unpacked")) as host:
        for _ in range(settings):
            start = random_settings(made, rng)
            inputs = {name: rng.uniform(-0.1, 0.1, n + 1).cumsum() * 0.1 for name in driven}
            expected = native_rows(host, start, inputs, recorded, size, n)
            said = host.messages[-1] if host.messages else ""
            host.messages.clear()
            rows = np.zeros((0, len(recorded)))
            if module.start(start) == OK and module.call("initialize", 0.0, 0.0) == OK:
                table = np.column_stack(list(inputs.values())) if inputs else None
                rows = module.run(size, n, recorded, table, linear=True)
            assert rows.tobytes() == expected.tobytes()
            whole += len(rows) == n + 1
            assert len(rows) == n + 1 or module.message == said
    return whole


def test_bits_and_messages_of_the_native_fmu(tmp_path: Path) -> None:
    """States, events, samplers, a table, elementary functions, the requirement that ends some of the runs."""
    assert 10 < check_bits(Swing, tmp_path, 0.01, 200, 20, seed=3) <= 20


@pytest.mark.slow
def test_bits_of_the_closed_loop(tmp_path: Path) -> None:
    assert check_bits(closed_loop_model(), tmp_path, 1e-3, 300, 20, seed=4) > 10


IN_BROWSER = """async ([code, settings]) => {
    const model = await load(Uint8Array.from(atob(code), (c) => c.charCodeAt(0)));
    return settings.map(({ start, inputs, n, size, recorded }) => {
        const driven = Object.entries(inputs).map(([name, values]) => [name, Float64Array.from(values)]);
        const given = { start, inputs: Object.fromEntries(driven), linear: true, startTime: 0 };
        const run = model.simulate({ ...given, stopTime: n * size, stepSize: size, record: recorded });
        return [recorded.map((name) => Array.from(run.values[name])), run.error];
    });
}"""


@pytest.mark.slow
def test_bits_of_the_closed_loop_in_a_browser(tmp_path: Path) -> None:
    require_compiler()
    model, size, n = closed_loop_model(), 1e-3, 200
    made = wasm_model(model)
    with shared_compilation():
        fmu = build_native(model, tmp_path, "fmi2", reference=False)
    rng, recorded, driven = np.random.default_rng(9), reals(made, "output", "local"), reals(made, "input")
    settings = []
    for _ in range(20):
        inputs = {name: (rng.uniform(-0.1, 0.1, n + 1).cumsum() * 0.1).tolist() for name in driven}
        start = random_settings(made, rng)
        settings.append({"start": start, "inputs": inputs, "n": n, "size": size, "recorded": recorded})
    with chromium() as browser:
        tab = browser.new_page()
        tab.add_script_tag(content=script(exports=False))
        found = tab.evaluate(IN_BROWSER, [b64encode(made.module).decode(), settings])
    whole = 0
    with Host(unpack(fmu, tmp_path / "unpacked")) as host:
        for setting, (columns, error) in zip(settings, found, strict=True):
            inputs = {name: np.array(values) for name, values in setting["inputs"].items()}
            expected = native_rows(host, setting["start"], inputs, recorded, size, n)
            assert np.array(columns).T.tobytes() == expected.tobytes()
            whole += error is None and len(expected) == n + 1
    assert whole > 10


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_bits_of_the_robot(tmp_path: Path, name: str) -> None:
    assert check_bits(MODELS[name], tmp_path, 1e-3, 100, 20, seed=5) > 10


@pytest.mark.slow
@pytest.mark.parametrize("module", sorted(path.stem for path in FOLDER.glob("*.py")))
def test_bits_of_the_examples(tmp_path: Path, module: str) -> None:
    model = model_of(module).model()
    size = model.default_experiment.step_size
    assert check_bits(model, tmp_path, size, 60, 10, seed=6) > 5


def test_a_module_imports_nothing_and_describes_itself(tmp_path: Path) -> None:
    path = build_wasm(Typed, tmp_path)
    assert path == tmp_path / "Typed.wasm"
    assert (tmp_path / SCRIPT).read_text(encoding="utf-8") == script()
    made = wasm_model(Typed)
    assert path.read_bytes() == made.module
    assert json_of(made.module) == made.description
    assert len(zlib.compress(made.code)) < 8000
    host = WasmHost(made)
    assert host.imports == []
    assert {v["name"]: v["start"] for v in made.description["variables"] if "start" in v} == {
        "n": 3,
        "on": 1,
        "speed": 2,
        "text": 1,
        "level": 0,
    }
    assert host.call("initialize", 0.0, 0.0) == OK
    assert host.set({"level": -2.0}) == OK
    assert host.get("sum").tolist() == [3 + 10 + 200 + 1000 - 2e4]


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ({"n": 2.5}, "'n' is 2.5, which is not a value of its type, integer"),
        ({"on": math.nan}, "the start value of 'on' is nan; it must be a finite number"),
        ({"speed": 4.0}, "'speed' is 4, which is not a value of its type, enumeration"),
    ],
)
def test_start_values_that_are_none_are_refused(typed: WasmModel, start: dict[str, float], message: str) -> None:
    host = WasmHost(typed)
    assert host.start(start) == ERROR
    assert host.message == message


@pytest.fixture(scope="module")
def typed() -> WasmModel:
    return wasm_model(Typed)


def test_what_is_set_is_checked(typed: WasmModel) -> None:
    host = WasmHost(typed)
    assert host.set({"level": 0.5}) == ERROR
    assert "not a value of its type" in host.message
    assert host.call("step", 0.0, 0.1) == ERROR
    assert host.message.startswith("step can't be called in this state")
    assert host.call("set", host.given([99], "<u4"), 1, host.given([1.0])) == ERROR
    assert host.message == "no variable has the value reference 99"


PROBE = b"""
#include "freestanding.h"
static char text[256];
static int print(const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    int n = vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    return n;
}
#define EXPORT(name) __attribute__((export_name(#name)))
EXPORT(text) char *get_text(void) { return text; }
EXPORT(number) int number(double x) { return print("%g %.9g %.17g %.4g", x, x, x, x); }
EXPORT(others) int others(int i) { return print("%d|%lu|%.2s|%s|%c|%%", i, (unsigned long)i, "abc", "", 'x'); }
EXPORT(cut) int cut(void) { return vsnprintf(text, 4, "abcdef", (va_list){0}); }
EXPORT(remainder) double remainder_of(double x, double y) { return fmod(x, y); }
"""


@pytest.fixture(scope="module")
def probe():
    """Functions of the C library, and a function that reads what they wrote."""
    wasmtime = pytest.importorskip("wasmtime", reason="nothing here runs WebAssembly: pip install wasmtime")
    folder = Path(backend.__file__).with_name("c")
    sources = {name: (folder / name).read_bytes() for name in ("freestanding.c", "freestanding.h")}
    store = wasmtime.Store()
    module = wasmtime.Module(store.engine, compile_module({**sources, "probe.c": PROBE}, "probe", strict=True))
    exports = wasmtime.Instance(store, module, []).exports(store)

    def call(name: str, *arguments: float):
        return exports[name](store, *arguments)

    def text() -> str:
        address = call("text")
        return exports["memory"].read(store, address, address + 256).split(b"\0")[0].decode()

    return call, text


def numbers() -> list[float]:
    rng = np.random.default_rng(7)
    sizes = 10.0 ** rng.uniform(-320.0, 308.0, 300)
    few = np.round(rng.uniform(-1e4, 1e4, 300), rng.integers(0, 6))
    halves = [k / 2**e for k in (1, 3, 5, 25, 123456789) for e in range(1, 40)]
    edges = [0.0, -0.0, 5e-324, sys.float_info.max, sys.float_info.min, 1e-4, 9.9999995e-5, 999999.5, 1e17, 0.1, 1e22]
    return [*edges, *halves, *few.tolist(), *sizes.tolist(), *rng.standard_normal(300).tolist(), math.inf, -math.inf]


def test_numbers_in_messages_are_those_of_c(probe) -> None:
    call, text = probe
    for x in numbers():
        n = call("number", x)
        expected = f"{x:g} {x:.9g} {x:.17g} {x:.4g}"
        assert (text(), n) == (expected, len(expected))


def test_other_conversions(probe) -> None:
    call, text = probe
    for i in (0, 7, -120, 2**31 - 1, -(2**31)):
        call("others", i)
        assert text() == f"{i}|{i % 2**32}|ab||x|%"
    assert call("cut") == 6
    assert text() == "abc"


def test_remainders_are_exact(probe) -> None:
    call, _ = probe
    rng = np.random.default_rng(8)
    x, y = (rng.choice([-1.0, 1.0], 300) * 10.0 ** rng.uniform(-323.0, 308.0, 300) for _ in range(2))
    near = rng.uniform(-50.0, 50.0, 300)
    pairs = [*zip(x.tolist(), y.tolist(), strict=True), *zip(near.tolist(), y.tolist(), strict=True)]
    pairs += [(a, b) for a in (0.0, -0.0, 1.5, -1.5, 3 * 5e-324) for b in (1.0, -0.5, 5e-324, math.inf)]
    for a, b in pairs:
        assert math.copysign(1.0, call("remainder", a, b)) == math.copysign(1.0, math.fmod(a, b))
        assert call("remainder", a, b) == math.fmod(a, b)
    assert all(math.isnan(call("remainder", *pair)) for pair in ((1.0, 0.0), (math.inf, 1.0), (1.0, math.nan)))


@pytest.mark.slow
def test_all_sources_compile_without_warnings() -> None:
    for model in (Swing.model(), Typed.model()):
        traced = trace(model)
        assert compile_module(backend.wasm_sources(traced, interface_of(traced)), model.name, strict=True)


def test_without_zig_the_remedy_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(toolchain, "find_spec", lambda name: None)
    with pytest.raises(ToolchainError, match="pip install ziglang"):
        build_wasm(Typed, tmp_path)
    assert list(tmp_path.iterdir()) == []
