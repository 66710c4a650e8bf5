"""The base tensions for given displacements of the tendon or given tip angles.

The displacement or tip angle that a motion adds since its turn comes only from the part of the body in which the tendon
slides. It grows throughout the motion. So displacement or angle turns where the tension turns, and each step has one
unknown. Just after a turn it grows with the square of the change in tension; so the search compares square roots.

In space the tip angle also depends on how the rest of the body is turned. There it need not grow throughout a motion.
Where it does not, the angle may be missed: the status is then `unreachable`.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..numerics.fixed_point import until
from ..robot.manipulator import Manipulator
from ..statics.targets import bending_tension
from .congruent_parts import Composed, at_place, composed, ends_of_motion, put, tilt_of
from .fronts import Motion
from .turns import NO_STEP, Number, Stack, Turns, go_on

DOUBLINGS = 24  # of a tension, until it is large enough
EVALUATIONS = 60  # at most; most searches take ten


class Drive(NamedTuple):
    """The base tensions of a path of displacements or tip angles."""

    tension: Float[Array, " steps"]  # N
    reached: Bool[Array, " steps"]  # whether it gives what was wanted, to half the digits
    turns: Turns


def driven(
    body: Manipulator,
    nodes: int,
    quantity: str,
    wanted: Float[Array, " steps"],
    stack: Stack,
    bodies: Composed,
    first_step: int,
) -> Drive:
    """Find the base tensions of a path.

    Args:
        body: with one tendon.
        nodes: Gauss nodes in each smooth piece.
        quantity: "displacement", m, or "tip_angle", rad.
        wanted: its values after each step.
        stack: the remembered turns before the first step.
        bodies: those at the turns of the stack.
        first_step: the number of the first step.
    """
    constant, value_of = jax.lax.stop_gradient(body), partial(_value_of, body, quantity)
    wanted = _side(body, quantity) * wanted
    zero = 0.0 * wanted[0]
    at_rest = _after(body, nodes, at_place(bodies, 0), Motion(zero, zero + 1, zero, zero == 0))
    first_try = 1e-3 * bending_tension(constant)  # N, a small tension
    scale = 1.0 if quantity == "tip_angle" else jnp.asarray(body.length)

    def advance(state: tuple[Stack, Composed], given: tuple[Number, Int[Array, ""]]):
        (stack, bodies), (value, step) = state, given
        stack, turn = go_on(stack, jax.lax.stop_gradient(value), step)
        from_rest = turn.before == NO_STEP
        below = jax.tree.map(partial(jnp.where, from_rest), at_rest, at_place(bodies, turn.place - 1))

        def after(body: Manipulator, below: Composed, tension: Number) -> Composed:
            return _after(body, nodes, below, Motion(tension, turn.direction, below.base_tension, from_rest))

        def gain(body: Manipulator, below: Composed, tension: Number) -> Number:
            return value_of(after(body, below, tension)) - value_of(below)

        gains = partial(gain, body, below), partial(gain, constant, jax.lax.stop_gradient(below))
        tension = _tension_for(*gains, below.base_tension, turn.direction, value - value_of(below), first_try)
        new = after(body, below, tension)
        reached = jnp.abs(value_of(new) - value) <= jnp.finfo(value.dtype).eps ** 0.5 * scale
        values = put(stack.value, turn.place, jax.lax.stop_gradient(jnp.where(reached, value, value_of(new))))
        return (stack._replace(value=values), put(bodies, turn.place, new)), Drive(tension, reached, turn)

    stack = stack._replace(value=jax.lax.stop_gradient(jax.vmap(value_of)(bodies)))
    return jax.lax.scan(advance, (stack, bodies), (wanted, first_step + jnp.arange(wanted.size)))[1]


def _after(body: Manipulator, nodes: int, below: Composed, motion: Motion) -> Composed:
    return composed(body, below, motion, *ends_of_motion(body, nodes, motion))


def _value_of(body: Manipulator, quantity: str, composed: Composed) -> Number:
    """The quantity, with the sign with which it grows while the tendon is pulled."""
    whole = composed.whole
    return whole.pulled_in if quantity == "displacement" else _side(body, quantity) * tilt_of(whole.heading)


def _side(body: Manipulator, quantity: str) -> int:
    """-1 for the tip angle of a tendon with side = -1."""
    return body.tendons[0].side if quantity == "tip_angle" and not body.in_space else 1


def _tension_for(
    gain: Callable[[Number], Number],
    constant_gain: Callable[[Number], Number],
    turned_at: Number,
    direction: Number,
    wanted: Number,
    first_try: Number,
) -> Number:
    """The tension of a motion that adds the wanted amount, or the nearest one; the search itself has no derivatives."""
    fixed = jax.lax.stop_gradient
    start, aim = fixed(turned_at), fixed(wanted * direction)
    target = jnp.sqrt(jnp.maximum(aim, 0.0))

    def missing(change: Number) -> Number:
        return jnp.sqrt(jnp.maximum(constant_gain(start + direction * change) * direction, 0.0)) - target

    most = jnp.where(aim > 0, jnp.where(direction > 0, first_try * 2.0**DOUBLINGS, start), 0.0)
    change, enough = _search(missing, -target, first_try, most)
    near = start + direction * change
    value, slope = jax.jvp(gain, (near,), (jnp.ones_like(near),))
    exact = (aim > 0) & enough & (fixed(slope) > 0)
    follows = near - (value - wanted) / fixed(jnp.where(exact, slope, 1.0))  # with the derivatives of the root
    return jnp.where(exact, follows, jnp.where(aim > 0, near, turned_at))


class _Bracket(NamedTuple):
    behind: Number
    last: Number
    value_behind: Number
    value: Number
    crossed: Bool[Array, ""]  # whether the zero lies between the two


def _search(
    function: Callable[[Number], Number], at_zero: Number, first_try: Number, most: Number
) -> tuple[Number, Bool[Array, ""]]:
    """The zero of a growing function between 0 and `most`, by the Illinois rule; and whether there is one."""
    least = 4 * jnp.finfo(most.dtype).eps

    def step(state: _Bracket) -> tuple[_Bracket, Bool[Array, ""]]:
        a, b, fa, fb, _ = state
        slope = jnp.where(fb == fa, 1.0, fb - fa)
        within = jnp.clip(b - fb * (b - a) / slope, jnp.minimum(a, b), jnp.maximum(a, b))
        c = jnp.where(state.crossed, within, jnp.minimum(jnp.maximum(2 * b, first_try), most))
        fc = function(c)
        crosses = fc * fb < 0
        crossed = state.crossed | crosses
        settled = (fc == 0) | jnp.where(crossed, jnp.abs(c - b) <= least * c, c >= most)
        behind, value_behind = jnp.where(crosses, b, a), jnp.where(crosses, fb, fa / 2)
        return _Bracket(behind, c, value_behind, fc, crossed), settled

    zero = jnp.zeros_like(most)
    end, _ = until(step, _Bracket(zero, zero, at_zero, at_zero, zero > 1), EVALUATIONS)
    return end.last, end.crossed | (end.value == 0)
