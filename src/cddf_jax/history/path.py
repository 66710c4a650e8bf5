"""A path as it is given: tensions or displacements of the tendons, and loads, after each step."""

from collections.abc import Sequence
from typing import Any, NamedTuple, cast, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Bool, Float

from ..numerics.given_numbers import check_numbers
from ..robot.loads import Loads, PointLoad
from ..robot.manipulator import Manipulator
from ..statics.targets import Displacement, TipAngle, TipTension, TotalTension
from .grid import Goal

AlongAPath = Displacement | TipAngle | TipTension | TotalTension
Driven = ArrayLike | AlongAPath | Sequence[ArrayLike | AlongAPath | Sequence[ArrayLike]]


class Path(NamedTuple):
    """The given numbers after each step; the axis of steps comes first."""

    given: Float[Array, "steps tendons"]  # base tensions, N, or what is given of driven tendons, m, rad or N
    by_goal: Float[Array, "steps tendons"]  # 1 where a goal sets the tendon, else 0
    loads: Loads | None
    resting: Loads | None = None  # that act before the first step; without an axis of steps

    def under(self, loads: Loads) -> "Path":
        """The same path under constant loads."""
        count = self.given.shape[0]
        return self._replace(loads=jax.tree.map(lambda x: jnp.broadcast_to(x, (count, *x.shape)), loads))

    def partly_by_tension(self, flags: Bool[Array, "steps tendons"]) -> "Path":
        """The same path, but where a flag says so, a base tension is given, N."""
        return self._replace(by_goal=jnp.where(flags, 0.0, self.by_goal))

    def behind(self, tension: Float[Array, " tendons"]) -> "Path":
        """The same path behind a step to these tensions, under the loads that act before the first step, or none."""
        resting = self.resting
        if resting is None:
            resting = jax.tree.map(lambda x: jnp.zeros_like(x[0]), self.loads)
        first = Path(tension.astype(self.given.dtype), jnp.zeros_like(self.by_goal[0]), resting)
        steps = self._replace(resting=None)
        path = jax.tree.map(lambda one, all_steps: jnp.concatenate([one[None], all_steps]), first, steps)
        return path._replace(resting=self.resting)


def as_numbers(values: object, name: str) -> Array:
    """The values as an array of floating-point numbers.

    Raises:
        ValueError: where they are not numbers, or rows of different lengths.
    """
    check_numbers(name, values)
    traced = any(isinstance(x, jax.Array) for x in jax.tree.leaves(values))
    try:
        array = jnp.asarray(cast("ArrayLike", values) if traced else np.asarray(values))
    except ValueError:
        raise ValueError(f"{name} must hold numbers, in rows of one length, got {values!r}") from None
    return array.astype(jnp.result_type(float, array))


def given_path(
    manipulator: Manipulator, base_tension: Driven, loads: Loads | Sequence[Loads] | None
) -> tuple[Path, tuple[Goal, ...]]:
    """The path, and what is given of tendons whose tensions are not.

    The members of `loads` without an axis of steps act already before the first step.

    Raises:
        ValueError: for wrong shapes.
        TypeError: for targets that drive no tendon along a path.
    """
    given, driven = _actuation(manipulator, base_tension)
    by_goal = jnp.zeros_like(given).at[:, [one.tendon for one in driven]].set(1.0) if driven else 0.0 * given
    if manipulator.in_space and loads is not None:
        loads = loads.with_components(3) if isinstance(loads, Loads) else [one.with_components(3) for one in loads]
    along = _loads(loads, given.shape[0], manipulator.in_space)
    path = Path(given, by_goal, along, _resting(loads, along))
    if path.loads is None and any(each.quantity == "tip_angle" for each in driven):
        still = Loads().with_components(manipulator.components)  # the headings are found with the loads
        path = path.under(jax.tree.map(lambda x: jnp.asarray(x, given.dtype), still))
    return path, driven


