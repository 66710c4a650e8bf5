"""Tables of measurements: CSV or .xlsx with the unit in the header, SI in memory.

    # simulated, seed 1           lines with # before the header are notes
    trial, base_tension [N], tip_tension [N], tip_angle [deg], direction
    A, 5, 4.79, 3.1, 1

| column | unit of | meaning |
| --- | --- | --- |
| base_tension, base_tension_2, ... | force | pull at the base on tendon 1, 2, ... |
| displacement, displacement_2, ... | length | pulled in at the actuator; sets a tendon where it has no base tension |
| tip_tension, tip_tension_2, ... | force | the same tendon's tension at its tip end |
| tip_angle | angle | phi(L) |
| tip_x, tip_y, tip_z | length | u(L) in the frame at the base, tip_z of a body in space |
| tip_axis_x, tip_axis_y, tip_axis_z | none | the direction in which the tip points, of length 1 |
| x@120mm, y@120mm, z@120mm | length | a marker at that arc length; the place of `x@head` is given separately |
| tip_force_x, tip_force_y, tip_force_z | force | known dead load on the tip |
| force_x@60mm, force_y@60mm, force_z@60mm | force | the same at that arc length, such as a weight that hangs there |
| direction, direction_2, ... | none | +1 where the tendon slides in (pulled), -1 out; without it: as `solve` finds it |
| wrap_angle | angle | pulley test: angle of contact |
| weight, pulling_tension | force | pulley test: hanging weight, and load cell while the weight is raised |
| trial | none | any label |
| step | none | gives the order in which the rows of a trial were measured, which are then a path with a history |
| time | time | says that the order of the file is that order |

Time may not go back in a trial, unless a column step gives the order. Its cells are numbers, clock times such as
10:00:18, or dates (`files.times`). A step may be repeated in rows one after another, which keep the order of the file.
A step that comes again later is refused.

A pulley test has its three columns, and may have trial, step and time;
pulling_tension = weight exp(mu wrap_angle), Liu et al. (2020), eq. (5).

Files of instruments and spreadsheets are read too; `Measurements.read_as` says how they were understood:

- Names in capitals or with spaces, `T_base` and `T_tip`; units in parentheses, behind the name or at most three rows
  below the header: `Base Tension (N)`, `Tbase_N`. Say what any other column is by `columns` or `--column`.
- Other columns are not used. A name that resembles a known one is refused.
- Text above the header, such as that of LabVIEW or a table of channels, is taken as notes.
- A cell of an instrument without a number (empty, nan, n/a, -): that reading is left out, and the others of its row
  stay. What was set (tensions at the base, or else displacements, forces, directions) must be there.
- `loading`, `in`, `up`, `pull` are direction 1; `unloading`, `out`, `down`, `release` are -1.
- A tension may be below 0 by up to 2 % of the largest, as the zero of a cell drifts.

Rows are counted as the lines of the file, or as the rows of a sheet. `table_source` lists the separators, decimal
marks and encodings that can be read; .xlsx needs the extra `excel`.
"""

import hashlib
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError, in_utf8, within
from ..files.csv_table import Table, read_table
from ..files.table_header import Heading, Kind, short
from ..files.times import seconds_of
from ..numerics.given_numbers import check_numbers
from ..units import preferred, written
from .columns import (
    DIRECTIONS,
    PER_TENDON,
    PULLEY,
    column_dimension,
    column_meant,
    column_resembled,
    how_to_say,
    is_reading,
    may_be_read,
    option,
)
from .marker_table import NO_MARKERS, of_markers, read_marker_table
from .markers import Marker
from .order import ORDER, check_order, order_of
from .readings import SetColumn, has_reading, kind_of, set_columns

_FROM_CELLS = ("base_tension", "tip_tension", "pulling_tension")
_NEVER_NEGATIVE = (*_FROM_CELLS, *PULLEY)
_LONGEST_AXIS = 1.05  # of the parts of a direction, which noise may make longer than 1
_DRIFT = 0.02  # of the largest tension, by which a cell may read below 0


