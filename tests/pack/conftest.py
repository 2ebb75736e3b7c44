"""The FMUs that the tests of packing have in common."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.small_fmus import build
from tests.support.tiny_models import GAIN, INTEGRATOR


@pytest.fixture(scope="session")
def small_fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Folders with Gain.fmu and Integrator.fmu, by flavour."""
    return {f: build(tmp_path_factory.mktemp(f"small_{f}"), f, GAIN, INTEGRATOR) for f in ("fmi2", "fmi3")}
