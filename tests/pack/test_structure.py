"""Arrays with sizes by structural parameters, single elements of arrays, and units that differ, in packed systems."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim import System, simulate
from cosim.pack import pack
from tests.support.fmi3_events import state_space
from tests.support.fmi3_gain import build_gain
from tests.support.packed_fmus import VERSIONS, columns, run_in_fmpy
from tests.support.small_fmus import redescribed


@pytest.mark.parametrize("version", VERSIONS)
def test_sizes_of_the_system_hold(tmp_path: Path, version: int) -> None:
    fmu = state_space(tmp_path)
    a = [[-1.0, 0.5], [0.0, -2.0]]
    start = {"m": 1, "n": 2, "r": 1, "A": a, "B": [[1.0], [2.0]], "C": [[1.0, -1.0]], "D": 0.0, "u": 3.0}
    system = System()
    system.add("s", fmu, start=start)
    expected = simulate(system, 1.0, 0.1)
    packed = pack(system, tmp_path / "W.fmu", 0.1, fmi=version)
    assert "s.A[2,2]" in packed.parameters
    assert not any(".m" in name or name == "s.n" for name in packed.parameters)
    assert np.array_equal(run_in_fmpy(packed.path, 1.0, 0.1, packed.outputs), columns(expected, packed.outputs))
    system.components["s"].start["A"][1][1] = -4.0  # type: ignore[index]
    expected = simulate(system, 1.0, 0.1)
    found = run_in_fmpy(packed.path, 1.0, 0.1, packed.outputs, {"s.A[2,2]": -4.0})
    assert np.array_equal(found, columns(expected, packed.outputs))


@pytest.mark.parametrize("version", VERSIONS)
def test_single_elements_of_arrays(tmp_path: Path, version: int) -> None:
    system = System()
    system.add("a", build_gain(tmp_path), start={"u[2]": 5.0})
    system.add("b", tmp_path / "gain.fmu", start={"K": -1.0})
    system.connect("a.y[2]", "b.u[3]")
    expected = simulate(system, 0.3, 0.1)
    packed = pack(system, tmp_path / "W.fmu", 0.1, fmi=version)
    assert {"a.u[1]", "a.u[2]", "b.u[1]"} <= set(packed.inputs)
    assert "b.u[3]" not in packed.inputs
    found = run_in_fmpy(packed.path, 0.3, 0.1, packed.outputs)
    assert np.array_equal(found, columns(expected, packed.outputs))
    assert found[-1, packed.outputs.index("b.y[3]")] == -10.0
    assert found[-1, packed.outputs.index("b.y[1]")] == -1.0  # the start value of its FMU


def test_units_are_converted(small_fmus: dict[str, Path], tmp_path: Path) -> None:
    """A length in m feeds one in mm."""
    metres = '<UnitDefinitions><Unit name="{}"><BaseUnit m="1"{}/></Unit>'
    unit = '<Unit name="1">'
    folder = small_fmus["fmi2"]
    x = redescribed(
        folder / "Integrator.fmu", tmp_path / "i.fmu", {"<UnitDefinitions>": metres.format("m", ""), unit: unit}
    )
    system = System()
    system.add("i", _with_unit(x, tmp_path / "metres.fmu", 'name="x"', "m"), start={"x_start": 2.0, "u": 1.0})
    u = redescribed(
        folder / "Gain.fmu", tmp_path / "g.fmu", {"<UnitDefinitions>": metres.format("mm", ' factor="0.001"')}
    )
    system.add("g", _with_unit(u, tmp_path / "millimetres.fmu", 'name="u[1]"', "mm"))
    system.connect("i.x", "g.u[1]", units="convert")
    expected = simulate(system, 0.3, 0.1)
    packed = pack(system, tmp_path / "W.fmu", 0.1)
    found = run_in_fmpy(packed.path, 0.3, 0.1, packed.outputs)
    assert np.array_equal(found, columns(expected, packed.outputs))
    assert found[0, packed.outputs.index("g.y[1]")] == 4000.0


def _with_unit(fmu: Path, path: Path, variable: str, unit: str) -> Path:
    """A copy whose variable has another unit."""
    import re
    import zipfile

    text = zipfile.ZipFile(fmu).read("modelDescription.xml").decode()
    (element,) = re.findall(rf"<ScalarVariable {re.escape(variable)}.*?</ScalarVariable>", text, flags=re.DOTALL)
    return redescribed(fmu, path, {element: element.replace('unit="1"', f'unit="{unit}"')})
