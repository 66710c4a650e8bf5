"""Trade-offs between two objectives: the bodies of which none is better in both."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import jax.numpy as jnp
import numpy as np

from .design_problem import Problem
from .design_results import Design, answered
from .design_search import Outcome, Search, Watch
from .design_setup import FAR, Asked, ask, weighted
from .designing import progress_shown
from .errors import InputError
from .limits import Limit
from .manipulator import Manipulator
from .units import Dimension

SECOND = 1e-4  # what the other objective counts beside the one that is made small, so that none is given away


SAME = 1e-3  # relative: ends that differ by less in both objectives are one body


@dataclass(frozen=True)
class ParetoFront:
    """Designs from the best in the first objective to the best in the second, SI units."""

    names: tuple[str, str]  # of the objectives
    dimensions: tuple[Dimension, Dimension]  # of their values
    values: np.ndarray  # (points, 2) of the two objectives; NaN where no body was found
    start: tuple[float, float]  # of the body that one began with
    exchange_rate: np.ndarray  # (points,) how much of the first objective a unit of the second costs; NaN at the ends
    designs: tuple[Design, ...]  # one for each point
    remarks: tuple[str, ...]  # in words, what else should be known

    @property
    def success(self) -> bool:
        """Whether every point was found."""
        return all(design.success for design in self.designs)

    def __str__(self) -> str:
        from .design_command import front_in_words

        return front_in_words(self)


def pareto_front(
    manipulator: Manipulator,
    objectives: Sequence[Any],
    free: Sequence[str],
    bounds: Mapping[str, tuple[Any, Any]] | None = None,
    constraints: Sequence[Limit] = (),
    *,
    num: int = 9,
    max_iterations: int = 300,
    progress: bool = False,
    **options: Any,
) -> ParetoFront:
    """The trade-off between two objectives.

    Between the bodies that are best in one of them, the widest gap is halved again and again: one objective is made
    small under a level of the other (the epsilon-constraint method, which also finds fronts that are not convex),
    from the bodies on both sides of the gap.

    Args:
        manipulator, free, bounds, constraints: as in `design`.
        objectives: two of `Least`, `Most`, `Even`, `Near` or functions of manipulator and equilibrium.
        num: points, 3 or more.
        max_iterations: of each search.
        progress: show it on standard error.
        options: of `design`: cases, base_tension, loads, direction, worst, offsets_outside_wall, nodes.

    Raises:
        InputError: for another number of objectives or points, and as `design`.
    """
    if not isinstance(objectives, list | tuple) or len(objectives) != 2:
        raise InputError('pareto_front: give two objectives, as in (Least("base_tension"), Least("mass"))')
    if isinstance(num, bool) or not isinstance(num, int) or num < 3:
        raise InputError(f"pareto_front: num must be a whole number of 3 or more, got {num!r}")
    aims = weighted([(1.0, aim) for aim in objectives])
    asked = ask(manipulator, aims, free, bounds, constraints, capped=True, **options)
    with progress_shown(progress) as watch:
        points = _Points(asked.problem, max_iterations, watch)
        for _ in range(num - 2):
            if not points.add():
                break
    return _front(asked, points.outcomes, manipulator, num)


class _Points:
    """The front as it grows: outcomes in order from one end to the other."""

    def __init__(self, problem: Problem, max_iterations: int, watch: Watch):
        self.problem, self.max_iterations, self.watch = problem, max_iterations, watch
        first = self._search(0, np.inf, [problem.space.scaled(problem.space.start)])
        last = self._search(1, np.inf, [_free(first), problem.space.scaled(problem.space.start)])
        self.outcomes = [first, last]
        self.given_up: set[tuple[int, int]] = set()  # gaps in which no body was found, by the bodies beside them

    def _search(self, small: int, level: float, starts: Sequence[Any]) -> Outcome:
        """Make one objective small under a level of the other; the best from some starts."""
        search = Search(_at(self.problem, small, level), self.max_iterations, self.watch)
        return min((search.from_start(z) for z in starts), key=lambda outcome: outcome.rank)

    def add(self) -> bool:
        """A body in the middle of the widest gap; false where there is no gap left."""
        raw = np.array([[_raw(outcome, k) for k in (0, 1)] for outcome in self.outcomes])
        found = [i for i, outcome in enumerate(self.outcomes) if outcome.feasible]
        size = np.maximum(np.abs(raw[0] - raw[-1]), 1e-12 * np.abs(raw[0]) + 1e-300)
        gaps = [pair for pair in pairwise(found) if self._between(pair) not in self.given_up]
        if not gaps or np.all(np.abs(raw[0] - raw[-1]) <= SAME * np.abs(raw[0])):
            return False
        before, after = max(gaps, key=lambda pair: float(np.linalg.norm((raw[pair[1]] - raw[pair[0]]) / size)))
        wide = int(np.argmax(np.abs(raw[after] - raw[before]) / size))
        ends = [self.outcomes[before], self.outcomes[after]]
        level = float(np.mean([raw[before, wide], raw[after, wide]]))
        outcome = self._search(1 - wide, level, [_free(end) for end in ends])
        if not outcome.feasible:
            self.given_up.add(self._between((before, after)))
        self.outcomes.insert(before + 1, outcome)
        return True

    def _between(self, pair: tuple[int, int]) -> tuple[int, int]:
        return id(self.outcomes[pair[0]]), id(self.outcomes[pair[1]])


def _at(problem: Problem, small: int, level: float) -> Problem:
    """The problem with one objective to be made small and the other below a level; infinite for none."""
    weights = [SECOND, SECOND]
    weights[small] = 1.0
    terms = tuple(replace(term, weight=jnp.asarray(w, float)) for term, w in zip(problem.terms, weights, strict=True))
    caps = list(problem.caps)
    other = caps[1 - small]
    caps[1 - small] = replace(other, most=jnp.minimum(jnp.asarray(level, float), FAR * other.reference))
    return replace(problem, terms=terms, caps=tuple(caps))


def _free(outcome: Outcome) -> np.ndarray:
    return outcome.local.point.x[: len(outcome.program.problem.space.names)]


def _raw(outcome: Outcome, i: int) -> float:
    """An objective as the optimiser has it."""
    problem, found = outcome.program.problem, outcome.evaluation
    return float(np.max(found.aims[i]) if i in problem.peaks else problem.mean(jnp.asarray(found.aims[i])))


def _rate(outcome: Outcome) -> float:
    """The multiplier of the level, as units of the first objective per unit of the second."""
    problem, found = outcome.program.problem, outcome.evaluation
    begin = sum(np.size(margin) for margin in found.margins)
    for i, (cap, aim) in enumerate(zip(problem.caps, found.capped, strict=True)):
        size = problem.room(cap, jnp.asarray(aim)).size
        price = float(np.sum(outcome.local.optimality.inequality[begin : begin + size]))
        begin += size
        if price > 0:
            first, second = (float(term.reference) for term in problem.terms)
            return (price if i == 1 else 1.0 / price) * first / second
    return float("nan")


def _front(asked: Asked, outcomes: list[Outcome], start: Manipulator, num: int) -> ParetoFront:
    aims = [term.objective for term in asked.problem.terms]
    designs = tuple(answered(asked, outcome, start) for outcome in outcomes)
    told = [[each.end if design.feasible else np.nan for each in design.objectives] for design in designs]
    rates = [_rate(outcome) if outcome.feasible else np.nan for outcome in outcomes]
    began = designs[0].objectives
    return ParetoFront(
        names=(str(aims[0]), str(aims[1])),
        dimensions=(aims[0].dimension, aims[1].dimension),
        values=np.asarray(told),
        start=(began[0].start, began[1].start),
        exchange_rate=np.asarray(rates),
        designs=designs,
        remarks=_remarks(outcomes, num),
    )


def _remarks(outcomes: list[Outcome], num: int) -> tuple[str, ...]:
    missing = sum(not outcome.feasible for outcome in outcomes)
    if len(outcomes) < num and not missing:
        return ("one body is best in both objectives: they are not in each other's way",)
    return (f"{missing} of {len(outcomes)} points were not found",) if missing else ()
