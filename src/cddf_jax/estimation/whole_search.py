"""One whole search of a fit: noise from residuals, a look along the valleys, and what the data determine at its end.

The curvature at a minimum may suggest too much. So the search looks far along the valleys of the sum of squares.
"""

import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .determination import (
    AT_BOUND,
    IDENTIFIED,
    LARGEST_RELATIVE_ERROR,
    NOT_IDENTIFIED,
    Determination,
    determine,
)
from .evidence import Evidence, Uncertainty, without_nan
from .levenberg_marquardt import LEAST_RANK, Minimum, Outcome, evaluate, hold_one, minimise
from .observations import Observed, estimate_noise
from .parameter_space import TINY, ParameterSpace
from .remarks import unexplained_groups
from .residuals import InputErrors, LeastSquaresProblem, Shared

SUCCESSFUL = "successful"
NO_NUMBER = "the model gave no number at the estimate; start closer, or leave out data that it cannot reach"
NOT_SETTLED = "the noise estimates did not settle; give the noise of some data"
STOPPED_SHORT = "the optimiser stopped short of a minimum; start closer, search from more starts, or allow more steps"
BETTER_ELSEWHERE = "a better minimum lies elsewhere; start closer, or search from more starts"
INTERRUPTED = "interrupted before the search had ended; the parameters are the best so far"
NOISE_ROUNDS = 100  # the noise of 27 columns of a real robot needs more than 50
NOTEWORTHY_FALL = 0.01  # of the sum of squares beside the minimum
CLOSING_RISE = 2.0  # of the sum of squares, times that at the end of a 95 % interval
EXPECTED_PART = 0.5  # of the rise that the curvature predicts: with less the valley is flatter than it seems
STRAIGHT = 0.75  # of the same: with less the end of an interval is moved to where the sum of squares has risen enough
MOSTLY_LOST = 0.7  # length of a direction within the parameters that are not identified, of 1
STEEPEST = 1e-4  # slope of the cost at a minimum, over what residuals and derivatives could make it
STEEPEST_UNSOLVED = 1e-6  # the same where the optimiser ran out of steps
FAR = 5.0  # times the accuracy of a model with kinks: a search that stalls farther from a minimum stopped short
EXACT = 1e-3  # root mean square residual, over the noise, below which the slope is rounding
BESIDE = 0.1  # standard errors, how far on both sides of a kink the sum of squares has to rise
NEAR = 0.1  # standard errors: a search that kinks stop has ended where it is so near to the minimum


class FitTask(NamedTuple):
    """The task of a fit, the same for every search."""

    problem: LeastSquaresProblem  # with the first guess of the noise
    groups: tuple[Observed, ...]  # of the data
    prefer_start: bool  # to end near the start in a valley that the data leave open
    inputs: InputErrors  # of the model, that were read with errors


class Ending(NamedTuple):
    """Where a search ended with its noise estimated, and what the data determine there."""

    minimum: Minimum
    evidence: Evidence
    determination: Determination
    result: str
    starts: np.ndarray = np.empty(0)  # the lowest cost from each start, the best first; empty if one search was enough
    restarted: str = ""  # why there were several starts although none were asked for, and their result

    @property
    def success(self) -> bool:
        """Whether it ended at a minimum that explains the data."""
        return self.result == SUCCESSFUL


