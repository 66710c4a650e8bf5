"""Cosine and sine of headings, without branches.

On the CPU, XLA calls a scalar library function for every cosine and sine in double precision; polynomials that it can
vectorise take a sixth of the time.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

# pi / 2 in three parts, the first two so short that their products with small integers are exact; then how many terms
# of the Taylor series the precision takes on |x| <= pi / 4
DOUBLE = tuple(map(float.fromhex, ("0x1.921fb54p+0", "0x1.10b46118p-30", "0x1.313198a2e0370p-61"))), 8
SINGLE = tuple(map(float.fromhex, ("0x1.92p+0", "0x1.fb4p-12", "0x1.4442d2p-24"))), 5


@jax.custom_jvp
def cos_sin(angle: Float[Array, "*points"]) -> tuple[Float[Array, "*points"], Float[Array, "*points"]]:
    """Cosine and sine of an angle, rad, to the last bit but one while |angle| < 1e6 (float32: 1e3)."""
    parts, terms = DOUBLE if angle.dtype == jnp.float64 else SINGLE
    quarter = jnp.round(angle * (2 / math.pi))
    rest = angle
    for part in parts:
        rest = rest - quarter * part
    square = rest * rest
    sine = rest * _series(square, [(-1) ** k / math.factorial(2 * k + 1) for k in range(terms)])
    cosine = _series(square, [(-1) ** k / math.factorial(2 * k) for k in range(terms + 1)])
    quadrant = quarter - 4 * jnp.floor(quarter / 4)
    odd = (quadrant == 1) | (quadrant == 3)
    across, along = jnp.where(odd, sine, cosine), jnp.where(odd, cosine, sine)
    cosine = jnp.where((quadrant == 1) | (quadrant == 2), -across, across)
    sine = jnp.where(quadrant >= 2, -along, along)
    length = 0.5 + 0.5 * (cosine * cosine + sine * sine)  # 1, but for rounding; a quotient is not computed anew
    return cosine / length, sine / length  # for every tangent


@cos_sin.defjvp
def _(primals, tangents):
    cosine, sine = cos_sin(*primals)
    return (cosine, sine), (-sine * tangents[0], cosine * tangents[0])


def _series(x: Array, coefficients: list[float]) -> Array:
    value = jnp.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = value * x + coefficient
    return value
