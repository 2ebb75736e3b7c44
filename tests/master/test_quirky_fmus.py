"""What a master does for FMUs that need to be told more, reset badly, or don't finish a step at once."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

import cosim.commands.execution
from cosim import Results, SetupError, Simulation, SimulationError, SimulationInterrupted, System, simulate
from cosim.__main__ import main
from cosim.master.unfinished_steps import UnfinishedSteps
from tests.support.fmi3_gain import DESCRIPTION, build_gain, zipped
from tests.support.native_fmus import FLAVOURS
from tests.support.quirks import Quirk, quirky
from tests.support.small_fmus import build
from tests.support.tiny_models import INTEGRATOR


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("quirks")


def one(fmu: Path, **start: float) -> System:
    """One FMU whose input rises with time."""
    system = System()
    system.add("m", fmu, start=start)
    system.drive("m.u", lambda t: t)
    return system


def y(results: Results) -> list[float]:
    return [float(value) for value in results["m.y"]]


PARABOLA = [0.0, 0.125, 0.5, 1.125, 2.0]  # the integral of t at 0, 0.5, ... 2 s


# Runs after the first one


@pytest.mark.parametrize(
    "quirks",
    [Quirk.NONE, Quirk.KEEPS_STATE, Quirk.REFUSES_RESET, Quirk.KEEPS_GLOBALS, Quirk.KEEPS_STATE | Quirk.REFUSES_RESET],
)
def test_each_run_is_as_the_first_one_whatever_a_reset_resets(folder: Path, quirks: Quirk) -> None:
    system = one(quirky(folder, quirks))
    system.add("again", quirky(folder, quirks), start={"u": 1.0})
    with Simulation(system) as simulation:
        for _ in range(3):
            results = simulation.run(2.0, 0.5)
            assert y(results) == PARABOLA
            assert results["again.y"].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
            assert [fmu["instance"] for fmu in results.info["fmus"].values()] == ["new", "new"]
        with simulation.start(step_size=0.5) as run:
            run.step(4)
            assert y(run.results) == PARABOLA


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_fmus_of_this_project_say_that_their_reset_is_complete_and_are_reused(tmp_path: Path, flavour: str) -> None:
    build(tmp_path, flavour, INTEGRATOR)
    system = System()
    system.add("i", tmp_path / "Integrator.fmu", start={"x_start": 3.0})
    system.drive("i.u", lambda t: t)
    with Simulation(system) as simulation:
        first = simulation.run(1.0, 0.1)
        again = simulation.run(1.0, 0.1, start={"i.x_start": 3.0})
    assert (first.info["fmus"]["i"]["instance"], again.info["fmus"]["i"]["instance"]) == ("new", "reset")
    assert first.values.tobytes() == again.values.tobytes()


# What FMUs are told


def told(results: Results) -> tuple[float, float]:
    return results["m.stop_time"][-1], results["m.tolerance"][-1]


def test_fmus_are_told_the_stop_time_of_the_run_and_the_tolerance_of_their_experiment(folder: Path) -> None:
    fmu = quirky(folder, experiment='startTime="0" stopTime="7" tolerance="1e-5" stepSize="0.1"')
    with Simulation(one(fmu)) as simulation:
        results = simulation.run(2.0, 0.5)
        assert told(results) == (2.0, 1e-5)
        assert results.info["fmus"]["m"]["tolerance"] == 1e-5
        assert told(simulation.run(1.0, 0.5, tolerance=1e-3)) == (1.0, 1e-3)
        with simulation.start(step_size=0.5) as run:
            assert (run["m.stop_time"], run["m.tolerance"]) == (-1.0, 1e-5)
        with simulation.start(step_size=0.5, stop_time=3.0, tolerance=0.1) as run:
            assert (run["m.stop_time"], run["m.tolerance"]) == (3.0, 0.1)
        for wrong in (0.0, -1e-6, float("nan"), float("inf")):
            with pytest.raises(SetupError, match=r"^tolerance .* must be a positive number"):
                simulation.run(1.0, 0.5, tolerance=wrong)
    assert told(simulate(one(quirky(folder)), 1.0, 0.5)) == (1.0, -1.0)


@pytest.mark.parametrize(("stop_time", "step_size"), [(0.3, 0.1), (15.0, 5e-3), (0.04, 1e-4), (1.0, 0.1), (1e-4, 1e-4)])
def test_no_step_ends_after_the_stop_time_for_rounding(folder: Path, stop_time: float, step_size: float) -> None:
    n = round(stop_time / step_size)
    with Simulation(one(quirky(folder, Quirk.REFUSES_TO_OVERSHOOT))) as simulation:
        results = simulation.run(stop_time, step_size)
        assert len(results.time) == n + 1
        assert results.time[-1] == n * step_size
        with simulation.start(step_size=step_size, stop_time=stop_time) as run:
            run.step(n)
            assert run["m.y"] == results["m.y"][-1] == pytest.approx(0.5 * stop_time**2)


HELD = [0.0, 0.0, 0.25, 0.75, 1.5]  # the integral of t with a zero-order hold


def test_inputs_are_held_where_an_fmu_refuses_derivatives_that_it_says_it_takes(folder: Path) -> None:
    system = one(quirky(folder, Quirk.REFUSES_DERIVATIVES))
    system.add("other", quirky(folder))
    system.drive("other.u", lambda t: t)
    with Simulation(system) as simulation:
        for _ in range(2):
            results = simulation.run(2.0, 0.5)
            assert (y(results), results["other.y"].tolist()) == (HELD, PARABOLA)
            assert results.info["extrapolation"] == {"mode": "auto", "linear": ["other.u"], "hold": ["m.u"]}
            assert results.info["derivatives_refused"] == {"m": "fmi2SetRealInputDerivatives returned error"}
        with simulation.start(step_size=0.5) as run:
            run.step(4)
            assert y(run.results) == HELD
    assert "derivatives_refused" not in simulate(one(quirky(folder)), 2.0, 0.5).info
    assert y(simulate(system, 2.0, 0.5, extrapolation="hold")) == HELD
    with pytest.raises(SimulationError, match=r"returned error, though it says that .*; use extrapolation='hold'"):
        simulate(system, 2.0, 0.5, extrapolation="linear")


def test_inputs_are_held_where_an_fmu_lacks_the_function_for_derivatives_that_it_says_it_takes(folder: Path) -> None:
    system = one(quirky(folder, Quirk.LACKS_DERIVATIVES))
    results = simulate(system, 2.0, 0.5)
    assert (y(results), results.info["extrapolation"]["hold"]) == (HELD, ["m.u"])
    assert results.info["derivatives_refused"] == {"m": "it lacks the function fmi2SetRealInputDerivatives"}
    with pytest.raises(SetupError, match=r"'m' says that .* it lacks the function fmi2Set.*; use extrapolation='hold'"):
        simulate(system, 2.0, 0.5, extrapolation="linear")


def test_inputs_that_an_fmu_refuses_during_a_step_are_held(tmp_path: Path) -> None:
    asks = DESCRIPTION.replace("<CoSimulation ", '<CoSimulation providesIntermediateUpdate="true" ').replace(
        'name="v" ', 'name="v" intermediateUpdate="true" '
    )
    for name, definitions, expected in (("takes", (), PARABOLA), ("refuses", ("REFUSES_DURING_STEP",), HELD)):
        (tmp_path / name).mkdir()
        system = System()
        system.add("m", build_gain(tmp_path / name, *definitions, description=asks), start={"u": 0.0})
        system.drive("m.v", lambda t: t)
        with Simulation(system, record=["m.x"]) as simulation:
            for _ in range(2):
                results = simulation.run(2.0, 0.5)
                assert results["m.x"].tolist() == expected
                refused = {"m": "it refuses fmi3SetFloat64 during a step"} if definitions else None
                assert results.info.get("derivatives_refused") == refused
    with pytest.raises(SimulationError, match=r"m failed at t = 0.5 s: fmi3SetFloat64 returned error, though it says"):
        simulate(system, 2.0, 0.5, extrapolation="linear")


# What FMUs refuse to give


def test_an_output_that_an_fmu_refuses_is_left_out_unless_it_is_asked_for(folder: Path) -> None:
    system = one(quirky(folder, Quirk.REFUSES_OUTPUT))
    with Simulation(system) as simulation:
        for _ in range(2):
            results = simulation.run(2.0, 0.5)
            assert y(results) == PARABOLA
            assert results.names == simulation.names == ["m.u", "m.y", "m.tolerance"]
            assert results.info["not_recorded"] == {"m.stop_time": "fmi2GetReal returned error"}
    assert simulate(system, 2.0, 0.5, record=["m.y"]).info.get("not_recorded") is None
    with pytest.raises(SimulationError, match="m failed at t = 0 s: fmi2GetReal returned error"):
        simulate(system, 2.0, 0.5, record=["m.y", "m.stop_time"])
    system.add("other", quirky(folder))
    system.connect("m.stop_time", "other.u")
    with pytest.raises(SimulationError, match="m failed at t = 0 s: fmi2GetReal returned error"):
        simulate(system, 2.0, 0.5)


def test_an_fmu_that_gives_no_output_at_all_fails(gain3c: Path, tmp_path: Path) -> None:
    """What it can't give says nothing of it otherwise; a run that records nothing of it would hide the fault."""
    description = DESCRIPTION.replace('name="x" valueReference="5"', 'name="x" valueReference="95"')
    description = description.replace('<Output valueReference="5"', '<Output valueReference="95"')
    fmu = zipped(tmp_path / "one.fmu", gain3c.with_suffix(fmpy.sharedLibraryExtension), description)
    system = System()
    system.add("m", fmu)
    assert simulate(system, 0.2, 0.1).info["not_recorded"] == {"m.x": "fmi3GetFloat64 returned error"}
    for reference in (2, 7, 9, 11):
        description = description.replace(f' valueReference="{reference}"', f' valueReference="{90 + reference}"')
    system = System()
    system.add("m", zipped(tmp_path / "all.fmu", gain3c.with_suffix(fmpy.sharedLibraryExtension), description))
    with pytest.raises(SimulationError, match=r"m failed at t = 0 s: fmi3Get.* returned error"):
        simulate(system, 0.2, 0.1)


