"""What the instruments of a bench read: an entry for each kind of column that a fit explains.

A kind of data is added here and in `quantities`: what is read of an equilibrium, its unit and its words. A column has
the name of its kind. If every tendon has one, `tip_tension` is that of tendon 1, and `tip_tension_2` that of tendon 2.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from .markers import marker_column


class Reading(NamedTuple):
    """One kind of data."""

    of: Callable[[Any], Any]  # of equilibria, rows first, SI; tendons last where every tendon has one
    per_tendon: bool = False
    by_cell: bool = False  # a tension as a load cell reads it, gain * (tension - pretension) + zero
    zero: str = ""  # the parameter of a bench that is added to the true value, of each tendon where every one has one
    in_space: bool = False  # whether only a body in space has it
    of_marker: bool = False  # markers last; its columns are those of `markers.marker_column`


READINGS = {
    "tip_tension": Reading(lambda found: found.tip_tension, per_tendon=True, by_cell=True),
    "displacement": Reading(lambda found: found.tendon_displacement, per_tendon=True, zero="slack_offset"),
    "tip_angle": Reading(lambda found: found.tip_angle, zero="angle_zero"),
    "tip_x": Reading(lambda found: found.tip_position[..., 0]),
    "tip_y": Reading(lambda found: found.tip_position[..., 1]),
    "tip_z": Reading(lambda found: found.tip_position[..., 2], in_space=True),
    "tip_axis_x": Reading(lambda found: found.tip_axis[..., 0]),
    "tip_axis_y": Reading(lambda found: found.tip_axis[..., 1]),
    "tip_axis_z": Reading(lambda found: found.tip_axis[..., 2], in_space=True),
    "marker_x": Reading(lambda found: found.markers[..., 0], of_marker=True),
    "marker_y": Reading(lambda found: found.markers[..., 1], of_marker=True),
    "marker_z": Reading(lambda found: found.markers[..., 2], of_marker=True, in_space=True),
}
SET = "base_tension", "displacement"  # what sets a tendon; the first that a table has
NAMED = {name: kind for name, kind in READINGS.items() if not kind.of_marker}  # whose names are those of columns


def kind_of(column: str) -> str:
    """The kind of a reading, "tip_tension" of "tip_tension_2", "marker_x" of "x@120mm"; "" of any other column."""
    stem, _, tendon = column.rpartition("_")
    if tendon.isdigit() and stem in NAMED and NAMED[stem].per_tendon:
        return stem
    if marker := marker_column(column):
        return f"marker_{marker[0]}"
    return column if column in NAMED else ""


def of_shape(column: str) -> bool:
    """Whether a column depends on the shape of the body, in which the two kinematics differ."""
    kind = kind_of(column)
    return bool(kind) and not READINGS[kind].per_tendon


def tendon_number(column: str) -> int:
    """1 for `tip_tension`, 2 for `tip_tension_2`, ..."""
    digits = column.rpartition("_")[2]
    return int(digits) if digits.isdigit() else 1


def of_tendons(name: str, num_tendons: int) -> list[str]:
    """The column of each tendon: `base_tension`, `base_tension_2`, ..."""
    return [name, *(f"{name}_{i}" for i in range(2, num_tendons + 1))]


def kind_of_set(column: str) -> str:
    """`base_tension` or `displacement`, for a column that sets a tendon."""
    return column.rstrip("0123456789").rstrip("_")


def set_by(columns: Collection[str]) -> list[str]:
    """The column that sets each tendon: its base tension, or its displacement where there is none in any row."""
    found = {tendon_number(column): column for kind in SET[::-1] for column in columns if kind_of_set(column) == kind}
    return [found[number] for number in sorted(found)]


class SetColumn(NamedTuple):
    """What sets a tendon in some rows of a table."""

    column: str
    tendon: int  # its place among those that are set, from 0
    rows: np.ndarray  # (rows,), whether the column sets it there

    @property
    def by_length(self) -> bool:
        """Whether it is a displacement."""
        return kind_of_set(self.column) == "displacement"


def set_columns(columns: Mapping[str, np.ndarray]) -> list[SetColumn]:
    """The columns that set the tendons: where a row has no base tension of a tendon, its displacement does."""
    found = []
    for tendon, column in enumerate(set_by(columns)):
        other = column.replace("base_tension", "displacement")
        known = np.isfinite(columns[column]) | (other == column or other not in columns)
        found += [SetColumn(column, tendon, known)] * bool(np.any(known))
        found += [] if np.all(known) else [SetColumn(other, tendon, ~known)]
    return found


def has_reading(columns: Mapping[str, np.ndarray], column: str) -> np.ndarray:
    """(rows,), where a column holds a number; of a displacement that sets its tendon in some rows, in the others."""
    found = np.isfinite(columns[column])
    for own in set_columns(columns):
        if own.column == column and own.by_length and not np.all(own.rows):
            found &= ~own.rows
    return found


def columns_of(num_tendons: int, markers: Sequence[str] = (), components: int = 2) -> list[str]:
    """Every column that a manipulator with these markers and components of positions can show."""
    found = []
    for name, kind in READINGS.items():
        if components == 3 or not kind.in_space:
            own = [f"{name[-1]}@{marker}" for marker in markers]
            found += own if kind.of_marker else of_tendons(name, num_tendons if kind.per_tendon else 1)
    return found
