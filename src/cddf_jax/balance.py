"""A body in equilibrium: what has to be known before one pass solves it, and derivatives through all of that."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .implicit import implicit, without_derivative
from .load_path import LoadedBody, LoadPath, Trial, follow_loads, hold_loads, moment_left_at_tip, start_from
from .loads import Loads
from .manipulator import Manipulator
from .problem import (
    Method,
    Nodal,
    Number,
    Path,
    PerTendon,
    Problem,
    all_points,
    at_base,
    curvature_of,
    cut_into_panels,
    everywhere,
    lay_out,
    loaded_to,
)
from .quadrature import Panels, redistribute
from .reductions import largest_size
from .sign_changes import Splits, locate, num_splits, turning_at_splits, unsplit
from .tendon_travel import tendon_displacement

MAX_ROUNDS = 8
SETTLED = 1e-7  # of the length: a kink that lies so far off a panel's end costs 1e-14


class Setup(eqx.Module):
    """A manipulator, its loads, and how it is to be solved."""

    manipulator: Manipulator
    direction: PerTendon
    loads: Loads | None
    method: Method
    nodes: int = eqx.field(static=True)


class Settled(NamedTuple):
    """What belongs to given base tensions: the base moment at the end of the path of loads, the sign changes."""

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


def place(setup: Setup, base_tension: PerTendon, settled: Settled) -> Problem:
    """The problem that one pass solves; where the path of the loads ended early, under the loads of its end."""
    problem = _lay_out(setup, base_tension, settled.splits)
    if setup.loads is None:
        return problem
    found = settled.load_path
    fraction = jnp.where(found.converged, 1.0, found.fraction)
    return loaded_to(problem, fraction, found.base_moment * problem.moment_scale)


def missing_moment(problem: Problem, path: Path) -> Float[Array, " equations"]:
    """What is missing of the moment at the tip, see `moment_at_tip`; empty without loads."""
    return path.tip.moment[None][:0] if problem.loads is None else moment_left_at_tip(problem, path)[None]


def equilibrate(setup: Setup, base_tension: PerTendon) -> Balance:
    """Shape and tensions under given base tensions and loads, with implicit derivatives."""
    return balance(setup, base_tension, settle(*without_derivative((setup, base_tension))))


def no_equations(problem: Problem, path: Path) -> Float[Array, " 0"]:
    """No tension is unknown."""
    return path.tip.ratio[:0]


def balance(
    setup: Setup,
    base_tension: PerTendon,
    settled: Settled,
    unknown: tuple[int, ...] = (),
    equations: Callable[[Problem, Path], Float[Array, " unknown"]] = no_equations,
) -> Balance:
    """One last pass, with the derivatives of everything that had to be known for it.

    Args:
        setup: the manipulator and its loads.
        base_tension: T_base, N, with derivatives where it is given, without where it was searched for.
        settled: what was found for these tensions.
        unknown: the tendons whose tension was searched for.
        equations: what vanishes at these tensions, one for each.
    """
    which = jnp.asarray(unknown, int)
    guess = settled.guess
    count = len(unknown), len(unknown) + (setup.loads is not None)

    def put(unknowns):
        load_path, splits, trial = settled
        if setup.loads is not None:
            load_path = load_path._replace(base_moment=unknowns[count[0]])
        splits = splits._replace(arc_length=unknowns[count[1] :])
        tension = base_tension.at[which].set(unknowns[: count[0]]) if unknown else base_tension
        return place(setup, tension, Settled(load_path, splits, trial)), splits

    def residual(unknowns):
        problem, splits = put(unknowns)
        path = setup.method(problem, guess)
        turning = turning_at_splits(problem, path, splits)
        return jnp.concatenate([equations(problem, path), missing_moment(problem, path), turning])

    moment = [settled.load_path.base_moment[None]] if setup.loads is not None else []
    start = jnp.concatenate([base_tension[which] if unknown else base_tension[:0], *moment, settled.splits.arc_length])
    problem, _ = put(implicit(residual, start))
    path = setup.method(problem, guess)
    found = settled.load_path
    found = found._replace(converged=found.converged & path.converged)
    if settled.trial is None:
        return Balance(problem, path, found, tendon_displacement(problem, path))
    path = path._replace(residual=jnp.maximum(path.residual, settled.trial.change))
    body, whole = LoadedBody(without_derivative(problem), setup.method), jnp.ones_like(found.fraction)
    return Balance(problem, path, found, body.travel(settled.trial, whole))


class _Round(NamedTuple):
    settled: Settled
    panels: Panels  # on which that was found
    moved: Number
    num_rounds: Number


def unsettled(setup: Setup, base_tension: PerTendon) -> Settled:
    """Where `settle` starts: no loads, no sign changes."""
    # it derives from all numbers, so that as the carry of a loop shard_map sees on which devices it varies
    numbers = jax.tree.leaves(eqx.filter((setup, base_tension), eqx.is_inexact_array))
    zero = 0.0 * jnp.sum(jnp.stack([jnp.sum(x) for x in numbers]))
    splits = jax.tree.map(lambda x: x + zero.astype(x.dtype), unsplit(setup.manipulator, setup.loads))
    fraction = zero + 1.0 if setup.loads is None else zero
    load_path = LoadPath(zero, fraction, zero, zero == 0, zero == 0, zero == 0)
    ones = jnp.ones_like(base_tension)
    guess = everywhere(_cut(setup, splits), Nodal(ones, zero))
    return Settled(load_path, splits, None if setup.loads is None else start_from(guess, zero))


def _cut(setup: Setup, splits: Splits) -> Panels:
    return cut_into_panels(setup.manipulator, setup.nodes, splits.arc_length)


def _lay_out(setup: Setup, base_tension: PerTendon, splits: Splits | None) -> Problem:
    at = setup.manipulator, base_tension, setup.direction, setup.nodes, setup.loads
    return lay_out(*at, splits.arc_length if splits is not None and splits.arc_length.size else None)


def settle(setup: Setup, base_tension: PerTendon) -> Settled:
    """Base moment and sign changes in turn, until the sign changes stay where they are. No derivatives."""
    start = unsettled(setup, base_tension)
    if setup.loads is None and num_splits(setup.manipulator, None) == 0:
        return start

    def once(state: _Round) -> _Round:
        old = state.settled
        problem = _lay_out(setup, base_tension, old.splits)
        if old.trial is None:
            found, trial, path = _unloaded(setup, problem, old)
        else:
            guess = old.trial._replace(nodal=redistribute(state.panels, problem.panels, old.trial.nodal))
            found, trial, path = hold_loads(problem, setup.method, old.load_path, guess)
        return judge(problem.panels, Settled(found, locate(problem, path), trial), old.splits, state.num_rounds + 1.0)

    def judge(cut: Panels, new: Settled, old: Splits, num_rounds: Number) -> _Round:
        moved = largest_size(new.splits.arc_length - old.arc_length) / cut.edges[-1]
        return _Round(new, cut, moved, num_rounds)

    def goes_on(state: _Round) -> Bool[Array, ""]:
        converged = state.settled.load_path.converged
        return (state.moved > SETTLED) & (state.num_rounds < MAX_ROUNDS) & converged

    zero = start.load_path.num_steps
    problem = _lay_out(setup, base_tension, None)
    if start.trial is None:
        found, trial, path = _unloaded(setup, problem, start)
    else:
        found, trial, path = follow_loads(problem, setup.method, everywhere(problem.panels, at_base(problem)), zero)
        more = start.trial.nodal.ratio.shape[0] - problem.panels.nodes.shape[0]
        trial = _with_empty_panels(trial, problem, path, more)
    new = Settled(found, locate(problem, path), trial)
    first = judge(_cut(setup, start.splits), new, start.splits, zero + 1.0)
    return jax.lax.while_loop(goes_on, once, first).settled


def _unloaded(setup: Setup, problem: Problem, old: Settled) -> tuple[LoadPath, None, Path]:
    path = setup.method(problem)
    return old.load_path._replace(converged=path.converged), None, path


def _with_empty_panels(trial: Trial, problem: Problem, path: Path, count: int) -> Trial:
    """With more panels at the tip, which sign changes may need."""
    order = problem.panels.order
    at_tip = Nodal(path.tip.ratio, path.tip.moment / problem.moment_scale)

    def more(x: Array, tip: Array) -> Array:
        return jnp.concatenate([x, jnp.broadcast_to(tip, (count, order, *tip.shape))])

    def more_tangents(x: Array) -> Array:
        return jnp.concatenate([x, jnp.broadcast_to(x[:, -1:], (3, count, *x.shape[2:]))], axis=1)

    def more_points(x: Array) -> Array:
        return jnp.concatenate([x, jnp.broadcast_to(x[..., -1:], (*x.shape[:-1], count * order))], axis=-1)

    return trial._replace(
        nodal=jax.tree.map(more, trial.nodal, at_tip),
        tangents=jax.tree.map(more_tangents, trial.tangents),
        heading=more_points(trial.heading),
        turning=more_points(trial.turning),
    )


def inside_of_bend(problem: Problem, path: Path) -> Float[Array, " points"]:
    """The product sigma d kappa at base, nodes and tip, the largest of the tendons that are there."""

    def inside(section, state):
        kappa = curvature_of(problem, section, state.pull, state.moment)
        return jnp.max(jnp.where(section.present, section.side * section.offset * kappa, -jnp.inf))

    return jax.vmap(inside)(*all_points(problem, path))
