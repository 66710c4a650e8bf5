"""Searches for the best body: from one start or many, and again where limits are broken between the stations."""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ..progress import each, stage
from ..statics.status import Status
from .constrained import (
    ACTIVE,
    TOLERANCE,
    LocalMinimum,
    Point,
    least_violation,
    minimise_constrained,
    optimality,
)
from .problem import USABLE, DesignEvaluation, DesignProblem, pieces_of

WANDERING = 16  # last stations, which are moved to where limits are broken between the others
LOOKS = 6  # how often a search begins again
FINE = 768  # places at which limits are checked between the stations
SEARCHES = 4  # from the best of many starts
NEAR = 1e-2  # a margin that may be negative between the points of the grid
NOT_ZERO = 1e-6  # a multiplier
BROKEN = 10.0  # weight of a violation beside the objective when starts are compared
FLAT = 1e-4  # scaled: a number is flat if its slopes, over its whole range, change objective and limits by less
AWAY = tuple(0.25**k for k in range(1, 7))  # of its range: how far a flat number is moved; the first that works
GAIN = 10 * TOLERANCE  # of the objective: a body is better only by more than this
ROUNDING = 1e-12  # of the objective at the start
BODIES = 8  # drawn within the bounds, to see whether an objective differs between bodies
TOWARD = (1.0, 0.5, 0.25, 0.125)  # of the way to such a body, if it cannot be used; the first that works

History = list[tuple[float, float]]


class Restart(NamedTuple):
    """A further search, because some numbers had no slope at the end of the one before."""

    numbers: np.ndarray  # their indices among the free numbers
    old: np.ndarray  # their values at that end
    new: np.ndarray  # their values at the new start
    better: bool  # whether it led to a better body


