"""Integers, Booleans, enumerations and strings as parameters, inputs and outputs."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Sequence
from ctypes import c_bool, c_char_p, c_int32, c_int64
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import fromstring

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from cosim import System, simulate
from cosim.__main__ import main as cosim_main
from fmu_export import ArgumentError, CompositionError, build_native, build_pythonfmu, compose, write_start_values
from fmu_export.errors import DocumentationError
from fmu_export.modelling.model import DefaultExperiment, Model, Sampled
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.package.references import Reference
from fmu_export.package.start_values import StartValueError
from tests.support.native_fmus import ERROR, FLAVOURS, OK, Host, Refused, unpack
from tests.support.typed_model import KINDS, TEXTS, TYPED

BOTH = pytest.mark.parametrize("flavour", FLAVOURS)


@pytest.fixture(scope="module", params=FLAVOURS)
def fmu(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_native(TYPED, tmp_path_factory.mktemp(request.param), request.param)


@pytest.fixture(scope="module")
def folder(fmu: Path) -> Path:
    return unpack(fmu, fmu.parent / "unpacked")


def kinds(host: Host) -> dict[str, tuple[str, Any]]:
    """Function and C type of each type of variable."""
    if host.version == 2:
        integer = ("Integer", c_int32)
        return {
            "integer": integer,
            "enumeration": integer,
            "boolean": ("Boolean", c_int32),
            "string": ("String", c_char_p),
        }
    return {
        "integer": ("Int32", c_int32),
        "enumeration": ("Int64", c_int64),
        "boolean": ("Boolean", c_bool),
        "string": ("String", c_char_p),
    }


def put(host: Host, kind: str, values: dict[str | int, Any]) -> int:
    name, c_type = kinds(host)[kind]
    n = len(values)
    array = (c_type * n)(*(v.encode() if isinstance(v, str) else v for v in values.values()))
    return host.call(f"Set{name}", host.vr(list(values)), n, array, *host._extra(n))


def ask(host: Host, kind: str, names: Sequence[str | int]) -> tuple[int, list[Any]]:
    name, c_type = kinds(host)[kind]
    n = len(names)
    array = (c_type * n)()
    status = host.call(f"Get{name}", host.vr(names), n, array, *host._extra(n))
    return status, [v.decode() if isinstance(v, bytes) else v for v in array]


def test_descriptions_say_types_items_and_variability(fmu: Path) -> None:
    assert validate_fmu(str(fmu)) == []
    found = {v.name: v for v in fmpy.read_model_description(str(fmu)).modelVariables}
    kinds_of = {n: v.type for n, v in found.items()}
    integer, real = ("Integer", "Real") if "fmi2" in str(fmu) else ("Int32", "Float64")
    assert kinds_of | {"der(x)": real, "time": real} == {
        **dict.fromkeys(["n", "N[1]", "N[2]", "level", "half", "count"], integer),
        **dict.fromkeys(["flag", "on", "not_on"], "Boolean"),
        **dict.fromkeys(["speed", "kind", "kind_seen"], "Enumeration"),
        **dict.fromkeys(["label", "text", "text_seen"], "String"),
        **dict.fromkeys(["max_step", "u", "x", "y", "der(x)", "time"], real),
    }
    assert {n: found[n].start for n in ("n", "flag", "speed", "label", "N[2]", "on", "level", "kind", "text")} == {
        "n": "3",
        "flag": "true",
        "speed": "2",
        "label": "b & c",
        "N[2]": "-5",
        "on": "false",
        "level": "-2",
        "kind": "-1",
        "text": "plain",
    }
    assert (found["n"].min, found["n"].max) == ("1", "9")
    items = {n: [(i.name, int(i.value)) for i in found[n].declaredType.items] for n in ("speed", "kind", "kind_seen")}
    assert items == {
        "speed": [("off", 1), ("slow", 2), ("fast", 3)],
        "kind": list(KINDS.items()),
        "kind_seen": list(KINDS.items()),
    }
    variability = {n: found[n].variability for n in ("n", "flag", "on", "text", "half", "text_seen", "count", "u", "y")}
    assert variability == {
        "n": "tunable",
        "flag": "fixed",
        **dict.fromkeys(["on", "text", "half", "text_seen", "count"], "discrete"),
        **dict.fromkeys(["u", "y"], "continuous"),
    }
    assert "one of 'plain', 'b & c'" in found["label"].description


def in_initialization(host: Host, call: Callable[[Host], int]) -> int:
    host.must(host.enter())
    return call(host)


def test_values_are_set_and_got(folder: Path) -> None:
    with Host(folder) as host:
        assert put(host, "integer", {"n": 7}) == OK
        assert put(host, "enumeration", {"speed": 3, "kind": 7}) == OK
        assert put(host, "boolean", {"flag": False, "on": True}) == OK
        assert put(host, "string", {"label": TEXTS[2], "text": TEXTS[2]}) == OK
        assert put(host, "integer", {"level": -8, "N[1]": 1}) == OK
        host.run_up()
        assert ask(host, "integer", ["n", "level", "half", "count", "N[2]", "N[1]"]) == (OK, [7, -8, -4, 7, -5, 1])
        assert ask(host, "boolean", ["flag", "on", "not_on"]) == (OK, [False, True, False])
        assert ask(host, "enumeration", ["speed", "kind_seen"]) == (OK, [3, 7])
        assert ask(host, "string", ["label", "text_seen"]) == (OK, [TEXTS[2], TEXTS[2]])
        assert host.get(["x", "y"]) == [1.0, 7.0 + 20.0 + 100.0 - 5000.0]
        host.must(host.step(0.0, 0.5))
        assert host.get(["x"]) == [pytest.approx(np.exp(-1.0), rel=1e-10)]
        assert put(host, "integer", {"n": 9}) == OK  # tunable
        assert ask(host, "integer", ["count"]) == (OK, [9])


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda h: put(h, "enumeration", {"kind": 0}), "'kind' is 0, which is not a value of its type, enumeration"),
        (lambda h: put(h, "enumeration", {"kind": 7, "speed": 4}), "'speed' is 4, which is not a value of its type"),
        (lambda h: put(h, "string", {"text": "else"}), "'text' can't be 'else'; set one of its texts, such as 'plain'"),
        (lambda h: put(h, "boolean", {"u": True}), "'u' is of type real"),
        (lambda h: put(h, "integer", {"on": 1}), "'on' is of type Boolean"),
        (lambda h: put(h, "string", {"kind": "low"}), "'kind' is of type enumeration"),
        (lambda h: put(h, "integer", {"half": 1}), "'half' is computed and can't be set"),
        (lambda h: put(h, "integer", {999: 1}), "'time' is of type real"),
        (lambda h: h.set({"level": 1.0}), "'level' is of type integer"),
        (lambda h: h.set({"u": 1.0, "on": 1.0}), "'on' is of type Boolean"),
        (lambda h: h.try_get(["half"])[0], "'half' is of type integer"),
        (lambda h: ask(h, "boolean", ["half"])[0], "'half' is of type integer"),
        (lambda h: ask(h, "integer", ["text"])[0], "'text' is of type string"),
    ],
)
def test_what_is_no_value_of_a_variable_is_refused(folder: Path, call: Callable[[Host], int], said: str) -> None:
    with Host(folder) as host:
        assert host.tried(lambda: in_initialization(host, call)) == ERROR
        assert said in host.messages[-1]
        host.run_up()  # nothing was set
        assert ask(host, "enumeration", ["kind"]) == (OK, [-1])
        assert ask(host, "string", ["text"]) == (OK, ["plain"])


def test_limits_of_integers_and_fixed_parameters(folder: Path) -> None:
    with Host(folder) as host:
        assert put(host, "integer", {"n": 10}) == OK
        host.must(host.enter())
        assert host.exit() == ERROR
        assert "parameter 'n' is 10; it must be between 1 and 9" in host.messages[-1]
    with Host(folder) as host:
        host.run_up()
        assert put(host, "boolean", {"flag": False}) == ERROR
        assert "parameter 'flag' is fixed after the initialisation" in host.messages[-1]


def test_an_output_that_is_no_value_of_its_type_is_an_error(folder: Path) -> None:
    with Host(folder) as host:
        assert put(host, "integer", {"level": 3}) == OK
        host.run_up()
        assert ask(host, "integer", ["half"])[0] == ERROR
        assert host.messages[-1] == "'half' is 1.5, which is not a value of its type, integer"


def test_discrete_inputs_have_no_derivatives_and_change_at_events(folder: Path) -> None:
    with Host(folder, "ModelExchange") as host:
        host.run_up()
        assert put(host, "boolean", {"on": True}) == OK  # event mode
        host.continuous()
        assert host.tried(lambda: put(host, "boolean", {"on": False})) == ERROR
        assert host.messages[-1] == "input 'on' is discrete and can't be set now; set it in event mode"
        assert ask(host, "boolean", ["not_on"]) == (OK, [False])
        assert host.direction(["der(x)"], {"x": 1.0}) == (OK, [-1.0])
        assert host.direction(["y"], {"u": 1.0}) == (OK, [1.0])
        status, _ = host.direction(["y"], {"level": 1.0})
        assert status == ERROR
        status, _ = host.direction(["half"], {"u": 1.0})
        assert status == ERROR
    if host.version == 2:
        with Host(folder) as host:
            host.run_up()
            assert host.tried(lambda: host.set_rates({"level": 1.0})) == ERROR
            assert host.messages[-1] == "input 'level' is discrete and has no derivative to set"
            assert host.set_rates({"u": 1.0}) == OK


def test_start_values_are_data_of_their_type(fmu: Path, tmp_path: Path) -> None:
    copy = tmp_path / "Typed.fmu"
    copy.write_bytes(fmu.read_bytes())
    write_start_values(copy, {"n": 5, "flag": False, "speed": "fast", "label": TEXTS[2], "N[1]": -1})
    assert validate_fmu(str(copy)) == []
    found = {v.name: v.start for v in fmpy.read_model_description(str(copy)).modelVariables}
    assert [found[n] for n in ("n", "flag", "speed", "label", "N[1]", "N[2]")] == [
        "5",
        "false",
        "3",
        TEXTS[2],
        "-1",
        "-5",
    ]
    with Host(unpack(copy, tmp_path / "unpacked")) as host:
        host.run_up()
        assert ask(host, "integer", ["n", "N[1]"]) == (OK, [5, -1])
        assert ask(host, "boolean", ["flag"]) == (OK, [False])
        assert ask(host, "enumeration", ["speed"]) == (OK, [3])
        assert ask(host, "string", ["label"]) == (OK, [TEXTS[2]])
    before = copy.read_bytes()
    for values, said in (
        ({"n": 1.5}, "start value of 'n' is 1.5, which is not a whole number of 32 bits"),
        ({"n": 10}, r"start value 10 of 'n' is outside \[1.0, 9.0\]"),
        ({"flag": 2}, "start value of 'flag' is 2, which is neither true nor false"),
        ({"speed": "warp"}, "start value of 'speed' is 'warp'; it must be one of 'off', 'slow', 'fast'"),
        ({"speed": 0}, "start value of 'speed' is 0; its items are off = 1, slow = 2, fast = 3"),
        ({"label": "else"}, "start value of 'label' is 'else'; it must be one of 'plain'"),
    ):
        with pytest.raises(StartValueError, match=said):
            write_start_values(copy, values)  # type: ignore[arg-type]
        assert copy.read_bytes() == before


@pytest.mark.parametrize(
    "line", ["flag = maybe", "speed = 4", "speed = slow", "label = else", "n = 2.5", "n = ", "n = 3x"]
)
def test_start_values_that_are_none_are_refused(folder: Path, tmp_path: Path, line: str) -> None:
    resources = tmp_path / "resources"
    resources.mkdir()
    text = (folder / "resources" / "start_values.txt").read_text(encoding="utf-8")
    name = line.split(" = ", maxsplit=1)[0]
    lines = [line if old.startswith(f"{name} = ") else old for old in text.splitlines()]
    (resources / "start_values.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    where = resources.as_uri() if (folder / "sources" / "fmi2.c").exists() else str(resources)
    with pytest.raises(Refused, match=f"start values can't be read: '{line}' in .* is not 'name = value'"):
        Host(folder, resources=where)


@BOTH
def test_the_master_and_fmpy_run_it(tmp_path: Path, flavour: str) -> None:
    fmu = build_native(TYPED, tmp_path, flavour)  # type: ignore[arg-type]
    system = System()
    system.add("a", fmu, start={"level": 6, "on": True, "kind": 7, "text": TEXTS[1], "speed": 1})
    system.add("b", fmu)
    for source, target in (
        ("half", "level"),
        ("not_on", "on"),
        ("kind_seen", "kind"),
        ("text_seen", "text"),
        ("y", "u"),
    ):
        system.connect(f"a.{source}", f"b.{target}", units="ignore")
    results = simulate(system, 0.2, 0.1)
    assert list(results["b.level"]) == [3, 3, 3]
    assert list(results["b.not_on"]) == [True, True, True]
    assert list(results["b.text_seen"]) == [TEXTS[1]] * 3
    assert [int(v) for v in results["b.kind_seen"]] == [7, 7, 7]
    assert list(results["a.x"]) == [2.0, 2.0, 2.0]  # off
    for kind in ("CoSimulation", "ModelExchange"):
        got = fmpy.simulate_fmu(
            str(fmu),
            stop_time=0.2,
            start_values={"level": 6, "on": True, "speed": 3},
            output=["half", "not_on", "x"],
            fmi_type=kind,
        )
        assert set(got["half"]) == {3}
        assert set(got["not_on"]) == {False}
        assert got["x"][-1] == pytest.approx(2.0 * np.exp(-0.4), rel=1e-4)


def test_the_pythonfmu_flavour_refuses_them(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="Typed: 'n' is of type integer; the pythonfmu flavour takes reals only, "):
        build_pythonfmu(TYPED, tmp_path)


def test_composed_models_connect_equal_types_only(tmp_path: Path) -> None:
    connections = [("a.half", "b.level"), ("a.text_seen", "b.text"), ("a.kind_seen", "b.kind")]
    whole = compose("Whole", "", {"a": TYPED, "b": TYPED}, connections, DefaultExperiment(1.0, 0.1))
    fmu = build_native(whole, tmp_path, "fmi3")
    start = {"a.level": 8, "a.text": TEXTS[1], "a.speed": 3}
    result = fmpy.simulate_fmu(str(fmu), stop_time=0.1, start_values=start, output=["b.half", "b.kind_seen"])
    assert set(result["b.half"]) == {2}
    with pytest.raises(CompositionError, match="the types differ: integer and boolean"):
        compose("Whole", "", {"a": TYPED, "b": TYPED}, [("a.half", "b.on")], DefaultExperiment(1.0, 0.1))


def test_sources_of_models_of_reals_have_no_types(tmp_path: Path) -> None:
    from tests.support.tiny_models import LAG

    with zipfile.ZipFile(build_native(LAG, tmp_path, "fmi2")) as archive:
        assert b"model_types" not in archive.read("sources/model.c") + archive.read("sources/model.h")
        assert fromstring(archive.read("modelDescription.xml")).find("TypeDefinitions") is None


@BOTH
def test_they_run_as_the_reference_says_that_they_bring_along(tmp_path: Path, flavour: str) -> None:
    inputs = {"on": True, "level": 4, "kind": "high"}
    reference = Reference(inputs, {"speed": "fast", "label": TEXTS[2], "n": 5, "flag": False})
    fmu = build_native(TYPED, tmp_path, flavour, reference=reference)  # type: ignore[arg-type]
    assert cosim_main(["validate", "--run", str(fmu)]) == 0
    with pytest.raises(DocumentationError, match=r"Typed: reference: parameter 'speed': .* is 'warp'; it must be"):
        build_native(TYPED, tmp_path, flavour, reference=Reference({}, {"speed": "warp"}))  # type: ignore[arg-type]
    with pytest.raises(DocumentationError, match="input 'text' is a string, which stimuli don't hold"):
        build_native(TYPED, tmp_path, flavour, reference=Reference({"text": "plain"}))  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_model_with_events_and_arrays_brings_its_reference(tmp_path: Path) -> None:
    hybrid = Model(
        name="Counters",
        parameters=Layout([Variable("gain", size=(2, 2), start=1.0)]),
        outputs=Layout([Variable("count", type="integer", size=2), Variable("label", type="string", items=("a", "b"))]),
        discrete=Layout([Variable("count", type="integer", size=2)]),
        sampled=[Sampled("tick", lambda t, x, z, u, p: z + np.array([1.0, 2.0]), 0.02)],
        output_values=lambda t, x, z, u, p: np.concatenate([z, np.minimum(z[:1], 1.0)]),
    )
    for arrays in (False, True):
        fmu = build_native(hybrid, tmp_path, "fmi3", arrays=arrays)
        assert cosim_main(["validate", "--run", str(fmu)]) == 0
        with zipfile.ZipFile(fmu) as archive:
            rows = archive.read("extra/org.fmi-standard.fmi-ls-ref/results.csv").decode().splitlines()
        assert rows[0] == '"time","count[1]","count[2]"'
        assert rows[5] == "0.04,3,6"
