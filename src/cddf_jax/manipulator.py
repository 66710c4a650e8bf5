"""The manipulator: a conical or free-form body, its tendons and its material, as one pytree."""

from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .profiles import Constant, Linear, Points, Profile, Scalar, as_number, as_profile, breakpoints

Kinematics = Literal["published", "exact"]
KINEMATICS = ("published", "exact")


def _as_optional_number(value: Any) -> Any:
    return None if value is None else as_number(value)


class Tendon(eqx.Module):
    """A tendon at the distance `offset` from the neutral axis, on side +1 or -1 of it.

    Args:
        offset: d(s) >= 0, profile or number, m.
        side: sigma, +1 or -1. A tendon with side +1 pulled alone bends the body towards +n.
        end: arc length at which it is anchored, m; None for the tip of the body.
        friction_coefficient: its own mu; None for the manipulator's.
        axial_stiffness: E A of the tendon, N; None for a tendon that does not stretch.
        free_length: of the tendon between body and actuator, m, which stretches as well.
        drag: its own w, N/m; None for the manipulator's.

    Raises:
        ValueError: when side is neither +1 nor -1.
    """

    offset: Profile = eqx.field(converter=as_profile)
    side: int = eqx.field(default=+1, static=True)
    end: Scalar | None = eqx.field(default=None, converter=_as_optional_number)
    friction_coefficient: Scalar | None = eqx.field(default=None, converter=_as_optional_number)
    axial_stiffness: Scalar | None = eqx.field(default=None, converter=_as_optional_number)
    free_length: Scalar = eqx.field(default=0.0, converter=as_number)
    drag: Scalar | None = eqx.field(default=None, converter=_as_optional_number)

    def __check_init__(self):
        if self.side not in (+1, -1):
            raise ValueError(f"Tendon: side must be +1 or -1, got {self.side!r}")


class CrossSection(eqx.Module):
    """What the mechanics needs to know at one arc length; primes are derivatives along s."""

    stiffness: Float[Array, ""]  # E J, N m^2
    stiffness_rate: Float[Array, ""]  # (E J)', N m
    offset: Float[Array, " tendons"]  # d, m
    offset_slope: Float[Array, " tendons"]  # d', -
    offset_bend: Float[Array, " tendons"]  # d'', 1/m
    side: Float[Array, " tendons"]  # sigma, +-1
    friction_coefficient: Float[Array, " tendons"]  # mu, -
    drag: Float[Array, " tendons"] | None  # w, N/m, zero beyond the anchor; None where no tendon has any
    present: Bool[Array, " tendons"]  # false beyond the anchor of a tendon
    kinematics: Kinematics = eqx.field(static=True)
    slanted: bool = eqx.field(static=True)  # false when every offset is Constant


