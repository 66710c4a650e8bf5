"""A body in equilibrium, with derivatives through all that had to be found for it."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..mechanics.friction import PerTendon
from ..mechanics.problem import Number, Problem, Solution, all_points, curvature_of
from ..mechanics.sign_changes import Splits, turning_at_splits
from ..numerics.arrays import largest
from ..numerics.implicit import Unknowns, implicit, without_derivative
from .corrector import moment_left_at_tip
from .equilibrium_search import Settled, Setup, place, settle, travel_of
from .load_path import LoadPath


class Balance(NamedTuple):
    """A body in equilibrium."""

    problem: Problem
    solution: Solution
    load_path: LoadPath  # how the loads were put on
    travel: PerTendon  # by which tendons slide in as all tensions rise in proportion, m; without loads: slid in
    leverage: Number  # by which errors made along the body grow; 1 without loads


def missing_moment(problem: Problem, solution: Solution) -> Float[Array, " equations"]:
    """The residual moment at the tip, over the moment scale; empty without loads."""
    return solution.tip.moment[None][:0] if problem.loads is None else moment_left_at_tip(problem, solution)[None]


def equilibrate(setup: Setup, base_tension: PerTendon) -> Balance:
    """Shape and tensions under given base tensions and loads, with implicit derivatives."""
    return balance(setup, base_tension, settle(*without_derivative((setup, base_tension))))


Equations = Callable[[Problem, Solution], Float[Array, " unknown"]]


def no_equations(problem: Problem, solution: Solution) -> Float[Array, " 0"]:
    """No tension is unknown."""
    return solution.tip.ratio[:0]


class _Residual(eqx.Module):
    """The residual whose root is the equilibrium.

    Its unknowns are the tensions that were searched for, the base moment, and the places of sign changes.
    """

    setup: Setup
    base_tension: PerTendon
    settled: Settled
    equations: Equations
    unknown: tuple[int, ...] = eqx.field(static=True)

    def start(self) -> Unknowns:
        """The unknowns as they were found."""
        load_path, splits = self.settled.load_path, self.settled.splits
        moment = [] if self.setup.loads is None else [load_path.base_moment[None]]
        return jnp.concatenate([*[self.base_tension[i, None] for i in self.unknown], *moment, splits.arc_length])

    def problem(self, unknowns: Unknowns) -> tuple[Problem, Splits]:
        """The problem and its sign changes with some values of the unknowns."""
        load_path, splits = self.settled.load_path, self.settled.splits
        tensions, rest = jnp.split(unknowns, [len(self.unknown)])
        if self.setup.loads is not None:
            load_path, rest = load_path._replace(base_moment=rest[0]), rest[1:]
        splits = splits._replace(arc_length=rest)
        tension = self.base_tension.at[jnp.asarray(self.unknown)].set(tensions) if self.unknown else self.base_tension
        return place(self.setup, tension, self.settled._replace(load_path=load_path, splits=splits)), splits

    def __call__(self, unknowns: Unknowns) -> Unknowns:
        """The equations of the targets, the residual moment at the tip, and the turning at the sign changes."""
        problem, splits = self.problem(unknowns)
        solution = self.setup.method(problem, self.settled.guess)
        turning = turning_at_splits(problem, solution, splits)
        return jnp.concatenate([self.equations(problem, solution), missing_moment(problem, solution), turning])


def balance(
    setup: Setup,
    base_tension: PerTendon,
    settled: Settled,
    unknown: tuple[int, ...] = (),
    equations: Equations = no_equations,
) -> Balance:
    """Solve once more with all that was found, now with its derivatives.

    Args:
        setup: the manipulator and its loads.
        base_tension: T_base, N, with derivatives where it is given, without where it was searched for.
        settled: what was found for these tensions.
        unknown: the tendons whose tension was searched for.
        equations: the residuals of the targets that are zero at these tensions, one for each; a pytree, see `implicit`.
    """
    residual = _Residual(setup, base_tension, settled, equations, unknown)
    problem, _ = residual.problem(implicit(residual, residual.start()))
    solution = setup.method(problem, settled.guess)
    found = settled.load_path
    found = found._replace(converged=found.converged & solution.converged)
    travel = travel_of(setup, problem, solution, settled)
    if settled.trial is None:
        return Balance(problem, solution, found, travel, jnp.ones_like(solution.residual))
    changes = solution.residual, settled.trial.change, jnp.abs(moment_left_at_tip(problem, solution))
    solution = solution._replace(residual=largest(jnp.stack(changes)))
    leverage = jnp.where(found.converged, settled.trial.leverage, 1.0)
    return Balance(problem, solution, found, travel, leverage)


def inside_of_bend(problem: Problem, solution: Solution) -> Float[Array, " points"]:
    """Sigma d kappa at base, nodes and tip, the largest of all tendons that reach there."""

    def inside(section, state):
        kappa = curvature_of(problem, section, state.pull, state.moment)
        return jnp.max(jnp.where(section.present, section.side * section.offset * kappa, -jnp.inf))

    return jax.vmap(inside)(*all_points(problem, solution))
