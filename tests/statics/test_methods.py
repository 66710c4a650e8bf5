"""The methods compared with each other."""

from dataclasses import replace
from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import (
    codes,
    lane,
    one_kinematics_at_once,
    paper_body,
    paper_plain,
    stack,
    two_slanted_tendons,
)
from loaded_bodies import reference_solution
from marching import Marching

import cddf_jax as cddf
from cddf_jax.mechanics.problem import Nodal, lay_out

# --- two tendons: one along straight lines through four points, and a slanted one opposite --------

KNOTS = np.array([0.0, 0.05, 0.10, 0.14])
STRAIGHT = 0.012 - 0.003 * KNOTS / 0.14  # slanted like the other: 12 to 9 mm
KINKED = np.array([0.008, 0.012, 0.010, 0.010])
IN_OUT, IN = (+1.0, -1.0), (+1.0, +1.0)


def pair(heights=STRAIGHT, friction_coefficient=0.42):
    bent = cddf.Tendon(cddf.Piecewise.linear(KNOTS, heights))
    tendons = (bent, cddf.Tendon(cddf.Linear(0.012, 0.009, 0.14), -1))
    return replace(paper_body("exact", friction_coefficient=friction_coefficient), tendons=tendons)


# body, tensions, direction
LANES = {
    "slanted pair": (pair(), (75.0, 20.0), IN_OUT),
    "kinked": (pair(KINKED), (40.0, 10.0), IN_OUT),
    "strong friction": (pair(friction_coefficient=1.2), (150.0, 20.0), IN),
}
# seed 3: 32 pairs of tensions
RANDOM = [(pair(), pulls, IN_OUT) for pulls in np.random.default_rng(3).uniform([20.0, 0.0], [80.0, 15.0], (32, 2))]


@lru_cache
def lanes_by(method):
    """All of them, by one compiled program for each method."""
    bodies, tensions, directions = zip(*LANES.values(), *RANDOM, strict=True)

    def solve(body, tension, direction):
        return cddf.solve(body, tension, direction=direction, method=method, throw=False)

    return jax.jit(jax.vmap(solve))(stack(bodies), jnp.asarray(tensions), jnp.asarray(directions))


MARCHING = Marching(steps=8)
ALONE = {"published": (paper_body("published"), 75.0, +1), "exact, out": (paper_body("exact"), 30.0, -1)}


def solved(case, method):
    if case in LANES:
        return lane(lanes_by(method), list(LANES).index(case))
    body, tension, direction = ALONE[case]
    return cddf.solve(body, tension, direction=direction, method=method)


@pytest.mark.parametrize(
    "case", ["published", "exact, out", *(pytest.param(c, marks=pytest.mark.slow) for c in ("slanted pair", "kinked"))]
)
def test_marching_agrees_with_the_fixed_point(case):
    fixed, marched = solved(case, cddf.FixedPoint()), solved(case, MARCHING)
    assert fixed.status in (cddf.Status.successful, cddf.Status.direction_contradicted)
    # marching: fourth order with 16 steps between neighbouring nodes, 1e-9
    np.testing.assert_allclose(marched.tip_tension, fixed.tip_tension, rtol=1e-8)
    np.testing.assert_allclose(marched.tip_position, fixed.tip_position, atol=1e-8 * 0.14)
    np.testing.assert_allclose(marched.tip_angle, fixed.tip_angle, atol=1e-8)
    np.testing.assert_allclose(marched.wrap_angle[:, -1], fixed.wrap_angle[:, -1], atol=1e-8)
    # between base and tip the fixed point has the lower order of its collocation
    np.testing.assert_allclose(marched.position, fixed.position, atol=1e-7 * 0.14)
    np.testing.assert_allclose(marched.heading, fixed.heading, atol=1e-6)
    np.testing.assert_allclose(marched.curvature, fixed.curvature, rtol=1e-6)
    np.testing.assert_allclose(marched.normal_force, fixed.normal_force, rtol=1e-5, atol=1e-3)
    assert marched.status == fixed.status


@pytest.mark.slow
@one_kinematics_at_once
def test_marching_is_of_fourth_order(kinematics):
    """Against the closed form (tension) and DOP853 (position); 4 nodes, 2 to 8 steps between them."""
    plain = paper_plain(kinematics)
    reference, tension = reference_solution(plain, 75.0), plain.closed_form(75.0, 0.14)
    errors = []
    for steps in (2, 4, 8):
        solution = cddf.solve(paper_body(kinematics), 75.0, method=Marching(steps), nodes=4, throw=False)
        miss = np.linalg.norm(solution.tip_position - reference.tip_position)
        errors.append([abs(solution.tip_tension[0] - tension) / tension, miss / 0.14])
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 4.0, atol=0.3)


