"""Values of all types of FMI: exact, converted between types only where that is exact, recorded as what they are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyarrow import parquet

from cosim import Results, SetupError, Simulation, SimulationError, System, simulate
from cosim.results.stored import StoredResults, TableWriter
from tests.support.small_fmus import compiled


@pytest.fixture(scope="module")
def types(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled(tmp_path_factory.mktemp("types"), "fmi3_types")


def carried(types: Path, source: str, target: str, values: Sequence[Any], **connection: float) -> Results:
    """One value a communication point, from the first element of a type to that of another one."""
    system = System()
    system.add("a", types)
    system.add("b", types)
    system.drive(f"a.{source}[1]", lambda t: values[int(t)])
    system.connect(f"a.{source}_out[1]", f"b.{target}[1]", **connection)
    return simulate(system, float(len(values) - 1), 1.0)


EXACT = [
    ("Int8", "Int64", [-128, 127], [-128, 127]),
    ("Int64", "Int8", [-128, 127], [-128, 127]),
    ("UInt64", "Int64", [0, 2**63 - 1], [0, 2**63 - 1]),
    ("Int64", "UInt64", [0, 2**63 - 1], [0, 2**63 - 1]),
    ("UInt64", "UInt8", [0, 255], [0, 255]),
    ("Int64", "Float64", [2**53, -(2**63)], [2.0**53, -(2.0**63)]),
    ("UInt64", "Float64", [2**53 + 2, 2**63], [2.0**53 + 2.0, 2.0**63]),
    ("Int32", "Float32", [2**24, -(2**31)], [2.0**24, -(2.0**31)]),
    ("Boolean", "Int8", [True, False], [1, 0]),
    ("UInt16", "Boolean", [1, 0], [True, False]),
    ("Float64", "Float32", [0.1, 3.4e38], [float(np.float32(0.1)), float(np.float32(3.4e38))]),
]


@pytest.mark.parametrize(("source", "target", "values", "expected"), EXACT)
def test_connections_convert_where_each_value_is_exact(
    types: Path, source: str, target: str, values: list[Any], expected: list[Any]
) -> None:
    found = carried(types, source, target, values)[f"b.{target}_out[1]"].tolist()
    assert found == expected
    assert [type(value) for value in found] == [type(value) for value in expected]


@pytest.mark.parametrize(
    ("source", "target", "value"),
    [
        ("Int32", "Int8", 300),
        ("Int32", "Int8", -129),
        ("Int8", "UInt32", -1),
        ("Int64", "UInt64", -1),
        ("UInt64", "Int64", 2**63),
        ("UInt64", "Int8", 2**64 - 1),
        ("Int64", "Float64", 2**53 + 1),
        ("Int64", "Float64", -(2**63) + 1),
        ("UInt64", "Float64", 2**64 - 1),
        ("Int32", "Float32", 2**24 + 1),
        ("Int8", "Boolean", 2),
        ("Int8", "Boolean", -1),
        ("Float64", "Float32", 3.5e38),
        ("Float64", "Float32", -1e300),
    ],
)
def test_a_value_that_does_not_fit_ends_the_run_with_its_name(
    types: Path, source: str, target: str, value: Any
) -> None:
    with pytest.raises(SimulationError) as failed:
        carried(types, source, target, [0, 1, value, 0])
    assert str(failed.value) == (
        f"b failed at t = 2 s: 'a.{source}_out[1]' = {value!r} does not fit input '{target}[1]' of type {target}"
    )
    assert failed.value.results is not None
    assert failed.value.results.time.tolist() == [0.0, 1.0]


def test_whole_numbers_are_scaled_after_they_became_real_and_reals_before_they_become_shorter(types: Path) -> None:
    r = carried(types, "Int32", "Float64", [3, -4], factor=0.5, offset=1.0)
    assert r["b.Float64_out[1]"].tolist() == [2.5, -1.0]
    r = carried(types, "Float64", "Float32", [1e39, 2e39], factor=1e-39, offset=0.0)
    assert r["b.Float32_out[1]"].tolist() == [1.0, 2.0]
    with pytest.raises(SimulationError, match=r"'a.Float64_out\[1\]' = 1.0 \(times 1e\+39 plus 0.0\) does not fit"):
        carried(types, "Float64", "Float32", [1.0, 1.0], factor=1e39)


# Texts and binary values

TEXTS = ["", "käse", 'a,b;"c"\n', "käse"]
BYTES = [b"", b"\x00\x01", b"\xff" * 200, b"\x00\x01"]


def texts(types: Path) -> System:
    system = System()
    for name in "abc":
        system.add(name, types)
    system.drive("a.String", lambda t: TEXTS[int(t)])
    system.drive("a.Binary", lambda t: BYTES[int(t)])
    system.drive("a.words", lambda t: [TEXTS[int(t)], "x"])
    for name in ("String", "Binary"):
        system.connect(f"a.{name}_out", f"b.{name}")
    system.connect("a.words_out[2]", "b.words[1]")
    system.connect("a.words_out[1]", "b.words[2]")
    return system


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_texts_and_binary_values_are_exchanged_and_recorded(types: Path, order: str) -> None:
    r = simulate(texts(types), 3.0, 1.0, order=order)
    late = order == "parallel"
    assert r["b.String_out"].tolist() == ([TEXTS[0], TEXTS[0], *TEXTS[:2]] if late else TEXTS)
    assert r["b.Binary_out"].tolist() == ([BYTES[0], BYTES[0], *BYTES[:2]] if late else BYTES)
    assert r["b.words_out"].tolist() == [["x", text] for text in ([TEXTS[0], TEXTS[0], *TEXTS[:2]] if late else TEXTS)]
    assert r["c.String_out"].tolist() == ["first"] * 4  # what nothing feeds keeps the value of its FMU
    assert r.types["b.Binary_out"] == "binary"
    assert np.isnan(r.values[:, r.names.index("b.String_out")]).all()


def test_start_values_are_of_the_size_of_their_vector(types: Path) -> None:
    def words(value: Any) -> list[str]:
        system = System()
        system.add("a", types, start={"words": value, "Binary": b"\x01", "Int64[2]": 2**53 + 1})
        r = simulate(system, 1.0, 1.0)
        assert r["a.Binary_out"].tolist() == [b"\x01"] * 2
        assert r["a.Int64_out"].tolist() == [[0, 2**53 + 1]] * 2
        return list(r["a.words_out"][-1])

    assert words(["xyz", "zz"]) == ["xyz", "zz"]
    assert words("xyz") == ["xyz", "xyz"]
    assert words(np.array(["p", "q"])) == ["p", "q"]
    with pytest.raises(Exception, match=r"start value of 'a.words': 3 values were given for 2"):
        words(["a", "b", "c"])


def test_values_are_got_set_and_brought_back_while_stepping(types: Path) -> None:
    system = System()
    system.add("a", types)
    with Simulation(system) as simulation, simulation.start(step_size=1.0) as run:
        run["a.String"], run["a.Binary"], run["a.UInt64"] = "now", b"\x07", [2**64 - 1, 1]
        run["a.words[2]"] = "second"
        assert (run["a.String_out"], run["a.Binary_out"]) == ("now", b"\x07")
        assert run["a.UInt64_out"].tolist() == [2**64 - 1, 1]
        assert run["a.words_out"].tolist() == ["a", "second"]
        run["a.Boolean[1]"] = True
        assert run["a.Boolean_out[1]"] is True
        assert type(run["a.Int8_out[1]"]) is int
        run.step()
        assert run.results["a.String_out"].tolist() == ["now", "now"]


def test_files_have_each_type_and_long_runs_give_the_same(types: Path, tmp_path: Path) -> None:
    system = texts(types)
    system.drive("a.Int64[1]", lambda t: 2**53 + 1 + int(t))
    system.drive("a.Boolean", lambda t: [int(t) % 2, 1])
    record = ["a.Int64_out", "a.Boolean_out", "b.String_out", "b.Binary_out", "a.Float64_out"]
    with Simulation(system, record=record) as simulation:
        r = simulation.run(3.0, 1.0)
        paths = [tmp_path / "long.parquet", tmp_path / "long.csv"]
        with TableWriter(paths, simulation.names, simulation.types) as writer:
            simulation.run(3.0, 1.0, sink=writer)
    for name in ("parquet", "csv", "npz", "mat", "json"):
        r.save(tmp_path / f"r.{name}")
    kinds = [str(field.type) for field in parquet.read_schema(tmp_path / "r.parquet")]
    assert kinds == ["double", "int64", "int64", "bool", "bool", "string", "binary", "double", "double"]
    stored = StoredResults(tmp_path / "r.parquet", r.info)
    for name in r.names:
        assert stored[name].tolist() == r[name].tolist(), name
    assert parquet.read_table(paths[0]).equals(parquet.read_table(tmp_path / "r.parquet"))
    assert paths[1].read_bytes() == (tmp_path / "r.csv").read_bytes()
    assert stored.thinned(2)["b.String_out"].tolist() == TEXTS[::2]
    archive = np.load(tmp_path / "r.npz")
    assert archive["a.Int64_out[1]"].tolist() == [2**53 + 1 + i for i in range(4)]
    assert archive["b.Binary_out"].tolist() == [value.hex() for value in BYTES]
    assert '"käse"' in (tmp_path / "r.csv").read_text(encoding="utf-8")
    assert "b.String_out" in repr(r).replace("String_out", "b.String_out")
    assert "käse" in r._repr_html_()


@pytest.mark.parametrize("text", ["a\0b", "\0", "\udc80"])
def test_texts_that_c_would_cut_or_can_not_have_are_refused(types: Path, text: str) -> None:
    system = System()
    system.add("a", types, start={"String": text})
    with pytest.raises(SetupError, match=r"start value of 'a\.String': .* has a character that no FMU can take"):
        Simulation(system)
    system = System()
    system.add("a", types)
    system.drive("a.String", lambda t: "good" if t < 1.0 else text)
    with pytest.raises(SimulationError, match=r"a failed at t = 1 s: the signal that feeds 'a\.String' gives .*String"):
        simulate(system, 2.0, 1.0)
