"""Order, accuracy, stability and cost of the coupling schemes: the robot, oscillators, a chain, a stiff split."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg
from scipy.integrate import solve_ivp

from benchmarks.measure import Section, interleaved
from benchmarks.system import STOP_TIME, disturbed
from cosim import Results, Simulation, SimulationError, System
from cosim import analysis as cosim_analysis
from cosim.analysis.stability import search
from cosim.errors import ArgumentError
from cosim.master.coupling.algorithm import EXTRAPOLATIONS, ORDERS
from fmu_export import build_native
from parallel_robot.stability import largest_stable_step
from tests.support.continuous_loop import end_effector, solve
from tests.support.oscillators import (
    FORCED,
    FORCING,
    Oscillator,
    coupled,
    fastest_period,
    linear,
    oscillator,
    splits,
)
from tests.support.tiny_models import LAG

STEPS = (20e-3, 10e-3, 4e-3, 2e-3, 1e-3, 0.5e-3)
EVERY = 0.02  # s
AFTER = 5.0  # s: what the start and the jump at 4 s have left is gone

#: Gains of the controller: those of the scenario, and two others.
GAINS: tuple[Mapping[str, float], ...] = ({}, {"alpha": 2.0, "beta": 1.5}, {"alpha": 5.0, "beta": 2.0})

#: Damping, spring between the masses, and second mass, of 27 oscillators.
OSCILLATORS = [(d, k, m) for d in (0.02, 0.1, 0.5) for k in (0.1, 1.0, 10.0) for m in (0.1, 1.0, 10.0)]

#: A stiff split: a light mass behind a spring that is ten thousand times stiffer than the others.
STIFF = (0.1, 1e4, 1e-3)

LAGS, LAG_STOP = 100, 10.0

#: Longer steps are not looked at.
_MOST_PERIODS = 10.0


def measure_coupling(folder: Path) -> Section:
    """Largest distance of the robot's end effector from the continuous loop, and time of a step."""
    scenario = disturbed()
    parts = [scenario.signals[n].function(size, scenario.seed, n) for n, size in (("plant.tau_d", 3), ("plant.dm", 1))]
    times = np.arange(round(STOP_TIME / EVERY) + 1) * EVERY
    at_rest = [0.0]  # the rate of the mass
    path = end_effector(solve(times, lambda t: np.concatenate([*(f(t) for f in parts), at_rest]), [4.0], rtol=1e-12))

    def errors(r: Results, step: float) -> tuple[float, float]:
        ours = np.column_stack([r["plant.x_E"], r["plant.y_E"]])[:: round(EVERY / step)]
        distance = np.hypot(*(ours - path).T)
        return float(distance.max()), float(distance[times >= AFTER].max())

    whole: dict[str, list[float]] = {}
    late: dict[str, list[float]] = {}
    loops: dict[str, Callable[[], float]] = {}
    open_ones: list[Simulation] = []
    for order in ORDERS:
        for name in EXTRAPOLATIONS:
            simulation = Simulation(scenario.system(folder, "fmi2"), order=order, extrapolation=name)
            open_ones.append(simulation.__enter__())
            found = [_errors_of(simulation, step, errors) for step in STEPS]
            whole[f"{order}, {name}"], late[f"{order}, {name}"] = (list(column) for column in zip(*found, strict=True))
            if order == "sequential":
                loops[f"{order}, {name}"] = partial(_processor_time, simulation)
    seconds = interleaved(loops, 9)
    for simulation in open_ones:
        simulation.close()
    orders = {n: _order(e) for n, e in whole.items()}
    stable = {n: _stable(*n.split(", ")) for n in whole}
    cost = {n: 1e6 * min(times) / (STOP_TIME / 1e-3) for n, times in seconds.items()}
    linear_one, adaptive = whole["sequential, linear"][4], whole["sequential, adaptive"][4]
    second, fourth = orders["sequential, linear"], orders["sequential, adaptive"]
    return Section(
        "Coupling schemes: the robot",
        "Largest distance (m) of the end effector from the continuous loop (DOP853, 1e-12) over 15 s, mass change and "
        f"disturbance on, and, behind the slash, from {AFTER:g} s on; order of the former fitted from 2 to 0.5 ms; "
        "largest stable step by the linear analysis for three sets of gains (adaptive: that of linear, its fallback); "
        "processor time of a step of 1 ms, shortest of nine interleaved runs.",
        ("scheme", *(f"{1e3 * s:g} ms" for s in STEPS), "order", "stable up to (ms)", "us a step"),
        [
            (
                n,
                *(_said(a, b) for a, b in zip(whole[n], late[n], strict=True)),
                f"{orders[n]:.2f}",
                "/".join(f"{1e3 * s:.1f}" for s in stable[n]),
                f"{cost[n]:.2f}" if n in cost else "",
            )
            for n in whole
        ],
        {
            "steps": STEPS,
            "errors": whole,
            "errors_late": late,
            "orders": orders,
            "largest_stable_steps": stable,
            "cost": cost,
        },
        [
            (f"order of the sequential linear coupling: {second:.3f}, 2", abs(second - 2.0) < 0.05),
            (f"order of the sequential adaptive coupling: {fourth:.3f}, 4", abs(fourth - 4.0) < 0.1),
            (f"linear / adaptive at 1 ms: {linear_one / adaptive:.0f}, at least 30", linear_one / adaptive >= 30.0),
        ],
    )


