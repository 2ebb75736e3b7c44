"""Places of components in SSPs, and the diagram of pages that takes them."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.page.diagram import diagram_section
from tests.support.ssp_files import archive, component, connection, connections, description, elements, read
from tests.support.tiny_models import GAIN, INTEGRATOR
from tests.support.tiny_models import build as build_tiny


def placed(text: str, corners: str, kind: str = "ElementGeometry") -> str:
    """An element with a place, which the schema wants behind connectors and before all else."""
    x1, y1, x2, y2 = corners.split()
    geometry = f'<ssd:{kind} x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}"/>'
    head, end, rest = text.partition("</ssd:Connectors>")
    return f"{head}{end}{geometry}{rest}"


def test_places_are_those_of_the_whole_system_also_of_nested_ones(tmp_path: Path) -> None:
    folder = build_tiny(tmp_path, GAIN, INTEGRATOR)
    fmus = {"gain": folder / "Gain.fmu", "integrator": folder / "Integrator.fmu"}
    tank = placed(component("tank", "integrator", "input u", "output x"), "0 0 50 100")
    # the nested system is 100 wide and 200 high inside, and half as large outside, where it is mirrored
    inner = elements(tank) + connections(connection(".u", "tank.u"), connection("tank.x", ".x"))
    nested = (
        '<ssd:System name="inner"><ssd:Connectors><ssd:Connector kind="input" name="u"/>'
        '<ssd:Connector kind="output" name="x"/></ssd:Connectors>'
        '<ssd:ElementGeometry x1="150" y1="0" x2="100" y2="100"/>'
        f'{inner}<ssd:SystemGeometry x1="0" y1="0" x2="100" y2="200"/></ssd:System>'
    )
    gain = placed(component("gain", "gain", "input u[1]", "output y[1]"), "0 10 40 60")
    system = elements(gain, nested) + connections(
        connection("gain.y[1]", "inner.u"), connection("inner.x", "gain.u[1]")
    )
    found = read(archive(tmp_path / "places.ssp", description(system), fmus))
    assert found.places == {"gain": (0.0, 10.0, 40.0, 60.0), "inner/tank": (150.0, 0.0, 125.0, 50.0)}
    info = {
        "fmus": {name: {} for name in found.places},
        "connections": {c.target: c.source for c in found.system.connections},
    }
    section = diagram_section({**info, "places": found.places})
    assert section is not None
    assert section.data["diagram"]["places"] == {name: list(corners) for name, corners in found.places.items()}
    assert not any("var dagre=" in script for script in section.scripts)


@pytest.mark.parametrize(
    "places",
    [
        {},
        {"a": (0, 0, 10, 10)},  # not of all
        {"a": (0, 0, 10, 10), "b": (5, 5, 15, 15)},  # one covers the other
        {"a": (0, 0, 10, 10), "b": (20, 5, 20, 15)},  # without width
    ],
)
def test_without_usable_places_the_diagram_is_laid_out(places: dict[str, tuple[float, ...]]) -> None:
    section = diagram_section({"fmus": {"a": {}, "b": {}}, "connections": {"b.u": "a.y"}, "places": places})
    assert section is not None
    assert section.data["diagram"]["places"] is None
    assert any("var dagre=" in script for script in section.scripts)
