"""Trade-offs between two objectives: bodies that cannot be improved in both."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..files.writing import markdown_table
from ..numerics.given_numbers import check_whole
from ..robot.manipulator import Manipulator
from ..units import shown
from .design import Aim, problem_of, weighted
from .free_numbers import Bounds
from .load_cases import LoadCase
from .objectives import Limit
from .problem import DesignProblem
from .results import Achieved, Design, design_of
from .search import SearchResult, search_designs, search_starts

SECOND = 1e-4  # weight of the other objective, so that it is not larger than it needs to be
SAME = 1e-3  # relative: ends that differ by less in both objectives are one body


@dataclass(frozen=True)
class ParetoFront:
    """Designs from the best in the first objective to the best in the second, SI units."""

    designs: tuple[Design, ...]  # one for each point; two where one body is best in both objectives

    @property
    def success(self) -> bool:
        """Whether every point was found."""
        return all(design.success for design in self.designs)

    @property
    def objectives(self) -> tuple[Achieved, ...]:
        """The two objectives at the start and at the best of the first."""
        return self.designs[0].objectives

    @property
    def values(self) -> np.ndarray:
        """(points, 2) of the two objectives; NaN where no body was found."""
        return np.array(
            [[each.end if found.feasible else np.nan for each in found.objectives] for found in self.designs]
        )

    def __str__(self) -> str:
        """The front as Markdown."""
        names = [each.name for each in self.objectives]
        head = [f"# Trade-off: {names[0]} against {names[1]}", ""]
        numbers = [*names, *self.designs[0].free]
        rows = []
        for found in self.designs:
            pair = [shown(each.end, each.dimension) for each in found.objectives]
            rows.append([*pair, *(shown(each.value, each.dimension) for each in found.free.values()), found.result])
        return "\n".join(head + markdown_table([*numbers, ""], rows, right=numbers))

    def as_dict(self) -> dict[str, object]:
        """The front for JSON, SI units."""
        return {
            "objectives": [each.name for each in self.objectives],
            "start": [each.start for each in self.objectives],
            "values": self.values,
            "success": self.success,
            "result": "successful" if self.success else "some points of the front were not found",
            "designs": [{"result": found.result, "value": found.value} for found in self.designs],
        }


def pareto_front(
    manipulator: Manipulator,
    objectives: Sequence[Aim],
    free: Sequence[str],
    bounds: Bounds | None = None,
    constraints: Limit | Sequence[Limit] = (),
    *,
    cases: LoadCase | Sequence[LoadCase],
    num: int = 9,
    nodes: int = 16,
    worst: bool = False,
    offsets_outside_wall: bool = False,
) -> ParetoFront:
    """The trade-off between two objectives.

    The ends of the front are the bodies that are best in one objective. Between them the widest gap is halved again and
    again: one objective is made small below a level of the other, starting from the bodies on both sides of the gap.
    This is the epsilon-constraint method, which also finds fronts that are not convex.

    Args:
        manipulator, free, bounds, constraints, cases, nodes, worst, offsets_outside_wall: as in `design`.
        objectives: two of `Least`, `Most`, `Even`, `Near` or functions of manipulator and equilibrium.
        num: points, 3 or more.

    Raises:
        InputError: for another number of objectives or points, and as `design`.
    """
    if not isinstance(objectives, list | tuple) or len(objectives) != 2:
        raise InputError('pareto_front: give two objectives, as in (Least("base_tension"), Least("mass"))')
    check_whole("pareto_front: num", num, 3)
    pairs = weighted([(1.0, aim) for aim in objectives])
    how = {"nodes": nodes, "worst": worst, "offsets_outside_wall": offsets_outside_wall}
    problem = problem_of(manipulator, pairs, free, bounds or {}, constraints, cases, **how)
    return ParetoFront(tuple(design_of(found, manipulator) for found in _searched(problem, num)))


def _searched(problem: DesignProblem, num: int) -> list[SearchResult]:
    """Search results from one end of the front to the other; a gap beside an infeasible result is not divided."""

    def best(small: int, level: float, *starts: np.ndarray) -> SearchResult:
        """Make one objective small under a level of the other, which may be infinite."""
        weights, levels = jnp.full(2, SECOND).at[small].set(1.0), jnp.full(2, jnp.inf).at[1 - small].set(level)
        terms = zip(problem.terms, weights, levels, strict=True)
        weighed = tuple(replace(term, weight=own, most=most) for term, own, most in terms)
        return search_designs(replace(problem, terms=weighed), starts)

    starts = search_starts(problem)
    first = best(0, np.inf, *starts)
    found = [first, best(1, np.inf, first.z, *starts)]
    while len(found) < num:
        raw = np.array([[problem.over_the_cases(k, each.evaluation.aims[k]) for k in (0, 1)] for each in found])
        size = np.maximum(np.abs(raw[0] - raw[-1]), 1e-12 * np.abs(raw[0]) + 1e-300)
        gaps = [i for i, pair in enumerate(pairwise(found)) if all(each.feasible for each in pair)]
        if not gaps or np.all(np.abs(raw[0] - raw[-1]) <= SAME * np.abs(raw[0])):
            break
        widths = np.abs(np.diff(raw, axis=0)) / size
        i = max(gaps, key=lambda i: float(np.linalg.norm(widths[i])))
        wide = int(np.argmax(widths[i]))
        level = float(np.mean(raw[i : i + 2, wide]))
        found.insert(i + 1, best(1 - wide, level, found[i].z, found[i + 1].z))
    return found
