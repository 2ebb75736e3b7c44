"""The life of a packed system: states, resets, messages, failures, and what an importer may set when."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import fmpy.fmi2
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from cosim import Simulation, System, simulate
from cosim.pack import pack
from tests.support.c_fmus import talker, tank
from tests.support.packed_fmus import VERSIONS, columns, initialized, instance_of, run_in_fmpy, small_loop
from tests.support.quirks import Quirk, quirky
from tests.support.small_fmus import compiled


@pytest.fixture
def fmus(small_fmus: dict[str, Path]) -> Path:
    return small_fmus["fmi2"]


@pytest.fixture(scope="module")
def loop(small_fmus: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return pack(small_loop(small_fmus["fmi2"]), tmp_path_factory.mktemp("packed") / "Loop.fmu", 0.1).path


def steps(instance: Any, first: int, end: int, length: float = 0.1) -> None:
    for i in range(first, end):
        instance.doStep(i * length, length)


def run_and_read(instance: Any, reference: int) -> None:
    for i in range(10):
        instance.doStep(0.1 * i, 0.1)
        instance.getReal([reference])


class Said:
    """Takes the messages of an FMU in FMPy."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def __call__(self, _environment: Any, _name: Any, status: int, _category: Any, message: bytes) -> None:
        self.texts.append(f"{status} {message.decode()}")


# States


def test_a_restored_state_goes_on_as_before(loop: Path) -> None:
    with instance_of(loop) as (instance, references):
        x = [references["i.x"], references["g.y[2]"]]
        initialized(instance)
        instance.setReal([references["g.u[2]"]], [0.5])
        steps(instance, 0, 5)
        state = instance.getFMUState()
        data = instance.serializeFMUState(state)
        steps(instance, 5, 10)
        expected = instance.getReal(x)
        instance.setFMUState(state)
        steps(instance, 5, 10)
        assert instance.getReal(x) == expected
        instance.freeFMUState(state)
        instance.reset()
        initialized(instance)
        read = instance.deserializeFMUState(data)
        instance.setFMUState(read)
        assert instance.serializeFMUState(read) == data
        steps(instance, 5, 10)
        assert instance.getReal(x) == expected
        instance.freeFMUState(read)


def test_a_state_of_another_fmu_is_refused(loop: Path, fmus: Path, tmp_path: Path) -> None:
    other = pack(small_loop(fmus), tmp_path / "Other.fmu", 0.2).path
    with instance_of(loop) as (instance, _):
        initialized(instance)
        state = instance.getFMUState()
        data = instance.serializeFMUState(state)
        instance.freeFMUState(state)
    with instance_of(other) as (instance, _):
        initialized(instance)
        with pytest.raises(FMICallException):
            instance.deserializeFMUState(data)
        with pytest.raises(FMICallException):
            instance.deserializeFMUState(data[:-9])


def test_runs_resume_from_their_checkpoints(loop: Path) -> None:
    """The master saves the states of the packed FMU in another run of it."""
    system = System()
    system.add("w", loop)
    with Simulation(system) as simulation:
        expected = simulation.run(2.0, 0.1)
        with simulation.start(0.1, stop_time=2.0) as run:
            run.step(7)
            state = run.save()
        with simulation.start(0.1, stop_time=2.0) as run:
            run.restore(state)
            run.step(13)
            assert run["w.i.x"] == expected["w.i.x"][-1]


def test_states_are_offered_where_all_components_have_them(fmus: Path, tmp_path: Path) -> None:
    system = small_loop(fmus)
    system.add("tank", tank(tmp_path / "tank.fmu"))
    offered = fmpy.read_model_description(str(pack(system, tmp_path / "W.fmu", 0.1).path)).coSimulation
    assert not offered.canGetAndSetFMUstate
    assert not offered.canSerializeFMUstate


# Reset


@pytest.mark.parametrize("version", VERSIONS)
def test_after_a_reset_all_is_as_at_first(tmp_path: Path, fmus: Path, version: int) -> None:
    """Components that keep their state or global variables, or refuse to be reset, are made anew."""
    system = System()
    for name, quirk in {
        "a": Quirk.KEEPS_STATE,
        "b": Quirk.KEEPS_GLOBALS,
        "c": Quirk.REFUSES_RESET,
    }.items():
        system.add(name, quirky(tmp_path, quirk), start={"u": 1.0} if name == "a" else None)
    system.add("i", fmus / "Integrator.fmu")
    system.connect("a.y", "b.u")
    system.connect("b.y", "c.u")
    system.connect("c.y", "i.u")
    packed = pack(system, tmp_path / "W.fmu", 0.1, fmi=version)
    expected = columns(simulate(system, 1.0, 0.1), packed.outputs)
    whole = System()
    whole.add("w", packed.path)
    with Simulation(whole) as simulation:
        for _ in range(2):
            assert np.array_equal(columns(simulation.run(1.0, 0.1), [f"w.{n}" for n in packed.outputs]), expected)
    with instance_of(packed.path) as (instance, references):
        for _ in range(2):
            if version == 2:
                initialized(instance, 1.0)
                get = instance.getReal
            else:
                instance.enterInitializationMode(startTime=0.0, stopTime=1.0)
                instance.exitInitializationMode()
                get = instance.getFloat64
            steps(instance, 0, 10)
            np.testing.assert_array_equal(get([references[n] for n in packed.outputs]), expected[-1])
            instance.reset()


