"""The friction law: how the tension of a tendon changes along the body. No other file of the solver states it.

    T' = -direction (mu |psi'| T + drag)      N/m

The loss by turning at the rate psi' (rad/m) is proportional to the tension: the derivative of Liu et al. (2020),
eq. (8). The drag (N/m) does not depend on the tension. The solver integrates r and c, which stay regular where T is
zero. By variation of constants, T = (T_base - c) / r with r' = direction mu |psi'| r and c' = direction drag r. All
functions here state the same law and must be changed together; `tests/mechanics/test_friction.py` compares them.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

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
