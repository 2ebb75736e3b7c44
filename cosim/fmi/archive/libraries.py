"""Shared libraries of FMUs, looked at without loading them: for which machine they are, and what they have."""

from __future__ import annotations

import mmap
import os
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

#: Begin of a library that is looked at for its format and processor.
_HEAD = 4096

_ELF_MACHINES = {3: "32-bit x86", 40: "32-bit ARM", 62: "64-bit x86", 183: "64-bit ARM", 243: "RISC-V"}
_PE_MACHINES = {0x14C: "32-bit x86", 0x8664: "64-bit x86", 0xAA64: "64-bit ARM", 0x1C0: "32-bit ARM"}
_MACH_O: dict[bytes, Literal["little", "big"]] = {
    b"\xfe\xed\xfa\xce": "big",
    b"\xfe\xed\xfa\xcf": "big",
    b"\xce\xfa\xed\xfe": "little",
    b"\xcf\xfa\xed\xfe": "little",
}
_FAT = b"\xca\xfe\xba\xbe"
_PT_LOAD, _ET_DYN = 1, 3

#: Processors of ELF whose libraries have 32 bits.
_OF_32_BITS = (3, 40)

_MACH_O_MACHINES = {7: "32-bit x86", 0x01000007: "64-bit x86", 0x0100000C: "64-bit ARM"}

#: Folder below `binaries` -> system and processor of its libraries.
_FOLDERS = {
    "linux32": ("Linux", "32-bit x86"),
    "linux64": ("Linux", "64-bit x86"),
    "win32": ("Windows", "32-bit x86"),
    "win64": ("Windows", "64-bit x86"),
    "darwin64": ("macOS", "64-bit x86"),
}
_SYSTEMS = {"linux": "Linux", "windows": "Windows", "darwin": "macOS"}
_PROCESSORS = {"x86": "32-bit x86", "x86_64": "64-bit x86", "aarch64": "64-bit ARM", "aarch32": "32-bit ARM"}

#: Functions without which no run is possible: version of FMI -> names, where `{}` is the model identifier.
_NEEDED = {
    1: ("{}_fmiInstantiateSlave", "{}_fmiFreeSlaveInstance", "{}_fmiInitializeSlave", "{}_fmiDoStep"),
    2: (
        "fmi2Instantiate",
        "fmi2FreeInstance",
        "fmi2SetupExperiment",
        "fmi2EnterInitializationMode",
        "fmi2ExitInitializationMode",
        "fmi2DoStep",
    ),
    3: (
        "fmi3InstantiateCoSimulation",
        "fmi3FreeInstance",
        "fmi3EnterInitializationMode",
        "fmi3ExitInitializationMode",
        "fmi3DoStep",
    ),
}

#: Further functions that each library for co-simulation has to have.
_DEMANDED = {
    1: ("{}_fmiGetTypesPlatform", "{}_fmiGetVersion", "{}_fmiTerminateSlave", "{}_fmiResetSlave"),
    2: ("fmi2GetTypesPlatform", "fmi2GetVersion", "fmi2Terminate", "fmi2Reset"),
    3: ("fmi3GetVersion", "fmi3Terminate", "fmi3Reset"),
}


@dataclass(frozen=True)
class Machine:
    """A system and a processor; of a library for several all of them."""

    system: str
    processors: tuple[str, ...] = ()

    def serves(self, other: Machine) -> bool:
        """Whether a library for this machine can be loaded on another one, as far as is known."""
        known = self.processors and other.processors
        return self.system == other.system and (not known or bool(set(self.processors) & set(other.processors)))

    def __str__(self) -> str:
        return f"{' and '.join(self.processors)} {self.system}".strip()


