"""The result of a design: the body, its objectives, the limits that bind, and the proof that it is the best nearby."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

import jax
import numpy as np
from jaxtyping import Array

from ..robot.manipulator import Manipulator
from ..statics.equilibrium import Equilibrium
from ..statics.named_numbers import unit_of_name
from ..statics.status import Status, words_of
from ..units import DIMENSION_OF, Dimension, shown
from .body_quantities import loop_in_short_steps
from .constrained import ACTIVE, TOLERANCE, LocalMinimum
from .load_cases import LoadCase
from .problem import DesignEvaluation, DesignProblem, pieces_of
from .search import GAIN, NOT_ZERO, Restart, SearchResult, indifferent
from .sensitivity import FixedNumber, sensitivities

Choices = tuple[tuple[dict[str, float], float], ...]  # numbers by name, and the objective that was reached with them


class Achieved(NamedTuple):
    """One objective; its value is the weighted mean over the load cases, or for a peak the largest."""

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
    multiplier: float  # how much better the objective becomes per unit of a wider bound; NaN if infeasible


class LimitReport(NamedTuple):
    """One side of a limit where it is tightest."""

    name: str  # of the quantity
    side: str  # "least", "most" or "equal"
    limit: float | list[float]
    reached: float | list[float]  # the value there
    margin: float  # scaled; negative where the limit is broken
    active: bool
    multiplier: float  # how much better the objective becomes per unit of a wider limit; NaN if infeasible
    tightening: float  # how much worse per unit of a tighter limit; differs if several limits are active at one place
    arc_length: float  # m, where it is tightest; NaN for a quantity that does not vary along the body
    all_along: bool  # whether it is active along more than half of the body
    case: str  # the load case; "" for the body itself
    implied: bool  # whether it is a limit that every body must keep, and not the user's
    dimension: Dimension


@dataclass(frozen=True)
class Design:
    """The body that was found, SI units."""

    manipulator: Manipulator  # the body that was found
    start: Manipulator  # the body at the start
    success: bool  # feasible and stationary
    feasible: bool
    result: str  # "successful", or what went wrong
    objective: float  # the value of one objective, or the weighted sum of several over their sizes at the start
    objectives: tuple[Achieved, ...]  # each with its value at the start and at the end
    free: dict[str, FreeNumber]  # by name, every number that could change
    limits: tuple[LimitReport, ...]  # each side of every limit, and what it costs
    blocking: tuple[str, ...]  # limits that contradict each other, if no body keeps all of them
    optimality: float  # first-order: largest entry of the gradient of the Lagrangian, scaled
    violation: float  # largest, scaled
    history: tuple[tuple[float, float], ...]  # objective and violation of every iterate
    evaluations: int  # of objective and limits
    starts: tuple[float, ...]  # the objective reached from each start, inf if not feasible
    choices: Choices  # the objective reached with each combination of choices, inf if not feasible
    chosen: dict[str, float]  # of the choices, the best
    cases: tuple[LoadCase, ...]  # how the body is used
    remarks: tuple[str, ...]  # further notes in words
    outcome: SearchResult = field(repr=False)

    def __str__(self) -> str:
        from .report import design_in_words

        return design_in_words(self)

    @cached_property
    def sensitivity(self) -> dict[str, float]:
        """Derivatives of the best objective by numbers that are not free, per SI unit, limits and load cases included.

        They are the derivatives of the Lagrangian (envelope theorem), for several objectives those of the weighted sum.
        NaN if several limits are active at one place, so that the slopes to both sides differ. Empty if the design is
        not feasible. Computed when it is first read.
        """
        return {number.label: slope for number, slope in self.sensitivity_by_number.items()}

    @cached_property
    def sensitivity_by_number(self) -> dict[FixedNumber, float]:
        """The same by the numbers themselves."""
        if not self.feasible:
            return {}
        problem = self.outcome.problem
        unit = unit_of_objective(problem)
        return {number: unit * slope for number, slope in sensitivities(problem, self.outcome.local).items()}

    @cached_property
    def equilibria(self) -> tuple[Equilibrium, ...]:
        """The equilibrium of the body in each load case."""
        return self._solved(self.outcome.z)

    @cached_property
    def equilibria_at_start(self) -> tuple[Equilibrium, ...]:
        """The equilibrium of the start in each load case."""
        return self._solved(self.outcome.problem.free.scaled_start)

    def _solved(self, z: np.ndarray | Array) -> tuple[Equilibrium, ...]:
        problem = self.outcome.problem
        return tuple(problem.view(z, case).equilibrium for case in problem.cases)

    @property
    def value(self) -> dict[str, float]:
        """The free numbers by name."""
        return {name: number.value for name, number in self.free.items()}


def design_of(
    outcome: SearchResult, start: Manipulator, choices: Choices = (), chosen: dict[str, float] | None = None
) -> Design:
    """The result of a search, with everything that is reported."""
    problem, local = outcome.problem, outcome.local
    no_heights = np.zeros(len(problem.peaks))
    at_start = problem.evaluation(np.append(problem.free.scaled_start, no_heights))
    at_end, unit = outcome.evaluation, abs(unit_of_objective(problem))
    objectives = achieved(problem, at_start, at_end)
    codes = zip(problem.cases, np.asarray(at_end.codes), strict=False)  # none without a solve
    same = indifferent(problem, outcome.z) if outcome.feasible else ()
    result = design_result(local, outcome.violation, has_answer=len(same) < len(problem.terms))
    return Design(
        manipulator=jax.tree.map(np.asarray, problem.body(outcome.z)),
        start=start,
        success=result == "successful",
        feasible=outcome.feasible,
        result=result,
        objective=objectives[0].end if len(objectives) == 1 else local.point.objective,
        objectives=objectives,
        free=free_numbers(problem, local, unit),
        limits=limit_reports(problem, local, unit),
        blocking=outcome.blocking,
        optimality=local.optimality.residual,
        violation=outcome.violation,
        history=tuple(outcome.history),
        evaluations=outcome.evaluations,
        starts=tuple(displayed(problem, value) for value in outcome.starts),
        choices=choices,
        chosen=chosen or {},
        cases=problem.cases,
        remarks=(
            *(f"{case.name or 'the load case'}: {words_of(code)}" for case, code in codes if code != Status.successful),
            *(restart_in_words(problem, restart) for restart in outcome.restarts),
            *loops_in_words(problem, outcome.z),
            *(indifference_in_words(problem, outcome.z, i) for i in same),
        ),
        outcome=outcome,
    )


def loops_in_words(problem: DesignProblem, z: np.ndarray | Array) -> list[str]:
    """The error estimates of loops that are followed in short steps, in words."""
    if not any(
        part.known.name == "hysteresis" for part in (*(term.objective for term in problem.terms), *problem.limits)
    ):
        return []
    found = []
    for case in problem.cases:
        loop = loop_in_short_steps(problem.view(z, case))
        if loop is None:
            continue
        own, error = case.name or "the load case", float(np.max(np.asarray(loop.error_estimate)))
        words = f"{own}: the loop of the tip angle is followed in short steps, with an error estimate of "
        inaccurate = np.any(loop.status == Status.inaccurate)
        more = ", which is inaccurate; raise nodes" if inaccurate else ""
        found.append(f"{words}{shown(error, 'angle')}{more}")
    return found


def unit_of_objective(problem: DesignProblem) -> float:
    """The factor from slopes of the optimiser's objective to those of the user's: a single one has unit and sign."""
    if len(problem.terms) != 1:
        return 1.0
    (term,) = problem.terms
    sense = -1.0 if term.objective.displayed(1.0) < 0 else 1.0
    return sense * float(term.reference) / float(term.weight)


def displayed(problem: DesignProblem, value: float) -> float:
    """The optimiser's objective as the user reads it: the value of one objective, or the weighted sum of several."""
    if len(problem.terms) != 1 or not np.isfinite(value):
        return value
    (term,) = problem.terms
    return term.objective.displayed(value * float(term.reference) / float(term.weight))


