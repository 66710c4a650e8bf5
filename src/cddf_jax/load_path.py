"""The moment at the base under dead loads: one unknown, followed from the unloaded body to the loaded one.

With M_ext(0) given, a body is an initial-value problem, solved in one pass from base to tip, and
M_ext(L) = m is one equation. Where it has several solutions, the one that is meant lies on the path
of equilibria along which the tensions act first and then all loads grow together from 0 to 1.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .friction import PerTendon
from .problem import Method, Nodal, Number, Path, Problem, loaded_to, nodal
from .reductions import all_finite, computed_once, largest, largest_size, relative_size
from .tendon_travel import tendon_displacement
from .varying import zero_as

LARGEST_TURN = 1.0  # rad, by which one step along the path may turn any cross-section
LARGEST_MISS = 0.2  # rad, by which it may miss its prediction
LEAST_STEP = 1e-5  # of the loads
CRITICAL_STEP = 1e-4  # of the loads: in a longer one stability must not change, lest a step lands on another branch
MAX_TRIES = 200
MAX_SWEEPS = 64  # in one of them
MAX_POLISHING = 16  # sweeps
ROUGH = 1e-3  # relative: what is passed on the way need not be known better
STEADY = 1e-2  # relative: nor its slope by the moment
TRAVEL = 1e-7  # relative: of how far tendons slide only the sign is asked


class LoadPath(NamedTuple):
    """Where the path led."""

    base_moment: Number  # M_ext(0) over the problem's moment scale
    fraction: Number  # of the loads, up to which there is an equilibrium; 1 unless the path ended
    num_steps: Number  # steps of the loads
    converged: Bool[Array, ""]
    stable: Bool[Array, ""]  # the smallest eigenvalue of the tangent is positive
    resolved: Bool[Array, ""]  # false where it was not the path that ended but the method that failed on it


class Headings(NamedTuple):
    """phi at the nodes and at the tip, rad, or slopes of it."""

    nodes: Float[Array, "*K P p"]
    tip: Float[Array, "*K"]


class Trial(NamedTuple):
    """What is made an equilibrium under some fraction of the loads, sweep by sweep.

    Slopes stand along a leading axis K: by the moment, and where they are wanted by the fraction.
    """

    moment: Number  # M_ext(0) over its scale
    nodal: Nodal
    tangents: Nodal  # its slopes
    slopes: Float[Array, " K"]  # of what is missing of the moment at the tip
    heading: Headings
    turning: Headings  # its slopes
    near: Bool[Array, ""]  # near enough to go on from
    settled: Bool[Array, ""]
    lost: Bool[Array, ""]
    sane: Bool[Array, ""]  # at the first sweep
    num_sweeps: Number
    change: Number  # in the last of them, relative

    @property
    def stable(self) -> Bool[Array, ""]:
        """Whether the smallest eigenvalue of the tangent is positive: no conjugate point along the body."""
        turning = by_moment(self.turning)
        return (self.slopes[0] > 0) & (turning.tip > 0) & (largest(-turning.nodes) < 0)

    @property
    def leverage(self) -> Number:
        """By how much errors made along the body grow once it is in equilibrium with them.

        What they leave at the tip the moment at the base puts right, and turns the body. Where bending grows
        exponentially along it, one in the middle grows by the square root of what one at the base would grow by.
        """
        turns, least = largest_size(by_moment(self.turning)), jnp.finfo(self.slopes.dtype).eps
        put_right = turns / jnp.maximum(jnp.abs(self.slopes[0]), least)
        return jnp.maximum(put_right, jnp.sqrt(jnp.maximum(turns, 1.0)))


class _Place(NamedTuple):
    """An equilibrium on the path; slopes are those along it, by the fraction."""

    fraction: Number
    moment: Number
    moment_slope: Number
    nodal: Nodal
    nodal_slope: Nodal
    heading: Headings
    turning: Headings  # its slope
    stable: Bool[Array, ""]


class _Walk(NamedTuple):
    place: _Place
    trial: Trial  # of the next place
    step: Number
    fraction: Number  # that is being tried
    num_steps: Number
    num_tries: Number
    arrived: Bool[Array, ""]
    ended: Bool[Array, ""]
    resolved: Bool[Array, ""]


class LoadedBody(NamedTuple):
    """A body between no loads and all of them, with any moment at its base."""

    problem: Problem
    method: Method

    def at(self, moment: Number, fraction: Number) -> Problem:
        """The problem there."""
        return loaded_to(self.problem, fraction, moment * self.problem.moment_scale)

    def path(self, trial: Trial, fraction: Number) -> Path:
        """The body."""
        return self.method.improve(self.at(trial.moment, fraction), trial.nodal)

    def sweep(self, trial: Trial, fraction: Number) -> tuple[Trial, Path]:
        """One sweep with its tangents; then Newton's method puts M_ext(0) right, and along its tangent the rest."""
        close = 2 * _round_off(trial.moment) ** 0.5

        def flow(guess: Nodal, *at: Number):
            here = self.at(*at)
            path = self.method.improve(here, guess)
            heading = Headings(path.nodes.heading, path.tip.heading)
            return (nodal(here, path), moment_left_at_tip(here, path), heading), path

        def push(*tangents):
            return jax.jvp(flow, (trial.nodal, trial.moment, fraction), tangents, has_aux=True)

        basis = jnp.eye(trial.slopes.shape[0], 2, dtype=trial.moment.dtype).T
        basis = basis + zero_as(trial.moment)  # shard_map wants tangents like their values
        (values, residual, heading), (tangents, slopes, turning), path = jax.vmap(push, out_axes=(None, 0, None))(
            trial.tangents, *basis
        )
        newton, off = _newton(trial.moment, residual, slopes[0], turning)
        rough = (path.residual > jnp.abs(residual)) & ~path.converged  # what is missing may be the sweep's fault
        correction = jnp.where(rough, 0.0, newton)
        sane = jnp.isfinite(newton) & jnp.isfinite(path.residual) & ~path.locked
        changes = slopes - trial.slopes
        steady = jnp.abs(changes[0]) <= STEADY * jnp.abs(slopes[0])
        enough = ROUGH * jnp.minimum(1.0, jnp.abs(slopes[0]))  # the sign of that slope is to be told
        settled = sane & path.converged & (jnp.maximum(off, relative_size(changes, slopes)) <= close)
        return Trial(
            moment=trial.moment + correction,
            nodal=jax.tree.map(lambda x, v: x + correction * v[0], values, tangents),
            tangents=tangents,
            slopes=slopes,
            heading=jax.tree.map(lambda x, v: x + correction * v[0], heading, turning),
            turning=turning,
            near=settled | (sane & (jnp.maximum(off, path.residual) <= enough) & steady),
            settled=settled,
            lost=~sane | (trial.num_sweeps + 1 >= MAX_SWEEPS),
            sane=jnp.where(trial.num_sweeps == 0, sane, trial.sane),
            num_sweeps=trial.num_sweeps + 1.0,
            change=path.residual,
        ), path

    def polish(self, trial: Trial, fraction: Number, wanted: Bool[Array, ""]) -> Trial:
        """Where it is wanted, sweeps without tangents, and Newton's method along those of before, until it settles."""

        def once(trial: Trial) -> Trial:
            path = self.path(trial, fraction)
            here = self.at(trial.moment, fraction)
            correction, off = _newton(trial.moment, moment_left_at_tip(here, path), trial.slopes[0], trial.turning)
            return trial._replace(
                moment=trial.moment + correction,
                nodal=jax.tree.map(lambda x, v: x + correction * v[0], nodal(here, path), trial.tangents),
                settled=path.converged & ~path.locked & (off <= _round_off(off) / STEADY),
                num_sweeps=trial.num_sweeps + 1.0,
                change=path.residual,
            )

        polished = jax.lax.while_loop(
            lambda trial: wanted & ~trial.settled & (trial.num_sweeps < MAX_POLISHING),
            once,
            trial._replace(num_sweeps=jnp.zeros_like(trial.num_sweeps)),
        )
        return jax.tree.map(lambda a, b: jnp.where(polished.settled, a, b), polished, trial)

    def travel(self, trial: Trial, fraction: Number) -> PerTendon:
        """By how much tendons slide in as all tensions rise in proportion, m."""

        def flow(guess: Nodal, moment: Number, pull: Number):
            here = self.at(moment, fraction)
            here = eqx.tree_at(lambda problem: problem.base_tension, here, pull * self.problem.base_tension)
            path = self.method.improve(here, guess)
            return nodal(here, path), moment_left_at_tip(here, path), tendon_displacement(here, path)

        def sweep(state):  # M_ext(0) has to follow for M_ext(L) to stay m
            old, slope, _, count = state
            new, missing, _ = push(old, slope, one)
            more = jnp.where(missing == 0, 0.0, -missing / trial.slopes[0])
            new = jax.tree.map(lambda x, v: x + more * v[0], new, trial.tangents)
            return new, slope + more, relative_size(jax.tree.map(jnp.subtract, new, old), new), count + 1.0

        zero, one = jnp.zeros_like(trial.moment), jnp.ones_like(trial.moment)
        push = jax.linearize(flow, trial.nodal, trial.moment, one)[1]
        start = jax.tree.map(jnp.zeros_like, trial.nodal), zero, zero + 1.0, zero
        pulled, slope, *_ = jax.lax.while_loop(
            lambda state: (state[2] > TRAVEL) & (state[3] < MAX_SWEEPS), sweep, start
        )
        return push(pulled, slope, one)[2]


