"""Components that have one FMU file in common."""

from __future__ import annotations

from pathlib import Path

import pytest

import cosim.fmi.fmu_file
from cosim import Simulation, System
from tests.support.small_fmus import build
from tests.support.tiny_models import GAIN, INTEGRATOR


def test_a_file_is_read_once_and_components_are_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fmus = build(tmp_path, "fmi2", GAIN, INTEGRATOR)
    read: list[Path] = []
    as_it_is = cosim.fmi.fmu_file.read_fmu

    def counting(path: Path, *rest: object, **more: object) -> object:
        read.append(path)
        return as_it_is(path, *rest, **more)

    monkeypatch.setattr(cosim.fmi.fmu_file, "read_fmu", counting)
    system = System()
    for i in range(5):
        system.add(f"g{i}", fmus / "Gain.fmu", start={"K": float(i), "u[2]": 0.0, **({"u[1]": 1.0} if i == 0 else {})})
        if i:
            system.connect(f"g{i - 1}.y[1]", f"g{i}.u[1]")
    system.add("i", fmus / "Integrator.fmu")
    with Simulation(system) as simulation:
        results = simulation.run(1.0, 0.5)
    assert sorted(path.name for path in read) == ["Gain.fmu", "Integrator.fmu"]
    assert results.info["parameters"]["g3.K"] == 3.0
    system.connect("g2.nothing", "i.u")
    with pytest.raises(cosim.SetupError, match="component 'g2' has no variable 'nothing'"):
        Simulation(system)
