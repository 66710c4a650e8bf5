"""The turns of a base tension that are still felt: largest and smallest values that nothing later has passed.

A tendon that is released slides out from the base as far as a front, and rests beyond it: there it has the tension that
an earlier pull has left. So what it remembers is a stack of extremes, in turn a largest and a smallest one, each within
those before. An extreme that a later tension passes is forgotten, and with it the one after it (Madelung's rules).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..numerics.arrays import zero_as

NOBODY = -1  # in the place of a step


class Turns(NamedTuple):
    """What is open after each step; steps are counted from 0."""

    direction: Float[Array, " steps"]  # +1 where the tendon was pulled, -1 where it was released
    before: Int[Array, " steps"]  # the step at whose tension this motion turned; NOBODY for the pull from rest
    open: Int[Array, "steps turns"]  # the steps that are felt, the oldest first, this one last; then NOBODY
    too_many: Bool[Array, " steps"]  # whether there were more turns than there is room for


class _Open(NamedTuple):
    tension: Float[Array, " turns"]  # N, in turn a largest and a smallest one
    step: Int[Array, " turns"]
    num_open: Int[Array, ""]
    too_many: Bool[Array, ""]


def open_turns(base_tension: Float[Array, " steps"], max_turns: int) -> Turns:
    """Follow a base tension from rest.

    Args:
        base_tension: N, after each step; between steps it goes straight from one to the next.
        max_turns: how many open turns there is room for; static.
    """
    slots = jnp.arange(max_turns)
    zero = zero_as(base_tension)

    def advance(state: _Open, given: tuple[Float[Array, ""], Int[Array, ""]]) -> tuple[_Open, Turns]:
        tension, step = given
        last = jnp.maximum(state.num_open - 1, 0)
        now = jnp.where(state.num_open > 0, state.tension[last], 0.0)
        stays, pulled_last = tension == now, last % 2 == 0
        pulled = jnp.where(stays & (state.num_open > 0), pulled_last, tension >= now)
        direction = jnp.where(pulled, 1.0, -1.0).astype(tension.dtype)
        alike = (slots % 2 == 0) == pulled  # a largest tension is passed by a pull, a smallest one by a release
        passed = (slots < state.num_open) & alike & ((tension - state.tension) * direction >= 0)
        place = jnp.where(jnp.any(passed), jnp.argmax(passed), state.num_open)
        too_many = state.too_many | (place >= max_turns)
        place = jnp.minimum(place, max_turns - 1)
        here = slots == place
        new = _Open(
            tension=jnp.where(here, tension, state.tension),
            step=jnp.where(here, step, jnp.where(slots < place, state.step, NOBODY)),
            num_open=place + 1,
            too_many=too_many,
        )
        before = jnp.where(place > 0, new.step[jnp.maximum(place - 1, 0)], NOBODY)
        return new, Turns(direction, before, new.step, too_many)

    nothing = jnp.full(max_turns, NOBODY)
    start = _Open(jnp.zeros(max_turns, base_tension.dtype) + zero, nothing, jnp.zeros((), int), zero > 1)
    steps = jnp.arange(base_tension.shape[0])
    return jax.lax.scan(advance, start, (jax.lax.stop_gradient(base_tension), steps))[1]
