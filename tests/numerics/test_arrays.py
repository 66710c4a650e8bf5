"""Cosine and sine against NumPy's, and their derivatives against the closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cddf_jax.numerics.arrays import cos_sin

ANGLES = np.concatenate([
    np.linspace(-40.0, 40.0, 100_001),
    np.pi / 4 * np.arange(-40, 41),  # where the quadrants meet
    np.random.default_rng(1).uniform(-1e3, 1e3, 100_000),
    [0.0, -0.0, 1e-30],
])  # fmt: skip


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_to_the_last_bit_but_one(dtype):
    angle = ANGLES.astype(dtype)
    found = jax.jit(cos_sin)(angle)
    for x, function in zip(found, (np.cos, np.sin), strict=True):
        assert x.dtype == dtype
        np.testing.assert_allclose(x, function(angle.astype("longdouble")), rtol=0, atol=1.2 * np.finfo(dtype).eps)
    # near the zeros of the sine the error is relative
    small = np.abs(angle) < 1.0
    np.testing.assert_allclose(found[1][small], np.sin(angle[small].astype("longdouble")), rtol=2 * np.finfo(dtype).eps)


def test_nan_and_infinity_give_nan():
    for x in cos_sin(jnp.asarray([np.nan, np.inf, -np.inf])):
        assert np.all(np.isnan(x))


@pytest.mark.parametrize("differentiate", [jax.jacfwd, jax.jacrev])
def test_derivatives_of_every_order(differentiate):
    cosine, sine = lambda x: cos_sin(x)[0], lambda x: cos_sin(x)[1]
    for angle in (0.3, 2.0, -4.0, np.pi / 2):
        assert differentiate(cosine)(angle) == pytest.approx(-np.sin(angle), abs=3e-16)
        assert differentiate(sine)(angle) == pytest.approx(np.cos(angle), abs=3e-16)
        assert jax.grad(differentiate(differentiate(sine)))(angle) == pytest.approx(-np.cos(angle), abs=3e-16)
