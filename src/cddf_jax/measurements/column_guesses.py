"""Guesses what unknown columns of a file are: by the unit, by words such as "tip" or "unten", and by their order.

A guess is never used. It is printed as options `--column`, for the user to check and copy.
"""

import re
import shlex
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..files.csv_table import Unused
from ..files.table_header import is_like_number, name_and_unit, short
from ..units import Dimension, preferred, to_si
from .columns import DIRECTIONS, PULLEY, column_dimension, column_resembled
from .readings import tendon_number

_WORDS = {
    "base": "base basis unten bottom lower proximal prox motor drive driven actuator antrieb winch input pull encoder "
    "servo",
    "tip": "tip spitze oben top upper distal dist end ende output",
    "force": "force kraft tension load cell lc f",
    "angle": "angle winkel theta phi bend bending heading",
    "length": "pos position em coord trans translation t p extension",
    "time": "time zeit timestamp millis elapsed clock date",
    "wrap": "wrap umschlingung",
    "weight": "weight gewicht",
    "trial": "trial versuch run lauf",
    "step": "step schritt",
    "direction": "direction richtung",
    "row": "row zeile frame index sample",
    "marker": "marker label",
    "along": "arc s",
    "offset": "offset",
    # what is neither set nor read
    "other": "soll set target cmd command desired ref error err fehler std sd mean max quat rot velocity vel speed acc",
}
_MEANS = {word: meaning for meaning, words in _WORDS.items() for word in words.split()}
_PARTS = [word for word in _MEANS if len(word) > 3 or word in ("tip", "pos")]  # of a word: Seilkraft
_WORD = re.compile(r"[A-ZÄÖÜ]?[a-zäöüß]+|[A-ZÄÖÜ]+(?![a-zäöüß])|\d+")
_COMPONENT = re.compile("([tpfdu]?)([xyz])")  # x, or in one word with its quantity: Tx, Fz
_BEHIND = re.compile(r"(.*?)(?:[\s_]+in)?[\s_]+(N|mN|kN|gf|kgf|g|kg|lbf|deg|rad|mm|cm|m|s|ms)")
_SAID = {"g": "gf", "kg": "kgf", "lb": "lbf", "lbs": "lbf", "grad": "deg"}  # for a unit that is refused
_DIMENSIONS: tuple[Dimension, ...] = ("force", "length", "angle", "time")
_SHOWN = 20  # unknown columns in a message


class _Seen(NamedTuple):
    """What the head of a column and its cells say."""

    head: str
    label: str  # words and numbers of its name without the axis, "head2"
    means: frozenset[str]
    axis: str  # x, y, z or ""
    number: int | None
    dimension: Dimension | None
    unit: str | None  # None: not given
    cells: Sequence[str]
    numeric: bool


_Pairs = Iterator[tuple[_Seen, str]]  # columns, and what they may be


def option(head: str, meant: str) -> str:
    """The option of the command line that says what a column is, as a shell takes it."""
    text = f"{head}={meant}"
    return "--column " + (shlex.quote(text) if re.search(r'["$`!\\]', text) else f'"{text}"')


def advice(unused: Sequence[Unused], guesses: Mapping[str, str], needed: Sequence[str] = ()) -> str:
    """The options for all columns with a guess, and the names of those without one; `needed` has no guess either."""
    parts = []
    if guesses:
        options = " ".join(option(one.head, guesses[one.head]) for one in unused if one.head in guesses)
        in_header = all(name_and_unit(head)[1] for head in guesses)
        note = "" if in_header else " (a unit that the header lacks is a guess too)"
        parts.append(f"check these guesses by unit, words and order{note}, then copy: {options}")
    count = Counter(one.head for one in unused)
    if rest := [short(head) for head in count if head not in guesses and count[head] == 1]:
        parts.append(f"no guess for {', '.join(rest[:_SHOWN])}{', ...' if len(rest) > _SHOWN else ''}")
    if twice := [short(head) for head in count if count[head] > 1]:
        parts.append(f"rename {', '.join(twice)}, of which there are several")
    if needed:
        parts.append(f"nothing looks like {' or '.join(needed)}: {option('NAME', _with_unit(needed[0], None))}")
    return "; ".join(parts)


def hint(guesses: Mapping[str, str]) -> list[str]:
    """A line on columns that could be used as well, if there are any."""
    return [f"to use more columns, {advice([*map(Unused, guesses)], guesses)}"] if guesses else []


