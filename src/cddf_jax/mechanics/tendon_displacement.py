"""How far tendons slide at the base: by the length of their paths through the body, and by their own stretch."""

import jax.numpy as jnp

from .bending import stretch_rate
from .friction import PerTendon
from .problem import Problem, State, at_nodes, strain_along, tension_of


def tendon_displacement(problem: Problem, state: State) -> PerTendon:
    """The length of each tendon pulled in at the base, m: zero for the straight body without tension.

    Args:
        problem: the body.
        state: at its nodes.
    """
    body = problem.manipulator
    outside = stretch_rate(body.tendon_compliance, problem.base_tension) * body.tendon_free_length
    tension = tension_of(problem.nodes, problem.base_tension, state.pull)
    strain = strain_along(problem.nodes, problem.base_tension, state)
    slip_rate = at_nodes(problem.geometry.slip_rate, (0, 0, 0, None))
    rate = slip_rate(problem.nodes, strain, tension, body.tendon_compliance)
    return jnp.sum(problem.elements.gain(rate), axis=0) + outside
