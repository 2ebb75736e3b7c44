"""The source of the compiled loop and where its library is; needs nothing, since the build of the package uses it."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

_FOLDER = Path(__file__).parent

LIBRARY = _FOLDER / ("_loop" + {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so"))


def _files() -> dict[str, bytes]:
    files = sorted(path for path in _FOLDER.iterdir() if path.suffix in (".c", ".h"))
    return {path.name: path.read_bytes() for path in files}


def source_hash() -> str:
    """Fingerprint of the source, which the library carries."""
    texts = (name.encode() + content.replace(b"\r\n", b"\n") for name, content in _files().items())
    return hashlib.sha256(b"".join(texts)).hexdigest()[:16]


def loop_sources(*, as_part: bool = False) -> dict[str, bytes]:
    """What a compiler needs, by file name; as a part of another library the loop keeps its functions to itself."""
    generated = f'#define LOOP_HASH "{source_hash()}"\n' + ("#define EXPORT\n" if as_part else "")
    own = {name: content for name, content in _files().items() if name != "current_calls.c" or not as_part}
    return {**own, "loop_hash.h": generated.encode()}
