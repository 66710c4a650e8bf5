"""The cross-sections along a body as a table: CSV from and for CAD, one row for each arc length.

    arc_length [mm], outer_radius [mm], inner_radius [mm], offset_1 [mm], offset_2 [mm]
    0,   20,   7, 10, -10
    70,  16.5, 7, 10, -10
    140, 13,   7, 10,

`offset_1`, `offset_2`, ... (one alone may be called `offset`) are distances of the tendons from the neutral axis,
negative for a tendon with side = -1; a tendon ends where its cells do. The first row is the base, the last the tip.
`csv_table` tells which separators, decimal marks and encodings are understood.
"""

import os
import re
from typing import NamedTuple

import numpy as np

from .csv_table import Kind, read_table, table_csv
from .errors import InputError
from .manipulator import Manipulator, Tendon
from .profiles import Profile
from .simplest_profile import simplest_profile
from .units import Dimension, shown

TOLERANCE = 1e-6  # m
ROWS = 201  # that are written, besides those at joints
_OFFSET = re.compile("offset(_[1-9][0-9]*)?")


class CrossSections(NamedTuple):
    """What a table of cross-sections tells; `Manipulator(**sections._asdict(), youngs_modulus=..., ...)` takes it."""

    length: float  # m
    outer_radius: Profile
    inner_radius: Profile
    tendons: tuple[Tendon, ...]


def read_cross_sections(path: str | os.PathLike[str], *, tolerance: float = TOLERANCE) -> CrossSections:
    """The body in a CSV file of cross-sections; the module's text shows the columns.

    Each column becomes the simplest profile that passes every point at `tolerance` or less: a number, a straight
    line, a cubic spline of few knots, or a chain of straight lines.

    Args:
        path: the file.
        tolerance: m, by how much a profile may miss the points, about what they are measured or rounded to.

    Raises:
        InputError: names the file, row (line), column, value and remedy.
    """
    if not (np.isfinite(tolerance) and tolerance > 0):
        raise InputError(f"tolerance must be a positive length in m, got {tolerance}")
    table = read_table(path, _KIND)
    try:
        return _sections(table.columns, table.rows, tolerance)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def cross_sections_csv(manipulator: Manipulator) -> str:
    """The text that `read_cross_sections` reads, in mm: a row at every joint of the body and on a grid."""
    length = float(manipulator.length)
    joints = np.asarray(manipulator.breakpoints, float)
    s = np.unique(np.concatenate([np.linspace(0.0, length, ROWS), joints[(joints > 0) & (joints < length)]]))
    outer, inner = map(np.asarray, manipulator.radii(s))
    columns = {"arc_length [mm]": 1e3 * s, "outer_radius [mm]": 1e3 * outer, "inner_radius [mm]": 1e3 * inner}
    for i, tendon in enumerate(manipulator.tendons, 1):
        end = length if tendon.end is None else float(tendon.end)
        columns[f"offset_{i} [mm]"] = np.where(s <= end, 1e3 * tendon.side * np.asarray(tendon.offset(s)), np.nan)
    return table_csv(columns)


# --- reading -------------------------------------------------------------------------------------


def _dimension_of(column: str) -> Dimension:
    if column in ("arc_length", "outer_radius", "inner_radius") or _OFFSET.fullmatch(column):
        return "length"
    raise InputError(
        f"unknown column {column!r}; known are arc_length, outer_radius, inner_radius, offset_1, offset_2, ..."
    )


_KIND = Kind(
    _dimension_of,
    "cross-sections",
    "arc_length [mm], outer_radius [mm], inner_radius [mm], offset_1 [mm]",
    gaps=lambda column: column.startswith("offset"),
)


def _sections(columns: dict[str, np.ndarray], rows: list[int], tolerance: float) -> CrossSections:
    for column in ("arc_length", "outer_radius", "inner_radius"):
        if column not in columns:
            raise InputError(f"the column {column} is missing; add it")
    s = _arc_length(columns["arc_length"], rows)
    names = _offset_columns(columns)
    for column, values in columns.items():
        if column not in names and not np.all(np.isfinite(values)):
            raise InputError(f"row {rows[int(np.argmin(np.isfinite(values)))]}, column {column}: must be finite")
    outer, inner = (simplest_profile(s, columns[name], tolerance, name) for name in ("outer_radius", "inner_radius"))
    tendons = tuple(_tendon(s, columns[name], rows, tolerance, name) for name in names)
    return CrossSections(float(s[-1]), outer, inner, tendons)


def _arc_length(s: np.ndarray, rows: list[int]) -> np.ndarray:
    if s[0] != 0.0:
        got = shown(s[0], "length")
        raise InputError(f"row {rows[0]}, column arc_length: the first must be 0, the base, got {got}")
    if len(s) < 2:
        raise InputError("holds one cross-section; give at least those at base and tip")
    good = np.diff(s) > 0
    if not np.all(good):
        at = int(np.argmin(good)) + 1
        got = shown(s[at], "length")
        raise InputError(f"row {rows[at]}, column arc_length: must increase, got {got}; sort the rows")
    return s


def _offset_columns(columns: dict[str, np.ndarray]) -> list[str]:
    """The columns of the tendons in their order, without gaps between the numbers."""
    found = sorted((c for c in columns if c.startswith("offset")), key=lambda c: int(c.partition("_")[2] or 1))
    wanted = [["offset"], [f"offset_{i}" for i in range(1, len(found) + 1)]]
    if not found or found not in wanted:
        got = ", ".join(found) or "none"
        raise InputError(f"tendons are numbered offset_1, offset_2, ... without gaps, got {got}; name the columns so")
    return found


def _tendon(s: np.ndarray, offset: np.ndarray, rows: list[int], tolerance: float, name: str) -> Tendon:
    there = np.isfinite(offset)
    count = int(np.sum(there))
    if count < 2 or not np.all(there[:count]):
        remedy = "fill them from the base to the end of the tendon, two or more"
        raise InputError(f"row {rows[int(np.argmin(there))]}, column {name}: cells are empty before the end; {remedy}")
    own = offset[:count]
    if np.any(own > 0) and np.any(own < 0):
        at = int(np.argmax(np.sign(own) != np.sign(own[0])))
        raise InputError(f"row {rows[at]}, column {name}: the tendon changes sides; keep one sign along it")
    side = -1 if np.any(own < 0) else +1
    end = None if count == len(s) else float(s[count - 1])
    return Tendon(simplest_profile(s[:count], side * own, tolerance, name), side, end=end)
