"""Tensions and shape of a body, resolved together by a fixed point.

The state is r_i = T_base,i / T_i, for which the capstan law, Liu et al. (2020) eq. (8), reads
r' = direction mu theta' r, and under dead loads the moment M_ext. One pass of the iteration computes the shape from
the last r and M_ext, and new r and M_ext from that shape. With one unloaded tendon theta' r mostly does not depend
on r, see `Problem.is_quadrature`, and one pass is exact. The part of the base tension that drag uses up follows from
r by one more integral, see `problem`.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Bool, Float

from ..numerics.arrays import all_finite, computed_once, cos_sin, largest, largest_size, relative_size
from ..numerics.implicit import minus, round_off, without_derivative
from ..numerics.iteration import constant_map, fixed_point
from ..numerics.quadrature import Panels
from ..numerics.rotations import about, cross, direction_of, parts_of, product, sum_of, turned_across, turned_by
from ..robot.cross_section import AnySection, spatial
from ..robot.loads import planar_cross
from . import space
from .friction import PerTendon, Pull, is_proportional, ratio_rate, spent_rate
from .problem import (
    Heading,
    Nodal,
    Number,
    PassState,
    Problem,
    Solution,
    State,
    acting,
    at_base,
    at_nodes,
    axis_of,
    curvature_along,
    everywhere,
    identity_as,
    moments_of,
    starts_of_newton,
    tension_of,
    turn_at_joint,
    turning_along,
    wrench_of,
)

LAST_GAIN = 64.0  # times the tolerance: with a larger change another pass is made, also where passes converge fast
_ratio_rates = at_nodes(ratio_rate, (None, 0, 0, 0))


def integrate_shape(cut: Panels, curvature: Float[Array, "P p"]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Heading and position, each at the P + 1 edges and at the nodes."""
    heading = cut.integrate(curvature)
    x, y = (cut.integrate(component) for component in cos_sin(heading[1]))
    return heading, (jnp.stack([x[0], y[0]], axis=-1), jnp.stack([x[1], y[1]], axis=-1))


class _Point(NamedTuple):
    """The values that a pass integrates from the base to a point, or to each of several points."""

    values: Nodal
    heading: Heading | None  # None in space without loads
    spent: Float[Array, "*points tendons"] | None  # c, N; None without drag


class _Shape(NamedTuple):
    """The shape that follows from the tensions and moments at the nodes."""

    turning: Float[Array, "P p tendons"]  # of the tendons, 1/m
    heading: tuple[Array, Array] | None  # at the edges and the nodes; None in space without loads
    axis: Float[Array, "P p components"] | None  # the derivative of the position; None without loads
    moment_rate: Float[Array, "P p *components"] | None  # M_ext', N; None without loads
    strain: Float[Array, "P p strains"] | None  # of a body in space
    elastic: Float[Array, "P p *strains"]  # the strain less that at rest


class _Pass(NamedTuple):
    """The result of one pass."""

    starts: _Point
    nodes: _Point
    turns: Float[Array, "P tendons"] | None  # finite angles by which tendons turn where panels start, rad
    shape: _Shape