@dataclass(frozen=True, eq=False)
class Measurements:
    """One table of measurements, checked; `table["tip_tension"]` is a column.

    Attributes:
        name: of the file.
        columns: float64 in SI by name. "trial" holds the position of the row's label in `trial_labels`.
        rows: the line of each measurement in the file; 1, 2, ... without a file.
        trial_labels: as written, in the order of their first appearance.
        notes: the text above the header.
        simulated: whether name or notes say so.
        read_as: how the file was understood, and whether its holds were averaged, in lines that begin with its name;
            empty for a plain one.
        files: if the trials are files, their names, in the order of `trial_labels`, numbered where two are the same.
        unread: columns that held no reading in any row and are left out.
        left_out: how many rows held no reading and are left out; with `step` or `time` they stay, as steps of a path.
        markers: by name, the places in a table of markers.
    """

    name: str
    columns: Mapping[str, np.ndarray]
    rows: np.ndarray
    trial_labels: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    simulated: bool = False
    read_as: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()
    left_out: int = 0
    markers: Mapping[str, Marker] = field(default_factory=dict)

    def __post_init__(self):
        for values in self.columns.values():
            values.setflags(write=False)

    @classmethod
    def from_columns(
        cls, name: str = "measurements", notes: Sequence[str] = (), /, **columns: ArrayLike
    ) -> "Measurements":
        """A table from one sequence per column, in SI units.

        Args:
            name: of the table, for messages.
            notes: free text.
            columns: as in the table at the head of the module; `trial` holds any labels. NaN: a missing reading. `time`
                holds seconds, dates, durations, or text as in a file.

        Raises:
            InputError: names table, row, column, value and remedy.
        """
        with within(name):
            return _table(name, columns, notes=tuple(notes))

    def __getitem__(self, column: str) -> np.ndarray:
        return self.columns[column]

    def __contains__(self, column: object) -> bool:
        return column in self.columns

    def __len__(self) -> int:
        return len(self.rows)

    def __str__(self) -> str:
        return "\n".join([f"{self.name}: {len(self)} rows of {', '.join(self.columns)}", *self.read_as])

    @cached_property
    def set_columns(self) -> list[SetColumn]:
        """The columns that set the tendons, and the rows in which each does."""
        return set_columns(self.columns)

    @property
    def actuation(self) -> np.ndarray:
        """(rows, tendons), what set each tendon: a base tension, N, or a displacement, m."""
        found = np.zeros((len(self), 1 + max((own.tendon for own in self.set_columns), default=-1)))
        for own in self.set_columns:
            found[own.rows, own.tendon] = self[own.column][own.rows]
        return found

    @property
    def by_length(self) -> np.ndarray:
        """(rows, tendons), whether a displacement set each tendon."""
        found = np.zeros(self.actuation.shape, bool)
        for own in self.set_columns:
            found[:, own.tendon] |= own.rows & own.by_length
        return found

    def has(self, column: str) -> np.ndarray:
        """Which rows hold a number in a column; a reading may be missing.

        A displacement that sets its tendon in some rows is a reading in the others, and only these count.
        """
        return has_reading(self.columns, column)

    @property
    def ordered(self) -> bool:
        """Whether columns give the order in which the rows were measured."""
        return any(column in self for column in ORDER)

    @cached_property
    def order(self) -> np.ndarray:
        """The rows, 0, 1, ..., in the order in which they were measured, trial by trial.

        It is the order of the column `step`, and for rows of one step or without this column that of the file.
        """
        return order_of(self.columns)

    @cached_property
    def trial(self) -> np.ndarray:
        """(rows,), the number of the trial of each row, from 0; 0 without a column of trials."""
        return self.columns.get("trial", np.zeros(len(self))).astype(int)

    @cached_property
    def trials(self) -> list[np.ndarray]:
        """The rows of each trial, 0, 1, ..., in the order in which they were measured."""
        trial = self.trial[self.order]
        return [self.order[trial == number] for number in np.unique(trial)]

    def place(self, row: int) -> str:
        """The place of a row in words: "row 7", counted as in the file; with several files "row 7 of run_2.csv".

        Files with the same name are numbered: "row 7 of run.csv (2)".

        Args:
            row: 0, 1, ... as in the columns.
        """
        file = self.file_of(row)
        return f"row {self.rows[row]} of {file}" if file else f"row {self.rows[row]}"

    def file_of(self, row: int) -> str:
        """The file that a row is from, where trials are files; else ""."""
        return self.files[int(self.trial[row])] if self.files else ""

    @cached_property
    def checksum(self) -> str:
        """SHA-256 in hexadecimal digits of the column names and numbers, the same in any file and dialect."""
        digest = hashlib.sha256()
        for column, values in self.columns.items():
            digest.update(f"{column}\0{len(values)}\0".encode())
            digest.update((values + 0.0).astype("<f8").tobytes())  # + 0.0: no zero is negative
        return digest.hexdigest()


