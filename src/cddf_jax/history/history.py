"""The result of `trace`: the states of a manipulator after each step of a path; the axis of steps comes first."""

import dataclasses
from abc import abstractmethod
from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from ..errors import InputError
from ..mechanics.fields import AnyFields, tendons_first
from ..mechanics.friction import PerTendon
from ..mechanics.geometry import Geometry
from ..numerics.arrays import words_or_shapes
from ..numerics.given_numbers import check_numbers
from ..robot.cross_section import AnySection
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import axis_of_tip, nan_unless
from ..statics.status import Status, in_words, words_of
from ..units import Dimension, shown

STEPS = 20  # described in words, at most
GOOD = (Status.successful, Status.slack)


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
    """The energies after every step, J; work and loss are sums since the straight body was at rest.

    In the exact kinematics the work is stored or lost. In the published kinematics the moment of a tendon is not
    exactly the derivative of its displacement, so the two sides differ.
    """

    work: Float[Array, " steps"]  # of base tensions over tendon displacements, and of loads where they act
    # for one tendon without loads the work less what the tendon has given to the body and stored; else an integral
    friction_loss: Float[Array, " steps"]
    stored_energy: Float[Array, " steps"]  # in the bent body and the stretched tendons


def stored_per_length(
    geometry: Geometry, section: AnySection, strain: Array, tension: PerTendon, compliance: PerTendon
) -> Float[Array, ""]:
    """The energy of the strains of a cross-section and of the stretch of its tendons, J/m."""
    slip = partial(geometry.slip_rate, section, strain, tension)
    elastic = section.stiffness * geometry.elastic(section, strain) ** 2
    return (jnp.sum(elastic) + jnp.sum(tension * (slip(compliance) - slip(0.0 * compliance)))) / 2


ENERGIES = tuple(field.name for field in dataclasses.fields(Energies))


@eqx.filter_jit
def _known_energies(states: States, tip_angle: Float[Array, " steps"]) -> Energies:
    """Compiled, as else all motions would be traced again at each call."""
    known = jnp.cumsum(jnp.isnan(tip_angle)) == 0  # after a failed step a sum is not known
    return jax.vmap(nan_unless)(known, states.energies())


@eqx.filter_jit
def _known_fields(states: States, tip_angle: Float[Array, " steps"], arc_length: Float[Array, " points"]) -> AnyFields:
    """Compiled, as else every operation would be a call of its own."""
    return jax.vmap(nan_unless)(~jnp.isnan(tip_angle), states.fields(arc_length))


