"""Tables of measurements: CSV with the unit in the header, SI in memory.

    # simulated, seed 1           lines with # before the header are notes
    trial, base_tension [N], tip_tension [N], tip_angle [deg], direction
    A, 5, 4.79, 3.1, 1

| column | unit of | meaning |
| --- | --- | --- |
| base_tension, base_tension_2, ... | force | pull at the base on tendon 1, 2, ... |
| tip_tension, tip_tension_2, ... | force | the same tendon's tension at its tip end |
| tip_angle | angle | phi(L) |
| tip_x, tip_y | length | u(L) in the frame at the base |
| tip_force_x, tip_force_y | force | known dead load on the tip |
| direction, direction_2, ... | none | +1 where the tendon slides in (pulled), -1 out; without it: as `solve` finds it |
| wrap_angle | angle | pulley test: angle of contact |
| weight, pulling_tension | force | pulley test: hanging weight, and load cell while the weight is raised |
| trial | none | any label |

A pulley test holds its three columns and no other but trial;
pulling_tension = weight exp(mu wrap_angle), Liu et al. (2020), eq. (5).
`csv_table` tells which separators, decimal marks and encodings are understood.
"""

import hashlib
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from .csv_table import Kind, read_table, short
from .errors import InputError
from .readings import READINGS, kind_of
from .table_warnings import warnings_of
from .units import Dimension, written

_DIMENSIONS: dict[str, Dimension | None] = {
    "trial": None,
    "direction": None,
    "base_tension": "force",
    **{name: kind.dimension for name, kind in READINGS.items()},
    "tip_force_x": "force",
    "tip_force_y": "force",
    "wrap_angle": "angle",
    "weight": "force",
    "pulling_tension": "force",
}
_PULLEY = ("wrap_angle", "weight", "pulling_tension")
_PER_TENDON = ("base_tension", "direction", *(name for name, kind in READINGS.items() if kind.per_tendon))
_NEVER_NEGATIVE = ("base_tension", "tip_tension", *_PULLEY)


