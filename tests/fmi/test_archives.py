"""FMU files as somebody else's: what is wrong with them is said before anything of them runs."""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from cosim import SetupError
from cosim.fmi.archive.findings import FileFindings
from cosim.fmi.archive.libraries import Machine, machine_of, machine_of_folder
from cosim.fmi.archive.members import ArchiveError, Members
from cosim.fmi.archive.xml_reading import XmlError, read_xml


def zipped(path: Path, *members: tuple[str | zipfile.ZipInfo, bytes], method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in members:
            archive.writestr(name, data)
    return path


def refusal(path: Path) -> str:
    with pytest.raises(ArchiveError) as caught, Members(path):
        pass
    return str(caught.value)


def unclean(path: Path) -> list[str]:
    with Members(path) as members:
        return members.findings.unclean


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("../x", "leads out of the archive"),
        ("a/../../x", "leads out of the archive"),
        ("/etc/x", "is an absolute path"),
        ("C:/x", "has a drive letter"),
        ("a\\b", "a backslash"),
        ("a\x1b[2Jb", "a control character"),
        ("a//b", "is not a name of a file"),
        ("a" * 300, "is longer than a file system takes"),
    ],
)
def test_paths_that_lead_elsewhere_are_refused(tmp_path: Path, name: str, why: str) -> None:
    message = refusal(zipped(tmp_path / "x.fmu", ("modelDescription.xml", b"<x/>"), (name, b"")))
    assert message.startswith("can't be unpacked: the path ")
    assert why in message
    assert "\x1b" not in message


def test_what_only_windows_cannot_write_is_a_remark(tmp_path: Path) -> None:
    path = zipped(tmp_path / "x.fmu", ("resources/NUL.txt", b""), ("resources/a?", b""), ("A", b""), ("a", b""))
    found = unclean(path)
    assert [text.partition(";")[0] for text in found] == [
        "the path 'resources/NUL.txt' in it can't be written on Windows",
        "the path 'resources/a?' in it can't be written on Windows",
        "'A' and 'a' are one file where case does not count",
    ]


def test_a_member_twice_is_refused_where_its_contents_differ(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="Duplicate name"):
        same = zipped(tmp_path / "same.fmu", ("a", b"1"), ("a", b"1"))
    with pytest.warns(UserWarning, match="Duplicate name"):
        other = zipped(tmp_path / "other.fmu", ("a", b"1"), ("a", b"2"))
    assert unclean(same) == ["'a' is there twice"]
    assert "'a' is there twice, with different contents" in refusal(other)
    assert "'a' is both a file and a folder" in refusal(zipped(tmp_path / "c.fmu", ("a", b""), ("a/b", b"")))


def test_links_are_refused(tmp_path: Path) -> None:
    link = zipfile.ZipInfo("resources/passwd")
    link.external_attr = 0o120777 << 16
    link.create_system = 3
    assert "is a link" in refusal(zipped(tmp_path / "x.fmu", (link, b"/etc/passwd")))


def changed(path: Path, change: Callable[[bytearray, int, int], None]) -> Path:
    """The archive of one member after a change, which gets the places of the local header and of the directory."""
    data = bytearray(path.read_bytes())
    change(data, data.index(b"PK\3\4"), data.index(b"PK\1\2"))
    path.write_bytes(data)
    return path


def _encrypted(data: bytearray, local: int, directory: int) -> None:
    data[local + 6] |= 1
    data[directory + 8] |= 1


def _other_method(data: bytearray, local: int, directory: int) -> None:
    data[local + 8 : local + 10] = data[directory + 10 : directory + 12] = struct.pack("<H", 93)


def _other_name(data: bytearray, local: int, directory: int) -> None:
    data[local + 30] = ord("X")


def _other_size(data: bytearray, local: int, directory: int) -> None:
    data[directory + 24 : directory + 28] = struct.pack("<I", 4)


def _longer(data: bytearray, local: int, directory: int) -> None:
    data[local + 18 : local + 22] = data[directory + 20 : directory + 24] = struct.pack("<I", 500)


def _elsewhere(data: bytearray, local: int, directory: int) -> None:
    data[directory + 42 : directory + 46] = struct.pack("<I", 7)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (_encrypted, "is encrypted"),
        (_other_method, "is compressed by method 93"),
        (_other_name, "is not where its directory says, or another member"),
        (_other_size, "is not where its directory says, or another member"),
        (_elsewhere, "is not where its directory says, or another member"),
        (_longer, "overlaps another member"),
    ],
)
def test_headers_that_lie_are_refused(tmp_path: Path, change: Callable[[bytearray, int, int], None], why: str) -> None:
    assert why in refusal(changed(zipped(tmp_path / "x.fmu", ("name", b"12345")), change))


