"""Markers in a separate table, which is read with the table of measurements before it.

    row, marker, arc_length [mm], offset_y [mm], x [mm], y [mm]
    1, head, 80, 11, 79.1, 12.3
    1, tip, 140, 0, 138.0, 4.1
    2, head, 80, 11, 77.8, 17.0

| column | unit of | meaning |
| --- | --- | --- |
| row | none | which row of the measurements: 1 for the first one below the header, on any line of the file |
| marker | none | its name: the table gets the columns `x@head`, `y@head`, ... |
| x, y, z | length | where the marker is, as `tip_x`; z of a body in space; an empty cell is a missing reading |
| arc_length | length | optional: the cross-section that the marker moves with |
| offset_x, offset_y, offset_z | length | optional, 0 unless given: from the axis, x along the body |

A marker without an arc_length is named by its place on the axis, such as `120mm`, or its place is given to `fit`.
"""

import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import InputError, within
from ..files.csv_table import Table, columns_in, read_table
from ..files.table_header import Kind, name_and_unit
from ..units import Dimension, shown
from .columns import how_to_say
from .markers import Marker

_AXES, _OFFSETS = ("x", "y", "z"), ("offset_x", "offset_y", "offset_z")
_COLUMNS = ("row", "marker", "arc_length", *_OFFSETS, *_AXES)


class MarkerTable(NamedTuple):
    """The content of a table of markers."""

    columns: dict[str, np.ndarray]  # "x@head", ..., one number for each row of the measurements, m; NaN: not there
    places: dict[str, Marker]  # of the markers whose positions it gives
    read_as: tuple[str, ...]  # how the file was understood
    described: set[str]  # names of columns that the caller described and the file has


NO_MARKERS = MarkerTable({}, {}, (), set())


def of_markers(columns: Mapping[str, str]) -> dict[str, str]:
    """The descriptions of columns, such as "arc_length [mm]", that are for a table of markers."""
    return {name: meant for name, meant in columns.items() if _meant(name_and_unit(meant)[0]) or not meant.strip()}


def is_marker_table(path: str | os.PathLike[str], columns: Mapping[str, str]) -> bool:
    """Whether the header of a file has a column `marker`, and with it a position or a row."""
    named = columns_in(path, _KIND, of_markers(columns))
    return "marker" in named and not named.isdisjoint(("row", *_AXES))


def read_marker_table(path: str | os.PathLike[str], columns: Mapping[str, str], num_rows: int) -> MarkerTable:
    """The markers in a file.

    Args:
        path: CSV or .xlsx.
        columns: by the head of a column in the file, what it is.
        num_rows: of the table of measurements.

    Raises:
        InputError: names the file, row (line), column and remedy.
    """
    found = read_table(path, _KIND, columns)
    with within(path):
        if "row" not in found.columns:
            missing = "the column row is missing; add it: 1 for the first row of the measurements, 2, ..."
            raise InputError(missing, where=f"row {found.header}")
        if not any(axis in found.columns for axis in _AXES):
            remedy = how_to_say("x [mm]", found.unused)
            raise InputError("the column x or y is missing", where=f"row {found.header}", remedy=remedy)
        names = ["".join(str(label).split()) for label in found.columns["marker"]]
        at = _rows(found, num_rows)
        for (row, name), count in Counter(zip(at.tolist(), names, strict=True)).items():
            if count > 1:
                raise InputError(f"the marker {name!r} of row {row + 1} is there {count} times; keep one")
        read: dict[str, np.ndarray] = {}
        for name in dict.fromkeys(names):
            own = np.array(names) == name
            for axis in (axis for axis in _AXES if axis in found.columns):
                read[f"{axis}@{name}"] = np.full(num_rows, np.nan)
                read[f"{axis}@{name}"][at[own]] = found.columns[axis][own]
        places = dict(_places(found, names))
    file = Path(path).name
    said = [f"{file}: {line}" for line in found.read_as]
    said.append(f"markers of {file}: {', '.join(dict.fromkeys(names))}, in {len(set(at.tolist()))} of {num_rows} rows")
    return MarkerTable(read, places, tuple(said), found.described)


def _rows(found: Table, num_rows: int) -> np.ndarray:
    """For each row of the file the index of its row in the measurements, from 0."""
    for line, row in zip(found.rows, found.columns["row"], strict=True):
        if row not in range(1, num_rows + 1):
            raise InputError(
                f"row {line}, column row: must be 1 to {num_rows}, got {row:g}; the first row of the measurements is 1"
            )
    return found.columns["row"].astype(int) - 1


def _places(found: Table, names: Sequence[str]) -> Iterator[tuple[str, Marker]]:
    given = [column for column in ("arc_length", *_OFFSETS) if column in found.columns]
    if given and given[0] != "arc_length":
        raise InputError(f"the column {given[0]} needs a column arc_length, of the cross-section of the marker; add it")
    for name in dict.fromkeys(names) if given else ():
        own = [i for i, other in enumerate(names) if other == name]
        place = {column: found.columns[column][own[0]] for column in given}
        for i, column in ((i, column) for i in own for column in given):
            if not np.isclose(found.columns[column][i], place[column], rtol=1e-9, atol=1e-12):
                here, there = (shown(x, "length") for x in (found.columns[column][i], place[column]))
                raise InputError(
                    f"row {found.rows[i]}, column {column}: {here}, but {there} in row {found.rows[own[0]]}; the "
                    f"marker {name!r} stays at one place of the body"
                )
        yield name, Marker(float(place["arc_length"]), tuple(float(place.get(column, 0.0)) for column in _OFFSETS))


def _meant(name: str) -> str | None:
    written = re.sub(r"[\s_-]+", "_", name.strip().lower())
    return written if written in _COLUMNS else None


def _dimension(column: str) -> Dimension | None:
    if column not in _COLUMNS:
        raise InputError(f"unknown column {column!r}; known are {', '.join(_COLUMNS)}")
    return None if column in ("row", "marker") else "length"


_KIND = Kind(
    _meant,
    _dimension,
    "positions",
    "row, marker, x [mm], y [mm]",
    labels=("marker",),
    gaps=lambda column: column in _AXES,
)
