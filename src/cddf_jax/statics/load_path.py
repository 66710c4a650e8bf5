"""The path of equilibria from the unloaded body to the loaded one.

Where a loaded body has several equilibria, the solution is the one on the path along which the tensions act first, and
then all loads grow together from 0 to 1. `follow_loads` follows this path in steps of the load fraction: a prediction
of second order, then a `Trial` that is corrected.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..mechanics.problem import Moment, Nodal, Number, unstrained
from ..mechanics.sign_changes import has_sharp_minimum, only_if
from ..numerics.arrays import computed_once, largest, largest_size
from .corrector import Flag, LoadedBody, Trial, along_moment, moment_that_follows, start_from

LARGEST_TURN = 1.0  # rad: the largest turn of a cross-section in one step along the path
FIRST_TURN = 0.35  # rad: the turn at which the first step aims, because no prediction has been compared yet
LARGEST_MISS = 0.2  # rad: the largest difference of a heading from its prediction
LEAST_STEP = 1e-5  # of the loads
CRITICAL_STEP = 1e-4  # of the loads: a longer step in which stability changes may have reached another branch
ENOUGH_TO_MOVE = 1e-4  # relative change in a pass below which the panels may move at the end of the path
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


Row = Float[Array, " numbers"]  # M_ext(0), then the values at the nodes, then the headings


class _Place(NamedTuple):
    """An equilibrium on the path."""

    fraction: Number
    values: Row
    slope: Row  # with respect to the load fraction
    bend: Row  # half the second derivative, as the slope changed in the last step; 0 at the start
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
    must_move: Flag  # arrived, but the panels have to move before the body settles
    resolved: Flag

    @property
    def over(self) -> Flag:
        trial = self.trial
        done = trial.settled | trial.lost | (trial.num_passes >= MAX_SETTLING)
        done = done | (self.must_move & (trial.change <= ENOUGH_TO_MOVE))
        return self.ended | (self.arrived & done)


def follow_loads(body: LoadedBody, guess: Nodal, zero: Number) -> tuple[LoadPath, Trial]:
    """Follow the path of equilibria until all loads act.

    Each step is predicted and corrected. It is taken back and shortened in three cases: a few passes do not bring the
    trial near to an equilibrium; the body turns too far or differs too much from the prediction; or the stability
    changes in a step that is not small.

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
        hopeless = walk.trial.lost | ((walk.num_tries > 0) & (walk.trial.num_passes >= MAX_SETTLING))
        tried = ~walk.arrived & (walk.trial.near | hopeless)
        return only_if(tried, partial(_decide, body), walk)

    walk = jax.lax.while_loop(lambda walk: ~walk.over, advance, _first_walk(body, guess, zero))
    place = walk.place
    found = LoadPath(
        base_moment=_moment(place.values, walk.trial),
        fraction=place.fraction,
        num_steps=walk.num_steps,
        converged=walk.arrived,
        stable=place.stable,
        resolved=walk.resolved,
    )
    return found, walk.trial


def _first_walk(body: LoadedBody, guess: Nodal, zero: Number) -> _Walk:
    """Before the first try, which is the body without loads."""
    problem = body.problem
    trial = start_from(guess, unstrained(problem.manipulator, problem.loads, guess.ratio), zero)
    false, true, values = zero > 0, zero == 0, _in_a_row(trial)
    still = jnp.zeros_like(values)
    place = _Place(zero, values, slope=still, bend=still, strain=trial.strain, stable=true)
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


def _in_a_row(trial: Trial) -> Row:
    return jnp.concatenate([x.ravel() for x in jax.tree.leaves((trial.moment, trial.nodal, trial.heading))])


def _moment(row: Row, trial: Trial) -> Moment:
    assert trial.moment is not None
    return row[: trial.moment.size].reshape(trial.moment.shape)


def _nodal(row: Row, trial: Trial) -> Nodal:
    assert trial.moment is not None
    arrays, structure = jax.tree.flatten(trial.nodal)
    ends = np.cumsum([trial.moment.size, *[x.size for x in arrays]]).tolist()
    parts = [row[a:b].reshape(x.shape) for a, b, x in zip(ends[:-1], ends[1:], arrays, strict=True)]
    return structure.unflatten(parts)


def _headings(row: Row, trial: Trial) -> Float[Array, " angles"]:
    return row[-sum(x.size for x in jax.tree.leaves(trial.heading)) :]


