"""Calls of a native FMU that must fail, and the runs that they must leave as they are.

A module of its own, because processes that the tests start import it too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from ctypes import c_double, c_void_p
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from plant_fmu.model import INPUTS, OUTPUTS
from tests.support.native_fmus import DISCARD, ERROR, FLAVOURS, Host

#: N m; torques of the runs.
TORQUE = {"tau_a[1]": 0.05, "tau_a[2]": -0.03, "tau_a[3]": 0.04}


@dataclass(frozen=True)
class Misuse:
    """A call that must fail, on a fresh instance of the plant."""

    name: str
    call: Callable[[Host], int]
    words: str  # regular expression that the messages must match
    status: int = ERROR
    kind: str = "CoSimulation"
    flavours: tuple[str, ...] = FLAVOURS


ME = {"kind": "ModelExchange"}
ONLY_2: dict[str, Any] = {"flavours": ("fmi2",)}
ONLY_3: dict[str, Any] = {"flavours": ("fmi3",)}
UNREACHABLE = {"x_E_start": 5.0}
STATE_MACHINE = "can't be called"
AFTER_ERROR = "can't be called after an error; restore a saved FMU state, or reset"


def twice(h: Host) -> int:
    h.run_up()
    h.must(h.call("Terminate"))
    return h.call("Terminate")


def enter_after_reset(h: Host) -> int:
    h.run_up()
    h.must(h.call("Reset"))
    return h.call(*INIT[h.version])


def after_terminate(call: Callable[[Host], int]) -> Callable[[Host], int]:
    def run(h: Host) -> int:
        h.run_up()
        h.must(h.call("Terminate"))
        return call(h)

    return run


def after_error(call: Callable[[Host], int]) -> Callable[[Host], int]:
    def run(h: Host) -> int:
        h.run_up()
        assert h.try_get([9999])[0] == ERROR
        return call(h)

    return run


def after_discard(call: Callable[[Host], int]) -> Callable[[Host], int]:
    def run(h: Host) -> int:
        h.run_up()
        assert h.step(0.0, 1e9) == DISCARD
        return call(h)

    return run


def until(h: Host, stop: float) -> Host:
    """Initialise with a stop time (s)."""
    h.must(h.enter(stop=stop))
    h.must(h.exit())
    return h


def typed(h: Host, function: str) -> int:
    """Get or set variable 0 as of another type."""
    buffer = (c_double * 1)()
    sizes = (1,) if h.version == 3 else ()
    return h.call(function, h.vr([0]), 1, buffer, *sizes)


NAN, INF = math.nan, math.inf

CASES = [
    Misuse("step before init", lambda h: h.step(0.0, 1e-3), STATE_MACHINE),
    Misuse("step in init", lambda h: h.enter() or h.step(0.0, 1e-3), STATE_MACHINE),
    Misuse("step in model exchange", lambda h: h.run_up().step(0.0, 1e-3), STATE_MACHINE, **ME),
    Misuse("get before init", lambda h: h.try_get(["X"])[0], STATE_MACHINE, **ONLY_2),
    Misuse("get typed before init", lambda h: h.call("GetBoolean", None, 0, None), STATE_MACHINE, **ONLY_2),
    Misuse(
        "get output before init", lambda h: h.try_get(["X", "x_E"])[0], "'x_E' is computed and has no value", **ONLY_3
    ),
    Misuse("step after an error", after_error(lambda h: h.step(0.0, 1e-3)), AFTER_ERROR),
    Misuse("set after an error", after_error(lambda h: h.set({"dm": 0.1})), AFTER_ERROR),
    Misuse("terminate after an error", after_error(lambda h: h.call("Terminate")), AFTER_ERROR),
    Misuse("states after an error", after_error(lambda h: h.set_states([0.0] * 12)), AFTER_ERROR, **ME),
    Misuse("step after a discarded one", after_discard(lambda h: h.step(0.0, 1e-3)), "after a discarded", **ONLY_2),
    Misuse("set after a discarded step", after_discard(lambda h: h.set({"dm": 0.0})), "after a discarded", **ONLY_2),
    Misuse("step back", lambda h: h.run_up().step(0.0, 1e-3) or h.step(0.0, 1e-3), "at 0.001 s; go on there"),
    Misuse("step ahead", lambda h: h.run_up(start=1.0).step(1.1, 1e-3), "is at 1 s; go on there"),
    Misuse("step elsewhere by a part of its length", lambda h: h.run_up().step(1e-10, 1e-9), "is at 0 s"),
    Misuse("step past the stop time", lambda h: until(h, 0.2).step(0.0, 0.25), "goes past 0.2 s"),
    Misuse("step from the stop time", lambda h: until(h, 0.2).step(0.0, 0.2) or h.step(0.2, 1e-3), "goes past 0.2 s"),
    Misuse("nan stop time", lambda h: h.enter(stop=NAN), "stop time -?nan"),
    Misuse("step after terminate", after_terminate(lambda h: h.step(0.0, 1e-3)), STATE_MACHINE),
    Misuse("set after terminate", after_terminate(lambda h: h.set({"dm": 0.1})), STATE_MACHINE),
    Misuse(
        "enter without setup", lambda h: h.call(*INIT[h.version]), "fmi2SetupExperiment must be called before", **ONLY_2
    ),
    Misuse("enter after a reset", enter_after_reset, "fmi2SetupExperiment must be called before", **ONLY_2),
    Misuse("enter twice", lambda h: h.enter() or h.call(*INIT[h.version]), STATE_MACHINE),
    Misuse("exit without enter", lambda h: h.exit(), STATE_MACHINE),
    Misuse("exit twice", lambda h: h.run_up().exit(), STATE_MACHINE),
    Misuse("terminate before init", lambda h: h.call("Terminate"), STATE_MACHINE),
    Misuse("terminate twice", twice, STATE_MACHINE),
    Misuse("continuous states in co-simulation", lambda h: h.run_up().set_states([0.0] * 12), STATE_MACHINE),
    Misuse("derivatives in co-simulation", lambda h: h.run_up().try_derivatives(12)[0], STATE_MACHINE),
    Misuse("set states in event mode", lambda h: h.run_up().set_states([0.0] * 12), STATE_MACHINE, **ME),
    Misuse("event update in continuous mode", lambda h: h.run_up().continuous().update(), STATE_MACHINE, **ME),
    Misuse("time in co-simulation", lambda h: h.run_up().call("SetTime", 1.0), STATE_MACHINE),
    Misuse("direction before init", lambda h: h.direction(["x_E"], {"dm": 1.0})[0], STATE_MACHINE),
    Misuse("rates before init", lambda h: h.set_rates({"dm": 1.0}), STATE_MACHINE, **ONLY_2),
    Misuse("rates in model exchange", lambda h: h.run_up().set_rates({"dm": 1.0}), STATE_MACHINE, **ME, **ONLY_2),
    Misuse(
        "setup after init", lambda h: h.run_up().call("SetupExperiment", 0, 0.0, 0.0, 0, 0.0), STATE_MACHINE, **ONLY_2
    ),
    Misuse("parameter after init", lambda h: h.run_up().set({"l": 0.2}), "parameter 'l' is fixed.*reset"),
    Misuse("parameters after init", lambda h: h.run_up().set({"X": 0.1, "m_a": 1.0}), "parameter 'm_a' is fixed"),
    Misuse(
        "tunable parameter in continuous mode",
        lambda h: h.run_up().continuous().set({"X": 0.1}),
        "parameter 'X' can't be set now; set it in event mode",
        **ME,
    ),
    Misuse("tunable parameter after terminate", after_terminate(lambda h: h.set({"X": 0.1})), STATE_MACHINE),
    Misuse("nan tunable parameter", lambda h: h.run_up().set({"X": NAN}), "'X' can't be -?nan"),
    Misuse(
        "tunable parameter below its limit",
        lambda h: h.run_up().set({"X": -1.0}),
        "parameter 'X' is -1; it must be between",
        DISCARD,
    ),
    Misuse(
        "tunable parameter that makes the mass matrix indefinite",
        lambda h: h.run_up().set({"X": 0.01}) or h.step(0.0, 1e-3),
        "t = 0 s: .*positive definite",
        DISCARD,
    ),
    Misuse("output", lambda h: h.set({"x_E": 0.1}), "'x_E' is computed"),
    Misuse("derivative", lambda h: h.run_up().set({"der(omega_a[1])": 0.1}), r"'der\(omega_a\[1\]\)' is computed"),
    Misuse("unknown reference set", lambda h: h.set({9999: 0.1}), "value reference 9999"),
    Misuse("unknown reference get", lambda h: h.enter() or h.try_get([9999])[0], "value reference 9999"),
    Misuse("largest reference get", lambda h: h.enter() or h.try_get([2**32 - 1])[0], "value reference 4294967295"),
    Misuse("set time variable", lambda h: h.run_up().set({"time": 0.1}), "reference|time", **ONLY_3),
    Misuse("nan input", lambda h: h.run_up().set({"dm": NAN}), "'dm' can't be -?nan"),
    Misuse("infinite input", lambda h: h.run_up().set({"tau_a[2]": INF}), r"'tau_a\[2\]' can't be inf"),
    Misuse("nan parameter", lambda h: h.set({"X": NAN}), "'X' can't be -?nan"),
    Misuse("nan start time", lambda h: h.enter(NAN), "start time -?nan"),
    Misuse("parameter below its limit", lambda h: h.set({"l": -1.0}) or h.enter() or h.exit(), "parameter 'l' is -1"),
    Misuse(
        "get with a parameter below its limit",
        lambda h: h.set({"l": -1.0}) or h.enter() or h.try_get(["x_E"])[0],
        "'l' is -1",
    ),
    Misuse("unreachable start", lambda h: h.set(UNREACHABLE) or h.enter() or h.exit(), "out of reach of chain 1"),
    Misuse(
        "get of an unreachable start",
        lambda h: h.set(UNREACHABLE) or h.enter() or h.try_get(["x_E"])[0],
        "out of reach",
    ),
    Misuse(
        "direction of an unreachable start",
        lambda h: h.set(UNREACHABLE) or h.enter() or h.direction(["x_E"], {"l": 1.0})[0],
        "out of reach",
    ),
    Misuse(
        "indefinite mass matrix at the start",
        lambda h: h.set({"dm": -5.0}) or h.enter() or h.exit(),
        "positive definite",
    ),
    Misuse(
        "indefinite mass matrix in a step",
        lambda h: h.run_up().set({"dm": -5.0}) or h.step(0.0, 1e-3),
        "t = 0 s: .*positive definite",
        DISCARD,
    ),
    Misuse(
        "indefinite mass matrix in model exchange",
        lambda h: h.run_up().continuous().set({"dm": -5.0}) or h.try_derivatives(12)[0],
        "positive definite",
        DISCARD,
        **ME,
    ),
    Misuse("step of zero", lambda h: h.run_up().step(0.0, 0.0), "communication step 0 s"),
    Misuse("negative step", lambda h: h.run_up().step(0.0, -1e-3), "communication step -0.001 s"),
    Misuse("nan step", lambda h: h.run_up().step(0.0, NAN), "communication step -?nan"),
    Misuse("infinite step", lambda h: h.run_up().step(0.0, INF), "communication step inf"),
    Misuse("nan time", lambda h: h.run_up().step(NAN, 1e-3), "-?nan"),
    Misuse("huge step", lambda h: h.run_up().step(0.0, 1e9), "more than 1000000 internal steps.*max_step", DISCARD),
    Misuse(
        "huge torque",
        lambda h: h.run_up().set({"tau_a[1]": 1e300}) or h.step(0.0, 1.0),
        "the loop closure is lost|the derivatives are not finite",
        DISCARD,
    ),
    Misuse(
        "nan continuous state", lambda h: h.run_up().continuous().set_states([NAN] * 12), "states.*not finite", **ME
    ),
    Misuse("wrong number of states set", lambda h: h.run_up().continuous().set_states([0.0] * 11), "12 .*not 11", **ME),
    Misuse("wrong number of derivatives", lambda h: h.run_up().try_derivatives(13)[0], "12 .*not 13", **ME),
    Misuse(
        "wrong number of states got",
        lambda h: h.run_up().call("GetContinuousStates", (c_double * 12)(), 0),
        "12 .*not 0",
        **ME,
    ),
    Misuse(
        "wrong number of nominals",
        lambda h: h.run_up().call("GetNominalsOfContinuousStates", (c_double * 3)(), 3),
        "12 .*not 3",
        **ME,
    ),
    Misuse(
        "event indicators",
        lambda h: h.run_up().call("GetEventIndicators", (c_double * 1)(), 1),
        "0 event indicators",
        **ME,
    ),
    Misuse("nan time in model exchange", lambda h: h.run_up().call("SetTime", NAN), "time -?nan", **ME),
    Misuse(
        "get integer", lambda h: h.enter() or typed(h, f"Get{h.integer}"), "no variable of this FMU is of this type"
    ),
    Misuse("set integer", lambda h: typed(h, f"Set{h.integer}"), "no variable of this FMU is of this type"),
    Misuse("set boolean", lambda h: typed(h, "SetBoolean"), "no variable of this FMU is of this type"),
    Misuse("get string", lambda h: h.enter() or typed(h, "GetString"), "no variable of this FMU is of this type"),
    Misuse("direction of an input", lambda h: h.run_up().direction(["dm"], {"dm": 1.0})[0], "not an unknown"),
    Misuse(
        "direction of an unknown reference", lambda h: h.run_up().direction([9999], {"dm": 1.0})[0], "reference 9999"
    ),
    Misuse(
        "direction along an unknown reference",
        lambda h: h.run_up().direction(["x_E"], {9999: 1.0})[0],
        "reference 9999",
    ),
    Misuse("direction along nan", lambda h: h.run_up().direction(["F_c[1]"], {"dm": NAN})[0], "finite|nan"),
    Misuse(
        "rates of order 4", lambda h: h.run_up().set_rates({"dm": 1.0}, order=4), "order 4.*only of orders 1", **ONLY_2
    ),
    Misuse("rates of order 0", lambda h: h.run_up().set_rates({"dm": 1.0}, order=0), "order 0", **ONLY_2),
    Misuse("rate of a parameter", lambda h: h.run_up().set_rates({"X": 1.0}), "not an input", **ONLY_2),
    Misuse("rate of an output", lambda h: h.run_up().set_rates({"x_E": 1.0}), "not an input", **ONLY_2),
    Misuse("rate of an unknown reference", lambda h: h.run_up().set_rates({9999: 1.0}), "9999", **ONLY_2),
    Misuse("nan rate", lambda h: h.run_up().set_rates({"dm": NAN}), "derivative of 'dm' can't be -?nan", **ONLY_2),
    Misuse("cancel step", lambda h: h.run_up().call("CancelStep"), "none to cancel", **ONLY_2),
    Misuse(
        "output derivatives of order 2",
        lambda h: h.run_up().output_rates(["x_E"], order=2)[0],
        "order 2.*maxOutputDerivativeOrder is 1",
    ),
    Misuse("output derivative of an input", lambda h: h.run_up().output_rates(["dm"])[0], "not an output"),
    Misuse(
        "adjoint derivative of an input",
        lambda h: h.run_up().adjoint(["dm"], {"dm": 1.0})[0],
        "is not an unknown: give outputs or state derivatives",
        **ONLY_3,
    ),
    Misuse(
        "adjoint derivative by an output",
        lambda h: h.run_up().adjoint(["x_E"], {"x_E": 1.0})[0],
        "is not a known: give states, inputs or parameters",
        **ONLY_3,
    ),
    Misuse(
        "numbers of adjoint derivatives",
        lambda h: h.run_up().call(
            "GetAdjointDerivative", h.vr(["x_E"]), 1, h.vr(["dm"]), 1, (c_double * 2)(), 2, (c_double * 1)(), 1
        ),
        "2 values for 1 variables, which are all scalars",
        **ONLY_3,
    ),
    Misuse("configuration mode", lambda h: h.call("EnterConfigurationMode"), "no structural parameters", **ONLY_3),
    Misuse("event mode in co-simulation", lambda h: h.run_up().call("EnterEventMode"), STATE_MACHINE),
    Misuse("step mode", lambda h: h.run_up().call("EnterStepMode"), "no event mode", **ONLY_3),
    Misuse(
        "numbers of values",
        lambda h: h.call("GetFloat64", h.vr(["X"]), 1, (c_double * 2)(), 2),
        "2 values for 1 variables",
        **ONLY_3,
    ),
    Misuse(
        "numbers of seeds",
        lambda h: h.run_up().call(
            "GetDirectionalDerivative", h.vr(["x_E"]), 1, h.vr(["dm"]), 1, (c_double * 2)(), 2, (c_double * 1)(), 1
        ),
        "2 values for 1 variables, which are all scalars",
        **ONLY_3,
    ),
    Misuse("state to set missing", lambda h: h.restore(c_void_p()), "no FMU state"),
    Misuse("bytes of another length", lambda h: h.restore_bytes(b"abc"), "damaged or belongs to another"),
    Misuse(
        "values array missing",
        lambda h: h.enter() or h.call(f"Get{h.real}", h.vr(["X"]), 1, None, *h._extra(1)),
        "is missing",
    ),
    Misuse(
        "references array missing",
        lambda h: h.call(f"Set{h.real}", None, 1, (c_double * 1)(), *h._extra(1)),
        "is missing",
    ),
]

#: Entering the initialisation mode once more, without SetupExperiment.
INIT: dict[int, tuple[Any, ...]] = {
    2: ("EnterInitializationMode",),
    3: ("EnterInitializationMode", False, 0.0, 0.0, False, 0.0),
}

#: Missing pointers that only a broken importer passes; tried in a process of their own.
MISSING = [
    Misuse("states to set", lambda h: h.run_up().continuous().call("SetContinuousStates", None, 12), "missing", **ME),
    Misuse("states to get", lambda h: h.run_up().call("GetContinuousStates", None, 12), "missing", **ME),
    Misuse(
        "state derivatives",
        lambda h: h.run_up().call({2: "GetDerivatives", 3: "GetContinuousStateDerivatives"}[h.version], None, 12),
        "missing",
        **ME,
    ),
    Misuse(
        "rates", lambda h: h.run_up().call("SetRealInputDerivatives", h.vr(["dm"]), 1, None, None), "missing", **ONLY_2
    ),
    Misuse(
        "seeds",
        lambda h: h.run_up().call(
            "GetDirectionalDerivative", h.vr(["x_E"]), 1, h.vr(["dm"]), 1, None, (c_double * 1)()
        ),
        "missing",
        **ONLY_2,
    ),
    Misuse(
        "seeds 3",
        lambda h: h.run_up().call(
            "GetDirectionalDerivative", h.vr(["x_E"]), 1, h.vr(["dm"]), 1, None, 1, (c_double * 1)(), 1
        ),
        "missing",
        **ONLY_3,
    ),
    Misuse("event info", lambda h: h.run_up().call("NewDiscreteStates", None), "missing", **ME, **ONLY_2),
    Misuse(
        "step results",
        lambda h: h.run_up().call("DoStep", 0.0, 1e-3, True, None, None, None, None),
        "missing",
        **ONLY_3,
    ),
    Misuse("place of the state", lambda h: h.call(h._state_function("GetFMUState"), None), ""),
    Misuse(
        "place of the deserialised state",
        lambda h: h.call(h._state_function("DeserializeFMUState"), h.save_bytes(), len(h.save_bytes()), None),
        "",
    ),
]


def good_run(folder: Path) -> list[float]:
    with Host(folder) as host:
        host.run_up(TORQUE)
        for i in range(50):
            host.must(host.step(i * 1e-3, 1e-3))
        values = host.get(list(OUTPUTS.names))
        host.must(host.call("Terminate"))
        assert host.messages == []
        return values


def advance(host: Host, first: int, last: int) -> list[float]:
    for i in range(first, last):
        host.must(host.set({"tau_a[1]": 0.1 * math.sin(i), "dm": 0.01 * i}))
        host.must(host.step(i * 1e-3, 1e-3))
    return host.get([*INPUTS.names, *OUTPUTS.names])


def prepared(folder: Path) -> Host:
    """Some steps on, with an input derivative (FMI 2.0) that is yet to be used."""
    host = Host(folder).run_up(TORQUE | {"x_E_start": 0.21})
    advance(host, 0, 10)
    if host.version == 2:
        host.must(host.set_rates({"tau_a[2]": 30.0}))
    return host
