"""Profiles along the arc length."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import cddf_jax as cddf
from cddf_jax.robot.profiles import FEW, breakpoints

KNOTS = np.array([0.0, 0.01, 0.035, 0.05, 0.09, 0.11, 0.14])
HEIGHTS = np.array([0.010, 0.012, 0.009, 0.0085, 0.011, 0.008, 0.0075])
ROUNDING = 1e-12  # a few hundred operations in float64


def test_constant_takes_the_shape_of_its_argument_and_linear_is_a_straight_line():
    assert cddf.Constant(0.3)(0.1).shape == ()
    np.testing.assert_array_equal(cddf.Constant(0.3)(np.zeros((2, 3))), np.full((2, 3), 0.3))
    s = np.linspace(0, 0.14, 9)
    np.testing.assert_allclose(cddf.Linear(0.02, 0.013, 0.14)(s), np.linspace(0.02, 0.013, 9), rtol=ROUNDING)


def test_spline_and_its_derivatives_are_those_of_scipy():
    """On a grid that goes beyond the ends, at the knots, and just to the right of them."""
    s = np.concatenate([np.linspace(-0.01, 0.15, 57), KNOTS, KNOTS[1:-1] + 1e-9])
    ours, scipys = cddf.Spline(KNOTS, HEIGHTS), CubicSpline(KNOTS, HEIGHTS, bc_type="not-a-knot")
    orders = jax.jit(jax.vmap(lambda s: [ours(s), jax.grad(ours)(s), jax.grad(jax.grad(ours))(s)]))
    for order, found in enumerate(orders(s)):  # each derivative divides by a knot distance of 0.01 m
        np.testing.assert_allclose(found, scipys(s, order), rtol=1e-10, atol=ROUNDING * 100**order)


def test_a_plain_function_holds_no_numbers_and_serves_jax_as_any_profile():
    """So that a body is a pytree of numbers; the expected tensions are those of the same line as a `Linear`."""

    def radius(s):
        return 0.020 - 0.05 * s

    def body(outer_radius):
        return cddf.Manipulator(0.14, outer_radius, 0.007, (cddf.Tendon(0.010),), 1.4e6, 0.42)

    told = body(radius)
    assert jax.tree.leaves(told.outer_radius) == []
    assert told.outer_radius(0.05) == radius(0.05)
    assert breakpoints(told.outer_radius).size == 0
    both = jax.tree.map(lambda x: np.stack([x, x]), told)
    tips = jax.jit(jax.vmap(lambda body: cddf.solve(body, 50.0).tip_tension))(both)
    expected = cddf.solve(body(cddf.Linear(0.020, 0.013, 0.14)), 50.0).tip_tension
    np.testing.assert_allclose(tips, [expected, expected], rtol=1e-13)
    wrong = eqx.tree_at(lambda body: body.outer_radius, told, radius)
    with pytest.raises(TypeError, match=r"solve: <function .* stands where a body has numbers; give the function to"):
        cddf.solve(wrong, 50.0)


@pytest.mark.parametrize(("s", "v"), [(KNOTS[:3], HEIGHTS[:3]), (KNOTS, HEIGHTS[:-1])])
def test_too_few_points_or_lists_of_different_length_are_refused(s, v):
    with pytest.raises(ValueError, match=r"Spline: arc_length and values .* 4 or more, got shapes"):
        cddf.Spline(s, v)
    with pytest.raises(ValueError, match=r"Piecewise\.linear: .* got shapes \(3,\) and \(2,\)"):
        cddf.Piecewise.linear([0.0, 0.1, 0.2], [1.0, 2.0])


def test_piecewise_changes_at_its_ends_and_the_next_piece_holds_there():
    step = cddf.Piecewise([0.04, 0.1], [cddf.Constant(1.0), cddf.Linear(2.0, 4.0, 0.14), cddf.Constant(3.0)])
    s = np.array([0.0, 0.0399, 0.04, 0.07, 0.0999, 0.1, 0.14])
    expected = [1, 1, 2 + 2 * 0.04 / 0.14, 3, 2 + 2 * 0.0999 / 0.14, 3, 3]  # by hand
    np.testing.assert_allclose(step(s), expected, rtol=ROUNDING)
    np.testing.assert_allclose([step(x) for x in s], expected, rtol=ROUNDING)
    assert step(s.reshape(7, 1)).shape == (7, 1)


@pytest.mark.parametrize("knots", [KNOTS, np.linspace(0, 0.14, FEW + 20)])  # more than are compared with one by one
def test_piecewise_linear_is_that_of_numpy(knots):
    s, heights = np.linspace(0, 0.14, 301), 0.01 + 0.001 * np.cos(5.0 * np.arange(knots.size))
    line = cddf.Piecewise.linear(knots, heights)
    np.testing.assert_allclose(line(s), np.interp(s, knots, heights), rtol=ROUNDING)
    np.testing.assert_array_equal(breakpoints(line), knots[1:-1])
    # the slope at a joint is that of the line behind it
    np.testing.assert_allclose(
        jax.jit(jax.vmap(jax.grad(line)))(knots[:-1]), np.diff(heights) / np.diff(knots), rtol=1e-9
    )


def test_breaks_are_where_the_third_derivative_of_a_spline_jumps_and_pieces_meet():
    spline = cddf.Spline(KNOTS, HEIGHTS)
    np.testing.assert_array_equal(breakpoints(spline), KNOTS[2:-2])
    nested = cddf.Piecewise([0.07], [spline, cddf.Constant(0.01)])
    np.testing.assert_allclose(np.sort(breakpoints(nested)), np.sort([*KNOTS[2:-2], 0.07]))
    for profile in (cddf.Constant(1.0), cddf.Linear(1.0, 2.0, 3.0), jnp.sin):
        assert breakpoints(profile).shape == (0,)


@pytest.mark.parametrize("kind", [cddf.Spline, cddf.Piecewise.linear])
def test_knots_that_do_not_increase_are_refused(kind):
    with pytest.raises(ValueError, match=r"arc_length must increase, got \[0.0, 0.1, 0.05, 0.14\] m; sort them"):
        kind([0.0, 0.1, 0.05, 0.14], HEIGHTS[:4])


@pytest.mark.parametrize(
    ("ends", "count", "message"),
    [
        ([0.1], 3, "3 pieces need 2 ends"),
        (0.1, 2, "2 pieces need 1 ends"),
        ([0.05, 0.1], 2, "got ends of shape"),
        ([0.1, 0.05], 3, "ends must increase"),
    ],
)
def test_piecewise_refuses_ends_that_do_not_fit_its_pieces(ends, count, message):
    with pytest.raises(ValueError, match=f"Piecewise: .*{message}"):
        cddf.Piecewise(ends, [cddf.Constant(1.0)] * count)


def test_profiles_are_trees_that_can_be_mapped_and_differentiated():
    tips = jnp.array([1.0, 2.0, 3.0])
    values = jax.vmap(lambda tip: cddf.Linear(0.0, tip, 2.0)(1.0))(tips)
    np.testing.assert_allclose(values, tips / 2, rtol=ROUNDING)
    slope = jax.grad(lambda line: line(1.0))(cddf.Linear(jnp.array(1.0), jnp.array(2.0), jnp.array(4.0)))
    # d/d(base, tip, length) of base + (tip - base) s / length at s = 1, by hand
    np.testing.assert_allclose([slope.base, slope.tip, slope.length], [3 / 4, 1 / 4, -1 / 16], rtol=ROUNDING)
