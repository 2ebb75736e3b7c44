"""Errata: each is shown by its numbers, held against a second formulation where there is one."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize

from controller_fmu.optimal_gains import PerformanceIndex
from parallel_robot.paper.reproduce import gains, proof, tracking
from parallel_robot.paper.reproduce.content import Erratum
from parallel_robot.paper.reproduce.errata import ERRATA, find_errata
from parallel_robot.paper.reproduce.material import Material
from parallel_robot.paper.reproduce.theorem import check, constants, motion
from tests.support import some


@pytest.fixture(scope="module")
def errata(material: Material) -> dict[str, Erratum]:
    return {erratum.id: erratum for erratum in find_errata(material)}


@pytest.mark.parametrize("position", range(len(ERRATA)))
def test_the_computation_shows_the_erratum(material: Material, position: int) -> None:
    erratum = ERRATA[position](material)
    print(erratum.id, dict(erratum.numbers))
    assert erratum.shown
    assert all(np.isfinite(number) for number in erratum.numbers.values())
    assert all((erratum.where, erratum.printed, erratum.correct, erratum.evidence, erratum.numbers))


def test_ids_are_unique(errata: dict[str, Erratum]) -> None:
    assert len(errata) == len(ERRATA)


# --- second formulations ---


def test_the_last_step_of_59_is_wrong_and_ours_is_right() -> None:
    """Over random psi and psi_bar, with every k that the proof allows: -k |psi|^2 - k psi^T psi_bar and its bounds."""
    rng = np.random.default_rng(1)
    printed_fails = 0
    for _ in range(5000):
        psi, psi_bar = rng.normal(size=(2, 2))
        rate = rng.uniform(0.5, 3.0)
        k = rate * rng.uniform(2.0, 8.0)
        exact = -k * psi @ psi - k * psi @ psi_bar
        printed_fails += exact > -rate * psi @ psi + rate * psi_bar @ psi_bar + 1e-12
        assert exact <= -rate * psi @ psi + k / 2 * psi_bar @ psi_bar + 1e-12
    assert 100 < printed_fails < 4900


def test_the_counterexample_to_59_is_a_state_of_the_closed_loop(errata: dict[str, Erratum]) -> None:
    """By the paper's (37) and (42) at theta_e = theta_e' = 0, along the motion: V' = k |psi_bar|^2 / 4."""
    k, p, h = 12.0, 0.25, 1e-5
    # both components alike; with s = 0, (37) reads psi_tilde' = -psi_tilde
    V_before, V_after = (k / 2 * 2 * (p / 2 * np.exp(-t) - p) ** 2 for t in (-h, h))
    assert (V_after - V_before) / (2 * h) == pytest.approx(errata["lyapunov-rate"].numbers["V' (J/s)"], rel=1e-8)
    assert k * 2 * p**2 / 4 == pytest.approx(errata["lyapunov-rate"].numbers["V' (J/s)"])


def test_the_corrected_bound_holds_where_the_printed_one_fails(errata: dict[str, Erratum]) -> None:
    numbers = errata["lyapunov-rate"].numbers
    assert numbers["bound as printed (J/s)"] < numbers["V' (J/s)"] < numbers["bound corrected (J/s)"]


def test_lower_bound_is_undercut_by_a_state(material: Material) -> None:
    """A theta_e, theta_e' for which V_theta_e of (42) is below lambda_M_min |X|^2, with M = lambda_M_min E."""
    lambda_M, beta, S = 0.0605, material.runs.controller("1").beta, 2.0
    found = minimize(
        lambda x: (lambda_M / 2 * (x[1] + S * x[0]) ** 2 + beta * S * x[0] ** 2) / (x @ x), np.array([0.1, 1.0])
    )
    assert found.fun < lambda_M * 0.6
    expected = proof.lower_bound(material).numbers["lambda_min(Lambda_i)"] / 2
    assert found.fun == pytest.approx(expected, rel=1e-2)


def test_derivative_by_beta_in_symbols() -> None:
    """(80) differentiated by CasADi: the factor before rho_3 alpha beta in (83) is 2."""
    a, b, rho = ca.SX.sym("a"), ca.SX.sym("b"), ca.SX.sym("rho", 8)
    J = rho[0] + rho[1] / (a**2 * b**3) + rho[2] / (a**2 * b**2) + rho[3] / (a * b**2) + rho[4] / (a * b)
    J += rho[5] / b + rho[6] * b + rho[7] * (a**2 + b**2)
    factor = ca.jacobian(ca.jacobian(J, b), rho)[3] * a**2 * b**4 / (a * b)
    assert [float(ca.evalf(ca.substitute(factor, ca.vertcat(a, b), ca.DM(x)))) for x in ((1, 2), (3, 0.5))] == [-2, -2]


