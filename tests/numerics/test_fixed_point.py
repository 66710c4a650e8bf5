"""Derivatives of roots and fixed points, against closed forms: in both modes, of second order, in a batch."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.tree_util import Partial
from numpy.testing import assert_allclose

from cddf_jax.numerics.fixed_point import fixed_point, implicit, solve_definite, solve_small
from cddf_jax.numerics.rotations import solve_three

A = np.array([0.5, 2.0, 7.0])


def chord(a, slope, both):
    """A Newton step for 2 x^2 = a with a constant slope, and a Picard iteration for y = sqrt(x + y)."""
    x, y = both
    return x - (2.0 * x * x - a) / slope, jnp.sqrt(x + y)


def root_and_values(a):
    """X = sqrt(a / 2) and y = (1 + sqrt(1 + 4 x)) / 2, which `implicit` is given without derivatives."""
    x = jnp.sqrt(a / 2.0)
    inexact = jax.lax.stop_gradient(4.4 * x)  # a tenth too large
    return jnp.stack(implicit(Partial(chord, a, inexact), (x, (1 + jnp.sqrt(1 + 4 * x)) / 2)))


def grow(a, y):
    return jnp.sqrt(a + y)


def golden(a):
    """The fixed point y = sqrt(a + y), which is (1 + sqrt(1 + 4 a)) / 2."""
    return fixed_point(Partial(grow, a), jnp.ones_like(a), tolerance=1e-15, max_iterations=100).value


# value, slope and curvature by hand
ROOT, STEEP, BENT = np.sqrt(A / 2), 0.5 / np.sqrt(2 * A), -0.25 / np.sqrt(2) * A**-1.5
INNER = 1 + 4 * ROOT
CASES = {
    "root and fixed point": (
        root_and_values,
        np.stack([ROOT, (1 + np.sqrt(INNER)) / 2], axis=1),
        np.stack([STEEP, INNER**-0.5 * STEEP], axis=1),
        np.stack([BENT, INNER**-0.5 * BENT - 2 * INNER**-1.5 * STEEP**2], axis=1),
    ),
    "fixed point": (golden, (1 + np.sqrt(1 + 4 * A)) / 2, (1 + 4 * A) ** -0.5, -2 * (1 + 4 * A) ** -1.5),
}


@pytest.mark.parametrize(("function", "value", "slope", "bend"), CASES.values(), ids=CASES)
def test_derivatives_are_those_of_the_closed_form(function, value, slope, bend):
    modes = jax.jacfwd, jax.jacrev
    first = [derivative(function) for derivative in modes]
    second = [jax.jacrev(first[0]), jax.jacfwd(first[1])]
    found = jax.jit(jax.vmap(lambda a: [f(a) for f in (function, *first, *second)]))(A)  # compiled together
    along, ones = (lambda f: lambda a: jax.jvp(f, (a,), (ones,))[1]), jnp.ones_like(A)  # a batch inside of derivatives
    inside = jax.vmap(jax.jit(function))
    assert_allclose(found[0], value, rtol=1e-14)
    assert_allclose(found[1:3], [slope] * 2, rtol=1e-13)
    assert_allclose(found[3:], [bend] * 2, rtol=1e-12)
    assert_allclose(along(along(inside))(A), bend, rtol=1e-12)


def test_what_does_not_move_has_no_slope():
    """Two values, of which one follows a and one does not: (a, 3)."""

    def halfway(a, values):
        return {"moved": (values["moved"] + a) / 2, "still": (values["still"] + 3.0) / 2}

    def values(a):
        start = {"moved": jnp.zeros(()), "still": jnp.zeros(())}
        return fixed_point(Partial(halfway, a), start, tolerance=1e-15, max_iterations=100).value

    for derivative in (jax.jacfwd, jax.jacrev):
        slopes = jax.jit(derivative(values))(2.0)
        assert_allclose([slopes["moved"], slopes["still"]], [1, 0], atol=1e-15)


def test_slopes_that_do_not_settle_show_as_nan():
    """The fixed point is v = 0.9 v + 0.1 p. After 64 iterations 1e-3 of its slope is missing."""

    def value(p):
        return implicit(Partial(lambda p, v: 0.9 * v + 0.1 * p, p), p)

    for derivative in (jax.jacfwd, jax.jacrev):
        assert np.isnan(jax.jit(derivative(value))(1.0))


@pytest.mark.parametrize("shape", [(), (2,), (3,)])
@pytest.mark.parametrize("size", [1, 3, 4])
def test_a_small_system_is_solved_as_lapack_solves_it(size, shape):
    """One right side or several; the first pivot is 0, so that rows have to change places."""
    rng = np.random.default_rng(size)
    matrix, sides = jnp.asarray(rng.normal(size=(size, size))), jnp.asarray(rng.normal(size=(size, *shape)))
    matrix = matrix.at[0, 0].set(0.0 if size > 1 else 2.0)
    assert_allclose(solve_small(matrix, sides)[0], np.linalg.solve(matrix, sides), rtol=1e-11, atol=1e-13)
    assert solve_small(jnp.ones((size, size)), sides)[1] == (1.0 if size == 1 else 0.0)  # a singular matrix


def test_three_equations_are_solved_as_lapack_solves_them():
    rng = np.random.default_rng(3)
    for _ in range(5):
        matrix, vector = jnp.asarray(rng.normal(size=(3, 3))), jnp.asarray(rng.normal(size=3))
        assert_allclose(solve_three(matrix, vector), np.linalg.solve(matrix, vector), rtol=1e-10)
        definite = matrix @ matrix.T + jnp.eye(3)
        assert_allclose(solve_definite(definite, vector), np.linalg.solve(definite, vector), rtol=1e-12)
