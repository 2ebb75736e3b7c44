"""Libraries whose global variables belong to one instance.

Many FMUs keep values in global variables without a word: two instances of one library then compute with those of each
other, and one that is made anew begins with those of the one before it. So each instance of an FMU whose instances are
not known to be independent has a library of its own: the file itself, or a copy while the file is loaded.
"""

from __future__ import annotations

import _ctypes
import ctypes
import hashlib
import os
import shutil
import struct
import sys
from pathlib import Path

from cosim.fmi.further_libraries import other_name, rename

#: Sections of ELF: symbols of the dynamic loader. Binds of their symbols.
_SHT_DYNSYM, _GLOBAL, _UNIQUE = 11, 1, 10

#: How names of what libstdc++ may define itself begin.
_OF_LIBSTDCXX = (b"_ZNSt", b"_ZNKSt", b"_ZSt", b"_ZGVNSt", b"_ZNSs", b"_ZNSbI", b"_ZN9__gnu_cxx")


def library_of_its_own(path: Path) -> Path:
    """The path of a library, or of a copy, that this process has not loaded.

    Copies are in folders beside that of the library, from where a library finds the same files by relative paths; what
    lies beside the library is copied too, and further libraries get other names, by which alone the loader of Linux
    tells libraries apart.
    """
    folder, own, number = path.parent, path, 1
    while _is_loaded(own):
        number += 1
        own = folder.with_name(f"{folder.name}-{number}") / path.name
        if not own.is_file():
            _copy(folder, own, number)
    return own


def _is_loaded(path: Path) -> bool:
    """Whether this process has a library loaded, or has not unloaded it although it was told to."""
    if sys.platform == "win32":
        return bool(ctypes.windll.kernel32.GetModuleHandleW(str(path)))
    try:
        library = ctypes.CDLL(str(path), mode=os.RTLD_NOLOAD)
    except OSError:
        return False
    _ctypes.dlclose(library._handle)
    return True


def _copy(folder: Path, path: Path, number: int) -> None:
    shutil.copytree(folder, path.parent)
    if not sys.platform.startswith("linux"):
        return
    names = sorted(file.name for file in folder.iterdir() if ".so" in file.name and file.is_file())
    digits = {name: hashlib.sha256(f"{number} {name} {path}".encode()).hexdigest() for name in names}
    renamed = {name: other_name(name, digits[name]) for name in names if name != path.name}
    if renamed:
        rename({name: (folder / name).read_bytes() for name in names}, renamed, path.parent)


def forget_unique_symbols(path: Path) -> None:
    """Make the unique symbols of a library of Linux usual ones, which belong to the library.

    C++ has its variables in inline functions and templates as unique symbols (STB_GNU_UNIQUE), of which the loader
    keeps one for the whole process: FMUs with equal names would share them, and their libraries stay loaded. Those that
    libstdc++ may have too are left alone where the library uses that of the system.
    """
    data = path.read_bytes()
    places = unique_symbols(data)
    if places:
        changed = bytearray(data)
        for place in places:
            changed[place] = _GLOBAL << 4 | changed[place] & 15
        path.write_bytes(changed)


def unique_symbols(data: bytes) -> list[int]:
    """Places of the bytes by which a library says that symbols which are its own are unique."""
    if data[:4] != b"\x7fELF" or data[4:6] != b"\2\1":  # 64 bits, little-endian
        return []
    try:
        return _unique_symbols(data)
    except (struct.error, IndexError, ValueError):  # the loader judges what is damaged
        return []


def _unique_symbols(data: bytes) -> list[int]:
    (table,) = struct.unpack_from("<Q", data, 40)
    size, number = struct.unpack_from("<HH", data, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", data, table + i * size) for i in range(number)]
    others = _OF_LIBSTDCXX if b"\0libstdc++.so" in data else ()
    found = []
    for _, kind, _, _, begin, length, link, _, _, step in sections:
        if kind != _SHT_DYNSYM or step < 24:
            continue
        names = sections[link][4]
        for place in range(begin, begin + length, step):
            name, info, _, section = struct.unpack_from("<IBBH", data, place)
            if info >> 4 == _UNIQUE and section != 0:
                at = names + name
                if not data[at : data.index(b"\0", at)].startswith(others):
                    found.append(place + 4)
    return found
