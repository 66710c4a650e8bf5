"""What a design came to: the body, what it reaches, what holds it back, and the proof that it is the best nearby."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import jax
import numpy as np

from .case import unit_of_name
from .constrained import ACTIVE, TOLERANCE, Local
from .design_problem import Problem, split
from .design_program import Program, fixed_numbers
from .design_search import NOT_ZERO, Again, Outcome
from .design_setup import Asked
from .equilibrium import RESULTS, Equilibrium, result_of
from .load_cases import LoadCase
from .manipulator import Manipulator
from .quantities import name_of, quantity_named
from .units import DIMENSION_OF, Dimension, shown

KINK = 1e-5  # relative: multipliers that differ by less are the same


class Achieved(NamedTuple):
    """One objective; its value over the load cases is their weighted mean, of a peak the largest."""

    name: str
    start: float
    end: float
    weight: float
    dimension: Dimension


class FreeNumber(NamedTuple):
    """One free number."""

    start: float
    value: float
    lower: float
    upper: float
    status: str  # "inside", "at lower bound" or "at upper bound"
    multiplier: float  # how much better the objective gets per unit by which the bound gives way; NaN if infeasible


class LimitReport(NamedTuple):
    """One side of a limit where it is tightest."""

    name: str  # of the quantity
    side: str  # "least", "most" or "equal"
    limit: Any
    reached: Any  # the value there
    margin: float  # scaled; negative where the limit is broken
    active: bool
    multiplier: float  # how much better the objective gets per unit by which the limit gives way; NaN if infeasible
    tightening: float  # how much worse per unit by which it is tightened: the same, but where limits bind at one place
    arc_length: float  # m, where it is tightest; NaN for what does not vary along the body
    all_along: bool  # whether it is used up along more than half of the body
    case: str  # in which; "" for the body itself
    implied: bool  # whether the user left it to us
    dimension: Dimension


@dataclass(frozen=True)
class Design:
    """The body that was found, SI units."""

    manipulator: Manipulator  # the body that was found
    start: Manipulator  # the body that one began with
    success: bool  # feasible and stationary
    feasible: bool
    result: str  # "successful", or what went wrong
    objective: float  # of one objective its value, of several their weighted sum over their sizes at the start
    objectives: tuple[Achieved, ...]  # each with its value at the start and at the end
    free: dict[str, FreeNumber]  # by name, every number that could change
    limits: tuple[LimitReport, ...]  # each side of every limit, and what it costs
    blocking: tuple[str, ...]  # limits that are in one another's way, where no body keeps to all of them
    optimality: float  # first-order: largest entry of the gradient of the Lagrangian, scaled
    violation: float  # largest, scaled
    history: tuple[tuple[float, float], ...]  # objective and violation of every iterate
    evaluations: int  # of objective and limits
    starts: tuple[float, ...]  # the objective that the search from each start came to, inf where not feasible
    choices: tuple[tuple[dict[str, float], float], ...]  # by combination of choices, inf where not feasible
    chosen: dict[str, float]  # of the choices, the best
    cases: tuple[LoadCase, ...]  # how the body is used
    remarks: tuple[str, ...]  # in words, what else should be known
    outcome: Outcome = field(repr=False)

    def __str__(self) -> str:
        from .design_command import in_words

        return in_words(self)

    @cached_property
    def sensitivity(self) -> dict[str, float]:
        """Derivatives of the best objective by numbers that are not free, per SI unit, limits and load cases included.

        By the envelope theorem: those of the Lagrangian at the multipliers. Of several objectives that of their
        weighted sum. NaN where limits bind at one place, so that more and less have different slopes. Empty where the
        design is not feasible. Worked out when it is first asked for.
        """
        return _sensitivities(self.outcome) if self.feasible else {}

    @cached_property
    def equilibria(self) -> tuple[Equilibrium, ...]:
        """Of the body in each load case."""
        problem = self.outcome.program.problem
        z = self.outcome.local.point.x[: len(problem.space.names)]
        return tuple(problem.view(z, case).equilibrium for case in problem.cases)

    @cached_property
    def equilibria_at_start(self) -> tuple[Equilibrium, ...]:
        """Of the start in each load case."""
        problem = self.outcome.program.problem
        z = problem.space.scaled(problem.space.start)
        return tuple(problem.view(z, case).equilibrium for case in problem.cases)

    @property
    def value(self) -> dict[str, float]:
        """The free numbers by name."""
        return {name: number.value for name, number in self.free.items()}


def answered(
    asked: Asked,
    outcome: Outcome,
    start: Manipulator,
    choices: tuple[tuple[dict[str, float], float], ...] = (),
    chosen: dict[str, float] | None = None,
) -> Design:
    """What a search came to, with everything that is told of it."""
    problem, local = outcome.program.problem, outcome.local
    z_start, z = problem.space.scaled(problem.space.start), local.point.x[: len(problem.space.names)]
    at_start = Program(problem).evaluation(np.append(z_start, np.zeros(len(problem.peaks))))
    objectives, unit = achieved(problem, at_start, outcome.evaluation), unit_of_objective(problem)
    result = words(local, outcome.violation)
    return Design(
        manipulator=jax.tree.map(np.asarray, problem.body(z)),
        start=start,
        success=result == "successful",
        feasible=outcome.feasible,
        result=result,
        objective=objectives[0].end if len(objectives) == 1 else local.point.objective,
        objectives=objectives,
        free=free_numbers(problem, local, unit),
        limits=limit_reports(problem, local, asked.implied, unit),
        blocking=outcome.blocking,
        optimality=local.optimality.residual,
        violation=outcome.violation,
        history=tuple(outcome.history),
        evaluations=outcome.evaluations,
        starts=tuple(told(problem, value) for value in outcome.starts),
        choices=choices,
        chosen=chosen or {},
        cases=problem.cases,
        remarks=(
            *remarks_on(outcome.evaluation.codes, [case.name for case in problem.cases]),
            *(again_in_words(problem, again) for again in outcome.again),
        ),
        outcome=outcome,
    )


def unit_of_objective(problem: Problem) -> float:
    """What turns the optimiser's objective into that of the user: one objective counts in its own unit and sense."""
    if len(problem.terms) != 1:
        return 1.0
    term = problem.terms[0]
    sense = -1.0 if term.objective.told(1.0) < 0 else 1.0
    return sense * float(term.reference) / float(term.weight)


