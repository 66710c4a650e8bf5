"""The manipulator: a conical or free-form body, its tendons and its material, as one pytree."""

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from ..errors import InputError
from ..numerics.arrays import cos_sin, words_or_shapes
from ..quantities import QUANTITIES, dimension_of
from ..units import shown
from .cross_section import CrossSection, Kinematics, SpatialSection
from .profiles import (
    Constant,
    Linear,
    Number,
    Points,
    Profile,
    ProfileLike,
    Scalar,
    as_number,
    as_optional_number,
    as_profile,
    breakpoints,
    profile_in_words,
)

KINEMATICS = ("published", "exact")
STRAINS = ("twist", "about y", "about z")  # parts of the curvature at rest, in words
STIFFNESSES = ("bending_stiffness", "torsional_stiffness", "axial_stiffness", "shear_stiffness")
Taper = ArrayLike | Sequence[ArrayLike]  # one number, or a pair (base, tip)


def _as_side(value: Any) -> int:
    if isinstance(value, bool) or value not in (+1, -1):
        raise ValueError(f"Tendon: side must be +1 or -1, got {value!r}")
    return int(value)


def _as_optional_profile(value: ProfileLike | None) -> Profile | None:
    return None if value is None else as_profile(value)


def _as_rest_curvature(value: Any) -> Any:
    if value is None:
        return None
    parts = tuple(value) if isinstance(value, list | tuple) or np.ndim(value) == 1 else ()
    if len(parts) != 3:
        raise ValueError(f"Manipulator: rest_curvature must have three components (twist, y, z), got {value!r}")
    return tuple(as_profile(part) for part in parts)


def _as_modulus(value: ProfileLike | None) -> Profile | Number | None:
    """A constant modulus stays a number, named "youngs_modulus"; a varying one is a profile."""
    return _as_optional_profile(value) if callable(value) else as_optional_number(value)


class Tendon(eqx.Module):
    """A tendon at the distance `offset` from the neutral axis: on side +1 or -1 of it, or at an angle around it.

    Args:
        offset: d(s) >= 0, profile or number, m.
        side: sigma, +1 or -1. A tendon with side +1, if it alone is pulled, bends the body towards +n.
        end: arc length at which it is anchored, m; None for the tip of the body.
        friction_coefficient: its own mu; None for the manipulator's.
        axial_stiffness: E A of the tendon, N; None for a tendon that does not stretch.
        free_length: length of the tendon between body and actuator, m, which stretches as well.
        outside_compliance: how far the tendon gives way between body and actuator, m/N, with all that it pulls on; None
            for free_length / axial_stiffness.
        outside_friction: mu times the angle by which a sheath or pulleys wrap the tendon between body and the part that
            gives way, -. On a pull the body gets the tension of the motor times exp(-outside_friction). None for none.
        outside_drag: the friction force there that does not depend on the tension, N. None for none.
        drag: its own w, N/m; None for the manipulator's.
        angle: around the axis, profile or number, rad, from y to z of the cross-section: a helix is `Linear`. None for
            a tendon in the plane, at 0 on side +1 and at pi on side -1. A body is in space where a tendon has an angle.

    Raises:
        ValueError: when side is neither +1 nor -1, or there is an angle and a side of -1.
    """

    offset: Profile = eqx.field(converter=as_profile)
    side: int = eqx.field(default=+1, static=True, converter=_as_side)
    end: Scalar | None = eqx.field(default=None, converter=as_optional_number)
    friction_coefficient: Scalar | None = eqx.field(default=None, converter=as_optional_number)
    axial_stiffness: Scalar | None = eqx.field(default=None, converter=as_optional_number)
    free_length: Scalar = eqx.field(default=0.0, converter=as_number)
    outside_compliance: Scalar | None = eqx.field(default=None, converter=as_optional_number)
    outside_friction: Scalar | None = eqx.field(default=None, converter=as_optional_number)
    outside_drag: Scalar | None = eqx.field(default=None, converter=as_optional_number)
    drag: Scalar | None = eqx.field(default=None, converter=as_optional_number)
    angle: Profile | None = eqx.field(default=None, converter=_as_optional_profile)

    def __check_init__(self):
        if self.side == -1 and self.angle is not None:
            raise ValueError("Tendon: side=-1 is the angle pi; give the angle alone")


