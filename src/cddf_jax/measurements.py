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
| direction | none | +1 where the tendon slides in (pulled), -1 where it slides out |
| wrap_angle | angle | pulley test: angle of contact |
| weight, pulling_tension | force | pulley test: hanging weight, and load cell while the weight is raised |
| trial | none | any label |

A pulley test holds its three columns and no other but trial;
pulling_tension = weight exp(mu wrap_angle), Liu et al. (2020), eq. (5).
Separators are commas, or semicolons, and then decimal commas are understood too.
"""

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from .errors import InputError
from .units import Dimension, to_si, written

_DIMENSIONS: dict[str, Dimension | None] = {
    "trial": None,
    "direction": None,
    "base_tension": "force",
    "tip_tension": "force",
    "tip_angle": "angle",
    "tip_x": "length",
    "tip_y": "length",
    "tip_force_x": "force",
    "tip_force_y": "force",
    "wrap_angle": "angle",
    "weight": "force",
    "pulling_tension": "force",
}
_PULLEY = ("wrap_angle", "weight", "pulling_tension")
_PER_TENDON = ("base_tension", "tip_tension")
_NEVER_NEGATIVE = (*_PER_TENDON, *_PULLEY)
_HEADER = re.compile(r"([^\[\]]+?)\s*(?:\[([^\[\]]*)\])?")
_TIP_ABOVE_BASE = 1.05  # a tip cell may read this much of the base cell before the report mentions it


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
    """

    name: str
    columns: Mapping[str, np.ndarray]
    rows: np.ndarray
    trial_labels: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    simulated: bool = False

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

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What deserves a look though it can be used, for the report."""
        if len(self) == 1:
            return ("there is one row only, from which no scatter can be estimated",)
        return tuple(filter(None, (_repeated_rows(self), _tip_above_base(self))))


def read_measurements(path: str | os.PathLike[str]) -> Measurements:
    """The measurements in a CSV file with the unit in the header; the module's text shows the columns.

    Raises:
        InputError: names the file, row (line), column, value and remedy.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not UTF-8 text; save it as CSV UTF-8") from None
    try:
        return _parse(Path(path).name, text)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


# --- from text to columns ------------------------------------------------------------------------


def _parse(name: str, text: str) -> Measurements:
    lines = text.split("\n")
    start = next((i for i, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), None)
    if start is None:
        raise InputError("is empty; write a header such as 'base_tension [N], tip_tension [N]' and rows below it")
    notes = tuple(line.strip().lstrip("#").strip() for line in lines[:start] if line.strip())
    lines[start:] = "\n".join(lines[start:]).replace('"', "").split("\n")
    separator = ";" if ";" in lines[start] else ","
    header = _read_header(lines[start].split(separator), start + 1)
    rows, columns_of_text = _split(lines, start + 1, separator, len(header))
    columns = {
        column: _labels(column, rows, texts) if column == "trial" else _numbers(column, rows, texts, unit, separator)
        for (column, unit), texts in zip(header.items(), columns_of_text, strict=True)
    }
    return _table(name, notes, rows, columns)


def _read_header(cells: Sequence[str], row: int) -> dict[str, str | None]:
    """The unit of each column by name; None for a column without."""
    header: dict[str, str | None] = {}
    for number, cell in enumerate(cells, 1):
        match = _HEADER.fullmatch(cell.strip())
        if match is None:
            raise InputError(f"row {row}, column {number}: {cell.strip()!r} is no column; write 'name [unit]'")
        column, unit = match.groups()
        dimension, unit = _dimension(column), unit and unit.strip()
        if column in header:
            raise InputError(f"row {row}: the column {column} appears twice; remove one")
        if dimension is None and unit is not None:
            raise InputError(f"row {row}: the column {column} has no unit, got [{unit}]; leave it out")
        if dimension is not None:
            to_si(np.zeros(0), unit or "", dimension, f"row {row}: the column {column}")
        header[column] = unit
    return header


def _dimension(column: str) -> Dimension | None:
    """What a column measures; None for labels and signs."""
    stem, _, tendon = column.rpartition("_")
    if stem in _PER_TENDON and re.fullmatch("[2-9]|[1-9][0-9]+", tendon):
        column = stem
    if column not in _DIMENSIONS:
        close = get_close_matches(column.lower(), _DIMENSIONS, 1)
        suggestion = f"did you mean {close[0]}? " if close else ""
        known = ", ".join([*_DIMENSIONS, *(f"{stem}_2" for stem in _PER_TENDON)])
        raise InputError(f"unknown column {column!r}; {suggestion}Known are {known}, ...")
    return _DIMENSIONS[column]


