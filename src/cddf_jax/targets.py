"""What may be given in place of a base tension: something that is to be reached, and the tension found for it."""

from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp

from .balance import Setup, missing_moment
from .friction import unspent
from .problem import Number, Path, Problem, curvature_of, guarded_section, with_tip_force
from .profiles import Scalar, as_number
from .tendon_travel import tendon_displacement


@runtime_checkable
class Target(Protocol):
    """Stands for the base tension of one tendon, which is found so that `reading` becomes `value`."""

    value: Any

    def reading(self, setup: Setup, problem: Problem, path: Path, tendon: int) -> Number:
        """What an equilibrium gives, in the unit of `value`; `tendon` is the place at which the target stands."""
        ...

    def size(self, setup: Setup) -> Number:
        """What counts as a large reading."""
        ...


class Displacement(eqx.Module):
    """Length of this tendon pulled in at its actuator since the straight body, m, as a micrometer sets it."""

    value: Scalar = eqx.field(converter=as_number)

    def reading(self, setup: Setup, problem: Problem, path: Path, tendon: int) -> Number:
        return tendon_displacement(problem, path)[tendon]

    def size(self, setup: Setup) -> Number:
        return jnp.max(setup.manipulator.offset(0.0 * jnp.asarray(setup.manipulator.length)))


class TipAngle(eqx.Module):
    """The heading of the tip phi(L), rad."""

    value: Scalar = eqx.field(converter=as_number)

    def reading(self, setup: Setup, problem: Problem, path: Path, tendon: int) -> Number:
        return path.tip.heading

    def size(self, setup: Setup) -> Number:
        return jnp.ones_like(jnp.asarray(setup.manipulator.length))


class TipTension(eqx.Module):
    """The tension of this tendon at its anchor, N."""

    value: Scalar = eqx.field(converter=as_number)

    def reading(self, setup: Setup, problem: Problem, path: Path, tendon: int) -> Number:
        left = unspent(problem.base_tension, path.tip.pull)
        if path.tip.pull.spent is not None:  # where it is slack, a tension below zero shows the search the way
            left = jnp.where(jnp.asarray(self.value) >= 0, problem.base_tension - path.tip.pull.spent, left)
        return left[tendon] / path.tip.ratio[tendon]

    def size(self, setup: Setup) -> Number:
        return jnp.abs(jnp.asarray(self.value)) + 1e-3 * bending_tension(setup)


class TotalTension(eqx.Module):
    """The sum of all base tensions, N: how hard antagonists pull against each other."""

    value: Scalar = eqx.field(converter=as_number)

    def reading(self, setup: Setup, problem: Problem, path: Path, tendon: int) -> Number:
        return jnp.sum(problem.base_tension)

    def size(self, setup: Setup) -> Number:
        return jnp.abs(jnp.asarray(self.value)) + 1e-3 * bending_tension(setup)


class CurvatureAt(eqx.Module):
    """The curvature kappa, 1/m, at one arc length, m."""

    value: Scalar = eqx.field(converter=as_number)
    arc_length: Scalar = eqx.field(converter=as_number)

    def reading(self, setup: Setup, problem: Problem, path: Path, tendon: int) -> Number:
        arc_length = jnp.asarray(self.arc_length, problem.panels.edges.dtype)
        state = problem.panels.interpolate(path.starts, path.nodes, arc_length)
        return curvature_of(problem, guarded_section(setup.manipulator, arc_length), state.pull, state.moment)

    def size(self, setup: Setup) -> Number:
        return 1.0 / jnp.asarray(setup.manipulator.length)


class TipStiffness(eqx.Module):
    """Force per deflection across the tip at constant base tensions, N/m: 1 / (n . C n), see `tip_compliance`."""

    value: Scalar = eqx.field(converter=as_number)

    def reading(self, setup: Setup, problem: Problem, path: Path, tendon: int) -> Number:
        heading = path.tip.heading
        across = jnp.stack([-jnp.sin(heading), jnp.cos(heading)])

        def tip(force, moment):
            there = eqx.tree_at(lambda problem: problem.base_moment, with_tip_force(problem, force), moment)
            path = setup.method(there)
            return path.tip.position, missing_moment(there, path)[0]

        def by(force, moment):
            return jax.jvp(tip, (problem.outboard.tip, problem.base_moment), (force, moment))[1]

        none = jnp.zeros_like(problem.base_moment)
        by_force, by_moment = by(across, none), by(jnp.zeros_like(across), none + 1.0)
        deflection = by_force[0] - by_moment[0] * by_force[1] / by_moment[1]
        return 1.0 / (across @ deflection)

    def size(self, setup: Setup) -> Number:
        return jnp.abs(jnp.asarray(self.value)) + jnp.finfo(float).tiny


def bending_tension(setup: Setup) -> Number:
    """The least E J / d^2 along the tendons, N: a tension that bends some place about as far as the model goes."""
    body = setup.manipulator
    arc_length = jnp.linspace(0.0, 1.0, 17) * jnp.asarray(body.length)
    section = jax.vmap(body.cross_section)(arc_length)
    offset = jnp.maximum(section.offset, 1e-3 * jnp.asarray(body.length))
    return jnp.min(jnp.where(section.present, section.stiffness[:, None] / offset**2, jnp.inf))
