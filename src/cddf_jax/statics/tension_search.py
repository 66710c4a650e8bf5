"""The search for base tensions that reach targets, or come nearest to them."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Bool, Float, Int

from ..mechanics.directions import is_contradicted
from ..mechanics.friction import PerTendon
from ..mechanics.problem import Number, Problem, Solution, geometry_of
from ..numerics import tolerances as tol
from ..numerics.arrays import zero_as
from ..numerics.fixed_point import slopes_by_unknowns, solve_small, without_derivative
from .balance import Balance, Equations, System, balance, inside_of_bend
from .settle import Settled, Setup, settle, unsettled
from .targets import CurvatureAt, Displacement, Target, TipAngle, TipPosition, bending_tension

Tensions = Float[Array, " unknowns"]  # over their scale
Flags = Bool[Array, " unknowns"]


class Found(NamedTuple):
    """Whether the targets were reached."""

    miss: Float[Array, " targets"]  # reached less wanted, in the unit of the target; 0 where a tension was given
    reached: Bool[Array, ""]
    slack: Bool[Array, ""]  # a tendon would have to push to give its displacement
    determined: Bool[Array, ""]  # whether no other tensions nearby do the same
    rank: Int[Array, ""] | None = None  # of the derivative of the tip's position by all tensions


class _Aim(NamedTuple):
    """The targets of a search, and its limits."""

    evaluate: Callable[[Tensions], "_TensionTrial"]
    least: Tensions
    most: Tensions
    # which targets are displacements, whose tendons may become slack; None where targets do not belong to tendons
    pulled: Flags | None
    left: float = 0.0  # the least part of a tension that is left after one step


class _TensionTrial(NamedTuple):
    tension: Tensions
    residual: Float[Array, " targets"]
    jacobian: Float[Array, "targets unknowns"]
    cost: Number
    settled: Settled


class _TensionSearch(NamedTuple):
    best: _TensionTrial
    next: Tensions
    damping: Number
    num_evaluations: Number
    improved: Bool[Array, ""]
    slack: Flags  # tendons that were set slack, since they would have to push
    ended: Bool[Array, ""]


Targets = tuple[Target | TipPosition | None, ...]  # one per tendon, None where the tension is given; or one of the tip


def reach(setup: Setup, given: PerTendon, targets: Targets) -> tuple[Balance, Found]:
    """The equilibrium in which targets are reached; its tensions have the derivatives of the implicit function.

    Args:
        setup: the manipulator and its loads.
        given: T_base, N; where there is a target the entry is not used.
        targets: one per tendon, None where the tension is given; or a single `TipPosition`.
    """
    if isinstance(targets[0], TipPosition):
        return _reach_place(setup, given, targets[0])
    wanted = {i: target for i, target in enumerate(targets) if isinstance(target, Target)}
    which = jnp.asarray(list(wanted))
    frozen_setup, frozen_given, frozen_wanted = without_derivative((setup, given, wanted))
    scale = bending_tension(frozen_setup)
    misses = Partial(_misses, frozen_setup, frozen_wanted)
    frames = geometry_of(setup.manipulator).has_frames
    whole = frames and any(isinstance(target, TipAngle) for target in wanted.values())
    vanishing = frames and any(isinstance(target, TipAngle | CurvatureAt) for target in wanted.values())
    start = jnp.full(len(wanted), tol.FIRST_TENSION) + zero_as(scale, given, frozen_wanted)
    aim = _Aim(
        evaluate=_evaluation(frozen_setup, frozen_given, tuple(wanted), misses, scale, whole),
        least=jnp.zeros_like(start),
        most=jnp.full_like(start, tol.FARTHEST),
        pulled=jnp.asarray([isinstance(target, Displacement) for target in wanted.values()]),
        left=tol.LEAST_LEFT if vanishing else 0.0,
    )
    best, slack = _search(aim, _nothing(frozen_setup, frozen_given, start, len(wanted)), start, start < 0)
    apart = slack[:, None] | slack | ~jnp.isfinite(best.jacobian)
    pivots = solve_small(jnp.where(apart, jnp.eye(len(wanted)), best.jacobian), best.residual)[1]
    determined = pivots > tol.WELL_DETERMINED
    reached = jnp.isfinite(best.cost) & (jnp.max(jnp.where(slack, 0.0, jnp.abs(best.residual))) <= _tolerance(scale))

    free = reached & determined & ~slack
    tension = given.at[which].set(scale * best.tension)
    sizes = jnp.stack([target.size(setup) for target in wanted.values()])
    miss = jnp.zeros_like(given).at[which].set(best.residual * sizes)
    found = Found(miss, reached, jnp.any(slack), determined)
    equations = Partial(_equations, setup, wanted, scale, best.tension, free)
    return balance(setup, tension, best.settled, tuple(wanted), equations, whole), found


def _tolerance(number: Number) -> float:
    return max(tol.REACHED, 1e2 * float(jnp.finfo(number.dtype).eps))


Wanted = dict[int, Target]  # by tendon


def _equations(
    setup: Setup,
    wanted: Wanted,
    scale: Number,
    found: Tensions,
    free: Flags,
    problem: Problem,
    solution: Solution,
) -> Float[Array, " unknowns"]:
    """The residuals: the misses of the targets; where a target is not reached, the change of the tension instead."""
    tension = problem.base_tension[jnp.asarray(list(wanted))] / scale
    return jnp.where(free, _misses(setup, wanted, problem, solution), tension - found)


def _misses(setup: Setup, wanted: Wanted, problem: Problem, solution: Solution) -> Float[Array, " unknowns"]:
    """Reached less wanted, over the sizes of the targets."""

    def miss(tendon, target):
        return (target.reading(setup, problem, solution, tendon) - target.value) / target.size(setup)

    return jnp.stack([miss(tendon, target) for tendon, target in wanted.items()])


# --- the search between the least and the most tensions -------------------------------------------


def _num_moments(setup: Setup) -> int:
    """How many numbers M_ext(0) has."""
    return 0 if setup.loads is None else geometry_of(setup.manipulator).no_moment.size


def _evaluation(
    setup: Setup, given: PerTendon, unknown: tuple[int, ...], misses: Equations, scale: Number, whole: bool
) -> Callable[[Tensions], _TensionTrial]:
    """A function that solves for given tensions, and returns the misses of the targets with their slopes."""
    count, loaded = len(unknown), _num_moments(setup)

    def evaluate(tension: Tensions) -> _TensionTrial:
        base_tension = given.at[jnp.asarray(unknown)].set(scale * tension)
        settled = settle(setup, base_tension)
        system = System(setup, base_tension, settled, misses, unknown, whole)
        values = settled.values
        (_, rows), push, (problem, solution) = jax.linearize(system.improved, values, system.root, has_aux=True)
        slopes = slopes_by_unknowns(push, values, system.root)[1].T
        targets = rows.size - loaded
        residual, jacobian = rows[:targets], slopes[:targets, :count]
        if loaded:  # the base moment follows the tensions so that M_ext(L) stays m
            followed = solve_small(slopes[targets:, count:], slopes[targets:, :count])[0]
            jacobian = jacobian - slopes[:targets, count:] @ followed
        # one more pass of a body that has settled may change more than the tolerance
        fine = solution.converged if values is None else settled.load_path.converged
        fine = fine & jnp.all(inside_of_bend(problem, solution) < 1.0)
        cost = jnp.sum(residual**2)
        fine = fine & jnp.isfinite(cost + jnp.sum(jacobian))
        return _TensionTrial(tension, residual, scale * jacobian, jnp.where(fine, cost, jnp.inf), settled)

    return evaluate


def _nothing(setup: Setup, given: PerTendon, start: Tensions, targets: int) -> _TensionTrial:
    """The first "best" trial of a search: no equilibrium, with infinite cost."""
    zero = zero_as(setup, given, start)
    blank = unsettled(setup, given + zero)
    blank = blank._replace(load_path=blank.load_path._replace(converged=zero > 0))
    slopes = jnp.eye(targets, start.size, dtype=start.dtype) + zero
    return _TensionTrial(start + zero, slopes[:, 0] * 0.0, slopes, zero + jnp.inf, blank)


def _search(aim: _Aim, nothing: _TensionTrial, start: Tensions, held: Flags) -> tuple[_TensionTrial, Flags]:
    """The Levenberg-Marquardt method between the limits; every trial is an equilibrium of its own.

    Args:
        aim: the targets and limits.
        nothing: from `_nothing`.
        start: the first tensions.
        held: tensions that keep their value at the start.

    Returns:
        The best trial, and the tendons that were set slack.
    """
    zero = zero_as(nothing)
    state = _TensionSearch(
        best=nothing,
        next=start + zero,
        damping=zero,
        num_evaluations=zero,
        improved=zero > 0,
        slack=nothing.tension < 0,
        ended=zero > 0,
    )
    state = jax.lax.while_loop(
        lambda state: ~state.ended, lambda state: _judge(aim, held, aim.evaluate(state.next), state), state
    )
    return state.best, state.slack


def _counted(aim: _Aim, residual: Array, slack: Flags) -> Array:
    """The residual without the targets of tendons that were set slack."""
    return residual if aim.pulled is None else jnp.where(slack, 0.0, residual)


def _judge(aim: _Aim, held: Flags, trial: _TensionTrial, state: _TensionSearch) -> _TensionSearch:
    """Keep the better trial, and choose the next tensions.

    Where the search would end with a tendon that has to push to give its displacement, that tendon is set slack, and
    the search goes on for the others.
    """

    def cost(trial: _TensionTrial) -> Number:
        return jnp.where(jnp.isfinite(trial.cost), jnp.sum(_counted(aim, trial.residual, state.slack) ** 2), jnp.inf)

    better = cost(trial) < cost(state.best)
    best = jax.tree.map(lambda new, old: jnp.where(better, new, old), trial, state.best)
    easier = jnp.where(state.improved, state.damping / 3.0, state.damping)
    damping = jnp.where(better, easier, jnp.maximum(4.0 * state.damping, 1.0))
    evaluations = state.num_evaluations + 1.0
    nowhere = ~jnp.isfinite(best.cost)
    others = jnp.asarray((*tol.OTHER_TENSIONS, 0.0), damping.dtype)
    elsewhere = others[jnp.minimum(evaluations.astype(int) - 1, len(tol.OTHER_TENSIONS))]
    # tendons that would have to push: should the search end now, it goes on without their targets
    pushing = state.slack & False
    if aim.pulled is not None:
        pushing = aim.pulled & ~nowhere & ~state.slack & (best.tension == 0) & (best.residual > tol.REACHED)
    slack = jnp.stack([state.slack, state.slack | pushing])
    steps = jax.vmap(partial(_step, aim, held, best))(jnp.stack([damping, 0.0 * damping]), slack)
    following = jnp.where(nowhere, jnp.clip(elsewhere, aim.least, aim.most), steps[0])
    move = jnp.max(jnp.abs(following - best.tension)) / (jnp.max(best.tension) + 1e-3)
    least = jnp.where(damping >= 1.0, tol.LEAST_MOVE[1], tol.LEAST_MOVE[0])
    done = jnp.where(nowhere, evaluations > len(tol.OTHER_TENSIONS), move <= least)
    again = done & jnp.any(pushing)
    slack, following = jnp.where(again, slack[1], slack[0]), jnp.where(again, steps[1], following)
    done = (done & ~again) | (evaluations >= tol.MAX_EVALUATIONS)
    return _TensionSearch(best, following, jnp.where(again, 0.0, damping), evaluations, better, slack, done)


def _step(aim: _Aim, held: Flags, best: _TensionTrial, damping: Number, slack: Flags) -> Tensions:
    """The damped Gauss-Newton step of the tendons that are free to follow it."""
    residual = _counted(aim, best.residual, slack)
    jacobian = best.jacobian if aim.pulled is None else jnp.where(slack[:, None], 0.0, best.jacobian)
    downhill = -jacobian.T @ residual
    tension, tiny = best.tension, jnp.finfo(best.tension.dtype)
    stuck = held | slack | ((tension <= aim.least) & (downhill < 0)) | ((tension >= aim.most) & (downhill > 0))
    free = jnp.where(stuck, 0.0, 1.0)
    normal = (jacobian * free).T @ (jacobian * free)
    ridge = (damping + 4 * float(tiny.eps)) * jnp.maximum(jnp.max(jnp.diag(normal)), tiny.tiny)
    step, _ = solve_small(normal + ridge * jnp.eye(tension.shape[0], dtype=tension.dtype), downhill * free)
    least = jnp.maximum(aim.least, aim.left * tension) if aim.left else aim.least
    return jnp.clip(tension + step * free, least, aim.most)


# --- a position of the tip ------------------------------------------------------------------------


def _reach_place(setup: Setup, given: PerTendon, target: TipPosition) -> tuple[Balance, Found]:
    """The equilibrium whose tip is at a position, or nearest to it, with the least sum of tensions."""
    frozen_setup, frozen_given, frozen = without_derivative((setup, given, target))
    scale = bending_tension(frozen_setup)
    unknown, whole = tuple(range(given.size)), True
    least, most = frozen.limits(scale, given)
    evaluate = _evaluation(frozen_setup, frozen_given, unknown, Partial(frozen.misses, frozen_setup), scale, whole)
    best = _least_total(_Aim(evaluate, least, most, None), frozen_setup, frozen_given, frozen)

    inside = (best.tension > least) & (best.tension < most)
    jacobian = jnp.where(jnp.isfinite(best.jacobian), best.jacobian, 0.0)
    both = jnp.concatenate([jacobian, jnp.max(jnp.abs(jacobian)) * jnp.ones_like(given)[None]])
    determined = jnp.linalg.matrix_rank(both * inside, rtol=_same_effect(scale)) == jnp.sum(inside)
    reached = jnp.isfinite(best.cost) & (jnp.max(jnp.abs(best.residual)) <= _tolerance(scale))
    rank = jnp.linalg.matrix_rank(jacobian, rtol=_same_effect(scale))
    none_let_go = jnp.zeros_like(reached)
    found = Found(best.residual * frozen_setup.manipulator.length, reached, none_let_go, determined, rank)

    follow = jnp.where(reached, jnp.linalg.pinv(jacobian * inside, rtol=_same_effect(scale)), 0.0)
    moves = jnp.eye(given.size, dtype=given.dtype) - follow @ jacobian
    equations = Partial(_place_equations, setup, target, scale, best.tension, follow, moves)
    return balance(setup, scale * best.tension, best.settled, unknown, equations, whole), found


def _place_equations(
    setup: Setup,
    target: TipPosition,
    scale: Number,
    found: Tensions,
    follow: Float[Array, "unknowns components"],
    moves: Float[Array, "unknowns unknowns"],
    problem: Problem,
    solution: Solution,
) -> Tensions:
    """One equation for each tension: tensions at a limit stay there, the others follow the position by least change.

    The derivative of the equations by the tensions is the identity.
    """
    least, most = target.limits(scale, problem.base_tension)
    limit = jnp.where(found <= least, least, jnp.where(found >= most, most, found))
    away = problem.base_tension / scale - limit
    return follow @ target.misses(setup, problem, solution) + moves @ away


class _Rounds(NamedTuple):
    """Searches one after the other; each starts from the best trial so far, changed so that the sum falls."""

    kept: _TensionTrial
    start: Tensions
    held: Flags
    length: Number  # of the last change of the tensions along which the tip stays
    longest: Number  # the largest length that may be tried
    num_rounds: Number
    over: Bool[Array, ""]


def _least_total(aim: _Aim, setup: Setup, given: PerTendon, target: TipPosition) -> _TensionTrial:
    """The tensions with the least miss, and of these with the least sum.

    The first search starts with tension in the tendons on the side of the position. Two more follow while the position
    is not reached, or while a tendon travels against the direction that was found for it: from equal tensions, and from
    tensions beyond the best ones, where other directions may hold. Each further search starts after a change of the
    tensions that keeps the tip to first order and lowers their sum, and brings the tip back.
    """
    alike = jnp.clip(tol.FIRST_TENSION + zero_as(target, given) + jnp.zeros_like(given), aim.least, aim.most)
    nothing = _nothing(setup, given, alike, jnp.size(target.value))
    zero = zero_as(nothing)
    alike = alike + zero
    none = alike < 0

    def next_round(state: _Rounds) -> _Rounds:
        found, _ = _search(aim, nothing, state.start, state.held)
        kept, good = _better(setup, found, state.kept)
        longest = jnp.where(state.num_rounds <= tol.OTHER_SEARCHES, jnp.inf, jnp.where(good, 2.0, 0.25) * state.length)
        change, gain = _downwards(aim, kept)
        start, length = _pushed(aim, kept.tension, change, longest)
        fine = (kept.cost <= _tolerance(zero) ** 2) & (_num_against(setup, kept) == 0)
        another = (state.num_rounds < tol.OTHER_SEARCHES) & ~fine
        elsewhere = jnp.where(state.num_rounds < 1, alike, jnp.clip(tol.BEYOND * kept.tension, aim.least, aim.most))
        start = jnp.where(another, elsewhere, start)
        held = ~another & ((start <= aim.least) | (start >= aim.most))
        rounds = jnp.where(another, state.num_rounds + 1.0, jnp.maximum(state.num_rounds, tol.OTHER_SEARCHES) + 1.0)
        small = ~(gain * length > tol.LEAST_GAIN * (jnp.sum(kept.tension) + 1e-3))
        over = ~another & (small | ~jnp.isfinite(kept.cost) | (rounds >= tol.MAX_ROUNDS))
        return _Rounds(kept, start, held, length, longest, rounds, over)

    towards = jnp.clip(tol.FIRST_TENSION * target.on_the_side(setup), aim.least, aim.most) + zero
    first = _Rounds(nothing, towards, none, zero, zero + jnp.inf, zero, zero > 0)
    return jax.lax.while_loop(lambda state: ~state.over, next_round, first).kept


def _num_against(setup: Setup, trial: _TensionTrial) -> Number:
    """How many tendons travel against the direction that was found for them."""
    travel, length = trial.settled.travel, jnp.asarray(setup.manipulator.length)
    if not setup.to_find or travel is None:
        return zero_as(trial.tension)
    return jnp.sum(jnp.where(is_contradicted(trial.settled.direction, travel, length), 1.0, 0.0))


def _better(setup: Setup, found: _TensionTrial, kept: _TensionTrial) -> tuple[_TensionTrial, Bool[Array, ""]]:
    """The trial that misses less, and whether it is the first one.

    Where both miss equally: that in which fewer tendons travel against their direction, then that of the lower sum.
    """
    enough = _tolerance(found.cost) ** 2
    nearer = (found.cost < (1 - tol.ALIKE) * kept.cost) & (kept.cost > enough)
    as_near = found.cost <= jnp.maximum((1 + tol.ALIKE) * kept.cost, enough)
    one, other = _num_against(setup, found), _num_against(setup, kept)
    lower = (one == other) & (jnp.sum(found.tension) < jnp.sum(kept.tension))
    good = nearer | (as_near & ((one < other) | lower))
    return jax.tree.map(lambda new, old: jnp.where(good, new, old), found, kept), good


def _downwards(aim: _Aim, trial: _TensionTrial) -> tuple[Tensions, Number]:
    """The change of the tensions along which the tip stays and their sum falls, and by how much it falls.

    Tensions at a limit stay there until nothing else lowers the sum; then one of them is released (gradient projection,
    Rosen, J. Soc. Indust. Appl. Math. 8, 1960).
    """
    low, high = trial.tension <= aim.least, trial.tension >= aim.most
    change, price = _without_effect(trial.jacobian, ~(low | high))
    wrong = jnp.where(low, -price, jnp.where(high, price, 0.0))
    first = (
        (jnp.arange(wrong.size) == jnp.argmax(wrong)) & (wrong > tol.LEVEL) & (jnp.max(jnp.abs(change)) <= tol.LEVEL)
    )
    change, _ = _without_effect(trial.jacobian, ~(low | high) | first)
    return change, -jnp.sum(change)


def _without_effect(jacobian: Float[Array, "components unknowns"], free: Flags) -> tuple[Tensions, Tensions]:
    """The change of the free tensions that lowers their sum fastest while the tip stays; and the price of each tension.

    The price is the change of the sum with this tension, while the free tensions keep the tip.
    """
    used = jacobian * free
    normal = used @ used.T
    ridge = _same_effect(normal) ** 2 * jnp.max(jnp.diag(normal)) + jnp.finfo(normal.dtype).tiny
    weight, _ = solve_small(normal + ridge * jnp.eye(normal.shape[0], dtype=normal.dtype), jnp.sum(used, axis=1))
    price = 1.0 - jacobian.T @ weight
    return jnp.where(free & (jnp.abs(price) > tol.LEVEL), -price, 0.0), price


def _same_effect(number: Array) -> float:
    return max(tol.SAME_EFFECT, 4 * float(jnp.finfo(number.dtype).eps) ** 0.5)


def _pushed(aim: _Aim, tension: Tensions, change: Tensions, longest: Number) -> tuple[Tensions, Number]:
    """The tensions after a change up to the first limit, or up to `longest`; and its length."""
    limit = jnp.where(change < 0, aim.least, aim.most)
    moves = change != 0
    room = jnp.where(moves, (limit - tension) / jnp.where(moves, change, 1.0), jnp.inf)
    length = jnp.minimum(jnp.min(room), longest)
    return jnp.where(moves, jnp.where(room <= length, limit, tension + length * change), tension), length
