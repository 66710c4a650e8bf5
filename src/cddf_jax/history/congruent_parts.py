"""A traced body composed of parts that are congruent to parts of equilibria.

From the base to the front of the last motion, the body is congruent to the equilibrium of that motion. From there to
the front of the motion before, it is congruent to the equilibrium of the motion before, and so on. So the rest of the
body beyond the front keeps its shape and is attached to the end of the new part; `Onward` holds what such a rest adds.
Each step needs two equilibria, both from the base to its front: its own, and that of the motion at whose end it turned.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..mechanics import bending
from ..mechanics.friction import PerTendon
from ..mechanics.problem import at_nodes, geometry_of, guarded_section, strain_along, tension_of
from ..numerics.arrays import cos_sin, zero_as
from ..numerics.rotations import length_of
from ..robot.cross_section import planar
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import Dense
from ..statics.solve import solve
from ..statics.status import Status, first_of
from .fronts import Motion, cut_at, front_of
from .turns import NO_STEP, Number, Turns

Heading = Float[Array, "*axes"]  # phi, rad, in the plane; in space R, whose columns are the axes, (3, 3)


class Onward(NamedTuple):
    """What a part of a body adds, in the frame at its start; every number is finite."""

    heading: Heading
    position: Float[Array, " components"]  # m
    pulled_in: Number  # m, of the tendon
    stored: Number  # energy in body and tendon, J
    given: Number  # energy that the tendon has given to the body or stored itself, J
    error: Number
    solved: Bool[Array, ""]
    status: Int[Array, ""]


class Slid(NamedTuple):
    """An equilibrium between the base and a front."""

    end: Number  # the front, s, m
    tension: Number  # there, N
    added: Onward


class Tip(NamedTuple):
    """A traced body at its tip."""

    tension: Number
    added: Onward  # from the base on


def slid_up_to(body: Manipulator, nodes: int, tension: Number, direction: Number, front: Number) -> Slid:
    """The equilibrium between the base and a front."""
    found = solve(cut_at(body, front), tension, direction=direction, nodes=nodes, throw=False)
    outside = jnp.sum(tension * body.tendon_outside_compliance)
    solved = found._dense.solved
    # the status compares the direction with the travel from rest, which does not matter here
    status = jnp.where(found.status == Status.direction_contradicted, Status.successful, found.status)
    added = Onward(
        found.tip_angle if found.tip_frame is None else found.tip_frame,
        found.tip_position,
        found.tendon_displacement[0] - outside,
        stored_energy(found._dense),
        given_energy(found._dense),
        found.error_estimate,
        solved,
        status,
    )
    # NaN of a solve that failed would spoil the derivatives of other steps
    tension, added = jax.tree.map(lambda x: jnp.where(solved, x, jnp.zeros_like(x)), (found.tip_tension[0], added))
    return Slid(front, tension, added._replace(status=status))


def ends_of_motion(body: Manipulator, nodes: int, motion: Motion, *, refined: bool = True) -> tuple[Number, Slid, Slid]:
    """The front of a motion, and two equilibria up to it: at the end of the motion, and at the turn where it began.

    Args:
        body: with one tendon.
        nodes: Gauss nodes in each smooth piece.
        motion: of the tendon; where it began at rest, the second equilibrium is the first one.
        refined: for the front, see `front_of`.
    """
    tension, direction, turned_at, from_rest = motion
    turned_at = jnp.where(from_rest, tension, turned_at)
    front = front_of(body, nodes, motion._replace(turned_at=turned_at), refined=refined)
    directions = jnp.stack([direction, jnp.where(from_rest, 1.0, -1.0) * direction])
    found = jax.vmap(partial(slid_up_to, body, nodes, front=front))(jnp.stack([tension, turned_at]), directions)
    own, other = (jax.tree.map(lambda x, i=i: x[i], found) for i in range(2))
    return front, own, other


def stored_energy(dense: Dense) -> Number:
    """The elastic energy of body and tendon in an equilibrium, J: the integral of E J kappa^2 / 2 + T^2 / (2 E A).

    In space the first term is the energy of all strains.
    """
    geometry = geometry_of(dense.manipulator)
    body, cut = dense.manipulator, dense.elements
    section = jax.vmap(jax.vmap(lambda s: guarded_section(body, s)))(cut.nodes)
    tension = tension_of(section, dense.base_tension, dense.states.nodes.pull)
    strain = strain_along(section, dense.base_tension, dense.states.nodes)
    slip = partial(at_nodes(geometry.slip_rate, (0, 0, 0, None)), section, strain, tension)
    stretch = tension * (slip(body.tendon_compliance) - slip(0.0 * body.tendon_compliance))
    elastic = section.stiffness * at_nodes(geometry.elastic, (0, 0))(section, strain) ** 2
    return jnp.sum(cut.gain(jnp.sum(elastic.reshape(*stretch.shape[:2], -1), axis=-1) + jnp.sum(stretch, axis=-1))) / 2


def given_energy(dense: Dense) -> Number:
    """The energy that a tendon has given to the body or stored itself, J: the integral of T over the length given way.

    In the exact kinematics it is the elastic energy. The published moment is not the derivative of that length.
    """
    body, cut = dense.manipulator, dense.elements
    if body.kinematics == "exact":
        return stored_energy(dense)
    section = planar(jax.vmap(jax.vmap(lambda s: guarded_section(body, s)))(cut.nodes))
    tension = tension_of(section, dense.base_tension, dense.states.nodes.pull)

    def shorter(tension: PerTendon) -> PerTendon:
        kappa = at_nodes(bending.curvature, (0, 0))(section, tension)
        return at_nodes(bending.slip_rate, (0, 0, 0, None))(section, kappa, tension, body.tendon_compliance)

    rule = cut.rule
    mean = jnp.tensordot(rule.weights, jax.vmap(lambda part: shorter(part * tension))(jnp.asarray(rule.nodes)), 1)
    return jnp.sum(cut.gain(jnp.sum(tension * (shorter(tension) - mean), axis=-1)))


def tips(body: Manipulator, own: Slid, other: Slid, turns: Turns) -> Tip:
    """The tip after each step.

    Args:
        body: of all steps.
        own: the equilibrium of each motion up to its front.
        other: that of the motion before it, up to the same front; unused where the motion began at rest.
        turns: the remembered turns after each step.
    """
    length = jnp.asarray(body.length)
    zero = zero_as((own, length))
    nothing = Onward(*pose_of_base(body, zero), zero, zero, zero, zero, zero == 0, first_of((zero > 1, Status.locked)))
    max_turns = turns.open.shape[1]
    slots = jnp.arange(max_turns)

    def add(stack: tuple[Slid, Onward, Float[Array, " turns"]], given: tuple[Slid, Slid, Turns]):
        own, other, turn = given
        end, onward, tip_tension = jax.tree.map(lambda x: x[jnp.maximum(turn.place - 1, 0)], stack)
        first = turn.before == NO_STEP
        between = _joined(_backwards(other.added), end.added)
        rest = jax.tree.map(partial(jnp.where, own.end < end.end), _joined(between, onward), onward)
        missed = jnp.abs(own.tension - other.tension) / jnp.where(other.tension > 0, other.tension, 1.0)
        rest = rest._replace(
            error=jnp.maximum(rest.error, jnp.where(own.end < length, missed, 0.0)),
            solved=rest.solved & end.added.solved,  # all equilibria that enter must be known
            status=_first_failure(rest.status, end.added.status),
        )
        rest = jax.tree.map(partial(jnp.where, first), nothing, rest)
        tension = jnp.where(first | (own.end >= length), own.tension, tip_tension)
        tip = _joined(own.added, rest)
        new = own, rest, tension
        here = slots == turn.place
        stack = jax.tree.map(lambda x, y: jnp.where(here.reshape(-1, *[1] * y.ndim), y, x), stack, new)
        status = jnp.where(turn.too_many, Status.too_many_turns, tip.status)
        return stack, Tip(tension, tip._replace(status=status, solved=tip.solved & ~turn.too_many))

    first = jax.tree.map(lambda x: jnp.zeros_like(x, shape=(max_turns, *x.shape[1:])), (own, own))
    empty = first[0], jax.tree.map(lambda x: jnp.broadcast_to(x, (max_turns, *x.shape)), nothing), first[0].end
    empty = jax.tree.map(lambda x: x + zero.astype(x.dtype) if x.dtype != bool else x, empty)
    return jax.lax.scan(add, empty, (own, other, turns))[1]


def _backwards(part: Onward) -> Onward:
    """From the end of a part to its start, in the frame of its end."""
    back = turned_back(part.heading)
    position, sums = -rotated(part.position, back), (-part.pulled_in, -part.stored, -part.given)
    return Onward(back, position, *sums, part.error, part.solved, part.status)


def _joined(here: Onward, further: Onward) -> Onward:
    return Onward(
        turned_on(here.heading, further.heading),
        here.position + rotated(further.position, here.heading),
        here.pulled_in + further.pulled_in,
        here.stored + further.stored,
        here.given + further.given,
        jnp.maximum(here.error, further.error),
        here.solved & further.solved,
        _first_failure(here.status, further.status),
    )


def _first_failure(one: Int[Array, ""], other: Int[Array, ""]) -> Int[Array, ""]:
    return jnp.where(one != Status.successful, one, other)


def pose_of_base(body: Manipulator, zero: Number) -> tuple[Heading, Float[Array, " components"]]:
    """Heading and position of the base, with precision and devices of `zero`."""
    if body.in_space:
        return jnp.eye(3, dtype=zero.dtype) + zero, jnp.zeros(3) + zero
    return zero, jnp.zeros(2) + zero


def turned_on(one: Heading, other: Heading) -> Heading:
    """The heading `other`, given in the frame of `one`, in the frame of the base."""
    return one + other if one.ndim == 0 else one @ other


def turned_back(heading: Heading) -> Heading:
    """The inverse of a heading."""
    return -heading if heading.ndim == 0 else heading.T


def tilt_of(heading: Heading) -> Number:
    """The tip angle, rad: phi in the plane, the angle between the axes of tip and base in space."""
    return heading if heading.ndim == 0 else jnp.arctan2(length_of(heading[1:, 0]), heading[0, 0])


def rotated(vector: Float[Array, "*points components"], heading: Heading) -> Float[Array, "*points components"]:
    """A vector, turned by a heading."""
    if heading.ndim > 0:
        return vector @ heading.T
    cosine, sine = cos_sin(heading)
    x, y = vector[..., 0], vector[..., 1]
    return jnp.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)
