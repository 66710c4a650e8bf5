"""Tensions and shape of a body, resolved together by a fixed point.

The state is r_i = T_base,i / T_i, for which the capstan law, Liu et al. (2020) eq. (8), reads
r' = direction mu theta' r, and under dead loads the moment M_ext. With one unloaded tendon theta' r mostly does not
depend on r, see `Problem.is_quadrature`, and one sweep is exact. What drag uses up of the base tension follows from r
by one more integral, see `problem`.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Bool, Float

from .fixed_point import constant_map, fixed_point, minus, round_off
from .friction import PerTendon, Pull, ratio_rate, spent_rate
from .manipulator import CrossSection
from .problem import (
    AT_NODES,
    Joints,
    Nodal,
    Number,
    Path,
    Problem,
    State,
    at_base,
    curvature_along,
    everywhere,
    guarded_section,
    moment_rate_of,
    rates_along,
    spent_scale,
    turn_at_joint,
)
from .quadrature import Panels
from .reductions import all_finite, largest, relative_size
from .trigonometry import cos_sin
from .varying import zero_as

ACCURACY = 1e-5  # a larger error of truncation is not called successful, nor a larger residual of Marching
SAFETY = 5.0  # by which the difference of two quadratures is taken larger than it is
_ratio_rates = jax.vmap(jax.vmap(ratio_rate, AT_NODES), AT_NODES)  # over panels and nodes


def integrate_shape(cut: Panels, curvature: Float[Array, "P p"]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Heading and position, each at the P + 1 edges and at the nodes."""
    heading = cut.integrate(curvature)
    x, y = (cut.integrate(component) for component in cos_sin(heading[1]))
    return heading, (jnp.stack([x[0], y[0]], axis=-1), jnp.stack([x[1], y[1]], axis=-1))


def truncation_error(problem: Problem, path: Path) -> Number:
    """Estimated error of tip tension (relative), tip position (per length) and tip angle (rad), the largest.

    With drag the tip tension is taken relative to what it would be without.
    The rates along the polynomials of the solution are integrated once more with a few more nodes in
    each panel; what differs is summed over the panels.
    """
    coarse, fine = problem.panels, problem.panels.finer()
    sections = jax.vmap(jax.vmap(lambda s: guarded_section(problem.manipulator, s)))(fine.nodes)
    finer = jax.tree.map(lambda a, b: coarse.resample(a, b, fine.rule.nodes), path.starts, path.nodes)

    def gains(cut, sections, state):
        kappa = curvature_along(problem, sections, state.pull, state.moment)
        moment_rate = moment_rate_of(state.heading, state.force)
        turning = rates_along(problem, sections, kappa, state.pull, moment_rate).turning
        growth = ratio_rate(problem.direction, sections, turning, state.ratio) / path.tip.ratio
        spending, scale = spent_rate(problem.direction, sections, state.ratio), spent_scale(problem, path.tip.pull)
        spent = [] if spending is None or scale is None else [cut.gain(spending / scale)]
        shape = [cut.gain(component)[:, None] / cut.edges[-1] for component in cos_sin(state.heading)]
        bending = [cut.gain(moment_rate)[:, None] / problem.moment_scale] if problem.loads is not None else []
        return jnp.concatenate([cut.gain(growth), *spent, *shape, cut.gain(kappa)[:, None], *bending], axis=1)

    differences = jnp.abs(gains(fine, sections, finer) - gains(coarse, problem.nodes, path.nodes))
    return jnp.maximum(SAFETY * largest(jnp.sum(differences, axis=0)), _unseen_turning(problem))


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


