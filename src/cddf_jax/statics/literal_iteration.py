"""The algorithm of Liu et al. (2020), section III, as published: as a method of `solve`, and step by step."""

from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.tree_util import Partial
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from ..mechanics import bending
from ..mechanics.directions import Directions, not_stated
from ..mechanics.friction import PerTendon, Pull
from ..mechanics.geometry import axis_of
from ..mechanics.march import FixedPoint
from ..mechanics.problem import (
    BodyStates,
    Problem,
    Solution,
    State,
    lay_out,
    line_up,
    nodal,
    starts_of_newton,
    strain_along,
    tension_of,
)
from ..numerics.elements import Elements
from ..numerics.fixed_point import FixedPointResult, fixed_point, without_derivative
from ..numerics.given_numbers import check_whole
from ..robot.cross_section import planar, where_present
from ..robot.manipulator import Manipulator
from ..robot.validation import refuse_memory
from .arguments import check_method, one_precision, per_tendon
from .solve import solve


class LiteralIteration(eqx.Module):
    """The paper's algorithm, Liu et al. (2020), section III: kappa_new = M[kappa_old] / (E J).

    It starts from the frictionless shape, eq. (17), evaluates eq. (14) at the last shape, and stops
    when the tip moves by less than the threshold, eq. (18). In the published kinematics it contracts
    only where T d^2 < E J all along the body.

    Args:
        tip_tolerance: e_tip,th, m. The error estimate contains the last motion over the length, which is smaller than
            the error where the map contracts slowly.
        max_updates: the largest number of updates.
    """

    tip_tolerance: float = eqx.field(default=1e-4, static=True)
    max_updates: int = eqx.field(default=100, static=True)

    def __call__(self, problem: Problem) -> Solution:
        _refuse_drag(problem.manipulator)
        answer = fixed_point(
            Partial(literal_update, problem),
            frictionless_curvature(problem),
            tolerance=self.tip_tolerance,
            max_iterations=self.max_updates,
            size=Partial(_tip_motion, without_derivative(problem.elements)),
        )
        return _as_solution(problem, answer)


def _as_solution(problem: Problem, answer: FixedPointResult) -> Solution:
    """The states along the body for a shape that was found, with the capstan law along it."""
    cut, gain = problem.elements, problem.direction * problem.manipulator.tendon_friction
    wrap, (heading, position) = literal_wrap_angle(problem, answer.value), integrate_shape(cut, answer.value)
    strains = starts_of_newton(problem, answer.value)

    def states(at: int, force: Array) -> State:
        pull, moment = Pull(jnp.exp(gain * wrap[at])), jnp.zeros_like(heading[at])
        return State(pull, heading[at], moment, force, None, wrap[at], position[at])

    edges, nodes = states(0, jnp.zeros_like(position[0])), states(1, problem.outboard.nodes)
    starts, ends = jax.tree.map(lambda x: x[:-1], edges), jax.tree.map(lambda x: x[1:], edges)
    around = (state._replace(strain=strain) for state, strain in zip((starts, nodes, ends), strains, strict=True))
    return Solution(
        BodyStates(*around),
        num_iterations=answer.num_iterations,
        residual=answer.change / cut.edges[-1],
        converged=answer.converged,
        locked=jnp.zeros_like(answer.converged),
        missed=FixedPoint().improve(problem, nodal(problem, nodes), strains[1]).missed,
    )


