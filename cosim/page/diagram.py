"""The diagram of a system: components, and the connections between them in bundles; as a section, or as a page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import combinations
from typing import Any

from cosim.page.document import Section, asset, document

#: More components than this make no picture.
_MOST_COMPONENTS = 400


def diagram_page(info: Mapping[str, Any]) -> str | None:
    """A page with nothing but the diagram of a system; None where there is none to draw."""
    section = diagram_section(info)
    if section is None:
        return None
    return document("System", "", [section], styles=[asset("page.css")], scripts=[asset("theme.js")])


def diagram_section(info: Mapping[str, Any]) -> Section | None:
    """The diagram of a system; None where its connections are not known.

    Parameters
    ----------
    info : mapping
        As results have it: `fmus`, `functions`, `connections` (target -> source), `inputs_driven`, `signals`, `places`.
    """
    bundles: dict[tuple[str, str], list[list[str]]] = {}
    fmus = [*info.get("fmus", {}), *info.get("functions", {})]
    for target, source in info.get("connections", {}).items():
        ends = _component(source, fmus), _component(target, fmus)
        bundles.setdefault(ends, []).append([source.removeprefix(f"{ends[0]}."), target.removeprefix(f"{ends[1]}.")])
    driven: dict[str, list[str]] = {}
    for target in dict.fromkeys(
        target for key in ("inputs_driven", "signals", "disturbances", "breakpoints") for target in info.get(key, ())
    ):
        driven.setdefault(_component(target, fmus), []).append(target)
    components = list(dict.fromkeys([*fmus, *(c for ends in bundles for c in ends)]))
    if not components or len(components) > _MOST_COMPONENTS or not (bundles or driven or len(components) > 1):
        return None
    data = {
        "components": [
            {"name": name, "about": _about(info, name), "signals": driven.get(name, [])} for name in components
        ],
        "bundles": [{"from": a, "to": b, "pairs": pairs} for (a, b), pairs in bundles.items()],
        "places": _usable(info.get("places"), components),
    }
    many = f"{len(components)} component{'s' * (len(components) != 1)}"
    n = sum(map(len, bundles.values()))
    html = f"""<p class="hint">{many}, {n} connection{"s" * (n != 1)}. An arrow stands for all connections from one
component to another; choose an arrow or a component to see them.</p>
<div class="diagram wide" role="group" aria-label="Diagram of the system"></div>
<div class="chosen" role="status"></div>"""
    scripts = [asset("diagram.js")] if data["places"] else [asset("dagre/dagre.min.js"), asset("diagram.js")]
    return Section("system", "System", html, scripts=scripts, data={"diagram": data})


def _component(path: str, known: Iterable[str]) -> str:
    """The component of `component.variable`; its name may have points."""
    for name in known:
        if path.startswith(f"{name}."):
            return name
    return path.partition(".")[0]


def _about(info: Mapping[str, Any], name: str) -> str:
    fmu = info.get("fmus", {}).get(name)
    if fmu is None:
        return "Python function" if name in info.get("functions", {}) else ""
    path = str(fmu.get("path", ""))
    return path.rpartition(": ")[2].replace("\\", "/").rpartition("/")[2]  # of one in an archive: behind its name


def _usable(places: Any, components: list[str]) -> Mapping[str, Any] | None:
    """Places of all components, if each has one and none covers another."""
    if not isinstance(places, Mapping) or not places.keys() >= set(components):
        return None
    boxes = [
        (min(x1, x2), min(y1, y2), max(x1, x2), max(y1, y2)) for x1, y1, x2, y2 in (places[name] for name in components)
    ]
    if any(left >= right or bottom >= top for left, bottom, right, top in boxes):
        return None
    apart = all(a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1] for a, b in combinations(boxes, 2))
    return {name: list(places[name]) for name in components} if apart else None
