"""The mechanics of one cross-section of a body in space: its strain, the tangents of its tendons, and their turning.

Frame: x along the axis, y and z across; tendon i lies at rho_i. Its unit tangent is t_i = w_i / |w_i| with
w_i = v + u x rho_i + rho_i'. Here u is the curvature, and v is the derivative of the position of the axis along s:
(1, 0, 0) unless the axis can stretch and shear. A tendon of tension T_i exerts the force -T_i t_i on the body outboard
of the cross-section. The strain is e = u, or e = (u, v) with stretch. It is the minimum of the convex energy

    1/2 (e - e*) K (e - e*) + sum T_i |w_i(e)| - M u - N v

where e* is the strain at rest, and M and N are moment and force of the loads in the frame of the cross-section.
Without friction this is the model of Rucker and Webster (2011), doi 10.1109/TRO.2011.2160469; in the plane it is the
law of `bending`.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics import tolerances as tol
from ..numerics.arrays import added_up
from ..numerics.fixed_point import newton, slope_along, solve_definite
from ..numerics.rotations import Vector, cross, dot, length_of
from ..robot.cross_section import SpatialSection, where_present
from .friction import PerTendon, tension_rate

Strain = Float[Array, " strains"]
Vectors = Float[Array, "tendons 3"]


class Wrench(NamedTuple):
    """Moment and force of the loads on a cross-section, in its frame."""

    moment: Vector  # N m
    force: Vector | None  # N; None where the axis can neither stretch nor shear


def strain(section: SpatialSection, tension: PerTendon, loads: Wrench | None, start: Strain | None = None) -> Strain:
    """The strain: the curvature u, 1/m; for an extensible axis u and v one after the other.

    Tendons parallel to the axis of a body without loads give a closed form. Elsewhere the strain is the root of an
    equation. From `start`, which is close to its elastic part, one step of Newton's method finds it; without `start`
    there are `tol.STRAIN_STEPS` steps.
    """
    if section.parallel and loads is None:  # no twist, and t = (1, 0, 0)
        moment = jnp.stack([0.0 * tension, -section.arm[:, 2] * tension, section.arm[:, 1] * tension], axis=-1)
        return added_up(moment) / section.stiffness
    return _strain_of_least_energy(section, tension, loads, start)


def curvature_of_strain(strain: Float[Array, "*points strains"]) -> Vector:
    """The curvature u, 1/m: twist, and bending about y and about z."""
    return strain[..., :3]


def path_rate(section: SpatialSection, strain: Strain) -> Vectors:
    """The derivative w of each tendon's position along s, in the frame of the cross-section."""
    w = cross(jnp.broadcast_to(curvature_of_strain(strain), section.arm.shape), section.arm) + section.ahead
    return w + strain[3:] if section.extensible else w


def tangents(section: SpatialSection, strain: Strain) -> Vectors:
    """The unit tangent t of each tendon in the frame of the cross-section."""
    return _pointing(section, strain)[0]


def _pointing(section: SpatialSection, strain: Strain) -> tuple[Vectors, PerTendon]:
    """The unit tangents, and the length |w| of each tendon per length of the axis."""
    w = path_rate(section, strain)
    size = length_of(w)
    return w / size[:, None], size


def turn_vectors(strain: Strain, tangent: Vectors, tangent_rate: Vectors) -> Vectors:
    """The derivative of each tangent along s, 1/m: t' + u x t, in components of the frame of the cross-section."""
    u = jnp.broadcast_to(curvature_of_strain(strain), tangent.shape)
    return tangent_rate + cross(u, tangent)


def tension_rate_without_loads(
    section_at: Callable[[Float[Array, ""]], SpatialSection],
    arc_length: Float[Array, ""],
    tension: PerTendon,
    direction: PerTendon,
) -> PerTendon:
    """T', N/m, of the sliding tendon of a body with one tendon and no loads, for a given arc length and tension.

    The strain follows from s and T alone, so t' = dt/ds + (dt/dT) T', and T' stands on both sides of the friction law.
    The difference of the two sides grows with T' while mu T |dt/dT| < 1, and is convex or concave. So Newton's method
    finds its root.
    """
    one = jnp.ones_like(arc_length)

    def pointing(s, tension):
        section = section_at(s)
        found = strain(section, tension, None)
        return tangents(section, found), (section, found)

    tangent, by_length, (section, found) = jax.jvp(lambda s: pointing(s, tension), (arc_length,), (one,), has_aux=True)
    by_tension = jax.jvp(lambda T: pointing(arc_length, T)[0], (tension,), (jnp.ones_like(tension),))[1]
    still = turn_vectors(found, tangent, by_length)

    def law(rate):
        turning = where_present(section, length_of(still + rate[:, None] * by_tension))
        return tension_rate(direction, section, turning, tension)

    def step(rate: PerTendon) -> PerTendon:
        value, slope = jax.jvp(law, (rate,), (jnp.ones_like(rate),))
        return rate - (rate - value) / (1.0 - slope)

    return newton(step, law(jnp.zeros_like(tension)), tol.STRAIN_STEPS)


