"""Bodies of two segments and of discs in space: against SciPy, which integrates from base to tip and shoots.

In the frame of the cross-section, with the moment m and the force n of all that lies beyond,

    G = K u - m + sum rho_i x T_i t_i = 0,    t = w / |w|,    w = e_x + u x rho + rho',
    T' = -direction mu |dt/ds + u x t| T,     m' = -e_x x n - u x m,    R' = R [u]x,    r' = R e_x.

T' is in the derivative of t as well, by u' = -(dG/du)^-1 (dG/ds + dG/dT T' - m'). A tendon that has ended has no term
in G. At its end u jumps, and so does the direction of a tendon that winds: by an angle a, which leaves exp(-mu a) of
its tension. Derivatives of G and t are taken by complex steps.
"""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root

import cddf_jax as cddf

L, HALF, MU, RADIUS, OFFSET = 0.20, 0.11, 0.25, 0.7e-3, 8e-3
E, POISSON = 60e9, 0.3
EI = E * np.pi / 4 * RADIUS**4
K = np.diag([EI / (1 + POISSON), EI, EI])
ANGLES, TURNS = (0.3, 2.4, 4.5), (0.0, 0.25, 0.0)  # at the base, and how far they wind up to the tip
ENDS = (L, L, HALF)
PULL = np.array([2.0, 1.0, 1.5])
DISCS = {0.05: 0.010, 0.10: 0.010, 0.15: 0.010, 0.20: 0.015}  # kg by place
GRAVITY, TIP_FORCE = np.array([1.0, -4.0, 2.0]), np.array([0.0, 0.02, 0.03])


def robot():
    """Discs on a thin rod carry tendons outside it; one of the tendons ends half way, another winds."""
    tendons = [
        cddf.Tendon(OFFSET, angle=cddf.Linear(angle, angle + 2 * np.pi * turns, L) if turns else angle, end=end)
        for angle, turns, end in zip(ANGLES, TURNS, ENDS, strict=True)
    ]
    return cddf.Manipulator(
        length=L,
        outer_radius=RADIUS,
        inner_radius=0.0,
        tendons=tendons,
        youngs_modulus=E,
        poissons_ratio=POISSON,
        friction_coefficient=MU,
        point_masses=[cddf.PointMass(s, mass) for s, mass in DISCS.items()],
    )


# --- the same by SciPy ---------------------------------------------------------------------------


def tangents(s, u):
    """Places and directions of the tendons, (tendons, 3)."""
    rate = 2 * np.pi * np.array(TURNS) / L
    angle = np.array(ANGLES) + rate * s
    rho = OFFSET * np.stack([0 * angle, np.cos(angle), np.sin(angle)], axis=-1)
    slope = OFFSET * rate[:, None] * np.stack([0 * angle, -np.sin(angle), np.cos(angle)], axis=-1)
    w = np.array([1.0, 0.0, 0.0]) + np.cross(u, rho) + slope
    return rho, w / np.sqrt(np.sum(w**2, axis=-1, keepdims=True))


def residual(s, u, tension, moment):
    rho, t = tangents(s, u)
    return K @ u - moment + np.sum(np.cross(rho, tension[:, None] * t), axis=0)


def complex_step(function, at):
    """The derivatives by each number, last."""
    at, step = np.atleast_1d(np.asarray(at, float)), 1e-30
    return np.stack([np.imag(function(at + 1j * step * own)) / step for own in np.eye(at.size)], axis=-1)


def strain(s, tension, moment):
    """By Newton's method."""
    u = np.linalg.solve(K, moment)
    for _ in range(30):
        miss = residual(s, u, tension, moment)
        u = u - np.linalg.solve(complex_step(lambda x: residual(s, x, tension, moment), u), miss)
        if np.max(np.abs(miss)) < 1e-16:
            break
    return u


