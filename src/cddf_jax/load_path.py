"""The moment at the base under dead loads: one unknown, followed from the unloaded body to the loaded one.

With M_ext(0) given, a body is an initial-value problem, solved in one pass from base to tip, and
M_ext(L) = m is one equation. Where it has several solutions, the one that is meant lies on the path
of equilibria along which the tensions act first and then all loads grow together from 0 to 1.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .problem import Method, Nodal, Number, Path, PerTendon, Problem, loaded_to, nodal
from .reductions import all_finite, largest_size
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
    resolved: Bool[Array, ""]  # false where it was not the path that ended but the method that failed on it


class Trial(NamedTuple):
    """What is made an equilibrium under some fraction of the loads, sweep by sweep.

    Slopes are by moment, fraction and pull, along a leading axis 3.
    """

    moment: Number  # M_ext(0) over its scale
    nodal: Nodal
    tangents: Nodal  # its slopes
    slopes: Float[Array, "3"]  # of what is missing of the moment at the tip
    heading: Float[Array, " points"]
    turning: Float[Array, "3 points"]  # its slopes
    settled: Bool[Array, ""]
    lost: Bool[Array, ""]
    sane: Bool[Array, ""]  # at the first sweep
    num_sweeps: Number
    change: Number  # in the last of them, relative

    @property
    def stable(self) -> Bool[Array, ""]:
        """Whether the smallest eigenvalue of the tangent is positive: no conjugate point along the body."""
        return (self.slopes[0] > 0) & jnp.all(self.turning[0] > 0)

    def along(self, parameter: int) -> Number:
        """Slope of the moment that keeps the tip's, by fraction (1) or pull (2)."""
        return jnp.where(self.slopes[parameter] == 0, 0.0, -self.slopes[parameter] / self.slopes[0])


class _Place(NamedTuple):
    """An equilibrium on the path."""

    fraction: Number
    at: Trial
    turning: Float[Array, " points"]  # slope of the heading along the path


class _Walk(NamedTuple):
    place: _Place
    step: Number
    fraction: Number  # that is to be tried
    num_steps: Number
    num_tries: Number
    arrived: Bool[Array, ""]
    ended: Bool[Array, ""]
    resolved: Bool[Array, ""]


class LoadedBody(NamedTuple):
    """A body between no loads and all of them, with any moment at its base, its tensions pulled in proportion."""

    problem: Problem
    method: Method

    def at(self, moment: Number, fraction: Number, pull: Number | float = 1.0) -> Problem:
        """The problem there."""
        there = loaded_to(self.problem, fraction, moment * self.problem.moment_scale)
        return eqx.tree_at(lambda problem: problem.base_tension, there, pull * self.problem.base_tension)

    def slopes(self, reading: Callable[[Problem, Path], Any], trial: Trial, fraction: Number) -> Any:
        """One sweep with its tangents: what is read of it, the slopes of that by moment, fraction and pull, and all."""

        def flow(guess: Nodal, *at: Number):
            here = self.at(*at)
            path = self.method.improve(here, guess)
            return reading(here, path), path

        def push(*tangents):
            at = trial.nodal, trial.moment, fraction, jnp.ones_like(trial.moment)
            return jax.jvp(flow, at, tangents, has_aux=True)

        basis = jnp.eye(3, dtype=trial.moment.dtype) + 0.0 * trial.moment  # shard_map wants tangents like their values
        return jax.vmap(push, out_axes=(None, 0, None))(trial.tangents, *basis)

    def correct(self, trial: Trial, fraction: Number) -> Trial:
        """Sweeps that carry their tangents along, until nothing changes.

        After every sweep Newton's method puts M_ext(0) right, and along its tangent everything else.
        """
        close = 4 * float(jnp.finfo(trial.moment.dtype).eps) ** 0.5

        def reading(here: Problem, path: Path):
            return nodal(here, path), moment_left_at_tip(here, path), jnp.append(path.nodes.heading, path.tip.heading)

        def sweep(trial: Trial) -> Trial:
            (values, residual, heading), (tangents, slopes, turning), path = self.slopes(reading, trial, fraction)
            exact = jnp.abs(residual) <= 4 * jnp.finfo(residual.dtype).eps  # also where its slope vanishes
            newton = jnp.where(exact, 0.0, -residual / slopes[0])
            rough = (path.residual > jnp.abs(residual)) & ~path.converged  # what is missing may be the sweep's fault
            correction = jnp.where(rough, 0.0, newton)
            sane = jnp.isfinite(newton) & ~path.locked & all_finite(values)
            steady = largest_size(slopes - trial.slopes) <= close * largest_size(slopes)
            settled = path.converged & steady & (jnp.abs(newton) <= close * (1 + jnp.abs(trial.moment)))
            return Trial(
                moment=trial.moment + correction,
                nodal=jax.tree.map(lambda x, v: x + correction * v[0], values, tangents),
                tangents=tangents,
                slopes=slopes,
                heading=heading + correction * turning[0],
                turning=turning,
                settled=settled & sane,
                lost=~sane | (trial.num_sweeps + 1 >= MAX_SWEEPS),
                sane=jnp.where(trial.num_sweeps == 0, sane, trial.sane),
                num_sweeps=trial.num_sweeps + 1.0,
                change=path.residual,
            )

        again = trial._replace(settled=trial.settled & False, lost=trial.lost & False, num_sweeps=0.0 * trial.moment)
        return jax.lax.while_loop(lambda trial: ~(trial.settled | trial.lost), sweep, again)

    def travel(self, trial: Trial, fraction: Number) -> PerTendon:
        """By how much tendons slide in as all tensions rise in proportion, m."""
        slides = self.slopes(tendon_displacement, trial, fraction)[1]
        return slides[2] + trial.along(2) * slides[0]

    def path(self, trial: Trial, fraction: Number) -> Path:
        """The body."""
        return self.method.improve(self.at(trial.moment, fraction), trial.nodal)


