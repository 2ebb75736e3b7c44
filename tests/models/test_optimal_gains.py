"""The performance index, its optimum and the proof that it is the only one."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq, differential_evolution

from controller_fmu.membership import Sine, psi_moments
from controller_fmu.optimal_gains import (
    NoMinimum,
    OptimalGains,
    PerformanceIndex,
    lyapunov_constants,
    optimal_gains,
)
from controller_fmu.uniqueness import convexity_margin
from tests.support.oracles.stationary import stationary_points

TABLE_1 = [  # mu, nu, alpha, beta, J_min as printed
    (1, 1, "1.3597", "1.6620", "9.1329"),
    (5, 1, "1.7839", "1.9337", "18.9766"),
    (10, 1, "2.0655", "2.1671", "29.3006"),
    (1, 10, "0.9419", "1.1195", "34.1584"),
    (1, 5, "1.0503", "1.2535", "22.3282"),
]
POINTS = [(1.3, 1.7), (0.2, 5.0), (30.0, 0.1)]


def random_indices(count, seed=5):
    """Yield valid indices over many decades, with rho_3 and rho_4 of either sign."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        D2 = 10 ** rng.uniform(-2, 1)
        mu, nu, k, s_a, s_b = 10 ** rng.uniform([-3, -3, -0.5, -2, -2], [2, 1, 2, 1, 1])
        D4 = D2**2 * (1 + 10 ** rng.uniform(-3, 1))
        yield PerformanceIndex(mu * (rng.random() < 0.8), nu, k, rng.uniform(0.2, 1), s_a, s_b, D2, D4)


# --- the index ---


@pytest.mark.parametrize(("mu", "nu"), [(1, 1), (5, 1), (10, 1), (0.3, 7)])
def test_coefficients_are_the_paper_s(mu, nu):
    rho = PerformanceIndex(mu, nu).rho
    printed = [
        -0.02298 + 1.24611 * mu,
        6.75,
        2.25 * mu,
        0.80166,
        9 * (0.29735 * mu - 0.043),
        1.37474,
        0.005547,
        nu,
    ]  # (92)
    np.testing.assert_allclose(rho, printed, rtol=2e-4)


def test_index_is_the_mean_of_the_squares_it_was_expanded_from():
    """(78), (79): the integral over time and the means over psi, before any expansion into (80)."""
    index = PerformanceIndex(mu=0.7, nu=0.4, k=9.0, lambda_3=0.8, s_a=0.5, s_b=0.2)
    v = (np.arange(200_000) + 0.5) / 400_000
    weight = np.sin(2 * np.pi * v) / np.sin(2 * np.pi * v).sum()
    for alpha, beta in POINTS:
        steady = index.k / 2 * 2 * v**2 + index.k / (8 * index.lambda_3 * alpha * beta)
        transient = (index.s_a + index.s_b * beta - steady) ** 2 * index.k / (4 * index.lambda_3 * beta)
        expected = weight @ (transient + index.mu * steady**2) + index.nu * (alpha**2 + beta**2)
        assert index(alpha, beta) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("alpha", "beta"), POINTS)
def test_gradient_agrees_with_complex_steps(alpha, beta):
    index, h = PerformanceIndex(mu=2, nu=0.3), 1e-30
    steps = [index(alpha + 1j * h, beta).imag / h, index(alpha, beta + 1j * h).imag / h]
    np.testing.assert_allclose(index.gradient(alpha, beta), steps, rtol=1e-13)


@pytest.mark.parametrize(("alpha", "beta"), POINTS)
def test_hessian_agrees_with_complex_steps_of_the_gradient(alpha, beta):
    index, h = PerformanceIndex(mu=2, nu=0.3), 1e-30
    columns = [index.gradient(alpha + 1j * h, beta).imag / h, index.gradient(alpha, beta + 1j * h).imag / h]
    np.testing.assert_allclose(index.hessian(alpha, beta), np.stack(columns, axis=1), rtol=1e-13)


