"""What others' work an FMU contains, and under which licences: a bill of materials in CycloneDX's JSON.

It has no time and no serial number, for equal FMUs have equal bytes. It is written here, and not by CycloneDX's
library, for these bytes must not depend on the version of one more package; a test has that library check it.
"""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version

from fmu_export.package.description_common import DISTRIBUTION, package_version
from fmu_export.package.metadata import Metadata

MEMBER = "extra/org.cyclonedx/bom.json"

#: Folder of the licences in an archive.
LICENCES = "documentation/licenses/"


@dataclass(frozen=True)
class Material:
    """Somebody's work in an archive.

    Attributes
    ----------
    name, version : str
    licence : str
        By its SPDX identifier.
    purl : str
        Package URL, empty where it comes in no package.
    sign : str
        A member that is there where it is; empty for what is everywhere.
    about : str
        Which part of the archive it is.
    """

    name: str
    version: str
    licence: str
    purl: str
    sign: str
    about: str


def materials() -> list[Material]:
    """All that can be in the FMUs of this exporter."""
    ours, theirs = package_version(), _version("pythonfmu")
    return [
        Material(DISTRIBUTION, ours, "MIT", f"pkg:pypi/{DISTRIBUTION}@{ours}", "", "code that was written and added"),
        Material("musl", "1.2.5", "MIT", "pkg:generic/musl@1.2.5", f"{LICENCES}musl.txt", "elementary functions"),
        Material(
            "pythonfmu",
            theirs,
            "MIT",
            f"pkg:pypi/pythonfmu@{theirs}",
            f"{LICENCES}pythonfmu.txt",
            "binaries that run Python",
        ),
        *(
            Material(f"FMI {n} headers", n, "BSD-2-Clause", "", f"sources/fmi{n[0]}Functions.h", "headers in C")
            for n in ("2.0", "3.0")
        ),
    ]


def bill_of_materials(name: str, metadata: Metadata, members: Collection[str]) -> dict[str, bytes]:
    """The bill of an archive, as a member of it.

    Parameters
    ----------
    name : str
        Of the model.
    metadata : Metadata
    members : collection of str
        Names of all other members.
    """
    root: dict[str, object] = {"type": "library", "bom-ref": "fmu", "name": name}
    if metadata.version:
        root["version"] = metadata.version
    if metadata.license:
        root["licenses"] = [{"license": {"name": metadata.license}}]
    found = [material for material in materials() if not material.sign or material.sign in members]
    bill = {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": root},
        "components": [_component(material) for material in found],
        "dependencies": [{"ref": "fmu", "dependsOn": [material.name for material in found]}],
    }
    return {MEMBER: (json.dumps(bill, indent=1) + "\n").encode()}


def _component(material: Material) -> dict[str, object]:
    return {
        "type": "library",
        "bom-ref": material.name,
        "name": material.name,
        "version": material.version,
        "description": material.about,
        "licenses": [{"license": {"id": material.licence}}],
        **({"purl": material.purl} if material.purl else {}),
    }


@cache  # it takes a while to look up
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # then nothing of it is in any FMU
        return ""
