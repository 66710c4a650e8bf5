"""Operations on arrays and trees: reductions, values that vary over devices, cosine and sine.

The reductions are fast in a batch. `zero_as` and `varying_as` make values that vary over devices as loops under
shard_map need them. The cosine and sine are polynomials, which XLA can vectorise.
"""

import math
from functools import reduce
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree, Shaped

Numbers = PyTree  # an array of floating-point numbers or a tree of them
Values = TypeVar("Values")
Scalar = Float[Array, ""]


@jax.jit  # traced once for every shape
def largest(values: Shaped[Array, "*values"]) -> Shaped[Array, ""]:
    """The largest value, by repeated halving: in a batch this is ten times as fast as XLA's reduction on the CPU."""
    return _largest_of_columns(values.ravel())


def _largest_of_columns(values: Shaped[Array, "n *columns"]) -> Shaped[Array, "*columns"]:
    while (n := values.shape[0]) > 1:
        # where n is odd, the middle value is in both halves
        values = jnp.maximum(values[: (n + 1) // 2], values[n // 2 :])
    return values[0]


def largest_size(numbers: Numbers) -> Scalar:
    """The largest magnitude."""
    return largest(jnp.abs(_flat(numbers)))


def largest_sizes(*trees: Numbers) -> tuple[Scalar, ...]:
    """The largest magnitude of each of several trees, which hold equally many numbers."""
    return largest_of_each(*(jnp.abs(_flat(tree)) for tree in trees))


@jax.jit
def largest_of_each(*arrays: Shaped[Array, "..."]) -> tuple[Scalar, ...]:
    """The largest value of each of several arrays of one size."""
    found = _largest_of_columns(jnp.stack([values.ravel() for values in arrays], axis=1))
    return tuple(found[i] for i in range(len(arrays)))


def relative_size(change: Numbers, value: Numbers) -> Scalar:
    """The largest change over the largest value."""
    change, value = largest_sizes(change, value)
    return change / jnp.maximum(value, jnp.finfo(value.dtype).tiny)


def _flat(numbers: Numbers) -> Float[Array, " numbers"]:
    leaves = [x.ravel() for x in jax.tree.leaves(numbers)]
    return leaves[0] if len(leaves) == 1 else jnp.concatenate(leaves)


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


# --- sine and cosine -------------------------------------------------------------------------------
# On the CPU, XLA calls a scalar library function for every cosine and sine in double precision. Polynomials that it can
# vectorise take a sixth of the time, and derivatives reuse the values.

# pi in three parts, the first two so short that their products with small integers and halves are exact; then the
# number of terms of the Taylor series that this precision needs on |x| <= pi / 2
DOUBLE = tuple(map(float.fromhex, ("0x1.921fb54p+1", "0x1.10b46118p-29", "0x1.313198a2e0370p-60"))), 11
SINGLE = tuple(map(float.fromhex, ("0x1.92p+1", "0x1.fb4p-11", "0x1.4442d2p-23"))), 7


@jax.jit  # traced once for every shape
def cos_sin(angle: Float[Array, "*points"]) -> tuple[Float[Array, "*points"], Float[Array, "*points"]]:
    """Cosine and sine of an angle, rad, to rounding errors while |angle| < 1e6 (float32: 1e3)."""
    return _cos_sin(angle)


@jax.custom_jvp
def _cos_sin(angle: Array) -> tuple[Array, Array]:
    # cos(x) = -sin(x - (n + 1 / 2) pi) for even n
    more = np.array([0.5, 0.0], angle.dtype).reshape(2, *[1] * angle.ndim)
    turns = jnp.floor(angle * (1 / math.pi) + (0.5 - more))  # rounding by `jnp.round` is slow
    parts, terms = DOUBLE if angle.dtype == jnp.float64 else SINGLE
    rest = jnp.broadcast_to(angle, turns.shape)
    for part in parts:
        rest = rest - (turns + more) * part
    sine = rest * _series(rest * rest, [(-1) ** k / math.factorial(2 * k + 1) for k in range(terms)])
    even = 0.5 * turns == jnp.floor(0.5 * turns)
    both = computed_once(jnp.where(even == (more == 0), sine, -sine))  # and not again for every tangent
    return both[0], both[1]


@_cos_sin.defjvp
def _(primals, tangents):
    cosine, sine = _cos_sin(*primals)
    return (cosine, sine), (-sine * tangents[0], cosine * tangents[0])


def _series(x: Array, coefficients: list[float]) -> Array:
    value = jnp.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = value * x + coefficient
    return value
