"""The header of a table: which column each cell means, and in which unit it is.

A unit stands in brackets, in parentheses, behind the name or in a row below the header.
"""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..units import Dimension, preferred, to_si, unit_fits

_MARKED = re.compile(r"(.*\S)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))")  # a name with its unit
_BEHIND = re.compile(r"(.*[^\s_])[\s_]+([^\s_]+)")  # `Tbase_N`
_LIKE_NUMBER = re.compile(r"[+-]?\d[\d.,:/' -]*")  # 1.234,5


class Kind(NamedTuple):
    """A kind of table: which columns it has, and how they are read."""

    dimension_of: Callable[[str], Dimension | None]  # of a column, None without; raises InputError for an unknown one
    content: str  # of a row, in the plural
    example: str  # of a header
    meant: Callable[[str], str | None] = lambda name: name  # the column that a name in a file means; None: left out
    labels: Collection[str] = ()  # columns of text
    gaps: Callable[[str], bool] = lambda column: False  # whether cells of a column may be empty, which gives NaN
    words: Callable[[str], Mapping[str, str]] = lambda column: {}  # by word, the number that it stands for in a column


class Heading(NamedTuple):
    """The head of a column."""

    text: str  # as in the file, on one line
    column: str | None  # None where it is not used
    unit: str | None

    @property
    def name(self) -> str:
        """The text without a unit in brackets or parentheses."""
        return name_and_unit(self.text)[0]


def name_and_unit(text: str) -> tuple[str, str | None]:
    """A head without its unit in brackets or parentheses, and this unit, where there is one."""
    marked = _MARKED.fullmatch(text)
    return (text, None) if marked is None else (marked[1], (marked[2] if marked[2] is not None else marked[3]).strip())


def heading_of(cell: str, kind: Kind, given: Mapping[str, str]) -> Heading:
    """The heading in a cell of the header."""
    text = " ".join(cell.split()) if len(cell) < 10_000 else short(cell)
    own = _as_written(text, kind)
    name, marked = name_and_unit(text)
    said = given.get(text, given.get(name))
    if said is None:
        return own
    if not said.strip():
        return Heading(text, None, None)
    column, unit = _as_written(said, kind)[1:]
    if column is None:
        kind.dimension_of(said)  # raises, and names the known columns
    if unit is None:
        unit = marked or _unit_behind(text, kind.dimension_of(str(column)))
    return Heading(text, column, unit)


def _as_written(text: str, kind: Kind) -> Heading:
    """The heading of a text with its unit in brackets, in parentheses or behind the name."""
    bare, unit = name_and_unit(text)
    if unit is not None:
        column = _known(bare, kind)
        plain = column is None or (kind.dimension_of(column) is None and (text.endswith(")") or unit in ("-", "1")))
        return Heading(text, column, None if plain else unit)  # direction (in/out) is plain
    if (column := _known(text, kind)) is not None:
        return Heading(text, column, None)
    if name := _BEHIND.fullmatch(text):
        column = _known(name[1], kind)
        unit = None if column is None else _unit_behind(text, kind.dimension_of(column))
        return Heading(text, column if unit else None, unit)
    return Heading(text, None, None)


def _known(name: str, kind: Kind) -> str | None:
    """The column that a name means, where there is one."""
    column = kind.meant(name)
    try:
        if column is not None:
            kind.dimension_of(column)
    except InputError:
        return None
    return column


def _unit_behind(text: str, dimension: Dimension | None) -> str | None:
    name = _BEHIND.fullmatch(text)
    return name[2] if name and dimension and unit_fits(name[2], dimension) else None


def headings_of(
    cells: list[str], row: int, kind: Kind, given: Mapping[str, str], below: Sequence[Sequence[str]]
) -> list[Heading]:
    """The headings of all columns; `below` are the cells of the next rows."""
    while len(cells) > 1 and not cells[-1].strip():  # spreadsheets leave separators at the end
        cells = cells[:-1]
    headings = [heading_of(cell.strip() or nameless(i), kind, given) for i, cell in enumerate(cells, 1)]
    known = any(heading.column for heading in headings)
    remedy = f"write names and units such as {kind.example!r}"
    for cell in cells:
        check_computed(cell, f"row {row}")
    if not known and all(is_number(cell) for cell in cells if cell.strip()):
        above = "there is no header above the numbers" if row == 1 else f"no row above names {len(cells)} columns"
        raise InputError(f"row {row}: {above}; {remedy}")
    if not known and len(cells) == 1 and not any(is_number(own[0].replace(",", ".")) for own in below):
        said = "and commas, semicolons or tabs between columns"
        raise InputError(f"row {row}: {short(cells[0])} is not a column; {remedy}, {said}")
    return headings


def nameless(position: int) -> str:
    """The head of a column without a name; positions count from 1."""
    return f"column {position} without a name"


def with_units_below(headings: Sequence[Heading], row: int, cells: Sequence[str], kind: Kind) -> list[Heading] | None:
    """The headings with the units in the row below them; None where that row holds numbers already."""
    units, others = {}, {}
    for i, (heading, cell) in enumerate(zip(headings, cells, strict=False)):
        dimension = None if heading.column is None else kind.dimension_of(heading.column)
        unit = cell.strip().strip("[]()").strip()
        if heading.column is None:
            others[i] = unit or None  # for a guess of what it is
        if dimension is None or not unit:
            continue
        if is_number(unit.replace(",", ".")):
            return None
        fits = unit_fits(unit, dimension)
        if not (fits or dimension == "time"):  # hh:mm:ss, or a clock time
            return None
        units |= {i: unit} if fits else {}
    for i, unit in units.items():
        text, column, own = headings[i]
        if own not in (None, unit) and text.rstrip(")] ").endswith(own):  # no unit that the user said
            raise InputError(f"row {row}, column {column}: the unit is {unit}, but {own} in the header; keep one")
    every = others | units
    return [each._replace(unit=each.unit or every.get(i)) for i, each in enumerate(headings)] if units else None


def check_headings(headings: Sequence[Heading], row: int, kind: Kind) -> None:
    """Refuse a column that appears twice, and a unit that is missing or wrong."""
    seen: dict[str, str] = {}
    bare = []
    for _, column, unit in headings:
        dimension = None if column is None or unit else kind.dimension_of(column)
        if dimension and dimension != "time":
            bare.append(f"{column} [{preferred(dimension)[1]}]")
    if len(bare) > 1:
        raise InputError(f"row {row}: {len(bare)} columns need units, got none; write for example {', '.join(bare)}")
    for text, column, unit in headings:
        if column is None:
            continue
        if column in seen:
            same = f"the column {column} appears twice; remove one"
            both = f"{seen[column]!r} and {text!r} both are the column {column}; remove one"
            raise InputError(f"row {row}: {same if seen[column] == text else both}")
        seen[column] = text
        dimension = kind.dimension_of(column)
        if dimension is None and unit is not None:
            raise InputError(f"row {row}: the column {column} has no unit, got [{unit}]; leave it out")
        if dimension not in (None, "time"):  # clock times need no unit
            to_si(np.zeros(0), unit or "", dimension, f"row {row}: the column {column}")


def check_computed(text: str, where: str) -> None:
    """Refuse a formula in place of its value."""
    if text.startswith("="):
        remedy = "open the file in a spreadsheet program and save it, or put the values in place of the formulas"
        raise InputError(f"{where}: the formula {short(text)} was never computed; {remedy}")


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
