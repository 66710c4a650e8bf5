"""The direction in which each tendon slides: that of its travel, where the caller does not state it.

A tendon that slides in at the base (+1) loses tension towards the tip; one that slides out (-1) gains tension. Its
travel is the length of tendon pulled in at the base since the body was straight. Under loads it is the rate of that
length while all tensions rise in proportion.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, PyTree

from ..numerics import tolerances as tol
from ..numerics.fixed_point import until
from ..robot.manipulator import Manipulator
from ..robot.profiles import as_number
from .friction import PerTendon, Pull, unspent
from .problem import Number, Problem

Answer = TypeVar("Answer")
Directions = ArrayLike | Sequence[ArrayLike | None] | None  # for all tendons, or one each; None where it is to be found


def not_stated(direction: Directions) -> tuple[int, ...]:
    """The tendons, counted from 0, whose direction is None."""
    entries = direction if isinstance(direction, tuple | list) else ()
    return tuple(i for i, entry in enumerate(entries) if entry is None)


def as_directions(direction: Directions) -> PyTree:
    """The directions with their numbers as arrays; None stays where a direction is to be found."""
    if not_stated(direction):
        assert isinstance(direction, tuple | list)
        return tuple(None if entry is None else as_number(entry) for entry in direction)
    return None if direction is None else as_number(direction)


def stated_directions(direction: Directions, num_tendons: int) -> ArrayLike | Sequence[ArrayLike | None]:
    """The directions: numbers, or one entry per tendon with None where a direction is to be found.

    Args:
        direction: +1 or -1, for all tendons or one per tendon; None for all or for some of them. A single tendon
            without a stated direction has +1.
        num_tendons: of the body.

    Raises:
        ValueError: when there is neither one direction for all nor one per tendon.
    """
    if direction is None:
        direction = (None,) * num_tendons
    if not not_stated(direction):
        return direction
    assert isinstance(direction, tuple | list)
    if len(direction) != num_tendons:
        raise ValueError(f"direction must be a number or one per tendon ({num_tendons}), got {len(direction)} entries")
    return tuple(direction) if num_tendons > 1 else 1.0


def travel_under_tension(problem: Problem, pull: Pull, travel: PerTendon) -> PerTendon:
    """The travel of each tendon, m, zero for one that has no tension anywhere.

    Drag gives a tendon that slides out more tension towards the tip, so it may have tension without base tension.
    """
    pulls = problem.base_tension > 0
    if problem.nodes.drag is not None:
        pulls = pulls | (unspent(problem.base_tension, pull) / pull.ratio > 0)[-1, -1]
    return jnp.where(pulls, travel, 0.0)


def is_contradicted(direction: PerTendon, travel: PerTendon, length: Number) -> Bool[Array, " tendons"]:
    """Whether each tendon travels against its direction."""
    return direction * travel < -tol.LEAST_TRAVEL * length


class _Choice(NamedTuple):
    direction: PerTendon  # to be tried next
    best: PyTree  # the best answer so far
    fewest: Number  # contradictions in the best answer
    against: PerTendon  # of the tendons to find: 1 for one that travelled against its last direction
    num_tried: Number


def find_directions(
    manipulator: Manipulator,
    base_tension: PerTendon,
    stated: PerTendon,
    to_find: tuple[int, ...],
    attempt: Callable[[PerTendon], tuple[Answer, PerTendon, Bool[Array, ""]]],
    blank: Answer,
) -> Answer:
    """The answer in which no tendon travels against its direction, or else the answer with the fewest that do.

    This is Picard iteration for the directions: the first choice follows the moment of the tensions at the base, and
    then those that are contradicted are reversed. It ends where one tendon contradicts both of its directions and all
    others agree: part of such a tendon usually sticks. Where it goes round in circles, all choices are tried in turn;
    of more than 6 tendons the first 64.

    Args:
        manipulator: its tendons.
        base_tension: T_base, N.
        stated: the directions, of which those `to_find` are replaced.
        to_find: numbers of the tendons, from 0.
        attempt: what a choice of directions leads to, the travel of each tendon in m, and whether there is an
            equilibrium.
        blank: any answer of the right structure.
    """
    which, zero = jnp.asarray(to_find), jnp.zeros_like(stated[0])

    def update(choice: _Choice) -> tuple[_Choice, Bool[Array, ""]]:
        answer, travel, found = attempt(choice.direction)
        contradicted = is_contradicted(choice.direction, travel, jnp.asarray(manipulator.length))
        return _next_choice(choice, which, answer, jnp.where(contradicted[which], 1.0 + zero, zero), found)

    first = _by_moment(manipulator, base_tension, stated, which)
    start = _Choice(first, blank, zero + jnp.inf, 0 * first[which], zero)
    most = tol.NUM_FLIPS + min(2 ** len(to_find), tol.MOST_LISTED)
    return until(update, start, most)[0].best


def _by_moment(manipulator: Manipulator, base_tension: PerTendon, stated: PerTendon, which: Array) -> PerTendon:
    """The directions, of which those to be found follow the moment of the tensions at the base."""
    arm = manipulator.arms(jnp.zeros_like(jnp.asarray(manipulator.length)))
    turned, least = arm @ (base_tension @ arm), jnp.sum(arm**2 * base_tension[:, None]) * tol.LEAST_TRAVEL
    one = jnp.ones_like(stated[0])
    return stated.at[which].set(jnp.where(turned < -least, -one, one)[which])


def _next_choice(
    choice: _Choice, which: Array, answer: PyTree, against: PerTendon, found: Bool[Array, ""]
) -> tuple[_Choice, Bool[Array, ""]]:
    """Keep the better answer and choose what to try next; and whether the search has ended."""
    one = jnp.ones_like(choice.num_tried)
    count, num_tried = jnp.where(found, jnp.sum(against), which.size + one), choice.num_tried + one
    better = count < choice.fewest
    best = jax.tree.map(lambda new, old: jnp.where(better, new, old), answer, choice.best)
    bits = ((num_tried - tol.NUM_FLIPS).astype(int) >> jnp.arange(which.size)) & 1
    flipped = choice.direction[which] * (one - 2 * against)
    following = choice.direction.at[which].set(jnp.where(num_tried < tol.NUM_FLIPS, flipped, one - 2 * bits))
    # one tendon, whose direction was reversed just now, slides neither in nor out
    sticks = (num_tried <= tol.NUM_FLIPS) & (count == 1) & jnp.all(against == choice.against)
    ended = found & ((count == 0) | sticks)
    kept = _Choice(following, best, jnp.minimum(count, choice.fewest), against, num_tried)
    return kept, ended
