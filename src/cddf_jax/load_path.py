"""The moment at the base under dead loads: one unknown, followed from the unloaded body to the loaded one.

With M_ext(0) given, a body is an initial-value problem, solved in one pass from base to tip, and
M_ext(L) = m is one equation. Where it has several solutions, the one that is meant lies on the path
of equilibria along which the tensions act first and then all loads grow together from 0 to 1.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .loads import Loads
from .problem import Method, Number, Path, PerTendon, Problem, loaded_to
from .tendon_travel import tendon_displacement

LARGEST_TURN = 1.0  # rad, by which one step along the path may turn any cross-section
LARGEST_MISS = 0.2  # rad, by which it may miss its prediction
LEAST_STEP = 1e-5  # of the loads
CRITICAL_STEP = 1e-4  # of the loads: in a longer one stability must not change, lest a step lands on another branch
MAX_EVALUATIONS = 400
NEWTON_STEPS = 8


class LoadPath(NamedTuple):
    """Where the path led."""

    base_moment: Number  # M_ext(0) over the problem's moment scale
    fraction: Number  # of the loads, up to which there is an equilibrium; 1 unless the path ended
    num_steps: Number  # steps of the loads
    converged: Bool[Array, ""]
    stable: Bool[Array, ""]  # the smallest eigenvalue of the tangent is positive
    travel: PerTendon  # by which tendons slide in as all tensions rise in proportion, m
    resolved: Bool[Array, ""]  # false where it was not the path that ended but the method that failed on it


class _Place(NamedTuple):
    """An equilibrium on the path."""

    fraction: Number
    moment: Number
    slope: Number  # of the moment, by the fraction
    heading: Float[Array, " points"]
    turning: Float[Array, " points"]  # slope of the heading, by the fraction
    stable: Bool[Array, ""]
    travel: PerTendon


class _Walk(NamedTuple):
    place: _Place
    path: Path  # of the last evaluation
    step: Number
    fraction: Number  # that is being tried
    moment: Number  # Newton's iterate there
    num_newton: Number
    num_steps: Number
    num_evaluations: Number
    arrived: Bool[Array, ""]
    ended: Bool[Array, ""]
    resolved: Bool[Array, ""]


def follow_loads(
    problem: Problem, loads: Loads, method: Method, start_fraction: Number, start_moment: Number
) -> tuple[LoadPath, Path]:
    """Walk along the path of equilibria until all loads act.

    Euler steps with Newton's method. A step is taken back and shortened where Newton's method does
    not settle, or where the body turns or misses its prediction by more than a path would let it, or
    where the stability changes within more than a small step.

    Args:
        problem: under its full loads, which are these.
        method: makes a path of the body out of a problem with a given base moment.
        start_fraction, start_moment: a known equilibrium: 0 and 0, or 1 and one that is nearly right.

    Returns:
        Where it led, and the body there, up to the last correction, which is small.
    """
    tip_moment = loads.tip_moment
    close = 4 * float(jnp.finfo(start_moment.dtype).eps) ** 0.5

    def flow(moment, fraction, pull):
        here = loaded_to(problem, fraction, moment * problem.moment_scale)
        here = eqx.tree_at(lambda problem: problem.base_tension, here, pull * problem.base_tension)
        path = method(here)
        residual = (path.tip.moment - fraction * tip_moment) / problem.moment_scale
        heading = jnp.append(path.nodes.heading, path.tip.heading)
        return (residual, heading, tendon_displacement(here, path)), path

    def advance(walk: _Walk) -> _Walk:
        def push(*tangents):
            at = walk.moment, walk.fraction, jnp.ones_like(walk.moment)
            return jax.jvp(flow, at, tangents, has_aux=True)

        basis = jnp.eye(3, dtype=start_moment.dtype) + 0.0 * walk.moment  # shard_map wants tangents like their values
        (residual, heading, _), slopes, path = jax.vmap(push, out_axes=(None, 0, None))(*basis)
        (by_moment, by_fraction, by_pull), (heading_by_moment, heading_by_fraction, _), travel = slopes
        exact = jnp.abs(residual) <= 4 * jnp.finfo(residual.dtype).eps  # also where by_moment vanishes
        correction = jnp.where(exact, 0.0, -residual / by_moment)
        slope = jnp.where(by_fraction == 0, 0.0, -by_fraction / by_moment)
        here = _Place(
            walk.fraction,
            walk.moment + correction,
            slope,
            heading + correction * heading_by_moment,
            heading_by_fraction + slope * heading_by_moment,
            (by_moment > 0) & jnp.all(heading_by_moment > 0),
            travel[2] - jnp.where(by_pull == 0, 0.0, by_pull / by_moment) * travel[0],
        )
        return _decide(walk, here, path, jnp.abs(correction) <= close * (1 + jnp.abs(walk.moment)))

    zero = 0.0 * start_moment
    still = zero + jnp.zeros(problem.panels.nodes.size + 1, zero.dtype)
    no, yes = zero > 0, zero == 0
    none = zero + jnp.zeros_like(problem.base_tension)
    place = _Place(start_fraction + zero, start_moment + zero, zero, still, still, yes, none)
    blank = jax.eval_shape(lambda: flow(zero, zero, zero)[1])
    path = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype) + zero.astype(x.dtype), blank)
    walk = _Walk(place, path, zero + 1.0, place.fraction, place.moment, zero, zero, zero, no, no, yes)
    walk = jax.lax.while_loop(lambda walk: ~(walk.arrived | walk.ended), advance, walk)
    place = walk.place
    return LoadPath(
        place.moment, place.fraction, walk.num_steps - 1.0, walk.arrived, place.stable, place.travel, walk.resolved
    ), walk.path


def _decide(walk: _Walk, here: _Place, path: Path, settled: Bool[Array, ""]) -> _Walk:
    """Correct once more, go on, or take the step back."""
    first = walk.num_steps == 0
    place = walk.place
    predicted = place.heading + (here.fraction - place.fraction) * place.turning
    missed = jnp.where(first, 0.0, jnp.max(jnp.abs(here.heading - predicted)))
    turned = jnp.where(first, 0.0, jnp.max(jnp.abs(here.heading - place.heading)))
    sane = path.converged & jnp.isfinite(here.moment) & jnp.all(jnp.isfinite(here.turning))
    jumped = ~first & (here.stable != place.stable) & (walk.step > CRITICAL_STEP)
    on_path = (missed <= LARGEST_MISS) & (turned <= LARGEST_TURN) & ~jumped
    accepted = sane & settled & on_path
    rejected = ~sane | (settled & ~on_path) | (~settled & (walk.num_newton + 1 >= NEWTON_STEPS))

    ideal = jnp.sqrt(0.5 * LARGEST_MISS / jnp.maximum(missed, 1e-3))  # a miss grows like the square of the step
    shorter = walk.step * jnp.where(sane & settled & ~jumped, jnp.clip(ideal, 0.1, 0.5), 0.25)
    longer = walk.step * jnp.clip(ideal, 0.3, 4.0)
    place = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), here, place)
    gentle = 0.8 * LARGEST_TURN / jnp.maximum(jnp.max(jnp.abs(place.turning)), 0.1 * LARGEST_TURN)
    step = jnp.where(accepted, longer, shorter)
    remaining = 1.0 - place.fraction
    step = jnp.minimum(jnp.minimum(step, gentle), remaining)
    moves = accepted | rejected
    evaluations = walk.num_evaluations + 1.0
    arrived = accepted & (here.fraction >= 1.0)
    return _Walk(
        place,
        path,
        step=jnp.where(moves, step, walk.step),
        fraction=jnp.where(moves, jnp.where(step >= remaining, 1.0, place.fraction + step), walk.fraction),
        moment=jnp.where(moves, place.moment + step * place.slope, here.moment),
        num_newton=jnp.where(moves, 0.0, walk.num_newton + 1.0),
        num_steps=walk.num_steps + jnp.where(accepted, 1.0, 0.0),
        num_evaluations=evaluations,
        arrived=arrived,
        ended=~arrived & ((rejected & ((step < LEAST_STEP) | first)) | (evaluations >= MAX_EVALUATIONS)),
        resolved=jnp.where(walk.num_newton == 0, sane, walk.resolved),
    )
