"""Rows that a fit leaves out: those that the user names.

A row is named by its number in the file, as in messages. Only its readings are left out: with a history the row stays
as a step of the path.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np

from ..errors import InputError
from .columns import is_reading
from .table import Measurements

FORM = 'rows such as "8, 14, 20-23"'

Rows = str | Sequence[int]
LeaveOut = Rows | Mapping[str, Rows]
LeftOut = dict[str, list[int]]  # by file, the numbers of rows


def numbered(names: Sequence[str]) -> list[str]:
    """Names of tables, with a number where two have the same name."""
    return [name if names.count(name) == 1 else f"{name} ({i + 1})" for i, name in enumerate(names)]


def sources(tables: Sequence[Measurements]) -> list[list[str]]:
    """By table and row, the file that the row is from."""
    own = [table.files or (table.name,) for table in tables]
    names = iter(numbered([file for files in own for file in files]))
    named = [dict(zip(files, names, strict=False)) for files in own]
    return [
        [every[table.file_of(i) or table.name] for i in range(len(table))]
        for every, table in zip(named, tables, strict=True)
    ]


def named_rows(tables: Sequence[Measurements], which: Sequence[np.ndarray]) -> LeftOut:
    """The rows of some tables that are marked, (rows,) each, by file."""
    found: LeftOut = {}
    for table, marked, files in zip(tables, which, sources(tables), strict=True):
        for i in np.flatnonzero(marked).tolist():
            found.setdefault(files[i], []).append(int(table.rows[i]))
    return found


def rows_in_words(rows: LeftOut) -> str:
    """ "rows 8, 14, 20-23 of poses.csv"; several files are joined by "and"."""
    return " and ".join(f"row{'s' * (len(own) > 1)} {_ranges(own)} of {file}" for file, own in rows.items())


def _ranges(numbers: Sequence[int]) -> str:
    """ "8, 14, 20-23"."""
    parts = []
    for _, run in groupby(enumerate(sorted(numbers)), lambda pair: pair[1] - pair[0]):
        first, *more = (number for _, number in run)
        parts.append(str(first) if not more else f"{first}{', ' if len(more) == 1 else '-'}{more[-1]}")
    return ", ".join(parts)


def without(tables: Sequence[Measurements], leave_out: LeaveOut) -> tuple[tuple[Measurements, ...], LeftOut]:
    """The tables without some rows, and which rows these are.

    Raises:
        InputError: for a file or row that is not there, rows of one file among several that is not named, or tables
            without any row left.
    """
    files = list(dict.fromkeys(file for own in sources(tables) for file in own))
    if not isinstance(leave_out, Mapping):
        if not len(leave_out):
            return tuple(tables), {}
        if len(files) > 1:
            raise InputError(f'leave_out: say of which file, such as "{files[0]}=8, 14"; there are {", ".join(files)}')
        leave_out = {files[0]: leave_out}
    if unknown := [file for file in leave_out if file not in files]:
        raise InputError(f"leave_out: there is no file {unknown[0]!r}; there are {', '.join(files)}")
    numbers = {file: _numbers(rows) for file, rows in leave_out.items()}
    marked = [
        np.array([number in numbers.get(file, ()) for file, number in zip(own, table.rows.tolist(), strict=True)], bool)
        for own, table in zip(sources(tables), tables, strict=True)
    ]
    found = named_rows(tables, marked)
    for file, wanted in numbers.items():
        if missing := [number for number in wanted if number not in found.get(file, ())]:
            raise InputError(f"leave_out: {file} has no row {missing[0]}; rows are counted as in the file")
    return tuple(_table_without(*pair) for pair in zip(tables, marked, strict=True)), found


def _numbers(rows: Rows) -> list[int]:
    if not isinstance(rows, str):
        if not all(isinstance(row, int | np.integer) and not isinstance(row, bool) for row in rows):
            raise InputError(f"leave_out: needs the numbers of rows, got {rows!r}; write {FORM}")
        return [int(row) for row in rows]
    found: list[int] = []
    for part in filter(None, re.split(r"[,;\s]+", re.sub(r"\s*-\s*", "-", rows))):
        if not (run := re.fullmatch(r"(\d+)(?:-(\d+))?", part)):
            raise InputError(f"leave_out {rows!r}: {part!r} is not a row; write {FORM}")
        first, last = int(run[1]), int(run[2] or run[1])
        if last < first:
            raise InputError(f"leave_out {rows!r}: {part} ends before it begins; write {last}-{first}")
        found += range(first, last + 1)
    return found


def _table_without(table: Measurements, marked: np.ndarray) -> Measurements:
    """The table without the readings of some rows, as if they were missing."""
    if not np.any(marked):
        return table
    read = [name for name in table.columns if is_reading(name, table.columns)]
    kept = {
        name: np.where(marked & table.has(name), np.nan, values) if name in read else values
        for name, values in table.columns.items()
    }
    empty = [name for name in read if not np.any(np.isfinite(kept[name]))]
    if len(empty) == len(read):
        raise InputError(f"leave_out: no reading of {table.name} is left; leave out fewer rows, or the whole table")
    return replace(table, columns={name: values for name, values in kept.items() if name not in empty})
