"""Panels: integrals and polynomials against closed forms, at the nodes of the panels and of others."""

import jax.numpy as jnp
import numpy as np
from numpy.polynomial import Polynomial
from numpy.testing import assert_allclose

from cddf_jax.numerics.quadrature import Panels, of_rows, rows_of

OLD = Panels.between(jnp.array([0.0, 0.3, 0.3, 1.0]), 6)  # the one in the middle is empty
NEW = Panels.between(jnp.array([0.0, 0.5, 0.8, 1.0]), 6)
CURVE = Polynomial([0.3, -2.0, 1.0, 4.0, -1.0, 0.5])  # of degree 5, exact on 6 nodes


def test_integrals_at_nodes_and_edges_are_those_of_the_polynomial():
    edges, nodes = OLD.integrate(jnp.stack([CURVE(OLD.nodes), 2 * CURVE(OLD.nodes)], axis=-1))
    assert_allclose(edges, np.stack([CURVE.integ()(OLD.edges), 2 * CURVE.integ()(OLD.edges)], axis=-1), atol=1e-14)
    assert_allclose(nodes[..., 1], 2 * CURVE.integ()(OLD.nodes), atol=1e-14)


def test_the_rate_of_an_integral_is_the_polynomial():
    """In an empty panel the integral does not change, and its rate is given as zero."""
    edges, nodes = OLD.integrate(CURVE(OLD.nodes))
    expected = np.where(OLD.width[:, None] > 0, CURVE(OLD.nodes), 0.0)
    assert_allclose(OLD.rate(edges[:-1], nodes), expected, atol=1e-12)


def test_values_on_other_panels_are_those_of_the_polynomial():
    weights = OLD.weights_on(NEW)
    assert_allclose(weights @ CURVE(OLD.nodes).ravel(), CURVE(NEW.nodes).ravel(), rtol=1e-13)
    assert_allclose(OLD.weights_on(OLD) @ CURVE(OLD.nodes).ravel(), CURVE(OLD.nodes).ravel(), rtol=1e-14)


def test_the_rule_of_the_check_finds_what_the_nodes_miss():
    """Cos(9 x) from 0 to 1 by 6 nodes and by 9: the difference is the error of the first to 1e-9 of it or better."""
    panel = Panels.between(jnp.array([0.0, 1.0]), 6)
    places, weights = panel.check_rule
    missed = np.sin(9.0) / 9 - panel.gain(jnp.cos(9 * panel.nodes))[0]
    assert abs(missed) > 1e-7
    assert_allclose(np.cos(9 * places) @ weights, missed, rtol=1e-4)


def test_rows_keep_every_number():
    numbers = jnp.arange(2.0 * 3 * 4 * 5 * 6).reshape(2, 3, 4, 5, 6)
    rows = rows_of(numbers, 1)
    assert rows.shape == (60, 3, 4)
    assert_allclose(rows[0], numbers[0, :, :, 0, 0])
    assert_allclose(rows[-1], numbers[1, :, :, -1, -1])
    assert_allclose(of_rows(rows, numbers, 1), numbers)


def test_integrals_together_are_those_of_each():
    cut, at = OLD, OLD.nodes
    rates = {"number": CURVE(at), "vector": jnp.stack([at, at**2, jnp.cos(at)], axis=-1), "none": None}
    edges, nodes = cut.integrate_together(rates)
    for name in ("number", "vector"):
        at_edges, at_nodes = cut.integrate(rates[name])
        assert_allclose(edges[name], at_edges, rtol=1e-15, atol=1e-16)
        assert_allclose(nodes[name], at_nodes, rtol=1e-15, atol=1e-16)


def test_neighbours_of_the_nodes():
    """By hand: two nodes lie 1 / (2 sqrt(3)) of the width from the middle; beyond the ends are their mirrors."""
    off = 1 / (2 * 3**0.5)
    before, after = Panels.between(jnp.array([0.0, 1.0, 3.0]), 2).neighbours
    assert_allclose(before, [[off - 0.5, 0.5 - off], [1 + 2 * (off - 0.5), 1 + 2 * (0.5 - off)]], rtol=1e-14)
    assert_allclose(after, [[0.5 + off, 1.5 - off], [1 + 2 * (0.5 + off), 1 + 2 * (1.5 - off)]], rtol=1e-14)