class PointMass(eqx.Module):
    """A mass on the neutral axis, such as a disc, a camera or a magnet; under gravity it is a dead load.

    Args:
        arc_length: where it is fixed, s, m, above 0 and at most the length of the body.
        mass: kg.
    """

    arc_length: Scalar = eqx.field(converter=as_number)
    mass: Scalar = eqx.field(converter=as_number)


class Manipulator(eqx.Module):
    """A tendon-driven continuum manipulator in the plane or in space; SI units.

    It is in space where a tendon has an angle, where the axis is extensible or has a curvature at rest, or where its
    loads have three components; then it twists as well.

    Its bending stiffness is E J, from radii and modulus with J of eq. (12), or `bending_stiffness`. Its weight under
    gravity is that of density, `mass_per_length` and `point_masses` together.

    Args:
        length: L of the neutral axis, m.
        outer_radius, inner_radius: of the annular section, profiles or numbers, m. Both may be left out if
            bending_stiffness is given; if they are given too, they define the wall, its strain and the mass by density.
        tendons: one or several `Tendon`.
        youngs_modulus: E, Pa, a number, or a profile where it varies along the body.
        friction_coefficient: mu between tendon and body, for every tendon without its own.
        density: rho, kg/m^3, of the material between the radii; it matters under gravity only.
        kinematics: "exact" follows the tendon itself, "published" takes the paper as written.
        drag: w >= 0, N/m, friction per length of the neutral axis without tension and curvature, such as that of a
            sheath that squeezes the tendon: T' = -direction (mu |psi'| T + w). For every tendon without its own; None
            for none. Where drag has used up its tension, a tendon is slack, T = 0.
        friction_moment: N m, 0 or more, of friction inside the body, such as that of strands or of discs on a rod. The
            curvature stays as it is until it differs by more than friction_moment / (E J) from that of the body without
            it, and then follows at this distance. None for none. Only `trace` follows it.
        yield_strain: above 0, a fraction: the largest bending strain of the wall from which the body recovers. A solve
            with a larger `peak_strain` has a remark; it has no other effect. None if unknown.
        mass_per_length: kg/m, profile or number, besides density: many discs, a sleeve, cables.
        point_masses: one or several `PointMass`.
        bending_stiffness: E I, N m^2, profile or number, in place of the modulus.
        stiffness_factor: multiplies the stiffness, -; None for 1. A fit estimates it for a body without a single
            modulus.
        poissons_ratio: nu of the material, -; the shear modulus is E / (2 (1 + nu)). It matters in space. No material
            has more than 0.5. A fit may find more, for a body that is softer in torsion than its bending suggests.
        extensible: whether the axis stretches and shears.
        axial_factor, shear_factor: of an extensible body: they multiply its axial and its shear stiffness as well, -;
            None for 1. A fit can estimate them, if these stiffnesses do not follow from that of bending.
        rest_curvature: of the body in space without moment, 1/m: three profiles or numbers (twist, about y, about z).
        torsional_stiffness, axial_stiffness, shear_stiffness: N m^2, N, N, profiles or numbers, in place of those that
            follow from radii, modulus and Poisson's ratio. In space a body without radii needs the first, and if it is
            extensible all three.

    Values are not checked here, as they may be traced: `validate` does that on the host.

    Raises:
        ValueError: for unknown kinematics, no tendon, no friction coefficient, one radius without the other, and
            unless either modulus (with radii) or bending_stiffness is given; for a density without radii; in space for
            published kinematics, or a stiffness that neither is given nor follows from radii.
    """

    length: Scalar = eqx.field(converter=as_number)
    # None without a wall; `Any` in place of None, as almost every body has both radii
    outer_radius: Profile | Any = eqx.field(default=None, converter=_as_optional_profile)
    inner_radius: Profile | Any = eqx.field(default=None, converter=_as_optional_profile)
    tendons: tuple[Tendon, ...] = eqx.field(default=(), converter=tuple)
    youngs_modulus: Any = eqx.field(default=None, converter=_as_modulus)  # Scalar | Profile | None
    friction_coefficient: Scalar = eqx.field(default=None, converter=as_optional_number)
    density: Scalar = eqx.field(default=0.0, converter=as_number)
    kinematics: Kinematics = eqx.field(default="exact", static=True)
    drag: Scalar | None = eqx.field(default=None, converter=as_optional_number)
    yield_strain: Scalar | None = eqx.field(default=None, converter=as_optional_number)
    mass_per_length: Profile | None = eqx.field(default=None, converter=_as_optional_profile)
    point_masses: tuple[PointMass, ...] = eqx.field(default=(), converter=tuple)
    bending_stiffness: Profile | None = eqx.field(default=None, converter=_as_optional_profile)
    stiffness_factor: Scalar | None = eqx.field(default=None, converter=as_optional_number)
    poissons_ratio: Scalar = eqx.field(default=0.5, converter=as_number)
    extensible: bool = eqx.field(default=False, static=True)
    rest_curvature: tuple[Profile, Profile, Profile] | None = eqx.field(default=None, converter=_as_rest_curvature)
    torsional_stiffness: Profile | None = eqx.field(default=None, converter=_as_optional_profile)
    axial_stiffness: Profile | None = eqx.field(default=None, converter=_as_optional_profile)
    shear_stiffness: Profile | None = eqx.field(default=None, converter=_as_optional_profile)
    axial_factor: Scalar | None = eqx.field(default=None, converter=as_optional_number)
    shear_factor: Scalar | None = eqx.field(default=None, converter=as_optional_number)
    friction_moment: Scalar | None = eqx.field(default=None, converter=as_optional_number)

    def __check_init__(self):
        if self.kinematics not in KINEMATICS:
            raise ValueError(f"Manipulator: kinematics must be one of {KINEMATICS}, got {self.kinematics!r}")
        if not self.tendons or not all(isinstance(tendon, Tendon) for tendon in self.tendons):
            raise ValueError("Manipulator: tendons must hold one Tendon or more, e.g. (Tendon(offset=5e-3),)")
        if not all(isinstance(mass, PointMass) for mass in self.point_masses):
            example = "(PointMass(arc_length=0.1, mass=5e-3),)"
            raise ValueError(f"Manipulator: point_masses must hold PointMass, e.g. {example}")
        if self.friction_coefficient is None:
            raise ValueError("Manipulator: friction_coefficient is missing; give mu, 0 for none")
        self._check_stiffness()
        if self.in_space:
            self._check_space()

    def _check_space(self):
        if self.kinematics == "published":
            raise ValueError("Manipulator: the published kinematics are those of the plane; in space take 'exact'")
        needed = ("torsional_stiffness", *(("axial_stiffness", "shear_stiffness") if self.extensible else ()))
        missing = [name for name in needed if getattr(self, name) is None]
        if missing and not self.has_radii:
            raise ValueError(f"Manipulator: a body in space without radii needs {' and '.join(missing)}")

    def _check_stiffness(self):
        if (self.outer_radius is None) != (self.inner_radius is None):
            raise ValueError(
                "Manipulator: outer_radius and inner_radius belong together; give both (inner_radius=0 for a solid "
                "body), or neither with bending_stiffness"
            )
        if self.bending_stiffness is not None and self.youngs_modulus is not None:
            raise ValueError("Manipulator: youngs_modulus and bending_stiffness are both given; leave one of them out")
        if self.bending_stiffness is None and (self.youngs_modulus is None or self.outer_radius is None):
            raise ValueError(
                "Manipulator: give outer_radius, inner_radius and youngs_modulus, or bending_stiffness in their place"
            )
        if not self.has_radii and isinstance(self.density, np.ndarray) and np.any(self.density != 0):
            raise ValueError("Manipulator: density needs outer_radius and inner_radius; give mass_per_length instead")

    def __str__(self) -> str:
        return words_or_shapes(_in_words, self)

    @property
    def num_tendons(self) -> int:
        return len(self.tendons)

    @property
    def profiles(self) -> dict[str, Profile]:
        """The profiles of the body by name, such as "outer_radius" and "tendons.0.offset"."""
        found: dict[str, Any] = {name: getattr(self, name) for name in ("outer_radius", "inner_radius")}
        found |= {f"tendons.{i}.offset": tendon.offset for i, tendon in enumerate(self.tendons)}
        found |= {f"tendons.{i}.angle": tendon.angle for i, tendon in enumerate(self.tendons)}
        found |= {name: getattr(self, name) for name in ("youngs_modulus", *STIFFNESSES, "mass_per_length")}
        found |= {f"rest_curvature.{i}": part for i, part in enumerate(self.rest_curvature or ())}
        return {name: found[name] for name in found if callable(found[name])}

    @property
    def has_radii(self) -> bool:
        """Whether outer and inner radius are known."""
        return self.outer_radius is not None

    @property
    def stiffened_by_radii(self) -> bool:
        """Whether the bending stiffness, E J, follows from the radii, and is not given."""
        return self.bending_stiffness is None

    @property
    def has_mass(self) -> bool:
        """Whether gravity acts on the body; a density whose value is not known yet counts as a mass."""
        if self.mass_per_length is not None or self.point_masses or isinstance(self.density, Tracer):
            return True
        return bool(np.any(np.asarray(self.density)))

    @property
    def breakpoints(self) -> Float[Array, " n"]:
        """Arc lengths (m), unsorted, at which the body or a tendon is not smooth."""
        ends = [jnp.asarray(tendon.end)[None] for tendon in self.tendons if tendon.end is not None]
        places = [jnp.asarray(mass.arc_length)[None] for mass in self.point_masses]  # the last, see `problem`
        found = (*map(breakpoints, self.profiles.values()), *ends, *places)
        named = [points for points in found if points.shape[0] > 0]
        return jnp.concatenate(named) if named else jnp.zeros_like(jnp.asarray(self.length), shape=0)

    @property
    def in_space(self) -> bool:
        """Whether the body may leave the plane; static."""
        turned = any(tendon.angle is not None for tendon in self.tendons)
        return turned or self.extensible or self.rest_curvature is not None

    @property
    def components(self) -> int:
        """How many components its positions have: two in the plane, three in space; static."""
        return 3 if self.in_space else 2

    @property
    def slanted(self) -> bool:
        """Whether any tendon may change its distance from the neutral axis, or wind around it."""
        places = [place for tendon in self.tendons for place in (tendon.offset, tendon.angle) if place is not None]
        return not all(isinstance(place, Constant) for place in places)

    @property
    def parallel(self) -> bool:
        """Whether every tendon of a body in space follows the axis as long as nothing twists or stretches it."""
        return not self.slanted and not self.extensible and self.rest_curvature is None

    @property
    def tendon_friction(self) -> Float[Array, " tendons"]:
        """The friction coefficient mu of each tendon."""
        own = (tendon.friction_coefficient for tendon in self.tendons)
        return jnp.stack([jnp.asarray(self.friction_coefficient if mu is None else mu) for mu in own])

    @property
    def tendon_drag(self) -> Float[Array, " tendons"] | None:
        """The drag w of each tendon, N/m; None where no tendon has any."""
        drags = [self.drag if tendon.drag is None else tendon.drag for tendon in self.tendons]
        if all(drag is None for drag in drags):
            return None
        none = jnp.zeros_like(jnp.asarray(self.length))
        return jnp.stack([none if drag is None else jnp.asarray(drag) for drag in drags])

    @property
    def tendon_compliance(self) -> Float[Array, " tendons"]:
        """Strain per tension of each tendon, 1 / (E A), 1/N; zero for one that does not stretch."""
        stiffness = (tendon.axial_stiffness for tendon in self.tendons)
        rigid = jnp.zeros_like(jnp.asarray(self.length))
        return jnp.stack([rigid if EA is None else 1.0 / jnp.asarray(EA) for EA in stiffness])

    @property
    def tendon_outside_compliance(self) -> Float[Array, " tendons"]:
        """How far each tendon gives way between body and actuator, m/N."""
        own = (tendon.outside_compliance for tendon in self.tendons)
        stretching = [
            strain * jnp.asarray(t.free_length) for strain, t in zip(self.tendon_compliance, self.tendons, strict=True)
        ]
        return jnp.stack([free if C is None else jnp.asarray(C) for free, C in zip(stretching, own, strict=True)])

    @property
    def rubs_outside(self) -> bool:
        """Whether a tendon has friction between body and actuator; static."""
        return any(t.outside_friction is not None or t.outside_drag is not None for t in self.tendons)

    @property
    def has_memory(self) -> bool:
        """Whether there is friction besides that of tendons on the body, so that only `trace` follows it; static."""
        return self.friction_moment is not None or self.rubs_outside

    @property
    def has_tendons_alike(self) -> bool:
        """Whether all tendons state the same numbers, on one side, and profiles of one kind; static."""
        return len({jax.tree.structure(tendon) for tendon in self._ended_tendons}) == 1

    @property
    def _ended_tendons(self) -> "list[Tendon]":
        ends = [tendon.end is not None for tendon in self.tendons]
        return [replace(t, end=self.length) if any(ends) and t.end is None else t for t in self.tendons]

    def with_tendons(self, which: Int[np.ndarray | Array, " which"] | tuple[int, ...]) -> "Manipulator":
        """The same body with some of its tendons only; `which` counts from 0.

        It may be traced where the tendons are alike; a tuple is static.
        """
        if isinstance(which, tuple):
            return replace(self, tendons=tuple(self.tendons[i] for i in which))
        own, which = self._ended_tendons, jnp.asarray(which)
        every = jax.tree.map(lambda *x: jnp.stack([jnp.asarray(one) for one in x]), *own)
        return replace(self, tendons=tuple(jax.tree.map(lambda x, i=i: x[which[i]], every) for i in range(len(which))))

    def offset(self, arc_length: Points) -> Float[Array, "tendons *points"]:
        """The offset d of each tendon, m."""
        return jnp.stack([tendon.offset(arc_length) for tendon in self.tendons])

    def radii(self, arc_length: Points) -> tuple[Float[Array, "*points"], Float[Array, "*points"]]:
        """R_outer and r_inner, m.

        Raises:
            InputError: for a body without radii.
        """
        if self.outer_radius is None or self.inner_radius is None:
            raise InputError("the body has no radii; give it outer_radius and inner_radius")
        return self.outer_radius(arc_length), self.inner_radius(arc_length)

    def area(self, arc_length: Points) -> Float[Array, "*points"]:
        """A = pi (R_outer^2 - r_inner^2), m^2."""
        outer, inner = self.radii(arc_length)
        return jnp.pi * (outer**2 - inner**2)

    def second_moment(self, arc_length: Points) -> Float[Array, "*points"]:
        """J = pi/4 (R_outer^4 - r_inner^4), m^4. Liu et al. (2020), eq. (12)."""
        outer, inner = self.radii(arc_length)
        return jnp.pi / 4 * (outer**4 - inner**4)

    def stiffness(self, arc_length: Points) -> Float[Array, "*points"]:
        """The bending stiffness, N m^2: E J, or what is given in its place, times the stiffness factor."""
        if self.bending_stiffness is not None:
            found = self.bending_stiffness(arc_length)
        else:
            modulus = self.profiles.get("youngs_modulus")
            E = jnp.asarray(self.youngs_modulus) if modulus is None else modulus(arc_length)
            found = E * self.second_moment(arc_length)
        return found if self.stiffness_factor is None else jnp.asarray(self.stiffness_factor) * found

    def distributed_mass(self, arc_length: Points) -> Float[Array, "*points"]:
        """The mass of the body per length without its point masses, kg/m: rho A and mass_per_length together."""
        parts = [jnp.asarray(self.density) * self.area(arc_length)] if self.has_radii else []
        parts += [] if self.mass_per_length is None else [self.mass_per_length(arc_length)]
        return sum(parts[1:], parts[0]) if parts else jnp.zeros_like(jnp.asarray(arc_length))

    def outer_strain(self, arc_length: Points, curvature: Points) -> Float[Array, "*points"]:
        """R_outer kappa, -: the bending strain of the outer surface, with the sign of the curvature (1/m).

        NaN where the body has no radii.
        """
        if self.outer_radius is None:
            return jnp.full_like(jnp.asarray(curvature), jnp.nan)
        return self.outer_radius(arc_length) * curvature

    def arms(self, arc_length: Float[ArrayLike, ""]) -> Float[Array, "tendons 3"]:
        """The place rho of each tendon in the cross-section (x, y, z) at one arc length, m; x is along the axis."""
        offset, none = self.offset(arc_length), jnp.zeros_like(jnp.asarray(arc_length))
        sides = [none if tendon.side > 0 else none + jnp.pi for tendon in self.tendons]
        angles = [side if t.angle is None else t.angle(arc_length) for t, side in zip(self.tendons, sides, strict=True)]
        cosine, sine = cos_sin(jnp.stack(angles))
        return jnp.stack([jnp.zeros_like(offset), offset * cosine, offset * sine], axis=-1)

    def strain_stiffness(self, arc_length: Float[ArrayLike, ""]) -> Float[Array, " strains"]:
        """The stiffness in torsion and twice in bending, N m^2; if extensible, also axial and twice in shear, N."""
        bending, shear_modulus = self.stiffness(arc_length), 0.5 / (1.0 + jnp.asarray(self.poissons_ratio))  # G / E

        def given_or(given: Profile | None, otherwise: Callable[[], Array], factor: Scalar | None = None) -> Array:
            found = otherwise() if given is None else times(self.stiffness_factor, given(arc_length))
            return times(factor, found)

        def times(factor: Scalar | None, found: Array) -> Array:
            return found if factor is None else jnp.asarray(factor) * found

        torsion = given_or(self.torsional_stiffness, lambda: 2.0 * shear_modulus * bending)
        parts = [torsion, bending, bending]
        if self.extensible:

            def stretching() -> Array:  # E A
                return bending * self.area(arc_length) / self.second_moment(arc_length)

            shear = given_or(self.shear_stiffness, lambda: shear_modulus * stretching(), self.shear_factor)
            parts += [given_or(self.axial_stiffness, stretching, self.axial_factor), shear, shear]
        return jnp.stack(parts)

    def cross_section_in_space(self, arc_length: Float[ArrayLike, ""]) -> SpatialSection:
        """Everything that the mechanics needs at one arc length of a body in space."""
        s = jnp.asarray(arc_length)
        arm, ahead = jax.jvp(self.arms, (s,), (jnp.ones_like(s),))
        rest, axis = jnp.zeros(3, s.dtype), jnp.eye(3, dtype=s.dtype)[0]
        if self.rest_curvature is not None:
            rest = jnp.stack([part(s) for part in self.rest_curvature])
        if self.extensible:
            rest = jnp.concatenate([rest, axis])
        present = self._present(s)
        return SpatialSection(
            stiffness=self.strain_stiffness(s),
            rest=rest,
            offset=self.offset(s),
            arm=arm,
            ahead=ahead if self.extensible else ahead + axis,
            friction_coefficient=self.tendon_friction,
            drag=self._drag_where(present),
            present=present,
            parallel=self.parallel,
        )

    def cross_section(self, arc_length: Float[ArrayLike, ""]) -> CrossSection:
        """Everything that the mechanics needs at one arc length of a body in the plane."""
        s = jnp.asarray(arc_length)
        one = jnp.ones_like(s)
        stiffness, stiffness_rate = jax.jvp(self.stiffness, (s,), (one,))
        offset_and_slope = jax.jvp(lambda s: jax.jvp(self.offset, (s,), (one,)), (s,), (one,))
        (offset, offset_slope), (_, offset_bend) = offset_and_slope
        present = self._present(s)
        return CrossSection(
            stiffness=stiffness,
            stiffness_rate=stiffness_rate,
            offset=offset,
            offset_slope=offset_slope,
            offset_bend=offset_bend,
            side=jnp.asarray([tendon.side for tendon in self.tendons], s.dtype),
            friction_coefficient=self.tendon_friction,
            drag=self._drag_where(present),
            present=present,
            kinematics=self.kinematics,
            slanted=self.slanted,
        )

    def _present(self, arc_length: Float[Array, ""]) -> Bool[Array, " tendons"] | None:
        """Whether each tendon reaches an arc length; None where all go to the tip."""
        if all(tendon.end is None for tendon in self.tendons):
            return None
        reach = [jnp.inf if tendon.end is None else tendon.end for tendon in self.tendons]
        return jnp.stack([arc_length <= jnp.asarray(end) for end in reach])

    def _drag_where(self, present: Bool[Array, " tendons"] | None) -> Float[Array, " tendons"] | None:
        """The drag of each tendon, N/m, zero where it is not present; None where no tendon has any."""
        drag = self.tendon_drag
        return drag if drag is None or present is None else jnp.where(present, drag, 0.0)

    def with_angles(self) -> "Manipulator":
        """The same body in space: all tendons have an angle, 0 and pi in the place of the sides +1 and -1."""
        if all(tendon.angle is not None for tendon in self.tendons):
            return self
        angles = {+1: 0.0, -1: np.pi}
        tendons = [t if t.angle is not None else replace(t, side=1, angle=angles[t.side]) for t in self.tendons]
        return replace(self, tendons=tuple(tendons))

    def validate(self, *, offsets_outside_wall: bool = False) -> "Manipulator":
        """Check on the host that the numbers describe a body; return the manipulator itself.

        Args:
            offsets_outside_wall: allow tendons in the bore or outside the body (on spacer disks, say).

        Raises:
            ValueError: names the quantity, the arc length, the value and the remedy.
            TypeError: when a number is traced; validate before `jit`, `grad` or `vmap`.
        """
        from .validation import check_manipulator

        check_manipulator(self, offsets_outside_wall)
        return self


