"""The front of a motion: the arc length up to which a tendon slides, and beyond which it rests."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, UInt

from ..mechanics import bending, space
from ..mechanics.friction import Pull, tension_rate
from ..mechanics.march import FixedPoint
from ..mechanics.problem import guarded_section, lay_out
from ..numerics.arrays import zero_as
from ..numerics.elements import Elements, times
from ..numerics.fixed_point import newton
from ..robot.cross_section import planar, spatial
from ..robot.manipulator import Manipulator
from ..statics.solve import solve
from .turns import NO_STEP, Number, Turns

REFINEMENTS = 3  # by Newton's method
NARROWINGS = 6  # likewise, of the zero of a polynomial
LEAST = 1e-9  # of the body: the least position of a front, for steps as small as rounding errors


class Motion(NamedTuple):
    """The motion of a tendon in one direction, since its last turn."""

    tension: Number  # at the base after the motion, N
    direction: Number
    turned_at: Number  # base tension at the turn where the motion began, N; before it the tendon slid the other way
    from_rest: Bool[Array, ""]  # whether it is the first motion, which began at no turn


def motions(path: Float[Array, " path"], turns: Turns) -> Motion:
    """The motions to the base tensions of a path from rest, N."""
    from_rest = turns.before == NO_STEP
    return Motion(path, turns.direction, jnp.where(from_rest, 0.0, path[turns.before]), from_rest)


def cut_at(body: Manipulator, arc_length: Number) -> Manipulator:
    """The body from its base to an arc length, m."""
    return eqx.tree_at(lambda body: body.length, body, arc_length)


def is_play_of_inverse(body: Manipulator) -> bool:
    """Whether a tendon turns in proportion to its tension, so that 1/T has a play operator with equal sides; static."""
    own_strain = body.extensible or body.rest_curvature is not None
    return body.tendon_drag is None and not body.slanted and not own_strain


def front_of(body: Manipulator, nodes: int, motion: Motion, *, refined: bool = True) -> Number:
    """The arc length, m, where the tension of a motion equals that of the motion before; the tip if all slides.

    Within the body it has no derivative. Integrals along the body need none, because their integrands are continuous at
    the front. See `moving_front` for the front with its derivative. At the tip it has that of the length.

    Args:
        body: with one tendon.
        nodes: Gauss nodes in each smooth piece.
        motion: of the tendon.
        refined: whether it must be exact to rounding errors. An error of the front changes integrals along the body by
            its square only.
    """
    tip = jnp.asarray(body.length)
    body, (tension, direction, turned_at, from_rest) = jax.lax.stop_gradient((body, motion))
    length = jnp.asarray(body.length)
    ends = (tension, direction), (turned_at, -direction)
    slides = [lay_out(body, at_base[None], way[None], nodes) for at_base, way in ends]
    pull, other = (FixedPoint()(problem).nodes.pull for problem in slides)
    # in T = (T_base - c) / r both r and c are smooth, also beyond the place where a released tendon would lock
    gap = direction * (left_of(tension, pull) * other.ratio - left_of(turned_at, other) * pull.ratio)
    front = jnp.clip(_first_zero(slides[0].elements, gap[..., 0]), LEAST * length, length)
    if refined and not is_play_of_inverse(body):  # else r is a polynomial, and the front is exact already
        found = newton(partial(_nearer, body, nodes, ends), front, REFINEMENTS)
        front = jnp.where((front < length) & ~is_held(body, front), found, front)
    return jnp.where(from_rest | (front >= length), tip, front)


def is_held(body: Manipulator, front: Number) -> Bool[Array, ""]:
    """Whether a front rests at a joint, where tensions may jump."""
    return jnp.any(body.breakpoints == front)


def moving_front(body: Manipulator, front: Number, here: Number, there: Number, direction: Number) -> Number:
    """The same front, m, with its derivative: the difference of two tensions over the difference of their slopes.

    Args:
        body: with one tendon.
        front: from `front_of`.
        here, there: the tensions at the front, of a motion and of the motion before it, N; with derivatives.
        direction: of the motion.
    """
    still, apart = jax.lax.stop_gradient((body, front, here, direction)), here - there
    body, place, tension, direction = still
    slope = partial(_slope, body, place, tension)
    parting = slope(direction) - slope(-direction)
    moves = (place < body.length) & (parting != 0) & ~is_held(body, place)
    change = (apart - jax.lax.stop_gradient(apart)) / jnp.where(moves, parting, 1.0)
    return front - jnp.where(moves, change, 0.0)


def _slope(body: Manipulator, place: Number, tension: Number, direction: Number) -> Number:
    """T', N/m, of a tendon that slides, at an arc length and for a tension there."""
    given = tension[None], direction[None]
    if body.in_space:
        return space.tension_rate_without_loads(lambda s: spatial(guarded_section(body, s)), place, *given)[0]
    section = planar(guarded_section(body, place))
    turning = bending.turning(section, bending.curvature(section, given[0]), *given)
    return tension_rate(given[1], section, turning, given[0])[0]


def left_of(tension: Number, pull: Pull) -> Float[Array, "*points"]:
    """What drag leaves of a base tension, N; below zero where the tendon would be slack."""
    return tension - (0.0 if pull.spent is None else pull.spent)


def _nearer(
    body: Manipulator, nodes: int, ends: tuple[tuple[Number, Number], tuple[Number, Number]], front: Number
) -> Number:
    """The front after a step of Newton's method."""
    part, both = cut_at(body, front), [jnp.stack(pair) for pair in zip(*ends, strict=True)]

    def at_end(tension: Number, direction: Number) -> tuple[Number, Number]:  # `solve` knows sharp minima of turning
        value = solve(part, tension, direction=direction, nodes=nodes, throw=False).tip_tension[0]
        return value, _slope(part, jnp.asarray(part.length), value, direction)

    (value, other), (slope, other_slope) = jax.vmap(at_end)(*both)  # one program for both
    found = front - (value - other) / (slope - other_slope)
    length = jnp.asarray(body.length)
    return jnp.where(jnp.isfinite(found), jnp.clip(found, LEAST * length, length), front)


def _first_zero(cut: Elements, values: Float[Array, "P p"]) -> Number:
    """The first arc length, m, where polynomials that are positive at the base fall below zero; the tip if none."""
    starts, ends = cut.at_starts_and_ends(values)
    points = jnp.concatenate([starts[:, None], values, ends[:, None]], axis=1)
    below = (points < 0).ravel()
    first = jnp.argmax(below).astype(jnp.uint32)  # not read from the end
    element, within = first // points.shape[1], first % points.shape[1]
    place = cut.edges[element] + cut.width[element] * _zero_before(cut, points[element], within)
    return jnp.where(jnp.any(below) & jnp.isfinite(place), place, cut.edges[-1])


def _zero_before(cut: Elements, values: Float[Array, " q"], point: UInt[Array, ""]) -> Number:
    """The zero of the polynomial of one element between a point and the one before, by Newton's method, in [0, 1].

    Args:
        cut: the elements.
        values: at the start, the nodes and the end of the element.
        point: the start of the element, which is itself the zero, a node, or the end, counted from 0.
    """
    points, slopes = jnp.asarray(cut.rule.points, cut.edges.dtype), times(cut.rule.differentiation, values[1:-1])

    def nearer(place: Number) -> Number:
        weights = cut.lagrange(place)
        found = place - weights @ values[1:-1] / (weights @ slopes)
        return jnp.clip(found, points[jnp.maximum(point, 1) - 1], points[point])

    return newton(nearer, points[point] + zero_as(values), NARROWINGS)  # shard_map wants it to vary as the values do
