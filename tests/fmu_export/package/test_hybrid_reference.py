"""The reference of a model with events and sampling is what its FMU computes, and what is known in closed form."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.util import read_csv

from fmu_export.errors import DocumentationError
from fmu_export.modelling.hybrid import HybridRun
from fmu_export.modelling.model import DefaultExperiment, Event
from fmu_export.native.backend import build_native
from fmu_export.package.documentation import reference_run
from tests.support.compilation import shared_compilation
from tests.support.hybrid_models import BALL, CHAIN, CROSSINGS, HYBRID, SAMPLED_PI
from tests.support.native_fmus import require_compiler


@pytest.mark.parametrize("name", ["Ball", "Thermostat", "SampledPI", "Samplers", "Hold", "Dip"])
def test_the_fmu_gives_the_reference(name: str, tmp_path: Path) -> None:
    require_compiler()
    model = HYBRID[name]
    with shared_compilation():
        fmu = build_native(model, tmp_path, "fmi2", page="A model for tests.")
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(tmp_path, [m for m in archive.namelist() if "/reference/" in m])
    inputs, reference = (
        read_csv(str(tmp_path / f"documentation/reference/{name}_{which}.csv")) for which in ("in", "ref")
    )
    result = fmpy.simulate_fmu(
        str(fmu),
        fmi_type="CoSimulation",
        stop_time=reference["time"][-1],
        output_interval=0.01,
        input=inputs if len(model.inputs) else None,
    )
    assert len(result) == len(reference) > 90
    for output in model.outputs.names:
        np.testing.assert_allclose(result[output], reference[output], rtol=0, atol=1e-8, err_msg=output)


def test_numpy_bounces_the_ball_at_the_right_times() -> None:
    run = HybridRun(BALL, BALL.parameters.starts, 0.05)
    u = np.zeros(0)
    state = run.settled(0.0, run.start(0.0), u)
    time, v = np.sqrt(2.0 / 9.81), np.sqrt(2.0 * 9.81)  # of the first bounce
    before = 0.0
    for _ in range(8):
        v *= 0.8
        top = time + v / 9.81
        state = run.settled(top, run.advanced(before, state, u, top), u)
        np.testing.assert_allclose(state.x, [v**2 / 2.0 / 9.81, 0.0], rtol=0, atol=1e-10)
        before, time = top, top + v / 9.81


def test_numpy_counts_crossings_by_their_direction() -> None:
    run = HybridRun(CROSSINGS, CROSSINGS.parameters.starts, 0.05)
    u = np.zeros(0)
    state = run.settled(0.0, run.start(0.0), u)
    state = run.settled(3.3, run.advanced(0.0, state, u, 3.3), u)
    np.testing.assert_allclose(state.z, [3.0, 3.0, 6.0, 3.0], rtol=0, atol=1e-10)


def test_events_without_end_have_no_reference() -> None:
    falling = replace(
        BALL, parameters=[replace(v, start=0.3) if v.name == "e" else v for v in BALL.parameters.variables]
    )
    with pytest.raises(DocumentationError, match="an event happens again and again"):
        reference_run(falling)
    run = HybridRun(CHAIN, np.ones(1), 0.01)
    state = run.settled(0.0, run.start(0.0), np.zeros(1))
    with pytest.raises(ArithmeticError, match="without end"):
        run.settled(0.1, run.advanced(0.0, state, np.zeros(1), 0.1), np.ones(1))


def test_a_reference_begins_at_the_start_time() -> None:
    later = replace(SAMPLED_PI, default_experiment=DefaultExperiment(9.0, 0.1, 7.13))
    run = reference_run(later)
    assert run.time[0] == 7.13
    np.testing.assert_array_equal(run.outputs[:7, 1], 0.0)  # the first instant is 7.2
    assert run.outputs[7, 1] == 1.5


def test_an_event_of_a_model_without_an_event_before_it_is_no_crossing() -> None:
    resting = replace(BALL, events=[Event("never", lambda t, x, u, p: -1.0 + 0.0 * x[0], lambda t, x, u, p: x)])
    run = HybridRun(resting, BALL.parameters.starts, 0.05)
    u = np.zeros(0)
    state = run.advanced(0.0, run.settled(0.0, run.start(0.0), u), u, 1.0)
    np.testing.assert_allclose(state.x, [1.0 - 9.81 / 2.0, -9.81], rtol=1e-12)
