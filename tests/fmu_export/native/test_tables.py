"""Lookup tables in FMUs: numpy's bits, data in files that are checked, shared by the instances of a process."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from zipfile import ZipFile

import fmpy
import numpy as np
import pytest

from fmu_export import Table, TableError, TraceError, build_native, build_pythonfmu, write_table
from fmu_export.modelling.model import DefaultExperiment, Model
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.native.adjoint_source import adjoint_source
from fmu_export.native.backend import _adapter_sources
from fmu_export.native.c_source import model_sources
from fmu_export.native.toolchain import compile_library, host_target
from fmu_export.package.interface import interface_of
from fmu_export.package.tables import table_members
from fmu_export.trace.trace import trace
from tests.support import CHECKOUT
from tests.support.compilation import shared_compilation

RNG = np.random.default_rng(8)
POINTS = np.linspace(-3.0, 4.0, 2000)
CURVE = Table("curve", POINTS, np.sin(POINTS) + 0.1 * RNG.normal(size=2000))
UNEVEN = Table("uneven", np.cumsum(RNG.uniform(1e-6, 1.0, 17)), RNG.normal(size=17))
STEEP = Table("steep", [-1e-300, 0.0, 1e-300, 1.0, 2.0], [-1e308, 1e308, 1e308, 0.0, -0.0])
TWO = Table("two", [0.5, 2.0], [1.0, -1.0])
MAP = Table("map", np.cumsum(RNG.uniform(0.1, 1.0, 30)), np.linspace(-1.0, 1.0, 41), RNG.normal(size=(30, 41)))
CELL = Table("cell", [0.0, 1.0], [0.0, 3.0], [[1.0, 2.0], [3.0, 5.0]])
ALL = (CURVE, UNEVEN, STEEP, TWO, MAP, CELL)


def model_of(output: Callable, n: int, size: int, name: str = "Lookup") -> Model:
    """A model without states: outputs y (n,) of inputs u (size,)."""
    return Model(
        name=name,
        description="Lookup",
        parameters=Layout([]),
        inputs=Layout([Variable("u", "1", "Places", size=size)]),
        outputs=Layout([Variable("y", "1", "Values", size=n)]),
        states=(),
        initial_state=lambda p: np.zeros(0),
        derivatives=lambda t, x, u, p: np.zeros(0),
        output_values=lambda t, x, u, p: output(u),
        default_experiment=DefaultExperiment(1.0, 0.1),
    )


class Probe:
    """The C of all tables, called for many places at once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        model = model_of(lambda u: np.stack([table(*u[: table.n_variables]) for table in ALL]), len(ALL), 2)
        traced = trace(
            replace(  # what has states and parameters compiles without any warning
                model,
                parameters=Layout([Variable("p", "1", "Parameter")]),
                outputs=Layout([*model.outputs.variables, Variable("x", "1", "State")]),
                states=("x",),
                initial_state=lambda p: p,
                derivatives=lambda t, x, u, p: -x,
                output_values=lambda t, x, u, p: np.append(model.output_values(t, x, u, p), x),
            )
        )
        assert traced.tables == ALL
        sources = _adapter_sources("fmi2", tables=True) | model_sources(traced, interface_of(traced), "{}")
        sources["model_adjoint.c"] = adjoint_source(traced)
        sources["probe.c"] = (CHECKOUT / "tests/support/table_probe.c").read_bytes()
        path = folder / f"probe{host_target().suffix}"
        path.write_bytes(compile_library(sources, "Lookup", strict=True))
        self.library = ctypes.CDLL(str(path))
        for name, content in table_members(ALL).items():
            self.write(name.removeprefix("resources/tables/"), content)

    def write(self, name: str, content: bytes) -> None:
        (self.folder / "tables").mkdir(exist_ok=True)
        (self.folder / "tables" / name).write_bytes(content)

    def open(self, which: int = 0) -> str:
        """Make an instance; what is wrong, or nothing."""
        message = ctypes.create_string_buffer(4096)
        status = self.library.probe_open(which, str(self.folder).encode(), message)
        assert (status == 0) == (message.value == b"")
        return message.value.decode()

    def close(self, which: int = 0) -> None:
        self.library.probe_close(which)

    def __call__(self, table: Table, *where: np.ndarray) -> list[np.ndarray]:
        """Values, and derivatives by each variable."""
        places = [np.ascontiguousarray(w, dtype=float) for w in where]
        results = [np.full(len(places[0]), 1e99) for _ in range(1 + len(where))]
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (*places, *results)]
        function = getattr(self.library, f"probe_{table.n_variables}")
        function(ctypes.c_double(ALL.index(table)), ctypes.c_long(len(places[0])), *pointers)
        return results


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Probe:
    return Probe(tmp_path_factory.mktemp("probe"))