@pytest.mark.slow
def test_marching_estimates_its_own_error():
    plain = paper_plain()
    solution = cddf.solve(paper_body("published"), 75.0, method=Marching(steps=1), nodes=8)
    error = abs(solution.tip_tension[0] / plain.closed_form(75.0, 0.14) - 1)
    assert error < 2 * solution.error_estimate


# whether theta' r, and with it one pass, is the same from every guess: worked out by hand in `Problem.is_quadrature`
SLANTED = (cddf.Tendon(cddf.Linear(0.012, 0.009, 0.14)),)
PARALLEL = paper_body("exact")
DRAGGED = replace(PARALLEL, drag=10.0)
SWEPT = {
    "published": (paper_body("published"), None, True),
    "published, slanted": (replace(paper_body("published"), tendons=SLANTED), None, True),
    "exact": (PARALLEL, None, True),
    "exact, slanted": (replace(PARALLEL, tendons=SLANTED), None, False),
    "two tendons": (replace(PARALLEL, tendons=(*PARALLEL.tendons, cddf.Tendon(0.008, -1))), None, False),
    "drag": (DRAGGED, None, False),
    "tip force": (PARALLEL, cddf.Loads(tip_force=(0.0, 1.0)), False),
}


@pytest.mark.parametrize("case", SWEPT)
def test_one_pass_is_enough_where_its_result_does_not_depend_on_the_guess(case):
    body, loads, expected = SWEPT[case]
    tension = jnp.linspace(75.0, 40.0, body.num_tendons)
    problem = eqx.filter_jit(lay_out)(body, tension, jnp.ones_like(tension), 16, loads)
    shape = problem.nodes.offset.shape
    ratios = jnp.stack([jnp.ones(shape), jnp.asarray(np.random.default_rng(5).uniform(0.5, 3.0, shape))])
    guesses = Nodal(ratios, None if loads is None else jnp.ones((2, *shape[:2])))
    ends = jax.jit(jax.vmap(lambda guess: cddf.FixedPoint().improve(problem, guess).tip.ratio))(guesses)
    assert problem.is_quadrature == expected
    assert bool(jnp.max(jnp.abs(ends[0] / ends[1] - 1)) < 1e-14) == expected
    if expected:
        solution = cddf.solve(body, tension)
        assert solution.num_iterations == 1
        np.testing.assert_allclose(solution.tip_tension, tension / ends[0], rtol=1e-14)


@pytest.mark.parametrize("same", [True, False])
def test_parallel_tendons_in_space_with_the_same_friction_need_no_passes(same):
    """By hand: |M| r is then the moment of the base tensions. A pass from any solution changes nothing."""
    offset, frictions = PARALLEL.tendons[0].offset, (0.3, 0.3, 0.3) if same else (0.3, 0.2, 0.4)
    ends = (None, 0.08, None)
    tendons = [
        cddf.Tendon(offset, angle=2.0 * i, end=end, friction_coefficient=mu)
        for i, (end, mu) in enumerate(zip(ends, frictions, strict=True))
    ]
    body, tension = replace(PARALLEL, tendons=tuple(tendons)), jnp.asarray([40.0, 30.0, 5.0])
    problem = eqx.filter_jit(lay_out)(body, tension, jnp.ones(3), 16)
    found = eqx.filter_jit(cddf.FixedPoint())(problem)
    again = eqx.filter_jit(cddf.FixedPoint().improve)(problem, Nodal(found.nodes.ratio, None))
    assert found.converged
    assert (found.num_iterations == 0) == same
    np.testing.assert_allclose(again.nodes.ratio, found.nodes.ratio, rtol=1e-12)


