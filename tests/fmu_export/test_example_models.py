"""The example models against solutions by other means, in FMI 2.0 and 3.0, by FMPy and by our master."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import RegularGridInterpolator, make_interp_spline
from scipy.linalg import expm

from fmu_export import DefaultExperiment, ModelClass, build_native, compose, discrete, every, parameter, state
from fmu_export import input as input_
from interop.tools import ecos
from tests.support.compilation import built_once, shared_compilation
from tests.support.example_models import FOLDER, Example, Values, build, by_ecos, by_fmpy, by_our_master
from tests.support.native_fmus import FLAVOURS, require_compiler

#: Integration of the oracles.
TIGHT = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12, "dense_output": True}


def pendulum(times: np.ndarray) -> Values:
    """The masses in Cartesian coordinates, held by the forces of the rods (Lagrange multipliers)."""
    n, m, length, g, torque = 3, np.array([0.5, 1.0, 0.2]), np.array([0.3, 0.2, 0.4]), 9.81, 0.3
    before = np.eye(n, k=-1)  # a rod's upper end is the mass before it
    theta = np.array([1.0, -0.5, 0.3])
    position = np.cumsum(np.stack([length * np.sin(theta), -length * np.cos(theta)]), axis=1)

    def motion(t: float, state: np.ndarray) -> np.ndarray:
        r, v = state.reshape(2, 2, n)
        rods, speeds = r - r @ before.T, v - v @ before.T
        applied = np.stack([np.zeros(n), -m * g])
        # the torque on the first rod is a force across it
        applied[:, 0] += torque / length[0] ** 2 * np.array([-rods[1, 0], rods[0, 0]])
        # of each rod, rods . acceleration + speeds . speeds = 0
        jacobian = np.concatenate([rods[k][:, None] * (np.eye(n) - before) for k in range(2)], axis=1)
        mass = np.tile(m, 2)
        force = np.linalg.solve(
            jacobian / mass @ jacobian.T, -(speeds**2).sum(axis=0) - jacobian @ (applied.ravel() / mass)
        )
        acceleration = (applied.ravel() + jacobian.T @ force) / mass
        return np.concatenate([v.ravel(), acceleration])

    start = np.concatenate([position.ravel(), np.zeros(2 * n)])
    r = solve_ivp(motion, (0.0, times[-1]), start, **TIGHT).sol(times)
    x, y = r[:n].T, r[n : 2 * n].T
    rods_x, rods_y = x - x @ before.T, y - y @ before.T
    speed = (r[2 * n : 3 * n].T ** 2 + r[3 * n :].T ** 2) @ m / 2.0
    return {"theta": np.unwrap(np.arctan2(rods_x, -rods_y), axis=0), "energy": speed + g * y @ m}


def heat(times: np.ndarray) -> Values:
    """The matrix exponential of the difference equations, whose state at rest is a line between the ends."""
    n, diffusivity, left, right = 50, 0.02, 340.0, 310.0
    place = np.arange(1, n + 1) / (n + 1)
    rest = left + (right - left) * place
    matrix = diffusivity * (n + 1) ** 2 * (np.eye(n, k=1) + np.eye(n, k=-1) - 2.0 * np.eye(n))
    start = 280.0 + 50.0 * np.sin(np.pi * place)
    step = expm(matrix * (times[1] - times[0]))
    values = [start]
    for _ in times[1:]:
        values.append(rest + step @ (values[-1] - rest))
    return {"T": np.array(values), "T_max": np.max(values, axis=1)}


def ball(times: np.ndarray) -> Values:
    """Free falls between bounces, whose speeds are a geometric series."""
    g, e, height = 9.81, 0.7, 1.5
    speed, begin, bounces = 0.0, 0.0, 0.0
    h, v, n = (np.empty_like(times) for _ in range(3))
    while begin <= times[-1]:
        now = times >= begin
        flown = times[now] - begin
        h[now] = height + speed * flown - 0.5 * g * flown**2
        v[now], n[now] = speed - g * flown, bounces
        flight = (speed + np.sqrt(speed**2 + 2.0 * g * height)) / g
        begin += flight
        speed, height, bounces = e * (g * flight - speed), 0.0, bounces + 1.0
    return {"h": h, "v": v, "bounces": n}


def thermostat(times: np.ndarray) -> Values:
    """Exponentials between switchings, whose instants are logarithms."""
    low, high, tau, rate, ambient = 18.0, 22.0, 80.0, 0.25, 12.0
    begin, T_0, on = 0.0, 20.0, False
    T, heating = np.empty_like(times), np.empty_like(times)
    while begin <= times[-1]:
        now, rest = times >= begin, ambient + (rate * tau if on else 0.0)
        T[now], heating[now] = rest + (T_0 - rest) * np.exp(-(times[now] - begin) / tau), rate if on else 0.0
        switch = high if on else low
        begin += tau * np.log((T_0 - rest) / (switch - rest))
        T_0, on = switch, not on
    return {"T": T, "heating": heating, "on": (heating > 0.0) * 1.0}


def sampled_pi(times: np.ndarray) -> Values:
    """The law at each sample, an exponential up to the next one."""
    T, K, K_i, limit, period, reference = 0.5, 4.0, 3.0, 1.2, 0.1, 1.0
    x, integral, values = 0.2, 0.0, []
    for k in range(round(times[-1] / period) + 1):
        error = reference - x
        wanted = K * error + integral + K_i * period * error
        control = min(max(wanted, -limit), limit)
        integral += K_i * period * error if control == wanted else 0.0
        now = times[(times > k * period - 1e-9) & (times < (k + 1) * period - 1e-9)]
        values += [(control + (x - control) * np.exp(-(t - k * period) / T), integral, control) for t in now]
        x = control + (x - control) * np.exp(-period / T)
    return dict(zip(("x", "integral", "control"), np.transpose(values), strict=True))


#: A signal that changes at the odd communication points, between the samples at the even ones.
STAIRS = np.random.default_rng(3).normal(size=200)


def stairs(t: float) -> float:
    return float(STAIRS[(round(t / 0.02) + 1) // 2])


def delay_line(times: np.ndarray) -> Values:
    samples = [stairs(0.04 * k) for k in range(len(times))]
    before = [0.3] * 19 + samples  # that of k = 0 comes out with the 20th sample
    return {"y": np.array([before[round(t / 0.02) // 2] for t in times])}


def kalman_filter(times: np.ndarray) -> Values:
    """The filter with the information matrix, which adds up what the measurements tell."""
    l, g, period, r, q = 0.8, 9.81, 0.04, 4e-3, np.diag([1e-5, 1e-3])
    x, P, values = np.array([0.3, 0.1]), 0.1 * np.eye(2), []
    for k in range(round(times[-1] / period) + 1):
        rate = x[1] - period * g / l * np.sin(x[0])
        slope = -period * g / l * np.cos(x[0])
        F = np.array([[1.0, period], [0.0, 1.0]]) @ np.array([[1.0, 0.0], [slope, 1.0]])
        x, P = np.array([x[0] + period * rate, rate]), F @ P @ F.T + q
        H = np.array([l * np.cos(x[0]), 0.0])
        P = np.linalg.inv(np.linalg.inv(P) + np.outer(H, H) / r)
        x = x + P @ H / r * (0.5 * stairs(k * period) - l * np.sin(x[0]))
        values += [(*x, P)] * 2
    theta, omega, P = (np.array([v[i] for v in values])[: len(times)] for i in range(3))
    return {"theta": theta, "omega": omega, "P": P}


def robertson(times: np.ndarray) -> Values:
    """By scipy's Radau."""

    def reaction(t: float, x: np.ndarray) -> list[float]:
        slow, fast, fastest = 0.04 * x[0], 1e4 * x[1] * x[2], 3e7 * x[1] ** 2
        return [fast - slow, slow - fast - fastest, fastest]

    x = solve_ivp(reaction, (0.0, times[-1]), [1.0, 0.0, 0.0], "Radau", t_eval=times, rtol=1e-12, atol=1e-16).y
    return dict(zip("ABC", x, strict=True))


