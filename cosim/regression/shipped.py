"""References that an FMU brings along, after FMI's layered standard for references, as cases.

The standard (fmi-ls-ref 1.0.0-beta.1) says which files of the archive belong to the FMU in which role; experiments with
parameters, stimuli and reference results are files of the Modelica Association's format (ma-hs-experiments). What both
leave open is decided here, and said in docs/regression.md.
"""

from __future__ import annotations

import csv
import io
import posixpath
import re
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree

import numpy as np

from cosim.errors import CosimError
from cosim.files.temporary import TemporaryFolder
from cosim.fmi.fmu_file import read_fmu
from cosim.regression.case import Case, CaseError, find_cases
from cosim.regression.options import Options, write_options
from cosim.results.results import Results
from cosim.system.variables import Ports

#: The folder of the layered standard in an FMU.
FOLDER = "extra/org.fmi-standard.fmi-ls-ref/"
MANIFEST = f"{FOLDER}fmi-ls-manifest.xml"

#: Types of files with experiments: the present one, the one before, and none.
_EXPERIMENTS = ("application/x-ma-hs-experiments", "application/x-ma-ls-experiments", "application/octet-stream")

#: Files that are larger are refused.
_MOST_BYTES = 256 * 1024**2

#: Allowed difference, of the range of a signal, where the maker says nothing: printed results may have few digits.
_RELATIVE = 1e-4

_SSD = """<?xml version="1.0" encoding="UTF-8"?>
<SystemStructureDescription xmlns="http://ssp-standard.org/SSP1/SystemStructureDescription" version="1.0" name="one">
<System name="one"><Elements>
<Component name="fmu" type="application/x-fmu-sharedlibrary" source="one.fmu">
<ParameterBindings><ParameterBinding source="set.ssv"/></ParameterBindings>
</Component>
</Elements></System>
<DefaultExperiment startTime="0" stopTime="1"/>
</SystemStructureDescription>
"""


@dataclass(frozen=True)
class ShippedCase(Case):
    """A case out of an FMU: unpacked files, and what its experiment says.

    Attributes
    ----------
    given : mapping
        Tables as in a file of tolerances.
    tolerances_file : Path
        Tolerances that a user has for this case; they take precedence.
    """

    given: Mapping[str, Any] = field(default_factory=dict)
    tolerances_file: Path | None = None

    @property
    def tolerances_path(self) -> Path:
        """Tolerances of the user; where there are none, a name for messages."""
        return self.tolerances_file or super().tolerances_path

    @property
    def _tables(self) -> dict[str, Any]:
        own = self._own_tables
        start = {**self.given.get("start", {}), **own.get("start", {})}
        return {**self.given, **own, "start": start}


@dataclass
class Shipped:
    """Cases of an FMU, and a line for each thing of its manifest that is not tried."""

    cases: list[Case] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def all_cases(fmu: Path, reference: Path | None, folder: Path) -> Shipped:
    """The cases of an FMU: those of a user (`find_cases`), then those that it brings along.

    Of a case that the FMU brings along, a user can have the tolerances: `<case>_ref.toml`, in a folder `<case>` or not.

    Parameters
    ----------
    fmu : Path
    reference : Path, optional
        Folder of cases; by default as in `find_cases`.
    folder : Path
        As in `shipped_cases`.

    Raises
    ------
    CaseError
        As in `shipped_cases`.
    """
    places = [reference] if reference is not None else [fmu.parent, fmu.parent / "reference", Path("reference")]

    def tolerances(name: str) -> Path | None:
        files = [place / part / f"{name}_ref.toml" for place in places for part in (name, "")]
        return next((path for path in files if path.is_file()), None)

    own = find_cases(fmu, reference)
    found = shipped_cases(fmu, folder, tolerances)
    names = {case.name for case in found.cases}
    own = [case for case in own if case.name not in names or case.reference_path.is_file()]
    names = {case.name for case in own}
    return Shipped([*own, *(case for case in found.cases if case.name not in names)], found.notes)


