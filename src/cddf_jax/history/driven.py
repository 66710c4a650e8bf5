"""The base tensions for given displacements of the tendon or given tip angles.

The displacement or tip angle that a motion adds since its turn comes only from the part of the body in which the tendon
slides. It grows throughout the motion. So displacement or angle turns where the tension turns, and each step has one
unknown. Just after a turn it grows with the square of the change in tension; so the search compares square roots.

In space the tip angle also depends on how the rest of the body is turned, which is remembered at each turn. There it
need not grow throughout a motion. Where it does not, the angle may be missed: the status is then `unreachable`.
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
from .congruent_parts import Heading, ends_of_motion, pose_of_base, slid_up_to, tilt_of, turned_back, turned_on
from .fronts import Motion
from .turns import NO_STEP, Number, Stack, Turns, go_on

DOUBLINGS = 24  # of a tension, until it is large enough
EVALUATIONS = 60  # at most; most searches take ten


class Gained(NamedTuple):
    """What a motion adds to the quantity since it turned."""

    amount: Number
    heading: Heading | None  # of the tip after it, for a tip angle in space


Gain = Callable[[Number, Number], Gained]  # from the tensions before and after a motion


class Drive(NamedTuple):
    """The base tensions of a path of displacements or tip angles, and whether they exist."""

    tension: Float[Array, " steps"]  # N
    slack: Bool[Array, " steps"]  # the tendon would have to push, and is slack
    unreachable: Bool[Array, " steps"]


def driven(
    body: Manipulator,
    nodes: int,
    quantity: str,
    wanted: Float[Array, " steps"],
    stack: Stack,
    tensions: Float[Array, " turns"],
    values: Float[Array, " turns"],
    headings: Float[Array, "turns *axes"],
    first_step: int,
) -> tuple[Drive, Turns]:
    """Find the base tensions of a path.

    Args:
        body: with one tendon.
        nodes: Gauss nodes in each smooth piece.
        quantity: "displacement", m, or "tip_angle", rad.
        wanted: its values after each step.
        stack: the remembered turns before the first step.
        tensions, values, headings: base tension, N, quantity, and heading of the tip at the turns of the stack.
        first_step: the number of the first step.
    """
    constant = jax.lax.stop_gradient(body)
    in_space = body.in_space and quantity == "tip_angle"
    at_rest = _heading_at_rest(body, nodes, wanted) if in_space else None

    def advance(state: _Driven, given: tuple[Number, Int[Array, ""]]) -> tuple[_Driven, tuple[Drive, Turns]]:
        value, step = given
        stack, turn = go_on(state.stack, jax.lax.stop_gradient(value), step)
        below = jnp.maximum(turn.place - 1, 0)
        from_rest = turn.before == NO_STEP
        turned_at, since = (jnp.where(from_rest, 0.0, x[below]) for x in (state.tensions, state.values))
        heading = None
        if at_rest is not None and state.headings is not None:
            heading = jnp.where(from_rest, at_rest, state.headings[below])
            since = tilt_of(heading)
        gain, constant_gain = (
            partial(_gain, one, nodes, quantity, turn.direction, from_rest, there)
            for one, there in ((body, heading), (constant, jax.lax.stop_gradient(heading)))
        )
        drive, added = _tension_for(gain, constant_gain, turned_at, turn.direction, value - since, first_try)
        here = jnp.arange(stack.step.size) == turn.place
        values = jnp.where(here, since + added.amount, state.values)
        headings = state.headings
        if headings is not None and added.heading is not None:
            headings = jnp.where(here[:, None, None], added.heading, headings)
        new = _Driven(
            stack._replace(value=jax.lax.stop_gradient(values)),
            jnp.where(here, drive.tension, state.tensions),
            values,
            headings,
        )
        return new, (drive, turn)

    first_try = 1e-3 * bending_tension(constant)  # N, a small tension
    known = stack._replace(value=jax.lax.stop_gradient(values))
    start = _Driven(known, tensions, values, headings if in_space else None)
    return jax.lax.scan(advance, start, (wanted, first_step + jnp.arange(wanted.size)))[1]


class _Driven(NamedTuple):
    stack: Stack
    tensions: Float[Array, " turns"]  # at its turns, N
    values: Float[Array, " turns"]  # those of the stack, with their derivatives
    headings: Float[Array, "turns 3 3"] | None  # of the tip, for a tip angle in space


def _gain(
    body: Manipulator,
    nodes: int,
    quantity: str,
    direction: Number,
    from_rest: Bool[Array, ""],
    heading: Heading | None,
    turned_at: Number,
    tension: Number,
) -> Gained:
    """How much a motion adds to the quantity since it turned, with the tip at `heading`."""
    _, own, other = ends_of_motion(body, nodes, Motion(tension, direction, turned_at, from_rest))
    if heading is not None:  # beyond the front the body keeps its shape
        rest = turned_on(turned_back(other.added.heading), heading)
        turned = jnp.where(from_rest, own.added.heading, turned_on(own.added.heading, rest))
        turned = jnp.where(own.added.solved & other.added.solved, turned, heading)
        return Gained(tilt_of(turned) - tilt_of(heading), turned)
    side = side_of(body, quantity)
    values = side * own.added.heading, side * other.added.heading
    outside = 0.0
    if quantity == "displacement":
        values = own.added.pulled_in, other.added.pulled_in
        outside = (tension - turned_at) * jnp.sum(body.tendon_outside_compliance)
    return Gained(outside + values[0] - jnp.where(from_rest, 0.0, values[1]), None)


def side_of(body: Manipulator, quantity: str) -> int:
    """The sign with which a quantity grows while the tendon is pulled: -1 for the tip angle of one with side = -1."""
    return body.tendons[0].side if quantity == "tip_angle" and not body.in_space else 1


def _heading_at_rest(body: Manipulator, nodes: int, like: Array) -> Heading:
    """The heading of the tip without tension."""
    zero = jnp.zeros_like(like[0])
    if body.rest_curvature is None:
        return pose_of_base(body, zero)[0]
    return slid_up_to(body, nodes, zero, zero + 1, jnp.asarray(body.length)).added.heading


def _tension_for(
    gain: Gain, constant_gain: Gain, turned_at: Number, direction: Number, wanted: Number, first_try: Number
) -> tuple[Drive, Gained]:
    """The tension of a motion that adds the wanted amount, and what it adds; the search itself has no derivatives."""
    fixed = jax.lax.stop_gradient
    start, aim = fixed(turned_at), fixed(wanted * direction)
    target = jnp.sqrt(jnp.maximum(aim, 0.0))

    def missing(change: Number) -> Number:
        added = constant_gain(start, start + direction * change).amount * direction
        return jnp.sqrt(jnp.maximum(added, 0.0)) - target

    most = jnp.where(aim > 0, jnp.where(direction > 0, first_try * 2.0**DOUBLINGS, start), 0.0)
    change, enough = _search(missing, -target, first_try, most)
    near = start + direction * change

    (value, heading), (slope, turning) = jax.jvp(partial(gain, turned_at), (near,), (jnp.ones_like(near),))
    moves = aim > 0
    exact = moves & enough & (fixed(slope) > 0)
    follows = near - (value - wanted) / fixed(jnp.where(exact, slope, 1.0))  # with the derivatives of the root
    tension = jnp.where(exact, follows, jnp.where(moves, near, turned_at))
    slack = jnp.where(direction > 0, (aim < 0) & (start == 0), moves & ~enough)
    added = jnp.where(exact, wanted, jnp.where(moves, value, 0.0))
    if heading is not None:
        heading = heading + jnp.where(exact, fixed(turning) * (tension - near), 0.0)
    return Drive(tension, slack, moves & ~slack & ~enough), Gained(added, heading)


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
