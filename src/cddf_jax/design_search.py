"""Searches for the best body: from one start or many, and again where limits are broken between the stations."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from .constrained import TOLERANCE, Local, Point, least_violation, minimise
from .design_problem import Evaluation, Problem, split
from .design_program import Program
from .lanes import Lanes

WANDERING = 16  # stations at the end, put where limits are broken between the others
LOOKS = 6  # how often that is done
FINE = 768  # places at which it is looked for
SEARCHES = 4  # from the best of many starts
NOT_ZERO = 1e-6  # a multiplier
BROKEN = 10.0  # what a violation counts beside the objective when starts are compared

Watch = Callable[[str], None]
History = list[tuple[float, float]]


class Outcome(NamedTuple):
    """Where the search from one start ended, or the best of several."""

    local: Local
    program: Program
    violation: float  # also between the stations
    blocking: tuple[str, ...]  # limits in one another's way, where it is not feasible
    history: History
    evaluations: int
    starts: tuple[float, ...]

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
        return Outcome(local, program, violation, blocking, history, evaluations, ())

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
            return local._replace(point=point), self._blocking(program, least)
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
            names += [f"{side} bound of {space.names[i][0]}" for i in np.flatnonzero(ends[:n] > NOT_ZERO)]
        return tuple(dict.fromkeys(names))


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
    """The largest violation anywhere along the body, and the places (over the length) where limits are broken."""
    problem, point = program.problem, local.point
    count, fine = len(problem.stations), np.linspace(0.0, 1.0, FINE)
    blocks = [fine[start : start + count] for start in range(0, FINE, count)]
    padded = [np.pad(block, (0, count - len(block)), mode="edge") for block in blocks]
    found = [program.at_stations(block).evaluation(point.x) for block in padded]
    heights = dict(zip(problem.peaks, point.x[len(problem.space.names) :], strict=True))
    rows = [
        _rows([np.asarray(each.margins[i]) for each in found]) for i, limit in enumerate(problem.limits) if limit.along
    ]
    for i, term in enumerate(problem.terms):
        if term.objective.peak:
            rows.append(_rows([heights[i] - each.aims[i] / float(term.reference) for each in found]))
    worst, places = 0.0, []
    for row in np.concatenate([np.zeros((0, FINE)), *rows]):
        for where, least in _lowest(fine, row):
            worst = max(worst, -least)
            places.append((least, where))
    places = sorted(place for place in places if place[0] < -TOLERANCE / 4)[:WANDERING]
    return max(worst, point.violation), np.array([where for _, where in places])


def _rows(blocks: Sequence[Any]) -> np.ndarray:
    joined = np.concatenate(blocks, axis=-1)[..., :FINE]
    return joined.reshape(-1, FINE)


def _lowest(x: np.ndarray, values: np.ndarray) -> list[tuple[float, float]]:
    """Local minima that are near zero or below, each that of the parabola through three neighbours."""
    inner = np.flatnonzero((values[1:-1] <= values[:-2]) & (values[1:-1] <= values[2:]) & (values[1:-1] < 1e-2)) + 1
    found = [(float(x[i]), float(values[i])) for i in (0, len(x) - 1) if values[i] < 0]
    for i in inner:
        before, here, after = values[i - 1 : i + 2]
        bend = before - 2 * here + after
        shift = 0.5 * (before - after) / bend if bend > 0 else 0.0
        shift = float(np.clip(shift, -0.5, 0.5))
        found.append((float(x[i] + shift * (x[1] - x[0])), float(here - 0.25 * (before - after) * shift)))
    return found


def _moved(program: Program, places: np.ndarray) -> Program:
    """The program with stations where limits were broken, in the place of the oldest of those that wander."""
    stations = np.asarray(program.problem.stations)
    kept, wandering = stations[:-WANDERING], stations[-WANDERING:]
    return Program(
        replace(program.problem, stations=jnp.asarray(np.concatenate([kept, wandering[len(places) :], places])))
    )
