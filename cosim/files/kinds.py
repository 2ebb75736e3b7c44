"""What a file is, whatever it was given for: so that a message can say so, and which command takes it."""

from __future__ import annotations

import re
import tomllib
import zipfile
from dataclasses import dataclass
from pathlib import Path

#: Bytes at the beginning of a file that are looked at.
_BEGINNING = 4096


@dataclass(frozen=True)
class FileKind:
    """A kind of files.

    Attributes
    ----------
    name : str
        With its article.
    remedy : str
        What to do with such a file, which `{path}` stands for.
    endings : tuple of str
        Of the names of its files; those of others are renamed first.
    is_table : bool
        Whether `cosim.results.reading` reads it.
    """

    name: str
    remedy: str
    endings: tuple[str, ...] = ()
    is_table: bool = False

    def advice(self, path: Path) -> str:
        """What to do with a file of this kind."""
        if self.endings and path.suffix.lower() not in self.endings:
            renamed = path.with_suffix(self.endings[0])
            return f"name it {renamed.name}, and {self.remedy.format(path=renamed)}"
        return self.remedy.format(path=path)


_RUN = "run it with: cosim run {path}"
_FEED = "compare it with: cosim compare {path} REFERENCE, or drive an FMU with it: cosim run MODEL.fmu --input {path}"
_SCENARIO_KEYS = {"components", "connections", "run", "system", "title", "start", "disturbances", "metrics"}

FMU = FileKind("an FMU", _RUN, (".fmu",))
SSP = FileKind("an SSP", _RUN, (".ssp",))
SSD = FileKind("the description of an SSP", _RUN, (".ssd",))
OSP = FileKind("an OSP configuration", _RUN, (".xml",))
SSV = FileKind("a parameter set of SSP", "use it with: cosim run SYSTEM.ssp --ssv {path}")
SCENARIO = FileKind("a scenario in TOML", _RUN, (".toml",))
TOLERANCES = FileKind("a TOML file of tolerances", "use it with: cosim compare RESULT REFERENCE --tolerances {path}")
TOML = FileKind("a TOML file", "cosim run takes scenarios in TOML, cosim compare --tolerances takes tolerances")
PARQUET = FileKind("a table in Parquet", _FEED, (".parquet",), is_table=True)
MAT = FileKind("a MAT file", _FEED, (".mat",), is_table=True)
NPZ = FileKind("an archive of NumPy arrays", _FEED, (".npz",), is_table=True)
JSON = FileKind("a JSON file", _FEED, (".json",), is_table=True)
CSV = FileKind("a table in CSV", _FEED, (".csv", ".txt", ".tsv"), is_table=True)
WORKBOOK = FileKind("a workbook of a spreadsheet", "save its sheet as CSV")
ARCHIVE = FileKind("a zip archive without the description of an FMU or an SSP", "check what packed it")
PYTHON = FileKind("a Python file", "run it with: python {path}")
MODEL_DESCRIPTION = FileKind("the description of an FMU alone", "name the FMU that it belongs to")
XML = FileKind("an XML file", "name an FMU, an SSP or a scenario")
LIBRARY = FileKind("a program or a library", "name the FMU that it belongs to")
FOLDER = FileKind("a folder", "name a file in it")
STREAM = FileKind("a device or a pipe", "save what it gives as a file")
EMPTY = FileKind("an empty file", "check what wrote it")
TEXT = FileKind("a text", "cosim run takes scenarios in TOML, FMUs and SSPs")
BINARY = FileKind("a file of unknown kind", "cosim run takes scenarios in TOML, FMUs and SSPs")

#: What an XML file is by its root element.
_ROOTS = {
    "SystemStructureDescription": SSD,
    "OspSystemStructure": OSP,
    "ParameterSet": SSV,
    "fmiModelDescription": MODEL_DESCRIPTION,
}