class SearchResult(NamedTuple):
    """Where the search from one start ended, or the best of several."""

    local: LocalMinimum
    problem: DesignProblem  # with the stations of the last search
    violation: float  # also between the stations
    blocking: tuple[str, ...]  # limits that contradict each other, if it is not feasible
    history: History
    evaluations: int
    starts: tuple[float, ...] = ()
    restarts: tuple[Restart, ...] = ()

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
        free = problem.free
        heights = np.full(len(problem.peaks), np.inf)
        self.ranges = np.asarray((free.upper - free.lower) / free.size)  # of the scaled free numbers, from 0
        self.bounds = np.append(0 * self.ranges, -heights), np.append(self.ranges, heights)

    def from_starts(self, starts: int, seed: int) -> SearchResult:
        """The best of the searches from the start and from the best of some points within the bounds."""
        points = [self.problem.free.scaled_start, *self._screened(starts, seed)]
        found = [self.from_start(z) for z in each("search from start", points)]
        best = min(found, key=lambda each: each.rank)
        evaluations = sum(each.evaluations for each in found)
        return best._replace(starts=tuple(each.value for each in found), evaluations=evaluations)

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
        """The best from one start; it searches again from elsewhere if some numbers have no slope.

        An example is a bore of radius 0: area and second moment grow with its square and its fourth power.
        """
        found = self._from(z)
        for _ in range(LOOKS):
            flat = self._flat(found.local.point, z)
            moved = self._moved_away(found, flat)
            if moved is None:
                break
            other = self._from(moved)
            better = _is_better(other, found)
            best, rest = (other, found) if better else (found, other)
            numbers = self.problem.free.numbers
            restart = Restart(flat, np.asarray(numbers(found.z))[flat], np.asarray(numbers(moved))[flat], better)
            found = best._replace(
                history=rest.history + best.history,
                evaluations=rest.evaluations + best.evaluations,
                restarts=(*found.restarts, restart),
            )
            if not better:
                break
        return found

    def _flat(self, point: Point, start: np.ndarray) -> np.ndarray:
        """Numbers at a bound or at their start, for which neither the objective nor an active limit has a slope."""
        x, count = point.x[: start.size], start.size
        active = point.inequality_slopes[point.inequality <= ACTIVE]
        slopes = np.concatenate([point.gradient[None], active, point.equality_slopes])[:, :count]
        flat = np.max(np.abs(slopes), axis=0) * self.ranges <= FLAT
        still = (x <= ACTIVE) | (x >= self.ranges - ACTIVE) | (np.abs(x - start) <= FLAT * self.ranges)
        return np.flatnonzero(flat & still)

    def _moved_away(self, found: SearchResult, flat: np.ndarray) -> np.ndarray | None:
        """The free numbers with the flat ones moved, within the limits if possible; None if they cannot be moved."""
        if flat.size == 0:
            return None
        moved, x = None, found.z
        broken = max(TOLERANCE, -float(np.min(found.local.point.inequality, initial=0.0)))
        for part in AWAY:
            z = x.copy()
            z[flat] += part * (self.ranges * np.where(x > self.ranges / 2, -1.0, 1.0))[flat]
            there = self.problem(self.with_heights(z))
            if there.usable:
                moved = z
                if np.min(there.inequality, initial=0.0) >= -broken:
                    break
        return moved

    def _from(self, z: np.ndarray) -> SearchResult:
        """The search from one start, repeated while limits are broken between the stations."""
        problem, x, history, evaluations, looks = self.problem, self.with_heights(z), [], 0, 0
        while True:
            local, blocking = self._search(problem, x, history)
            violation, places = broken_between(problem, local)
            evaluations += local.evaluations
            if violation <= TOLERANCE or not local.feasible or looks == LOOKS:
                return SearchResult(local, problem, violation, blocking, history, evaluations)
            problem, x, looks = _moved(problem, places), local.point.x, looks + 1

    def _search(self, problem: DesignProblem, x: np.ndarray, history: History) -> tuple[LocalMinimum, tuple[str, ...]]:
        """One search; if limits are broken at its end, another one from the point that breaks them least."""

        def minimum(x: np.ndarray) -> LocalMinimum:
            def after(count: int, point: Point) -> None:
                history.append((point.objective, point.violation))
                now.what = f"iteration {len(history)}: objective {point.objective:.6g}, violation {point.violation:.2g}"

            with stage("searching") as now:
                return minimise_constrained(problem, x, *self.bounds, max_iterations=self.max_iterations, after=after)

        local = minimum(x)
        if local.feasible:
            return local, ()
        aims = problem.evaluation(local.point.x).aims
        rigid = sum(aims[i].size for i in self.problem.peaks)
        least = least_violation(problem, local.point.x, *self.bounds, rigid=rigid)
        inner = least.point.x[:-1]
        if least.point.objective > TOLERANCE:
            point = problem(inner)
            broken = local._replace(point=point, optimality=optimality(point, *self.bounds))
            return broken, self._blocking(problem, least)
        return minimum(inner), ()

    def _blocking(self, problem: DesignProblem, least: LocalMinimum) -> tuple[str, ...]:
        """Limits and bounds with multipliers that are not zero, at the point that breaks them least."""
        found, multipliers = problem.evaluation(least.point.x[:-1]), least.optimality
        of_ranges = pieces_of(multipliers.inequality, found.margins)
        count = multipliers.inequality.size - 2 * sum(zero.size for zero in found.zeros)
        above, below = np.split(multipliers.inequality[count:], 2)
        of_equations = pieces_of(above + below, found.zeros)
        names = [
            str(limit)
            for limit, *prices in zip(self.problem.limits, of_ranges, of_equations, strict=True)
            if any(np.any(price > NOT_ZERO) for price in prices)
        ]
        for side, prices in (("lower", multipliers.lower), ("upper", multipliers.upper)):
            numbers = np.flatnonzero(prices[: self.ranges.size] > NOT_ZERO)
            names += [f"{side} bound of {self.problem.free.label(int(i))}" for i in numbers]
        return tuple(dict.fromkeys(names))


def _is_better(one: SearchResult, other: SearchResult) -> bool:
    """Whether one result keeps limits that the other breaks, or has a smaller objective, by more than tolerances."""
    if not (one.feasible and other.feasible):
        return one.feasible or (not other.feasible and one.violation < other.violation - TOLERANCE)
    return one.value < other.value - max(GAIN * abs(other.value), ROUNDING)