def shipped_cases(fmu: Path, folder: Path, tolerances: Callable[[str], Path | None] = lambda _: None) -> Shipped:
    """The cases that an FMU brings along.

    Parameters
    ----------
    fmu : Path
    folder : Path
        Their files are unpacked into it; it must live as long as the cases.
    tolerances : callable, optional
        The file of tolerances that takes precedence, by the name of a case; None for none.

    Returns
    -------
    Shipped
        Empty where the FMU has no manifest.

    Raises
    ------
    CaseError
        The manifest or an experiment is malformed; the message names the member of the archive.
    """
    try:
        with zipfile.ZipFile(fmu) as archive:
            if MANIFEST not in archive.namelist():
                return Shipped()
            reader = _Reader(fmu, archive, folder, tolerances)
            reader.read()
            return reader.found
    except (zipfile.BadZipFile, OSError) as error:
        raise CaseError(f"{fmu}: its references can't be read: {error}") from error


class _Reader:
    """Reads the manifest of one FMU and writes the files of its cases."""

    def __init__(
        self, fmu: Path, archive: zipfile.ZipFile, folder: Path, tolerances: Callable[[str], Path | None]
    ) -> None:
        self.found = Shipped()
        self._fmu, self._archive, self._folder, self._tolerances = fmu, archive, folder, tolerances
        self._members = set(archive.namelist())

    def read(self) -> None:
        """Find the cases: experiments, and the results that belong to none of them."""
        root = self._xml(MANIFEST)
        results: list[str] = []
        used: set[str] = set()
        for related in root.iter():
            if _local(related) != "Related":
                continue
            role, kind = related.get("role", ""), related.get("type", "application/octet-stream")
            main, _, purpose = role.partition("/")
            if main == "experiment" and purpose == "uncertainty-analysis":
                self._note(related.get("source", ""), "is for an uncertainty analysis")
            elif main == "experiment" and (member := self._member(MANIFEST, related)):
                if kind in _EXPERIMENTS:
                    used |= self._experiments(member)
                else:
                    self._note(member, f"is of type {kind}, which is not read")
            elif main == "result" and (member := self._member(MANIFEST, related)):
                if _is_csv(member, kind):
                    results.append(member)
                else:
                    self._note(member, f"is of type {kind}; results are read from CSV files only")
        free = [member for member in dict.fromkeys(results) if member not in used]
        if len(free) == 1:  # nothing says of which run it is: the run that needs nothing but the FMU
            self._case(Path(free[0]).stem, reference=free[0])
        else:
            for member in free:
                self._note(member, "is one of several results, and no experiment says of which run it is")

    def _experiments(self, member: str) -> set[str]:
        """Cases of a file of experiments; the members that are their references."""
        used: set[str] = set()
        root = self._xml(member)
        if _local(root) != "Experiments":
            raise CaseError(f"{self._fmu}: {member}: <{_local(root)}> is not <Experiments>")
        for element in root:
            if _local(element) != "Experiment":
                continue
            name = element.get("name", "")
            here = f"{member}: experiment '{name}'"
            parts = {_local(child): child for child in element}
            other = next((tag for tag in parts if tag not in _PARTS), None)
            if other is not None:
                self._note(here, f"is not a transient simulation, but <{other}>")
                continue
            files: dict[str, str | None] = {}
            for tag in ("Parameters", "Stimuli", "References"):
                part = parts.get(tag)
                files[tag] = self._member(member, part) if part is not None else None
            if missing := [tag for tag in ("Parameters", "Stimuli", "References") if tag in parts and not files[tag]]:
                self._note(here, f"is not tried for want of its {missing[0].lower()}")
                continue
            if unread := self._unread(parts):
                self._note(here, unread)
                continue
            used |= {files["References"]} - {None}  # type: ignore[arg-type]
            settings = parts.get("TransientSimulation", element)
            numbers = {
                key: _number(self._fmu, here, key, (element if key == "tolerance" else settings).get(key))
                for key in ("startTime", "stopTime", "stepSize", "tolerance")
            }
            start = self._start(files["Parameters"]) if files["Parameters"] else {}
            self._case(name, files["References"], files["Stimuli"], numbers, start)
        return used

    def _unread(self, parts: Mapping[str, ElementTree.Element]) -> str:
        """Why an experiment can't be run, empty where it can."""
        for tag, default in (("Stimuli", "text/csv"), ("References", "text/csv")):
            kind = parts[tag].get("type", default) if tag in parts else default
            if kind != default:
                return f"is not tried: its {tag.lower()} are of type {kind}, and CSV files only are read"
        default = "application/x-ssp-parameter-set"
        kind = parts["Parameters"].get("type", default) if "Parameters" in parts else default
        return (
            "" if kind == default else f"is not tried: its parameters are of type {kind}, and SSV files only are read"
        )

    def _case(
        self,
        name: str,
        reference: str | None = None,
        stimuli: str | None = None,
        numbers: Mapping[str, float | None] | None = None,
        start: Mapping[str, Any] | None = None,
    ) -> None:
        """Write the files of a case."""
        taken = {case.name for case in self.found.cases}
        plain = re.sub(r"[^\w.-]+", "_", name) or "experiment"
        plain = next(n for n in (plain, *(f"{plain}_{k}" for k in range(2, len(taken) + 3))) if n not in taken)
        numbers = numbers or {}
        tolerance = numbers.get("tolerance")
        given: dict[str, Any] = {
            "relative": max(_RELATIVE, tolerance or 0.0),
            "absolute": 1e-12,
            "solver": "either",
            "reference": reference is not None,
            "start": dict(start or {}),
        }
        case = ShippedCase(plain, self._folder / plain, given, self._tolerances(plain))
        case.folder.mkdir(parents=True)
        for member, path in ((reference, case.reference_path), (stimuli, case.inputs_path)):
            if member is not None:
                path.write_text(self._table(member, inputs=path == case.inputs_path), encoding="utf-8")
        self._options(case, numbers)
        self.found.cases.append(case)

    def _options(self, case: Case, numbers: Mapping[str, float | None]) -> None:
        """Write what the experiment says of times; the rest is left to the reference and to the FMU."""
        rows = Results.from_csv(case.reference_path).time if case.reference_path.is_file() else np.zeros(0)
        start, stop = numbers.get("startTime"), numbers.get("stopTime")
        if stop is None and not len(rows):
            return
        start = start if start is not None else float(rows[0]) if len(rows) else 0.0
        stop = stop if stop is not None else float(rows[-1])
        if len(rows) and (start > rows[0] or stop > rows[-1]):  # rows that end before: so did the run
            stop = float(rows[-1])
        step = numbers.get("stepSize") or 0.0
        if len(rows) > 1 and step > (rows[-1] - rows[0]) / (len(rows) - 1) * (1 + 1e-9):
            step = 0.0  # longer than from row to row: as the rows
        write_options(Options(start, stop, step, numbers.get("tolerance")), case.options_path)

    def _start(self, member: str) -> dict[str, Any]:
        """Start values of a parameter set: what a component that is bound to it gets, without prefix and mapping."""
        from cosim.ssp import read_ssp

        with TemporaryFolder() as name:
            folder = Path(name)
            (folder / "set.ssv").write_bytes(self._archive.read(member))
            description = folder / "SystemStructure.ssd"
            description.write_text(_SSD, encoding="utf-8")
            with zipfile.ZipFile(folder / "one.fmu", "w") as one:  # its description is all that is looked at
                one.writestr("modelDescription.xml", self._archive.read("modelDescription.xml"))
            try:
                read = read_ssp(description, folder)
            except CosimError as error:
                raise CaseError(f"{self._fmu}: {member}: {error}") from error
        self.found.notes += [f"{member.removeprefix(FOLDER)}: {note.rpartition('set.ssv: ')[2]}" for note in read.notes]
        (component,) = read.system.components.values()
        return dict(component.start)

    def _table(self, member: str, *, inputs: bool) -> str:
        """A table as a case has it: the time is named so, and a cell with several numbers is a cell for each.

        Columns of results that the FMU has no variables for are left out: makers ship one file with FMUs of both
        versions of FMI, whose variables differ.
        """
        text = self._read(member).decode("utf-8-sig", errors="replace")
        rows = [row for row in csv.reader(io.StringIO(text)) if row]
        if not rows:
            raise CaseError(f"{self._fmu}: {member}: has no rows")
        header = ["time" if i == 0 and name.strip().lower() == "time" else name for i, name in enumerate(rows[0])]
        columns: list[tuple[str, ...]] = list(zip(*rows[1:], strict=False)) or [()] * len(header)
        if any(len(row) != len(header) for row in rows[1:]):
            raise CaseError(f"{self._fmu}: {member}: rows differ in their number of columns")
        wide = [(header[0], *columns[0])]
        unknown = []
        for name, column in zip(header[1:], columns[1:], strict=True):
            cells = [cell.split() for cell in column]
            names = self._elements_of(name)
            if not names and not inputs:
                unknown.append(name)
                continue
            if len(names) > 1 and all(len(c) == len(names) for c in cells):
                wide += [(element, *(c[k] for c in cells)) for k, element in enumerate(names)]
            else:
                wide.append((name, *column))
        if len(wide) == 1 and unknown:
            raise CaseError(f"{self._fmu}: {member}: the FMU has none of its variables, such as '{unknown[0]}'")
        if unknown:
            self._note(member, f"has columns for which the FMU has no variables: {', '.join(unknown)}")
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerows(zip(*wide, strict=True))
        return stream.getvalue()

    def _elements_of(self, name: str) -> list[str]:
        """Names of the elements of an array; no names for other variables."""
        try:
            return [element.name for element in self._ports.find(name)]
        except CosimError:
            return []

    @cached_property
    def _ports(self) -> Ports:
        return Ports("fmu", read_fmu(self._fmu, str(self._fmu)).description)

    def _member(self, here: str, element: ElementTree.Element) -> str | None:
        """The member of the archive that an attribute `source` names; None, with a note, where there is none."""
        source = element.get("source", "")
        parts = urlsplit(source)
        if parts.scheme or parts.netloc:
            self._note(source, "is not a file of the FMU; it is not fetched")
            return None
        member = posixpath.normpath(posixpath.join(posixpath.dirname(here), unquote(parts.path)))
        if member not in self._members:
            self._note(here, f"names '{source}', which the FMU lacks")
            return None
        return member

    def _read(self, member: str) -> bytes:
        if self._archive.getinfo(member).file_size > _MOST_BYTES:
            raise CaseError(f"{self._fmu}: {member}: has more than {_MOST_BYTES // 1024**2} MiB")
        return self._archive.read(member)

    def _xml(self, member: str) -> ElementTree.Element:
        try:
            return ElementTree.fromstring(self._read(member))
        except ElementTree.ParseError as error:
            raise CaseError(f"{self._fmu}: {member}: is not XML: {error}") from error

    def _note(self, what: str, why: str) -> None:
        self.found.notes.append(f"{what.removeprefix(FOLDER)} {why}")


#: Elements of an experiment; others say that it is another analysis.
_PARTS = ("TransientSimulation", "Parameters", "Stimuli", "References", "Annotations")


def _local(element: ElementTree.Element) -> str:
    return str(element.tag).rpartition("}")[2]


def _is_csv(member: str, kind: str) -> bool:
    return kind in ("text/csv", "application/csv") or (
        kind == "application/octet-stream" and member.lower().endswith(".csv")
    )


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _number(fmu: Path, here: str, key: str, text: str | None) -> float | None:
    if text is None:
        return None
    if not _is_number(text):
        raise CaseError(f'{fmu}: {here}: {key}="{text}" is not a number')
    return float(text)
