"""Derivatives in both modes and twice: against the closed form, against unrolled passes."""

from dataclasses import replace
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import both_modes, paper_body, paper_plain, twice
from numpy.polynomial import legendre
from scipy.integrate import quad

import cddf_jax as cddf

ACCURATE = 1e-8  # relative to the largest: what the solver promises for the tip tension

# mu, E (MPa), base tension (N), outer radius at base and tip (mm): of order one to a hundred
PARAMETERS = jnp.array([0.42, 1.4, 60.0, 20.0, 13.0])
CASES = {
    "published": ("published", 1, +1, (0.010, 0.010)),
    "exact": ("exact", 1, +1, (0.010, 0.010)),
    "published, one out": ("published", 2, (+1, -1), (0.012, 0.009)),
    "exact, one out": ("exact", 2, (+1, -1), (0.010, 0.010)),
    "exact, out": ("exact", 1, -1, (0.010, 0.010)),
    "exact slanted, out": ("exact", 1, -1, (0.012, 0.009)),
}


each_kinematics = pytest.mark.parametrize(
    "case", ["published", "exact"]
)  # of one tendon, for which there is a closed form
G = 2.942783188998e4  # int d/J ds, docs/theory.md (16)


def body_from(parameters, kinematics, count, offset):
    mu, modulus, _, base, tip = parameters
    return paper_body(
        kinematics,
        friction_coefficient=mu,
        youngs_modulus=modulus * 1e6,
        outer_radius=jnp.stack([base, tip]) * 1e-3,
        tendon_offset=offset[0] if offset[0] == offset[1] else offset,
        num_tendons=count,
    )


def pulls(parameters, count):
    return parameters[2] * jnp.array([1.0, 0.25])[:count]


def solved(case, method=cddf.FixedPoint()):
    kinematics, count, direction, offset = CASES[case]

    def tip(parameters):
        body = body_from(parameters, kinematics, count, offset)
        return tip_of(body, pulls(parameters, count), direction, method)

    return tip


def tip_of(body, tension, direction, method=cddf.FixedPoint()):
    """Of order one to a hundred."""
    solution = cddf.solve(body, tension, direction=direction, method=method, throw=False)
    return jnp.concatenate([solution.tip_tension, 1e3 * solution.tip_position, solution.tip_angle[None]])


KNOTS = np.array([0.0, 0.05, 0.10, 0.14])


def bent(numbers):
    """One tendon in the exact kinematics: after the parameters come its direction and four heights, cm.

    It follows straight lines through its heights, so that it may be parallel, slanted, or kinked.
    """
    parameters, direction, heights = numbers[:5], jax.lax.stop_gradient(numbers[5]), 1e-2 * numbers[6:]
    tendons = (cddf.Tendon(cddf.Piecewise.linear(KNOTS, heights)),)
    body = replace(body_from(parameters, "exact", 1, (0.01, 0.01)), tendons=tendons)
    return tip_of(body, pulls(parameters, 1), direction)


def between(offset):
    """The heights of a tendon that does not bend."""
    base, tip = 1e2 * np.array(offset)
    return base + (tip - base) * KNOTS / 0.14


def collocation(order):
    """Gauss nodes on [0, 1] and the end, the integrals of the Lagrange polynomials up to them."""
    x, _ = legendre.leggauss(order)
    columns = []
    for j in range(order):
        others = np.delete(x, j)
        basis = np.polynomial.Polynomial.fromroots(others) / np.prod(x[j] - others)
        integral = basis.integ(lbnd=-1)
        columns.append([*integral(x), integral(1.0)])
    return (np.append(x, 1.0) + 1) / 2, np.array(columns).T / 2