def indifferent(problem: DesignProblem, z: np.ndarray) -> tuple[int, ...]:
    """The objectives that no free number changes: at z they are what they were at the start, and in every other body.

    The other bodies are drawn within the bounds. Their equilibria differ, so a slope at z alone would not tell.
    """
    start, ranges = np.asarray(problem.free.scaled_start), (problem.free.upper - problem.free.lower) / problem.free.size
    best = _sizes(problem, z)
    same = _alike(best, _sizes(problem, start))
    for drawn in np.random.default_rng(0).random((BODIES, z.size)) if np.any(same) else ():
        others = (_sizes(problem, z + part * (drawn * np.asarray(ranges) - z)) for part in TOWARD)
        same &= _alike(best, next((other for other in others if np.all(np.isfinite(other))), best * np.nan))
    return tuple(int(i) for i in np.flatnonzero(same))


def _sizes(problem: DesignProblem, z: np.ndarray) -> np.ndarray:
    """Every objective over its size at the start; NaN for a body without an accurate equilibrium."""
    found = problem.evaluation(np.append(z, np.zeros(len(problem.peaks))))
    sizes = [
        problem.over_the_cases(i, aim) / term.reference
        for i, (aim, term) in enumerate(zip(found.aims, problem.terms, strict=True))
    ]
    accurate = np.isin(found.codes, USABLE) & (found.codes != Status.inaccurate)
    return np.asarray(sizes, float) if np.all(accurate) else np.full(len(sizes), np.nan)


def _alike(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.abs(one - other) <= GAIN


# --- between the stations ------------------------------------------------------------------------


def broken_between(problem: DesignProblem, local: LocalMinimum) -> tuple[float, np.ndarray]:
    """The largest violation anywhere along the body, and the places (over the length) where limits are broken.

    Limits are checked on a fine grid, and at minima of parabolas through three neighbours of the grid.
    """
    fine = np.linspace(0.0, 1.0, FINE)
    on_grid = _margins(problem, local, fine)
    between = _lowest(fine, on_grid)[: len(problem.stations)]
    looked, margins = fine, on_grid
    if between.size:
        looked = np.concatenate([fine, between])
        margins = np.concatenate([on_grid, _margins(problem, local, between)], axis=1)
    worst = np.min(margins, axis=0, initial=np.inf)
    order = np.argsort(worst)[:WANDERING]
    violation = max(local.point.violation, -float(np.min(worst, initial=0.0)))
    return violation, looked[order[worst[order] < -TOLERANCE / 4]]


def _margins(problem: DesignProblem, local: LocalMinimum, places: np.ndarray) -> np.ndarray:
    """(rows, places) of every limit along the body, and of every peak below its height."""
    point, count = local.point, len(problem.stations)
    heights = dict(zip(problem.peaks, problem.split(point.x)[1], strict=True))
    blocks = np.pad(places, (0, -len(places) % count), mode="edge").reshape(-1, count)
    found = [replace(problem, stations=jnp.asarray(block)).evaluation(point.x) for block in blocks]
    parts = [[each.margins[i] for each in found] for i, limit in enumerate(problem.limits) if limit.known.along]
    for i, term in enumerate(problem.terms):
        if term.objective.peak:
            parts.append([heights[i] - each.aims[i] / float(term.reference) for each in found])
    rows = [np.concatenate(part, axis=-1)[..., : len(places)].reshape(-1, len(places)) for part in parts if part]
    return np.concatenate([np.zeros((0, len(places))), *rows])


def _lowest(x: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Places between the points of a grid where rows have a local minimum near zero or below, the lowest first."""
    before, here, after = rows[:, :-2], rows[:, 1:-1], rows[:, 2:]
    bend = before - 2 * here + after
    row, i = np.nonzero((here <= before) & (here <= after) & (here < NEAR) & (bend > 0))
    shift = np.clip(0.5 * (before - after)[row, i] / bend[row, i], -0.5, 0.5)
    order = np.argsort(here[row, i])
    return np.unique((x[i + 1] + shift * (x[1] - x[0]))[order][: len(x)])


def _moved(problem: DesignProblem, places: np.ndarray) -> DesignProblem:
    """The problem with stations where limits were broken, in place of the oldest of those that move."""
    stations = np.asarray(problem.stations)
    kept, wandering = stations[:-WANDERING], stations[-WANDERING:]
    return replace(problem, stations=jnp.asarray(np.concatenate([kept, wandering[len(places) :], places])))
