"""What a model declares, as an importer of its FMU finds it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from fmu_export.modelling.model import Requirement
from fmu_export.native.backend import build_native
from tests.support.native_fmus import ERROR, FLAVOURS, Host, unpack
from tests.support.tiny_models import FRAGILE

#: Quotes, backslash, a percent sign, trigraphs and digraphs, accents and letters beyond 16 bits.
TEXT = "u is \"small\" 'now' \\n at 100 %d of ??/ <: größer als 𝒰"


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_texts_reach_the_log_as_they_are_written_and_a_folder_may_be_text(tmp_path: Path, flavour: str) -> None:
    model = replace(FRAGILE, requirements=(Requirement(TEXT, lambda t, x, u, p: u[0]),))
    fmu = build_native(model, str(tmp_path), flavour)  # type: ignore[arg-type]
    assert fmu == tmp_path / "Fragile.fmu"
    with Host(unpack(fmu, tmp_path / "unpacked")) as host:
        host.must(host.set({"u": -1.0}))
        host.must(host.enter())
        assert host.exit() == ERROR
        assert host.messages == [f"t = 0 s: {TEXT}"]
