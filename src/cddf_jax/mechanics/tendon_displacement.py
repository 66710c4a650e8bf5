"""How far tendons slide at the base: by the length of their paths through the body, and by their own stretch."""

import jax
import jax.numpy as jnp

from ..robot.cross_section import AnySection
from .friction import PerTendon
from .kinks import tensions_along
from .problem import Number, Problem, State


def tendon_displacement(problem: Problem, state: State) -> PerTendon:
    """The length of each tendon pulled in at the base, m: zero for the straight body without tension.

    Args:
        problem: the body.
        state: at its nodes.
    """
    body, geometry = problem.manipulator, problem.geometry

    def gain(width: Number, section: AnySection, state: State) -> PerTendon:
        tensions = tensions_along(section, problem.base_tension, state.pull, problem.rough)
        at = state.heading, state.moment, state.force, state.strain
        strain = jax.vmap(jax.vmap(geometry.strain), (None, 0, None, None, None, None))(section, tensions.branches, *at)
        slip = jax.vmap(jax.vmap(geometry.slip_rate, (0, 0, 0, None)), (None, 0, 0, None))
        rates = slip(section, strain, tensions.branches, body.tendon_compliance)
        return tensions.totals(width, rates)[1]

    outside = problem.base_tension * body.tendon_outside_compliance
    return jnp.sum(jax.vmap(gain)(problem.elements.width, problem.nodes, state), axis=0) + outside
