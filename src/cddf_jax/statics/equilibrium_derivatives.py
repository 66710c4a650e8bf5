"""A body in equilibrium, with its derivatives by the implicit function theorem."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..mechanics.directions import travel_under_tension
from ..mechanics.friction import PerTendon
from ..mechanics.problem import (
    AnyState,
    Nodal,
    Number,
    Problem,
    Solution,
    State,
    all_points,
    cut_into_panels,
    nodal,
    strain_of,
)
from ..mechanics.sign_changes import turning_at_splits
from ..mechanics.space import path_rate
from ..mechanics.tendon_displacement import tendon_displacement
from ..numerics.arrays import largest
from ..numerics.implicit import Places, Unknowns, implicit, without_derivative
from ..robot.cross_section import AnySection, SpatialSection, where_present
from .corrector import magnitude, moment_left_at_tip
from .equilibrium_search import SETTLED, Settled, Setup, first_guess, place, settle
from .load_path import LoadPath

KINK = 10 * SETTLED**2  # rad: the error of a panel that ends SETTLED off a kink where kappa changes by 10 / L in L


class Balance(NamedTuple):
    """A body in equilibrium."""

    problem: Problem
    solution: Solution[State]
    load_path: LoadPath  # the end of the path of the loads
    travel: PerTendon  # the length pulled in, m; under loads its rate while all tensions rise in proportion
    leverage: Number  # the factor by which errors along the body grow; 1 without loads


def missing_moment(problem: Problem, solution: Solution[AnyState]) -> Float[Array, " equations"]:
    """The residual moment at the tip, over the moment scale; empty without loads."""
    if problem.loads is None:
        return solution.tip.ratio[:0]
    return jnp.atleast_1d(moment_left_at_tip(problem, solution))


def equilibrate(setup: Setup, base_tension: PerTendon) -> Balance:
    """Shape and tensions under given base tensions and loads, with implicit derivatives."""
    return balance(setup, base_tension, settle(*without_derivative((setup, base_tension))))


Equations = Callable[[Problem, Solution[AnyState]], Float[Array, " unknown"]]


def no_equations(problem: Problem, solution: Solution[AnyState]) -> Float[Array, " 0"]:
    """No tension is unknown."""
    return solution.tip.ratio[:0]


class _There(NamedTuple):
    """What a pass has found, for `System.moved`."""

    problem: Problem
    solution: Solution[AnyState]
    rate: Float[Array, " places"]  # of the turning along s, at the sign changes


class System(eqx.Module):
    """One pass, and the equations of the equilibrium, as `implicit` takes them.

    The unknowns are the tensions that were searched for and the base moment; the places are the sign changes.
    """

    setup: Setup
    base_tension: PerTendon
    settled: Settled
    equations: Equations
    unknown: tuple[int, ...] = eqx.field(static=True)
    whole: bool = eqx.field(default=False, static=True)  # whether the equations need frame and position

    @property
    def strain(self) -> Array | None:
        """The elastic strain at the nodes, approximately; None where it has a closed form."""
        return None if self.settled.trial is None else self.settled.trial.strain

    @property
    def root(self) -> Unknowns:
        """The unknowns that were found."""
        moment = [] if self.setup.loads is None else [jnp.atleast_1d(self.settled.load_path.base_moment)]
        return jnp.concatenate([*[self.base_tension[i, None] for i in self.unknown], *moment, self.base_tension[:0]])

    @property
    def places(self) -> Places:
        """The sign changes that were found, m."""
        return self.settled.splits.arc_length

    def problem(self, unknowns: Unknowns, places: Places) -> Problem:
        """The problem with some values of the unknowns, and panels that end at some places."""
        tensions, rest = jnp.split(unknowns, [len(self.unknown)])
        load_path, splits = self.settled.load_path, self.settled.splits._replace(arc_length=places)
        if self.setup.loads is not None:
            load_path = load_path._replace(base_moment=rest if self.setup.manipulator.in_space else rest[0])
        tension = self.base_tension.at[jnp.asarray(self.unknown)].set(tensions) if self.unknown else self.base_tension
        return place(self.setup, tension, self.settled._replace(load_path=load_path, splits=splits))

    def __call__(
        self, values: Nodal | None, unknowns: Unknowns, places: Places
    ) -> tuple[tuple[Nodal | None, Unknowns, Places], _There]:
        """Better values, the residual, and the turning at the sign changes."""
        (better, residual), (problem, solution) = self.improved(values, unknowns, places)
        turning, rate = turning_at_splits(problem, solution, self.settled.splits._replace(arc_length=places))
        return (better, residual, turning), _There(problem, solution, rate)

    def improved(
        self, values: Nodal | None, unknowns: Unknowns, places: Places
    ) -> tuple[tuple[Nodal | None, Unknowns], tuple[Problem, Solution[AnyState]]]:
        """Better values and the residual; and the problem and the solution from which they follow.

        The residual: the equations of the targets and the residual moment at the tip.
        Without values the method solves the whole problem, with derivatives of its own.
        """
        problem, method = self.problem(unknowns, places), self.setup.method
        improve = method.finish if self.whole else method.improve
        solution = method(problem) if values is None else improve(problem, values, self.strain)
        residual = jnp.concatenate([self.equations(problem, solution), missing_moment(problem, solution)])
        return (None if values is None else nodal(problem, solution.nodes), residual), (problem, solution)

    def moved(self, there: _There, places: Places, vanishing: Places) -> tuple[Nodal, Places]:
        """The slopes of the values at the nodes, which move with the sign changes, and those of the sign changes."""
        problem, solution, rate = there
        change = -vanishing / rate
        body, nodes = self.setup.manipulator, self.setup.nodes
        shift = jax.jvp(lambda places: cut_into_panels(body, nodes, places).nodes, (places,), (change,))[1]

        def carried(starts: Array, values: Array) -> Array:
            return shift.reshape(*shift.shape, *[1] * (values.ndim - 2)) * problem.panels.rate(starts, values)

        return jax.tree.map(carried, nodal(problem, solution.starts), nodal(problem, solution.nodes)), change


def balance(
    setup: Setup,
    base_tension: PerTendon,
    settled: Settled,
    unknown: tuple[int, ...] = (),
    equations: Equations = no_equations,
    whole: bool = False,
) -> Balance:
    """Solve once more with all values that were found, now with derivatives.

    Args:
        setup: the manipulator and its loads.
        base_tension: T_base, N, with derivatives where it is given, without where it was searched for.
        settled: what was found for these tensions.
        unknown: the tendons whose tension was searched for.
        equations: the residuals of the targets that are zero at these tensions, one for each; a pytree, see `implicit`.
        whole: whether the equations need frame and position.
    """
    trial, found, travel = settled.trial, settled.load_path, settled.travel
    if trial is None or travel is None:
        return _from_scratch(System(setup, base_tension, settled, equations, unknown, whole))
    start = first_guess(trial.nodal), None if trial.strain is None else jnp.zeros_like(trial.strain)
    here = trial.nodal, trial.strain
    values, strain = jax.tree.map(lambda x, guess: jnp.where(found.converged, x, guess), here, start)
    settled = settled._replace(trial=trial._replace(strain=strain))
    system = System(setup, base_tension, settled, equations, unknown, whole)
    values, root, places = implicit(system, values, system.root, system.places, ~found.converged)
    assert values is not None
    problem = system.problem(root, places)
    solution = setup.method.finish(problem, values, strain)
    changes = [solution.residual, jnp.where(jnp.any(settled.splits.owner >= 0), KINK, 0.0 * solution.residual)]
    changes += [] if setup.loads is None else [magnitude(moment_left_at_tip(problem, solution))]
    solution = replace(
        solution,
        num_iterations=jnp.maximum(trial.num_passes, solution.num_iterations),
        residual=largest(jnp.stack(changes)),
        converged=found.resolved & jnp.isfinite(solution.residual),
        locked=trial.locked,
    )
    return Balance(problem, solution, found, travel, jnp.where(found.converged, trial.leverage, 1.0))


def _from_scratch(system: System) -> Balance:
    """The same for a body without loads and sign changes, where only tensions were searched for."""
    found, root, places = system.settled.load_path, system.root, system.places
    nothing: Nodal | None = None
    if system.unknown:
        root = implicit(system, nothing, root, places, ~found.converged)[1]
    problem = system.problem(root, places)
    solution = system.setup.method(problem)
    found = found._replace(converged=found.converged & solution.converged)
    pull = solution.nodes.pull
    travel = travel_under_tension(problem, pull, tendon_displacement(problem, solution.nodes))
    return Balance(problem, solution, found, travel, jnp.ones_like(solution.residual))


def inside_of_bend(problem: Problem, solution: Solution[State]) -> Float[Array, " points"]:
    """The largest sigma d kappa of all tendons that are present, at base, nodes and tip.

    In space it is by how much the fibre at a tendon is shorter than the axis at rest.
    """

    def inside(section: AnySection, state: AnyState) -> Number:
        if isinstance(section, SpatialSection) and state.strain is not None:
            strain = section.rest + state.strain  # near enough
        else:
            strain = strain_of(section, problem.base_tension, state)
        if isinstance(section, SpatialSection):
            shorter = 1.0 - path_rate(section, strain)[:, 0]
        else:
            shorter = section.side * section.offset * strain
        return jnp.max(where_present(section, shorter, -jnp.inf))

    return jax.vmap(inside)(*all_points(problem, solution))
