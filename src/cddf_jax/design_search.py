"""Searches for the best body: from one start or many, and again where limits are broken between the stations."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from .constrained import ACTIVE, TOLERANCE, Local, Point, least_violation, minimise, optimality
from .design_problem import Evaluation, Problem, split
from .design_program import Program
from .lanes import Lanes

WANDERING = 16  # stations at the end, put where limits are broken between the others
LOOKS = 6  # how often that is done
FINE = 768  # places at which it is looked for
SEARCHES = 4  # from the best of many starts
NEAR = 1e-2  # a margin that may be used up between the points of the grid
NOT_ZERO = 1e-6  # a multiplier
BROKEN = 10.0  # what a violation counts beside the objective when starts are compared
MUTE = 1e-4  # of the objective, or of a limit: what a number that tells nothing would change over its whole range
AWAY = tuple(0.25**k for k in range(1, 7))  # of its range, how far such a number is moved, the first that can be
GAIN = 10 * TOLERANCE  # of the objective, by which a body is better and not only nearer to its limits
NOTHING = 1e-12  # of the objective at the start

Watch = Callable[[str], None]
History = list[tuple[float, float]]


class Again(NamedTuple):
    """Another search, because at the end of one no first derivative told whether some numbers should change."""

    numbers: np.ndarray  # their places among the free numbers
    old: np.ndarray  # where they stood
    new: np.ndarray  # where the other search put them at first
    better: bool  # whether it led to a better body


class Outcome(NamedTuple):
    """Where the search from one start ended, or the best of several."""

    local: Local
    program: Program
    violation: float  # also between the stations
    blocking: tuple[str, ...]  # limits in one another's way, where it is not feasible
    history: History
    evaluations: int
    starts: tuple[float, ...] = ()
    again: tuple[Again, ...] = ()

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
    def evaluation(self) -> Evaluation:
        return self.program.evaluation(self.local.point.x)


class Search:
    """Searches of one problem.

    Args:
        problem: its last `WANDERING` stations are moved.
        max_iterations: of every search.
        watch: is told in words how it goes.
    """

    def __init__(self, problem: Problem, max_iterations: int, watch: Watch):
        self.problem, self.max_iterations, self.watch = problem, max_iterations, watch
        self.program, space = Program(problem), problem.space
        heights = np.full(len(problem.peaks), np.inf)
        self.lower = np.append(np.zeros(len(space.names)), -heights)
        self.upper = np.append((np.asarray(space.upper) - space.lower) / space.size, heights)

    def from_starts(self, starts: int, seed: int) -> Outcome:
        """The best from the start, and from the best of some points within the bounds."""
        space = self.problem.space
        points = [space.scaled(space.start), *self._screened(starts, seed)]
        outcomes = [self.from_start(z) for z in points]
        best = min(outcomes, key=lambda outcome: outcome.rank)
        return best._replace(
            starts=tuple(outcome.value for outcome in outcomes), evaluations=sum(o.evaluations for o in outcomes)
        )

    def _screened(self, starts: int, seed: int) -> list[np.ndarray]:
        """The most promising of `starts` - 1 points, all tried at once on all devices."""
        if starts <= 1:
            return []
        self.watch(f"trying {starts - 1} starts")
        count = len(self.problem.space.names)
        draws = qmc.Sobol(count, rng=np.random.default_rng(seed)).random(2 ** int(np.ceil(np.log2(starts))))
        points = draws[: starts - 1] * self.upper[:count]
        merit = Lanes(_Merit(self.problem), len(points))(points, len(points))
        good = [i for i in np.argsort(merit)[:SEARCHES] if np.isfinite(merit[i])]
        return [points[i] for i in good]

    def with_heights(self, z: Any) -> np.ndarray:
        """Scaled free numbers, and behind them the heights that the peaks have."""
        found = self.program.evaluation(np.append(z, np.zeros(len(self.problem.peaks))))
        terms = self.problem.terms
        return np.append(z, [np.max(found.aims[i]) / float(terms[i].reference) for i in self.problem.peaks])

    def from_start(self, z: Any) -> Outcome:
        """The best from one start, and from elsewhere where first derivatives tell nothing of some numbers.

        So it is with a bore of radius 0: area and second moment grow with its square and its fourth power.
        """
        found = self._from(z)
        for _ in range(LOOKS):
            mute = self._mute(found.local.point, z)
            away = self._moved_away(found, mute)
            if away is None:
                break
            other = self._from(away)
            old, new = (np.asarray(self.problem.space.numbers(x[: len(z)]))[mute] for x in (found.local.point.x, away))
            best, rest = (other, found) if (better := _is_better(other, found)) else (found, other)
            found = best._replace(
                history=rest.history + best.history,
                evaluations=rest.evaluations + best.evaluations,
                again=(*found.again, Again(mute, old, new, better)),
            )
            if not better:
                break
        return found

    def _mute(self, point: Point, start: np.ndarray) -> np.ndarray:
        """Numbers at a bound or where they began, of which neither the objective nor what holds it back has a slope."""
        count = len(start)
        x, range_ = point.x[:count], self.upper[:count]
        held = point.inequality_slopes[point.inequality <= ACTIVE]
        slopes = np.concatenate([point.gradient[None], held, point.equality_slopes])[:, :count]
        flat = np.max(np.abs(slopes), axis=0) * range_ <= MUTE
        still = (x <= ACTIVE) | (x >= range_ - ACTIVE) | (np.abs(x - start) <= MUTE * range_)
        return np.flatnonzero(flat & still)

    def _moved_away(self, found: Outcome, mute: np.ndarray) -> np.ndarray | None:
        """The free numbers with the mute ones off their places, within the limits if that can be; None if it cannot."""
        if mute.size == 0:
            return None
        point, away = found.local.point, None
        x, range_ = point.x[: len(self.problem.space.names)], self.upper[: len(self.problem.space.names)]
        broken = max(TOLERANCE, -float(np.min(point.inequality, initial=0.0)))
        for part in AWAY:
            z = x.copy()
            z[mute] += part * (range_ * np.where(x > range_ / 2, -1.0, 1.0))[mute]
            there = self.program(self.with_heights(z))
            away = z if there.usable else away
            if there.usable and np.min(there.inequality, initial=0.0) >= -broken:
                return z
        return away

    def _from(self, z: Any) -> Outcome:
        """The search from one start, again where limits turn out to be broken between the stations."""
        program, history = self.program, []
        local, blocking = self._search(program, self.with_heights(z), history)
        violation, places = broken_between(program, local)
        evaluations = local.evaluations
        for _ in range(LOOKS):
            if violation <= TOLERANCE or not local.feasible:
                break
            program = _moved(program, places)
            local, blocking = self._search(program, local.point.x, history)
            violation, places = broken_between(program, local)
            evaluations += local.evaluations
        return Outcome(local, program, violation, blocking, history, evaluations)

    def _search(self, program: Program, x: np.ndarray, history: History) -> tuple[Local, tuple[str, ...]]:
        """From where the limits are broken least where the first search ends outside of them."""
        bounds = self.lower, self.upper

        def watch(count: int, point: Point) -> None:
            history.append((point.objective, point.violation))
            self.watch(f"iteration {len(history)}: objective {point.objective:.6g}, violation {point.violation:.2g}")

        options: Any = {"max_iterations": self.max_iterations, "watch": watch}
        local = minimise(program, x, *bounds, **options)
        if local.feasible:
            return local, ()
        rigid = sum(int(np.prod(np.shape(aim))) for aim in self._peak_aims(program, local.point.x))
        least = least_violation(program, local.point.x, *bounds, rigid)
        inner = least.point.x[:-1]
        if least.point.objective > TOLERANCE:
            point = program(inner)
            return local._replace(point=point, optimality=optimality(point, *bounds)), self._blocking(program, least)
        return minimise(program, inner, *bounds, **options), ()

    def _peak_aims(self, program: Program, x: np.ndarray) -> list[np.ndarray]:
        aims = program.evaluation(x).aims
        return [np.asarray(aims[i]) for i in self.problem.peaks]

    def _blocking(self, program: Program, least: Local) -> tuple[str, ...]:
        """Limits and bounds whose multipliers are not zero where they are broken least."""
        found, held = program.evaluation(least.point.x[:-1]), least.optimality
        zeros = sum(zero.size for zero in found.zeros)
        above, below = held.inequality[-2 * zeros or len(held.inequality) :].reshape(2, zeros)
        own = list(zip(split(held.inequality, found.margins), split(above + below, found.zeros), strict=True))
        limits = zip(self.problem.limits, own, strict=True)
        names = [str(limit) for limit, parts in limits if any(np.any(part > NOT_ZERO) for part in parts)]
        space, n = self.problem.space, len(self.problem.space.names)
        for side, ends in (("lower", held.lower), ("upper", held.upper)):
            names += [f"{side} bound of {space.label(int(i))}" for i in np.flatnonzero(ends[:n] > NOT_ZERO)]
        return tuple(dict.fromkeys(names))


def _is_better(one: Outcome, other: Outcome) -> bool:
    """By more than tolerances: keeping to the limits where the other does not, or the smaller objective."""
    if not (one.feasible and other.feasible):
        return one.feasible or (not other.feasible and one.violation < other.violation - TOLERANCE)
    return one.value < other.value - max(GAIN * abs(other.value), NOTHING)


class _Merit(eqx.Module):
    """How promising a start is; infinite where there is no answer."""

    problem: Problem

    def __call__(self, z: Any) -> Any:
        found = self.problem.evaluate(z)
        total = jnp.zeros(())
        for i, (term, aim) in enumerate(zip(self.problem.terms, found.aims, strict=True)):
            value = jnp.max(aim) if i in self.problem.peaks else self.problem.mean(aim)
            total += term.weight / term.reference * value
        broken = [jnp.max(-margin, initial=0.0) for margin in found.margins]
        broken += [jnp.max(jnp.abs(zero), initial=0.0) for zero in found.zeros]
        merit = total + BROKEN * jnp.max(jnp.stack([jnp.zeros(()), *broken]))
        return jnp.where(jnp.isfinite(merit), merit, jnp.inf)


# --- between the stations ------------------------------------------------------------------------


def broken_between(program: Program, local: Local) -> tuple[float, np.ndarray]:
    """The largest violation anywhere along the body, and the places (over the length) where limits are broken.

    On a fine grid, and where the parabola through three neighbours on it says that a limit is lower still.
    """
    fine = np.linspace(0.0, 1.0, FINE)
    on_grid = _margins(program, local, fine)
    between = _lowest(fine, on_grid)[: len(program.problem.stations)]
    looked, margins = fine, on_grid
    if between.size:
        looked = np.concatenate([fine, between])
        margins = np.concatenate([on_grid, _margins(program, local, between)], axis=1)
    worst = np.min(margins, axis=0, initial=np.inf)
    order = np.argsort(worst)[:WANDERING]
    violation = max(local.point.violation, -float(np.min(worst, initial=0.0)))
    return violation, looked[order[worst[order] < -TOLERANCE / 4]]


def _margins(program: Program, local: Local, places: np.ndarray) -> np.ndarray:
    """(rows, places) of every limit along the body, and of every peak below its height."""
    problem, point, count = program.problem, local.point, len(program.problem.stations)
    heights = dict(zip(problem.peaks, point.x[len(problem.space.names) :], strict=True))
    blocks = [places[start : start + count] for start in range(0, len(places), count)]
    padded = [np.pad(block, (0, count - len(block)), mode="edge") for block in blocks]
    found = [program.at_stations(block).evaluation(point.x) for block in padded]
    parts = [[each.margins[i] for each in found] for i, limit in enumerate(problem.limits) if limit.along]
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


def _moved(program: Program, places: np.ndarray) -> Program:
    """The program with stations where limits were broken, in the place of the oldest of those that wander."""
    stations = np.asarray(program.problem.stations)
    kept, wandering = stations[:-WANDERING], stations[-WANDERING:]
    return Program(
        replace(program.problem, stations=jnp.asarray(np.concatenate([kept, wandering[len(places) :], places])))
    )
