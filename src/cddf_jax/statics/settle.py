"""What has to be searched for before a body is in equilibrium: directions of sliding, and the moment at the base.

The search has no derivatives: `balance` gives them to the result, by the implicit function theorem.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..mechanics.directions import find_directions, travel_under_tension
from ..mechanics.friction import PerTendon
from ..mechanics.march import FixedPoint, unbent
from ..mechanics.problem import BodyStates, Method, Number, Problem, lay_out, loaded_to, state_at_nodes
from ..mechanics.tendon_displacement import tendon_displacement
from ..numerics.arrays import varying_as, zero_as
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from .continuation import LoadPath, follow_loads
from .shooting import Flag, LoadedBody


class Setup(eqx.Module):
    """A manipulator, its loads, and the settings of the solve."""

    manipulator: Manipulator
    direction: PerTendon  # any number for a tendon whose direction is to be found
    loads: Loads | None
    method: Method
    nodes: int = eqx.field(static=True)
    to_find: tuple[int, ...] = eqx.field(default=(), static=True)  # the tendons whose direction is not stated

    @property
    def iteration(self) -> FixedPoint:
        """The method of a loaded body, whose iterations go on together with those of the moment at the base."""
        assert isinstance(self.method, FixedPoint)
        return self.method

    def lay_out(self, base_tension: PerTendon, rough: bool = False) -> Problem:
        """The problem under the full loads."""
        return lay_out(self.manipulator, base_tension, self.direction, self.nodes, self.loads, rough=rough)

    def sliding(self, direction: PerTendon) -> "Setup":
        """The same with other directions."""
        return eqx.tree_at(lambda setup: setup.direction, self, direction)


class Settled(NamedTuple):
    """What was found for given base tensions."""

    direction: PerTendon
    load_path: LoadPath
    travel: PerTendon  # with which directions are compared, m
    states: BodyStates | None  # along the body, those of `unbent` where none was found; None without loads
    missed: Number | float  # as in a `Solution`
    change: Number  # in the last iteration, relative
    num_iterations: Number
    locked: Flag
    error_amplification: Number  # the factor by which errors along the body grow


def place(setup: Setup, base_tension: PerTendon, settled: Settled) -> Problem:
    """The problem that one march solves. Where the path of the loads ended early, it is under the loads of its end."""
    problem = setup.sliding(settled.direction).lay_out(base_tension)
    if setup.loads is None:
        return problem
    found = settled.load_path
    fraction = jnp.where(found.converged, 1.0, found.fraction)
    return loaded_to(problem, fraction, found.base_moment * problem.moment_scale)


def settle(setup: Setup, base_tension: PerTendon) -> Settled:
    """Find the directions that are not stated, and the moment at the base; without derivatives."""
    if not setup.to_find:
        return _loaded(setup, base_tension) if setup.loads is not None else _nothing_to_find(setup, base_tension)

    def attempt(direction: PerTendon) -> tuple[Settled, PerTendon, Flag]:
        solve = _loaded if setup.loads is not None else _unloaded
        settled = solve(setup.sliding(direction), base_tension)
        return settled, settled.travel, settled.load_path.converged

    start = unsettled(setup, base_tension)
    return find_directions(setup.manipulator, base_tension, start.direction, setup.to_find, attempt, start)


def unsettled(setup: Setup, base_tension: PerTendon) -> Settled:
    """Where `settle` starts: no loads, no friction."""
    start = _nothing_to_find(setup, base_tension)
    if setup.loads is None:
        return start
    zero = start.num_iterations
    problem = setup.lay_out(base_tension)
    path = start.load_path._replace(base_moment=0.0 * problem.base_moment + zero, fraction=zero)
    return start._replace(load_path=path, states=varying_as(unbent(problem), zero))


def _nothing_to_find(setup: Setup, base_tension: PerTendon) -> Settled:
    """Without loads, and where all directions are stated."""
    zero = zero_as(setup, base_tension)
    true = zero == 0
    path = LoadPath(zero, zero + 1.0, zero, converged=true, stable=true, resolved=true)
    return Settled(setup.direction + zero, path, base_tension + zero, None, zero, zero, zero, ~true, zero + 1.0)


def _loaded(setup: Setup, base_tension: PerTendon) -> Settled:
    """Follow the loads on the rough body, then settle the body with its kinks."""
    start = _nothing_to_find(setup, base_tension)
    rough, body = (LoadedBody(setup.lay_out(base_tension, each), setup.iteration) for each in (True, False))
    path, end = follow_loads(rough, start.num_iterations)
    pull = state_at_nodes(rough.problem, end.values.nodal, end.strain).pull
    found, num_iterations = rough.refine(end, body, path.fraction)
    path = path._replace(
        base_moment=jnp.where(path.converged, found.moment, path.base_moment),
        converged=path.converged & found.settled,
        resolved=path.resolved & (found.settled | ~path.converged),
    )
    return Settled(
        direction=start.direction,
        load_path=path,
        travel=travel_under_tension(rough.problem, pull, rough.travel_rate(end, path.fraction)),
        states=jax.tree.map(partial(jnp.where, path.converged), found.states, unbent(body.problem)),
        missed=found.missed,
        change=found.change,
        num_iterations=num_iterations,
        locked=end.locked | (found.lost & found.settled),
        error_amplification=rough.error_amplification(end),
    )


def _unloaded(setup: Setup, base_tension: PerTendon) -> Settled:
    """The travel of the tendons of a body without loads."""
    problem = setup.lay_out(base_tension)
    found = setup.method(problem)
    travel = travel_under_tension(problem, found.nodes.pull, tendon_displacement(problem, found.nodes))
    start = _nothing_to_find(setup, base_tension)
    return start._replace(travel=travel, load_path=start.load_path._replace(converged=found.converged))