def unrolled(case, order=16, passes=40):
    """Plain Picard passes over one Gauss panel, differentiated as they stand; nothing from the library."""
    kinematics, count, direction, (d_base, d_tip) = CASES[case]
    x, Q = collocation(order)
    side, slope = np.array([1.0, -1.0])[:count, None], (d_tip - d_base) / 0.14
    d = (d_base + (d_tip - d_base) * x) * np.ones((count, 1))
    sliding = np.broadcast_to(np.asarray(direction, float), count)[:, None]

    def local(EJ, T, d):
        if kinematics == "published":
            return jnp.sum(side * d * T, 0) / (EJ + jnp.sum(T * d**2, 0))
        kappa = jnp.sum(side * d * T, 0) / EJ
        for _ in range(8 if slope else 0):  # Newton's method on E J kappa = sum sigma d T cos(alpha)
            q = 1 - side * d * kappa
            residual = EJ * kappa - jnp.sum(side * d * T * q / jnp.hypot(q, slope), 0)
            kappa = kappa - residual / (EJ + jnp.sum(d**2 * T * slope**2 / jnp.hypot(q, slope) ** 3, 0))
        return kappa

    def tip(parameters):
        mu, modulus, _, base, end = parameters
        T0 = pulls(parameters, count)[:, None]
        outer = (base + (end - base) * jnp.append(x, 0.0)) * 1e-3  # the last one: the base of the body
        stiffness = modulus * 1e6 * jnp.pi / 4 * (outer**4 - 0.007**4)
        EJ = stiffness[:-1]

        def psi(kappa, heading, d):
            return heading + jnp.arctan2(side * slope, 1 - side * d * kappa)

        def wrap(T):
            kappa = local(EJ, T, d)
            if kinematics == "published":
                return 0.14 * jnp.abs(kappa / (1 - side * d * kappa))[:, :-1] @ Q.T
            return jnp.abs(psi(kappa, 0.14 * Q @ kappa[:-1], d) - at_base)

        at_base = psi(local(stiffness[-1], T0, d_base), 0.0, d_base)

        def one_pass(T, _):
            return T0 * jnp.exp(-sliding * mu * wrap(T)), None

        T, _ = jax.lax.scan(one_pass, T0 * jnp.ones_like(d), None, length=passes)
        kappa = local(EJ, T, d)
        heading = 0.14 * Q @ kappa[:-1]
        position = 140 * Q[-1] @ jnp.stack([jnp.cos(heading), jnp.sin(heading)], -1)[:-1]
        return jnp.concatenate([T[:, -1], position, heading[-1:]])

    return tip


def assert_close(ours, theirs, tolerance):
    theirs = np.asarray(theirs)
    scale = np.max(np.abs(theirs), axis=tuple(range(1, theirs.ndim)), keepdims=True)
    np.testing.assert_allclose(ours / scale, theirs / scale, atol=tolerance, rtol=0)


@lru_cache
def derivatives_of(case):
    """One compiled program for all tests of a case."""
    return twice(solved(case))


bent_derivatives = both_modes(bent)


@pytest.mark.parametrize(
    "case",
    [
        "exact",
        *(pytest.param(c, marks=pytest.mark.slow) for c in ("published", "published, one out", "exact, one out")),
    ],
)
def test_implicit_derivatives_are_those_of_unrolled_passes(case):
    value, forward, reverse, second = derivatives_of(case)(PARAMETERS)
    expected, slope, _, bend = twice(unrolled(case))(PARAMETERS)
    np.testing.assert_allclose(value, expected, rtol=ACCURATE)
    assert_close(forward, slope, ACCURATE)
    assert_close(reverse, slope, ACCURATE)
    assert_close(second, bend, 1e-7)  # a second derivative loses a digit to the first
    np.testing.assert_allclose(second, np.swapaxes(second, 1, 2), rtol=1e-7, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["exact, out", "exact slanted, out"])
def test_implicit_derivatives_of_a_slanted_tendon_are_those_of_unrolled_passes(case):
    """Two slanted tendons are held to differences of SciPy's solution, see test_sign_changes.py."""
    _, _, direction, offset = CASES[case]
    parameters = at(tension=30.0)
    value, forward, reverse = bent_derivatives(jnp.concatenate([parameters, jnp.array([direction]), between(offset)]))
    slope = jax.jit(jax.jacfwd(unrolled(case)))(parameters)
    np.testing.assert_allclose(value, unrolled(case)(parameters), rtol=ACCURATE)
    assert_close(forward[:, :5], slope, ACCURATE)
    assert_close(reverse[:, :5], slope, ACCURATE)


def closed_form_derivatives(mu, E, T, G):
    """Of T_tip = T / (1 + mu T G / E) by (mu, E in Pa, T), first and second, by hand."""
    c, k = 1 + mu * T * G / E, T * G / E
    first = np.array([-T * k / c**2, T * mu * k / (E * c**2), 1 / c**2])
    mu_mu = 2 * T * k**2 / c**3
    mu_E = T * k / (E * c**2) - 2 * mu * T * k**2 / (E * c**3)
    mu_T = -2 * k / c**3
    E_E = -2 * T * mu * k / (E**2 * c**2) + 2 * T * (mu * k) ** 2 / (E**2 * c**3)
    E_T = 2 * mu * k / (E * c**3)
    T_T = -2 * mu * G / (E * c**3)
    return first, np.array([[mu_mu, mu_E, mu_T], [mu_E, E_E, E_T], [mu_T, E_T, T_T]])


