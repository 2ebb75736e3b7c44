"""The source of the compiled loop and where its library is; needs nothing, since the build of the package uses it."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

SOURCE = Path(__file__).with_name("loop.c")
HEADER = Path(__file__).with_name("loop.h")

LIBRARY = Path(__file__).with_name("_loop" + {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so"))


def source_hash() -> str:
    """Fingerprint of the source, which the library carries."""
    texts = (path.read_bytes().replace(b"\r\n", b"\n") for path in (SOURCE, HEADER))
    return hashlib.sha256(b"".join(texts)).hexdigest()[:16]


def loop_sources(*, as_part: bool = False) -> dict[str, bytes]:
    """What a compiler needs, by file name; as a part of another library the loop keeps its functions to itself."""
    generated = f'#define LOOP_HASH "{source_hash()}"\n' + ("#define EXPORT\n" if as_part else "")
    return {"loop.c": SOURCE.read_bytes(), "loop.h": HEADER.read_bytes(), "loop_hash.h": generated.encode()}