class FixedPoint(eqx.Module):
    """The default method: Picard iteration of r = 1 + integral of direction mu theta' r.

    Under dead loads M_ext = M_ext(0) - integral of t x N is iterated with it. Each pass solves the equilibrium
    of every cross-section with the last tensions and the last moment (the semi-implicit map). Both enter
    through Volterra integrals, so that the error after n passes falls like c^n / n! for any load.
    Derivatives are implicit, see `fixed_point`.

    Args:
        tolerance: relative change of r at which the passes stop; None for 1e-12 (float32: 4e-6).
        max_passes: the largest number of passes in one try.
    """

    tolerance: float | None = eqx.field(default=None, static=True)
    max_passes: int = eqx.field(default=64, static=True)

    def __call__(self, problem: Problem) -> Solution[State]:
        update, guess, off = Partial(_improved, problem), everywhere(problem.panels, at_base(problem)), jnp.inf
        if problem.is_quadrature:
            answer = constant_map(update, guess, _acceptable)
        else:
            if problem.in_space and follow_the_axis(problem) and is_proportional(problem.nodes):
                guess, off = _along_the_axis(problem)
            settings = {"tolerance": self._tolerance(problem), "max_passes": self.max_passes}
            answer = fixed_point(update, guess, **settings, acceptable=_acceptable, off=off)
        along, tip = _pass(problem, answer.value)
        good = answer.converged & jnp.all(tip.values.ratio > 0)
        solution = _solution(
            problem,
            along,
            tip,
            num_iterations=answer.num_passes,
            residual=answer.change,
            converged=good,
            locked=(answer.change <= self._tolerance(problem)) & ~good,
        )
        return _with_path(problem, along, solution)

    def improve(
        self, problem: Problem, guess: Nodal, strain: Array | None = None, before: Number | float = 0.0
    ) -> Solution[PassState]:
        return self._improve(problem, guess, strain, before)[1]

    def finish(self, problem: Problem, guess: Nodal, strain: Array | None = None) -> Solution[State]:
        return _with_path(problem, *self._improve(problem, guess, strain, 0.0))

    def _improve(
        self, problem: Problem, guess: Nodal, strain: Array | None, before: Number | float
    ) -> tuple["_Pass", Solution[PassState]]:
        along, tip = _pass(problem, guess, strain)
        better, guess = without_derivative((along.nodes.values, guess))  # their change needs no derivative
        change = relative_size(jax.tree.map(problem.panels.without_empty, minus(better, guess)), better)
        positive = jnp.all(tip.values.ratio > 0) & jnp.all(better.ratio > 0)
        # passes converge by the factor change / before, so the next change would be this one times that factor
        least = self._tolerance(problem)
        still = (change * change <= least * jnp.maximum(before, change)) & (change <= LAST_GAIN * least)
        return along, _solution(
            problem,
            along,
            tip,
            num_iterations=jnp.ones_like(change),
            residual=change,
            converged=still & positive,
            locked=still & ~positive,  # from a poor guess r may pass below zero and come back
        )

    def _tolerance(self, problem: Problem) -> float:
        return max(1e-12, round_off(problem.panels.edges.dtype)) if self.tolerance is None else self.tolerance


def _pass(problem: Problem, guess: Nodal, strain: Array | None = None) -> tuple[_Pass, _Point]:
    """Shape and turning that follow from a guess of r and M_ext, and the better r and M_ext that follow from these.

    Args:
        problem: the body.
        guess: the values at its nodes.
        strain: the elastic strain there, approximately, from which Newton's method starts; None to start from zero.

    Returns:
        The values along the body, and those at its tip.
    """
    cut, section, base = problem.panels, problem.nodes, at_base(problem)
    spending = spent_rate(problem.direction, section, guess.ratio)
    spent, spent_at_nodes = (None, None) if spending is None else cut.integrate(spending)
    tension = tension_of(section, problem.base_tension, Pull(guess.ratio, spent_at_nodes))
    shape = (_shape_in_space if problem.in_space else _shape)(problem, guess, tension, strain)
    scaled = None if shape.moment_rate is None else shape.moment_rate * (1.0 / problem.moment_scale)
    growth = _ratio_rates(problem.direction, section, shape.turning, guess.ratio)
    integrals = cut.integrate_together(Nodal(growth, scaled))
    edges, inside = (jax.tree.map(jnp.add, base._replace(frame=None), integral) for integral in integrals)
    heading, heading_at_nodes = (None, None) if shape.heading is None else shape.heading
    if problem.in_space:
        edges, inside = edges._replace(frame=heading), inside._replace(frame=heading_at_nodes)
    starts, tip, turns = _across_joints(problem, edges, spent)
    inside = inside._replace(ratio=(starts - edges.ratio[:-1])[:, None] + inside.ratio)
    nodes = _Point(inside, heading_at_nodes, spent_at_nodes)

    at_edges = edges.moment, edges.frame, heading, spent
    at_starts = _point(starts, *jax.tree.map(lambda x: x[:-1], at_edges))
    at_tip = _point(tip, *jax.tree.map(lambda x: x[-1], at_edges))
    return _Pass(at_starts, nodes, turns, shape), at_tip


def _shape(problem: Problem, guess: Nodal, tension: Float[Array, "P p tendons"], start: Array | None) -> _Shape:
    """In the plane."""
    section, loaded = problem.nodes, guess.moment is not None
    kappa = curvature_along(section, tension, moments_of(problem, guess), start)
    heading = problem.panels.integrate(kappa)
    axis = axis_of(heading[1]) if loaded else None
    moment_rate = jnp.zeros_like(kappa) if axis is None else -planar_cross(axis, problem.outboard.nodes)
    turning = turning_along(section, kappa, tension, problem.direction, moment_rate)
    return _Shape(turning, heading, axis, moment_rate if loaded else None, None, kappa)


