"""Membership functions and the D-operation, against closed forms, Monte Carlo and properties."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import erf

from controller_fmu.membership import (
    Gaussian,
    MembershipError,
    PointTable,
    Sine,
    Trapezoid,
    Triangle,
    d_operation,
    membership_from_text,
    psi_moments,
)
from tests.support import some

ALL = [
    Sine(),
    Sine(-1.0, 3.0),
    Triangle(0.0, 0.25, 0.5),
    Triangle(0.0, 0.0, 0.5),
    Triangle(0.0, 0.5, 0.5),
    Trapezoid(0.1, 0.1, 0.4, 0.4),
    Trapezoid(-1.0, 0.0, 2.0, 2.5),
    Gaussian.within(0.25, 0.05),
    Gaussian(0.2, 0.1, 0.0, 0.5),
    PointTable((0.0, 0.1, 0.3, 0.5), (0.2, 1.0, 0.0, 0.6)),
]


def polynomial_mean(power, points, weights):
    """D[v^power] of a piecewise linear membership, from antiderivatives of polynomials."""
    numerator = denominator = 0.0
    for v0, v1, w0, w1 in zip(points, points[1:], weights, weights[1:], strict=False):
        if v0 == v1:
            continue
        line = np.polynomial.Polynomial.fit([v0, v1], [w0, w1], 1).convert()
        monomial = np.polynomial.Polynomial([0.0] * power + [1.0])
        for integrand, which in ((line * monomial, 0), (line, 1)):
            antiderivative = integrand.integ()
            value = antiderivative(v1) - antiderivative(v0)
            numerator, denominator = numerator + (1 - which) * value, denominator + which * value
    return numerator / denominator


@pytest.mark.parametrize("membership", ALL, ids=repr)
def test_membership_lies_in_unit_interval_and_vanishes_outside_its_support(membership):
    lower, upper = membership.support
    inside = membership(np.linspace(lower, upper, 1001))
    assert np.all((inside >= 0) & (inside <= 1))
    assert inside.max() > 0.9
    assert np.all(membership([lower - 1e-9, upper + 1e-9, -1e6, 1e6]) == 0)


@pytest.mark.parametrize("membership", ALL, ids=repr)
def test_membership_is_smooth_between_its_breakpoints(membership):
    for lower, upper in some(zip(membership.breakpoints, membership.breakpoints[1:], strict=False)):
        if lower < upper:
            v = np.linspace(lower, upper, 2003)[1:-1]
            kink = np.abs(np.diff(membership(v), 2)).max()
            assert kink < 2e-4


@pytest.mark.parametrize(
    ("membership", "at", "expected"),
    [
        (Triangle(0, 1, 3), [0, 0.25, 1, 2, 3], [0, 0.25, 1, 0.5, 0]),
        (Trapezoid(0, 1, 3, 5), [0, 0.5, 1, 2, 3, 4, 5], [0, 0.5, 1, 1, 1, 0.5, 0]),
        (PointTable((0, 1, 2), (0.25, 1, 0.5)), [0, 0.5, 1, 1.5, 2], [0.25, 0.625, 1, 0.75, 0.5]),
        (Sine(1, 3), [1, 1.5, 2, 2.5, 3], [0, np.sqrt(0.5), 1, np.sqrt(0.5), 0]),
        (Gaussian(1, 2, -3, 5), [-3, -1, 1, 3, 5], [np.exp(-2), np.exp(-0.5), 1, np.exp(-0.5), np.exp(-2)]),
    ],
    ids=repr,
)
def test_weights_at_points(membership, at, expected):
    np.testing.assert_allclose(membership(at), expected, atol=1e-15)


def test_membership_keeps_the_shape_of_its_argument():
    assert Sine()(0.25).shape == ()
    assert Triangle(0, 1, 2)(np.zeros((2, 3))).shape == (2, 3)


def test_default_sine_is_the_paper_s_membership():
    v = np.linspace(0, 0.5, 101)
    np.testing.assert_allclose(Sine()(v), np.sin(2 * np.pi * v), atol=1e-15)


def test_vertical_edges_keep_the_full_height():
    assert Triangle(0.0, 0.0, 0.5)(0.0) == 1
    np.testing.assert_allclose(Trapezoid(0.1, 0.1, 0.4, 0.4)([0.1, 0.2, 0.3]), 1)


def test_d_operation_of_the_sine_has_its_closed_form():
    # Integrals of v^2 sin(2 pi v) and v^4 sin(2 pi v) on [0, 1/2], by parts, over 1/pi.
    assert d_operation(lambda v: v**2, Sine()) == pytest.approx(1 / 8 - 1 / (2 * np.pi**2), rel=1e-13)
    fourth = np.pi * (np.pi**4 - 12 * np.pi**2 + 48) / (2 * np.pi) ** 5
    assert d_operation(lambda v: v**4, Sine()) == pytest.approx(fourth, rel=1e-13)


@pytest.mark.parametrize("power", [0, 1, 2, 4])
@pytest.mark.parametrize("membership", [m for m in ALL if hasattr(m, "values")], ids=repr)
def test_d_operation_of_piecewise_linear_memberships_has_its_closed_form(membership, power):
    expected = polynomial_mean(power, membership.breakpoints, membership.values)
    assert d_operation(lambda v: v**power, membership) == pytest.approx(expected, rel=1e-12, abs=1e-15)


def test_d_operation_of_the_gaussian_is_the_truncated_normal_mean():
    mean, sigma, n = 0.25, 0.05, 1.5
    inside = erf(n / np.sqrt(2))
    variance = sigma**2 * (1 - 2 * n * np.exp(-(n**2) / 2) / np.sqrt(2 * np.pi) / inside)
    second = d_operation(lambda v: v**2, Gaussian.within(mean, sigma, n))
    assert second == pytest.approx(mean**2 + variance, rel=1e-12)


def test_edge_too_steep_for_double_precision_counts_as_vertical():
    steep, vertical = Triangle(0.0, 2e-309, 1.0), Triangle(0.0, 0.0, 1.0)
    assert d_operation(lambda v: v, steep) == pytest.approx(d_operation(lambda v: v, vertical), rel=1e-12)


def test_the_weight_within_an_edge_too_steep_is_at_most_one():
    assert Triangle(0.0, 1e-309, 1.0)(5e-310) == 1.0


def test_narrow_bell_on_a_wide_support_is_not_missed():
    assert d_operation(lambda v: v, Gaussian(0.7, 1e-6, -1000.0, 1000.0)) == pytest.approx(0.7, rel=1e-12)


def test_d_operation_of_a_function_that_averages_to_zero():
    assert d_operation(lambda v: v - 0.25, Sine()) == pytest.approx(0, abs=1e-16)


@given(
    st.floats(-10, 10),
    st.floats(0.01, 10),
    st.floats(0, 1),
    st.floats(0.1, 5),
    st.floats(-3, 3),
    st.floats(-3, 3),
)
def test_d_operation_is_linear_and_follows_shift_and_scale(lower, width, at, scale, a, b):
    unit, moved = Triangle(0, at, 1), Triangle(lower, lower + at * width, lower + width)
    assert d_operation(lambda v: (v - lower) / width, moved) == pytest.approx(d_operation(lambda v: v, unit), rel=1e-9)
    combined = d_operation(lambda v: a * v + b * scale * v**2, unit)
    parts = a * d_operation(lambda v: v, unit) + b * scale * d_operation(lambda v: v**2, unit)
    assert combined == pytest.approx(parts, rel=1e-11, abs=1e-12)


def test_shared_moments_give_the_paper_s_constants():
    D2, D4 = psi_moments(Sine())
    # (92): rho_0 = 1.24611 mu + ..., rho_4 = 9 (0.29735 mu - ...), five significant digits.
    assert abs(144 * D4 / 4 - 1.24611) < 5e-6
    assert abs(2 * D2 - 0.29735) < 1e-5


@pytest.mark.parametrize("components", [1, 2, 3])
def test_independent_moments_agree_with_monte_carlo(components):
    rng = np.random.default_rng(2021)
    n = 400_000
    # Inverse of the distribution (1 - cos(2 pi v))/2 whose density is the paper's membership.
    v = np.arccos(1 - 2 * rng.random((n, components))) / (2 * np.pi)
    squares = (v**2).sum(axis=1)
    moments = psi_moments(Sine(), shared=False, components=components)
    for sample, moment in zip((squares, squares**2), moments, strict=True):
        assert abs(sample.mean() - moment) < 4 * sample.std() / np.sqrt(n)


def test_shared_and_independent_moments_differ_only_in_the_fourth():
    shared, independent = psi_moments(Sine()), psi_moments(Sine(), shared=False)
    assert shared[0] == independent[0]
    assert shared[1] > 1.2 * independent[1]
    assert psi_moments(Sine(), components=1) == psi_moments(Sine(), shared=False, components=1)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("sine", Sine()),
        (" Sine:0,1 ", Sine(0, 1)),
        ("triangle:0,0.25,0.5", Triangle(0, 0.25, 0.5)),
        ("trapezoid:0, 0.1, 0.4, 0.5", Trapezoid(0, 0.1, 0.4, 0.5)),
        ("gaussian:0.25,0.05", Gaussian.within(0.25, 0.05, 4)),
        ("gaussian:0.25,0.05,0,0.5", Gaussian(0.25, 0.05, 0, 0.5)),
        ("points:0=0,0.25=1,0.5=0", PointTable((0, 0.25, 0.5), (0, 1, 0))),
    ],
)
def test_membership_is_read_from_text(text, expected):
    assert membership_from_text(text) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "cosine",
            "unknown membership 'cosine' in 'cosine'; known: sine, triangle, trapezoid, gaussian, points",
        ),
        ("", "unknown membership ''"),
        ("triangle:0,1", "triangle takes 3 numbers, not 2"),
        ("sine:1", "sine takes 0 or 2 numbers, not 1"),
        ("triangle:0,x,1", "'x' is not a number"),
        ("triangle:0,,1", "'' is not a number"),
        ("points:0=0,1", "write every point as v=w"),
        ("points:0=0,y=1", "'y' is not a number"),
        ("points", "0 points and 0 weights"),
        ("triangle:0,2,1", r"peak = 2.0 is above upper = 1.0; give lower <= peak <= upper"),
        ("sine:0,inf", "upper = inf must be a finite number"),
        ("trapezoid:nan,0,1,2", "lower = nan must be a finite number"),
        ("gaussian:0,0", "sigma = 0.0 must be greater than 0"),
        ("gaussian:0,nan", "sigma = nan must be a finite number"),
        ("points:0=0,1=1.5", r"weight 1.5 at v = 1.0 must be in \[0, 1\]"),
        ("points:0=0,1=-0.5", r"weight -0.5 at v = 1.0 must be in \[0, 1\]"),
        ("points:0=0,1=nan", r"weight nan at v = 1.0"),
        ("points:0=0,1=1,1=0", "v = 1.0 after 1.0; points must increase"),
        ("points:0=0,inf=1", "point 2 = inf must be a finite number"),
    ],
)
def test_unusable_text_is_refused_in_one_line(text, message):
    with pytest.raises(MembershipError, match=message) as refused:
        membership_from_text(text)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "membership",
    [
        Sine(0.2, 0.2),
        Triangle(1, 1, 1),
        Trapezoid(1, 1, 1, 1),
        PointTable((0, 1), (0, 0)),
        Gaussian(0, 1, 2, 2),
    ],
    ids=repr,
)
def test_membership_without_area_is_refused(membership):
    with pytest.raises(MembershipError, match="has no area"):
        d_operation(lambda v: v, membership)


@pytest.mark.parametrize(
    "f",
    [lambda v: 1 / v**2, lambda v: v * np.nan, lambda v: (1e200 + v) ** 2],
    ids=["pole", "nan", "overflow"],
)
def test_function_without_a_mean_is_refused(f):
    with pytest.raises(MembershipError, match="did not converge"):
        d_operation(f, Sine())


def test_psi_without_components_is_refused():
    with pytest.raises(MembershipError, match="psi has 0 components"):
        psi_moments(Sine(), components=0)