def test_a_sink_gets_what_it_was_told_or_nothing(folder: Path) -> None:
    rows: list[int] = []
    with Simulation(one(quirky(folder, Quirk.REFUSES_OUTPUT))) as simulation:
        with pytest.raises(SetupError, match=r"'m' does not give 'm.stop_time' \(fmi2GetReal returned error\)"):
            simulation.run(2.0, 0.5, sink=lambda _, values: rows.append(values.shape[1]))
        assert rows == []
        simulation.run(2.0, 0.5, sink=lambda _, values: rows.append(values.shape[1]))
    assert rows == [3]


def test_a_long_run_of_the_command_line_leaves_refused_outputs_out(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cosim.commands.execution, "MOST_VALUES_IN_MEMORY", 1)
    fmu = quirky(folder, Quirk.REFUSES_OUTPUT | Quirk.REFUSES_DERIVATIVES)
    table = tmp_path / "u.csv"
    table.write_text("time,u\n0,0\n2,2\n")
    options = ["--stop", "2", "--step", "0.5", "--set", "m.end=10", "--input", str(table), "--out", str(tmp_path / "o")]
    assert main(["run", str(fmu), *(o.replace("m.end", f"{fmu.stem}.end") for o in options)]) == 0
    out = capsys.readouterr().out
    assert f"not in the results: {fmu.stem}.stop_time (fmi2GetReal returned error)" in out
    assert f"'{fmu.stem}' says that it interpolates inputs, but fmi2SetRealInputDerivatives returned error" in out
    results = Results.read(tmp_path / "o" / "results.csv")
    assert results[f"{fmu.stem}.y"].tolist() == HELD
    assert f"{fmu.stem}.stop_time" not in results.names


