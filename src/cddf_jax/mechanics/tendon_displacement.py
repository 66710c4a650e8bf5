"""How far tendons slide at the base: by the length of their paths through the body, and by their own stretch."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..robot.cross_section import CrossSection, planar, where_present
from ..robot.manipulator import Manipulator
from . import space
from .friction import PerTendon
from .problem import AnyState, Number, Problem, at_nodes, curvature_along, strain_along, tension_of


def tendon_displacement(problem: Problem, state: AnyState) -> PerTendon:
    """The length of each tendon pulled in at the base, m: zero for the straight body without tension.

    Args:
        problem: the body.
        state: at its nodes.
    """
    body = problem.manipulator
    outside = stretch_rate(body.tendon_compliance, problem.base_tension) * body.tendon_free_length
    tension = tension_of(problem.nodes, problem.base_tension, state.pull)
    if problem.in_space:
        strain = strain_along(problem.nodes, problem.base_tension, state)
        rate = at_nodes(space.slip_rate_in_space, (0, 0, 0, None))(
            problem.nodes, strain, tension, body.tendon_compliance
        )
    else:
        kappa = curvature_along(problem.nodes, tension, state.moment, state.strain)
        rate = displacement_rate(body, planar(problem.nodes), kappa, tension)
    return jnp.sum(problem.panels.gain(rate), axis=0) + outside


def displacement_rate(
    manipulator: Manipulator,
    section: CrossSection,
    curvature: Float[Array, "P p"],
    tension: Float[Array, "P p tendons"],
) -> Float[Array, "P p tendons"]:
    """By how much a tendon's path shortens and the tendon stretches per arc length, at the nodes."""
    return at_nodes(slip_rate, (0, 0, 0, None))(section, curvature, tension, manipulator.tendon_compliance)


def slip_rate(section: CrossSection, curvature: Number, tension: PerTendon, compliance: PerTendon) -> PerTendon:
    """By how much a tendon's path shortens and the tendon stretches per arc length, at one cross-section.

    The path shortens by sqrt(1 + d'^2) - |u_c'|; the tendon stretches by T sqrt(1 + d'^2) / (E A).

    Args:
        section: the cross-section.
        curvature: kappa, 1/m.
        tension: T, N.
        compliance: 1 / (E A), 1/N.
    """
    # q = 1 - sigma d kappa; sqrt(1 + d'^2) - sqrt(q^2 + d'^2) without cancellation
    bend, slope = section.side * section.offset * curvature, section.offset_slope
    straight = jnp.sqrt(1.0 + slope**2)
    rate = bend * (2.0 - bend) / (straight + jnp.sqrt((1.0 - bend) ** 2 + slope**2))
    return where_present(section, rate) + stretch_rate(compliance, tension * straight)


def stretch_rate(compliance: PerTendon, tension: Array, section: CrossSection | None = None) -> Array:
    """By how much a tendon stretches per length.

    It is T / (E A) per length outside the body, and T sqrt(1 + d'^2) / (E A) per arc length within it. Half of this
    times T is the elastic energy of the tendon per length.
    """
    along = tension if section is None else tension * jnp.sqrt(1.0 + section.offset_slope**2)
    return along * compliance
