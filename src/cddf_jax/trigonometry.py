"""Cosine and sine of headings, without branches.

On the CPU, XLA calls a scalar library function for every cosine and sine in double precision; polynomials that it can
vectorise take a sixth of the time.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .reductions import computed_once

# pi in three parts, the first two so short that their products with small integers and halves are exact; then how many
# terms of the Taylor series the precision takes on |x| <= pi / 2
DOUBLE = tuple(map(float.fromhex, ("0x1.921fb54p+1", "0x1.10b46118p-29", "0x1.313198a2e0370p-60"))), 11
SINGLE = tuple(map(float.fromhex, ("0x1.92p+1", "0x1.fb4p-11", "0x1.4442d2p-23"))), 7


@jax.jit  # traced once for every shape
def cos_sin(angle: Float[Array, "*points"]) -> tuple[Float[Array, "*points"], Float[Array, "*points"]]:
    """Cosine and sine of an angle, rad, to rounding errors while |angle| < 1e6 (float32: 1e3)."""
    return _cos_sin(angle)


@jax.custom_jvp
def _cos_sin(angle: Array) -> tuple[Array, Array]:
    turns = angle * (1 / math.pi)
    cosine, sine = -_sine(angle, jnp.floor(turns), 0.5), _sine(angle, jnp.floor(turns + 0.5), 0.0)  # round is slow
    return computed_once(cosine), computed_once(sine)  # not anew for every tangent


def _sine(angle: Array, turns: Array, more: float) -> Array:
    """The sine of angle - (turns + more) pi, its sign changed where `turns` is odd."""
    parts, terms = DOUBLE if angle.dtype == jnp.float64 else SINGLE
    rest = angle
    for part in parts:
        rest = rest - (turns + more) * part
    sine = rest * _series(rest * rest, [(-1) ** k / math.factorial(2 * k + 1) for k in range(terms)])
    return jnp.where(0.5 * turns == jnp.floor(0.5 * turns), sine, -sine)


@_cos_sin.defjvp
def _(primals, tangents):
    cosine, sine = _cos_sin(*primals)
    return (cosine, sine), (-sine * tangents[0], cosine * tangents[0])


def _series(x: Array, coefficients: list[float]) -> Array:
    value = jnp.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = value * x + coefficient
    return value
