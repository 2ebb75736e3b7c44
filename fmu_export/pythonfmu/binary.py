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
from pathlib import Path

from fmu_export.errors import ModelError, needs

#: SHA-256 of the binary that has the defect; any other is taken as it is.
_DEFECTIVE = "4be156a552c16f30eb4395805c59855d8d4086056d0f165442565f6c5fbac0c9"

_DT_FINI_ARRAYSZ = 0x1C
_TWO_ENTRIES, _ONE_ENTRY = (struct.pack("<QQ", _DT_FINI_ARRAYSZ, 8 * n) for n in (2, 1))


class BinariesMissing(ModelError):
    """The installed pythonfmu has no binaries; one line says where they should be."""


def binaries(name: str) -> dict[str, bytes]:
    """Binaries of all platforms that pythonfmu has, as members of an FMU with this model identifier.

    Raises
    ------
    BinariesMissing
        The installed pythonfmu has none.
    MissingExtra
        pythonfmu is not installed.
    """
    # not where the module comes from: an FMU in this process may have brought a pythonfmu of its own
    with needs("export"):
        installed = distribution("pythonfmu")
    folder = Path(str(installed.locate_file("pythonfmu/resources/binaries")))
    found = {
        f"binaries/{file.parent.name}/{name}{file.suffix}": mended(file.read_bytes())
        for file in sorted(folder.glob("*/*"))
        if file.suffix in (".so", ".dll", ".dylib")
    }
    if not found:
        raise BinariesMissing(
            f"{folder} has no binaries; install pythonfmu again: pip install --force-reinstall pythonfmu"
        )
    return found


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
