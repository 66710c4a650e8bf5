"""The implicit function theorem, for a fixed point, a few unknowns, and places at which pieces of a line end."""

from collections.abc import Callable
from typing import Generic, Protocol, TypeVar, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from .arrays import relative_size, zero_as
from .rotations import solve_three

Unknowns = Float[Array, " unknowns"]
Places = Float[Array, " places"]
Tree = TypeVar("Tree")
Context = TypeVar("Context")
Slopes = TypeVar("Slopes", bound=tuple)
Result = TypeVar("Result")
Scalar = Float[Array, ""]
MAX_PASSES = 64


@runtime_checkable
class ImplicitStep(Protocol, Generic[Tree, Context]):
    """The equations of an equilibrium, as a pytree.

    The values are those of functions along a line that is cut into pieces. Some pieces end at places where a quantity
    vanishes, so that all functions are smooth in each piece.
    """

    def __call__(
        self, values: Tree, unknowns: Unknowns, places: Places
    ) -> tuple[tuple[Tree, Unknowns, Places], Context]:
        """Better values, the residual and the quantities that vanish at the places; and whatever `moved` needs."""
        ...

    def moved(self, context: Context, /, places: Places, vanishing: Places) -> tuple[Tree, Places]:
        """The slopes of the values, which move with the places, and those of the places.

        Args:
            context: from the step.
            places: where they are.
            vanishing: the slopes of the quantities that vanish, at places that do not move.
        """
        ...


def implicit(
    step: ImplicitStep[Tree, Context],
    values: Tree,
    root: Unknowns,
    places: Places,
    failed: Bool[Array, ""] | bool = False,
) -> tuple[Tree, Unknowns, Places]:
    """The same values, unknowns and places, with the derivatives that follow from the equations.

    The equations are (values, 0, 0) = step(values, unknowns, places)[0], a fixed point for the values. The derivatives
    hold in both modes and to any order. Linear passes solve the fixed point; the Jacobian of the unknowns is dense.
    Where it is singular, as in a lane of a batch that found no root, it is replaced by the identity, so that the
    derivative is finite. The functions along the line do not depend on where pieces end, so that the places follow at
    last, each by its own quantity. Where nothing is differentiated, `step` is not evaluated.

    Args:
        step: the equations. Derivatives are with respect to its leaves; everything else that it closes over must be
            constant.
        values: of the fixed point; without derivatives of their own.
        root: where the residual is zero; without derivatives of its own.
        places: where pieces end; without derivatives of their own.
        failed: whether this lane of a batch has no solution. Then the slopes of the values by the unknowns are zero.
            They would be NaN where passes do not settle, and in reverse mode zero times NaN is NaN.
    """
    values, root, places = jax.tree.map(jax.lax.stop_gradient, (values, root, places))
    return _root(step, values, root, places, failed)


def slopes_by_unknowns(push: Callable[[Tree, Unknowns], Slopes], values: Tree, root: Unknowns) -> Slopes:
    """The slopes of the values, and of all that follows from them, by the unknowns, which stand along a leading axis.

    They have no derivatives in reverse mode.

    Args:
        push: (values, unknowns) -> a tuple of better values and what else follows, linearised at the values and root.
        values, root: where.
    """

    def by(unit: Unknowns) -> Slopes:
        start = jax.tree.map(lambda x: jnp.zeros_like(x) + 0.0 * unit[0], jax.eval_shape(push, values, unit))
        return by_passes(lambda slopes: push(slopes[0], unit), start, MAX_PASSES)

    return jax.vmap(by)(_units(root, values))


def _units(root: Unknowns, *others: PyTree) -> Float[Array, "unknowns unknowns"]:
    """A unit for each unknown, which varies over the same devices of shard_map as all numbers."""
    return jnp.eye(root.size, dtype=root.dtype) + zero_as(root, *others)


@eqx.filter_custom_jvp
def _root(step, values, root, places, failed):
    return values, root, places


@_root.def_jvp
def _(primals, tangents):
    (step, values, root, places, failed), (direction, *_) = primals, tangents
    values, root, places = _root(step, values, root, places, failed)
    pushed, push, context = linearised(lambda step, *at: step(*at, places), step, direction, values, root)
    slopes = _through_passes(push, pushed, root)
    root_slope = jnp.zeros_like(root)
    if root.size:
        still = jax.tree.map(jnp.zeros_like, values)
        by_unknowns = jax.vmap(lambda unit: _through_passes(push, push(still, unit), root))(_units(root, values))
        by_unknowns = jax.tree.map(lambda slope: jnp.where(failed, 0.0, slope), by_unknowns)
        root_slope = -_solve_where_regular(by_unknowns[1].T, slopes[1])
        slopes = jax.tree.map(lambda v, k: v + jnp.tensordot(root_slope, k, 1), slopes[::2], by_unknowns[::2])
    values_slope, vanishing = slopes[0], slopes[-1]
    if not places.size:
        return (values, root, places), (values_slope, root_slope, vanishing)
    moved, places_slope = step.moved(context, places, vanishing)
    values_slope = jax.tree.map(jnp.add, values_slope, moved)
    return (values, root, places), (values_slope, root_slope, places_slope)


