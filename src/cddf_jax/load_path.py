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

from .batches import all_finite, minus, relative_size
from .loads import Loads
from .problem import Method, Nodal, Number, Path, PerTendon, Problem, loaded_to, nodal
from .tendon_travel import tendon_displacement

LARGEST_TURN = 1.0  # rad, by which one step along the path may turn any cross-section
LARGEST_MISS = 0.2  # rad, by which it may miss its prediction
LEAST_STEP = 1e-5  # of the loads
CRITICAL_STEP = 1e-4  # of the loads: in a longer one stability must not change, lest a step lands on another branch
MAX_TRIES = 200
MAX_SWEEPS = 64  # in one of them


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
    """An equilibrium on the path, or what is taken for one."""

    fraction: Number
    moment: Number
    slope: Number  # of the moment, by the fraction
    nodal: Nodal
    tangents: Nodal  # by moment, fraction and pull, leading axis 3
    heading: Float[Array, " points"]
    turning: Float[Array, " points"]  # slope of the heading, by the fraction
    stable: Bool[Array, ""]
    travel: PerTendon


class _Trial(NamedTuple):
    """A place that is made an equilibrium, sweep by sweep."""

    place: _Place
    settled: Bool[Array, ""]
    lost: Bool[Array, ""]
    sane: Bool[Array, ""]  # at the first sweep
    num_sweeps: Number


class _Walk(NamedTuple):
    place: _Place
    step: Number
    fraction: Number  # that is to be tried
    num_steps: Number
    num_tries: Number
    arrived: Bool[Array, ""]
    ended: Bool[Array, ""]
    resolved: Bool[Array, ""]


def follow_loads(
    problem: Problem, loads: Loads, method: Method, start_fraction: Number, start_moment: Number, guess: Nodal
) -> tuple[LoadPath, Path]:
    """Walk along the path of equilibria until all loads act.

    Euler steps, each corrected by sweeps of the method that carry their own tangents along: after every
    sweep Newton's method puts M_ext(0) right, and along its tangent everything else. A step is taken back
    and shortened where that does not settle, or where the body turns or misses its prediction by more than
    a path would let it, or where the stability changes within more than a small step.

    Args:
        problem: under its full loads, which are these.
        method: makes a path of the body out of a problem with a given base moment.
        start_fraction, start_moment: a known equilibrium: 0 and 0, or 1 and one that is nearly right.
        guess: the values at the nodes there.

    Returns:
        Where it led, and the body there.
    """
    scale, one = problem.moment_scale, jnp.ones_like(start_moment)
    close = 4 * float(jnp.finfo(start_moment.dtype).eps) ** 0.5

    def loaded(fraction: Number, moment: Number, pull: Number) -> Problem:
        there = loaded_to(problem, fraction, moment * scale)
        return eqx.tree_at(lambda problem: problem.base_tension, there, pull * problem.base_tension)

    def flow(guess: Nodal, moment: Number, fraction: Number, pull: Number):
        here = loaded(fraction, moment, pull)
        path = method.improve(here, guess)
        residual = (path.tip.moment - fraction * loads.tip_moment) / scale
        heading = jnp.append(path.nodes.heading, path.tip.heading)
        return (nodal(here, path), residual, heading, tendon_displacement(here, path)), path.converged

    def sweep(trial: _Trial) -> _Trial:
        at = trial.place

        def push(*tangents):
            return jax.jvp(flow, (at.nodal, at.moment, at.fraction, one), tangents, has_aux=True)

        basis = jnp.eye(3, dtype=one.dtype) + 0.0 * at.moment  # shard_map wants tangents like their values
        (values, residual, heading, _), slopes, converged = jax.vmap(push, out_axes=(None, 0, None))(
            at.tangents, *basis
        )
        tangents, (by_moment, by_fraction, by_pull), (heading_by_moment, heading_by_fraction, _), travel = slopes
        exact = jnp.abs(residual) <= 4 * jnp.finfo(residual.dtype).eps  # also where by_moment vanishes
        correction = jnp.where(exact, 0.0, -residual / by_moment)
        slope = jnp.where(by_fraction == 0, 0.0, -by_fraction / by_moment)
        place = _Place(
            at.fraction,
            at.moment + correction,
            slope,
            jax.tree.map(lambda x, v: x + correction * v[0], values, tangents),
            tangents,
            heading + correction * heading_by_moment,
            heading_by_fraction + slope * heading_by_moment,
            (by_moment > 0) & jnp.all(heading_by_moment > 0),
            travel[2] - jnp.where(by_pull == 0, 0.0, by_pull / by_moment) * travel[0],
        )
        sane = jnp.isfinite(place.moment) & all_finite(place.nodal) & jnp.all(values.ratio > 0)
        settled = converged & (jnp.abs(correction) <= close * (1 + jnp.abs(at.moment)))
        settled = settled & (relative_size(minus(tangents, at.tangents), tangents) <= close)
        return _Trial(
            place,
            settled & sane,
            ~sane | (trial.num_sweeps + 1 >= MAX_SWEEPS),
            jnp.where(trial.num_sweeps == 0, sane, trial.sane),
            trial.num_sweeps + 1.0,
        )

    def advance(walk: _Walk) -> _Walk:
        old, step = walk.place, walk.fraction - walk.place.fraction
        ahead = jax.tree.map(lambda x, v: x + step * (v[1] + old.slope * v[0]), old.nodal, old.tangents)
        place = old._replace(fraction=walk.fraction, moment=old.moment + step * old.slope, nodal=ahead)
        trial = _Trial(place, no, no, yes, zero)
        trial = jax.lax.while_loop(lambda trial: ~(trial.settled | trial.lost), sweep, trial)
        return _decide(walk, trial)

    zero = 0.0 * start_moment
    still = zero + jnp.zeros(problem.panels.nodes.size + 1, zero.dtype)
    no, yes = zero > 0, zero == 0
    none = zero + jnp.zeros_like(problem.base_tension)
    guess = jax.tree.map(lambda x: x + zero, guess)
    flat = jax.tree.map(lambda x: jnp.stack([0.0 * x] * 3), guess)
    place = _Place(start_fraction + zero, start_moment + zero, zero, guess, flat, still, still, yes, none)
    walk = _Walk(place, zero + 1.0, place.fraction, zero, zero, no, no, yes)
    walk = jax.lax.while_loop(lambda walk: ~(walk.arrived | walk.ended), advance, walk)
    place = walk.place
    path = method.improve(loaded(place.fraction, place.moment, one), place.nodal)
    return LoadPath(
        place.moment, place.fraction, walk.num_steps - 1.0, walk.arrived, place.stable, place.travel, walk.resolved
    ), path


