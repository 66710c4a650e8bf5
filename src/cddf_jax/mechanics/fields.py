"""What varies along the body: at one cross-section, and at many."""

from collections.abc import Callable
from typing import TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..errors import InputError
from ..numerics.rotations import as_matrix, in_fixed_frame, length_of
from ..robot.cross_section import CrossSection, SpatialSection, planar
from ..robot.manipulator import Manipulator
from . import bending, space
from .friction import PerTendon, tension_rate
from .geometry import PLANE
from .problem import State, guarded_section, strain_of, tension_of


class Fields(eqx.Module):
    """What varies along the body, at one or several arc lengths; per tendon first."""

    arc_length: Float[Array, "*points"]  # s, m
    curvature: Float[Array, "*points"]  # kappa, 1/m, positive towards +n
    heading: Float[Array, "*points"]  # phi, rad
    position: Float[Array, "*points 2"]  # u, m, in the fixed frame at the base
    tension: Float[Array, "tendons *points"]  # T, N; zero beyond the anchor of a tendon
    wrap_angle: Float[Array, "tendons *points"]  # theta, rad, counted from the base
    normal_force: Float[Array, "tendons *points 2"]  # F_CDDN on the body, N/m, fixed frame
    friction_force: Float[Array, "tendons *points 2"]  # F_CDDF on the body, N/m, fixed frame

    def bend(self) -> Float[Array, "*points"]:
        """The curvature, 1/m, with its sign."""
        return self.curvature

    def tilt(self) -> Float[Array, "*points"]:
        """The angle from the axis of the base to that of the cross-section, rad: the heading."""
        return self.heading


class SpatialFields(eqx.Module):
    """What varies along a body in space, at one or several arc lengths; per tendon first."""

    arc_length: Float[Array, "*points"]  # s, m
    # u - u*, 1/m: twist, and bending about y and z, in the frame of the cross-section
    curvature: Float[Array, "*points 3"]
    frame: Float[Array, "*points 3 3"]  # R, whose columns are the axes of the cross-section, x along the axis
    position: Float[Array, "*points 3"]  # m, in the fixed frame at the base
    tension: Float[Array, "tendons *points"]  # T, N; zero beyond the anchor of a tendon
    wrap_angle: Float[Array, "tendons *points"]  # theta, rad, counted from the base
    normal_force: Float[Array, "tendons *points 3"]  # T t' on the body, N/m, fixed frame
    friction_force: Float[Array, "tendons *points 3"]  # T' t on the body, N/m, fixed frame
    path: Float[Array, "tendons *points 3"]  # position of the tendon, m, fixed frame

    @property
    def twist(self) -> Float[Array, "*points"]:
        """The twist rate less that at rest, rad/m."""
        return self.curvature[..., 0]

    def bend(self) -> Float[Array, "*points"]:
        """The size of the curvature about y and z, 1/m."""
        return length_of(self.curvature[..., 1:])

    def tilt(self) -> Float[Array, "*points"]:
        """The angle between the axes of cross-section and base, rad, from 0 to pi."""
        return jnp.arctan2(length_of(self.frame[..., 1:, 0]), self.frame[..., 0, 0])


AnyFields: TypeAlias = Fields | SpatialFields
Varying = TypeVar("Varying", bound=AnyFields)


def in_the_plane(fields: AnyFields, caller: str) -> Fields:
    """The fields of a body in the plane.

    Args:
        fields: of any body.
        caller: its name, for the message.

    Raises:
        InputError: for those of a body in space.
    """
    if isinstance(fields, SpatialFields):
        raise InputError(f"{caller}: the body is in space; this works for bodies in the plane only")
    return fields


def fields_at(
    manipulator: Manipulator,
    base_tension: PerTendon,
    direction: PerTendon,
    arc_length: Float[Array, ""],
    state: Callable[[Float[Array, ""]], State],
) -> AnyFields:
    """The fields at one cross-section, tendons last.

    Args:
        manipulator: the body.
        base_tension: T_base, N.
        direction: of each tendon.
        arc_length: s, m.
        state: the integrated state at an arc length.
    """
    if manipulator.in_space:
        return _spatial_fields(manipulator, base_tension, direction, arc_length, state)
    section = planar(guarded_section(manipulator, arc_length))
    return planar_fields(section, base_tension, direction, arc_length, state(arc_length))


def planar_fields(
    section: CrossSection, base_tension: PerTendon, direction: PerTendon, arc_length: Float[Array, ""], state: State
) -> Fields:
    """The fields at one cross-section in the plane, tendons last."""
    tension = tension_of(section, base_tension, state.pull)
    kappa = bending.curvature(section, tension, state.moment, state.strain)
    moment_rate = PLANE.moment_rate(PLANE.axis(state.heading, kappa), state.force)
    rate = bending.rates(section, kappa, tension, direction, moment_rate)
    forces = bending.distributed_forces(section, state.heading, kappa, tension, direction, rate)
    return Fields(
        arc_length, kappa, state.heading, state.position, tension, state.wrap_angle, forces.normal, forces.friction
    )


def _spatial_fields(
    manipulator: Manipulator,
    base_tension: PerTendon,
    direction: PerTendon,
    arc_length: Float[Array, ""],
    state: Callable[[Float[Array, ""]], State],
) -> SpatialFields:
    def tangents(s: Float[Array, ""]) -> tuple[Array, tuple[SpatialSection, State, Array]]:
        section, here = guarded_section(manipulator, s), state(s)
        assert isinstance(section, SpatialSection)
        strain = strain_of(section, base_tension, here)
        return space.tangents(section, strain), (section, here, strain)

    tangent, rate, (section, here, strain) = jax.jvp(
        tangents, (arc_length,), (jnp.ones_like(arc_length),), has_aux=True
    )
    tension = tension_of(section, base_tension, here.pull)
    turn = space.turn_vectors(strain, tangent, rate)
    loss = tension_rate(direction, section, length_of(turn), tension)
    return SpatialFields(
        arc_length=arc_length,
        curvature=space.curvature_of_strain(strain - section.rest),
        frame=as_matrix(here.heading),
        position=here.position,
        tension=tension,
        wrap_angle=here.wrap_angle,
        normal_force=in_fixed_frame(here.heading, tension[:, None] * turn),
        friction_force=in_fixed_frame(here.heading, loss[:, None] * tangent),
        path=here.position + in_fixed_frame(here.heading, manipulator.arms(arc_length)),
    )


def tendons_first(fields: Varying, points_ndim: int) -> Varying:
    """Move the axis of the tendons before those of the points."""

    def per_tendon(fields):
        own = fields.tension, fields.wrap_angle, fields.normal_force, fields.friction_force
        return (*own, fields.path) if isinstance(fields, SpatialFields) else own

    return eqx.tree_at(per_tendon, fields, [jnp.moveaxis(x, points_ndim, 0) for x in per_tendon(fields)])