def told(problem: Problem, value: float) -> float:
    """The optimiser's objective as the user reads it: of one objective its value, of several their weighted sum."""
    if len(problem.terms) != 1 or not np.isfinite(value):
        return value
    (term,) = problem.terms
    return term.objective.told(value * float(term.reference) / float(term.weight))


def free_numbers(problem: Problem, local: Local, unit: float) -> dict[str, FreeNumber]:
    """Free numbers with what their bounds cost."""
    space, found = problem.space, {}
    n = len(space.names)
    numbers = space.numbers(local.point.x[:n])
    for i in range(n):
        low = abs(numbers[i] - space.lower[i]) <= ACTIVE * space.size[i]
        high = abs(numbers[i] - space.upper[i]) <= ACTIVE * space.size[i]
        status = "at lower bound" if low else "at upper bound" if high else "inside"
        worth = _worth_of_bounds(local, i) * abs(unit) / float(space.size[i]) if low or high else 0.0
        ends = float(space.lower[i]), float(space.upper[i])
        found[space.label(i)] = FreeNumber(float(space.start[i]), float(numbers[i]), *ends, status, worth)
    return found


def _worth_of_bounds(local: Local, i: int) -> float:
    """The least that the multipliers tell, scaled; zero where it is none but for rounding."""
    if not local.feasible:
        return np.nan
    own = np.arange(local.point.x.size) == i
    worth, _ = local.optimality.range_of(lower=1.0 * own, upper=1.0 * own)
    return worth if worth > NOT_ZERO else 0.0


def achieved(problem: Problem, at_start: Any, at_end: Any) -> tuple[Achieved, ...]:
    """What each objective was and is."""

    def value(i: int, found: Any) -> float:
        aim = found.aims[i]
        number = np.max(aim) if i in problem.peaks else problem.mean(aim)
        return problem.terms[i].objective.told(float(number))

    return tuple(
        Achieved(
            str(term.objective), value(i, at_start), value(i, at_end), float(term.weight), term.objective.dimension
        )
        for i, term in enumerate(problem.terms)
    )


