"""Forward derivatives by central differences, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np

from cddf_jax.history.differences import with_differences


def power(given):
    """A power of the fraction x - floor(x), whose derivative with respect to x JAX takes for zero."""
    x, exponent = given
    return jax.lax.stop_gradient(x - jnp.floor(x)) ** exponent


def test_slopes_of_numbers_of_very_different_sizes():
    """d(x^n) = n x^(n-1) dx + x^n ln(x) dn, with x about 1e6 and n about 0.5."""

    def of(x, n):
        return with_differences(lambda given: given[0] ** given[1], (x, n))

    x, n = jnp.array([2e6, 1e6]), jnp.asarray(0.5)
    value, slope = jax.jvp(of, (x, n), (jnp.array([1e3, 0.0]), jnp.asarray(0.0)))
    np.testing.assert_allclose(value, np.sqrt([2e6, 1e6]))
    np.testing.assert_allclose(slope, [0.5 / np.sqrt(2e6) * 1e3, 0.0], rtol=1e-7)
    jacobian = jax.jit(jax.jacfwd(of, argnums=1))(x, n)
    np.testing.assert_allclose(jacobian, np.sqrt(x) * np.log(x), rtol=1e-6)
    assert not np.any(jax.jvp(of, (x, n), (jnp.zeros(2), jnp.asarray(0.0)))[1])


def test_a_derivative_that_jax_takes_for_zero():
    """The fraction of x, squared: a slope of 2 (x - floor x), which JAX takes for zero."""
    given = jnp.asarray(3.25), jnp.asarray(2.0)
    blind = jax.jacfwd(lambda x: power((x, given[1])))(given[0])
    seen = jax.jacfwd(lambda x: with_differences(power, (x, given[1])))(given[0])
    assert blind == 0.0
    np.testing.assert_allclose(seen, 0.5, rtol=1e-6)


def test_lanes_and_shapes():
    """Under vmap, and of a tree."""

    def of(x):
        return with_differences(lambda given: {"square": given**2, "sum": jnp.sum(given)}, x)

    found = jax.vmap(jax.jacfwd(of))(jnp.array([[1.0, 2.0], [3.0, 0.0]]))
    np.testing.assert_allclose(found["square"], [np.diag([2.0, 4.0]), np.diag([6.0, 0.0])], atol=1e-7)
    np.testing.assert_allclose(found["sum"], np.ones((2, 2)), rtol=1e-7)
