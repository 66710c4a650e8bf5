"""The header of a table: which column each cell means, and in which unit it is.

A unit stands in brackets, in parentheses, behind the name or in a row below the header.
"""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..units import Dimension, to_si, unit_fits

_MARKED = re.compile(r"(.*\S)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))")  # a name with its unit
_BEHIND = re.compile(r"(.*[^\s_])[\s_]+([^\s_]+)")  # `Tbase_N`
_LIKE_NUMBER = re.compile(r"[+-]?\d[\d.,:/' -]*")  # 1.234,5


class Kind(NamedTuple):
    """A kind of table: which columns it has, and how they are read."""

    meant: Callable[[str], str | None]  # the column that a name in a file means; None for an unknown one
    dimension_of: Callable[[str], Dimension | None]  # of a column, None without; raises InputError for an unknown one
    content: str  # of a row, in the plural
    example: str  # of a header
    labels: Collection[str] = ()  # columns of text
    gaps: Callable[[str], bool] = lambda column: False  # whether cells of a column may be empty, which gives NaN
    words: Callable[[str], Mapping[str, str]] = lambda column: {}  # by word, the number that it stands for in a column


class Heading(NamedTuple):
    """The head of a column."""

    text: str  # as in the file, on one line
    column: str | None = None  # None where it is not used
    unit: str | None = None  # None where there is none

    @property
    def name(self) -> str:
        """The text without a unit in brackets or parentheses."""
        return name_and_unit(self.text)[0]


def name_and_unit(text: str) -> tuple[str, str | None]:
    """A head without its unit in brackets or parentheses, and this unit, where there is one."""
    marked = _MARKED.fullmatch(text)
    return (text, None) if marked is None else (marked[1], (marked[2] if marked[2] is not None else marked[3]).strip())


def heading_of(cell: str, kind: Kind, given: Mapping[str, str]) -> Heading:
    """The heading in a cell of the header; `given` describes columns by their heads, "" leaves one out."""
    text = " ".join(cell.split())
    name, marked = name_and_unit(text)
    said = given.get(text, given.get(name))
    if said is None:
        return _as_written(text, kind)
    if not said.strip():
        return Heading(text)
    _, column, unit = _as_written(said, kind)
    dimension = kind.dimension_of(column or said)  # raises for an unknown column
    return Heading(text, column, unit or marked or _unit_behind(text, dimension))


def _as_written(text: str, kind: Kind) -> Heading:
    """The heading of a text with its unit in brackets, in parentheses or behind the name."""
    name, unit = name_and_unit(text)
    column = kind.meant(name)
    if column is None and unit is None and (behind := _BEHIND.fullmatch(text)):
        column = kind.meant(behind[1])
        unit = None if column is None else _unit_behind(text, kind.dimension_of(column))
        column = column if unit else None
    has_unit = column is not None and kind.dimension_of(column) is not None  # not that of direction (in/out)
    return Heading(text, column, unit if has_unit else None)


def _unit_behind(text: str, dimension: Dimension | None) -> str | None:
    name = _BEHIND.fullmatch(text)
    return name[2] if name and dimension and unit_fits(name[2], dimension) else None


def headings_of(cells: list[str], row: int, kind: Kind, given: Mapping[str, str]) -> list[Heading]:
    """The headings of all columns; without a known one there must be several names."""
    while len(cells) > 1 and not cells[-1].strip():  # spreadsheets leave separators at the end
        cells = cells[:-1]
    headings = [heading_of(cell.strip() or nameless(i), kind, given) for i, cell in enumerate(cells, 1)]
    named = any(heading.column for heading in headings)
    if not named and (len(cells) == 1 or all(map(is_number, filter(None, cells)))):
        remedy = f"write names and units such as {kind.example!r}, with commas, semicolons or tabs between columns"
        raise InputError(f"row {row}: {short(cells[0])} is no header (lines with # are notes); {remedy}")
    return headings


def nameless(position: int) -> str:
    """The head of a column without a name; positions count from 1."""
    return f"column {position} without a name"


def with_units_below(headings: Sequence[Heading], row: int, cells: Sequence[str], kind: Kind) -> list[Heading] | None:
    """The headings with the units in a row below them; None where that row does not hold units."""
    found, fitting = list(headings), False
    for i, (heading, cell) in enumerate(zip(headings, cells, strict=False)):
        text, column, own = heading
        dimension = None if column is None else kind.dimension_of(column)
        unit = cell.strip().strip("[]()").strip()
        if not unit or (column is not None and dimension is None):
            continue
        fits = dimension is not None and unit_fits(unit, dimension)
        if not (column is None or fits or (dimension == "time" and not is_number(unit.replace(",", ".")))):  # hh:mm:ss
            return None
        if fits and own not in (None, unit) and text.rstrip(")] ").endswith(own):  # no unit that the user said
            raise InputError(f"row {row}, column {column}: the unit is {unit}, but {own} in the header; keep one")
        if own is None and fits:
            found[i] = heading._replace(unit=unit)
        fitting = fitting or fits
    return found if fitting else None


def check_headings(headings: Sequence[Heading], row: int, kind: Kind) -> None:
    """Refuse a column that appears twice, and a unit that is missing or wrong."""
    seen: dict[str, str] = {}
    for text, column, unit in headings:
        if column is None:
            continue
        if column in seen:
            raise InputError(f"row {row}: {seen[column]!r} and {text!r} both are the column {column}; remove one")
        seen[column] = text
        dimension = kind.dimension_of(column)
        if dimension not in (None, "time"):  # clock times need no unit
            to_si(np.zeros(0), unit or "", dimension, f"row {row}: the column {column}")


def number(text: str) -> float:
    """The number in a text; unlike in Python, 1_000 is not a number."""
    return float(text if "_" not in text else "")


def is_number(text: str) -> bool:
    try:
        number(text)
    except ValueError:
        return False
    return True


def is_like_number(text: str) -> bool:
    """Whether a text is a number in any notation, a date or a time: no name and no unit."""
    return is_number(text) or _LIKE_NUMBER.fullmatch(text) is not None


def short(text: str) -> str:
    """A piece of a file for a message: quoted and shortened."""
    text = text.strip()
    return repr(text if len(text) <= 60 else text[:57] + "...")