def van_der_pol(times: np.ndarray) -> Values:
    """By scipy's Radau."""

    def oscillator(t: float, x: np.ndarray) -> list[float]:
        return [x[1], 1000.0 * (1.0 - x[0] ** 2) * x[1] - x[0]]

    x = solve_ivp(oscillator, (0.0, times[-1]), [2.0, 0.0], "Radau", t_eval=times, rtol=1e-12, atol=1e-15).y
    return {"x": x[0], "v": x[1]}


def torque_map(times: np.ndarray) -> Values:
    """With scipy's interpolation."""
    speeds, throttles, u = np.linspace(0.0, 600.0, 13), [0.0, 0.1, 0.3, 0.6, 1.0], 0.85
    measured = [[min(180.0, 45e3 / (w + 1.0)) * v - 0.02 * w for v in throttles] for w in speeds]
    torque = RegularGridInterpolator((speeds, throttles), measured)
    efficiency = make_interp_spline([0.0, 50.0, 200.0, 400.0, 600.0], [0.6, 0.85, 0.95, 0.93, 0.88], k=1)

    def motion(t: float, w: np.ndarray) -> np.ndarray:
        return (torque((w[0], u)) - 3e-4 * w**2) / 0.4

    w = solve_ivp(motion, (0.0, times[-1]), [10.0], t_eval=times, max_step=0.01, rtol=1e-11, atol=1e-11).y[0]
    drive = torque((w, u))
    return {"speed": w, "drive": drive, "power": drive * w / efficiency(w)}


