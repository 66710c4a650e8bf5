"""Paths of displacements and of tip angles, against a closed form and against traces of their tensions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import PAPER, code, codes, paper_body

import cddf_jax as cddf

BODY = paper_body("exact")
TOP = float(cddf.solve(BODY, 75.0).tendon_displacement[0])
PATH = [75.0, 40.0, 60.0, 50.0, 30.0, 80.0, 10.0]


@pytest.mark.slow
def test_a_little_back_from_a_pull():
    """The closed form with the front inside: y_b/y_0 = (2 - K + 2 sqrt(1 - K)) / K, K = exp(mu phi) y_0 / (y_0 + g).

    Then further back than the tendon can push, and pulled in again: it is slack meanwhile, and loses nothing.
    """
    path = [TOP, TOP - 1e-4, TOP - 5e-4, TOP - 2e-3, -1e-3, -2e-3, 3e-3]
    history = cddf.trace(BODY, cddf.Displacement(path))
    np.testing.assert_allclose(history.base_tension[:4], [75, 65.879540, 56.100971, 41.836412], atol=6e-7)
    np.testing.assert_array_equal(history.base_tension[4:6], 0.0)
    slack = code(cddf.RESULTS.slack)
    assert codes(history.result) == [0, 0, 0, 0, slack, slack, 0]
    np.testing.assert_allclose(history.tendon_displacement, [*path[:4], 0, 0, 3e-3], atol=1e-15)
    np.testing.assert_allclose(history.base_tension[6], cddf.solve(BODY, cddf.Displacement(3e-3)).base_tension[0])


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{}, {"drag": 5.0}, {"tendon_offset": (0.012, 0.008)}, {"kinematics": "published"}])
@pytest.mark.parametrize("target", [cddf.Displacement, cddf.TipAngle])
def test_the_way_back_from_what_a_trace_gives(changes, target):
    """Loops that close, and a start in the middle of them."""
    body = paper_body(**{"kinematics": "exact", **changes})
    history = cddf.trace(body, PATH)
    values = history.tip_angle if target is cddf.TipAngle else history.tendon_displacement
    found = cddf.trace(body, target(values))
    np.testing.assert_allclose(found.base_tension, PATH, rtol=1e-10)
    np.testing.assert_array_equal(found.num_turns, history.num_turns)
    on = cddf.trace(body, target(values[4:]), start=cddf.trace(body, PATH[:4]))
    np.testing.assert_allclose(on.base_tension, PATH[4:], rtol=1e-10)


@pytest.mark.slow
def test_derivatives_are_those_of_the_inverse():
    """dT/dx against the inverse of dx/dT; by mu against differences."""
    path = jnp.array([75.0, 60.0, 30.0, 45.0])
    values = cddf.trace(BODY, path).tendon_displacement

    def tension(values, mu):
        body = paper_body("exact", friction_coefficient=mu)
        return cddf.trace(body, cddf.Displacement(values), throw=False).base_tension

    mu = PAPER["friction_coefficient"]
    forward, reverse = (jax.jit(mode(tension, (0, 1)))(values, mu) for mode in (jax.jacfwd, jax.jacrev))
    for a, b in zip(forward, reverse, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)
    inverse = jax.jacfwd(lambda path: cddf.trace(BODY, path, throw=False).tendon_displacement)(path)
    np.testing.assert_allclose(forward[0] @ inverse, np.eye(4), atol=1e-9)
    step = 1e-6
    difference = (tension(values, mu + step) - tension(values, mu - step)) / (2 * step)
    np.testing.assert_allclose(forward[1], difference, rtol=1e-6)
    lanes = jax.vmap(tension, (None, 0))(values, jnp.array([mu, 0.3]))
    np.testing.assert_allclose(lanes[0], path, rtol=1e-10)


@pytest.mark.slow
def test_what_cannot_be_reached_is_an_error():
    with pytest.raises(cddf.SolveError, match="No base tension between slack"):
        cddf.trace(BODY, cddf.TipAngle([1e3]))


def test_what_came_before():
    whole = cddf.trace(BODY, [75.0, 40.0, 50.0])
    found = cddf.trace(BODY, [40.0, 50.0], before=75.0)
    for name in ("tip_tension", "tip_angle", "front", "num_turns"):
        np.testing.assert_allclose(getattr(found, name), getattr(whole, name)[1:], rtol=1e-13)
    with pytest.raises(ValueError, match='before must be "rest" or the largest base tension, N, got'):
        cddf.trace(BODY, [40.0], before="full")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="before and start both give the history"):
        cddf.trace(BODY, [40.0], before=75.0, start=whole)
    with pytest.raises(ValueError, match=r"displacement must be a list of lengths, m, .* shape \(\)"):
        cddf.trace(BODY, cddf.Displacement(0.01))


@pytest.mark.slow
def test_derivative_by_what_came_before():
    """Mu phi = ln[y (y_0 + g) / ((y + y_0) / 2)^2] with y_0 = 1/T of what came before; without g in its derivative."""
    mu, y, y0 = PAPER["friction_coefficient"], 1 / 60.0, 1 / 75.0
    g = 1 / float(cddf.solve(BODY, 75.0).tip_tension[0]) - y0
    slope = jax.grad(lambda before: cddf.trace(BODY, [60.0], before=before).tip_angle[0])(75.0)
    np.testing.assert_allclose(slope, (1 / (y0 + g) - 2 / (y + y0)) / mu * -(y0**2), rtol=1e-9)
