"""Validators that are not ours, on every FMU, and on a broken one, which they must refuse."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from fmpy.validation import validate_fmu

from cosim.pack import pack
from fmu_export.package.archive import replace_members
from interop.tools import maven
from parallel_robot.scenario import load_scenario

#: The Maven package.
VDMCHECK = "org.into-cps.vdmcheck.fmi2:vdmcheck2:1.1.3"


@dataclass(frozen=True)
class Validation:
    """What a validator said.

    Attributes
    ----------
    validator : str
    passed : tuple of Path
        FMUs that it finds nothing in.
    findings : tuple of str
        What it found in the others.
    catches : bool
        Whether it refuses an FMU that is broken.
    reason : str
        Why it could not run; empty where it did.
    """

    validator: str
    passed: tuple[Path, ...] = ()
    findings: tuple[str, ...] = ()
    catches: bool = False
    reason: str = ""

    @property
    def is_good(self) -> bool:
        """Whether nothing has to be looked at."""
        return bool(self.reason) or (self.catches and not self.findings)


def validate(fmus: Path, folder: Path) -> Iterator[Validation]:
    """Run all validators.

    Parameters
    ----------
    fmus : Path
        Folder of FMUs, `<fmus>/<flavour>/*.fmu`.
    folder : Path
        Empty, for files.
    """
    files = [*sorted(fmus.glob("*/*.fmu")), *_packed(fmus, folder)]
    broken = _broken(fmus / "fmi2" / "RobotController.fmu", folder)
    yield _validation("FMPy", _fmpy, files, broken)
    if reason := maven.unavailable("vdmcheck2"):
        yield Validation("VDMCheck2", reason=reason)
        return
    jars = _unpack_vdmcheck(folder)
    fmi2 = [file for file in files if file.parent.name != "fmi3"]
    yield _validation("VDMCheck2", lambda file: _vdmcheck(file, jars), fmi2, broken)


def _packed(fmus: Path, folder: Path) -> list[Path]:
    """The robot's system as one FMU of each version."""
    packed = []
    for version in (2, 3):
        path = folder / "packed" / f"fmi{version}" / "RobotSystem.fmu"
        path.parent.mkdir(parents=True)
        system = load_scenario("tracking").system(fmus, "fmi2")
        packed.append(pack(system, path, 1e-3, stop_time=1.0, fmi=version).path)
    return packed


def _validation(name: str, check: Callable[[Path], list[str]], files: list[Path], broken: Path) -> Validation:
    found = {file: check(file) for file in files}
    return Validation(
        name,
        tuple(file for file, problems in found.items() if not problems),
        tuple(f"{file.parent.name}/{file.name}: {problem}" for file, problems in found.items() for problem in problems),
        bool(check(broken)),
    )


def _broken(fmu: Path, folder: Path) -> Path:
    """A copy of an FMU without the initial unknowns that the standard demands."""
    copy = folder / "broken.fmu"
    shutil.copyfile(fmu, copy)
    with zipfile.ZipFile(fmu) as archive:
        description = archive.read("modelDescription.xml")
    begin, end = description.index(b"<InitialUnknowns>"), description.index(b"</InitialUnknowns>")
    without = description[:begin] + description[end + len(b"</InitialUnknowns>") :]
    replace_members(copy, {"modelDescription.xml": without})
    return copy


def _fmpy(file: Path) -> list[str]:
    return list(validate_fmu(str(file)))


def _vdmcheck(file: Path, folder: Path) -> list[str]:
    command = ["java", "-jar", str(folder / "vdmcheck2.jar"), str(file)]
    lines = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder).stdout.splitlines()
    return [] if lines == ["No errors found."] else lines or ["no answer"]


def _unpack_vdmcheck(folder: Path) -> Path:
    """The layout in which VDMCheck2 is released: its packages without versions in their names, models beside them."""
    target = folder / "vdmcheck"
    target.mkdir()
    for jar in map(Path, maven.class_path("vdmcheck2")):
        shutil.copyfile(jar, target / f"{jar.stem.rpartition('-')[0]}.jar")
        if jar.stem.startswith(("rule-model", "static-model", "vdmcheck2")):
            with zipfile.ZipFile(jar) as archive:
                archive.extractall(target)
    return target
