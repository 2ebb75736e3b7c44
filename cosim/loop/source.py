"""The source of the compiled loop and where its library is; needs nothing, since the build of the package uses it."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

_FOLDER = Path(__file__).parent

#: Coefficients that exported FMUs integrate by, too.
_COEFFICIENTS = Path(__file__).parents[2] / "fmu_export" / "native" / "c_adapter" / "dormand_prince.h"

#: Libraries of the system that it is linked with; on Windows all are.
SYSTEM_LIBRARIES = ("pthread",)

#: Files that a library of which the loop is a part goes without.
_NO_PARTS = (
    _COEFFICIENTS.name,
    *("channel_master.c", "channel_relay.c", "channel_worker.c", "current_calls.c"),
    *(
        f"{name}.{ending}"
        for name in ("algebraic_loop", "core", "iterated_step", "model_exchange", "team")
        for ending in ("c", "h")
    ),
)

LIBRARY = _FOLDER / ("_loop" + {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so"))


def _files() -> dict[str, bytes]:
    files = [*(path for path in _FOLDER.iterdir() if path.suffix in (".c", ".h")), _COEFFICIENTS]
    return {path.name: path.read_bytes() for path in sorted(files, key=lambda path: path.name)}


def source_hash() -> str:
    """Fingerprint of the source, which the library carries."""
    texts = (name.encode() + content.replace(b"\r\n", b"\n") for name, content in _files().items())
    return hashlib.sha256(b"".join(texts)).hexdigest()[:16]


def loop_sources(*, as_part: bool = False) -> dict[str, bytes]:
    """What a compiler needs, by file name; as a part of another library the loop keeps its functions to itself."""
    part = "#define EXPORT\n#define WITHOUT_TEAM\n"
    generated = f'#define LOOP_HASH "{source_hash()}"\n' + (part if as_part else "")
    own = {name: content for name, content in _files().items() if name not in _NO_PARTS or not as_part}
    return {**own, "loop_hash.h": generated.encode()}
