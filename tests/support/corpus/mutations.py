"""Random changes of an FMU's bytes and of its model description."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

from tests.support.corpus.case import DESCRIPTION_1, DESCRIPTION_2, DESCRIPTION_3, LIBRARY, LIBRARY_3, in_memory

#: What takes the place of values, or stands somewhere in between.
_WORDS = (
    *(b"", b" ", b"0", b"-1", b"NaN", b"1e999", b"4294967296", b"9" * 25, b"true", b"x", b"\xff", b"\xc2\x9b", b"&#0;"),
    *(b'"', b"<", b">", b"<a/>", b"name", b'valueReference="', b'start="x"', b'<Dimension start="3"/>', b'clocks="1"'),
    *(b'<Alias name="q"/>', b'derivative="1"', b'declaredType="T"', b"<!-- x -->", b"<![CDATA[x]]>"),
)

_LIBRARY = b"\x7fELF" + bytes(100)


def mutants(path: Path, number: int, seed: int) -> Iterator[Path]:
    """Write one after another to a path, and give it."""
    rng = random.Random(seed)
    bases = ((DESCRIPTION_1, LIBRARY), (DESCRIPTION_2, LIBRARY), (DESCRIPTION_3, LIBRARY_3))
    for _ in range(number):
        text, library = rng.choice(bases)
        xml = bytearray(text.encode())
        in_archive = rng.random() < 0.5
        for _ in range(0 if in_archive else rng.randint(1, 4)):
            _change_text(xml, rng)
        archive = bytearray(in_memory(("modelDescription.xml", bytes(xml)), (library, _LIBRARY)))
        for _ in range(rng.randint(1, 4) if in_archive else 0):
            _change_bytes(archive, rng)
        path.write_bytes(archive)
        yield path


def _change_bytes(data: bytearray, rng: random.Random) -> None:
    """Change, take out or put in some bytes, often in the directory at the end."""
    place = max(0, len(data) - rng.randint(1, 200)) if rng.random() < 0.3 else rng.randrange(len(data))
    how = rng.randrange(4)
    if how < 2:
        data[place] = rng.randrange(256)
    elif how == 2:
        del data[place : place + rng.randint(1, 20)]
    else:
        data[place:place] = rng.randbytes(rng.randint(1, 8))


def _change_text(xml: bytearray, rng: random.Random) -> None:
    """Change, take out or put in something, or another value of an attribute."""
    place, how = rng.randrange(len(xml)), rng.randrange(4)
    if how == 0:
        _change_bytes(xml, rng)
    elif how == 1:
        xml[place:place] = rng.choice(_WORDS)
    elif how == 2:
        del xml[place : place + rng.randint(1, 30)]
    else:
        quotes = [k for k, c in enumerate(xml) if c == ord('"')]
        if len(quotes) > 1:
            k = rng.randrange(len(quotes) - 1)
            xml[quotes[k] + 1 : quotes[k + 1]] = rng.choice(_WORDS)
