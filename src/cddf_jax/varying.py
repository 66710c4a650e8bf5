"""A zero that costs nothing and is at home on every device.

What a loop carries must, under shard_map, vary over the same devices before and after a turn. So does a zero made of
the numbers that go into the loop; XLA takes it for the constant that it is, which it would not do with 0 * x.
"""

from functools import reduce
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def zero_as(*numbers: Any) -> Float[Array, ""]:
    """0, which varies over the devices of shard_map as any number of the trees does; whole arrays are left out."""
    real = [x for x in jax.tree.leaves(numbers) if isinstance(x, float | int) or eqx.is_inexact_array(x)]
    return reduce(jnp.add, [jax.lax.full_like(x, 0, shape=()) for x in real])
