"""What one call of an FMU gets or sets, and when: as few calls as the dependencies allow, by hand for small systems."""

from __future__ import annotations

import numpy as np
import pytest
from fmpy.model_description import ModelDescription

from cosim import System
from cosim.master.coupling.algorithm import algorithm
from cosim.master.coupling.extrapolated_inputs import extrapolated_inputs
from cosim.master.value_layout import ValueLayout
from cosim.system.resolution import resolve
from tests.support.descriptions import fmi2, ports


def layout_of(
    system: System, descriptions: dict[str, ModelDescription], *recorded: str, extrapolation: str = "hold"
) -> ValueLayout:
    """The layout of a system that records variables `component.variable`."""
    resolved = resolve(system, ports(**descriptions), needs_levels=False)
    names = [path.partition(".") for path in recorded]
    elements = [(component, e) for component, _, name in names for e in resolved.ports[component].find(name)]
    return ValueLayout(resolved, elements, extrapolated_inputs(resolved, algorithm(extrapolation=extrapolation)))


#: Level, component, and names of the variables in one call.
Call = tuple[int, str, str]


def calls(layout: ValueLayout, kind: str) -> list[Call]:
    """Those of a kind; positions are those of the elements, one after the other."""
    parts = getattr(layout, kind)
    for part in parts:
        names = [(part.component, e.name) for e in part.elements]
        assert [layout.positions[name] for name in names] == list(range(part.first, part.first + len(names)))
    return [(part.level, part.component, " ".join(e.name for e in part.elements)) for part in parts]


def system_of(*components: str, connect: str = "", drive: str = "", start: str = "") -> System:
    """Components with connections `a.y>b.u`, signals and start values of 0, given in words."""
    system = System()
    for name in components:
        held = [path.partition(".")[2] for path in start.split() if path.startswith(f"{name}.")]
        system.add(name, f"{name}.fmu", start=dict.fromkeys(held, 0.0))
    for pair in connect.split():
        system.connect(*pair.split(">"))
    for path in drive.split():
        system.drive(path, lambda t: t)
    return system


GAIN = ("u input Real", "y output Real")


def test_a_chain_of_gains_is_exchanged_level_by_level() -> None:
    system = system_of("a", "b", "c", connect="a.y>b.u b.y>c.u", drive="a.u")
    layout = layout_of(system, {n: fmi2(*GAIN, guid=n, feedthrough=True) for n in "abc"}, "c.y")
    assert calls(layout, "sets") == [(0, "a", "u"), (1, "b", "u"), (2, "c", "u")]
    assert calls(layout, "gets") == [(0, "a", "y"), (1, "b", "y"), (2, "c", "y")]
    assert (calls(layout, "constants"), layout.size, layout.columns) == ([], 6, {("a", "u"): 0})


def test_outputs_that_nobody_needs_are_not_read() -> None:
    system = system_of("a", "b", connect="a.y>b.u", drive="a.u")
    layout = layout_of(system, {n: fmi2(*GAIN, "z output Real", guid=n) for n in "ab"})
    assert calls(layout, "gets") == [(0, "a", "y")]


#: Output `now` does not depend on the inputs, `through` does.
BOTH = ("u input Real", "now output Real", "through output Real", "more output Real")


def test_what_is_only_recorded_is_read_after_all_inputs() -> None:
    """`b` is fed on level 1; what it gives before that is read on level 0, the rest in one call."""
    system = system_of("a", "b", connect="a.y>b.u b.now>a.u")
    one = fmi2(*GAIN, guid="a", feedthrough=True)
    other = fmi2(*BOTH, guid="b", feedthrough={"through": "u"})
    layout = layout_of(system, {"a": one, "b": other}, "b.through", "b.more", "b.now")
    assert calls(layout, "gets") == [(1, "a", "y"), (0, "b", "now"), (2, "b", "through more")]
    assert calls(layout, "sets") == [(1, "a", "u"), (2, "b", "u")]
    # also where it depends on no input: the call before would make the FMU compute its outputs twice
    layout = layout_of(system, {"a": one, "b": other}, "b.more")
    assert calls(layout, "gets") == [(1, "a", "y"), (0, "b", "now"), (2, "b", "more")]


def test_what_is_only_recorded_joins_the_next_call_that_feeds_somebody() -> None:
    system = system_of("a", "b", connect="a.through>b.u", drive="a.u")
    first = fmi2(*BOTH, guid="a", feedthrough={"through": "u"})
    layout = layout_of(system, {"a": first, "b": fmi2(*BOTH, guid="b")}, "a.more", "a.now")
    assert calls(layout, "gets") == [(0, "a", "now through more")]


def test_inputs_wait_for_each_other_where_nothing_that_is_read_depends_on_them_before() -> None:
    descriptions = {"a": fmi2(*GAIN, guid="a", feedthrough=True)}
    two = ("u input Real", "v input Real", "y output Real", "z output Real")
    system = system_of("a", "b", connect="a.y>b.v", drive="a.u b.u")
    layout = layout_of(system, descriptions | {"b": fmi2(*two, guid="b", feedthrough={"y": "u v"})}, "b.y")
    assert calls(layout, "sets") == [(0, "a", "u"), (1, "b", "u v")]
    # an output that depends on the first input alone feeds another component at once
    system = system_of("a", "b", "c", connect="a.y>b.v b.z>c.u", drive="a.u b.u")
    descriptions |= {"b": fmi2(*two, guid="b", feedthrough={"y": "u v", "z": "u"}), "c": fmi2(*GAIN, guid="c")}
    layout = layout_of(system, descriptions, "b.y")
    assert calls(layout, "sets") == [(0, "a", "u"), (0, "b", "u"), (1, "b", "v"), (1, "c", "u")]
    assert calls(layout, "gets") == [(0, "a", "y"), (0, "b", "z"), (1, "b", "y")]


