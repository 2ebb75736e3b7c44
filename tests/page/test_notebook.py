"""Pages in the cells of notebooks: the diagram of a system, and frames that keep to themselves."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from cosim import Results, System, simulate
from cosim.page.diagram import diagram_section
from cosim.page.notebook import frame
from tests.support.browser import until
from tests.support.html import Elements


def system() -> System:
    made = System()
    made.add("<plant>", "there/Plant.fmu", start={"x": 1.0})
    made.add_function("law", lambda t, y: y, inputs=["y"], outputs=["u"])
    made.connect("<plant>.y[1]", "law.y")
    made.connect("law.u", "<plant>.u")
    made.drive("<plant>.d", lambda t: 0.0)
    return made


def test_a_system_is_shown_as_its_diagram() -> None:
    ((tag, attributes, _),) = Elements(system()._repr_html_() or "").all
    assert tag == "iframe"
    page = attributes["srcdoc"] or ""
    assert Elements(page).open == []
    diagram = json.loads(re.findall(r'<script type="application/json" id="data">(.*?)</script>', page)[0])["diagram"]
    assert diagram["components"] == [
        {"name": "<plant>", "about": "Plant.fmu", "signals": ["<plant>.d"]},
        {"name": "law", "about": "Python function", "signals": []},
    ]
    assert diagram["bundles"] == [
        {"from": "<plant>", "to": "law", "pairs": [["y[1]", "y"]]},
        {"from": "law", "to": "<plant>", "pairs": [["u", "u"]]},
    ]
    assert System()._repr_html_() is None


def test_the_diagram_of_a_run_has_what_functions_drive() -> None:
    made = System()
    made.add_function("law", lambda t, y: y, inputs=["y"], outputs=["u"])
    made.add_function("further", lambda t, u: u, inputs=["u"], outputs=["v"])
    made.connect("law.u", "further.u")
    made.drive("law.y", lambda t: t)
    made.disturb("further.u", lambda t: 0.0)
    section = diagram_section(simulate(made, 1.0, 0.5).info)
    assert section is not None
    found = {c["name"]: c["signals"] for c in section.data["diagram"]["components"]}
    assert found == {"law": ["law.y"], "further": ["further.u"]}


def test_a_page_in_a_frame_is_that_page() -> None:
    page = '<p title="a &amp; b">&quot;"\'</p><script>1 && "2" < 3</script>\n'
    cell = frame(page, 'its "title"')
    ((_, attributes, _),) = Elements(cell).all
    assert attributes["srcdoc"] == page
    assert attributes["title"] == 'its "title"'
    assert "allow-same-origin" not in cell


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_cells_draw_in_a_browser(tabs, tmp_path: Path, width: int, scheme: str) -> None:
    time = np.linspace(0.0, 1.0, 101)
    values = np.column_stack([np.sin((1 + i) * time) for i in range(20)])
    results = Results(time, [f"a.x{i}" for i in range(20)], values, {"parameters": {"a.k": 1.0}})
    page = tmp_path / "notebook.html"
    cells = f"{system()._repr_html_()}{results._repr_html_()}"
    page.write_text(f"<!DOCTYPE html><title>A notebook</title><body>{cells}", encoding="utf-8")
    tab = tabs.open(page, width=width, color_scheme=scheme)
    until(tab, lambda: len(tab.frames) == 3)
    diagram, run = tab.frames[1:]
    until(diagram, "document.querySelectorAll('.diagram .box').length === 2")
    assert diagram.evaluate("document.querySelector('.diagram svg').getBBox().width") > 100
    assert diagram.evaluate("document.documentElement.scrollWidth <= innerWidth")
    until(run, "document.querySelectorAll('[data-drawn]').length > 0")
    assert run.evaluate("document.documentElement.scrollWidth <= innerWidth")
    # a link within the page stays there, where the base of addresses is that of the notebook
    run.evaluate("document.querySelector('nav a[href=\"#parameters\"]').click()")
    until(run, "scrollY > 300")
    assert tab.frames[2].url == "about:srcdoc"
