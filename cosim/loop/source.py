"""The source of the compiled loop and where its library is; needs nothing, since the build of the package uses it."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

SOURCE = Path(__file__).with_name("loop.c")

LIBRARY = Path(__file__).with_name("_loop" + {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so"))


def source_hash() -> str:
    """Fingerprint of the source, which the library carries."""
    return hashlib.sha256(SOURCE.read_bytes().replace(b"\r\n", b"\n")).hexdigest()[:16]