def test_a_local_variable_may_depend_on_every_input() -> None:
    system = system_of("a", "b", connect="a.y>b.u", drive="a.u")
    inner = fmi2(*GAIN, "x local Real", guid="b")
    layout = layout_of(system, {"a": fmi2(*GAIN, guid="a", feedthrough=True), "b": inner}, "b.x")
    assert calls(layout, "gets") == [(0, "a", "y"), (1, "b", "x")]


def test_what_depends_on_nothing_is_read_first() -> None:
    """Also of a component that has neither inputs nor outputs, and so no place among the levels."""
    layout = layout_of(system_of("a"), {"a": fmi2("x local Real")}, "a.x")
    assert calls(layout, "gets") == [(0, "a", "x")]


def test_around_an_algebraic_loop_all_is_on_one_level() -> None:
    system = system_of("a", "b", connect="a.y>b.u b.y>a.u")
    layout = layout_of(system, {n: fmi2(*GAIN, guid=n, feedthrough=True) for n in "ab"})
    assert calls(layout, "sets") == [(0, "a", "u"), (0, "b", "u")]
    assert calls(layout, "gets") == [(0, "a", "y"), (0, "b", "y")]


def test_types_take_calls_of_their_own() -> None:
    mixed = ("u input Real", "n input Integer", "v input Real", "m input Integer", "b input Boolean")
    layout = layout_of(system_of("a", drive="a.u a.n a.v a.m a.b"), {"a": fmi2(*mixed)})
    assert sorted(calls(layout, "sets")) == [(0, "a", "b"), (0, "a", "n m"), (0, "a", "u v")]


def test_what_does_not_change_is_read_once() -> None:
    variables = (
        *GAIN,
        "v input Real",
        "p parameter Real",
        "t parameter Real variability=tunable",
        "c output Real variability=constant initial=exact",
    )
    system = system_of("a", drive="a.u", start="a.v")
    layout = layout_of(system, {"a": fmi2(*variables)}, "a.v", "a.p", "a.t", "a.c", "a.y", "a.u")
    assert calls(layout, "constants") == [(0, "a", "v p t c")]
    assert calls(layout, "gets") == [(0, "a", "y")]
    assert calls(layout, "sets") == [(0, "a", "u")]


def test_recorded_values_that_stand_together_are_one_run() -> None:
    variables = ("u input Real", *(f"y[{i}] output Real" for i in (1, 2, 3)), "p parameter Real")
    system = system_of("a", drive="a.u")
    descriptions = {"a": fmi2(*variables)}

    def runs(*recorded: str) -> list[list[str]]:
        layout = layout_of(system, descriptions, *recorded)
        names = {position: name for (_, name), position in layout.positions.items()}
        return [[names[position] for position in range(k, k + n)] for k, n in layout.recorded_runs.tolist()]

    assert runs("a.y") == [["y[1]", "y[2]", "y[3]"]]
    assert runs("a.y[3]", "a.y[1]", "a.y[2]") == [["y[3]"], ["y[1]", "y[2]"]]
    assert runs("a.y[1]", "a.y[3]", "a.u") == [["y[1]", "y[3]"], ["u"]]  # nobody reads the one between
    assert runs("a.y[1]", "a.y[3]", "a.y[2]", "a.y[1]") == [["y[1]"], ["y[3]"], ["y[2]"], ["y[1]"]]
    assert runs("a.u", "a.y") == [["u", "y[1]", "y[2]", "y[3]"]]
    assert runs() == []
    assert layout_of(system, descriptions, "a.y").recorded_runs.dtype == np.int32


def test_an_added_signal_stands_behind_all_that_is_exchanged() -> None:
    system = system_of("a", "b", connect="a.y>b.u", drive="a.u")
    system.disturb("b.u", lambda t: t)
    layout = layout_of(system, {n: fmi2(*GAIN, guid=n) for n in "ab"})
    assert layout.added == {("b", "u"): 3}
    assert (layout.size, sorted(layout.positions.values())) == (4, [0, 1, 2])
    assert layout.columns == {("a", "u"): 0, ("b", "u"): 1}


@pytest.mark.parametrize("extrapolation", ["auto", "hold"])
def test_inputs_stand_in_the_order_held_extrapolated_known_beforehand(extrapolation: str) -> None:
    """So that what takes rates is contiguous: `d` is discrete and held, `v` follows a connection, others signals."""
    variables = ("u input Real", "v input Real", "w input Real", "d input Real variability=discrete")
    system = system_of("a", "b", connect="a.y>b.v", drive="a.u b.u b.w b.d")
    descriptions = {"a": fmi2(*GAIN, guid="a"), "b": fmi2(*variables, guid="b", interpolates=True)}
    layout = layout_of(system, descriptions, extrapolation=extrapolation)
    order = "d v u w" if extrapolation == "auto" else "u v w d"
    assert calls(layout, "sets") == [(0, "a", "u"), (1, "b", order)]
    (transfer,) = [each for each in layout.sets if each.component == "b"]
    groups = layout.extrapolated_groups(transfer)
    assert [[e.name for e in group.elements] for group in groups] == (
        [["v", "u", "w"]] if extrapolation == "auto" else []
    )
