"""The cross-sections along a body as a table: CSV to and from CAD, one row for each arc length.

    arc_length [mm], outer_radius [mm], inner_radius [mm], offset_1 [mm], offset_2 [mm]
    0,   20,   7, 10, -10
    70,  16.5, 7, 10, -10
    140, 13,   7, 10,

`offset_1`, `offset_2`, ... (one alone may be called `offset`) are distances of the tendons from the neutral axis,
negative for a tendon with side = -1. A tendon ends at the last row with a number in its column. The first row is the
base, the last the tip. A step is two rows with the same arc length: the body before it and behind it. `table_source`
says which separators, decimal marks and encodings are understood.

Between its points a table is read as straight lines, unless a smooth curve passes all of them at the tolerance, stays
within the values of neighbouring points and does not turn back between them. `read_cross_sections(path).columns` says
which profile was taken, and every command that reads the body prints it.
"""

import os
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from ..errors import InputError, within
from ..robot.manipulator import Manipulator, Tendon
from ..robot.profiles import Polyline, Profile, profile_in_words
from ..units import shown
from .csv_table import read_table, table_csv
from .simplest_profile import simplest_profile
from .table_header import Kind, short

TOLERANCE = 1e-6  # m
ROWS = 201  # that are written, besides those at joints
_COLUMNS = "arc_length, outer_radius, inner_radius, offset_1, offset_2, ..."
_OFFSET = re.compile("offset(_[1-9][0-9]*)?")


class CrossSections(NamedTuple):
    """The body in a table of cross-sections."""

    length: float  # m
    outer_radius: Profile
    inner_radius: Profile
    tendons: tuple[Tendon, ...]
    columns: dict[str, str]  # how each was read, as `print` shows a profile

    @property
    def body(self) -> dict[str, Any]:
        """What the table says of the body, for `Manipulator(**sections.body, youngs_modulus=..., ...)`."""
        return {name: value for name, value in self._asdict().items() if name != "columns"}


def read_cross_sections(path: str | os.PathLike[str], *, tolerance: float = TOLERANCE) -> CrossSections:
    """The body in a CSV file of cross-sections; the module's text shows the columns.

    Each column becomes the simplest profile that passes every point at `tolerance` or less: a number, a straight
    line, a cubic spline of few knots that stays between neighbouring points, or straight lines from point to point.
    `columns` says which.

    Args:
        path: the file.
        tolerance: m, by how much a profile may miss the points: about the accuracy to which they are measured.

    Raises:
        InputError: names the file, row (line), column, value and remedy.
    """
    if not (np.isfinite(tolerance) and tolerance > 0):
        raise InputError(f"tolerance must be a positive length in m, got {tolerance}")
    table = read_table(path, _KIND)
    with within(path):
        if table.unused:
            names = ", ".join(short(column.name) for column in table.unused)
            raise InputError(f"row {table.header}: unknown column {names}; known are {_COLUMNS}")
        return _sections(table.columns, table.rows, tolerance)


def in_one_line(columns: Mapping[str, str]) -> str:
    """How a table was read, in one line."""
    return f"cross-sections: {'; '.join(f'{name}: {words}' for name, words in columns.items())}"


def _offset_in_words(profile: Profile, end: float) -> str:
    """The profile that was taken; of straight lines also how far they turn the tendon, which rubs."""
    said = profile_in_words(profile, end)
    if not isinstance(profile, Polyline):
        return said
    angle = np.arctan(np.diff(profile.values) / np.diff(profile.arc_length))
    turned = np.degrees(np.sum(np.abs(np.diff(angle))))
    return f"{said}, whose kinks turn the tendon by {turned:.3g} deg in all"


def cross_sections_csv(manipulator: Manipulator) -> str:
    """The text that `read_cross_sections` reads, in mm: rows on a grid and at joints of the body, two at a step."""
    with jax.enable_x64(True):  # to distinguish the two sides of a step, in any precision of the caller
        return table_csv(_rows(manipulator))


def _rows(manipulator: Manipulator) -> dict[str, np.ndarray]:
    """The columns that are written; a step of a radius has two rows."""
    length = float(manipulator.length)
    joints = np.unique(np.asarray(manipulator.breakpoints, float))
    joints = joints[(joints > 0) & (joints < length)]
    before = joints - 1e-9 * length
    jumps = np.abs(np.subtract(manipulator.radii(joints), manipulator.radii(before))) > TOLERANCE
    steps = joints[np.any(jumps, axis=0)]
    s = np.sort(np.concatenate([np.union1d(np.linspace(0.0, length, ROWS), joints), steps]))
    at = np.where(np.append(np.diff(s) == 0, False), s - 1e-9 * length, s)
    outer, inner = map(np.asarray, manipulator.radii(at))
    columns = {"arc_length [mm]": 1e3 * s, "outer_radius [mm]": 1e3 * outer, "inner_radius [mm]": 1e3 * inner}
    for i, tendon in enumerate(manipulator.tendons, 1):
        end = length if tendon.end is None else float(tendon.end)
        columns[f"offset_{i} [mm]"] = np.where(s <= end, 1e3 * tendon.side * np.asarray(tendon.offset(s)), np.nan)
    return columns