class FixedPoint(eqx.Module):
    """The default: in each panel sweep r = r_start + integral of direction mu theta' r.

    Under dead loads M_ext = M_start - integral of t x N is swept with it. A sweep solves the equilibrium
    of every cross-section with the tensions and the moment at hand (the semi-implicit map). Both enter
    through Volterra integrals, so the errors of the sweeps fall like c^n / n! for any load.
    Derivatives are implicit, see `fixed_point`.

    Args:
        tolerance: relative change of r at which the sweeps stop; None for 1e-12 (float32: 4e-6).
        max_sweeps: in one panel.
    """

    tolerance: float | None = eqx.field(default=None, static=True)
    max_sweeps: int = eqx.field(default=64, static=True)

    def __call__(self, problem: Problem, guess: Nodal | None = None) -> Path:
        tolerance = self._tolerance(problem)

        def resolved(start: _Reached, part: _Part, first: Nodal) -> tuple[_Reached, Any]:
            sweep = Partial(_improved, problem, part, start)
            if problem.is_quadrature:
                answer = constant_map(sweep, first, _acceptable)
            else:
                settings = {"tolerance": tolerance, "max_sweeps": self.max_sweeps}
                answer = fixed_point(sweep, first, **settings, acceptable=_acceptable)
            swept, end = _sweep(problem, part, start, answer.value)
            positive = jnp.all(end.values.ratio > 0)
            values = end.values._replace(ratio=jnp.where(positive, end.values.ratio, 1.0))
            return end._replace(values=values), (swept, answer._replace(value=None), positive)

        def panel(start: _Reached, inputs: tuple[Panels, Any]):
            part = _Part(inputs[0], *jax.tree.map(lambda x: x[None], inputs[1]))
            end, (swept, *outcome) = resolved(start, part, everywhere(part.cut, start.values))
            return end, (jax.tree.map(lambda x: x[0], swept), *outcome)

        edges, whole = problem.panels.edges, _whole(problem)
        # From scratch it takes fewer sweeps panel by panel. From a good guess the panels go together, outside a scan:
        # within one, forward over reverse mode differentiates the sweeps as they ran, and they may be one or two.
        if guess is None:
            single = Panels(jnp.stack([edges[:-1], edges[1:]], axis=1), problem.panels.order)
            tip, (swept, answer, positive) = jax.lax.scan(panel, _base(problem), (single, whole[1:]))
        else:
            tip, (swept, answer, positive) = resolved(_base(problem), whole, guess)
        good = answer.converged & positive
        return _follow(
            problem,
            swept,
            tip,
            num_iterations=jnp.max(answer.num_sweeps),
            residual=jnp.max(answer.change),
            converged=jnp.all(good),
            locked=jnp.any((answer.change <= tolerance) & ~good),
        )

    def improve(self, problem: Problem, guess: Nodal) -> Path:
        swept, tip = _sweep(problem, _whole(problem), _base(problem), guess)
        better = swept.nodes.values
        change = relative_size(minus(better, guess), better)
        positive = jnp.all(tip.values.ratio > 0) & (largest(-better.ratio) < 0)
        still = change <= self._tolerance(problem)
        return _follow(
            problem,
            swept,
            tip,
            num_iterations=jnp.ones_like(change),
            residual=change,
            converged=still & positive,
            locked=still & ~positive,  # from a poor guess r may pass below zero and come back
        )

    def _tolerance(self, problem: Problem) -> float:
        return max(1e-12, round_off(problem.panels.edges.dtype)) if self.tolerance is None else self.tolerance


class _Part(NamedTuple):
    """Some panels in a row, leading axis P."""

    cut: Panels
    joints: Joints | None
    section: CrossSection
    force: Float[Array, "P p 2"]


class _Reached(NamedTuple):
    """What is known at one place once everything inboard is."""

    values: Nodal
    heading: Number
    spent: PerTendon | None


class _Swept(NamedTuple):
    """What one sweep makes of some panels."""

    starts: _Reached
    nodes: _Reached
    turns: Float[Array, "P tendons"]
    turning: Float[Array, "P p tendons"]


def _whole(problem: Problem) -> _Part:
    return _Part(problem.panels, problem.joints, problem.nodes, problem.outboard.nodes)


def _base(problem: Problem) -> _Reached:
    base = at_base(problem)
    return _Reached(base, zero_as(base), None if problem.base.drag is None else jnp.zeros_like(base.ratio))


def _moment(problem: Problem, values: Nodal) -> Float[Array, "*points"]:
    """M_ext, N m."""
    return jnp.zeros_like(values.ratio[..., 0]) if values.moment is None else problem.moment_scale * values.moment


def _onward(cut: Panels, start: Array | None, rate: Array | None) -> tuple[Any, Any]:
    """What grows at some rate from a start on, at the edges and at the nodes; None where nothing does."""
    if start is None or rate is None:
        return None, None
    edges, nodes = cut.integrate(rate)
    return start + edges, start + nodes