in_space = Manipulator.with_angles  # as the solver calls it


def conical(
    *,
    length: ArrayLike,
    outer_radius: Taper,
    inner_radius: Taper,
    tendon_offset: Taper,
    youngs_modulus: ProfileLike,
    friction_coefficient: ArrayLike,
    density: ArrayLike = 0.0,
    num_tendons: int = 1,
    kinematics: Kinematics = "exact",
    drag: ArrayLike | None = None,
    yield_strain: ArrayLike | None = None,
) -> Manipulator:
    """The conical manipulator of Liu et al. (2020), section II: every dimension tapers linearly.

    Args:
        length: L, m.
        outer_radius, inner_radius, tendon_offset: a pair (base, tip) or one number, m.
        youngs_modulus: E, Pa.
        friction_coefficient: mu.
        density: kg/m^3.
        num_tendons: 1 (side +1) or 2 (sides +1 and -1).
        kinematics: "exact" or "published".
        drag: w, N/m; None for none.
        yield_strain: a fraction; None where unknown.

    Raises:
        ValueError: for a number of tendons other than 1 or 2, or a dimension that is neither a number nor a pair.
    """
    if num_tendons not in (1, 2):
        remedy = "pass tendons to Manipulator for more"
        raise ValueError(f"conical: num_tendons must be 1 or 2, got {num_tendons!r}; {remedy}")
    offset = _taper("tendon_offset", tendon_offset, length)
    return Manipulator(
        length=length,
        outer_radius=_taper("outer_radius", outer_radius, length),
        inner_radius=_taper("inner_radius", inner_radius, length),
        tendons=tuple(Tendon(offset, side) for side in (+1, -1)[:num_tendons]),
        youngs_modulus=youngs_modulus,
        friction_coefficient=friction_coefficient,
        density=density,
        kinematics=kinematics,
        drag=drag,
        yield_strain=yield_strain,
    )


