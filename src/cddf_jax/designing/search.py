"""Searches for the best body: from one start or many, and again where limits are broken between the stations."""

from collections.abc import Sequence
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
    local_minimum,
    minimise_constrained,
)
from .problem import USABLE, DesignEvaluation, DesignProblem, pieces_of

WANDERING = 16  # last stations, which are moved to where limits are broken between the others
LOOKS = 6  # how often a search begins again where it ended
LITTLE = 1e-4  # of the objective, scaled: a search that gains less does not begin again
FINE = 768  # places at which limits are checked between the stations
SEARCHES = 4  # from the best of many starts
NEAR = 1e-2  # a margin that may be negative between the points of the grid
NOT_ZERO = 1e-6  # a multiplier
BROKEN = 10.0  # weight of a violation beside the objective when starts are compared
FLAT = 1e-4  # scaled: a number is flat if its slopes, over its whole range, change objective and limits by less
AWAY = 1 / 16  # of its range: how far beside a flat start another search begins
GAIN = 10 * TOLERANCE  # of the objective at the start: one that changes by less is the same
BODIES = 8  # drawn within the bounds, to see whether an objective differs between bodies


class SearchResult(NamedTuple):
    """Where the search from one start ended, or the best of several."""

    local: LocalMinimum
    problem: DesignProblem  # with the stations of the last search
    violation: float  # also between the stations
    blocking: tuple[str, ...]  # limits that contradict each other, if it is not feasible
    starts: tuple[float, ...] = ()  # the objective reached from each start

    @property
    def feasible(self) -> bool:
        return self.violation <= TOLERANCE

    @property
    def value(self) -> float:
        return self.local.point.objective if self.feasible else float("inf")

    @property
    def evaluation(self) -> DesignEvaluation:
        return self.problem.evaluation(self.local.point.x)

    @property
    def z(self) -> np.ndarray:
        """The scaled free numbers."""
        return np.asarray(self.problem.split(self.local.point.x)[0])


def search_designs(problem: DesignProblem, starts: Sequence[np.ndarray]) -> SearchResult:
    """Searches that begin at some scaled free numbers; the first of those that end as well as the best."""
    found = [_repeated(problem, z) for z in each("search from start", starts)]
    value, violation = min((each.value, each.violation) for each in found)
    best = next(
        each
        for each in found
        if each.value <= value + GAIN * abs(value) and each.violation <= max(violation, TOLERANCE)
    )
    return best._replace(starts=tuple(each.value for each in found))


def search_starts(problem: DesignProblem, tried: int = 1) -> list[np.ndarray]:
    """The start, a point beside it if it is flat, and the best of `tried` - 1 points by objective and violation."""
    start, ranges = problem.free.scaled_start, problem.free.ranges
    first = [start, *_beside(problem, start)]
    if tried == 1:
        return first
    from scipy.stats import qmc

    points = qmc.Sobol(ranges.size, rng=0).random(2 ** int(np.ceil(np.log2(tried))))
    points = points[: tried - 1] * ranges
    there = [problem(problem.unknowns(z)) for z in each("trying start", list(points))]
    merit = [point.objective + BROKEN * point.violation if point.usable else np.inf for point in there]
    return [*first, *(points[i] for i in np.argsort(merit)[:SEARCHES] if np.isfinite(merit[i]))]


def _beside(problem: DesignProblem, start: np.ndarray) -> list[np.ndarray]:
    """A point beside the start, if some numbers change neither the objective nor a limit that holds it back.

    An example is a bore of radius 0: area and second moment grow with its square and its fourth power.
    """
    point, ranges = problem(problem.unknowns(start)), problem.free.ranges
    slopes = np.concatenate([point.gradient[None], point.slopes[point.equal | (point.margins <= ACTIVE)]])
    flat = np.max(np.abs(slopes), axis=0)[: start.size] * ranges <= FLAT
    moved = start + np.where(flat, AWAY * ranges * np.where(start > ranges / 2, -1.0, 1.0), 0.0)
    return [moved] if np.any(flat) and problem(problem.unknowns(moved)).usable else []