# --- reading -------------------------------------------------------------------------------------


def _meant(name: str) -> str | None:
    return name if name in ("arc_length", "outer_radius", "inner_radius") or _OFFSET.fullmatch(name) else None


_KIND = Kind(
    _meant,
    lambda column: "length",
    "cross-sections",
    "arc_length [mm], outer_radius [mm], inner_radius [mm], offset_1 [mm]",
    gaps=lambda column: column.startswith("offset"),
)


def _sections(columns: dict[str, np.ndarray], rows: list[int], tolerance: float) -> CrossSections:
    for column in ("arc_length", "outer_radius", "inner_radius"):
        if column not in columns:
            raise InputError(f"the column {column} is missing; add it")
    s = _arc_length(columns["arc_length"], rows)
    names, tendons = _offset_columns(columns), []
    profiles = {name: _profile(name, s, columns[name], tolerance) for name in ("outer_radius", "inner_radius")}
    said = {name: profile_in_words(profile, s[-1]) for name, profile in profiles.items()}
    for name in names:
        side, count = _side_and_count(columns[name], rows, name)
        distance = side * columns[name][:count]
        if s[count - 1] == s[count - 2] and abs(distance[-1] - distance[-2]) > tolerance:
            remedy = "fill one of the two cells there"
            raise InputError(f"row {rows[count - 1]}, column {name}: the tendon ends in a step; {remedy}")
        profiles[name] = _profile(name, s[:count], distance, tolerance)
        said[name] = _offset_in_words(profiles[name], s[count - 1])
        tendons.append(Tendon(profiles[name], side, end=None if s[count - 1] == s[-1] else float(s[count - 1])))
    return CrossSections(float(s[-1]), profiles["outer_radius"], profiles["inner_radius"], tuple(tendons), said)


def _profile(name: str, s: np.ndarray, values: np.ndarray, tolerance: float) -> Profile:
    with within(name):
        return simplest_profile(s, values, tolerance)


def _arc_length(s: np.ndarray, rows: list[int]) -> np.ndarray:
    def refused(at: int, what: str) -> InputError:
        return InputError(f"row {rows[at]}, column arc_length: {what.format(shown(s[at], 'length'))}")

    if s[0] != 0.0:
        raise refused(0, "the first must be 0, the base, got {}")
    if len(s) < 2:
        raise InputError("holds one cross-section; give at least those at base and tip")
    for at in (np.flatnonzero(np.diff(s) < 0) + 1).tolist():
        raise refused(at, "must increase, got {}; sort the rows")
    for at in (np.flatnonzero(np.diff(s) == 0) + 1).tolist():
        at_an_end = s[at] in (s[0], s[-1])
        if at_an_end or s[at - 1] == s[at - 2]:
            where = "at an end of the body" if at_an_end else "three times"
            raise refused(at, f"{{}} is repeated {where}; keep two rows for a step, before it and behind it, else one")
    return s


def _offset_columns(columns: dict[str, np.ndarray]) -> list[str]:
    """The columns of the tendons in their order, without gaps between the numbers."""
    found = sorted((c for c in columns if c.startswith("offset")), key=lambda c: int(c.partition("_")[2] or 1))
    wanted = [["offset"], [f"offset_{i}" for i in range(1, len(found) + 1)]]
    if not found or found not in wanted:
        got = ", ".join(found) or "none"
        raise InputError(f"tendons are numbered offset_1, offset_2, ... without gaps, got {got}; name the columns so")
    return found


def _side_and_count(offset: np.ndarray, rows: list[int], name: str) -> tuple[int, int]:
    """The side of a tendon, and how many rows it reaches."""
    there = np.isfinite(offset)
    count = int(np.sum(there))
    if count < 2 or not np.all(there[:count]):
        remedy = "fill them from the base to the end of the tendon, two or more"
        raise InputError(f"row {rows[int(np.argmin(there))]}, column {name}: cells are empty before the end; {remedy}")
    own = offset[:count]
    if np.any(own > 0) and np.any(own < 0):
        at = int(np.argmax(np.sign(own) != np.sign(own[0])))
        raise InputError(f"row {rows[at]}, column {name}: the tendon changes sides; keep one sign along it")
    return (-1 if np.any(own < 0) else +1), count