def moment_left_at_tip(problem: Problem, path: Path) -> Number:
    """M_ext(L) - m over the moment scale."""
    assert problem.loads is not None
    return (path.tip.moment - problem.loads.tip_moment) / problem.moment_scale


def start_from(guess: Nodal, zero: Number) -> Trial:
    """Nothing but a guess; 0 under shard_map varies as all numbers do."""
    guess = jax.tree.map(lambda x: x + zero, guess)
    tangents, slopes = (jax.tree.map(lambda x: jnp.stack([0.0 * x] * 3), x) for x in (guess, zero))
    heading = zero + jnp.zeros(guess.ratio.shape[0] * guess.ratio.shape[1] + 1, zero.dtype)
    no, yes = zero > 0, zero == 0
    return Trial(zero, guess, tangents, slopes, heading, jnp.stack([heading] * 3), no, no, yes, zero, zero)


def follow_loads(problem: Problem, method: Method, guess: Nodal, zero: Number) -> tuple[LoadPath, Trial, Path]:
    """Walk along the path of equilibria until all loads act.

    Euler steps, each of them corrected. A step is taken back and shortened where the correction does not
    settle, or where the body turns or misses its prediction by more than a path would let it, or where
    the stability changes within more than a small step.

    Args:
        problem: under its full loads.
        method: makes a path of the body out of a problem with a given base moment.
        guess: the values at the nodes without loads.
        zero: 0, which under shard_map varies as all numbers do.

    Returns:
        Where it led, and the values and the body there.
    """
    body = LoadedBody(problem, method)
    no, yes = zero > 0, zero == 0

    def advance(walk: _Walk) -> _Walk:
        old, step = walk.place, walk.fraction - walk.place.fraction
        slope = old.at.along(1)
        ahead = jax.tree.map(lambda x, v: x + step * (v[1] + slope * v[0]), old.at.nodal, old.at.tangents)
        trial = body.correct(old.at._replace(moment=old.at.moment + step * slope, nodal=ahead), walk.fraction)
        turning = trial.turning[1] + trial.along(1) * trial.turning[0]
        return _decide(walk, _Place(walk.fraction, trial, turning))

    start = start_from(guess, zero)
    walk = _Walk(_Place(zero, start, start.heading), zero + 1.0, zero, zero, zero, no, no, yes)
    walk = jax.lax.while_loop(lambda walk: ~(walk.arrived | walk.ended), advance, walk)
    trial, fraction = walk.place.at, walk.place.fraction
    steps = walk.num_steps - 1.0
    found = LoadPath(trial.moment, fraction, steps, walk.arrived, trial.stable, walk.resolved)
    return found, trial, body.path(trial, fraction)


def hold_loads(problem: Problem, method: Method, found: LoadPath, guess: Trial) -> tuple[LoadPath, Trial, Path]:
    """The same place on other panels; where it cannot be found there, what was known."""
    body = LoadedBody(problem, method)
    trial = body.correct(guess, found.fraction)
    settled, resolved = trial.settled, trial.sane
    trial = jax.tree.map(lambda new, old: jnp.where(settled, new, old), trial, guess)
    new = LoadPath(trial.moment, found.fraction, found.num_steps, settled, trial.stable, resolved)
    return new, trial, body.path(trial, found.fraction)


def _decide(walk: _Walk, here: _Place) -> _Walk:
    """Go on, or take the step back."""
    first, old, new = walk.num_steps == 0, walk.place.at, here.at
    predicted = old.heading + (here.fraction - walk.place.fraction) * walk.place.turning
    missed = jnp.where(first, 0.0, largest_size(new.heading - predicted))
    turned = jnp.where(first, 0.0, largest_size(new.heading - old.heading))
    settled = new.settled & all_finite(here.turning)
    jumped = ~first & (new.stable != old.stable) & (walk.step > CRITICAL_STEP)
    accepted = settled & (missed <= LARGEST_MISS) & (turned <= LARGEST_TURN) & ~jumped

    ideal = jnp.sqrt(0.5 * LARGEST_MISS / jnp.maximum(missed, 1e-3))  # a miss grows like the square of the step
    shorter = walk.step * jnp.where(settled & ~jumped, jnp.clip(ideal, 0.1, 0.5), 0.25)
    longer = walk.step * jnp.clip(ideal, 0.3, 4.0)
    place = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), here, walk.place)
    gentle = 0.8 * LARGEST_TURN / jnp.maximum(largest_size(place.turning), 0.1 * LARGEST_TURN)
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
        resolved=new.sane,
    )
