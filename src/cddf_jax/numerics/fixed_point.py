"""The fixed point with implicit derivatives, which everything that is solved here uses; small linear systems.

A fixed point y = update(y) is found by Picard iteration, and differentiated by the implicit function theorem: in both
modes and to any order, in jit, vmap, scan and shard_map.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from . import tolerances as tol
from .arrays import all_finite, relative_size, zero_as
from .rotations import solve_three

Unknowns = Float[Array, " unknowns"]
Tree = TypeVar("Tree")
Result = TypeVar("Result")
Scalar = Float[Array, ""]


class FixedPointResult(NamedTuple):
    """The result of the iteration."""

    value: PyTree  # as the start
    num_iterations: Scalar
    change: Scalar  # in the last iteration, as `size` measures it
    converged: Bool[Array, ""]


def fixed_point(
    update: Callable[[Tree], Tree],
    start: Tree,
    *,
    tolerance: float,
    max_iterations: int = tol.MAX_ITERATIONS,
    size: Callable[[Tree, Tree], Scalar] = relative_size,
    acceptable: Callable[[Tree], Bool[Array, ""]] = all_finite,
    off: Scalar | float = jnp.inf,
) -> FixedPointResult:
    """Solve y = update(y) by Picard iteration; differentiate the solution implicitly.

    No Jacobian is formed, and no exception is raised. Where the iteration does not settle, or ends on a value that is
    not acceptable, `converged` is false and the value is `start`. The derivatives are then those of the linearisation
    at `start`, which are finite if those of `update` are.

    Args:
        update: the map, a pytree as `jax.tree_util.Partial` makes it. Derivatives are with respect to its leaves;
            everything else that it closes over must be constant.
        start: first guess, without derivatives.
        tolerance: the iteration stops when the last change was no larger.
        max_iterations: the largest number of updates.
        size: (change, value) -> how large a change is, to be compared with `tolerance`. The linearised iteration
            always goes on until only rounding errors change.
        acceptable: whether a value may count as a solution.
        off: an upper bound of the first change, where one is known. Nothing is iterated where it is within the
            tolerance.
    """
    start, off, frozen = without_derivative((start, off, update))
    off = zero_as(start) + off

    def step(last: tuple[Tree, Scalar]) -> tuple[tuple[Tree, Scalar], Bool[Array, ""]]:
        new = frozen(last[0])
        change = size(minus(new, last[0]), new)
        return (new, change), ~(change > tolerance)  # NaN ends it

    (value, change), count = until(step, (start, off), max_iterations, ended=~(off > tolerance))
    good = (change <= tolerance) & acceptable(value)
    value = jax.tree.map(lambda new, old: jnp.where(good, new, old), value, start)
    return FixedPointResult(implicit(update, value), count, change, good)


def implicit(update: Callable[[Tree], Tree], value: Tree) -> Tree:
    """The fixed point y = update(y) that was found, with the derivatives that follow from this equation.

    They hold in both modes and to any order. They are solved by the linearised iteration, so that no Jacobian is
    formed; where it does not settle they are NaN. Where nothing is differentiated, `update` is not evaluated.

    Args:
        update: the map. Derivatives are with respect to its leaves; everything else that it closes over must be
            constant.
        value: the fixed point; without derivatives of its own.
    """
    return _found(update, jax.tree.map(jax.lax.stop_gradient, value))


@eqx.filter_custom_jvp
def _found(update, value):
    return value


@_found.def_jvp
def _(primals, tangents):
    (update, value), (direction, _) = primals, tangents
    value = _found(update, value)
    pushed, push = _linearised(update, direction, value)
    return value, _solve_by_iteration(push, pushed)


def _linearised(update: Callable[[Tree], Tree], direction: PyTree, value: Tree) -> tuple[Tree, Callable[[Tree], Tree]]:
    """The derivative of update(value) along a direction of the leaves of `update`, and by changes of the value.

    The map stands in the program once. `direction` is as in `slope_along`.
    """
    moving, rest = eqx.partition(update, jax.tree.map(lambda _, way: way is not None, update, direction))
    _, push = jax.linearize(lambda moving, value: eqx.combine(moving, rest)(value), moving, value)
    still, unchanged = jax.tree.map(jnp.zeros_like, (moving, value))
    zero = 0.0 * jax.tree.leaves(direction)[0].ravel()[0]  # as in `slope_along`
    pushed = jax.tree.map(lambda slope: slope + zero, push(direction, unchanged))
    return pushed, jax.linearize(lambda change: push(still, change), unchanged)[1]


def _solve_by_iteration(push: Callable[[Tree], Tree], pushed: Tree) -> Tree:
    """The solution of v = pushed + push(v), where the iteration v <- pushed + push(v) settles; NaN elsewhere.

    The known part is computed once: where it cancels, its rounding errors must not change from one iteration to the
    next. The values are iterated as one array, as XLA compiles a kernel for every array that a loop carries.

    Args:
        push: a linear function.
        pushed: the known part, of which the solution is a linear function.
    """

    def solve_linear(operator: Callable[[Tree], Tree], known: Tree) -> Tree:
        start, as_tree = ravel_pytree(known)
        settled = round_off(start.dtype)

        def again(last: tuple[Array, Scalar]) -> tuple[tuple[Array, Scalar], Bool[Array, ""]]:
            value, before = last
            new = start + value - ravel_pytree(operator(as_tree(value)))[0]
            change = relative_size(new - value, new)
            rounding = (change <= tol.NEARLY * settled) & (change > 0.5 * before)  # it falls no further
            return (new, change), ~(change > settled) | rounding  # NaN ends it

        (value, change), _ = until(again, (start, zero_as(start) + jnp.inf), tol.MAX_ITERATIONS)
        return as_tree(jnp.where(change <= tol.NEARLY * settled, value, jnp.nan))

    return jax.lax.custom_linear_solve(
        lambda v: minus(v, push(v)), pushed, solve=solve_linear, transpose_solve=solve_linear
    )


def until(
    step: Callable[[Tree], tuple[Tree, Bool[Array, ""]]],
    start: Tree,
    most: int,
    ended: Bool[Array, ""] | bool = False,
) -> tuple[Tree, Scalar]:
    """Repeat a step until it says that it was the last one; the values, and the number of steps.

    Args:
        step: values -> the next ones, and whether they are the last.
        start: the first values.
        most: the largest number of steps.
        ended: whether the first values are the last.
    """
    zero = zero_as(start)

    def goes_on(carry: tuple[Tree, Bool[Array, ""], Scalar]) -> Bool[Array, ""]:
        _, ended, count = carry
        return ~ended & (count < most)

    def body(carry: tuple[Tree, Bool[Array, ""], Scalar]) -> tuple[Tree, Bool[Array, ""], Scalar]:
        value, _, count = carry
        return *step(value), count + 1.0

    value, _, count = jax.lax.while_loop(goes_on, body, (start, (zero > 0) | ended, zero))
    return value, count


def newton(step: Callable[[Tree], Tree], start: Tree, num_steps: int) -> Tree:
    """A fixed number of steps of Newton's method or of another contraction, which derivatives pass in both modes."""
    return jax.lax.fori_loop(0, num_steps, lambda _, value: step(value), start)