def by_moment(slopes: Any) -> Any:
    """The first of them."""
    return jax.tree.map(lambda x: x[0], slopes)


def _round_off(x: Array) -> float:
    return 4 * float(jnp.finfo(x.dtype).eps)


def _newton(moment: Number, residual: Number, slope: Number, turning: Headings) -> tuple[Number, Number]:
    """The step to where nothing is missing at the tip, and by how much it turns the body, rad."""
    exact = jnp.abs(residual) <= _round_off(residual)  # also where its slope vanishes
    step = jnp.where(exact, 0.0, -residual / slope)
    size = 1 + jnp.abs(moment)
    turned = jnp.abs(step) * jnp.maximum(1 / size, largest_size(by_moment(turning)))
    return step, jnp.where(jnp.abs(step) <= _round_off(step) * size, 0.0, turned)  # a nearer moment cannot be written


def moment_left_at_tip(problem: Problem, path: Path) -> Number:
    """M_ext(L) - m over the moment scale."""
    assert problem.loads is not None
    return (path.tip.moment - problem.loads.tip_moment) / problem.moment_scale


def start_from(guess: Nodal, zero: Number, count: int) -> Trial:
    """Nothing but a guess, with room for `count` slopes; 0 under shard_map varies as all numbers do."""
    guess = jax.tree.map(lambda x: x + zero, guess)
    tangents, slopes = (jax.tree.map(lambda x: jnp.stack([jnp.zeros_like(x)] * count), x) for x in (guess, zero))
    heading = Headings(zero + jnp.zeros(guess.ratio.shape[:2], zero.dtype), zero)
    turning = jax.tree.map(lambda x: jnp.stack([x] * count), heading)
    no, yes = zero > 0, zero == 0
    return Trial(zero, guess, tangents, slopes, heading, turning, no, no, no, yes, zero, zero)


