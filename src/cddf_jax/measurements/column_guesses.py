"""Guesses what unknown columns of a file are: by the unit, by words such as "tip" or "unten", and by their order.

A guess is never used. It is printed as options `--column`, for the user to check and copy.
"""

import re
import shlex
from collections import Counter
from collections.abc import Collection, Mapping, Sequence

from ..files.table_header import Heading, is_like_number, name_and_unit, short
from ..units import Dimension, preferred, unit_fits
from .columns import PULLEY, column_dimension
from .readings import of_tendons

_Wanted = Mapping[Dimension, Sequence[str]]  # columns by what they measure, the usual one first
_FORCES = ("base_tension", "tip_tension", "tip_force_x", "tip_force_y", "tip_force_z")
_PULLED = of_tendons("displacement", 9)
_LENGTHS = ("tip_x", "tip_y", "tip_z", *_PULLED)
_BENCH: _Wanted = {"force": _FORCES, "angle": ["tip_angle"], "length": _LENGTHS, "time": ["time"]}
_PULLEY: _Wanted = {"force": ["weight", "pulling_tension"], "angle": ["wrap_angle"]}
_MARKERS: _Wanted = {"length": ["x", "y", "z", "arc_length"]}
_WORDS = {  # by the beginning of a column, in names of it
    "base": re.compile("base|unten|bottom|lower|prox|motor|winch", re.I),
    "tip": re.compile(r"tip|spitze|oben|\btop|upper|dist|\bend\b", re.I),
    "weight": re.compile("weight|gewicht", re.I),
    "displacement": re.compile(r"servo|encoder|\benc\b|displac|pulled|motor|winch|spool|tendon", re.I),
}
_MEASURED: dict[Dimension, re.Pattern[str]] = {  # in names without a unit
    "angle": re.compile("angle|winkel|bend", re.I),
    "time": re.compile(r"time|zeit|clock|elapsed|\bt\b", re.I),
    "force": re.compile(r"force|kraft|tension|load|cell|zug|\bF\b|^(base|tip)$", re.I),
}
_AXIS = re.compile(r"(?:^|[^a-z])[a-z]?([xyz])", re.I)
_WRAP = re.compile("wrap|umschlingung", re.I)
_NEITHER_SET_NOR_READ = re.compile(r"soll|\bset\b|target|cmd|command|desired|\bref\b|\berr|\bstd\b|\bmean\b", re.I)
_SHOWN = 20  # unknown columns in a message


def option(head: str, meant: str) -> str:
    """The option of the command line that says what a column is, as a shell takes it."""
    text = f"{head}={meant}"
    return "--column " + (shlex.quote(text) if re.search(r'["$`!\\]', text) else f'"{text}"')


def advice(unused: Sequence[Heading], guesses: Mapping[str, str], needed: Sequence[str] = ()) -> str:
    """The options for all columns with a guess, and the names of those without one; `needed` has no guess either."""
    parts = []
    if guesses:
        in_header = all(name_and_unit(head)[1] for head in guesses)
        note = "" if in_header else " (a unit that the header lacks is a guess too)"
        options = " ".join(option(*guess) for guess in guesses.items())
        parts.append(f"check these guesses by unit, words and order{note}, then copy: {options}")
    if rest := [short(head) for head in dict.fromkeys(one.text for one in unused) if head not in guesses]:
        parts.append(f"no guess for {', '.join(rest[:_SHOWN])}{', ...' if len(rest) > _SHOWN else ''}")
    if needed:
        unit = preferred(column_dimension(needed[0]) or "dimensionless")[1]
        parts.append(f"nothing looks like {' or '.join(needed)}: {option('NAME', f'{needed[0]} [{unit}]')}")
    return "; ".join(parts)


def hint(guesses: Mapping[str, str]) -> list[str]:
    """A line on columns that could be used as well, if there are any."""
    return [f"to use more columns, {advice((), guesses)}"] if guesses else []


def guess_measurements(unused: Sequence[Heading], known: Collection[str]) -> dict[str, str]:
    """By head, what columns of a table of measurements may be, such as "tip_x [mm]"; `known` are its other columns."""
    pulley = set(known) & set(PULLEY) or any(_WRAP.search(one.text) for one in unused)
    guessed = [one for one in unused if not _NEITHER_SET_NOR_READ.search(_words(one.text))]
    return _guesses(guessed, known, _PULLEY if pulley else _BENCH)


def guess_markers(unused: Sequence[Heading], known: Collection[str]) -> dict[str, str]:
    """As `guess_measurements`, for a table of markers."""
    return _guesses(unused, known, _MARKERS)


def _guesses(unused: Sequence[Heading], known: Collection[str], wanted: _Wanted) -> dict[str, str]:
    """The first column that is not taken, has the dimension and the axis, and the words where any column has them."""
    count, found, taken = Counter(one.text for one in unused), {}, set(known)
    columns = [one for one in unused if count[one.text] == 1 and _is_numeric(one.cells)]
    for by_words in (True, False):
        for one in (one for one in columns if one.text not in found):
            name, unit = _words(one.name), _unit(one)
            dimension, axis = _dimension(name, unit), _AXIS.fullmatch(name[-2:])
            for meant in wanted.get(dimension, ()) if dimension else ():
                of_axis, said = meant[-2:] in ("_x", "_y", "_z") or len(meant) == 1, _said(name, meant)
                good = meant[-1] == axis[1].lower() if axis and of_axis else not axis and not of_axis
                if good and meant not in taken and (said if by_words or meant in _PULLED else said is not False):
                    found[one.text] = _with_unit(meant, unit, dimension)
                    taken.add(meant)
                    break
    return {one.text: found[one.text] for one in columns if one.text in found}


def _words(name: str) -> str:
    return re.sub(r"[\W_]+", " ", name).strip()


def _said(name: str, meant: str) -> bool | None:
    """Whether a name has the words of a column; None if it has no such words."""
    own, found = meant.partition("_")[0], [stem for stem, words in _WORDS.items() if words.search(name)]
    return own in found if found else None


def _is_numeric(cells: Sequence[str]) -> bool:
    filled = [cell.strip() for cell in cells if cell.strip()]
    return bool(filled) and 2 * sum(is_like_number(cell) for cell in filled) >= len(filled)


def _unit(one: Heading) -> str | None:
    """The unit in the head, below it or behind the name; None if there is none."""
    first, _, behind = _words(one.text).rpartition(" ")
    others = [one.unit, *(cell.strip("[]() ") for cell in one.cells[:1]), behind if first else None]
    return name_and_unit(one.text)[1] or next((unit for unit in others if unit and _dimension("", unit)), None)


def _dimension(name: str, unit: str | None) -> Dimension | None:
    if unit is None:
        return next((dimension for dimension, words in _MEASURED.items() if words.search(name)), None)
    return next((dimension for dimension in ("force", "length", "angle", "time") if unit_fits(unit, dimension)), None)


def _with_unit(meant: str, unit: str | None, dimension: Dimension | None) -> str:
    """A column with the unit of the file, or else the usual one."""
    if dimension is None or (unit is None and dimension == "time"):
        return meant
    unit = {None: preferred(dimension)[1], "g": "gf", "kg": "kgf"}.get(unit, unit)
    return f"{meant} [{unit}]"