def _repeated(problem: DesignProblem, z: np.ndarray) -> SearchResult:
    """The search from one start, repeated while that helps and it is not stationary, or limits are broken between.

    The last `WANDERING` stations are moved to where limits are broken.
    """
    x, before, looks = problem.unknowns(z), np.inf, 0
    while True:
        local, blocking = _minimum(problem, x)
        violation, places = broken_between(problem, local)
        done = local.stationary or local.point.objective > before - LITTLE
        if (done and violation <= TOLERANCE) or not local.feasible or looks == LOOKS:
            return SearchResult(local, problem, violation, blocking)
        kept, wandering = np.split(np.asarray(problem.stations), [-WANDERING])
        moved = np.concatenate([kept, wandering[len(places) :], places])  # in place of the oldest
        problem, x, looks = replace(problem, stations=jnp.asarray(moved)), local.point.x, looks + 1
        before = local.point.objective


@stage("searching")
def _minimum(problem: DesignProblem, x: np.ndarray) -> tuple[LocalMinimum, tuple[str, ...]]:
    """The end of one search, or of one more from the point that breaks the limits least; and limits that it breaks."""
    local = minimise_constrained(problem, x, *problem.bounds)
    if local.feasible:
        return local, ()
    least = least_violation(problem, local.point.x, *problem.bounds)
    x = least.point.x[:-1]
    if least.point.objective <= TOLERANCE:
        return minimise_constrained(problem, x, *problem.bounds), ()
    local = local_minimum(problem(x), *problem.bounds)
    return local, _blocking(problem, local.point, least)


def _blocking(problem: DesignProblem, point: Point, least: LocalMinimum) -> tuple[str, ...]:
    """Limits and bounds with multipliers that are not zero, at the point that breaks them least."""
    prices, from_below = np.split(least.limits.copy(), [point.margins.size])
    prices[point.equal] += from_below
    pieces = pieces_of(prices, problem.evaluation(point.x).margins)
    names = [str(kept.limit) for kept, own in zip(problem.limits, pieces, strict=True) if np.any(own > NOT_ZERO)]
    for side, prices in (("lower", least.lower), ("upper", least.upper)):
        numbers = np.flatnonzero(prices[: len(problem.free.names)] > NOT_ZERO)
        names += [f"{side} bound of {problem.free.label(int(i))}" for i in numbers]
    return tuple(dict.fromkeys(names))


def undetermined(problem: DesignProblem, z: np.ndarray) -> bool:
    """Whether no free number changes an objective: it is the same at z, at the start, and in bodies drawn around z.

    The equilibria of these bodies differ, which a slope at z does not show. Inaccurate ones do not count.
    """
    drawn = np.random.default_rng(0).random((BODIES, z.size)) * problem.free.ranges
    found = [problem.evaluation(x) for x in (problem.free.scaled_start, z, *(z + (drawn - z) / 4))]
    accurate = [each for each in found if np.all(np.isin(each.codes, USABLE) & (each.codes != Status.inaccurate))]
    terms = list(enumerate(problem.terms))
    sizes = [[float(problem.over_the_cases(i, each.aims[i]) / term.size) for i, term in terms] for each in accurate]
    return len(accurate) > 2 and bool(np.all(np.ptp(sizes, axis=0) <= GAIN))


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
    found = [replace(problem, stations=jnp.asarray(block)).rows_along(local.point.x) for block in blocks]
    return np.concatenate(found, axis=1)[:, : len(places)]


def _lowest(x: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Places between the points of a grid where rows have a local minimum near zero or below, the lowest first."""
    before, here, after = rows[:, :-2], rows[:, 1:-1], rows[:, 2:]
    bend = before - 2 * here + after
    row, i = np.nonzero((here <= before) & (here <= after) & (here < NEAR) & (bend > 0))
    shift = np.clip(0.5 * (before - after)[row, i] / bend[row, i], -0.5, 0.5)
    return (x[i + 1] + shift * (x[1] - x[0]))[np.argsort(here[row, i])]
