"""What has to be searched for before a body is in equilibrium: directions of sliding, and the moment at the base.

The search has no derivatives: `balance` gives them to the result, by the implicit function theorem.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..mechanics.directions import find_directions
from ..mechanics.friction import PerTendon
from ..mechanics.march import FixedPoint, unbent
from ..mechanics.problem import (
    BodyStates,
    Method,
    Nodal,
    Number,
    Problem,
    fibres_cross,
    lay_out,
    loaded_to,
    nodal,
)
from ..mechanics.tendon_displacement import tendon_displacement
from ..numerics.arrays import varying_as, zero_as
from ..numerics.fixed_point import Unknowns
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from .continuation import LoadPath, follow_loads
from .shooting import LoadedBody
from .system import Equations, Flag, Slopes, System, no_equations, no_slopes, polish


class Setup(eqx.Module):
    """What is to be solved, and how."""

    problem: Problem  # under all loads; a tension or direction that is to be found is any number
    rough: Problem | None  # likewise; None without loads
    method: Method
    to_find: tuple[int, ...] = eqx.field(static=True)  # the tendons whose direction is not stated
    unknown: tuple[int, ...] = eqx.field(static=True, default=())  # those whose tension is searched for
    equations: Equations = no_equations  # of the targets
    num_targets: int = eqx.field(static=True, default=0)

    @property
    def manipulator(self) -> Manipulator:
        """The body and its tendons."""
        return self.problem.manipulator

    @property
    def zero(self) -> Number:
        """0, which varies over the same devices of shard_map as what is given."""
        given = self.problem
        return zero_as(given.manipulator, given.base_tension, given.direction, given.loads)

    def system(self, settled: "Settled") -> System:
        """What an equilibrium has to fulfil. Where the path of the loads ended early, it is under those of its end."""
        problem, path = self.with_numbers(direction=settled.direction).problem, settled.load_path
        if problem.loads is not None:
            fraction = jnp.where(path.converged, 1.0, path.fraction)
            problem = loaded_to(problem, fraction, path.base_moment * problem.moment_scale)
        return System(self.method, problem, self.equations, self.unknown)

    def with_numbers(self, **numbers: PerTendon) -> "Setup":
        """The same with other numbers of its problems: base_tension, N, or direction."""
        problem, rough = (each and replace(each, **numbers) for each in (self.problem, self.rough))
        return replace(self, problem=problem, rough=rough)


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
    slopes: Slopes  # by the unknowns of the system; approximately, where no tension is searched for
    residual: Unknowns  # of the system
    crossing: Flag  # whether fibres cross; not known where no tension is searched for
    missed: Number | float  # as in a `Solution`
    change: Number  # in the last iteration, relative
    num_iterations: Number
    locked: Flag
    error_amplification: Number  # the factor by which errors along the body grow


def settle(setup: Setup) -> Settled:
    """Find the directions that are not stated, and the moment at the base; without derivatives."""
    settled = _loaded if setup.problem.loads is not None else _unloaded
    if not setup.to_find:
        return settled(setup)

    def attempt(direction: PerTendon) -> tuple[Settled, PerTendon, Flag]:
        found = settled(setup.with_numbers(direction=direction))
        return found, found.travel, found.load_path.converged

    start, tension = unsettled(setup), setup.problem.base_tension
    return find_directions(setup.manipulator, tension, start.direction, setup.to_find, attempt, start)


def unsettled(setup: Setup) -> Settled:
    """Where `settle` starts: no loads, no friction."""
    zero, problem = setup.zero, setup.problem
    loaded, true = problem.loads is not None, zero == 0
    moment = 0.0 * problem.base_moment + zero if loaded else zero
    states = varying_as(unbent(problem), zero) if loaded else None
    values = None if states is None else nodal(problem, states.nodes)
    moments = max(problem.base_moment.size, 1) if loaded else 0
    slopes = no_slopes(values, len(setup.unknown) + moments, setup.num_targets + moments, zero)
    return Settled(
        direction=problem.direction + zero,
        load_path=LoadPath(moment, zero if loaded else zero + 1.0, zero, converged=true, stable=true, resolved=true),
        travel=problem.base_tension + zero,
        nodal=values,
        states=states,
        slopes=slopes,
        residual=jnp.zeros(setup.num_targets + moments, zero.dtype) + zero,
        crossing=~true,
        missed=zero,
        change=zero,
        num_iterations=zero,
        locked=~true,
        error_amplification=zero + 1.0,
    )


def _loaded(setup: Setup) -> Settled:
    """Follow the loads on the rough body, then settle the body with its kinks."""
    assert setup.rough is not None
    assert isinstance(setup.method, FixedPoint)
    start = unsettled(setup)
    rough = LoadedBody(setup.rough, setup.method)
    path, end = follow_loads(rough, start.num_iterations)
    system = setup.system(start._replace(load_path=path))
    found, num_iterations = polish(
        system, rough.roughly(end, system, setup.num_targets), rough.headings(end.slopes[:-1])
    )
    moment = found.unknowns[len(setup.unknown) :].reshape(path.base_moment.shape)
    arrived = path.converged
    path = path._replace(
        base_moment=jnp.where(path.converged, moment, path.base_moment),
        converged=path.converged & found.settled,
        resolved=path.resolved & (found.settled | ~path.converged),
    )
    settled = partial(jnp.where, path.converged)
    return Settled(
        direction=start.direction,
        load_path=path,
        travel=rough.travel_rate(end, path.fraction),
        nodal=jax.tree.map(settled, found.nodal, start.nodal),
        states=jax.tree.map(settled, found.states, start.states),
        slopes=found.slopes,
        residual=found.residual,
        crossing=fibres_cross(system.at(found.unknowns), found.states) if setup.unknown else start.crossing,
        missed=found.missed,
        change=found.change,
        num_iterations=num_iterations,
        locked=end.locked | (arrived & found.locked),
        error_amplification=rough.error_amplification(end),
    )


def _unloaded(setup: Setup) -> Settled:
    """The travel of the tendons of a body without loads, and where tensions are searched for their slopes."""
    start, problem = unsettled(setup), setup.problem
    if not (setup.to_find or setup.unknown):
        return start
    system = setup.system(start)
    _, residual, slopes, found = system.with_slopes(None, system.with_moment(start.load_path.base_moment), start.slopes)
    return start._replace(
        travel=tendon_displacement(problem, found.nodes),
        load_path=start.load_path._replace(converged=found.converged),
        slopes=slopes,
        residual=residual,
        crossing=fibres_cross(problem, found.states) if setup.unknown else start.crossing,
    )
