"""Bodies in space: the numbers on which two independent codes and a published one agree, and properties."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import both_modes, paper_body, paper_with
from kinds import of_kind
from scipy.integrate import solve_ivp

import cddf_jax as cddf

LENGTH = 0.14
DIRECTION = (1, -1, -1)  # of three tendons, the first of which is pulled most


def at_angle(angle, offset: Any = 0.010):
    return cddf.Tendon(offset, angle=angle)


def helix(turns):
    return at_angle(cddf.Linear(0.0, 2 * np.pi * turns, LENGTH))


# number of turns: tip tension (N), tip position (mm) at 75 N; from two independent derivations and codes
HELICES = {
    0.25: (47.41876687, (118.67079545, 47.51777947, 32.74408991)),
    0.5: (54.52936051, (122.12680351, 17.21060405, 47.09759111)),
    1.0: (42.13217899, (137.46753785, -5.67019229, 12.15926669)),
}


@pytest.mark.parametrize("turns", HELICES)
def test_numbers_of_two_independent_codes(turns):
    tip_tension, tip_mm = HELICES[turns]
    found = cddf.solve(paper_with(helix(turns)), 75.0)
    np.testing.assert_allclose(found.tip_tension, [tip_tension], rtol=5e-9)
    sharp = turns == 0.5  # the turning of its tendon has a sharp minimum, where 1e-7 of the length is promised
    np.testing.assert_allclose(1e3 * found.tip_position, tip_mm, atol=1.4e-5 if sharp else 2e-7)
    assert found.error_estimate < (1e-6 if sharp else 1e-8)
    frame = np.asarray(found.tip_frame)
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-12)


def test_a_rigid_helix_has_a_closed_form():
    turns, offset = 2 * np.pi / LENGTH, 0.010
    found = cddf.solve(paper_with(helix(1.0), youngs_modulus=1.4e16), 75.0)
    # the tendon turns by a w^2 per arc length of the axis, over sqrt(1 + a^2 w^2)
    expected = 75.0 * np.exp(-0.42 * offset * turns**2 * LENGTH / np.sqrt(1 + (offset * turns) ** 2))
    np.testing.assert_allclose(expected, 25.4563817, rtol=2e-9)
    np.testing.assert_allclose(found.tip_tension, [expected], rtol=1e-9)


ROD: dict[str, Any] = {  # of a published code for rods with tendons without friction, Till, Aloi and Rucker (2019)
    "length": 0.5,
    "outer_radius": 1e-3,
    "inner_radius": 0.0,
    "youngs_modulus": 200e9,
    "poissons_ratio": 0.25,  # G = 80 GPa
    "friction_coefficient": 0.0,
    "density": 8000.0,
}


@pytest.mark.slow
def test_rods_of_a_published_code():
    """Its z is along the rod, x and y across: its (x, y, z) are our (y, z, x). With stretch and shear, and without."""
    gravity = cddf.Loads(gravity=(0.0, 9.81, 0.0))
    winding = cddf.Manipulator(tendons=[at_angle(cddf.Linear(0.0, 2 * np.pi, 0.5), 0.01506)], extensible=True, **ROD)
    straight = cddf.Manipulator(tendons=[at_angle(0.0, 0.01506)], **ROD)
    for body, loads, place, atol in (
        (winding, None, (493.268789, 0.073404, 58.159618), 2e-6),
        (winding, gravity, (493.3483, 12.2099, 58.1888), 2e-3),
        (straight, gravity, (453.239992, 182.216166, 0.0), 2e-6),
    ):
        np.testing.assert_allclose(1e3 * cddf.solve(body, 15.0, loads).tip_position, place, atol=atol)


def test_a_body_of_the_plane_in_space():
    body = paper_body("exact", num_tendons=2)
    plane, space = (cddf.solve(body, (40.0, 10.0), space=space) for space in (False, True))
    np.testing.assert_allclose(space.tip_tension, plane.tip_tension, rtol=1e-10)
    np.testing.assert_allclose(space.tip_position, [*plane.tip_position, 0.0], atol=1e-11)
    np.testing.assert_allclose(space.tip_angle, plane.tip_angle, atol=1e-10)
    np.testing.assert_allclose(space.tendon_displacement, plane.tendon_displacement, atol=1e-12)
    at = np.linspace(0.0, LENGTH, 9)
    flat, there = plane.at(at), space.at(at)
    np.testing.assert_allclose(there.curvature[:, 2], flat.curvature, atol=1e-8)
    np.testing.assert_allclose(there.curvature[:, :2], 0.0, atol=1e-10)
    np.testing.assert_allclose(there.tension, flat.tension, rtol=1e-10)
    np.testing.assert_allclose(there.position[:, :2], flat.position, atol=1e-11)
    np.testing.assert_allclose(there.wrap_angle, flat.wrap_angle, atol=1e-10)
    np.testing.assert_allclose(there.normal_force[..., :2], flat.normal_force, atol=1e-6)
    np.testing.assert_allclose(there.friction_force[..., :2], flat.friction_force, atol=1e-6)


@pytest.mark.slow
def test_forces_on_the_body_balance_the_reactions_at_the_base():
    """The tendon forces in sum are T t at the anchor less T t at the base; their moment and the load's bend the base.

    The direction t of a tendon follows from strain and routing, docs/space.md: v + u x rho + rho' with v = e_x.
    """
    turns, first, force = np.array([0.25, 0.0]), np.array([0.0, 2.0]), np.array([0.0, 0.1, 0.2])
    body = paper_with(helix(0.25), at_angle(2.0))
    found = cddf.solve(body, (40.0, 25.0), cddf.Loads(tip_force=force), direction=1)
    x, weights = np.polynomial.legendre.leggauss(40)
    places, weights = ((x + 1) / 2 * LENGTH, [0.0, LENGTH]), LENGTH / 2 * weights
    along, ends = (of_kind(cddf.SpatialFields, found.at(s)) for s in places)
    forces = along.normal_force + along.friction_force

    def pull(end):  # T t, (tendons, 3), in the fixed frame
        rate = 2 * np.pi * turns / LENGTH
        angle, zero = first + rate * LENGTH * end, np.zeros(2)
        arm = 0.010 * np.stack([zero, np.cos(angle), np.sin(angle)], axis=-1)
        slope = 0.010 * rate[:, None] * np.stack([zero, -np.sin(angle), np.cos(angle)], axis=-1)
        direction = (np.array([1.0, 0.0, 0.0]) + np.cross(ends.curvature[end], arm) + slope) @ ends.frame[end].T
        return ends.tension[:, end, None] * direction / np.linalg.norm(direction, axis=-1, keepdims=True)

    np.testing.assert_allclose(np.einsum("p,tpi->ti", weights, forces), pull(1) - pull(0), atol=1e-10)
    moment = np.einsum("p,tpi->i", weights, np.cross(along.path, forces))
    moment = moment - np.cross(ends.path[:, 1], pull(1)).sum(axis=0) + np.cross(found.tip_position, force)
    base = body.strain_stiffness(jnp.asarray(0.0)) * ends.curvature[0]
    np.testing.assert_allclose(moment, base, atol=1e-11)


@pytest.mark.slow
def test_derivatives_against_differences_in_both_modes():
    """At 3,000 N the strain at the tendon is above 1, and passes diverge: no load is to blame. Derivatives are zero."""
    loads = cddf.Loads(tip_force=(0.0, 0.1, 0.3))

    def tip(numbers):
        angle, tension, mu = numbers
        body = paper_with(at_angle(cddf.Linear(0.2, 0.2 + angle, LENGTH)), friction_coefficient=mu)
        found = cddf.solve(body, tension, loads, throw=False)
        how = jnp.stack([found.status, found.num_load_steps])
        return jnp.concatenate([found.tip_position, found.tip_tension, found.tip_angle[None], how])

    at, step = jnp.array([1.0, 30.0, 0.4]), jnp.array([1e-5, 1e-4, 1e-5])
    derivatives = both_modes(tip)
    _, forward, reverse = derivatives(at)
    differences = [(derivatives(at + h)[0] - derivatives(at - h)[0]) / (2 * jnp.sum(h)) for h in jnp.diag(step)]
    np.testing.assert_allclose(forward, jnp.stack(differences, axis=1), rtol=2e-7, atol=1e-9)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-13)
    (*_, status, num_load_steps), *slopes = derivatives(at.at[1].set(3000.0))
    assert (status, num_load_steps) == (cddf.Status.not_converged, 0)
    np.testing.assert_array_equal(slopes, 0.0)


@pytest.mark.parametrize("force", [None, pytest.param((0.5, -1.0, 0.3), marks=pytest.mark.slow)])
def test_a_sharp_minimum_of_the_turning_is_integrated(force):
    """Against four times as many nodes; |T t'| comes near to zero within the body, nearly with a kink."""
    body, loads = paper_with(helix(0.5)), None if force is None else cddf.Loads(tip_force=force)
    found, fine = (cddf.solve(body, 40.0, loads, nodes=nodes) for nodes in (16, 64))
    turning = np.linalg.norm(fine.normal_force[0], axis=-1) / fine.tension[0]
    assert turning.min() < 0.5 * turning.max()
    error = np.max(np.abs(found.tip_tension / fine.tip_tension - 1))
    assert error < 3e-7
    assert error < found.error_estimate < 1e-5
    np.testing.assert_allclose(found.tip_position, fine.tip_position, atol=1e-7 * LENGTH)