def slip_rate_in_space(section: SpatialSection, strain: Strain, tension: PerTendon, compliance: PerTendon) -> PerTendon:
    """By how much a tendon's path shortens and the tendon stretches per arc length; see `slip_rate` for the plane."""
    straight, bent = path_rate(section, section.rest), path_rate(section, strain)
    length, now = length_of(straight), length_of(bent)
    shorter = dot(straight - bent, straight + bent) / (length + now)  # without cancellation
    return where_present(section, shorter) + tension * length * compliance


def _gradient(section: SpatialSection, tension: PerTendon, tangent: Vectors, loads: Wrench | None) -> Strain:
    """The derivative of the energy with respect to the strain, without the elastic part."""
    pull = added_up(tension[:, None] * _by_strain(section, tangent))
    if loads is None:
        return pull
    acting = loads.moment if loads.force is None else jnp.concatenate([loads.moment, loads.force])
    return pull - acting


@eqx.filter_custom_jvp
def _strain_of_least_energy(
    section: SpatialSection, tension: PerTendon, loads: Wrench | None, start: Strain | None
) -> Strain:
    def step(strain: Strain) -> Strain:
        pointing = _pointing(section, strain)
        stiffness = _tangent_stiffness(section, tension, *pointing)
        return strain - solve_definite(stiffness, _residual(section, tension, loads, strain, pointing[0]))

    if start is not None:
        return step(section.rest + start)
    at_rest = section.rest + 0.0 * _gradient(section, tension, section.ahead, loads)
    return newton(step, at_rest, tol.STRAIN_STEPS)


@_strain_of_least_energy.def_jvp
def _(primals, directions):
    section, tension, *_ = primals
    found = _strain_of_least_energy(*primals)

    def residual(given):
        section, tension, loads = given
        return _residual(section, tension, loads, found, tangents(section, found))

    stiffness = _tangent_stiffness(section, tension, *_pointing(section, found))
    return found, -solve_definite(stiffness, slope_along(residual, primals[:3], directions[:3]))


def _residual(
    section: SpatialSection, tension: PerTendon, loads: Wrench | None, strain: Strain, tangent: Vectors
) -> Strain:
    return section.stiffness * (strain - section.rest) + _gradient(section, tension, tangent, loads)


def _tangent_stiffness(
    section: SpatialSection, tension: PerTendon, tangent: Vectors, size: PerTendon
) -> Float[Array, "strains strains"]:
    """The second derivative of the energy: K + sum T / |w| (dw/de)^T (1 - t t^T) dw/de."""
    arm, along, eye = section.arm, _by_strain(section, tangent), jnp.eye(3, dtype=size.dtype)
    squares = dot(arm, arm)[:, None, None] * eye - arm[:, :, None] * arm[:, None]
    if section.extensible:
        turned = cross(*jnp.broadcast_arrays(eye, arm[:, None]))  # by row the change of w with a component of u
        stretched = jnp.concatenate([jnp.swapaxes(turned, 1, 2), jnp.broadcast_to(eye, turned.shape)], axis=2)
        squares = jnp.concatenate([jnp.concatenate([squares, turned], axis=2), stretched], axis=1)
    across = squares - along[:, :, None] * along[:, None]
    return jnp.diag(section.stiffness) + added_up((tension / size)[:, None, None] * across)


def _by_strain(section: SpatialSection, vectors: Vectors) -> Float[Array, "tendons strains"]:
    """The products of vectors with dw/de: their moments about the axis, and the vectors too where it can stretch."""
    moments = cross(section.arm, vectors)
    return jnp.concatenate([moments, vectors], axis=-1) if section.extensible else moments
