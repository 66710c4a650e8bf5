"""Where drag uses up the tension of a tendon, its tension has a kink, and with it the strain of the body.

An element in which a tendon becomes slack is integrated in two parts, up to the place and beyond it. In each part all
rates are polynomials through values at the nodes: with the tension continued below zero, and with no tension. More than
one such place in an element counts as one.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..numerics.elements import gauss_rule, legendre_basis, totals, totals_switched
from ..robot.cross_section import AnySection, where_present
from .friction import PerTendon, Pull

Number = Float[Array, ""]
ROOT_STEPS = 3  # of Newton's method, from the root of the straight line between two nodes


class Tensions(NamedTuple):
    """The tensions at the nodes of an element: one array, or two with the place where one takes over from the other."""

    parts: tuple[Float[Array, "p tendons"], ...]
    place: Number | None = None  # in [0, 1]; 1 where no tendon becomes slack

    def totals(
        self, width: Number, rates: Sequence[Array], integrate: Callable = totals, size: Callable = lambda rate: rate
    ) -> tuple[Array, Array]:
        """The integral of a rate, given for each of the parts, to the nodes of an element and over it.

        `integrate` and `size`: see `totals_switched`.
        """
        if self.place is None:
            return integrate(width, rates[0])
        return totals_switched(integrate, size, width, *rates, self.place)

    def at_nodes(self, values: Sequence[Array]) -> Array:
        """The values at the nodes, given for each of the parts."""
        if self.place is None:
            return values[0]
        before = jnp.asarray(gauss_rule(len(values[0])).nodes, values[0].dtype) < self.place
        return jnp.where(before.reshape(-1, *[1] * (values[0].ndim - 1)), *values)


def tensions_along(
    section: AnySection, base_tension: PerTendon, start: Pull, nodes: Pull, width: Number, rate: Array | None
) -> Tensions:
    """The tensions along an element.

    Args:
        section: at its nodes.
        base_tension: T_base, N.
        start, nodes: the integrated friction at the start and at the nodes of the element.
        width: m.
        rate: c', N/m, at the nodes; not used without drag.
    """
    size = jnp.maximum(jnp.abs(nodes.ratio), jnp.finfo(nodes.ratio.dtype).eps)
    if nodes.spent is None or start.spent is None or rate is None:
        return Tensions((where_present(section, base_tension / size),))
    left, first = base_tension - nodes.spent, base_tension - start.spent
    last = first - totals(width, rate)[1]
    tension = where_present(section, left / size)
    parts = tuple(jnp.where(taut, tension, 0.0) for taut in ((first > 0) | (last > 0), last > 0))
    return Tensions(parts, _first_slack(jnp.concatenate([first[None], left, last[None]]), width * rate))


def _first_slack(values: Float[Array, "q tendons"], falling: Float[Array, "p tendons"]) -> Number:
    """The first place in [0, 1] at which a tendon becomes slack; 1 where none does. Derivatives of any order.

    Args:
        values: T_base - c at the start, the nodes and the end of an element; negative where a tendon is slack.
        falling: the rate at which they fall at the nodes, over an element of width 1.
    """
    rule = gauss_rule(len(falling))
    crosses = (values[:-1] > 0) & (values[1:] <= 0)
    steps = jnp.asarray(np.diff(rule.points)[:, None], values.dtype)
    drop = jnp.where(crosses, values[:-1] - values[1:], 1.0)
    straight = jnp.sum(
        jnp.where(crosses, jnp.asarray(rule.points[:-1, None]) + steps * values[:-1] / drop, 0.0), axis=0
    )

    def newton(place: PerTendon, values: Array, falling: Array) -> PerTendon:
        basis = legendre_basis(place, len(rule.nodes) + 1)
        height = jnp.sum((basis @ jnp.asarray(rule.interpolation, place.dtype)).T * values[:-1], axis=0)
        rise = jnp.sum((basis[:, :-1] @ jnp.asarray(rule.series, place.dtype)).T * falling, axis=0)
        return jnp.clip(place + height / jnp.where(rise > 0, rise, 1.0), 0.0, 1.0)

    still = jax.lax.stop_gradient((values, falling))
    place = jax.lax.stop_gradient(straight)
    for _ in range(ROOT_STEPS):
        place = newton(place, *still)
    return jnp.min(jnp.where(jnp.any(crosses, axis=0), newton(place, values, falling), 1.0))