def test_printed_factored_derivative_by_beta_is_wrong_by_its_rho_3_term():
    """The second line of (83) for dJ/dbeta prints 3 rho_3 alpha beta; the derivative of (80) has 2."""
    index, (a, b) = PerformanceIndex(), (1.3, 1.7)
    r = index.rho

    def factored(multiple):
        bracket = 2 * r[7] * a**2 * b**5 + r[6] * a**2 * b**4 - r[5] * a**2 * b**2 - r[4] * a * b**2
        return (bracket - multiple * r[3] * a * b - 2 * r[2] * b - 3 * r[1]) / (a**2 * b**4)

    slope = (index(a, b + 1e-30j).imag) / 1e-30
    assert factored(2) == pytest.approx(slope, rel=1e-12)
    assert abs(factored(3) - slope) > 0.1


def test_index_and_derivatives_are_vectorised():
    index, alpha, beta = PerformanceIndex(), np.array([[1.0], [2.0]]), np.array([1.0, 2.0, 3.0])
    assert index(alpha, beta).shape == (2, 3)
    assert index.gradient(alpha, beta).shape == (2, 2, 3)
    assert index.hessian(alpha, beta).shape == (2, 2, 2, 3)
    np.testing.assert_array_equal(index.hessian(alpha, beta)[..., 1, 2], index.hessian(2.0, 3.0))


# --- the optimum ---


@pytest.mark.parametrize(("mu", "nu", "alpha", "beta", "J"), TABLE_1)
def test_table_1_to_every_printed_digit(mu, nu, alpha, beta, J):
    gains = optimal_gains(PerformanceIndex(mu, nu))
    # The paper cut the first alpha, 1.35976, and rounded every other number.
    cut = (mu, nu) == (1, 1)
    assert f"{math.floor(gains.alpha * 1e4) / 1e4 if cut else gains.alpha:.4f}" == alpha
    assert f"{gains.beta:.4f}" == beta
    assert f"{gains.J:.4f}" == J


@pytest.mark.parametrize(("mu", "nu"), [row[:2] for row in TABLE_1])
def test_optimum_agrees_with_differential_evolution(mu, nu):
    index = PerformanceIndex(mu, nu)
    found = differential_evolution(lambda x: float(index(*np.exp(x))), [(-5, 5)] * 2, rng=1, tol=1e-12, polish=False)
    gains = optimal_gains(index)
    assert found.fun >= gains.J
    np.testing.assert_allclose([gains.alpha, gains.beta], np.exp(found.x), rtol=1e-5)


def test_optimum_does_not_depend_on_the_start():
    index = PerformanceIndex()
    reference = optimal_gains(index)
    for start in 10.0 ** np.random.default_rng(3).uniform(-5, 5, (30, 2)):
        gains = optimal_gains(index, tuple(start))
        assert gains.alpha == pytest.approx(reference.alpha, rel=1e-13)
        assert gains.beta == pytest.approx(reference.beta, rel=1e-13)
    again = optimal_gains(index, (reference.alpha, reference.beta))
    assert again.alpha == pytest.approx(reference.alpha, rel=1e-14)


def test_gains_grow_with_the_weight_ratio():
    gains = [optimal_gains(PerformanceIndex(mu, 1)) for mu in (0.0, 0.01, 0.1, 1, 10, 100)]
    assert np.all(np.diff([g.alpha for g in gains]) > 0)
    assert np.all(np.diff([g.beta for g in gains]) > 0)


@pytest.mark.parametrize("exponent", [-9, -3, 3, 9])
def test_optimum_is_certified_over_many_decades_of_weights(exponent):
    for weights in ({"mu": 10.0**exponent}, {"nu": 10.0**exponent}):
        gains = optimal_gains(PerformanceIndex(**weights))
        assert gains.is_unique_minimum
        assert gains.J > 0


# --- the only one ---


def test_elimination_finds_the_optimum_and_nothing_else():
    signs = set()
    for index in random_indices(60):
        (only,) = stationary_points(index.rho)
        gains = optimal_gains(index)
        np.testing.assert_allclose(only, [gains.alpha, gains.beta], rtol=1e-7)
        assert gains.is_unique_minimum
        signs.add(tuple(np.sign(index.rho[3:5])))
    assert signs == {(1, 1), (1, -1), (-1, 1), (-1, -1)}


def test_margin_is_the_spread_of_psi():
    """4 rho_1 rho_5 - rho_3^2 = k^6 (D4 - D2^2)/(1024 lambda_3^4)."""
    for index in random_indices(20, seed=6):
        rho = index.rho
        spread = index.k**6 * (index.D4 - index.D2**2) / (1024 * index.lambda_3**4)
        assert convexity_margin(rho) * 4 * rho[1] * rho[5] == pytest.approx(spread, rel=1e-6)