@pytest.fixture
def probe(compiled: Probe):
    """Open tables; whatever a test has written is put back."""
    assert compiled.open() == ""
    yield compiled
    compiled.close()
    for name, content in table_members(ALL).items():
        compiled.write(name.removeprefix("resources/tables/"), content)


def places(points: np.ndarray, n: int = 20_000) -> np.ndarray:
    """Everywhere, at breakpoints, beside them, beyond the ends, at zeros, infinities and NaN."""
    low, high = points[0] - 1.0, points[-1] + 1.0
    special = [-np.inf, np.inf, np.nan, 0.0, -0.0, -1e308, 1e308, 5e-324]
    beside = [points, np.nextafter(points, -np.inf), np.nextafter(points, np.inf)]
    return np.concatenate([RNG.uniform(low, high, n), *beside, special])


@pytest.mark.parametrize("table", [CURVE, UNEVEN, STEEP, TWO], ids=lambda t: t.name)
def test_a_table_over_one_variable_has_the_bits_of_numpy(table: Table, probe: Probe) -> None:
    x = places(table.x)
    values, slopes = probe(table, x)
    with np.errstate(all="ignore"):
        expected = np.interp(x, table.x, table.values)
        assert values.tobytes() == np.where(np.isnan(x), values, expected).tobytes()
        assert np.array_equal(np.isnan(values), np.isnan(expected))
        assert np.array_equal(slopes, table.slopes(x)[0], equal_nan=True)
    assert np.isnan(values).sum() == 1  # and not more, where the slope overflows


@pytest.mark.parametrize("table", [MAP, CELL], ids=lambda t: t.name)
def test_a_table_over_two_variables_has_the_bits_of_numpy(table: Table, probe: Probe) -> None:
    x, y = (RNG.permutation(np.resize(places(points), 30_000)) for points in table.breakpoints)
    values, by_x, by_y = probe(table, x, y)
    with np.errstate(all="ignore"):
        assert np.array_equal(values, table(x, y), equal_nan=True)
        assert np.allclose([by_x, by_y], table.slopes(x, y), rtol=1e-15, atol=0.0, equal_nan=True)


def test_the_bilinear_table_is_that_of_scipy() -> None:
    from scipy.interpolate import RegularGridInterpolator

    x, y = (RNG.uniform(points[0], points[-1], 2000) for points in MAP.breakpoints)
    oracle = RegularGridInterpolator(MAP.breakpoints, MAP.values, method="linear")
    assert np.allclose(MAP(x, y), oracle(np.stack([x, y], axis=1)), rtol=1e-13, atol=1e-14)
    corners = np.meshgrid(*MAP.breakpoints, indexing="ij")
    assert np.array_equal(MAP(*corners), MAP.values)
    beyond = MAP(MAP.x[-1] + 5.0, -7.0)
    assert beyond == MAP.values[-1, 0]


@pytest.mark.parametrize("table", [CURVE, MAP], ids=lambda t: t.name)
def test_slopes_are_central_differences(table: Table) -> None:
    where = [RNG.uniform(points[0] - 0.5, points[-1] + 0.5, 500) for points in table.breakpoints]
    for k, slope in enumerate(table.slopes(*where)):
        h, points = 1e-7, table.breakpoints[k]
        smooth = np.abs(points[:, None] - where[k]).min(axis=0) > 2.0 * h
        ends = [[w + s * h * (i == k) for i, w in enumerate(where)] for s in (-1.0, 1.0)]
        difference = (table(*ends[1]) - table(*ends[0])) / (2.0 * h)
        assert smooth.sum() > 400
        assert np.allclose(slope[smooth], difference[smooth], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("two", None, "two.csv is missing or unreadable"),
        ("two", "", "two.csv, line 1: the file is empty"),
        ("two", "x,y\n0,1\n", "line 2: at least two breakpoints"),
        ("two", "x,y\n0,1\n0,2\n", "breakpoints do not increase"),
        ("two", "x,y\n0,1\n1,abc\n", "line 3: a cell is not a finite number"),
        ("two", "x,y\n0,1\n1,inf\n", "line 3: a cell is not a finite number"),
        ("two", "0,1x\n1,2\n2,3\n", "line 1: a cell is not a finite number"),
        ("two", "x,y\nx,y\n1,2\n2,3\n", "line 2: a cell is not a finite number"),
        ("two", "x,y\n0,1\n1,2,3\n", "line 3: it has not as many cells as the first line"),
        ("two", "x;y\n0;1\n", "line 1: two numbers are needed, separated by a comma"),
        ("cell", "x,y\n0,1\n1,2\n", "line 1: at least three cells are needed"),
        ("cell", "x,0,1\n0,1,2\n", "at least two breakpoints"),
        ("cell", "x,1,0\n0,1,2\n1,2,3\n", "breakpoints do not increase"),
        ("cell", "x,0,\n0,1,2\n1,2,3\n", "line 1: a cell is not a finite number"),
    ],
)
def test_a_file_that_holds_no_table_is_refused(name: str, text: str | None, said: str, probe: Probe) -> None:
    probe.close()
    if text is None:
        (probe.folder / "tables" / f"{name}.csv").unlink()
    else:
        probe.write(f"{name}.csv", text.encode())
    message = probe.open()
    assert said in message
    assert f"{name}.csv" in message
    assert "\n" not in message


