"""Tensions and shape of a body, resolved together by a fixed point.

The state is r_i = T_base,i / T_i, for which the capstan law, Liu et al. (2020) eq. (8), reads
r' = direction mu theta' r, and under dead loads the moment M_ext. One pass of the iteration computes the shape from
the last r and M_ext, and new r and M_ext from that shape. With one unloaded tendon theta' r mostly does not depend
on r, see `Problem.is_quadrature`, and one pass is exact. What drag uses up of the base tension follows from r by one
more integral, see `problem`.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Bool, Float

from ..numerics.arrays import all_finite, cos_sin, largest, relative_size, zero_as
from ..numerics.implicit import minus, round_off, without_derivative
from ..numerics.iteration import constant_map, fixed_point
from ..numerics.quadrature import Panels
from ..robot.loads import planar_cross
from ..robot.manipulator import CrossSection
from .friction import PerTendon, Pull, ratio_rate, spent_rate
from .problem import (
    Joints,
    Nodal,
    Number,
    Problem,
    Solution,
    State,
    at_base,
    at_nodes,
    axis_of,
    curvature_along,
    everywhere,
    guarded_section,
    moments_of,
    spent_scale,
    tension_of,
    turn_at_joint,
    turning_along,
)

ACCURACY = 1e-5  # a solve with a larger truncation error is not called successful
SAFETY = 5.0  # by which the difference of two quadratures is taken larger than it is
_ratio_rates = at_nodes(ratio_rate, (None, 0, 0, 0))


def integrate_shape(cut: Panels, curvature: Float[Array, "P p"]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Heading and position, each at the P + 1 edges and at the nodes."""
    heading = cut.integrate(curvature)
    x, y = (cut.integrate(component) for component in cos_sin(heading[1]))
    return heading, (jnp.stack([x[0], y[0]], axis=-1), jnp.stack([x[1], y[1]], axis=-1))


def truncation_error(problem: Problem, solution: Solution) -> Number:
    """Estimated error of tip tension (relative), tip position (per length) and tip angle (rad), the largest.

    With drag the tip tension is taken relative to what it would be without.
    The rates along the polynomials of the solution are integrated by the nodes of the panels and by a few more in
    each; what differs is summed over the panels.
    """
    cut = problem.panels
    fractions, difference = cut.check_rule
    places = cut.edges[:-1, None] + cut.width[:, None] * jnp.asarray(fractions, cut.edges.dtype)
    sections = jax.vmap(jax.vmap(lambda s: guarded_section(problem.manipulator, s)))(places)
    state = jax.tree.map(lambda a, b: cut.resample(a, b, fractions), solution.starts, solution.nodes)
    tension = tension_of(sections, problem.base_tension, state.pull)
    kappa = curvature_along(sections, tension, state.moment)
    axis = axis_of(state.heading)
    moment_rate = -planar_cross(axis, state.force)
    turning = turning_along(sections, kappa, tension, problem.direction, moment_rate)
    growth = ratio_rate(problem.direction, sections, turning, state.ratio) / solution.tip.ratio
    spending, scale = spent_rate(problem.direction, sections, state.ratio), spent_scale(problem, solution.tip.pull)
    spent = [] if spending is None or scale is None else [spending / scale]
    bending = [moment_rate[..., None] / problem.moment_scale] if problem.loads is not None else []
    rates = jnp.concatenate([growth, *spent, axis / cut.edges[-1], kappa[..., None], *bending], axis=-1)
    missed = cut.width[:, None] * jnp.abs(jnp.moveaxis(rates, 1, -1) @ jnp.asarray(difference, rates.dtype))
    return jnp.maximum(SAFETY * largest(jnp.sum(missed, axis=0)), _unseen_turning(problem))


def _unseen_turning(problem: Problem) -> Number:
    """What the nodes miss of the bend under constant moments, T_base d and M_ext(0) over E J, rad: a notch."""
    body, cut = problem.manipulator, problem.panels

    def bend(arc_length):
        stiffness = body.stiffness(arc_length)
        moments = problem.base_tension * body.offset(arc_length)
        if problem.loads is not None:
            moments = jnp.append(moments, problem.base_moment)
        return moments / jnp.where(stiffness > 0, stiffness, 1.0)

    seen = cut.gain(jax.vmap(jax.vmap(bend))(cut.nodes))
    return largest(jnp.sum(jnp.abs(cut.dense_gain(bend, times=32, order=4) - seen), axis=0))


class _Part(NamedTuple):
    """Some panels in a row, leading axis P."""

    cut: Panels
    joints: Joints | None
    section: CrossSection
    force: Float[Array, "P p 2"]


class _Point(NamedTuple):
    """What a pass integrates from the base up to a point, or to each of several points."""

    values: Nodal
    heading: Float[Array, "*points"]  # phi, rad
    spent: Float[Array, "*points tendons"] | None  # c, N; None without drag


