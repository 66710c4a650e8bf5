"""Tensions and shape of a body, resolved together by a fixed point.

The state is r_i = T_base,i / T_i, for which the capstan law, Liu et al. (2020) eq. (8), reads
r' = direction mu theta' r, and under dead loads the moment M_ext. One pass of the iteration computes the shape from
the last r and M_ext, and new r and M_ext from that shape. With one unloaded tendon theta' r mostly does not depend
on r, see `Problem.is_quadrature`, and one pass is exact. What drag uses up of the base tension follows from r by one
more integral, see `problem`.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Bool, Float

from ..numerics.arrays import all_finite, cos_sin, largest, relative_size
from ..numerics.implicit import minus, round_off, without_derivative
from ..numerics.iteration import constant_map, fixed_point
from ..numerics.quadrature import Panels
from ..robot.loads import planar_cross
from .friction import PerTendon, Pull, ratio_rate, spent_rate
from .problem import (
    AnyState,
    Nodal,
    Number,
    PassState,
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


def truncation_error(problem: Problem, solution: Solution[AnyState]) -> Number:
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


class _Point(NamedTuple):
    """What a pass integrates from the base up to a point, or to each of several points."""

    values: Nodal
    heading: Float[Array, "*points"]  # phi, rad
    spent: Float[Array, "*points tendons"] | None  # c, N; None without drag


class _Pass(NamedTuple):
    """The result of one pass."""

    starts: _Point
    nodes: _Point
    turns: Float[Array, "P tendons"]  # finite angles by which tendons turn where panels start, rad
    turning: Float[Array, "P p tendons"]  # psi' at the nodes, rad/m
    axis: Float[Array, "P p 2"] | None  # t at the nodes; None without loads, where a pass has no need of it


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
        update, guess = Partial(_improved, problem), everywhere(problem.panels, at_base(problem))
        if problem.is_quadrature:
            answer = constant_map(update, guess, _acceptable)
        else:
            settings = {"tolerance": self._tolerance(problem), "max_passes": self.max_passes}
            answer = fixed_point(update, guess, **settings, acceptable=_acceptable)
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

    def improve(self, problem: Problem, guess: Nodal) -> Solution[PassState]:
        return self._improve(problem, guess)[1]

    def finish(self, problem: Problem, guess: Nodal) -> Solution[State]:
        return _with_path(problem, *self._improve(problem, guess))

    def _improve(self, problem: Problem, guess: Nodal) -> tuple["_Pass", Solution[PassState]]:
        along, tip = _pass(problem, guess)
        better, guess = without_derivative((along.nodes.values, guess))  # their change needs no derivative
        change = relative_size(jax.tree.map(problem.panels.without_empty, minus(better, guess)), better)
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

    def _tolerance(self, problem: Problem) -> float:
        return max(1e-12, round_off(problem.panels.edges.dtype)) if self.tolerance is None else self.tolerance


def _integral(cut: Panels, start: Array | float | None, rate: Array | None) -> tuple[Array | None, Array | None]:
    """The integral of a rate from a start value on, at the edges and at the nodes; None where there is no rate."""
    if rate is None or start is None:
        return None, None
    edges, nodes = cut.integrate(rate)
    return start + edges, start + nodes


def _pass(problem: Problem, guess: Nodal) -> tuple[_Pass, _Point]:
    """Curvature and turning that follow from a guess of r and M_ext, and the better r and M_ext that follow from these.

    Returns:
        What is found along the body, and at its tip.
    """
    cut, section, base, loaded = problem.panels, problem.nodes, at_base(problem), guess.moment is not None
    spent, spent_at_nodes = _integral(cut, 0.0, spent_rate(problem.direction, section, guess.ratio))
    tension = tension_of(section, problem.base_tension, Pull(guess.ratio, spent_at_nodes))
    kappa = curvature_along(section, tension, moments_of(problem, guess))
    heading, heading_at_nodes = cut.integrate(kappa)
    axis = axis_of(heading_at_nodes) if loaded else None
    moment_rate = jnp.zeros_like(kappa) if axis is None else -planar_cross(axis, problem.outboard.nodes)
    turning = turning_along(section, kappa, tension, problem.direction, moment_rate)
    scaled = moment_rate * (1.0 / problem.moment_scale) if loaded else None
    bending, bending_at_nodes = _integral(cut, base.moment, scaled)
    gains, within = cut.integrate(_ratio_rates(problem.direction, section, turning, guess.ratio))
    starts, tip, turns = _across_joints(problem, Nodal(base.ratio + gains, bending), spent)
    nodes = _Point(Nodal((starts - gains[:-1])[:, None] + within, bending_at_nodes), heading_at_nodes, spent_at_nodes)

    at_edges = bending, heading, spent
    at_starts = _point(starts, *jax.tree.map(lambda x: x[:-1], at_edges))
    at_tip = _point(tip, *jax.tree.map(lambda x: x[-1], at_edges))
    return _Pass(at_starts, nodes, turns, turning, axis), at_tip


def _point(ratio: Array, moment: Array | None, heading: Array, spent: Array | None) -> _Point:
    return _Point(Nodal(ratio, moment), heading, spent)


def _improved(problem: Problem, guess: Nodal) -> Nodal:
    return _pass(problem, guess)[0].nodes.values


def _acceptable(values: Nodal) -> Bool[Array, ""]:
    return jnp.all(values.ratio > 0) & all_finite(values)


def _across_joints(problem: Problem, edges: Nodal, spent: Array | None) -> tuple[Array, Array, Array]:
    """The finite angles by which tendons turn between panels, and what they do to r.

    Args:
        problem: the body.
        edges: r and M_ext at the edges of the panels, as they are without these turns.
        spent: c there.

    Returns:
        r at the start of each panel, r at the end of the last one, and the angles, rad.
    """
    if problem.joints is None:
        return edges.ratio[:-1], edges.ratio[-1], jnp.zeros_like(edges.ratio[:-1])

    def across(ratio: PerTendon, inputs):
        joint, gain, spent, moment = inputs
        turn, beyond = turn_at_joint(problem, joint, Pull(ratio, spent), moment)
        return beyond + gain, (beyond, turn)

    gains, moment = jnp.diff(edges.ratio, axis=0), moments_of(problem, edges)
    inputs = problem.joints, gains, None if spent is None else spent[:-1], moment[:-1]
    tip, (starts, turns) = jax.lax.scan(across, edges.ratio[0], inputs)
    return starts, tip, turns


def _solution(problem: Problem, along: _Pass, tip: _Point, **outcome: Array) -> Solution[PassState]:
    """What a pass found."""

    def state(point: _Point, force: Array) -> PassState:
        values, heading, spent = point
        return PassState(Pull(values.ratio, spent), heading, moments_of(problem, values), force)

    outboard = problem.outboard
    return Solution(
        starts=state(along.starts, outboard.starts),
        nodes=state(along.nodes, outboard.nodes),
        tip=state(tip, outboard.tip),
        **outcome,
    )


def _with_path(problem: Problem, along: _Pass, solution: Solution[PassState]) -> Solution[State]:
    """The solution with wrap angle and position, which a pass has no need of."""
    cut = problem.panels
    axis = axis_of(along.nodes.heading) if along.axis is None else along.axis
    position, position_at_nodes = cut.integrate(axis)
    wrap, wrap_at_nodes = cut.integrate(jnp.abs(along.turning))
    turned = jnp.cumsum(along.turns, axis=0)
    return Solution(
        State(*solution.starts, wrap[:-1] + turned, position[:-1]),
        State(*solution.nodes, wrap_at_nodes + turned[:, None], position_at_nodes),
        State(*solution.tip, wrap[-1] + turned[-1], position[-1]),
        solution.num_iterations,
        solution.residual,
        solution.converged,
        solution.locked,
    )