def kind_of(path: Path) -> FileKind | None:
    """The kind of a file or folder by its content; None where there is none, or it can't be read."""
    if path.is_dir():
        return FOLDER
    try:
        if not path.is_file() and path.exists():  # it might never end, and can be read once only
            return STREAM
        with path.open("rb") as file:
            beginning = file.read(_BEGINNING)
        return _kind(path, beginning)
    except OSError:
        return None


def _kind(path: Path, beginning: bytes) -> FileKind:
    if beginning.startswith(b"PK"):
        return _archive(path)
    for magic, kind in ((b"PAR1", PARQUET), (b"MATLAB ", MAT), (b"\x7fELF", LIBRARY), (b"MZ", LIBRARY)):
        if beginning.startswith(magic):
            return kind
    if not beginning.strip():
        return EMPTY
    if b"Aclass\0" in beginning[:40] or (path.suffix.lower() == ".mat" and b"\0" in beginning):
        return MAT
    try:
        text = beginning.decode("utf-16" if beginning[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig", "ignore")
    except UnicodeDecodeError:
        return BINARY
    return BINARY if "\0" in text else _text(path, text)


def _archive(path: Path) -> FileKind:
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except Exception:  # zipfile raises whatever a damaged archive makes it
        return ARCHIVE
    for member, kind in (
        ("modelDescription.xml", FMU),
        ("SystemStructure.ssd", SSP),
        ("[Content_Types].xml", WORKBOOK),
        ("mimetype", WORKBOOK),
    ):
        if member in names:
            return kind
    return NPZ if names and all(name.endswith(".npy") for name in names) else ARCHIVE


def _text(path: Path, text: str) -> FileKind:
    if text.lstrip().startswith("<"):
        root = re.search(r"<(?:[\w.-]+:)?([A-Za-z]\w*)", text)
        return _ROOTS.get(root[1], XML) if root else XML
    ending = path.suffix.lower()
    if ending == ".py":
        return PYTHON
    first = text.lstrip().partition("\n")[0].strip()
    if re.match(r'"?(time|t)\s*([\[(].*?[\])])?"?\s*([,;\t]|$)', first, re.IGNORECASE):
        return CSV
    if text.lstrip().startswith(("{", "[")) and ending == ".json":
        return JSON
    if ending == ".csv":
        return CSV
    try:
        keys = tomllib.loads(path.read_text(encoding="utf-8")).keys()
    except (OSError, ValueError, RecursionError):
        return SCENARIO if ending == ".toml" else TEXT
    if keys & {"relative", "absolute", "time_shift", "co_simulation", "model_exchange"}:
        return TOLERANCES
    return SCENARIO if keys & _SCENARIO_KEYS else TOML


def not_read(path: Path, wanted: str, why: str, *kinds: FileKind) -> str:
    """One line for a file that can't be read: what it is, where it is something else than what was wanted.

    Parameters
    ----------
    path : Path
    wanted : str
        What was wanted, with its article.
    why : str
        Why it can't be read, for a file that is of a wanted kind, or of none that is known.
    *kinds : FileKind
        Kinds that are wanted.
    """
    kind = kind_of(path)
    if kind is None or kind in (*kinds, BINARY, EMPTY, ARCHIVE, FOLDER):
        return f"{path}: {why}"
    reason = f" ({why.removeprefix(f'not {wanted} (').removesuffix(')')})" if kind is TEXT else ""
    return f"{path}: is {kind.name}, not {wanted}{reason}; {kind.advice(path)}"


def no_table(path: Path) -> str:
    """One line that says what a file is which is not a table, or not of the format that its name says; else empty."""
    kind = kind_of(path)
    if kind is None or kind in (TEXT, EMPTY, BINARY, FOLDER, TOML):
        return ""  # the reader says better what it lacks
    if not kind.is_table:
        return f"{path}: is {kind.name}, not a table; {kind.advice(path)}"
    ending = path.suffix.lower()
    others = {e for k in (PARQUET, MAT, NPZ, JSON) for e in k.endings}
    if ending not in kind.endings and (ending in others or kind is not CSV):
        return f"{path}: is {kind.name}; let its name end in {kind.endings[0]}"
    return ""