@pytest.mark.parametrize(
    "rho",
    [
        [0.0, 1.0, 0.028, -6.283, 1.253, 4.502, 0.014, 0.002],
        [0.0, 1.0, 0.237, -2.461, -5.905, -0.103, 0.031, 0.202],
    ],
)
def test_margin_catches_coefficients_with_several_stationary_points(rho):
    assert len(stationary_points(np.array(rho))) > 1
    assert not convexity_margin(np.array(rho)) > 0


@pytest.mark.parametrize("place", [1, 2, 5, 7])
def test_margin_refuses_a_sign_that_the_proof_needs(place):
    rho = PerformanceIndex().rho
    assert convexity_margin(rho) > 0
    rho[place] *= -1
    assert convexity_margin(rho) == -np.inf


def test_paper_s_claim_of_a_positive_hessian_fails_where_ours_of_convexity_holds():
    """(85) is false for a small mu; in (1/(alpha beta), beta) the Hessian is positive at the same points."""
    index = PerformanceIndex(mu=0.01, nu=1e-3)
    alpha, beta = np.meshgrid(np.logspace(-2, 2, 41), np.logspace(-2, 2, 41))
    least = np.linalg.eigvalsh(np.moveaxis(index.hessian(alpha, beta), (0, 1), (-2, -1)))[..., 0]
    assert least.min() < 0

    _, r1, r2, r3, _, r5, _, r7 = index.rho
    u, b = 1 / (alpha * beta), beta
    uu = 2 * r1 / b + 2 * r2 + 6 * r7 / (u**4 * b**2)
    ub = -(2 * r1 * u + r3) / b**2 + 4 * r7 / (u**3 * b**3)
    bb = 2 * (r1 * u**2 + r3 * u + r5) / b**3 + r7 * (6 / (u**2 * b**4) + 2)
    assert uu.min() > 0
    assert (uu * bb - ub**2).min() > 0


def test_paper_s_claim_holds_for_its_table():
    alpha, beta = np.meshgrid(np.logspace(-2, 2, 41), np.logspace(-2, 2, 41))
    for mu, nu, *_ in TABLE_1:
        hessian = PerformanceIndex(mu, nu).hessian(alpha, beta)
        assert np.linalg.eigvalsh(np.moveaxis(hessian, (0, 1), (-2, -1)))[..., 0].min() > 0


@pytest.mark.parametrize(
    "spoilt",
    [{"relative_gradient": 1e-6}, {"hessian_eigenvalues": (-1.0, 2.0)}, {"convexity_margin": 0.0}],
    ids=str,
)
def test_each_part_of_the_certificate_counts(spoilt):
    gains = optimal_gains(PerformanceIndex())
    assert gains.is_unique_minimum
    assert not replace(gains, **spoilt).is_unique_minimum


# --- no minimum, no sense ---


def least_mu_without_minimum():
    """Where dJ/du at alpha = infinity changes sign, for nu = 0 and the paper's other values."""

    def slope(mu):
        rho = PerformanceIndex(mu, 0).rho
        return rho[4] + rho[3] * np.sqrt(rho[6] / rho[5])

    return brentq(slope, 1e-3, 1)


def test_free_gains_have_a_minimum_below_a_threshold_of_mu_only():
    threshold = least_mu_without_minimum()
    assert 0.12 < threshold < 0.13
    gains = optimal_gains(PerformanceIndex(mu=0.99 * threshold, nu=0))
    index = PerformanceIndex(mu=0.99 * threshold, nu=0)
    away = np.exp(np.random.default_rng(0).uniform(-8, 12, (2, 10_000)))
    assert index(*away).min() > gains.J
    with pytest.raises(NoMinimum, match="J falls as alpha grows without end; give nu > 0"):
        optimal_gains(PerformanceIndex(mu=1.01 * threshold, nu=0))


def test_index_refused_for_want_of_a_minimum_indeed_falls_without_end():
    index = PerformanceIndex(mu=1.01 * least_mu_without_minimum(), nu=0)
    for beta in np.logspace(-2, 3, 26):
        best = index(np.logspace(-3, 9, 400), beta)
        # Where J has a minimum along alpha, a larger alpha with another beta undercuts it.
        assert best.min() > index(1e9, np.sqrt(index.rho[5] / index.rho[6])) * (1 - 1e-12)


