"""A corpus of broken and hostile files, made by a script: FMUs, SSPs, scenarios, references, each with what should be.

`all_cases()` has them all. Nothing of it lies in the repository but the sources of two FMUs in C.
"""

from __future__ import annotations

from tests.support.corpus.case import REFUSED, RUNS, STOPS, Case, Materials
from tests.support.corpus.descriptions import DESCRIPTIONS
from tests.support.corpus.libraries import LIBRARIES
from tests.support.corpus.references import REFERENCES
from tests.support.corpus.scenarios import SCENARIOS
from tests.support.corpus.systems import SYSTEMS
from tests.support.corpus.zips import ZIPS

__all__ = [
    "ARCHIVES",
    "REFERENCES",
    "REFUSED",
    "RUNS",
    "SCENARIOS",
    "STOPS",
    "SYSTEMS",
    "Case",
    "Materials",
    "all_cases",
]

#: FMU files.
ARCHIVES = (*ZIPS, *DESCRIPTIONS, *LIBRARIES)


def all_cases() -> tuple[Case, ...]:
    """All cases, by kind."""
    return (*ARCHIVES, *SYSTEMS, *SCENARIOS, *REFERENCES)
