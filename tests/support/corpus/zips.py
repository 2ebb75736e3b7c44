"""Archives that are broken, lie, or lead elsewhere."""

from __future__ import annotations

import stat
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

from tests.support.corpus.case import (
    DESCRIPTION_2,
    LIBRARY,
    REFUSED,
    RUNS,
    Case,
    Materials,
    Member,
    fmu_2,
    in_memory,
    members_2,
    zipped,
)

_Change = Callable[[bytearray], object]


def _with(name: str, *more: Member, expected: str = REFUSED, says: str = "", is_valid: bool | None = None) -> Case:
    """The FMU with further members."""
    return Case(name, lambda folder, m: fmu_2(folder, m, DESCRIPTION_2, *more), expected, says, is_valid=is_valid)


def _bytes(name: str, content: bytes | Callable[[bytes], bytes], says: str, expected: str = REFUSED) -> Case:
    """A file of these bytes, or made of those of the FMU."""

    def make(folder: Path, materials: Materials) -> Path:
        path = folder / "x.fmu"
        whole = in_memory(*members_2(materials))
        path.write_bytes(content if isinstance(content, bytes) else content(whole))
        return path

    return Case(name, make, expected, says)


def _patched(name: str, says: str, *changes: tuple[bytes, int, bytes], member: int = 0) -> Case:
    """The FMU with bytes at an offset from the n-th header of a kind replaced."""

    def make(folder: Path, materials: Materials) -> Path:
        path = fmu_2(folder, materials)
        data = bytearray(path.read_bytes())
        with zipfile.ZipFile(path) as archive:
            info = archive.infolist()[member]
            directory = archive.start_dir
        for magic, offset, new in changes:
            place = info.header_offset if magic == LOCAL else directory if magic == CENTRAL else len(data) - 22
            data[place + offset : place + offset + len(new)] = new
        path.write_bytes(data)
        return path

    return Case(name, make, REFUSED, says)


LOCAL, CENTRAL, END = b"PK\3\4", b"PK\1\2", b"PK\5\6"


def _mode(name: str, mode: int) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name)
    info.create_system, info.external_attr = 3, mode << 16
    return info


def _only(name: str, *members: Member, says: str) -> Case:
    return Case(name, lambda folder, m: zipped(folder / "x.fmu", *members), REFUSED, says)


def _method(name: str, method: int) -> Case:
    return Case(
        name,
        lambda folder, m: zipped(folder / "x.fmu", *members_2(m), method=method),
        RUNS,
        is_valid=method in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED),
    )


def _deflated(name: str, size: int, copies: int = 1) -> Case:
    """The FMU with members of many zeros."""

    def make(folder: Path, materials: Materials) -> Path:
        path = fmu_2(folder, materials)
        with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
            for k in range(copies):
                with archive.open(f"resources/{k}", "w", force_zip64=True) as member:
                    block = bytes(1024**2)
                    for _ in range(size):
                        member.write(block)
        return path

    return Case(name, make, REFUSED, "not opened")


def _quoted(folder: Path, materials: Materials) -> Path:
    """The bomb of Fifield: many members that share one compressed kernel."""
    path = folder / "x.fmu"
    head = in_memory(*members_2(materials))
    with zipfile.ZipFile(fmu_2(folder, materials, name="y.fmu")) as archive:
        start = archive.start_dir
    kernel = in_memory(("k", bytes(10_000)), method=zipfile.ZIP_DEFLATED)
    local = kernel[: kernel.index(CENTRAL)]
    central = kernel[kernel.index(CENTRAL) : kernel.index(END)]
    entries = b""
    for _ in range(50):
        entries += central[:42] + struct.pack("<I", start) + central[46:]
    directory = head[start : head.rindex(END)] + entries
    end = END + struct.pack("<HHHHIIH", 0, 0, 52, 52, len(directory), start + len(local), 0)
    path.write_bytes(head[:start] + local + directory + end)
    return path


