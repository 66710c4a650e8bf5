"""Targets: they take the place of a base tension, which is then found so that the target is reached."""

from collections.abc import Sequence
from typing import Any, ClassVar, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from ..mechanics.friction import PerTendon, unspent
from ..mechanics.march import finished
from ..mechanics.problem import (
    Number,
    Problem,
    Solution,
    geometry_of,
    guarded_section,
    strain_of,
    with_tip_force,
)
from ..mechanics.tendon_displacement import tendon_displacement
from ..numerics import tolerances as tol
from ..numerics.fixed_point import solve_small
from ..numerics.rotations import as_matrix, direction_of, length_of
from ..robot.cross_section import SpatialSection, where_present
from ..robot.manipulator import Manipulator
from ..robot.profiles import Scalar, as_number, as_optional_number
from .settle import Setup
from .system import missing_moment


@runtime_checkable
class Target(Protocol):
    """Takes the place of the base tension of one tendon, which is found so that `reading` becomes `value`."""

    quantity: ClassVar[str]  # its name in `quantities`
    value: Any  # Scalar, which pyright does not see in a field with a converter

    def reading(self, setup: Setup, problem: Problem, solution: Solution, tendon: int) -> Number:
        """The value in an equilibrium, in the unit of `value`; `tendon` is the index of the tendon, from 0."""
        ...

    def size(self, setup: Setup) -> Number:
        """The scale of a reading, for tolerances."""
        ...


class TipPosition(eqx.Module):
    """The position of the tip, in place of all base tensions. The tensions that reach it with the least sum are found.

    If no tensions reach it, the answer is the nearest position that was found. The search is local, from several
    starts: for a body that bends far it may miss tensions that come nearer.

    Args:
        value: (x, y) of the tip, m, or (x, y, z) in space.
        minimum_tension: the least tension, N, 0 or more, for all tendons or one each.
        maximum_tension: the largest tension, N, likewise; None for no limit.
    """

    quantity: ClassVar[str] = "tip_position"
    value: Any = eqx.field(converter=as_number)
    minimum_tension: Any = eqx.field(default=0.0, converter=as_number)
    maximum_tension: Any = eqx.field(default=None, converter=as_optional_number)

    def misses(self, setup: Setup, problem: Problem, solution: Solution) -> Float[Array, " components"]:
        """The tip's position less the wanted one, over the length."""
        position = finished(problem, solution).tip.position
        return (position - self.value) / jnp.asarray(setup.manipulator.length)

    def limits(self, scale: Number, like: PerTendon) -> tuple[PerTendon, PerTendon]:
        """The least and the most tension of each tendon, over a scale."""
        least = jnp.zeros_like(like) + jnp.asarray(self.minimum_tension, like.dtype) / scale
        if self.maximum_tension is None:
            return least, jnp.maximum(least, tol.FARTHEST)
        return least, jnp.zeros_like(like) + jnp.asarray(self.maximum_tension, like.dtype) / scale

    def on_the_side(self, setup: Setup) -> PerTendon:
        """How much each tendon bends the body towards the position, estimated from its arm at the base; 0.1 to 1.1."""
        aside = jnp.asarray(self.value)[1:]
        arms = setup.manipulator.arms(jnp.zeros_like(aside[0]))[:, 1 : 1 + aside.size]
        size = jnp.linalg.norm(arms, axis=1) * jnp.linalg.norm(aside)
        return 0.1 + jnp.maximum(arms @ aside / jnp.maximum(size, jnp.finfo(size.dtype).tiny), 0.0)


Actuation = ArrayLike | Target | TipPosition | Sequence[ArrayLike | Target]  # for all tendons, or one entry per tendon


class Displacement(eqx.Module):
    """The length of this tendon pulled in at its actuator since the straight body, m, as set by a micrometer."""

    quantity: ClassVar[str] = "displacement"
    value: Scalar = eqx.field(converter=as_number)

    def reading(self, setup: Setup, problem: Problem, solution: Solution, tendon: int) -> Number:
        return tendon_displacement(problem, solution.nodes)[tendon]

    def size(self, setup: Setup) -> Number:
        length = jnp.asarray(setup.manipulator.length)
        return jnp.maximum(jnp.max(setup.manipulator.offset(0.0 * length)), 1e-3 * length)


class TipAngle(eqx.Module):
    """The heading of the tip phi(L), rad; in space the angle between tip and base, from 0 to pi."""

    quantity: ClassVar[str] = "tip_angle"
    value: Scalar = eqx.field(converter=as_number)

    def reading(self, setup: Setup, problem: Problem, solution: Solution, tendon: int) -> Number:
        return problem.geometry.tip_angle(finished(problem, solution).tip.heading)

    def size(self, setup: Setup) -> Number:
        return jnp.ones_like(jnp.asarray(setup.manipulator.length))


