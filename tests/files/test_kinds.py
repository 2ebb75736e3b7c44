"""Files of another kind than is wanted: each command says what the file is, and which command takes it."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cosim import Results, ResultsError
from cosim.__main__ import main
from cosim.files.kinds import kind_of

FILES = {
    "table": ("a table in CSV", b"time,x\n0,1\n"),
    "parquet": ("a table in Parquet", None),
    "mat": ("a MAT file", None),
    "npz": ("an archive of NumPy arrays", None),
    "json": ("a JSON file", None),
    "fmu": ("an FMU", {"modelDescription.xml": "<fmiModelDescription/>"}),
    "ssp": ("an SSP", {"SystemStructure.ssd": "<SystemStructureDescription/>"}),
    "xlsx": ("a workbook of a spreadsheet", {"[Content_Types].xml": ""}),
    "ssd": ("the description of an SSP", b'<?xml version="1.0"?>\n<ssd:SystemStructureDescription name="a"/>'),
    "ssv": ("a parameter set of SSP", b"<ssv:ParameterSet/>"),
    "xml": ("an OSP configuration", b"<!-- a --><OspSystemStructure/>"),
    "toml": ("a scenario in TOML", b"[components]\na.fmu = 'a.fmu'\n"),
    "tolerances": ("a TOML file of tolerances", b"relative = 1e-3\n"),
    "txt": ("a text", b"hello, world\n"),
    "py": ("a Python file", b"import cosim\n"),
}


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of each kind, with the ending of that kind as its name."""
    monkeypatch.chdir(tmp_path)
    for name, (_, content) in FILES.items():
        path = Path(f"a.{name}")
        if isinstance(content, bytes):
            path.write_bytes(content)
        elif content is None:
            Results(np.arange(2.0), ["x"], np.ones((2, 1))).save(path)
        else:
            with zipfile.ZipFile(path, "w") as archive:
                for member, text in content.items():
                    archive.writestr(member, text)
    return tmp_path


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize("name", FILES)
def test_the_kind_of_a_file_is_that_of_its_content(name: str) -> None:
    kind = kind_of(Path(f"a.{name}"))
    assert kind is not None
    assert kind.name == FILES[name][0]
    renamed = Path(f"a.{name}").rename("b.bin")
    again = kind_of(renamed)
    if name not in ("json", "py"):
        assert again is kind


def line(capsys: pytest.CaptureFixture[str]) -> str:
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("cosim: ")
    assert shown.err.count("\n") == 1
    return shown.err


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("run a.table", "a.table: is a table in CSV, not a scenario in TOML; name it a.csv, and compare it with"),
        ("run a.parquet", "is a table in Parquet, not a scenario in TOML; compare it with: cosim compare a.parquet"),
        ("run a.mat", "drive an FMU with it: cosim run MODEL.fmu --input a.mat"),
        ("run a.xlsx", "is a workbook of a spreadsheet, not a scenario in TOML; save its sheet as CSV"),
        (
            "run a.ssv",
            "is a parameter set of SSP, not a scenario in TOML; use it with: cosim run SYSTEM.ssp --ssv a.ssv",
        ),
        ("run a.tolerances", "is a TOML file of tolerances, not a scenario in TOML; use it with: cosim compare RESULT"),
        ("run a.txt", "is a text, not a scenario in TOML (can't be read as TOML"),
        ("run a.py", "is a Python file, not a scenario in TOML; run it with: python a.py"),
        ("sweep a.json", "is a JSON file, not a scenario in TOML"),
        ("compare a.fmu a.table --tolerances a.tolerances", "a.fmu: is an FMU, not a table; run it with"),
        ("compare a.table a.fmu", "a.fmu: is an FMU, not a table; run it with: cosim run a.fmu"),
        ("compare a.table a.toml", "is a scenario in TOML, not a table; run it with: cosim run a.toml"),
        ("compare a.table a.table --tolerances a.ssp", "is an SSP, not a TOML file of tolerances; run it with"),
        ("compare a.table a.table --tolerances a.toml", "is a scenario in TOML, not a TOML file of tolerances"),
        ("compare a.table a.table --tolerances a.parquet", "is a table in Parquet, not a TOML file of tolerances"),
    ],
)
def test_every_command_says_what_a_file_is(capsys: pytest.CaptureFixture[str], command: str, says: str) -> None:
    assert main(command.split()) == 1
    assert says in line(capsys)


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize(
    ("name", "as_what", "says"),
    [
        (
            "a.toml",
            "b.fmu",
            "b.fmu: is a scenario in TOML, not an FMU; name it b.toml, and run it with: cosim run b.toml",
        ),
        ("a.parquet", "b.fmu", "b.fmu: is a table in Parquet, not an FMU; name it b.parquet"),
        ("a.fmu", "b.ssp", "b.ssp: is an FMU, not an SSP; name it b.fmu, and run it with: cosim run b.fmu"),
        ("a.table", "b.ssp", "b.ssp: is a table in CSV, not an SSP"),
        ("a.fmu", "b.toml", "b.toml: is an FMU, not a scenario in TOML; name it b.fmu"),
        ("a.ssd", "b.xml", "b.xml: is the description of an SSP, not an OSP configuration; name it b.ssd"),
    ],
)
def test_a_wrong_ending_is_seen(capsys: pytest.CaptureFixture[str], name: str, as_what: str, says: str) -> None:
    Path(name).rename(as_what)
    assert main(["run", as_what]) == 1
    assert says in line(capsys)


@pytest.mark.usefixtures("files")
def test_validate_says_what_is_no_fmu(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", "a.ssp", "a.parquet", "a.npz"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [shown.partition(", not an FMU; ")[0] for shown in lines] == [
        "a.ssp: is an SSP",
        "a.parquet: is a table in Parquet",
        "a.npz: is an archive of NumPy arrays",
    ]


@pytest.mark.parametrize("content", [b"\n \n", b"\xf8\xf6\xd8\xd4", b" "])
@pytest.mark.parametrize("ending", ["fmu", "json", "toml"])
def test_a_file_of_blanks_and_of_bytes_that_are_no_text_has_a_kind(tmp_path: Path, content: bytes, ending: str) -> None:
    path = tmp_path / f"file.{ending}"
    path.write_bytes(content)
    assert kind_of(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this platform has no named pipes")
def test_what_never_ends_or_never_begins_is_no_table(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (Path("/dev/zero"), tmp_path / "pipe"):
        with pytest.raises(ResultsError, match="is a device or a pipe, not a table; save what it gives as a file"):
            Results.read(path)
