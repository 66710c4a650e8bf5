"""How far the answer of a solve may be off: what the Gauss nodes of the panels miss."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..numerics.arrays import largest
from ..numerics.rotations import cross, turned_by
from ..robot.cross_section import AnySection
from ..robot.loads import planar_cross
from . import space
from .fixed_point import follow_the_axis, turning_along_axis, turning_in_space
from .friction import ratio_rate, spent_rate
from .problem import (
    AnyState,
    Number,
    Problem,
    Solution,
    at_nodes,
    axis_of,
    curvature_along,
    guarded_section,
    spent_scale,
    strain_along,
    tension_of,
    turning_along,
)

ACCURACY = 1e-5  # a solve with a larger truncation error is not called successful
SAFETY = 5.0  # factor on the difference of two quadratures in the error estimate


def truncation_error(problem: Problem, solution: Solution[AnyState]) -> Number:
    """Estimated error of tip tension (relative), tip position (per length) and tip angle (rad), the largest.

    With drag, errors of the tip tension are relative to the tip tension without drag.
    The rates along the polynomials of the solution are integrated twice: with the nodes of the panels, and with three
    more nodes in each panel. The magnitudes of the differences are summed over the panels.
    """
    cut = problem.panels
    fractions, difference = cut.check_rule
    places = cut.edges[:-1, None] + cut.width[:, None] * jnp.asarray(fractions, cut.edges.dtype)
    sections = jax.vmap(jax.vmap(lambda s: guarded_section(problem.manipulator, s)))(places)
    state = jax.tree.map(lambda a, b: cut.resample(a, b, fractions), solution.starts, solution.nodes)
    rates_of = _shape_rates_in_space if problem.in_space else _shape_rates_in_plane
    turning, axis, turned, moment_rate = rates_of(problem, sections, state, fractions)
    growth = ratio_rate(problem.direction, sections, turning, state.ratio) / solution.tip.ratio
    spending, scale = spent_rate(problem.direction, sections, state.ratio), spent_scale(problem, solution.tip.pull)
    spent = [] if spending is None or scale is None else [spending / scale]
    bending = [moment_rate / problem.moment_scale] if problem.loads is not None else []
    rates = jnp.concatenate([growth, *spent, axis / cut.edges[-1], turned, *bending], axis=-1)
    missed = cut.width[:, None] * jnp.abs(jnp.moveaxis(rates, 1, -1) @ jnp.asarray(difference, rates.dtype))
    return jnp.maximum(SAFETY * largest(jnp.sum(missed, axis=0)), _unseen_turning(problem))


def _shape_rates_in_plane(
    problem: Problem, sections: AnySection, state: AnyState, _: np.ndarray
) -> tuple[Array, Array, Array, Array]:
    """Turning of the tendons, t, phi' and M_ext' at other places of the panels, in the plane."""
    tension = tension_of(sections, problem.base_tension, state.pull)
    kappa = curvature_along(sections, tension, state.moment, state.strain)
    assert state.force is not None
    axis = axis_of(state.heading)
    moment_rate = -planar_cross(axis, state.force)
    turning = turning_along(sections, kappa, tension, problem.direction, moment_rate)
    return turning, axis, kappa[..., None], moment_rate[..., None]


def _shape_rates_in_space(
    problem: Problem, sections: AnySection, state: AnyState, fractions: np.ndarray
) -> tuple[Array, Array, Array, Array]:
    """The same in space. The derivative of the quaternion is doubled, because half an angle stands in it."""
    cut, strain = problem.panels, strain_along(sections, problem.base_tension, state)
    if follow_the_axis(problem):
        turning = turning_along_axis(sections, strain)
    else:
        tangent = at_nodes(space.tangents, (0, 0))(sections, strain)
        rate = cut.extended(cut.differentiate(tangent[:, : cut.order]), fractions)  # the first places are the nodes
        turning = turning_in_space(sections, strain, tangent, rate)
    axis = space.axis_in_fixed_frame(state.heading, strain)
    turned = 2.0 * turned_by(state.heading, space.curvature_of_strain(strain))
    return turning, axis, turned, jnp.zeros_like(axis) if state.force is None else -cross(axis, state.force)


def _unseen_turning(problem: Problem) -> Number:
    """The bending angle that the nodes miss, for instance at a narrow notch, rad.

    The moments are taken as constant: T_base d, and M_ext(0) under loads; the curvature is these over E J.
    """
    body, cut = problem.manipulator, problem.panels

    def bend_per_unit(arc_length):  # in a batch over tensions and loads it is computed once
        stiffness = body.stiffness(arc_length)
        return jnp.append(body.offset(arc_length), 1.0) / jnp.where(stiffness > 0, stiffness, 1.0)

    seen = cut.gain(jax.vmap(jax.vmap(bend_per_unit))(cut.nodes))
    missed = jnp.sum(jnp.abs(cut.dense_gain(bend_per_unit, times=32, order=4) - seen), axis=0)
    angles = problem.base_tension * missed[:-1]
    if problem.loads is not None:
        angles = jnp.append(angles, jnp.abs(problem.base_moment) * missed[-1])  # of a body in space all three
    return largest(angles)
