"""A fixed point with implicit derivatives that is at home in jit, vmap, scan and shard_map."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .implicit import slope_along
from .reductions import all_finite, computed_once, relative_size
from .varying import zero_as

Values = Any  # an array or a tree of arrays
Scalar = Float[Array, ""]


class FixedPointResult(NamedTuple):
    value: Values
    num_sweeps: Scalar
    change: Scalar  # in the last sweep, as `size` measures it
    converged: Bool[Array, ""]


def minus(a: Values, b: Values) -> Values:
    """The difference of two trees."""
    return jax.tree.map(jnp.subtract, a, b)


def round_off(dtype: jnp.dtype) -> float:
    """The relative change below which repeated sweeps only stir rounding errors."""
    return 32 * float(jnp.finfo(dtype).eps)


def fixed_point(
    sweep: Callable[[Values], Values],
    start: Values,
    *,
    tolerance: float,
    max_sweeps: int,
    size: Callable[[Values, Values], Scalar] = relative_size,
    acceptable: Callable[[Values], Bool[Array, ""]] = all_finite,
) -> FixedPointResult:
    """Solve y = sweep(y) by repetition; differentiate it implicitly.

    Derivatives come from the same kind of sweeps on the linearised equation v = sweep'(y) v + b, in
    both modes and to any order, and no Jacobian is formed. Nothing is ever thrown: where the sweeps
    do not settle or end on a value that is not acceptable, `converged` is false, the value is
    `start`, and the derivatives are those of the linearisation there, finite unless the sweep's are not.

    Args:
        sweep: the map, a pytree as `jax.tree_util.Partial` makes it: derivatives are by its leaves, and what else it
            closes over must be constant.
        start: first guess; its own derivatives are not looked at.
        tolerance: the sweeps stop when the last change was no larger.
        max_sweeps: the sweeps stop here at the latest.
        size: (change, value) -> how large a change is, to be compared with `tolerance`. The
            linearised sweeps always go on until only rounding errors change.
        acceptable: whether a value may count as a solution.
    """
    settings = {"tolerance": tolerance, "max_sweeps": max_sweeps, "size": size, "acceptable": acceptable}
    return FixedPointResult(*_solve(sweep, jax.lax.stop_gradient(start), **settings))


@eqx.filter_custom_jvp
def _solve(sweep, start, *, tolerance, max_sweeps, size, acceptable):
    value, change, count = _repeat(sweep, start, size, tolerance, max_sweeps)
    good = (change <= tolerance) & acceptable(value)
    return jax.tree.map(lambda new, old: jnp.where(good, new, old), value, start), count, change, good


@_solve.def_jvp
def _(primals, tangents, **settings):
    (sweep, start), (direction, _) = primals, tangents
    value, *outcome = _solve(sweep, start, **settings)
    pushed = slope_along(lambda sweep: sweep(value), sweep, direction)
    push = jax.linearize(sweep, value)[1]

    def solve_linear(operator, b):
        settled = round_off(jax.tree.leaves(b)[0].dtype)

        def again(v):
            return jax.tree.map(lambda b, v, w: b + v - w, b, v, operator(v))

        value, change, _ = _repeat(again, b, relative_size, settled, settings["max_sweeps"])
        return jax.tree.map(lambda x: jnp.where(change <= 1e3 * settled, x, jnp.nan), value)

    slope = jax.lax.custom_linear_solve(
        lambda v: minus(v, push(v)), pushed, solve=solve_linear, transpose_solve=solve_linear
    )
    return (value, *outcome), (slope, None, None, None)


def constant_map(
    sweep: Callable[[Values], Values], start: Values, acceptable: Callable[[Values], Bool[Array, ""]] = all_finite
) -> FixedPointResult:
    """As `fixed_point`, for a sweep that is known to give the same from wherever it starts: one is enough."""
    value, zero = sweep(jax.lax.stop_gradient(start)), zero_as(start)
    change = jnp.where(all_finite(value), zero, jnp.inf)
    good = computed_once(acceptable(value).astype(zero.dtype)) > 0.5
    value = jax.tree.map(lambda new, old: jnp.where(good, new, old), value, start)
    return FixedPointResult(value, zero + 1.0, change, good)


def _repeat(step, first, size, tolerance, max_sweeps):
    zero = zero_as(first)

    def unsettled(carry):
        _, change, count = carry
        return (change > tolerance) & (count < max_sweeps)

    def body(carry):
        value, _, count = carry
        new = step(value)
        return new, size(minus(new, value), new), count + 1.0

    return jax.lax.while_loop(unsettled, body, (first, zero + jnp.inf, zero))