def test_rounding_makes_some_of_these_steps_end_after_the_stop_time() -> None:
    assert [n * h + h > stop for n, h, stop in ((2, 0.1, 0.3), (2999, 5e-3, 15.0), (399, 1e-4, 0.04))] == [True] * 3


def test_fmus_that_need_a_stop_time_or_a_tolerance_get_one(folder: Path) -> None:
    assert told(simulate(one(quirky(folder, Quirk.NEEDS_STOP_TIME)), 1.0, 0.5)) == (1.0, -1.0)
    system = one(quirky(folder, Quirk.NEEDS_TOLERANCE))
    system.add("other", quirky(folder, Quirk.NEEDS_TOLERANCE), start={"u": 0.0})
    results = simulate(system, 2.0, 0.5)
    assert told(results) == (2.0, 1e-6)
    assert results.info["tolerance_assumed"] == ["m", "other"]
    assert y(results) == PARABOLA
    with (
        Simulation(one(quirky(folder, Quirk.NEEDS_STOP_TIME))) as simulation,
        pytest.raises(SimulationError, match="fmi2EnterInitializationMode returned error"),
        simulation.start(step_size=0.5),
    ):
        pass


# Ends


def ends(results: Results) -> tuple[int, float, Any]:
    return len(results.time), results.time[-1], results.info["ended_by"]


