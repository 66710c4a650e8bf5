"""The methods are checks on one another."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import code, codes, paper_body, paper_plain, reference_solution, two_slanted_tendons

import cddf_jax as cddf

KINKED = cddf.Manipulator(
    0.14,
    cddf.Linear(0.020, 0.013, 0.14),
    0.007,
    (cddf.Tendon(cddf.Piecewise.linear([0.0, 0.05, 0.10, 0.14], [0.008, 0.012, 0.010, 0.010])),),
    1.4e6,
    0.42,
)
CASES = {
    "published": (paper_body("published"), 75.0, +1),
    "exact, out": (paper_body("exact"), 30.0, -1),
    "slanted pair": (two_slanted_tendons(), (75.0, 20.0), (+1, -1)),
    "kinked": (KINKED, 40.0, +1),
}


@pytest.mark.parametrize("case", CASES)
def test_marching_agrees_with_the_fixed_point(case):
    body, tension, direction = CASES[case]
    fixed = cddf.solve(body, tension, direction=direction)
    marched = cddf.solve(body, tension, direction=direction, method=cddf.Marching(steps=8))
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
    assert marched.result == fixed.result


@pytest.mark.parametrize("kinematics", ["published", "exact"])
def test_marching_is_of_fourth_order(kinematics):
    """Against the closed form (tension) and DOP853 (position); 4 nodes, 2 to 8 steps between them."""
    plain = paper_plain(kinematics)
    reference, tension = reference_solution(plain, 75.0), plain.closed_form(75.0, 0.14)
    errors = []
    for steps in (2, 4, 8):
        solution = cddf.solve(paper_body(kinematics), 75.0, method=cddf.Marching(steps), nodes=4, throw=False)
        miss = np.linalg.norm(solution.tip_position - reference.tip_position)
        errors.append([abs(solution.tip_tension[0] - tension) / tension, miss / 0.14])
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 4.0, atol=0.3)


def test_marching_estimates_its_own_error():
    plain = paper_plain()
    solution = cddf.solve(paper_body("published"), 75.0, method=cddf.Marching(steps=1), nodes=8)
    error = abs(solution.tip_tension[0] / plain.closed_form(75.0, 0.14) - 1)
    assert error < 2 * solution.error_estimate


def test_one_sweep_is_exact_for_one_tendon_in_the_published_kinematics():
    """design.md section 3, by the reciprocal tension: a second sweep only confirms it."""
    assert cddf.solve(paper_body("published"), 75.0).num_iterations == 2


def test_few_sweeps_settle_strong_friction():
    """The errors of the sweeps fall like c^n / n!, design.md section 3: 80 % loss, a slanted pair."""
    body = two_slanted_tendons(friction_coefficient=1.2)
    solution = cddf.solve(body, (150.0, 20.0), nodes=32, throw=False)
    assert solution.tension_loss[0] > 0.7
    assert solution.num_iterations < 25


def test_too_few_sweeps_are_reported():
    body = two_slanted_tendons()
    method = cddf.FixedPoint(max_sweeps=2)
    solution = cddf.solve(body, (75.0, 20.0), direction=(+1, -1), method=method, throw=False)
    assert solution.result == cddf.RESULTS.not_converged
    assert np.all(np.isnan(solution.tip_tension))
    with pytest.raises(cddf.SolveError, match=r"did not settle\. Raise nodes= or max_sweeps"):
        cddf.solve(body, (75.0, 20.0), direction=(+1, -1), method=method)


def test_a_looser_tolerance_takes_fewer_sweeps():
    body, arguments = two_slanted_tendons(), {"base_tension": (75.0, 20.0), "direction": (+1, -1)}
    loose = cddf.solve(body, **arguments, method=cddf.FixedPoint(tolerance=1e-4))
    tight = cddf.solve(body, **arguments)
    assert loose.num_iterations < tight.num_iterations
    np.testing.assert_allclose(loose.tip_tension, tight.tip_tension, rtol=1e-3)


def test_literal_iteration_refuses_finite_turns():
    with pytest.raises(ValueError, match="LiteralIteration does not know tendons that turn by a finite angle"):
        cddf.solve(KINKED, 40.0, method=cddf.LiteralIteration())


@pytest.mark.parametrize("kinematics", ["published", "exact"])
@pytest.mark.parametrize("method", [cddf.FixedPoint(), cddf.Marching()], ids=lambda m: type(m).__name__)
def test_a_locking_tendon_is_reported_as_such(method, kinematics):
    """Sliding out, the closed form of design.md section 3 reads T_base / (1 - (mu/E) T_base G): no tip beyond 1."""
    limit = 1.4e6 / 0.42 / 2.942783188998e4
    body = paper_body(kinematics)
    solve = jax.jit(jax.vmap(lambda t: cddf.solve(body, t, direction=-1, method=method, throw=False).result))
    factors = jnp.array([1.01, 1.05, 1.2, 1.5, 2.0, 3.0, 10.0, 100.0])
    assert codes(solve(factors * limit)) == [code(cddf.RESULTS.locked)] * 8
    assert code(cddf.RESULTS.locked) not in codes(solve(jnp.linspace(0.1, 0.9, 8) * limit))


def test_methods_agree_over_random_tensions():
    """Seed 3: 32 pairs of tensions, one lane each."""
    rng = np.random.default_rng(3)
    tensions = jnp.asarray(rng.uniform([20.0, 0.0], [80.0, 15.0], (32, 2)))
    body = two_slanted_tendons()

    def tips(method):
        def tip(tension):
            solution = cddf.solve(body, tension, direction=(+1, -1), method=method, throw=False)
            return solution.tip_tension, 1e3 * solution.tip_position, solution.tendon_displacement

        return jax.jit(jax.vmap(tip))(tensions)

    for a, b in zip(tips(cddf.FixedPoint()), tips(cddf.Marching()), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-7)
