"""What has to be found before one pass solves a body: directions, the moment at the base, and sign changes.

Without derivatives: `balance` gives the result its derivatives, as implicit functions.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from ..mechanics.directions import find_directions, travel_under_tension
from ..mechanics.friction import PerTendon
from ..mechanics.problem import (
    Method,
    Nodal,
    Number,
    Problem,
    Solution,
    at_base,
    cut_into_panels,
    everywhere,
    lay_out,
    loaded_to,
    tendon_displacement,
)
from ..mechanics.sign_changes import Splits, changes_sign, locate, num_splits, only_if, unsplit
from ..numerics.arrays import largest_size, varying_as, zero_as
from ..numerics.implicit import without_derivative
from ..numerics.quadrature import Panels, follow_edges, redistribute, with_empty_panels
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from .corrector import Flag, LoadedBody, Trial, by_moment, start_from
from .load_path import LoadPath, follow_loads

MAX_ROUNDS = 6
MAX_MOVES = 12  # of panels that follow the sign changes from pass to pass; then MAX_ROUNDS more of settled bodies
ROUGHLY = 1e-2  # relative change in a pass below which panels follow the sign changes at once
SETTLED = 1e-6  # of the length: a kink that lies so far off a panel's end costs 1e-12


class Setup(eqx.Module):
    """A manipulator, its loads, and how it is to be solved."""

    manipulator: Manipulator
    direction: PerTendon  # any where it is to be found
    loads: Loads | None
    method: Method
    nodes: int = eqx.field(static=True)
    to_find: tuple[int, ...] = eqx.field(default=(), static=True)  # the tendons whose direction is not stated

    def lay_out(self, base_tension: PerTendon, splits: Splits | None) -> Problem:
        """The problem under the full loads, with panels that end at `splits` as well."""
        at = self.manipulator, base_tension, self.direction, self.nodes, self.loads
        return lay_out(*at, splits.arc_length if splits is not None and splits.arc_length.size else None)

    def sliding(self, direction: PerTendon) -> "Setup":
        """The same with other directions."""
        return eqx.tree_at(lambda setup: setup.direction, self, direction)


class Settled(NamedTuple):
    """What was found for given base tensions."""

    direction: PerTendon
    load_path: LoadPath
    splits: Splits
    trial: Trial | None  # the values at the nodes; None without loads

    @property
    def guess(self) -> Nodal | None:
        """From which a method may start."""
        return None if self.trial is None else self.trial.nodal


def place(setup: Setup, base_tension: PerTendon, settled: Settled) -> Problem:
    """The problem that one pass solves. Where the path of the loads ended early, it is under the loads of its end."""
    problem = setup.sliding(settled.direction).lay_out(base_tension, settled.splits)
    if setup.loads is None:
        return problem
    found = settled.load_path
    fraction = jnp.where(found.converged, 1.0, found.fraction)
    return loaded_to(problem, fraction, found.base_moment * problem.moment_scale)


def travel_of(setup: Setup, problem: Problem, solution: Solution, settled: Settled) -> PerTendon:
    """The travel of each tendon by which its direction is judged, m."""
    if settled.trial is None:
        travel = tendon_displacement(problem, solution)
    else:
        body = LoadedBody(without_derivative(problem), setup.method)
        travel = body.travel(settled.trial, jnp.ones_like(settled.load_path.fraction))
    return travel_under_tension(problem, solution, travel)


def unsettled(setup: Setup, base_tension: PerTendon) -> Settled:
    """Where `settle` starts: no loads, no sign changes."""
    zero = zero_as(setup, base_tension)
    true = zero == 0
    splits = varying_as(unsplit(setup.manipulator, setup.loads), zero)
    load_path = LoadPath(
        base_moment=zero,
        fraction=zero + 1.0 if setup.loads is None else zero,
        num_steps=zero,
        converged=true,
        stable=true,
        resolved=true,
    )
    direction = setup.direction + zero
    if setup.loads is None:
        return Settled(direction, load_path, splits, None)
    guess = everywhere(_cut(setup, splits), Nodal(jnp.ones_like(base_tension), zero))
    return Settled(direction, load_path, splits, start_from(guess, zero, num_slopes=1))


def _cut(setup: Setup, splits: Splits) -> Panels:
    return cut_into_panels(setup.manipulator, setup.nodes, splits.arc_length)


def settle(setup: Setup, base_tension: PerTendon) -> Settled:
    """Directions that are not stated, base moment, and sign changes until they stay where they are. No derivatives."""
    if not setup.to_find:
        return _settle_as_stated(setup, base_tension)[0]

    def attempt(direction: PerTendon) -> tuple[Settled, PerTendon, Flag]:
        there = setup.sliding(direction)
        settled, travel = _settle_as_stated(there, base_tension)
        if settled.trial is not None:
            problem = place(there, base_tension, settled)
            travel = travel_of(there, problem, there.method.improve(problem, settled.trial.nodal), settled)
        assert travel is not None
        return settled, travel, settled.load_path.converged

    blank = unsettled(setup, base_tension)
    return find_directions(setup.manipulator, base_tension, blank.direction, setup.to_find, attempt, blank)


def _settle_as_stated(setup: Setup, base_tension: PerTendon) -> tuple[Settled, PerTendon | None]:
    """With the directions of the setup; and the travel of each tendon, if directions are to be found without loads."""
    start = unsettled(setup, base_tension)
    if setup.loads is not None:
        return _settle_loaded(setup, base_tension, start.load_path.fraction), None
    if num_splits(setup.manipulator, None) == 0:
        return start, None
    return _settle_unloaded(setup, base_tension, start)


# --- without loads -------------------------------------------------------------------------------


class _Round(NamedTuple):
    settled: Settled
    travel: PerTendon | None  # None where all directions are stated
    moved: Number  # how far the sign changes moved, of the length
    num_rounds: Number


def _settle_unloaded(setup: Setup, base_tension: PerTendon, start: Settled) -> tuple[Settled, PerTendon | None]:
    """Solve, and solve again on panels that end at the sign changes, until these stay where they are."""

    def once(state: _Round) -> _Round:
        old = state.settled
        problem = setup.lay_out(base_tension, old.splits)
        solution = setup.method(problem)
        load_path = old.load_path._replace(converged=solution.converged)
        new = old._replace(load_path=load_path, splits=locate(problem, solution))
        travel = travel_of(setup, problem, solution, new) if setup.to_find else None
        return _Round(new, travel, _distance(new.splits, old.splits, problem.panels), state.num_rounds + 1.0)

    def goes_on(state: _Round) -> Flag:
        converged = state.settled.load_path.converged
        return (state.moved > SETTLED) & (state.num_rounds < MAX_ROUNDS) & converged

    zero = start.load_path.num_steps
    travel = base_tension + zero if setup.to_find else None
    end = jax.lax.while_loop(goes_on, once, _Round(start, travel, zero + jnp.inf, zero))
    return end.settled, end.travel


def _distance(new: Splits, old: Splits, cut: Panels) -> Number:
    return largest_size(new.arc_length - old.arc_length) / cut.edges[-1]


# --- under loads ---------------------------------------------------------------------------------


class _Following(NamedTuple):
    """Passes over panels that follow the sign changes."""

    trial: Trial
    splits: Splits  # the sign changes
    ends: Splits  # where the panels end on which they were found
    moved: Number  # the distance between the two, of the length
    num_moves: Number


def _settle_loaded(setup: Setup, base_tension: PerTendon, zero: Number) -> Settled:
    """Along the path of the loads, then with panels that follow the sign changes from pass to pass.

    On the way the panels end where the body is not smooth, and nowhere else. A body without sign changes settles there.
    """
    problem = setup.lay_out(base_tension, None)
    body = LoadedBody(problem, setup.method)
    found, near = follow_loads(body, everywhere(problem.panels, at_base(problem)), zero)
    smooth = ~changes_sign(problem, body.solution(near, found.fraction))
    near = body.polish(near, found.fraction, found.converged & smooth)
    start = _first_following(setup, problem, body.solution(near, found.fraction), near, zero)

    def goes_on(state: _Following) -> Flag:
        in_place = (state.moved <= SETTLED) | (state.num_moves >= MAX_MOVES + MAX_ROUNDS)
        return found.converged & ~state.trial.lost & ~(state.trial.settled & in_place)

    follow = partial(_follow_sign_changes, setup, base_tension, found.fraction)
    trial, splits, *_ = jax.lax.while_loop(goes_on, follow, start)
    found = found._replace(
        base_moment=trial.moment,
        converged=found.converged & trial.settled,
        stable=jnp.where(trial.num_passes > 0, trial.stable, found.stable),
        resolved=found.resolved & trial.sane,
    )
    return Settled(setup.direction + zero, found, splits, trial)


def _first_following(setup: Setup, problem: Problem, solution: Solution, near: Trial, zero: Number) -> _Following:
    """The sign changes of the body at the end of the path, and its values on panels that end there."""
    splits = locate(problem, solution)
    moved = jnp.where(largest_size(splits.owner + 1.0) > 0, zero + jnp.inf, zero)
    old, new = problem.panels, _cut(setup, splits)

    def redistributed(zero: Number) -> Trial:
        cut = Panels(new.edges + zero, new.order)
        return _on_other_panels(near, problem, solution, partial(redistribute, old, cut))

    unmoved = _on_other_panels(near, problem, solution, partial(with_empty_panels, old, new))
    return _Following(only_if(moved > 0, redistributed, unmoved), splits, splits, moved, zero)


def _follow_sign_changes(setup: Setup, base_tension: PerTendon, fraction: Number, state: _Following) -> _Following:
    """Move the panels to the sign changes if it is time, make one pass, and locate the sign changes again.

    Panels follow at once where the passes are calm. Where sign changes come and go, the panels follow only from one
    settled body to the next.
    """
    calm = (state.num_moves < MAX_MOVES) & (state.trial.change <= ROUGHLY)
    move = (state.moved > SETTLED) & (state.trial.settled | calm)
    ends = jax.tree.map(lambda a, b: jnp.where(move, a, b), state.splits, state.ends)
    num_moves = state.num_moves + jnp.where(move, 1.0, 0.0)
    problem = setup.lay_out(base_tension, ends)
    guess = follow_edges(_cut(setup, state.ends), problem.panels, state.trial.nodal)
    start = state.trial._replace(nodal=guess, num_passes=jnp.where(move, 0.0, state.trial.num_passes))
    trial, solution = LoadedBody(problem, setup.method).correct(start, fraction)
    splits = locate(problem, solution)
    new = _Following(trial, splits, ends, _distance(splits, ends, problem.panels), num_moves)
    kept = jax.tree.map(lambda a, b: jnp.where(trial.lost, a, b), state, new)
    return kept._replace(trial=kept.trial._replace(lost=trial.lost))


def _on_other_panels(
    trial: Trial, problem: Problem, solution: Solution, moved: Callable[[PyTree, PyTree], PyTree]
) -> Trial:
    """The trial with the values that `moved` makes of those at nodes and tip, and slopes by M_ext(0) only."""
    nodal_slopes, heading_slopes = by_moment(trial.nodal_slopes), by_moment(trial.heading_slopes)
    at_tip = Nodal(solution.tip.ratio, solution.tip.moment / problem.moment_scale)
    values = moved(trial.nodal, at_tip)
    nodal_slopes = moved(nodal_slopes, jax.tree.map(lambda x: x[-1, -1], nodal_slopes))
    heading_slopes = heading_slopes._replace(nodes=moved(heading_slopes.nodes, heading_slopes.tip))
    blank = start_from(values, jnp.zeros_like(trial.moment), num_slopes=1)
    return blank._replace(
        moment=trial.moment,
        nodal_slopes=jax.tree.map(lambda x: x[None], nodal_slopes),
        residual_slopes=trial.residual_slopes[:1],
        heading_slopes=jax.tree.map(lambda x: x[None], heading_slopes),
        settled=trial.settled,
        change=trial.change,
    )
