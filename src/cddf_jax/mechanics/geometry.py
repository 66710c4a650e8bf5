"""What differs between a body in the plane and one in space: strain, heading, turning. The solver asks here only.

A `Geometry` is chosen by `problem.geometry_of`. Its functions of "an element" take the values at the p nodes of one
element and integrate over it; the others take one cross-section.
"""

from typing import ClassVar, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..numerics import tolerances as tol
from ..numerics.arrays import cos_sin, largest_size, sum_of
from ..numerics.elements import Quartics, gains_of_length, gains_of_magnitude, slope_in_element
from ..numerics.rotations import (
    IDENTITY,
    as_matrix,
    cofactors,
    cross,
    dot,
    first_axis,
    in_fixed_frame,
    in_own_frame,
    length_of,
    of_turn,
    product,
    small_turn,
    solve_three,
    square_root,
    tilt,
    turned_by,
)
from ..robot.cross_section import AnySection, planar, spatial
from ..robot.manipulator import Manipulator
from . import bending, space
from .friction import PerTendon

Number = Float[Array, ""]


class Plane:
    """The strain is the curvature kappa, the heading is phi, rad, and a moment is a number."""

    components: ClassVar[int] = 2
    elements: ClassVar[tuple[int, float]] = 4, 0.5  # of a piece with kinks, and the share of `nodes` that each has
    no_moment: ClassVar[np.ndarray] = np.zeros(())
    upright: ClassVar[np.ndarray] = np.zeros(())  # the heading at the base
    has_frames: ClassVar[bool] = False  # whether headings are unknowns of the iteration

    def reverses(self, body: Manipulator, loaded: bool) -> bool:
        """Whether a tendon may turn to both sides along the body; static.

        In the published kinematics and for tendons parallel to the axis all tendons turn with the body. Without loads
        and drag their moment M depends on the wrap angle theta alone, and theta' = |M(theta)| / (E J) does not reach
        a zero of M along a finite body. In the exact kinematics a slanted tendon has a turning of its own.
        """
        own = body.kinematics == "exact" and body.slanted
        return loaded or own or (body.num_tendons > 1 and (body.slanted or body.tendon_drag is not None))

    def has_closed_strain(self, body: Manipulator, loaded: bool) -> bool:
        """Whether the strain needs no iteration, and no tendon turns where the body is not smooth; static."""
        return body.kinematics == "published" or not body.slanted

    def bending_stiffness(self, section: AnySection) -> Float[Array, "*points"]:
        """E J, N m^2."""
        return section.stiffness

    def strain(
        self,
        section: AnySection,
        tension: PerTendon,
        heading: Array | None,
        moment: Array,
        force: Array | None,
        start: Array | None,
    ) -> Array:
        """The strain of a cross-section, from the tensions and the loads outboard in the fixed frame.

        `start`: the elastic strain, approximately, where there is no closed form.
        """
        return bending.curvature(planar(section), tension, moment, start)

    def elastic(self, section: AnySection, strain: Array) -> Array:
        """The strain less that at rest."""
        return strain

    def bending_part(self, strain: Array) -> Array:
        """The curvatures among the strains; zero in place of twist, stretch and shear."""
        return strain

    def moment_in_fixed_frame(self, heading: Array, stress: Array) -> Array:
        """The moment among what acts along the strains of cross-sections."""
        return stress

    def heading_rate(self, guess: Array | None, strain: Array) -> Array:
        """The rate of the heading along s, from a guess of the heading."""
        return strain

    def axis(self, heading: Float[Array, "*points"], strain: Array) -> Float[Array, "*points 2"]:
        """The derivative of the position along s: the unit vector t."""
        return axis_of(heading)

    def moment_rate(self, axis: Array, force: Array) -> Array:
        """M_ext' = -(t x N), N."""
        return -(axis[..., 0] * force[..., 1] - axis[..., 1] * force[..., 0])

    def turning(
        self,
        width: Number,
        section: AnySection,
        strain: Array,
        tension: Array,
        direction: PerTendon,
        moment_rate: Array | None,
        sign: PerTendon | None = None,
    ) -> Float[Array, "p tendons"]:
        """The signed rate psi' of each tendon at the nodes of an element, rad/m.

        `sign`: of psi', with which friction acts; 0 or None to find it.
        """
        by_loads = jnp.zeros_like(strain) if moment_rate is None else moment_rate
        at_nodes = jax.vmap(bending.turning, (0, 0, 0, None, 0, None))
        return at_nodes(planar(section), strain, tension, direction, by_loads, sign)

    def scaled(self, turning: Array, factor: Array) -> Array:
        """The turning of each tendon times a factor."""
        return factor * turning

    def size(self, turning: Array) -> Array:
        """|psi'|."""
        return jnp.abs(turning)

    def gains(self, turning: Array, curve: Quartics) -> Array:
        """The integral of |psi'|, which changes its sign, over the sub-intervals of an element of width 1."""
        return gains_of_magnitude(curve)

    def pointing(self, section: AnySection, strain: Array) -> Array:
        """Where the tendons point in the frame of the cross-section: angles alpha, rad."""
        return bending.tangent_angle(planar(section), strain)

    def turn_between(self, one: Array, other: Array) -> PerTendon:
        """The angle between two directions of `pointing`, rad."""
        return jnp.abs(other - one)

    def turned(self, width: Number, sections: AnySection, strains: Array) -> PerTendon:
        """The angle by which tendons turn along a short element, rad, from values at both its ends (axis of two)."""
        sections = planar(sections)
        turn = width * jnp.mean(jax.vmap(bending.turning_in_bend)(sections, strains), axis=0)
        if sections.kinematics == "exact":
            angles = jax.vmap(bending.tangent_angle)(sections, strains)
            turn = turn + angles[1] - angles[0]
        return square_root(turn**2 + tol.LEAST_TURN**2)

    def turned_on(self, heading: Array, turn: Array) -> Array:
        """The heading beyond a short element, from that before it and the strain times its length."""
        return heading + turn

    def turn_from(self, one: Array, other: Array) -> Array:
        """The small turn from one heading to another, rad, in the fixed frame."""
        return other - one

    def slip_rate(self, section: AnySection, strain: Array, tension: PerTendon, compliance: PerTendon) -> PerTendon:
        """By how much a tendon's path shortens and the tendon stretches per arc length."""
        return bending.slip_rate(planar(section), strain, tension, compliance)

    def inside(self, section: AnySection, strain: Array) -> PerTendon:
        """By how much the fibre at a tendon is shorter than the axis: sigma d kappa."""
        return planar(section).side * section.offset * strain

    def tip_angle(self, heading: Array) -> Number:
        return heading

    def tip_frame(self, heading: Array) -> None:
        """None: the angle says it all."""
        return None

    # M_ext(0) is one number

    def moment_for(self, slopes: Array, change: Array) -> Array:
        """The change of M_ext(0) that causes a change of the moment at the tip."""
        return change / slopes[0]

    def steepness(self, slopes: Array) -> Number:
        """The least rate at which the moment at the tip changes with M_ext(0)."""
        return jnp.abs(slopes[0])

    def is_stable(self, turned: Array, heading: Array, slopes: Array) -> Bool[Array, ""]:
        """Whether the smallest eigenvalue of the tangent is positive: no conjugate point along the body.

        Args:
            turned: the slopes of the headings at the nodes and, last, at the tip, by M_ext(0).
            heading: there.
            slopes: of the moment at the tip by M_ext(0).
        """
        return (slopes[0] > 0) & (turned[0, -1] > 0) & jnp.all(turned[0] >= 0)


