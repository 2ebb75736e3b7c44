"""pythonfmu's binaries, with one defect of the Linux one mended.

The Linux binary of pythonfmu 0.7.0 frees its interpreter state twice when the process exits: once by the destructor of
the static object, and again by a function marked as destructor of the library, which runs later and then writes into
memory that is no longer its own. Now and then a host dies from it after all work is done. The second one is the last
of two entries of the library's DT_FINI_ARRAY; here its size (DT_FINI_ARRAYSZ) is set from two entries to one.
"""

from __future__ import annotations

import hashlib
import struct
from importlib.metadata import distribution
from importlib.util import find_spec
from pathlib import Path

#: SHA-256 of the binary that has the defect; any other is taken as it is.
_DEFECTIVE = "4be156a552c16f30eb4395805c59855d8d4086056d0f165442565f6c5fbac0c9"

_DT_FINI_ARRAYSZ = 0x1C
_TWO_ENTRIES, _ONE_ENTRY = (struct.pack("<QQ", _DT_FINI_ARRAYSZ, 8 * n) for n in (2, 1))


def binaries(name: str) -> dict[str, bytes]:
    """Binaries of all platforms that pythonfmu has, as members of an FMU with this model identifier."""
    spec = find_spec("pythonfmu")
    assert spec is not None
    assert spec.origin is not None
    folder = Path(spec.origin).parent / "resources" / "binaries"
    return {
        f"binaries/{file.parent.name}/{name}{file.suffix}": mended(file.read_bytes())
        for file in sorted(folder.glob("*/*"))
        if file.suffix in (".so", ".dll", ".dylib")
    }


def mended(binary: bytes) -> bytes:
    """The binary without the defect, or unchanged when it is not known to have it."""
    if hashlib.sha256(binary).hexdigest() != _DEFECTIVE:
        return binary
    assert binary.count(_TWO_ENTRIES) == 1
    return binary.replace(_TWO_ENTRIES, _ONE_ENTRY)


def licence() -> bytes:
    """The licence of the binaries, which must go where they go."""
    files = distribution("pythonfmu").files or []
    return Path(str(next(f for f in files if f.name == "LICENSE").locate())).read_bytes()