class Manipulator(eqx.Module):
    """A tendon-driven continuum manipulator in the plane; SI units.

    Args:
        length: L of the neutral axis, m.
        outer_radius, inner_radius: of the annular section, profiles or numbers, m.
        tendons: one or several `Tendon`.
        youngs_modulus: E, Pa.
        friction_coefficient: mu between tendon and body, for every tendon without its own.
        density: rho, kg/m^3; it matters under gravity only.
        kinematics: "exact" follows the tendon itself, "published" takes the paper as written; see `mechanics`.
        drag: w >= 0, N/m, friction per length of the neutral axis that is there without tension and curvature, as
            of a sheath that squeezes the tendon: T' = -direction (mu |psi'| T + w). For every tendon without its
            own; None for none. A tendon is slack, T = 0, from where drag has used its tension up.
        yield_strain: above 0, a fraction: the largest bending strain of the wall from which the body comes back. A
            solve is remarked on where its `peak_strain` is larger; nothing else follows from it. None where unknown.

    Values are not checked here, as they may be traced: `validate` does that on the host.

    Raises:
        ValueError: for unknown kinematics or no tendon.
    """

    length: Scalar = eqx.field(converter=as_number)
    outer_radius: Profile = eqx.field(converter=as_profile)
    inner_radius: Profile = eqx.field(converter=as_profile)
    tendons: tuple[Tendon, ...] = eqx.field(converter=tuple)
    youngs_modulus: Scalar = eqx.field(converter=as_number)
    friction_coefficient: Scalar = eqx.field(converter=as_number)
    density: Scalar = eqx.field(default=0.0, converter=as_number)
    kinematics: Kinematics = eqx.field(default="exact", static=True)
    drag: Scalar | None = eqx.field(default=None, converter=_as_optional_number)
    yield_strain: Scalar | None = eqx.field(default=None, converter=_as_optional_number)

    def __check_init__(self):
        if self.kinematics not in KINEMATICS:
            raise ValueError(f"Manipulator: kinematics must be one of {KINEMATICS}, got {self.kinematics!r}")
        if not self.tendons or not all(isinstance(tendon, Tendon) for tendon in self.tendons):
            raise ValueError("Manipulator: tendons must hold one Tendon or more, e.g. (Tendon(offset=5e-3),)")

    def __str__(self) -> str:
        from .printing import manipulator_in_words

        return manipulator_in_words(self)

    @property
    def num_tendons(self) -> int:
        return len(self.tendons)

    @property
    def breakpoints(self) -> Float[Array, " n"]:
        """Arc lengths (m), unsorted, at which the body or a tendon is not smooth."""
        profiles = [self.outer_radius, self.inner_radius, *(tendon.offset for tendon in self.tendons)]
        ends = [jnp.asarray(tendon.end)[None] for tendon in self.tendons if tendon.end is not None]
        named = [points for points in (*map(breakpoints, profiles), *ends) if points.shape[0] > 0]
        return jnp.concatenate(named) if named else jnp.zeros_like(jnp.asarray(self.length), shape=0)

    @property
    def slanted(self) -> bool:
        """Whether any tendon may change its distance from the neutral axis."""
        return not all(isinstance(tendon.offset, Constant) for tendon in self.tendons)

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
    def tendon_free_length(self) -> Float[Array, " tendons"]:
        """The length of each tendon outside the body, m."""
        return jnp.stack([jnp.asarray(tendon.free_length) for tendon in self.tendons])

    def offset(self, arc_length: Points) -> Float[Array, "tendons *points"]:
        """The offset d of each tendon, m."""
        return jnp.stack([tendon.offset(arc_length) for tendon in self.tendons])

    def area(self, arc_length: Points) -> Float[Array, "*points"]:
        """A = pi (R_outer^2 - r_inner^2), m^2."""
        return jnp.pi * (self.outer_radius(arc_length) ** 2 - self.inner_radius(arc_length) ** 2)

    def second_moment(self, arc_length: Points) -> Float[Array, "*points"]:
        """J = pi/4 (R_outer^4 - r_inner^4), m^4. Liu et al. (2020), eq. (12)."""
        return jnp.pi / 4 * (self.outer_radius(arc_length) ** 4 - self.inner_radius(arc_length) ** 4)

    def bending_stiffness(self, arc_length: Points) -> Float[Array, "*points"]:
        """E J, N m^2."""
        return jnp.asarray(self.youngs_modulus) * self.second_moment(arc_length)

    def outer_strain(self, arc_length: Points, curvature: Points) -> Float[Array, "*points"]:
        """R_outer kappa, -: the bending strain of the outer surface, with the sign of the curvature (1/m)."""
        return self.outer_radius(arc_length) * curvature

    def cross_section(self, arc_length: Scalar) -> CrossSection:
        """Everything that the mechanics needs at one arc length."""
        s = jnp.asarray(arc_length)
        one = jnp.ones_like(s)

        def slope(profile, s):
            return jax.jvp(profile, (s,), (one,))[1]

        stiffness, stiffness_rate = jax.jvp(self.bending_stiffness, (s,), (one,))
        offset, offset_slope = jax.jvp(self.offset, (s,), (one,))
        reach = [jnp.inf if tendon.end is None else tendon.end for tendon in self.tendons]
        present, drag = jnp.stack([s <= jnp.asarray(end) for end in reach]), self.tendon_drag
        return CrossSection(
            stiffness=stiffness,
            stiffness_rate=stiffness_rate,
            offset=offset,
            offset_slope=offset_slope,
            offset_bend=slope(lambda s: slope(self.offset, s), s),
            side=jnp.asarray([tendon.side for tendon in self.tendons], s.dtype),
            friction_coefficient=self.tendon_friction,
            drag=None if drag is None else jnp.where(present, drag, 0.0),
            present=present,
            kinematics=self.kinematics,
            slanted=self.slanted,
        )

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


def conical(
    *,
    length: Any,
    outer_radius: Any,
    inner_radius: Any,
    tendon_offset: Any,
    youngs_modulus: Any,
    friction_coefficient: Any,
    density: Any = 0.0,
    num_tendons: int = 1,
    kinematics: Kinematics = "exact",
    drag: Any = None,
    yield_strain: Any = None,
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
        ValueError: for a number of tendons other than 1 or 2, or a dimension that is no number and no pair.
    """
    if num_tendons not in (1, 2):
        raise ValueError(
            f"conical: num_tendons must be 1 or 2, got {num_tendons!r}; pass tendons to Manipulator for more"
        )
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


def _taper(name: str, value: Any, length: Any) -> Constant | Linear:
    if isinstance(value, tuple | list):
        shape = (len(value), *np.shape(value[0])) if value else (0,)
    else:
        shape = np.shape(value)
    if shape not in ((), (2,)):
        raise ValueError(f"conical: {name} must be a number or a pair (base, tip), got shape {shape}")
    return Linear(value[0], value[1], length) if shape else Constant(value)