def search_from(task: FitTask, z: np.ndarray, *, again: bool = True) -> Ending:
    """Weights from residuals and residuals from weights, until they agree; then a look along the valleys.

    If that look finds a lower place, the search goes on there, once.
    """
    minimum, settled = _settle_noise(task, z)
    evidence = _evidence(task, minimum)
    stopped = is_steep(minimum, evidence)
    if stopped and (found := kink_of(minimum, evidence)):
        stopped, (kink, minimum) = False, found
        evidence = replace(_evidence(task, minimum), kink=kink)
    first, determination = evidence, determine(evidence)
    evidence, least_rise, lower = look_along_valleys(minimum, evidence, determination)
    if again and not stopped and lower is not None and least_rise < -NOTEWORTHY_FALL:
        return search_from(task, lower, again=False)
    result = _result(minimum, evidence, least_rise, settled=settled, stopped=stopped)
    if task.prefer_start and evidence.open_profile:
        minimum = minimum._replace(outcome=nearest_to_start(minimum, evidence))
        seen = {"open_profile": evidence.open_profile, "bounded_above": evidence.bounded_above, "ends": evidence.ends}
        evidence = replace(_evidence(task, minimum), **seen)
    if result != SUCCESSFUL:
        evidence = replace(evidence, failed=True, bounded_above=())
    if evidence is not first:  # the look along the valleys added something
        determination = determine(evidence)
    if result == SUCCESSFUL and not are_products(minimum, evidence, determination):
        evidence = replace(evidence, products=False)
        determination = determine(evidence)
    return Ending(minimum, evidence, determination, result)


def interrupted_at(task: FitTask, best: Minimum) -> Ending:
    """The ending of a search that was interrupted."""
    evidence = replace(_evidence(task, best), failed=True)
    return Ending(best, evidence, determine(evidence), INTERRUPTED)


def _settle_noise(task: FitTask, z: np.ndarray) -> tuple[Minimum, bool]:
    """The minimum with the noise of its residuals, and whether the two agreed in the end.

    Where the model has kinks, the estimates may jump to and fro with the effect of errors of inputs. Where they come
    back to an earlier place, and the last jump is less than one standard error, the search ends.
    """
    problem = task.problem
    found, settled, close = Minimum(problem, minimise(problem, z)), False, max(1e-4, problem.accuracy / 10)
    ends = [found]
    for _ in range(NOISE_ROUNDS):
        noise = problem.data.noise
        improved, shared = estimate_noise(task.groups, found, task.inputs)
        before, after = (np.concatenate([np.ravel(own) for own in every]) for every in (noise, improved))
        same = _alike(problem.shared, shared, after / before)
        if same and np.array_equal(before, after):  # it was known
            return found, True
        # far below the errors of inputs, noise may go to 0 ever more slowly, and hardly counts
        errors = problem.by_group(problem.unwhitened(found.outcome.residual)) if np.any(shared.basis) else []
        scatter = [np.full(np.size(a), np.std(e * np.ravel(a))) for e, a in zip(errors, noise, strict=bool(errors))]
        near = np.allclose(before, after, rtol=close, atol=close * np.concatenate(scatter) if scatter else 0.0)
        problem = replace(problem, data=problem.data._replace(noise=improved), shared=shared)
        found = Minimum(problem, minimise(problem, found.outcome.z))
        returned = any(map(found.is_near, ends)) and found.is_near(ends[-1], 1.0)
        settled = near and (same or returned)
        ends.append(found)
        if settled or not np.all(np.isfinite(found.outcome.residual)):
            break
    return found, settled


def _alike(one: Shared, other: Shared, noise: np.ndarray) -> bool:
    """Whether the errors of inputs have the same effect; `noise` of the data is that of the other over the first."""
    own = [np.concatenate([*columns.values()], axis=1) for columns in (one.columns, other.columns) if columns]
    if len(own) == 2:
        same = own[0], own[1] * noise[:, None]
        return bool(np.allclose(*same, rtol=0, atol=1e-4 * max(1.0, float(np.max(np.abs(own[0]), initial=0.0)))))
    return not own or not np.any(own[0])


