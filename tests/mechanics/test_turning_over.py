"""Where curvature or a tendon's turning changes sign, nothing is lost (see loaded_bodies.py)."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import PAPER, PlainBody, both_modes, codes, paper_body, paper_plain, paper_with
from loaded_bodies import PlainLoads, largest_difference, loaded_reference
from scipy.integrate import quad

import cddf_jax as cddf

LENGTH = PAPER["length"]
AGREES = 1e-7  # what `solve` promises of the length; the reference has a relative tolerance of 1e-11 per step
TIP = 1e-8  # what it promises of the tip tension
KINEMATICS = ["published", "exact"]


class Offset(eqx.Module):
    """An offset, m, from base to tip that bulges in between: of JAX's arrays, and of plain numbers for SciPy."""

    base: Any
    tip: Any
    rise: Any = 0.0

    def __call__(self, s):
        x = s / LENGTH
        return self.base + (self.tip - self.base) * x + 4 * self.rise * x * (1 - x)

    def slope(self, s):
        return (self.tip - self.base + 4 * self.rise * (1 - 2 * s / LENGTH)) / LENGTH


def manipulator(kinematics, *offsets, friction=0.42, youngs_modulus=1.4e6):
    tendons = tuple(
        cddf.Tendon(jax.tree.map(jnp.asarray, offset), side)  # one compiled program for all of these bodies
        for offset, side in zip(offsets, (+1, -1), strict=False)
    )
    numbers = {"friction_coefficient": friction, "youngs_modulus": youngs_modulus}
    return paper_with(*tendons, kinematics=kinematics, **numbers)


def plain(kinematics, *offsets, friction=0.42, youngs_modulus=1.4e6) -> PlainBody:
    return paper_plain(
        kinematics,
        (+1, -1)[: len(offsets)],
        offsets=list(offsets),
        slopes=[offset.slope for offset in offsets],
        friction=[friction] * len(offsets),
        youngs_modulus=youngs_modulus,
    )


# --- two tendons against each other, no loads ----------------------------------------------------

# both pull with 60 N on opposite sides; the farther one bends the body, and which that is changes along the way
CROSSING = {
    # offsets, number of sign changes: of the curvature, and of the turning of the exact tendons
    "in the middle": ((Offset(0.012, 0.008), Offset(0.009, 0.011)), (1, 2)),
    "near the base": ((Offset(0.012, 0.008), Offset(0.0119, 0.0119)), (1, 2)),
    "near the tip": ((Offset(0.012, 0.008), Offset(0.0082, 0.0082)), (1, 2)),
    "twice": ((Offset(0.009, 0.009, 0.003), Offset(0.0105, 0.0105)), (2, 2)),
}
PULLS = (60.0, 60.0)


@lru_cache
def crossing(kinematics, case, direction):
    offsets, _ = CROSSING[case]
    solution = cddf.solve(manipulator(kinematics, *offsets), PULLS, direction=direction, throw=False)
    return solution, loaded_reference(plain(kinematics, *offsets), PULLS, direction=direction)


# both kinematics of the hardest two; the program of the exact ones takes long to compile
ANTAGONISTS = [("published", case, (+1, -1)) for case in CROSSING]
ANTAGONISTS += [("published", "in the middle", (+1, +1))]
ANTAGONISTS += [pytest.param("exact", case, (+1, -1), marks=pytest.mark.slow) for case in ("in the middle", "twice")]


