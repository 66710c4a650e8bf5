"""Where the tension of a tendon has a kink, and the two smooth branches that meet there.

Friction acts on |psi'|. Where a tendon turns over, psi' changes its sign, and the slope of r' jumps. Where drag has
used up the tension of a tendon, it is slack, and the slope of the tension jumps. An element with such a place is
integrated in two parts, up to the place and beyond it. In each part all rates are polynomials through values at the
nodes, on the branch of that part continued over the whole element. Only the first place in an element counts; at
another sign change the wrap angle is divided as well, but the branches are not.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics.elements import (
    Totals,
    first_root,
    gains,
    gauss_rule,
    sums,
    switched,
    total_to,
    total_to_root,
    totals,
)
from ..robot.cross_section import AnySection, where_present
from .friction import PerTendon, Pull, unspent

Number = Float[Array, ""]
TOGETHER = 0.1  # of an element: tendons that turn over at a smaller distance are taken to do so at one place


class Tensions(NamedTuple):
    """The tensions at the nodes of an element, on one branch, or on two that meet at a place."""

    branches: Float[Array, "branches p tendons"]
    ratios: Float[Array, "branches p tendons"]  # r
    place: Number | None = None  # in [0, 1]; 1 where there is no kink
    signs: Float[Array, "branches tendons"] | None = None  # of psi'; None where they are not known

    def totals(
        self,
        width: Number,
        rates: Array,
        size: Callable[[Array], Array] = lambda rate: rate,
        divided: Callable[[Array], Array] | None = None,
    ) -> Totals:
        """The integral of the size of a rate, given for each branch.

        Args:
            width: of the element, m.
            rates: at its nodes.
            size: the rate itself, its magnitude or its length.
            divided: integrates it over sub-intervals, and divides them where it is not smooth; None where it is.
        """
        if self.place is None and divided is None:
            return totals(width, size(rates[0]))
        over = divided or (lambda rate: gains(size(rate)))
        return sums(width, over(rates[0]) if self.place is None else switched(over, size, rates, self.place))

    def at_nodes(self, values: Array) -> Array:
        """The values at the nodes, given for each branch."""
        if self.place is None:
            return values[0]
        before = jnp.asarray(gauss_rule(values.shape[1]).nodes, values.dtype) < self.place
        return jnp.where(before.reshape(-1, *[1] * (values.ndim - 2)), values[0], values[1])


def tensions_along(section: AnySection, base_tension: PerTendon, pull: Pull, rough: bool = False) -> Tensions:
    """The tensions along an element, with a kink where drag has used one up.

    Args:
        section: at its nodes.
        base_tension: T_base, N.
        pull: the integrated friction at its nodes.
        rough: whether to pass over the kink.
    """
    size = jnp.maximum(jnp.abs(pull.ratio), jnp.finfo(pull.ratio.dtype).eps)
    if pull.spent is None or rough:
        return Tensions(where_present(section, unspent(base_tension, pull) / size)[None], pull.ratio[None])
    left = base_tension - pull.spent
    slack = first_root(left)
    tension = where_present(section, left / size)
    taut = left > 0
    early, late = jnp.where((slack < 1) | taut[0], tension, 0.0), jnp.where((slack < 1) | ~taut[-1], 0.0, tension)
    return Tensions(jnp.stack([early, late]), jnp.stack([pull.ratio] * 2), jnp.min(slack))


def with_smooth_ratios(
    tensions: Tensions, section: AnySection, base_tension: PerTendon, pull: Pull, direction: PerTendon, growth: Array
) -> Tensions:
    """The tensions along an element, whose branches of r are continued smoothly beyond the place where they meet.

    Where no tendon is slack, the branches meet where a tendon turns over.

    Args:
        tensions: with r as it is.
        section: at the nodes of the element.
        base_tension: T_base, N.
        pull: the integrated friction there.
        direction: of the tendons.
        growth: the signed r' over the direction, for an element of width 1, on each branch.
    """
    ratio, nodes = pull.ratio, jnp.asarray(gauss_rule(len(pull.ratio)).nodes, pull.ratio.dtype)[:, None]
    if tensions.place is None:
        rate, turns_at = growth[0], first_root(growth[0])
        place = jnp.min(turns_at)
        apart = 2.0 * direction * jnp.abs(totals(jnp.ones_like(place), rate)[0] - total_to_root(rate))
        over = (turns_at < 1) & (turns_at <= place + TOGETHER)
        apart = jnp.where(over, apart, 0.0)
    else:
        place = tensions.place
        rate = direction * (jnp.sign(growth[1, -1]) * growth[1] - jnp.sign(growth[0, 0]) * growth[0])
        apart = totals(jnp.ones_like(place), rate)[0] - total_to(rate, place)
        apart = jnp.where(place < 1, apart, 0.0)
    ratios = jnp.stack([jnp.where(nodes > place, ratio - apart, ratio), jnp.where(nodes > place, ratio, ratio + apart)])
    size = jnp.maximum(jnp.abs(ratios), jnp.finfo(ratio.dtype).eps)
    if tensions.place is None:
        early = jnp.where(growth[0, 0] < 0, -1.0, 1.0)
        signs = jnp.stack([early, jnp.where(over, -early, early)])
        return Tensions(where_present(section, base_tension / size), ratios, place, signs)
    taut = jnp.where(tensions.branches != 0, 1.0, 0.0)
    left = base_tension - (0.0 if pull.spent is None else pull.spent)
    return Tensions(where_present(section, taut * left / size), ratios, place)