def machine_of(head: bytes) -> Machine | None:
    """For which machine a library is, by its first bytes; None where these are of no library."""
    if head[:4] == b"\x7fELF" and len(head) >= 20:
        number = int.from_bytes(head[18:20], "little" if head[5] == 1 else "big")
        return Machine("Linux", (_ELF_MACHINES.get(number, f"processor {number}"),))
    if head[:2] == b"MZ":
        place = int.from_bytes(head[60:64], "little") if len(head) >= 64 else 0
        if head[place : place + 4] != b"PE\0\0" or len(head) < place + 6:
            return Machine("Windows")
        number = int.from_bytes(head[place + 4 : place + 6], "little")
        return Machine("Windows", (_PE_MACHINES.get(number, f"processor {number}"),))
    if head[:4] in _MACH_O and len(head) >= 8:
        return Machine("macOS", _mach_o(head[4:8], _MACH_O[head[:4]]))
    if head[:4] == _FAT and len(head) >= 8:
        number = min(int.from_bytes(head[4:8], "big"), (len(head) - 8) // 20)
        places = (8 + 20 * i for i in range(number))
        return Machine("macOS", tuple(p for place in places for p in _mach_o(head[place : place + 4], "big")))
    return None


def _mach_o(data: bytes, order: Literal["little", "big"]) -> tuple[str, ...]:
    number = int.from_bytes(data, order)
    return (_MACH_O_MACHINES[number],) if number in _MACH_O_MACHINES else ()


def is_damaged(path: Path) -> bool:
    """Whether a library of Linux is none by its header, or ends before its last segment does.

    The loader refuses the former; the latter ends the process that loads it.
    """
    try:
        with path.open("rb") as file:
            head = file.read(64)
            size = file.seek(0, os.SEEK_END)
            if head[:4] != b"\x7fELF":
                return False
            if len(head) < 64 or head[4] not in (1, 2) or head[5] not in (1, 2):
                return True
            order, wide = "<" if head[5] == 1 else ">", head[4] == 2
            (kind,) = struct.unpack(f"{order}H", head[16:18])
            (table,) = struct.unpack(f"{order}Q", head[32:40]) if wide else struct.unpack(f"{order}I", head[28:32])
            entry, number = struct.unpack(f"{order}HH", head[54:58] if wide else head[42:46])
            machine = int.from_bytes(head[18:20], "little" if head[5] == 1 else "big")
            if kind != _ET_DYN or wide != (machine not in _OF_32_BITS) or entry < (56 if wide else 32):
                return True
            if table + entry * number > size:
                return True
            file.seek(table)
            segments = file.read(entry * number)
    except OSError:
        return False
    for place in range(0, entry * number, entry):
        if wide:
            kind, _, begin, _, _, length = struct.unpack(f"{order}IIQQQQ", segments[place : place + 40])
        else:
            kind, begin, _, _, length = struct.unpack(f"{order}IIIII", segments[place : place + 20])
        if kind == _PT_LOAD and begin + length > size:
            return True
    return False


def machine_of_file(path: Path) -> Machine | None:
    """For which machine a library or program is; None where it is none, or can't be read."""
    try:
        with path.open("rb") as file:
            return machine_of(file.read(_HEAD))
    except OSError:
        return None


def machine_of_folder(folder: str) -> Machine | None:
    """For which machine the libraries in a folder below `binaries` should be, by its name in FMI 2.0 or 3.0."""
    if folder in _FOLDERS:
        system, processor = _FOLDERS[folder]
        return Machine(system, (processor,))
    processor, _, system = folder.partition("-")
    if processor in _PROCESSORS and system in _SYSTEMS:
        return Machine(_SYSTEMS[system], (_PROCESSORS[processor],))
    return None


def misplaced(folder: Path, members: Iterable[str]) -> list[str]:
    """Findings about libraries of an unpacked FMU that are for another machine than their folder says.

    Parameters
    ----------
    folder : Path
        With the unpacked FMU.
    members : iterable of str
        Names of its members.
    """
    found = []
    for member in members:
        parts = PurePosixPath(member).parts
        if len(parts) != 3 or parts[0] != "binaries" or PurePosixPath(member).suffix not in (".so", ".dll", ".dylib"):
            continue
        meant, is_for = machine_of_folder(parts[1]), machine_of_file(folder / member)
        if meant is None or not (folder / member).is_file():
            continue
        if is_for is None:
            found.append(f"{member} is not a library")
        elif not is_for.serves(meant):
            found.append(f"{member} is for {is_for}, not for {meant}")
    return found


def missing_functions(library: Path, version: int, identifier: str, *, demanded: bool = False) -> list[str]:
    """Functions whose names are not in a library, nor in those beside it: what has not the name has not the function.

    Parameters
    ----------
    library : Path
    version : int
        Of FMI.
    identifier : str
        Model identifier, with which names begin in FMI 1.0, and may begin in others.
    demanded : bool
        All that the standard demands of each library for co-simulation, not only what a run needs.
    """
    names = [name.format(identifier) for name in (*_NEEDED[version], *(_DEMANDED[version] if demanded else ()))]
    beside = sorted(file for file in library.parent.iterdir() if file != library and file.is_file())
    for file in (library, *beside):
        if not names:
            break
        names = _absent(file, names)
    return names


def _absent(file: Path, names: Sequence[str]) -> list[str]:
    """Names that are not in a file."""
    if file.stat().st_size == 0:
        return list(names)
    with file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        return [name for name in names if data.find(name.encode() + b"\0") < 0]
