"""How far the answer of a solve may be off: what the Gauss nodes of the elements miss.

A rate that the nodes of an element resolve has Legendre coefficients that fall off. An integral by p Gauss nodes misses
those from degree 2 p on. Where a tendon turns over or becomes slack, the rates have a kink, and a part of the last
coefficients is missed. In space the turning may have a sharp minimum instead, and a part of the next ones is missed.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics import tolerances as tol
from ..numerics.arrays import largest
from ..numerics.elements import last_coefficients
from .problem import Number, Problem, Solution


def truncation_error(problem: Problem, solution: Solution) -> Number:
    """Estimated error of tip tension (relative), tip position (per length) and tip angle (rad), the largest."""
    least = jnp.clip(jnp.min(solution.tip.ratio), 1e-3, 1.0)  # r of a tendon that slides out falls, its errors do not
    return tol.SAFETY * (solution.missed / least + _unseen_turning(problem))


def missed_in_turning(problem: Problem, width: Number, rates: Float[Array, "branches p ..."]) -> Number:
    """What the nodes of an element miss of r and of the turning of the tendons, from their rates on each branch."""
    rates = rates if problem.has_kinks else problem.geometry.size(rates)
    last, falls = last_coefficients(width * jnp.moveaxis(jax.lax.stop_gradient(rates), 1, 0))
    sharp = problem.has_kinks and problem.geometry.has_frames
    return largest(tol.AT_MINIMUM * last * falls if sharp else last * falls ** (rates.shape[1] // 2))


def missed_in_place(
    problem: Problem, width: Number, axis: Float[Array, "p components"], places: Float[Array, " places"] | None = None
) -> Number:
    """What the nodes of an element miss of the position over the length, and because of kinks.

    Args:
        problem: the body.
        width: of the element, m.
        axis: at its nodes.
        places: of kinks, in [0, 1]; 1 where there is none. None where there are none.
    """
    last, falls = last_coefficients(width / problem.elements.edges[-1] * jax.lax.stop_gradient(axis))
    missed = last * falls ** (len(axis) // 2)
    if places is None:
        return largest(missed)
    kink = tol.AT_KINK if len(places) == 1 else tol.AT_KINKS
    return largest(missed + jnp.where(jnp.min(places) < 1, kink, 0.0) * last)


def _unseen_turning(problem: Problem) -> Number:
    """The bending angle that the nodes miss, for instance at a narrow notch, rad.

    The moments are taken as constant: T_base d, and M_ext(0) under loads; the curvature is these over E J.
    """
    body, cut = problem.manipulator, problem.elements

    def bend_per_unit(arc_length):  # in a batch over tensions and loads it is computed once
        stiffness = body.stiffness(arc_length)
        return jnp.append(body.offset(arc_length), 1.0) / jnp.where(stiffness > 0, stiffness, 1.0)

    seen = cut.gain(jax.vmap(jax.vmap(bend_per_unit))(cut.nodes))
    missed = jnp.sum(jnp.abs(cut.dense_gain(bend_per_unit, parts=32, order=4) - seen), axis=0)
    angles = problem.base_tension * missed[:-1]
    if problem.loads is not None:
        angles = jnp.append(angles, jnp.abs(problem.base_moment) * missed[-1])  # of a body in space all three
    return largest(angles)
