"""How far the answer of a solve may be off: what the Gauss nodes of the elements miss."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics import tolerances as tol
from ..numerics.arrays import largest
from ..numerics.elements import Elements
from .march import FixedPoint
from .problem import Method, Number, Problem, Solution, State, lay_out, nodal, spent_scale


def truncation_error(problem: Problem, solution: Solution, method: Method) -> Number:
    """Estimated error of tip tension (relative), tip position (per length) and tip angle (rad), the largest.

    With drag, errors of the tip tension are relative to the tip tension without drag.
    One more iteration is made with more nodes in each element, from the polynomials of the solution; several where the
    tension may have a kink, which polynomials round off. By how much the gains over the elements differ is summed over
    the elements.
    """
    cut, once = problem.elements, FixedPoint()
    finer = Elements.between(cut.edges, cut.order + tol.MORE_NODES)
    fine = lay_out(problem.manipulator, problem.base_tension, problem.direction, 0, problem.loads, finer)
    fine = eqx.tree_at(lambda fine: fine.base_moment, fine, problem.base_moment)
    resample = partial(cut.resample, places=finer.rule.nodes)
    state = jax.tree.map(resample, solution.starts, solution.nodes, solution.ends)

    def again(last: tuple, _: None) -> tuple[tuple, Solution]:
        found = once.finish(fine, *last)
        return (nodal(fine, found.nodes), found.nodes.strain), found

    count = tol.KINK_ITERATIONS if problem.has_kinks else 1
    found = jax.tree.map(lambda x: x[-1], jax.lax.scan(again, (nodal(fine, state), state.strain), length=count)[1])
    if not isinstance(method, FixedPoint):  # it may have ended before it settled, which is another error
        solution = once.finish(problem, nodal(problem, solution.nodes), solution.nodes.strain)
    missed = jnp.sum(jnp.abs(_gains(problem, found) - _gains(problem, solution)), axis=0)
    safety = tol.SAFETY * tol.WITH_KINKS if problem.has_kinks else tol.SAFETY
    rounding = 16 * float(jnp.finfo(missed.dtype).eps)  # which `solve` adds by itself
    return jnp.maximum(safety * jnp.maximum(largest(missed) - rounding, 0.0), _unseen_turning(problem))


def _gains(problem: Problem, solution: Solution) -> Float[Array, "P values"]:
    """The gains over the elements of all that is integrated, each over its scale."""
    tip = solution.tip
    scale = spent_scale(problem, tip.pull)

    def scaled(state: State) -> Float[Array, " values"]:
        ratio = state.ratio / tip.ratio
        spent = [] if scale is None or state.pull.spent is None else [state.pull.spent / scale]
        turned = (2.0 if problem.geometry.has_frames else 1.0) * state.heading  # half an angle stands in a quaternion
        parts = ratio, *spent, turned, state.position / problem.elements.edges[-1], state.moment / problem.moment_scale
        return jnp.concatenate([jnp.atleast_1d(part) for part in parts])

    return jnp.diff(jnp.concatenate([jax.vmap(scaled)(solution.starts), scaled(tip)[None]]), axis=0)


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