def test_parameters_and_inputs_are_those_of_the_description_after_a_reset(loop: Path) -> None:
    with instance_of(loop) as (instance, references):
        names = [references[n] for n in ("g.K", "i.x_start", "g.u[2]", "max_step")]
        for _ in range(2):
            assert instance.getReal(names) == [-1.3, 1.0, 0.0, 0.1]
            instance.setReal(names, [2.0, 3.0, 4.0, 0.05])
            initialized(instance)
            assert instance.getReal(names) == [2.0, 3.0, 4.0, 0.05]
            steps(instance, 0, 2)
            instance.reset()


@pytest.mark.parametrize("complete", [True, False])
def test_the_annotation_of_a_complete_reset(fmus: Path, tmp_path: Path, complete: bool) -> None:
    system = small_loop(fmus)
    if not complete:
        system.add("tank", tank(tmp_path / "tank.fmu"))
    whole = System()
    whole.add("w", pack(system, tmp_path / "W.fmu", 0.1).path)
    with Simulation(whole) as simulation:
        simulation.run(0.2, 0.1)
        assert simulation.run(0.2, 0.1).info["fmus"]["w"]["instance"] == ("reset" if complete else "new")


# Values


@pytest.mark.parametrize("version", VERSIONS)
def test_parameters_of_components(fmus: Path, tmp_path: Path, version: int) -> None:
    system = small_loop(fmus)
    packed = pack(system, tmp_path / "W.fmu", 0.1, fmi=version)
    assert packed.parameters == ("max_step", "i.x_start", "i.T", "i.max_step", "g.K")
    with Simulation(system) as simulation:
        expected = simulation.run(1.0, 0.1, start={"i.x_start": 2.5, "g.K": -0.2, "i.T": 0.5})
    found = run_in_fmpy(packed.path, 1.0, 0.1, packed.outputs, {"i.x_start": 2.5, "g.K": -0.2, "i.T": 0.5})
    assert np.array_equal(found, columns(expected, packed.outputs))


def test_what_cannot_be_set_names_the_variable_and_the_remedy(loop: Path) -> None:
    said = Said()
    with instance_of(loop, logger=said) as (instance, references):
        initialized(instance)
        for name, value in (("i.x", 1.0), ("i.x_start", 1.0), ("g.u[2]", float("nan")), ("max_step", 0.0)):
            with pytest.raises(FMICallException):
                instance.setReal([references[name]], [value])
        with pytest.raises(FMICallException):
            instance.getInteger([references["i.x"]])
        with pytest.raises(FMICallException):
            instance.getReal([12345])
    expected = [
        "'i.x' is computed and can't be set",
        "'i.x_start' is fixed after the initialisation; reset the instance to change it",
        "'g.u[2]' can't be nan; set a finite number",
        "'max_step' can't be 0 s; it must be positive",
        "'i.x' is of type Float64 (Real), not Int32 (Integer)",
        "no variable has the value reference 12345",
    ]
    assert said.texts == [f"3 {text}" for text in expected]


def test_texts_go_round(tmp_path: Path) -> None:
    compiled(tmp_path, "fmi3_types")
    system = System()
    system.add("a", tmp_path / "types.fmu")
    system.add("b", tmp_path / "types.fmu")
    system.connect("a.String_out", "b.String")
    packed = pack(system, tmp_path / "W.fmu", 0.1, inputs=["a.String"], fmi=2)
    with instance_of(packed.path) as (instance, references):
        initialized(instance)
        assert instance.getString([references["b.String_out"]]) == [b"first"]
        instance.setString([references["a.String"]], ["zwölf Wörter"])
        instance.doStep(0.0, 0.1)
        assert instance.getString([references["b.String_out"]]) == ["zwölf Wörter".encode()]
        state = instance.getFMUState()
        data = instance.serializeFMUState(state)
        instance.setString([references["a.String"]], ["another"])
        instance.setFMUState(instance.deserializeFMUState(data))
        instance.doStep(0.1, 0.1)
        assert instance.getString([references["b.String_out"]]) == ["zwölf Wörter".encode()]