class _Pass(NamedTuple):
    """The result of one pass over some panels."""

    starts: _Point
    nodes: _Point
    turns: Float[Array, "*P tendons"]  # finite angles by which tendons turn where panels start, rad
    turning: Float[Array, "*P p tendons"]  # psi' at the nodes, rad/m
    axis: Float[Array, "*P p 2"] | None  # t at the nodes; None without loads, where a pass has no need of it


class _Resolved(NamedTuple):
    """Some panels after the last pass, and how the passes ended."""

    along: _Pass
    num_passes: Float[Array, "*P"]
    change: Float[Array, "*P"]  # in the last pass, relative
    converged: Bool[Array, "*P"]
    positive: Bool[Array, "*P"]  # r > 0 at the end: no tendon locks


class FixedPoint(eqx.Module):
    """The default method: Picard iteration of r = r_start + integral of direction mu theta' r in each panel.

    Under dead loads M_ext = M_start - integral of t x N is iterated with it. Each pass solves the equilibrium
    of every cross-section with the last tensions and the last moment (the semi-implicit map). Both enter
    through Volterra integrals, so that the error after n passes falls like c^n / n! for any load.
    Derivatives are implicit, see `fixed_point`.

    Args:
        tolerance: relative change of r at which the passes stop; None for 1e-12 (float32: 4e-6).
        max_passes: the largest number of passes in one panel.
    """

    tolerance: float | None = eqx.field(default=None, static=True)
    max_passes: int = eqx.field(default=64, static=True)

    def __call__(self, problem: Problem) -> Solution:
        # from scratch it takes fewer passes panel by panel
        edges, whole = problem.panels.edges, _whole(problem)
        single = jax.vmap(lambda *ends: Panels.between(jnp.stack(ends), problem.panels.order))(edges[:-1], edges[1:])
        tip, answer = jax.lax.scan(partial(self._resolve_panel, problem), _base(problem), (single, whole[1:]))
        good = answer.converged & answer.positive
        return _with_path(
            problem,
            answer.along,
            _solution(
                problem,
                answer.along,
                tip,
                num_iterations=jnp.max(answer.num_passes),
                residual=jnp.max(answer.change),
                converged=jnp.all(good),
                locked=jnp.any((answer.change <= self._tolerance(problem)) & ~good),
            ),
        )

    def improve(self, problem: Problem, guess: Nodal) -> Solution:
        return self._improve(problem, guess)[1]

    def finish(self, problem: Problem, guess: Nodal) -> Solution:
        return _with_path(problem, *self._improve(problem, guess))

    def _improve(self, problem: Problem, guess: Nodal) -> tuple["_Pass", Solution]:
        along, tip = _pass(problem, _whole(problem), _base(problem), guess)
        better, guess = without_derivative((along.nodes.values, guess))  # as what is told of them has none
        change = relative_size(minus(better, guess), better)
        positive = jnp.all(tip.values.ratio > 0) & (largest(-better.ratio) < 0)
        still = change <= self._tolerance(problem)
        return along, _solution(
            problem,
            along,
            tip,
            num_iterations=jnp.ones_like(change),
            residual=change,
            converged=still & positive,
            locked=still & ~positive,  # from a poor guess r may pass below zero and come back
        )

    def _resolve(self, problem: Problem, part: _Part, start: _Point, guess: Nodal) -> tuple[_Point, _Resolved]:
        """Iterate on one panel, from what is known at its start; what follows at its end."""
        update = Partial(_improved, problem, part, start)
        if problem.is_quadrature:
            answer = constant_map(update, guess, _acceptable)
        else:
            settings = {"tolerance": self._tolerance(problem), "max_passes": self.max_passes}
            answer = fixed_point(update, guess, **settings, acceptable=_acceptable)
        along, end = _pass(problem, part, start, answer.value)
        positive = jnp.all(end.values.ratio > 0)
        values = end.values._replace(ratio=jnp.where(positive, end.values.ratio, 1.0))
        resolved = _Resolved(along, answer.num_passes, answer.change, answer.converged, positive)
        return end._replace(values=values), resolved

    def _resolve_panel(self, problem: Problem, start: _Point, inputs: tuple[Panels, tuple]) -> tuple[_Point, _Resolved]:
        """The same for one panel, from what holds at its start."""
        part = _Part(inputs[0], *jax.tree.map(lambda x: x[None], inputs[1]))
        end, answer = self._resolve(problem, part, start, everywhere(part.cut, start.values))
        return end, answer._replace(along=jax.tree.map(lambda x: x[0], answer.along))

    def _tolerance(self, problem: Problem) -> float:
        return max(1e-12, round_off(problem.panels.edges.dtype)) if self.tolerance is None else self.tolerance


def _whole(problem: Problem) -> _Part:
    return _Part(problem.panels, problem.joints, problem.nodes, problem.outboard.nodes)


def _base(problem: Problem) -> _Point:
    base = at_base(problem)
    return _Point(base, zero_as(base), None if problem.base.drag is None else jnp.zeros_like(base.ratio))


def _onward(cut: Panels, start: Array, rate: Array) -> tuple[Array, Array]:
    """The integral of a rate from a start value on, at the edges and at the nodes."""
    edges, nodes = cut.integrate(rate)
    return start + edges, start + nodes


