"""Drag w, a friction per length that is there without tension and curvature: T' = -direction (mu |psi'| T + w)."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import PAPER, both_modes, one_kinematics_at_once, paper_body, paper_plain, paper_with, replaced
from kinds import of_kind, root_of
from scipy.integrate import quad, solve_ivp

import cddf_jax as cddf
from cddf_jax.errors import InputError

LENGTH, d, E, MU = (PAPER[name] for name in ("length", "tendon_offset", "youngs_modulus", "friction_coefficient"))
W = 100.0  # N/m: 14 N over the length
EXACT, PUBLISHED = (paper_body(kinematics, drag=W) for kinematics in ("exact", "published"))
CYLINDER = paper_body("exact", outer_radius=(0.016, 0.016), drag=W)
J = np.pi / 4 * (0.016**4 - 0.007**4)
second_moment = paper_plain().second_moment
WITH_KINKS = 3e-7  # where a tendon becomes slack or turns over


def cylinder_tension(base_tension, direction, s, w=W):
    """T' = -direction (a T^2 + w) with a = mu d / (E J): a Riccati equation with constant coefficients."""
    a = MU * d / (E * J)
    angle = np.arctan(base_tension * np.sqrt(a / w)) - direction * np.sqrt(a * w) * s
    return np.sqrt(w / a) * np.tan(np.maximum(angle, 0.0))


class Reference:
    """Exact kinematics by SciPy, while all tendons turn to the left.

    With psi' > 0 the law reads (T e^(g psi))' = -direction w e^(g psi), g = direction mu. So the state is
    y_i = T_i e^(g_i (psi_i - psi_i(0))), heading, position and the moment of a tip force, and the curvature the root
    of E J kappa = sum sigma d T q / sqrt(q^2 + d'^2) + M with T = max(y, 0) e^(-g psi): no kappa', no T' inside.
    """

    def __init__(self, tension, direction=+1, sides=(+1,), offsets=(d, d), w: Any = W, mu=MU, tip_force=(0.0, 0.0)):
        self.side = np.asarray(sides, float)
        self.base, self.w = (np.broadcast_to(np.asarray(x, float), self.side.shape) for x in (tension, w))
        self.direction = np.broadcast_to(np.asarray(direction, float), self.side.shape)
        self.gain, self.offsets, self.force = self.direction * mu, offsets, np.asarray(tip_force)
        moment = root_of(lambda m: self.run(m)[-1, -1], 0.0, 0.3, xtol=1e-13) if np.any(self.force) else 0.0
        end = self.run(moment)[-1]
        assert np.all(np.diff(self.psi, axis=0) > -1e-9), "a tendon turns to the right"
        n = self.side.size
        psi = self.section(LENGTH, end)[1]
        self.tip_tension = np.maximum(end[:n], 0.0) * np.exp(-self.gain * (psi - self.psi_base))
        self.tip_angle, self.tip_position = end[n], end[n + 1 : n + 3]

    def run(self, moment):
        n = self.side.size
        start = np.concatenate([self.base, [0.0, 0.0, 0.0, moment]])
        self.psi_base = np.zeros(n)
        self.psi_base = self.section(0.0, start, at_base=True)[1]
        out = solve_ivp(self.rate, (0.0, LENGTH), start, method="DOP853", rtol=1e-11, atol=1e-12)
        self.psi = np.array([self.section(*at)[1] for at in zip(out.t, out.y.T, strict=True)])
        return out.y.T

    def section(self, s, state, at_base=False):
        n = self.side.size
        base, tip = self.offsets
        offset, slope = base + (tip - base) * s / LENGTH, (tip - base) / LENGTH

        def psi(kappa):
            return state[n] + np.arctan2(self.side * slope, 1 - self.side * offset * kappa)

        def gap(kappa):
            wrap = 0.0 if at_base else psi(kappa) - self.psi_base
            tension = np.maximum(state[:n], 0.0) * np.exp(-self.gain * wrap)
            q = 1 - self.side * offset * kappa
            pull = np.sum(self.side * offset * tension * q / np.hypot(q, slope))
            return E * second_moment(s) * kappa - pull - state[-1]

        kappa = root_of(gap, -60.0, 60.0, xtol=1e-14, rtol=1e-14)
        return kappa, psi(kappa)

    def rate(self, s, state):
        n = self.side.size
        kappa, psi = self.section(s, state)
        axis = np.array([np.cos(state[n]), np.sin(state[n])])
        growth = (
            -self.direction
            * self.w
            * np.exp(self.gain * (psi - self.psi_base))
            * ((state[:n] > 0) | (self.direction < 0))
        )
        return np.concatenate([growth, [kappa], axis, [-(axis[0] * self.force[1] - axis[1] * self.force[0])]])


