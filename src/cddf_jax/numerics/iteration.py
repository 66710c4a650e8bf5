"""A fixed point with implicit derivatives, which works in jit, vmap, scan and shard_map."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from .arrays import all_finite, computed_once, relative_size, zero_as
from .implicit import linearised, repeat, solve_by_passes

Values = TypeVar("Values")  # an array or a tree of arrays
Scalar = Float[Array, ""]


class FixedPointResult(NamedTuple):
    """The result of the passes."""

    value: PyTree  # as the start
    num_passes: Scalar
    change: Scalar  # in the last pass, as `size` measures it
    converged: Bool[Array, ""]


def fixed_point(
    update: Callable[[Values], Values],
    start: Values,
    *,
    tolerance: float,
    max_passes: int,
    size: Callable[[Values, Values], Scalar] = relative_size,
    acceptable: Callable[[Values], Bool[Array, ""]] | None = None,
    off: Scalar | float = jnp.inf,
) -> FixedPointResult:
    """Solve y = update(y) by Picard iteration; differentiate the solution implicitly.

    One evaluation of `update` is a pass. Derivatives come from passes of the same kind on the linearised equation
    v = update'(y) v + b, in both modes and to any order. No Jacobian is formed, and no exception is raised. Where the
    passes do not settle, or end on a value that is not acceptable, `converged` is false and the value is `start`. The
    derivatives are then those of the linearisation at `start`, which are finite if those of `update` are.

    Args:
        update: the map, a pytree as `jax.tree_util.Partial` makes it. Derivatives are with respect to its leaves;
            everything else that it closes over must be constant.
        start: first guess, without derivatives.
        tolerance: the passes stop when the last change was no larger.
        max_passes: the largest number of passes.
        size: (change, value) -> how large a change is, to be compared with `tolerance`. The
            linearised passes always go on until only rounding errors change.
        acceptable: whether a value may count as a solution; None where every finite value may. After a pass the value
            is finite if its change is.
        off: an upper bound of the change in the first pass, where one is known. There are no passes where it is within
            the tolerance.
    """
    settings = {"tolerance": tolerance, "max_passes": max_passes, "size": size, "acceptable": acceptable}
    return FixedPointResult(*_solve(update, *jax.lax.stop_gradient((start, off)), **settings))


@eqx.filter_custom_jvp
def _solve(update, start, off, *, tolerance, max_passes, size, acceptable):
    value, change, count = repeat(update, start, size, tolerance, max_passes, off)
    good = (change <= tolerance) & (True if acceptable is None else acceptable(value))
    return jax.tree.map(lambda new, old: jnp.where(good, new, old), value, start), count, change, good


@_solve.def_jvp
def _(primals, tangents, **settings):
    (update, *_), (direction, *_) = primals, tangents
    value, *outcome = _solve(*primals, **settings)
    pushed, push, _ = linearised(lambda update, value: (update(value), None), update, direction, value)
    slope = solve_by_passes(push, pushed, settings["max_passes"])
    return (value, *outcome), (slope, None, None, None)


def constant_map(
    update: Callable[[Values], Values], start: Values, acceptable: Callable[[Values], Bool[Array, ""]] = all_finite
) -> FixedPointResult:
    """As `fixed_point`, for an update whose result does not depend on its argument: one pass is enough."""
    value, zero = update(jax.lax.stop_gradient(start)), zero_as(start)
    change = jnp.where(all_finite(value), zero, jnp.inf)
    good = computed_once(acceptable(value).astype(zero.dtype)) > 0.5
    value = jax.tree.map(lambda new, old: jnp.where(good, new, old), value, start)
    return FixedPointResult(value, zero + 1.0, change, good)
