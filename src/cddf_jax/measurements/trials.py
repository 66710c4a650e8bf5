"""Several tables of measurements: files that are the trials of one experiment, and tables that are given twice."""

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError
from .left_out import numbered
from .marker_table import is_marker_table
from .table import Measurements, read_file


def read_tables(
    paths: Iterable[str | os.PathLike[str]], columns: Mapping[str, str] | None = None
) -> tuple[Measurements, ...]:
    """The measurements in several files; those that are trials of one experiment become one table.

    Files are trials where two or more have the same columns and none of these is `trial`; each file is then a trial.
    To keep a table for each file, use `read_measurements`. A file with a column `marker` is a table of markers
    (`marker_table`), and belongs to the table before it.

    Args:
        paths: of the files.
        columns: as in `read_measurements`; a file need not have all of them.

    Raises:
        InputError: as `read_measurements`.
    """
    found = [read_file(path, columns or {}, markers) for path, markers in _with_markers(paths, columns or {})]
    for name in columns or {}:
        if not any(name in described for _, described in found):
            where = ", ".join(table.name for table, _ in found) or "no file of data"
            raise InputError(f"{where}: no column {name!r}; check the name")
    return trials_together([table for table, _ in found])


def _with_markers(
    paths: Iterable[str | os.PathLike[str]], columns: Mapping[str, str]
) -> list[tuple[str | os.PathLike[str], str | os.PathLike[str] | None]]:
    """Each file of measurements, with the table of markers that follows it, if any."""
    found: list[tuple[str | os.PathLike[str], str | os.PathLike[str] | None]] = []
    for path in paths:
        if not is_marker_table(path, columns):
            found.append((path, None))
        elif found and found[-1][1] is None:
            found[-1] = found[-1][0], path
        else:
            raise InputError(f"{path}: is a table of markers; name the file of the measurements just before it")
    return found


def trials_together(tables: Sequence[Measurements]) -> tuple[Measurements, ...]:
    """Tables with the same columns, none of them `trial`, as the trials of one table; other tables stay as they are.

    A column without a reading still counts as a column of its table.
    """
    alike: dict[tuple[frozenset[str], frozenset[object]], list[int]] = {}
    for number, table in enumerate(tables):
        of_table = frozenset((*table.columns, *table.unread)), frozenset(table.markers.items())
        alike.setdefault(of_table, []).append(number)
    found = dict(enumerate(tables))
    for (columns, _), group in alike.items():
        again = len({tables[number].checksum for number in group}) < len(group)  # given twice, of which `fit` warns
        if len(group) > 1 and "trial" not in columns and not again:
            found[group[0]] = _joined([found.pop(number) for number in group])
    return tuple(found[number] for number in sorted(found))


def _joined(tables: Sequence[Measurements]) -> Measurements:
    """One table whose trials are the tables."""
    names = numbered([table.name for table in tables])
    stems = [Path(name).stem for name in names]
    columns = {"trial": np.repeat(np.arange(len(tables), dtype=float), [len(table) for table in tables])}
    gaps = [np.full(len(table), np.nan) for table in tables]  # where a table has no reading of a column
    for column in dict.fromkeys(column for table in tables for column in table.columns):
        own = [table.columns.get(column, gap) for table, gap in zip(tables, gaps, strict=True)]
        columns[column] = np.concatenate(own)
    said = [line for table in tables for line in table.read_as]
    every = ", ".join(names)
    said.append(f"{every}: the same columns and no column trial, so each file is a trial of one experiment")
    return Measurements(
        name=every if len(every) <= 60 else f"{names[0]} to {names[-1]}",
        columns=columns,
        rows=np.concatenate([table.rows for table in tables]),
        trial_labels=tuple(stems if len(set(stems)) == len(stems) else names),
        notes=tuple(note for table in tables for note in table.notes),
        simulated=any(table.simulated for table in tables),
        read_as=tuple(said),
        files=tuple(names),
        left_out=sum(table.left_out for table in tables),
        unread=tuple(column for column in tables[0].unread if column not in columns),
        markers=tables[0].markers,
    )


def repeated_tables(tables: Sequence[Measurements]) -> list[str]:
    """A warning for each table of several that holds the same numbers as an earlier one."""
    sums = [table.checksum for table in tables]
    pairs = [(sums.index(own), number) for number, own in enumerate(sums)]
    return [
        f"{tables[number].name}: table {number + 1} holds the same numbers as table {first + 1} "
        f"({tables[first].name}), which thus count twice and make standard errors too small; leave one out"
        for first, number in pairs
        if first != number
    ]