def compare(solution, reference):
    if not np.any(solution.direction_contradicted):
        assert solution.status == cddf.Status.successful
    np.testing.assert_allclose(solution.tip_tension, reference.tip_tension, rtol=WITH_KINKS, atol=1e-12)
    np.testing.assert_allclose(solution.tip_angle, reference.tip_angle, atol=WITH_KINKS)
    np.testing.assert_allclose(solution.tip_position, reference.tip_position, atol=WITH_KINKS * LENGTH)


# --- without curvature-dependent friction: T = T_base - direction w s -----------------------------


@pytest.mark.parametrize("direction", [+1, -1], ids=["in", "out"])
@pytest.mark.parametrize("base_tension", [75.0, 10.0, 0.0])
@one_kinematics_at_once
def test_drag_alone_lowers_the_tension_linearly(kinematics, base_tension, direction):
    """T = max(T_base - direction w s, 0), zero from s = T_base / w; kappa = T d / (E J + T d^2 where published)."""
    body = replace(EXACT if kinematics == "exact" else PUBLISHED, friction_coefficient=0.0)
    solution = cddf.solve(body, base_tension, direction=direction, throw=False)

    def tension(s):
        return np.maximum(base_tension - direction * W * s, 0.0)

    def curvature(s):
        return tension(s) * d / (E * second_moment(s) + (kinematics == "published") * tension(s) * d**2)

    np.testing.assert_allclose(solution.tension[0], tension(np.asarray(solution.arc_length)), rtol=1e-13, atol=1e-12)
    np.testing.assert_allclose(solution.tip_tension, [tension(LENGTH)], rtol=1e-13)
    slack = np.clip(base_tension / W, 0.0, LENGTH) if direction > 0 else LENGTH
    np.testing.assert_allclose(solution.tip_angle, quad(curvature, 0.0, slack, epsabs=1e-14)[0], atol=1e-10)
    if base_tension > 0:
        np.testing.assert_allclose(solution.tension_loss, [1 - tension(LENGTH) / base_tension], rtol=1e-13)
    # a tendon alone bends the body towards it, and cannot slide out; one without tension is not judged
    pulls = base_tension > 0 or direction < 0
    assert solution.direction_contradicted == (pulls and direction < 0)


def test_friction_force_of_drag_alone_is_the_drag_up_to_where_the_tendon_is_slack():
    """F_CDDF = T' t_c, eq. (10): -w t for a tendon parallel to the axis, and nothing beyond s = T_base / w."""
    solution = cddf.solve(replace(EXACT, friction_coefficient=0.0), 10.0)
    along = of_kind(cddf.Fields, solution.at([0.0, 0.05, 0.0999, 0.1001, 0.14]))
    axis = np.stack([np.cos(along.heading), np.sin(along.heading)], axis=-1)
    w = np.array([W, W, W, 0.0, 0.0])
    np.testing.assert_allclose(along.friction_force[0], -w[:, None] * axis, atol=1e-12)
    np.testing.assert_array_equal(along.tension[0, 3:], 0.0)


def test_capstan_and_drag_add_up():
    """|F_CDDF| = mu |F_CDDN| + w, as t_c has length one in the exact kinematics."""
    solution = cddf.solve(EXACT, 75.0)
    friction, normal = (np.linalg.norm(f, axis=-1) for f in (solution.friction_force, solution.normal_force))
    np.testing.assert_allclose(friction, MU * normal + W, rtol=1e-10)


@pytest.mark.slow
def test_a_sharp_bend_and_an_end_before_the_tip():
    """A rigid body: T falls linearly from 0 to 60 and from 60 to 80 mm, between them by exp(-mu atan(0.06))."""
    offset = cddf.Piecewise.linear([0.0, 0.06, LENGTH], [0.0076, 0.0112, 0.0112])
    body = replace(EXACT, tendons=(cddf.Tendon(offset, end=0.08),), youngs_modulus=1e16)
    solution = cddf.solve(body, 75.0)
    expected = (75.0 - W * 0.06) * np.exp(-MU * np.arctan(0.06)) - W * 0.02
    np.testing.assert_allclose(solution.tip_tension, [expected], rtol=1e-9)
    assert solution.tension[0, -1] == 0.0


# --- both frictions ------------------------------------------------------------------------------