def test_hessian_is_indefinite_where_the_erratum_says(errata: dict[str, Erratum]) -> None:
    """By finite differences of J in extended precision."""
    numbers = errata["positive-hessian"].numbers
    a, b = numbers["at alpha"], numbers["at beta"]
    index = PerformanceIndex(0.001, 0.001)
    h = 1e-3
    aa = (index(a + h, b) - 2 * index(a, b) + index(a - h, b)) / h**2
    bb = (index(a, b + h) - 2 * index(a, b) + index(a, b - h)) / h**2
    ab = (index(a + h, b + h) - index(a + h, b - h) - index(a - h, b + h) + index(a - h, b - h)) / (4 * h**2)
    assert aa * bb - ab**2 == pytest.approx(numbers["C"], rel=1e-2)
    assert numbers["C"] < 0.0


def test_corrected_index_is_the_mean_of_squares(errata: dict[str, Erratum]) -> None:
    """(78) by sums over psi_bar, with the corrected h: the same minimum."""
    v = (np.arange(20_000) + 0.5) / 40_000
    weight = np.sin(2 * np.pi * v) / np.sin(2 * np.pi * v).sum()
    index = PerformanceIndex(1.0, 1.0)

    def J(gains: np.ndarray) -> float:
        alpha, beta = gains
        steady = index.k / (2 * beta) * (index.k**2 / (4 * (index.k - beta)) * 2 * v**2 + 1 / (4 * alpha))
        transient = (index.s_a + index.s_b * beta - steady) ** 2 * index.k / (4 * beta)
        return float(weight @ (transient + steady**2) + alpha**2 + beta**2)

    numbers = errata["corrected-index"].numbers
    assert (round(numbers["alpha"], 3), round(numbers["beta (N m s/rad)"], 3)) == (1.178, 2.598)
    assert numbers["2 beta max(S_ii)"] < 12.0
    best = np.array([numbers["alpha"], numbers["beta (N m s/rad)"]])
    assert J(best) == pytest.approx(numbers["J"], rel=1e-6)
    for step in ((1e-2, 0), (-1e-2, 0), (0, 1e-2), (0, -1e-2)):
        assert J(best + step) > J(best)


def test_start_constants_are_a_tenth_in_s_b_and_far_less_in_s_a(errata: dict[str, Erratum]) -> None:
    numbers = errata["start-constants"].numbers
    assert numbers["s_b printed"] / numbers["s_b"] == pytest.approx(10.0, rel=0.01)
    assert numbers["s_a printed"] / numbers["s_a, tracking part"] > 50


# --- the checks can fail ---


def test_an_erratum_is_not_shown_by_runs_without_it(material: Material) -> None:
    """A mass change within (88), and errors as small as the printed ones: the computations say so."""
    runs = material.runs
    r = runs.closed_loop["1", "disturbed"]
    column = r.names.index("plant.dm")
    values = r.values.copy()
    values[:, column] = np.abs(values[:, column])
    closed = {**runs.closed_loop, ("1", "disturbed"): dataclasses.replace(r, values=values)}
    assert not tracking.mass_support(Material(dataclasses.replace(runs, closed_loop=closed))).shown

    best = runs.closed_loop["10", "disturbed"]
    values = best.values.copy()
    for actual, desired in (("plant.x_E", "trajectory.x_ref"), ("plant.y_E", "trajectory.y_ref")):
        values[:, best.names.index(actual)] = values[:, best.names.index(desired)]
    closed = {**runs.closed_loop, ("10", "disturbed"): dataclasses.replace(best, values=values)}
    assert not tracking.steady_errors(Material(dataclasses.replace(runs, closed_loop=closed))).shown


def test_factored_derivative_is_right_with_2(material: Material) -> None:
    numbers = gains.factored_derivative(material).numbers
    assert numbers["with 2"] == pytest.approx(numbers["central difference"], abs=1e-6)


# --- Theorem 1 along the runs ---


