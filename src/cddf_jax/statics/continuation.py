"""Continuation in the loads, from the unloaded body to the loaded one.

Where a loaded body has several equilibria, the solution is the one on the path along which the tensions act first, and
then all loads grow together from 0 to 1. `follow_loads` follows this path by predictor and corrector: a prediction of
second order in the load fraction, then iterations of `LoadedBody.iterate`, then the step is accepted or shortened.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ..mechanics.problem import Moment, Number
from ..numerics import tolerances as tol
from ..numerics.arrays import all_finite, largest_size
from .shooting import Flag, Iterate, LoadedBody, Values


class LoadPath(NamedTuple):
    """The end of the path of equilibria."""

    base_moment: Moment  # M_ext(0) over the problem's moment scale
    fraction: Number  # of the loads, up to which an equilibrium was found; 1 unless the path ended before
    num_steps: Number  # steps of the loads
    converged: Flag
    stable: Flag  # the smallest eigenvalue of the tangent is positive
    resolved: Flag  # false where the path did not end, but the method failed


class _Point(NamedTuple):
    """An equilibrium on the path."""

    fraction: Number
    values: Values
    slope: Values  # with respect to the load fraction; it has no leading axis
    bend: Values  # half the second derivative, as the slope changed in the last step; 0 at the start
    strain: jax.Array | None  # as in an iterate
    stable: Flag


class _Continuation(NamedTuple):
    point: _Point  # the last equilibrium that was accepted
    iterate: Iterate  # of the next one
    step: Number  # to it, of the loads; 0 at the end of the path
    num_steps: Number
    num_tries: Number

    @property
    def first(self) -> Flag:
        """Whether the body without loads is tried."""
        return self.num_tries == 0

    @property
    def fraction(self) -> Number:
        """At which the next equilibrium is tried."""
        last, step = self.point.fraction, self.step
        return jnp.where(self.first, 0.0, jnp.where(step >= 1.0 - last, 1.0, last + step))

    @property
    def arrived(self) -> Flag:
        """Whether the full loads are reached."""
        return self.point.fraction >= 1.0

    @property
    def ended(self) -> Flag:
        """Whether the path ended before them."""
        return (self.step <= 0.0) & ~self.arrived


def follow_loads(body: LoadedBody, zero: Number) -> tuple[LoadPath, Iterate]:
    """Follow the path of equilibria until all loads act.

    A step is taken back and shortened in three cases: a few iterations do not bring it near to an equilibrium; the body
    turns too far or differs too much from the prediction; or the stability changes in a step that is not small.

    Args:
        body: its problem is that under its full loads.
        zero: 0, which under shard_map varies as all numbers do.

    Returns:
        The end of the path, and the iterate there. Where the path did not end before, the last slopes of the iterate
        are those with respect to a factor on all base tensions.
    """

    def unfinished(state: _Continuation) -> Flag:
        return ~(state.ended | (state.arrived & (state.iterate.settled | state.iterate.lost)))

    def advance(state: _Continuation) -> _Continuation:
        state = state._replace(iterate=body.iterate(state.iterate, state.fraction, state.fraction < 1.0))
        iterate = state.iterate
        failed = iterate.lost | ((state.num_tries > 0) & (iterate.num_iterations >= tol.MAX_CORRECTIONS))
        tried = ~state.arrived & (iterate.near | failed)
        return jax.tree.map(lambda new, old: jnp.where(tried, new, old), _next_try(body, state), state)

    end = jax.lax.while_loop(unfinished, advance, _start(body, zero))
    point, last = end.point, end.iterate
    converged = end.arrived & last.settled
    found = LoadPath(
        base_moment=body.moment(jnp.where(converged, last.values, point.values)),
        fraction=point.fraction,
        num_steps=end.num_steps,
        converged=converged,
        stable=jnp.where(converged, body.is_stable(last), point.stable),
        resolved=last.sane & (last.settled | ~end.arrived) & ~(end.ended & (end.num_tries <= 1)),
    )
    return found, last


def _start(body: LoadedBody, zero: Number) -> _Continuation:
    """Before the first try, which is the body without loads."""
    first = body.first(zero)
    still = jnp.zeros_like(first.values) + zero
    point = _Point(zero, first.values, still, still, first.strain, stable=zero == 0)
    return _Continuation(point, first, zero + 1.0, zero, zero)


def _next_try(body: LoadedBody, state: _Continuation) -> _Continuation:
    """Accept the step and predict the next one, or shorten it."""
    first = state.first
    reached, on_path, missed = _reached(body, state)
    turned = jnp.where(first, 0.0, largest_size(body.headings(reached.values - state.point.values)))
    accepted = on_path & (missed <= tol.LARGEST_MISS) & (turned <= tol.LARGEST_TURN)
    point = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), reached, state.point)

    step = state.step * _step_factor(missed, accepted, on_path)
    step = jnp.minimum(jnp.minimum(step, _gentle_step(body, point, first)), 1.0 - point.fraction)
    tries, arrived = state.num_tries + 1.0, accepted & (point.fraction >= 1.0)
    ended = ~arrived & ((~accepted & ((step < tol.LEAST_STEP) | first)) | (tries >= tol.MAX_TRIES))
    step = jnp.where(ended, 0.0, step)
    predicted = _predict(point, step, state.iterate)
    return _Continuation(
        point,
        predicted._replace(  # at the end it is the iterate itself
            near=arrived & state.iterate.near,
            settled=arrived & state.iterate.settled,
            change=jnp.where(arrived, state.iterate.change, 0.0),
        ),
        step,
        num_steps=state.num_steps + jnp.where(accepted & ~first, 1.0, 0.0),
        num_tries=tries,
    )


def _reached(body: LoadedBody, state: _Continuation) -> tuple[_Point, Flag, Number]:
    """The equilibrium near an iterate, whether it may lie on the path, and the miss of its prediction, rad."""
    first, old, iterate = state.first, state.point, state.iterate
    step, slope = state.fraction - old.fraction, body.slope_that_follows(iterate)
    half = jnp.where(first, 0.0, 0.5 / jnp.where(first, 1.0, step))
    bend = half * (slope - old.slope)
    new = _Point(state.fraction, iterate.values, slope, bend, iterate.strain, body.is_stable(iterate))
    expected = step * (old.slope + step * old.bend)
    missed = largest_size(body.headings(iterate.values - old.values - expected))
    stays = first | (new.stable == old.stable) | (state.step <= tol.CRITICAL_STEP)
    stays &= all_finite(slope)
    return new, iterate.near & stays, jnp.where(first, 0.0, missed)


def _step_factor(missed: Number, accepted: Flag, on_path: Flag) -> Number:
    """The factor on the last step. A prediction misses by the square of the step, as its `bend` is that of the last."""
    ideal = jnp.sqrt(0.3 * tol.LARGEST_MISS / jnp.maximum(missed, 1e-3))
    shorter = jnp.where(on_path, jnp.clip(ideal, 0.1, 0.5), 0.25)
    return jnp.where(accepted, jnp.clip(ideal, 0.3, 4.0), shorter)


def _gentle_step(body: LoadedBody, point: _Point, first: Flag) -> Number:
    """The step, of the loads, in which the body turns as far as it may."""
    turn = jnp.where(first, tol.FIRST_TURN, 0.8 * tol.LARGEST_TURN)
    return turn / jnp.maximum(largest_size(body.headings(point.slope)), 0.1 * tol.LARGEST_TURN)


def _predict(point: _Point, step: Number, iterate: Iterate) -> Iterate:
    """The next iterate, to second order in the step; it takes over the slopes of the last one."""
    return iterate._replace(
        values=point.values + step * (point.slope + step * point.bend),
        slopes=jnp.where(jnp.isfinite(iterate.slopes), iterate.slopes, 0.0),
        strain=point.strain,
        lost=iterate.lost & False,
        num_iterations=0.0 * iterate.num_iterations,
    )
