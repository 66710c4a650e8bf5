"""What has to be searched for before a body is in equilibrium: directions of sliding, and the moment at the base.

The search has no derivatives: `balance` gives them to the result, by the implicit function theorem.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..mechanics.directions import find_directions, travel_under_tension
from ..mechanics.friction import PerTendon
from ..mechanics.march import FixedPoint, unbent
from ..mechanics.problem import BodyStates, Method, Nodal, Number, Problem, lay_out, loaded_to, nodal, state_at_nodes
from ..mechanics.tendon_displacement import tendon_displacement
from ..numerics.arrays import varying_as, zero_as
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from .continuation import LoadPath, follow_loads
from .shooting import Flag, LoadedBody, Slopes, no_slopes


class Setup(eqx.Module):
    """What is to be solved, and how."""

    problem: Problem  # under all loads; a tension or direction that is to be found is any number
    rough: Problem | None  # likewise; None without loads
    method: Method
    to_find: tuple[int, ...] = eqx.field(static=True)  # the tendons whose direction is not stated

    @property
    def manipulator(self) -> Manipulator:
        """The body and its tendons."""
        return self.problem.manipulator

    @property
    def zero(self) -> Number:
        """0, which varies over the same devices of shard_map as what is given."""
        given = self.problem
        return zero_as(given.manipulator, given.base_tension, given.direction, given.loads)

    @property
    def iteration(self) -> FixedPoint:
        """The method of a loaded body, whose iterations go on together with those of the moment at the base."""
        assert isinstance(self.method, FixedPoint)
        return self.method

    def pulled(self, base_tension: PerTendon) -> "Setup":
        """The same with other base tensions, N."""
        return _with(self, base_tension=base_tension)

    def sliding(self, direction: PerTendon) -> "Setup":
        """The same with other directions."""
        return _with(self, direction=direction)


def _with(setup: Setup, **number: PerTendon) -> Setup:
    """The same with another value of a number of its problems."""
    problem, rough = (each and replace(each, **number) for each in (setup.problem, setup.rough))
    return replace(setup, problem=problem, rough=rough)


def set_up(
    manipulator: Manipulator,
    base_tension: PerTendon,
    direction: PerTendon,
    loads: Loads | None,
    method: Method,
    nodes: int,
    to_find: tuple[int, ...],
) -> Setup:
    """Lay out the problems of a solve."""
    given = manipulator, base_tension, direction, nodes, loads
    return Setup(lay_out(*given), None if loads is None else lay_out(*given, rough=True), method, to_find)


class Settled(NamedTuple):
    """What was found for given base tensions."""

    direction: PerTendon
    load_path: LoadPath
    travel: PerTendon  # with which directions are compared, m
    nodal: Nodal | None  # the unknowns of the march, those of `unbent` where none were found; None without loads
    states: BodyStates | None  # along the body, likewise
    slopes: Slopes  # by the base moment, approximately; by tensions and base moment where tensions were searched for
    missed: Number | float  # as in a `Solution`
    change: Number  # in the last iteration, relative
    num_iterations: Number
    locked: Flag
    error_amplification: Number  # the factor by which errors along the body grow


def place(setup: Setup, settled: Settled) -> Problem:
    """The problem that one march solves. Where the path of the loads ended early, it is under the loads of its end."""
    problem = setup.sliding(settled.direction).problem
    if problem.loads is None:
        return problem
    found = settled.load_path
    fraction = jnp.where(found.converged, 1.0, found.fraction)
    return loaded_to(problem, fraction, found.base_moment * problem.moment_scale)


def settle(setup: Setup) -> Settled:
    """Find the directions that are not stated, and the moment at the base; without derivatives."""
    loaded = setup.problem.loads is not None
    if not setup.to_find:
        return _loaded(setup) if loaded else _nothing_to_find(setup)

    def attempt(direction: PerTendon) -> tuple[Settled, PerTendon, Flag]:
        settled = (_loaded if loaded else _unloaded)(setup.sliding(direction))
        return settled, settled.travel, settled.load_path.converged

    start, tension = unsettled(setup), setup.problem.base_tension
    return find_directions(setup.manipulator, tension, start.direction, setup.to_find, attempt, start)


def unsettled(setup: Setup) -> Settled:
    """Where `settle` starts: no loads, no friction."""
    start, problem = _nothing_to_find(setup), setup.problem
    if problem.loads is None:
        return start
    zero = start.num_iterations
    path = start.load_path._replace(base_moment=0.0 * problem.base_moment + zero, fraction=zero)
    states = varying_as(unbent(problem), zero)
    values = nodal(problem, states.nodes)
    count = max(problem.base_moment.size, 1)
    return start._replace(load_path=path, nodal=values, states=states, slopes=no_slopes(values, count, count, zero))


def _nothing_to_find(setup: Setup) -> Settled:
    """Without loads, and where all directions are stated."""
    zero = setup.zero
    true = zero == 0
    path = LoadPath(zero, zero + 1.0, zero, converged=true, stable=true, resolved=true)
    return Settled(
        direction=setup.problem.direction + zero,
        load_path=path,
        travel=setup.problem.base_tension + zero,
        nodal=None,
        states=None,
        slopes=no_slopes(None, 0, 0, zero),
        missed=zero,
        change=zero,
        num_iterations=zero,
        locked=~true,
        error_amplification=zero + 1.0,
    )


def _loaded(setup: Setup) -> Settled:
    """Follow the loads on the rough body, then settle the body with its kinks."""
    assert setup.rough is not None
    start = unsettled(setup)
    rough, body = (LoadedBody(problem, setup.iteration) for problem in (setup.rough, setup.problem))
    path, end = follow_loads(rough, start.num_iterations)
    pull = state_at_nodes(rough.problem, rough.nodal(end.values), end.strain).pull
    slopes = rough.slopes_by_moment(end, body)
    found, num_iterations = rough.refine(end, slopes, body, path.fraction)
    path = path._replace(
        base_moment=jnp.where(path.converged, found.moment, path.base_moment),
        converged=path.converged & found.settled,
        resolved=path.resolved & (found.settled | ~path.converged),
    )
    settled = partial(jnp.where, path.converged)
    return Settled(
        direction=start.direction,
        load_path=path,
        travel=travel_under_tension(rough.problem, pull, rough.travel_rate(end, path.fraction)),
        nodal=jax.tree.map(settled, found.nodal, start.nodal),
        states=jax.tree.map(settled, found.states, start.states),
        slopes=slopes,
        missed=found.missed,
        change=found.change,
        num_iterations=num_iterations,
        locked=end.locked | (found.lost & found.settled),
        error_amplification=rough.error_amplification(end),
    )


def _unloaded(setup: Setup) -> Settled:
    """The travel of the tendons of a body without loads."""
    problem = setup.problem
    found = setup.method(problem)
    travel = travel_under_tension(problem, found.nodes.pull, tendon_displacement(problem, found.nodes))
    start = _nothing_to_find(setup)
    return start._replace(travel=travel, load_path=start.load_path._replace(converged=found.converged))
