"""The search for base tensions that reach targets, or come nearest to them."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Bool, Float, Int

from ..mechanics.directions import is_contradicted
from ..mechanics.problem import Number, Problem, Solution, geometry_of
from ..numerics import tolerances as tol
from ..numerics.arrays import zero_as
from ..numerics.fixed_point import solve_small, until, without_derivative
from .balance import Balance, balance
from .settle import Settled, Setup, settle, unsettled
from .system import Equations
from .targets import CurvatureAt, Displacement, Target, TipAngle, TipPosition, bending_tension

Tensions = Float[Array, " unknowns"]  # over their scale
Flags = Bool[Array, " unknowns"]
Rule = Callable[[Float[Array, " targets"], Tensions], Tensions]


class Found(NamedTuple):
    """Whether the targets were reached."""

    miss: Float[Array, " targets"]  # reached less wanted, in the unit of the target; 0 where a tension was given
    reached: Bool[Array, ""]
    slack: Bool[Array, ""]  # a tendon would have to push to give its displacement
    determined: Bool[Array, ""]  # whether no other tensions nearby do the same
    rank: Int[Array, ""] | None = None  # of the derivative of the tip's position by all tensions


class _TensionTrial(NamedTuple):
    tension: Tensions
    residual: Float[Array, " targets"]
    jacobian: Float[Array, "targets unknowns"]
    cost: Number
    settled: Settled


class _Aim(NamedTuple):
    """The targets of a search, without derivatives, and its limits."""

    setup: Setup
    scale: Number  # of tensions, N
    least: Tensions
    most: Tensions
    # which targets are displacements, whose tendons may become slack; None where targets do not belong to tendons
    pulled: Flags | None = None
    left: float = 0.0  # the least part of a tension that is left after one step

    def evaluate(self, tension: Tensions) -> _TensionTrial:
        """Solve for given tensions: the misses of the targets, and their slopes."""
        settled = settle(self.with_tensions(self.setup, tension))
        residual = settled.residual[: settled.residual.size - self.num_moments]
        jacobian = _at_constant_moment(settled.slopes.residual.T, self.num_moments)
        cost = jnp.sum(residual**2)
        fine = settled.load_path.converged & ~settled.crossing & jnp.isfinite(cost + jnp.sum(jacobian))
        return _TensionTrial(tension, residual, self.scale * jacobian, jnp.where(fine, cost, jnp.inf), settled)

    def with_tensions(self, setup: Setup, tension: Tensions) -> Setup:
        """The setup with values of the unknown tensions."""
        given = setup.problem.base_tension
        return setup.with_numbers(base_tension=given.at[jnp.asarray(self.setup.unknown)].set(self.scale * tension))

    @property
    def num_moments(self) -> int:
        """Components of the moment at the base that have to be found."""
        return 0 if self.setup.rough is None else self.setup.problem.base_moment.size

    def equilibrium(self, setup: Setup, best: _TensionTrial, misses: Equations, rule: Rule) -> Balance:
        """The equilibrium at the tensions that were found, which follow a rule.

        Args:
            setup: with derivatives, as the misses.
            misses: of the targets.
            rule: (misses, unknown tensions over their scale) -> zeros, one for each tension; linear but for a constant.
            best: the trial at these tensions.
        """
        by_misses, by_moment = jnp.split(best.settled.slopes.residual, [best.residual.size], axis=1)
        units = jnp.eye(by_misses.shape[0], best.tension.size, dtype=best.tension.dtype) / self.scale
        units = units + zero_as(best)  # varies over the same devices of shard_map as the rule
        at = best.residual, best.tension
        rows = jax.vmap(lambda *slopes: jax.jvp(rule, at, slopes)[1])(by_misses, units)
        slopes = best.settled.slopes._replace(residual=jnp.concatenate([rows, by_moment], axis=1))
        settled = without_derivative(best.settled._replace(slopes=slopes))
        unknown = self.setup.unknown
        equations = Partial(_ruled, rule, misses, self.scale, np.asarray(unknown))
        searching = replace(setup, unknown=unknown, equations=equations, num_targets=len(unknown))
        return balance(self.with_tensions(searching, best.tension), settled)

    def nothing(self, start: Tensions) -> _TensionTrial:
        """The first "best" trial of a search: no equilibrium, with infinite cost."""
        blank = unsettled(self.with_tensions(self.setup, start))
        zero = blank.num_iterations
        jacobian = jnp.eye(self.setup.num_targets, start.size, dtype=start.dtype) + zero
        blank = blank._replace(load_path=blank.load_path._replace(converged=zero > 0))
        return _TensionTrial(start + zero, jacobian[:, 0] * 0.0, jacobian, zero + jnp.inf, blank)


def _at_constant_moment(slopes: Float[Array, "equations unknowns"], moments: int) -> Float[Array, "targets tensions"]:
    """The slopes of the targets by the tensions, while M_ext(0) follows the tensions so that M_ext(L) stays m."""
    if not moments:
        return slopes
    targets, tensions = (count - moments for count in slopes.shape)
    followed = solve_small(slopes[targets:, tensions:], slopes[targets:, :tensions])[0]
    return slopes[:targets, :tensions] - slopes[:targets, tensions:] @ followed


def _ruled(
    rule: Rule, misses: Equations, scale: Number, unknown: np.ndarray, problem: Problem, solution: Solution
) -> Tensions:
    """A rule as the equations of `balance`."""
    return rule(misses(problem, solution), problem.base_tension[unknown] / scale)


Targets = tuple[Target | TipPosition | None, ...]  # one per tendon, None where the tension is given; or one of the tip


def reach(setup: Setup, targets: Targets) -> tuple[Balance, Found]:
    """The equilibrium in which targets are reached; its tensions have the derivatives of the implicit function.

    Args:
        setup: where there is a target its tension is not used.
        targets: one per tendon, None where the tension is given; or a single `TipPosition`.
    """
    if isinstance(targets[0], TipPosition):
        return _reach_place(setup, targets[0])
    wanted = {i: target for i, target in enumerate(targets) if isinstance(target, Target)}
    aim = _aim_at(*without_derivative((setup, wanted)))
    let_out = [isinstance(target, Displacement) & (jnp.asarray(target.value) <= 0) for target in wanted.values()]
    start = aim.least + jnp.where(jnp.stack(let_out), 0.0, tol.FIRST_TENSION)  # such a tendon may be loose
    best, slack = _levenberg_marquardt(aim, aim.nothing(start), start, start < 0)
    reached, determined = _is_reached(aim, best, slack)
    sizes = jnp.stack([target.size(setup) for target in wanted.values()])
    miss = jnp.zeros_like(setup.problem.base_tension).at[jnp.asarray(aim.setup.unknown)].set(best.residual * sizes)
    found = Found(miss, reached, jnp.any(slack), determined)
    rule = Partial(_unless_missed, reached & determined & ~slack, best.tension)
    return aim.equilibrium(setup, best, Partial(_misses, setup, wanted), rule), found


def _is_reached(aim: _Aim, best: _TensionTrial, slack: Flags) -> tuple[Bool[Array, ""], Bool[Array, ""]]:
    """Whether the targets of the tendons that pull are reached, and by no other tensions nearby."""
    apart = slack[:, None] | slack | ~jnp.isfinite(best.jacobian)
    pivots = solve_small(jnp.where(apart, jnp.eye(slack.size), best.jacobian), best.residual)[1]
    missed = jnp.max(jnp.where(slack, 0.0, jnp.abs(best.residual)))
    return jnp.isfinite(best.cost) & (missed <= _tolerance(aim.scale)), pivots > tol.WELL_DETERMINED


def _aim_at(setup: Setup, wanted: "Wanted") -> _Aim:
    scale, frames = bending_tension(setup.manipulator), geometry_of(setup.manipulator).has_frames
    kinds = list(wanted.values())
    least = jnp.zeros(len(wanted), scale.dtype) + setup.zero + zero_as(wanted)
    return _Aim(
        replace(setup, unknown=tuple(wanted), equations=Partial(_misses, setup, wanted), num_targets=len(wanted)),
        scale,
        least=least,
        most=jnp.full_like(least, tol.FARTHEST),
        pulled=jnp.asarray([isinstance(target, Displacement) for target in kinds]),
        left=tol.LEAST_LEFT if frames and any(isinstance(target, TipAngle | CurvatureAt) for target in kinds) else 0.0,
    )


def _tolerance(number: Number) -> float:
    return max(tol.REACHED, 1e2 * float(jnp.finfo(number.dtype).eps))


Wanted = dict[int, Target]  # by tendon


def _unless_missed(free: Flags, found: Tensions, misses: Array, tension: Tensions) -> Float[Array, " unknowns"]:
    """The misses of the targets; where a target is not reached, the change of the tension instead."""
    return jnp.where(free, misses, tension - found)


def _misses(setup: Setup, wanted: Wanted, problem: Problem, solution: Solution) -> Float[Array, " unknowns"]:
    """Reached less wanted, over the sizes of the targets."""

    def miss(tendon, target):
        return (target.reading(setup, problem, solution, tendon) - target.value) / target.size(setup)

    return jnp.stack([miss(tendon, target) for tendon, target in wanted.items()])


# --- the search between the least and the most tensions -------------------------------------------


class _Search(NamedTuple):
    best: _TensionTrial
    next: Tensions
    damping: Number
    num_evaluations: Number
    improved: Bool[Array, ""]
    slack: Flags  # tendons that were set slack, since they would have to push


def _levenberg_marquardt(
    aim: _Aim, nothing: _TensionTrial, start: Tensions, held: Flags
) -> tuple[_TensionTrial, Flags]:
    """The Levenberg-Marquardt method between the limits; every trial is an equilibrium of its own.

    Args:
        aim: the targets and limits.
        nothing: from `_Aim.nothing`.
        start: the first tensions.
        held: tensions that keep their value at the start.

    Returns:
        The best trial, and the tendons that were set slack.
    """
    zero = zero_as(nothing)
    state = _Search(nothing, start + zero, zero, zero, improved=zero > 0, slack=nothing.tension < 0)
    found, _ = until(lambda state: _judge(aim, held, state), state, tol.MAX_EVALUATIONS)
    return found.best, found.slack


def _counted(aim: _Aim, residual: Array, slack: Flags) -> Array:
    """The residual without the targets of tendons that were set slack."""
    return residual if aim.pulled is None else jnp.where(slack, 0.0, residual)


def _judge(aim: _Aim, held: Flags, state: _Search) -> tuple[_Search, Bool[Array, ""]]:
    """Try tensions, keep the better trial, and choose the next tensions; and whether the search has ended."""
    trial, evaluations = aim.evaluate(state.next), state.num_evaluations + 1.0
    better = _cost(aim, trial, state.slack) < _cost(aim, state.best, state.slack)
    best = jax.tree.map(lambda new, old: jnp.where(better, new, old), trial, state.best)
    easier = jnp.where(state.improved, state.damping / 3.0, state.damping)
    damping = jnp.where(better, easier, jnp.maximum(4.0 * state.damping, 1.0))
    nowhere = ~jnp.isfinite(best.cost)
    step, slack, damping, rests = _next_step(aim, held, best, damping, state.slack)
    following = jnp.where(nowhere, _elsewhere(aim, evaluations), step)
    done = jnp.where(nowhere, evaluations > len(tol.OTHER_TENSIONS), rests)
    return _Search(best, following, damping, evaluations, better, slack), done


def _elsewhere(aim: _Aim, evaluations: Number) -> Tensions:
    """Other tensions to start from, where there was no equilibrium yet."""
    others = jnp.asarray((*tol.OTHER_TENSIONS, 0.0), evaluations.dtype)
    other = others[jnp.minimum(evaluations.astype(int) - 1, len(tol.OTHER_TENSIONS))]
    return jnp.clip(other, aim.least, aim.most)


def _next_step(
    aim: _Aim, held: Flags, best: _TensionTrial, damping: Number, slack: Flags
) -> tuple[Tensions, Flags, Number, Bool[Array, ""]]:
    """The next tensions, the tendons that are set slack, the damping, and whether the search rests at the best trial.

    Where it would end with a tendon that has to push to give its displacement, that tendon is set slack, and the search
    goes on for the others.
    """
    if aim.pulled is None:
        following = _step(aim, held, best, damping, slack)
        return following, slack, damping, _rests(best, following, damping)
    pushing = aim.pulled & jnp.isfinite(best.cost) & ~slack
    pushing &= (best.tension == 0) & (best.residual > _tolerance(best.cost))
    both = jnp.stack([slack, slack | pushing])
    steps = jax.vmap(partial(_step, aim, held, best))(jnp.stack([damping, 0.0 * damping]), both)
    rests = _rests(best, steps[0], damping)
    again = rests & jnp.any(pushing)
    following, slack = (jnp.where(again, each[1], each[0]) for each in (steps, both))
    return following, slack, jnp.where(again, 0.0, damping), rests & ~again


def _rests(best: _TensionTrial, following: Tensions, damping: Number) -> Bool[Array, ""]:
    """Whether the next tensions are the best ones."""
    move = jnp.max(jnp.abs(following - best.tension)) / (jnp.max(best.tension) + 1e-3)
    return move <= jnp.where(damping >= 1.0, tol.LEAST_MOVE[1], tol.LEAST_MOVE[0])


def _cost(aim: _Aim, trial: _TensionTrial, slack: Flags) -> Number:
    return jnp.where(jnp.isfinite(trial.cost), jnp.sum(_counted(aim, trial.residual, slack) ** 2), jnp.inf)


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


def _reach_place(setup: Setup, target: TipPosition) -> tuple[Balance, Found]:
    """The equilibrium whose tip is at a position, or nearest to it, with the least sum of tensions."""
    frozen = without_derivative((setup, target))
    aim, given = _aim_at_place(*frozen), setup.problem.base_tension
    best = _least_total(aim, frozen[1])
    jacobian = jnp.where(jnp.isfinite(best.jacobian), best.jacobian, 0.0)
    inside = (best.tension > aim.least) & (best.tension < aim.most)
    found = _found_near_place(aim, best, jacobian, inside)
    follow = jnp.where(found.reached, jnp.linalg.pinv(jacobian * inside, rtol=_same_effect(aim.scale)), 0.0)
    moves = jnp.eye(given.size, dtype=given.dtype) - follow @ jacobian
    rule = Partial(_between_limits, *target.limits(aim.scale, given), best.tension, follow, moves)
    return aim.equilibrium(setup, best, Partial(TipPosition.misses, target, setup), rule), found


def _aim_at_place(setup: Setup, target: TipPosition) -> _Aim:
    scale, given = bending_tension(setup.manipulator), setup.problem.base_tension
    misses = Partial(TipPosition.misses, target, setup)
    searching = replace(setup, unknown=tuple(range(given.size)), equations=misses, num_targets=jnp.size(target.value))
    return _Aim(searching, scale, *target.limits(scale, given))


def _found_near_place(
    aim: _Aim, best: _TensionTrial, jacobian: Float[Array, "components unknowns"], inside: Flags
) -> Found:
    """Whether the position was reached, and whether other tensions between the limits do the same."""
    rank = partial(jnp.linalg.matrix_rank, rtol=_same_effect(aim.scale))
    both = jnp.concatenate([jacobian, jnp.max(jnp.abs(jacobian)) * jnp.ones_like(best.tension)[None]])
    reached = jnp.isfinite(best.cost) & (jnp.max(jnp.abs(best.residual)) <= _tolerance(aim.scale))
    miss = best.residual * aim.setup.manipulator.length
    return Found(miss, reached, jnp.zeros_like(reached), rank(both * inside) == jnp.sum(inside), rank(jacobian))


def _between_limits(
    least: Tensions,
    most: Tensions,
    found: Tensions,
    follow: Float[Array, "unknowns components"],
    moves: Float[Array, "unknowns unknowns"],
    misses: Float[Array, " components"],
    tension: Tensions,
) -> Tensions:
    """One equation for each tension: tensions at a limit stay there, the others follow the position by least change.

    The derivative of the equations by the tensions is the identity.
    """
    limit = jnp.where(found <= least, least, jnp.where(found >= most, most, found))
    return follow @ misses + moves @ (tension - limit)


class _Rounds(NamedTuple):
    """Searches one after the other; each starts from the best trial so far, changed so that the sum falls."""

    best: _TensionTrial
    start: Tensions
    held: Flags
    length: Number  # of the last change of the tensions along which the tip stays
    num_rounds: Number


def _least_total(aim: _Aim, target: TipPosition) -> _TensionTrial:
    """The tensions with the least miss, and of these with the least sum.

    The first search starts with tension in the tendons on the side of the position. Two more follow while the position
    is not reached, or while a tendon travels against the direction that was found for it: from equal tensions, and from
    tensions beyond the best ones, where other directions may hold. Each further search starts after a step of the
    gradient projection method, and brings the tip back.
    """
    zero = zero_as(target) + aim.setup.zero
    alike = jnp.clip(tol.FIRST_TENSION + zero + jnp.zeros_like(aim.least), aim.least, aim.most)
    nothing = aim.nothing(alike)
    zero = zero_as(nothing)
    alike = alike + zero
    towards = jnp.clip(tol.FIRST_TENSION * target.on_the_side(aim.setup), aim.least, aim.most) + zero

    def next_round(state: _Rounds) -> tuple[_Rounds, Bool[Array, ""]]:
        best, good = _better(aim.setup, _levenberg_marquardt(aim, nothing, state.start, state.held)[0], state.best)
        longest = jnp.where(state.num_rounds <= tol.OTHER_SEARCHES, jnp.inf, jnp.where(good, 2.0, 0.25) * state.length)
        start, length, gain = _gradient_projection(aim, best, longest)
        fine = (best.cost <= _tolerance(zero) ** 2) & (_num_against(aim.setup, best) == 0)
        another = (state.num_rounds < tol.OTHER_SEARCHES) & ~fine
        beyond = jnp.clip(tol.BEYOND * best.tension, aim.least, aim.most)
        start = jnp.where(another, jnp.where(state.num_rounds < 1, alike, beyond), start)
        held = ~another & ((start <= aim.least) | (start >= aim.most))
        num_rounds = jnp.where(another, state.num_rounds, jnp.maximum(state.num_rounds, tol.OTHER_SEARCHES)) + 1.0
        goes_on = (gain > tol.LEAST_GAIN) & jnp.isfinite(best.cost) & (num_rounds < tol.MAX_ROUNDS)
        return _Rounds(best, start, held, length, num_rounds), ~(another | goes_on)

    first = _Rounds(nothing, towards, alike < 0, zero, zero)
    return until(next_round, first, tol.MAX_ROUNDS)[0].best


def _num_against(setup: Setup, trial: _TensionTrial) -> Number:
    """How many tendons travel against the direction that was found for them."""
    travel, length = trial.settled.travel, jnp.asarray(setup.manipulator.length)
    if not setup.to_find or travel is None:
        return zero_as(trial.tension)
    against = is_contradicted(trial.settled.direction, travel, length) & (trial.tension > 0)
    return jnp.sum(jnp.where(against, 1.0, 0.0))


def _better(setup: Setup, found: _TensionTrial, best: _TensionTrial) -> tuple[_TensionTrial, Bool[Array, ""]]:
    """The trial that misses less, and whether it is the first one.

    Where both miss equally: that in which fewer tendons travel against their direction, then that of the lower sum.
    """
    enough = _tolerance(found.cost) ** 2
    nearer = (found.cost < (1 - tol.ALIKE) * best.cost) & (best.cost > enough)
    as_near = found.cost <= jnp.maximum((1 + tol.ALIKE) * best.cost, enough)
    one, other = _num_against(setup, found), _num_against(setup, best)
    lower = (one == other) & (jnp.sum(found.tension) < jnp.sum(best.tension))
    good = nearer | (as_near & ((one < other) | lower))
    return jax.tree.map(lambda new, old: jnp.where(good, new, old), found, best), good


def _gradient_projection(aim: _Aim, trial: _TensionTrial, longest: Number) -> tuple[Tensions, Number, Number]:
    """Tensions of a lower sum that keep the tip to first order, up to the first limit or up to `longest`.

    Tensions at a limit stay there until nothing else lowers the sum; then one of them is released (gradient projection,
    Rosen, J. Soc. Indust. Appl. Math. 8, 1960).

    Returns:
        The tensions, the length of their change, and the part of the sum that is gained.
    """
    tension = trial.tension
    change = _downwards(trial.jacobian, tension <= aim.least, tension >= aim.most)
    limit, moves = jnp.where(change < 0, aim.least, aim.most), change != 0
    room = jnp.where(moves, (limit - tension) / jnp.where(moves, change, 1.0), jnp.inf)
    length = jnp.minimum(jnp.min(room), longest)
    start = jnp.where(moves, jnp.where(room <= length, limit, tension + length * change), tension)
    return start, length, -jnp.sum(change) * length / (jnp.sum(tension) + 1e-3)


def _downwards(jacobian: Float[Array, "components unknowns"], low: Flags, high: Flags) -> Tensions:
    """The change of the tensions along which the tip stays and their sum falls; some are at a limit."""
    change, price = _without_effect(jacobian, ~(low | high))
    wrong = jnp.where(low, -price, jnp.where(high, price, 0.0))
    stays = jnp.max(jnp.abs(change)) <= tol.LEVEL
    released = (jnp.arange(wrong.size) == jnp.argmax(wrong)) & (wrong > tol.LEVEL) & stays
    return _without_effect(jacobian, ~(low | high) | released)[0]


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
