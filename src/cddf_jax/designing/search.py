"""Searches for the best body: from one start or many, and again where limits are broken between the stations."""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ..progress import each, stage
from ..statics.status import Status
from .constrained import (
    ACTIVE,
    LITTLE,
    TOLERANCE,
    LocalMinimum,
    Point,
    least_violation,
    minimise_constrained,
    optimality,
)
from .problem import USABLE, DesignEvaluation, DesignProblem, pieces_of

WANDERING = 16  # last stations, which are moved to where limits are broken between the others
LOOKS = 6  # how often a search begins again where it ended
FINE = 768  # places at which limits are checked between the stations
SEARCHES = 4  # from the best of many starts
NEAR = 1e-2  # a margin that may be negative between the points of the grid
NOT_ZERO = 1e-6  # a multiplier
BROKEN = 10.0  # weight of a violation beside the objective when starts are compared
FLAT = 1e-4  # scaled: a number is flat if its slopes, over its whole range, change objective and limits by less
AWAY = 1 / 16  # of its range: how far a flat number is moved
GAIN = 10 * TOLERANCE  # of the objective at the start: a body is better only by more than this
BODIES = 8  # drawn within the bounds, to see whether an objective differs between bodies


class SearchResult(NamedTuple):
    """Where the search from one start ended, or the best of several."""

    local: LocalMinimum
    problem: DesignProblem  # with the stations of the last search
    violation: float  # also between the stations
    blocking: tuple[str, ...]  # limits that contradict each other, if it is not feasible
    starts: tuple[float, ...] = ()  # the objective reached from each start
    remarks: tuple[str, ...] = ()

    @property
    def feasible(self) -> bool:
        return self.violation <= TOLERANCE

    @property
    def value(self) -> float:
        return self.local.point.objective if self.feasible else float("inf")

    @property
    def rank(self) -> tuple[float, float]:
        return self.value, self.violation

    @property
    def evaluation(self) -> DesignEvaluation:
        return self.problem.evaluation(self.local.point.x)

    @property
    def z(self) -> np.ndarray:
        """The scaled free numbers."""
        return np.asarray(self.problem.split(self.local.point.x)[0])