def read_measurements(path: str | os.PathLike[str], columns: Mapping[str, str] | None = None) -> Measurements:
    """The measurements in a file with the unit in the header; the module's text shows the columns.

    Args:
        path: CSV, or .xlsx with one sheet that holds a table.
        columns: by the head of a column in the file, what it is: {"Tbase_N": "base_tension [N]"}; "" to leave it out.

    Raises:
        InputError: names the file, row (line), column, value and remedy.
    """
    table, described = read_file(path, columns or {})
    if missing := [name for name in columns or {} if name not in described]:
        raise InputError(f"{path}: has no column {missing[0]!r}; use the heads of its header row")
    return table


def read_file(
    path: str | os.PathLike[str], columns: Mapping[str, str], markers: str | os.PathLike[str] | None = None
) -> tuple[Measurements, set[str]]:
    """The measurements in a file and its table of markers in another, and which of `columns` these have."""
    theirs = {} if markers is None else of_markers(columns)
    own = {name: meant for name, meant in columns.items() if name not in theirs or not meant.strip()}
    found = read_table(path, KIND, own)
    more = NO_MARKERS if markers is None else read_marker_table(markers, theirs, len(found.rows))
    with within(path):
        if twice := [column for column in more.columns if column in found.columns]:
            raise InputError(f"the column {twice[0]} is in {markers} as well; leave one out")
        _check_heads(found)
        said, every = (*found.read_as, *more.read_as), found.columns | more.columns
        table = _table(in_utf8(Path(path).name), every, notes=found.notes, rows=found.rows, read_as=said)
    return replace(table, markers=more.places), found.described | more.described


KIND = Kind(
    column_meant,
    column_dimension,
    "measurements",
    "base_tension [N], tip_tension [N]",
    labels=("trial",),
    gaps=lambda column: may_be_read(column) or column.startswith("base_tension"),
    words=lambda column: DIRECTIONS if column.startswith("direction") else {},
)


# --- from columns to a table ---------------------------------------------------------------------


def _table(
    name: str,
    columns: Mapping[str, ArrayLike],
    *,
    notes: tuple[str, ...] = (),
    rows: Sequence[int] | None = None,
    read_as: tuple[str, ...] = (),
) -> Measurements:
    """Check the columns and make a table of them."""
    _check_columns(columns)
    every = {column: _array(column, values) for column, values in columns.items()}
    lengths = {column: len(values) for column, values in every.items()}
    count, *others = set(lengths.values())
    if others:
        raise InputError(f"the columns differ in length ({lengths}); give one value per row")
    if count == 0:
        raise InputError("has no rows; add measurements")
    at = np.arange(1, count + 1) if rows is None else np.asarray(rows)
    numbers = {column: values for column, values in every.items() if column != "trial"}
    for column, values in numbers.items():
        _check_values(column, values, at, numbers)
    unread, kept, left_out = _gaps(numbers, at)
    arrays = {column: values[kept] for column, values in every.items() if column not in unread}
    labels: list[str] = arrays.get("trial", np.zeros(0)).tolist()
    codes = {label: code for code, label in enumerate(dict.fromkeys(labels))}
    if labels:
        arrays["trial"] = np.array([codes[label] for label in labels], float)
    simulated = any("simulated" in text.lower() for text in (name, *notes))
    check_order(arrays, at[kept])
    lines = tuple(f"{name}: {line}" for line in (*read_as, *left_out))
    return Measurements(
        *(name, arrays, at[kept], tuple(codes), notes, simulated),
        read_as=lines,
        unread=unread,
        left_out=int(np.sum(~kept)),
    )


def _gaps(columns: Mapping[str, np.ndarray], rows: np.ndarray) -> tuple[tuple[str, ...], np.ndarray, list[str]]:
    """Columns without any reading, the rows that are kept, and in words what is left out."""
    missing = {column: ~has_reading(columns, column) for column in columns if is_reading(column, columns)}
    unread = tuple(column for column, values in columns.items() if np.all(np.isnan(values)))
    if missing and np.all([*missing.values()]):
        raise InputError(f"no row holds a reading ({', '.join(missing)}); add the measurements")
    said = [f"{column} holds no number and is not used" for column in unread]
    read = [where for column, where in missing.items() if column not in unread]
    empty = np.all(read, axis=0) if read else np.zeros(len(rows), bool)
    if any(column in columns for column in ORDER):
        empty[:] = False  # such a row is a step of the path all the same
    if np.any(empty):
        first, count = rows[int(np.argmax(empty))], np.count_nonzero(empty)
        said.append(f"rows without a reading are left out: {count} of {len(rows)} rows (row {first} first)")
    return unread, ~empty, said