def _many(folder: Path, materials: Materials) -> Path:
    path = folder / "x.fmu"
    members = [(f"resources/{k}", b"") for k in range(100_001)]
    return zipped(path, *members_2(materials), *members)


def _symlinked_library(folder: Path, materials: Materials) -> Path:
    link = _mode(LIBRARY, stat.S_IFLNK | 0o777)
    target = LIBRARY.rpartition("/")[2] + ".1"
    description, (_, library) = members_2(materials)
    return zipped(folder / "x.fmu", description, (LIBRARY + ".1", library), (link, target.encode()))


def _folder(folder: Path, materials: Materials) -> Path:
    (folder / "x.fmu").mkdir()
    return folder / "x.fmu"


def _fifo_free(folder: Path, materials: Materials) -> Path:
    return folder / "nowhere.fmu"


def _loop_of_links(folder: Path, materials: Materials) -> Path:
    (folder / "x.fmu").symlink_to(folder / "y.fmu")
    (folder / "y.fmu").symlink_to(folder / "x.fmu")
    return folder / "x.fmu"


def _zip64_lies(folder: Path, materials: Materials) -> Path:
    """Sizes of 2^63 in a zip64 field."""
    path = fmu_2(folder, materials)
    data = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as archive:
        directory = archive.start_dir
    extra = struct.pack("<HHQQ", 1, 16, 2**63, 2**63)
    name_size = struct.unpack("<H", data[directory + 28 : directory + 30])[0]
    data[directory + 20 : directory + 28] = b"\xff" * 8
    data[directory + 30 : directory + 32] = struct.pack("<H", len(extra))
    data[directory + 46 + name_size : directory + 46 + name_size] = extra
    end = data.rindex(END)
    size = struct.unpack("<I", data[end + 12 : end + 16])[0] + len(extra)
    data[end + 12 : end + 16] = struct.pack("<I", size)
    path.write_bytes(data)
    return path


def _polyglot(whole: bytes) -> bytes:
    return b"#!/bin/sh\necho hello\n" + whole


_XML = DESCRIPTION_2.encode()
_NAME = b"modelDescription.xml"

