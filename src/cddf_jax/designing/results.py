"""The result of a design: the body, its objectives, the limits that bind, and the proof that it is the best nearby."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..files.writing import markdown_table
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import Equilibrium
from ..statics.named_numbers import tip_of_winding
from ..statics.status import Status, words_of
from ..units import Dimension, preferred, shown
from .constrained import ACTIVE, TOLERANCE
from .free_numbers import PLACE, dimension_in
from .load_cases import LoadCase, case_numbers
from .problem import DesignProblem, Values, pieces_of
from .search import GAIN, SearchResult, undetermined

NOT_IN_JSON = ("manipulator", "start", "cases", "outcome")
NOTHING = 1e-9  # of the objective: a number that changes it by less by as much as it is itself
KINK = "not unique: limits bind at one place"


class Achieved(NamedTuple):
    """One objective; its value is the weighted mean over the load cases, or for a peak the largest."""

    name: str
    start: float
    end: float
    dimension: Dimension


class FreeNumber(NamedTuple):
    """One free number."""

    start: float
    value: float
    lower: float
    upper: float
    status: str  # "inside", "at lower bound" or "at upper bound"
    multiplier: float  # how much better the objective becomes per unit of a wider bound; NaN as in `LimitReport`
    dimension: Dimension


class LimitReport(NamedTuple):
    """One side of a limit where it is tightest."""

    name: str  # of the quantity
    side: str  # "least", "most" or "equal"
    limit: float
    reached: float  # the value there
    margin: float  # scaled; negative where the limit is broken
    active: bool
    multiplier: float  # how much better the objective becomes per unit of a wider limit; NaN where that is not unique
    arc_length: float  # m, where it is tightest; NaN for a quantity that does not vary along the body
    case: str  # the load case; "" for the body itself
    dimension: Dimension


@dataclass(frozen=True)
class Design:
    """The body that was found, SI units.

    A multiplier is NaN if the design is not feasible, and if several limits bind at one place: relaxing one of them
    then gains another amount than tightening it costs. Multipliers and sensitivities of a single `Even` or `Near` are
    those of the square, of which `objective` is the root.
    """

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
    starts: tuple[float, ...]  # of each search its end as it is made small, relative to the start; inf if not feasible
    cases: tuple[LoadCase, ...]  # how the body is used
    remarks: tuple[str, ...]  # further notes in words
    outcome: SearchResult = field(repr=False)

    def __str__(self) -> str:
        """The report as Markdown."""
        return "\n".join([*_head(self), *_numbers(self), *_limits(self), *_sensitivity(self), *_foot(self)])

    def as_dict(self) -> dict[str, object]:
        """The design for JSON, SI units."""
        own = {each.name: getattr(self, each.name) for each in fields(self) if each.name not in NOT_IN_JSON}
        return {**own, "sensitivity": self.sensitivity if _follows(self) else {}}

    @cached_property
    def sensitivity(self) -> dict[str, float]:
        """Derivatives of the best objective by numbers of the body that are not free, per SI unit.

        With one load case also by its tensions and loads. They are the derivatives of the Lagrangian (envelope
        theorem), for several objectives those of the weighted sum. NaN if several limits are active at one place, so
        that the slopes to both sides differ. Empty if the design is not feasible. Computed when it is first read.
        """
        if not self.feasible:
            return {}
        problem, local = self.outcome.problem, self.outcome.local
        fixed, unit = fixed_numbers(problem), unit_of_objective(problem)
        numbers = jnp.asarray(list(fixed.values()))
        gradient, slopes = map(np.asarray, _slopes(problem, jnp.asarray(local.point.x), tuple(fixed), numbers))
        columns = zip(fixed, gradient, slopes.T, strict=True)
        return {name: unit * (float(own) - local.price(limits)) for name, own, limits in columns}

    @cached_property
    def equilibria(self) -> tuple[Equilibrium, ...]:
        """The equilibrium of the body in each load case."""
        return self._solved(self.outcome.z)

    @cached_property
    def equilibria_at_start(self) -> tuple[Equilibrium, ...]:
        """The equilibrium of the start in each load case."""
        return self._solved(self.outcome.problem.free.scaled_start)

    def _solved(self, z: np.ndarray) -> tuple[Equilibrium, ...]:
        problem = self.outcome.problem
        return tuple(problem.view(z, case).equilibrium for case in problem.cases)

    @property
    def value(self) -> dict[str, float]:
        """The free numbers by name."""
        return {name: number.value for name, number in self.free.items()}


def design_of(outcome: SearchResult, start: Manipulator) -> Design:
    """The result of a search, with everything that is reported."""
    problem, local, objectives = outcome.problem, outcome.local, []
    body, at_start, at_end = problem.body(outcome.z), problem.evaluation(problem.free.scaled_start), outcome.evaluation
    for i, term in enumerate(problem.terms):
        aim, values = term.objective, (problem.over_the_cases(i, each.aims[i]) for each in (at_start, at_end))
        start_value, end_value = (aim.displayed(float(value)) for value in values)
        objectives.append(Achieved(str(aim), start_value, end_value, aim.dimension))
    codes = zip(problem.cases, at_end.codes, strict=True)
    result = design_result(outcome)
    return Design(
        manipulator=jax.tree.map(np.asarray, body),
        start=start,
        success=result == "successful",
        feasible=outcome.feasible,
        result=result,
        objective=objectives[0].end if len(objectives) == 1 else local.point.objective,
        objectives=tuple(objectives),
        free=free_numbers(outcome),
        limits=limit_reports(outcome, float(body.length)),
        blocking=outcome.blocking,
        optimality=local.residual,
        violation=outcome.violation,
        starts=outcome.starts,
        cases=problem.cases,
        remarks=tuple(
            f"{case.name or 'the load case'}: {words_of(code)}" for case, code in codes if code != Status.successful
        ),
        outcome=outcome,
    )


def design_result(outcome: SearchResult) -> str:
    """The result in words."""
    local = outcome.local
    if not local.point.usable:
        return "no usable equilibrium was found"
    if not outcome.feasible:
        return "infeasible"
    if not local.stationary:
        return f"not stationary: the first-order optimality is {local.residual:.2g} and not {TOLERANCE:g}"
    if undetermined(outcome.problem, outcome.z):
        return "undetermined: no free number changes the objective"
    return "successful"


def unit_of_objective(problem: DesignProblem) -> float:
    """The factor from slopes of the optimiser's objective to those of the user's: a single one has unit and sign."""
    if len(problem.terms) != 1:
        return 1.0
    (term,) = problem.terms
    sense = -1.0 if term.objective.displayed(1.0) < 0 else 1.0
    return sense * float(term.size) / float(term.weight)


# --- what binds ----------------------------------------------------------------------------------


def free_numbers(outcome: SearchResult) -> dict[str, FreeNumber]:
    """The free numbers, with the multipliers of their bounds."""
    problem, local, unit, found = outcome.problem, outcome.local, abs(unit_of_objective(outcome.problem)), {}
    free, case = problem.free, problem.cases[0].of(problem.manipulator)
    columns = (free.start, np.asarray(free.numbers(outcome.z)), free.lower, free.upper, free.size)
    for i, row in enumerate(zip(*columns, strict=True)):
        start, value, lower, upper, size = map(float, row)
        at_lower, at_upper = abs(value - lower) <= ACTIVE * size, abs(value - upper) <= ACTIVE * size
        status = "at lower bound" if at_lower else "at upper bound" if at_upper else "inside"
        own = unit / size * (np.arange(local.point.x.size) == i)
        worth = local.price(lower=own, upper=own) if local.feasible else np.nan
        dimension = dimension_in(case, free.names[i][0])
        found[free.label(i)] = FreeNumber(start, value, lower, upper, status, worth, dimension)
    return found


def limit_reports(outcome: SearchResult, length: float) -> tuple[LimitReport, ...]:
    """Every side of every limit, where it is tightest, on a body of this length."""
    problem, local, found = outcome.problem, outcome.local, outcome.evaluation.margins
    reports, all_rows = [], np.arange(local.point.margins.size)
    for kept, each, rows in zip(problem.limits, found, pieces_of(all_rows, found), strict=True):
        limit, size, unit = kept.limit, float(kept.size), abs(unit_of_objective(problem))
        for k, (side, bound) in enumerate(limit.sides.items()):
            margins = -np.abs(each[:, k]) if side == "equal" else each[:, k]
            at = np.unravel_index(np.argmin(margins), margins.shape)
            margin, weights = float(margins[at]) / size, unit / size * np.isin(all_rows, rows[:, k])
            case = problem.cases[at[0]].name or (f"case {at[0] + 1}" if len(problem.cases) > 1 else "")
            report = LimitReport(
                name=limit.name,
                side=side,
                limit=float(bound),
                reached=float(bound + each[:, k][at] * (-1 if side == "most" else 1)),
                margin=margin,
                active=bool(side == "equal" or margin <= ACTIVE),
                multiplier=local.price(weights) if local.feasible else np.nan,
                arc_length=float(problem.stations[at[-1]]) * length if limit.known.along else np.nan,
                case=case if limit.known.bent else "",
                dimension=limit.known.dimension,
            )
            reports.append(report)
    return tuple(reports)


# --- numbers that are not free --------------------------------------------------------------------


def fixed_numbers(problem: DesignProblem) -> dict[str, float]:
    """The numbers of the body, and of a single load case, that are not free; without arc lengths."""
    given = {name for names in problem.free.names for name in names}
    given |= {tip_of_winding(name) for name in given} | {name for case in problem.cases for name in case.numbers}
    first, *others = problem.cases
    case = case_numbers(problem.manipulator) if others else replace(first, direction=None).of(problem.manipulator)
    numbers = {name: x for name, x in case.numbers.items() if name not in given and not PLACE.search(name)}
    return {name: float(np.asarray(x)) for name, x in numbers.items()}


def with_fixed(problem: DesignProblem, numbers: Mapping[str, Array]) -> DesignProblem:
    """The problem with other fixed numbers; another length stretches everything along the body."""
    first, *others = problem.cases
    body, first = first.with_numbers(problem.manipulator, numbers)
    return replace(problem, manipulator=body, cases=(first, *others))


@eqx.filter_jit
def _slopes(problem: DesignProblem, x: Array, fixed: tuple[str, ...], numbers: Array) -> Values:
    """The derivatives of objective and margins by fixed numbers, on the last axis."""
    return jax.jacfwd(lambda numbers: with_fixed(problem, dict(zip(fixed, numbers, strict=True))).values(x)[0])(numbers)


# --- in words --------------------------------------------------------------------------------------


def _head(found: Design) -> Iterator[str]:
    yield f"# Design: {found.result}"
    yield ""
    for each in found.objectives:
        yield f"- {each.name}: {shown(each.start, each.dimension)} -> {shown(each.end, each.dimension)}"
    for name in found.blocking:
        yield f"- in the way: {name}"
    if found.blocking:
        yield "- no body nearby keeps to all of these; relax one of them, or start elsewhere"
    for remark in found.remarks:
        yield f"- {remark}"
    yield ""


def _numbers(found: Design) -> Iterator[str]:
    rows = []
    for name, free in found.free.items():
        start, value, lower, upper = (shown(x, free.dimension) for x in free[:4])
        worth = "" if free.status == "inside" else _worth(found, free.multiplier, free.dimension)
        rows.append((name, start, value, f"{lower} to {upper}", free.status, worth))
    head = ("free number", "start", "design", "bounds", "", "gain by a wider bound")
    yield from markdown_table(head, rows, right=("start", "design"))
    yield ""


def _limits(found: Design) -> Iterator[str]:
    rows, signs = [], {"least": ">=", "most": "<=", "equal": "="}
    for limit in found.limits:
        bound, reached = shown(limit.limit, limit.dimension), shown(limit.reached, limit.dimension)
        text = f"{limit.name} {signs[limit.side]} {bound}"
        place = "" if np.isnan(limit.arc_length) else f"s = {shown(limit.arc_length, 'length')}"
        where = ", ".join(part for part in (limit.case, place) if part)
        worth = _worth(found, limit.multiplier, limit.dimension) if limit.active else ""
        rows.append((text, reached, where, "broken" if limit.margin < -TOLERANCE else worth))
    yield from markdown_table(("limit", "reached", "where", "gain by relaxing it"), rows, right=("reached",))
    yield ""


def _worth(found: Design, slope: float, dimension: Dimension) -> str:
    """A derivative of the objective in preferred units."""
    if not _follows(found):
        return ""
    if np.isnan(slope):
        return KINK
    size, unit = preferred(found.objectives[0].dimension) if len(found.objectives) == 1 else (1.0, "")
    step, per = preferred(dimension)
    return f"{slope * size / step:.4g}{' ' + unit if unit else ''}{f' per {per}' if per else ''}"


def _sensitivity(found: Design) -> Iterator[str]:
    """The derivatives of the best objective that count, or of several objectives those of their weighted sum."""
    if _follows(found):
        rows, case = [], found.cases[0].of(found.manipulator)
        for name, number in fixed_numbers(found.outcome.problem).items():
            slope = found.sensitivity[name]
            if not abs(slope * number) <= NOTHING * abs(found.objective):
                rows.append((name, _worth(found, slope, dimension_in(case, name))))
        yield from markdown_table(("number that is not free", "the best objective changes by"), rows)
        yield ""


def _follows(found: Design) -> bool:
    """Whether relative changes of the best objective are meaningful; for `Near` and `Even` the best value is zero."""
    kinds = {each.name.split()[0] for each in found.objectives}
    return found.feasible and not (len(found.objectives) == 1 and kinds & {"near", "even"})


def _foot(found: Design) -> Iterator[str]:
    yield (
        f"Largest violation {found.violation:.1g} and first-order optimality {found.optimality:.1g} (scaled; "
        f"{TOLERANCE:g} is asked for)."
    )
    if len(found.starts) > 1 and found.feasible:
        best = min(found.starts)
        alike = sum(value <= best + GAIN * abs(best) for value in found.starts)
        yield f"Of {len(found.starts)} searches {alike} ended as well as the best."
