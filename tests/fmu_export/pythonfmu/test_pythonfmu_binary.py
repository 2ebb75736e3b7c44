"""The one defect of pythonfmu's Linux binary is mended, and nothing else of it is touched."""

from __future__ import annotations

import importlib.util
import struct
import sys
import zipfile
from pathlib import Path

import pytest
import pythonfmu

from fmu_export.pythonfmu.binary import BinariesMissing, binaries, mended

ORIGINAL = Path(pythonfmu.__file__).parent / "resources/binaries/linux64/libpythonfmu-export.so"


def entries_of_fini_array(elf: bytes) -> int:
    """Number of functions that an ELF64 library runs when it is finished (DT_FINI_ARRAYSZ / 8)."""
    (headers,) = struct.unpack_from("<Q", elf, 32)
    size, count = struct.unpack_from("<HH", elf, 54)
    for i in range(count):
        kind, _, offset, _, _, length = struct.unpack_from("<IIQQQQ", elf, headers + i * size)
        if kind == 2:  # PT_DYNAMIC
            tags = dict(struct.iter_unpack("<QQ", elf[offset : offset + length]))
            return tags[0x1C] // 8
    raise AssertionError("no dynamic section")


def test_library_destroys_the_interpreter_state_once(fmus: Path) -> None:
    with zipfile.ZipFile(fmus / "RobotPlant.fmu") as archive:
        binary = archive.read("binaries/linux64/RobotPlant.so")
    original = ORIGINAL.read_bytes()
    assert entries_of_fini_array(original) == 2
    assert entries_of_fini_array(binary) == 1
    assert sum(a != b for a, b in zip(original, binary, strict=True)) == 1


def test_unknown_binaries_are_taken_as_they_are() -> None:
    original = ORIGINAL.read_bytes()
    assert mended(original + b"\0") == original + b"\0"
    assert mended(mended(original)) == mended(original)


def test_a_pythonfmu_that_an_fmu_has_brought_does_not_stand_in(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """FMUs of pythonfmu's own builder have a `pythonfmu` in their resources, without binaries."""
    brought = importlib.util.spec_from_file_location("pythonfmu", tmp_path / "__init__.py")
    assert brought is not None
    module = importlib.util.module_from_spec(brought)
    monkeypatch.setitem(sys.modules, "pythonfmu", module)
    assert {name.split("/")[1] for name in binaries("Model")} >= {"linux64", "win64"}


def test_an_installation_without_binaries_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    class Broken:
        def locate_file(self, path: str) -> Path:
            return tmp_path / path

    monkeypatch.setattr("fmu_export.pythonfmu.binary.distribution", lambda name: Broken())
    with pytest.raises(BinariesMissing, match="has no binaries; install pythonfmu again"):
        binaries("Model")