def _processor_time(simulation: Simulation) -> float:
    began = time.process_time()
    simulation.run(STOP_TIME, 1e-3)
    return time.process_time() - began


def _errors_of(
    simulation: Simulation, step: float, errors: Callable[[Results, float], tuple[float, float]]
) -> tuple[float, float]:
    try:
        return errors(simulation.run(STOP_TIME, step), step)
    except SimulationError:  # diverged
        return math.inf, math.inf


def _said(whole: float, late: float) -> str:
    return "unstable" if math.isinf(whole) else f"{whole:.1e}/{late:.1e}"


def _order(errors: list[float]) -> float:
    with np.errstate(invalid="ignore"):
        return float(np.polyfit(np.log(STEPS[3:]), np.log(errors[3:]), 1)[0])


def _stable(order: str, name: str) -> list[float]:
    return [largest_stable_step({"controller": g}, order=order, extrapolation=name, points=32) for g in GAINS]


def measure_other_systems(folder: Path) -> Section:  # noqa: ARG001 -- as all sections
    """Stable steps and errors of oscillators, a chain and a stiff split."""
    rows: list[tuple[str, ...]] = []
    data: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as place:
        for model in (FORCED, FORCING, LAG):
            build_native(model, place, "fmi2")
        for name in EXTRAPOLATIONS:
            limits, stiff = [], _limit(STIFF, name)
            for which in OSCILLATORS:
                of_linear, own = _limit(which, "linear"), _limit(which, name)
                if math.isfinite(of_linear):
                    limits.append(min(own, 100.0) / of_linear)
            error = [_oscillator_error(Path(place), name, h) for h in (0.1, 0.02)]
            chain = [_chain_error(Path(place), name, h) for h in (0.1, 0.02)]
            data[name] = {"limits": limits, "stiff": stiff, "oscillator": error, "chain": chain}
            ranked = sorted(limits)
            rows.append(
                (
                    name,
                    f"{ranked[0]:.2f}, {ranked[len(ranked) // 2]:.2f}, {ranked[-1]:.1f}",
                    f"{1e3 * stiff:.2f}",
                    *(f"{e:.1e}" for e in (*error, *chain)),
                )
            )
    return Section(
        "Coupling schemes: oscillators, a chain, a stiff split",
        f"Largest stable step of {len(OSCILLATORS)} two-mass oscillators (damping 0.02 to 0.5, spring and mass from a "
        "tenth to ten times) against that of linear: least, median, largest; the same (ms) of a stiff split; largest "
        f"error of one oscillator (damping 0.1) over 8 s, and at the end of {LAGS} lags in a row over {LAG_STOP:g} s, "
        "at steps of 0.1 and 0.02 s. Sequential order.",
        ("scheme", "stable step / linear's", "stiff split", "osc. 0.1 s", "osc. 0.02 s", "chain 0.1 s", "chain 0.02 s"),
        rows,
        data,
    )


