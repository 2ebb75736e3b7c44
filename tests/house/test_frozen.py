"""Dataclasses are values: only those that are filled bit by bit may change."""

from __future__ import annotations

from dataclasses import is_dataclass
from importlib import import_module

from tests.support.sources import sources

#: Those that change while they are made, or that users change.
CHANGING = {
    "cosim.fmi.event_mode._Timer",
    "cosim.fmi.messages._Kind",
    "cosim.master.refusals.Refusals",
    "cosim.osp.functions.Function",
    "cosim.osp.reader._Simulator",
    "cosim.regression.session.Selection",
    "cosim.regression.shipped.Shipped",
    "cosim.results.results.Results",
    "cosim.ssp.format.components.PackagedComponent",
    "cosim.ssp.format.components.SystemContent",
    "cosim.ssp.flow.Flow",
    "cosim.ssp.reader._Values",
    "cosim.ssp.format.structure.Part",
    "cosim.sweep.batch.Rows",
    "cosim.fmi.archive.findings.FileFindings",
    "cosim.system.read.Findings",
    "cosim.system.system.System",
    "fmu_export.trace.straight_line._Value",
}


def test_dataclasses_are_frozen_but_for_those_that_are_filled_bit_by_bit() -> None:
    changing, seen = set(), 0
    for name in sources():
        if name.startswith("fmu_export.pythonfmu.script_"):  # run inside an FMU
            continue
        for value in vars(import_module(name)).values():
            if isinstance(value, type) and is_dataclass(value) and value.__module__ == name:
                seen += 1
                if not value.__dataclass_params__.frozen:  # type: ignore[attr-defined]
                    changing.add(f"{name}.{value.__qualname__}")
    assert seen > 50
    assert changing == CHANGING
