"""A body in equilibrium, with its derivatives by the implicit function theorem."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..mechanics.friction import PerTendon
from ..mechanics.march import finished
from ..mechanics.problem import (
    BodyStates,
    Nodal,
    Number,
    Problem,
    Solution,
)
from ..mechanics.tendon_displacement import tendon_displacement
from ..numerics.fixed_point import Unknowns, implicit, solve_small, without_derivative
from .continuation import LoadPath
from .settle import Settled, Setup, settle
from .system import System


class Balance(NamedTuple):
    """A body in equilibrium."""

    problem: Problem
    solution: Solution
    load_path: LoadPath  # the end of the path of the loads
    travel: PerTendon  # the length pulled in, m; under loads its rate while all tensions rise in proportion
    error_amplification: Number  # the factor by which errors along the body grow; 1 without loads


def equilibrate(setup: Setup) -> Balance:
    """Shape and tensions under given base tensions and loads, with implicit derivatives."""
    return balance(setup, settle(without_derivative(setup)))


class SystemValues(NamedTuple):
    """What an equilibrium consists of: the fixed point of a `System`."""

    nodal: Nodal | None  # None without loads, as the states
    states: BodyStates | None
    unknowns: Unknowns


class Chord(eqx.Module):
    """The chord method: one iteration of a system, whose slopes stay those that were found."""

    system: System
    settled: Settled

    @property
    def found(self) -> SystemValues:
        """What the search found."""
        settled = self.settled
        unknowns = self.system.with_moment(settled.load_path.base_moment)
        return SystemValues(settled.nodal, settled.states, unknowns)

    def __call__(self, last: SystemValues) -> SystemValues:
        """Better values. Where nothing was found they are the constant `found`, which has zero derivatives."""
        slopes, good = self.settled.slopes, self.settled.load_path.converged
        strain = None if self.settled.states is None else self.settled.states.nodes.strain
        (better, residual), solution = self.system.improved(last.nodal, last.unknowns, strain)
        step = -solve_small(slopes.residual.T, residual)[0]
        states = None if last.states is None else solution.states
        new = SystemValues(slopes.moved(better, step), states, last.unknowns + step)
        return jax.tree.map(lambda x, old: jnp.where(good, x, jax.lax.stop_gradient(old)), new, self.found)


def balance(setup: Setup, settled: Settled) -> Balance:
    """What was found, now with derivatives.

    Args:
        setup: its tensions have derivatives where they are given, and none where they were searched for. Its equations
            are zero at these tensions, and a pytree, see `implicit`.
        settled: what was found for these tensions.
    """
    system, found = setup.system(settled), settled.load_path
    chord = Chord(system, settled)
    values = chord.found
    if values.unknowns.size:
        values = implicit(chord, values)
    problem = system.at(values.unknowns)
    if values.states is None:
        return _without_loads(problem, setup.method(problem), found)
    ended = settled.num_iterations, settled.change, found.resolved, settled.locked, settled.missed
    solution = finished(problem, Solution(values.states, *ended))
    grown = jnp.where(found.converged, settled.error_amplification, 1.0)
    return Balance(problem, solution, found, settled.travel, grown)


def _without_loads(problem: Problem, found: Solution, path: LoadPath) -> Balance:
    solution = finished(problem, found)
    converged = path.converged & solution.converged
    path = path._replace(converged=converged, resolved=converged)
    travel = tendon_displacement(problem, solution.nodes)
    return Balance(problem, solution, path, travel, jnp.ones_like(solution.residual))
