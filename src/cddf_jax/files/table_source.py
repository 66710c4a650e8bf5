"""The cells of a table in a file, from its header on: CSV in the dialects of instruments and spreadsheets, and .xlsx.

Separators are commas, semicolons or tabs, or the one in a first line such as `sep=;`. With semicolons or tabs, decimal
commas are understood too. Blank lines, lines with # between the rows, and separators at the end of a line are ignored.
The encoding is UTF-8, UTF-16 with a byte order mark, or else Windows-1252 (Latin-1).
"""

import codecs
import csv
import io
import os
import re
import zipfile
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import InputError, needed
from .table_header import is_like_number

Recognised = Callable[[Sequence[str]], int]  # how many cells are heads of columns
Row = tuple[int, list[str]]  # its line in the file, or its number in the sheet, and its cells

_BLANK = ' \t\r\n,;"'
_LOOKED_AT = 200  # rows, for the header
_ENOUGH = 2  # columns that are enough to recognise a header
_COMMENT = re.compile(r'[ \t"]*#(?!N/A|DIV/0!|REF!|VALUE!|NAME\?|NUM!|NULL!)', re.I)  # not an error of a spreadsheet
_CONTROL = re.compile("[\x00-\x08\x0e-\x1f]")  # characters that no text holds
_ZIP, _OLD_SPREADSHEET = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"


class Source(NamedTuple):
    """A table in a file."""

    row: int  # of the header
    header: list[str]
    rows: Iterator[Row]  # below it
    notes: tuple[str, ...]  # the text above the header
    decimal_commas: bool  # whether a number may have one
    read_as: list[str]  # how the file was understood, complete when the rows are read


