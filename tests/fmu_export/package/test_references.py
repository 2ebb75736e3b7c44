"""The run that an FMU brings along: members after fmi-ls-ref, results by the author's functions, met by the FMU."""

from __future__ import annotations

import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from cosim.fmi.fmu_file import read_fmu
from cosim.regression.outcome import check
from cosim.regression.run import interfaces_of
from cosim.regression.shipped import shipped_cases
from cosim.results.results import Results
from fmu_export import DocumentationError, Event, Layout, Model, Reference, Requirement, Variable
from fmu_export.modelling.model import DefaultExperiment
from fmu_export.native.backend import build_native
from fmu_export.package.references import FOLDER
from fmu_export.pythonfmu.backend import build_pythonfmu
from tests.support.native_fmus import FLAVOURS, require_compiler
from tests.support.tiny_models import LAG

#: Falls from 1 m and bounces: an event, which numpy's run does not know.
BALL = Model(
    name="Ball",
    parameters=Layout([Variable("e", start=0.8)]),
    outputs=Layout([Variable("h", "m"), Variable("v", "m/s")]),
    states=("h", "v"),
    initial_state=lambda p: np.array([1.0, 0.0]),
    derivatives=lambda t, x, u, p: np.array([x[1], -9.81 + 0.0 * x[0]]),
    output_values=lambda t, x, u, p: x,
    events=(Event("bounce", lambda t, x, u, p: x[0], lambda t, x, u, p: np.array([0.0 * x[0], -p[0] * x[1]])),),
    default_experiment=DefaultExperiment(stop_time=1.0, step_size=0.05),
)


def built(model: Model, folder: Path, flavour: str, **options: object) -> Path:
    if flavour == "pythonfmu":
        return build_pythonfmu(model, folder, **options)
    require_compiler()
    return build_native(model, folder, flavour, **options)


def findings(fmu: Path, folder: Path) -> dict[str, list[str]]:
    """What the regression finds for each interface of the only case that an FMU brings along."""
    shipped = shipped_cases(fmu, folder)
    assert shipped.notes == []
    (case,) = shipped.cases
    return {interface: check(case, fmu, interface).findings for interface in interfaces_of(read_fmu(fmu, str(fmu)))}


@pytest.mark.parametrize("flavour", ["pythonfmu", *FLAVOURS])
def test_the_regression_reads_and_meets_it(tmp_path: Path, flavour: str) -> None:
    reference = Reference({"u": 2.0}, {"T": 0.4, "x_start": -1.0}, stop_time=2.0, step_size=0.1, name="warm start")
    fmu = built(LAG, tmp_path, flavour, reference=reference)
    assert all(found == [] for found in findings(fmu, tmp_path / "unpacked").values())
    (case,) = shipped_cases(fmu, tmp_path / "again").cases
    assert case.name == "warm_start"
    found = Results.from_csv(case.reference_path)
    np.testing.assert_allclose(found["x"], 2.0 - 3.0 * np.exp(-found.time / 0.4), rtol=1e-7)


def test_members_are_those_of_the_standard(tmp_path: Path) -> None:
    fmu = built(LAG, tmp_path, "fmi3", reference=Reference({"u": 1.0}, {"T": 2.0}))
    with zipfile.ZipFile(fmu) as archive:
        names = {n.removeprefix(f"{FOLDER}/") for n in archive.namelist() if n.startswith(FOLDER)}
        root = ElementTree.fromstring(archive.read(f"{FOLDER}/fmi-ls-manifest.xml"))
        notes = archive.read("documentation/fmi-ls-ref.txt").decode()
    assert names == {"fmi-ls-manifest.xml", "experiments.exp", "inputs.csv", "parameters.ssv", "results.csv"}
    assert root.tag == "fmiReferences"
    prefix = "{http://fmi-standard.org/fmi-ls-manifest}fmi-ls-"
    assert root.get(f"{prefix}name") == "org.fmi-standard.fmi-ls-ref"
    assert root.get(f"{prefix}version") == "1.0.0-beta.1"
    assert [(e.get("role"), e.get("source")) for e in root] == [
        ("experiment/smoke-test", "experiments.exp"),
        ("parameter", "parameters.ssv"),
        ("result", "results.csv"),
    ]
    assert "smoke test" in notes