def integrate_shape(cut: Elements, curvature: Float[Array, "P p"]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Heading and position, each at the P + 1 edges and at the nodes."""
    heading = cut.integrate(curvature)
    return heading, cut.integrate(axis_of(heading[1]))


def _refuse_drag(manipulator: Manipulator) -> None:
    if manipulator.tendon_drag is not None:
        raise ValueError("LiteralIteration is the paper's algorithm and has no drag; use FixedPoint, or drag=None")


def _tip(cut: Elements, curvature: Float[Array, "P p"]) -> Float[Array, "2"]:
    return integrate_shape(cut, curvature)[1][0][-1]


def _tip_motion(cut: Elements, change: Float[Array, "P p"], curvature: Float[Array, "P p"]) -> Float[Array, ""]:
    """How far the last change moved the tip, m: e_tip of eq. (18)."""
    moved = _tip(cut, curvature) - _tip(cut, curvature - change)
    return jnp.sqrt(jnp.sum(moved**2))


def frictionless_curvature(problem: Problem) -> Float[Array, "P p"]:
    """The shape with T = T_base everywhere, where the paper starts. Liu et al. (2020), eq. (17)."""
    tension = tension_of(problem.nodes, problem.base_tension, Pull(jnp.ones_like(problem.nodes.offset)))
    none = jnp.zeros_like(problem.elements.nodes)
    state = State(Pull(jnp.ones_like(tension)), none, none, None, None)
    return strain_along(problem.nodes, problem.base_tension, state)


def literal_wrap_angle(problem: Problem, curvature: Float[Array, "P p"]) -> tuple[Array, Array]:
    """The wrap angle theta at edges and nodes for a given shape, eq. (8). Its kappa' is that of the shape."""
    if problem.joints is not None:
        raise ValueError(
            "LiteralIteration is not possible for tendons that turn by a finite angle between two pieces of the body; "
            "use FixedPoint"
        )
    t = jax.vmap(jax.vmap(bending.tangent))(planar(problem.nodes), curvature)
    turning = t.turning + t.turning_slope * problem.elements.differentiate(curvature)[..., None]
    return problem.elements.integrate(where_present(problem.nodes, jnp.abs(turning)))


def literal_update(problem: Problem, curvature: Float[Array, "P p"]) -> Float[Array, "P p"]:
    """One update of the paper's algorithm: eq. (14) at the last shape, with its double integral integrated by parts."""
    _, wrap = literal_wrap_angle(problem, curvature)
    section = planar(problem.nodes)
    tension = problem.base_tension * jnp.exp(-problem.direction * section.friction_coefficient * wrap)
    t = jax.vmap(jax.vmap(bending.tangent))(section, curvature)
    moment = where_present(section, section.side * section.offset * tension * t.along)
    return jnp.sum(moment, axis=-1) / section.stiffness


class IterationHistory(eqx.Module):
    """The shapes of the iteration: iterate 0 is the frictionless start, iterate k the shape after k updates.

    It holds all iterates, also those after `num_updates`, where the paper's algorithm stops.
    """

    arc_length: Float[Array, " points"]  # s, m: 0, the nodes, L
    curvature: Float[Array, "iterates nodes"]  # kappa, 1/m, at the nodes
    position: Float[Array, "iterates points 2"]  # u, m
    tip_tension: Float[Array, "iterates tendons"]  # N, for the shape by eq. (8)
    tip_error: Float[Array, " updates"]  # e_tip, m: how far update k + 1 moved the tip, eq. (18)
    tip_tolerance: float = eqx.field(static=True)  # e_tip,th, m
    num_updates: Int[Array, ""]  # updates until e_tip < e_tip,th; all updates if it stayed larger
    converged: Bool[Array, ""]  # whether e_tip fell below e_tip,th


def iteration_history(
    manipulator: Manipulator,
    base_tension: ArrayLike | Sequence[ArrayLike],
    *,
    direction: Directions = None,
    tip_tolerance: float = 1e-4,
    max_updates: int = 30,
    nodes: int = 16,
) -> IterationHistory:
    """Run the algorithm of Liu et al. (2020), section III, and keep every shape.

    Args:
        base_tension, nodes: as in `solve`.
        direction: as in `solve`; where it is to be found, it is that of the equilibrium.
        tip_tolerance: e_tip,th, m.
        max_updates: how many updates are made, also after e_tip has fallen below the threshold.
    """
    check_whole("nodes", nodes, 4)
    check_whole("max_updates", max_updates, 1)
    refuse_memory("iteration_history", manipulator)
    check_method(LiteralIteration(), in_space=manipulator.in_space, loaded=False)
    _refuse_drag(manipulator)
    given = per_tendon(manipulator, base_tension, direction)
    if not_stated(given[1]):
        given = given[0], solve(manipulator, given[0], direction=given[1], nodes=nodes).direction
    if not isinstance(given[0], Tracer) and np.any(np.asarray(given[0]) < 0):
        raise ValueError(f"iteration_history: a tendon cannot push, got base_tension {base_tension}")
    manipulator, tension, direction, _ = one_precision(manipulator, *given)
    problem = lay_out(manipulator, tension, direction, nodes)
    start = frictionless_curvature(problem)

    def update(curvature: Array, _: None) -> tuple[Array, Array]:
        new = literal_update(problem, curvature)
        return new, new

    _, later = jax.lax.scan(update, start, None, length=max_updates)
    curvature = jnp.concatenate([start[None], later])
    position, tip_tension = jax.vmap(partial(_observed, problem))(curvature)
    tip_error = jnp.sqrt(jnp.sum(jnp.diff(position[:, -1], axis=0) ** 2, axis=-1))
    below = tip_error < tip_tolerance
    return IterationHistory(
        arc_length=line_up(problem.elements.edges[0], problem.elements.nodes, problem.elements.edges[-1]),
        curvature=curvature.reshape(max_updates + 1, -1),
        position=position,
        tip_tension=tip_tension,
        tip_error=tip_error,
        tip_tolerance=tip_tolerance,
        num_updates=jnp.where(jnp.any(below), jnp.argmax(below) + 1, max_updates),
        converged=jnp.any(below),
    )


def _observed(problem: Problem, curvature: Float[Array, "P p"]) -> tuple[Float[Array, "points 2"], PerTendon]:
    """The positions of a shape at base, nodes and tip, and the tip tensions, N."""
    edges, nodes = integrate_shape(problem.elements, curvature)[1]
    gain = problem.direction * problem.manipulator.tendon_friction
    tip_tension = problem.base_tension * jnp.exp(-gain * literal_wrap_angle(problem, curvature)[0][-1])
    return line_up(edges[0], nodes, edges[-1]), tip_tension
