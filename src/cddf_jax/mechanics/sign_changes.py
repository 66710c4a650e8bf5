"""Places where a tendon's turning changes its sign, or the tendon goes slack: T' has a kink, and a panel must end.

In the published kinematics and for tendons parallel to the axis all tendons turn with the body, and
what changes sign is the curvature; in the exact kinematics a slanted tendon has a turning of its own.
A tendon goes slack where drag has used up its base tension.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..numerics.arrays import largest, varying_as, zero_as
from ..robot.loads import Loads
from ..robot.manipulator import CrossSection, Manipulator
from .problem import (
    Number,
    Problem,
    Solution,
    State,
    all_points,
    curvature_of,
    edge_nudge,
    guarded_section,
    line_up,
    moment_rate_of,
    rates_of,
)

NEGLIGIBLE = 1e-9  # of the largest bend: smaller turning has no sign
Values = TypeVar("Values")
REFINEMENTS = 5  # the panels end ever closer to the place, and so does the interval in which it lies


def only_if(needed: Bool[Array, ""], compute: Callable[[Number], Values], otherwise: Values) -> Values:
    """The result of `compute` where it is needed, and `otherwise` elsewhere.

    Nothing is computed where no lane of a batch needs it: this is a loop of one turn or none, while `lax.cond` would
    always compute for the whole batch. There are no derivatives in reverse mode.

    Args:
        needed: whether this lane needs it.
        compute: its argument is a zero, to be added to what it works on. XLA would move the rest out of the loop.
        otherwise: the result where it is not needed.
    """
    turns = jnp.where(needed, 1.0, 0.0)

    def once(carry):
        return carry[0] - 1.0, compute(0.0 * carry[0])

    return jax.lax.while_loop(lambda carry: carry[0] > 0, once, (turns, otherwise))[1]


class Splits(NamedTuple):
    """Where the panels are to end. Places that are not needed lie at the tip, and belong to no tendon."""

    arc_length: Float[Array, " splits"]  # m
    owner: Int[Array, " splits"]  # whose turning or base tension left changes sign, see `turning_at`; -1 for none


def num_splits(manipulator: Manipulator, loads: Loads | None) -> int:
    """For how many sign changes there is room."""
    own = _turns_on_its_own(manipulator)
    slack = 0 if manipulator.tendon_drag is None else manipulator.num_tendons
    if loads is None and manipulator.num_tendons == 1 and not own:
        return slack
    return slack + (2 * min(manipulator.num_tendons, 2) if own else 2)


def _turns_on_its_own(manipulator: Manipulator) -> bool:
    return manipulator.kinematics == "exact" and manipulator.slanted


def unsplit(manipulator: Manipulator, loads: Loads | None) -> Splits:
    """No sign change."""
    count = num_splits(manipulator, loads)
    return Splits(jnp.broadcast_to(jnp.asarray(manipulator.length), (count,)), jnp.full((count,), -1))


def turning_at(problem: Problem, section: CrossSection, state: State) -> Float[Array, " owners"]:
    """What may change sign at one cross-section, 1/m: kappa, or psi' of every tendon.

    And with drag what it leaves of the base tension of every tendon, over the moment scale.
    """
    kappa = curvature_of(problem, section, state.pull, state.moment)
    turning = kappa[None]
    if _turns_on_its_own(problem.manipulator):
        turning = rates_of(problem, section, kappa, state.pull, moment_rate_of(state.heading, state.force)).turning
    if state.pull.spent is None:
        return turning
    return jnp.concatenate([turning, (problem.base_tension - state.pull.spent) / problem.moment_scale])


def locate(problem: Problem, solution: Solution) -> Splits:
    """The first sign changes from the base, found between neighbouring nodes and refined on their polynomials."""
    turning = jax.vmap(lambda *at: turning_at(problem, *at))(*all_points(problem, solution))
    both, least = _has_both_signs(problem, turning)
    none = varying_as(unsplit(problem.manipulator, problem.loads), zero_as(least))
    return only_if(both, lambda zero: _first_changes(problem, solution, turning + zero, least, none), none)


def changes_sign(problem: Problem, solution: Solution) -> Bool[Array, ""]:
    """Whether there is a sign change between nodes."""
    turning = jax.vmap(jax.vmap(lambda *at: turning_at(problem, *at)))(problem.nodes, solution.nodes)
    return _has_both_signs(problem, turning)[0]


def _has_both_signs(problem: Problem, turning: Float[Array, "*points owners"]) -> tuple[Bool[Array, ""], Number]:
    """Whether there is turning of both signs, and how small it may be to have one.

    That is measured by what one tendon alone or the largest turning would make of the curvature, 1/m.
    """
    alone = problem.base_tension * problem.nodes.offset / problem.nodes.stiffness[..., None]
    ahead, back = largest(turning), largest(-turning)
    least = NEGLIGIBLE * jnp.maximum(largest(alone), jnp.maximum(ahead, back))
    return (ahead > least) & (back > least), least


def _first_changes(
    problem: Problem, solution: Solution, turning: Float[Array, "points owners"], least: Number, none: Splits
) -> Splits:
    cut = problem.panels
    arc_length = line_up(cut.edges[0], cut.nodes, cut.edges[-1]) + zero_as(turning)
    left_turn, right_turn = turning > least, turning < -least
    last_left, last_right = _last_before(left_turn), _last_before(right_turn)
    changes = (left_turn & (last_right > last_left)) | (right_turn & (last_left > last_right))

    order = _first_of(changes.ravel(), none.owner.shape[0])
    found, at = order < changes.size, jnp.minimum(order, changes.size - 1)
    point, owner = at // turning.shape[1], at % turning.shape[1]
    before = jnp.maximum(last_left, last_right).ravel()[at]
    bracket = arc_length[jnp.maximum(before, 0)], arc_length[point]
    place, jumps = jax.vmap(partial(_refine, problem, solution))(*bracket, owner)
    found = found & ~jumps
    return Splits(jnp.where(found, place, none.arc_length), jnp.where(found, owner, -1))


def _last_before(holds: Bool[Array, "points owners"]) -> Int[Array, "points owners"]:
    """For each point the last one before it at which something holds; -1 where there is none."""
    last = jax.lax.cummax(jnp.where(holds, jnp.arange(holds.shape[0])[:, None], -1))
    return jnp.concatenate([-jnp.ones_like(last[:1]), last[:-1]])


def _first_of(holds: Bool[Array, " entries"], count: int) -> Int[Array, " count"]:
    """The first entries at which something holds; the number of entries where there are no more."""
    order, entries = [], jnp.arange(holds.size)
    for _ in range(count):  # sorting takes longer
        rest = holds if not order else holds & (entries > order[-1])
        order.append(-largest(jnp.where(rest, -entries, -holds.size)))
    return jnp.stack(order)


def _refine(
    problem: Problem, solution: Solution, left: Number, right: Number, owner: Int[Array, ""]
) -> tuple[Number, Bool[Array, ""]]:
    """The zero of one tendon's turning between two arc lengths, by the Illinois rule.

    And whether the sign changes in a jump instead, where a piece of the body or a tendon ends and a panel ends anyway.
    """

    def turning(arc_length):
        state = problem.panels.read(solution.starts, solution.nodes, arc_length)
        return turning_at(problem, guarded_section(problem.manipulator, arc_length), state)[owner]

    def narrow(_, bracket):
        a, fa, b, fb = bracket
        slope = jnp.where(fb == fa, 1.0, fb - fa)
        c = jnp.where(fb == fa, (a + b) / 2, jnp.clip(b - fb * (b - a) / slope, jnp.minimum(a, b), jnp.maximum(a, b)))
        fc = turning(c)
        crossed = fc * fb < 0
        return jnp.where(crossed, b, a), jnp.where(crossed, fb, fa / 2), c, fc

    nudge, joints = edge_nudge(problem.panels), problem.manipulator.breakpoints
    ends, before, after = jnp.split(
        jax.vmap(turning)(jnp.concatenate([jnp.stack([left, right]), joints - nudge, joints + nudge])),
        [2, 2 + joints.shape[0]],
    )
    zero = zero_as(ends)  # shard_map wants the bracket to vary as the turning does
    place = jax.lax.fori_loop(0, REFINEMENTS, narrow, (left + zero, ends[0], right + zero, ends[1]))[2]
    within = (joints >= left) & (joints <= right)
    return place, jnp.any(within & (before * after < 0))


def turning_at_splits(problem: Problem, solution: Solution, splits: Splits) -> Float[Array, " splits"]:
    """The turning that should vanish at each split; for one that is not needed, its distance from the tip, m."""

    def residual(arc_length, owner):
        start = jnp.argmin(jnp.abs(problem.panels.edges[:-1] - arc_length))
        state = jax.tree.map(lambda x: x[start], solution.starts)
        section = guarded_section(problem.manipulator, arc_length)
        turning = turning_at(problem, section, state)[jnp.maximum(owner, 0)]
        return jnp.where(owner >= 0, turning, arc_length - problem.panels.edges[-1])

    return jax.vmap(residual)(*splits)
