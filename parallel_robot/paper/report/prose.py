"""Plain text, numbers and tables, set for the page: symbols, powers of ten, subscripts."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape

_GREEK = {
    "alpha": "α",
    "beta": "β",
    "delta": "δ",
    "gamma": "γ",
    "lambda": "λ",
    "mu": "μ",
    "nu": "ν",
    "omega": "ω",
    "phi": "φ",
    "pi": "π",
    "psi": "ψ",
    "rho": "ρ",
    "tau": "τ",
    "theta": "θ",
    "zeta": "ζ",
    "chi": "χ",
    "Gamma": "Γ",
    "Lambda": "Λ",
    "Pi": "Π",
}

#: A symbol is a Greek name or one letter; longer words with an underscore are names of variables, and stay.
_SYMBOL = re.compile(r"(?<![A-Za-z_])(" + "|".join(_GREEK) + r")(?![a-z])")

_INDEX = re.compile(r"(?<!\w)([A-Za-zΓΛΠα-ω])_([A-Za-z0-9]{1,3}(?:_min|_max)?)(?:\[(\d)\])?(?!\w)")

_POWER = re.compile(r"(?<=[\w)|])\^(?:\(([^()]+)\)|(-?\d+|[Tmn]\b))")

_EXPONENT = re.compile(r"(?<![\w.])(-?\d+(?:\.\d+)?)e([+-]?\d+)(?!\w)")

_MINUS = re.compile(r"(?<![\w)\].])-(?=[\dα-ωΓ]|[A-Z]\b)|(?<= )-(?= )")


def prose(text: str) -> str:
    """HTML of a text of the project's plain notation: theta_a[1], M^-1, <=, 1e-6."""
    html = escape(text, quote=False).replace("&lt;=", "≤").replace("&gt;=", "≥")
    html = _SYMBOL.sub(lambda m: _GREEK[m[1]], html)
    html = _EXPONENT.sub(lambda m: number(float(m[0])) if 0 <= int(m[2]) < 5 else _times_power(m[1], int(m[2])), html)
    html = _POWER.sub(lambda m: f"<sup>{(m[1] or m[2]).replace('-', '−')}</sup>", html)
    html = _INDEX.sub(lambda m: f"{m[1]}<sub>{m[2].replace('_', ' ')}{m[3] or ''}</sub>", html)
    return _MINUS.sub("−", html)


def number(value: float, digits: int = 4) -> str:
    """HTML of a number: so many digits, or all before the point; powers of ten where they help."""
    size = abs(value)
    if size >= 1e5 or 0 < size < 1e-3:
        factor, power = f"{value:.{digits - 1}e}".split("e")
        return _times_power(factor.rstrip("0").rstrip("."), int(power))
    return (f"{value:.0f}" if size >= 10.0**digits else f"{value:.{digits}g}").replace("-", "−")


def _times_power(digits: str, power: int) -> str:
    sign = "−" if digits.startswith("-") else ""
    factor = "" if digits.lstrip("-") == "1" else f"{digits.lstrip('-')}·"
    return f"{sign}{factor}10<sup>{str(power).replace('-', '−')}</sup>"


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], caption: str, kind: str = "") -> str:
    """An HTML table whose cells are HTML already; of class `cards`, its rows become cards on narrow screens."""
    head = "".join(f'<th scope="col">{h}</th>' for h in heads)
    body = "\n".join(
        "<tr>"
        + "".join(f'<td data-head="{_words(h)}"><div>{c}</div></td>' for h, c in zip(heads, row, strict=True))
        + "</tr>"
        for row in rows
    )
    return (
        f'<table class="framed compact {kind}"><caption class="unseen">{caption}</caption>'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table>"
    )


def _words(html: str) -> str:
    """The text of HTML, for an attribute."""
    return re.sub(r"<[^>]*>", "", html)