@pytest.mark.parametrize(("direction", "friction", "expected"), [(+1, 1e200, "not_converged"), (-1, 2.0, "locked")])
def test_one_pass_without_a_solution_is_reported(direction, friction, expected):
    """The ratio overflows, or falls below zero; the lane beside them is that of a solve alone, slopes and all."""
    modulus = jnp.asarray([1e-200 if expected == "not_converged" else 1e5, 1.4e6])

    def tension(friction, modulus):
        body = replace(PARALLEL, friction_coefficient=friction, youngs_modulus=modulus)
        solution = cddf.solve(body, 75.0, direction=direction, throw=False)
        return solution.tip_tension[0], solution.status

    with_slope = jax.jit(jax.vmap(jax.value_and_grad(tension, has_aux=True)))
    (tensions, results), slopes = with_slope(jnp.asarray([friction, 0.1]), modulus)
    assert codes(results)[0] == cddf.Status[expected]
    assert np.isnan(tensions[0])
    assert slopes[0] == 0.0
    (alone, _), slope = with_slope(jnp.full(2, 0.1), jnp.full(2, 1.4e6))
    np.testing.assert_allclose([tensions[1], slopes[1]], [alone[1], slope[1]], rtol=1e-12)


@pytest.mark.slow
def test_few_passes_settle_strong_friction():
    """The errors of passes over the whole body fall like c^n / n!, docs/theory.md (16).

    A slanted pair with 80 % loss: c = -ln(1 - 0.8) = 1.6, and c^n / n! is 1e-12 at n = 18.
    """
    solution = solved("strong friction", cddf.FixedPoint())
    assert solution.tension_loss[0] > 0.7
    assert solution.num_iterations < 18


@pytest.mark.slow
def test_few_passes_settle_strong_friction_in_one_panel():
    """The same law for a pair of plain offsets: 77 % loss, c = 1.46, and c^n / n! is 1e-12 at n = 18."""
    solution = cddf.solve(two_slanted_tendons(friction_coefficient=1.2), (150.0, 20.0), direction=+1, throw=False)
    assert solution.tension_loss[0] > 0.7
    assert solution.num_iterations < 16


HASTY = cddf.FixedPoint(tolerance=1e-4, max_iterations=4)  # enough for the body with drag only


@pytest.mark.slow
def test_too_few_passes_are_reported():
    body, tension, direction = LANES["slanted pair"]
    solution = cddf.solve(body, tension, direction=direction, method=HASTY, throw=False)
    assert solution.status == cddf.Status.not_converged
    assert np.all(np.isnan(solution.tip_tension))
    with pytest.raises(cddf.SolveError, match=r"did not settle\. Raise nodes= or max_iterations"):
        cddf.solve(body, tension, direction=direction, method=HASTY)


def test_a_looser_tolerance_takes_fewer_passes():
    loose, tight = (cddf.solve(DRAGGED, 75.0, method=method) for method in (HASTY, cddf.FixedPoint()))
    assert loose.num_iterations < tight.num_iterations
    np.testing.assert_allclose(loose.tip_tension, tight.tip_tension, rtol=1e-3)


def test_literal_iteration_refuses_finite_turns():
    with pytest.raises(ValueError, match="LiteralIteration is not possible for tendons that turn by a finite angle"):
        cddf.solve(pair(KINKED), (40.0, 10.0), method=cddf.LiteralIteration())


@pytest.mark.parametrize("kinematics", ["published", "exact"])
@pytest.mark.parametrize(
    "method", [cddf.FixedPoint(), pytest.param(Marching(), marks=pytest.mark.slow)], ids=lambda m: type(m).__name__
)
def test_a_locking_tendon_is_reported_as_such(method, kinematics):
    """Sliding out, the closed form of docs/theory.md (16) reads T_base / (1 - (mu/E) T_base G): no tip beyond 1."""
    limit = 1.4e6 / 0.42 / 2.942783188998e4
    body = paper_body(kinematics)
    solve = jax.jit(jax.vmap(lambda t: cddf.solve(body, t, direction=-1, method=method, throw=False).status))
    factors = jnp.array([1.01, 1.05, 1.2, 1.5, 2.0, 3.0, 10.0, 100.0])
    assert codes(solve(factors * limit)) == [cddf.Status.locked] * 8
    assert cddf.Status.locked not in codes(solve(jnp.linspace(0.1, 0.9, 8) * limit))


@pytest.mark.slow
def test_methods_agree_over_random_tensions():
    fixed, marched = (
        jax.tree.map(lambda x: x[len(LANES) :], lanes_by(method)) for method in (cddf.FixedPoint(), MARCHING)
    )
    np.testing.assert_allclose(fixed.tip_tension, marched.tip_tension, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(1e3 * fixed.tip_position, 1e3 * marched.tip_position, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(fixed.tendon_displacement, marched.tendon_displacement, rtol=1e-6, atol=1e-7)
