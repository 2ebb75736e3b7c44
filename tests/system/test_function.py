"""Components that are functions in Python, as a system takes and refuses them; nothing has run by then."""

from __future__ import annotations

import pickle
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import SetupError, Simulation, System, simulate
from cosim.scenario.own_fmus import replaced
from cosim.ssp import Experiment, SSPError, write_ssp
from cosim.system.function import PythonFunction
from tests.support.tiny_models import GAIN, UNITS, build


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("functions"), GAIN, UNITS)


def law(time: float, *inputs: Any) -> float:
    return float(time + len(inputs))


class Law:
    def __call__(self, time: float) -> float:
        return time

    def step(self, time: float) -> float:
        return time

    @staticmethod
    def static(time: float) -> float:
        return time

    @classmethod
    def of_class(cls, time: float) -> float:
        return time

    def reset(self) -> None:
        pass


def added(**options: Any) -> System:
    system = System()
    system.add_function("c", **{"function": law, **options})
    return system


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"function": 3.0}, "component 'c': 3.0 is not callable"),
        (
            {"function": lambda t, u: u},
            r"with \(time\), which it does not take: missing a required argument: 'u'",
        ),
        ({"function": lambda t: t, "inputs": ["a", "b"]}, r"with \(time, a, b\), .*: too many positional arguments"),
        ({"function": lambda t, *, gain: t}, "missing a required argument: 'gain'"),
        ({"inputs": "theta"}, "inputs = 'theta' must be a mapping or a list of names"),
        ({"outputs": 3}, "outputs = 3 must be a mapping or a list of names"),
        ({"inputs": ["theta[1]"]}, r"inputs: 'theta\[1\]' is no name; write a vector of 3 as theta\[1..3\]"),
        ({"inputs": ["theta[2..3]"]}, "is no name"),
        ({"inputs": [""]}, "inputs: '' is no name"),
        ({"inputs": [3]}, "inputs: 3 is no name"),
        ({"inputs": {"u": 0}}, r"'u' has the shape \(0,\); its sizes must be positive whole numbers"),
        ({"inputs": ["u[1..0]"]}, r"'u\[1..0\]' has the shape \(0,\)"),
        ({"inputs": {"u": ("rad", (3, 1.5))}}, "its sizes must be positive whole numbers"),
        ({"inputs": {"u": True}}, "its sizes must be positive whole numbers"),
        ({"inputs": {"u": 1.5}}, "'u' is described by 1.5; write its unit or type, its shape, or both"),
        ({"inputs": {"u": complex}}, "is described by <class 'complex'>"),
        ({"inputs": {"u": ("rad", "m")}}, r"is described by \('rad', 'm'\); write its unit"),
        ({"inputs": {"u[1..3]": ("rad", 3)}}, "has a shape by its name, and another one beside it"),
        ({"inputs": ["u"], "outputs": ["u"]}, "there are two variables 'u'"),
        ({"inputs": ["u", "u[1..3]"]}, "there are two variables 'u'"),
        ({"every": 0}, "every = 0 must be a positive whole number"),
        ({"direct_feedthrough": "no"}, "direct_feedthrough = 'no' must be True or False"),
    ],
)
def test_a_function_that_is_not_described_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(SetupError, match=message):
        added(**options)


def test_its_name_is_its_own(tiny: Path) -> None:
    system = added()
    with pytest.raises(SetupError, match="there are two components named 'c'"):
        system.add_function("c", law)
    with pytest.raises(SetupError, match="there are two components named 'c'"):
        system.add("c", tiny / "Gain.fmu")
    with pytest.raises(SetupError, match="non-empty text without a dot"):
        system.add_function("a.b", law)


def test_two_functions_of_one_object_are_refused() -> None:
    one = Law()
    system = added(function=one)
    with pytest.raises(SetupError, match="components 'c' and 'd' are functions of one object; give each its own"):
        system.add_function("d", partial(one.step))
    system.add_function("e", Law())
    for name, plain in {"f": law, "g": law, "h": Law.static, "i": Law.of_class, "k": Law().of_class}.items():
        system.add_function(name, plain)


@pytest.mark.parametrize(
    ("function", "name"),
    [
        (law, f"{__name__}.law"),
        (partial(law, 1.0), f"{__name__}.law"),
        (Law(), f"{__name__}.Law"),
        (Law().step, f"{__name__}.Law.step"),
        (np.sin, "numpy.sin"),
        (np.ones(1).sum, "builtins.ndarray.sum"),
        (max, "builtins.max"),
    ],
)
def test_its_qualified_name(function: Any, name: str) -> None:
    made = PythonFunction("c", function, (), (), direct_feedthrough=True)
    assert made.qualified_name == name


