"""An equilibrium under loads near one that is known roughly: one march and one Newton step at a time.

The unknowns are the tensions that are searched for, N, and M_ext(0) over its scale. Their equations are those of the
targets, and M_ext(L) = m.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..mechanics.march import FixedPoint
from ..mechanics.problem import BodyStates, Method, Moment, Nodal, Number, Problem, Solution, nodal
from ..numerics import tolerances as tol
from ..numerics.arrays import computed_once, largest_size, relative_size, zero_as
from ..numerics.fixed_point import Unknowns, until

Tree = TypeVar("Tree")
Flag = Bool[Array, ""]
Equations = Callable[[Problem, Solution], Float[Array, " targets"]]  # the residuals of the targets


def no_equations(problem: Problem, solution: Solution) -> Float[Array, " 0"]:
    """No tension is unknown."""
    return solution.tip.ratio[:0]


class Slopes(NamedTuple):
    """Slopes by the unknowns, which stand along the leading axis."""

    nodal: Nodal | None  # None without loads
    residual: Float[Array, "unknowns equations"]

    def moved(self, values: Tree, step: Unknowns) -> Tree:
        """The values after a step of the unknowns."""
        return jax.tree.map(lambda x, slope: x + jnp.tensordot(step, slope, 1), values, self.nodal)

    def beside(self, unknowns: int, equations: int) -> "Slopes":
        """The same with further unknowns and equations before them, whose slopes are zero."""

        def more(slopes: Array, *others: int) -> Array:
            return jnp.pad(slopes, [(before, 0) for before in (unknowns, *others)])

        nodal = jax.tree.map(lambda x: more(x, *[0] * (x.ndim - 1)), self.nodal)
        return Slopes(nodal, more(self.residual, equations))


def no_slopes(nodal: Nodal | None, unknowns: int, equations: int, zero: Number) -> Slopes:
    """Slopes of a body that has not moved."""
    still = jax.tree.map(lambda x: jnp.zeros((unknowns, *x.shape), x.dtype) + zero, nodal)
    return Slopes(still, jnp.eye(unknowns, equations, dtype=zero.dtype) + zero)


class System(eqx.Module):
    """A body with unknown tensions and an unknown base moment."""

    method: Method
    problem: Problem  # under the loads at the end of their path
    equations: Equations
    unknown: tuple[int, ...] = eqx.field(static=True)  # the tendons whose tension is searched for

    def with_moment(self, moment: Moment) -> Unknowns:
        """The unknowns: the tensions of the problem, and a base moment over its scale."""
        tension = self.problem.base_tension
        loaded = [] if self.problem.loads is None else [jnp.atleast_1d(moment)]
        return jnp.concatenate([*[tension[i, None] for i in self.unknown], *loaded, tension[:0]])

    def at(self, unknowns: Unknowns) -> Problem:
        """The problem with some values of the unknowns."""
        tensions, moment = jnp.split(unknowns, [len(self.unknown)])
        problem, tension = self.problem, self.problem.base_tension
        if self.unknown:
            tension = tension.at[jnp.asarray(self.unknown)].set(tensions)
        if problem.loads is not None:
            moment = moment.reshape(problem.base_moment.shape) * problem.moment_scale
            problem = eqx.tree_at(lambda problem: problem.base_moment, problem, moment)
        return eqx.tree_at(lambda problem: problem.base_tension, problem, tension)

    def improved(
        self, last: Nodal | None, unknowns: Unknowns, strain: Array | None = None, before: Number | float = 0.0
    ) -> tuple[tuple[Nodal | None, Unknowns], Solution]:
        """Better values of the nodes and the residual, and the solution from which they follow.

        Without loads the method solves the whole problem, with derivatives of its own.

        Args:
            last: the values of the nodes.
            unknowns: where.
            strain: the elastic strain at the nodes, approximately.
            before: the relative change in the last iteration.
        """
        problem, better = self.at(unknowns), None
        if last is None:
            solution = self.method(problem)
        else:
            assert isinstance(self.method, FixedPoint)
            solution = self.method.improve(problem, last, strain, before)
            better = nodal(problem, solution.nodes)
        residual = jnp.concatenate([self.equations(problem, solution), missing_moment(problem, solution)])
        return (better, residual), solution

    def with_slopes(
        self, last: Nodal | None, unknowns: Unknowns, slopes: Slopes, *others: Any
    ) -> tuple[Nodal | None, Unknowns, Slopes, Solution]:
        """As `improved`; where tensions are searched for with better slopes, elsewhere with the same."""
        if not self.unknown:
            (better, residual), solution = self.improved(last, unknowns, *others)
            return better, residual, slopes, solution

        def push(*way):
            return jax.jvp(lambda *at: self.improved(*at, *others), (last, unknowns), way, has_aux=True)

        units = jnp.eye(unknowns.size, dtype=unknowns.dtype) + zero_as(unknowns, last)
        (better, residual), found, solution = jax.vmap(push, out_axes=(None, 0, None))(slopes.nodal, units)
        return better, residual, Slopes(*found), solution


class Polished(NamedTuple):
    """An iterate of `polish`."""

    unknowns: Unknowns
    nodal: Any  # a `Nodal`
    states: BodyStates  # of the last march
    slopes: Slopes
    residual: Float[Array, " equations"]
    missed: Number | float  # as in a `Solution`
    settled: Flag
    locked: Flag  # a tendon locks
    change: Number


def polish(system: System, start: Polished, turned: Array) -> tuple[Polished, Number]:
    """The equilibrium at constant tensions, by Newton's method for the base moment, and the number of iterations.

    Where no tension is searched for the slopes stay as they are (chord method). Elsewhere they improve with the values.

    Args:
        system: the body with its unknowns.
        start: a rough equilibrium.
        turned: the slopes of the headings by the base moment over its scale, approximately.
    """
    method = system.method
    assert isinstance(method, FixedPoint)
    tolerance = method.tolerance_of(system.problem)

    def again(last: Polished) -> tuple[Polished, Flag]:
        others = last.states.nodes.strain, last.change
        better, residual, slopes, solution = system.with_slopes(last.nodal, last.unknowns, last.slopes, *others)
        step, off = _moment_step(system, last.unknowns, residual, slopes, turned)
        change = jnp.maximum(solution.residual, off)
        settled, lost = solution.converged & (off <= tolerance), solution.locked | ~jnp.isfinite(change)
        if system.unknown:
            changed = relative_size(slopes.residual - last.slopes.residual, slopes.residual)
            settled &= changed <= tol.SAME_SLOPES * tolerance
        found = last.unknowns + step, slopes.moved(better, step), solution.states, slopes, residual, solution.missed
        return Polished(*found, settled, solution.locked, change), settled | lost

    return until(again, start, method.max_iterations)


def _moment_step(
    system: System, unknowns: Unknowns, residual: Array, slopes: Slopes, turned: Array
) -> tuple[Unknowns, Number]:
    """The Newton step of the base moment, at constant tensions; and the angle by which it turns the body, rad."""
    problem, tensions = system.problem, len(system.unknown)
    still, moment = jnp.split(unknowns, [tensions])
    targets = residual.size - moment.size
    every = moment, residual[targets:], slopes.residual[tensions:, targets:]
    moment, missing, by_moment = (x.reshape(*x.shape[:-1], *problem.base_moment.shape) for x in every)
    step, off = newton_step(problem, moment, missing, turned, by_moment)
    return jnp.concatenate([0.0 * still, jnp.atleast_1d(step)]), off


def missing_moment(problem: Problem, solution: Solution) -> Float[Array, " equations"]:
    """The residual moment at the tip, over the moment scale; empty without loads."""
    if problem.loads is None:
        return solution.tip.ratio[:0]
    return jnp.atleast_1d(moment_left_at_tip(problem, solution))


def moment_left_at_tip(problem: Problem, solution: Solution) -> Moment:
    """M_ext(L) - m over the moment scale."""
    return (solution.tip.moment - problem.outboard.tip_moment) / problem.moment_scale


def newton_step(
    problem: Problem, moment: Moment, residual: Moment, turned: Array, by_moment: Array
) -> tuple[Moment, Number]:
    """The Newton step of M_ext(0), and the largest angle by which it turns the body, rad."""
    exact = largest_size(residual) <= few_round_offs(residual)  # also where its slope vanishes
    step = computed_once(jnp.where(exact, 0.0, -problem.geometry.moment_for(by_moment, residual)))
    size, length = 1 + largest_size(moment), largest_size(step)
    angle = length * jnp.maximum(1 / size, largest_size(turned))
    return step, computed_once(jnp.where(length <= few_round_offs(step) * size, 0.0, angle))  # less than rounding


def few_round_offs(x: Array) -> float:
    """A relative error that is due to rounding."""
    return 4 * float(jnp.finfo(x.dtype).eps)
