"""Operations on arrays and trees: reductions, values that vary over devices, text, cosine and sine, evaluation.

The reductions are fast in a batch. `zero_as` and `varying_as` make values that vary over devices as loops under
shard_map need them. The cosine and sine are polynomials, which XLA can vectorise.
"""

import math
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree, Shaped

Numbers = PyTree  # an array of floating-point numbers or a tree of them
Values = TypeVar("Values")
Scalar = Float[Array, ""]
FEW = 6  # values that XLA reduces as fast as halves of them


@jax.jit  # traced once for every shape
def largest(values: Shaped[Array, "*values"]) -> Shaped[Array, ""]:
    """The largest value, by halving down to a few: in a batch on the CPU this is faster than XLA's reduction of all."""
    values = values.ravel()
    while (n := values.size) > FEW:
        values = jnp.maximum(values[: (n + 1) // 2], values[n // 2 :])  # where n is odd, the middle one is in both
    return jnp.max(values)


def largest_size(numbers: Numbers) -> Scalar:
    """The largest magnitude."""
    return largest(jnp.abs(_flat(numbers)))


def relative_size(change: Numbers, value: Numbers) -> Scalar:
    """The largest change over the largest value."""
    value = largest_size(value)
    return largest_size(change) / jnp.maximum(value, jnp.finfo(value.dtype).tiny)


def _flat(numbers: Numbers) -> Float[Array, " numbers"]:
    leaves = [x.ravel() for x in jax.tree.leaves(numbers)]
    return leaves[0] if len(leaves) == 1 else jnp.concatenate(leaves)


def sum_of(parts: Sequence[Array]) -> Array:
    """The sum of a few arrays."""
    return reduce(jnp.add, parts)


def added_up(values: Float[Array, "few *k"]) -> Float[Array, "*k"]:
    """The sum along the first axis, which is short.

    XLA hands its own sum of products over a short axis to a library that takes up to ten times as long in a batch.
    """
    return sum_of(jnp.split(values, len(values)))[0]


def all_finite(numbers: Numbers) -> Bool[Array, ""]:
    """Whether there is neither infinity nor NaN."""
    return jnp.isfinite(largest_size(numbers))


def computed_once(x: Float[Array, "*values"]) -> Float[Array, "*values"]:
    """The same finite numbers as a quotient, because XLA computes a quotient once and not in every expression again."""
    return x / (1.0 + 0.0 * x)


def zero_as(*numbers: PyTree) -> Float[Array, ""]:
    """0, which varies over the same devices of shard_map as the numbers of the trees; arrays of integers are left out.

    Under shard_map, the values that a loop carries must vary over the same devices before and after each pass of the
    loop. A zero made of the numbers that enter the loop does so. XLA treats this zero as a constant, unlike 0 * x.
    """
    real = [x for x in jax.tree.leaves(numbers) if isinstance(x, float | int) or eqx.is_inexact_array(x)]
    return reduce(jnp.add, [jax.lax.full_like(x, 0, shape=()) for x in real])


def varying_as(tree: Values, zero: Scalar) -> Values:
    """The same values, which vary over the same devices of shard_map as `zero`; `zero` is 0."""

    def varying(x: Array) -> Array:
        return x ^ (zero != 0) if x.dtype == bool else x + zero.astype(x.dtype)

    return jax.tree.map(varying, tree)


def words_or_shapes(in_words: Callable[[Values], str], tree: Values) -> str:
    """The words for a tree, or of a batch, a traced or a filtered tree its names and shapes: printing never fails."""
    try:
        return in_words(tree)
    except Exception:  # whatever stands in the place of numbers
        return eqx.tree_pformat(tree)


# --- sine and cosine -------------------------------------------------------------------------------
# On the CPU, XLA calls a scalar library function for every cosine and sine in double precision. Polynomials that it can
# vectorise take a sixth of the time, and derivatives reuse the values.

# pi in three parts, the first two so short that their products with small integers and halves are exact; then the
# polynomial in x^2 that is nearest to sin(x) / x on |x| <= pi / 2: by Remez, with errors of 2e-19 and 4e-9
DOUBLE = (
    tuple(map(float.fromhex, ("0x1.921fb54p+1", "0x1.10b46118p-29", "0x1.313198a2e0370p-60"))),
    (
        1.0,
        -0.16666666666666666,
        0.008333333333333186,
        -0.00019841269841208676,
        2.7557319211229606e-06,
        -2.505210689056952e-08,
        1.605894087848656e-10,
        -7.643026557971632e-13,
        2.7215749422983443e-15,
    ),
)
SINGLE = (
    tuple(map(float.fromhex, ("0x1.92p+1", "0x1.fb4p-11", "0x1.4442d2p-23"))),
    (0.999999995698809, -0.16666657947846011, 0.008333050170671773, -0.00019809017408678003, 2.605107635334788e-06),
)


@jax.jit  # traced once for every shape
def cos_sin(angle: Float[Array, "*points"]) -> tuple[Float[Array, "*points"], Float[Array, "*points"]]:
    """Cosine and sine of an angle, rad, to rounding errors while |angle| < 1e6 (float32: 1e3)."""
    return _cos_sin(angle)


@jax.custom_jvp
def _cos_sin(angle: Array) -> tuple[Array, Array]:
    # cos(x) = -sin(x - (n + 1 / 2) pi) for even n
    more = np.array([0.5, 0.0], angle.dtype).reshape(2, *[1] * angle.ndim)
    turns = jnp.floor(angle * (1 / math.pi) + (0.5 - more))  # rounding by `jnp.round` is slow
    parts, coefficients = DOUBLE if angle.dtype == jnp.float64 else SINGLE
    rest = jnp.broadcast_to(angle, turns.shape)
    whole = turns + more
    for part in parts:
        rest = rest - whole * part
    sine = rest * _polynomial(rest * rest, coefficients)
    even = 0.5 * turns == jnp.floor(0.5 * turns)
    both = computed_once(jnp.where(even == (more == 0), sine, -sine))  # and not again for every tangent
    return both[0], both[1]


@_cos_sin.defjvp
def _(primals, tangents):
    cosine, sine = _cos_sin(*primals)
    return (cosine, sine), (-sine * tangents[0], cosine * tangents[0])


def _polynomial(x: Array, coefficients: tuple[float, ...]) -> Array:
    value = jnp.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = value * x + coefficient
    return value


def evaluated(function: Callable[..., Any], *arguments: Any) -> Any:
    """The result of a function, or of a callable pytree such as a profile, with NumPy arrays.

    It is compiled as one program, because else JAX compiles a program for every operation. Numbers among the arguments
    must be arrays, as every Python number makes another program.
    """
    return jax.tree.map(np.asarray, _called(function, *arguments))


@eqx.filter_jit
def _called(function: Callable[..., Any], *arguments: Any) -> Any:
    return function(*arguments)
