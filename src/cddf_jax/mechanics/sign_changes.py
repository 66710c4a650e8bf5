"""Arc lengths where a tendon's turning changes its sign, or the tendon becomes slack: T' has a kink, so a panel ends.

In the published kinematics and for tendons parallel to the axis all tendons turn with the body, and
what changes sign is the curvature; in the exact kinematics a slanted tendon has a turning of its own.
A tendon goes slack where drag has used up its base tension.
Without loads and drag, tendons parallel to the axis have no sign changes: their moment M depends on the wrap angle
theta alone, and theta' = |M(theta)| / (E J) does not reach a zero of M along a finite body.

In space the turning of a tendon has no sign, and mostly it does not vanish; but it may have a minimum so sharp that it
is nearly a kink. There panels end as well. Without loads and drag, tendons that are all parallel to the axis have no
such minimum: their wrap angle obeys theta'' = P'(theta) / 2 over s / (E J), where P, the square of the moment, is
smooth in theta.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt

from ..numerics.arrays import largest, varying_as, zero_as
from ..numerics.quadrature import Panels
from ..numerics.rotations import cross, length_of
from ..robot.cross_section import spatial, where_present
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from . import space
from .problem import (
    AnyState,
    Number,
    Problem,
    Solution,
    at_nodes,
    curvature_along,
    edge_nudge,
    moment_rate_of,
    strain_along,
    tension_of,
    turning_along,
)

NEGLIGIBLE = 1e-9  # of the largest: a smaller turning has no sign, and a smaller change of it no minimum
Values = TypeVar("Values")
SHARP = 0.25  # of the length: a minimum at a larger distance from a kink does no harm
KINK = 1e-5  # of the length: a minimum at a smaller distance from a kink is treated as one at this distance
REFINEMENTS = 5  # by the Illinois rule


def only_if(needed: Bool[Array, ""], compute: Callable[[Values], Values], values: Values) -> Values:
    """Apply a function to values where it is needed, and return them unchanged elsewhere.

    Nothing is computed where no lane of a batch needs it. This is a loop of one pass or none, because `lax.cond` would
    always compute for the whole batch. There are no derivatives in reverse mode.

    Args:
        needed: whether this lane needs it.
        compute: a function of the values. XLA moves out of the loop what does not depend on its argument.
        values: its argument.
    """
    turns = jnp.where(needed, 1.0, 0.0)
    return jax.lax.while_loop(
        lambda carry: carry[0] > 0, lambda carry: (carry[0] - 1, compute(carry[1])), (turns, values)
    )[1]


def tied_to(values: Float[Array, "..."]) -> Number:
    """Zero, computed from values that a loop carries. XLA does not move what it is added to out of that loop."""
    first = values.ravel()[0]
    return jnp.where(jnp.isfinite(first), 0.0 * first, 0.0)


class Splits(NamedTuple):
    """Where the panels are to end. Places that are not needed lie at the tip, and belong to no tendon.

    In space no place belongs to a tendon.
    """

    arc_length: Float[Array, " splits"]  # m
    owner: Int[Array, " splits"]  # whose turning or base tension left changes sign, see `signed_turning`; -1 for none


def num_splits(manipulator: Manipulator, loads: Loads | None) -> int:
    """How many sign changes can be located; for a body in space, how many panel ends around one sharp minimum."""
    if manipulator.in_space:
        # tendons that all follow the axis, where neither drag nor stretch moves the moment towards zero
        parallel = not manipulator.slanted and manipulator.rest_curvature is None
        alone = manipulator.num_tendons == 1 or (manipulator.tendon_drag is None and not manipulator.extensible)
        return 0 if loads is None and parallel and alone else 3
    own = _turns_on_its_own(manipulator)
    slack = 0 if manipulator.tendon_drag is None else manipulator.num_tendons
    if loads is None and not own and (manipulator.num_tendons == 1 or not (manipulator.slanted or slack)):
        return slack
    return slack + (2 * min(manipulator.num_tendons, 2) if own else 2)


def _turns_on_its_own(manipulator: Manipulator) -> bool:
    return manipulator.kinematics == "exact" and manipulator.slanted


def unsplit(manipulator: Manipulator, loads: Loads | None) -> Splits:
    """No sign change."""
    count = num_splits(manipulator, loads)
    return Splits(jnp.broadcast_to(jnp.asarray(manipulator.length), (count,)), jnp.full((count,), -1))


Turning = Float[Array, "P p owners"]


def signed_turning(problem: Problem, state: AnyState) -> Turning:
    """The quantities whose sign changes matter, at the nodes, 1/m: kappa, or psi' of every tendon.

    With drag also the base tension that it leaves to every tendon, over the moment scale.

    Args:
        problem: the body.
        state: at its nodes.
    """
    section = problem.nodes
    tension = tension_of(section, problem.base_tension, state.pull)
    kappa = curvature_along(section, tension, state.moment, state.strain)
    turning = kappa[..., None]
    if _turns_on_its_own(problem.manipulator):
        moment_rate = moment_rate_of(state.heading, state.force)
        turning = turning_along(section, kappa, tension, problem.direction, moment_rate)
    if state.pull.spent is None:
        return turning
    left = (problem.base_tension - state.pull.spent) / problem.moment_scale
    return jnp.concatenate([turning, left], axis=-1)


def locate(problem: Problem, state: AnyState, ends: Splits) -> Splits:
    """The first sign changes from the base, between neighbouring nodes and on the polynomials through them.

    In space: the sharpest minimum, and a place on either side.

    Args:
        problem: the body.
        state: at its nodes.
        ends: where its panels end now; the result in space without a sharp minimum.
    """
    if num_splits(problem.manipulator, problem.loads) == 0:
        return unsplit(problem.manipulator, problem.loads)
    if problem.in_space:
        return _around_sharpest_minimum(problem, state, ends)
    turning = signed_turning(problem, state)
    points = with_ends(problem.panels, turning)
    both, least = _has_both_signs(problem, points)
    none = varying_as(unsplit(problem.manipulator, problem.loads), zero_as(least))

    def changes(before: Splits) -> Splits:
        return _first_changes(problem, points + tied_to(before.arc_length), least, before)

    return only_if(both, changes, none)


def with_ends(cut: Panels, turning: Turning) -> Float[Array, "P q owners"]:
    """The turning at the start, the nodes and the end of each panel, on the polynomials through its nodes."""
    starts, ends = cut.at_starts_and_ends(turning)
    return jnp.concatenate([starts[:, None], turning, ends[:, None]], axis=1)


def _around_sharpest_minimum(problem: Problem, state: AnyState, ends: Splits) -> Splits:
    """Three arc lengths: the sharpest minimum of the turning of a tendon, and one on either side.

    The panels beside the minimum are short compared with the body, but not much longer than its distance from a kink.
    Where there is no sharp minimum, panels stay as they are, so that they do not go back and forth.
    """
    (place, distance), length = _sharpest_minimum(problem, state), problem.panels.edges[-1]
    beside = jnp.sqrt(jnp.maximum(distance, KINK * length) * length)
    around = jnp.clip(jnp.stack([place - beside, place, place + beside]), 0.0, length)
    return ends._replace(arc_length=jnp.where(distance < SHARP * length, around, ends.arc_length))


def has_sharp_minimum(problem: Problem, state: AnyState) -> Bool[Array, ""]:
    """Whether the turning of a tendon of a body in space has a minimum at which panels end."""
    return _sharpest_minimum(problem, state)[1] < SHARP * problem.panels.edges[-1]


def _sharpest_minimum(problem: Problem, state: AnyState) -> tuple[Number, Number]:
    """The minimum of the turning of a tendon that is nearest to a kink: its arc length and its distance from a kink, m.

    Near its minimum the turning is the length of a vector c that passes zero at a distance: about the square root of
    c'^2 ((s - s0)^2 + distance^2). From c and c' each node finds s0 and the distance. The minimum counts if it lies
    between the neighbours of the node, in the same smooth piece of the body. The node nearest to it gives the result.
    Without a minimum the distance is infinite.
    """
    cut, nodes = problem.panels, problem.nodes
    if state.strain is None:
        strain = strain_along(nodes, problem.base_tension, state)
    else:
        strain = spatial(nodes).rest + state.strain  # near enough for a place
    tangent = at_nodes(space.tangents, (0, 0))(nodes, strain)
    turn = at_nodes(space.turn_vectors, (0, 0, 0))(strain, tangent, cut.differentiate(tangent))
    rate = cut.differentiate(turn)
    growth, speed = (jnp.sum(each * rate, axis=-1) for each in (turn, rate))
    length, least = cut.edges[-1], max(NEGLIGIBLE, 1e3 * float(jnp.finfo(speed.dtype).eps))
    steep = speed > jnp.maximum(NEGLIGIBLE**2 * largest(speed), (least / length**2) ** 2)
    place = cut.nodes[..., None] - growth / jnp.where(steep, speed, 1.0)
    before, after = _neighbours_in_piece(problem)
    near = (before[..., None] <= place) & (place <= after[..., None]) & (place > 0) & (place < length)
    minimum = steep & near & (cut.differentiate(growth) > 0)
    distance = length_of(cross(turn, rate)) / jnp.where(steep, speed, 1.0)
    distance = where_present(nodes, jnp.where(minimum, distance, jnp.inf), jnp.inf)
    distance, place = (x.reshape(-1, x.shape[-1]) for x in (distance, place))
    sharpest = jnp.argmin(distance).astype(jnp.uint32)  # not read from the end
    node, tendon = sharpest // distance.shape[1], sharpest % distance.shape[1]
    distance, place = distance[:, tendon], place[:, tendon]
    off = jnp.where(jnp.isfinite(distance), jnp.abs(cut.nodes.ravel() - place[node]), jnp.inf)
    nearest = jnp.argmin(off)  # the farther the node, the less exact its minimum
    return place[nearest], distance[nearest]


def _neighbours_in_piece(problem: Problem) -> tuple[Float[Array, "P p"], Float[Array, "P p"]]:
    """As `Panels.neighbours`, but none beyond a place where the body is not smooth."""
    cut = problem.panels
    before, after = cut.neighbours
    if problem.manipulator.breakpoints.shape[0] == 0:
        return before, after
    joint, starts, ends = _is_joint(problem, cut.edges), cut.edges[:-1], cut.edges[1:]
    before = jnp.maximum(before, jnp.where(joint[:-1], starts, -jnp.inf)[:, None])
    return before, jnp.minimum(after, jnp.where(joint[1:], ends, jnp.inf)[:, None])


def _has_both_signs(problem: Problem, turning: Float[Array, "P q owners"]) -> tuple[Bool[Array, ""], Number]:
    """Whether there is turning of both signs, and the least turning, 1/m, that counts as having a sign.

    The latter is relative to the curvature that one tendon alone would cause, or to the largest turning.
    """
    alone = problem.base_tension * problem.nodes.offset / problem.nodes.stiffness[..., None]
    ahead, back = largest(turning), largest(-turning)
    least = NEGLIGIBLE * jnp.maximum(largest(alone), jnp.maximum(ahead, back))
    return (ahead > least) & (back > least), least


def _first_changes(problem: Problem, turning: Float[Array, "P q owners"], least: Number, none: Splits) -> Splits:
    """The first changes of sign.

    Negligible turning counts as turning to the right. A panel starts with the sign with which the one before ends, so
    that round-off where a panel ends at a sign change does not make two of one; for the same reason nothing changes in
    a panel without width. Between two pieces of the body the sign may change in a jump, and a panel ends there already.
    """
    cut = problem.panels
    left = turning > least
    left = jnp.where(cut.width[:, None, None] > 0, left, _before(left)[:, None])
    starts = jnp.where(_is_joint(problem, cut.edges[:-1])[:, None], left[:, 0], _before(left))
    left = jnp.concatenate([starts[:, None], left[:, 1:]], axis=1)
    changes = left[:, 1:] != left[:, :-1]
    per_panel, owners = changes.shape[1:]

    order = _first_of(changes.ravel(), none.owner.shape[0])
    found, at = order < changes.size, jnp.minimum(order, changes.size - 1).astype(jnp.uint32)  # not read from the end
    point, owner = at // owners, at % owners
    panel, within = point // per_panel, point % per_panel + 1
    places = jax.vmap(lambda panel, owner, at: zero_before(cut, turning[panel, :, owner], at))(panel, owner, within)
    place = cut.edges[panel] + cut.width[panel] * places
    return Splits(jnp.where(found, place, none.arc_length), jnp.where(found, owner.astype(none.owner.dtype), -1))


def _before(left: Bool[Array, "P q owners"]) -> Bool[Array, "P owners"]:
    """The value at the end of the panel before each panel; for the first one, at its own start."""
    return jnp.concatenate([left[:1, 0], left[:-1, -1]])


def _is_joint(problem: Problem, arc_length: Float[Array, " places"]) -> Bool[Array, " places"]:
    """Whether a piece of the body or a tendon ends there."""
    distance = jnp.abs(arc_length[:, None] - problem.manipulator.breakpoints)
    return jnp.any(distance <= edge_nudge(problem.panels), axis=1)


def _first_of(holds: Bool[Array, " entries"], count: int) -> Int[Array, " count"]:
    """The first entries at which something holds; the number of entries where there are no more."""
    order, entries = [], jnp.arange(holds.size)
    for _ in range(count):  # sorting takes longer
        rest = holds if not order else holds & (entries > order[-1])
        order.append(-largest(jnp.where(rest, -entries, -holds.size)))
    return jnp.stack(order)


def zero_before(cut: Panels, turning: Float[Array, " q"], point: UInt[Array, ""]) -> Number:
    """The zero of the polynomial of one panel between a point and the one before, by the Illinois rule, in [0, 1].

    Args:
        cut: the panels.
        turning: at the start, the nodes and the end of the panel, see `with_ends`.
        point: the start of the panel, which is itself the zero, a node, or the end, counted from 0.
    """
    points = jnp.asarray([0.0, *cut.rule.nodes, 1.0], cut.edges.dtype)

    def value(place):
        return cut.lagrange(place) @ turning[1:-1]

    def narrow(_, state):
        (a, b), (fa, fb) = state
        slope = jnp.where(fb == fa, 1.0, fb - fa)
        c = jnp.where(fb == fa, (a + b) / 2, jnp.clip(b - fb * (b - a) / slope, jnp.minimum(a, b), jnp.maximum(a, b)))
        fc = value(c)
        crossed = fc * fb < 0
        return jnp.stack([jnp.where(crossed, b, a), c]), jnp.stack([jnp.where(crossed, fb, fa / 2), fc])

    ends = jnp.stack([jnp.maximum(point, 1) - 1, point])
    bracket = points[ends] + zero_as(turning)  # shard_map wants the bracket to vary as the turning does
    return jax.lax.fori_loop(0, REFINEMENTS, narrow, (bracket, turning[ends]))[0][1]


def turning_at_splits(
    problem: Problem, solution: Solution[AnyState], splits: Splits
) -> tuple[Float[Array, " splits"], Float[Array, " splits"]]:
    """The turning that should vanish at each split, 1/m, and its derivative along s, 1/m^2.

    For a split that is not needed, its distance from the tip, m, and 1.
    """
    one = jnp.ones_like(splits.arc_length)
    if problem.in_space or not one.size:  # nothing depends on the places, but for the error of the quadrature
        return 0.0 * solution.tip.ratio[0] * one, one  # 0 as a linear function: `custom_linear_solve` transposes it
    cut, turning = problem.panels, signed_turning(problem, solution.nodes)
    panel = jnp.sum(cut.edges[1:-1] <= splits.arc_length[:, None], axis=1)  # the last that starts there is not empty
    needed, at = splits.owner >= 0, (panel, jnp.maximum(splits.owner, 0))

    def there(turning: Turning) -> Float[Array, " splits"]:
        return cut.at_starts_and_ends(turning)[0][at]

    from_tip, rate = splits.arc_length - cut.edges[-1], there(cut.differentiate(turning))
    return jnp.where(needed, there(turning), from_tip), jnp.where(needed & (rate != 0), rate, one)