class DesignSearch:
    """Searches of one problem, whose last `WANDERING` stations are moved."""

    def __init__(self, problem: DesignProblem, max_iterations: int):
        self.problem, self.max_iterations = problem, max_iterations
        heights = np.full(len(problem.peaks), np.inf)
        self.ranges = problem.free.ranges
        self.bounds = np.append(0 * self.ranges, -heights), np.append(self.ranges, heights)

    def from_starts(self, starts: int, seed: int) -> SearchResult:
        """The best of the searches from the start and from the best of some points within the bounds."""
        points = [self.problem.free.scaled_start, *self._screened(starts, seed)]
        found = [self.from_start(z) for z in each("search from start", points)]
        best = min(found, key=lambda each: each.rank)
        return best._replace(starts=tuple(each.value for each in found))

    def _screened(self, starts: int, seed: int) -> list[np.ndarray]:
        """The most promising of `starts` - 1 points, by the objective and a penalty for the largest violation."""
        from scipy.stats import qmc

        if starts <= 1:
            return []
        sobol = qmc.Sobol(self.ranges.size, rng=np.random.default_rng(seed))
        points = sobol.random(2 ** int(np.ceil(np.log2(starts))))[: starts - 1] * self.ranges
        there = [self.problem(self.with_heights(z)) for z in each("trying start", list(points))]
        merit = [point.objective + BROKEN * point.violation if point.usable else np.inf for point in there]
        return [points[i] for i in np.argsort(merit)[:SEARCHES] if np.isfinite(merit[i])]

    def with_heights(self, z: np.ndarray) -> np.ndarray:
        """Scaled free numbers, followed by the heights of the peaks there."""
        problem = self.problem
        aims = problem.evaluation(np.append(z, np.zeros(len(problem.peaks)))).aims
        return np.append(z, [np.max(aims[i]) / float(problem.terms[i].reference) for i in problem.peaks])

    def from_start(self, z: np.ndarray) -> SearchResult:
        """The best from one start; it searches again from elsewhere if some numbers have no slope at its end.

        An example is a bore of radius 0: area and second moment grow with its square and its fourth power.
        """
        found = self._from(z)
        flat = self._flat(found.local.point, z)
        moved = found.z + np.where(flat, AWAY * self.ranges * np.where(found.z > self.ranges / 2, -1.0, 1.0), 0.0)
        if not np.any(flat) or not self.problem(self.with_heights(moved)).usable:
            return found
        other, free = self._from(moved), self.problem.free
        if other.feasible and found.feasible:
            better = other.value < found.value - GAIN * abs(found.value)
        else:
            better = other.rank < found.rank
        result = "found a better body" if better else "found no better body"
        places = free.in_words(found.z, flat), free.in_words(moved, flat)
        remark = f"{places[0]}: the objective has no slope there; a search from {places[1]} {result}"
        return (other if better else found)._replace(remarks=(remark,))

    def _flat(self, point: Point, start: np.ndarray) -> np.ndarray:
        """Which numbers are at a bound or at their start, and change neither the objective nor an active limit."""
        x, count = point.x[: start.size], start.size
        active = point.inequality_slopes[point.inequality <= ACTIVE]
        slopes = np.concatenate([point.gradient[None], active, point.equality_slopes])[:, :count]
        still = (x <= ACTIVE) | (x >= self.ranges - ACTIVE) | (np.abs(x - start) <= FLAT * self.ranges)
        return still & (np.max(np.abs(slopes), axis=0) * self.ranges <= FLAT)

    def _from(self, z: np.ndarray) -> SearchResult:
        """The search from one start, repeated while that helps and it is not stationary, or limits are broken between.

        If limits are broken at its end, it begins again at the point that breaks them least.
        """
        problem, x, looks, before = self.problem, self.with_heights(z), 0, np.inf
        while True:
            local, blocking = self._minimum(problem, x), ()
            if not local.feasible:
                least = least_violation(problem, local.point.x, *self.bounds)
                x = least.point.x[:-1]
                if least.point.objective <= TOLERANCE:
                    local = self._minimum(problem, x)
                else:
                    point, blocking = problem(x), self._blocking(problem, least)
                    local = local._replace(point=point, optimality=optimality(point, *self.bounds))
            violation, places = broken_between(problem, local)
            ended = local.iterations >= self.max_iterations or local.point.objective > before - LITTLE
            done = violation <= TOLERANCE and (local.stationary or ended)
            if done or not local.feasible or looks == LOOKS:
                return SearchResult(local, problem, violation, blocking)
            kept, wandering = np.split(np.asarray(problem.stations), [-WANDERING])
            moved = np.concatenate([kept, wandering[len(places) :], places])  # in place of the oldest
            problem, x, looks = replace(problem, stations=jnp.asarray(moved)), local.point.x, looks + 1
            before = local.point.objective

    @stage("searching")
    def _minimum(self, problem: DesignProblem, x: np.ndarray) -> LocalMinimum:
        return minimise_constrained(problem, x, *self.bounds, max_iterations=self.max_iterations)

    def _blocking(self, problem: DesignProblem, least: LocalMinimum) -> tuple[str, ...]:
        """Limits and bounds with multipliers that are not zero, at the point that breaks them least."""
        found, multipliers = problem.evaluation(least.point.x[:-1]), least.optimality
        of_ranges = pieces_of(multipliers.inequality, found.margins)
        count = multipliers.inequality.size - 2 * sum(zero.size for zero in found.zeros)
        above, below = np.split(multipliers.inequality[count:], 2)
        of_equations = pieces_of(above + below, found.zeros)
        names = [
            str(limit)
            for limit, *prices in zip(problem.limits, of_ranges, of_equations, strict=True)
            if any(np.any(price > NOT_ZERO) for price in prices)
        ]
        for side, prices in (("lower", multipliers.lower), ("upper", multipliers.upper)):
            numbers = np.flatnonzero(prices[: self.ranges.size] > NOT_ZERO)
            names += [f"{side} bound of {problem.free.label(int(i))}" for i in numbers]
        return tuple(dict.fromkeys(names))