def _decide(walk: _Walk, trial: _Trial) -> _Walk:
    """Go on, or take the step back."""
    first, place, here = walk.num_steps == 0, walk.place, trial.place
    predicted = place.heading + (here.fraction - place.fraction) * place.turning
    missed = jnp.where(first, 0.0, jnp.max(jnp.abs(here.heading - predicted)))
    turned = jnp.where(first, 0.0, jnp.max(jnp.abs(here.heading - place.heading)))
    settled = trial.settled & jnp.all(jnp.isfinite(here.turning))
    jumped = ~first & (here.stable != place.stable) & (walk.step > CRITICAL_STEP)
    accepted = settled & (missed <= LARGEST_MISS) & (turned <= LARGEST_TURN) & ~jumped

    ideal = jnp.sqrt(0.5 * LARGEST_MISS / jnp.maximum(missed, 1e-3))  # a miss grows like the square of the step
    shorter = walk.step * jnp.where(settled & ~jumped, jnp.clip(ideal, 0.1, 0.5), 0.25)
    longer = walk.step * jnp.clip(ideal, 0.3, 4.0)
    place = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), here, place)
    gentle = 0.8 * LARGEST_TURN / jnp.maximum(jnp.max(jnp.abs(place.turning)), 0.1 * LARGEST_TURN)
    remaining = 1.0 - place.fraction
    step = jnp.minimum(jnp.minimum(jnp.where(accepted, longer, shorter), gentle), remaining)
    tries = walk.num_tries + 1.0
    arrived = accepted & (place.fraction >= 1.0)
    return _Walk(
        place,
        step,
        fraction=jnp.where(step >= remaining, 1.0, place.fraction + step),
        num_steps=walk.num_steps + jnp.where(accepted, 1.0, 0.0),
        num_tries=tries,
        arrived=arrived,
        ended=~arrived & ((~accepted & ((step < LEAST_STEP) | first)) | (tries >= MAX_TRIES)),
        resolved=trial.sane,
    )