def _shape_in_space(
    problem: Problem, guess: Nodal, tension: Float[Array, "P p tendons"], start: Array | None
) -> _Shape:
    """In space. Rotations are unknowns, as r and M_ext are; t' is the derivative of polynomials through the nodes."""
    cut, section = problem.panels, problem.nodes
    wrench = wrench_of(spatial(section), guess.frame, moments_of(problem, guess), problem.outboard.nodes)
    strain = _strain_in_space(section, tension, wrench, start)
    elastic = strain - spatial(section).rest
    if follow_the_axis(problem):
        turning = turning_along_axis(section, strain)
    else:
        turning = turning_in_space(section, strain, *_tangents(cut, section, strain))
    if guess.frame is None:
        return _Shape(turning, None, None, None, strain, elastic)
    turns = cut.integrate(turned_by(guess.frame, space.curvature_of_strain(strain)))
    frames = jax.tree.map(lambda turn: turn + identity_as(turn), turns)
    axis = space.axis_in_fixed_frame(frames[1], strain)  # with the new rotations passes converge faster
    return _Shape(turning, frames, axis, -cross(axis, problem.outboard.nodes), strain, elastic)


def follow_the_axis(problem: Problem) -> bool:
    """Whether all tendons of a body in space follow its axis, and turn as it does; static."""
    return problem.loads is None and spatial(problem.nodes).parallel


def _along_the_axis(problem: Problem) -> tuple[Nodal, Number]:
    """The ratio r of tendons that follow the axis after one pass; and how far it is off: zero if friction is alike.

    If all tendons have the same friction, all tensions fall alike, and |M| r is the moment of the base tensions:
    r' = direction mu |M(0)| / (E J).
    """
    section, ones = problem.nodes, everywhere(problem.panels, at_base(problem)).ratio
    tension = tension_of(section, problem.base_tension, Pull(ones))
    bend = turning_along_axis(section, _strain_in_space(section, tension, None, None))
    rate = _ratio_rates(problem.direction, section, bend, ones)
    growth = problem.direction * problem.manipulator.tendon_friction
    alike = jnp.all(growth == growth[0])
    return Nodal(ones + problem.panels.integrate(rate)[1], None), jnp.where(alike, 0.0, jnp.inf)


_strain_in_space = at_nodes(space.strain, (0, 0, 0, 0))
turning_in_space = at_nodes(space.turning_in_space, (0, 0, 0, 0))
turning_along_axis = at_nodes(space.turning_along_axis, (0, 0))


def _tangents(cut: Panels, section: AnySection, strain: Array) -> tuple[Array, Array]:
    """The tangents of the tendons in the frame of the nodes, and their derivatives there."""
    tangent = at_nodes(space.tangents, (0, 0))(section, strain)
    return tangent, cut.differentiate(tangent)


def _frames(cut: Panels, strain: Array) -> tuple[Array, Array]:
    """The rotations at the edges and the nodes that follow from the curvature, both (..., 4).

    Each is a turn about one axis for the whole body, and a rotation after it, which passes find: the identity and a
    change. Where the body bends about one axis, the turn is all.
    """
    curvature = computed_once(space.curvature_of_strain(strain))
    axis = without_derivative(direction_of(jnp.sum(cut.gain(curvature), axis=0)))  # any axis leads to the same frames
    rate = sum_of([x * n for x, n in zip(parts_of(curvature), axis, strict=True)])[..., 0]
    turns = jax.tree.map(lambda angle: about(axis, angle), cut.integrate(rate))
    rest = turned_across(turns[1], curvature - rate[..., None] * axis)
    off = largest(sum_of([jnp.abs(part) for part in parts_of(rest)])) * cut.edges[-1]
    settings = {"tolerance": round_off(rate.dtype), "max_passes": 64, "size": _absolute_size, "off": off}
    found = fixed_point(Partial(_turned_on, cut, rest), jax.tree.map(jnp.zeros_like, turns), **settings)
    return jax.tree.map(lambda turn, change: turn + product(change, turn), turns, found.value)


def _turned_on(cut: Panels, rate: Array, change: tuple[Array, Array]) -> tuple[Array, Array]:
    """A better change, by which the rotation differs from the identity."""
    real, vector = jnp.split(change[1], [1], axis=-1)
    return cut.integrate(turned_by(jnp.concatenate([1.0 + real, vector], axis=-1), rate))


