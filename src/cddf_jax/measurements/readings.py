"""What instruments on a bench read of a manipulator: one entry for each kind of column that a fit explains.

A kind of data is added here and in `quantities`: what is read of an equilibrium, its unit and its words. A column of a
table is called by the name of its kind; where every tendon has one, `tip_tension` is that of the first, `tip_tension_2`
of the second.
"""

from collections.abc import Callable
from typing import Any, NamedTuple


class Reading(NamedTuple):
    """One kind of data."""

    of: Callable[[Any], Any]  # of equilibria, rows first, SI; tendons last where every tendon has one
    per_tendon: bool = False
    by_cell: bool = False  # a tension as a load cell reads it, gain * (tension - pretension) + zero
    zero: str = ""  # the parameter of a bench that is added to what is true


READINGS = {
    "tip_tension": Reading(lambda found: found.tip_tension, per_tendon=True, by_cell=True),
    "tip_angle": Reading(lambda found: found.tip_angle, zero="angle_zero"),
    "tip_x": Reading(lambda found: found.tip_position[..., 0]),
    "tip_y": Reading(lambda found: found.tip_position[..., 1]),
}
OF_SHAPE = tuple(name for name, kind in READINGS.items() if not kind.per_tendon)  # in which the kinematics differ


def kind_of(column: str) -> str:
    """The kind of reading of a column, "tip_tension" of "tip_tension_2"; "" for a column that is not a reading."""
    stem, _, tendon = column.rpartition("_")
    if tendon.isdigit() and stem in READINGS and READINGS[stem].per_tendon:
        return stem
    return column if column in READINGS else ""


def tendon_number(column: str) -> int:
    """1 for `tip_tension`, 2 for `tip_tension_2`, ..."""
    digits = column.rpartition("_")[2]
    return int(digits) if digits.isdigit() else 1


def of_tendons(name: str, num_tendons: int) -> list[str]:
    """The column of each tendon: `base_tension`, `base_tension_2`, ..."""
    return [name, *(f"{name}_{i}" for i in range(2, num_tendons + 1))]


def columns_of(num_tendons: int) -> list[str]:
    """Every column that a manipulator can show."""
    return [c for name, kind in READINGS.items() for c in of_tendons(name, num_tendons if kind.per_tendon else 1)]