@pytest.mark.parametrize(("kinematics", "case", "direction"), ANTAGONISTS, ids=str)
def test_antagonists_of_changing_advantage(kinematics, case, direction):
    """The exact tendons, slanted, turn over at places of their own on either side of where the body does."""
    solution, reference = crossing(kinematics, case, direction)
    assert len(reference.turning_points) == CROSSING[case][1][KINEMATICS.index(kinematics)]
    # one of the two, stated to slide in, may be drawn out
    good = cddf.Status.successful, cddf.Status.direction_contradicted
    assert codes(solution.status)[0] in good
    difference = largest_difference(solution, reference, plain(kinematics, *CROSSING[case][0]))
    assert difference < AGREES
    assert difference < max(float(solution.error_estimate), 2e-9) < 1e-5
    np.testing.assert_allclose(solution.tip_tension, reference.tip_tension, rtol=TIP)
    if kinematics == "published":
        # one shape for every case
        at = solution.at(jnp.asarray(np.resize(reference.turning_points, 2)))
        np.testing.assert_allclose(at.curvature, 0.0, atol=1e-4 * np.max(np.abs(reference.curvature)))
    along = solution.at(solution.arc_length)
    for name in ("curvature", "heading", "position", "tension", "wrap_angle", "friction_force"):
        ours, theirs = getattr(solution, name), getattr(along, name)
        np.testing.assert_allclose(ours, theirs, atol=1e-9 * np.max(np.abs(theirs)), err_msg=name)


@pytest.mark.parametrize(("pulls", "direction"), [((60.0, 62.0), (+1, -1)), ((62.0, 66.0), (-1, +1))], ids=str)
def test_parallel_antagonists_near_balance_have_no_sign_change(pulls, direction):
    """Strong friction brings their moments together but not past each other; SciPy's reference knows no elements."""
    offsets, friction = (Offset(0.010, 0.010), Offset(0.0095, 0.0095)), 2.0
    body = manipulator("exact", cddf.Constant(0.010), cddf.Constant(0.0095), friction=friction)
    solution = cddf.solve(body, pulls, direction=direction, throw=False)
    straight = replace(plain("exact", *offsets, friction=friction), slopes=None)
    reference = loaded_reference(straight, pulls, direction=direction)
    assert len(reference.turning_points) == 0
    assert largest_difference(solution, reference, straight) < AGREES
    assert solution.elements.edges.shape == (2,)  # one element, from base to tip


# --- one tendon ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_bowed_tendon_turns_over_though_the_body_does_not():
    """Exact kinematics: psi' is about kappa + d'', and d'' = -1.2 / m lies between kappa at base and tip."""
    offset = Offset(0.009, 0.009, 0.003)
    solution, reference = cddf.solve(manipulator("exact", offset), 5.0), loaded_reference(plain("exact", offset), 5.0)
    assert len(reference.turning_points) == 1
    assert np.min(reference.curvature) > 0
    assert largest_difference(solution, reference, plain("exact", offset)) < AGREES


# on the paper's body: base tension (N), loads, number of sign changes
OPPOSED = {
    "a force, before the first node": (40.0, PlainLoads((0.0, -2.9104)), 1),  # at 0.3 mm; the node lies at 0.7 mm
    "a force and a moment, near the tip": (60.0, PlainLoads((0.0, 4.7), -0.51), 1),
    "a weight": (60.0, PlainLoads(gravity=(0.0, -160.0)), 1),
    "a force, a moment and a weight, twice": (10.0, PlainLoads((0.0, 1.8), -0.12, (0.0, -40.0)), 2),
}


@pytest.mark.parametrize("case", OPPOSED)
def test_loads_against_the_tendon(case):
    tension, loads, changes = OPPOSED[case]
    body, straight = paper_body("exact", density=1070.0), paper_plain("exact")
    solution = cddf.solve(body, tension, cddf.Loads(*loads))
    reference = loaded_reference(straight, tension, loads, 1070.0, aim=1e-14)  # 1e-12 would exceed our own estimate
    assert len(reference.turning_points) == changes
    difference = largest_difference(solution, reference, straight)
    assert difference < AGREES
    assert difference < solution.error_estimate < 1e-5
    np.testing.assert_allclose(solution.tip_tension, reference.tip_tension, rtol=TIP)


# --- derivatives ---------------------------------------------------------------------------------

# tensions / 10 N, mu, E / MPa, offsets at base and tip / mm
CENTRE = np.array([6.0, 6.0, 0.42, 1.4, 12.0, 8.0, 9.0, 11.0])
SLIDING = (+1, -1)


def told_by(numbers):
    """The pulls, the offsets, and what else `manipulator` and `plain` take."""
    pulls, mu, E, (b1, t1, b2, t2) = 10 * numbers[:2], numbers[2], numbers[3], 1e-3 * numbers[4:]
    return pulls, (Offset(b1, t1), Offset(b2, t2)), {"friction": mu, "youngs_modulus": 1e6 * E}