def limit_reports(problem: Problem, local: Local, implied: tuple[bool, ...], unit: float) -> tuple[LimitReport, ...]:
    """Every side of every limit, where it is tightest."""
    found = Program(problem).evaluation(local.point.x)
    body = problem.body(local.point.x[: len(problem.space.names)])
    places = np.asarray(problem.stations) * float(np.asarray(body.length))
    rows = split(np.arange(local.point.inequality.size), found.margins)
    zeros = split(np.arange(local.point.equality.size), found.zeros)
    reports = []
    for i, limit in enumerate(problem.limits):
        scale = float(limit.scale)
        for k, side in enumerate(side for side in ("least", "most") if getattr(limit, side) is not None):
            margin = np.asarray(found.margins[i])[:, k]
            at = np.unravel_index(np.argmin(margin), margin.shape)
            bound, room = float(getattr(limit, side)), float(margin[at])
            worth, cost = _prices(local, rows[i][:, k], "inequality", abs(unit) / scale)
            reports.append(
                LimitReport(
                    **_report(problem, limit, side, implied[i], int(at[0])),
                    limit=bound,
                    reached=bound + (room if side == "least" else -room) * scale,
                    margin=room,
                    active=room <= ACTIVE,
                    multiplier=worth,
                    tightening=cost,
                    arc_length=float(places[at[-1]]) if limit.along else np.nan,
                    all_along=limit.along and bool(np.mean(_lowest_of_all(margin) <= ACTIVE) > 0.5),
                )
            )
        for k, miss in enumerate(np.asarray(found.zeros[i]) if limit.equal is not None else ()):
            worth, cost = _prices(local, zeros[i][k][:1], "equality", abs(unit) / scale)
            reports.append(
                LimitReport(
                    **_report(problem, limit, "equal", implied[i], k),
                    limit=_plain(limit.equal),
                    reached=_plain(limit.equal + miss * scale),
                    margin=-float(np.max(np.abs(miss))),
                    active=True,
                    multiplier=worth if miss.size == 1 else np.nan,
                    tightening=cost if miss.size == 1 else np.nan,
                    arc_length=np.nan,
                    all_along=False,
                )
            )
    return tuple(reports)


def _lowest_of_all(margin: np.ndarray) -> np.ndarray:
    """The tightest of cases and tendons at every place."""
    return np.min(margin.reshape(-1, margin.shape[-1]), axis=0)


def _prices(local: Local, places: np.ndarray, kind: str, price: float) -> tuple[float, float]:
    """What giving way of some limits together is worth, and what tightening them costs."""
    if not local.feasible:
        return np.nan, np.nan
    weights = {name: np.zeros(getattr(local.point, name).size) for name in ("inequality", "equality")}
    weights[kind][np.ravel(places)] = price
    if kind == "inequality" and not np.any(local.point.inequality[np.ravel(places)] <= ACTIVE):
        return 0.0, 0.0
    return local.optimality.range_of(**weights)


def _report(problem: Problem, limit: Any, side: str, implied: bool, case: int) -> dict[str, Any]:
    quantity = quantity_named(limit.quantity)
    where = _case_name(problem, case) if quantity.bent else ""
    dimension = quantity.dimension
    return {"name": name_of(limit.quantity), "side": side, "case": where, "implied": implied, "dimension": dimension}


def _plain(value: Any) -> Any:
    array = np.squeeze(np.asarray(value))
    return float(array) if array.ndim == 0 else array.tolist()


def _case_name(problem: Problem, i: int) -> str:
    return problem.cases[i].name or (f"case {i + 1}" if len(problem.cases) > 1 else "")


def _sensitivities(outcome: Outcome) -> dict[str, float]:
    """NaN where several sets of multipliers meet the conditions, and the objective has a kink there."""
    problem, held = outcome.program.problem, outcome.local.optimality
    unit, answer = unit_of_objective(problem), {}
    response = outcome.program.response(outcome.local.point.x, fixed_numbers(problem))
    for name, slope in response.items():
        low, high = held.range_of(np.asarray(slope.inequality), np.asarray(slope.equality))
        unique = high - low <= KINK * max(1.0, abs(low), abs(high))
        answer[name] = unit * (float(slope.objective) - low) if unique else np.nan
    return answer


def words(local: Local, violation: float) -> str:
    """The result in words."""
    if not local.point.usable:
        return "no equilibrium was found that could be gone by"
    if not violation <= TOLERANCE:
        return "infeasible"
    if not local.optimality.residual <= TOLERANCE:
        return f"not stationary: the first-order optimality is {local.optimality.residual:.2g} and not {TOLERANCE:g}"
    return "successful"


def remarks_on(codes: Any, names: list[str]) -> list[str]:
    """What the solves say that a designer must know."""
    said = [(name, result_of(code)) for name, code in zip(names, np.asarray(codes), strict=False)]
    return [f"{name or 'the load case'}: {RESULTS[result]}" for name, result in said if result != RESULTS.successful]


def again_in_words(problem: Problem, again: Again) -> str:
    """Why the search began again, and what came of it."""
    labels = [problem.space.label(int(i)) for i in again.numbers]

    def told(numbers: np.ndarray) -> str:
        named = zip(labels, numbers, strict=True)
        return ", ".join(f"{label} = {number_in_words(label, float(number))}" for label, number in named)

    came = "found a better body" if again.better else "found no better body"
    return f"{told(again.old)}: the objective has no slope there; a search from {told(again.new)} {came}"


def number_in_words(name: str, value: float) -> str:
    """A number of a body or a case with the unit that its name tells."""
    return in_unit(value, DIMENSION_OF[unit_of_name(name)])


def in_unit(value: float, dimension: Dimension) -> str:
    return f"{value:.5g}" if dimension == "dimensionless" else shown(value, dimension)