def _solve_where_regular(jacobian: Float[Array, "n n"], vector: Unknowns) -> Unknowns:
    """The solution; where the matrix is singular, that with the identity in its place."""
    size = jnp.max(jnp.abs(jacobian), axis=1)
    regular = jnp.all(size != 0)  # NaN, of passes that do not settle, stays
    size, eye = jnp.where(regular, size, 1.0), jnp.eye(vector.size, dtype=vector.dtype)
    return solve_small(jnp.where(regular, jacobian / size[:, None], eye), vector / size)[0]


def _through_passes(push: Callable[[Tree, Unknowns], Slopes], pushed: Slopes, root: Unknowns) -> Slopes:
    """All slopes x with x = pushed + push(values of x, 0), by passes that go on until only rounding changes."""
    still = jnp.zeros_like(root)
    known, empty = _without_empty(pushed)  # `custom_linear_solve` cannot transpose empty arrays

    def again(slopes: Slopes) -> Slopes:
        return _without_empty(push(eqx.combine(slopes, empty)[0], still))[0]

    return eqx.combine(solve_by_passes(again, known), empty)


def _without_empty(slopes: Slopes) -> tuple[Slopes, Slopes]:
    """The arrays that hold numbers, and those that do not; None in the place of the others."""
    return eqx.partition(slopes, lambda x: x.size > 0)


def solve_by_passes(push: Callable[[Tree], Tree], pushed: Tree, max_passes: int = MAX_PASSES) -> Tree:
    """The solution of v = pushed + push(v), where passes v <- pushed + push(v) settle; NaN elsewhere.

    Args:
        push: a linear function.
        pushed: the known part, of which the solution is a linear function.
        max_passes: the largest number of passes.
    """

    def solve_linear(operator, b):
        def again(v):
            return jax.tree.map(lambda b, v, w: b + v - w, b, v, operator(v))

        return by_passes(again, b, max_passes)

    return jax.lax.custom_linear_solve(
        lambda v: minus(v, push(v)), pushed, solve=solve_linear, transpose_solve=solve_linear
    )


def by_passes(again: Callable[[Tree], Tree], first: Tree, max_passes: int) -> Tree:
    """The values that a linear pass leaves as they are; NaN where passes do not settle."""
    settled = round_off(jax.tree.leaves(first)[0].dtype)
    value, change, _ = repeat(again, first, relative_size, settled, max_passes)
    return jax.tree.map(lambda x: jnp.where(change <= 1e3 * settled, x, jnp.nan), value)


def repeat(
    update: Callable[[Tree], Tree],
    first: Tree,
    size: Callable[[Tree, Tree], Scalar],
    tolerance: float,
    max_passes: int,
    change: Scalar | float = jnp.inf,
) -> tuple[Tree, Scalar, Scalar]:
    """The update again and again until it changes no more than the tolerance: values, last change, number of passes.

    `change` is what is known of the change that the first pass would make.
    """
    zero = zero_as(first)

    def unsettled(carry):
        _, change, count = carry
        return (change > tolerance) & (count < max_passes)

    def body(carry):
        value, _, count = carry
        new = update(value)
        return new, size(minus(new, value), new), count + 1.0

    return jax.lax.while_loop(unsettled, body, (first, zero + change, zero))


def minus(a: Tree, b: Tree) -> Tree:
    """The difference of two trees."""
    return jax.tree.map(jnp.subtract, a, b)


def round_off(dtype: jnp.dtype) -> float:
    """The relative change below which further passes change nothing but rounding errors."""
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
    function: Callable[..., tuple[Result, Context]], given: PyTree, direction: PyTree, *at: PyTree
) -> tuple[Result, Callable[..., Result], Context]:
    """The derivative of function(given, *at)[0] along a direction of `given`, and by changes of `at`.

    The function stands in the program once.

    Args:
        function: whose second result is not differentiated.
        given, direction: as in `slope_along`.
        at: the other arguments, arrays or trees of them.

    Returns:
        The derivative, the linear function, and the second result.
    """
    moving, rest = eqx.partition(given, jax.tree.map(lambda _, way: way is not None, given, direction))
    _, push, context = jax.linearize(
        lambda moving, *at: function(eqx.combine(moving, rest), *at), moving, *at, has_aux=True
    )
    still, *unchanged = jax.tree.map(jnp.zeros_like, (moving, *at))
    zero = 0.0 * jax.tree.leaves(direction)[0].ravel()[0]  # as in `slope_along`
    slope = jax.tree.map(lambda slope: slope + zero, push(direction, *unchanged))
    return slope, jax.linearize(lambda *changes: push(still, *changes), *unchanged)[1], context


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
