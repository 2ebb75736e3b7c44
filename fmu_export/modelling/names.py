"""Names and texts that every tool can take: C identifiers for models, FMI's structured names for variables."""

from __future__ import annotations

import keyword
import re

from fmu_export.errors import ArgumentError

#: Keywords of C and C++, up to C23 and C++20; the name of a model becomes part of names of C functions.
_C_KEYWORDS = frozenset(
    re.findall(
        r"\w+",
        """
        alignas alignof and and_eq asm auto bitand bitor bool break case catch char char8_t char16_t char32_t class
        compl concept const consteval constexpr constinit const_cast continue co_await co_return co_yield decltype
        default delete do double dynamic_cast else enum explicit export extern false float for friend goto if inline
        int long mutable namespace new noexcept not not_eq nullptr operator or or_eq private protected public register
        reinterpret_cast requires restrict return short signed sizeof static static_assert static_cast struct switch
        template this thread_local throw true try typedef typeid typename typeof typeof_unqual union unsigned using
        virtual void volatile wchar_t while xor xor_eq _Alignas _Alignof _Atomic _BitInt _Bool _Complex _Decimal128
        _Decimal32 _Decimal64 _Generic _Imaginary _Noreturn _Static_assert _Thread_local main
        """,
    )
)

#: Files that Windows can't have.
_DEVICES = re.compile(r"(?i:con|prn|aux|nul|com[0-9]|lpt[0-9])")

_WORD = r"[A-Za-z_][A-Za-z0-9_]*"
_IDENTIFIER = re.compile(_WORD)
#: FMI 2.0.4, section 2.2.9, and FMI 3.0.1, section 2.4.7.5.1, without names in quotes.
_LEVEL = rf"{_WORD}(?:\[[0-9]+(?:,[0-9]+)*\])?"
_STRUCTURED = re.compile(rf"{_LEVEL}(?:\.{_LEVEL})*")

#: What XML can't hold, and what breaks a line.
_UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufffe\uffff]")

LONGEST_IDENTIFIER = 100
LONGEST_NAME = 200


def check_identifier(what: str, name: object) -> None:
    """Refuse what is not an identifier in C and Python, or stands for something else there.

    Parameters
    ----------
    what : str
        What has the name, for the message.
    name : object

    Raises
    ------
    ArgumentError
    """
    if not isinstance(name, str) or not _IDENTIFIER.fullmatch(name):
        problem = "is not an identifier; take letters without accents, digits and _, and begin with a letter"
    elif name in _C_KEYWORDS or keyword.iskeyword(name):
        problem = "is a keyword of C or Python; take another one"
    elif re.match("fmi[0-9][A-Z]", name):
        problem = "is like the functions of FMI; take another one"
    elif _DEVICES.fullmatch(name):
        problem = "is not a name of a file on Windows; take another one"
    elif len(name) > LONGEST_IDENTIFIER:
        problem = f"is longer than {LONGEST_IDENTIFIER} characters; take a shorter one"
    else:
        return
    raise ArgumentError(f"{what}: the name {name!r} {problem}")


def check_variable_name(name: object) -> None:
    """Refuse what is not a structured name of FMI: identifiers with indices, joined by dots.

    Raises
    ------
    ArgumentError
    """
    if not isinstance(name, str) or not _STRUCTURED.fullmatch(name):
        problem = (
            "is not a name of FMI; take letters without accents, digits, _, indices as [1] and dots between levels"
        )
    elif name == "time":
        problem = "is that of the simulation time, which every FMU has; take another one"
    elif len(name) > LONGEST_NAME:
        problem = f"is longer than {LONGEST_NAME} characters; take a shorter one"
    else:
        return
    raise ArgumentError(f"variable {name!r}: the name {problem}")


def check_text(what: str, text: object) -> None:
    """Refuse what can't stand in a model description or on one line of a log.

    Raises
    ------
    ArgumentError
    """
    if not isinstance(text, str):
        raise ArgumentError(f"{what} is {text!r}, which is not a text")
    if found := _UNPRINTABLE.search(text):
        raise ArgumentError(f"{what} has the character {found[0]!r}; write one line of printable text")
