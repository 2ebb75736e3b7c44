"""What is locked: all that pyproject.toml names, with hashes, and nothing about where it came from."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import pytest
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.support import CHECKOUT, some

FOLDER = CHECKOUT / "requirements"
PROJECT = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
OWN = PROJECT["name"]

ADVICE = "python requirements/update.py writes it anew"


def declared(extra: str) -> list[Requirement]:
    """The packages that an extra needs, and the extras in it; without one, those of the package itself."""
    found: list[Requirement] = []
    for text in PROJECT["optional-dependencies"][extra] if extra else PROJECT["dependencies"]:
        requirement = Requirement(text)
        if requirement.name == OWN:
            found += [more for name in sorted(requirement.extras) for more in declared(name)]
        else:
            found.append(requirement)
    return found + (declared("") if extra else [])


def locked(path: Path) -> dict[str, list[tuple[str, int]]]:
    """Name -> versions, and number of hashes of each."""
    found: dict[str, list[tuple[str, int]]] = {}
    for entry in re.split(r"\n(?=\S)", path.read_text(encoding="utf-8").strip()):
        first, *hashes = [line.rstrip(" \\").strip() for line in entry.splitlines()]
        name, _, version = first.partition(";")[0].strip().partition("==")
        assert version, f"{path.name}: {first} is not pinned"
        assert all(re.fullmatch(r"--hash=sha256:[0-9a-f]{64}", line) for line in hashes), first
        found.setdefault(canonicalize_name(name.partition("[")[0]), []).append((version, len(hashes)))
    return found


@pytest.mark.parametrize(("name", "extra"), [("run.txt", ""), ("all.txt", "all"), ("test.txt", "test")])
def test_all_that_is_declared_is_locked_with_hashes(name: str, extra: str) -> None:
    found = locked(FOLDER / name)
    for requirement in some(declared(extra)):
        versions = found.get(canonicalize_name(requirement.name))
        assert versions, f"{name} lacks {requirement}; {ADVICE}"
        for version, _ in versions:
            assert requirement.specifier.contains(version), f"{name} has {requirement.name} {version}; {ADVICE}"
    assert all(hashes for versions in found.values() for _, hashes in versions)


@pytest.mark.parametrize("name", ["run.txt", "all.txt", "test.txt", "sbom.json"])
def test_no_file_says_where_packages_lie(name: str) -> None:
    text = (FOLDER / name).read_text(encoding="utf-8").replace("http://cyclonedx.org/schema/bom-1.6.schema.json", "")
    assert "://" not in text
    assert "--index" not in text


def test_the_bill_of_materials_is_that_of_the_lock() -> None:
    text = (FOLDER / "sbom.json").read_text(encoding="utf-8")
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(text) is None
    bill = json.loads(text)
    assert "serialNumber" not in bill
    assert "timestamp" not in bill["metadata"]
    assert (bill["metadata"]["component"]["name"], bill["metadata"]["component"]["version"]) == (
        OWN,
        PROJECT["version"],
    )
    listed = {(canonicalize_name(part["name"]), part["version"]) for part in bill["components"]}
    lock = {(name, version) for name, versions in locked(FOLDER / "all.txt").items() for version, _ in versions}
    assert listed == lock, ADVICE
