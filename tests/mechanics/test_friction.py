"""All functions of the friction law state the same law: T' of `tension_rate` is that of T = (T_base - c) / r."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cddf_jax as cddf
from cddf_jax.mechanics.friction import (
    Pull,
    is_proportional,
    ratio_beyond,
    ratio_factor,
    spent_rate,
    tension_rate,
    unspent,
)

BASE = jnp.array([40.0, 25.0])
TURNING = jnp.array([3.0, -7.0])  # rad/m
RATIO = jnp.array([1.3, 1.1])
SPENT = jnp.array([4.0, 2.0])


def section(drag):
    tendons = [cddf.Tendon(0.01, friction_coefficient=0.3), cddf.Tendon(0.008, -1)]
    body = cddf.Manipulator(0.14, 0.015, 0.0, tendons, 1.4e6, 0.42, drag=drag)
    return body.cross_section(jnp.asarray(0.05))


@pytest.mark.parametrize("direction", [[1.0, 1.0], [1.0, -1.0]])
@pytest.mark.parametrize("drag", [None, 12.0])
def test_the_rate_of_the_tension_is_that_of_what_is_integrated(direction, drag):
    """T' by the chain rule from r' and c', which the solver integrates."""
    here, direction = section(drag), jnp.array(direction)
    pull = Pull(RATIO, None if drag is None else SPENT)
    rates = Pull(direction * jnp.abs(TURNING) * ratio_factor(here, RATIO), spent_rate(direction, here, RATIO))
    tension, by_rule = jax.jvp(lambda pull: unspent(BASE, pull) / pull.ratio, (pull,), (rates,))
    np.testing.assert_allclose(tension_rate(direction, here, TURNING, tension), by_rule, rtol=1e-14)


@pytest.mark.parametrize("drag", [None, 12.0])
def test_what_is_called_proportional_doubles_with_the_tension(drag):
    here, direction = section(drag), jnp.array([1.0, -1.0])
    once, twice = (tension_rate(direction, here, TURNING, tension) for tension in (BASE, 2 * BASE))
    assert is_proportional(here) == np.allclose(twice, 2 * once, rtol=1e-14)


def test_a_finite_turn_is_a_fast_one():
    """R across a turn of 0.4 rad against its rate: the capstan's exp(mu 0.4)."""
    here, direction, turn = section(None), jnp.array([1.0, -1.0]), jnp.array([0.4, 0.4])
    mu = np.array([0.3, 0.42])
    np.testing.assert_allclose(ratio_beyond(direction, here, turn, RATIO), RATIO * np.exp([0.12, -0.168]), rtol=1e-14)
    np.testing.assert_allclose(ratio_factor(here, RATIO), mu * RATIO, rtol=1e-14)
    slope = jax.jvp(lambda turn: ratio_beyond(direction, here, turn, RATIO), (0.0 * turn,), (jnp.ones(2),))[1]
    np.testing.assert_allclose(slope, direction * mu * RATIO, rtol=1e-14)