def _evidence(task: FitTask, minimum: Minimum) -> Evidence:
    """The scaled Jacobian by groups; all 0 if the model gave no number."""
    problem, outcome = minimum
    space = problem.space
    finite = np.all(np.isfinite(outcome.residual))
    at_bound = space.at_bound(outcome.parameters)  # there the value is not a scale for its error
    size = np.where(at_bound, np.maximum(outcome.size, space.scale), outcome.size)
    jacobian = without_nan(outcome.jacobian * (size / outcome.size)) if finite else np.zeros_like(outcome.jacobian)
    rows, prior_rows = problem.by_group(jacobian), jacobian[problem.num_data :]
    return Evidence(
        space=space,
        value=outcome.parameters,
        size=size,
        at_bound=at_bound,
        rows=dict(zip(problem.groups, rows, strict=True)),
        shared=problem.shared,
        estimated_inputs=tuple(
            name
            for name, sigma in task.inputs.sigma.items()
            if sigma is None and problem.shared.deviation.get(name, 0.0) > 0
        ),
        prior_rows={i: row[None] for i, row in zip(problem.data.prior, prior_rows, strict=True)},
        noise_slopes={
            group.name: group.noise_slopes(np.asarray(noise), residual)
            for group, noise, residual in zip(
                task.groups, problem.data.noise, problem.by_group(outcome.residual), strict=True
            )
        },
    )


def _result(minimum: Minimum, evidence: Evidence, least_rise: float, *, settled: bool, stopped: bool) -> str:
    """ "successful", or what went wrong."""
    outcome = minimum.outcome
    if not np.all(np.isfinite(outcome.residual)) or not np.all(np.isfinite(outcome.jacobian)):
        return NO_NUMBER
    if not settled:
        return NOT_SETTLED
    if stopped:
        return STOPPED_SHORT
    if least_rise < -NOTEWORTHY_FALL:
        return BETTER_ELSEWHERE
    unexplained = unexplained_groups(evidence, minimum)
    if unexplained and 2 * sum(unexplained.values()) >= minimum.problem.num_data:
        return (
            f"hardly anything of {', '.join(unexplained)} is explained (less than a fifth of the variance); "
            "check units, signs and frames, start closer, or search from more starts"
        )
    return SUCCESSFUL


# --- kinks ---------------------------------------------------------------------------------------
# There the sum of squares rises on both sides of a parameter, although its slope is not zero. A model whose derivative
# jumps has them. Searches end beside such a place and look as if they had stopped short.


def slopes(outcome: Outcome) -> np.ndarray:
    """(parameters,), of the cost, over what residuals and derivatives could make them."""
    column, total = np.linalg.norm(outcome.jacobian, axis=0), np.linalg.norm(outcome.residual)
    slope = np.abs(outcome.jacobian.T @ outcome.residual)
    return slope / np.maximum(column * total, TINY)


def is_steep(minimum: Minimum, evidence: Evidence) -> bool:
    """Whether the cost has a slope where the search ended, not counting parameters at a bound.

    Where kinks stop a search, the slope counts only if a whole step of Gauss-Newton promises as much as `NEAR`.
    """
    outcome = minimum.outcome
    exact = np.linalg.norm(outcome.residual) <= EXACT * np.sqrt(outcome.residual.size)
    steepest = max(STEEPEST, FAR * np.sqrt(minimum.problem.noteworthy)) if outcome.solved else STEEPEST_UNSOLVED
    if exact or not np.any(slopes(outcome)[~evidence.at_bound] > steepest):
        return False
    columns = outcome.jacobian / np.maximum(np.linalg.norm(outcome.jacobian, axis=0), TINY)
    promised = columns @ np.linalg.lstsq(columns, outcome.residual, rcond=LEAST_RANK)[0]
    near = np.sum(promised**2) < NEAR**2 * outcome.cost / minimum.problem.num_data
    return not (outcome.solved and near)


def kink_of(minimum: Minimum, evidence: Evidence) -> tuple[int, Minimum] | None:
    """The parameter with the kink, and the minimum there; None if the search did not end at a kink.

    One parameter after the other is held, the one with the steepest slope first, and the others are fitted again.
    """
    slope = slopes(minimum.outcome)
    steep = np.flatnonzero(~evidence.at_bound & (slope > STEEPEST))
    found = ((i, _kink_in(i, minimum, evidence)) for i in steep[np.argsort(-slope[steep])].tolist())
    return next(((i, there) for i, there in found if there), None)


