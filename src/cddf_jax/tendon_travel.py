"""How far tendons slide: the length of their paths through the body, and their own stretch."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .friction import PerTendon
from .problem import Path, Problem, curvature_of, tension_of


def tendon_displacement(problem: Problem, path: Path) -> PerTendon:
    """Length of each tendon pulled in at the base since the straight body without tension, m.

    The tendon's path shortens by the integral of sqrt(1 + d'^2) - |u_c'|, and the tendon itself stretches
    by T / (E A), inside the body and along its free length outside.
    """
    body = problem.manipulator
    rate = shortening_along(problem, path) + stretch_along(problem, path)
    outside = problem.base_tension * body.tendon_compliance * body.tendon_free_length
    return problem.panels.integrate(rate)[0][-1] + outside


def stretch_along(problem: Problem, path: Path) -> Float[Array, "P p tendons"]:
    """By how much each tendon is stretched, T sqrt(1 + d'^2) / (E A) per arc length."""
    tension = tension_of(problem.nodes, problem.base_tension, path.nodes.pull)
    return tension * jnp.sqrt(1.0 + problem.nodes.offset_slope**2) * problem.manipulator.tendon_compliance


def shortening_along(problem: Problem, path: Path) -> Float[Array, "P p tendons"]:
    """Length of each tendon in the straight body less that in the bent one, per arc length."""

    def shortening(section, pull, moment):
        kappa = curvature_of(problem, section, pull, moment)
        # q = 1 - sigma d kappa; sqrt(1 + d'^2) - sqrt(q^2 + d'^2) without cancellation
        bend, slope = section.side * section.offset * kappa, section.offset_slope
        rate = bend * (2.0 - bend) / (jnp.sqrt(1.0 + slope**2) + jnp.sqrt((1.0 - bend) ** 2 + slope**2))
        return jnp.where(section.present, rate, 0.0)

    return jax.vmap(jax.vmap(shortening))(problem.nodes, path.nodes.pull, path.nodes.moment)
