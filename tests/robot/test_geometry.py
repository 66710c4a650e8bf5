"""The body and its tendons: section properties, the paper's shape, what is refused."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import PAPER, paper_body, paper_with
from scipy.integrate import dblquad

import cddf_jax as cddf
from cddf_jax.robot.reshape import stretched

ROUNDING = 1e-13
S = np.linspace(0, 0.14, 8)


def over_the_annulus(integrand, outer, inner):
    """An integral over the section in polar coordinates, by adaptive quadrature."""
    return dblquad(lambda r, a: integrand(r, a) * r, 0, 2 * np.pi, inner, outer, epsabs=0, epsrel=1e-11)[0]


@pytest.mark.parametrize("s", [0.0, 0.05, 0.14])
def test_area_and_second_moment_are_integrals_over_the_section(s):
    body, outer, inner = paper_body(), 0.020 - 0.007 * s / 0.14, 0.007
    area = over_the_annulus(lambda r, a: 1.0, outer, inner)
    second_moment = over_the_annulus(lambda r, a: (r * np.sin(a)) ** 2, outer, inner)  # eq. (12)
    np.testing.assert_allclose(body.area(s), area, rtol=1e-10)
    np.testing.assert_allclose(body.second_moment(s), second_moment, rtol=1e-10)
    np.testing.assert_allclose(body.stiffness(s), 1.4e6 * second_moment, rtol=1e-10)


def test_conical_tapers_linearly():
    body = paper_body(inner_radius=(0.008, 0.006), tendon_offset=(0.011, 0.009))
    np.testing.assert_allclose(body.outer_radius(S), np.linspace(0.020, 0.013, 8), rtol=ROUNDING)
    np.testing.assert_allclose(body.inner_radius(S), np.linspace(0.008, 0.006, 8), rtol=ROUNDING)
    np.testing.assert_allclose(body.offset(S), [np.linspace(0.011, 0.009, 8)], rtol=ROUNDING)


def test_defaults_are_exact_kinematics_and_the_friction_of_the_manipulator():
    tendons = cddf.Tendon(0.01, friction_coefficient=0.1), cddf.Tendon(0.01, side=-1)
    body = cddf.Manipulator(0.14, 0.02, 0.007, tendons, 1.4e6, 0.42)
    np.testing.assert_array_equal(body.tendon_friction, [0.1, 0.42])
    assert (body.kinematics, cddf.conical(**PAPER).kinematics) == ("exact", "exact")


def test_everything_along_a_body_is_stretched_with_it():
    """Twice as long: the value at twice the arc length is the one before, for every kind of profile."""
    body = paper_with(
        cddf.Tendon(0.010, end=0.11),
        cddf.Tendon(cddf.Linear(0.011, 0.009, 0.14), angle=cddf.Linear(0.0, np.pi, 0.14)),
        inner_radius=cddf.Piecewise([0.05], [0.006, cddf.Linear(0.006, 0.005, 0.14)]),
        outer_radius=cddf.Spline(np.linspace(0, 0.14, 5), [0.02, 0.019, 0.017, 0.016, 0.013]),
        rest_curvature=(0.0, cddf.Linear(1.0, 3.0, 0.14), 0.0),
    )
    longer = stretched(body, 0.28)

    @jax.jit
    def along(body, s):
        return body.radii(s), jax.vmap(body.arms)(s), body.rest_curvature[1](s)

    s = np.linspace(0.0, 0.14, 57)
    compare = partial(np.testing.assert_allclose, rtol=1e-12, atol=1e-15)
    jax.tree.map(compare, along(longer, 2 * s), along(body, s))
    assert longer.tendons[0].end == pytest.approx(0.22, rel=1e-12)
    assert longer.tendons[1].end is None
    assert float(longer.length) == 0.28


def test_numbers_can_be_traced_and_mapped():
    def tip_stiffness(radius, modulus):
        return paper_body(outer_radius=(0.02, radius), youngs_modulus=modulus).stiffness(0.14)

    radii = jnp.array([0.010, 0.013, 0.016])
    expected = 1.4e6 * np.pi / 4 * (np.asarray(radii) ** 4 - 0.007**4)  # eq. (12)
    np.testing.assert_allclose(jax.vmap(tip_stiffness, (0, None))(radii, 1.4e6), expected, rtol=ROUNDING)
    slope = jax.grad(tip_stiffness)(0.013, 1.4e6)
    np.testing.assert_allclose(slope, 1.4e6 * np.pi * 0.013**3, rtol=ROUNDING)


def test_what_conical_refuses():
    with pytest.raises(ValueError, match=r"conical: num_tendons must be 1 or 2, got 3"):
        paper_body(num_tendons=3)
    with pytest.raises(ValueError, match=r"conical: inner_radius must be a number or a pair .* got shape \(3,\)"):
        paper_body(inner_radius=(0.01, 0.01, 0.01))


def test_a_manipulator_needs_a_tendon_on_one_side_and_known_kinematics():
    for side in (0, 2, -2, True):
        with pytest.raises(ValueError, match=r"Tendon: side must be \+1 or -1, got"):
            cddf.Tendon(0.01, side=side)
    left = paper_with(cddf.Tendon(0.01, side=np.sign(-0.5)))  # a float
    assert "side -1" in str(left)
    for tendons in ((), (0.01,)):
        with pytest.raises(ValueError, match="Manipulator: tendons must hold one Tendon or more"):
            cddf.Manipulator(0.14, 0.02, 0.007, tendons, 1.4e6, 0.42)  # pyright: ignore[reportArgumentType]
    for rest in (2.0, (0.0, 2.0)):
        with pytest.raises(ValueError, match=r"rest_curvature must have three components \(twist, y, z\), got"):
            cddf.Manipulator(0.14, 0.02, 0.007, (cddf.Tendon(0.01),), 1.4e6, 0.42, rest_curvature=rest)
    with pytest.raises(ValueError, match=r"kinematics must be one of .*'published', 'exact'.* got 'literal'"):
        paper_body("literal")
