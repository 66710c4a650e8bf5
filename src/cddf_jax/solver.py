"""Tensions and shape of a body, resolved together by a fixed point.

The state is r_i = T_base,i / T_i, for which the capstan law, Liu et al. (2020) eq. (8), reads
r' = direction mu theta' r, and under dead loads the moment M_ext. With one unloaded tendon in the published
kinematics theta' r does not depend on r, and one sweep of the fixed point is exact. What drag uses up of the
base tension follows from r by one more integral, see `problem`.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .fixed_point import fixed_point, round_off
from .problem import (
    AT_NODES,
    Number,
    Path,
    PerTendon,
    Problem,
    Pull,
    State,
    curvature_along,
    curvature_of,
    guarded_section,
    moment_rate_of,
    rates_along,
    rates_of,
    ratio_rate,
    spent_rate,
    spent_scale,
    turn_at_joint,
)
from .quadrature import Panels
from .reductions import largest
from .trigonometry import cos_sin

ACCURACY = 1e-5  # a larger error of truncation is not called successful, nor a larger residual of Marching
SAFETY = 5.0  # by which the difference of two quadratures is taken larger than it is
_curvatures = jax.vmap(curvature_of, AT_NODES)  # over the nodes of a panel
_rates = jax.vmap(rates_of, (*AT_NODES, 0))
_ratio_rates = jax.vmap(ratio_rate, AT_NODES)
_spent_rates = jax.vmap(spent_rate, AT_NODES[:3])


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
        growth = sections.friction_coefficient * jnp.abs(turning) * state.ratio / path.tip.ratio
        spending, scale = spent_rate(problem, sections, state.ratio), spent_scale(problem, path.tip.pull)
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
        stiffness = body.bending_stiffness(arc_length)
        moments = problem.base_tension * body.offset(arc_length)
        if problem.loads is not None:
            moments = jnp.append(moments, problem.base_moment)
        return moments / jnp.where(stiffness > 0, stiffness, 1.0)

    seen = cut.gain(jax.vmap(jax.vmap(bend))(cut.nodes))
    return largest(jnp.sum(jnp.abs(cut.dense_gain(bend, times=32, order=4) - seen), axis=0))


class FixedPoint(eqx.Module):
    """The default: in each panel sweep r = r_start + integral of direction mu theta' r; `lax.scan` over the panels.

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

    def __call__(self, problem: Problem) -> Path:
        cut, count = problem.panels, problem.base_tension.shape[0]
        loaded = problem.loads is not None
        tolerance = max(1e-12, round_off(cut.edges.dtype)) if self.tolerance is None else self.tolerance
        weights = cut.constant("weights")

        def unpack(values):  # r, and M_ext over its scale where there are loads
            return values[..., :count], problem.moment_scale * jnp.sum(values[..., count:], axis=-1)

        def rates(inputs, heading, spent, values):
            section, force, width = inputs
            ratio, moment = unpack(values)
            rate = _spent_rates(problem, section, ratio)
            pull = Pull(ratio, None if rate is None else spent + width * cut.accumulate(rate))
            kappa = _curvatures(problem, section, pull, moment)
            moment_rate = moment_rate_of(heading + width * cut.accumulate(kappa), force) if loaded else 0.0 * kappa
            turning = _rates(problem, section, kappa, pull, moment_rate).turning
            growth = _ratio_rates(problem, section, turning, ratio)
            if loaded:
                growth = jnp.concatenate([growth, moment_rate[:, None] / problem.moment_scale], axis=1)
            return growth, kappa, turning

        def panel(carry, inputs):
            (values, heading, spent), (joint, *inputs) = carry, inputs
            ratio, moment = unpack(values)
            turn, ratio = turn_at_joint(problem, joint, Pull(ratio, spent), moment)
            start = jnp.concatenate([ratio, values[count:]])
            answer = fixed_point(
                lambda y: start + inputs[-1] * cut.accumulate(rates(inputs, heading, spent, y)[0]),
                jnp.broadcast_to(start, (cut.order, *start.shape)),
                tolerance=tolerance,
                max_sweeps=self.max_sweeps,
                acceptable=lambda y: jnp.all(y[:, :count] > 0) & jnp.all(jnp.isfinite(y)),
            )
            growth, kappa, turning = rates(inputs, heading, spent, answer.value)
            end = start + inputs[-1] * (growth.T @ weights)
            positive = jnp.all(end[:count] > 0)
            end = jnp.where(positive, end, 1.0)
            rate = _spent_rates(problem, inputs[0], unpack(answer.value)[0])
            spent = None if rate is None else spent + inputs[-1] * (rate.T @ weights)
            carry = end, heading + inputs[-1] * (kappa @ weights), spent
            return carry, (start, answer, turn, positive, kappa, turning)

        base = jnp.append(ones_at_base(problem), problem.base_moment / problem.moment_scale)
        base = base if loaded else base[:count]
        inputs = problem.joints, problem.nodes, problem.outboard.nodes, cut.width
        start = base, 0.0 * base[0], None if problem.base.drag is None else 0.0 * base[:count]
        (tip, *_), (starts, answer, turns, positive, *rate) = jax.lax.scan(panel, start, inputs)
        settled = answer.change <= tolerance
        return _follow(
            problem, unpack(starts), unpack(answer.value), unpack(tip), turns, *rate,
            num_iterations=jnp.max(answer.num_sweeps),
            residual=jnp.max(answer.change),
            converged=jnp.all(answer.converged & positive),
            locked=jnp.any(settled & ~(answer.converged & positive)),
        )  # fmt: skip


def ones_at_base(problem: Problem) -> PerTendon:
    """Ones, r at the base, made so that under shard_map it varies over the same devices as r further on."""
    there = problem.base, problem.base_tension, problem.direction, problem.base_moment, problem.outboard.tip
    total = jnp.sum(jnp.stack([jnp.sum(x) for x in jax.tree.leaves(there)]))
    return jnp.where(total == total, jnp.ones_like(problem.base_tension), 1.0)


def _follow(problem: Problem, starts, nodes, tip, turns: Array, kappa: Array, turning: Array, **outcome) -> Path:
    """Integrate the turning that goes with (r, M_ext) at starts, nodes and tip into wrap angle, heading, position."""
    outboard = problem.outboard
    (heading_edges, heading), (position_edges, position) = integrate_shape(problem.panels, kappa)
    wrap_edges, wrap = problem.panels.integrate(jnp.abs(turning))
    turned = jnp.cumsum(turns, axis=0)
    pulls = Pull(starts[0]), Pull(nodes[0]), Pull(tip[0])
    spent_rates = spent_rate(problem, problem.nodes, nodes[0])
    if spent_rates is not None:
        edges, inner = problem.panels.integrate(spent_rates)
        pulls = Pull(starts[0], edges[:-1]), Pull(nodes[0], inner), Pull(tip[0], edges[-1])
    return Path(
        State(pulls[0], wrap_edges[:-1] + turned, heading_edges[:-1], position_edges[:-1], starts[1], outboard.starts),
        State(pulls[1], wrap + turned[:, None], heading, position, nodes[1], outboard.nodes),
        State(pulls[2], wrap_edges[-1] + turned[-1], heading_edges[-1], position_edges[-1], tip[1], outboard.tip),
        **outcome,
    )
