"""The result of a solve: the equilibrium and its fields along the body."""

from collections.abc import Sequence
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from ..errors import InputError
from ..mechanics.fields import AnyFields, fields_at, tendons_first
from ..mechanics.problem import BodyStates, State, geometry_at, guarded_section, strain_of
from ..numerics.arrays import words_or_shapes
from ..numerics.elements import Elements
from ..numerics.given_numbers import check_numbers
from ..numerics.rotations import length_of
from ..robot.cross_section import SpatialSection
from ..robot.manipulator import Manipulator
from .status import Status

PerTendon = Float[Array, " tendons"]
Tree = TypeVar("Tree")
FRACTIONS = np.linspace(0.0, 1.0, 129)  # of every element, at which the strain of the wall is computed


class Equilibrium(eqx.Module):
    """A manipulator in static equilibrium.

    Where no equilibrium was found, the numbers are NaN and `status` says why. `status` also says when numbers are
    doubtful (`crossing`, `inaccurate`, `unstable`, `direction_contradicted`), or those of the nearest tensions
    (`slack`, `unreachable`, `undetermined`).

    Every attribute of `Fields`, or of `SpatialFields` where the body is in space, is an attribute here as well, at the
    base, the Gauss nodes and the tip.
    """

    along: AnyFields  # all that varies along the body
    tip_position: Float[Array, " components"]  # u(L), m
    # phi(L), rad; in space between the axes of tip and base, from 0 to pi, and with a derivative of zero at 0
    tip_angle: Float[Array, ""]
    tip_frame: Float[Array, "3 3"] | None  # of a body in space: its columns are the axes of the tip
    tip_tension: Float[Array, " tendons"]  # N; at its anchor for a tendon that ends before the tip
    tension_loss: Float[Array, " tendons"]  # 1 - T_tip / T_base, a fraction; without base tension that of bending alone
    tendon_displacement: Float[Array, " tendons"]  # m, pulled in at the base since the straight body: positive
    base_tension: Float[Array, " tendons"]  # N; found where a target stood in its place
    target_miss: Float[Array, " targets"]  # reached less wanted, in the target's unit; 0 where the tension was given
    target_rank: Int[Array, ""] | None  # of a `TipPosition`: in how many directions the tensions move the tip there
    base_moment: Float[Array, "*components"]  # M_ext(0), N m, that the dead loads put on the base
    load_fraction: Float[Array, ""]  # of the loads, up to which there is an equilibrium: 1, or the limit load
    num_load_steps: Int[Array, ""]  # in which the loads were put on; 1 where one step would do, 0 without loads
    stable: Bool[Array, ""]  # at constant base tensions and dead loads, sliding as `direction` says
    direction: Float[Array, " tendons"]  # +1 slides in at the base, -1 out; found where it was not stated
    # True where a tendon travels against its direction: since the straight body, or under loads as all tensions rise
    direction_contradicted: Bool[Array, " tendons"]
    error_estimate: Float[Array, ""]  # of tip tension (relative), tip position (per length), tip angle (rad)
    num_iterations: Int[Array, ""]  # iterations of the last step
    status: Int[Array, ""]  # how the solve ended; of `Status`
    _dense: "Dense"

    arc_length = property(lambda self: self.along.arc_length, doc="s, m, from 0 to L.")
    curvature = property(lambda self: self.along.curvature, doc="kappa, 1/m.")
    heading = property(lambda self: self.along.heading, doc="phi, rad.")
    position = property(lambda self: self.along.position, doc="u, m, (points, 2).")
    tension = property(lambda self: self.along.tension, doc="T, N, (tendons, points).")
    wrap_angle = property(lambda self: self.along.wrap_angle, doc="theta, rad, (tendons, points).")
    normal_force = property(lambda self: self.along.normal_force, doc="F_CDDN, N/m, (tendons, points, 2).")
    friction_force = property(lambda self: self.along.friction_force, doc="F_CDDF, N/m, (tendons, points, 2).")
    frame = property(lambda self: self.along.frame, doc="R of a body in space, (points, 3, 3).")
    twist = property(lambda self: self.along.twist, doc="The twist of a body in space, 1/m, (points,).")
    path = property(lambda self: self.along.path, doc="The place of each tendon in space, m, (tendons, points, 3).")

    @property
    def tip_axis(self) -> Float[Array, " components"]:
        """The direction in which the tip points, of length 1."""
        return axis_of_tip(self.tip_angle, self.tip_frame)

    @property
    def in_space(self) -> bool:
        """Whether the body was solved in space, so that its fields are `SpatialFields`; static."""
        return self._dense.manipulator.in_space

    @property
    def has_wall(self) -> bool:
        """Whether the body has an outer radius, so that the strain of its wall is known."""
        return self._dense.manipulator.outer_radius is not None

    @property
    def peak_strain(self) -> Float[Array, ""]:
        """The largest strain |R_outer kappa| of the wall, a fraction, to 1e-4 of it; NaN where a solve failed.

        On an axis that stretches the magnitude of its stretch is added. Computed on access. It is the strain of the
        wall that the profiles describe, without notches.

        Raises:
            InputError: for a body without an outer radius.
            ValueError: for a batch.
        """
        return self._peak[0]

    @property
    def peak_strain_at(self) -> Float[Array, ""]:
        """The arc length, m, at which the wall has its `peak_strain`."""
        return self._peak[1]

    @property
    def _peak(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        self._check_single("peak_strain")
        return _peak_strain(self._dense)

    def _check_single(self, asked: str) -> None:
        """Refuse a batch.

        Raises:
            InputError: names what was asked for, and the remedy.
        """
        if np.ndim(self.tip_angle) > 0:
            what = f"{asked}: needs one equilibrium, not a batch of shape {np.shape(self.tip_angle)}"
            raise InputError(what, remedy=f"use jax.vmap(lambda equilibrium: equilibrium.{asked})(equilibria)")

    @property
    def remarks(self) -> tuple[str, ...]:
        """Warnings about numbers that are correct, in words; for one solve, on the host, not traced.

        An unstable equilibrium, tendons that travel against their direction, a strain above the body's
        `yield_strain`, a body that touches itself, a Poisson's ratio that no material has.

        Raises:
            ValueError: for a batch or traced values.
        """
        from .equilibrium_text import remarks_on

        return remarks_on(self)

    def __str__(self) -> str:
        from .equilibrium_text import equilibrium_in_words

        return words_or_shapes(equilibrium_in_words, self)

    @property
    def elements(self) -> Elements:
        """The elements of the solve, which end where the body is not smooth."""
        return self._dense.elements

    def at(self, arc_length: ArrayLike | Sequence[ArrayLike]) -> AnyFields:
        """The same fields anywhere along the body.

        Args:
            arc_length: s, m, a number or an array of any shape; the fields are NaN outside 0 to L. At a joint or the
                anchor of a tendon they are those before it.
        """
        self._check_single("at(s)")
        check_numbers("at: arc_length", arc_length)
        s = jnp.asarray(arc_length, self.arc_length.dtype)
        fields = _along(self._dense, s.ravel())
        return tendons_first(jax.tree.map(lambda x: x.reshape(s.shape + x.shape[1:]), fields), s.ndim)


class Dense(eqx.Module):
    """The collocation polynomials of a solution."""

    manipulator: Manipulator
    base_tension: PerTendon
    direction: PerTendon
    edges: Float[Array, " edges"]  # of the elements, m
    order: int = eqx.field(static=True)  # nodes in each element
    states: BodyStates
    solved: Bool[Array, ""]

    @property
    def elements(self) -> Elements:
        """The elements of the solve."""
        return Elements.between(self.edges, self.order)

    def state(self, arc_length: Float[Array, ""]) -> State:
        """The integrated state at one arc length."""
        return self.elements.interpolate(*self.states, arc_length)

    def __call__(self, arc_length: Float[Array, ""]) -> AnyFields:
        """The fields at one arc length, tendons last; at a joint those before it."""
        place = self.elements.before_edge(arc_length)
        fields = fields_at(self.manipulator, self.base_tension, self.direction, place, self.state)
        inside = (arc_length >= 0) & (arc_length <= self.elements.edges[-1])
        return nan_unless(self.solved & inside, fields)

    def inside_of_bend(self, arc_length: Float[ArrayLike, " points"]) -> Float[Array, "tendons points"]:
        """Offset * curvature of each tendon; in space by how much the fibre there is shorter than the axis at rest."""

        def at(s: Float[Array, ""]) -> PerTendon:
            s = self.elements.before_edge(s)
            section = guarded_section(self.manipulator, s)
            strain = strain_of(section, self.base_tension, self.state(s))
            return geometry_at(section).inside(section, strain)

        return jax.vmap(at, out_axes=1)(jnp.asarray(arc_length))

    def peak_strain(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """The largest |R_outer kappa|, and its arc length, m."""
        if self.manipulator.outer_radius is None:
            raise InputError("peak_strain: the body has no outer_radius; give it both radii, or leave the strain out")
        cut, nudge = self.elements, self.elements.nudge
        left, right = cut.edges[:-1, None], cut.edges[1:, None]
        places = left + cut.width[:, None] * FRACTIONS
        within = jnp.clip(places, left + nudge, right - nudge)  # at a joint each side has its own radius
        states = jax.tree.map(lambda a, b, c: cut.resample(a, b, c, FRACTIONS), *self.states)
        states = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), states)
        strain = jnp.abs(jax.vmap(self._strain)(within.ravel(), states))
        same = 64 * float(jnp.finfo(strain.dtype).eps)  # where the strain is constant, the first point counts
        most = jnp.argmax(strain >= (1 - same) * jnp.max(strain))
        return nan_unless(self.solved, (strain[most], places.ravel()[most]))

    def _strain(self, arc_length: Float[Array, ""], state: State) -> Float[Array, ""]:
        section = guarded_section(self.manipulator, arc_length)
        strain = strain_of(section, self.base_tension, state)
        if not isinstance(section, SpatialSection):
            return self.manipulator.outer_strain(arc_length, strain)
        strain = strain - section.rest
        bent = jnp.abs(self.manipulator.outer_strain(arc_length, length_of(strain[1:3])))
        return bent + jnp.abs(strain[3]) if section.extensible else bent


