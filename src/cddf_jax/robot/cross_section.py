"""The properties of a cross-section that the mechanics needs, in the plane and in space."""

from typing import Literal, TypeAlias

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

Kinematics = Literal["published", "exact"]


class CrossSection(eqx.Module):
    """The properties of a cross-section at one arc length; primes are derivatives along s."""

    stiffness: Float[Array, ""]  # E J, N m^2
    stiffness_rate: Float[Array, ""]  # (E J)', N m
    offset: Float[Array, " tendons"]  # d, m
    offset_slope: Float[Array, " tendons"]  # d', -
    offset_bend: Float[Array, " tendons"]  # d'', 1/m
    side: Float[Array, " tendons"]  # sigma, +-1
    friction_coefficient: Float[Array, " tendons"]  # mu, -
    drag: Float[Array, " tendons"] | None  # w, N/m, zero beyond the anchor; None where no tendon has any
    present: Bool[Array, " tendons"] | None  # false beyond the anchor of a tendon; None where all go to the tip
    kinematics: Kinematics = eqx.field(static=True)
    slanted: bool = eqx.field(static=True)  # false when every offset is Constant


class SpatialSection(eqx.Module):
    """The properties of a cross-section of a body in space, whose frame has x along the axis; primes as above.

    The strain is the curvature u (3), and where the axis can stretch and shear also v (3). A tendon follows
    w = u x arm + ahead, per arc length, and + v where the axis can stretch.
    """

    stiffness: Float[Array, " strains"]  # torsion and bending twice, N m^2; axial and shear twice, N
    rest: Float[Array, " strains"]  # the strain without moment and force
    offset: Float[Array, " tendons"]  # d, m
    arm: Float[Array, "tendons 3"]  # rho, m
    ahead: Float[Array, "tendons 3"]  # rho', and + (1, 0, 0) where the axis cannot stretch
    friction_coefficient: Float[Array, " tendons"]  # mu, -
    drag: Float[Array, " tendons"] | None  # as above
    present: Bool[Array, " tendons"] | None  # as above
    parallel: bool = eqx.field(static=True)  # whether every tendon follows the axis while there is no twist

    @property
    def extensible(self) -> bool:
        """Whether the axis can stretch and shear; static."""
        return self.rest.shape[-1] > 3


AnySection: TypeAlias = CrossSection | SpatialSection


def where_present(section: AnySection, numbers: Array, beyond: float = 0.0) -> Array:
    """The numbers of the tendons, and another number in their place beyond the anchor of a tendon."""
    return numbers if section.present is None else jnp.where(section.present, numbers, beyond)


def planar(section: AnySection) -> CrossSection:
    """The section itself, which must be that of a body in the plane."""
    assert isinstance(section, CrossSection)
    return section


def spatial(section: AnySection) -> SpatialSection:
    """The section itself, which must be that of a body in space."""
    assert isinstance(section, SpatialSection)
    return section