def connected(tiny: Path, source: str, target: str, units: Any = "equal") -> System:
    system = added(inputs={"length": "m", "n": int, "v": 3}, outputs={"torque": "N.m", "bare": None, "w": ("N.m", 2)})
    system.add("u", tiny / "Units.fmu")
    system.connect(source, target, units=units)
    return system


@pytest.mark.parametrize(
    ("source", "target", "message"),
    [
        ("u.energy", "c.length", "units 'J' and 'm' don't match"),
        ("c.torque", "u.length", "units 'N.m' and 'm' don't match"),
        ("u.place", "c.n", "real and integer don't match; connect values of one type"),
        ("u.place", "c.v", "1 values can't feed 3; connect elements one by one"),
        ("c.w", "u.torque", "2 values can't feed 1"),
        ("c.length", "u.length", "'c.length' is an input and can't be the source"),
        ("u.place", "c.torque", "'c.torque' is an output and can't be the target"),
        ("u.place", "c.lenght", "component 'c' has no variable 'lenght'; did you mean 'length'?"),
        ("u.place", "c.length", "nothing feeds input 'c.n', 'c.v"),
    ],
)
def test_connections_are_checked_as_those_of_fmus(tiny: Path, source: str, target: str, message: str) -> None:
    with pytest.raises(SetupError, match=message.replace("?", r"\?")):
        Simulation(connected(tiny, source, target))


def test_units_may_be_ignored_or_unknown(tiny: Path) -> None:
    for source, target, units in (("c.torque", "u.length", "ignore"), ("c.bare", "u.length", "equal")):
        with pytest.raises(SetupError, match=r"nothing feeds input 'c\.length'"):
            Simulation(connected(tiny, source, target, units))


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ({"n": 1.5}, "1.5 is not a value of type Int64"),
        ({"on": 2}, "2 is not a value of type Boolean"),
        ({"y": 1.0}, "output variables can't be set"),
        ({"v": [1.0, 2.0]}, "2 values were given for 3"),
        ({"w": 1.0}, "component 'c' has no variable 'w'"),
    ],
)
def test_start_values_are_checked_as_those_of_fmus(start: dict[str, Any], message: str) -> None:
    with pytest.raises(SetupError, match=message):
        Simulation(added(inputs={"n": int, "on": bool, "v": 3}, outputs=["y"], start=start))


def test_linear_extrapolation_can_not_be_demanded_for_its_inputs() -> None:
    system = added(inputs=["u"], outputs=["y"])
    system.drive("c.u", lambda t: t)
    message = r"'c\.u' can only be held, for it is discrete and changes at communication points only; use 'auto'"
    with pytest.raises(SetupError, match=message):
        Simulation(system, extrapolation="linear")
    assert simulate(system, 0.2, 0.1)["c.u"].tolist() == [0.0, 0.1, 0.2]


def test_an_ssp_can_not_have_it(tmp_path: Path) -> None:
    with pytest.raises(SSPError, match="component 'c' is a function in Python; an SSP takes FMUs only"):
        write_ssp(tmp_path / "system.ssp", added(outputs=["y"]), "system", Experiment(1.0, 0.1))
    assert not list(tmp_path.iterdir())


def test_an_fmu_can_stand_in_for_it(tiny: Path) -> None:
    system = added(inputs={"u": 2}, outputs={"y": 2}, start={"u": 1.0})
    system.add_function("sink", lambda t, y: None, inputs={"y": 2})
    system.connect("c.y", "sink.y")
    other, missing = replaced(system, {"c": tiny / "Gain.fmu"})
    assert missing == []
    results = simulate(other, 0.2, 0.1)
    assert results["sink.y"].tolist() == [[2.0, 2.0]] * 3
    assert "c" in results.info["fmus"]
    assert list(results.info["functions"]) == ["sink"]


def test_a_system_of_functions_can_be_sent_to_another_process() -> None:
    system = added(outputs=["y"])
    system.add_function("o", Law(), outputs=["y"])
    copy = pickle.loads(pickle.dumps(system))
    assert simulate(copy, 1.0, 0.25).values.tolist() == simulate(system, 1.0, 0.25).values.tolist()


def test_a_system_is_described_without_fmpy() -> None:
    """Which takes long to import; commands that simulate nothing need not wait for it."""
    code = (
        "import sys; from cosim import System; System().add_function('f', lambda t: None); "
        "sys.exit('fmpy' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