@pytest.mark.parametrize(("base_tension", "direction"), [(75.0, +1), (12.0, +1), (40.0, -1), (0.0, -1)], ids=str)
@one_kinematics_at_once
def test_a_cylinder_follows_the_riccati_equation(kinematics, base_tension, direction):
    """12 N are used up before the tip. In the published kinematics kappa_c = T d / (E J) as well, docs/theory.md."""
    body = CYLINDER if kinematics == "exact" else replace(CYLINDER, kinematics=kinematics)
    solution = cddf.solve(body, base_tension, direction=direction, throw=False)
    s = np.linspace(0.0, LENGTH, 12)
    along = solution.at(s)
    # near the place where the tendon becomes slack, polynomials between the nodes round off a kink
    np.testing.assert_allclose(along.tension[0], cylinder_tension(base_tension, direction, s), rtol=1e-7, atol=2e-6)
    at_nodes = cylinder_tension(base_tension, direction, np.asarray(solution.arc_length))
    np.testing.assert_allclose(solution.tension[0], at_nodes, rtol=1e-7, atol=1e-6)
    tip = cylinder_tension(base_tension, direction, LENGTH)
    np.testing.assert_allclose(solution.tip_tension, [tip], rtol=1e-9)
    assert solution.error_estimate < 1e-6
    if kinematics == "exact":
        turn = quad(lambda s: cylinder_tension(base_tension, direction, s), 0, LENGTH, epsabs=1e-12)[0] * d / (E * J)
        np.testing.assert_allclose(solution.tip_angle, turn, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("offsets", "tension", "direction"),
    [
        ((0.012, 0.009), (75.0, 20.0), (+1, -1)),
        ((0.012, 0.009), (60.0, 0.0), (+1, -1)),  # the second is let go
        ((d, d), (15.0, 2.0), (+1, +1)),  # both become slack
    ],
    ids=str,
)
def test_two_tendons(offsets, tension, direction):
    """Antagonists, of which the first has a drag of its own."""
    offset = cddf.Linear(*offsets, length=LENGTH)
    tendons = cddf.Tendon(offset, drag=150.0), cddf.Tendon(offset, -1)
    solution = cddf.solve(paper_with(*tendons, drag=60.0), tension, direction=direction, throw=False)
    compare(solution, Reference(tension, direction, (+1, -1), offsets, w=(150.0, 60.0)))


@pytest.mark.slow
def test_under_a_load():
    force = (0.3, 1.0)
    for base_tension in (60.0, 10.0):
        solution = cddf.solve(EXACT, base_tension, cddf.Loads(tip_force=force))
        assert solution.status == cddf.Status.successful
        compare(solution, Reference(base_tension, tip_force=force))


@pytest.mark.slow
def test_a_tip_tension_is_found_across_the_slack():
    """Far below the tension of the start, and above what is used up: the Riccati equation backwards."""
    for wanted in (0.5, 40.0):
        solution = cddf.solve(CYLINDER, cddf.TipTension(wanted))
        np.testing.assert_allclose(solution.base_tension, [cylinder_tension(wanted, -1, LENGTH)], rtol=1e-8)


# --- derivatives and batches ---------------------------------------------------------------------


# drag, base tension, direction, friction
LANES = {
    "in": (W, 75.0, +1, MU),
    "slack": (W, 12.0, +1, MU),
    "out": (W, 40.0, -1, MU),
    "slack from the base": (W, 0.0, +1, MU),
    "out from no tension": (W, 0.0, -1, MU),
    "no drag": (0.0, 75.0, +1, MU),
    "fails": (-W, 30.0, +1, MU),
    "other friction": (2 * W, 20.0, +1, 0.6),
}


def drawn(w, base_tension, direction, friction):
    body = replaced(CYLINDER, drag=w, friction_coefficient=friction)
    return cddf.solve(body, base_tension, direction=direction, throw=False)


def by_scipy(w, base_tension, direction):
    def tension(s):
        return cylinder_tension(base_tension, direction, s, w)

    end = LENGTH
    if direction > 0:
        a = MU * d / (E * J)
        end = min(LENGTH, np.arctan(base_tension * np.sqrt(a / w)) / np.sqrt(a * w))
    return np.array([tension(LENGTH), quad(tension, 0, end, epsabs=1e-13, epsrel=1e-13)[0] * d / (E * J)])


NUMBERS = np.array([*LANES.values()])


@lru_cache
def derivatives():
    """Of tip tension and tip angle by drag and tension, in both modes, in all lanes."""

    def both(numbers):
        def observed(drag_and_tension):
            solution = drawn(*drag_and_tension, *numbers[2:])
            return jnp.stack([solution.tip_tension[0], solution.tip_angle])

        return both_modes(observed)(numbers[:2])

    return jax.jit(jax.vmap(both))(NUMBERS)


def jacobians(name):
    """Forward and reverse: a row by drag and one by tension, each of tip tension and tip angle."""
    return [modes[[*LANES].index(name)].T for modes in derivatives()[1:]]