def measure_iterated() -> Section:
    """Stable steps without and with iteration, in periods of the fastest motion."""
    rows: list[tuple[str, ...]] = []
    data: dict[str, Any] = {}
    oscillators = splits()
    for name in EXTRAPOLATIONS:
        row = [name]
        for iterated in (False, True):
            limits = [_periods(o, name, iterated=iterated) for o in oscillators]
            damped = [n for n, o in zip(limits, oscillators, strict=True) if o[2]]
            unlimited = sum(map(math.isinf, limits))
            row += [f"{min(limits):.3f}", f"{min(damped):.3f}", f"{unlimited}"]
            data[f"{name}, {'iterated' if iterated else 'not iterated'}"] = limits
        rows.append(tuple(row))
    n = len(oscillators)
    return Section(
        "Coupling schemes: iterated steps",
        f"Least stable step of {n} two-mass oscillators (masses 1 to 20, the force on either, springs 0.1 to 100, "
        "damping 0, 0.02 and 0.1), in periods of the fastest motion: of all, of those with damping, and how many have "
        f"no limit up to {_MOST_PERIODS:g}; without iteration, and with it. Sequential order.",
        ("scheme", "all", "damped", "no limit", "iterated: all", "damped", "no limit"),
        rows,
        data,
    )


def _periods(o: Oscillator, name: str, *, iterated: bool) -> float:
    """Largest stable step in periods; an undamped oscillator may keep what it has."""
    system, period = linear(o), fastest_period(o)

    def is_stable(step: float) -> bool:
        radius = cosim_analysis.spectral_radius(system, step * period, extrapolation=name, iterated=iterated)
        return bool(radius < (1.0 if o[2] else 1.0 + 1e-9))

    try:
        return search(is_stable, 1e-3, _MOST_PERIODS)
    except ArgumentError:
        return 0.0


def _limit(which: tuple[float, float, float], name: str) -> float:
    try:
        system = linear(oscillator(*which))
        return cosim_analysis.largest_stable_step(system, extrapolation=name, shortest=1e-5, longest=100.0)
    except ArgumentError:
        return 0.0


def _oscillator_error(folder: Path, name: str, step: float) -> float:
    o = oscillator(0.1, 1.0, 1.0)
    try:
        with Simulation(coupled(folder, o), extrapolation=name) as simulation:
            r = simulation.run(8.0, step)
    except SimulationError:
        return math.inf
    matrix = linear(o).closed_loop()
    exact = np.array([(scipy.linalg.expm(matrix * t) @ [1.0, 0.0, -0.5, 0.0])[0] for t in r.time])
    return float(np.abs(r["a.x"] - exact).max())


def _chain_error(folder: Path, name: str, step: float) -> float:
    """Lags of 0.05 s one behind the other, the first of sin(t)."""
    system = System()
    for i in range(LAGS):
        system.add(f"c{i}", folder / "Lag.fmu", start={"T": 0.05, "x_start": 0.0})
        if i:
            system.connect(f"c{i - 1}.x", f"c{i}.u")
    system.drive("c0.u", np.sin, vectorized=True)
    with Simulation(system, extrapolation=name, record=[f"c{LAGS - 1}.x"]) as simulation:
        r = simulation.run(LAG_STOP, step)

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        return np.asarray((np.concatenate([[math.sin(t)], x[:-1]]) - x) / 0.05)

    exact = solve_ivp(rates, (0.0, LAG_STOP), np.zeros(LAGS), "DOP853", r.time, rtol=1e-11, atol=1e-13)
    return float(np.abs(r[f"c{LAGS - 1}.x"] - exact.y[-1]).max())
