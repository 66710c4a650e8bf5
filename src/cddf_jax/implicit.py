"""The implicit function theorem, for a handful of unknowns found by whatever means."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Unknowns = Float[Array, " unknowns"]


def implicit(residual: Callable[[Unknowns], Unknowns], root: Unknowns) -> Unknowns:
    """The root again, with the derivatives of the function that residual(root) = 0 makes of it.

    In both modes and to any order. The Jacobian is dense: one linearised residual for each unknown.
    Where it is singular, as in a lane of a batch that found no root, the identity stands in, so that
    the derivative is finite.

    Args:
        residual: as many equations as unknowns; it may close over traced values.
        root: where the residual vanishes; its own derivatives are not looked at.
    """
    if root.size == 0:
        return root

    def solve_tangent(operator, b):
        jacobian = jax.vmap(operator, out_axes=1)(jnp.eye(root.size, dtype=root.dtype))
        size = jnp.max(jnp.abs(jacobian), axis=1, keepdims=True)
        scaled = jacobian / jnp.where(size > 0, size, 1.0)
        regular = jnp.abs(jnp.linalg.det(scaled)) > 1e3 * jnp.finfo(root.dtype).tiny
        regular = regular & jnp.all(jnp.isfinite(jacobian))
        safe = jnp.where(regular, scaled, jnp.eye(root.size, dtype=root.dtype))
        return jnp.linalg.solve(safe, b / jnp.where(regular, jnp.where(size > 0, size, 1.0), 1.0)[:, 0])

    return jax.lax.custom_root(residual, jax.lax.stop_gradient(root), lambda _, guess: guess, solve_tangent)


def without_derivative(tree: Any) -> Any:
    """The same numbers, which no derivative passes."""
    arrays, rest = eqx.partition(tree, eqx.is_inexact_array)
    return eqx.combine(jax.tree.map(jax.lax.stop_gradient, arrays), rest)