class Space:
    """The strain is the curvature u, and v where the axis stretches; the heading is a quaternion."""

    components: ClassVar[int] = 3
    elements: ClassVar[tuple[int, float]] = 4, 0.75  # more nodes each, as the derivatives of tangents need them
    no_moment: ClassVar[np.ndarray] = np.zeros(3)
    upright: ClassVar[np.ndarray] = np.array(IDENTITY)
    has_frames: ClassVar[bool] = True

    def reverses(self, body: Manipulator, loaded: bool) -> bool:
        """Whether the turning of a tendon may have a minimum so sharp that it is nearly a kink; static.

        Without loads and drag, tendons that are all parallel to the axis have none: their wrap angle obeys
        theta'' = P'(theta) / 2 over s / (E J), where P, the square of the moment, is smooth in theta.
        """
        parallel = not body.slanted and body.rest_curvature is None
        alone = body.num_tendons == 1 or (body.tendon_drag is None and not body.extensible)
        return loaded or not (parallel and alone)

    def has_closed_strain(self, body: Manipulator, loaded: bool) -> bool:
        return not loaded and body.parallel

    def bending_stiffness(self, section: AnySection) -> Float[Array, "*points"]:
        return section.stiffness[..., 1]

    def strain(
        self,
        section: AnySection,
        tension: PerTendon,
        heading: Array | None,
        moment: Array,
        force: Array | None,
        start: Array | None,
    ) -> Array:
        section, wrench = spatial(section), None
        if heading is not None and force is not None:
            wrench = space.Wrench(
                in_own_frame(heading, moment), in_own_frame(heading, force) if section.extensible else None
            )
        return space.strain(section, tension, wrench, start)

    def elastic(self, section: AnySection, strain: Array) -> Array:
        return strain - spatial(section).rest

    def bending_part(self, strain: Array) -> Array:
        return strain * np.array([0.0, 1.0, 1.0, 0.0, 0.0, 0.0])[: strain.shape[-1]]

    def moment_in_fixed_frame(self, heading: Array, stress: Array) -> Array:
        return in_fixed_frame(heading, stress[..., :3])

    def heading_rate(self, guess: Array | None, strain: Array) -> Array:
        assert guess is not None
        return turned_by(guess, space.curvature_of_strain(strain))

    def axis(self, heading: Float[Array, "*points 4"], strain: Array) -> Float[Array, "*points 3"]:
        return in_fixed_frame(heading, strain[..., 3:]) if strain.shape[-1] > 3 else first_axis(heading)

    def moment_rate(self, axis: Array, force: Array) -> Array:
        return -cross(axis, force)

    def turning(
        self,
        width: Number,
        section: AnySection,
        strain: Array,
        tension: Array,
        direction: PerTendon,
        moment_rate: Array | None,
        sign: PerTendon | None = None,
    ) -> Float[Array, "p tendons 3"]:
        """The vectors by which the tangents of the tendons turn; t' is that of the polynomial through the nodes."""
        section = spatial(section)
        if moment_rate is None and section.parallel:
            turn = jnp.broadcast_to(strain[..., None, :], (*section.offset.shape, 3))
        else:
            tangent = jax.vmap(space.tangents)(section, strain)
            turn = jax.vmap(space.turn_vectors)(strain, tangent, slope_in_element(width, tangent))
        return turn if section.present is None else jnp.where(section.present[..., None], turn, 0.0)

    def scaled(self, turning: Array, factor: Array) -> Array:
        return factor[..., None] * turning

    def size(self, turning: Array) -> Array:
        return length_of(turning)

    def gains(self, turning: Array, curve: Quartics) -> Array:
        return gains_of_length(turning, curve)

    def pointing(self, section: AnySection, strain: Array) -> Array:
        """Unit tangents."""
        return space.tangents(spatial(section), strain)

    def turn_between(self, one: Array, other: Array) -> PerTendon:
        return 2.0 * jnp.arctan2(length_of(other - one), length_of(other + one))

    def turned(self, width: Number, sections: AnySection, strains: Array) -> PerTendon:
        tangents = jax.vmap(space.tangents)(spatial(sections), strains)
        mean, change = jnp.mean(tangents, axis=0), tangents[1] - tangents[0]
        turn = space.turn_vectors(width * jnp.mean(strains, axis=0), mean, change)
        return square_root(dot(turn, turn) + tol.LEAST_TURN**2)

    def turned_on(self, heading: Array, turn: Array) -> Array:
        return product(heading, of_turn(space.curvature_of_strain(turn)))

    def turn_from(self, one: Array, other: Array) -> Array:
        return small_turn(other - one, (one + other) / 2)

    def slip_rate(self, section: AnySection, strain: Array, tension: PerTendon, compliance: PerTendon) -> PerTendon:
        return space.slip_rate_in_space(spatial(section), strain, tension, compliance)

    def inside(self, section: AnySection, strain: Array) -> PerTendon:
        return 1.0 - space.path_rate(spatial(section), strain)[:, 0]

    def tip_angle(self, heading: Array) -> Number:
        """Between the axes of tip and base, rad."""
        return tilt(heading)

    def tip_frame(self, heading: Array) -> Float[Array, "3 3"]:
        """Its columns are the axes of the tip."""
        return as_matrix(heading)

    # M_ext(0) has three components

    def moment_for(self, slopes: Array, change: Array) -> Array:
        return solve_three(slopes.T, change)

    def steepness(self, slopes: Array) -> Number:
        tiny = jnp.finfo(slopes.dtype).tiny
        return jnp.abs(_invariants(slopes)[2]) / jnp.maximum(largest_size(slopes), tiny) ** 2

    def is_stable(self, turned: Array, heading: Array, slopes: Array) -> Bool[Array, ""]:
        """Whether no eigenvalue has become negative, of two matrices of derivatives.

        These are the turns of the cross-sections by M_ext(0), and M_ext(L) by the turn of the tip. The three invariants
        decide. They also show two eigenvalues that became negative together.
        """
        turns = jnp.moveaxis(small_turn(turned, heading), 0, -1) * 2.0  # headings are twice a quaternion
        stiffness = slopes.T @ cofactors(turns[-1]).T  # det(tip) times M_ext(L) by the turn of the tip
        signs = _invariants(jnp.concatenate([turns, (stiffness + stiffness.T)[None]]))
        return jnp.all(signs >= 0) & jnp.all(signs[:, -2:] > 0)


def _invariants(matrix: Float[Array, "*points 3 3"]) -> Float[Array, "3 *points"]:
    """The trace, the sum of the principal minors, and the determinant."""
    at = {(i, j): matrix[..., i, j] for i in range(3) for j in range(3)}
    minors = [at[i, i] * at[j, j] - at[i, j] * at[j, i] for i, j in ((0, 1), (0, 2), (1, 2))]
    determinant = dot(matrix[..., 0, :], cross(matrix[..., 1, :], matrix[..., 2, :]))
    return jnp.stack([at[0, 0] + at[1, 1] + at[2, 2], sum_of(minors), determinant])


def axis_of(heading: Float[Array, "*points"]) -> Float[Array, "*points 2"]:
    """The unit vector t along the neutral axis, in the plane."""
    return jnp.stack(cos_sin(heading), axis=-1)


Geometry: TypeAlias = Plane | Space
PLANE, SPACE = Plane(), Space()
