"""What `cddf design` says and writes: the report, the numbers for JSON, the profile of a body with radii for CAD."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .artifacts import as_json, write_all
from .constrained import TOLERANCE
from .cross_sections import cross_sections_csv
from .design_figure import design_figure, pareto_figure
from .design_file import DesignTask
from .design_program import fixed_numbers
from .design_results import Design, FreeNumber, LimitReport, in_unit, number_in_words
from .designing import design
from .errors import InputError
from .manipulator_file import manipulator_text
from .pareto import ParetoFront, pareto_front
from .plotting import render
from .units import Dimension, preferred, shown

LARGEST = 12  # sensitivities that are told


def carry_out(task: DesignTask, out: Path | None, progress: bool) -> tuple[dict[str, Any], str, bool]:
    """Design, and write what is asked for; the new manipulator only where it keeps to all limits.

    Returns:
        The answer for JSON, the report, and whether all is well.
    """
    arguments = task.arguments() | {"choices": task.choices, "starts": task.starts, "seed": task.seed}
    with task.named():
        found = design(task.manipulator, task.objective, **arguments, progress=progress)
    answer, text = as_dict(found), in_words(found)
    if out is not None:
        files: dict[str, Any] = {"design.md": text + "\n", "design.json": as_json(answer)}
        if found.feasible:
            outside = task.offsets_outside_wall
            files["design.toml"] = manipulator_text(found.manipulator, offsets_outside_wall=outside)
            if found.manipulator.has_radii:
                files["profile.csv"] = cross_sections_csv(found.manipulator)
            files |= render(design_figure(found), "design")
        write_all(out, files)
    return answer, text, found.success


def trade_off(task: DesignTask, num: int, out: Path | None, progress: bool) -> tuple[dict[str, Any], str, bool]:
    """As `carry_out`, of the two objectives against each other."""
    if task.choices or task.starts > 1 or any(weight != 1 for weight, _ in task.objective):
        raise InputError(
            "--pareto: choices, starts and weights have no place in a trade-off; take them out of the task"
        )
    aims = [aim for _, aim in task.objective]
    with task.named():
        front = pareto_front(task.manipulator, aims, **task.arguments(), num=num, progress=progress)
    answer, text = front_as_dict(front), front_in_words(front)
    if out is not None:
        files: dict[str, Any] = {"pareto.md": text + "\n", "pareto.json": as_json(answer)}
        for i, found in enumerate(front.designs, 1):
            if found.feasible:
                outside = task.offsets_outside_wall
                files[f"design_{i}.toml"] = manipulator_text(found.manipulator, offsets_outside_wall=outside)
        write_all(out, files | render(pareto_figure(front), "pareto"))
    return answer, text, front.success


def in_words(found: Design) -> str:
    """The report as Markdown."""
    return "\n".join([*_head(found), *_numbers(found), *_limits(found), *_sensitivity(found), *_foot(found)])


def _head(found: Design) -> Iterator[str]:
    yield f"# Design: {found.result}"
    yield ""
    for each in found.objectives:
        yield f"- {each.name}: {in_unit(each.start, each.dimension)} -> {in_unit(each.end, each.dimension)}"
    for name in found.blocking:
        yield f"- in the way: {name}"
    if found.blocking:
        yield "- no body nearby keeps to all of these; relax one of them, or start elsewhere"
    for name, value in found.chosen.items():
        yield f"- chosen: {name} = {number_in_words(name, value)}"
    for values, objective in found.choices:
        told = ", ".join(f"{name} = {number_in_words(name, value)}" for name, value in values.items())
        yield f"- with {told}: {_objective(found, objective)}"
    for remark in found.remarks:
        yield f"- {remark}"
    yield from _at_bounds(found)
    yield ""


def _at_bounds(found: Design) -> Iterator[str]:
    """What the multipliers tell of the bounds that are reached, and no more."""
    reached = {name: free for name, free in found.free.items() if free.status != "inside"}
    if not found.success or not reached:
        return

    def listed(some: dict[str, FreeNumber]) -> str:
        return ", ".join(f"{name} {free.status}" for name, free in some.items())

    if held := {name: free for name, free in reached.items() if free.multiplier > 0}:
        yield f"- {listed(held)}: a wider bound would make the objective better"
    if others := {name: free for name, free in reached.items() if name not in held}:
        yield f"- {listed(others)}: a multiplier of 0, which does not tell whether another value is better"


def _objective(found: Design, value: float) -> str:
    """The objective in words: of one its value, of several their weighted sum."""
    if not np.isfinite(value):
        return "not feasible"
    return in_unit(value, found.objectives[0].dimension) if len(found.objectives) == 1 else f"{value:.5g}"


def _numbers(found: Design) -> Iterator[str]:
    yield "| free number | start | design | bounds | |"
    yield "| --- | ---: | ---: | --- | --- |"
    for name, free in found.free.items():
        values = [number_in_words(name, value) for value in (free.start, free.value, free.lower, free.upper)]
        yield f"| {name} | {values[0]} | {values[1]} | {values[2]} to {values[3]} | {free.status} |"
    yield ""


def _limits(found: Design) -> Iterator[str]:
    yield "| limit | reached | where | what giving way is worth |"
    yield "| --- | ---: | --- | --- |"
    for limit in found.limits:
        place = "all along" if limit.all_along else f"s = {shown(limit.arc_length, 'length')}"
        place = "" if np.isnan(limit.arc_length) else place
        where = ", ".join(part for part in (limit.case, place) if part)
        yield f"| {_limit_text(limit)} | {_value(limit.reached, limit.dimension)} | {where} | {_worth(found, limit)} |"
    yield ""


def _limit_text(limit: LimitReport) -> str:
    sign = {"least": ">=", "most": "<=", "equal": "="}[limit.side]
    return f"{limit.name} {sign} {_value(limit.limit, limit.dimension)}{' (implied)' if limit.implied else ''}"


def _worth(found: Design, limit: LimitReport) -> str:
    if not found.feasible:
        return "broken" if limit.margin < -TOLERANCE else ""
    if not limit.active or np.isnan(limit.multiplier) or not _follows(found):
        return ""
    worth = _per(found, limit.multiplier, limit.dimension)
    if abs(limit.tightening - limit.multiplier) <= 1e-4 * abs(limit.tightening):
        return worth
    return f"{worth}; tightening costs {_per(found, limit.tightening, limit.dimension)} (limits bind at one place)"


def _per(found: Design, slope: float, dimension: Dimension) -> str:
    """A derivative of the objective, per unit that an engineer writes."""
    if len(found.objectives) != 1 or not _follows(found):
        own, unit = slope, ""
    else:
        size, unit = preferred(found.objectives[0].dimension)
        own = slope * size
    step, per = preferred(dimension)
    return f"{own / step:.4g}{' ' + unit if unit else ''}{f' per {per}' if per else ''}"


def _sensitivity(found: Design) -> Iterator[str]:
    if not _follows(found):
        return
    relative = _relative(found)
    several = "" if len(found.objectives) == 1 else " (of several: their weighted sum)"
    yield f"| how the best objective follows{several} | change by 1 % changes it by |"
    yield "| --- | ---: |"
    for name, percent in sorted(relative.items(), key=lambda item: -abs(item[1]))[:LARGEST]:
        yield f"| {name} | {percent:+.3g} % |"
    kinks = [_plain_name(name, found) for name, slope in found.sensitivity.items() if np.isnan(slope)]
    if kinks:
        yield f"| {', '.join(kinks)} | a kink: limits bind at one place |"
    yield ""


def _follows(found: Design) -> bool:
    """Whether the best objective has a size that can follow; a distance from what is wanted is zero at best."""
    kinds = {each.name.split()[0] for each in found.objectives}
    return found.feasible and not (len(found.objectives) == 1 and kinds & {"near", "even"})


def _relative(found: Design) -> dict[str, float]:
    """Logarithmic derivatives of the objective, where both it and the number have a size."""
    values = fixed_numbers(found.outcome.program.problem)
    size = abs(found.objective)
    return {
        _plain_name(name, found): slope * values[name] / size
        for name, slope in found.sensitivity.items()
        if size > 0 and abs(slope * values[name]) > 1e-9 * size
    }


def _plain_name(name: str, found: Design) -> str:
    """A limit by what it limits, and the one load case without a number."""
    kind, _, side = name.partition(": ")
    if kind.startswith("limit "):
        limit = found.outcome.program.problem.limits[int(kind.removeprefix("limit ")) - 1]
        return f"limit of {limit.quantity}, {side}"
    if not kind.startswith("case "):
        return name
    case = found.cases[int(kind.removeprefix("case ")) - 1]
    target = "what base_tension is to reach" if side.endswith(".value") else side
    return target if len(found.cases) == 1 else f"{case.name or kind}: {target}"


def _foot(found: Design) -> Iterator[str]:
    weights = "; weights " + ", ".join(f"{each.weight:g}" for each in found.objectives)
    if len(found.objectives) > 1:
        yield f"Each objective counts relative to its size at the start{weights}: together {found.objective:.5g}."
    yield (
        f"Largest violation {found.violation:.1g} and first-order optimality {found.optimality:.1g} (scaled; "
        f"{TOLERANCE:g} is asked for), {len(found.history)} iterations, {found.evaluations} evaluations."
    )
    if len(found.starts) > 1:
        ends = ", ".join(_objective(found, value) for value in found.starts)
        yield f"Searches from {len(found.starts)} starts came to {ends}."


def _value(value: Any, dimension: Dimension) -> str:
    return ", ".join(in_unit(each, dimension) for each in np.ravel(value))


def as_dict(found: Design) -> dict[str, Any]:
    """For JSON, SI units."""
    return {
        "result": found.result,
        "success": found.success,
        "feasible": found.feasible,
        "objective": found.objective,
        "objectives": [each._asdict() for each in found.objectives],
        "free": {name: free._asdict() for name, free in found.free.items()},
        "limits": [limit._asdict() for limit in found.limits],
        "blocking": list(found.blocking),
        "optimality": found.optimality,
        "violation": found.violation,
        "sensitivity": found.sensitivity if _follows(found) else {},
        "chosen": found.chosen,
        "choices": [{"numbers": values, "objective": objective} for values, objective in found.choices],
        "iterations": len(found.history),
        "evaluations": found.evaluations,
        "history": [{"objective": objective, "violation": violation} for objective, violation in found.history],
        "starts": list(found.starts),
        "remarks": list(found.remarks),
    }


def front_in_words(front: ParetoFront) -> str:
    """The front as Markdown."""
    lines = [f"# Trade-off: {front.names[0]} against {front.names[1]}", ""]
    lines += [f"- {remark}" for remark in front.remarks] + ([""] if front.remarks else [])
    names = list(front.designs[0].free)
    lines.append(f"| {front.names[0]} | {front.names[1]} | {' | '.join(names)} | |")
    lines.append("| ---: | ---: |" + " ---: |" * len(names) + " --- |")
    for found in front.designs:
        pair = " | ".join(in_unit(each.end, each.dimension) for each in found.objectives)
        free = " | ".join(number_in_words(name, value) for name, value in found.value.items())
        lines.append(f"| {pair} | {free} | {found.result} |")
    return "\n".join(lines)


def front_as_dict(front: ParetoFront) -> dict[str, Any]:
    """For JSON, SI units."""
    return {
        "objectives": list(front.names),
        "start": list(front.start),
        "values": front.values,
        "exchange_rate": front.exchange_rate,
        "success": front.success,
        "remarks": list(front.remarks),
        "result": "successful" if front.success else "some points of the front were not found",
        "designs": [{"result": found.result, "value": found.value} for found in front.designs],
    }
