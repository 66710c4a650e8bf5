"""Where the tension of a tendon has a kink, and the smooth branches that meet there.

Friction acts on |psi'|. Where a tendon turns over, psi' changes its sign, and the slope of r' jumps. Where drag has
used up the tension of a tendon, it is slack, and the slope of the tension jumps. An element with such places is
integrated in parts between them. In each part all rates are polynomials through values at the nodes, on the branch of
that part continued over the whole element. Of each tendon the first place in an element counts; at another sign change
the wrap angle is divided as well, but the branches are not.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics.elements import (
    Size,
    SizeOver,
    Totals,
    first_root,
    gauss_rule,
    quartics,
    sums,
    switched,
    total_to,
    total_to_root,
    totals,
)
from ..robot.cross_section import AnySection, where_present
from .friction import PerTendon, Pull, unspent

Number = Float[Array, ""]


class Tensions(NamedTuple):
    """The tensions at the nodes of an element, on branches that meet at places."""

    branches: Float[Array, "branches p tendons"]
    ratios: Float[Array, "branches p tendons"]  # r
    places: Float[Array, " places"] | None = None  # in [0, 1], increasing; 1 where there is no kink
    signs: Float[Array, "branches tendons"] | None = None  # of psi'; None, or 0 where it is not one
    spread: Number | None = None  # between the places where tendons become slack, of which the first one counts

    def totals(
        self,
        width: Number,
        rates: Array,
        size: Size = lambda rate: rate,
        divided: SizeOver | None = None,
    ) -> Totals:
        """The integral of the size of a rate, given for each branch.

        Args:
            width: of the element, m.
            rates: at its nodes.
            size: the rate itself, its magnitude or its length.
            divided: integrates it over sub-intervals, and divides them where it is not smooth; None where it is, and
                the size is then the rate itself.
        """
        if self.places is not None:
            return sums(width, switched(size, divided, rates, self.places))
        if divided is None:
            return totals(width, size(rates[0]))
        return sums(width, divided(rates[0], quartics(rates[0])))

    def at_nodes(self, values: Array) -> Array:
        """The values at the nodes, given for each branch."""
        found = values[0]
        nodes = jnp.asarray(gauss_rule(values.shape[1]).nodes, values.dtype).reshape(-1, *[1] * (values.ndim - 2))
        for place, beyond in zip([] if self.places is None else self.places, values[1:], strict=True):
            found = jnp.where(nodes < place, found, beyond)
        return found


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
    # where drag adds tension, none becomes slack
    slack = jnp.where(left[-1] < left[0], first_root(quartics(left)), 1.0)
    tension = where_present(section, left / size)
    taut = left > 0
    early, late = jnp.where((slack < 1) | taut[0], tension, 0.0), jnp.where((slack < 1) | ~taut[-1], 0.0, tension)
    first = jnp.min(slack)
    spread = jnp.max(jnp.where(slack < 1, slack, first)) - first
    return Tensions(jnp.stack([early, late]), jnp.stack([pull.ratio] * 2), first[None], spread=spread)


def with_smooth_ratios(
    tensions: Tensions,
    section: AnySection,
    base_tension: PerTendon,
    pull: Pull,
    direction: PerTendon,
    growth: Array,
    apart: bool,
) -> Tensions:
    """The tensions along an element, whose branches of r are continued smoothly beyond the places where they meet.

    Args:
        tensions: with r as it is.
        section: at the nodes of the element.
        base_tension: T_base, N.
        pull: the integrated friction there.
        direction: of the tendons.
        growth: the signed r' over the direction, for an element of width 1, on each branch.
        apart: whether each tendon turns over at a place of its own; otherwise all do at one.
    """
    if tensions.places is None:
        own, differs, signs = _where_turning_over(growth[0])
        places = jnp.sort(own) if apart else jnp.min(own)[None]
        taut, left = 1.0, base_tension
    else:
        own, differs, signs = _where_slack(growth, tensions.places, apart)
        places = tensions.places if apart else jnp.min(own)[None]
        assert pull.spent is not None
        taut, left = jnp.where(tensions.branches != 0, 1.0, 0.0), base_tension - pull.spent
    passed = own <= places[:, None] if apart else jnp.ones((1, *own.shape), bool)
    late = jnp.concatenate([jnp.zeros((1, *own.shape), bool), passed])
    beyond = jnp.asarray(gauss_rule(len(pull.ratio)).nodes, pull.ratio.dtype)[:, None] > own
    shift = jnp.where(late[:, None], 1.0, 0.0) - jnp.where(beyond, 1.0, 0.0)
    # branch by branch: as one product of arrays, a gradient of a batch takes longer
    ratios = jnp.stack([pull.ratio + each * (direction * differs) for each in shift])
    size = jnp.maximum(jnp.abs(ratios), jnp.finfo(ratios.dtype).eps)
    signs = None if signs is None else jnp.where(late, signs[1], signs[0])
    return Tensions(where_present(section, taut * left / size), ratios, places, signs, tensions.spread)


def _where_turning_over(growth: Float[Array, "p tendons"]) -> tuple[Array, Array, Array]:
    """Where tendons turn over, by how much the branches of r are apart, and the signs of psi' before and beyond.

    Beyond that place, r' is |g| on one branch and -|g| on the other, so that r differs by 2 |integral of g from there|.
    """
    curve, left = quartics(growth), growth < 0
    places = first_root(curve)
    differs = 2.0 * jnp.abs(totals(jnp.ones_like(places[0]), growth)[0] - total_to_root(curve, places))
    early, last = (jnp.where(side, -1.0, 1.0) for side in (left[0], left[-1]))
    once = (jnp.sum(left[1:] != left[:-1], axis=0) == 1) & (early * last < 0)
    over = places < 1
    late = jnp.where(over, jnp.where(once, -early, 0.0), jnp.where(early == last, early, 0.0))
    return places, jnp.where(over, differs, 0.0), jnp.stack([early, late])


def _where_slack(growth: Array, place: Float[Array, " 1"], apart: bool) -> tuple[Array, Array, Array | None]:
    """As `_where_turning_over`, where a tendon becomes slack at a place; where none does, tendons may turn over."""
    differs = _apart_where_slack(growth, place[0])
    if apart:
        return place, differs, None
    both = zip((place, differs, 0.0), _where_turning_over(growth[0]), strict=True)
    own, differs, signs = (jnp.where(place < 1, slack, over) for slack, over in both)
    return own, differs, signs


def _apart_where_slack(growth: Float[Array, "2 p tendons"], place: Number) -> Float[Array, "p tendons"]:
    """By how much the branches of r are apart, where a tendon becomes slack at a place."""
    early, late = growth
    rate = jnp.sign(late[-1]) * late - jnp.sign(early[0]) * early
    apart = totals(jnp.ones_like(place), rate)[0] - total_to(quartics(rate), place)
    return jnp.where(place < 1, apart, 0.0)
