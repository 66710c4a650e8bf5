"""The result of `trace`: the states of a manipulator after each step of a path; the axis of steps comes first."""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int

from ..mechanics.fields import AnyFields, tendons_first
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import RESULTS, nan_unless


class States(eqx.Module):
    """The states of the body after each step; one class for each method of tracing."""

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
        """Work, friction loss and stored energy after each step."""


class Energies(eqx.Module):
    """The energies after every step, J; work and loss are sums since the straight body was at rest."""

    work: Float[Array, " steps"]
    friction_loss: Float[Array, " steps"]
    stored_energy: Float[Array, " steps"]


class History(eqx.Module):
    """The states of a manipulator after each step of a path; the axis of steps comes first.

    Numbers of one tendon have the shape (steps,), those of several tendons (steps, tendons).
    They are NaN where a step failed; `result` says why.
    """

    base_tension: Float[Array, "steps *tendons"]  # N
    tip_tension: Float[Array, "steps *tendons"]  # N
    tip_angle: Float[Array, " steps"]  # phi(L), rad; in space between the axes of tip and base, from 0 to pi
    tip_position: Float[Array, "steps components"]  # u(L), m
    tip_frame: Float[Array, "steps 3 3"] | None  # of a body in space: its columns are the axes of the tip
    direction: Float[Array, "steps *tendons"]  # of the sliding tendon: +1 in, -1 out
    front: Float[Array, "steps *tendons"]  # s, m, up to which the tendon slid in this step; beyond it the tendon rests
    num_turns: Int[Array, " steps"] | None  # how many turns are still remembered; None with several tendons or loads
    tendon_displacement: Float[Array, "steps *tendons"]  # m, pulled in at the base since the straight body
    error_estimate: Float[Array, " steps"]  # of tip tension (relative), tip position (per length), tip angle (rad)
    result: RESULTS  # how each step ended
    _states: States

    def sliding(self, arc_length: ArrayLike) -> Float[Array, "steps *tendons_and_points"]:
        """+1 where the tendon slid in during the step, -1 where it slid out, 0 where it rested, at arc lengths (m)."""
        s = jnp.asarray(arc_length, self.front.dtype)
        found = self._states.sliding(s.ravel())
        return found.reshape(*found.shape[:-1], *s.shape)

    @property
    def work(self) -> Float[Array, " steps"]:
        """The work of actuators and loads since the body was straight, J.

        It is the integral of the base tensions over the tendon displacements, and of the loads over the displacements
        of the points where they act.
        """
        return self._energies.work

    @property
    def friction_loss(self) -> Float[Array, " steps"]:
        """The part of the work that friction and drag have dissipated, J.

        In the plane it is an integral of its own; in space it is the work less the stored energy.
        """
        return self._energies.friction_loss

    @property
    def stored_energy(self) -> Float[Array, " steps"]:
        """The elastic energy of the bent body and the stretched tendons, J.

        In the exact kinematics work = stored energy + friction loss. In the published kinematics the moment of a
        tendon is not exactly the derivative of its displacement, so the two sides differ.
        """
        return self._energies.stored_energy

    @property
    def _energies(self) -> Energies:
        known = jnp.cumsum(jnp.isnan(self.tip_angle)) == 0  # after a failed step a sum is not known
        return jax.vmap(nan_unless)(known, self._states.energies())

    @property
    def equilibria(self) -> AnyFields:
        """The fields along the body after each step, at the base, the Gauss nodes and the tip."""
        return self.at(self._states.arc_length)

    def at(self, arc_length: ArrayLike) -> AnyFields:
        """The fields along the body after each step, as in `Equilibrium.at`; the axis of steps comes first.

        Args:
            arc_length: s, m, a number or an array of any shape; the fields are NaN outside 0 to L.
        """
        s = jnp.asarray(arc_length, self.front.dtype)
        fields = jax.vmap(nan_unless)(~jnp.isnan(self.tip_angle), self._states.fields(s.ravel()))
        fields = jax.tree.map(lambda x: x.reshape(x.shape[0], *s.shape, *x.shape[2:]), fields)
        return jax.vmap(lambda step: tendons_first(step, s.ndim))(fields)
