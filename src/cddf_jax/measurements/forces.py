"""Known dead forces in the rows of a table: `tip_force_y`, and `force_y@60mm` of a force at the arc length 60 mm."""

import re
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from ..errors import InputError
from ..units import quantity, shown

ON_TIP = "tip"
_COLUMN = re.compile(r"tip_force_([xyz])|\s*(?:force|f)[\s_]?([xyz])\s*@\s*(\S.*?)\s*", re.IGNORECASE)


def force_column(name: str) -> tuple[str, str] | None:
    """Component and place of a column: ("y", "tip") of "tip_force_y", ("y", "60mm") of "force_y@60 mm"; else None."""
    found = _COLUMN.fullmatch(name)
    if found is None:
        return None
    return (found[2].lower(), re.sub(r"\s+", "", found[3])) if found[2] else (found[1].lower(), ON_TIP)


def column_of_force(axis: str, place: str) -> str:
    """The name of a column, by the component and place that `force_column` returns."""
    return f"tip_force_{axis}" if place == ON_TIP else f"force_{axis}@{place}"


def forces_of(
    columns: Mapping[str, np.ndarray], rows: int
) -> tuple[dict[str, float], Float[np.ndarray, "rows places components"]]:
    """The arc lengths, m, of the places besides the tip, by their names, and all forces, N, those on the tip first.

    There are three components where there is a column of the third.

    Raises:
        InputError: for a place that is no arc length.
    """
    found = {parts: columns[column] for column in columns if (parts := force_column(column))}
    places, none = [*dict.fromkeys([ON_TIP, *(place for _, place in found)])], np.zeros(rows)
    axes = "xyz" if any(axis == "z" for axis, _ in found) else "xy"
    forces = [[found.get((axis, place), none) for axis in axes] for place in places]
    at = {place: quantity(place, "length", f"force @{place}") for place in places[1:]}
    return at, np.moveaxis(np.array(forces), 2, 0)


def check_on_body(places: Mapping[str, float], length: float) -> None:
    """Refuse forces beside a body of this length, m."""
    for place, arc_length in places.items():
        if not 0 < arc_length <= length * (1 + 1e-9):
            raise InputError(
                f"force @{place}: it must act above 0 and up to the tip at {shown(length, 'length')}, not at "
                f"{shown(arc_length, 'length')}; correct the place"
            )
