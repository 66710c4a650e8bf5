"""The mechanics of one cross-section: where its tendons point, how they turn, how the body bends.

Frame: t along the neutral axis, n to its left; tendon i lies at sigma_i d_i n. A tendon with
tension T_i exerts the force -T_i t_ci on the body outboard of the cross-section. Everything here
follows from that one vector. The two kinematics differ in two things only: the length of t_ci, and
the rate at which a tendon turns. "published" takes both from Liu et al. (2020) as written. "exact"
normalises t_ci and takes the turning of the tendon itself.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics import tolerances as tol
from ..numerics.arrays import added_up
from ..numerics.fixed_point import newton, slope_along
from ..robot.cross_section import CrossSection, where_present
from .friction import PerTendon, bending_loss, drag_loss, tension_rate

Number = Float[Array, ""]


class Tangent(NamedTuple):
    """t_ci in the frame (t, n) of the cross-section, and its derivatives at fixed s or fixed kappa."""

    along: PerTendon  # t_ci . t
    across: PerTendon  # t_ci . n
    along_rate: PerTendon  # d(along)/ds at fixed kappa, 1/m
    along_slope: PerTendon  # d(along)/dkappa at fixed s, m
    turning: PerTendon  # psi' less the term with kappa', rad/m
    turning_slope: PerTendon  # the factor of kappa' in psi', m


def arm_ratio(section: CrossSection, curvature: Number) -> PerTendon:
    """The ratio q = 1 - sigma d kappa: length of the fibre through the tendon per length of the neutral axis."""
    return 1.0 - section.side * section.offset * curvature


def tangent(section: CrossSection, curvature: Number) -> Tangent:
    """t_ci = (q t + sigma d' n), eq. (3), divided by its length in the exact kinematics."""
    side, d, d1, d2 = section.side, section.offset, section.offset_slope, section.offset_bend
    if section.kinematics == "exact" and not section.slanted:
        still = jnp.zeros_like(d)
        return Tangent(jnp.ones_like(d), still, still, still, curvature + still, still)
    q = arm_ratio(section, curvature)
    if section.kinematics == "published":
        # eq. (3) and (8): t_c = du_c/ds, theta' = |kappa_c| with kappa_c = kappa / q
        return Tangent(q, side * d1, -side * d1 * curvature, -side * d, curvature / q, jnp.zeros_like(q))
    # psi = phi + alpha, alpha = atan2(sigma d', q), psi' = kappa + dalpha/ds + dalpha/dkappa kappa'
    length = jnp.sqrt(q**2 + d1**2)
    cos, sin = q / length, side * d1 / length
    alpha_rate = (side * d2 * q + d1**2 * curvature) / length**2
    alpha_slope = d * d1 / length**2
    return Tangent(cos, sin, -sin * alpha_rate, -sin * alpha_slope, curvature + alpha_rate, alpha_slope)


def tangent_angle(section: CrossSection, curvature: Number) -> PerTendon:
    """The angle alpha from t to t_ci in the exact kinematics, rad. At a kink the tendon turns by the jump of alpha."""
    return jnp.arctan2(section.side * section.offset_slope, arm_ratio(section, curvature))


def turning_in_bend(section: CrossSection, curvature: Number) -> PerTendon:
    """Psi' where alpha does not change, 1/m; in the published kinematics kappa_c = kappa / q, which is all."""
    if section.kinematics == "published":
        return curvature / arm_ratio(section, curvature)
    return curvature + jnp.zeros_like(section.offset)


def curvature(
    section: CrossSection, tension: PerTendon, external_moment: float | Number = 0.0, start: Number | None = None
) -> Number:
    """kappa, 1/m, from E J kappa = sum sigma d T (t_c . t) + M_ext.

    This is eq. (13) of Liu et al. (2020) integrated by parts; with T and d constant along s its
    published form is the integral of eq. (17). External loads add M_ext. With slanted tendons kappa is the root of an
    equation: from a `start` close to it, one step of Newton's method finds it.
    """
    arm = section.side * section.offset
    pull = added_up(arm * tension) + external_moment
    if section.kinematics == "published":
        return pull / (section.stiffness + added_up(tension * section.offset**2))
    if not section.slanted:
        return pull * (1.0 / section.stiffness)  # 1 / E J is the same in every pass
    return _slanted_curvature(section, tension, external_moment, start)


@eqx.filter_custom_jvp
def _slanted_curvature(
    section: CrossSection, tension: PerTendon, external_moment: float | Number, start: Number | None
) -> Number:
    """The root of `_moment_gap`, by Newton's method. The gap grows with kappa, so the start may be rough."""

    def step(kappa: Number) -> Number:
        value, slope = _gap_and_slope((section, tension, external_moment), kappa)
        return kappa - value / slope

    if start is not None:
        return step(start)
    pull = added_up(section.side * section.offset * tension) + external_moment
    return newton(step, pull / section.stiffness, tol.CURVATURE_STEPS)


@_slanted_curvature.def_jvp
def _(primals, tangents):
    kappa, given = _slanted_curvature(*primals), primals[:3]
    pushed = slope_along(lambda given: _moment_gap(given, kappa), given, tangents[:3])
    return kappa, -pushed / _gap_and_slope(given, kappa)[1]


def _moment_gap(given: tuple[CrossSection, PerTendon, float | Number], kappa: Number) -> Number:
    """E J kappa less the moments of the tendons and M_ext, N m: zero in equilibrium."""
    section, tension, external_moment = given
    arm = section.side * section.offset * tension
    return section.stiffness * kappa - added_up(arm * tangent(section, kappa).along) - external_moment


def _gap_and_slope(given: tuple[CrossSection, PerTendon, float | Number], kappa: Number) -> tuple[Number, Number]:
    return jax.jvp(partial(_moment_gap, given), (kappa,), (jnp.ones_like(kappa),))


class Rates(NamedTuple):
    """Derivatives along s at one cross-section."""

    curvature: Number  # kappa', 1/m^2
    turning: PerTendon  # psi' of each tendon, signed, rad/m (published: kappa_c)


def rates(
    section: CrossSection,
    curvature: Number,
    tension: PerTendon,
    direction: PerTendon,
    external_moment_rate: float | Number = 0.0,
    sign: PerTendon | None = None,
) -> Rates:
    """The rates kappa' and psi' from the derivative of the equilibrium along s, with the T' of `tension_rate`.

    In the exact kinematics psi' of a slanted tendon contains kappa', which contains T'. The
    equation is linear once the signs of psi' are known. Unless they are given, the first are those without friction.
    """
    t = tangent(section, curvature)
    arm = section.side * section.offset
    pull_rate = section.side * section.offset_slope * t.along + arm * t.along_rate
    force = added_up(tension * pull_rate) - section.stiffness_rate * curvature + external_moment_rate
    dragged = drag_loss(direction, section, tension)
    if dragged is not None:
        force = force - added_up(arm * t.along * dragged)
    stiffness = section.stiffness - added_up(arm * tension * t.along_slope)

    def with_signs(sign: PerTendon) -> Rates:
        friction = bending_loss(direction, section, tension) * sign * arm * t.along
        kappa_rate = (force - added_up(friction * t.turning)) / (stiffness + added_up(friction * t.turning_slope))
        return Rates(kappa_rate, t.turning + t.turning_slope * kappa_rate)

    if _turns_with_the_body(section):
        found = jnp.sign(t.turning)
    else:
        frictionless = with_signs(jnp.zeros_like(t.turning))
        found = jnp.sign(with_signs(jnp.sign(frictionless.turning)).turning)
    return with_signs(found if sign is None else jnp.where(sign == 0, found, sign))


def turning(
    section: CrossSection,
    curvature: Number,
    tension: PerTendon,
    direction: PerTendon,
    external_moment_rate: float | Number = 0.0,
    sign: PerTendon | None = None,
) -> PerTendon:
    """The rate psi' of each tendon, rad/m, which friction needs; zero beyond its anchor.

    It does not compute kappa' where psi' does not depend on it.
    """
    if _turns_with_the_body(section):
        rate = tangent(section, curvature).turning
    else:
        rate = rates(section, curvature, tension, direction, external_moment_rate, sign).turning
    return where_present(section, rate)


def _turns_with_the_body(section: CrossSection) -> bool:
    """Whether psi' does not depend on kappa'; static."""
    return section.kinematics == "published" or not section.slanted


class Forces(NamedTuple):
    """The force of each tendon on the body per length of the neutral axis, in the fixed frame, N/m."""

    normal: Float[Array, "tendons 2"]
    friction: Float[Array, "tendons 2"]


def distributed_forces(
    section: CrossSection, heading: Number, curvature: Number, tension: PerTendon, direction: PerTendon, rate: Rates
) -> Forces:
    """F_CDDN = T t_c' and F_CDDF = T' t_c, together the derivative of T t_c.

    Liu et al. (2020), eq. (9) and the second line of eq. (10). The first line of eq. (10), mu |F_CDDN|, is
    another force; only the second line satisfies the balance of eq. (13).
    """
    t = tangent(section, curvature)
    axis = jnp.stack([jnp.cos(heading), jnp.sin(heading)])
    left = jnp.stack([-axis[1], axis[0]])
    along_rate = t.along_rate + t.along_slope * rate.curvature
    if section.kinematics == "published":
        across_rate = section.side * section.offset_bend
        turn = jnp.broadcast_to(curvature, along_rate.shape)
        along_rate, across_rate = along_rate - t.across * turn, across_rate + t.along * turn
    else:
        along_rate, across_rate = -t.across * rate.turning, t.along * rate.turning
    loss_rate = tension_rate(direction, section, rate.turning, tension)

    def in_fixed_frame(along, across):
        return along[:, None] * axis + across[:, None] * left

    return Forces(
        normal=in_fixed_frame(tension * along_rate, tension * across_rate),
        friction=in_fixed_frame(loss_rate * t.along, loss_rate * t.across),
    )


# --- how far a tendon slides ----------------------------------------------------------------------


def slip_rate(section: CrossSection, curvature: Number, tension: PerTendon, compliance: PerTendon) -> PerTendon:
    """By how much a tendon's path shortens and the tendon stretches per arc length, at one cross-section.

    The path shortens by sqrt(1 + d'^2) - |u_c'|; the tendon stretches by T sqrt(1 + d'^2) / (E A).

    Args:
        section: the cross-section.
        curvature: kappa, 1/m.
        tension: T, N.
        compliance: 1 / (E A), 1/N.
    """
    # q = 1 - sigma d kappa; sqrt(1 + d'^2) - sqrt(q^2 + d'^2) without cancellation
    bend, slope = section.side * section.offset * curvature, section.offset_slope
    straight = jnp.sqrt(1.0 + slope**2)
    rate = bend * (2.0 - bend) / (straight + jnp.sqrt((1.0 - bend) ** 2 + slope**2))
    return where_present(section, rate) + tension * straight * compliance