def free_numbers(problem: DesignProblem, local: LocalMinimum, unit: float) -> dict[str, FreeNumber]:
    """The free numbers, with the multipliers of their bounds."""
    free, found = problem.free, {}
    numbers = np.asarray(free.numbers(problem.split(local.point.x)[0]))
    columns = (free.start, numbers, free.lower, free.upper, free.size)
    for i, row in enumerate(zip(*columns, strict=True)):
        start, value, lower, upper, size = map(float, row)
        at_lower, at_upper = abs(value - lower) <= ACTIVE * size, abs(value - upper) <= ACTIVE * size
        status = "at lower bound" if at_lower else "at upper bound" if at_upper else "inside"
        worth = 0.0
        if at_lower or at_upper:
            own = 1.0 * (np.arange(local.point.x.size) == i)
            least, _ = local.optimality.range_of(lower=own, upper=own) if local.feasible else (np.nan, np.nan)
            worth = 0.0 if least <= NOT_ZERO else least * unit / size  # the least that follows from the multipliers
        found[free.label(i)] = FreeNumber(start, value, lower, upper, status, worth)
    return found


def achieved(problem: DesignProblem, at_start: DesignEvaluation, at_end: DesignEvaluation) -> tuple[Achieved, ...]:
    """Each objective at the start and at the end."""
    found = []
    for i, term in enumerate(problem.terms):
        aim, values = term.objective, (problem.over_the_cases(i, each.aims[i]) for each in (at_start, at_end))
        start, end = (aim.displayed(float(value)) for value in values)
        found.append(Achieved(str(aim), start, end, float(term.weight), aim.dimension))
    return tuple(found)


