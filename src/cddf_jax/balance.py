"""A body in equilibrium: what has to be known before one pass solves it, and derivatives through all of that."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .batches import largest
from .implicit import implicit, without_derivative
from .load_path import LoadPath, follow_loads
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
    everywhere,
    lay_out,
    loaded_to,
    nodal,
)
from .sign_changes import Splits, locate, num_splits, turning_at_splits, unsplit
from .tendon_travel import tendon_displacement

MAX_ROUNDS = 6
SETTLED = 1e-6  # of the length: a kink that lies so far off a panel's end costs 1e-12


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
    guess: Nodal | None  # the values at the nodes under loads, rough where nothing has been solved yet


class Balance(NamedTuple):
    """A body in equilibrium."""

    problem: Problem
    path: Path
    load_path: LoadPath  # how the loads were put on


def place(setup: Setup, base_tension: PerTendon, settled: Settled) -> Problem:
    """The problem that one pass solves; where the path of the loads ended early, under the loads of its end."""
    at = setup.manipulator, base_tension, setup.direction, setup.nodes, setup.loads
    splits = settled.splits.arc_length
    problem = lay_out(*at, splits if splits.size else None)
    if setup.loads is None:
        return problem
    found = settled.load_path
    fraction = jnp.where(found.converged, 1.0, found.fraction)
    return loaded_to(problem, fraction, found.base_moment * problem.moment_scale)


def missing_moment(problem: Problem, path: Path) -> Float[Array, " equations"]:
    """M_ext(L) - m over the moment scale; empty without loads."""
    if problem.loads is None:
        return path.tip.moment[None][:0]
    return ((path.tip.moment - problem.loads.tip_moment) / problem.moment_scale)[None]


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
    count = len(unknown), len(unknown) + (setup.loads is not None)

    def put(unknowns):
        load_path, splits, guess = settled
        if setup.loads is not None:
            load_path = load_path._replace(base_moment=unknowns[count[0]])
        splits = splits._replace(arc_length=unknowns[count[1] :])
        tension = base_tension.at[which].set(unknowns[: count[0]]) if unknown else base_tension
        return place(setup, tension, Settled(load_path, splits, guess)), splits

    def residual(unknowns):
        problem, splits = put(unknowns)
        path = setup.method(problem, settled.guess)
        turning = turning_at_splits(problem, path, splits)
        return jnp.concatenate([equations(problem, path), missing_moment(problem, path), turning])

    moment = [settled.load_path.base_moment[None]] if setup.loads is not None else []
    start = jnp.concatenate([base_tension[which] if unknown else base_tension[:0], *moment, settled.splits.arc_length])
    problem, _ = put(implicit(residual, start))
    path = setup.method(problem, settled.guess)
    found = settled.load_path
    found = found._replace(converged=found.converged & path.converged)
    return Balance(problem, path, found if moment else found._replace(travel=tendon_displacement(problem, path)))


class _Round(NamedTuple):
    settled: Settled
    moved: Number
    num_rounds: Number


def unsettled(setup: Setup, base_tension: PerTendon) -> Settled:
    """Where `settle` starts: no loads, no sign changes."""
    # it derives from all numbers, so that as the carry of a loop shard_map sees on which devices it varies
    numbers = jax.tree.leaves(eqx.filter((setup, base_tension), eqx.is_inexact_array))
    zero = 0.0 * jnp.sum(jnp.stack([jnp.sum(x) for x in numbers]))
    splits = jax.tree.map(lambda x: x + zero.astype(x.dtype), unsplit(setup.manipulator, setup.loads))
    fraction, travel = (zero + 1.0 if setup.loads is None else zero), zero + jnp.zeros_like(base_tension)
    load_path = LoadPath(zero, fraction, zero, zero == 0, zero == 0, travel, zero == 0)
    guess = None
    if setup.loads is not None:
        problem = _lay_out(setup, base_tension, splits)
        guess = jax.tree.map(lambda x: x + zero, everywhere(problem, at_base(problem)))
    return Settled(load_path, splits, guess)


def _lay_out(setup: Setup, base_tension: PerTendon, splits: Splits | None) -> Problem:
    at = setup.manipulator, base_tension, setup.direction, setup.nodes, setup.loads
    return lay_out(*at, None if splits is None else splits.arc_length)


def settle(setup: Setup, base_tension: PerTendon) -> Settled:
    """Base moment and sign changes in turn, until the sign changes stay where they are. No derivatives."""
    length = jnp.asarray(setup.manipulator.length)
    start = unsettled(setup, base_tension)
    if setup.loads is None and num_splits(setup.manipulator, None) == 0:
        return start

    def solved(problem: Problem, found: LoadPath, guess: Nodal | None) -> tuple[LoadPath, Splits, Path]:
        if problem.loads is None or guess is None:
            path = setup.method(problem)
            return found._replace(converged=path.converged), locate(problem, path), path
        new, path = follow_loads(problem, problem.loads, setup.method, found.fraction, found.base_moment, guess)
        problem = loaded_to(problem, new.fraction, new.base_moment * problem.moment_scale)
        return new._replace(num_steps=jnp.maximum(new.num_steps, found.num_steps)), locate(problem, path), path

    def once(state: _Round) -> _Round:
        old = state.settled
        problem = _lay_out(setup, base_tension, old.splits)
        found, splits, path = solved(problem, old.load_path, old.guess)
        return _Round(
            Settled(found, splits, guess_from(problem, path)), moved(splits, old.splits), state.num_rounds + 1.0
        )

    def moved(new: Splits, old: Splits) -> Number:
        return largest(new.arc_length - old.arc_length) / length

    def guess_from(problem: Problem, path: Path, more: int = 0) -> Nodal | None:
        """With as many empty panels at the tip as there may be sign changes."""
        if problem.loads is None:
            return None
        values = nodal(problem, path)
        tip = path.tip.ratio, path.tip.moment / problem.moment_scale
        empty = jax.tree.map(
            lambda x: jnp.broadcast_to(x, (more, *problem.panels.nodes.shape[1:], *x.shape)), Nodal(*tip)
        )
        return jax.tree.map(lambda a, b: jnp.concatenate([a, b]), values, empty)

    def goes_on(state: _Round) -> Bool[Array, ""]:
        converged = state.settled.load_path.converged
        return (state.moved > SETTLED) & (state.num_rounds < MAX_ROUNDS) & converged

    problem = _lay_out(setup, base_tension, None)
    guess = None if setup.loads is None else everywhere(problem, at_base(problem))
    found, splits, path = solved(problem, start.load_path, guess)
    zero = start.load_path.num_steps
    first = Settled(found, splits, guess_from(problem, path, start.splits.owner.shape[0]))
    return jax.lax.while_loop(goes_on, once, _Round(first, moved(splits, start.splits), zero + 1.0)).settled


def inside_of_bend(problem: Problem, path: Path) -> Float[Array, " points"]:
    """The product sigma d kappa at base, nodes and tip, the largest of the tendons that are there."""

    def inside(section, state):
        kappa = curvature_of(problem, section, state.pull, state.moment)
        return jnp.max(jnp.where(section.present, section.side * section.offset * kappa, -jnp.inf))

    return jax.vmap(inside)(*all_points(problem, path))