@eqx.filter_jit
def _along(dense: Dense, arc_length: Float[Array, " points"]) -> AnyFields:
    return jax.vmap(dense)(arc_length)


_peak_strain = eqx.filter_jit(Dense.peak_strain)


def ended_as(equilibrium: Equilibrium, *statuses: Status) -> bool:
    """Whether one solve, whose numbers are known, ended with one of these statuses."""
    return int(equilibrium.status) in statuses


def on_host(equilibrium: Equilibrium) -> Equilibrium:
    """The same in NumPy arrays, from which texts are made without a compiled program for every operation."""
    return jax.tree.map(np.asarray, equilibrium)


def axis_of_tip(
    tip_angle: Float[Array, "*steps"], tip_frame: Float[Array, "*steps 3 3"] | None
) -> Float[Array, "*steps components"]:
    """The direction in which a tip points; the frame is that of a body in space."""
    if tip_frame is not None:
        return tip_frame[..., 0]
    return jnp.stack([jnp.cos(tip_angle), jnp.sin(tip_angle)], axis=-1)


def nan_unless(good: Bool[Array, ""], tree: Tree) -> Tree:
    """NaN where a solve failed, so that no number is mistaken for a result; derivatives of other lanes stay finite."""
    return jax.tree.map(lambda x: jnp.where(good, x, jnp.nan), tree)
