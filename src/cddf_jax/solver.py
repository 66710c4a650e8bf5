"""Tensions and shape of a body, resolved together by a fixed point.

The state is r_i = T_base,i / T_i, for which the capstan law, Liu et al. (2020) eq. (8), reads
r' = direction mu theta' r, and under dead loads the moment M_ext. With one unloaded tendon in the published
kinematics theta' r does not depend on r, and one sweep of the fixed point is exact. What drag uses up of the
base tension follows from r by one more integral, see `problem`.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .batches import all_finite, minus, relative_size
from .fixed_point import FixedPointResult, fixed_point, round_off
from .problem import (
    AT_NODES,
    Nodal,
    Number,
    Path,
    Problem,
    Pull,
    State,
    at_base,
    axis_of,
    curvature_along,
    curvature_of,
    guarded_section,
    moment_rate_of,
    nodal,
    ones_at_base,
    rates_along,
    rates_of,
    ratio_rate,
    spent_rate,
    spent_scale,
    turn_at_joint,
)
from .quadrature import Panels
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
        if spending is not None and scale is not None:
            growth = jnp.concatenate([growth, spending / scale], axis=-1)
        shape = axis_of(state.heading) / cut.edges[-1]
        bending = (moment_rate / problem.moment_scale)[..., None]
        return cut.gain(jnp.concatenate([growth, shape, kappa[..., None], bending], axis=-1))

    differences = jnp.abs(gains(fine, sections, finer) - gains(coarse, problem.nodes, path.nodes))
    return jnp.maximum(SAFETY * jnp.max(jnp.sum(differences, axis=0)), _unseen_turning(problem))


def _unseen_turning(problem: Problem) -> Number:
    """What the nodes miss of the bend under constant moments, T_base d and M_ext(0) over E J, rad: a notch."""
    body, coarse = problem.manipulator, problem.panels
    dense = coarse.densely(times=32, order=4)

    def bend(arc_length):
        stiffness = body.bending_stiffness(arc_length)
        moments = jnp.append(problem.base_tension * body.offset(arc_length), problem.base_moment)
        return moments / jnp.where(stiffness > 0, stiffness, 1.0)

    seen = coarse.gain(jax.vmap(jax.vmap(bend))(coarse.nodes))
    there = dense.gain(jax.vmap(jax.vmap(bend))(dense.nodes)).reshape(seen.shape[0], -1, seen.shape[1]).sum(axis=1)
    return jnp.max(jnp.sum(jnp.abs(there - seen), axis=0))


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

    def __call__(self, problem: Problem, guess: Nodal | None = None) -> Path:
        tolerance = self._tolerance(problem)

        def repeated(sweep: Callable[[Nodal], Nodal], first: Nodal) -> FixedPointResult:
            return fixed_point(
                sweep,
                first,
                tolerance=tolerance,
                max_sweeps=self.max_sweeps,
                acceptable=lambda y: jnp.all(y.ratio > 0) & all_finite(y),
            )

        path, answer = _pass(problem, guess, repeated)
        good = answer.converged & path.converged
        return path._replace(
            num_iterations=jnp.max(answer.num_sweeps),
            residual=jnp.max(answer.change),
            converged=jnp.all(good),
            locked=jnp.any((answer.change <= tolerance) & ~good),
        )

    def improve(self, problem: Problem, guess: Nodal) -> Path:
        zero = 0.0 * problem.panels.edges[-1]
        path, _ = _pass(problem, guess, lambda _, first: FixedPointResult(first, zero, zero, zero == 0))
        better = nodal(problem, path)
        change = relative_size(minus(better, guess), better)
        return path._replace(residual=change, converged=jnp.all(path.converged) & (change <= self._tolerance(problem)))

    def _tolerance(self, problem: Problem) -> float:
        return max(1e-12, round_off(problem.panels.edges.dtype)) if self.tolerance is None else self.tolerance


def _pass(
    problem: Problem, guess: Nodal | None, resolve: Callable[[Callable[[Nodal], Nodal], Nodal], FixedPointResult]
) -> tuple[Path, FixedPointResult]:
    """From base to tip, panel by panel.

    Args:
        problem: what is to be solved.
        guess: where to start; None for the values at the start of each panel.
        resolve: (sweep, first guess) -> what the values at the nodes of a panel are taken to be.

    Returns:
        The path that one sweep makes of the values that were resolved, `converged` and `resolved` by panel.
    """
    cut, loaded = problem.panels, problem.loads is not None
    weights = cut.constant("weights")

    def moment_of(values: Nodal) -> Array:
        return 0.0 * values.ratio[..., 0] if values.moment is None else problem.moment_scale * values.moment

    def panel(carry, inputs):
        (before, heading, spent), (joint, section, force, width, guess) = carry, inputs
        turn, ratio = turn_at_joint(problem, joint, Pull(before.ratio, spent), moment_of(before))
        start = before._replace(ratio=ratio)

        def rates(values: Nodal):
            spending = _spent_rates(problem, section, values.ratio)
            pull = Pull(values.ratio, None if spending is None else spent + width * cut.accumulate(spending))
            kappa = _curvatures(problem, section, pull, moment_of(values))
            moment_rate = moment_rate_of(heading + width * cut.accumulate(kappa), force) if loaded else 0.0 * kappa
            turning = _rates(problem, section, kappa, pull, moment_rate).turning
            growth = _ratio_rates(problem, section, turning, values.ratio)
            return Nodal(growth, moment_rate / problem.moment_scale if loaded else None), spending, kappa, turning

        def swept(growth: Nodal) -> Nodal:
            return jax.tree.map(lambda a, rate: a + width * cut.accumulate(rate), start, growth)

        first = jax.tree.map(lambda a: jnp.broadcast_to(a, (cut.order, *a.shape)), start) if guess is None else guess
        answer = resolve(lambda values: swept(rates(values)[0]), first)
        growth, spending, kappa, turning = rates(answer.value)
        end = jax.tree.map(lambda a, rate: a + width * (rate.T @ weights), start, growth)
        positive = jnp.all(end.ratio > 0)
        end = jax.tree.map(lambda x: jnp.where(positive, x, 1.0), end)
        spent = None if spending is None else spent + width * (spending.T @ weights)
        carry = end, heading + width * (kappa @ weights), spent
        return carry, (start, swept(growth), answer, turn, positive, kappa, turning)

    ones = ones_at_base(problem)
    base = at_base(problem)
    inputs = problem.joints, problem.nodes, problem.outboard.nodes, cut.width, guess
    start = base, 0.0 * ones[0], None if problem.base.drag is None else 0.0 * ones
    (tip, *_), (starts, nodes, answer, turns, positive, *rate) = jax.lax.scan(panel, start, inputs)
    values = ((x.ratio, moment_of(x)) for x in (starts, nodes, tip))
    none = 0.0 * ones[0]
    return _follow(
        problem, *values, turns, *rate, num_iterations=none, residual=none, converged=positive, locked=none > 0
    ), answer


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