def limit_reports(problem: DesignProblem, local: LocalMinimum, unit: float) -> tuple[LimitReport, ...]:
    """Every side of every limit, where it is tightest."""
    found = problem.evaluation(local.point.x)
    rows = pieces_of(np.arange(local.point.inequality.size), found.margins)
    equations = pieces_of(np.arange(local.point.equality.size), found.zeros)
    length = float(np.asarray(problem.body(problem.split(local.point.x)[0]).length))
    reports = []
    for i, limit in enumerate(problem.limits):
        price = unit / float(np.asarray(limit.scale))
        for k, side in enumerate(side for side in ("least", "most") if getattr(limit, side) is not None):
            prices = _prices(local, "inequality", rows[i][:, k], price)
            reports.append(_of_range(problem, i, side, np.asarray(found.margins[i])[:, k], prices, length))
        for case, miss in enumerate(np.asarray(found.zeros[i]) if limit.equal is not None else ()):
            prices = _prices(local, "equality", equations[i][case], price) if miss.size == 1 else (np.nan, np.nan)
            wanted = np.asarray(limit.equal)
            values = np.squeeze(wanted).tolist(), np.squeeze(wanted + miss * np.asarray(limit.scale)).tolist()
            reports.append(_report(problem, i, "equal", case, values, -float(np.max(np.abs(miss))), prices))
    return tuple(reports)


def _of_range(
    problem: DesignProblem, i: int, side: str, margin: np.ndarray, prices: tuple[float, float], length: float
) -> LimitReport:
    """One side of a limit with its scaled margins, (cases, ...), where it is tightest."""
    limit = problem.limits[i]
    at = np.unravel_index(np.argmin(margin), margin.shape)
    bound, room = float(getattr(limit, side)), float(margin[at])
    reached = bound + (room if side == "least" else -room) * float(np.asarray(limit.scale))
    report = _report(problem, i, side, int(at[0]), (bound, reached), room, prices)
    if not limit.known.along:
        return report
    along = np.min(margin.reshape(-1, margin.shape[-1]), axis=0)  # the tightest of cases and tendons at every place
    place = float(problem.stations[at[-1]]) * length
    return report._replace(arc_length=place, all_along=bool(np.mean(along <= ACTIVE) > 0.5))