def _onward_if_any(cut: Panels, start: Array | None, rate: Array | None) -> tuple[Array | None, Array | None]:
    """The same, or None for what there is not, such as the drag."""
    return (None, None) if start is None or rate is None else _onward(cut, start, rate)


def _pass(problem: Problem, part: _Part, start: _Point, guess: Nodal) -> tuple[_Pass, _Point]:
    """Curvature and turning that follow from a guess of r and M_ext, and the better r and M_ext that follow from these.

    Returns:
        What is found along the panels, and at the end of the last one.
    """
    cut, section, loaded = part.cut, part.section, guess.moment is not None
    moment = moments_of(problem, guess)
    spent, spent_at_nodes = _onward_if_any(cut, start.spent, spent_rate(problem.direction, section, guess.ratio))
    tension = tension_of(section, problem.base_tension, Pull(guess.ratio, spent_at_nodes))
    kappa = curvature_along(section, tension, moment)
    heading, heading_at_nodes = _onward(cut, start.heading, kappa)
    axis = axis_of(heading_at_nodes) if loaded else None
    moment_rate = jnp.zeros_like(kappa) if axis is None else -planar_cross(axis, part.force)
    turning = turning_along(section, kappa, tension, problem.direction, moment_rate)
    bending, bending_at_nodes = _onward_if_any(cut, start.values.moment, moment_rate * (1.0 / problem.moment_scale))
    gains, within = cut.integrate(_ratio_rates(problem.direction, section, turning, guess.ratio))
    starts, tip, turns = _across_joints(problem, part, Nodal(start.values.ratio + gains, bending), spent)
    nodes = _Point(Nodal((starts - gains[:-1])[:, None] + within, bending_at_nodes), heading_at_nodes, spent_at_nodes)

    at_edges = bending, heading, spent
    at_starts = _point(starts, *jax.tree.map(lambda x: x[:-1], at_edges))
    at_tip = _point(tip, *jax.tree.map(lambda x: x[-1], at_edges))
    return _Pass(at_starts, nodes, turns, turning, axis), at_tip


def _point(ratio: Array, moment: Array | None, heading: Array, spent: Array | None) -> _Point:
    return _Point(Nodal(ratio, moment), heading, spent)


def _improved(problem: Problem, part: _Part, start: _Point, guess: Nodal) -> Nodal:
    return _pass(problem, part, start, guess)[0].nodes.values


def _acceptable(values: Nodal) -> Bool[Array, ""]:
    return jnp.all(values.ratio > 0) & all_finite(values)


def _across_joints(problem: Problem, part: _Part, edges: Nodal, spent: Array | None) -> tuple[Array, Array, Array]:
    """The finite angles by which tendons turn between panels, and what they do to r.

    Args:
        problem, part: the body and the panels.
        edges: r and M_ext at the edges of the panels, as they are without these turns.
        spent: c there.

    Returns:
        r at the start of each panel, r at the end of the last one, and the angles, rad.
    """
    if part.joints is None:
        return edges.ratio[:-1], edges.ratio[-1], jnp.zeros_like(edges.ratio[:-1])

    def across(ratio: PerTendon, inputs):
        joint, gain, spent, moment = inputs
        turn, beyond = turn_at_joint(problem, joint, Pull(ratio, spent), moment)
        return beyond + gain, (beyond, turn)

    gains, moment = jnp.diff(edges.ratio, axis=0), moments_of(problem, edges)
    inputs = part.joints, gains, None if spent is None else spent[:-1], moment[:-1]
    tip, (starts, turns) = jax.lax.scan(across, edges.ratio[0], inputs)
    return starts, tip, turns


def _solution(problem: Problem, along: _Pass, tip: _Point, **outcome: Array) -> Solution:
    """What a pass found."""

    def state(point: _Point, force: Array) -> State:
        values, heading, spent = point
        return State(Pull(values.ratio, spent), heading, moments_of(problem, values), force)

    outboard = problem.outboard
    return Solution(
        starts=state(along.starts, outboard.starts),
        nodes=state(along.nodes, outboard.nodes),
        tip=state(tip, outboard.tip),
        **outcome,
    )


def _with_path(problem: Problem, along: _Pass, solution: Solution) -> Solution:
    """The solution with wrap angle and position, which a pass has no need of."""
    cut = problem.panels
    axis = axis_of(along.nodes.heading) if along.axis is None else along.axis
    position, position_at_nodes = cut.integrate(axis)
    wrap, wrap_at_nodes = cut.integrate(jnp.abs(along.turning))
    turned = jnp.cumsum(along.turns, axis=0)
    return solution._replace(
        starts=solution.starts._replace(wrap_angle=wrap[:-1] + turned, position=position[:-1]),
        nodes=solution.nodes._replace(wrap_angle=wrap_at_nodes + turned[:, None], position=position_at_nodes),
        tip=solution.tip._replace(wrap_angle=wrap[-1] + turned[-1], position=position[-1]),
    )