EXAMPLES = [
    Example(
        "bouncing_ball",
        stop=2.99,
        step=0.013,
        start={"e": 0.7, "h_start": 1.5},
        solution=ball,
        tolerance=1e-8,
        tolerance_me=1e-5,
    ),
    Example(
        "thermostat",
        stop=600.0,
        step=3.0,
        start={"tau": 80.0, "rate": 0.25, "ambient": 12.0},
        solution=thermostat,
        tolerance=1e-9,
        tolerance_me=1e-6,
    ),
    Example(
        "sampled_pi",
        stop=3.0,
        step=0.05,
        start={"T": 0.5, "K": 4.0, "K_i": 3.0, "limit": 1.2, "x_start": 0.2},
        solution=sampled_pi,
        tolerance=1e-11,
        tolerance_me=1e-7,
    ),
    Example(
        "delay_line",
        stop=3.0,
        step=0.02,
        start={"period": 0.04, "u_0": 0.3},
        inputs={"u": stairs},
        solution=delay_line,
        tolerance=0.0,
        tolerance_me=0.0,
    ),
    Example(
        "extended_kalman_filter",
        stop=3.0,
        step=0.02,
        start={"l": 0.8, "period": 0.04, "q": [1e-5, 1e-3], "r": 4e-3, "omega_start": 0.1},
        inputs={"measured": lambda t: 0.5 * stairs(t)},
        solution=kalman_filter,
        tolerance=1e-11,
        tolerance_me=1e-11,
    ),
    Example(
        "n_link_pendulum",
        stop=3.0,
        step=0.02,
        start={
            "m_i": [0.5, 1.0, 0.2],
            "l": [0.3, 0.2, 0.4],
            "theta_start": [1.0, -0.5, 0.3],
            "tau": 0.3,
            "max_step": 2e-4,
        },
        solution=pendulum,
        tolerance=1e-9,
        tolerance_me=1e-6,
    ),
    Example(
        "heat_equation",
        stop=5.0,
        step=0.1,
        start={"T_mean": 280.0, "diffusivity": 0.02, "T_left": 340.0, "T_right": 310.0, "max_step": 2e-4},
        solution=heat,
        tolerance=1e-11,
        tolerance_me=1e-7,
    ),
    Example(
        "torque_map",
        stop=6.0,
        step=0.1,
        start={"inertia": 0.4, "drag": 3e-4, "speed_start": 10.0, "throttle": 0.85, "max_step": 1e-3},
        solution=torque_map,
        tolerance=1e-7,
        tolerance_me=1e-6,
    ),
    Example(
        "robertson",
        stop=40.0,
        step=40.0,
        solution=robertson,
        tolerance=1e-6,
        tolerance_me=1e-6,
        rows_me=40,  # between two of which CVode, as FMPy sets it, takes 500 steps at most
    ),
    Example(
        "van_der_pol",
        stop=2000.0,
        step=1.0,
        solution=van_der_pol,
        tolerance=1e-6,
        tolerance_me=1e-6,
        stop_me=700.0,  # CVode, as FMPy sets it, does not get through the jumps
    ),
]


#: Every other example is built for FMI 2.0, the others for FMI 3.0; slow tests take the other version of each.
BUILT = [
    pytest.param(
        example,
        flavour,
        id=f"{example.module}-{flavour}",
        marks=() if i % 2 == j and example.module != "van_der_pol" else pytest.mark.slow,  # whose many steps take long
    )
    for i, example in enumerate(EXAMPLES)
    for j, flavour in enumerate(FLAVOURS)
]


@pytest.fixture(scope="session")
def fmu_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Path]:
    """The FMU of an example, built when it is first asked for."""
    require_compiler()
    folder = tmp_path_factory.mktemp("examples")

    def built(module: str, flavour: str) -> Path:
        path = folder / flavour / f"{module}.fmu"
        if not path.exists():
            built_once(f"{module}-{flavour}", lambda common: build(module, common, flavour), path.parent)
        return path

    return built


