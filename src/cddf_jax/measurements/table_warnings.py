"""Warnings about a table of measurements that can be used."""

from collections.abc import Callable
from functools import partial

import numpy as np

from .forces import force_column
from .readings import set_by
from .table import Measurements

_TIP_ABOVE_BASE = 1.05  # times the base tension, plus
_ZERO_ERROR = 0.005  # times the largest base tension: a tip tension above this sum is reported
ONE_LEVEL = 0.01  # base tensions that vary by less, relative to the largest, are one level
_LARGEST_ANGLE = {"wrap_angle": 10 * np.pi, "tip_angle": 2 * np.pi}  # larger ones are probably degrees


def warnings_of(table: Measurements, *, in_order: bool | None, from_rest: bool = True) -> tuple[str, ...]:
    """Warnings, one line each, for the report; a warning about columns names the first of them.

    Args:
        table: of measurements.
        in_order: whether its rows have a history; None: each is pulled from rest.
        from_rest: whether the trials begin at rest.
    """
    of_past = [partial(_tip_above_base, in_order=in_order)] if from_rest else []
    of_order = [_coming_down] if in_order is False else []
    looks = _below_zero, *of_past, *of_order, _large_angle
    found = [next(filter(None, (look(table, column) for column in table.columns)), "") for look in looks]
    return tuple(filter(None, found))


def _below_zero(table: Measurements, column: str) -> str:
    if not column.startswith(("base_tension", "tip_tension", "pulling_tension")):
        return ""
    free = f"; if so let {column.replace('tension', 'zero')} be free too"
    remedy = "has the zero of the cell drifted?" + ("" if column == "pulling_tension" else free)
    values = table[column]
    return _rows_with(table, values < 0, f"{column} below 0", lambda i: f"{values[i]:.4g} N", remedy)


def _tip_above_base(table: Measurements, column: str, *, in_order: bool | None) -> str:
    """Rows in which all of the tendon slides in: with a history those at the largest base tension so far."""
    pull, way = column.replace("tip", "base"), column.replace("tip_tension", "direction")
    if not column.startswith("tip_tension") or pull not in table:
        return ""
    if len(set_by(table.columns)) > 1 and (in_order or way not in table):
        return ""  # of several tendons any may slide out while another is pulled
    base, tip = table[pull], table[column]
    sliding_in = table.columns.get(way, np.ones(len(table))) > 0
    for rows in table.trials if in_order else ():
        sliding_in[rows] = base[rows] >= np.maximum.accumulate(base[rows])
    above = sliding_in & (tip > _TIP_ABOVE_BASE * base + _ZERO_ERROR * np.nanmax(base))
    remedy = f"are the cells swapped or off zero, or does the tendon slide out ({way} -1)?"
    what = f"{column} more than 5 % above {pull}"
    return _rows_with(table, above, what, lambda i: f"{tip[i]:.6g} N over {base[i]:.6g} N", remedy)


def _coming_down(table: Measurements, column: str) -> str:
    """Rows below the row before them that are not a new start at the lowest level of their trial."""
    stated = column.replace("base_tension", "direction")
    several = len(set_by(table.columns)) > 1 or any(map(force_column, table.columns))
    if not column.startswith("base_tension") or (stated in table and several):
        return ""
    down, before, slack = np.zeros(len(table), bool), np.zeros(len(table)), ONE_LEVEL * table[column].max()
    for rows in table.trials:
        own = table[column][rows]
        down[rows[1:]] = (np.diff(own) < -slack) & (own[1:] > own.min() + slack)
        before[rows[1:]] = own[:-1]
    what = f"{column} below that of the row before"
    remedy = (
        f"without a history the whole tendon slides as {stated} says, or is pulled from rest. Give the rows a history "
        f"(history=True, --history, a column step or time), or write {stated} -1 where all of the tendon slides out, "
        "and leave out the rows right after the turn, where part of it sticks"
    )
    return _rows_with(table, down, what, lambda i: f"{table[column][i]:.6g} N after {before[i]:.6g} N", remedy)


def _large_angle(table: Measurements, column: str) -> str:
    values, largest = table[column], _LARGEST_ANGLE.get(column, np.inf)
    what, remedy = f"{column} beyond {largest / (2 * np.pi):.0f} turn(s)", "are these degrees under a unit of rad?"
    return _rows_with(table, np.abs(values) > largest, what, lambda i: f"{values[i]:.6g} rad", remedy)


def _rows_with(table: Measurements, which: np.ndarray, what: str, value: Callable[[int], str], remedy: str) -> str:
    """A warning with the number of rows concerned and the first of them; "" for none."""
    if not np.any(which):
        return ""
    first = int(np.argmax(which))
    count = f"{np.count_nonzero(which)} of {len(table)}"
    return f"rows with {what}: {count} ({table.place(first)}: {value(first)}); {remedy}"
