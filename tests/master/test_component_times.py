"""The profile of a run: where its time went."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from cosim import Simulation, System, simulate
from cosim.__main__ import main
from tests.support.quirks import Quirk, quirky
from tests.support.tiny_models import build


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("times"))


def loop(fmus: Path) -> System:
    """A tank, a gain, and a function that takes long."""

    def slow(t: float, u: float) -> float:
        time.sleep(1e-4)
        return u

    system = System()
    system.add("tank", fmus / "Integrator.fmu", start={"x_start": 1.0})
    system.add("gain", fmus / "Gain.fmu", start={"u[2]": 0.0}, every=2)
    system.add_function("slow", slow, inputs=["u"], outputs=["y"], direct_feedthrough=False)
    system.connect("tank.x", "gain.u[1]")
    system.connect("gain.y[1]", "slow.u")
    system.connect("slow.y", "tank.u")
    return system


@pytest.mark.parametrize("threads", [1, 2])
def test_the_slow_one_is_found(fmus: Path, threads: int) -> None:
    plain = simulate(loop(fmus), 10.0, 0.01)
    assert "profile" not in plain.info
    results = simulate(loop(fmus), 10.0, 0.01, profile=True, threads=threads)
    assert results.values.tobytes() == plain.values.tobytes()
    profile = results.info["profile"]
    assert profile["measured_points"] == 17  # 0, 61, ... 976
    found = profile["components"]
    assert list(found) == ["tank", "gain", "slow"]
    assert [c["steps"] for c in found.values()] == [1000, 500, 1000]
    assert found["slow"]["steps_s"] >= 1000 * 1e-4  # it sleeps at least so long
    assert found["slow"]["steps_s"] > found["tank"]["steps_s"] > 0.0
    assert found["tank"]["exchange_s"] > 0.0


def test_a_short_run_is_measured_more_often(fmus: Path) -> None:
    with Simulation(loop(fmus), profile=True) as simulation:
        assert simulation.run(0.2, 0.01).info["profile"]["measured_points"] == 11
        assert simulation.run(0.05, 0.01).info["profile"]["measured_points"] == 6
        with simulation.start(step_size=0.01) as run:
            run.step(3)
            assert run.results.info["profile"]["components"]["tank"]["steps"] == 3


def test_connections_are_ranked_by_what_inputs_were_predicted(fmus: Path) -> None:
    """Two tanks in a loop, x = cos t and v = -sin t, and one that gets 100 t, held."""
    system = System()
    for name, start in (("x", 1.0), ("v", 0.0), ("z", 0.0), ("w", 0.0)):
        system.add(name, fmus / "Integrator.fmu", start={"x_start": start})
    system.connect("v.x", "x.u")
    system.connect("x.x", "v.u", factor=-1.0)
    system.connect("z.x", "w.u")
    system.drive("z.u", lambda t: 100.0)
    found = simulate(system, 6.2, 0.01, extrapolation="hold", profile=True).info["profile"]["connections"]
    errors = {each["target"]: each["error"] for each in found}
    assert set(errors) == {"x.u", "v.u", "w.u"}
    assert errors["x.u"] == pytest.approx(0.01 / 2**0.5, rel=0.2)  # h cos t, its rms
    assert errors["w.u"] == pytest.approx(0.01 / 6.2, rel=0.05)
    assert [each["error"] for each in found] == sorted(errors.values(), reverse=True)
    assert found[-1] == {"source": "z.x", "target": "w.u", "error": errors["w.u"]}


def test_discarded_steps_are_counted(tmp_path: Path) -> None:
    system = System()
    system.add("m", quirky(tmp_path, Quirk.COMPUTES_IN_PART), start={"longest": 0.3})
    system.drive("m.u", lambda t: t)
    for threads in (1, 2):
        found = simulate(system, 2.0, 0.5, profile=True, threads=threads).info["profile"]["components"]
        assert found["m"]["steps_repeated"] == 4


def test_the_program_prints_a_table(fmus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["run", str(fmus / "Integrator.fmu"), "--step", "0.01", "--stop", "1", "--out", str(tmp_path / "o")]
    assert main([*command, "--profile"]) == 0
    head, row = [line for line in capsys.readouterr().out.splitlines() if line.startswith(("component", "Integrator "))]
    assert head.split() == ["component", "time", "share", "steps", "exchange", "number", "repeated"]
    assert row.split()[-2:] == ["100", "0"]
    assert main(command) == 0
    assert "share" not in capsys.readouterr().out
