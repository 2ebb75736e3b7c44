"""Shared libraries of any platform, read from their bytes: the platform they are for, and what they export."""

import struct

MACHINES = {
    ("ELF", 62): "x86_64-linux",
    ("ELF", 183): "aarch64-linux",
    ("PE", 0x8664): "x86_64-windows",
    ("Mach-O", 0x01000007): "x86_64-darwin",
    ("Mach-O", 0x0100000C): "aarch64-darwin",
}


def text_at(data: bytes, offset: int) -> str:
    return data[offset : data.index(b"\0", offset)].decode()


def elf_exports(data: bytes) -> set[str]:
    (headers,) = struct.unpack_from("<Q", data, 40)
    size, count = struct.unpack_from("<HH", data, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", data, headers + i * size) for i in range(count)]
    found = set()
    for _, kind, _, _, offset, length, link, *_ in sections:
        if kind == 11:  # SHT_DYNSYM
            for name, _, _, section, _, _ in struct.iter_unpack("<IBBHQQ", data[offset : offset + length]):
                found |= {text_at(data, sections[link][4] + name)} if section else set()
    return found - {""}


def pe_exports(data: bytes) -> set[str]:
    (start,) = struct.unpack_from("<I", data, 0x3C)
    (count,) = struct.unpack_from("<H", data, start + 6)
    (optional,) = struct.unpack_from("<H", data, start + 20)
    sections = [struct.unpack_from("<IIII", data, start + 24 + optional + 40 * i + 8) for i in range(count)]

    def offset(address: int) -> int:
        return next(raw + address - base for size, base, _, raw in sections if base <= address < base + size)

    directory = offset(struct.unpack_from("<I", data, start + 24 + 112)[0])
    number, _, names = struct.unpack_from("<III", data, directory + 24)
    return {text_at(data, offset(a)) for a in struct.unpack_from(f"<{number}I", data, offset(names))}


def macho_commands(data: bytes) -> dict[int, int]:
    """Number -> offset of the load commands."""
    found, at = {}, 32
    for _ in range(struct.unpack_from("<I", data, 16)[0]):
        number, size = struct.unpack_from("<II", data, at)
        found[number] = at
        at += size
    return found


def macho_exports(data: bytes) -> set[str]:
    symbols, count, strings, _ = struct.unpack_from("<IIII", data, macho_commands(data)[2] + 8)  # LC_SYMTAB
    entries = struct.iter_unpack("<IBBHQ", data[symbols : symbols + 16 * count])
    # external (1), not private to the library (0x10), defined (0xE)
    found = {text_at(data, strings + name)[1:] for name, kind, *_ in entries if kind & 0x11 == 1 and kind & 0xE}
    return found - {"_mh_dylib_header", "__dso_handle"}  # zig's linker exports these two of its own; harmless


def kind_and_exports(data: bytes) -> tuple[str, set[str]]:
    """Our name of the platform of a shared library, and the functions it exports."""
    if data[:5] == b"\x7fELF\x02":
        kind, library = struct.unpack_from("<HH", data, 16)
        assert kind == 3  # shared
        return MACHINES["ELF", library], elf_exports(data)
    if data[:2] == b"MZ":
        (start,) = struct.unpack_from("<I", data, 0x3C)
        assert data[start : start + 4] == b"PE\0\0"
        assert struct.unpack_from("<H", data, start + 22)[0] & 0x2000  # a DLL
        return MACHINES["PE", struct.unpack_from("<H", data, start + 4)[0]], pe_exports(data)
    magic, cpu, _, kind = struct.unpack_from("<IIII", data)
    assert (magic, kind) == (0xFEEDFACF, 6)  # 64 bits, MH_DYLIB
    return MACHINES["Mach-O", cpu], macho_exports(data)
