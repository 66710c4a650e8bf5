"""The algorithm of the paper, section III, as a history and as a method."""

import numpy as np
import pytest
from bodies import paper_body, paper_plain, paper_with, two_slanted_tendons
from scipy.integrate import quad
from scipy.interpolate import BarycentricInterpolator

import cddf_jax as cddf

THRESHOLD = 1e-4  # e_tip,th of eq. (18): 0.1 mm


@pytest.fixture(scope="module")
def history():
    return cddf.iteration_history(paper_body("published"), 75.0, max_updates=30)


def test_five_updates_at_75_newtons(history):
    """docs/theory.md (16); the paper says "after 6 iterations", counting the start."""
    assert history.num_updates == 5
    assert history.converged
    assert history.tip_tolerance == THRESHOLD
    assert history.tip_error[4] < THRESHOLD <= history.tip_error[3]


def test_the_method_stops_where_the_history_does(history):
    solution = cddf.solve(paper_body("published"), 75.0, method=cddf.LiteralIteration(tip_tolerance=THRESHOLD))
    assert solution.num_iterations == 5
    np.testing.assert_allclose(solution.position, history.position[5], rtol=1e-12, atol=1e-15)
    # curvature goes with the tensions of the last shape: half an update on from it
    np.testing.assert_allclose(solution.curvature[1:-1], history.curvature[5], rtol=5e-3)


def test_the_first_shape_is_frictionless(history):
    """Eq. (17) with T = T_base: kappa = d T / (E J + T d^2)."""
    J = np.array([paper_plain().second_moment(s) for s in history.arc_length[1:-1]])
    np.testing.assert_allclose(history.curvature[0], 0.010 * 75 / (1.4e6 * J + 75 * 0.010**2), rtol=1e-12)


def test_each_shape_is_the_update_of_the_one_before(history):
    """Eq. (14) by parts: E J kappa_new = d T (1 - d kappa), T = T_base exp(-mu int kappa / (1 - d kappa))."""
    s = np.asarray(history.arc_length[1:-1])
    J = np.array([paper_plain().second_moment(x) for x in s])
    for k in (0, 1, 4):
        old = np.asarray(history.curvature[k])
        shape = BarycentricInterpolator(s, old)
        wrap = [quad(lambda x, f=shape: f(x) / (1 - 0.010 * f(x)), 0, end, epsrel=1e-10)[0] for end in s]
        T = 75.0 * np.exp(-0.42 * np.array(wrap))
        np.testing.assert_allclose(history.curvature[k + 1], 0.010 * T * (1 - 0.010 * old) / (1.4e6 * J), rtol=1e-7)


@pytest.mark.parametrize(
    ("body", "tension", "direction"),
    [
        (paper_body("exact"), 75.0, +1),
        pytest.param(paper_body("published", num_tendons=2), (75.0, 20.0), (+1, -1), marks=pytest.mark.slow),
        pytest.param(two_slanted_tendons("exact"), (60.0, 20.0), (+1, -1), marks=pytest.mark.slow),
    ],
    ids=["exact", "published pair", "exact slanted pair"],
)
def test_converged_it_is_the_fixed_point(body, tension, direction):
    literal = cddf.LiteralIteration(tip_tolerance=1e-13)
    ours = cddf.solve(body, tension, direction=direction, method=literal)
    fixed = cddf.solve(body, tension, direction=direction)
    # the literal map differentiates the polynomial through the nodes where a tendon is slanted
    np.testing.assert_allclose(ours.tip_tension, fixed.tip_tension, rtol=1e-7)
    np.testing.assert_allclose(ours.tip_position, fixed.tip_position, atol=1e-8)
    assert ours.num_iterations > 5


SLIPPERY = paper_body("published", friction_coefficient=0.01)  # so that T stays above E J / d^2


def test_it_diverges_where_the_tension_exceeds_the_stiffness():
    """docs/theory.md (16): it contracts if and only if T d^2 < E J everywhere. E J at the tip is 0.0288 N m^2."""
    stiffness = 1.4e6 * paper_plain().second_moment(0.14)
    tip = paper_plain(friction=[0.01]).closed_form(400.0, 0.14)
    assert tip * 0.010**2 > 1.2 * stiffness
    solution = cddf.solve(SLIPPERY, 400.0, method=cddf.LiteralIteration(max_updates=200), throw=False)
    assert solution.status == cddf.Status.not_converged
    assert np.all(np.isnan(solution.curvature))
    assert np.all(np.isnan(solution.tip_tension))
    with pytest.raises(cddf.SolveError, match="did not settle"):
        cddf.solve(SLIPPERY, 400.0, method=cddf.LiteralIteration(max_updates=200))
    assert not cddf.iteration_history(SLIPPERY, 400.0, max_updates=30).converged


def test_it_converges_just_below_that_tension():
    """T_base d^2 = 0.9 E J at the tip, where E J is least and T no larger than at the base."""
    tension = 0.9 * 1.4e6 * paper_plain().second_moment(0.14) / 0.010**2
    literal = cddf.LiteralIteration(tip_tolerance=1e-10, max_updates=400)
    assert cddf.solve(SLIPPERY, tension, method=literal).status == cddf.Status.successful


def test_literal_iteration_refuses_finite_turns():
    kinked = cddf.Tendon(cddf.Piecewise.linear([0.0, 0.05, 0.14], [0.008, 0.012, 0.010]))
    with pytest.raises(ValueError, match="LiteralIteration is not possible for tendons that turn by a finite angle"):
        cddf.solve(paper_with(kinked), 40.0, method=cddf.LiteralIteration())
    with pytest.raises(ValueError, match=r"LiteralIteration is a method without loads; use FixedPoint\(\) under loads"):
        cddf.solve(paper_body(), 40.0, cddf.Loads(), method=cddf.LiteralIteration())
    with pytest.raises(ValueError, match="LiteralIteration is a method for the plane"):
        cddf.iteration_history(paper_with(cddf.Tendon(0.010, angle=0.0)), 40.0)
    with pytest.raises(ValueError, match="a tendon cannot push"):
        cddf.iteration_history(paper_body(), -40.0)
    with pytest.raises(ValueError, match="friction_moment, outside_friction and outside_drag act along a history"):
        cddf.iteration_history(paper_with(cddf.Tendon(0.010, outside_friction=0.3)), 40.0)
    with pytest.raises(ValueError, match="max_updates must be a whole number of 1 or more"):
        cddf.iteration_history(paper_body(), 40.0, max_updates=0)
