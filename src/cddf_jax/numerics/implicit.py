"""The implicit function theorem, for a few unknowns, by whatever method they were found."""

from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from .arrays import zero_as

Unknowns = Float[Array, " unknowns"]
Tree = TypeVar("Tree")
Result = TypeVar("Result")


def implicit(residual: Callable[[Unknowns], Unknowns], root: Unknowns) -> Unknowns:
    """The same root, with the derivatives that residual(root) = 0 gives it.

    They hold in both modes and to any order. The Jacobian is dense: one linearised residual for each unknown.
    Where it is singular, as in a lane of a batch that found no root, it is replaced by the identity, so that
    the derivative is finite. Where nothing is differentiated, the residual is not evaluated.

    Args:
        residual: as many equations as unknowns, a pytree as `jax.tree_util.Partial` makes it: derivatives are by its
            leaves, and whatever else it closes over must be constant.
        root: where the residual is zero; without derivatives of its own.
    """
    return _root(residual, jax.lax.stop_gradient(root)) if root.size else root


@eqx.filter_custom_jvp
def _root(residual, root):
    return root


@_root.def_jvp
def _(primals, tangents):
    (residual, root), (direction, _) = primals, tangents
    root = _root(residual, root)
    pushed = slope_along(lambda residual: residual(root), residual, direction)
    eye = jnp.eye(root.size, dtype=root.dtype) + zero_as(root)
    jacobian = jax.vmap(jax.linearize(residual, root)[1], out_axes=1)(eye)
    size = jnp.max(jnp.abs(jacobian), axis=1)
    regular = jnp.all(jnp.isfinite(jacobian)) & jnp.all(size > 0)
    size = jnp.where(regular, size, 1.0)
    return root, -solve_small(jnp.where(regular, jacobian / size[:, None], eye), pushed / size)[0]


def slope_along(function: Callable[[Tree], Result], given: Tree, direction: PyTree) -> Result:
    """The derivative of function(given) along a direction, as the rules of `equinox.filter_custom_jvp` get it.

    Args:
        function: of one pytree.
        given: that pytree.
        direction: None in the place of a number that stays constant.

    Returns:
        A number for every number of the result, zero for one that stays constant.
    """
    value, slope = eqx.filter_jvp(function, (given,), (direction,))
    moved = jax.tree.leaves(slope)
    still = 0.0 * moved[0].ravel()[0] if moved else 0.0  # linear as the others: `custom_linear_solve` transposes all
    return jax.tree.map(lambda x, v: jnp.zeros_like(x) + still if v is None else v, value, slope)


def solve_small(matrix: Float[Array, "n n"], vector: Float[Array, " n"]) -> tuple[Float[Array, " n"], Float[Array, ""]]:
    """Gaussian elimination with partial pivoting, unrolled: for a handful of unknowns in batches of thousands.

    LAPACK would be called once for every matrix of a batch, and not every loop that XLA compiles may call it.

    Returns:
        The solution, and the smallest pivot over the largest one: near zero where the matrix is singular.
        A pivot of zero is replaced by 1.
    """
    n, pivots = matrix.shape[0], []
    for k in range(n):  # matrix and vector apart, as derivatives in reverse mode need what is linear in the vector
        chosen = k + jnp.argmax(jnp.abs(matrix[k:, k]))
        order = jnp.arange(n).at[k].set(chosen).at[chosen].set(k)
        matrix, vector = matrix[order], vector[order]
        pivots.append(matrix[k, k])
        safe = jnp.where(pivots[k] == 0, 1.0, pivots[k])
        others = jnp.where(jnp.arange(n) == k, 0.0, matrix[:, k]) / safe
        matrix, vector = matrix - others[:, None] * matrix[k], vector - others * vector[k]
    size = jnp.abs(jnp.stack(pivots))
    safe = jnp.where(size == 0, 1.0, jnp.stack(pivots))
    return vector / safe, jnp.min(size) / jnp.maximum(jnp.max(size), jnp.finfo(size.dtype).tiny)


def without_derivative(tree: Tree) -> Tree:
    """The same numbers as constants, which have no derivatives."""
    arrays, rest = eqx.partition(tree, eqx.is_inexact_array)
    return eqx.combine(jax.tree.map(jax.lax.stop_gradient, arrays), rest)
