"""A body in equilibrium: what has to be known before one pass solves it, and derivatives through all of that."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .implicit import implicit, without_derivative
from .load_path import LoadPath, follow_loads
from .loads import Loads
from .manipulator import Manipulator
from .problem import Method, Number, Path, PerTendon, Problem, all_points, curvature_of, lay_out, loaded_to
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
        load_path, splits = settled
        if setup.loads is not None:
            load_path = load_path._replace(base_moment=unknowns[count[0]])
        splits = splits._replace(arc_length=unknowns[count[1] :])
        tension = base_tension.at[which].set(unknowns[: count[0]]) if unknown else base_tension
        return place(setup, tension, Settled(load_path, splits)), splits

    def residual(unknowns):
        problem, splits = put(unknowns)
        path = setup.method(problem)
        turning = turning_at_splits(problem, path, splits)
        return jnp.concatenate([equations(problem, path), missing_moment(problem, path), turning])

    moment = [settled.load_path.base_moment[None]] if setup.loads is not None else []
    start = jnp.concatenate([base_tension[which] if unknown else base_tension[:0], *moment, settled.splits.arc_length])
    problem, _ = put(implicit(residual, start))
    path = setup.method(problem)
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
    return Settled(LoadPath(zero, fraction, zero, zero == 0, zero == 0, travel, zero == 0), splits)


def settle(setup: Setup, base_tension: PerTendon) -> Settled:
    """Base moment and sign changes in turn, until the sign changes stay where they are. No derivatives."""
    length = jnp.asarray(setup.manipulator.length)
    start = unsettled(setup, base_tension)
    if setup.loads is None and num_splits(setup.manipulator, None) == 0:
        return start

    def once(state: _Round) -> _Round:
        found, splits = state.settled
        problem = lay_out(setup.manipulator, base_tension, setup.direction, setup.nodes, setup.loads, splits.arc_length)
        if problem.loads is None:
            path = setup.method(problem)
            found = found._replace(converged=path.converged)
        else:
            steps = found.num_steps
            found, path = follow_loads(problem, problem.loads, setup.method, found.fraction, found.base_moment)
            found = found._replace(num_steps=jnp.maximum(found.num_steps, steps))
            problem = loaded_to(problem, found.fraction, found.base_moment * problem.moment_scale)
        new = locate(problem, path)
        moved = jnp.max(jnp.abs(new.arc_length - splits.arc_length)) / length
        return _Round(Settled(found, new), moved, state.num_rounds + 1.0)

    def goes_on(state: _Round) -> Bool[Array, ""]:
        converged = state.settled.load_path.converged
        return (state.moved > SETTLED) & (state.num_rounds < MAX_ROUNDS) & converged

    zero = start.load_path.num_steps
    return jax.lax.while_loop(goes_on, once, _Round(start, zero + jnp.inf, zero)).settled


def inside_of_bend(problem: Problem, path: Path) -> Float[Array, " points"]:
    """The product sigma d kappa at base, nodes and tip, the largest of the tendons that are there."""

    def inside(section, state):
        kappa = curvature_of(problem, section, state.pull, state.moment)
        return jnp.max(jnp.where(section.present, section.side * section.offset * kappa, -jnp.inf))

    return jax.vmap(inside)(*all_points(problem, path))