def _arrive(trial: Trial, walk: _Walk, first: Flag) -> _Place:
    """The equilibrium that a trial is near to, with its derivatives along the path."""
    assert trial.slopes is not None
    moment_slope, before = moment_that_follows(trial.slopes.residual), walk.place
    slopes = jax.tree.leaves((trial.slopes.nodal, trial.slopes.heading))
    rows = jnp.concatenate([x.reshape(x.shape[0], -1) for x in slopes], axis=1)
    slope = jnp.concatenate([moment_slope.ravel(), rows[-1] + along_moment(rows, moment_slope)])
    half = jnp.where(first, 0.0, 0.5 / (walk.fraction - before.fraction))
    bend = half * (slope - before.slope)
    return _Place(walk.fraction, _in_a_row(trial), slope, bend, trial.strain, trial.stable)


def _decide(body: LoadedBody, walk: _Walk) -> _Walk:
    """Accept the trial and go on, or take the step back and shorten it."""
    first, old, trial = walk.num_tries == 0, walk.place, walk.trial
    new = _arrive(trial, walk, first)
    changed = new.values - old.values
    missed = changed - _expected(old, new.fraction - old.fraction)
    missed, turned = (jnp.where(first, 0.0, largest_size(_headings(row, trial))) for row in (missed, changed))
    stays = first | (new.stable == old.stable) | (walk.step <= CRITICAL_STEP)
    on_path = trial.near & jnp.isfinite(jnp.sum(new.slope)) & stays
    accepted = on_path & (missed <= LARGEST_MISS) & (turned <= LARGEST_TURN)
    accepted = computed_once(jnp.where(accepted, 1.0, 0.0)) > 0
    place = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), new, old)

    remaining = 1.0 - place.fraction
    rate = largest_size(_headings(place.slope, trial))
    step = jnp.minimum(_next_step(walk.step, missed, rate, accepted, on_path, first), remaining)
    step = computed_once(step)
    tries = walk.num_tries + 1.0
    arrived = accepted & (place.fraction >= 1.0)
    ended = ~arrived & ((~accepted & ((step < LEAST_STEP) | first)) | (tries >= MAX_TRIES))
    must_move = arrived & _panels_have_to_move(body, trial, walk.fraction)
    predicted = _predict(place, jnp.where(ended | arrived, 0.0, step), trial)
    here = {"near": arrived & trial.near, "settled": arrived & trial.settled}  # at the end it is the trial itself
    return _Walk(
        place,
        predicted._replace(**here, change=jnp.where(arrived, trial.change, 0.0)),
        step,
        fraction=jnp.where(step >= remaining, 1.0, place.fraction + step),
        num_steps=walk.num_steps + jnp.where(accepted & ~first, 1.0, 0.0),
        num_tries=tries,
        arrived=arrived,
        ended=ended,
        must_move=must_move,
        resolved=trial.sane & (accepted | ~first),
    )


def _panels_have_to_move(body: LoadedBody, trial: Trial, fraction: Number) -> Flag:
    """Whether the body bends to both sides; in space whether the turning of a tendon has a sharp minimum."""
    if body.problem.in_space:
        return has_sharp_minimum(body.problem, body.state(trial, fraction))
    assert trial.heading is not None
    turns = jnp.diff(trial.heading.nodes.ravel())
    return largest(turns) * largest(-turns) > 0


def _next_step(step: Number, missed: Number, rate: Number, accepted: Flag, on_path: Flag, first: Flag) -> Number:
    """The next step to try, of the loads, from the miss of the last prediction and the rate at which the body turns.

    Args:
        step: the last one.
        missed: its prediction, rad.
        rate: at which the body turns where the next step starts, rad.
        accepted: whether the last step was.
        on_path: whether it led to an equilibrium that may lie on the path.
        first: whether the step is the first one, from the body without loads.
    """
    # `bend` is that of the last step, so that a miss grows like the square of this one
    ideal = jnp.sqrt(0.3 * LARGEST_MISS / jnp.maximum(missed, 1e-3))
    shorter = step * jnp.where(on_path, jnp.clip(ideal, 0.1, 0.5), 0.25)
    longer = step * jnp.clip(ideal, 0.3, 4.0)
    turn = jnp.where(first, FIRST_TURN, 0.8 * LARGEST_TURN)
    gentle = turn / jnp.maximum(rate, 0.1 * LARGEST_TURN)
    return jnp.minimum(jnp.where(accepted, longer, shorter), gentle)


def _expected(place: _Place, step: Number) -> Row:
    """The change in a step of the loads, to second order."""
    return step * (place.slope + step * place.bend)


def _predict(place: _Place, step: Number, trial: Trial) -> Trial:
    """The next trial; it takes over the slopes of the last one."""
    assert trial.slopes is not None
    slopes = jax.tree.map(lambda x: jnp.where(jnp.isfinite(x), x, 0.0), trial.slopes.nodal)
    values = place.values + _expected(place, step)
    return trial._replace(
        moment=_moment(values, trial),
        nodal=_nodal(values, trial),
        slopes=trial.slopes._replace(nodal=slopes),
        strain=place.strain,
        lost=trial.lost & False,
        num_passes=0.0 * trial.num_passes,
    )