def _kink_in(i: int, minimum: Minimum, evidence: Evidence) -> Minimum | None:
    """The minimum at the kink in a parameter: None where there is none.

    A little to either side of its value, the sum of squares must be larger, also after the others are fitted again.
    """
    value = minimum.outcome.parameters
    held = hold_one(len(value), i, value[i])
    z = np.where(np.isnan(held), minimum.refit(held)[0].z, minimum.outcome.z)
    there = minimum._replace(outcome=evaluate(minimum.problem, z))
    others = ~evidence.at_bound & np.isnan(held)
    if not np.all(slopes(there.outcome)[others] <= STEEPEST):
        return None
    away = BESIDE * evidence.spectrum.relative_error[i] * evidence.size[i]
    space = minimum.problem.space
    for place in (value[i] - away, value[i] + away):
        inside = space.lower[i] < place < space.upper[i]
        if not inside or not there.refit(hold_one(len(value), i, place))[1] > 0:
            return None
    return there._replace(outcome=there.outcome._replace(num_steps=minimum.outcome.num_steps))


# --- valleys --------------------------------------------------------------------------------------


def look_along_valleys(
    minimum: Minimum, evidence: Evidence, determination: Determination
) -> tuple[Evidence, float, np.ndarray | None]:
    """Hold each parameter that looks identified at values further and further away, and fit the others again.

    The curvature at a minimum can suggest an interval although the valley is flat further away. A side is closed if the
    sum of squares rises there by twice the rise at the end of a 95 % interval. If it rises by much less than the
    curvature predicts, that side of the interval is made longer. Returns the evidence with the open and the limited
    parameters and the longer sides, the least rise of the sum of squares at all places, and the z of this place: None
    if it fell nowhere.
    """
    space, value = minimum.problem.space, evidence.value
    reach = evidence.uncertainty(np.eye(len(value)))
    error, enough, half_width = reach.standard_error, closing_rise(reach), reach.half_width
    tried: list[tuple[float, np.ndarray | None]] = [(0.0, None)]  # rise and z

    def end(i: int, places: np.ndarray) -> float:
        """The end of the interval over its half-width, where the sum of squares rises enough at one of the places.

        The nearest place comes first. Infinite if the sum of squares rises enough nowhere.
        """
        distance, roots = abs(places - value[i]) / half_width[i], []
        for k, place in enumerate(places):
            held = hold_one(len(value), i, place)
            z = None if k else minimum.beside(i, place)  # further away, the valley may bend
            expected = ((place - value[i]) / error[i]) ** 2
            needed = min(enough[i], EXPECTED_PART * expected)
            limit = needed if k else max(needed, STRAIGHT * expected)
            moved, rise = minimum.refit(held, z, limit)
            if k == 0 and np.isnan(rise):
                moved, rise = minimum.refit(held, closing_rise=limit)
            if rise < 0:
                tried.append((rise, np.where(np.isnan(held), moved.z, space.inverse(i, place))))
            roots.append(np.sqrt(max(rise, 0.0)) / reach.quantile[i] if np.isfinite(rise) else np.inf)
            if not rise <= needed:  # NaN: the model ends there
                return _end_of_side(distance[: k + 1], np.array(roots))
        return np.inf

    status = np.array([determination.status[name] for name in space.names])
    ends = np.ones((len(value), 2))  # below, above
    for i in np.flatnonzero(status == IDENTIFIED).tolist():
        ends[i] = [end(i, places) for places in _sides(space, i, value[i], half_width[i])]
    opened = np.flatnonzero(np.any(np.isinf(ends), axis=1)).tolist()
    near = np.isfinite(space.lower) & (value - half_width <= space.lower) & np.isin(status, (NOT_IDENTIFIED, AT_BOUND))
    near &= np.isfinite(half_width) & (value + half_width < space.upper)
    for i in np.flatnonzero(near).tolist():
        ends[i, 1] = end(i, value[i] + half_width[i] * np.array([1.0, 2.0]))
    limited = np.flatnonzero(near & np.isfinite(ends[:, 1])).tolist()
    if opened or limited or np.any(ends > 1):
        ends = np.where(np.isfinite(ends), ends, 1.0)
        evidence = replace(evidence, open_profile=tuple(opened), bounded_above=tuple(limited), ends=ends)
    return evidence, *min(tried, key=lambda place: place[0])


