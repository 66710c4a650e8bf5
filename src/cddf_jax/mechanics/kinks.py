"""Where the tension of a tendon has a kink, and the two smooth branches that meet there.

Friction acts on |psi'|. Where a tendon turns over, psi' changes its sign, and the slope of r' jumps. Where drag has used
up the tension of a tendon, it is slack, and the slope of the tension jumps. An element with such a place is integrated
in two parts, up to the place and beyond it. In each part all rates are polynomials through values at the nodes, on the
branch of that part continued over the whole element. Only the first place in an element counts; at another sign change
the wrap angle is divided as well, but the branches are not.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics.elements import first_root, gauss_rule, totals, totals_switched
from ..robot.cross_section import AnySection, where_present
from .friction import PerTendon, Pull

Number = Float[Array, ""]
TOGETHER = 1e-9  # of an element: tendons that turn over at a smaller distance do so at one place


class Tensions(NamedTuple):
    """The tensions at the nodes of an element: one array, or two branches and the place where they meet."""

    branches: tuple[Float[Array, "p tendons"], ...]
    place: Number | None = None  # in [0, 1]; 1 where there is no kink

    def totals(
        self, width: Number, rates: Sequence[Array], integrate: Callable = totals, size: Callable = lambda rate: rate
    ) -> tuple[Array, Array]:
        """The integral of a rate, given for each branch, to the nodes of an element and over it.

        `integrate` and `size`: see `totals_switched`.
        """
        if self.place is None:
            return integrate(width, rates[0])
        return totals_switched(integrate, size, width, *rates, self.place)

    def at_nodes(self, values: Sequence[Array]) -> Array:
        """The values at the nodes, given for each branch."""
        if self.place is None:
            return values[0]
        before = jnp.asarray(gauss_rule(len(values[0])).nodes, values[0].dtype) < self.place
        return jnp.where(before.reshape(-1, *[1] * (values[0].ndim - 1)), *values)


def tensions_along(section: AnySection, base_tension: PerTendon, pull: Pull) -> Tensions:
    """The tensions along an element, with a kink where drag has used one up.

    Args:
        section: at its nodes.
        base_tension: T_base, N.
        pull: the integrated friction at its nodes.
    """
    size = jnp.maximum(jnp.abs(pull.ratio), jnp.finfo(pull.ratio.dtype).eps)
    if pull.spent is None:
        return Tensions((where_present(section, base_tension / size),))
    left = base_tension - pull.spent
    slack = first_root(left)
    tension = where_present(section, left / size)
    taut = left > 0
    early, late = jnp.where(slack.exists | taut[0], tension, 0.0), jnp.where(taut[-1], tension, 0.0)
    return Tensions((early, jnp.where(slack.exists, 0.0, late)), jnp.min(slack.place))


def reversing(
    section: AnySection, base_tension: PerTendon, ratio: Array, direction: PerTendon, growth: Array
) -> Tensions:
    """The tensions along an element without drag in which tendons may turn over.

    Beyond the place z where r' / direction = |g| has a kink, the branches of r differ by 2 |integral of g from z|.

    Args:
        section: at its nodes.
        base_tension: T_base, N.
        ratio: r at the nodes.
        direction: of the tendons.
        growth: g, over an element of width 1, at the nodes.
    """
    turn = first_root(growth)
    place = jnp.min(turn.place)
    apart = 2.0 * direction * jnp.abs(totals(jnp.ones_like(place), growth)[0] - turn.total)
    apart = jnp.where(turn.exists & (turn.place <= place + TOGETHER), apart, 0.0)
    beyond = jnp.asarray(gauss_rule(len(ratio)).nodes, place.dtype)[:, None] > place
    branches = jnp.where(beyond, ratio - apart, ratio), jnp.where(beyond, ratio, ratio + apart)
    least = jnp.finfo(ratio.dtype).eps
    tensions = (where_present(section, base_tension / jnp.maximum(jnp.abs(branch), least)) for branch in branches)
    return Tensions(tuple(tensions), place)
