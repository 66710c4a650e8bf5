"""A body in equilibrium: what has to be known before one pass solves it, and derivatives through all of that."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .directions import find_directions, travel_under_tension
from .friction import PerTendon
from .implicit import Unknowns, implicit, without_derivative
from .load_path import LoadedBody, LoadPath, Trial, by_moment, follow_loads, moment_left_at_tip, start_from
from .loads import Loads
from .manipulator import Manipulator
from .problem import (
    Method,
    Nodal,
    Number,
    Path,
    Problem,
    all_points,
    at_base,
    curvature_of,
    cut_into_panels,
    everywhere,
    lay_out,
    loaded_to,
)
from .quadrature import Panels, follow_edges, redistribute, with_empty_panels
from .reductions import largest, largest_size
from .sign_changes import Splits, changes_sign, locate, num_splits, only_if, turning_at_splits, unsplit
from .tendon_travel import tendon_displacement
from .varying import zero_as

MAX_ROUNDS = 6
MAX_MOVES = 12  # of panels that follow the sign changes from sweep to sweep; then MAX_ROUNDS more of settled bodies
ROUGHLY = 1e-2  # relative change in a sweep that is not too large for panels to follow it
SETTLED = 1e-6  # of the length: a kink that lies so far off a panel's end costs 1e-12


class Setup(eqx.Module):
    """A manipulator, its loads, and how it is to be solved."""

    manipulator: Manipulator
    direction: PerTendon  # any where it is to be found
    loads: Loads | None
    method: Method
    nodes: int = eqx.field(static=True)
    to_find: tuple[int, ...] = eqx.field(default=(), static=True)  # the tendons whose direction is not stated


class Settled(NamedTuple):
    """What belongs to given base tensions: directions, base moment at the end of the path of loads, sign changes."""

    direction: PerTendon
    load_path: LoadPath
    splits: Splits
    trial: Trial | None  # the values at the nodes; None without loads

    @property
    def guess(self) -> Nodal | None:
        """Where a pass may start."""
        return None if self.trial is None else self.trial.nodal


class Balance(NamedTuple):
    """A body in equilibrium."""

    problem: Problem
    path: Path
    load_path: LoadPath  # how the loads were put on
    travel: PerTendon  # by which tendons slide in as all tensions rise in proportion, m; without loads: slid in
    leverage: Number  # by which errors made along the body grow; 1 without loads


def place(setup: Setup, base_tension: PerTendon, settled: Settled) -> Problem:
    """The problem that one pass solves; where the path of the loads ended early, under the loads of its end."""
    problem = _lay_out(_sliding(setup, settled.direction), base_tension, settled.splits)
    if setup.loads is None:
        return problem
    found = settled.load_path
    fraction = jnp.where(found.converged, 1.0, found.fraction)
    return loaded_to(problem, fraction, found.base_moment * problem.moment_scale)


def missing_moment(problem: Problem, path: Path) -> Float[Array, " equations"]:
    """What is missing of the moment at the tip; empty without loads."""
    return path.tip.moment[None][:0] if problem.loads is None else moment_left_at_tip(problem, path)[None]


def equilibrate(setup: Setup, base_tension: PerTendon) -> Balance:
    """Shape and tensions under given base tensions and loads, with implicit derivatives."""
    return balance(setup, base_tension, settle(*without_derivative((setup, base_tension))))


Equations = Callable[[Problem, Path], Float[Array, " unknown"]]


def no_equations(problem: Problem, path: Path) -> Float[Array, " 0"]:
    """No tension is unknown."""
    return path.tip.ratio[:0]


class _LeftOpen(eqx.Module):
    """What unknowns leave open of a body: tensions that were searched for, the base moment, sign changes."""

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

    def put(self, unknowns: Unknowns) -> tuple[Problem, Splits]:
        """The body with them."""
        load_path, splits = self.settled.load_path, self.settled.splits
        tensions, rest = jnp.split(unknowns, [len(self.unknown)])
        if self.setup.loads is not None:
            load_path, rest = load_path._replace(base_moment=rest[0]), rest[1:]
        splits = splits._replace(arc_length=rest)
        tension = self.base_tension.at[jnp.asarray(self.unknown)].set(tensions) if self.unknown else self.base_tension
        return place(self.setup, tension, self.settled._replace(load_path=load_path, splits=splits)), splits

    def __call__(self, unknowns: Unknowns) -> Unknowns:
        """What vanishes."""
        problem, splits = self.put(unknowns)
        path = self.setup.method(problem, self.settled.guess)
        turning = turning_at_splits(problem, path, splits)
        return jnp.concatenate([self.equations(problem, path), missing_moment(problem, path), turning])


def balance(
    setup: Setup,
    base_tension: PerTendon,
    settled: Settled,
    unknown: tuple[int, ...] = (),
    equations: Equations = no_equations,
) -> Balance:
    """One last pass, with the derivatives of everything that had to be known for it.

    Args:
        setup: the manipulator and its loads.
        base_tension: T_base, N, with derivatives where it is given, without where it was searched for.
        settled: what was found for these tensions.
        unknown: the tendons whose tension was searched for.
        equations: what vanishes at these tensions, one for each; a pytree, see `implicit`.
    """
    left_open = _LeftOpen(setup, base_tension, settled, equations, unknown)
    problem, _ = left_open.put(implicit(left_open, left_open.start()))
    path = setup.method(problem, settled.guess)
    found = settled.load_path
    found = found._replace(converged=found.converged & path.converged)
    travel = _travel(setup, problem, path, settled)
    if settled.trial is None:
        return Balance(problem, path, found, travel, jnp.ones_like(path.residual))
    changes = path.residual, settled.trial.change, jnp.abs(moment_left_at_tip(problem, path))
    path = path._replace(residual=largest(jnp.stack(changes)))
    leverage = jnp.where(found.converged, settled.trial.leverage, 1.0)
    return Balance(problem, path, found, travel, leverage)


def _travel(setup: Setup, problem: Problem, path: Path, settled: Settled) -> PerTendon:
    if settled.trial is None:
        travel = tendon_displacement(problem, path)
    else:
        body = LoadedBody(without_derivative(problem), setup.method)
        travel = body.travel(settled.trial, jnp.ones_like(settled.load_path.fraction))
    return travel_under_tension(problem, path, travel)


class _Round(NamedTuple):
    settled: Settled
    travel: PerTendon | None  # None where nobody asks
    moved: Number
    num_rounds: Number


class _Sweeping(NamedTuple):
    trial: Trial
    splits: Splits
    ends: Splits  # of the panels on which all that was found
    moved: Number  # how far they lie off each other
    num_moves: Number


def unsettled(setup: Setup, base_tension: PerTendon) -> Settled:
    """Where `settle` starts: no loads, no sign changes."""
    zero = zero_as(setup, base_tension)
    splits = jax.tree.map(lambda x: x + zero.astype(x.dtype), unsplit(setup.manipulator, setup.loads))
    fraction = zero + 1.0 if setup.loads is None else zero
    load_path = LoadPath(zero, fraction, zero, zero == 0, zero == 0, zero == 0)
    direction = setup.direction + zero
    if setup.loads is None:
        return Settled(direction, load_path, splits, None)
    guess = everywhere(_cut(setup, splits), Nodal(jnp.ones_like(base_tension), zero))
    return Settled(direction, load_path, splits, start_from(guess, zero, 1))


def _cut(setup: Setup, splits: Splits) -> Panels:
    return cut_into_panels(setup.manipulator, setup.nodes, splits.arc_length)


def _lay_out(setup: Setup, base_tension: PerTendon, splits: Splits | None) -> Problem:
    at = setup.manipulator, base_tension, setup.direction, setup.nodes, setup.loads
    return lay_out(*at, splits.arc_length if splits is not None and splits.arc_length.size else None)


def settle(setup: Setup, base_tension: PerTendon) -> Settled:
    """Directions that are not stated, base moment, and sign changes until they stay where they are. No derivatives."""
    if not setup.to_find:
        return _settle_as_stated(setup, base_tension)[0]

    def attempt(direction: PerTendon) -> tuple[Settled, PerTendon, Bool[Array, ""]]:
        there = _sliding(setup, direction)
        settled, travel = _settle_as_stated(there, base_tension)
        if settled.trial is not None:
            problem = place(there, base_tension, settled)
            travel = _travel(there, problem, there.method.improve(problem, settled.trial.nodal), settled)
        assert travel is not None
        return settled, travel, settled.load_path.converged

    blank = unsettled(setup, base_tension)
    return find_directions(setup.manipulator, base_tension, blank.direction, setup.to_find, attempt, blank)


def _sliding(setup: Setup, direction: PerTendon) -> Setup:
    return eqx.tree_at(lambda setup: setup.direction, setup, direction)


def _settle_as_stated(setup: Setup, base_tension: PerTendon) -> tuple[Settled, PerTendon | None]:
    """With the directions of the setup; and the travel of each tendon, where it is asked for and at hand."""
    start = unsettled(setup, base_tension)
    if setup.loads is not None:
        return _put_loads_on(setup, base_tension, start.load_path.fraction), None
    if num_splits(setup.manipulator, None) == 0:
        return start, None

    def once(state: _Round) -> _Round:
        old = state.settled
        problem = _lay_out(setup, base_tension, old.splits)
        path = setup.method(problem)
        new = old._replace(load_path=old.load_path._replace(converged=path.converged), splits=locate(problem, path))
        travel = _travel(setup, problem, path, new) if setup.to_find else None
        return _Round(new, travel, _distance(new.splits, old.splits, problem.panels), state.num_rounds + 1.0)

    def goes_on(state: _Round) -> Bool[Array, ""]:
        converged = state.settled.load_path.converged
        return (state.moved > SETTLED) & (state.num_rounds < MAX_ROUNDS) & converged

    zero = start.load_path.num_steps
    travel = base_tension + zero if setup.to_find else None
    end = jax.lax.while_loop(goes_on, once, _Round(start, travel, zero + jnp.inf, zero))
    return end.settled, end.travel


def _distance(new: Splits, old: Splits, cut: Panels) -> Number:
    return largest_size(new.arc_length - old.arc_length) / cut.edges[-1]


def _put_loads_on(setup: Setup, base_tension: PerTendon, zero: Number) -> Settled:
    """Along the path of the loads, then with panels that follow the sign changes from sweep to sweep.

    On the way the panels end where the body is not smooth, and no more; where nothing changes sign it settles on them.
    Panels follow at once where the sweeps are calm; those that come and go, only from one settled body to the next.
    """
    problem = _lay_out(setup, base_tension, None)
    body = LoadedBody(problem, setup.method)
    found, near = follow_loads(body, everywhere(problem.panels, at_base(problem)), zero)
    smooth = ~changes_sign(problem, body.path(near, found.fraction))
    near = body.polish(near, found.fraction, found.converged & smooth)
    path = body.path(near, found.fraction)

    def once(state: _Sweeping) -> _Sweeping:
        free = state.num_moves < MAX_MOVES
        move = (state.moved > SETTLED) & (state.trial.settled | (free & (state.trial.change <= ROUGHLY)))
        ends = jax.tree.map(lambda a, b: jnp.where(move, a, b), state.splits, state.ends)
        num_moves = state.num_moves + jnp.where(move, 1.0, 0.0)
        problem = _lay_out(setup, base_tension, ends)
        guess = follow_edges(_cut(setup, state.ends), problem.panels, state.trial.nodal)
        start = state.trial._replace(nodal=guess, num_sweeps=jnp.where(move, 0.0, state.trial.num_sweeps))
        trial, path = LoadedBody(problem, setup.method).sweep(start, found.fraction)
        splits = locate(problem, path)
        new = _Sweeping(trial, splits, ends, _distance(splits, ends, problem.panels), num_moves)
        kept = jax.tree.map(lambda a, b: jnp.where(trial.lost, a, b), state, new)
        return kept._replace(trial=kept.trial._replace(lost=trial.lost))

    def goes_on(state: _Sweeping) -> Bool[Array, ""]:
        in_place = (state.moved <= SETTLED) | (state.num_moves >= MAX_MOVES + MAX_ROUNDS)
        return found.converged & ~state.trial.lost & ~(state.trial.settled & in_place)

    splits = locate(problem, path)
    moved = jnp.where(largest_size(splits.owner + 1.0) > 0, zero + jnp.inf, zero)
    old, new = problem.panels, _cut(setup, splits)

    def redistributed(zero: Number) -> Trial:
        cut = Panels(new.edges + zero, new.order)
        return _on_other_panels(near, problem, path, partial(redistribute, old, cut))

    ahead = _on_other_panels(near, problem, path, partial(with_empty_panels, old, new))
    ahead = only_if(moved > 0, redistributed, ahead)
    start = _Sweeping(ahead, splits, splits, moved, zero)
    trial, splits, *_ = jax.lax.while_loop(goes_on, once, start)
    found = found._replace(
        base_moment=trial.moment,
        converged=found.converged & trial.settled,
        stable=jnp.where(trial.num_sweeps > 0, trial.stable, found.stable),
        resolved=found.resolved & trial.sane,
    )
    return Settled(setup.direction + zero, found, splits, trial)


def _on_other_panels(trial: Trial, problem: Problem, path: Path, moved: Callable[[Any, Any], Any]) -> Trial:
    """With the values that `moved` makes of those at nodes and tip, and slopes by the moment only."""
    tangents = by_moment(trial.tangents)
    at_tip = Nodal(path.tip.ratio, path.tip.moment / problem.moment_scale)
    values = moved(trial.nodal, at_tip)
    slopes = moved(tangents, jax.tree.map(lambda x: x[-1, -1], tangents))
    turning = by_moment(trial.turning)
    turning = turning._replace(nodes=moved(turning.nodes, turning.tip))
    blank = start_from(values, jnp.zeros_like(trial.moment), 1)
    return blank._replace(
        moment=trial.moment,
        tangents=jax.tree.map(lambda x: x[None], slopes),
        slopes=trial.slopes[:1],
        turning=jax.tree.map(lambda x: x[None], turning),
        settled=trial.settled,
        change=trial.change,
    )


def inside_of_bend(problem: Problem, path: Path) -> Float[Array, " points"]:
    """The product sigma d kappa at base, nodes and tip, the largest of the tendons that are there."""

    def inside(section, state):
        kappa = curvature_of(problem, section, state.pull, state.moment)
        return jnp.max(jnp.where(section.present, section.side * section.offset * kappa, -jnp.inf))

    return jax.vmap(inside)(*all_points(problem, path))
