"""Forward derivatives by central differences, for functions whose values are smooth and whose derivatives are not."""

from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

STEP = 1e-4  # of the largest number of an array

Given = TypeVar("Given")


def with_differences(function: Callable[[Given], PyTree[Float[Array, "..."]]], given: Given) -> PyTree:
    """The value of the function; its derivative along a direction is a central difference.

    First derivatives in forward mode only.

    Args:
        function: of a tree that holds arrays and static values; it returns floating-point arrays.
        given: that tree. The numbers of one array should be of similar size: each array is changed by `STEP` times its
            largest number, or by less.
    """
    arrays, rest = eqx.partition(given, eqx.is_inexact_array)
    flat, unravel = jax.flatten_util.ravel_pytree(arrays)
    size, _ = jax.flatten_util.ravel_pytree(jax.tree.map(_size, jax.lax.stop_gradient(arrays)))

    @jax.custom_jvp
    def of(flat: Array) -> PyTree:
        return function(eqx.combine(unravel(flat), rest))

    @of.defjvp
    def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[PyTree, PyTree]:
        (x,), (direction,) = primals, tangents
        reach = jnp.max(jnp.abs(direction) / size)
        step = STEP / jnp.where(reach > 0, reach, 1.0)
        ends = jax.vmap(of)(jnp.stack([x - step * direction, x + step * direction]))  # one program for both
        return of(x), jax.tree.map(lambda y: (y[1] - y[0]) / (2 * step), ends)

    return of(flat)


def _size(x: Array) -> Array:
    largest = jnp.max(jnp.abs(x), initial=0.0)
    return jnp.full_like(x, jnp.where(largest > 0, largest, 1.0))