def test_a_bomb_is_not_opened(tmp_path: Path) -> None:
    path = zipped(tmp_path / "x.fmu", ("resources/zeros", bytes(70 * 1024**2)))
    assert "times what is packed, more than any FMU needs; not opened" in refusal(path)


def test_a_damaged_member_is_named(tmp_path: Path) -> None:
    path = zipped(tmp_path / "x.fmu", ("resources/x", b"12345" * 20), method=zipfile.ZIP_STORED)
    path.write_bytes(path.read_bytes().replace(b"12345", b"12346", 1))
    with Members(path) as members, pytest.raises(ArchiveError, match="'resources/x' can't be unpacked: Bad CRC-32"):
        members.unpack(tmp_path / "out")


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("modelDescription.xml/", "but a folder of that name"),
        ("Model/modelDescription.xml", "pack the content of the folder"),
        ("ModelDescription.XML", "rename it"),
        ("other", "it is not an FMU"),
    ],
)
def test_a_description_that_is_elsewhere_is_found(tmp_path: Path, name: str, why: str) -> None:
    with Members(zipped(tmp_path / "x.fmu", (name, b""))) as members, pytest.raises(ArchiveError, match=why):
        members.read("modelDescription.xml", 1000)


# XML

_LAUGHS = b'<!DOCTYPE a [<!ENTITY l "l"><!ENTITY m "&l;&l;">]>'


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "Document is empty"),
        (b"<a>", "Premature end"),
        (_LAUGHS + b"<a>&m;</a>", "document type"),
        (b'<!DOCTYPE a SYSTEM "file:///etc/passwd"><a/>', "document type"),
        pytest.param(b"<a>" * 150 + b"</a>" * 150, "nested more than 100 times", id="nested"),
        pytest.param(b"<a>" * 100_000 + b"</a>" * 100_000, "Excessive depth", id="nested deeply"),
        (b'<a b="\xe4"/>', "Invalid bytes|not proper UTF-8"),  # the second one by lxml 5
        (b'<?xml version="1.0" encoding="x-none"?><a/>', "encoding"),
    ],
)
def test_xml_that_is_not_read(data: bytes, why: str) -> None:
    with pytest.raises(XmlError, match=why):
        read_xml(data)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_xml_in_other_encodings_is_read(encoding: str) -> None:
    said = "windows-1252" if encoding == "cp1252" else encoding.removesuffix("-sig")
    text = f'<?xml version="1.0" encoding="{said}"?><!-- comment --><a b="ä"><?pi?><c/></a>'
    root = read_xml(text.encode(encoding))
    assert (root.get("b"), [child.tag for child in root]) == ("ä", ["c"])


# Libraries


def test_machines_are_told_by_the_first_bytes() -> None:
    elf = b"\x7fELF\2\1\1" + bytes(11) + struct.pack("<H", 183)
    pe = b"MZ" + bytes(58) + struct.pack("<I", 64) + b"PE\0\0" + struct.pack("<H", 0x8664)
    fat = b"\xca\xfe\xba\xbe" + struct.pack(">I", 2)
    fat += b"".join(struct.pack(">I16x", number) for number in (0x01000007, 0x0100000C))
    assert machine_of(elf) == Machine("Linux", ("64-bit ARM",))
    assert machine_of(pe) == Machine("Windows", ("64-bit x86",))
    assert machine_of(fat) == Machine("macOS", ("64-bit x86", "64-bit ARM"))
    assert machine_of(b"\xcf\xfa\xed\xfe" + struct.pack("<I", 0x0100000C)) == Machine("macOS", ("64-bit ARM",))
    assert machine_of(b"PK\3\4") is None
    assert machine_of_folder("aarch64-darwin") == Machine("macOS", ("64-bit ARM",))
    assert machine_of_folder("linux64") == Machine("Linux", ("64-bit x86",))
    assert machine_of_folder("amiga") is None
    assert machine_of(fat).serves(machine_of_folder("aarch64-darwin"))  # type: ignore[union-attr, arg-type]


def test_the_errors_are_setup_errors() -> None:
    assert issubclass(ArchiveError, SetupError)
    assert issubclass(XmlError, SetupError)


def test_of_one_kind_of_findings_the_first_few_are_kept() -> None:
    """A description may have one for each of its variables."""
    found = FileFindings()
    for k in range(100_000):
        found.add(wrong=f"line {k}: variable 'it{chr(92)}'s {k}' has no type")
    found.add(wrong="line 7: variable 'x' has no name", unclean="other")
    assert len(found.wrong) == 4
    assert found.unclean == ["other"]
