"""Properties that hold for all numbers: mirror images, units, and the limit without friction."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import PAPER, paper_body, paper_plain, paper_with, replaced, two_slanted_tendons
from scipy.integrate import quad

import cddf_jax as cddf

ROUNDING = 1e-12  # the same operations in another order
SCALED = 1e-10  # the passes stop at a relative change of 1e-12


# mirrors and units do not depend on the kinematics; the exact ones of slanted tendons take longer to compile
published_at_once = pytest.mark.parametrize("kinematics", ["published", pytest.param("exact", marks=pytest.mark.slow)])


def with_sides(body, *sides):
    tendons = tuple(cddf.Tendon(t.offset, side) for t, side in zip(body.tendons, sides, strict=True))
    return eqx.tree_at(lambda body: body.tendons, body, tendons)


@pytest.mark.slow
@published_at_once
def test_the_other_side_gives_the_mirror_image(kinematics):
    body = two_slanted_tendons(kinematics)
    left = cddf.solve(body, (60.0, 15.0), direction=(+1, -1))
    right = cddf.solve(with_sides(body, -1, +1), (60.0, 15.0), direction=(+1, -1))
    np.testing.assert_allclose(right.position, left.position * jnp.array([1, -1]), atol=ROUNDING)
    np.testing.assert_allclose(right.curvature, -left.curvature, rtol=ROUNDING)
    np.testing.assert_allclose(right.heading, -left.heading, atol=ROUNDING)
    np.testing.assert_allclose(right.tension, left.tension, rtol=ROUNDING)
    np.testing.assert_allclose(right.wrap_angle, left.wrap_angle, atol=ROUNDING)
    np.testing.assert_allclose(right.tendon_displacement, left.tendon_displacement, atol=ROUNDING)
    for ours, theirs in ((right.normal_force, left.normal_force), (right.friction_force, left.friction_force)):
        np.testing.assert_allclose(ours, theirs * jnp.array([1, -1]), rtol=1e-10, atol=1e-9)
    # the order of the tendons does not matter
    other = cddf.solve(with_sides(body, -1, +1), (15.0, 60.0), direction=(-1, +1))
    np.testing.assert_allclose(other.tip_tension, left.tip_tension[::-1], rtol=SCALED)
    np.testing.assert_allclose(other.tip_position, left.tip_position, atol=SCALED)


@pytest.mark.slow
def test_an_anchor_at_the_tip_is_as_no_anchor():
    """A tendon that ends at s = L causes no turn there."""
    body = two_slanted_tendons()
    there = tuple(cddf.Tendon(tendon.offset, tendon.side, end=body.length) for tendon in body.tendons)
    anchored = cddf.solve(eqx.tree_at(lambda body: body.tendons, body, there), (60.0, 15.0), direction=(+1, -1))
    plain = cddf.solve(body, (60.0, 15.0), direction=(+1, -1))
    np.testing.assert_allclose(anchored.tip_tension, plain.tip_tension, rtol=SCALED)
    np.testing.assert_allclose(anchored.tip_position, plain.tip_position, atol=SCALED)


@published_at_once
def test_millimetres_and_megapascals_give_the_same_newtons(kinematics):
    """N/mm^2 is MPa: lengths by 1e3, modulus by 1e-6, forces as they are."""
    si = two_slanted_tendons(kinematics)
    mm = paper_body(
        kinematics,
        length=140.0,
        outer_radius=(20.0, 13.0),
        inner_radius=7.0,
        tendon_offset=(12.0, 9.0),
        youngs_modulus=1.4,
        num_tendons=2,
    )
    a, b = (cddf.solve(body, (60.0, 15.0), direction=(+1, -1)) for body in (si, mm))
    np.testing.assert_allclose(b.tip_tension, a.tip_tension, rtol=SCALED)
    np.testing.assert_allclose(b.tip_position, a.tip_position * 1e3, rtol=SCALED)
    np.testing.assert_allclose(b.curvature, a.curvature / 1e3, rtol=SCALED)
    np.testing.assert_allclose(b.tendon_displacement, a.tendon_displacement * 1e3, rtol=SCALED)
    np.testing.assert_allclose(b.normal_force, a.normal_force / 1e3, rtol=1e-8, atol=1e-9)


def test_stiffness_and_tension_scale_together():
    """Only T / E enters, docs/theory.md."""
    soft, stiff = paper_body("exact"), paper_body("exact", youngs_modulus=7 * PAPER["youngs_modulus"])
    a, b = cddf.solve(soft, 40.0), cddf.solve(stiff, 7 * 40.0)
    np.testing.assert_allclose(b.tip_position, a.tip_position, rtol=SCALED)
    np.testing.assert_allclose(b.tension_loss, a.tension_loss, rtol=SCALED)


@pytest.mark.parametrize("kinematics", ["published", "exact"])
def test_without_friction_the_tension_is_that_at_the_base(kinematics):
    """Exact: kappa = d T / (E J); published, eq. (17) integrated: d T / (E J + T d^2). SciPy integrates to the tip."""
    solution = cddf.solve(paper_body(kinematics, friction_coefficient=0.0), 50.0)
    np.testing.assert_array_equal(solution.tension, 50.0)
    np.testing.assert_array_equal(solution.tension_loss, 0.0)

    def curvature(s):
        return 0.010 * 50.0 / (1.4e6 * paper_plain().second_moment(s) + (kinematics == "published") * 50.0 * 0.010**2)

    np.testing.assert_allclose(solution.curvature, curvature(np.asarray(solution.arc_length)), rtol=ROUNDING)
    np.testing.assert_allclose(solution.tip_angle, quad(curvature, 0, 0.14, epsrel=1e-13)[0], atol=1e-9)


def test_small_friction_joins_the_limit():
    """First order in mu: T_tip = T_base (1 - mu theta), docs/theory.md."""
    frictionless = cddf.solve(paper_body("exact", friction_coefficient=0.0), 50.0)
    solution = cddf.solve(paper_body("exact", friction_coefficient=1e-6), 50.0)
    theta = frictionless.wrap_angle[:, -1]
    np.testing.assert_allclose(solution.tension_loss / 1e-6, theta, rtol=1e-5)  # of second order: mu theta


@pytest.mark.parametrize("sliding", [+1, -1])
def test_loss_at_a_given_angle_does_not_depend_on_the_body(sliding):
    """Constant d, exact kinematics: loss = 1 - exp(-mu tip_angle), docs/identifiability.md."""
    solve = jax.jit(lambda body: cddf.solve(body, 30.0, direction=sliding, throw=False))
    for tip_radius in (0.013, 0.016, 0.020):
        solution = solve(paper_body("exact", outer_radius=(0.020, tip_radius)))
        expected = -np.expm1(-sliding * 0.42 * solution.tip_angle)
        np.testing.assert_allclose(solution.tension_loss, [expected], rtol=1e-9)


def test_no_tension_no_bending():
    solution = cddf.solve(two_slanted_tendons("published"), 0.0, direction=+1)
    np.testing.assert_array_equal(solution.curvature, 0.0)
    np.testing.assert_array_equal(solution.tip_tension, 0.0)
    np.testing.assert_allclose(solution.tip_position, [0.14, 0.0], atol=ROUNDING)


def test_equal_pulls_on_both_sides_keep_a_body_straight():
    solution = cddf.solve(paper_body("published", tendon_offset=(0.01, 0.01), num_tendons=2), 30.0, direction=+1)
    np.testing.assert_allclose(solution.tip_position, [0.14, 0.0], atol=ROUNDING)
    np.testing.assert_allclose(solution.tip_tension, 30.0, rtol=ROUNDING)


def test_a_passive_end_does_not_change_the_rest():
    """A body whose tendon ends before the tip goes on straight: u(L) = u(end) + (L - end) t."""
    body = paper_with(cddf.Tendon(0.010, end=0.10))
    a, b = cddf.solve(body, 40.0), cddf.solve(replaced(body, length=0.12), 40.0)
    axis = np.array([np.cos(a.tip_angle), np.sin(a.tip_angle)])
    np.testing.assert_allclose(a.tip_position - b.tip_position, 0.02 * axis, atol=ROUNDING)
