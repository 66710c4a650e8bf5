"""Distributed forces: they balance, and the paper's double integral agrees with the local equilibrium."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from bodies import paper_body, paper_plain, two_slanted_tendons
from numpy.polynomial import legendre

import cddf_jax as cddf

LENGTH = 0.14
CASES = {
    "published": (paper_body("published"), 75.0, +1),
    "exact": (paper_body("exact"), 75.0, +1),
    "exact, one out": (two_slanted_tendons("exact"), (75.0, 20.0), (+1, -1)),
}


@cache
def solved(case, nodes=16):
    body, tension, direction = CASES[case]
    return body, cddf.solve(body, tension, direction=direction, nodes=nodes, throw=False)


def tangents(body, fields):
    """t_c of every tendon in the fixed frame, eq. (3): (1 - sigma d kappa) t + sigma d' n; exact: its direction."""
    phi, s = np.asarray(fields.heading), np.asarray(fields.arc_length)
    t, n = np.stack([np.cos(phi), np.sin(phi)], -1), np.stack([-np.sin(phi), np.cos(phi)], -1)
    rows = []
    for tendon in body.tendons:
        d = np.asarray(tendon.offset(s))
        slope = (float(tendon.offset(LENGTH)) - float(tendon.offset(0.0))) / LENGTH
        q = 1 - tendon.side * d * np.asarray(fields.curvature)
        u_c = q[..., None] * t + tendon.side * slope * n
        if body.kinematics == "exact":
            u_c = u_c / np.linalg.norm(u_c, axis=-1, keepdims=True)
        rows.append(u_c)
    return np.array(rows)


def cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def imbalance(case, nodes):
    """Integral of both forces + T t_c at the base - T t_c at the tip, over the largest tension."""
    body, solution = solved(case, nodes)
    x, w = legendre.leggauss(40)
    along = solution.at(jnp.asarray((x + 1) / 2 * LENGTH))
    total = (w * LENGTH / 2) @ np.asarray(along.normal_force + along.friction_force)
    ends = solution.at(jnp.array([0.0, LENGTH]))
    pull = np.asarray(ends.tension)[..., None] * tangents(body, ends)
    return np.max(np.abs(total + pull[:, 0] - pull[:, 1])) / 75


each_case = pytest.mark.parametrize(
    "case", ["published", "exact", pytest.param("exact, one out", marks=pytest.mark.slow)]
)


@each_case
def test_the_forces_along_the_body_and_at_its_ends_balance(case):
    """F_CDDN + F_CDDF is the derivative of T t_c, eq. (9), (10): the integral closes, the better the more nodes."""
    coarse, fine = imbalance(case, 6), imbalance(case, 16)
    assert fine < 1e-8  # the interpolant between 16 nodes is of degree 8 in each panel
    assert fine < max(coarse / 100, 1e-10)


@each_case
def test_friction_opposes_the_sliding_and_lies_along_the_tendon(case):
    """Eq. (10): on the body it points to the base (-t_c) for a tendon sliding in; exact: the normal force is across."""
    body, solution = solved(case)
    t_c, sign = tangents(body, solution.along), np.broadcast_to(np.asarray(CASES[case][2]), body.num_tendons)
    friction, normal = np.asarray(solution.friction_force), np.asarray(solution.normal_force)
    assert np.all(sign[:, None] * np.sum(friction * t_c, axis=-1) < 0)
    np.testing.assert_allclose(cross(friction, t_c), 0.0, atol=1e-9 * np.max(np.abs(normal)))
    if body.kinematics == "exact":
        np.testing.assert_allclose(np.sum(normal * t_c, -1), 0.0, atol=1e-9 * np.max(np.abs(normal)))


def test_the_two_lines_of_eq_10_differ():
    """docs/theory.md: |F_CDDN| is 532 N/m at the tip at 75 N, T kappa_c is 708 N/m and friction goes with it."""
    _, solution = solved("published")
    normal = np.linalg.norm(solution.normal_force[0, -1])
    kappa, tension = float(solution.curvature[-1]), float(solution.tension[0, -1])
    q = 1 - 0.010 * kappa
    np.testing.assert_allclose(normal, 532.0, atol=0.5)
    np.testing.assert_allclose(tension * kappa / q, 708.0, atol=0.5)
    friction = np.linalg.norm(solution.friction_force[0, -1])
    np.testing.assert_allclose(friction, 0.42 * tension * kappa / q * q, rtol=1e-10)  # mu T kappa_c |t_c|


def literal_moment(body, solution, points):
    """The double integral of eq. (13) and (14) over a uniform grid, by the trapezoidal rule.

    The lever from s to the force at xi is int_s^xi t + sigma d n (the inner integral runs to xi); the
    tip force of eq. (7) comes on top.
    """
    s = np.linspace(0, LENGTH, points)
    along = solution.at(jnp.asarray(s))
    phi = np.asarray(along.heading)
    h = s[1] - s[0]
    axis = np.stack([np.cos(phi), np.sin(phi)], -1)
    run = np.concatenate([np.zeros((1, 2)), np.cumsum((axis[1:] + axis[:-1]) / 2 * h, axis=0)])
    normal = np.stack([-np.sin(phi), np.cos(phi)], -1)
    arm = np.array([tendon.side * tendon.offset(s)[:, None] * normal for tendon in body.tendons]) + run  # from the base
    force = np.asarray(along.normal_force + along.friction_force)
    tip_force = -np.asarray(along.tension)[:, -1, None] * tangents(body, along)[:, -1]
    moments = []
    for i in range(points):
        density = np.sum(cross(arm - run[i], force), axis=0)[i:]
        inside = np.sum((density[1:] + density[:-1]) / 2 * h)
        moments.append(inside + np.sum(cross(arm[:, -1] - run[i], tip_force)))
    return s, np.array(moments)


@each_case
def test_the_double_integral_of_eq_13_is_the_local_equilibrium(case):
    """It tends to E J kappa with the square of the step, as the trapezoidal rule does."""
    body, solution = solved(case)
    errors = []
    for points in (57, 113, 225):
        s, moment = literal_moment(body, solution, points)
        EJ = 1.4e6 * np.array([paper_plain().second_moment(x) for x in s])
        local = EJ * np.asarray(solution.at(jnp.asarray(s)).curvature)
        errors.append(np.max(np.abs(moment - local)) / np.max(local))
    assert errors[-1] < 1e-4
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 2.0, atol=0.05)


def test_forces_without_slant_by_hand():
    """Exact, constant d: F = T kappa n - mu T kappa t, eq. (9) and (10)."""
    _, solution = solved("exact")
    phi, T, kappa = (np.asarray(x) for x in (solution.heading, solution.tension[0], solution.curvature))
    t, n = np.stack([np.cos(phi), np.sin(phi)], -1), np.stack([-np.sin(phi), np.cos(phi)], -1)
    np.testing.assert_allclose(solution.normal_force[0], (T * kappa)[:, None] * n, atol=1e-9)
    np.testing.assert_allclose(solution.friction_force[0], (-0.42 * T * kappa)[:, None] * t, atol=1e-9)