def guess_measurements(unused: Sequence[Unused], known: Collection[str]) -> dict[str, str]:
    """By head, what columns of a table of measurements may be, such as "tip_x [mm]"; `known` are its other columns."""
    columns = _seen(unused)
    misspelt = [(one, column_resembled(name_and_unit(one.head)[0])) for one in columns]
    found = [(one, meant) for one, meant in misspelt if meant]
    rest = [one for one, meant in misspelt if not meant]
    found += [*_labels(rest), *_times(rest)]
    rest = [one for one in rest if one.numeric and "other" not in one.means]
    if set(known) & set(PULLEY) or any("wrap" in one.means for one in rest):
        return _described([*found, *_pulley(rest)], known)
    return _described([*found, *_tensions(rest, known), *_angles(rest), *_positions(rest, known)], known)


def guess_markers(unused: Sequence[Unused], known: Collection[str]) -> dict[str, str]:
    """As `guess_measurements`, for a table of markers."""
    found: list[tuple[_Seen, str]] = []
    for one in _seen(unused):
        if one.axis and one.dimension == "length":
            found.append((one, f"offset_{one.axis}" if "offset" in one.means else one.axis))
        elif one.dimension == "length" and "along" in one.means:
            found.append((one, "arc_length"))
        elif one.dimension is None and (labels := one.means & {"row", "marker"}):
            found.append((one, min(labels)))
    return _described(found, known)


def guess_path(unused: Sequence[Unused], known: Collection[str]) -> dict[str, str]:
    """As `guess_measurements`, for a path: a tension, a displacement or an angle, read or set."""
    columns = _seen(unused)
    for dimension, meant in (("force", "base_tension"), ("length", "tendon_displacement"), ("angle", "tip_angle")):
        driven = [one for one in columns if one.dimension == dimension and not one.axis and one.numeric]
        if driven := [one for one in driven if "base" in one.means] or driven:
            return _described([(driven[0], meant), *_labels(columns), *_times(columns)], known)
    return _described([*_labels(columns), *_times(columns)], known)


# --- what a column says --------------------------------------------------------------------------


def _seen(unused: Sequence[Unused]) -> list[_Seen]:
    """Every column whose head stands there once, and that is not empty."""
    count = Counter(column.head for column in unused)
    return [_one(*one) for one in unused if count[one.head] == 1 and any(cell.strip() for cell in one.cells)]


def _one(head: str, cells: Sequence[str], unit_below: str | None) -> _Seen:
    name, unit = name_and_unit(head)
    if unit is None and (behind := _BEHIND.fullmatch(name)):
        name, unit = behind.groups()
    filled = [cell.strip() for cell in cells if cell.strip()]
    numbers = [is_like_number(cell) or cell.startswith("=") for cell in filled]
    numeric = 2 * sum(numbers) >= len(filled)
    if unit is None and numeric:
        above = [cell.strip("[]() ") for cell in filled[: numbers.index(True)]]  # above the numbers
        unit = next((text for text in (unit_below, *above) if text and _dimension(text)), None)
    words, axis = [], ""
    for word in map(str.lower, _WORD.findall(name)):
        component = _COMPONENT.fullmatch(word)
        axis = component[2] if component else axis
        words.append(component[1] if component else word)
    means = frozenset(meaning for word in words for meaning in _meanings(word))
    digits = [int(word) for word in words if word.isdecimal()]
    label = "".join(words)
    return _Seen(
        *(head, label, means, axis, digits[0] if len(digits) == 1 else None),
        dimension=_by_words(label, means, axis) if unit is None else _dimension(unit),
        unit=("ms" if label in ("millis", "ms") else None) if unit is None else _SAID.get(unit.lower(), unit),
        cells=filled,
        numeric=numeric,
    )


def _meanings(word: str) -> list[str]:
    """The meanings of a word, or else those of its first and last parts."""
    parts = [word] if word in _MEANS else [part for part in _PARTS if word.startswith(part) or word.endswith(part)]
    return [_MEANS[part] for part in parts]


def _dimension(unit: str) -> Dimension | None:
    said = _SAID.get(unit.lower(), unit)
    for dimension in _DIMENSIONS:  # without pint
        if said == preferred(dimension)[1]:
            return dimension
    return next((dimension for dimension in _DIMENSIONS if _converts(said, dimension)), None)


def _converts(unit: str, dimension: Dimension) -> bool:
    try:
        to_si(np.zeros(0), unit, dimension, "")
    except InputError:
        return False
    return True


def _by_words(label: str, means: frozenset[str], axis: str) -> Dimension | None:
    """The dimension of a column without a unit."""
    if axis:
        if "force" in means:
            return "force"
        return "length" if means & {"length", "tip", "offset"} or not label.strip("0123456789") else None
    if means & {"trial", "step", "direction", "row", "marker"}:
        return None
    if label in ("t", "ms") or "time" in means:
        return "time"
    if means & {"wrap", "angle"}:
        return "angle"
    if means & {"force", "base", "tip", "weight"}:
        return "force"
    return "length" if "along" in means else None