def test_a_whole_number_that_a_component_cannot_hold_is_refused(tmp_path: Path) -> None:
    compiled(tmp_path, "fmi3_types")
    system = System()
    system.add("a", tmp_path / "types.fmu")
    packed = pack(system, tmp_path / "W.fmu", 0.1)
    said = Said()
    with instance_of(packed.path, logger=said) as (instance, references):
        initialized(instance)
        instance.setInteger([references["a.Int8[1]"]], [-128])
        with pytest.raises(FMICallException):
            instance.setInteger([references["a.Int8[1]"]], [128])
        assert instance.getInteger([references["a.Int8_out[1]"]]) == [-128]
    assert said.texts == ["3 'a.Int8[1]' can't be 128; it must be between -128 and 127"]


# Messages and failures


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("own", VERSIONS)
def test_messages_name_the_component(tmp_path: Path, own: int, version: int) -> None:
    system = System()
    system.add("mouth", talker(tmp_path / "talker.fmu", "FAILS", version=own))
    packed = pack(system, tmp_path / "W.fmu", 0.1, fmi=version)
    whole = System()
    whole.add("w", packed.path)
    with pytest.raises(Exception, match=r"component 'mouth': fmi.DoStep returned error") as failed:
        simulate(whole, 1.0, 0.1)
    assert "mouth: " in str(failed.value)


def test_warnings_are_handed_on(tmp_path: Path) -> None:
    system = System()
    system.add("mouth", talker(tmp_path / "talker.fmu", "WARNS"))
    whole = System()
    whole.add("w", pack(system, tmp_path / "W.fmu", 0.1).path)
    said = simulate(whole, 1.0, 0.1).info["messages"]["w"]
    alone = simulate(system, 1.0, 0.1).info["messages"]["mouth"]
    assert said["warnings"] == alone["warnings"] > 0
    assert said["first"][0]["text"] == f"mouth: {alone['first'][0]['text']}"


@pytest.mark.parametrize("flags", [("FLOOD=50", "THREADS=3"), ("STRAY", "WARNS"), ("ODD", "WARNS"), ("LATE",)])
def test_odd_messages_crash_nothing(tmp_path: Path, flags: tuple[str, ...]) -> None:
    system = System()
    system.add("mouth", talker(tmp_path / "talker.fmu", *flags))
    whole = System()
    whole.add("w", pack(system, tmp_path / "W.fmu", 0.1).path)
    with Simulation(whole) as simulation:
        for _ in range(2):
            assert len(simulation.run(0.5, 0.1).time) == 6


@pytest.mark.parametrize(("status", "name"), [(2, "discard"), (3, "error"), (4, "fatal"), (7, "no status of FMI")])
@pytest.mark.parametrize(("where", "function"), [(0, "fmi2DoStep"), (1, "fmi2SetReal"), (2, "fmi2GetReal")])
def test_a_failed_component_is_named_and_a_reset_helps(
    tmp_path: Path, fmus: Path, status: int, name: str, where: int, function: str
) -> None:
    compiled(tmp_path, "fmi2_probe")
    system = System()
    system.add("i", fmus / "Integrator.fmu")
    system.add("p", tmp_path / "probe.fmu")
    system.connect("i.x", "p.u")
    packed = pack(system, tmp_path / "W.fmu", 0.1, outputs=["i.x", "p.y"])
    said = Said()
    with instance_of(packed.path, logger=said) as (instance, references):
        instance.setInteger([references["p.status"], references["p.where"]], [status, where])
        instance.setupExperiment(startTime=0.0)
        instance.enterInitializationMode()
        instance.setReal([references["p.fail_at"]], [0.25])
        instance.exitInitializationMode()
        with pytest.raises(FMICallException) as failed:
            run_and_read(instance, references["p.y"])
        assert failed.value.status == (2 if status == 2 else 3) or failed.value.function == "fmi2GetReal"
        repeated = (where, status) == (0, 2)
        expected = "component 'p' did not finish the step" if repeated else f"component 'p': {function} returned {name}"
        assert expected in said.texts[-1]
        with pytest.raises(FMICallException):
            instance.doStep(0.3, 0.1)
        assert "reset the instance" in said.texts[-1]
        reached = ctypes.c_double()
        instance.fmi2GetRealStatus(instance.component, fmpy.fmi2.fmi2LastSuccessfulTime, ctypes.byref(reached))
        assert 0.15 < reached.value < 0.45
        instance.reset()
        initialized(instance)
        steps(instance, 0, 10)


