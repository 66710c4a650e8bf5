"""`cddf plan`: candidates from a file, the ranking as a table."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from .bench import parameter_named, unit_of
from .determination import NOT_IDENTIFIED, Determination
from .errors import InputError
from .fit_command import noise_of
from .measured_columns import dimension_of
from .next_measurement import Candidate, Plan, Ranked
from .observations import Noise
from .units import quantity


def read_candidates(path: Path) -> list[Candidate]:
    """Candidates from a TOML file.

        [[candidate]]
        name = "tip angles"
        base_tension = ["20 N", "40 N", "60 N"]
        noise = { tip_angle = "1 deg", tip_tension = "0.5 N" }
        repeats = 3
        cost = 2.0

    Raises:
        InputError: names the file, the candidate and the remedy.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is no TOML ({error}); write [[candidate]] tables") from None
    entries = content.get("candidate")
    if not isinstance(entries, list) or not entries or set(content) != {"candidate"}:
        raise InputError(f"{path}: holds no candidates; write one [[candidate]] table for each, and nothing else")
    return [_candidate(f"{path}, candidate {i}", entry) for i, entry in enumerate(entries, 1)]


def _candidate(where: str, entry: dict[str, Any]) -> Candidate:
    entry = dict(entry)
    name, noise = entry.pop("name", where), entry.pop("noise", None)
    repeats, cost = entry.pop("repeats", 1), entry.pop("cost", 1.0)
    if not isinstance(noise, dict):
        raise InputError(f'{where}: needs what is read, as in noise = {{ tip_tension = "0.5 N" }}')
    if isinstance(repeats, bool) or not isinstance(repeats, int):
        raise InputError(f"{where}: repeats must be a whole number, got {repeats!r}")
    if isinstance(cost, bool) or not isinstance(cost, int | float):
        raise InputError(f"{where}: cost must be a number, got {cost!r}")
    try:
        conditions = {column: _numbers(where, column, value) for column, value in entry.items()}
        deviations = {column: _noise(where, column, value) for column, value in noise.items()}
        return Candidate(str(name), conditions, deviations, repeats, float(cost))
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(where) else f"{where}: {text}") from None


def _noise(where: str, column: str, value: Any) -> float | Noise:
    if isinstance(value, str) and value.rstrip().endswith("%"):
        return noise_of(column, value, f"{where}: {column}")
    return float(_numbers(where, column, value)[0])


def _numbers(where: str, column: str, value: Any) -> np.ndarray:
    values = value if isinstance(value, list) else [value]
    dimension = dimension_of(column)
    if not values:
        raise InputError(f"{where}: {column} is empty; give a value with its unit")
    return np.array([quantity(v, dimension or "dimensionless", f"{where}: {column}") for v in values])


def as_markdown(plan: Plan) -> str:
    """First in words what to do, then the table."""
    lines = ["# What to measure next", ""]
    lines += [f"- {line}" for line in in_words(plan)]
    lines += ["", "| candidate | cost | gain | expected standard error | told |", "| --- | --- | --- | --- | --- |"]
    lines += ["| " + " | ".join(_row(ranked)) + " |" for ranked in plan.ranking]
    lines += ["", _explanation(plan), ""]
    warnings = [f"{r.candidate.name}: {text}" for r in plan.ranking for text in r.warnings]
    return "\n".join(lines + [f"- warning: {text}" for text in warnings])


def _explanation(plan: Plan) -> str:
    gain = (
        "growth of the logarithm of the determinant of the Fisher information (D-optimality)"
        if plan.criterion == "D"
        else f"fall of the logarithm of the standard error of {plan.criterion} (c-optimality)"
    )
    return f"Gain: {gain}, each candidate alone; ranked by gain per cost."


def in_words(plan: Plan) -> list[str]:
    """What is known now, and what to do in turn."""
    lines = [f"now: {_told(plan.now)}"]
    for i, ranked in enumerate(plan.chosen, 1):
        lines.append(f"{i}. {ranked.candidate.name}: then {_told(ranked.expected)}")
    return lines


def _row(ranked: Ranked) -> list[str]:
    errors = ", ".join(f"{name} {_error(ranked.expected, name)}" for name in ranked.expected.names)
    open_ones = [name for name in ranked.expected.names if ranked.expected.status[name] == NOT_IDENTIFIED]
    told = f"not: {', '.join(open_ones)}" if open_ones else "all identified"
    return [
        ranked.candidate.name,
        f"{ranked.candidate.cost:g}",
        f"{ranked.gain:.2f}".replace("-0.00", "0.00"),
        errors,
        told,
    ]


def _told(told: Determination) -> str:
    known = [f"{name} +- {_error(told, name)}" for name in told.names if told.status[name] != NOT_IDENTIFIED]
    lost = [name for name in told.names if told.status[name] == NOT_IDENTIFIED]
    combined = [f"{name} +- {100 * e.standard_error / e.value:.2g} %" for name, e in told.combinations.items()]
    return "; ".join(known + combined + [f"{name} not identified" for name in lost])


def _error(told: Determination, name: str) -> str:
    """Relative where the parameter has a size, else in its unit."""
    error, value = told.standard_error[name], told.value[name]
    if not np.isfinite(error):
        return "open"
    if parameter_named(name).positive:
        return f"{100 * error / abs(value):.2g} %"
    from .units import shown

    return shown(error, parameter_named(name).dimension)


def as_dict(plan: Plan) -> dict[str, Any]:
    """For JSON, SI units; what is infinite becomes null there."""

    def told(ranked: Ranked) -> dict[str, Any]:
        expected = ranked.expected
        return {
            "name": ranked.candidate.name,
            "cost": ranked.candidate.cost,
            "gain": ranked.gain,
            "unit": {name: unit_of(name) for name in (*expected.names, *expected.combinations)},
            "standard_error": expected.standard_error,
            "status": expected.status,
            "combinations": {name: estimate._asdict() for name, estimate in expected.combinations.items()},
            "warnings": list(ranked.warnings),
        }

    now = {"value": plan.now.value, "standard_error": plan.now.standard_error, "status": plan.now.status}
    return {
        "criterion": plan.criterion,
        "now": now,
        "ranking": [told(ranked) for ranked in plan.ranking],
        "chosen": [told(ranked) for ranked in plan.chosen],
    }
