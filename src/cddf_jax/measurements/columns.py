"""The columns of a table of measurements: their names, other spellings of them, and what they measure."""

import re
from collections.abc import Collection, Sequence
from difflib import get_close_matches

from ..errors import InputError
from ..files.table_header import Heading, short
from ..quantities import QUANTITIES
from ..units import Dimension
from .forces import column_of_force, force_column
from .markers import marker_column
from .order import ORDER
from .readings import NAMED, kind_of, set_by

COLUMNS = (
    *("trial", *ORDER, "direction", "base_tension", *NAMED, "tip_force_x", "tip_force_y", "tip_force_z"),
    *("wrap_angle", "weight", "pulling_tension"),
)
PULLEY = ("wrap_angle", "weight", "pulling_tension")
PER_TENDON = ("base_tension", "direction", *(name for name, kind in NAMED.items() if kind.per_tendon))
# other spellings, in small letters and without what separates words
_SPELLINGS = {
    "tbase": "base_tension",
    "tendondisplacement": "displacement",
    "ttip": "tip_tension",
    **{name.replace("_", ""): name for name in COLUMNS},
}
_LIKENESS = 0.85  # of a name to a known one, above which it counts as misspelt

_IN = ("loading", "load", "pulling", "pull", "in", "up", "+")
_OUT = ("unloading", "unload", "releasing", "release", "out", "down", "-", "−", "−1")
DIRECTIONS = {word: way for words, way in ((_IN, "1"), (_OUT, "-1")) for word in words}


def column_meant(name: str) -> str | None:
    """The column that a name in a file means, `base_tension` for "T base" or "Tbase_1"; None if it means none."""
    if marker := marker_column(name):
        return "@".join(marker)
    if force := force_column(name):
        return column_of_force(*force)
    stem, number = _parts(name)
    column = _SPELLINGS.get(stem)
    if column is None or not number or (column in PER_TENDON and number == "1"):
        return column
    return f"{column}_{number}" if column in PER_TENDON and number != "0" else None


def column_resembled(name: str) -> str | None:
    """The known column whose name is probably misspelt; None if no known name is similar enough."""
    if place := re.fullmatch(r"\s*f(?:orce)?\s*@\s*(\S.*)", name, re.IGNORECASE):  # without its component
        return column_meant(f"force_y@{place[1]}")
    stem, number = _parts(name)
    if number == "0" and _SPELLINGS.get(stem) in PER_TENDON:
        return _SPELLINGS[stem]
    written = re.sub(r"\W+", "_", name.lower())
    close = get_close_matches(written, COLUMNS, 1, _LIKENESS)
    if not close or close[0] in written or close[0][:-2] == written:  # base_tension_set and tip_force are words
        return None
    other_component = re.fullmatch(".*_[a-z]", written) and written[:-1] == close[0][:-1]  # tip_force_n
    return None if other_component else close[0]


def _parts(name: str) -> tuple[str, str]:
    """Letters and number of a name, without separators between words."""
    key = re.sub(r"[\s_.#-]+", "", name.lower())
    stem = key.rstrip("0123456789")
    number = key[len(stem) :]
    return stem, number.lstrip("0") or number[:1]


def option(head: str, meant: str) -> str:
    """The option of the command line that says what a column is."""
    return f'--column "{head}={meant}"'


def how_to_say(wanted: str, unused: Sequence[Heading]) -> str:
    """How to say which of the columns that a file has besides is the one that is `wanted`, "base_tension [N]"."""
    heads = ", ".join(dict.fromkeys(short(one.text) for one in unused))
    return (
        f"add it, or say which one it is by {option('NAME', wanted)}, where NAME is one of {heads}"
        if heads
        else "add it"
    )


def column_dimension(column: str) -> Dimension | None:
    """What a column measures; None for labels and signs.

    Raises:
        InputError: for an unknown column.
    """
    if marker_column(column):
        return "length"
    if force_column(column):
        return "force"
    stem, _, tendon = column.rpartition("_")
    if stem in PER_TENDON and re.fullmatch("[2-9]|[1-9][0-9]+", tendon):
        column = stem
    if column not in COLUMNS:
        close = get_close_matches(column.lower(), COLUMNS, 1)
        remedy = f"did you mean {close[0]}? Known are" if close else "known are"
        more = [f"{name}_2" for name in PER_TENDON]
        raise InputError(f"unknown column {short(column)}; {remedy} {', '.join([*COLUMNS, *more])}, ...")
    dimension = QUANTITIES[column].dimension
    return None if dimension == "dimensionless" else dimension


def may_be_read(column: str) -> bool:
    """Whether an instrument may read the column, so that cells may be empty."""
    return bool(kind_of(column)) or column == "pulling_tension"


def is_reading(column: str, columns: Collection[str]) -> bool:
    """Whether a column of a table was read. What was set is needed in every row, as a displacement that pulls."""
    return may_be_read(column) and column not in set_by(columns)
