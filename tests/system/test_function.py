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
        ({"function": lambda t, *, gain: t}, "missing a required (keyword-only )?argument: 'gain'"),
        ({"inputs": "theta"}, "inputs = 'theta' must be a mapping or a list of names"),
        ({"outputs": 3}, "outputs = 3 must be a mapping or a list of names"),
        ({"inputs": ["theta[1]"]}, r"inputs: 'theta\[1\]' is not a name; write a vector of 3 as theta\[1..3\]"),
        ({"inputs": ["theta[2..3]"]}, "is not a name"),
        ({"inputs": [""]}, "inputs: '' is not a name"),
        ({"inputs": [3]}, "inputs: 3 is not a name"),
        ({"inputs": {"u": 0}}, r"'u' has the shape \(0,\); its sizes must be positive whole numbers"),
        ({"inputs": ["u[1..0]"]}, r"'u\[1..0\]' has the shape \(0,\)"),
        ({"inputs": {"u": ("rad", (3, 1.5))}}, "its sizes must be positive whole numbers"),
        ({"inputs": {"u": ("rad", 3, 4)}}, "its sizes must be positive whole numbers"),
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


@pytest.mark.parametrize(
    ("spec", "expected"),
    [
        (None, ("Float64", None, ())),
        ("rad", ("Float64", "rad", ())),
        (bool, ("Boolean", None, ())),
        (1, ("Float64", None, (1,))),
        (np.int32(3), ("Float64", None, (3,))),
        (("rad", 3), ("Float64", "rad", (3,))),
        ([int, [2, np.int64(1)]], ("Int64", None, (2, 1))),
        ((2, 3), ("Float64", None, (2, 3))),
    ],
)
def test_what_a_variable_is(spec: Any, expected: tuple[Any, ...]) -> None:
    (variable,) = PythonFunction("c", law, {"u": spec}, (), direct_feedthrough=True).inputs
    assert (variable.name, variable.type, variable.unit, variable.shape) == ("u", *expected)


class Keeps:
    """An object that keeps how often it was called."""

    def __init__(self) -> None:
        self.calls = 5

    def __call__(self, time: float) -> float:
        self.calls += 1
        return time


class Resets(Keeps):
    def reset(self) -> None:
        self.calls = 0


class Saves(Keeps):
    def save(self) -> bytes:
        return bytes([self.calls])

    def restore(self, state: bytes) -> None:
        (self.calls,) = state


class Full:
    """Nobody can tell whether it is alive."""

    __slots__ = ()

    def __call__(self, time: float) -> float:
        return time


def of(function: Any) -> PythonFunction:
    return PythonFunction("c", function, (), (), direct_feedthrough=True)


@pytest.mark.parametrize(("kind", "begins_with"), [(Resets, 0), (Saves, 5)])
def test_each_run_begins_where_the_first_one_did(kind: type[Keeps], begins_with: int) -> None:
    function = of(kind())
    for run in (1, 2, 3):
        assert function.begin() == run
        assert function.owner.calls == begins_with
        function.function(0.0)


def test_an_object_that_can_not_go_back_takes_part_in_one_run() -> None:
    one, other = Keeps(), Keeps()
    assert (of(one).begin(), of(other).begin()) == (1, 1)
    for function in (of(one), of(other)):  # also in another simulation
        with pytest.raises(SetupError, match=r"component 'c': a Keeps has taken part in a run before .*reset\(\)"):
            function.begin()
    plain = of(law)
    assert (plain.begin(), plain.begin()) == (0, 0)  # keeps nothing


def test_an_object_that_can_not_be_told_from_an_earlier_one_is_refused() -> None:
    with pytest.raises(SetupError, match="component 'c': a Full can't be told from one that has taken part"):
        of(Full()).begin()


def test_its_state_is_that_of_its_object() -> None:
    function = of(Saves())
    state = function.save()
    function.function(0.0)
    assert (state, function.save()) == (bytes([5]), bytes([6]))
    function.restore(state)
    assert function.owner.calls == 5
    plain = of(law)
    plain.restore(plain.save())
    assert plain.save() == b""


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


@pytest.mark.parametrize(
    ("given", "taken", "why"),
    [
        ((2, 3), (3, 2), "an array of 2 x 3 can't feed one of 3 x 2; connect elements one by one"),
        ((2, 6), (2, 2, 3), "an array of 2 x 6 can't feed one of 2 x 2 x 3"),
        ((2, 3), (2, 3), ""),
        ((1, 2, 3), (2, 3), ""),
        ((6,), (2, 3), ""),
        ((6, 1), (6,), ""),
    ],
)
def test_an_array_of_other_sizes_is_not_fed(given: tuple[int, ...], taken: tuple[int, ...], why: str) -> None:
    system = System()
    system.add_function("a", lambda _: np.arange(np.prod(given)).reshape(given), outputs={"y": given})
    system.add_function("b", lambda _, u: u, inputs={"u": taken}, outputs={"y": taken})
    system.connect("a.y", "b.u")
    if why:
        with pytest.raises(SetupError, match=f"connection 'a.y' -> 'b.u': {why}"):
            Simulation(system)
    else:
        assert simulate(system, 1.0, 1.0)["b.y"][-1].ravel().tolist() == list(range(6))


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
    message = r"'c\.u' can only be held, because it is discrete and changes at communication points only; use 'auto'"
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
