"""The pulley test: friction between tendon and body material, apart from any manipulator."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float


def pulling_tension(weight: Any, friction_coefficient: Any, wrap_angle: Any) -> Float[Array, "*rows"]:
    """T_pull = W exp(mu theta): what raises a weight W over a fixed pulley. Liu et al. (2020), eq. (5).

    Args:
        weight: W, N.
        friction_coefficient: mu.
        wrap_angle: theta, rad.
    """
    return jnp.asarray(weight) * jnp.exp(friction_coefficient * jnp.asarray(wrap_angle))
