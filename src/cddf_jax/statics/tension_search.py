"""The base tensions with which targets are reached, or the nearest to them that a tendon can give."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Bool, Float

from ..mechanics.friction import PerTendon
from ..mechanics.problem import AnyState, Nodal, Number, Problem, Solution
from ..numerics.arrays import largest, varying_as, zero_as
from ..numerics.implicit import Unknowns, slopes_by_unknowns, solve_small, without_derivative
from .equilibrium_derivatives import Balance, System, balance, inside_of_bend
from .equilibrium_search import Settled, Setup, settle, unsettled
from .targets import Displacement, Target, bending_tension

START = 0.05  # of the tension at which d kappa would come near 1
FARTHEST = 100.0  # of the same: no target is looked for beyond
OTHER_STARTS = (0.0, 0.5, 5.0)  # where there is no equilibrium at the start
MAX_EVALUATIONS = 200
REACHED = 1e-9  # of the size of a target
LEAST_MOVE = 1e-11, 1e-7  # relative change of the tensions below which the search ends: undamped, damped
WELL_DETERMINED = 1e-8  # smallest pivot over the largest


class Found(NamedTuple):
    """Whether the targets were reached."""

    miss: PerTendon  # reached less wanted, in the unit of the target; zero where the tension was given
    reached: Bool[Array, ""]
    slack: Bool[Array, ""]  # a tendon would have to push to give its displacement
    determined: Bool[Array, ""]  # no other tensions nearby do the same


class _TensionTrial(NamedTuple):
    tension: Float[Array, " unknowns"]  # over its scale
    residual: Float[Array, " unknowns"]
    jacobian: Float[Array, "unknowns unknowns"]
    cost: Number
    settled: Settled


class _TensionSearch(NamedTuple):
    best: _TensionTrial
    next: Float[Array, " unknowns"]
    damping: Number
    num_evaluations: Number
    improved: Bool[Array, ""]
    slack: Bool[Array, " unknowns"]  # tendons that were let go, since they would have to push
    ended: Bool[Array, ""]


def reach(setup: Setup, given: PerTendon, targets: tuple[Target | None, ...]) -> tuple[Balance, Found]:
    """The equilibrium in which targets are reached; its tensions have the derivatives of the implicit function.

    Args:
        setup: the manipulator and its loads.
        given: T_base, N; where there is a target the entry is not used.
        targets: one per tendon, None where the tension is given.
    """
    wanted = {i: target for i, target in enumerate(targets) if target is not None}
    which = jnp.asarray(list(wanted))
    frozen_setup, frozen_given, frozen_wanted = without_derivative((setup, given, wanted))
    scale = bending_tension(frozen_setup)
    best, slack = _search(frozen_setup, frozen_given, frozen_wanted, scale)
    apart = slack[:, None] | slack | ~jnp.isfinite(best.jacobian)
    pivots = solve_small(jnp.where(apart, jnp.eye(len(wanted)), best.jacobian), best.residual)[1]
    determined = pivots > WELL_DETERMINED
    tolerance = max(REACHED, 1e2 * float(jnp.finfo(scale.dtype).eps))
    reached = jnp.isfinite(best.cost) & (jnp.max(jnp.where(slack, 0.0, jnp.abs(best.residual))) <= tolerance)

    free = reached & determined & ~slack
    tension = given.at[which].set(scale * best.tension)
    sizes = jnp.stack([target.size(setup) for target in wanted.values()])
    miss = jnp.zeros_like(given).at[which].set(best.residual * sizes)
    found = Found(miss, reached, jnp.any(slack), determined)
    equations = Partial(_equations, setup, wanted, scale, best.tension, free)
    return balance(setup, tension, best.settled, tuple(wanted), equations), found


Wanted = dict[int, Target]  # by tendon


def _equations(
    setup: Setup,
    wanted: Wanted,
    scale: Number,
    found: Float[Array, " unknowns"],
    free: Bool[Array, " unknowns"],
    problem: Problem,
    solution: Solution[AnyState],
) -> Float[Array, " unknowns"]:
    """The residuals: the misses of the targets; for a tension that could not follow its target, how far it moved."""
    tension = problem.base_tension[jnp.asarray(list(wanted))] / scale
    return jnp.where(free, _misses(setup, wanted, problem, solution), tension - found)


def _misses(setup: Setup, wanted: Wanted, problem: Problem, solution: Solution[AnyState]) -> Float[Array, " unknowns"]:
    """Reached less wanted, over the sizes of the targets."""

    def miss(tendon, target):
        return (target.reading(setup, problem, solution, tendon) - target.value) / target.size(setup)

    return jnp.stack([miss(tendon, target) for tendon, target in wanted.items()])


def _num_moments(setup: Setup) -> int:
    """How many numbers M_ext(0) has."""
    if setup.loads is None:
        return 0
    return 3 if setup.manipulator.in_space else 1


def _search(
    setup: Setup, given: PerTendon, wanted: Wanted, scale: Number
) -> tuple[_TensionTrial, Bool[Array, " unknowns"]]:
    """Levenberg-Marquardt between slack and the farthest tension; every trial is an equilibrium of its own."""
    which = jnp.asarray(list(wanted))

    count, loaded = len(wanted), _num_moments(setup)

    def evaluate(tension: Float[Array, " unknowns"]) -> _TensionTrial:
        base_tension = given.at[which].set(scale * tension)
        settled = settle(setup, base_tension)
        system = System(setup, base_tension, settled, Partial(_misses, setup, wanted), tuple(wanted))
        values = None if settled.trial is None else settled.trial.nodal
        root, splits = jnp.split(system.root(), [count + loaded])  # slopes by the places of sign changes vanish

        def step(values: Nodal | None, root: Unknowns):
            (better, rows), there = system.step(values, jnp.concatenate([root, splits]))
            return (better, rows[: count + loaded]), there

        (_, rows), push, (problem, solution) = jax.linearize(step, values, root, has_aux=True)
        slopes = slopes_by_unknowns(push, values, root)[1].T
        residual, jacobian = rows[:count], slopes[:count, :count]
        if loaded:  # the base moment follows the tensions so that M_ext(L) stays m
            followed = [solve_small(slopes[count:, count:], slopes[count:, i])[0] for i in range(count)]
            jacobian = jacobian - slopes[:count, count:] @ jnp.stack(followed, axis=1)
        fine = settled.load_path.converged & solution.converged & (largest(inside_of_bend(problem, solution)) < 1.0)
        fine = fine & jnp.all(jnp.isfinite(residual)) & jnp.all(jnp.isfinite(jacobian))
        cost = jnp.where(fine, jnp.sum(residual**2), jnp.inf)
        return _TensionTrial(tension, residual, scale * jacobian, cost, settled)

    start = jnp.full(len(wanted), START) + zero_as(scale, given)
    blank, eye = unsettled(setup, given), jnp.eye(len(wanted), dtype=start.dtype)
    zero = blank.load_path.num_steps + zero_as(wanted)
    # all of it varies over the devices of shard_map; an empty array would not, were it chosen by `where`
    false, blank = zero > 0, varying_as(blank, zero)
    blank = blank._replace(load_path=blank.load_path._replace(converged=false))
    nothing = _TensionTrial(start + zero, jnp.zeros_like(start) + zero, eye + zero, zero + jnp.inf, blank)
    state = _TensionSearch(
        best=nothing,
        next=start + zero,
        damping=zero,
        num_evaluations=zero,
        improved=false,
        slack=nothing.tension < 0,
        ended=false,
    )
    pulled = jnp.asarray([isinstance(target, Displacement) for target in wanted.values()])
    state = jax.lax.while_loop(
        lambda state: ~state.ended, lambda state: _judge(evaluate(state.next), state, pulled), state
    )
    return state.best, state.slack


def _cost(trial: _TensionTrial, slack: Bool[Array, " unknowns"]) -> Number:
    return jnp.where(jnp.isfinite(trial.cost), jnp.sum(jnp.where(slack, 0.0, trial.residual) ** 2), jnp.inf)


def _judge(trial: _TensionTrial, state: _TensionSearch, pulled: Bool[Array, " unknowns"]) -> _TensionSearch:
    """Keep the better one, and choose where to look next.

    Where the search would end with a tendon that has to push to give its displacement, that tendon is let go,
    and the search goes on for the others.
    """
    better = _cost(trial, state.slack) < _cost(state.best, state.slack)
    best = jax.tree.map(lambda new, old: jnp.where(better, new, old), trial, state.best)
    easier = jnp.where(state.improved, state.damping / 3.0, state.damping)
    damping = jnp.where(better, easier, jnp.maximum(4.0 * state.damping, 1.0))
    evaluations = state.num_evaluations + 1.0
    nowhere = ~jnp.isfinite(best.cost)
    others = jnp.asarray((*OTHER_STARTS, 0.0), damping.dtype)
    elsewhere = others[jnp.minimum(evaluations.astype(int) - 1, len(OTHER_STARTS))]
    following = jnp.where(nowhere, elsewhere, _step(best, damping, state.slack))
    move = jnp.max(jnp.abs(following - best.tension)) / (jnp.max(best.tension) + 1e-3)
    least = jnp.where(damping >= 1.0, LEAST_MOVE[1], LEAST_MOVE[0])
    done = jnp.where(nowhere, evaluations > len(OTHER_STARTS), move <= least)
    pushes = done & ~nowhere & pulled & ~state.slack & (best.tension == 0) & (best.residual > REACHED)
    slack = state.slack | pushes
    again = jnp.any(pushes)
    following = jnp.where(again, _step(best, 0.0 * damping, slack), following)
    done = (done & ~again) | (evaluations >= MAX_EVALUATIONS)
    return _TensionSearch(best, following, jnp.where(again, 0.0, damping), evaluations, better, slack, done)


def _step(best: _TensionTrial, damping: Number, slack: Bool[Array, " unknowns"]) -> Float[Array, " unknowns"]:
    """The damped Gauss-Newton step of the tendons that are free to follow it."""
    jacobian, residual = jnp.where(slack[:, None], 0.0, best.jacobian), jnp.where(slack, 0.0, best.residual)
    downhill = -jacobian.T @ residual
    tension, tiny = best.tension, jnp.finfo(best.tension.dtype)
    stuck = slack | ((tension <= 0) & (downhill < 0)) | ((tension >= FARTHEST) & (downhill > 0))
    free = jnp.where(stuck, 0.0, 1.0)
    normal = (jacobian * free).T @ (jacobian * free)
    ridge = (damping + 4 * float(tiny.eps)) * jnp.maximum(jnp.max(jnp.diag(normal)), tiny.tiny)
    step, _ = solve_small(normal + ridge * jnp.eye(tension.shape[0], dtype=tension.dtype), downhill * free)
    return jnp.clip(tension + step * free, 0.0, FARTHEST)
