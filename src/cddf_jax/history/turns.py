"""The turns of a path that are still remembered: largest and smallest values that nothing later has passed.

A tendon that is released slides out from the base up to a front, and rests beyond it. There it has the tension that an
earlier pull has left. So the memory is a stack of extremes, alternately a largest and a smallest value, each within the
range of those before. An extreme that a later value passes is forgotten, together with the extreme after it (Madelung's
rules).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..numerics.arrays import zero_as

Number = Float[Array, ""]
NO_STEP = -1  # where the number of a step is expected and there is none


class Turns(NamedTuple):
    """The remembered turns after each step; steps are counted from 0. Without the axis of steps, those of one step."""

    direction: Float[Array, " steps"]  # +1 where the tendon was pulled, -1 where it was released
    before: Int[Array, " steps"]  # the step at whose value this motion turned; NO_STEP for the pull from rest
    place: Int[Array, " steps"]  # the index of this step in the stack
    open: Int[Array, "steps turns"]  # the remembered steps, the oldest first, this one last; then NO_STEP
    too_many: Bool[Array, " steps"]  # whether there were more turns than `max_turns`


class Stack(NamedTuple):
    """The extremes that are remembered, or "open"."""

    value: Float[Array, " turns"]  # alternately a largest and a smallest value
    step: Int[Array, " turns"]
    num_open: Int[Array, ""]
    too_many: Bool[Array, ""]


def go_on(stack: Stack, value: Number, step: Int[Array, ""]) -> tuple[Stack, Turns]:
    """The stack and the turns after a step to `value`. The values are those of a quantity that a pull raises."""
    max_turns = stack.step.shape[0]
    slots = jnp.arange(max_turns)
    last = jnp.maximum(stack.num_open - 1, 0)
    now = jnp.where(stack.num_open > 0, stack.value[last], 0.0)
    stays, pulled_last = value == now, last % 2 == 0
    pulled = jnp.where(stays & (stack.num_open > 0), pulled_last, value >= now) | (stack.num_open == 0)
    direction = jnp.where(pulled, 1.0, -1.0).astype(value.dtype)
    alike = (slots % 2 == 0) == pulled  # a largest value is passed by a pull, a smallest one by a release
    passed = (slots < stack.num_open) & alike & ((value - stack.value) * direction >= 0)
    place = jnp.where(jnp.any(passed), jnp.argmax(passed), stack.num_open)
    too_many = stack.too_many | (place >= max_turns)
    place = jnp.minimum(place, max_turns - 1)
    here = slots == place
    new = Stack(
        value=jnp.where(here, value, stack.value),
        step=jnp.where(here, step, jnp.where(slots < place, stack.step, NO_STEP)),
        num_open=place + 1,
        too_many=too_many,
    )
    before = jnp.where(place > 0, new.step[jnp.maximum(place - 1, 0)], NO_STEP)
    return new, Turns(direction, before, place, new.step, too_many)


def open_turns(values: Float[Array, " steps"], max_turns: int) -> tuple[Stack, Turns]:
    """Follow a path from rest.

    Args:
        values: after each step; between two steps the value changes monotonically.
        max_turns: how many turns can be remembered; static.

    Returns:
        The stack at the end, and the turns after each step.
    """
    values = jax.lax.stop_gradient(values)
    zero, steps = zero_as(values), jnp.arange(values.shape[0])
    at_rest = Stack(jnp.full(max_turns, zero), jnp.full(max_turns, NO_STEP), jnp.zeros((), int), zero > 1)
    return jax.lax.scan(lambda stack, given: go_on(stack, *given), at_rest, (values, steps))
