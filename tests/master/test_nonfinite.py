"""Outputs that become infinite: the run ends there or goes on and says so, as it is asked to."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from cosim import SetupError, Simulation, SimulationError, System
from cosim.__main__ import main
from tests.support.c_fmus import tank


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tank(tmp_path_factory.mktemp("tank") / "tank.fmu")


def filled(fmu: Path) -> System:
    """Two tanks; at 1e308 a second the first one has more than a double can hold after two."""
    system = System()
    for name, rate in (("tank", 1e308), ("other", 1.0)):
        system.add(name, fmu, start={"u": rate})
    return system


@pytest.mark.parametrize("every", [1, 2])
def test_a_run_goes_on_and_says_what_was_not_finite(fmu: Path, every: int) -> None:
    chunks: list[np.ndarray] = []
    with Simulation(filled(fmu)) as simulation:
        found = [
            simulation.run(5.0, 1.0, record_every=every),
            simulation.run(5.0, 1.0, record_every=every, sink=lambda _, values: chunks.append(values.copy())),
        ]
    for results in found:
        assert results.info["status"] == "completed"
        assert results.info["nonfinite"] == {"tank.y": {"time": 2.0, "rows": 4 if every == 1 else 2}}
    assert np.isinf(found[0]["tank.y"]).tolist() == [t >= 2.0 for t in found[0].time]
    assert np.isinf(np.concatenate(chunks)).sum() == np.isinf(found[0].values).sum()


@pytest.mark.parametrize("every", [1, 2, 3])
def test_a_run_ends_where_an_output_is_not_finite(fmu: Path, every: int) -> None:
    chunks: list[np.ndarray] = []
    with Simulation(filled(fmu)) as simulation:
        for sink in (None, lambda times, _: chunks.append(times.copy())):
            with pytest.raises(SimulationError, match=r"'y' is inf") as ended:
                simulation.run(9.0, 1.0, record_every=every, sink=sink, nonfinite="error")
            assert (ended.value.component, ended.value.time) == ("tank", 2.0 if every < 3 else 3.0)
            assert ended.value.results is not None
            assert ended.value.results.info["status"] == "failed"
            assert "nonfinite" not in ended.value.results.info
            times = ended.value.results.time if sink is None else np.concatenate(chunks)
            assert times.tolist() == [t for t in (0.0, 1.0) if t % every == 0]


def test_one_that_is_finite_says_nothing_whatever_its_sum(fmu: Path) -> None:
    system = System()
    for name in ("a", "b", "c"):
        system.add(name, fmu, start={"u": 1e308})
    with Simulation(system, record=["a.y", "b.y", "c.y"]) as simulation:
        results = simulation.run(1.0, 0.5, nonfinite="error")
    assert math.isinf(sum(results.values[-1].tolist()))
    assert "nonfinite" not in results.info


def test_a_word_that_is_none_is_refused(fmu: Path) -> None:
    with Simulation(filled(fmu)) as simulation, pytest.raises(SetupError, match="nonfinite = 'stop' must be one of"):
        simulation.run(1.0, 0.5, nonfinite="stop")  # type: ignore[arg-type]


def test_the_command_has_both(
    fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    command = ["run", str(fmu), "--set", "u=1e308", "--step", "1", "--stop", "4", "--out"]
    assert main([*command, "marked"]) == 0
    said = "note: these were NaN or infinite: tank.y (from t = 2 s on, 3 times)"
    assert said in capsys.readouterr().out
    assert json.loads(Path("marked/summary.json").read_text())["nonfinite"] == {"tank.y": {"time": 2.0, "rows": 3}}
    Path("tank.toml").write_text(
        f'[components.tank]\nfmu = "{fmu}"\n[start]\ntank.u = 1e308\n[run]\nstop_time = 4.0\nstep_size = 1.0\n'
        '[metrics]\nlast = {measure = "final", of = "tank.y"}\nfirst = {measure = "min", of = "tank.y"}\n'
    )
    assert main(["run", "tank.toml", "--out", "measured"]) == 0
    summary = json.loads(Path("measured/summary.json").read_text(), parse_constant=pytest.fail)  # no NaN in JSON
    assert summary["metrics"] == {"last": None, "first": 0.0}
    capsys.readouterr()
    assert main([*command, "ended", "--nonfinite", "error"]) == 1
    assert "tank failed at t = 2 s: 'y' is inf; --nonfinite mark goes on" in capsys.readouterr().err
    summary = json.loads(Path("ended/summary.json").read_text())
    assert summary["status"] == "failed"
    assert Path("ended/results.csv").read_text().count("\n") == 3
