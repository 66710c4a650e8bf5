"""The friction law: how the tension of a tendon changes along the body. No other file of the solver states it.

    T' = -direction (mu |psi'| T + drag)      N/m

The loss by turning at the rate psi' (rad/m) is proportional to the tension: the derivative of Liu et al. (2020),
eq. (8); theta' = |psi'|. The drag (N/m) does not depend on the tension. The solver integrates r and c, which stay
regular where T is zero. By variation of constants, T = (T_base - c) / r with r' = direction mu theta' r and
c' = direction drag r. All functions here state the same law and must be changed together.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics import tolerances as tol
from ..robot.cross_section import AnySection

PerTendon = Float[Array, "... tendons"]  # at one point or several


class Pull(NamedTuple):
    """The integrated friction, from which the tension follows: T = (T_base - c) / r."""

    ratio: Float[Array, "*points tendons"]  # r, which grows where the tendon turns; T_base / T without drag
    spent: Float[Array, "*points tendons"] | None = None  # c, N, used up by drag; None without drag


def bending_loss(direction: PerTendon, section: AnySection, tension: PerTendon) -> PerTendon:
    """The loss of T per radian by which the tendon turns, N."""
    return direction * section.friction_coefficient * tension


def drag_loss(direction: PerTendon, section: AnySection, tension: PerTendon) -> PerTendon | None:
    """The loss of T per length by drag, N/m: 0 where a tendon that slides in is slack; None without drag.

    A slack tendon has T = 0 exactly. `trace` iterates through T < 0; there the law continues smoothly.
    """
    if section.drag is None:
        return None
    return jnp.where((tension != 0) | (direction < 0), direction * section.drag, 0.0)


def tension_rate(direction: PerTendon, section: AnySection, turning: PerTendon, tension: PerTendon) -> PerTendon:
    """T', N/m, of a tendon that turns by psi' = `turning`, rad/m."""
    by_bending = -bending_loss(direction, section, tension) * jnp.abs(turning)
    by_drag = drag_loss(direction, section, tension)
    return by_bending if by_drag is None else by_bending - by_drag


def ratio_factor(section: AnySection, ratio: PerTendon) -> PerTendon:
    """The factor of direction |psi'| in r' = direction mu |psi'| |r|; r < 0 only beyond where a tendon locks."""
    return section.friction_coefficient * jnp.abs(ratio)


def wrap_of(loss: PerTendon, growth: PerTendon) -> PerTendon:
    """The wrap angle theta, rad, by the capstan law r = exp(loss theta).

    Args:
        loss: direction mu.
        growth: the integral of theta' r, so that r = 1 + loss growth.
    """
    grown = jnp.maximum(loss * growth, tol.NOT_LOCKED - 1.0)
    return growth * _near_zero(lambda x: jnp.log1p(x) / x, [(-1.0) ** k / (k + 1) for k in range(7)], grown)


def growth_beyond(direction: PerTendon, section: AnySection, turn: PerTendon, ratio: PerTendon) -> PerTendon:
    """The integral of theta' r over a finite angle `turn` >= 0, rad, with r before it."""
    angle = direction * section.friction_coefficient * turn
    return ratio * turn * _near_zero(lambda x: jnp.expm1(x) / x, [1 / math.factorial(k + 1) for k in range(7)], angle)


def _near_zero(function: Callable[[Array], Array], series: list[float], x: Array) -> Array:
    """A function of x, near 0 by the coefficients of its series."""
    small = jnp.abs(x) < tol.SERIES
    return jnp.where(small, jnp.polyval(jnp.asarray(series[::-1], x.dtype), x), function(jnp.where(small, 1.0, x)))


def is_proportional(section: AnySection) -> bool:
    """Whether the loss of a tendon is proportional to its tension, so that psi' r alone determines r'; static."""
    return section.drag is None


def ratio_beyond(direction: PerTendon, section: AnySection, turn: PerTendon, ratio: PerTendon) -> PerTendon:
    """The ratio r beyond a point where the tendon turns by a finite angle `turn` >= 0, rad."""
    return ratio * jnp.exp(direction * section.friction_coefficient * turn)


def spent_rate(direction: PerTendon, section: AnySection, ratio: PerTendon) -> PerTendon | None:
    """The rate c' = direction drag r, N/m; None without drag. c also grows where a tendon is slack."""
    return None if section.drag is None else direction * section.drag * jnp.abs(ratio)


def unspent(base_tension: PerTendon, pull: Pull) -> Float[Array, "*points tendons"]:
    """T_base - c, N: the base tension less the drag so far; 0 where the tendon is slack."""
    if pull.spent is None:
        return base_tension
    left = base_tension - pull.spent
    return jnp.where(left >= 0, left, 0.0)
