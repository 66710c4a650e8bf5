"""What deserves a look in a table of measurements, though it can be used."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np

_TIP_ABOVE_BASE = 1.05  # a tip cell may read this much of the base cell before the report mentions it,
_ZERO_ERROR = 0.005  # and this much of the largest base tension more
ONE_LEVEL = 0.01  # base tensions that vary by less, relative to the largest, are one level
_LARGEST_ANGLE = {"wrap_angle": 10 * np.pi, "tip_angle": 2 * np.pi}  # larger ones are rather degrees than radians


class Table(Protocol):
    """What of a table of measurements is looked at."""

    @property
    def columns(self) -> Mapping[str, np.ndarray]: ...
    @property
    def trial_labels(self) -> tuple[str, ...]: ...
    def __len__(self) -> int: ...
    def __getitem__(self, column: str, /) -> np.ndarray: ...
    def place(self, row: int, /) -> str: ...


def warnings_of(table: Table) -> tuple[str, ...]:
    """One line each, for the report."""
    looks = (_too_few_rows, _repeated_rows, _one_level, _below_zero, _tip_above_base, _coming_down, _large_angles)
    return tuple(warning for look in looks if (warning := look(table)))


def _too_few_rows(table: Table) -> str:
    if len(table) == 1:
        return "there is one row only, from which no scatter can be estimated"
    trials = table.columns.get("trial", np.zeros(0)).astype(int)
    counts = np.bincount(trials)
    alone = np.flatnonzero(counts == 1)
    if alone.size == 0 or counts.max() == 1:  # one row in each trial: the trial is but a label of the row
        return ""
    first = table.place(int(np.flatnonzero(trials == alone[0])[0]))
    return (
        f"trials of one row only: {alone.size} of {counts.size} (trial {table.trial_labels[alone[0]]}, {first}); "
        "is the rest missing?"
    )


def _repeated_rows(table: Table) -> str:
    if len(table) == 1:
        return ""
    columns = [np.nan_to_num(values, nan=np.inf) for values in table.columns.values()]  # what is missing twice is alike
    measured = [values for column, values in zip(table.columns, columns, strict=True) if column != "trial"]
    if all(np.all(values == values[0]) for values in measured):
        return f"all {len(table)} rows are equal, so that nothing can be told from their differences"
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


def _one_level(table: Table) -> str:
    pulls = [values for column, values in table.columns.items() if column.startswith("base_tension")]
    if len(table) == 1 or not pulls or any(np.ptp(values) > ONE_LEVEL * values.max() for values in pulls):
        return ""
    level = f"{pulls[0].mean():.4g} N"
    return f"base_tension hardly varies from {level}, so that nothing can be told of a slope; measure at other levels"


def _below_zero(table: Table) -> str:
    for column, values in table.columns.items():
        if column.startswith(("base_tension", "tip_tension", "pulling_tension")) and np.any(values < 0):
            zero = column.replace("tension", "zero")  # a pulley test has no such parameter
            remedy = "" if column == "pulling_tension" else f"; if so let {zero} be free too"
            value = f"{values[int(np.argmax(values < 0))]:.4g} N"
            return _rows_with(
                table, values < 0, f"{column} below 0", value, f"has the zero of the cell drifted?{remedy}"
            )
    return ""


def _tip_above_base(table: Table) -> str:
    several = "base_tension_2" in table.columns
    for column in table.columns:
        if column.startswith("tip_tension"):
            base, tip, way = (
                table[column.replace("tip", "base")],
                table[column],
                column.replace("tip_tension", "direction"),
            )
            if several and way not in table.columns:  # found with the equilibrium
                continue
            sliding_in = table.columns.get(way, np.ones(len(table))) > 0
            above = sliding_in & (tip > _TIP_ABOVE_BASE * base + _ZERO_ERROR * base.max())
            if np.any(above):
                what = f"{column} more than 5 % above {column.replace('tip', 'base')}"
                remedy = f"are the cells swapped or off zero, or does the tendon slide out ({way} -1)?"
                first = int(np.argmax(above))
                return _rows_with(table, above, what, f"{tip[first]:.6g} N over {base[first]:.6g} N", remedy)
    return ""


def _coming_down(table: Table) -> str:
    """Rows below the one before them in the file that are no fresh start at the lowest level of their trial."""
    trial = table.columns.get("trial", np.zeros(len(table)))
    for column in table.columns:
        if column.startswith("base_tension") and column.replace("base_tension", "direction") not in table.columns:
            base = table[column]
            least = (
                np.array([base[trial == label].min() for label in trial]) if "trial" in table.columns else base.min()
            )
            slack = ONE_LEVEL * base.max()
            down = np.append(False, (np.diff(base) < -slack) & (np.diff(trial) == 0)) & (base > least + slack)
            if np.any(down):
                first = int(np.argmax(down))
                stated = column.replace("base_tension", "direction")
                what = f"{column} below that of the row before, while no {stated} is stated"
                remedy = (
                    "each counts as pulled from rest. Where the tension was lowered without a release to 0 N, write "
                    f"{stated} -1 for rows in which all of the tendon slides out, and leave out those right after the "
                    "turn, where part of it still sticks"
                )
                return _rows_with(table, down, what, f"{base[first]:.6g} N after {base[first - 1]:.6g} N", remedy)
    return ""


def _large_angles(table: Table) -> str:
    for column, largest in _LARGEST_ANGLE.items():
        large = np.abs(table.columns.get(column, np.zeros(len(table)))) > largest
        if np.any(large):
            what, value = f"{column} beyond {largest / (2 * np.pi):.0f} turn(s)", table[column][int(np.argmax(large))]
            return _rows_with(table, large, what, f"{value:.6g} rad", "are these degrees under a unit of rad?")
    return ""


def _rows_with(table: Table, which: np.ndarray, what: str, value: str, remedy: str) -> str:
    first = table.place(int(np.argmax(which)))
    return f"rows with {what}: {np.count_nonzero(which)} of {len(table)} ({first}: {value}); {remedy}"