@pytest.mark.parametrize("n_others", [0, 2])
def test_an_fmu_that_ends_the_simulation_ends_it_well(folder: Path, n_others: int) -> None:
    system = System()
    for i in range(n_others // 2):
        system.add(f"before{i}", quirky(folder), start={"u": 1.0})
    system.add("m", quirky(folder), start={"end": 1.5})
    system.drive("m.u", lambda t: t)
    for i in range(n_others // 2):
        system.add(f"after{i}", quirky(folder), start={"u": 1.0})
    with Simulation(system) as simulation:
        results = simulation.run(5.0, 0.5)
        assert ends(results) == (4, 1.5, {"component": "m", "time": 1.5})
        assert results.info["status"] == "completed"
        assert y(results) == PARABOLA[:4]
        with simulation.start(step_size=0.5) as run:
            run.step(9)
            assert run.time == 1.5
            assert ends(run.results) == (4, 1.5, {"component": "m", "time": 1.5})
            with pytest.raises(SetupError, match=r"ended: the FMU of 'm' ended the simulation at t = 1\.5 s"):
                run.step()
        assert y(simulation.run(1.0, 0.5)) == PARABOLA[:3]


def test_an_error_at_the_end_is_a_warning_and_costs_no_results(folder: Path) -> None:
    with Simulation(one(quirky(folder, Quirk.FAILS_TO_TERMINATE))) as simulation:
        results = simulation.run(2.0, 0.5)
        assert y(results) == PARABOLA
        assert results.info["status"] == "completed"
        assert results.info["not_terminated"] == {"m": "m failed at t = 2 s: fmi2Terminate returned error"}
        with simulation.start(step_size=0.5) as run:
            run.step(4)
        assert "not_terminated" in run.results.info


def test_results_can_be_saved_before_the_fmus_are_told_that_the_run_is_over(folder: Path) -> None:
    said = {"m": "m failed at t = 2 s: fmi2Terminate returned error"}
    with Simulation(one(quirky(folder, Quirk.FAILS_TO_TERMINATE)), terminate_late=True) as simulation:
        first = simulation.run(2.0, 0.5)
        assert (y(first), first.info["status"]) == (PARABOLA, "completed")
        assert "not_terminated" not in first.info
        second = simulation.run(2.0, 0.5)
        assert first.info["not_terminated"] == said
        assert "not_terminated" not in second.info
    assert second.info["not_terminated"] == said


# Steps that are not finished at once


@pytest.mark.parametrize("quirks", [Quirk.NONE, Quirk.COMPUTES_IN_PART])
@pytest.mark.parametrize("longest", [0.3, 0.125, 0.5])
def test_a_discarded_step_is_repeated_in_shorter_ones_with_the_inputs_of_their_times(
    folder: Path, quirks: Quirk, longest: float
) -> None:
    results = simulate(one(quirky(folder, quirks), longest=longest), 2.0, 0.5)
    assert y(results) == pytest.approx(PARABOLA, rel=1e-14)
    assert results.info.get("steps_repeated", {}) == ({"m": 4} if longest < 0.5 else {})


def test_others_go_on_after_a_repeated_step(folder: Path) -> None:
    system = System()
    system.add("first", quirky(folder), start={"u": 1.0, "longest": 0.25})
    system.add("second", quirky(folder, interpolates=False))
    system.connect("first.y", "second.u")
    results = simulate(system, 2.0, 0.5)
    assert results["first.y"].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert results["second.y"].tolist() == np.cumsum([0.0, 0.0, 0.25, 0.5, 0.75]).tolist()


def test_a_failure_after_a_repeated_step_is_that_of_its_own_component(folder: Path) -> None:
    system = System()
    system.add("first", quirky(folder), start={"u": 1.0, "longest": 0.25})
    system.add("between", quirky(folder), start={"u": 1.0})
    system.add("last", quirky(folder, Quirk.REFUSES_DERIVATIVES))
    system.drive("last.u", lambda t: t)
    with pytest.raises(SimulationError, match="last failed at t = 0 s: fmi2SetRealInputDerivatives") as failed:
        simulate(system, 2.0, 0.5, extrapolation="linear")
    assert failed.value.component == "last"


def test_a_step_that_can_not_be_made_shorter_ends_the_run_with_its_results(folder: Path) -> None:
    for fmu, start, message in (
        (
            quirky(folder),
            {"internal": 0.3},
            r"did not finish the step of 0\.5 s from t = 0 s on, nor steps of ",
        ),
        (quirky(folder, any_step=False), {"longest": 0.25}, "m failed at t = 0 s: fmi2DoStep returned discard"),
    ):
        with pytest.raises(SimulationError, match=message) as failed:
            simulate(one(fmu, **start), 2.0, 0.5)
        assert failed.value.results is not None
        assert y(failed.value.results) == [0.0]


def test_a_pending_step_is_waited_for(folder: Path) -> None:
    assert y(simulate(one(quirky(folder, Quirk.IS_ASYNCHRONOUS)), 2.0, 0.5)) == PARABOLA


def test_the_command_line_says_what_was_out_of_the_ordinary(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    fmu = quirky(folder, Quirk.NEEDS_TOLERANCE | Quirk.FAILS_TO_TERMINATE)
    options = ["--set", "u=1", "--set", "end=1.5", "--set", "longest=0.3", "--stop", "2", "--step", "0.5"]
    assert main(["run", str(fmu), *options, "--out", "r"]) == 0
    said = capsys.readouterr().out.splitlines()
    name = fmu.stem
    assert [line for line in said if line.startswith("note: ")][:4] == [
        f"note: the FMU of '{name}' fails without a tolerance; it was told 1e-06",
        f"note: the FMU of '{name}' discarded 3 steps, which were repeated in shorter ones",
        f"note: the FMU of '{name}' ended the simulation at t = 1.5 s",
        f"note: {name} failed at t = 1.5 s: fmi2Terminate returned error",
    ]
    summary = json.loads(Path("r/summary.json").read_text(encoding="utf-8"))
    assert summary["ended_by"] == {"component": name, "time": 1.5}
    assert Results.from_csv("r/results.csv").time.tolist() == [0.0, 0.5, 1.0, 1.5]


@pytest.mark.parametrize("longest", [1e9, 0.25])
def test_ctrl_c_while_a_step_is_pending_or_repeated_interrupts_the_run_with_its_results(
    folder: Path, monkeypatch: pytest.MonkeyPatch, longest: float
) -> None:
    fmu = quirky(folder, Quirk.IS_ASYNCHRONOUS if longest > 1.0 else Quirk.NONE)
    finish = UnfinishedSteps.finish

    def interrupted(self: UnfinishedSteps, *arguments: Any) -> Any:
        if arguments[2] >= 1.0:
            signal.raise_signal(signal.SIGINT)
        return finish(self, *arguments)

    monkeypatch.setattr(UnfinishedSteps, "finish", interrupted)
    with pytest.raises(SimulationInterrupted, match="interrupted at t = 1 s") as stopped:
        simulate(one(fmu, longest=longest), 2.0, 0.5)
    assert y(stopped.value.results) == PARABOLA[:3]


def test_a_failure_that_no_tolerance_explains_is_not_tried_again_and_keeps_its_cause(folder: Path) -> None:
    system = one(quirky(folder))
    asked: list[float] = []

    def broken(t: float) -> float:
        asked.append(t)
        raise ZeroDivisionError("by mistake")

    system.add_function("f", broken, outputs=["y"])
    with pytest.raises(SimulationError, match="by mistake") as failed:
        simulate(system, 1.0, 0.5)
    assert isinstance(failed.value.__cause__, ZeroDivisionError)
    assert asked == [0.0]
    with (
        Simulation(one(quirky(folder, Quirk.NEEDS_STOP_TIME))) as simulation,
        pytest.raises(SimulationError) as failed,
        simulation.start(step_size=0.5),
    ):
        pass
    assert getattr(failed.value.__cause__, "function", "") == "fmi2EnterInitializationMode"
