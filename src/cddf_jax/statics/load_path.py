"""The path of equilibria from the unloaded body to the loaded one.

Where a loaded body has several equilibria, the solution is the one on the path along which the tensions act first, and
then all loads grow together from 0 to 1. `follow_loads` follows this path in steps of the load fraction: an Euler
prediction, then a `Trial` that is corrected.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..mechanics.problem import Moment, Nodal, Number, unstrained
from ..mechanics.sign_changes import has_sharp_minimum, only_if
from ..numerics.arrays import computed_once, largest_size
from .corrector import Flag, Headings, LoadedBody, Tree, Trial, along_moment, moment_that_follows, start_from

LARGEST_TURN = 1.0  # rad: the largest turn of a cross-section in one step along the path
FIRST_TURN = 0.35  # rad: the turn at which the first step aims, because no prediction has been compared yet
LARGEST_MISS = 0.2  # rad: the largest difference of a heading from its prediction
LEAST_STEP = 1e-5  # of the loads
CRITICAL_STEP = 1e-4  # of the loads: a longer step in which stability changes may have reached another branch
MAX_TRIES = 200
MAX_SETTLING = 16  # passes of one try, and once more at the full loads; before the sign changes they need not settle


class LoadPath(NamedTuple):
    """The end of the path of equilibria."""

    base_moment: Moment  # M_ext(0) over the problem's moment scale
    fraction: Number  # of the loads, up to which an equilibrium was found; 1 unless the path ended before
    num_steps: Number  # steps of the loads
    converged: Flag
    stable: Flag  # the smallest eigenvalue of the tangent is positive
    resolved: Flag  # false where the path did not end, but the method failed


class _Place(NamedTuple):
    """An equilibrium on the path; slopes are along the path, with respect to the load fraction."""

    fraction: Number
    moment: Moment
    moment_slope: Moment
    nodal: Nodal
    nodal_slope: Nodal
    heading: Headings
    heading_slope: Headings
    strain: Array | None  # as in a trial
    stable: Flag


class _Walk(NamedTuple):
    place: _Place  # the last equilibrium that was accepted
    trial: Trial  # of the next one
    step: Number  # to it, of the loads
    fraction: Number  # at which it is tried
    num_steps: Number
    num_tries: Number
    arrived: Flag  # at the full loads
    ended: Flag  # before them
    must_move: Flag  # arrived in space, where the panels have to move before the body settles
    resolved: Flag

    @property
    def over(self) -> Flag:
        trial = self.trial
        done = trial.settled | trial.lost | (trial.num_passes >= MAX_SETTLING)
        return self.ended | self.must_move | (self.arrived & done)


def follow_loads(body: LoadedBody, guess: Nodal, zero: Number) -> tuple[LoadPath, Trial]:
    """Follow the path of equilibria until all loads act.

    Each step is an Euler step that is corrected. It is taken back and shortened in three cases: a few passes do not
    bring the trial near to an equilibrium; the body turns too far or differs too much from the prediction; or the
    stability changes in a step that is not small.

    Args:
        body: its problem is that under its full loads.
        guess: the values at the nodes without loads.
        zero: 0, which under shard_map varies as all numbers do.

    Returns:
        The end of the path, and a trial near there. Where the path did not end before, the second slopes of the trial
        are those with respect to a factor on all base tensions.
    """

    def advance(walk: _Walk) -> _Walk:
        # in a batch this runs for all lanes, also for those that are over
        walk = walk._replace(trial=body.correct(walk.trial, walk.fraction, walk.fraction < 1.0))
        hopeless = walk.trial.lost | ((walk.num_steps > 0) & (walk.trial.num_passes >= MAX_SETTLING))
        tried = ~walk.arrived & (walk.trial.near | hopeless)
        return only_if(tried, partial(_decide, body), walk)

    walk = jax.lax.while_loop(lambda walk: ~walk.over, advance, _first_walk(body, guess, zero))
    place = walk.place
    found = LoadPath(
        base_moment=place.moment,
        fraction=place.fraction,
        num_steps=walk.num_steps - 1.0,  # the first one is the body without loads
        converged=walk.arrived,
        stable=place.stable,
        resolved=walk.resolved,
    )
    return found, walk.trial


def _first_walk(body: LoadedBody, guess: Nodal, zero: Number) -> _Walk:
    """Before the first try, which is the body without loads."""
    problem = body.problem
    trial = start_from(guess, unstrained(problem.manipulator, problem.loads, guess.ratio), zero)
    false, true = zero > 0, zero == 0
    assert trial.moment is not None
    assert trial.heading is not None
    still = jax.tree.map(jnp.zeros_like, trial)
    place = _Place(
        fraction=zero,
        moment=trial.moment,
        moment_slope=still.moment,
        nodal=trial.nodal,
        nodal_slope=still.nodal,
        heading=trial.heading,
        heading_slope=still.heading,
        strain=trial.strain,
        stable=true,
    )
    return _Walk(
        place=place,
        trial=trial,
        step=zero + 1.0,
        fraction=zero,
        num_steps=zero,
        num_tries=zero,
        arrived=false,
        ended=false,
        must_move=false,
        resolved=true,
    )


def _arrive(trial: Trial, fraction: Number) -> _Place:
    """The equilibrium that a trial is near to, with its slopes along the path."""
    assert trial.moment is not None
    assert trial.heading is not None
    assert trial.slopes is not None
    moment_slope = moment_that_follows(trial.slopes.residual)

    def along_path(slopes: Tree) -> Tree:
        return jax.tree.map(lambda x: x[-1] + along_moment(x, moment_slope), slopes)

    return _Place(
        fraction=fraction,
        moment=trial.moment,
        moment_slope=moment_slope,
        nodal=trial.nodal,
        nodal_slope=along_path(trial.slopes.nodal),
        heading=trial.heading,
        heading_slope=along_path(trial.slopes.heading),
        strain=trial.strain,
        stable=trial.stable,
    )


def _decide(body: LoadedBody, walk: _Walk) -> _Walk:
    """Accept the trial and go on, or take the step back and shorten it."""
    first, old, trial = walk.num_steps == 0, walk.place, walk.trial
    new = _arrive(trial, walk.fraction)
    turned = jax.tree.map(jnp.subtract, new.heading, old.heading)
    missed = jax.tree.map(lambda x, v: x - (new.fraction - old.fraction) * v, turned, old.heading_slope)
    missed, turned = (jnp.where(first, 0.0, largest_size(change)) for change in (missed, turned))
    near = trial.near & jnp.isfinite(largest_size(new.heading_slope))
    jumped = ~first & (new.stable != old.stable) & (walk.step > CRITICAL_STEP)
    accepted = near & (missed <= LARGEST_MISS) & (turned <= LARGEST_TURN) & ~jumped
    accepted = computed_once(jnp.where(accepted, 1.0, 0.0)) > 0
    place = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), new, old)

    remaining = 1.0 - place.fraction
    step = jnp.minimum(_next_step(walk.step, missed, place, accepted, near & ~jumped, first), remaining)
    step = computed_once(step)
    tries = walk.num_tries + 1.0
    arrived = accepted & (place.fraction >= 1.0)
    ended = ~arrived & ((~accepted & ((step < LEAST_STEP) | first)) | (tries >= MAX_TRIES))
    must_move = walk.must_move
    if body.problem.in_space:
        must_move = arrived & has_sharp_minimum(body.problem, body.state(trial, walk.fraction))
    predicted = _predict(place, jnp.where(ended | arrived, 0.0, step), trial)
    return _Walk(
        place,
        predicted._replace(near=arrived & trial.near, settled=arrived & trial.settled),  # which is the trial itself
        step,
        fraction=jnp.where(step >= remaining, 1.0, place.fraction + step),
        num_steps=walk.num_steps + jnp.where(accepted, 1.0, 0.0),
        num_tries=tries,
        arrived=arrived,
        ended=ended,
        must_move=must_move,
        resolved=trial.sane,
    )


def _next_step(step: Number, missed: Number, place: _Place, accepted: Flag, on_path: Flag, first: Flag) -> Number:
    """The next step to try, of the loads, from the miss of the last prediction and the rate at which the body turns.

    Args:
        step: the last one.
        missed: its prediction, rad.
        place: from which the next step starts.
        accepted: whether the last step was.
        on_path: whether it led to an equilibrium that may lie on the path.
        first: whether the step is the first one, from the body without loads.
    """
    ideal = jnp.sqrt(0.3 * LARGEST_MISS / jnp.maximum(missed, 1e-3))  # a miss grows like the square of the step
    shorter = step * jnp.where(on_path, jnp.clip(ideal, 0.1, 0.5), 0.25)
    longer = step * jnp.clip(ideal, 0.3, 4.0)
    turn = jnp.where(first, FIRST_TURN, 0.8 * LARGEST_TURN)
    gentle = turn / jnp.maximum(largest_size(place.heading_slope), 0.1 * LARGEST_TURN)
    return jnp.minimum(jnp.where(accepted, longer, shorter), gentle)


def _predict(place: _Place, step: Number, trial: Trial) -> Trial:
    """The next trial, by an Euler step along the path; it takes over the slopes of the last trial."""
    assert trial.slopes is not None
    slopes = jax.tree.map(lambda x: jnp.where(jnp.isfinite(x), x, 0.0), trial.slopes.nodal)
    return trial._replace(
        moment=place.moment + step * place.moment_slope,
        nodal=jax.tree.map(lambda x, v: x + step * v, place.nodal, place.nodal_slope),
        slopes=trial.slopes._replace(nodal=slopes),
        strain=place.strain,
        lost=trial.lost & False,
        num_passes=0.0 * trial.num_passes,
        change=0.0 * trial.num_passes,
    )
