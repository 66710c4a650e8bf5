"""The turns of a path that are still remembered: largest and smallest values that nothing later has passed.

A tendon that is released slides out from the base as far as a front, and rests beyond it: there it has the tension that
an earlier pull has left. So what it remembers is a stack of extremes, in turn a largest and a smallest one, each within
those before. An extreme that a later value passes is forgotten, and with it the one after it (Madelung's rules).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..numerics.arrays import zero_as

Number = Float[Array, ""]
NO_STEP = -1  # in the place of a step


class Turns(NamedTuple):
    """What is open after each step; steps are counted from 0. Without the axis of the steps it is that of one."""

    direction: Float[Array, " steps"]  # +1 where the tendon was pulled, -1 where it was released
    before: Int[Array, " steps"]  # the step at whose value this motion turned; NO_STEP for the pull from rest
    place: Int[Array, " steps"]  # of this step in the stack
    open: Int[Array, "steps turns"]  # the remembered steps, the oldest first, this one last; then NO_STEP
    too_many: Bool[Array, " steps"]  # whether there were more turns than there is room for


class Stack(NamedTuple):
    """The extremes that are open."""

    value: Float[Array, " turns"]  # in turn a largest and a smallest one
    step: Int[Array, " turns"]
    num_open: Int[Array, ""]
    too_many: Bool[Array, ""]


def empty_stack(max_turns: int, values: Float[Array, " steps"]) -> Stack:
    """The stack of a tendon at rest; `values` tells precision and devices."""
    zero = zero_as(values)
    nothing = jnp.full(max_turns, NO_STEP)
    return Stack(jnp.zeros(max_turns, values.dtype) + zero, nothing, jnp.zeros((), int), zero > 1)


def go_on(stack: Stack, value: Number, step: Int[Array, ""]) -> tuple[Stack, Turns]:
    """Go straight to the value after a step. All values from rest on are such that a pull raises them."""
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
        values: after each step; between steps it goes straight from one to the next.
        max_turns: how many open turns there is room for; static.

    Returns:
        What is open at the end, and the turns of each step.
    """
    values = jax.lax.stop_gradient(values)

    def advance(stack: Stack, given: tuple[Number, Int[Array, ""]]) -> tuple[Stack, Turns]:
        return go_on(stack, *given)

    return jax.lax.scan(advance, empty_stack(max_turns, values), (values, jnp.arange(values.shape[0])))
