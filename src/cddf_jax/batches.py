"""Small things that in a batch on the CPU are slow as JAX has them."""

from collections.abc import Callable
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

Numbers = Any  # an array of floating-point numbers or a tree of them
Scalar = Float[Array, ""]


def largest(numbers: Numbers) -> Scalar:
    """The largest magnitude, by halves, which is ten times as fast as XLA's reduction."""
    return reduce(jnp.maximum, map(_largest, jax.tree.leaves(numbers)))


def _largest(numbers: Array) -> Scalar:
    left = jnp.abs(numbers).ravel()
    while left.size > 1:
        half = left.size // 2
        left = jnp.concatenate([jnp.maximum(left[:half], left[half : 2 * half]), left[2 * half :]])
    return left[0]


def relative_size(change: Numbers, value: Numbers) -> Scalar:
    """The largest change over the largest value."""
    size = largest(value)
    return largest(change) / jnp.maximum(size, jnp.finfo(size.dtype).tiny)


def minus(a: Numbers, b: Numbers) -> Numbers:
    """The difference of two trees."""
    return jax.tree.map(jnp.subtract, a, b)


def all_finite(numbers: Numbers) -> Bool[Array, ""]:
    """Whether there is neither infinity nor NaN."""
    return jnp.isfinite(largest(numbers))


def only_if(needed: Bool[Array, ""], compute: Callable[[Scalar], Any], otherwise: Any) -> Any:
    """What `compute` makes where it is needed; a batch computes nothing where no lane needs it.

    `lax.cond` would compute for the whole batch whatever happens. There are no derivatives in reverse mode.

    Args:
        needed: whether this lane needs it.
        compute: gets a zero, to be added to what it works on: the rest XLA moves out of the loop that this is.
        otherwise: what comes back where it is not needed.
    """
    turns = jnp.where(needed, 1.0, 0.0)

    def once(carry):
        return carry[0] - 1.0, compute(0.0 * carry[0])

    return jax.lax.while_loop(lambda carry: carry[0] > 0, once, (turns, otherwise))[1]
