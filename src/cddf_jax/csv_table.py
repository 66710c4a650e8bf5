"""CSV tables with the unit in the header: text to columns of SI numbers, and columns to text.

Separators are commas, or semicolons or tabs, and then decimal commas are understood too. Blank lines, lines
with # between the rows and separators at the end of a line are passed over. UTF-8, or UTF-16 with its mark.
"""

import codecs
import csv
import io
import os
import re
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from .errors import InputError
from .units import Dimension, to_si

_HEADER = re.compile(r"([^\[\]]+?)\s*(?:\[([^\[\]]*)\])?")
_BLANK = ' \t\r\n,;"'
_BATCH = 50_000  # rows


class Table(NamedTuple):
    """What a file holds."""

    columns: dict[str, Any]  # float64 in SI by name, lists of text for labels
    rows: list[int]  # the line of each row in the file
    notes: tuple[str, ...]  # the text above the header


class Kind(NamedTuple):
    """What the columns of a kind of table are."""

    dimension_of: Callable[[str], Dimension | None]  # of a column, None without; raises InputError for an unknown one
    content: str  # of a row, in the plural
    example: str  # of a header
    labels: Collection[str] = ()  # columns of text
    gaps: Callable[[str], bool] = lambda column: False  # whether cells of a column may be empty, which gives NaN


def read_table(path: str | os.PathLike[str], kind: Kind) -> Table:
    """The columns of a CSV file.

    Raises:
        InputError: names the file, row (line), column, value and remedy.
    """
    try:
        with open(path, "rb") as file, io.TextIOWrapper(file, _encoding(file.peek(2))) as text:
            return _parse(text, kind)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not text in UTF-8 or UTF-16; save it as CSV UTF-8") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def table_csv(columns: Mapping[str, Any]) -> str:
    """The text of a table: heads with units, and a row for each place in the columns; NaN becomes an empty cell."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(columns)
    for row in zip(*(np.asarray(column, float) for column in columns.values()), strict=True):
        table.writerow("" if np.isnan(x) else f"{x:.9g}" for x in row)
    return text.getvalue()


def _encoding(start: bytes) -> str:
    """UTF-16 where a byte-order mark says so, as in "Unicode text" of spreadsheets."""
    return "utf-16" if start[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8-sig"


def _parse(text: Iterable[str], kind: Kind) -> Table:
    """A table from the lines of a file, read in batches so that their text need not be kept."""
    lines = enumerate(text, 1)
    notes, row, line = [], 0, ""
    while not line.strip(_BLANK) or _is_comment(line):
        notes += [line.strip(_BLANK).lstrip("#").strip()] if line.strip(_BLANK) else []
        row, line = next(lines, (0, None))
        if line is None:
            raise InputError(f"is empty; write a header such as {kind.example!r} and rows below it")
    if "\0" in line:
        raise InputError("is not text in UTF-8 or UTF-16; save it as CSV UTF-8")
    separator = next((mark for mark in ";,\t" if mark in line), ",")
    header = _read_header(_cells(row, line, separator), row, kind)
    columns: dict[str, list[Any]] = {column: [] for column in header}
    rows, marks = [], {}
    while batch := list(islice(lines, _BATCH)):
        filled, texts_of_columns = _split(batch, separator, len(header))
        for (column, unit), texts in zip(header.items(), texts_of_columns, strict=True):
            if column in kind.labels:
                columns[column] += _labels(column, filled, texts)
                continue
            if separator != ",":
                texts = _with_points(column, filled, texts, marks)
            columns[column].append(_numbers(column, filled, texts, unit, kind))
        rows += filled
    if not rows:
        raise InputError(
            f"has a header but no rows; add the {kind.content} below it (lines that begin with # are notes)"
        )
    joined = {column: parts if column in kind.labels else np.concatenate(parts) for column, parts in columns.items()}
    return Table(joined, rows, tuple(notes))


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


def _read_header(cells: list[str], row: int, kind: Kind) -> dict[str, str | None]:
    """The unit of each column by name; None for a column without."""
    header: dict[str, str | None] = {}
    while len(cells) > 1 and not cells[-1].strip():  # spreadsheets leave separators at the end
        cells.pop()
    for number, cell in enumerate(cells, 1):
        match = _HEADER.fullmatch(cell.strip()) if len(cell) < 200 else None
        if match is None:
            remedy = "write 'name [unit]', and commas, semicolons or tabs between columns"
            raise InputError(f"row {row}, column {number}: {short(cell)} is no column; {remedy}")
        column, unit = match.groups()
        dimension, unit = kind.dimension_of(column), unit and unit.strip()
        if column in header:
            raise InputError(f"row {row}: the column {column} appears twice; remove one")
        if dimension is None and unit is not None:
            raise InputError(f"row {row}: the column {column} has no unit, got [{unit}]; leave it out")
        if dimension is not None:
            to_si(np.zeros(0), unit or "", dimension, f"row {row}: the column {column}")
        header[column] = unit
    return header


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


def _labels(column: str, rows: Sequence[int], texts: Sequence[str]) -> list[str]:
    labels = [sys.intern(text.strip()) for text in texts]
    if "" in labels:
        raise InputError(f"row {rows[labels.index('')]}, column {column}: the cell is empty; fill it")
    return labels


def _with_points(column: str, rows: Sequence[int], texts: Sequence[str], marks: dict[str, str]) -> Sequence[str]:
    """The texts with points for decimal commas; `marks` holds where the file first has either."""
    for mark in {",", "."} - set(marks):
        at = next((i for i, text in enumerate(texts) if mark in text), None)
        if at is not None:
            marks[mark] = f"row {rows[at]}, column {column}: {short(texts[at])}"
    if len(marks) == 2:
        remedy = "write all numbers with the same decimal mark and without thousands separators"
        raise InputError(f"{marks[',']} has a comma, but {marks['.']} a point; {remedy}")
    return [text.replace(",", ".") for text in texts] if "," in marks else texts


def _numbers(column: str, rows: Sequence[int], texts: Sequence[str], unit: str | None, kind: Kind) -> np.ndarray:
    """A column of text as SI numbers."""
    if kind.gaps(column):
        texts = [text if text.strip() else "nan" for text in texts]
    try:
        values = np.fromiter(map(_number, texts), float, len(texts))
    except ValueError:
        bad = next(i for i, text in enumerate(texts) if not _is_number(text))
        text = texts[bad].strip()
        found = f"{short(text)} is not a number" if text else "the cell is empty"
        remedy = "give a number or remove the row"
        if re.fullmatch(r"[+-]?\d+([,.'’\s]\d+)+", text):
            remedy = "write it with a decimal point and without thousands separators"
        raise InputError(f"row {rows[bad]}, column {column}: {found}; {remedy}") from None
    dimension = kind.dimension_of(column)
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


def short(text: str) -> str:
    """A piece of a file for a message: quoted, on one line, not long."""
    text = text.strip()
    return repr(text if len(text) <= 60 else text[:57] + "...")
