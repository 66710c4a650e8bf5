"""Warnings about a table of measurements that can be used."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .table import Measurements

_TIP_ABOVE_BASE = 1.05  # times the base tension, plus
_ZERO_ERROR = 0.005  # times the largest base tension: a tip tension above this sum is reported
ONE_LEVEL = 0.01  # base tensions that vary by less, relative to the largest, are one level
_TURNED = (
    "each counts as pulled from rest. Where the tension was lowered without a release to 0 N, write {} -1 for rows in "
    "which all of the tendon slides out, and leave out those right after the turn, where part of it still sticks"
)
_LARGEST_ANGLE = {"wrap_angle": 10 * np.pi, "tip_angle": 2 * np.pi}  # larger ones are probably degrees


def warnings_of(table: "Measurements", *, in_order: bool, from_rest: bool = True) -> tuple[str, ...]:
    """Warnings, one line each, for the report; a warning about columns names the first of them.

    Args:
        table: of measurements.
        in_order: whether its rows have a history.
        from_rest: whether the trials begin at rest.
    """
    of_rows = [look(table) for look in (_too_few_rows, _repeated_rows, _one_level)]
    of_order = (_tip_above_base_on_the_way_up, _starts_anew) if in_order else (_tip_above_base, _coming_down)
    looks = (_below_zero, *(of_order if from_rest else of_order[1:]), _large_angle)
    of_columns = [next(filter(None, (look(table, column) for column in table.columns)), "") for look in looks]
    return tuple(filter(None, of_rows + of_columns))


def _too_few_rows(table: "Measurements") -> str:
    if len(table) == 1:
        return "there is one row only, from which no scatter can be estimated"
    counts = np.bincount(table.trial)
    alone = np.flatnonzero(counts == 1)
    if alone.size == 0 or counts.max() == 1:  # one row in each trial: the trial is only a label of the row
        return ""
    first = table.place(int(np.flatnonzero(table.trial == alone[0])[0]))
    return (
        f"trials of one row only: {alone.size} of {counts.size} (trial {table.trial_labels[alone[0]]}, {first}); "
        "is the rest missing?"
    )


def _repeated_rows(table: "Measurements") -> str:
    if len(table) == 1:
        return ""
    columns = [np.nan_to_num(values, nan=np.inf) for values in table.columns.values()]  # gaps are equal to each other
    measured = [values for column, values in zip(table.columns, columns, strict=True) if column != "trial"]
    if all(np.all(values == values[0]) for values in measured):
        return f"all {len(table)} rows are equal, so that nothing follows from their differences"
    order = np.lexsort(columns)  # stable: of equal rows the earlier stays first
    same = np.all([values[order][1:] == values[order][:-1] for values in columns], axis=0)
    if not np.any(same):
        return ""
    earlier, later = order[:-1][same], order[1:][same]
    first = int(np.argmin(later))
    return (
        f"rows that repeat an earlier one to the last digit: {later.size} of {len(table)} "
        f"({table.place(int(later[first]))} is {table.place(int(earlier[first]))} again); were they copied?"
    )


def _one_level(table: "Measurements") -> str:
    pulls = [values for column, values in table.columns.items() if column.startswith("base_tension")]
    if len(table) == 1 or not pulls or any(np.ptp(values) > ONE_LEVEL * values.max() for values in pulls):
        return ""
    level = f"{pulls[0].mean():.4g} N"
    return f"base_tension hardly varies from {level}, so that no slope can be determined; measure at other levels"


def _below_zero(table: "Measurements", column: str) -> str:
    if not column.startswith(("base_tension", "tip_tension", "pulling_tension")):
        return ""
    free = f"; if so let {column.replace('tension', 'zero')} be free too"
    remedy = "has the zero of the cell drifted?" + ("" if column == "pulling_tension" else free)
    values = table[column]
    return _rows_with(table, values < 0, f"{column} below 0", lambda i: f"{values[i]:.4g} N", remedy)


def _tip_above_base(table: "Measurements", column: str) -> str:
    way = column.replace("tip_tension", "direction")
    found_later = "base_tension_2" in table.columns and way not in table.columns  # with the equilibrium
    if not column.startswith("tip_tension") or found_later:
        return ""
    return _above(table, column, table.columns.get(way, np.ones(len(table))) > 0)


def _tip_above_base_on_the_way_up(table: "Measurements", column: str) -> str:
    """As `_tip_above_base`, for rows at the largest base tension so far, where all of the tendon slides in."""
    if not column.startswith("tip_tension") or "base_tension_2" in table.columns:
        return ""  # of several tendons any may slide out while another is pulled
    base, highest = table["base_tension"], np.zeros(len(table), bool)
    for rows in table.trials:
        highest[rows] = base[rows] >= np.maximum.accumulate(base[rows])
    return _above(table, column, highest)


def _starts_anew(table: "Measurements", column: str) -> str:
    """Rows at the lowest level of their trial, after twice that level or more, before a new pull: perhaps from rest."""
    if column != "base_tension":
        return ""
    base, trial = table[column][table.order], table.trial[table.order]
    least = np.full(trial.max() + 1, np.inf)
    np.minimum.at(least, trial, base)
    slack, alike = ONE_LEVEL * base.max(), np.diff(trial) == 0
    before, after = np.append(0.0, np.where(alike, base[:-1], 0.0)), np.append(np.where(alike, base[1:], 0.0), 0.0)
    low = (base > slack) & (base <= least[trial] + slack) & (before > 2 * base + slack) & (after > base + slack)
    which, above = np.zeros(len(table), bool), np.zeros(len(table))
    which[table.order], above[table.order] = low, before
    what = f"{column} back at its lowest level, from which it rises again"
    remedy = (
        "they count as released to this level; if the tendon was fully released in between, give each pull a trial of "
        "its own, or add rows of 0 N"
    )
    return _rows_with(table, which, what, lambda i: f"{table[column][i]:.6g} N after {above[i]:.6g} N", remedy)


def _above(table: "Measurements", column: str, sliding_in: np.ndarray) -> str:
    pull, way = column.replace("tip", "base"), column.replace("tip_tension", "direction")
    base, tip = table[pull], table[column]
    above = sliding_in & (tip > _TIP_ABOVE_BASE * base + _ZERO_ERROR * base.max())
    remedy = f"are the cells swapped or off zero, or does the tendon slide out ({way} -1)?"
    what = f"{column} more than 5 % above {pull}"
    return _rows_with(table, above, what, lambda i: f"{tip[i]:.6g} N over {base[i]:.6g} N", remedy)


def _coming_down(table: "Measurements", column: str) -> str:
    """Rows below the row before them that are not a new start at the lowest level of their trial."""
    stated = column.replace("base_tension", "direction")
    with_history = "base_tension_2" not in table and not any(name.startswith("tip_force") for name in table.columns)
    if not column.startswith("base_tension") or (stated in table.columns and not with_history):
        return ""
    order = table.order
    base, trial = table[column][order], table.trial[order]
    slack, least = ONE_LEVEL * base.max(), np.full(trial.max() + 1, np.inf)
    np.minimum.at(least, trial, base)
    falls = np.append(False, (np.diff(base) < -slack) & (np.diff(trial) == 0))
    down = np.zeros(len(table), bool)
    down[order] = falls & (base > least[trial] + slack)
    before = np.empty(len(table))
    before[order] = np.append(0.0, base[:-1])
    if with_history:
        how = f"slides as its {stated} says" if stated in table.columns else "is pulled from rest"
        what = f"{column} below that of the row before"
        remedy = (
            f"without a history the tendon {how}, along its whole length. With one, what came before counts: give "
            "history=True (--history), or a column step or time"
        )
    else:
        what, remedy = f"{column} below that of the row before, while no {stated} is stated", _TURNED.format(stated)
    return _rows_with(table, down, what, lambda i: f"{table[column][i]:.6g} N after {before[i]:.6g} N", remedy)


def _large_angle(table: "Measurements", column: str) -> str:
    values, largest = table[column], _LARGEST_ANGLE.get(column, np.inf)
    what, remedy = f"{column} beyond {largest / (2 * np.pi):.0f} turn(s)", "are these degrees under a unit of rad?"
    return _rows_with(table, np.abs(values) > largest, what, lambda i: f"{values[i]:.6g} rad", remedy)


def _rows_with(table: "Measurements", which: np.ndarray, what: str, value: Callable[[int], str], remedy: str) -> str:
    """A warning with the number of rows concerned and the first of them; "" for none."""
    if not np.any(which):
        return ""
    first = int(np.argmax(which))
    count = f"{np.count_nonzero(which)} of {len(table)}"
    return f"rows with {what}: {count} ({table.place(first)}: {value(first)}); {remedy}"
