"""Elements: integrals and polynomials against closed forms and SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import Polynomial
from numpy.testing import assert_allclose
from scipy.integrate import quad

from cddf_jax.numerics.elements import (
    Elements,
    gains_of_length,
    gains_of_magnitude,
    quartics,
    sums,
)

CUT = Elements.between(jnp.array([0.0, 0.3, 0.3, 1.0]), 6)  # the one in the middle is empty
CURVE = Polynomial([0.3, -2.0, 1.0, 4.0, -1.0, 0.5])  # of degree 5, exact on 6 nodes


def test_integrals_at_nodes_and_edges_are_those_of_the_polynomial():
    edges, nodes = CUT.integrate(jnp.stack([CURVE(CUT.nodes), 2 * CURVE(CUT.nodes)], axis=-1))
    assert_allclose(edges, np.stack([CURVE.integ()(CUT.edges), 2 * CURVE.integ()(CUT.edges)], axis=-1), atol=1e-14)
    assert_allclose(nodes[..., 1], 2 * CURVE.integ()(CUT.nodes), atol=1e-14)


# --- the magnitude of what changes its sign --------------------------------------------------------

ONE = Elements.between(jnp.array([0.0, 0.2]), 8)


def integrals(function, *kinks):
    """From 0 to each node and to the end of `ONE`, by SciPy."""
    ends = [*np.asarray(ONE.nodes[0]), 0.2]
    options = {"epsabs": 1e-14, "epsrel": 1e-13, "limit": 300}
    return [quad(function, 0.0, end, points=[x for x in kinks if x < end] or None, **options)[0] for end in ends]


# between nodes, at a node, near an end, two roots, and none
CHANGING = [(lambda x, root=root: np.sin(7 * (x - root)), (root,), 2e-10) for root in (0.0003, 0.123, ONE.nodes[0, 3])]
CHANGING += [(lambda x: (x - 0.05) * (x - 0.13) * np.exp(x), (0.05, 0.13), 1e-9), (lambda x: -np.cos(x), (), 1e-14)]


@pytest.mark.parametrize(("rate", "roots", "atol"), CHANGING)
def test_the_magnitude_of_a_rate_that_changes_its_sign(rate, roots, atol):
    nodes, end = sums(ONE.width[0], gains_of_magnitude(quartics(rate(ONE.nodes[0]))))
    assert_allclose([*nodes, end], integrals(lambda x: abs(rate(x)), *roots), rtol=0, atol=atol)


def test_derivatives_of_the_magnitude_by_the_root():
    """The integral of |x - a| over [0, w] is (a^2 + (w - a)^2) / 2: slope 2 a - w and curvature 2."""

    def total(a):
        return sums(ONE.width[0], gains_of_magnitude(quartics(ONE.nodes[0] - a)))[1]

    slope, bend = jax.jit(lambda a: (jax.grad(total)(a), jax.jacfwd(jax.grad(total))(a)))(0.07)
    assert_allclose([slope, bend], [2 * 0.07 - 0.2, 2.0], rtol=1e-12)


@pytest.mark.parametrize("distance", [3.0, 0.03, 0.0])
def test_the_length_of_a_vector_that_passes_near_zero(distance):
    """From a smooth minimum to a kink."""
    place = 0.1234

    def vector(x):
        return np.stack([0.1 * distance * np.cos(x), np.sin(3 * (x - place)), (x - place) ** 2], axis=-1)

    rate = jnp.asarray(vector(ONE.nodes[0]))
    nodes, end = sums(ONE.width[0], gains_of_length(rate, quartics(rate)))
    assert_allclose([*nodes, end], integrals(lambda x: np.linalg.norm(vector(x)), place), atol=2e-10)


def test_derivatives_of_the_length_of_a_vector():
    """The integral of sqrt(a^2 + x^2) over [0, w] has the slope a asinh(w / a) by a."""

    def total(a):
        vectors = jnp.stack([jnp.full(8, a), ONE.nodes[0], jnp.zeros(8)], axis=-1)
        return sums(ONE.width[0], gains_of_length(vectors, quartics(vectors)))[1]

    slope = jax.jit(jax.grad(total))
    for a in (0.3, 0.02):
        assert_allclose(slope(a), a * np.arcsinh(0.2 / a), rtol=1e-6)
    assert np.isfinite(slope(0.0))
