"""Tables with the unit in the header, or in a row below it: a file to columns of SI numbers, and columns to CSV.

`table_source` tells which separators, decimal marks, encodings and spreadsheets are understood.
"""

import csv
import io
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, islice
from typing import Any, NamedTuple

import numpy as np

from .errors import InputError
from .table_header import (
    Heading,
    Kind,
    check_headings,
    heading_of,
    headings_of,
    is_number,
    number,
    short,
    units_below,
    with_units,
)
from .table_source import Row, Source, open_table
from .units import to_si

_BATCH = 50_000  # rows, so that the text of all cells need not be kept
_MISSING = (
    "",
    "nan",
    "na",
    "n/a",
    "#n/a",
    "null",
    "none",
    "-",
    "--",
)  # what instruments write where there is no number


class Table(NamedTuple):
    """What a file holds."""

    columns: dict[str, Any]  # float64 in SI by name, lists of text for labels
    rows: list[int]  # the line of each row in the file, or its number in the sheet
    notes: tuple[str, ...]  # the text above the header
    read_as: tuple[str, ...]  # what was done to read it, where the file is not plain
    unused: tuple[str, ...]  # columns that the reader does not know
    missing: tuple[str, ...]  # what was said of columns that are not there


def read_table(path: str | os.PathLike[str], kind: Kind, columns: Mapping[str, str] | None = None) -> Table:
    """The columns of a file.

    Args:
        path: CSV or .xlsx.
        kind: of table.
        columns: by the head of a column in the file, what it is, such as "base_tension [N]"; "" to leave it out.

    Raises:
        InputError: names the file, row (line), column, value and remedy.
    """
    empty = f"is empty; write a header such as {kind.example!r} and rows below it"
    given = {" ".join(name.split()): text for name, text in (columns or {}).items()}

    def recognised(cells: Sequence[str]) -> int:
        return sum(heading_of(cell, kind, given).column is not None for cell in cells)

    try:
        source = open_table(path, recognised, empty)
        headings = headings_of(source.header, source.row, kind, given)
        first = next(source.rows, None)
        below = () if first is None else (first,)
        if first is not None and (units := units_below(first[1], headings, kind)):
            headings = with_units(headings, units, first[0])
            source.read_as.append(f"row {first[0]} holds the units")
            below = ()
        check_headings(headings, source.row, kind)
        names = {text for heading in headings for text in (heading.text, heading.name)}
        return _read(chain(below, source.rows), headings, kind, source, tuple(set(given) - names))
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


# --- the rows ------------------------------------------------------------------------------------


def _read(
    rows: Iterator[Row], headings: Sequence[Heading], kind: Kind, source: Source, missing: tuple[str, ...]
) -> Table:
    """The columns, from rows that are read in batches."""
    used = {heading.column: (i, heading.unit) for i, heading in enumerate(headings) if heading.column is not None}
    columns: dict[str, list[Any]] = {column: [] for column in used}
    numbers, filled, marks = [], np.zeros(len(headings), bool), {}
    said: dict[str, str] = {}
    while batch := list(islice(rows, _BATCH)):
        at, texts_of_columns = _split(batch, headings)
        for i, heading in enumerate(headings):
            if heading.column is None and not filled[i]:
                filled[i] = any(text.strip() for text in texts_of_columns[i])
        for column, (i, unit) in used.items():
            texts = texts_of_columns[i]
            if column in kind.labels:
                columns[column] += _labels(column, at, texts)
                continue
            if words := kind.words(column):
                texts = _in_numbers(texts, words, said)
            if source.decimal_commas:
                texts = _with_points(column, at, texts, marks)
            columns[column].append(_numbers(column, at, texts, unit, kind))
        numbers += at
    if not numbers:
        raise InputError(
            f"has a header but no rows; add the {kind.content} below it (lines that begin with # are notes)"
        )
    joined = {column: parts if column in kind.labels else np.concatenate(parts) for column, parts in columns.items()}
    unused = tuple(
        heading.text or f"column {i} without a name"
        for i, heading in enumerate(headings, 1)
        if heading.column is None and (heading.text or filled[i - 1])
    )
    read_as = (*source.read_as, *_done(headings, unused, said))
    return Table(joined, numbers, source.notes, read_as, unused, missing)


def _done(headings: Sequence[Heading], unused: Sequence[str], said: Mapping[str, str]) -> Iterator[str]:
    """In words, what the header and the words of the rows were taken for."""
    renamed = [h for h in headings if h.column is not None and h.name != h.column]
    if renamed:
        yield "read as: " + ", ".join(f"{h.text!r} {h.column}" + (f" [{h.unit}]" if h.unit else "") for h in renamed)
    if unused:
        yield f"columns that are not used: {', '.join(map(short, unused))}"
    if said:
        yield "words read as numbers: " + ", ".join(f"{word!r} {number}" for word, number in said.items())


def _split(batch: Sequence[Row], headings: Sequence[Heading]) -> tuple[list[int], list[list[str]]]:
    """The line number of every row, and the text of its cells by column."""
    width = len(headings)
    needed = max((i for i, heading in enumerate(headings, 1) if heading.column is not None), default=0)
    rows, texts = [], []
    for row, cells in batch:
        while len(cells) > width and not cells[-1].strip():
            cells.pop()
        if needed <= len(cells) < width:
            cells = [*cells, *[""] * (width - len(cells))]
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


def _in_numbers(texts: Sequence[str], words: Mapping[str, str], said: dict[str, str]) -> list[str]:
    """The texts with numbers for words; `said` keeps which."""
    found = []
    for text in texts:
        number = words.get(text.strip().lower())
        if number is not None:
            said[text.strip()] = number
        found.append(text if number is None else number)
    return found


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
        texts = ["nan" if text.strip().lower() in _MISSING else text for text in texts]
    try:
        values = np.fromiter(map(number, texts), float, len(texts))
    except ValueError:
        bad = next(i for i, text in enumerate(texts) if not is_number(text))
        text = texts[bad].strip()
        found = f"{short(text)} is not a number" if text else "the cell is empty"
        remedy = f"write {', '.join(kind.words(column))}" if kind.words(column) else "give a number or remove the row"
        if re.fullmatch(r"[+-]?\d+([,.'’\s]\d+)+", text):
            remedy = "write it with a decimal point and without thousands separators"
        raise InputError(f"row {rows[bad]}, column {column}: {found}; {remedy}") from None
    dimension = kind.dimension_of(column)
    return values if dimension is None or unit is None else to_si(values, unit, dimension, column)
