"""Controls of a page, as HTML: sliders where a value has both limits, else fields, switches and choices."""

from __future__ import annotations

import re
from collections.abc import Mapping
from html import escape
from math import log10
from typing import Any

_POWERS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

#: A range from this factor on gets a slider with a logarithmic scale.
_WIDE = 1000.0


def control(variable: Mapping[str, Any], about: str | None = None) -> str:
    """A control of a value, which scripts find by the name of its variable.

    Parameters
    ----------
    variable : mapping
        As the description of a module has it: name, type, unit, description, start, min, max, items.
    about : str, optional
        HTML of its label; by default name, unit and description.
    """
    name, start = variable["name"], variable["start"]
    identifier = f"control-{name}"
    unit = variable.get("unit", "1")
    text = about if about is not None else _label(variable)
    if variable.get("type", "real") in ("integer", "boolean", "enumeration", "string"):
        start = int(start)
    inner = _input(variable, identifier, start, text)
    label = f'<label for="{escape(identifier)}">{text}</label>'
    if variable.get("type") == "boolean":
        label, inner = "", f'<label class="check">{inner}<span>{text}</span></label>'
    said = "" if unit == "1" else escape(shown_unit(unit))
    data = f'data-name="{escape(name)}" data-start="{start!r}" data-unit="{said}"'
    return f'<div class="control" {data}>{label}{inner}</div>'


def has_slider(variable: Mapping[str, Any]) -> bool:
    """Whether a value has a slider: a number with both limits."""
    return variable.get("type", "real") in ("real", "integer") and "min" in variable and "max" in variable


def _label(variable: Mapping[str, Any]) -> str:
    about = variable.get("description", "")
    small = f"<small> {escape(about)}</small>" if about else ""
    return f"<b>{escape(variable['name'])}</b>{in_unit(variable.get('unit', '1'))}{small}"


def in_unit(unit: str) -> str:
    """A unit behind a name, as HTML."""
    return "" if unit in ("", "1") else f" ({escape(shown_unit(unit))})"


def shown_unit(unit: str) -> str:
    """A unit for people: N.m/s2 as N·m/s²."""
    raised = re.sub(r"(?<=[A-Za-z])-?\d+", lambda power: power[0].translate(_POWERS), unit)
    return raised.replace(".", "·")


def _input(variable: Mapping[str, Any], identifier: str, start: float, about: str) -> str:
    named = f'id="{escape(identifier)}"'
    kind = variable.get("type", "real")
    if kind == "boolean":
        return f'<input type="checkbox" {named}{" checked" if start else ""}>'
    if "items" in variable:
        options = "".join(
            f'<option value="{number}"{" selected" if number == start else ""}>{escape(text)}</option>'
            for text, number in variable["items"]
        )
        return f"<select {named}>{options}</select>"
    if not has_slider(variable):
        step = "1" if kind == "integer" else "any"
        return f'<input type="number" {named} value="{start!r}" step="{step}">'
    low, high = float(variable["min"]), float(variable["max"])
    step = "1" if kind == "integer" else "any"
    log = step == "any" and low > 0.0 and high / low >= _WIDE
    label = escape(f"{re.sub('<[^>]*>', '', about)}, as a number", quote=True)
    ends = _ends(low, high, log)
    return (
        f'<div class="pair"><input type="range" {named} {ends} step="{step}"{" data-log" if log else ""}>'
        f'<input type="number" aria-label="{label}" value="{start!r}" step="{step}"></div>'
    )


def _ends(low: float, high: float, log: bool) -> str:
    least, most = (log10(low), log10(high)) if log else (low, high)
    return f'min="{least!r}" max="{most!r}"'