def test_an_end_of_the_simulation_is_handed_on(tmp_path: Path) -> None:
    system = System()
    system.add("q", quirky(tmp_path), start={"end": 0.55})
    alone = simulate(system, 1.0, 0.1).info["ended_by"]
    whole = System()
    whole.add("w", pack(system, tmp_path / "W.fmu", 0.1).path)
    assert simulate(whole, 1.0, 0.1).info["ended_by"]["time"] == pytest.approx(alone["time"], abs=0.11)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(
    ("quirk", "start"),
    [
        (Quirk.NONE, {"longest": 0.03}),
        (Quirk.COMPUTES_IN_PART, {"longest": 0.03}),
        (Quirk.IS_ASYNCHRONOUS, {}),
        (Quirk.NEEDS_TOLERANCE, {}),
        (Quirk.NEEDS_STOP_TIME, {}),
        (Quirk.REFUSES_TO_OVERSHOOT, {}),
    ],
)
def test_steps_are_finished_as_unpacked(
    fmus: Path, tmp_path: Path, quirk: Quirk, start: dict[str, float], version: int
) -> None:
    """Discarded steps are repeated in shorter ones; other FMUs need what they don't say."""
    system = System()
    system.add("i", fmus / "Integrator.fmu", start={"u": 1.0})
    system.add("q", quirky(tmp_path, quirk), start=start)
    system.add("j", fmus / "Integrator.fmu")
    system.connect("i.x", "q.u")
    system.connect("q.y", "j.u")
    expected = simulate(system, 0.3, 0.1)
    packed = pack(system, tmp_path / "W.fmu", 0.1, fmi=version)
    found = run_in_fmpy(packed.path, 0.3, 0.1, packed.outputs)
    assert np.array_equal(found, columns(expected, packed.outputs))
    assert found[-1, packed.outputs.index("q.y")] > 0.0


def test_a_step_that_no_component_can_make_is_said(tmp_path: Path) -> None:
    system = System()
    system.add("q", quirky(tmp_path), start={"longest": 1e-6})
    packed = pack(system, tmp_path / "W.fmu", 0.1)
    said = Said()
    with instance_of(packed.path, logger=said) as (instance, _):
        initialized(instance)
        with pytest.raises(FMICallException) as failed:
            instance.doStep(0.0, 0.1)
    assert failed.value.status == 2
    assert said.texts[-1].startswith("2 component 'q' did not finish the step of 0.1 s from t = 0 s on, nor steps of")


def test_outputs_that_are_not_finite_are_named(fmus: Path, tmp_path: Path) -> None:
    system = small_loop(fmus)
    packed = pack(system, tmp_path / "W.fmu", 0.1)
    whole = System()
    whole.add("w", packed.path, start={"g.K": 9.0, "i.T": 1e-6})
    with pytest.raises(Exception, match=r"component '[ig]'"):
        simulate(whole, 1e4, 100.0)


def test_a_token_of_another_build_is_refused(loop: Path, tmp_path: Path) -> None:
    from tests.support.small_fmus import redescribed

    token = fmpy.read_model_description(str(loop)).guid
    other = redescribed(loop, tmp_path / "other.fmu", {token: "{another}"})
    said = Said()
    with pytest.raises(Exception, match="instantiate"), instance_of(other, logger=said):
        pass
    assert said.texts == ["3 the token is not that of this FMU; don't mix files of different builds"]


@pytest.mark.parametrize("damage", ["cut", "empty", "other version", "missing"])
def test_a_damaged_plan_is_refused(loop: Path, tmp_path: Path, damage: str) -> None:
    import shutil

    description = fmpy.read_model_description(str(loop))
    folder = tmp_path / "unpacked"
    fmpy.extract(str(loop), str(folder))
    plan = folder / "resources/plan.txt"
    text = plan.read_text()
    if damage == "missing":
        plan.unlink()
    else:
        changed = {"cut": text[: len(text) // 2], "empty": "", "other version": text.replace("pack 1", "pack 2", 1)}
        plan.write_text(changed[damage])
    said = Said()
    with pytest.raises(Exception, match="instantiate"):
        fmpy.instantiate_fmu(str(folder), description, "CoSimulation", logger=said)
    assert "the plan of the system" in said.texts[0]
    shutil.rmtree(folder)


def test_components_share_no_global_variables(tmp_path: Path) -> None:
    """Two of one FMU have libraries of their own."""
    fmu = tank(tmp_path / "tank.fmu", "GLOBAL")
    system = System()
    for n in (1, 2):
        system.add(f"tank{n}", fmu, start={"u": float(n)})
    packed = pack(system, tmp_path / "Tanks.fmu", 0.5).path
    assert run_in_fmpy(packed, 2.0, 0.5, ["tank1.y", "tank2.y"])[-1].tolist() == [2.0, 4.0]
