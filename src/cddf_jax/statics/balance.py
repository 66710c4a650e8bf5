"""A body in equilibrium, with its derivatives by the implicit function theorem."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..mechanics.directions import travel_under_tension
from ..mechanics.friction import PerTendon
from ..mechanics.march import finished
from ..mechanics.problem import BodyStates, Number, Problem, Solution, State, all_points, nodal, strain_of
from ..mechanics.tendon_displacement import tendon_displacement
from ..numerics.fixed_point import Unknowns, implicit, without_derivative
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


def equilibrate(setup: Setup, base_tension: PerTendon) -> Balance:
    """Shape and tensions under given base tensions and loads, with implicit derivatives."""
    return balance(setup, base_tension, settle(*without_derivative((setup, base_tension))))


class System(eqx.Module):
    """One march, and the equations of the equilibrium, as `implicit` takes them.

    The unknowns are the tensions that were searched for and the base moment.
    """

    setup: Setup
    base_tension: PerTendon
    settled: Settled
    equations: Equations
    unknown: tuple[int, ...] = eqx.field(static=True)

    @property
    def root(self) -> Unknowns:
        """The unknowns that were found."""
        moment = [] if self.setup.loads is None else [jnp.atleast_1d(self.settled.load_path.base_moment)]
        return jnp.concatenate([*[self.base_tension[i, None] for i in self.unknown], *moment, self.base_tension[:0]])

    def problem(self, unknowns: Unknowns) -> Problem:
        """The problem with some values of the unknowns."""
        tensions, moment = jnp.split(unknowns, [len(self.unknown)])
        path = self.settled.load_path
        if self.setup.loads is not None:
            path = path._replace(base_moment=moment.reshape(path.base_moment.shape))
        tension = self.base_tension.at[jnp.asarray(self.unknown)].set(tensions) if self.unknown else self.base_tension
        return place(self.setup, tension, self.settled._replace(load_path=path))

    def __call__(self, states: BodyStates | None, unknowns: Unknowns) -> tuple[BodyStates | None, Unknowns]:
        """Better states, and the residual."""
        return self.improved(states, unknowns)[0]

    def improved(
        self, states: BodyStates | None, unknowns: Unknowns
    ) -> tuple[tuple[BodyStates | None, Unknowns], tuple[Problem, Solution]]:
        """Better states and the residual; and the problem and the solution from which they follow.

        The residual: the equations of the targets and the residual moment at the tip.
        Without states the method solves the whole problem, with derivatives of its own.
        """
        problem, setup = self.problem(unknowns), self.setup
        if states is None:
            better, solution = None, setup.method(problem)
        else:
            found = setup.iteration.improve(problem, nodal(problem, states.nodes), states.nodes.strain)
            better, solution = found.states, finished(problem, found)
        residual = jnp.concatenate([self.equations(problem, solution), missing_moment(problem, solution)])
        return (better, residual), (problem, solution)


def missing_moment(problem: Problem, solution: Solution) -> Float[Array, " equations"]:
    """The residual moment at the tip, over the moment scale; empty without loads."""
    if problem.loads is None:
        return solution.tip.ratio[:0]
    return jnp.atleast_1d(moment_left_at_tip(problem, solution))


def balance(
    setup: Setup,
    base_tension: PerTendon,
    settled: Settled,
    unknown: tuple[int, ...] = (),
    equations: Equations = no_equations,
) -> Balance:
    """What was found, now with derivatives.

    Args:
        setup: the manipulator and its loads.
        base_tension: T_base, N, with derivatives where it is given, without where it was searched for.
        settled: what was found for these tensions.
        unknown: the tendons whose tension was searched for.
        equations: the residuals of the targets that are zero at these tensions, one for each; a pytree, see `implicit`.
    """
    system = System(setup, base_tension, settled, equations, unknown)
    found, states, root = settled.load_path, settled.states, system.root
    if states is not None or unknown:
        states, root = implicit(system, states, root, ~found.converged)
    problem = system.problem(root)
    if states is None:
        return _without_loads(problem, setup.method(problem), found)
    ended = settled.num_iterations, settled.change, found.resolved, settled.locked, settled.missed
    solution = finished(problem, Solution(states, *ended))
    grown = jnp.where(found.converged, settled.error_amplification, 1.0)
    return Balance(problem, solution, found, settled.travel, grown)


def _without_loads(problem: Problem, solution: Solution, path: LoadPath) -> Balance:
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