def _split(lines: Sequence[str], start: int, separator: str, width: int) -> tuple[np.ndarray, list[list[str]]]:
    """The line number of every row that is not blank, and the text of its cells by column."""
    blank = f" \t{separator}"
    rows = [number for number, line in enumerate(lines[start:], start + 1) if line.strip(blank)]
    if not rows:
        raise InputError("has a header but no rows; add the measurements below it")
    filled = [lines[row - 1] for row in rows]
    for row, line in zip(rows, filled, strict=True):
        found = line.count(separator) + 1
        if found != width:
            remedy = "fill the row" if found < width else "with decimal commas separate the columns by semicolons"
            raise InputError(f"row {row} has {found} cells, the header {width}; {remedy}")
    cells = separator.join(filled).split(separator)
    return np.asarray(rows), [cells[column::width] for column in range(width)]


def _labels(column: str, rows: np.ndarray, texts: Sequence[str]) -> list[str]:
    labels = [text.strip() for text in texts]
    if "" in labels:
        raise InputError(f"row {rows[labels.index('')]}, column {column}: the cell is empty; fill it")
    return labels


def _numbers(column: str, rows: np.ndarray, texts: Sequence[str], unit: str | None, separator: str) -> np.ndarray:
    """A column of text as SI numbers."""
    if separator == ";":
        texts = [text.replace(",", ".") for text in texts]
    try:
        values = np.fromiter(map(_number, texts), float, len(texts))
    except ValueError:
        bad = next(i for i, text in enumerate(texts) if not _is_number(text))
        found = f"{texts[bad].strip()!r} is not a number" if texts[bad].strip() else "the cell is empty"
        raise InputError(f"row {rows[bad]}, column {column}: {found}; give a number or remove the row") from None
    dimension = _dimension(column)
    return values if dimension is None or unit is None else to_si(values, unit, dimension, column)


def _number(text: str) -> float:
    """The number that a text is; unlike Python, no reader takes 1_000 for one."""
    return float(text if "_" not in text else "")


def _is_number(text: str) -> bool:
    try:
        _number(text)
    except ValueError:
        return False
    return True


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
        _dimension(column)
    if names & set(_PULLEY):
        needed = set(_PULLEY)
        if other := sorted(names - needed - {"trial"}):
            raise InputError(f"the column {other[0]} does not belong to a pulley test; put it into a table of its own")
    else:
        tips = {column for column in names if column.startswith("tip_tension")}
        needed = {"base_tension"} | {column.replace("tip", "base") for column in tips}
    if missing := sorted(needed - names):
        raise InputError(f"the column {missing[0]} is missing; add it (a pulley test has {', '.join(_PULLEY)})")


def _check_values(column: str, values: np.ndarray, rows: np.ndarray) -> None:
    demand = partial(_demand, column, values, rows)
    demand(np.isfinite(values), "must be finite", "give a number or remove the row")
    if column == "direction":
        demand(np.abs(values) == 1, "must be 1 or -1", "write 1 where the tendon slides in, -1 where it slides out")
    if column.startswith(_NEVER_NEGATIVE):
        demand(values >= 0, "must be 0 or more", "check its sign and the zero of the sensor")


def _demand(column: str, values: np.ndarray, rows: np.ndarray, good: np.ndarray, rule: str, remedy: str) -> None:
    """Raise for the first row that is not good."""
    if not np.all(good):
        bad = int(np.argmin(good))
        dimension = _dimension(column)
        got = written(values[bad], dimension) if dimension and np.isfinite(values[bad]) else f"{values[bad]:g}"
        raise InputError(f"row {rows[bad]}, column {column}: {rule}, got {got}; {remedy}")


# --- what deserves a look ------------------------------------------------------------------------


def _repeated_rows(table: Measurements) -> str:
    measured = [values for column, values in table.columns.items() if column != "trial"]
    if all(np.all(values == values[0]) for values in measured):
        return f"all {len(table)} rows are equal, so that nothing can be told from their differences"
    columns = list(table.columns.values())
    order = np.lexsort(columns)  # stable: of equal rows the earlier stays first
    same = np.all([values[order][1:] == values[order][:-1] for values in columns], axis=0)
    if not np.any(same):
        return ""
    earlier, later = order[:-1][same], order[1:][same]
    first = int(np.argmin(later))
    return (
        f"rows that repeat an earlier one to the last digit: {later.size} of {len(table)} "
        f"(row {table.rows[later[first]]} is row {table.rows[earlier[first]]} again); were they copied?"
    )


def _tip_above_base(table: Measurements) -> str:
    if "tip_tension" not in table:
        return ""
    base, tip = table["base_tension"], table["tip_tension"]
    sliding_in = table.columns.get("direction", np.ones(len(table))) > 0
    above = sliding_in & (tip > _TIP_ABOVE_BASE * base)
    if not np.any(above):
        return ""
    first = int(np.argmax(above))
    return (
        f"rows with tip_tension more than 5 % above base_tension: {np.count_nonzero(above)} of {len(table)} "
        f"(row {table.rows[first]}: {tip[first]:.6g} N over {base[first]:.6g} N); are the cells swapped or off zero?"
    )
