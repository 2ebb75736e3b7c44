"""Headings of columns: names, and units that stand behind them."""

from __future__ import annotations

import re

#: What many write for the unit one.
_ONES = ("-", "–", "—")

_UNIT = re.compile(r"(?P<name>.*\S)(?:\s*\[(?P<bracket>[^\[\]\s]+)\]|\s+\((?P<parenthesis>[^()\s]+)\))")

#: A name with brackets behind it that have no unit.
_NO_UNIT = re.compile(r"(?P<name>.*\S) \[\]", re.DOTALL)

#: What a unit has and indices, slices and the like do not: a letter, or the sign of one. One letter alone is an index
#: too, but for those that are units.
_CAN_BE_UNIT = re.compile(r"(?!(?![msghdltAKNVWJCFHTSL])[a-zA-Z]$).*([^\W\d_]|[%°‰])")


def name_and_unit(text: str, *, apart: bool = False) -> tuple[str, str]:
    """A name, and the unit that stands behind it in brackets; empty where there is none.

    With `apart` there has to be a space between them: in files of ours, say, whose names may end in brackets.

    >>> name_and_unit("motor.tau [N.m]")
    ('motor.tau', 'N.m')
    >>> name_and_unit("motor.tau[2]")
    ('motor.tau[2]', '')
    >>> name_and_unit("motor.tau[k]")
    ('motor.tau[k]', '')
    >>> name_and_unit("motor.tau[m]"), name_and_unit("motor.tau[m]", apart=True)
    (('motor.tau', 'm'), ('motor.tau[m]', ''))
    >>> name_and_unit("motor.ratio [1]")
    ('motor.ratio', '1')
    >>> name_and_unit("motor.ratio [-]")
    ('motor.ratio', '1')
    >>> name_and_unit("motor.I (A) []")  # says that it has none
    ('motor.I (A)', '')
    """
    if says_none := _NO_UNIT.fullmatch(text):
        return says_none["name"], ""
    found = _UNIT.fullmatch(text)
    unit = (found["bracket"] or found["parenthesis"]) if found else ""
    one = unit in _ONES or text.endswith(" [1]")  # [1] behind a space is the unit one
    if not found or not (one or _CAN_BE_UNIT.match(unit)) or (apart and text[len(found["name"])] != " "):
        return text, ""
    return found["name"], "1" if one else unit


def heading(name: str) -> str:
    """The heading of ours for a name: one that ends as with a unit says that it has none.

    >>> heading("motor.I"), heading("motor.I (A)")
    ('motor.I', 'motor.I (A) []')
    """
    return name if name_and_unit(name, apart=True) == (name, "") else f"{name} []"


def unit_of(text: str) -> str:
    """A unit by the text for it, alone or in brackets."""
    unit = re.sub(r"^[\[(](.*)[\])]$", r"\1", text.strip())
    return "1" if unit in _ONES else unit
