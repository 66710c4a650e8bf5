"""A traced body composed of parts that are congruent to parts of equilibria.

From the base to the front of the last motion, the body is congruent to the equilibrium of that motion. From there to
the front of the motion before, it is congruent to the equilibrium of the motion before, and so on. So the rest of the
body beyond the front keeps its shape and is attached to the end of the new part; `Onward` holds what such a rest adds.
Each step needs two equilibria, both from the base to its front: its own, and that of the motion at whose end it turned.
"""

from functools import partial
from typing import NamedTuple, TypeVar

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
from .fronts import Motion, cut_at, front_of, is_held
from .history import stored_per_length
from .turns import Number

Tree = TypeVar("Tree")
Heading = Float[Array, "*axes"]  # phi, rad, in the plane; in space R, whose columns are the axes, (3, 3)


class Onward(NamedTuple):
    """What a part of a body adds, in the frame at its start; every number is finite."""

    heading: Heading
    position: Float[Array, " components"]  # m
    pulled_in: Number  # m, of the tendon
    stored: Number  # energy in body and tendon, J
    error: Number
    solved: Bool[Array, ""]
    status: Int[Array, ""]


class Slid(NamedTuple):
    """An equilibrium between the base and a front."""

    end: Number  # the front, s, m
    tension: Number  # there, N
    given: Number  # energy that the tendon has given to the body or stored itself, J
    added: Onward


class Composed(NamedTuple):
    """A traced body after a motion."""

    base_tension: Number  # N
    slid: Slid  # from the base to the front
    rest: Onward  # from there to the tip
    tip_tension: Number  # N

    @property
    def whole(self) -> Onward:
        """From the base on."""
        return _joined(self.slid.added, self.rest)


def slid_up_to(body: Manipulator, nodes: int, tension: Number, direction: Number, front: Number) -> Slid:
    """The equilibrium between the base and a front."""
    found = solve(cut_at(body, front), tension, direction=direction, nodes=nodes, throw=False)
    stretch = jnp.sum(tension**2 * body.tendon_outside_compliance) / 2  # J, of the tendon outside the body
    solved = found._dense.solved
    # the status compares the direction with the travel from rest, which does not matter here
    status = jnp.where(found.status == Status.direction_contradicted, Status.successful, found.status)
    added = Onward(
        found.tip_angle if found.tip_frame is None else found.tip_frame,
        found.tip_position,
        found.tendon_displacement[0],
        stored_energy(found._dense) + stretch,
        found.error_estimate,
        solved,
        status,
    )
    # NaN of a solve that failed would spoil the derivatives of other steps
    numbers = found.tip_tension[0], given_energy(found._dense) + stretch, added
    tension, given, added = jax.tree.map(lambda x: jnp.where(solved, x, jnp.zeros_like(x)), numbers)
    return Slid(front, tension, given, added._replace(status=status))


def ends_of_motion(body: Manipulator, nodes: int, motion: Motion, *, refined: bool = True) -> tuple[Slid, Slid]:
    """Two equilibria up to the front of a motion: at the end of the motion, and at the turn where it began.

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
    return own, other


def stored_energy(dense: Dense) -> Number:
    """The elastic energy of body and tendon in an equilibrium, J: the integral of E J kappa^2 / 2 + T^2 / (2 E A).

    In space the first term is the energy of all strains.
    """
    geometry = geometry_of(dense.manipulator)
    body, cut = dense.manipulator, dense.elements
    section = jax.vmap(jax.vmap(lambda s: guarded_section(body, s)))(cut.nodes)
    tension = tension_of(section, dense.base_tension, dense.states.nodes.pull)
    strain = strain_along(section, dense.base_tension, dense.states.nodes)
    per_length = at_nodes(partial(stored_per_length, geometry), (0, 0, 0, None))
    return jnp.sum(cut.gain(per_length(section, strain, tension, body.tendon_compliance)))


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


def composed(body: Manipulator, below: Composed, motion: Motion, own: Slid, other: Slid) -> Composed:
    """The body after a motion.

    Args:
        body: with one tendon.
        below: the body at the turn where the motion began; unused where it began at rest.
        motion: of the tendon.
        own, other: the equilibria of the motion and of the motion before it up to its front, see `ends_of_motion`.
    """
    length = jnp.asarray(body.length)
    rest = _joined(_backwards(other.added), below.whole)
    missed = jnp.abs(own.tension - other.tension) / jnp.where(other.tension > 0, other.tension, 1.0)
    missed = jnp.where(is_held(body, own.end), 0.0, missed)
    rest = rest._replace(error=jnp.where(own.end < length, jnp.maximum(rest.error, missed), 0.0))
    rest = jax.tree.map(partial(jnp.where, motion.from_rest), _nothing(body, zero_as(own)), rest)
    tension = jnp.where(motion.from_rest | (own.end >= length), own.tension, below.tip_tension)
    return Composed(motion.tension, own, rest, tension)


def unknown(body: Manipulator, zero: Number, count: int) -> Composed:
    """Bodies of which nothing is known, with the precision and the devices of `zero`."""
    nothing = _nothing(body, zero)
    one = Composed(zero, Slid(zero, zero, zero, nothing), nothing, zero)
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (count, *x.shape)), one)


def put(values: Tree, place: Int[Array, ""], value: Tree) -> Tree:
    """The values, whose first axis is that of places, with another one at one place."""

    def one(old: Array, new: Array) -> Array:
        here = jnp.arange(old.shape[0]) == place
        return jnp.where(here.reshape(-1, *[1] * new.ndim), new, old)

    return jax.tree.map(one, values, value)


def at_place(values: Tree, place: Int[Array, ""] | int) -> Tree:
    """The value at one place; the first one where the place is below 0."""
    return jax.tree.map(lambda x: x[jnp.maximum(place, 0)], values)


def _nothing(body: Manipulator, zero: Number) -> Onward:
    return Onward(*pose_of_base(body, zero), zero, zero, zero, zero == 0, first_of((zero > 1, Status.locked)))


def _backwards(part: Onward) -> Onward:
    """From the end of a part to its start, in the frame of its end."""
    back = turned_back(part.heading)
    position = -rotated(part.position, back)
    return Onward(back, position, -part.pulled_in, -part.stored, part.error, part.solved, part.status)


def _joined(here: Onward, further: Onward) -> Onward:
    return Onward(
        turned_on(here.heading, further.heading),
        here.position + rotated(further.position, here.heading),
        here.pulled_in + further.pulled_in,
        here.stored + further.stored,
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
