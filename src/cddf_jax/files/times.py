"""Times as seconds: numbers, "18 s", clock times, durations and dates.

| form | examples |
| --- | --- |
| number | `18`, `18 s`, `0.3 min` |
| clock time or duration | `10:00:18`, `9:05:00.5 PM`, `1 day, 0:00:05`, `10:05` (h, min), `00:01.5` (min, s) |
| date | `2026-05-04 10:00:18`, `2026-05-04T10:00:18.5+02:00`, `2026/05/04 10:00`, `04.05.2026 10:00:18` |

Dates count from the first row. `10:05` is minutes and seconds where the unit says so: `[mm:ss]`, `[min]`. All cells of
a column have one form: else their order is not known.
"""

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..units import quantity, to_si
from .table_header import is_number, number, short

_CLOCK = re.compile(r"(?:(\d+) days?,? )?(\d+):([0-5]\d)(?::([0-5]\d(?:\.\d*)?))?(?: ?([ap])\.?m\.?)?", re.I)
_REMEDY = (
    "give a time such as 18 s, 10:00:18 or 2026-05-04 10:00:18, or in place of the times a column step (1, 2, ...)"
)


def seconds_in(column: str, rows: Sequence[int], texts: Sequence[str], unit: str) -> tuple[np.ndarray, str]:
    """The times in the cells of a column, s, and in words how they were read; "" for numbers.

    Args:
        column: its name, for messages.
        rows: the number of each row, for messages.
        texts: the cells.
        unit: of cells that are plain numbers.

    Raises:
        InputError: names row, column, cell and remedy.
    """
    texts = [" ".join(text.split()) for text in texts]
    if all(is_number(text) and isfinite(number(text)) for text in texts):
        return to_si(np.array([*map(number, texts)]), unit, "time", f"the column {column}"), ""
    forms, values = [], np.zeros(len(texts))
    for i, (row, text) in enumerate(zip(rows, texts, strict=True)):
        form, values[i] = _read(text, unit)
        if not form:
            found = f"{short(text)} is not a time" if text else "the cell is empty"
            raise InputError(f"row {row}, column {column}: {found}; {_REMEDY}")
        if forms and form != forms[0]:
            there = f"{short(texts[0])} in row {rows[0]} is {forms[0]}"
            raise InputError(f"row {row}, column {column}: {short(text)} is {form}, but {there}; write one form")
        forms.append(form)
    if forms[0].startswith("a date"):
        values -= values[0]
    return values, f"{column}: {short(texts[0])} is read as {values[0]:.9g} s" if forms[0] != "a number" else ""


def _read(text: str, unit: str) -> tuple[str, float]:
    """The form of a time, and its seconds; "" for a text that is no time."""
    if found := _CLOCK.fullmatch(text):
        days, hours, minutes, rest, half = found.groups()
        hour = int(hours) % 12 + 12 * (half in "pP") if half else int(hours)
        if not half or 1 <= int(hours) <= 12:
            seconds = int(days or 0) * 86400.0 + hour * 3600.0 + int(minutes) * 60.0 + float(rest or 0)
            of_minutes = (days, rest, half) == (None, None, None) and unit.startswith("m")  # mm:ss, min
            return "a clock time", seconds / 60 if of_minutes else seconds
    if found := re.fullmatch(r"(\d+):([0-5]\d\.\d+)", text):
        return "a clock time", int(found[1]) * 60.0 + float(found[2])
    if found := re.match(r"(\d{4})/(\d\d)/(\d\d)|(\d\d)\.(\d\d)\.(\d{4})", text):
        year, month, day = found.groups()[:3] if found[1] else found.groups()[:2:-1]
        text = f"{year}-{month}-{day}{text[found.end() :]}"
    if re.match(r"\d{4}-\d\d-\d\d", text):
        try:
            date = datetime.fromisoformat(re.sub(r"(?<=[ T])(?=\d:)", "0", text))  # 9:05
        except ValueError:
            return "", 0.0
        form = "a date" if date.tzinfo is None else "a date with a time zone"
        return form, date.replace(tzinfo=date.tzinfo or UTC).timestamp()
    try:
        return "a number", quantity(f"{text} {unit}" if is_number(text) else text, "time", "time")
    except InputError:
        return "", 0.0


def seconds_of(values: ArrayLike) -> ArrayLike:
    """The times in a column from Python, s: of text as in a file, dates, times and durations; others stay as they are.

    Raises:
        InputError: for text or an object that is not a time; names row and value.
    """
    if np.ma.isMaskedArray(values):
        return values
    array = np.asarray(values)
    if array.dtype.kind == "M":
        array = array.astype("M8[us]") - array[:1].astype("M8[us]")
    if np.issubdtype(array.dtype, np.timedelta64) and np.can_cast(array.dtype, "m8[s]", "same_kind"):  # no months
        return array / np.timedelta64(1, "s")  # NaN for NaT
    if array.dtype.kind in "OU" and array.ndim == 1:
        return seconds_in("time", range(1, len(array) + 1), [str(value) for value in array], "s")[0]
    return values