def at(**changed):
    """The parameters, some of them replaced."""
    names = ("mu", "modulus", "tension", "base", "tip")
    return jnp.array([changed.get(name, number) for name, number in zip(names, PARAMETERS, strict=True)])


@each_kinematics
def test_derivatives_of_the_closed_form(case):
    first, second = closed_form_derivatives(0.42, 1.4e6, 75.0, G)
    unit = np.array([1.0, 1e6, 1.0])
    _, forward, reverse, bend = derivatives_of(case)(at(tension=75.0))
    np.testing.assert_allclose(forward[0, :3], unit * first, rtol=ACCURATE)
    np.testing.assert_allclose(reverse[0, :3], unit * first, rtol=ACCURATE)
    np.testing.assert_allclose(bend[0, :3, :3], np.outer(unit, unit) * second, rtol=1e-7)


def test_derivatives_by_the_geometry():
    """dT_tip/dR = -T_tip^2 (mu/E) dG/dR with dG/dR = -int d pi R^3 (dR(s)/dR) / J^2, by SciPy."""
    plain = paper_plain()

    def compliance_slope(weight):
        def integrand(s):
            return -0.010 * np.pi * plain.outer_radius(s) ** 3 * weight(s / 0.14) / plain.second_moment(s) ** 2

        return quad(integrand, 0, 0.14, epsrel=1e-12)[0]

    slopes = np.array([compliance_slope(lambda x: 1 - x), compliance_slope(lambda x: x)])
    tip = plain.closed_form(75.0, 0.14)
    expected = -(tip**2) * 0.42 / 1.4e6 * slopes

    def closed_tip(radii):
        return cddf.closed_form_tension(paper_body("published", outer_radius=radii), 75.0, 0.14)

    for case in ("published", "exact"):
        _, by_number, by_number_reverse, _ = derivatives_of(case)(at(tension=75.0))
        np.testing.assert_allclose(by_number[0, 3:], 1e-3 * expected, rtol=ACCURATE)  # of radii in mm
        np.testing.assert_allclose(by_number_reverse[0, 3:], 1e-3 * expected, rtol=ACCURATE)
    radii = jnp.array([0.020, 0.013])
    _, forward, reverse = both_modes(closed_tip)(radii)
    np.testing.assert_allclose(forward, expected, rtol=1e-11)
    np.testing.assert_allclose(reverse, expected, rtol=1e-11)


@pytest.mark.slow
def test_derivatives_by_a_kinked_offset_against_differences():
    """Finite turns included: both modes against central differences of the solver itself."""
    heights, h = jnp.array([0.8, 1.2, 1.0, 1.0]), 1e-4
    steps = jnp.eye(10)[6:]

    def tip(change):
        return bent_derivatives(jnp.concatenate([at(tension=30.0), jnp.ones(1), heights]) + change)

    ends = [[tip(sign * h * step)[0] for sign in (+1, -1)] for step in steps]
    differences = np.stack([(ahead - behind) / (2 * h) for ahead, behind in ends], axis=1)
    _, forward, reverse = tip(0.0)
    assert_close(forward[:, 6:], differences, 1e-6)  # h^2 and rounding over h
    assert_close(reverse, forward, ACCURATE)


@each_kinematics
def test_derivatives_without_friction_are_finite(case):
    """Mu = 0 lies inside the range of the model: dT_tip/dmu = -T^2 G / E by the closed form."""
    _, forward, reverse, _ = derivatives_of(case)(at(mu=0.0, tension=75.0))
    np.testing.assert_allclose(forward[0, 0], -(75.0**2) * G / 1.4e6, rtol=ACCURATE)
    np.testing.assert_allclose(reverse[0, 0], -(75.0**2) * G / 1.4e6, rtol=ACCURATE)


@each_kinematics
def test_derivatives_without_tension_are_finite(case):
    """The straight body: dT_tip/dT_base = 1 and d(tip angle)/dT_base = G / E by the closed form at T = 0."""
    _, forward, reverse, second = derivatives_of(case)(at(tension=0.0))
    np.testing.assert_allclose(forward[[0, 3], 2], [1.0, G / 1.4e6], rtol=ACCURATE)
    np.testing.assert_allclose(reverse[[0, 3], 2], forward[[0, 3], 2], rtol=ACCURATE)
    assert np.all(np.isfinite(forward) & np.isfinite(reverse))
    assert np.all(np.isfinite(second))