def _absolute_size(change: tuple[Array, Array], _: tuple[Array, Array]) -> Number:
    return largest_size(change)


def _point(
    ratio: Array, moment: Array | None, frame: Array | None, heading: Array | None, spent: Array | None
) -> _Point:
    return _Point(Nodal(ratio, moment, frame), heading, spent)


def _improved(problem: Problem, guess: Nodal) -> Nodal:
    return _pass(problem, guess)[0].nodes.values


def _acceptable(values: Nodal) -> Bool[Array, ""]:
    return all_finite(values._replace(ratio=jnp.where(values.ratio > 0, values.ratio, jnp.inf)))


def _across_joints(problem: Problem, edges: Nodal, spent: Array | None) -> tuple[Array, Array, Array | None]:
    """The finite angles by which tendons turn between panels, and r with the friction of these turns.

    Args:
        problem: the body.
        edges: r and M_ext at the edges of the panels, as they are without these turns.
        spent: c there.

    Returns:
        r at the start of each panel, r at the end of the last one, and the angles, rad; None where all are zero.
    """
    if problem.joints is None:
        return edges.ratio[:-1], edges.ratio[-1], None

    def across(ratio: PerTendon, inputs):
        joint, gain, spent, moment, frame, force = inputs
        turn, beyond = turn_at_joint(problem, joint, Pull(ratio, spent), moment, frame, force)
        return beyond + gain, (beyond, turn)

    gains, moment = jnp.diff(edges.ratio, axis=0), moments_of(problem, edges)
    starts = jax.tree.map(lambda x: x[:-1], (spent, moment, edges.frame))
    inputs = problem.joints, gains, *starts, problem.outboard.starts
    tip, (starts, turns) = jax.lax.scan(across, edges.ratio[0], inputs)
    return starts, tip, turns


def _solution(problem: Problem, along: _Pass, tip: _Point, **outcome: Array) -> Solution[PassState]:
    """What a pass found."""

    def state(point: _Point, outboard: Array, strain: Array | None) -> PassState:
        values, heading, spent = point
        if heading is None:
            heading = jnp.broadcast_to(identity_as(values.ratio), (*values.ratio.shape[:-1], 4))
        moment, force = moments_of(problem, values), acting(problem, outboard)
        return PassState(Pull(values.ratio, spent), heading, moment, force, strain)

    outboard, (at_starts, at_nodes, at_tip) = problem.outboard, starts_of_newton(problem, along.shape.elastic)
    return Solution(
        starts=state(along.starts, outboard.starts, at_starts),
        nodes=state(along.nodes, outboard.nodes, at_nodes),
        tip=state(tip, outboard.tip, at_tip),
        **outcome,
    )


def _with_path(problem: Problem, along: _Pass, solution: Solution[PassState]) -> Solution[State]:
    """The solution with wrap angle and position, which the passes do not need."""
    cut, shape, axis = problem.panels, along.shape, along.shape.axis
    if shape.strain is not None and shape.heading is None:
        frame, frame_at_nodes = _frames(cut, shape.strain)
        axis = space.axis_in_fixed_frame(frame_at_nodes, shape.strain)
        solution = eqx.tree_at(
            lambda found: (found.starts.heading, found.nodes.heading, found.tip.heading),
            solution,
            (frame[:-1], frame_at_nodes, frame[-1]),
        )
    elif axis is None:
        assert along.nodes.heading is not None
        axis = axis_of(along.nodes.heading)
    places = [cut.integrate(part) for part in parts_of(axis)]
    position, position_at_nodes = (jnp.concatenate(parts, axis=-1) for parts in zip(*places, strict=True))
    wrap, wrap_at_nodes = cut.integrate(jnp.abs(shape.turning))
    wrap_at_starts, wrap_at_tip = wrap[:-1], wrap[-1]
    if along.turns is not None:
        turned = jnp.cumsum(along.turns, axis=0)
        wrap_at_starts, wrap_at_nodes = wrap_at_starts + turned, wrap_at_nodes + turned[:, None]
        wrap_at_tip = wrap_at_tip + turned[-1]
    return Solution(
        State(*solution.starts, wrap_at_starts, position[:-1]),
        State(*solution.nodes, wrap_at_nodes, position_at_nodes),
        State(*solution.tip, wrap_at_tip, position[-1]),
        solution.num_iterations,
        solution.residual,
        solution.converged,
        solution.locked,
    )
