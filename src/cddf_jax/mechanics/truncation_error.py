"""How far the answer of a solve may be off: what the Gauss nodes of the elements miss.

A rate that the nodes of an element resolve has Legendre coefficients that fall off. An integral by p Gauss nodes misses
those from degree 2 p on, and the product of what the polynomial leaves out of the rate and out of its weight in the
answer. Where a tendon turns over or becomes slack, the rates have a kink, and a part of the last coefficients is
missed. In space the turning may have a sharp minimum instead, and a part of the next ones is missed.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics import tolerances as tol
from ..numerics.arrays import largest
from ..numerics.elements import last_coefficients
from .problem import Number, Problem, Solution


def truncation_error(problem: Problem, solution: Solution) -> Number:
    """Estimated error of tip tension (relative), tip position (per length) and tip angle (rad), the largest.

    With drag, errors of the tip tension are relative to the tip tension without drag.
    """
    least = jnp.clip(jnp.min(solution.tip.ratio), tol.LEAST_RATIO, 1.0)
    return tol.SAFETY * (solution.missed / least + _unseen_turning(problem))


def missed_in_turning(problem: Problem, width: Number, rates: Float[Array, "branches p ..."]) -> Number:
    """What the nodes of an element miss of r and of the turning of the tendons, from their rates on each branch."""
    rates = rates if problem.has_kinks else problem.geometry.size(rates)
    sharp = problem.has_kinks and problem.geometry.has_frames
    rates = jnp.moveaxis(rates, 1, 0)
    _, following, beyond = _coefficients(width * (rates if sharp else rates[..., None]))
    return largest(tol.AT_MINIMUM * following if sharp else beyond)


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
    last, _, beyond = _coefficients(width / problem.elements.edges[-1] * axis)
    if places is None:
        return largest(beyond)
    kink = tol.AT_KINK if len(places) == 1 else tol.AT_KINKS
    kink = kink * min(1.0, (len(axis) / 8) ** 6)  # with fewer nodes the smooth part has most of the last coefficients
    return largest(beyond + jnp.where(jnp.min(places) < 1, kink, 0.0) * last)


def _coefficients(vectors: Float[Array, "p ..."]) -> tuple[Array, Array, Array]:
    """The last Legendre coefficients of vectors, the next ones, and what the Gauss rule misses, if they fall on so.

    It misses the coefficient of degree 2 p, and products of coefficients. With fewer than 16 nodes that is too much;
    the factor was measured with `benchmarks/error_estimate.py`.
    """
    p = len(vectors)
    last, falls = last_coefficients(jax.lax.stop_gradient(vectors))
    missed = last * falls * jnp.maximum(last, falls ** (p // 2))
    return last, last * falls, missed * min(1.0, (p / 16) ** 2)


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