def _actuation(manipulator: Manipulator, base_tension: Driven) -> tuple[Array, tuple[Goal, ...]]:
    count = manipulator.num_tendons
    entries = base_tension if isinstance(base_tension, tuple | list) else [base_tension]
    for entry in entries:
        if isinstance(entry, eqx.Module) and not isinstance(entry, AlongAPath):
            kinds = ", ".join(kind.__name__ for kind in get_args(AlongAPath))
            raise TypeError(
                f"trace: a path may hold base tensions, {kinds}, got {type(entry).__name__}; give the tension or the "
                "length pulled in after each step (solve finds tensions without a history: they are right up to the "
                "first turn only)"
            )
    driven = tuple(Goal(i, entry.quantity) for i, entry in enumerate(entries) if isinstance(entry, AlongAPath))
    if not driven:
        tension = as_numbers(base_tension, "trace: base_tension")
        shape = tension.shape
        tension = tension[:, None] if tension.ndim == 1 and count == 1 else tension
        if tension.ndim != 2 or tension.shape[1] != count or tension.shape[0] == 0:
            one = "(steps,) or " if count == 1 else ""
            raise ValueError(
                f"trace: base_tension must hold tensions, N, of the shape {one}(steps, {count}) for this body, got the "
                f"shape {shape}"
            )
        return tension, ()
    if len(entries) != count:
        raise ValueError(
            f"trace: with targets, base_tension must hold one entry per tendon ({count}), got {len(entries)}; "
            "give [Displacement(lengths[:, 0]), Displacement(lengths[:, 1]), ...], or the tensions of a tendon"
        )
    values = [as_numbers(getattr(entry, "value", entry), "trace: base_tension") for entry in entries]
    if any(value.shape != values[0].shape or value.ndim != 1 or value.size == 0 for value in values):
        shapes = ", ".join(str(value.shape) for value in values)
        raise ValueError(f"trace: each tendon must have one number for each step, got the shapes {shapes}")
    return jnp.stack(values, axis=1), driven


def check_moments(loads: Loads, num_steps: int) -> None:
    """Refuse three numbers on a path of three steps of a body in the plane: one moment (X, Y, Z), or one a step.

    Raises:
        ValueError: names the moment and the remedy.
    """
    moments = {"tip_moment": loads.tip_moment} | {f"points.{i}.moment": p.moment for i, p in enumerate(loads.points)}
    without = Loads(loads.tip_force, 0.0, loads.gravity, [PointLoad(p.arc_length, p.force) for p in loads.points])
    doubtful = [name for name, moment in moments.items() if np.shape(moment) == (3,)]
    if num_steps == 3 and loads.in_space and not without.in_space:
        raise ValueError(
            f"trace: loads.{doubtful[0]} holds three numbers for three steps; give a list of Loads, one for each step, "
            "or for one moment (X, Y, Z) a tip_force of three components"
        )


def _resting(loads: Loads | Sequence[Loads] | None, along: Loads | None) -> Loads | None:
    """The loads that act before the first step, those without an axis of steps; None where there are none."""
    if along is None or not isinstance(loads, Loads):
        return None
    stays = jax.tree.map(lambda own, all_steps: np.ndim(own) < np.ndim(all_steps), loads, along)
    own = [load for load, stay in zip(_vectors(loads), _vectors(stays), strict=True) if stay]
    if not any(isinstance(load, Tracer) or np.any(np.asarray(load) != 0) for load in own):
        return None
    return jax.tree.map(lambda load, stay: load[0] if stay else jnp.zeros_like(load[0]), along, stays)


def _vectors(loads: Loads) -> list[Any]:
    """Forces, moments and gravity, without the places of point loads."""
    points = [load for point in loads.points for load in (point.force, point.moment)]
    return [loads.tip_force, loads.tip_moment, loads.gravity, *points]


def _loads(loads: Loads | Sequence[Loads] | None, num_steps: int, in_space: bool) -> Loads | None:
    """The loads after each step."""
    if loads is None:
        return None
    if not isinstance(loads, Loads):
        if not isinstance(loads, tuple | list) or not all(isinstance(entry, Loads) for entry in loads):
            raise TypeError(f"trace: loads must be a Loads or a list of them, got {type(loads).__name__}")
        if len(loads) != num_steps:
            raise ValueError(f"trace: there are {num_steps} steps and {len(loads)} loads; give one for each step")
        if len({len(entry.points) for entry in loads}) > 1:
            raise ValueError("trace: all loads of a path must have the same points; give those that do not act 0 N")
        return jax.tree.map(lambda *x: jnp.stack([jnp.asarray(value, float) for value in x]), *loads)

    def along(path: tuple, own: ArrayLike) -> Array:
        name, value = jax.tree_util.keystr(path, simple=True, separator="."), jnp.asarray(own, float)
        count = {"arc_length": 0, "tip_moment": int(in_space), "moment": int(in_space)}.get(name.split(".")[-1], 1)
        shape = value.shape[value.ndim - count :]
        most = count if name.endswith("arc_length") else count + 1  # a load does not move along the body
        if value.ndim > most or (value.ndim == count + 1 and value.shape[0] != num_steps):
            wanted = f"{shape} or {(num_steps, *shape)}" if most > count else "()"
            raise ValueError(f"trace: loads.{name} must have the shape {wanted}, got {value.shape}")
        return jnp.broadcast_to(value, (num_steps, *shape))

    return jax.tree_util.tree_map_with_path(along, loads)
