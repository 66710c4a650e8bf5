"""Derivatives in both modes and twice of one tendon, against the closed form and differences.

Two tendons that bend the body both ways are held to differences of SciPy's solution in test_turning_over.py.
"""

from dataclasses import replace
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import both_modes, paper_body, paper_plain, twice
from scipy.integrate import quad

import cddf_jax as cddf

ACCURATE = 1e-8  # relative to the largest: what the solver promises for the tip tension

# mu, E (MPa), base tension (N), outer radius at base and tip (mm): of order one to a hundred
PARAMETERS = jnp.array([0.42, 1.4, 60.0, 20.0, 13.0])
each_kinematics = pytest.mark.parametrize("case", ["published", "exact"])
G = 2.942783188998e4  # int d/J ds, docs/theory.md (16)


def body_from(parameters, kinematics):
    mu, modulus, _, base, tip = parameters
    radii = jnp.stack([base, tip]) * 1e-3
    return paper_body(kinematics, friction_coefficient=mu, youngs_modulus=modulus * 1e6, outer_radius=radii)


def tip_of(body, tension):
    """Of order one to a hundred."""
    solution = cddf.solve(body, tension, throw=False)
    return jnp.concatenate([solution.tip_tension, 1e3 * solution.tip_position, solution.tip_angle[None]])


@lru_cache
def derivatives_of(kinematics):
    """One compiled program for all tests of a kinematics."""
    return twice(lambda parameters: tip_of(body_from(parameters, kinematics), parameters[2]))


def closed_form(numbers):
    """T_tip = T / (1 + mu T G / E) of (mu, E in MPa, T)."""
    mu, modulus, tension = numbers
    return tension / (1 + mu * tension * G / (1e6 * modulus))


def at(**changed):
    """The parameters, some of them replaced."""
    names = ("mu", "modulus", "tension", "base", "tip")
    return jnp.array([changed.get(name, number) for name, number in zip(names, PARAMETERS, strict=True)])


@each_kinematics
@pytest.mark.parametrize(("mu", "tension"), [(0.42, 75.0), (0.0, 75.0), (0.42, 0.0)], ids=str)
def test_derivatives_of_the_closed_form(case, mu, tension):
    """Friction and tension of 0 lie inside the range of the model; without tension the body is straight, phi' = G/E."""
    numbers = jnp.array([mu, 1.4, tension])
    first, second = jax.grad(closed_form)(numbers), jax.hessian(closed_form)(numbers)
    _, forward, reverse, bend = derivatives_of(case)(at(mu=mu, tension=tension))
    for mode in (forward, reverse):
        np.testing.assert_allclose(mode[0, :3], first, rtol=ACCURATE, atol=1e-12)
        if tension == 0:
            np.testing.assert_allclose(mode[3, 2], G / 1.4e6, rtol=ACCURATE)
    np.testing.assert_allclose(bend[0, :3, :3], second, rtol=1e-7, atol=1e-12)
    assert np.all(np.isfinite(forward) & np.isfinite(reverse))
    assert np.all(np.isfinite(bend))


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
    """A tendon along straight lines, finite turns included: both modes against central differences of the solver."""

    def tip(heights):
        tendon = cddf.Tendon(cddf.Piecewise.linear(np.array([0.0, 0.05, 0.10, 0.14]), 1e-2 * heights))
        return tip_of(replace(paper_body("exact"), tendons=(tendon,)), 30.0)

    heights, h, derivatives = jnp.array([0.8, 1.2, 1.0, 1.0]), 1e-4, both_modes(tip)
    ends = [[derivatives(heights + sign * h * step)[0] for sign in (+1, -1)] for step in jnp.eye(4)]
    differences = np.stack([(ahead - behind) / (2 * h) for ahead, behind in ends], axis=1)
    _, forward, reverse = derivatives(heights)
    scale = np.max(np.abs(differences), axis=1, keepdims=True)
    np.testing.assert_allclose(forward / scale, differences / scale, atol=1e-6)  # h^2 and rounding over h
    np.testing.assert_allclose(reverse / scale, forward / scale, atol=ACCURATE)


def test_a_modulus_that_grows_with_all_tensions_bends_no_further():
    """Both sides of the equilibrium grow alike: r and shape stay, and the tip tension grows in proportion."""
    pair = paper_body(num_tendons=2)

    def answer(factor):
        body = replace(pair, youngs_modulus=factor * 1.4e6)
        found = cddf.solve(body, factor * jnp.array([58.0, 7.0]), direction=(1.0, -1.0))
        return jnp.append(found.tip_tension, found.tip_angle)

    value, *modes = both_modes(lambda factor: answer(factor[0]))(jnp.ones(1))
    for slopes in modes:
        np.testing.assert_allclose(slopes[:, 0], [*value[:2], 0.0], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("places", [(0.05, 0.09), (0.07, 0.07)])
def test_derivatives_by_each_of_two_anchors(places):
    """Without friction phi = sum sigma d T end / (E J), eq. (13); also where the anchors are at one place."""
    tension, offset = np.array([30.0, 10.0]), 0.010
    plain = replace(paper_body("exact", friction_coefficient=0.0), outer_radius=0.013)

    def angle(ends):
        tendons = cddf.Tendon(offset, end=ends[0]), cddf.Tendon(offset, side=-1, end=ends[1])
        return cddf.solve(replace(plain, tendons=tendons), tension, direction=[1, -1]).tip_angle

    stiffness = 1.4e6 * np.pi / 4 * (0.013**4 - 0.007**4)
    bends = offset * tension * [1.0, -1.0] / stiffness
    value, *derivatives = both_modes(angle)(np.array(places))
    np.testing.assert_allclose(value, bends @ places, rtol=1e-12)
    for found in derivatives:
        np.testing.assert_allclose(found, bends, rtol=1e-9)


@pytest.mark.slow
def test_derivatives_by_each_of_two_loads_at_one_place():
    """They are those of the loads a little apart, as the place of the tip is smooth in both."""

    def tip(places):
        loads = cddf.Loads(points=[cddf.PointLoad(places[0], (0.0, -1.0)), cddf.PointLoad(places[1], (0.0, 0.6))])
        return cddf.solve(paper_body("exact"), 30.0, loads).tip_position[1]

    derivatives = both_modes(tip)
    for found, beside in zip(
        derivatives(np.array([0.07, 0.07])), derivatives(np.array([0.07, 0.0700001])), strict=True
    ):
        np.testing.assert_allclose(found, beside, rtol=1e-5)
