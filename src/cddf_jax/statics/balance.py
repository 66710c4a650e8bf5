"""A body in equilibrium, with its derivatives by the implicit function theorem."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..mechanics.directions import travel_under_tension
from ..mechanics.friction import PerTendon
from ..mechanics.march import FixedPoint, finished
from ..mechanics.problem import (
    BodyStates,
    Method,
    Nodal,
    Number,
    Problem,
    Solution,
    State,
    all_points,
    nodal,
    strain_of,
)
from ..mechanics.tendon_displacement import tendon_displacement
from ..numerics.fixed_point import Unknowns, implicit, solve_small, without_derivative
from ..robot.cross_section import AnySection, where_present
from .continuation import LoadPath
from .settle import Settled, Setup, place, settle
from .shooting import moment_left_at_tip


class Balance(NamedTuple):
    """A body in equilibrium."""

    problem: Problem
    solution: Solution
    load_path: LoadPath  # the end of the path of the loads
    travel: PerTendon  # the length pulled in, m; under loads its rate while all tensions rise in proportion
    error_amplification: Number  # the factor by which errors along the body grow; 1 without loads


Equations = Callable[[Problem, Solution], Float[Array, " unknown"]]


def no_equations(problem: Problem, solution: Solution) -> Float[Array, " 0"]:
    """No tension is unknown."""
    return solution.tip.ratio[:0]


def equilibrate(setup: Setup) -> Balance:
    """Shape and tensions under given base tensions and loads, with implicit derivatives."""
    return balance(setup, settle(without_derivative(setup)))


class SystemValues(NamedTuple):
    """What an equilibrium consists of: the fixed point of a `System`."""

    nodal: Nodal | None  # None without loads, as the states
    states: BodyStates | None
    unknowns: Unknowns


class System(eqx.Module):
    """The chord method for an equilibrium: one march, and one Newton step for the equations, with constant slopes.

    The unknowns are the tensions that were searched for and the base moment.
    """

    method: Method
    problem: Problem  # under the loads of the end of the path
    settled: Settled
    equations: Equations
    unknown: tuple[int, ...] = eqx.field(static=True)

    @property
    def found(self) -> SystemValues:
        """What the search found."""
        settled, tension = self.settled, self.problem.base_tension
        moment = [] if settled.nodal is None else [jnp.atleast_1d(settled.load_path.base_moment)]
        unknowns = jnp.concatenate([*[tension[i, None] for i in self.unknown], *moment, tension[:0]])
        return SystemValues(settled.nodal, settled.states, unknowns)

    def at(self, unknowns: Unknowns) -> Problem:
        """The problem with some values of the unknowns."""
        tensions, moment = jnp.split(unknowns, [len(self.unknown)])
        problem, tension = self.problem, self.problem.base_tension
        if self.unknown:
            tension = tension.at[jnp.asarray(self.unknown)].set(tensions)
        if self.settled.nodal is not None:
            moment = moment.reshape(problem.base_moment.shape) * problem.moment_scale
            problem = eqx.tree_at(lambda problem: problem.base_moment, problem, moment)
        return eqx.tree_at(lambda problem: problem.base_tension, problem, tension)

    def __call__(self, last: SystemValues) -> SystemValues:
        """One iteration. Where nothing was found it is the constant `found`, which has zero derivatives."""
        (better, residual), (_, solution) = self.improved(last.nodal, last.unknowns)
        slopes, good = self.settled.slopes, self.settled.load_path.converged
        step = -solve_small(slopes.residual.T, residual)[0]
        states = None if last.states is None else solution.states
        new = SystemValues(slopes.moved(better, step), states, last.unknowns + step)
        return jax.tree.map(lambda x, old: jnp.where(good, x, jax.lax.stop_gradient(old)), new, self.found)

    def improved(
        self, last: Nodal | None, unknowns: Unknowns
    ) -> tuple[tuple[Nodal | None, Unknowns], tuple[Problem, Solution]]:
        """Better values of the nodes and the residual; and the problem and the solution from which they follow.

        The residual: the equations of the targets and the residual moment at the tip.
        Without loads the method solves the whole problem, with derivatives of its own.
        """
        problem = self.at(unknowns)
        if last is None:
            better, solution = None, self.method(problem)
        else:
            assert isinstance(self.method, FixedPoint)
            assert self.settled.states is not None
            solution = self.method.improve(problem, last, self.settled.states.nodes.strain)
            better = nodal(problem, solution.nodes)
        residual = jnp.concatenate([self.equations(problem, solution), missing_moment(problem, solution)])
        return (better, residual), (problem, solution)


def missing_moment(problem: Problem, solution: Solution) -> Float[Array, " equations"]:
    """The residual moment at the tip, over the moment scale; empty without loads."""
    if problem.loads is None:
        return solution.tip.ratio[:0]
    return jnp.atleast_1d(moment_left_at_tip(problem, solution))


def balance(
    setup: Setup,
    settled: Settled,
    unknown: tuple[int, ...] = (),
    equations: Equations = no_equations,
) -> Balance:
    """What was found, now with derivatives.

    Args:
        setup: its tensions have derivatives where they are given, and none where they were searched for.
        settled: what was found for these tensions.
        unknown: the tendons whose tension was searched for.
        equations: the residuals of the targets that are zero at these tensions, one for each; a pytree, see `implicit`.
    """
    system = System(setup.method, place(setup, settled), settled, equations, unknown)
    found, values = settled.load_path, system.found
    if values.unknowns.size:
        values = implicit(system, values)
    problem = system.at(values.unknowns)
    if values.states is None:
        return _without_loads(problem, setup.method(problem), found)
    ended = settled.num_iterations, settled.change, found.resolved, settled.locked, settled.missed
    solution = finished(problem, Solution(values.states, *ended))
    grown = jnp.where(found.converged, settled.error_amplification, 1.0)
    return Balance(problem, solution, found, settled.travel, grown)


def _without_loads(problem: Problem, found: Solution, path: LoadPath) -> Balance:
    solution = finished(problem, found)
    path = path._replace(converged=path.converged & solution.converged)
    travel = travel_under_tension(problem, solution.nodes.pull, tendon_displacement(problem, solution.nodes))
    return Balance(problem, solution, path, travel, jnp.ones_like(solution.residual))


def inside_of_bend(problem: Problem, solution: Solution) -> Float[Array, " points"]:
    """The largest sigma d kappa of all tendons that are present, at base, nodes and tip.

    In space it is by how much the fibre at a tendon is shorter than the axis at rest.
    """

    def inside(section: AnySection, state: State) -> Number:
        strain = strain_of(section, problem.base_tension, state)
        return jnp.max(where_present(section, problem.geometry.inside(section, strain), -jnp.inf))

    return jax.vmap(inside)(*all_points(problem, solution))
