"""How far tendons slide at the base: by the length of their paths through the body, and by their own stretch."""

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..robot.cross_section import AnySection
from .bending import stretch_rate
from .friction import PerTendon, Pull, spent_rate
from .problem import Number, Problem, State
from .slack import tensions_along


def tendon_displacement(problem: Problem, state: State) -> PerTendon:
    """The length of each tendon pulled in at the base, m: zero for the straight body without tension.

    Args:
        problem: the body.
        state: at its nodes.
    """
    body, cut, geometry = problem.manipulator, problem.elements, problem.geometry
    spending = spent_rate(problem.direction, problem.nodes, state.ratio)
    spent = None if spending is None else cut.integrate(spending)[0][:-1]

    def gain(
        width: Number, section: AnySection, state: State, spending: Array | None, spent: Array | None
    ) -> PerTendon:
        start = Pull(jnp.ones_like(state.ratio[0]), spent)
        tensions = tensions_along(section, problem.base_tension, start, state.pull, width, spending)
        at = state.heading, state.moment, state.force, state.strain
        strains = [jax.vmap(geometry.strain)(section, tension, *at) for tension in tensions.parts]
        slip = jax.vmap(geometry.slip_rate, (0, 0, 0, None))
        rates = [slip(section, *each, body.tendon_compliance) for each in zip(strains, tensions.parts, strict=True)]
        return tensions.totals(width, rates)[1]

    outside = stretch_rate(body.tendon_compliance, problem.base_tension) * body.tendon_free_length
    return jnp.sum(jax.vmap(gain)(cut.width, problem.nodes, state, spending, spent), axis=0) + outside