ZIPS: tuple[Case, ...] = (
    Case("the FMU of FMI 2.0 as it is", fmu_2, RUNS),
    # no archives
    _bytes("an empty file", b"", "not a zip archive"),
    _bytes("one byte", b"P", "not a zip archive"),
    _bytes("a magic number only", b"PK\3\4", "FMU"),
    _bytes("an end of a directory only", END + bytes(18), "has no modelDescription.xml"),
    _bytes("a text", b"this is not an FMU\n", "not an FMU"),
    _bytes("random bytes", bytes(range(256)) * 40, "not a zip archive"),
    _bytes("zeros", bytes(100_000), "not a zip archive"),
    _bytes("a gzip file", b"\x1f\x8b\x08" + bytes(50), "not a zip archive"),
    _bytes("a library", b"\x7fELF\2\1\1" + bytes(100), "not an FMU"),
    _bytes("a 7z file", b"7z\xbc\xaf\x27\x1c" + bytes(50), "not a zip archive"),
    _bytes("the first half", lambda b: b[: len(b) // 2], "not a zip archive"),
    _bytes("without its last byte", lambda b: b[:-1], "zip"),
    _bytes("without its first bytes", lambda b: b[100:], ""),
    _bytes("zeros in the middle", lambda b: b[:3000] + bytes(2000) + b[5000:], "can't be unpacked"),
    _bytes("behind a script", _polyglot, "", RUNS),
    _bytes("before other bytes", lambda b: b + b"\n" * 10, "", RUNS),
    _bytes("twice", lambda b: b + b, "", RUNS),
    Case("a folder of that name", _folder, REFUSED, "there is no such FMU file"),
    Case("no file", _fifo_free, REFUSED, "there is no such FMU file"),
    Case("a circle of links", _loop_of_links, REFUSED, "there is no such FMU file"),
    # paths
    _with("a path out of it", ("../../escaped", b"x"), says="leads out of the archive"),
    _with("a path out of it, deep", ("resources/../../escaped", b"x"), says="leads out of the archive"),
    _with("an absolute path", ("/tmp/escaped-by-an-archive", b"x"), says="absolute path"),
    _with("a path with a host", ("//host/share/x", b"x"), says="the path"),
    _with("a drive letter", ("C:/escaped", b"x"), says="drive letter"),
    _with("a drive letter without a slash", ("C:escaped", b"x"), says="drive letter"),
    _with("backslashes", ("resources\\x", b"x"), says="backslash"),
    _with("backslashes out of it", ("..\\..\\escaped", b"x"), says="backslash"),
    _with("a second stream", ("resources/x:stream", b"x"), says="drive letter"),
    _with("a name of a space", (" ", b"x"), expected=RUNS, is_valid=False),
    _with("a name of a slash", ("/", b""), says="the path"),
    _with("two dots alone", ("..", b"x"), says="leads out"),
    _with("a dot alone", (".", b"x"), says=""),
    _with("an empty folder in a path", ("resources//x", b"x"), says="not a name of a file"),
    _with("a line break in a name", ("resources/a\nb", b"x"), says="control character"),
    _with("an escape code in a name", ("resources/\x1b[2J", b"x"), says="control character"),
    _with("a very long name", ("resources/" + "n" * 300, b"x"), says="longer than a file system takes"),
    _with("a very long path", ("a/" * 1000 + "x", b"x"), says="longer than a file system takes"),
    _with("a name of Windows", ("resources/CON", b"x"), expected=RUNS, is_valid=False),
    _with("a name of Windows with an ending", ("resources/nul.txt", b"x"), expected=RUNS, is_valid=False),
    _with("a name that ends in a dot", ("resources/x.", b"x"), expected=RUNS, is_valid=False),
    _with("a name with a star", ("resources/*", b"x"), expected=RUNS, is_valid=False),
    _with("two names but for case", ("resources/A", b"1"), ("resources/a", b"2"), expected=RUNS, is_valid=False),
    _with(
        "two names but for how an accent is composed",
        ("resources/\u00e9", b"1"),
        ("resources/e\u0301", b"2"),
        expected=RUNS,
        is_valid=False,
    ),
    _with("names in other scripts", ("resources/模型", b"1"), ("resources/модель", b"2"), expected=RUNS),
    _with("a description twice, the same", (_NAME.decode(), _XML), expected=RUNS, is_valid=False),
    _with("a description twice, another", (_NAME.decode(), _XML + b" "), says="twice, with different contents"),
    _with("a library twice, another", (LIBRARY, b"other"), says="twice, with different contents"),
    _with("a file that is a folder, too", (f"{LIBRARY}/x", b""), says="both a file and a folder"),
    _with("a folder of the name of a file", (f"{LIBRARY}/", b""), says=""),
    # kinds of members
    _with("a link", (_mode("resources/x", stat.S_IFLNK | 0o777), b"/etc/passwd"), says="is a link"),
    _with("a link to a folder", (_mode("resources", stat.S_IFLNK | 0o777), b"/tmp"), says="is a link"),
    _with("a device", (_mode("resources/x", stat.S_IFBLK | 0o777), b""), says="neither a file nor a folder"),
    _with("a pipe", (_mode("resources/x", stat.S_IFIFO | 0o777), b""), says="neither a file nor a folder"),
    _with("a set-uid file", (_mode("resources/x", stat.S_IFREG | 0o4777), b"x"), expected=RUNS),
    _with("a member without rights", (_mode("resources/x", stat.S_IFREG), b"x"), expected=RUNS),
    Case("a library by a link", _symlinked_library, REFUSED, "is a link"),
    # headers
    _patched("encrypted", "encrypted", (LOCAL, 6, b"\1\0"), (CENTRAL, 8, b"\1\0")),
    _patched("encrypted by its directory", "encrypted", (CENTRAL, 8, b"\1\0")),
    _patched("compressed by method 93", "compressed by method 93", (LOCAL, 8, b"\x5d\0"), (CENTRAL, 10, b"\x5d\0")),
    _patched("compressed by method 9", "compressed by method 9", (LOCAL, 8, b"\x09\0"), (CENTRAL, 10, b"\x09\0")),
    _patched("stored, but deflated by its directory", "not where its directory says", (CENTRAL, 10, b"\x08\0")),
    _patched("stored, and both say deflated", "can't be unpacked", (LOCAL, 8, b"\x08\0"), (CENTRAL, 10, b"\x08\0")),
    _patched("another name in the header", "not where its directory says", (LOCAL, 30, b"X")),
    _patched("another name in the directory", "not where its directory says", (CENTRAL, 46, b"X")),
    _patched("a wrong checksum", "Bad CRC-32", (LOCAL, 14, b"1234"), (CENTRAL, 16, b"1234")),
    _patched("a wrong checksum of the library", "Bad CRC-32", (LOCAL, 60, b"1234"), member=1),
    _patched("a wrong size in the directory", "not where its directory says", (CENTRAL, 24, b"\4\0\0\0")),
    _patched("sizes of 4 GiB", "not opened", (CENTRAL, 20, b"\xfe\xff\xff\xff"), (CENTRAL, 24, b"\xfe\xff\xff\xff")),
    _patched("a member behind the end", "not where its directory says", (CENTRAL, 42, b"\xff\xff\xff\x7f")),
    _patched("a member in another", "", (CENTRAL, 42, b"\x20\0\0\0")),
    _patched("a NUL in a name", "", (LOCAL, 35, b"\0"), (CENTRAL, 51, b"\0")),
    _patched("no magic number of a member", "not where its directory says", (LOCAL, 0, b"XXXX")),
    _patched("a needed version of 99", "", (CENTRAL, 6, b"\x63\0")),
    _patched("several disks", "part of an archive in several", (END, 4, b"\1\0\1\0")),
    _patched("a directory elsewhere", "", (END, 16, b"\0\0\0\0")),
    _patched("a directory of 4 GiB", "", (END, 12, b"\xfe\xff\xff\xff")),
    _patched("a count of no members", "says that it has 0 members", (END, 8, b"\0\0\0\0")),
    _patched("a count of 65,534 members", "says that it has 65534 members", (END, 8, b"\xfe\xff\xfe\xff")),
    _patched("a name of 65,535 bytes", "", (CENTRAL, 28, b"\xff\xff")),
    _patched("an extra field of 65,535 bytes", "", (CENTRAL, 30, b"\xff\xff")),
    _patched(
        "a name that is not UTF-8",
        "",
        (LOCAL, 6, b"\0\x08"),
        (CENTRAL, 8, b"\0\x08"),
        (LOCAL, 30, b"\xff\xfe"),
        (CENTRAL, 46, b"\xff\xfe"),
    ),
    Case("sizes of 2^63 in zip64", _zip64_lies, REFUSED, ""),
    Case("members that share their bytes", _quoted, REFUSED, "overlaps another member"),
    Case("100,001 members", _many, REFUSED, "members, more than any FMU needs"),
    _deflated("70 MiB of zeros", 70),
    _deflated("20 times 20 MiB of zeros", 20, 20),
    _method("stored", zipfile.ZIP_STORED),
    _method("deflated", zipfile.ZIP_DEFLATED),
    _method("compressed by bzip2", zipfile.ZIP_BZIP2),
    _method("compressed by LZMA", zipfile.ZIP_LZMA),
    # the description in it
    _only("no members", says="has no modelDescription.xml"),
    _only("no description", ("readme", b""), says="has no modelDescription.xml"),
    _only("a folder for the description", ("modelDescription.xml/", b""), says="a folder of that name"),
    _only("a folder with the description", ("Model/modelDescription.xml", _XML), says="pack the content of the folder"),
    _only("a description of another case", ("ModelDescription.xml", _XML), says="rename it"),
    _only("an FMU in an FMU", ("x.fmu", in_memory(("modelDescription.xml", _XML))), says="has no modelDescription.xml"),
)