def follow_loads(body: LoadedBody, guess: Nodal, zero: Number) -> tuple[LoadPath, Trial]:
    """Walk along the path of equilibria until all loads act.

    Euler steps, each of them corrected. A step is taken back and shortened where the correction does not
    settle, or where the body turns or misses its prediction by more than a path would let it, or where
    the stability changes within more than a small step.

    Args:
        body: its problem is that under its full loads.
        guess: the values at the nodes without loads.
        zero: 0, which under shard_map varies as all numbers do.

    Returns:
        Where it led, and the values near there, to be settled.
    """
    no, yes = zero > 0, zero == 0

    def advance(walk: _Walk) -> _Walk:
        # a batch comes here with lanes, too, that are over already
        trial = jax.lax.while_loop(
            lambda trial: ~(trial.near | trial.lost | over(walk)),
            lambda trial: body.sweep(trial, walk.fraction)[0],
            walk.trial,
        )
        return _decide(walk._replace(trial=trial))

    def over(walk: _Walk) -> Bool[Array, ""]:
        return walk.arrived | walk.ended

    start = start_from(guess, zero, 2)
    slope = jax.tree.map(lambda x: x[1], (start.tangents, start.turning))
    place = _Place(zero, zero, zero, start.nodal, slope[0], start.heading, slope[1], yes)
    walk = _Walk(place, start, zero + 1.0, zero, zero, zero, no, no, yes)
    walk = jax.lax.while_loop(lambda walk: ~over(walk), advance, walk)
    place, steps = walk.place, walk.num_steps - 1.0
    found = LoadPath(place.moment, place.fraction, steps, walk.arrived, place.stable, walk.resolved)
    return found, walk.trial


