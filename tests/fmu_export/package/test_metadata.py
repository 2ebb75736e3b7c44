"""Author, version, copyright and licence of a model, and archives without sources."""

from __future__ import annotations

import zipfile
from pathlib import Path
from xml.etree.ElementTree import fromstring

import pytest
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu

from fmu_export import ArgumentError, Metadata, build_native, build_pythonfmu
from fmu_export.package.description_common import DISTRIBUTION
from fmu_export.package.metadata import project_licence
from tests.support import CHECKOUT
from tests.support.native_fmus import FLAVOURS
from tests.support.tiny_models import LAG

COMPANY = Metadata(
    author="Ada Example, Example & Söhne",
    version="3.1",
    copyright='(c) 2027 "Example" GmbH',
    license="proprietary",
    license_text="Not for you.\n",
)
OURS = f"documentation/licenses/{DISTRIBUTION}.txt"
ALL = pytest.mark.parametrize("flavour", ["pythonfmu", *FLAVOURS])


def built(folder: Path, flavour: str, **options: object) -> zipfile.ZipFile:
    if flavour == "pythonfmu":
        fmu = build_pythonfmu(LAG, folder, **options)  # type: ignore[arg-type]
    else:
        fmu = build_native(LAG, folder, flavour, **options)  # type: ignore[arg-type]
    assert validate_fmu(str(fmu)) == []
    return zipfile.ZipFile(fmu)


@ALL
def test_a_model_says_whose_it_is(tmp_path: Path, flavour: str) -> None:
    with built(tmp_path, flavour, metadata=COMPANY, page="# A lag\n") as archive:
        root = fromstring(archive.read("modelDescription.xml"))
        for name in ("author", "version", "copyright", "license"):
            assert root.get(name) == getattr(COMPANY, name)
        assert archive.read("documentation/licenses/license.txt").decode() == "Not for you.\n"
        # the code around the model is ours and under our licence
        assert archive.read(OURS) == (CHECKOUT / "LICENSE").read_bytes()
        html = archive.read("documentation/index.html").decode()
        assert "Author: Ada Example, Example &amp; Söhne; version 3.1; (c) 2027 &quot;Example&quot; GmbH." in html
        assert 'proprietary licence: <a href="licenses/license.txt">' in html
        assert "MIT" not in html


@ALL
def test_a_model_that_says_nothing_is_under_no_licence(tmp_path: Path, flavour: str) -> None:
    with built(tmp_path, flavour, page="# A lag\n") as archive:
        root = fromstring(archive.read("modelDescription.xml"))
        assert not {"author", "version", "copyright", "license"} & set(root.keys())
        assert "documentation/licenses/license.txt" not in archive.namelist()
        assert archive.read(OURS).decode() == project_licence()
        assert "licence" not in archive.read("documentation/index.html").decode()


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_archives_without_sources(tmp_path: Path, flavour: str) -> None:
    with built(tmp_path, flavour, sources=False, page="# A lag\n") as archive:
        assert not [name for name in archive.namelist() if name.startswith("sources/") or name.endswith((".c", ".h"))]
        assert b"SourceFile" not in archive.read("modelDescription.xml")
        assert "sources" not in archive.read("documentation/index.html").decode()
    result = simulate_fmu(str(tmp_path / "Lag.fmu"), stop_time=0.1, start_values={"u": 1.0}, output=["x"])
    assert result["x"][-1] > 0.0


@pytest.mark.parametrize("name", ["author", "version", "copyright", "license"])
def test_texts_are_printable(name: str) -> None:
    with pytest.raises(ArgumentError, match=f"metadata: {name} has the character"):
        Metadata(**{name: "two\nlines"})
    with pytest.raises(ArgumentError, match=f"metadata: {name} is 3, which is not a text"):
        Metadata(**{name: 3})  # type: ignore[arg-type]
