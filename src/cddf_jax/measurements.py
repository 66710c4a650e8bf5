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
| direction, direction_2, ... | none | +1 where the tendon slides in (pulled), -1 out; tendons without: as tendon 1 |
| wrap_angle | angle | pulley test: angle of contact |
| weight, pulling_tension | force | pulley test: hanging weight, and load cell while the weight is raised |
| trial | none | any label |

A pulley test holds its three columns and no other but trial;
pulling_tension = weight exp(mu wrap_angle), Liu et al. (2020), eq. (5).
Separators are commas, or semicolons or tabs, and then decimal commas are understood too. Blank lines, lines
with # between the rows and separators at the end of a line are passed over. UTF-8, or UTF-16 with its mark.
"""

import codecs
import csv
import hashlib
import io
import os
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from .errors import InputError
from .table_warnings import warnings_of
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
_PER_TENDON = ("base_tension", "tip_tension", "direction")
_NEVER_NEGATIVE = ("base_tension", "tip_tension", *_PULLEY)
_HEADER = re.compile(r"([^\[\]]+?)\s*(?:\[([^\[\]]*)\])?")
_BLANK = ' \t\r\n,;"'
_BATCH = 50_000  # rows


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
    try:
        with open(path, "rb") as file, io.TextIOWrapper(file, _encoding(file.peek(2))) as text:
            return _parse(Path(path).name, text)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not text in UTF-8 or UTF-16; save it as CSV UTF-8") from None
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


# --- from text to columns ------------------------------------------------------------------------


def _encoding(start: bytes) -> str:
    """UTF-16 where a byte-order mark says so, as in "Unicode text" of spreadsheets."""
    return "utf-16" if start[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8-sig"


def _parse(name: str, text: Iterable[str]) -> Measurements:
    """A table from the lines of a file, read in batches so that their text need not be kept."""
    lines = enumerate(text, 1)
    notes, row, line = [], 0, ""
    while not line.strip(_BLANK) or _is_comment(line):
        notes += [line.strip(_BLANK).lstrip("#").strip()] if line.strip(_BLANK) else []
        row, line = next(lines, (0, None))
        if line is None:
            raise InputError("is empty; write a header such as 'base_tension [N], tip_tension [N]' and rows below it")
    if "\0" in line:
        raise InputError("is not text in UTF-8 or UTF-16; save it as CSV UTF-8")
    separator = next((mark for mark in ";,\t" if mark in line), ",")
    header = _read_header(_cells(row, line, separator), row)
    columns: dict[str, list[Any]] = {column: [] for column in header}
    rows, marks = [], {}
    while batch := list(islice(lines, _BATCH)):
        filled, texts_of_columns = _split(batch, separator, len(header))
        for (column, unit), texts in zip(header.items(), texts_of_columns, strict=True):
            if column == "trial":
                columns[column] += _labels(filled, texts)
                continue
            if separator != ",":
                texts = _with_points(column, filled, texts, marks)
            columns[column].append(_numbers(column, filled, texts, unit))
        rows += filled
    if not rows:
        raise InputError("has a header but no rows; add the measurements below it (lines that begin with # are notes)")
    joined = {column: parts if column == "trial" else np.concatenate(parts) for column, parts in columns.items()}
    return _table(name, tuple(notes), rows, joined)


def _is_comment(line: str) -> bool:
    return line.lstrip(' \t"').startswith("#")


def _cells(row: int, line: str, separator: str) -> list[str]:
    """The cells of a line; a separator within quotation marks separates nothing."""
    if '"' not in line:
        return line.rstrip("\n").split(separator)
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True))
    except csv.Error as error:
        raise InputError(f"row {row}: quotation marks are astray ({error}); take them out") from None


def _read_header(cells: list[str], row: int) -> dict[str, str | None]:
    """The unit of each column by name; None for a column without."""
    header: dict[str, str | None] = {}
    while len(cells) > 1 and not cells[-1].strip():  # spreadsheets leave separators at the end
        cells.pop()
    for number, cell in enumerate(cells, 1):
        match = _HEADER.fullmatch(cell.strip()) if len(cell) < 200 else None
        if match is None:
            remedy = "write 'name [unit]', and commas, semicolons or tabs between columns"
            raise InputError(f"row {row}, column {number}: {_short(cell)} is no column; {remedy}")
        column, unit = match.groups()
        dimension, unit = dimension_of(column), unit and unit.strip()
        if column in header:
            raise InputError(f"row {row}: the column {column} appears twice; remove one")
        if dimension is None and unit is not None:
            raise InputError(f"row {row}: the column {column} has no unit, got [{unit}]; leave it out")
        if dimension is not None:
            to_si(np.zeros(0), unit or "", dimension, f"row {row}: the column {column}")
        header[column] = unit
    return header


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
        raise InputError(f"unknown column {_short(column)}; {remedy} {known}, ...")
    return _DIMENSIONS[column]


def _split(lines: Sequence[tuple[int, str]], separator: str, width: int) -> tuple[list[int], list[list[str]]]:
    """The line number of every row that is neither blank nor a note, and the text of its cells by column."""
    rows, texts = [], []
    for row, line in lines:
        if not line.strip(_BLANK) or ("#" in line and _is_comment(line)):
            continue
        cells = _cells(row, line, separator)
        while len(cells) > width and not cells[-1].strip():
            cells.pop()
        if len(cells) != width:
            surplus = "with decimal commas separate the columns by semicolons, and name every column"
            remedy = "fill the row" if len(cells) < width else surplus
            raise InputError(f"row {row} has {len(cells)} cells, the header {width}; {remedy}")
        rows.append(row)
        texts += cells
    return rows, [texts[column::width] for column in range(width)]


def _labels(rows: Sequence[int], texts: Sequence[str]) -> list[str]:
    labels = [sys.intern(text.strip()) for text in texts]
    if "" in labels:
        raise InputError(f"row {rows[labels.index('')]}, column trial: the cell is empty; fill it")
    return labels


def _with_points(column: str, rows: Sequence[int], texts: Sequence[str], marks: dict[str, str]) -> Sequence[str]:
    """The texts with points for decimal commas; `marks` holds where the file first has either."""
    for mark in {",", "."} - set(marks):
        at = next((i for i, text in enumerate(texts) if mark in text), None)
        if at is not None:
            marks[mark] = f"row {rows[at]}, column {column}: {_short(texts[at])}"
    if len(marks) == 2:
        remedy = "write all numbers with the same decimal mark and without thousands separators"
        raise InputError(f"{marks[',']} has a comma, but {marks['.']} a point; {remedy}")
    return [text.replace(",", ".") for text in texts] if "," in marks else texts


def _numbers(column: str, rows: Sequence[int], texts: Sequence[str], unit: str | None) -> np.ndarray:
    """A column of text as SI numbers."""
    try:
        values = np.fromiter(map(_number, texts), float, len(texts))
    except ValueError:
        bad = next(i for i, text in enumerate(texts) if not _is_number(text))
        text = texts[bad].strip()
        found = f"{_short(text)} is not a number" if text else "the cell is empty"
        remedy = "give a number or remove the row"
        if re.fullmatch(r"[+-]?\d+([,.'’\s]\d+)+", text):
            remedy = "write it with a decimal point and without thousands separators"
        raise InputError(f"row {rows[bad]}, column {column}: {found}; {remedy}") from None
    dimension = dimension_of(column)
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


def _short(text: str) -> str:
    """A piece of a file for a message: quoted, on one line, not long."""
    text = text.strip()
    return repr(text if len(text) <= 60 else text[:57] + "...")


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
        tips = {column for column in names if column.startswith("tip_tension")}
        needed = {"base_tension"} | {column.replace("tip", "base") for column in tips}
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