def _sweep(problem: Problem, part: _Part, start: _Reached, guess: Nodal) -> tuple[_Swept, _Reached]:
    """Curvature and turning that go with a guess, and r and M_ext that go with these, which are a better one."""
    cut, section, loaded = part.cut, part.section, guess.moment is not None
    moment = _moment(problem, guess)
    spent, spent_at_nodes = _onward(cut, start.spent, spent_rate(problem.direction, section, guess.ratio))
    pull = Pull(guess.ratio, spent_at_nodes)
    kappa = curvature_along(problem, section, pull, moment)
    heading, heading_at_nodes = _onward(cut, start.heading, kappa)
    moment_rate = moment_rate_of(heading_at_nodes, part.force) if loaded else jnp.zeros_like(kappa)
    turning = rates_along(problem, section, kappa, pull, moment_rate).turning
    bending, bending_at_nodes = _onward(cut, start.values.moment, moment_rate * (1.0 / problem.moment_scale))
    gains, within = cut.integrate(_ratio_rates(problem.direction, section, turning, guess.ratio))
    starts, tip, turns = _across_joints(problem, part, Nodal(start.values.ratio + gains, bending), spent)
    nodes = _Reached(Nodal((starts - gains[:-1])[:, None] + within, bending_at_nodes), heading_at_nodes, spent_at_nodes)

    def edges(ratio: Array, at: Any) -> _Reached:
        moment, phi, c = jax.tree.map(lambda x: x[at], (bending, heading, spent))
        return _Reached(Nodal(ratio, moment), phi, c)

    return _Swept(edges(starts, slice(-1)), nodes, turns, turning), edges(tip, -1)


def _improved(problem: Problem, part: _Part, start: _Reached, guess: Nodal) -> Nodal:
    return _sweep(problem, part, start, guess)[0].nodes.values


def _acceptable(values: Nodal) -> Bool[Array, ""]:
    return jnp.all(values.ratio > 0) & all_finite(values)


def _across_joints(problem: Problem, part: _Part, edges: Nodal, spent: Array | None) -> tuple[Array, Array, Array]:
    """Where tendons turn by a finite angle from panel to panel: r beyond, r at the end, and these angles.

    Args:
        problem, part: what is swept.
        edges: at the edges of the panels, as if no tendon did that.
        spent: c there.
    """
    if part.joints is None:
        return edges.ratio[:-1], edges.ratio[-1], jnp.zeros_like(edges.ratio[:-1])

    def across(ratio: PerTendon, inputs):
        joint, gain, spent, moment = inputs
        turn, beyond = turn_at_joint(problem, joint, Pull(ratio, spent), moment)
        return beyond + gain, (beyond, turn)

    gains, moment = jnp.diff(edges.ratio, axis=0), _moment(problem, edges)
    inputs = part.joints, gains, None if spent is None else spent[:-1], moment[:-1]
    tip, (starts, turns) = jax.lax.scan(across, edges.ratio[0], inputs)
    return starts, tip, turns


def _follow(problem: Problem, swept: _Swept, tip: _Reached, **outcome) -> Path:
    """Integrate what goes with a sweep at starts, nodes and tip into wrap angle and position."""
    cut, outboard = problem.panels, problem.outboard
    axis = [cut.integrate(component) for component in cos_sin(swept.nodes.heading)]
    position, position_at_nodes = (jnp.stack(components, axis=-1) for components in zip(*axis, strict=True))
    wrap, wrap_at_nodes = cut.integrate(jnp.abs(swept.turning))
    turned = jnp.cumsum(swept.turns, axis=0)

    def state(reached: _Reached, wrap: Array, position: Array, force: Array) -> State:
        values, heading, spent = reached
        return State(Pull(values.ratio, spent), wrap, heading, position, _moment(problem, values), force)

    return Path(
        state(swept.starts, wrap[:-1] + turned, position[:-1], outboard.starts),
        state(swept.nodes, wrap_at_nodes + turned[:, None], position_at_nodes, outboard.nodes),
        state(tip, wrap[-1] + turned[-1], position[-1], outboard.tip),
        **outcome,
    )