def _array(column: str, values: ArrayLike) -> np.ndarray:
    if column == "trial":
        return np.array([str(label) for label in np.asarray(values, object)])
    if column == "time":
        values = seconds_of(values)
    check_numbers(f"column {column}", values)
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"column {column}: not every value is a number; give numbers in SI units") from None
    if array.ndim != 1:
        raise InputError(f"column {column}: needs one list of numbers, got shape {array.shape}")
    return array


def _check_heads(found: Table) -> None:
    """Refuse a file that lacks a column, or has a misspelt one."""
    for one in found.unused:
        if meant := column_resembled(one.name):
            what = f"unknown column {short(one.name)}; did you mean {meant}?"
            ways = f"say so by {option(one.name, meant)}, or leave it out by {option(one.name, '')}"
            raise InputError(f"{what} Rename it, or {ways}", where=f"row {found.header}")
    with within(f"row {found.header}"):
        _check_columns(found.columns, found.unused)


def _check_columns(columns: Iterable[str], unused: Sequence[Heading] = ()) -> None:
    """Refuse unknown columns, and columns whose base tension is missing; a displacement does in place of it."""
    names = set(columns)
    for column in columns:
        column_dimension(column)
    others = sorted(names - {*PULLEY, "trial", *ORDER})
    if names & set(PULLEY) and others:
        raise InputError(f"the column {others[0]} does not belong to a pulley test; put it into a table of its own")
    pulled = {column.replace("displacement", "base_tension") for column in names if kind_of(column) == "displacement"}
    names |= pulled
    tendons = {column: kind for column in names if (kind := kind_of(column)) in PER_TENDON}
    needed = (set() if pulled else {"base_tension"}) | {
        column.replace(kind, "base_tension") for column, kind in tendons.items()
    }
    if missing := sorted((set(PULLEY) if names & set(PULLEY) else needed) - names):
        unit = preferred(column_dimension(missing[0]) or "dimensionless")[1]
        every = f" (a pulley test has {', '.join(PULLEY)})" if names & set(PULLEY) else ""
        remedy = how_to_say(f"{missing[0]} [{unit}]", unused) + every
        raise InputError(f"the column {missing[0]} is missing", remedy=remedy)


def _check_values(column: str, values: np.ndarray, rows: np.ndarray, table: Mapping[str, np.ndarray]) -> None:
    demand = partial(check_rows, column, values, rows)
    other = table.get(column.replace("base_tension", "displacement"), np.full(len(values), np.nan))
    may_miss = is_reading(column, table) or (column.startswith("base_tension") & np.isfinite(other))
    demand(np.isfinite(values) | (np.isnan(values) & may_miss), "must be finite", "give a number or remove the row")
    if column.startswith("direction"):
        demand(np.abs(values) == 1, "must be 1 or -1", "write 1 where the tendon slides in, -1 where it slides out")
    if column.startswith("tip_axis"):
        demand(~(np.abs(values) > _LONGEST_AXIS), "must be from -1 to 1", "give the parts of a direction of length 1")
    if column.startswith(_FROM_CELLS):
        tensions = [own for name, own in table.items() if name.startswith((*_FROM_CELLS, "weight"))]
        largest = max(np.nanmax(own, initial=0.0) for own in tensions)
        remedy = f"check its sign and the zero of the sensor (a drift of {100 * _DRIFT:g} % of the largest is taken)"
        demand(~(values < -_DRIFT * largest), "must be 0 or more", remedy)
    elif column.startswith(_NEVER_NEGATIVE):
        demand(values >= 0, "must be 0 or more", "check its sign and the zero of the sensor")


def check_rows(
    column: str, values: np.ndarray, rows: Sequence[int] | np.ndarray, good: np.ndarray, rule: str, remedy: str
) -> None:
    """Raise for the first row that is not good."""
    if not np.all(good):
        bad = int(np.argmin(good))
        dimension = column_dimension(column)
        got = written(values[bad], dimension) if dimension and np.isfinite(values[bad]) else f"{values[bad]:g}"
        raise InputError(f"row {rows[bad]}, column {column}: {rule}, got {got}; {remedy}")