def after_a_jump(s, tension, moment, before, there):
    """The tensions behind the place where a tendon ends."""
    came, left = tangents(s, strain(s, np.where(before, tension, 0.0), moment))[1], tension
    for _ in range(60):
        goes = tangents(s, strain(s, np.where(there, left, 0.0), moment))[1]
        angle = 2 * np.arcsin(np.linalg.norm(goes - came, axis=-1) / 2)
        left = np.where(there, tension * np.exp(-MU * angle), tension)
    return left


def rates(s, tension, moment, force, there):
    """The strain, and how fast tensions fall along the axis."""
    pulling = np.where(there, tension, 0.0)
    u = strain(s, pulling, moment)
    slope = complex_step(lambda x: residual(s, x, pulling, moment), u)
    moment_rate = -np.cross([1.0, 0.0, 0.0], force) - np.cross(u, moment)
    by_s = complex_step(lambda x: residual(x[0], u + 0j, pulling, moment), s)[:, 0]
    by_tension = complex_step(lambda x: residual(s, u, x, moment), pulling)
    t = tangents(s, u)[1]
    t_by_s = complex_step(lambda x: tangents(x[0], u + 0j)[1], s)[..., 0]
    t_by_u = complex_step(lambda x: tangents(s, x)[1], u)
    rate = np.zeros(3)
    for _ in range(60):
        turn = np.linalg.solve(slope, moment_rate - by_s - by_tension @ rate)
        new = np.where(there, -MU * np.linalg.norm(t_by_s + t_by_u @ turn + np.cross(u, t), axis=-1) * pulling, 0.0)
        done, rate = np.max(np.abs(new - rate)) < 1e-13, new
        if done:
            break
    return u, rate, moment_rate


def integrated(base_moment):
    """Tensions where tendons end, tip and its frame, and the moment that is left at the tip."""
    at_end, tension, moment = PULL, PULL, np.array(base_moment, float)
    frame, place = np.eye(3), np.zeros(3)
    edges, before = sorted({0.0, HALF, L, *DISCS}), np.full(3, True)
    for low, high in pairwise(edges):
        there = np.array([end >= high for end in ENDS])
        tension, before = after_a_jump(low, tension, moment, before, there), there
        beyond = sum(mass for s, mass in DISCS.items() if s >= high)
        load = TIP_FORCE + beyond * GRAVITY

        def rate(s, state, there=there, load=load):
            frame, tension, moment = state[:9].reshape(3, 3), state[12:15], state[15:]
            u, falls, moment_rate = rates(s, tension, moment, frame.T @ load, there)
            cross = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
            return np.concatenate([(frame @ cross).ravel(), frame[:, 0], falls, moment_rate])

        state = np.concatenate([frame.ravel(), place, tension, moment])
        end = solve_ivp(rate, (low, high), state, method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
        frame, place, tension, moment = end[:9].reshape(3, 3), end[9:12], end[12:15], end[15:]
        at_end = np.where(there, tension, at_end)
    return at_end, place, frame, moment


@pytest.mark.slow
def test_discs_and_segments_under_loads():
    """SciPy shoots for the base moment with which none is left at the tip; ours, to be judged, is where it starts."""
    found = cddf.solve(robot(), PULL, cddf.Loads(tip_force=TIP_FORCE, gravity=GRAVITY), direction=1)
    shot = root(lambda moment: integrated(moment)[3], np.asarray(found.base_moment), tol=1e-12)
    assert np.max(np.abs(shot.fun)) < 1e-10
    tension, place, frame, _ = integrated(shot.x)
    np.testing.assert_allclose(found.base_moment, shot.x, atol=1e-10)
    np.testing.assert_allclose(found.tip_tension, tension, rtol=1e-8)
    np.testing.assert_allclose(found.tip_position, place, atol=1e-10)
    np.testing.assert_allclose(np.asarray(found.tip_frame), frame, atol=1e-9)
    along = found.at(np.array([HALF - 1e-6, HALF + 1e-6]))
    np.testing.assert_allclose(along.tension[2], [tension[2], 0.0], rtol=1e-5)  # beyond its end there is none