def open_table(path: str | os.PathLike[str], recognised: Recognised, empty: str) -> Source:
    """The table in a file; errors do not name it.

    `recognised` counts the cells that are heads of columns; the header is found by it. `empty` is the message for a
    file without any text.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror}); check the path") from None
    if content.startswith(_OLD_SPREADSHEET):
        raise InputError("is a spreadsheet in the old format .xls; save it as .xlsx or as CSV UTF-8")
    source = _of_sheets(content, recognised) if content.startswith(_ZIP) else _of_text(content, recognised)
    if source is None:
        raise InputError(empty)
    return source


# --- text ----------------------------------------------------------------------------------------


def _of_text(content: bytes, recognised: Recognised) -> Source | None:
    text, read_as = _decoded(content)
    lines, marks = list(io.StringIO(text, newline=None)), ";,\t"
    if lines and (said := re.fullmatch(r'"?sep=(.)"?[ \t,;]*\n?', lines[0], re.I)):
        lines[0], marks = "\n", said[1]
    plain = ["\n" if not line.strip(_BLANK) or _COMMENT.match(line) else line for line in lines]
    filled = [i for i, line in enumerate(plain) if line != "\n"]
    if not filled:
        return None
    note = [i for i in range(filled[0]) if lines[i].strip(_BLANK)][-1:]  # a header behind #, as NumPy's savetxt writes
    looked_at = note + filled[:_LOOKED_AT]
    tables = {
        mark: [(i, [cell.strip(_BLANK + "#") for cell in lines[i].split(mark)]) for i in looked_at] for mark in marks
    }
    found = {mark: _header_in(rows, recognised) for mark, rows in tables.items()}

    def goodness(mark: str) -> tuple[int, int]:
        known, own, numbers = found[mark]
        return known, mark in lines[looked_at[own]] if known else numbers

    mark = max(marks, key=goodness)
    at = looked_at[found[mark][1]]
    notes = [line.strip(_BLANK).lstrip("#").strip() for line in lines[:at] if line.strip(_BLANK)]
    if filled[0] < at:
        read_as.append(f"the header is row {at + 1}; the text above it from row {filled[0] + 1} on is taken for notes")
    rows = _rows([lines[at].lstrip(" #"), *plain[at + 1 :]], at, mark)
    return Source(at + 1, next(rows)[1], rows, tuple(notes), mark != ",", read_as)


def _decoded(content: bytes) -> tuple[str, list[str]]:
    """The text, and how it was read if not as UTF-8 or UTF-16."""
    marked = content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)  # "Unicode text" of spreadsheets
    other = ["the file is not UTF-8; it was read as Windows-1252 (Latin-1)"]
    for encoding, read_as in (("utf-16" if marked else "utf-8-sig", []), ("cp1252", other)):
        with suppress(UnicodeDecodeError):
            text = content.decode(encoding)
            if not _CONTROL.search(text):
                return text, read_as
    raise InputError("is not text in UTF-8, UTF-16 or Latin-1; save it as CSV UTF-8")


def _header_in(rows: Sequence[Row], recognised: Recognised) -> tuple[int, int, int]:
    """How many columns of the header are known, its index, and how many numbers stand below the last row of words.

    It is the row with most known columns, of equal ones the last above numbers. Without a known column it is the
    fullest of the last three rows above the numbers, the uppermost of equal ones: units stand below it.
    """
    most, at, numbers_below = 0, 0, False
    for i, (_, cells) in enumerate(rows):
        numbers, words = _numbers_and_words(cells)
        known = recognised(cells) if words else 0
        if numbers_below and most >= _ENOUGH:  # the table has begun
            break
        if known > most or (known == most and known and not numbers_below):
            most, at, numbers_below = known, i, False
        numbers_below = numbers_below or (known < most and numbers > 0)
    counted = [_numbers_and_words(cells) for _, cells in rows]
    first = 1 + max((i for i, (numbers, words) in enumerate(counted) if numbers <= words / 2), default=-1)
    names = max(range(max(first - 3, 0), first), key=lambda i: sum(counted[i]), default=0)
    return most, at if most else names, sum(numbers for numbers, _ in counted[first:])


def _numbers_and_words(cells: Sequence[str]) -> tuple[int, int]:
    """How many cells are numbers, or dates and the like, and how many are words."""
    numbers = sum(is_like_number(cell) for cell in cells)
    return numbers, sum(map(bool, cells)) - numbers


def _rows(lines: Sequence[str], above: int, separator: str) -> Iterator[Row]:
    """Every row that is not blank, by the number of its first line; `above` are the lines of the file before these."""
    reader, at = csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=True), above + 1
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield at, cells
            at = above + reader.line_num + 1
    except csv.Error as error:
        raise InputError(f"row {at}: is not CSV ({error}); remove a misplaced quotation mark there") from None


# --- spreadsheets --------------------------------------------------------------------------------


def _of_sheets(content: bytes, recognised: Recognised) -> Source | None:
    """The one sheet that holds a table."""
    sheets = {name: rows for name, rows in _sheets(content).items() if rows}
    found = {name: _header_in(rows[:_LOOKED_AT], recognised) for name, rows in sheets.items()}
    tables = [name for name, (known, *_) in found.items() if known] or list(sheets)[:1]
    if len(tables) > 1:
        raise InputError(f"holds tables in the sheets {', '.join(map(repr, tables))}; save each in a file of its own")
    if not tables:
        return None
    name, read_as = tables[0], []
    at = found[name][1]
    if others := [repr(other) for other in sheets if other != name]:
        read_as.append(f"the sheet {name!r} is read; not used: {', '.join(others)}")
    above, (row, header), below = sheets[name][:at], sheets[name][at], sheets[name][at + 1 :]
    notes = tuple(" ".join(cell for cell in cells if cell).lstrip("#").strip() for _, cells in above)
    if above:
        read_as.append(f"the header is row {row}; the text above it from row {above[0][0]} on is taken for notes")
    return Source(row, header, iter(below), notes, True, read_as)


def _sheets(content: bytes) -> dict[str, list[Row]]:
    """The rows of each sheet that are not blank, all of one width, as text that gives every number exactly."""
    openpyxl = needed("openpyxl", "excel")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            nothing = (None, 0) if b'fullCalcOnLoad="1"' in archive.read("xl/workbook.xml") else (None,)
        values, formulas = (
            openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=computed).worksheets
            for computed in (True, False)
        )
        sheets = {one.title: _texts(one, own, nothing) for one, own in zip(values, formulas, strict=True)}
    except Exception as error:  # many kinds: a zip archive may hold anything
        raise InputError(
            f"is not a spreadsheet in the format .xlsx ({error}); save it as .xlsx or as CSV UTF-8"
        ) from None
    found = {}
    for name, rows in sheets.items():
        width = max(map(len, rows), default=0)
        found[name] = [(i, cells + [""] * (width - len(cells))) for i, cells in enumerate(rows, 1) if any(cells)]
    return found


def _texts(values: Any, formulas: Any, nothing: Collection[object]) -> list[list[str]]:
    """The text of each cell of a sheet; of a formula that was never computed the formula.

    The value of such a cell is one of `nothing`: it is empty, or 0 in some files.
    """
    for sheet in (values, formulas):
        sheet.reset_dimensions()  # the size in the file may be wrong

    def text(cell: Any, formula: Any) -> str:
        never = formula.data_type == "f" and cell.value in nothing and cell.data_type != "str"
        return _text(formula.value if never else cell.value)

    both = zip(values.iter_rows(), formulas.iter_rows(), strict=True)
    return [[text(*cells) for cells in zip(*row, strict=True)] for row in both]


def _text(value: object) -> str:
    value = getattr(value, "text", value)  # of a formula that fills several cells
    return "" if value is None else repr(value) if isinstance(value, float) else str(value).strip()