def tip_of(kinematics):
    def tip(numbers):
        pulls, offsets, others = told_by(numbers)
        solution = cddf.solve(manipulator(kinematics, *offsets, **others), pulls, direction=SLIDING, throw=False)
        return jnp.concatenate([solution.tip_tension / 10, 10 * solution.tip_position, solution.tip_angle[None]])

    return tip


def reference_tip(kinematics, numbers):
    pulls, offsets, others = told_by(numbers)
    found = loaded_reference(plain(kinematics, *offsets, **others), pulls, direction=SLIDING)
    return np.concatenate([found.tip_tension / 10, 10 * found.tip_position, [found.tip_angle]])


derivatives = both_modes(tip_of("published"))


@pytest.mark.slow
def test_derivatives_across_a_sign_change():
    """Forward and reverse against central differences of the reference: h^2 and its 1e-11 over h leave 1e-6."""
    _, forward, reverse = derivatives(CENTRE)
    h = 1e-4
    for i, step in enumerate(h * np.eye(CENTRE.size)):
        ends = [reference_tip("published", CENTRE + sign * step) for sign in (+1, -1)]
        np.testing.assert_allclose(forward[:, i], (ends[0] - ends[1]) / (2 * h), atol=1e-6, err_msg=str(i))
    np.testing.assert_allclose(reverse, forward, atol=1e-9)


@pytest.mark.slow
def test_derivatives_where_each_tendon_turns_over_by_itself():
    """In the exact kinematics, along two directions, in reverse mode, which differentiates what forward mode makes."""
    rng = np.random.default_rng(5)
    directions, h = rng.normal(size=(2, CENTRE.size)) * CENTRE / 10, 1e-4
    slopes = directions @ np.array(jax.jit(jax.jacrev(tip_of("exact")))(CENTRE)).T
    for ours, v in zip(slopes, directions, strict=True):
        ends = [reference_tip("exact", CENTRE + sign * h * v) for sign in (+1, -1)]
        np.testing.assert_allclose(ours, (ends[0] - ends[1]) / (2 * h), atol=1e-6)


EVEN = np.array([6.0, 6.0, 0.42, 1.4, 10.0, 10.0, 10.0, 10.0])


def slopes_of_even_antagonists():
    """Of the first tip tension by its base tension, above and below that of the other tendon.

    One slides in, one out: with c = d / (E J + 2 T d^2), C = int c ds and T_1 = T + x, theta' = c |x -+ 2 mu T theta|
    to first order, so dT_tip,1/dx = (1 + exp(-+ 2 mu T C)) / 2 for x > 0, x < 0.
    """
    J = paper_plain().second_moment
    C = quad(lambda s: 0.010 / (1.4e6 * J(s) + 2 * 60.0 * 0.010**2), 0, LENGTH, epsrel=1e-12)[0]
    return {sign: (1 + np.exp(-sign * 2 * 0.42 * 60.0 * C)) / 2 for sign in (+1, -1)}


def test_the_kink_of_a_straight_body():
    """Friction acts on |kappa|: where kappa is 0 all along, the one-sided slopes differ.

    `solve` gives that of a curvature which turns positive: to JAX the slope of |x| at 0 is 1.
    """
    pulls, step = 10 * EVEN[:2], 1e-3
    body = manipulator("published", Offset(0.010, 0.010), Offset(0.010, 0.010))

    def tension(more):
        return float(cddf.solve(body, pulls + np.array([more, 0.0]), direction=SLIDING, throw=False).tip_tension[0])

    for sign, expected in slopes_of_even_antagonists().items():  # of first order in the step
        assert (tension(sign * step) - tension(0.0)) / (sign * step) == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
def test_the_derivative_at_the_kink_of_a_straight_body():
    """In both modes: that of a curvature which turns positive."""
    _, forward, reverse = derivatives(EVEN)
    for slopes in (forward, reverse):
        np.testing.assert_allclose(slopes[0, 0], slopes_of_even_antagonists()[+1], rtol=1e-9)
