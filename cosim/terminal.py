"""What the program prints: texts of others among it are shown, and never obeyed by the terminal.

Names, titles, descriptions and messages of FMUs and files may have codes that move the cursor, change colours or the
title of the window, or turn the direction of writing. All that the program prints goes through one place, here.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO, cast

#: Control characters but for the line feed and the tab, separators of lines, and what turns the direction of writing.
_OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def printable(text: str) -> str:
    r"""A text in which whatever a terminal would obey is written by its code; line feeds stay.

    Examples
    --------
    >>> print(printable("\x1b[31mred"))
    \x1b[31mred
    """
    return _OBEYED.sub(lambda found: found[0].encode("unicode_escape", "surrogatepass").decode(), text)


class _Filtered:
    """A stream that writes what is printable only; all else is that of the stream below."""

    def __init__(self, stream: TextIO) -> None:
        self.below = stream

    def write(self, text: str) -> int:
        encoding = self.below.encoding or "utf-8"
        self.below.write(printable(text).encode(encoding, "backslashreplace").decode(encoding))
        return len(text)

    def writelines(self, lines: Any) -> None:
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.below, name)


@contextmanager
def filtered_output() -> Iterator[None]:
    """Context in which what is printed goes through `printable`."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (cast(TextIO, _Filtered(stream)) for stream in before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def screen() -> TextIO:
    """The error stream for progress bars, which move the cursor themselves; foreign texts in them: `printable`."""
    stream: Any = sys.stderr
    return cast(TextIO, stream.below if isinstance(stream, _Filtered) else stream)