def test_every_example_is_compared_with_something() -> None:
    assert {example.module for example in EXAMPLES} == {path.stem for path in FOLDER.glob("*.py")}


@pytest.mark.parametrize(
    "importer",
    [
        "fmpy",
        "fmpy_me",
        "our_master",
        "our_dopri5_me",
        pytest.param("our_cvode_me", marks=pytest.mark.slow),
        pytest.param("ecos", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize(("example", "flavour"), BUILT)
def test_example_is_right(
    example: Example, flavour: str, importer: str, fmu_of: Callable[[str, str], Path], tmp_path: Path
) -> None:
    if importer == "ecos" and (reason := ecos.unavailable()):
        pytest.skip(reason)
    fmu = fmu_of(example.module, flavour)
    if importer.endswith("_me") and example.stop_me:
        example = replace(example, stop=example.stop_me)
    expected = example.expected
    shapes = {name: values.shape[1:] for name, values in expected.items()}
    if importer == "ecos":
        found, tolerance = by_ecos(fmu, example, shapes, tmp_path), example.tolerance
    elif importer == "our_master":
        found, tolerance = by_our_master(fmu, example, shapes), example.tolerance
    elif importer in ("our_dopri5_me", "our_cvode_me"):
        solver = importer.split("_")[1]
        found = by_our_master(fmu, example, shapes, solver=solver)
        tolerance = example.tolerance_me if solver == "cvode" or example.module == "van_der_pol" else 1e-8
        tolerance = min(tolerance, example.tolerance_me)
    elif importer == "fmpy":
        found, tolerance = by_fmpy(fmu, example, shapes, "CoSimulation"), example.tolerance
    else:
        found, tolerance = by_fmpy(fmu, example, shapes, "ModelExchange"), example.tolerance_me
    assert set(found) == set(expected)
    for name, values in expected.items():
        error = np.abs(found[name] - values).max()
        assert error <= tolerance * np.abs(values).max(), (name, error)


@pytest.mark.parametrize(("example", "flavour"), [case for case in BUILT if case.values[1] == "fmi2"])
def test_example_runs_as_it_stands(
    example: Example, flavour: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It builds an FMU for FMI 2.0."""
    require_compiler()
    monkeypatch.chdir(tmp_path)
    with shared_compilation():
        runpy.run_path(str(FOLDER / f"{example.module}.py"), run_name="__main__")
    assert len(capsys.readouterr().out.splitlines()) >= 1
    assert len(list(tmp_path.glob("*.fmu"))) == 1


class Plant(ModelClass):
    """The plant of the example, alone."""

    T = parameter(0.8, "s")
    control = input_(0.0)
    x = state(0.0)

    def derivatives(m):
        return {"x": (m.control - m.x) / m.T}


class Law(ModelClass):
    """Its controller, alone."""

    K = parameter(2.0)
    K_i = parameter(1.5, "s-1")
    limit = parameter(1.5)
    period = parameter(0.1, "s")
    reference = input_(1.0)
    x = input_(0.0)
    integral = discrete(0.0)
    control = discrete(0.0)

    @every(period)
    def sample(m):
        error = m.reference - m.x
        integral = m.integral + m.K_i * m.period * error
        wanted = m.K * error + integral
        control = np.clip(wanted, -m.limit, m.limit)
        return {"control": control, "integral": np.where(control == wanted, integral, m.integral)}


def test_the_sampled_pi_composed_of_its_parts(tmp_path: Path) -> None:
    """The same numbers, also where two components are one FMU."""
    require_compiler()
    (example,) = (e for e in EXAMPLES if e.module == "sampled_pi")
    connections = [("plant.x", "law.x"), ("law.control", "plant.control")]
    experiment = DefaultExperiment(stop_time=3.0, step_size=0.05)
    whole = compose("Whole", "In parts", {"law": Law, "plant": Plant}, connections, experiment)
    fmu = build_native(whole, tmp_path, "fmi3")
    owners = {name: "plant" if name in ("T", "x_start") else "law" for name in example.start}
    start = {f"{owners[name]}.{name}": value for name, value in example.start.items()}
    shapes = dict.fromkeys(("plant.x", "law.integral", "law.control"), ())
    found = by_our_master(fmu, replace(example, start=start), shapes)
    for name in shapes:
        values = example.expected[name.partition(".")[2]]
        np.testing.assert_allclose(found[name], values, atol=1e-11, err_msg=name)