@pytest.mark.parametrize("other", [{"mu": 0}, {"mu": 1, "s_b": 0}, {"mu": 0, "s_b": 0}], ids=str)
def test_free_gains_without_a_minimum_are_refused(other):
    with pytest.raises(NoMinimum, match=r"no optimal gains for mu = \d, nu = 0: with .*; give nu > 0") as refused:
        optimal_gains(PerformanceIndex(nu=0, **other))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("s_b", [0.0, 0.043])
@pytest.mark.parametrize("s_a", [0.0, 0.803])
@pytest.mark.parametrize("mu", [0.0, 1.0])
def test_costly_gains_always_have_a_minimum(mu, s_a, s_b):
    assert optimal_gains(PerformanceIndex(mu=mu, nu=0.1, s_a=s_a, s_b=s_b)).is_unique_minimum


@pytest.mark.parametrize("name", ["mu", "nu", "k", "lambda_3", "s_a", "s_b", "D2", "D4"])
@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_index_refuses_values_without_sense(name, value):
    with pytest.raises(ValueError, match=f"{name} = {value!r} must be a finite number, 0 or greater"):
        PerformanceIndex(**{name: value})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"k": 0.0}, "k = 0 must be greater than 0"),
        ({"lambda_3": 0.0}, r"lambda_3 = 0.0 must be in \(0, 1\]"),
        ({"lambda_3": 1.5}, r"lambda_3 = 1.5 must be in \(0, 1\]: give min\(S_ii, 1\)"),
        ({"D2": 0.5, "D4": 0.25}, r"D4 = 0.25 must be greater than D2\^2 = 0.25"),
    ],
)
def test_index_names_what_is_out_of_range(values, message):
    with pytest.raises(ValueError, match=message):
        PerformanceIndex(**values)


@pytest.mark.parametrize("start", [(0.0, 1.0), (1.0, -1.0), (float("nan"), 1.0), (1.0, float("inf"))])
def test_start_must_be_positive(start):
    with pytest.raises(ValueError, match="must hold two positive numbers"):
        optimal_gains(PerformanceIndex(), start)


@pytest.mark.parametrize("values", [{"mu": 1e30}, {"k": 1e200}, {"nu": 1e-300, "mu": 1e300}], ids=str)
def test_numbers_too_far_apart_are_refused(values):
    with pytest.raises(ValueError, match="too far apart for double precision"):
        optimal_gains(PerformanceIndex(**values))


def test_result_is_plain_floats():
    gains = optimal_gains(PerformanceIndex())
    assert isinstance(gains, OptimalGains)
    for number in (gains.alpha, gains.beta, gains.J, *gains.gradient, *gains.hessian_eigenvalues):
        assert type(number) is float


def test_default_moments_are_those_of_the_paper_s_membership():
    assert psi_moments(Sine()) == (PerformanceIndex().D2, PerformanceIndex().D4)


# --- V0 ---


def test_lyapunov_constants_are_the_parts_of_the_start_value():
    """V0 by (42) with beta S as a full matrix, at two values of beta."""
    rng = np.random.default_rng(8)
    root = rng.normal(size=(3, 3))
    M, theta_e, omega_e, S = root @ root.T, rng.normal(size=3), rng.normal(size=3), np.array([2.0, 3.0, 1.5])
    s_a, s_b = lyapunov_constants(M, theta_e, omega_e, S)
    for beta in (0.0, 1.7):
        s = omega_e + np.diag(S) @ theta_e
        V0 = 0.5 * s.T @ M @ s + theta_e.T @ (beta * np.diag(S)) @ theta_e
        assert s_a + s_b * beta == pytest.approx(V0, rel=1e-13)


@pytest.mark.parametrize(
    ("name", "value"), [("M", np.eye(2)), ("theta_e", [1, 2]), ("omega_e", [0, 0, np.nan]), ("S", 2.0)]
)
def test_lyapunov_constants_name_the_wrong_array(name, value):
    arrays = {"M": np.eye(3), "theta_e": np.ones(3), "omega_e": np.zeros(3), "S": np.ones(3)}
    with pytest.raises(ValueError, match=f"Lyapunov constants: {name} of shape"):
        lyapunov_constants(**arrays | {name: value})
