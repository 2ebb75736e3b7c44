"""What a model declares, as an importer of its FMU finds it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from cosim import System, simulate
from fmu_export import ArgumentError, build_pythonfmu, compose
from fmu_export.modelling.model import DefaultExperiment, Model, Requirement
from fmu_export.modelling.variables import Layout, Variable
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


def stateless(
    name: str, inputs: Sequence[Variable], outputs: Sequence[Variable], output_values: Callable[..., Any]
) -> Model:
    return Model(name=name, inputs=Layout(inputs), outputs=Layout(outputs), output_values=output_values)


#: At t = 0: 20 degC, 3000 rpm, 2 bar and half an opening.
PLANT = stateless(
    "Plant",
    [],
    [Variable("T", "degC"), Variable("n", "rpm"), Variable("P", "bar", size=2), Variable("opening", "%")],
    lambda t, x, u, p: np.stack([20.0 + t, 3000.0 + 0.0 * t, 2.0 + t, 3.0 + t, 50.0 + t]),
)
#: The same in other units.
METER = stateless(
    "Meter",
    [Variable("T", "K"), Variable("n", "rad/s"), Variable("P", "kPa", size=2), Variable("opening")],
    [
        Variable("T_seen", "K", display_unit="degC"),
        Variable("n_seen", "rad/s", display_unit="rpm"),
        Variable("P_seen", "kPa", size=2),
        Variable("opening_seen"),
    ],
    lambda t, x, u, p: u,
)
SEEN = {"T_seen": 293.15, "n_seen": 100.0 * math.pi, "P_seen[1]": 200.0, "P_seen[2]": 300.0, "opening_seen": 0.5}
CONNECTIONS = [(f"plant.{name}", f"meter.{name}") for name in ("T", "n", "P", "opening")]


@pytest.mark.parametrize("flavour", ["pythonfmu", *FLAVOURS])
def test_values_in_other_units_are_converted_between_fmus(tmp_path: Path, flavour: str) -> None:
    system = System()
    for component, model in (("plant", PLANT), ("meter", METER)):
        build = build_pythonfmu if flavour == "pythonfmu" else lambda m, f: build_native(m, f, flavour)  # type: ignore[arg-type]
        fmu = build(model, tmp_path)
        assert validate_fmu(str(fmu)) == []
        system.add(component, fmu)
    for source, target in CONNECTIONS:
        system.connect(source, target, units="convert")
    results = simulate(system, 0.2, 0.1)
    for name, value in SEEN.items():
        assert results[f"meter.{name}"][0] == pytest.approx(value, rel=1e-15), name
    displayed = {
        (u.name, d.name): (d.factor, d.offset)
        for u in fmpy.read_model_description(str(tmp_path / "Meter.fmu")).unitDefinitions
        for d in u.displayUnits
    }
    assert displayed == {("K", "degC"): (1.0, -273.15), ("rad/s", "deg/s"): (math.degrees(1.0), 0.0)} | {
        ("rad/s", "rpm"): (pytest.approx(30.0 / math.pi, rel=4e-16), 0.0)
    }


def test_values_in_other_units_are_converted_in_a_composed_model() -> None:
    whole = compose("Whole", "Both", {"plant": PLANT, "meter": METER}, CONNECTIONS, DefaultExperiment(1.0, 0.1))
    values = dict(
        zip(whole.outputs.names, whole.output_values(0.0, np.zeros(0), np.zeros(0), np.zeros(0)), strict=True)
    )
    for name, value in SEEN.items():
        assert values[f"meter.{name}"] == pytest.approx(value, rel=1e-15), name


def test_functions_may_return_lists_and_a_flavour_is_one_of_two(tmp_path: Path) -> None:
    model = Model(
        name="Lists",
        outputs=Layout([Variable("x"), Variable("v")]),
        states=("x", "v"),
        initial_state=lambda p: [1.0, 0.0],
        derivatives=lambda t, x, u, p: [x[1], -x[0]],
    )
    fmu = build_native(model, tmp_path, "fmi2", page="# A pendulum\n")
    result = fmpy.simulate_fmu(str(fmu), stop_time=1.0, output=["x"], fmi_type="CoSimulation")
    assert result["x"][-1] == pytest.approx(math.cos(1.0), rel=1e-10)
    with pytest.raises(ArgumentError, match="Lists: flavour is 'fmi4'; it must be 'fmi2' or 'fmi3'"):
        build_native(model, tmp_path, "fmi4")  # type: ignore[arg-type]