@pytest.mark.parametrize(
    "text",
    ["0,1\n1,3\n4,-2", "x,y\r\n0,1\r\n1,3\r\n4,-2\r\n", "\ufeffspeed, torque\n\n 0 , 1.0\n1e0,+3\n  \n4,-2\n"],
    ids=["no headings", "Windows", "spaces and byte order mark"],
)
def test_data_may_change_their_number_and_their_style(text: str, probe: Probe, tmp_path: Path) -> None:
    probe.close()
    probe.write("two.csv", text.encode())
    assert probe.open() == ""
    assert probe(TWO, np.array([-1.0, 0.5, 2.0, 9.0]))[0].tolist() == [1.0, 2.0, 4.0 / 3.0, -2.0]
    (tmp_path / "file.csv").write_bytes(text.encode())
    read = Table.from_file(tmp_path / "file.csv")
    assert read.name == "file"
    assert (read.x.tolist(), read.values.tolist()) == ([0.0, 1.0, 4.0], [1.0, 3.0, -2.0])


def test_instances_share_tables_and_notice_other_data(probe: Probe) -> None:
    assert probe.open(1) == ""
    probe.close(1)
    probe.write("two.csv", b"0,1\n1,2\n")
    assert "two.csv is not what other instances in this process have read" in probe.open(1)
    assert probe(TWO, np.array([2.0]))[0] == TWO(2.0)  # those of the first one
    probe.close()
    assert probe.open() == ""
    assert probe(TWO, np.array([0.5]))[0] == 1.5


def curves(u):
    """From np.interp over constants, from a table with a name, from one over two variables."""
    return np.append(np.interp(u, CURVE.x, CURVE.values) * u, [UNEVEN(u[0]), MAP(u[1], u[2])])


@pytest.mark.parametrize("flavour", ["fmi2", "fmi3"])
def test_an_fmu_has_its_tables_as_files(flavour: str, tmp_path: Path) -> None:
    model = model_of(curves, 5, 3)
    with shared_compilation():
        path = build_native(model, tmp_path, flavour)
    with ZipFile(path) as archive:
        names = archive.namelist()
        assert [n for n in names if n.startswith("resources/tables/")] == [
            f"resources/tables/{name}.csv" for name in ("interp_1", "map", "uneven")
        ]
        assert len(archive.read("sources/model.c")) < 4000
        assert "sources/table.c" in names
    u = np.array([0.3, -1.2, 0.7])
    inputs = np.array([(t, *u) for t in (0.0, 1.0)], dtype=[("time", float), *((f"u[{i}]", float) for i in (1, 2, 3))])

    def computed() -> list[float]:
        result = fmpy.simulate_fmu(str(path), stop_time=0.2, output_interval=0.1, input=inputs)
        return [result[f"y[{i}]"][-1] for i in range(1, 6)]

    assert computed() == curves(u).tolist()
    write_table(path, "uneven", [0.0, 1.0, 2.0], [0.0, 10.0, 10.0])
    assert computed() == [*curves(u)[:3].tolist(), 3.0, curves(u)[4]]


