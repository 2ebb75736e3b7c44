"""The sources of the library of packed FMUs and where it is; needs nothing, since the build of the package uses it."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

from cosim.loop.source import loop_sources

#: One library for all systems, built beside its sources when the package is built, as the loop is.
LIBRARY = Path(__file__).with_name("_packed" + {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so"))

_FOLDER = Path(__file__).with_name("c")

#: What it is linked with beside the mathematical functions: the loader of libraries, where it is one of its own.
SYSTEM_LIBRARIES = ("dl",)

#: How the adapter of exported FMUs finds its resources.
_ADAPTER = Path(__file__).parents[2] / "fmu_export" / "native" / "c_adapter"


def library_hash() -> str:
    """Fingerprint of the sources, which the library carries."""
    texts = (content.replace(b"\r\n", b"\n") for _, content in sorted(_sources().items()))
    return hashlib.sha256(b"".join(texts)).hexdigest()[:16]


def library_sources() -> dict[str, bytes]:
    """What a compiler needs, by file name."""
    return {**_sources(), "packed_hash.h": f'#define PACKED_HASH "{library_hash()}"\n'.encode()}


def _sources() -> dict[str, bytes]:
    """The library's own sources, the loop's, and the reading of URIs of exported FMUs."""
    own = {path.name: path.read_bytes() for path in sorted(_FOLDER.iterdir())}
    return {**own, **loop_sources(as_part=True), **{n: (_ADAPTER / n).read_bytes() for n in ("uri.c", "uri.h")}}