class History(eqx.Module):
    """The states of a manipulator after each step of a path; the axis of steps comes first.

    Numbers of one tendon have the shape (steps,), those of several tendons (steps, tendons).
    They are NaN where a step failed; `status` says why.
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
    status: Int[Array, " steps"]  # how each step ended; of `Status`
    _states: States

    def __str__(self) -> str:
        return words_or_shapes(history_in_words, self)

    @property
    def tip_axis(self) -> Float[Array, "steps components"]:
        """The direction in which the tip points, of length 1."""
        return axis_of_tip(self.tip_angle, self.tip_frame)

    def sliding(self, arc_length: ArrayLike | Sequence[ArrayLike]) -> Float[Array, "steps *tendons_and_points"]:
        """+1 where the tendon slid in during the step, -1 where it slid out, 0 where it rested, at arc lengths (m)."""
        s = self._places("sliding(s)", arc_length)
        found = self._states.sliding(s.ravel())
        return found.reshape(*found.shape[:-1], *s.shape)

    @property
    def energies(self) -> Energies:
        """Work, friction loss and stored energy. They are computed anew at each access: keep the result."""
        self._check_single("energies")
        return _known_energies(self._states, self.tip_angle)

    def _check_single(self, asked: str) -> None:
        """Refuse a batch.

        Raises:
            InputError: names what was asked for, and the remedy.
        """
        if np.ndim(self.tip_angle) != 1:
            what = f"{asked}: needs one history, not a batch of shape {np.shape(self.tip_angle)[:-1]}"
            raise InputError(what, remedy=f"use jax.vmap(lambda history: history.{asked})(histories)")

    def _places(self, asked: str, arc_length: ArrayLike | Sequence[ArrayLike]) -> Float[Array, "..."]:
        """Arc lengths of one history, m."""
        self._check_single(asked)
        check_numbers(f"{asked}: s", arc_length)
        return jnp.asarray(arc_length, self.front.dtype)

    @property
    def equilibria(self) -> AnyFields:
        """The fields along the body after each step, at the base, the Gauss nodes and the tip."""
        self._check_single("equilibria")
        return self.at(self._states.arc_length)

    def at(self, arc_length: ArrayLike | Sequence[ArrayLike]) -> AnyFields:
        """The fields along the body after each step, as in `Equilibrium.at`; the axis of steps comes first.

        Args:
            arc_length: s, m, a number or an array of any shape; the fields are NaN outside 0 to L.
        """
        s = self._places("at(s)", arc_length)
        fields = _known_fields(self._states, self.tip_angle, s.ravel())
        fields = jax.tree.map(lambda x: x.reshape(x.shape[0], *s.shape, *x.shape[2:]), fields)
        return jax.vmap(lambda step: tendons_first(step, s.ndim))(fields)


# --- in words -------------------------------------------------------------------------------------


def history_in_words(history: History) -> str:
    """A line for each of the last steps of one history whose numbers are known."""
    history._check_single("words")
    steps = range(len(history.tip_angle))
    return "\n".join([*steps_in_words(history, steps), last_line(history)])


def steps_in_words(history: History, steps: Sequence[int]) -> list[str]:
    """What slid in each of these steps, and the state after it; of the last ones, if there are many.

    Args:
        history: the whole history; it may have further steps between.
        steps: indices from 0.
    """
    of_steps = ("base_tension", "tip_tension", "tip_angle", "tendon_displacement", "direction", "front")
    states = {name: np.asarray(getattr(history, name))[list(steps)] for name in of_steps}
    codes, length = np.asarray(history.status)[list(steps)], float(history._states.manipulator.length)
    slack = f"; {'the' if np.ndim(history.base_tension) == 1 else 'a'} tendon is slack, as it would have to push"
    lines = []
    for i, code in enumerate(codes):
        failed, exact = np.isnan(states["tip_angle"][i]), history.num_turns is not None
        words = words_of(code) if failed else _step_in_words(states, i, length, exact=exact)
        lines.append(f"{i + 1}: {words}{slack if code == Status.slack else ''}")
    return [f"the last {STEPS} of {len(lines):,} steps:", *lines[-STEPS:]] if len(lines) > STEPS else lines


def last_line(history: History) -> str:
    """The largest error estimate, and how the steps ended."""
    ended = "successful" if np.all(np.isin(history.status, GOOD)) else in_words(history.status)
    known = np.asarray(history.error_estimate)[np.isfinite(history.error_estimate)]
    return f"error estimate {np.max(known, initial=0.0):.1e}; {ended}"


def _step_in_words(states: dict[str, np.ndarray], i: int, length: float, *, exact: bool) -> str:
    """ "released to 40 N, slides out up to 115.09 mm and rests beyond; tip tension 45.1 N, ..."."""
    if exact and not np.any(states["base_tension"][: i + 1]):
        return f"{shown(states['base_tension'][i], 'force')}, at rest"
    now, front, direction = (np.ravel(states[name][i]) for name in ("base_tension", "front", "direction"))
    before, parts = np.ravel(states["base_tension"][i - 1]) if i > 0 else np.zeros_like(now), []
    for k, tension in enumerate(now):
        name = f"tendon {k + 1} " if now.size > 1 else ""
        rises = direction[k] > 0 if exact else tension > before[k]
        how = "stays at" if tension == before[k] else "pulled to" if rises else "released to"
        parts.append(f"{name}{how} {shown(tension, 'force')}")
        if exact and tension == before[k]:
            continue
        where = "along the whole body" if front[k] >= length else f"up to {shown(front[k], 'length')} and rests beyond"
        way = "in" if direction[k] > 0 else "out"
        parts[-1] += f", slides {way} {where}" if front[k] > 0 else ", rests at the base"
    tips, angle = listed(states["tip_tension"][i], "force"), shown(states["tip_angle"][i], "angle")
    pulled_in = listed(states["tendon_displacement"][i], "length")
    return "; ".join([*parts, f"tip tension {tips}, tip angle {angle}, pulled in {pulled_in}"])


def listed(values: np.ndarray, dimension: Dimension) -> str:
    """ "60 N, 20 N"."""
    return ", ".join(shown(float(value), dimension) for value in np.ravel(values))
