"""What FMUs contain of others is listed, in CycloneDX's form, and its licences are there and allow it."""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path

import pytest
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator

from fmu_export import Metadata, build_native, build_script
from fmu_export.package.bill_of_materials import MEMBER
from tests.support import some
from tests.support.native_fmus import DEFAULT_FLAVOUR
from tests.support.tiny_models import LAG

#: Licences under which others' work may be in an FMU that somebody sells, and words of their texts.
ALLOWED = {
    "MIT": "Permission is hereby granted, free of charge",
    "BSD-2-Clause": "Redistributions in binary form must reproduce",
}

#: Others' files in an archive -> whose they are. Each file must belong to somebody.
OWNERS = (
    (r"binaries/.*", "pythonfmu or closed-chain-cosim"),
    (r"sources/fmi2\w+\.h", "FMI 2.0 headers"),
    (r"sources/fmi3\w+\.h", "FMI 3.0 headers"),
    (r"sources/(?!libm\b|libm_|acosh_domain)\w+\.inc|sources/\w+_data\.h", "musl"),
    (r"resources/pythonfmu/.*", "pythonfmu"),
)


def bill_of(archive: zipfile.ZipFile) -> dict[str, dict[str, object]]:
    text = archive.read(MEMBER).decode()
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(text) is None
    bill = json.loads(text)
    assert "serialNumber" not in bill
    assert "timestamp" not in bill["metadata"]
    found = {part["name"]: part for part in bill["components"]}
    assert bill["dependencies"] == [{"ref": "fmu", "dependsOn": list(found)}]
    return found


def licence_of(part: dict[str, object]) -> str:
    ((known,),) = (part["licenses"],)  # type: ignore[misc]
    return str(known["license"]["id"])


def check(archive: zipfile.ZipFile) -> set[str]:
    """Whether all in an archive is listed, and its licences are in it and allow it; the names of the parts."""
    names = archive.namelist()
    found = bill_of(archive)
    texts = [archive.read(n).decode() for n in names if re.match(r"documentation/licenses/|sources/fmi\d\w*\.h", n)]
    for part in found.values():
        assert any(ALLOWED[licence_of(part)] in " ".join(text.split()) for text in texts), part["name"]
    for name in names:
        for pattern, owner in OWNERS:
            if re.fullmatch(pattern, name) and " or " not in owner:
                assert owner in found, name
    return set(found)


def check_all(fmus: Path, flavour: str) -> None:
    expected = {"closed-chain-cosim", "pythonfmu" if flavour == "pythonfmu" else f"FMI {flavour[3]}.0 headers"}
    for path in some(sorted((fmus / flavour).glob("*.fmu"))):
        with zipfile.ZipFile(path) as archive:
            assert check(archive) - {"musl"} == expected
            assert ("musl" in bill_of(archive)) == ("documentation/licenses/musl.txt" in archive.namelist())


@pytest.mark.parametrize("flavour", sorted({"pythonfmu", DEFAULT_FLAVOUR}))
def test_the_bill_of_the_robots_fmus_has_all_that_they_contain(robot_fmus: Path, flavour: str) -> None:
    check_all(robot_fmus, flavour)


@pytest.mark.slow
def test_so_do_those_of_fmi_3(native_fmus: Path) -> None:
    check_all(native_fmus, "fmi3")


def test_a_model_says_whose_it_is_in_its_bill(tmp_path: Path) -> None:
    fmu = build_native(LAG, tmp_path, "fmi2", metadata=Metadata(version="3.1", license="proprietary"), sources=False)
    with zipfile.ZipFile(fmu) as archive:
        assert check(archive) == {"closed-chain-cosim"}  # the headers are not in it
        root = json.loads(archive.read(MEMBER))["metadata"]["component"]
    assert (root["name"], root["version"]) == ("Lag", "3.1")
    assert root["licenses"] == [{"license": {"name": "proprietary"}}]


def test_a_script_has_a_bill(tmp_path: Path) -> None:
    (tmp_path / "gain.py").write_text(
        "from pythonfmu import Fmi2Slave\n\n\n"
        "class Gain(Fmi2Slave):\n    def do_step(self, time, step):\n        return True\n"
    )
    with zipfile.ZipFile(build_script(tmp_path / "gain.py", tmp_path)) as archive:
        assert {"closed-chain-cosim", "pythonfmu"} <= set(bill_of(archive))