def _described(pairs: Sequence[tuple[_Seen, str]], known: Collection[str]) -> dict[str, str]:
    """By head, column and unit; a column that is there already, or with another unit, is left out."""
    found: dict[str, str] = {}
    taken = set(known)
    for one, meant in pairs:
        text = _with_unit(meant, one)
        if one.head not in found and meant not in taken and text:
            found[one.head] = text
            taken.add(meant)
    return found


def _with_unit(meant: str, one: _Seen | None) -> str:
    """A column with the unit of the file, or else the usual one; "" where the file has the unit of something else."""
    dimension = _dimension_of(meant)
    if dimension is None:
        return meant
    if one is None or one.unit is None:
        return f"{meant} [{preferred(dimension)[1]}]"
    return f"{meant} [{one.unit}]" if one.dimension == dimension else ""


def _dimension_of(meant: str) -> Dimension | None:
    if meant in ("row", "marker"):
        return None
    of_markers = meant in ("x", "y", "z", "arc_length") or meant.startswith("offset_")
    return "length" if of_markers or meant == "tendon_displacement" else column_dimension(meant)


# --- what columns may be -------------------------------------------------------------------------


def _labels(columns: Sequence[_Seen]) -> _Pairs:
    for one in columns:
        if one.dimension is None and one.unit is None:
            directions = all(cell.strip().lower() in (*DIRECTIONS, "1", "+1", "-1") for cell in one.cells)
            named = {"trial": True, "step": one.numeric, "direction": directions}
            yield from ((one, label) for label, good in named.items() if good and label in one.means)


def _times(columns: Sequence[_Seen]) -> _Pairs:
    yield from ((one, "time") for one in columns if one.dimension == "time" and one.numeric)


def _pulley(columns: Sequence[_Seen]) -> _Pairs:
    for one in columns:
        if one.dimension == "angle":
            yield one, "wrap_angle"
        elif one.dimension == "force":
            yield one, "weight" if "weight" in one.means else "pulling_tension"


def _tensions(columns: Sequence[_Seen], known: Collection[str]) -> _Pairs:
    """Tensions at base and tip by their words; without words two cells are base and tip, others those of the base."""
    forces = [one for one in columns if one.dimension == "force"]
    yield from ((one, f"tip_force_{one.axis}") for one in forces if one.axis)
    forces = [one for one in forces if not one.axis]
    bases, tips = ([one for one in forces if place in one.means] for place in ("base", "tip"))
    free = [one for one in forces if one not in bases + tips]
    tendons = [tendon_number(column) for column in known if column.startswith("base_tension")]
    if bases or tendons:
        tips = tips or free
    elif tips or len(free) != 2:
        bases = free
    else:
        bases, tips = free[:1], free[1:]
    if all(one.number is not None for one in bases):
        bases = sorted(bases, key=lambda one: one.number or 0)
    of_number = {number: number for number in tendons}
    for one in bases:
        tendon = next(i for i in range(1, len(tendons) + 2) if i not in tendons)
        tendons.append(tendon)
        of_number |= {} if one.number is None else {one.number: tendon}
        yield one, _of_tendon("base_tension", tendon)
    for one, tendon in zip(tips, sorted(tendons), strict=False):
        yield one, _of_tendon("tip_tension", of_number.get(-1 if one.number is None else one.number, tendon))


def _of_tendon(column: str, tendon: int) -> str:
    return column if tendon == 1 else f"{column}_{tendon}"


def _angles(columns: Sequence[_Seen]) -> _Pairs:
    """The only angle, or the only one of the tip; that of a motor is none."""
    angles = [one for one in columns if one.dimension == "angle" and "base" not in one.means]
    of_tip = [one for one in angles if "tip" in one.means] or angles
    if len(of_tip) == 1:
        yield of_tip[0], "tip_angle"


def _positions(columns: Sequence[_Seen], known: Collection[str]) -> _Pairs:
    """The only position, or that with a word for the tip; others are markers."""
    places = [one for one in columns if one.dimension == "length" and one.axis]
    labels = {one.label for one in places}
    tips = {one.label for one in places if "tip" in one.means} or (labels if len(labels) == 1 else set())
    for one in places:
        if one.label in tips and f"tip_{one.axis}" not in known:
            yield one, f"tip_{one.axis}"
        elif one.label:
            yield one, f"{one.axis}@{one.label}"