def test_a_derivative_goes_through_tables(tmp_path: Path) -> None:
    with shared_compilation():
        path = build_native(model_of(curves, 5, 3), tmp_path, "fmi2")
    folder = fmpy.extract(str(path))
    description = fmpy.read_model_description(folder)
    slave = fmpy.instantiate_fmu(folder, description, "CoSimulation")
    references = {v.name: v.valueReference for v in description.modelVariables}
    unknowns, knowns = ([references[f"{n}[{i}]"] for i in r] for n, r in (("y", range(1, 6)), ("u", range(1, 4))))
    u = np.array([0.3, 1.7, 0.71])
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.setReal(knowns, u.tolist())
    for k, known in enumerate(knowns):
        found = slave.getDirectionalDerivative(unknowns, [known], [1.0])
        h = 1e-7 * (np.arange(3) == k)
        assert np.allclose(found, (curves(u + h) - curves(u - h)) / 2e-7, rtol=1e-6, atol=1e-8)
    slave.freeInstance()


def test_an_adjoint_derivative_goes_through_tables(probe: Probe) -> None:
    """Of all tables at one place, each alone and all together."""
    u, one = np.array([1.3, 0.4]), np.array([0.5])
    slopes = np.array([(*table.slopes(*u[: table.n_variables]), 0.0)[:2] for table in ALL])
    for weights in [*np.eye(len(ALL)), RNG.normal(size=len(ALL))]:
        sums, all_weights = np.full(4, np.nan), np.concatenate([weights, [0.0, 0.0]])  # of the state, its derivative
        arrays = (one, u, one, all_weights, sums)
        probe.library.probe_adjoint(*(a.ctypes.data_as(ctypes.c_void_p) for a in arrays))
        assert np.allclose(sums[1:3], weights @ slopes, rtol=1e-12, atol=1e-15)


def test_other_data_give_another_fingerprint(tmp_path: Path) -> None:
    guids = set()
    for height in (1.0, 2.0):
        table = Table("table", [0.0, 1.0], [0.0, height])
        with shared_compilation():
            path = build_native(model_of(lambda u, table=table: np.array([table(u[0])]), 1, 1), tmp_path, "fmi2")
        guids.add(fmpy.read_model_description(str(path)).guid)
    assert len(guids) == 2


def test_many_lookups_are_loops() -> None:
    def output(u):
        return np.array([CURVE(v) * 2.0 + UNEVEN(w) for v, w in pairwise(u)])

    traced = trace(model_of(output, 50, 51))
    source = model_sources(traced, interface_of(traced), "{}")["model.c"].decode()
    assert source.count("table_value(0.0, u[i]") == 1
    assert source.count("table_value(1.0, u[1 + i]") == 1


def test_python_fmus_compute_the_same(tmp_path: Path) -> None:
    """Their data stand in the code, which `write_table` does not change."""
    path = build_pythonfmu(model_of(curves, 5, 3), tmp_path)
    with ZipFile(path) as archive:
        (member,) = [n for n in archive.namelist() if n.endswith("equations.py")]
        namespace: dict = {}
        exec(archive.read(member).decode(), namespace)
    for u in RNG.uniform(-4.0, 9.0, (200, 3)):
        assert namespace["outputs"](0.0, [], u.tolist(), []) == curves(u).tolist()
    with pytest.raises(TableError, match=r"no table 'map'; its tables are none"):
        write_table(path, "map", [0.0, 1.0], [0.0, 1.0])


def test_what_write_table_refuses(tmp_path: Path) -> None:
    with shared_compilation():
        path = build_native(model_of(curves, 5, 3), tmp_path, "fmi2")
    before = path.read_bytes()
    for arguments, said in [
        (("none", [0.0, 1.0], [0.0, 1.0]), "no table 'none'; its tables are interp_1, map, uneven"),
        (("map", [0.0, 1.0], [0.0, 1.0]), "table 'map' has 2 variables, not 1"),
        (("uneven", [0.0, 0.0], [0.0, 1.0]), "x does not increase"),
        (("uneven", [0.0, 1.0], [0.0, np.nan]), "not finite"),
    ]:
        with pytest.raises(TableError, match=said):
            write_table(path, *arguments)
    assert path.read_bytes() == before
    (tmp_path / "text.fmu").write_text("no archive")
    with pytest.raises(TableError, match="not an FMU"):
        write_table(tmp_path / "text.fmu", "map", [0.0, 1.0], [0.0, 1.0])


def test_one_name_is_one_table() -> None:
    other = Table("curve", [0.0, 1.0], [0.0, 1.0])
    with pytest.raises(TraceError, match=r"test_tables.py:\d+: two tables with different data have the name 'curve'"):
        trace(model_of(lambda u: np.array([CURVE(u[0]), other(u[0])]), 2, 1))
    again = Table("curve", CURVE.x, CURVE.values)
    assert trace(model_of(lambda u: np.array([CURVE(u[0]), again(u[0])]), 2, 1)).tables == (CURVE,)