@pytest.mark.parametrize("name", ["in", "slack", "out"])
@pytest.mark.slow
def test_derivatives_by_drag_and_tension(name):
    """Against central differences of the closed form, whose error is of the size 1e-9 of the value over the step."""
    _, tension, direction, _ = LANES[name]
    h = 1e-4
    ends = [by_scipy(W * (1 + x), tension, direction) for x in (h, -h)]
    by_w = (ends[0] - ends[1]) / (2 * h * W)
    ends = [by_scipy(W, tension * (1 + x), direction) for x in (h, -h)]
    expected = by_w, (ends[0] - ends[1]) / (2 * h * tension)
    for mode in jacobians(name):
        np.testing.assert_allclose(mode, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.slow
def test_derivatives_where_there_is_no_tension():
    """Slack from the base on nothing changes; sliding out T' = w + a T^2 starts at 0, so that T is near w s."""
    h = 1e-4 * W
    expected = (by_scipy(W + h, 0.0, -1) - by_scipy(W - h, 0.0, -1)) / (2 * h)
    both = jacobians("slack from the base"), jacobians("out from no tension")
    for slack, (by_w, by_tension) in zip(*both, strict=True):
        np.testing.assert_array_equal(slack, 0.0)
        np.testing.assert_allclose(by_w, expected, rtol=1e-6)
        assert np.all(by_tension > 0)


@pytest.mark.slow
def test_where_there_is_no_drag():
    """T = T_0 / (1 + a T_0 s); at w = 0 d(delta T)/ds = -2 a T delta T - 1, so delta T = -T^2 int ds / T^2."""
    by_w = jacobians("no drag")[0][0]
    a = MU * d / (E * J)
    z = 1 + a * 75.0 * LENGTH
    np.testing.assert_allclose(by_w[0], -(z**3 - 1) / (3 * a * 75.0) / z**2, rtol=1e-9)
    np.testing.assert_allclose(derivatives()[0][[*LANES].index("no drag"), 0], 75.0 / z, rtol=1e-12)


@pytest.mark.slow
def test_a_batch_is_a_loop():
    """Taut, slack before the tip, slack from the base, and a lane that fails; friction differs too."""
    solutions = jax.jit(jax.vmap(lambda numbers: drawn(*numbers)))(NUMBERS)
    for i, numbers in enumerate(NUMBERS):
        alone = drawn(*numbers)
        np.testing.assert_allclose(solutions.tip_tension[i], alone.tip_tension, rtol=1e-13)
        np.testing.assert_allclose(solutions.tip_position[i], alone.tip_position, rtol=1e-13)
        assert solutions.status[i] == alone.status
    assert solutions.status[[*LANES].index("fails")] == cddf.Status.unphysical


# --- energy --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_energy_of_drag_alone():
    """A cylinder with mu = 0, pulled from P = 0: slack beyond P / w until P = w L.

    With k = d^2 / (E J) the pulled length is k P^2 / (2 w) at first and grows by k L dP then, and
    U = (k / 2) int T^2 ds; what is left is the drag's work.
    """
    k, P, slack = d**2 / (E * J), 75.0, W * LENGTH
    work = k * slack**3 / (3 * W) + k * LENGTH * (P**2 - slack**2) / 2
    elastic = k / 2 * (P**3 - (P - slack) ** 3) / (3 * W)
    pull = cddf.trace(replace(CYLINDER, friction_coefficient=0.0), [P], nodes=8)
    np.testing.assert_allclose(pull.energies.work, [work], rtol=1e-11)
    np.testing.assert_allclose(pull.energies.stored_energy, [elastic], rtol=1e-11)
    np.testing.assert_allclose(pull.energies.friction_loss, [work - elastic], rtol=1e-11)


# --- refusals ------------------------------------------------------------------------------------


def test_methods_without_drag_refuse_it():
    with pytest.raises(ValueError, match="closed_form_tension holds without drag only; use solve, or drag=None"):
        cddf.closed_form_tension(EXACT, 75.0, 0.1)
    with pytest.raises(ValueError, match="has no drag; use FixedPoint, or drag=None"):
        cddf.iteration_history(EXACT, 75.0)
    with pytest.raises(ValueError, match="has no drag; use FixedPoint, or drag=None"):
        cddf.solve(PUBLISHED, 75.0, method=cddf.LiteralIteration())


def test_a_drag_must_not_push():
    body = replace(EXACT, tendons=(cddf.Tendon(d, drag=-2.0),))
    with pytest.raises(InputError, match=r"^tendon 1: drag must be 0 or more, got -2 N/m; correct its value$"):
        body.validate()