def _end_of_side(distance: np.ndarray, root: np.ndarray) -> float:
    """Where one side of a 95 % interval ends, in half-widths by the curvature: where the root of the rise is 1.

    The root of the rise of the sum of squares, over that at the end of an interval, is known at some distances. By the
    curvature it would be the distance. If it is much less at the first one, it is taken for a parabola through this
    place and the estimate, or, further away, for a straight line between the last two places.
    """
    part = root[0] / distance[0]
    if part**2 >= STRAIGHT:
        return 1.0
    if root[0] < 1 and len(root) > 1:
        return float(np.interp(1.0, root[-2:], distance[-2:])) if np.isfinite(root[-1]) else float(distance[-1])
    return float(2 / (1 + np.sqrt(max(1 + 4 * (part - 1) / distance[0], 0.0))))


def closing_rise(reach: Uncertainty) -> np.ndarray:
    """The rise of the sum of squares that closes the interval of each quantity: twice that at its ends."""
    return CLOSING_RISE * reach.quantile**2


def are_products(minimum: Minimum, evidence: Evidence, determination: Determination) -> bool:
    """Whether the data determine products of powers of the unidentified parameters.

    They do not if the sum of squares rises when these parameters are doubled or halved along their valley, by more than
    would close the interval of any of them.
    """
    space, best = minimum.problem.space, minimum.outcome
    lost = np.array([determination.status[name] == NOT_IDENTIFIED for name in determination.names])
    if np.count_nonzero(lost) < 2 or np.any(best.parameters[lost] <= 0) or not np.all(np.isfinite(best.jacobian)):
        return True
    enough = np.max(closing_rise(evidence.uncertainty(np.eye(lost.size)[lost])))
    _, values, directions = np.linalg.svd(np.linalg.qr(best.jacobian, mode="r"))  # all directions, however many rows
    for singular, direction in itertools.zip_longest(values, directions, fillvalue=0.0):
        along = np.where(lost, direction, 0.0)
        if singular * LARGEST_RELATIVE_ERROR > 1 or np.linalg.norm(along) < MOSTLY_LOST:
            continue
        for factor in (0.5, 2.0):
            place = best.parameters * factor ** (along / np.abs(along).max())
            if np.any(place <= space.lower) or np.any(place >= space.upper):
                continue
            _, rise = minimum.refit(np.where(lost, place, np.nan))
            if not rise <= enough:
                return False
    return True


def nearest_to_start(minimum: Minimum, evidence: Evidence) -> Outcome:
    """The place along the first open valley where its parameter has its start value, if it fits equally well.

    Noise makes shallow minima somewhere in the valley.
    """
    problem, best = minimum
    i, first = evidence.open_profile[0], problem.space.first()
    (enough,) = closing_rise(evidence.uncertainty(np.eye(len(first))[[i]]))
    held = hold_one(len(first), i, problem.space.start[i])
    moved, _ = minimum.refit(held)
    there = evaluate(problem, np.where(np.isnan(held), moved.z, first))
    return there if there.cost - best.cost <= enough else best


def _sides(space: ParameterSpace, i: int, value: float, half_width: float) -> tuple[np.ndarray, np.ndarray]:
    """Places below and above an estimate: 2 and 10 half-widths of its interval away, and a fifth and five times it."""
    lower, upper, reach = float(space.lower[i]), float(space.upper[i]), np.array([2.0, 10.0]) * half_width
    below = np.maximum(value - reach, value - 0.9 * (value - lower))
    above = np.minimum(value + reach, value + 0.9 * (upper - value))
    if np.isfinite(lower) and not np.isfinite(upper):
        below, above = np.append(below, lower + (value - lower) / 5), np.append(above, lower + (value - lower) * 5)
    return below, above
