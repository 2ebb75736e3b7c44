"""Further libraries in FMUs, kept apart from those of the same names in other FMUs.

The loader of Linux knows a library by its name: an FMU that needs `libmodel.so` gets that of another FMU, if that is
loaded already, although its own one lies beside it. So those of later FMUs get other names, of the same length, in the
folder that they are unpacked into.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Mapping, Set
from pathlib import Path

#: Name of a further library -> hash of the first one that an FMU of this process has under it.
_first: dict[str, bytes] = {}


def keep_apart(folder: Path, own: Set[str]) -> bool:
    """Rename the further libraries of an unpacked FMU, if other ones of their names belong to another FMU.

    Parameters
    ----------
    folder : Path
        Folder with the libraries of an FMU for this machine.
    own : set of str
        Names of the files that are the FMU's own libraries, not further ones.

    Returns
    -------
    bool
        Whether there are further libraries.
    """
    if not sys.platform.startswith("linux") or not folder.is_dir():
        return False
    names = {file.name for file in folder.iterdir() if ".so" in file.name and file.is_file()}
    if names <= own:
        return False
    files = {name: (folder / name).read_bytes() for name in sorted(names)}
    hashes = {name: hashlib.sha256(data).digest() for name, data in files.items() if name not in own}
    if not all(_first.setdefault(name, found) == found for name, found in hashes.items()):
        together = hashlib.sha256(repr(sorted(hashes.items())).encode()).hexdigest()
        rename(files, {name: other_name(name, together) for name in hashes}, folder)
    return True


def rename(files: Mapping[str, bytes], renamed: Mapping[str, str], folder: Path) -> None:
    """Write libraries into a folder, some under other names, by which all of them find each other.

    Parameters
    ----------
    files : mapping of str to bytes
        Name -> contents.
    renamed : mapping of str to str
        Name -> another one of the same length.
    folder : Path
    """
    for name, data in files.items():
        for before, after in renamed.items():
            data = data.replace(b"\0%s\0" % before.encode(), b"\0%s\0" % after.encode())
        # under the old name, too: an FMU may open it by its path
        for new in {name, renamed.get(name, name)}:
            (folder / new).write_bytes(data)


def other_name(name: str, digits: str) -> str:
    """A name of the same length for a library, whose stem is digits."""
    stem = name.index(".so")
    return digits[:stem].ljust(stem, "_") + name[stem:]