def test_the_same_model_gives_the_same_bytes(tmp_path: Path) -> None:
    files = [built(LAG, tmp_path / k, "fmi2", reference=Reference({"u": 1.0})).read_bytes() for k in "ab"]
    assert files[0] == files[1]


def test_by_default_it_runs_from_the_start_values(tmp_path: Path) -> None:
    fmu = built(LAG, tmp_path, "fmi2")
    with zipfile.ZipFile(fmu) as archive:
        assert f"{FOLDER}/results.csv" in archive.namelist()
        assert f"{FOLDER}/inputs.csv" not in archive.namelist()
    without = built(LAG, tmp_path / "without", "fmi2", reference=False)
    with zipfile.ZipFile(without) as archive:
        assert not [n for n in archive.namelist() if "ls-ref" in n]


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_a_model_with_events_runs_itself(tmp_path: Path, flavour: str) -> None:
    fmu = built(BALL, tmp_path, flavour, reference=Reference(parameters={"e": 0.5}, stop_time=0.8, step_size=0.05))
    (case,) = shipped_cases(fmu, tmp_path / "unpacked").cases
    found = Results.from_csv(case.reference_path)
    hit = np.sqrt(2.0 / 9.81)
    since = found.time - hit
    expected = np.where(since < 0, 1.0 - 9.81 / 2.0 * found.time**2, 0.5 * 9.81 * hit * since - 9.81 / 2.0 * since**2)
    np.testing.assert_allclose(found["h"], expected, atol=1e-8)
    assert findings(fmu, tmp_path / "again")["co_simulation"] == []


def test_a_model_that_does_not_run_from_its_start_values_has_none(tmp_path: Path) -> None:
    model = Model(
        name="Root",
        inputs=Layout([Variable("u")]),
        outputs=Layout([Variable("y")]),
        output_values=lambda t, x, u, p: np.sqrt(u - 1.0),
        requirements=(Requirement("u must be greater than 1", lambda t, x, u, p: u[0] - 1.0),),
    )
    with zipfile.ZipFile(built(model, tmp_path, "fmi2")) as archive:
        assert not [n for n in archive.namelist() if "ls-ref" in n]
    with pytest.raises(DocumentationError, match="Root: reference: the results are not finite"):
        built(model, tmp_path, "fmi2", reference=Reference({"u": 0.5}))
    assert (
        findings(built(model, tmp_path, "fmi2", reference=Reference({"u": 5.0})), tmp_path / "u")["co_simulation"] == []
    )


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        (Reference({"v": 1.0}), "Lag: reference: input 'v': the model has no such one; it has u"),
        (Reference({"u": [1.0, 2.0]}), "Lag: reference: input 'u' is .*; give 1 finite numbers"),
        (Reference({"u": float("nan")}), "Lag: reference: input 'u' is nan"),
        (Reference(parameters={"S": 1.0}), "Lag: reference: parameter 'S': the model has no such one"),
        (Reference(step_size=-1.0), "Lag: reference: step_size is -1.0"),
        (Reference(stop_time=0.0), "Lag: reference: stop_time is 0.0"),
        (Reference(stop_time=1e9, step_size=0.1), "steps are too many"),
        (Reference(parameters={"T": 0.0}), "Lag: reference: the results are not finite"),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path: Path, reference: Reference, message: str) -> None:
    with pytest.raises(DocumentationError, match=message):
        built(LAG, tmp_path, "pythonfmu", reference=reference)
    assert not list(tmp_path.glob("*.fmu"))


@pytest.mark.slow
def test_the_robots_fmus_bring_theirs(robot_fmus: Path, tmp_path: Path) -> None:
    found = sorted(robot_fmus.rglob("*.fmu"))
    assert len(found) >= 3
    for i, fmu in enumerate(found):
        outcome = findings(fmu, tmp_path / str(i))
        assert outcome["co_simulation"] == [], fmu
