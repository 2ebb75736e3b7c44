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
from fmu_export.modelling.model import DefaultExperiment
from fmu_export.native.backend import build_native
from fmu_export.package.documentation import reference_run
from tests.support.compilation import shared_compilation
from tests.support.hybrid_models import BALL, HYBRID, SAMPLED_PI
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


def test_events_without_end_have_no_reference() -> None:
    falling = replace(
        BALL, parameters=[replace(v, start=0.3) if v.name == "e" else v for v in BALL.parameters.variables]
    )
    with pytest.raises(DocumentationError, match="an event happens again and again"):
        reference_run(falling)


def test_a_reference_begins_at_the_start_time() -> None:
    later = replace(SAMPLED_PI, default_experiment=DefaultExperiment(9.0, 0.1, 7.13))
    run = reference_run(later)
    assert run.time[0] == 7.13
    np.testing.assert_array_equal(run.outputs[:7, 1], 0.0)  # the first instant is 7.2
    assert run.outputs[7, 1] == 1.5