def _report(
    problem: DesignProblem,
    i: int,
    side: str,
    case: int,
    values: tuple[float | list[float], float | list[float]],
    margin: float,
    prices: tuple[float, float],
) -> LimitReport:
    """The report of a limit without a place: its value and the one that is reached, the scaled margin, the prices."""
    limit, several = problem.limits[i], len(problem.cases) > 1
    return LimitReport(
        name=limit.name,
        side=side,
        limit=values[0],
        reached=values[1],
        margin=margin,
        active=side == "equal" or margin <= ACTIVE,
        multiplier=prices[0],
        tightening=prices[1],
        arc_length=np.nan,
        all_along=False,
        case=(problem.cases[case].name or (f"case {case + 1}" if several else "")) if limit.known.bent else "",
        implied=problem.implied[i],
        dimension=limit.known.dimension,
    )


def _prices(
    local: LocalMinimum, kind: Literal["inequality", "equality"], places: np.ndarray, price: float
) -> tuple[float, float]:
    """How much the objective gains if some limits are relaxed together, and loses if they are tightened."""
    if not local.feasible:
        return np.nan, np.nan
    values = getattr(local.point, kind)
    if kind == "inequality" and not np.any(values[np.ravel(places)] <= ACTIVE):
        return 0.0, 0.0
    weights = np.zeros(values.size)
    weights[np.ravel(places)] = price
    return local.optimality.range_of(**{kind: weights})


def design_result(local: LocalMinimum, violation: float, *, has_answer: bool) -> str:
    """The result in words; `has_answer` says whether a free number changes an objective."""
    if not local.point.usable:
        return "no usable equilibrium was found"
    if not violation <= TOLERANCE:
        return "infeasible"
    if not local.optimality.residual <= TOLERANCE:
        return f"not stationary: the first-order optimality is {local.optimality.residual:.2g} and not {TOLERANCE:g}"
    return "successful" if has_answer else "undetermined: no free number changes the objective"


def indifference_in_words(problem: DesignProblem, z: np.ndarray, i: int) -> str:
    """That no free number changes an objective, and why, if it is a loss that follows from the angle alone."""
    words = f"{problem.terms[i].objective} is the same for all bodies that were tried within the bounds"
    why = "1 - exp(-friction_coefficient tip_angle), as of every tendon at a constant offset that bends to one side"
    return f"{words}: {why}" if _is_of_angle(problem, z, i) else words


def _is_of_angle(problem: DesignProblem, z: np.ndarray, i: int) -> bool:
    """Whether an objective is the loss of a tendon at a constant offset that bends to one side, in every case."""
    if problem.terms[i].objective.known.name != "tension_loss":
        return False
    views = [problem.view(z, case) for case in problem.cases]
    losses = [-np.expm1(-view.body.friction_coefficient * abs(view.equilibrium.tip_angle)) for view in views]
    return all(np.allclose(view.equilibrium.tension_loss, own, GAIN) for view, own in zip(views, losses, strict=True))


def restart_in_words(problem: DesignProblem, restart: Restart) -> str:
    """Why the search began again, and whether that found a better body."""
    labels = [problem.free.label(int(i)) for i in restart.numbers]

    def listed(numbers: np.ndarray) -> str:
        named = zip(labels, numbers, strict=True)
        return ", ".join(f"{label} = {number_in_words(label, float(number))}" for label, number in named)

    result = "found a better body" if restart.better else "found no better body"
    return f"{listed(restart.old)}: the objective has no slope there; a search from {listed(restart.new)} {result}"


def number_in_words(name: str, value: float) -> str:
    """A number of a body or a case with the unit that follows from its name."""
    return shown(value, DIMENSION_OF[unit_of_name(name)])
