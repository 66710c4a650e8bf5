"""What `trace` returns: the states through which a manipulator went, step first."""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int

from ..mechanics.fields import AnyFields, tendons_first
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import RESULTS, nan_unless


class States(eqx.Module):
    """What a method knows of the body after each step; one class for each method."""

    manipulator: eqx.AbstractVar[Manipulator]

    @property
    @abstractmethod
    def arc_length(self) -> Float[Array, " points"]:
        """Base, nodes and tip, m."""

    @abstractmethod
    def fields(self, arc_length: Float[Array, " points"]) -> AnyFields:
        """The fields after each step, tendons last: (steps, points, ...); NaN off the body."""

    @abstractmethod
    def sliding(self, arc_length: Float[Array, " points"]) -> Float[Array, "steps *tendons points"]:
        """+1 where a tendon slid in last, -1 where it slid out, 0 where it rests."""

    @abstractmethod
    def energies(self) -> "Energies":
        """What was done, lost and stored."""


class Energies(eqx.Module):
    """Of every step, J; all but the stored energy is summed up since the straight body was at rest."""

    work: Float[Array, " steps"]
    friction_loss: Float[Array, " steps"]
    stored_energy: Float[Array, " steps"]


class History(eqx.Module):
    """The states through which a manipulator went, step first.

    One tendon has its numbers as (steps,), several have theirs as (steps, tendons).
    NaN where a step failed, and `result` says why.
    """

    base_tension: Float[Array, "steps *tendons"]  # N
    tip_tension: Float[Array, "steps *tendons"]  # N
    tip_angle: Float[Array, " steps"]  # phi(L), rad; in space between the axes of tip and base, from 0 to pi
    tip_position: Float[Array, "steps components"]  # u(L), m
    tip_frame: Float[Array, "steps 3 3"] | None  # of a body in space: its columns are the axes of the tip
    direction: Float[Array, "steps *tendons"]  # of the sliding tendon: +1 in, -1 out
    front: Float[Array, "steps *tendons"]  # s, m, up to which the tendon slid last; it rests beyond, if not the tip
    num_turns: Int[Array, " steps"] | None  # how many turns are still remembered; None with several tendons or loads
    tendon_displacement: Float[Array, "steps *tendons"]  # m, pulled in at the base since the straight body
    error_estimate: Float[Array, " steps"]  # of tip tension (relative), tip position (per length), tip angle (rad)
    result: RESULTS  # how each step ended
    _states: States

    def sliding(self, arc_length: ArrayLike) -> Float[Array, "steps *tendons_and_points"]:
        """+1 where the tendon slid in last, -1 where it slid out, 0 where it rests, at arc lengths (m)."""
        s = jnp.asarray(arc_length, self.front.dtype)
        found = self._states.sliding(s.ravel())
        return found.reshape(*found.shape[:-1], *s.shape)

    @property
    def work(self) -> Float[Array, " steps"]:
        """What actuators and loads have done since the straight body, J.

        That is the integral of base tension by tendon displacement, and that of loads by what they move.
        """
        return self._energies.work

    @property
    def friction_loss(self) -> Float[Array, " steps"]:
        """What friction and drag have taken of that, J.

        In the plane from an integral of its own; in space the work less what is stored.
        """
        return self._energies.friction_loss

    @property
    def stored_energy(self) -> Float[Array, " steps"]:
        """What the bent body and the stretched tendons hold, J.

        In the exact kinematics work = stored energy + friction loss. In the published kinematics the moment of a
        tendon is not quite the one that does its work, and the difference tells how much.
        """
        return self._energies.stored_energy

    @property
    def _energies(self) -> Energies:
        known = jnp.cumsum(jnp.isnan(self.tip_angle)) == 0  # after a step that failed a sum is not known
        return jax.vmap(nan_unless)(known, self._states.energies())

    @property
    def equilibria(self) -> AnyFields:
        """What varies along the body, after each step, at the base, the Gauss nodes and the tip."""
        return self.at(self._states.arc_length)

    def at(self, arc_length: ArrayLike) -> AnyFields:
        """What varies along the body, after each step, as `Equilibrium.at` has it; step first.

        Args:
            arc_length: s, m, a number or an array of any shape; NaN comes back outside 0 to L.
        """
        s = jnp.asarray(arc_length, self.front.dtype)
        fields = jax.vmap(nan_unless)(~jnp.isnan(self.tip_angle), self._states.fields(s.ravel()))
        fields = jax.tree.map(lambda x: x.reshape(x.shape[0], *s.shape, *x.shape[2:]), fields)
        return jax.vmap(lambda step: tendons_first(step, s.ndim))(fields)
