"""Tables with units in the header or in a row below it: a file becomes columns of SI numbers, and columns become CSV.

`table_source` lists the separators, decimal marks, encodings and spreadsheets that can be read.
"""

import csv
import io
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError, within
from ..units import to_si
from . import table_header
from .table_header import Heading, Kind, is_number, number, short
from .table_source import Row, Source, open_table
from .times import seconds_in

_UNITS_BELOW = 3  # rows below the header, in which units are looked for: there may be channels above them
# what instruments write where there is no number
_MISSING = ("", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--")


class Table(NamedTuple):
    """The content of a file."""

    columns: dict[str, np.ndarray]  # float64 in SI by name, text for labels
    header: int  # the line of the header in the file, or its number in the sheet
    rows: list[int]  # that of each row
    notes: tuple[str, ...]  # the text above the header
    read_as: tuple[str, ...]  # how the file was understood, if it is not plain
    unused: tuple[Heading, ...]  # columns that the reader does not know, without those that the caller leaves out
    described: set[str]  # names of columns that the caller described and the file has


def read_table(path: str | os.PathLike[str], kind: Kind, columns: Mapping[str, str] | None = None) -> Table:
    """The columns of a CSV or .xlsx file.

    `columns` describes columns by their heads in the file, such as "base_tension [N]"; "" leaves a column out.
    """
    with within(path):
        source, given = _opened(path, kind, columns or {})
        below = list(islice(source.rows, _UNITS_BELOW))
        headings = table_header.headings_of(source.header, source.row, kind, given)
        for i, (row, cells) in enumerate(below):
            if with_units := table_header.with_units_below(headings, row, cells, kind):
                source.read_as.append(f"row {row} holds the units")
                headings, below = with_units, below[i + 1 :]
                break
        table_header.check_headings(headings, source.row, kind)
        return _read(chain(below, source.rows), headings, kind, source, given)


def columns_in(path: str | os.PathLike[str], kind: Kind, columns: Mapping[str, str]) -> set[str]:
    """The known columns that the header of a file names; none if the file cannot be read."""
    try:
        source, given = _opened(path, kind, columns)
        return {column for cell in source.header if (column := table_header.heading_of(cell, kind, given).column)}
    except InputError:
        return set()


def _opened(path: str | os.PathLike[str], kind: Kind, columns: Mapping[str, str]) -> tuple[Source, dict[str, str]]:
    """The table in a file, and the descriptions of its columns by their heads, each on one line."""
    empty = f"is empty; write a header such as {kind.example!r} and rows below it"
    given = {" ".join(name.split()): text for name, text in columns.items()}

    def recognised(cells: Sequence[str]) -> int:
        found = (table_header.heading_of(cell, kind, given).column for cell in cells)
        return sum(column is not None and not _is_time(column, kind) for column in found)  # loggers write it above

    return open_table(path, recognised, empty), given


def table_csv(columns: Mapping[str, ArrayLike]) -> str:
    """The text of a table: heads with units, and a row for each place in the columns; NaN becomes an empty cell."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(columns)
    for row in zip(*(np.asarray(column, float) for column in columns.values()), strict=True):
        table.writerow("" if np.isnan(x) else f"{x:.9g}" for x in row)
    return text.getvalue()


# --- the rows ------------------------------------------------------------------------------------


def _read(
    rows: Iterator[Row], headings: Sequence[Heading], kind: Kind, source: Source, given: Mapping[str, str]
) -> Table:
    """The columns, each converted as a whole."""
    at, cells = _cells_by_column(rows, headings)
    if not at:
        raise InputError(
            f"has a header but no rows; add the {kind.content} below it (lines that begin with # are notes)"
        )
    texts = {heading: own for heading, own in zip(headings, cells, strict=True) if heading.column is not None}
    if source.decimal_commas:
        texts = _without_commas(texts, at, kind)
    columns = {str(heading.column): _values(heading, own, at, kind, source) for heading, own in texts.items()}
    unused = tuple(
        heading
        for i, (heading, own) in enumerate(zip(headings, cells, strict=True), 1)
        if heading.column is None and (heading.text != table_header.nameless(i) or any(text.strip() for text in own))
    )
    read_as = (*source.read_as, *_reading_notes(headings, unused))
    unknown = tuple(heading for heading in unused if not {heading.text, heading.name} & set(given))
    described = {heading.text if heading.text in given else heading.name for heading in headings} & set(given)
    return Table(columns, source.row, at, source.notes, read_as, unknown, described)


def _values(heading: Heading, texts: list[str], rows: list[int], kind: Kind, source: Source) -> np.ndarray:
    """A column of texts as labels, or as numbers in SI units."""
    column = str(heading.column)
    for row, text in zip(rows, texts, strict=True):
        if text.startswith("="):
            remedy = "open the file in a spreadsheet program and save it, or put the values in place of the formulas"
            raise InputError(f"row {row}, column {column}: the formula {short(text)} was never computed; {remedy}")
    if column in kind.labels:
        labels = [text.strip() for text in texts]
        if "" in labels:
            raise InputError(f"row {rows[labels.index('')]}, column {column}: the cell is empty; fill it")
        return np.array(labels)
    if _is_time(column, kind):
        values, said = seconds_in(column, rows, texts, heading.unit or "s")
        source.read_as.extend([said] if said else [])
        return values
    return _numbers(column, rows, texts, heading.unit, kind)


def _reading_notes(headings: Sequence[Heading], unused: Sequence[Heading]) -> Iterator[str]:
    """How the header was read, where that is not obvious: renamed and unused columns."""
    renamed = [h for h in headings if h.column is not None and h.name != h.column]
    if renamed:
        yield "read as: " + ", ".join(f"{h.text!r} {h.column}" + (f" [{h.unit}]" if h.unit else "") for h in renamed)
    if unused:
        yield f"columns that are not used: {', '.join(short(heading.text) for heading in unused)}"


def _is_time(column: str, kind: Kind) -> bool:
    return kind.dimension_of(column) == "time"


def _cells_by_column(rows: Iterable[Row], headings: Sequence[Heading]) -> tuple[list[int], list[list[str]]]:
    """The line number of every row, and the text of its cells by column."""
    width = len(headings)
    needed = max((i for i, heading in enumerate(headings, 1) if heading.column is not None), default=0)
    at, texts = [], []
    for row, cells in rows:
        while len(cells) > width and not cells[-1].strip():
            cells.pop()
        if needed <= len(cells) < width:
            cells = [*cells, *[""] * (width - len(cells))]
        if len(cells) != width:
            surplus = "with decimal commas separate the columns by semicolons, and name every column"
            remedy = "fill the row" if len(cells) < width else surplus
            raise InputError(f"row {row} has {len(cells)} cells, the header {width}; {remedy}")
        at.append(row)
        texts += cells
    return at, [texts[column::width] for column in range(width)]


def _without_commas(texts: Mapping[Heading, list[str]], rows: Sequence[int], kind: Kind) -> dict[Heading, list[str]]:
    """The texts with points in place of decimal commas; numbers with both marks are refused."""
    found, first = dict(texts), {}
    for heading, own in texts.items():
        if heading.column in kind.labels:
            continue
        if _is_time(str(heading.column), kind):
            found[heading] = [re.sub(r"(?<=\d),(?=\d)", ".", text) for text in own]
            continue
        found[heading] = [text.replace(",", ".") for text in own]
        for row, text in zip(rows, own, strict=True):
            for mark in filter(text.__contains__, ",."):
                first.setdefault(mark, f"row {row}, column {heading.column}: {short(text)}")
    if len(first) > 1:
        remedy = "write all numbers with the same decimal mark and without thousands separators"
        raise InputError(f"{first[',']} has a comma, but {first['.']} a point; {remedy}")
    return found


def _numbers(column: str, rows: Sequence[int], texts: Sequence[str], unit: str | None, kind: Kind) -> np.ndarray:
    """A column of texts as numbers in SI units."""
    words = kind.words(column)
    texts = [words.get(text.strip().lower(), text) for text in texts] if words else texts
    if kind.gaps(column):
        texts = ["nan" if text.strip().lower() in _MISSING else text for text in texts]
    try:
        values = np.fromiter(map(number, texts), float, len(texts))
    except ValueError:
        bad = next(i for i, text in enumerate(texts) if not is_number(text))
        text = texts[bad].strip()
        found = f"{short(text)} is not a number" if text else "the cell is empty"
        remedy = f"write {', '.join(words)}" if words else "give a number or remove the row"
        if re.fullmatch(r"[+-]?\d+([,.'’\s]\d+)+", text):
            remedy = "write it with a decimal point and without thousands separators"
        raise InputError(f"row {rows[bad]}, column {column}: {found}; {remedy}") from None
    good = np.isfinite(values) | (np.isnan(values) & kind.gaps(column))
    if not np.all(good):
        bad = int(np.argmin(good))
        rule = f"must be finite, got {values[bad]:g}; give a number or remove the row"
        raise InputError(f"row {rows[bad]}, column {column}: {rule}")
    dimension = kind.dimension_of(column)
    return values if dimension is None or unit is None else to_si(values, unit, dimension, column)
