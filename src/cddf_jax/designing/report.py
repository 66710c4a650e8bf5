"""A design in words, as Markdown, and as numbers for JSON."""

from collections.abc import Iterator
from dataclasses import fields

import numpy as np

from ..files.writing import markdown_table
from ..units import Dimension, preferred, shown
from .constrained import TOLERANCE
from .free_numbers import dimension_of_number, number_in_words
from .results import Design, fixed_numbers

LARGEST = 12  # sensitivities in the report
NOT_IN_JSON = ("manipulator", "start", "cases", "outcome")
KINK = "not unique: limits bind at one place"


def design_in_words(found: Design) -> str:
    """The report as Markdown."""
    return "\n".join([*_head(found), *_numbers(found), *_limits(found), *_sensitivity(found), *_foot(found)])


def _head(found: Design) -> Iterator[str]:
    yield f"# Design: {found.result}"
    yield ""
    for each in found.objectives:
        yield f"- {each.name}: {shown(each.start, each.dimension)} -> {shown(each.end, each.dimension)}"
    for name in found.blocking:
        yield f"- in the way: {name}"
    if found.blocking:
        yield "- no body nearby keeps to all of these; relax one of them, or start elsewhere"
    for name, value in found.chosen.items():
        yield f"- chosen: {name} = {number_in_words(name, value)}"
    for values, objective in found.choices:
        numbers = ", ".join(f"{name} = {number_in_words(name, value)}" for name, value in values.items())
        yield f"- with {numbers}: {_objective(found, objective)}"
    for remark in found.remarks:
        yield f"- {remark}"
    yield ""


def _objective(found: Design, value: float) -> str:
    """The objective in words: the value of one, or the weighted sum of several."""
    if not np.isfinite(value):
        return "not feasible"
    return shown(value, found.objectives[0].dimension) if len(found.objectives) == 1 else f"{value:.5g}"


def _numbers(found: Design) -> Iterator[str]:
    rows = []
    for name, free in found.free.items():
        start, value, lower, upper = (number_in_words(name, x) for x in free[:4])
        worth = "" if free.status == "inside" else _worth(found, free.multiplier, dimension_of_number(name))
        rows.append((name, start, value, f"{lower} to {upper}", free.status, worth))
    head = ("free number", "start", "design", "bounds", "", "gain by a wider bound")
    yield from markdown_table(head, rows, right=("start", "design"))
    yield ""


def _limits(found: Design) -> Iterator[str]:
    rows, signs = [], {"least": ">=", "most": "<=", "equal": "="}
    for limit in found.limits:
        bound, reached = shown(limit.limit, limit.dimension), shown(limit.reached, limit.dimension)
        text = f"{limit.name} {signs[limit.side]} {bound}{' (implied)' if limit.implied else ''}"
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
    """The largest logarithmic derivatives of the objective, if neither it nor the number is zero."""
    if not _follows(found):
        return
    size, rows, kinks = abs(found.objective), {}, []
    numbers = zip(fixed_numbers(found.outcome.problem).values(), found.sensitivity.items(), strict=True)
    for value, (name, slope) in numbers:
        change = slope * value
        if dimension_of_number(name.split(": ")[-1]) == "angle":  # which has no size
            name, change = f"{name}, by 1 deg", slope * np.radians(1.0) / 0.01
        if np.isnan(slope):
            kinks.append(name)
        elif size > 0 and abs(change) > 1e-9 * size:
            rows[name] = change / size
    largest = sorted(rows.items(), key=lambda item: -abs(item[1]))[:LARGEST]
    lines = [(name, f"{percent:+.3g} %") for name, percent in largest]
    if kinks:
        lines.append((", ".join(kinks), KINK))
    several = "" if len(found.objectives) == 1 else " (of several: their weighted sum)"
    head = f"how the best objective follows{several}", "change by 1 % changes it by"
    yield from markdown_table(head, lines, right=head[1:])
    yield ""


def _follows(found: Design) -> bool:
    """Whether relative changes of the best objective are meaningful; for `Near` and `Even` the best value is zero."""
    kinds = {each.name.split()[0] for each in found.objectives}
    return found.feasible and not (len(found.objectives) == 1 and kinds & {"near", "even"})


def _foot(found: Design) -> Iterator[str]:
    if len(found.objectives) > 1:
        weights = ", ".join(f"{each.weight:g}" for each in found.objectives)
        yield (
            f"Each objective counts relative to its size at the start; weights {weights}: "
            f"together {found.objective:.5g}."
        )
    yield (
        f"Largest violation {found.violation:.1g} and first-order optimality {found.optimality:.1g} (scaled; "
        f"{TOLERANCE:g} is asked for)."
    )
    if len(found.starts) > 1:
        ends = ", ".join(_objective(found, value) for value in found.starts)
        yield f"Searches from {len(found.starts)} starts ended at {ends}."


def design_as_dict(found: Design) -> dict[str, object]:
    """A design for JSON, SI units."""
    own = {each.name: getattr(found, each.name) for each in fields(found) if each.name not in NOT_IN_JSON}
    return own | {
        "sensitivity": found.sensitivity if _follows(found) else {},
        "choices": [{"numbers": values, "objective": objective} for values, objective in found.choices],
    }