@dataclass(frozen=True, eq=False)
class Measurements:
    """One table of measurements, checked; `table["tip_tension"]` is a column.

    Attributes:
        name: of the file.
        columns: float64 in SI by name. "trial" holds the position of the row's label in `trial_labels`.
        rows: of each measurement, its line in the file, or 1, 2, ... where there is none.
        trial_labels: as written, in the order of their first appearance.
        notes: the text above the header.
        simulated: whether name or notes say so.
        spread: of means by `average_holds`, by column, the standard deviation of the rows behind each; else None.
    """

    name: str
    columns: Mapping[str, np.ndarray]
    rows: np.ndarray
    trial_labels: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    simulated: bool = False
    spread: Mapping[str, np.ndarray] | None = None

    @classmethod
    def from_columns(cls, name: str = "measurements", *, notes: Sequence[str] = (), **columns: Any) -> "Measurements":
        """A table from one sequence per column, in SI units.

        Args:
            name: of the table, for messages.
            notes: free text.
            columns: as in the table at the head of the module; `trial` holds any labels.

        Raises:
            InputError: names table, row, column, value and remedy.
        """
        try:
            return _table(name, tuple(notes), None, columns)
        except InputError as error:
            raise InputError(f"{name}: {error}") from None

    def __getitem__(self, column: str) -> np.ndarray:
        return self.columns[column]

    def __contains__(self, column: object) -> bool:
        return column in self.columns

    def __len__(self) -> int:
        return len(self.rows)

    def __str__(self) -> str:
        return f"{self.name}: {len(self)} rows of {', '.join(self.columns)}"

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What deserves a look though it can be used, for the report."""
        return warnings_of(self)

    @cached_property
    def checksum(self) -> str:
        """SHA-256 in hexadecimal digits of the column names and numbers, whatever the file and its dialect."""
        digest = hashlib.sha256()
        for column, values in self.columns.items():
            digest.update(f"{column}\0{len(values)}\0".encode())
            digest.update((values + 0.0).astype("<f8").tobytes())  # + 0.0: no zero is negative
        return digest.hexdigest()


def read_measurements(path: str | os.PathLike[str]) -> Measurements:
    """The measurements in a CSV file with the unit in the header; the module's text shows the columns.

    Raises:
        InputError: names the file, row (line), column, value and remedy.
    """
    found = read_table(path, _KIND)
    try:
        return _table(Path(path).name, found.notes, found.rows, found.columns)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def repeated_tables(tables: Sequence[Measurements]) -> list[str]:
    """A warning for each table of several that holds the same numbers as an earlier one."""
    first: dict[str, tuple[int, str]] = {}
    found = []
    for number, table in enumerate(tables, 1):
        earlier, name = first.setdefault(table.checksum, (number, table.name))
        if earlier != number:
            found.append(
                f"{table.name}: table {number} holds the same numbers as table {earlier} ({name}), which thus "
                "count twice and make standard errors too small; leave one out"
            )
    return found


def dimension_of(column: str) -> Dimension | None:
    """What a column measures; None for labels and signs.

    Raises:
        InputError: for a column that is none.
    """
    stem, _, tendon = column.rpartition("_")
    if stem in _PER_TENDON and re.fullmatch("[2-9]|[1-9][0-9]+", tendon):
        column = stem
    if column not in _DIMENSIONS:
        close = get_close_matches(column.lower(), _DIMENSIONS, 1)
        remedy = f"did you mean {close[0]}? Known are" if close else "known are"
        known = ", ".join([*_DIMENSIONS, *(f"{stem}_2" for stem in _PER_TENDON)])
        raise InputError(f"unknown column {short(column)}; {remedy} {known}, ...")
    return _DIMENSIONS[column]


_KIND = Kind(dimension_of, "measurements", "base_tension [N], tip_tension [N]", labels=("trial",))


# --- from columns to a table ---------------------------------------------------------------------


def _table(name: str, notes: tuple[str, ...], rows: Any, columns: Mapping[str, Any]) -> Measurements:
    """Check the columns and put them together."""
    _check_columns(columns)
    labels = [str(label) for label in columns.get("trial", ())]
    codes = {label: code for code, label in enumerate(dict.fromkeys(labels))}
    arrays = {
        column: np.array([codes[label] for label in labels], float) if column == "trial" else _array(column, values)
        for column, values in columns.items()
    }
    lengths = {column: len(values) for column, values in arrays.items()}
    if len(set(lengths.values())) > 1:
        raise InputError(f"the columns differ in length ({lengths}); give one value per row")
    count = min(lengths.values())
    if count == 0:
        raise InputError("has no rows; add measurements")
    rows = np.arange(1, count + 1) if rows is None else np.asarray(rows)
    for column, values in arrays.items():
        _check_values(column, values, rows)
        values.setflags(write=False)
    simulated = any("simulated" in text.lower() for text in (name, *notes))
    return Measurements(name, arrays, rows, tuple(codes), notes, simulated)


def _array(column: str, values: Any) -> np.ndarray:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"column {column}: not every value is a number; give numbers in SI units") from None
    if array.ndim != 1:
        raise InputError(f"column {column}: needs one list of numbers, got shape {array.shape}")
    return array


def _check_columns(columns: Iterable[str]) -> None:
    """Every column known, and no column without its companion."""
    names = set(columns)
    for column in columns:
        dimension_of(column)
    if names & set(_PULLEY):
        needed = set(_PULLEY)
        if other := sorted(names - needed - {"trial"}):
            raise InputError(f"the column {other[0]} does not belong to a pulley test; put it into a table of its own")
    else:
        tendons = {column: kind for column in names if (kind := kind_of(column)) in _PER_TENDON}
        needed = {"base_tension"} | {column.replace(kind, "base_tension") for column, kind in tendons.items()}
    if missing := sorted(needed - names):
        raise InputError(f"the column {missing[0]} is missing; add it (a pulley test has {', '.join(_PULLEY)})")


def _check_values(column: str, values: np.ndarray, rows: np.ndarray) -> None:
    demand = partial(_demand, column, values, rows)
    demand(np.isfinite(values), "must be finite", "give a number or remove the row")
    if column.startswith("direction"):
        demand(np.abs(values) == 1, "must be 1 or -1", "write 1 where the tendon slides in, -1 where it slides out")
    if column.startswith(_NEVER_NEGATIVE):
        demand(values >= 0, "must be 0 or more", "check its sign and the zero of the sensor")


def _demand(column: str, values: np.ndarray, rows: np.ndarray, good: np.ndarray, rule: str, remedy: str) -> None:
    """Raise for the first row that is not good."""
    if not np.all(good):
        bad = int(np.argmin(good))
        dimension = dimension_of(column)
        got = written(values[bad], dimension) if dimension and np.isfinite(values[bad]) else f"{values[bad]:g}"
        raise InputError(f"row {rows[bad]}, column {column}: {rule}, got {got}; {remedy}")