CONVERGING = cddf.Tendon(cddf.Linear(0.010, 0.005, LENGTH))
BEARING = {
    # a bend by about a turn, and a small load; a kink of the turning, where the curvature changes its sign
    "about a turn": (paper_body("exact"), 900.0, (0.0, 1e-6)),
    "kink": (paper_body("exact"), 40.0, (0.0, -10.0)),
    "converging": (paper_with(CONVERGING), 75.0, None),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", BEARING)
def test_bodies_of_the_plane_whose_references_are_there(case):
    body, tension, force = BEARING[case]
    loads = None if force is None else cddf.Loads(tip_force=force)
    plane, space = (cddf.solve(body, tension, loads, space=space) for space in (False, True))
    assert space.stable
    np.testing.assert_allclose(space.tip_tension, plane.tip_tension, rtol=1e-7 if loads else 1e-8)
    np.testing.assert_allclose(space.tip_position, [*plane.tip_position, 0.0], atol=1e-7 * LENGTH)
    axis = np.cos(plane.tip_angle), -np.sin(plane.tip_angle)
    np.testing.assert_allclose(np.asarray(space.tip_frame)[0, :2], axis, atol=1e-6 if loads else 5e-9)


@pytest.mark.slow
def test_the_tip_angle_at_zero_has_a_derivative():
    slope = jax.grad(lambda tension: cddf.solve(paper_with(at_angle(0.0)), tension, throw=False).tip_angle)(0.0)
    assert np.isfinite(slope)


def test_stiffnesses_by_hand():
    """A solid rod: G = E / (2 (1 + nu)), J = pi r^4 / 4, A = pi r^2, and the factors on them."""
    E, nu, r = 2e6, 0.3, 0.01
    numbers: dict[str, Any] = {"outer_radius": r, "inner_radius": 0.0, "youngs_modulus": E, "poissons_ratio": nu}
    numbers |= {"stiffness_factor": 1.5, "axial_factor": 0.7, "shear_factor": 0.8}
    body = paper_with(at_angle(0.0, 0.005), extensible=True, **numbers)
    J, A, G = np.pi * r**4 / 4, np.pi * r**2, E / (2 * (1 + nu))
    expected = 1.5 * np.array([2 * G * J, E * J, E * J, 0.7 * E * A, 0.8 * G * A, 0.8 * G * A])
    np.testing.assert_allclose(body.strain_stiffness(0.05), expected, rtol=1e-14)
    given = dataclasses.replace(body, torsional_stiffness=3.0, axial_stiffness=5.0, shear_stiffness=7.0)
    expected[[0, 3, 4, 5]] = 1.5 * np.array([3.0, 0.7 * 5.0, 0.8 * 7.0, 0.8 * 7.0])
    np.testing.assert_allclose(given.strain_stiffness(0.05), expected, rtol=1e-14)


@pytest.mark.slow
def test_an_axis_that_stretches_is_shortened_by_its_tendons():
    stiff = paper_with(at_angle(0.0), at_angle(np.pi), extensible=True, friction_coefficient=0.0)
    found = cddf.solve(stiff, (20.0, 20.0))
    # no bend: the force -40 N along the axis shortens it by the integral of 40 / (E A)
    area = np.pi * (np.linspace(0.020, 0.013, 20001) ** 2 - 0.007**2)
    shorter = np.trapezoid(40.0 / (1.4e6 * area), dx=LENGTH / 20000)
    np.testing.assert_allclose(found.tip_position, np.array([LENGTH - shorter, 0.0, 0.0]), atol=1e-10)


def test_a_body_in_space_needs_its_torsional_stiffness():
    with pytest.raises(ValueError, match="needs torsional_stiffness"):
        cddf.Manipulator(length=0.1, tendons=(at_angle(0.0),), bending_stiffness=1e-3, friction_coefficient=0.1)


@pytest.mark.slow
def test_targets_in_space():
    body = paper_with(at_angle(0.0), at_angle(2.1), at_angle(4.2))
    given = cddf.solve(body, (30.0, 10.0, 5.0), direction=DIRECTION)
    wanted = tuple(cddf.Displacement(x) for x in given.tendon_displacement[:2])
    found = cddf.solve(body, (*wanted, 5.0), direction=DIRECTION)
    np.testing.assert_allclose(found.base_tension, given.base_tension, rtol=1e-7)
    bent = cddf.solve(paper_with(at_angle(0.7)), cddf.TipAngle(0.5))
    np.testing.assert_allclose(bent.tip_angle, 0.5, atol=1e-9)
    bent = cddf.solve(paper_with(helix(0.25)), cddf.CurvatureAt(6.0, 0.05))
    np.testing.assert_allclose(np.linalg.norm(bent.at(0.05).curvature[1:]), 6.0, rtol=1e-9)


@pytest.mark.slow
def test_the_compliance_of_the_tip_is_6_by_6_and_symmetric_without_friction():
    body = paper_with(helix(0.25), friction_coefficient=0.0)
    compliance = cddf.tip_compliance(body, 30.0)
    assert compliance.shape == (6, 6)
    np.testing.assert_allclose(compliance, compliance.T, atol=1e-9 * np.max(np.abs(compliance)))  # Maxwell and Betti
    step = 1e-4
    moved = [cddf.solve(body, 30.0, cddf.Loads(tip_force=(0.0, 0.0, sign * step))) for sign in (1, -1)]
    difference = (moved[0].tip_position - moved[1].tip_position) / (2 * step)
    np.testing.assert_allclose(compliance[:3, 2], difference, rtol=1e-6, atol=1e-9)


def test_a_body_in_words():
    assert "angle 0 deg at the base, 90 deg at s = 140 mm" in str(paper_with(helix(0.25)))


@pytest.mark.slow
def test_parallel_tendons_that_slide_both_ways():
    """T' = -direction mu |u| T, u = sum T (z, -y) / (E J) up to signs, by SciPy; the moment passes near zero."""
    angles, friction, direction = np.radians([0.0, 120.0, 240.0]), np.array([0.9, 0.3, 0.5]), np.array([1.0, -1.0, 1.0])
    tendons = [cddf.Tendon(0.010, angle=a, friction_coefficient=mu) for a, mu in zip(angles, friction, strict=True)]
    body, pull = paper_with(*tendons), np.array([60.0, 40.0, 45.0])
    arms = 0.010 * np.stack([np.cos(angles), np.sin(angles)])

    def rate(s, tension):
        outer = 0.020 - 0.007 * s / LENGTH
        stiffness = 1.4e6 * np.pi / 4 * (outer**4 - 0.007**4)
        return -direction * friction * np.linalg.norm(arms @ tension) / stiffness * tension

    expected = solve_ivp(rate, (0.0, LENGTH), pull, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    found = cddf.solve(body, pull, direction=direction, throw=False)
    np.testing.assert_allclose(found.tip_tension, expected, rtol=1e-9)


def test_a_torsional_stiffness_below_zero_is_not_physical():
    """G = E / (2 (1 + nu)) is negative below nu = -1."""
    body = paper_with(at_angle(0.2), poissons_ratio=-1.5)
    assert cddf.solve(body, 10.0, throw=False).status == cddf.Status.unphysical