def minus(a: Tree, b: Tree) -> Tree:
    """The difference of two trees."""
    return jax.tree.map(jnp.subtract, a, b)


def round_off(dtype: jnp.dtype) -> float:
    """The relative change below which further updates change nothing but rounding errors."""
    return 32 * float(jnp.finfo(dtype).eps)


def slope_along(function: Callable[[Tree], Result], given: Tree, direction: PyTree) -> Result:
    """The derivative of function(given) along a direction, in the form that `equinox.filter_custom_jvp` passes it.

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


def solve_small(
    matrix: Float[Array, "n n"], vector: Float[Array, "n *k"]
) -> tuple[Float[Array, "n *k"], Float[Array, ""]]:
    """Gaussian elimination with partial pivoting, unrolled: for a handful of unknowns in batches of thousands.

    LAPACK would be called once for every matrix of a batch, and not every loop that XLA compiles may call it. The right
    side is a vector, or a matrix with one in each column.

    Returns:
        The solution, and the smallest pivot over the largest one: near zero where the matrix is singular.
        A pivot of zero is replaced by 1.
    """
    n, pivots = matrix.shape[0], []
    for k in range(n):  # matrix and vector apart, as derivatives in reverse mode need what is linear in the vector
        if k + 1 < n:
            chosen = k + jnp.argmax(jnp.abs(matrix[k:, k]))
            order = jnp.arange(n).at[k].set(chosen).at[chosen].set(k)
            matrix, vector = matrix[order], vector[order]
        pivots.append(matrix[k, k])
        if n == 1:
            break
        safe = jnp.where(pivots[k] == 0, 1.0, pivots[k])
        others = jnp.where(jnp.arange(n) == k, 0.0, matrix[:, k]) / safe
        matrix, vector = matrix - others[:, None] * matrix[k], vector - _along_rows(others, vector) * vector[k]
    size = jnp.abs(jnp.stack(pivots))
    safe = jnp.where(size == 0, 1.0, jnp.stack(pivots))
    return vector / _along_rows(safe, vector), jnp.min(size) / jnp.maximum(jnp.max(size), jnp.finfo(size.dtype).tiny)


def _along_rows(numbers: Float[Array, " n"], like: Float[Array, "n *k"]) -> Float[Array, "n *_"]:
    return numbers.reshape(-1, *[1] * (like.ndim - 1))


def solve_definite(matrix: Float[Array, "n n"], vector: Float[Array, " n"]) -> Float[Array, " n"]:
    """As `solve_small`, without pivoting: for a matrix whose symmetric part is positive definite."""
    if matrix.shape[0] == 3:
        return solve_three(matrix, vector)
    for k in range(matrix.shape[0]):
        others = jnp.where(jnp.arange(matrix.shape[0]) == k, 0.0, matrix[:, k]) / matrix[k, k]
        matrix, vector = matrix - others[:, None] * matrix[k], vector - others * vector[k]
    return vector / jnp.diagonal(matrix)


def without_derivative(tree: Tree) -> Tree:
    """The same numbers as constants, which have no derivatives."""
    arrays, rest = eqx.partition(tree, eqx.is_inexact_array)
    return eqx.combine(jax.tree.map(jax.lax.stop_gradient, arrays), rest)
