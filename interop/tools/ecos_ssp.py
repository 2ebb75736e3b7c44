"""Ecos through ecospy, from an SSP.

Trap: it applies no parameters but those of the sets of one name, which the caller says. So all sets of the SSP get one
name here.
"""

from __future__ import annotations

import re
import shutil
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from fmu_export.package.archive import replace_members
from interop.tools import ecos
from interop.tools.case import Case, ToolRun

if TYPE_CHECKING:
    from ecospy import EcosSimulation

NAME = "ecos_ssp"
TITLE = "Ecos, SSP"
PACKAGE = ecos.PACKAGE

unavailable = ecos.unavailable


def run(case: Case, folder: Path) -> ToolRun:
    """As `ecos`, with connections and parameters of the SSP."""
    (ssp,) = case.fmus.values()
    renamed = folder / ssp.name
    shutil.copyfile(ssp, renamed)
    _name_parameter_sets(renamed, ecos.START_VALUES)
    return ecos.record(lambda: _simulation(renamed, case.step_size), case, folder)


@contextmanager
def _simulation(ssp: Path, step_size: float) -> Iterator[EcosSimulation]:
    from ecospy import EcosLib, EcosSimulation

    EcosLib.set_log_level("err")
    with EcosSimulation(step_size=step_size, ssp_path=str(ssp)) as simulation:
        yield simulation
        simulation.terminate()


def _name_parameter_sets(ssp: Path, name: str) -> None:
    with zipfile.ZipFile(ssp) as archive:
        sets = {member: archive.read(member).decode() for member in archive.namelist() if member.endswith(".ssv")}
    pattern = re.compile(r'(<ssv:ParameterSet\b[^>]*?\bname=")[^"]*')
    replace_members(ssp, {member: pattern.sub(rf"\g<1>{name}", text).encode() for member, text in sets.items()})