def indifferent(problem: DesignProblem, z: np.ndarray) -> tuple[int, ...]:
    """The objectives that no free number changes: at z they are what they were at the start, and in every other body.

    The other bodies are drawn around z, within the bounds. Their equilibria differ, which a slope at z does not show.
    """
    best = _sizes(problem, z)
    same = np.abs(_sizes(problem, problem.free.scaled_start) - best) <= GAIN
    if np.any(same):
        drawn = np.random.default_rng(0).random((BODIES, z.size)) * problem.free.ranges
        others = np.array([_sizes(problem, z + (other - z) / 4) for other in drawn])
        known = others[np.all(np.isfinite(others), axis=1)]
        same &= np.all(np.abs(known - best) <= GAIN, axis=0) & (len(known) > 0)
    return tuple(int(i) for i in np.flatnonzero(same))


def _sizes(problem: DesignProblem, z: np.ndarray) -> np.ndarray:
    """Every objective over its size at the start; NaN for a body without an accurate equilibrium."""
    found = problem.evaluation(np.append(z, np.zeros(len(problem.peaks))))
    sizes = [
        problem.over_the_cases(i, aim) / term.reference
        for i, (aim, term) in enumerate(zip(found.aims, problem.terms, strict=True))
    ]
    accurate = np.isin(found.codes, USABLE) & (found.codes != Status.inaccurate)
    return np.where(np.all(accurate), np.asarray(sizes, float), np.nan)


# --- between the stations ------------------------------------------------------------------------


def broken_between(problem: DesignProblem, local: LocalMinimum) -> tuple[float, np.ndarray]:
    """The largest violation anywhere along the body, and the places (over the length) where limits are broken.

    Limits are checked on a fine grid, and at minima of parabolas through three neighbours of the grid.
    """
    fine = np.linspace(0.0, 1.0, FINE)
    on_grid = _margins(problem, local, fine)
    between = np.append(_lowest(fine, on_grid)[: len(problem.stations) - 1], 1.0)
    looked = np.concatenate([fine, between])
    margins = np.concatenate([on_grid, _margins(problem, local, between)], axis=1)
    worst = np.min(margins, axis=0, initial=np.inf)
    order = np.argsort(worst)[:WANDERING]
    violation = max(local.point.violation, -float(np.min(worst, initial=0.0)))
    return violation, looked[order[worst[order] < -TOLERANCE / 4]]


def _margins(problem: DesignProblem, local: LocalMinimum, places: np.ndarray) -> np.ndarray:
    """(rows, places) of every limit along the body, and of every peak below its height."""
    count = len(problem.stations)
    blocks = np.pad(places, (0, -len(places) % count), mode="edge").reshape(-1, count)
    found = [_rows_along(replace(problem, stations=jnp.asarray(block)), local.point.x) for block in blocks]
    return np.concatenate(found, axis=1)[:, : len(places)]


def _rows_along(problem: DesignProblem, x: np.ndarray) -> np.ndarray:
    found = problem.evaluation(x)
    heights = dict(zip(problem.peaks, problem.split(x)[1], strict=True))
    rows = [margin for margin, limit in zip(found.margins, problem.limits, strict=True) if limit.known.along]
    for i, term in enumerate(problem.terms):
        if term.objective.peak:
            rows.append(heights[i] - found.aims[i] / float(term.reference))
    count = len(problem.stations)
    return np.concatenate([np.zeros((0, count)), *(row.reshape(-1, count) for row in rows)])


def _lowest(x: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Places between the points of a grid where rows have a local minimum near zero or below, the lowest first."""
    before, here, after = rows[:, :-2], rows[:, 1:-1], rows[:, 2:]
    bend = before - 2 * here + after
    row, i = np.nonzero((here <= before) & (here <= after) & (here < NEAR) & (bend > 0))
    shift = np.clip(0.5 * (before - after)[row, i] / bend[row, i], -0.5, 0.5)
    return (x[i + 1] + shift * (x[1] - x[0]))[np.argsort(here[row, i])]