def _arrive(trial: Trial, fraction: Number) -> _Place:
    """Where a trial led that is near enough to an equilibrium."""
    slope = jnp.where(trial.slopes[1] == 0, 0.0, -trial.slopes[1] / trial.slopes[0])

    def along(slopes):
        return slopes[1] + slope * slopes[0]

    values = trial.nodal, jax.tree.map(along, trial.tangents), trial.heading, jax.tree.map(along, trial.turning)
    return _Place(fraction, trial.moment, slope, *values, trial.stable)


def _decide(walk: _Walk) -> _Walk:
    """Go on, or take the step back."""
    first, old, trial = walk.num_steps == 0, walk.place, walk.trial
    new = _arrive(trial, walk.fraction)
    turned = jax.tree.map(jnp.subtract, new.heading, old.heading)
    missed = jax.tree.map(lambda x, v: x - (new.fraction - old.fraction) * v, turned, old.turning)
    missed, turned = (jnp.where(first, 0.0, largest_size(x)) for x in (missed, turned))
    near = trial.near & all_finite(new.turning)
    jumped = ~first & (new.stable != old.stable) & (walk.step > CRITICAL_STEP)
    accepted = near & (missed <= LARGEST_MISS) & (turned <= LARGEST_TURN) & ~jumped
    accepted = computed_once(jnp.where(accepted, 1.0, 0.0)) > 0

    ideal = jnp.sqrt(0.5 * LARGEST_MISS / jnp.maximum(missed, 1e-3))  # a miss grows like the square of the step
    shorter = walk.step * jnp.where(near & ~jumped, jnp.clip(ideal, 0.1, 0.5), 0.25)
    longer = walk.step * jnp.clip(ideal, 0.3, 4.0)
    place = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), new, old)
    gentle = 0.8 * LARGEST_TURN / jnp.maximum(largest_size(place.turning), 0.1 * LARGEST_TURN)
    remaining = 1.0 - place.fraction
    step = jnp.minimum(jnp.minimum(jnp.where(accepted, longer, shorter), gentle), remaining)
    tries = walk.num_tries + 1.0
    step = computed_once(step)
    arrived = accepted & (place.fraction >= 1.0)
    ended = ~arrived & ((~accepted & ((step < LEAST_STEP) | first)) | (tries >= MAX_TRIES))
    return _Walk(
        place,
        _ahead(place, jnp.where(ended, 0.0, step), trial)._replace(settled=trial.settled & arrived),
        step,
        fraction=jnp.where(step >= remaining, 1.0, place.fraction + step),
        num_steps=walk.num_steps + jnp.where(accepted, 1.0, 0.0),
        num_tries=tries,
        arrived=arrived,
        ended=ended,
        resolved=trial.sane,
    )


def _ahead(place: _Place, step: Number, trial: Trial) -> Trial:
    """What to try next, along the path; the slopes by moment and fraction are still about the same."""
    no = trial.lost & False
    return trial._replace(
        moment=place.moment + step * place.moment_slope,
        nodal=jax.tree.map(lambda x, v: x + step * v, place.nodal, place.nodal_slope),
        tangents=jax.tree.map(lambda x: jnp.where(jnp.isfinite(x), x, 0.0), trial.tangents),
        near=no,
        lost=no,
        num_sweeps=jnp.zeros_like(place.moment),
    )