def test_V_falls_as_printed_by_its_integral(material: Material) -> None:
    """Without differentiating: V gains no more over each tenth of a second than -lambda |Z|^2 + h sums up to."""
    for found in some(material.theorem1):
        m, psi_bar = material.motions[found.controller], np.array(found.psi_bar)
        V, Z = m.V(psi_bar), m.Z(psi_bar)
        allowed = np.concatenate([[0], np.cumsum((found.h_printed - found.lambda_hat * Z[:-1] ** 2) * np.diff(m.time))])
        span = round(0.1 / (m.time[1] - m.time[0]))
        assert (V[span:] - V[:-span] <= allowed[span:] - allowed[:-span]).all()
        assert found.excess_printed < 0.0
        assert found.share_violated == 0.0


def test_V_stays_below_its_envelope(material: Material) -> None:
    """(74) solves phi' = -2 lambda_3 beta/k phi + h with phi(0) = V(0), and V starts on it."""
    for found in some(material.theorem1):
        assert 1.0 - 1e-9 <= found.envelope_printed <= 1.0 + 1e-9
        assert found.envelope_corrected <= 1.0 + 1e-9
        assert found.below_from <= found.T_chi == 0.0
    c = constants(1.36, 1.66, np.array([0.25, 0.25]))
    t, h = 0.7, 1e-5
    slope = (c.envelope(np.array([t + h]), 3.0) - c.envelope(np.array([t - h]), 3.0))[0] / (2 * h)
    assert slope == pytest.approx(-2 * 1.66 / 12 * c.envelope(np.array([t]), 3.0)[0] + c.h, rel=1e-6)
    assert c.envelope(np.array([0.0]), 3.0)[0] == pytest.approx(3.0)


def test_time_to_a_radius_bounds_the_slowest_decay() -> None:
    """|Z|^2 = V/lambda_1, the most by (45), of a V on its envelope from lambda_2 |Z(0)|^2 is below it after T."""
    c = constants(1.36, 1.66, np.array([0.25, 0.25]), lambda_M_min=0.06)
    start, radius = 40.0, 2.0 * c.Gamma * c.stretch
    T = c.time_to(radius, start)
    assert T > 0.0
    assert np.sqrt(c.envelope(np.array([T]), c.lambda_2 * start**2)[0] / c.lambda_1) <= radius * (1 + 1e-9)
    assert c.time_to(radius, 0.1) == 0.0


def test_radii_hold_and_are_far_off(material: Material) -> None:
    for found in some(material.theorem1):
        assert found.Z_max <= found.d_chi
        assert 20 < found.chi_min / found.Z_steady < 60


def test_uncertainty_is_what_V_needs(material: Material) -> None:
    """(52): V_theta_e' = s^T (tau_a + g) + 2 beta theta_e^T S theta_e', with V differentiated as a whole."""
    c = material.runs.controller("1")
    m = material.motions["1"]
    tau = material.runs.closed_loop["1", "disturbed"].thinned(2)["controller.tau_a"]
    rate = np.gradient(m.tracking_part, m.time, edge_order=2)
    right = (m.s * (tau + m.g)).sum(axis=1) + 2 * c.beta * (m.error * m.S * m.rate).sum(axis=1)
    late = m.time > 0.1
    assert np.abs(rate - right)[late].max() < 5e-3 * np.abs(right)[late].max()


def test_violated_inequality_would_be_found(material: Material) -> None:
    """With a psi_bar that is no bound of the uncertainty, and a motion whose V rises without cause."""
    c = material.runs.controller("1")
    m = motion(material.runs.closed_loop["1", "disturbed"], c)
    wild = dataclasses.replace(m, error=m.error * (1 + 50 * (m.time[:, None] > 7)))
    assert check(wild, c, material.runs.steady_after).share_violated > 0.0


def test_constants_are_those_of_the_paper() -> None:
    c = constants(1.36, 1.66, np.array([0.25, 0.25]), k=12.0, lambda_3=1.0, lambda_M_min=0.06)
    assert c.h == pytest.approx(1.66 * 0.125 + 1 / (4 * 1.36))
    # the least h for which (59) holds: the largest -k |psi|^2 - k psi^T psi_bar + beta lambda_3 |psi|^2
    bar = np.array([0.25, 0.25])
    worst = minimize(lambda psi: 12.0 * psi @ psi + 12.0 * psi @ bar - 1.66 * psi @ psi, np.zeros(2))
    assert c.h_corrected == pytest.approx(-worst.fun + 1 / (4 * 1.36))
    assert pytest.approx(np.sqrt(0.125 + 1 / (4 * 1.36 * 1.66))) == c.Gamma
    assert c.stretch == pytest.approx(10.0)