def _taper(name: str, value: Any, length: ArrayLike) -> Constant | Linear:
    pair = isinstance(value, tuple | list)  # whose numbers may be traced
    shape = (len(value), *(np.shape(value[0]) if value else ())) if pair else np.shape(value)
    if shape not in ((), (2,)):
        raise ValueError(f"conical: {name} must be a number or a pair (base, tip), got shape {shape}")
    return Linear(value[0], value[1], length) if shape else Constant(value)


# --- what `print` shows --------------------------------------------------------------------------

_BESIDE = ("length", "offset", "angle", "rest_curvature")  # have words of their own


def _in_words(manipulator: Manipulator) -> str:
    """Dimensions, material and tendons of one body whose numbers are known.

    Raises:
        TypeError: for a batch or traced numbers.
    """
    length, kind = float(manipulator.length), f"{manipulator.kinematics} kinematics"
    if manipulator.in_space:
        kind = "in space, its axis stretches and shears" if manipulator.extensible else "in space"
    lines = [f"Manipulator of {shown(length, 'length')}, {kind}", *_told(manipulator, length)]
    for name, part in zip(STRAINS, manipulator.rest_curvature or (), strict=False):
        lines.append(f"rest_curvature {name} {profile_in_words(part, length, 'curvature')}")
    for i, point in enumerate(manipulator.point_masses, 1):
        lines.append(f"point mass {i}: {shown(point.mass, 'mass')} at s = {shown(point.arc_length, 'length')}")
    for i, tendon in enumerate(manipulator.tendons, 1):
        end, side = length if tendon.end is None else float(tendon.end), f"side {tendon.side:+d}"
        place = side if tendon.angle is None else f"angle {profile_in_words(tendon.angle, end, 'angle')}"
        told = [f"offset {profile_in_words(tendon.offset, end)}", place, *_told(tendon, end)]
        lines.append(f"tendon {i}: {', '.join(told)}")
    return "\n".join(lines)


def _told(owner: Manipulator | Tendon, length: float) -> list[str]:
    """What is given, in the order of the fields; a number that is 0 is left out, except for friction."""
    told = []
    for name in (field.name for field in fields(owner)):
        value: Any = getattr(owner, name)
        if name not in QUANTITIES or name in _BESIDE or value is None:
            continue
        if not isinstance(value, jax.Array | np.ndarray):
            told.append(f"{name} {profile_in_words(value, length, dimension_of(name))}")
        elif value or name == "friction_coefficient":
            told.append(f"{name} {shown(value, dimension_of(name))}")
    return told
