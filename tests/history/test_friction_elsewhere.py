"""Friction of the body, and of tendons outside it, against play operators by hand."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import both_modes
from refusals import refused

import cddf_jax as cddf

OFFSET, STIFFNESS, REACH, COMPLIANCE = 0.0045, 2.5e-3, 0.12, 1.5e-4  # m, N m^2, m, m/N
MOMENT, EXPONENT, DRAG = 2e-3, 0.3, 0.2  # N m, -, N
PULLS = np.array([1.0, 3.0, 4.0, 3.8, 2.0, 0.5, 2.5])


def body(friction=0.0, compliance: float | None = COMPLIANCE, moment=None, **outside):
    tendon = cddf.Tendon(OFFSET, end=REACH, outside_compliance=compliance, **outside)
    return cddf.Manipulator(
        length=0.18,
        tendons=[tendon],
        bending_stiffness=STIFFNESS,
        friction_coefficient=friction,
        friction_moment=moment,
    )


def followed(low, high):
    """A play by hand: what stays between two bounds, and moves only when one of them takes it along."""
    found, here = [], 0.0
    for least, most in zip(low, high, strict=True):
        here = min(max(here, least), most)
        found.append(here)
    return np.array(found)


def test_friction_of_the_body_holds_the_curvature():
    free, limit = OFFSET * PULLS / STIFFNESS, MOMENT / STIFFNESS
    curvature = followed(free - limit, free + limit)
    found = cddf.trace(body(moment=MOMENT), PULLS, short_steps=32)
    np.testing.assert_allclose(found.tip_angle, REACH * curvature, rtol=1e-9)
    np.testing.assert_allclose(found.equilibria.bend()[:, 5], np.abs(curvature), rtol=1e-9)
    np.testing.assert_allclose(found.tendon_displacement, OFFSET * REACH * curvature + COMPLIANCE * PULLS, rtol=1e-6)
    lost = MOMENT * REACH * np.cumsum(np.abs(np.diff(curvature, prepend=0.0)))
    # less exact is the increment in which it begins to move
    np.testing.assert_allclose(found.energies.friction_loss, lost, rtol=3e-3)


@pytest.mark.slow
def test_in_space_it_holds_against_the_resulting_moment():
    """Pulled about one axis, then about another: the curvature follows the vector of the moments at a distance."""
    tendons = [cddf.Tendon(OFFSET, angle=angle) for angle in (0.0, np.pi / 2)]
    robot = cddf.Manipulator(
        length=REACH,
        tendons=tendons,
        bending_stiffness=STIFFNESS,
        torsional_stiffness=STIFFNESS,
        friction_coefficient=0.0,
        friction_moment=MOMENT,
    )
    found = cddf.trace(robot, [[4.0, 0.0], [4.0, 4.0]], short_steps=64)
    here, expected = np.zeros(2), []
    for pull in np.concatenate([np.linspace([0, 0], [4, 0], 4001)[1:], np.linspace([4, 0], [4, 4], 4001)[1:]]):
        apart = OFFSET * pull / STIFFNESS - here
        size, limit = np.linalg.norm(apart), MOMENT / STIFFNESS
        here = here + apart * (1 - limit / size) if size > limit else here
        expected.append(np.linalg.norm(here))
    np.testing.assert_allclose(found.equilibria.bend()[:, 5], np.array(expected)[[3999, 7999]], rtol=2e-3)


def test_friction_outside_holds_the_tendon():
    """Both kinds together: T0 - T1 = tanh(exponent / 2) (T0 + T1) + drag, either way."""
    share = np.tanh(EXPONENT / 2)
    low = (PULLS * (1 - share) - DRAG) / (1 + share)
    high = (PULLS * (1 + share) + DRAG) / (1 - share)
    found = cddf.trace(body(outside_friction=EXPONENT, outside_drag=DRAG), PULLS)
    np.testing.assert_allclose(found.tip_tension, followed(low, high), rtol=1e-5)
    assert np.all(found.base_tension == PULLS)


@pytest.mark.slow
def test_it_cannot_be_seen_without_compliance_before_it():
    """The displacement alone then sets the body behind it."""
    path = cddf.Displacement(1e-3 * np.array([1.0, 2.0, 1.0]))
    with_it = cddf.trace(body(compliance=None, outside_drag=DRAG), path)
    np.testing.assert_allclose(with_it.tip_angle, cddf.trace(body(compliance=None), path).tip_angle, rtol=1e-6)


@pytest.mark.slow
def test_work_is_stored_or_lost():
    robot = body(friction=0.4, moment=MOMENT, outside_friction=EXPONENT, outside_drag=DRAG)
    found = cddf.trace(robot, cddf.Displacement(1e-3 * np.array([1.0, 3.0, 1.5, 0.5, 2.0])))
    of = found.energies
    np.testing.assert_allclose(of.work, of.friction_loss + of.stored_energy, rtol=1e-6)
    assert np.all(np.diff(of.friction_loss) > 0)


@pytest.mark.slow
def test_derivatives_in_both_modes_also_where_the_tendon_is_slack():
    path = cddf.Displacement(1e-3 * np.array([1.0, 3.0, 4.8, 3.9, 1.0, 0.1]))

    def angles(numbers):
        moment, exponent, drag = numbers
        robot = body(friction=0.5, moment=moment, outside_friction=exponent, outside_drag=drag)
        return cddf.trace(robot, path, short_steps=4, estimate_error=False, throw=False).tip_angle

    derivatives, at = both_modes(angles), np.array([1e-3, 0.1, 0.1])
    value, forward, reverse = derivatives(at)
    np.testing.assert_allclose(reverse, forward, rtol=1e-8, atol=1e-9)
    for k, step in enumerate((1e-7, 1e-5, 1e-5)):
        change = np.zeros(3)
        change[k] = step
        above, below = derivatives(at + change)[0], derivatives(at - change)[0]
        np.testing.assert_allclose(forward[:, k], (above - below) / (2 * step), rtol=1e-6, atol=1e-8)
    assert value[-1] > 0  # slack, and friction still bends the body


@pytest.mark.slow
def test_lanes_of_a_batch():
    """A friction moment below 0 is no number of a body: its lane fails alone."""

    def angle(moment):
        return cddf.trace(body(moment=moment), PULLS, estimate_error=False, throw=False).tip_angle

    found = jax.jit(jax.vmap(angle))(jnp.array([MOMENT, -MOMENT]))
    assert np.all(np.isnan(found[1]))
    alone = cddf.trace(body(moment=MOMENT), PULLS)  # as above: one program for both
    np.testing.assert_allclose(found[0], alone.tip_angle, rtol=1e-12)


def test_solve_refuses_what_has_a_history():
    for robot in (body(moment=MOMENT), body(outside_friction=0.1), body(outside_drag=0.1)):
        assert "use trace" in refused(partial(cddf.solve, robot, 1.0))


@pytest.mark.slow
def test_slack_tendons_are_dragged_along():
    """Where the body takes up a slack tendon, its friction outside holds it with 0.1 N; elsewhere nothing does."""
    angles, ends = np.radians([-175.4, -55.2, 58.6, -143.9, -33.0, 91.7, -128.5]), [0.06] * 3 + [0.1225] * 3 + [None]
    tendons = [
        cddf.Tendon(0.0045, end=end, angle=float(angle), outside_drag=0.1, outside_compliance=1.5e-4)
        for angle, end in zip(angles, ends, strict=True)
    ]
    rod = cddf.Manipulator(0.188, 5e-4, 0.0, tendons=tendons, youngs_modulus=50e9, friction_coefficient=0.0)
    pulled, slack = 1e-3 * np.array([1.5, 3.0, 4.2, 3.7, 3.2]), np.full(5, -0.01)
    found = cddf.trace(rod, [*map(cddf.Displacement, [pulled, *[slack] * 6])], nodes=4, short_steps=2, throw=False)
    lost = np.asarray(found.base_tension - found.tip_tension)
    np.testing.assert_allclose(lost[:, 0], [0.1, 0.1, 0.1, -0.1, -0.1], atol=1e-6)
    assert np.all(lost[:, 1:] > -0.1 - 1e-6)
    assert np.all(lost[:, 1:] < 1e-6)
    assert np.any(lost[:, 1:] < -0.05)