class TipTension(eqx.Module):
    """The tension of this tendon at its anchor, N."""

    quantity: ClassVar[str] = "tip_tension"
    value: Scalar = eqx.field(converter=as_number)

    def reading(self, setup: Setup, problem: Problem, solution: Solution, tendon: int) -> Number:
        left = unspent(problem.base_tension, solution.tip.pull)
        if solution.tip.pull.spent is not None:  # for a slack tendon, a tension below zero gives the search a direction
            left = jnp.where(jnp.asarray(self.value) >= 0, problem.base_tension - solution.tip.pull.spent, left)
        return left[tendon] / solution.tip.ratio[tendon]

    def size(self, setup: Setup) -> Number:
        return jnp.abs(jnp.asarray(self.value)) + 1e-3 * bending_tension(setup.manipulator)


class TotalTension(eqx.Module):
    """The sum of all base tensions, N: how hard antagonists pull against each other."""

    quantity: ClassVar[str] = "total_tension"
    value: Scalar = eqx.field(converter=as_number)

    def reading(self, setup: Setup, problem: Problem, solution: Solution, tendon: int) -> Number:
        return jnp.sum(problem.base_tension)

    def size(self, setup: Setup) -> Number:
        return jnp.abs(jnp.asarray(self.value)) + 1e-3 * bending_tension(setup.manipulator)


class CurvatureAt(eqx.Module):
    """The curvature kappa, 1/m, at one arc length, m.

    In space it is the size of the bending beyond `rest_curvature`, without the twist: 0 or more.
    """

    quantity: ClassVar[str] = "curvature"
    value: Scalar = eqx.field(converter=as_number)
    arc_length: Scalar = eqx.field(converter=as_number)

    def reading(self, setup: Setup, problem: Problem, solution: Solution, tendon: int) -> Number:
        arc_length = problem.elements.before_edge(jnp.asarray(self.arc_length, problem.elements.edges.dtype))
        state = problem.elements.interpolate(*solution.states, arc_length)
        section = guarded_section(setup.manipulator, arc_length)
        strain = strain_of(section, problem.base_tension, state)
        return length_of((strain - section.rest)[1:3]) if isinstance(section, SpatialSection) else strain

    def size(self, setup: Setup) -> Number:
        return 1.0 / jnp.asarray(setup.manipulator.length)


class TipStiffness(eqx.Module):
    """Force per deflection across the tip at constant base tensions, N/m: 1 / (n . C n), see `tip_compliance`.

    In space n lies in the plane of the axes of base and tip; where these are parallel, it is the y axis of the tip.
    """

    quantity: ClassVar[str] = "tip_stiffness"
    value: Scalar = eqx.field(converter=as_number)

    def reading(self, setup: Setup, problem: Problem, solution: Solution, tendon: int) -> Number:
        across = _across(solution.tip.heading)

        def tip(force, moment):
            there = eqx.tree_at(lambda problem: problem.base_moment, with_tip_force(problem, force), moment)
            solution = setup.method(there)
            return finished(there, solution).tip.position, missing_moment(there, solution)

        def by(force, moment):
            return jax.jvp(tip, (problem.outboard.tip, problem.base_moment), (force, moment))[1]

        none = jnp.zeros_like(problem.base_moment)
        units = jnp.eye(max(none.size, 1), dtype=none.dtype).reshape(-1, *none.shape)
        moved, missing = by(across, none)
        moved_by_moment, missing_by_moment = jax.vmap(lambda unit: by(jnp.zeros_like(across), unit))(units)
        moment, _ = solve_small(missing_by_moment.T, -missing)  # M_ext(0) follows so that M_ext(L) stays m
        return 1.0 / (across @ (moved + moment @ moved_by_moment))

    def size(self, setup: Setup) -> Number:
        return jnp.abs(jnp.asarray(self.value)) + jnp.finfo(float).tiny


def _across(heading: Array) -> Float[Array, " components"]:
    """The direction n of `TipStiffness`."""
    if heading.ndim == 0:
        return jnp.stack([-jnp.sin(heading), jnp.cos(heading)])
    axes = as_matrix(heading).T
    leaning = axes[0] * axes[0, 0] - jnp.eye(3, dtype=axes.dtype)[0]
    return jnp.where(length_of(leaning) > tol.PARALLEL, direction_of(leaning), axes[1])


def bending_tension(body: Manipulator) -> Number:
    """The least E J / d^2 along the tendons, N: the scale of tensions at which d kappa comes near 1."""
    arc_length = jnp.linspace(0.0, jnp.asarray(body.length), 17)
    section = jax.vmap(body.cross_section_in_space if body.in_space else body.cross_section)(arc_length)
    offset = jnp.maximum(section.offset, 1e-3 * jnp.asarray(body.length))
    return jnp.min(where_present(section, geometry_of(body).bending_stiffness(section)[:, None] / offset**2, jnp.inf))
