"""The fixed point with implicit derivatives, which everything that is solved here uses; small linear systems.

A fixed point y = update(y) is found by Picard iteration, and differentiated by the implicit function theorem: in both
modes and to any order, in jit, vmap, scan and shard_map. Beside its values there may be a few unknowns with an equation
each, such as the moment at the base of a loaded body.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Bool, Float, PyTree

from . import tolerances as tol
from .arrays import all_finite, relative_size, zero_as
from .rotations import solve_three

Unknowns = Float[Array, " unknowns"]
Tree = TypeVar("Tree")
Slopes = TypeVar("Slopes", bound=tuple)
Result = TypeVar("Result")
Scalar = Float[Array, ""]
Step = Callable[[Tree, Unknowns], tuple[Tree, Unknowns]]  # (values, unknowns) -> better values, residual


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
    max_iterations: int,
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
    value, change, count = picard(_measured(frozen, size), start, tolerance, max_iterations, off)
    good = (change <= tolerance) & acceptable(value)
    value = jax.tree.map(lambda new, old: jnp.where(good, new, old), value, start)
    none = zero_as(value)[None][:0]
    value, _ = implicit(Partial(_without_unknowns, update), value, none, max_iterations=max_iterations)
    return FixedPointResult(value, count, change, good)


def _without_unknowns(update: Callable[[Tree], Tree], values: Tree, unknowns: Unknowns) -> tuple[Tree, Unknowns]:
    return update(values), unknowns


def implicit(
    step: Step,
    values: Tree,
    root: Unknowns,
    failed: Bool[Array, ""] | bool = False,
    max_iterations: int = tol.MAX_ITERATIONS,
) -> tuple[Tree, Unknowns]:
    """The same values and unknowns, with the derivatives that follow from the equations.

    The equations are (values, 0) = step(values, unknowns), a fixed point for the values. The derivatives hold in both
    modes and to any order. A linear iteration solves the fixed point; the Jacobian of the unknowns is dense. Where it
    is singular, as in a lane of a batch that found no root, it is replaced by the identity, so that the derivative is
    finite. Where nothing is differentiated, `step` is not evaluated.

    Args:
        step: the equations. Derivatives are with respect to its leaves; everything else that it closes over must be
            constant.
        values: of the fixed point; without derivatives of their own.
        root: where the residual is zero; without derivatives of its own.
        failed: whether this lane of a batch has no solution. Then the slopes of the values by the unknowns are zero.
            They would be NaN where the iteration does not settle, and in reverse mode zero times NaN is NaN.
        max_iterations: of the linear iteration.
    """
    values, root = jax.tree.map(jax.lax.stop_gradient, (values, root))
    return _root(step, values, root, failed, max_iterations=max_iterations)


def slopes_by_unknowns(push: Callable[[Tree, Unknowns], Slopes], values: Tree, root: Unknowns) -> Slopes:
    """The slopes of the values, and of all that follows from them, by the unknowns, which stand along a leading axis.

    They have no derivatives in reverse mode.

    Args:
        push: (values, unknowns) -> a tuple of better values and what else follows, linearised at the values and root.
        values, root: where.
    """

    def by(unit: Unknowns) -> Slopes:
        start = jax.tree.map(lambda x: jnp.zeros_like(x) + 0.0 * unit[0], jax.eval_shape(push, values, unit))
        return by_iteration(lambda slopes: push(slopes[0], unit), start, tol.MAX_ITERATIONS)

    return jax.vmap(by)(_units(root, values))


def _units(root: Unknowns, *others: PyTree) -> Float[Array, "unknowns unknowns"]:
    """A unit for each unknown, which varies over the same devices of shard_map as all numbers."""
    return jnp.eye(root.size, dtype=root.dtype) + zero_as(root, *others)


@eqx.filter_custom_jvp
def _root(step, values, root, failed, *, max_iterations):
    return values, root


@_root.def_jvp
def _(primals, tangents, *, max_iterations):
    step, values, root, failed = primals
    values, root = _root(step, values, root, failed, max_iterations=max_iterations)
    pushed, push = linearised(lambda step, *at: step(*at), step, tangents[0], values, root)
    slopes = _settled(push, pushed, root, max_iterations)
    if not root.size:  # in a batch JAX wants an output that is the same in all lanes to have such a tangent
        return (values, root), (slopes[0], jnp.zeros_like(root))
    still = jax.tree.map(jnp.zeros_like, values)
    by_unknowns = jax.vmap(lambda unit: _settled(push, push(still, unit), root, max_iterations))(_units(root, values))
    by_unknowns = jax.tree.map(lambda slope: jnp.where(failed, 0.0, slope), by_unknowns)
    root_slope = -_solve_where_regular(by_unknowns[1].T, slopes[1])
    moved = jax.tree.map(lambda v, k: v + jnp.tensordot(root_slope, k, 1), slopes[0], by_unknowns[0])
    return (values, root), (moved, root_slope)


def _solve_where_regular(jacobian: Float[Array, "n n"], vector: Unknowns) -> Unknowns:
    """The solution; where the matrix is singular, that with the identity in its place."""
    size = jnp.max(jnp.abs(jacobian), axis=1)
    regular = jnp.all(size != 0)  # NaN, of an iteration that does not settle, stays
    size, eye = jnp.where(regular, size, 1.0), jnp.eye(vector.size, dtype=vector.dtype)
    return solve_small(jnp.where(regular, jacobian / size[:, None], eye), vector / size)[0]


def _settled(push: Callable[[Tree, Unknowns], Slopes], pushed: Slopes, root: Unknowns, max_iterations: int) -> Slopes:
    """All slopes x with x = pushed + push(values of x, 0), by an iteration that ends where only rounding changes."""
    still = jnp.zeros_like(root)
    known, empty = _without_empty(pushed)  # `custom_linear_solve` cannot transpose empty arrays

    def again(slopes: Slopes) -> Slopes:
        return _without_empty(push(eqx.combine(slopes, empty)[0], still))[0]

    return eqx.combine(solve_by_iteration(again, known, max_iterations), empty)


def _without_empty(slopes: Slopes) -> tuple[Slopes, Slopes]:
    """The arrays that hold numbers, and those that do not; None in the place of the others."""
    return eqx.partition(slopes, lambda x: x.size > 0)


def solve_by_iteration(push: Callable[[Tree], Tree], pushed: Tree, max_iterations: int) -> Tree:
    """The solution of v = pushed + push(v), where the iteration v <- pushed + push(v) settles; NaN elsewhere.

    Args:
        push: a linear function.
        pushed: the known part, of which the solution is a linear function.
        max_iterations: the largest number of iterations.
    """

    def solve_linear(operator, b):
        def again(v):
            return jax.tree.map(lambda b, v, w: b + v - w, b, v, operator(v))

        return by_iteration(again, b, max_iterations)

    return jax.lax.custom_linear_solve(
        lambda v: minus(v, push(v)), pushed, solve=solve_linear, transpose_solve=solve_linear
    )


def by_iteration(again: Callable[[Tree], Tree], first: Tree, max_iterations: int) -> Tree:
    """The values that a linear update leaves as they are; NaN where its iteration does not settle."""
    settled = round_off(jax.tree.leaves(first)[0].dtype)
    value, change, _ = picard(_measured(again, relative_size), first, settled, max_iterations)
    return jax.tree.map(lambda x: jnp.where(change <= 1e3 * settled, x, jnp.nan), value)


def picard(
    update: Callable[[Tree], tuple[Tree, Scalar]],
    first: Tree,
    tolerance: float,
    max_iterations: int,
    change: Scalar | float = jnp.inf,
) -> tuple[Tree, Scalar, Scalar]:
    """Picard iteration: the update again and again, until it changes no more than the tolerance.

    Args:
        update: values -> better values, and how large their change is.
        first: where it starts.
        tolerance: the largest change at which it ends.
        max_iterations: the largest number of updates.
        change: what is known of the change that the first update would make.

    Returns:
        The values, the last change, and the number of updates.
    """
    zero = zero_as(first)

    def unsettled(carry: tuple[Tree, Scalar, Scalar]) -> Bool[Array, ""]:
        _, change, count = carry
        return (change > tolerance) & (count < max_iterations)

    def body(carry: tuple[Tree, Scalar, Scalar]) -> tuple[Tree, Scalar, Scalar]:
        value, _, count = carry
        return *update(value), count + 1.0

    return jax.lax.while_loop(unsettled, body, (first, zero + change, zero))


def _measured(
    update: Callable[[Tree], Tree], size: Callable[[Tree, Tree], Scalar]
) -> Callable[[Tree], tuple[Tree, Scalar]]:
    """The update with the size of its change, as `picard` takes it."""

    def measured(value: Tree) -> tuple[Tree, Scalar]:
        new = update(value)
        return new, size(minus(new, value), new)

    return measured


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


def linearised(
    function: Callable[..., Result], given: PyTree, direction: PyTree, *at: PyTree
) -> tuple[Result, Callable[..., Result]]:
    """The derivative of function(given, *at) along a direction of `given`, and by changes of `at`.

    The function stands in the program once.

    Args:
        given, direction: as in `slope_along`.
        at: the other arguments, arrays or trees of them.

    Returns:
        The derivative, and the linear function.
    """
    moving, rest = eqx.partition(given, jax.tree.map(lambda _, way: way is not None, given, direction))
    _, push = jax.linearize(lambda moving, *at: function(eqx.combine(moving, rest), *at), moving, *at)
    still, *unchanged = jax.tree.map(jnp.zeros_like, (moving, *at))
    zero = 0.0 * jax.tree.leaves(direction)[0].ravel()[0]  # as in `slope_along`
    slope = jax.tree.map(lambda slope: slope + zero, push(direction, *unchanged))
    return slope, jax.linearize(lambda *changes: push(still, *changes), *unchanged)[1]


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
