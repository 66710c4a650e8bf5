"""Markers on a body, and the camera that sees them and the tip.

A column `x@120mm` is the first coordinate of a marker on the axis at 120 mm; `x@head` is that of the marker "head",
whose place is given separately from the table.
"""

import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import InputError
from ..mechanics.fields import AnyFields, SpatialFields
from ..numerics.rotations import in_fixed_frame, of_turn
from ..units import quantity, shown

_COLUMN = re.compile(r"\s*([xyzXYZ])\s*@\s*(\S.*?)\s*")


class Marker(NamedTuple):
    """A marker that moves with a cross-section.

    Args:
        arc_length: of the cross-section, m.
        offset: from the axis, along the axes of the cross-section, m: x along the body, y, and z. In the plane y points
            towards a tendon on side +1, and z is left out or 0.
    """

    arc_length: float
    offset: tuple[float, ...] = (0.0, 0.0, 0.0)

    def __str__(self) -> str:
        offset = ", ".join(f"{1e3 * x:.5g}" for x in self.offset)
        return f"({offset}) mm from the axis at {shown(self.arc_length, 'length')}"


def marker_column(name: str) -> tuple[str, str] | None:
    """Coordinate and marker of a column, ("x", "120mm") of "x@120 mm"; None for any other column."""
    found = _COLUMN.fullmatch(name)
    return None if found is None else (found[1].lower(), re.sub(r"\s+", "", found[2]))


def markers_of(columns: Iterable[str], given: Mapping[str, Marker], length: float) -> dict[str, Marker]:
    """The markers that columns name, in the order in which they come.

    Args:
        columns: of a table.
        given: markers by their names.
        length: of the body, m.

    Raises:
        InputError: for a marker without a place, or with one beyond the body.
    """
    found: dict[str, Marker] = {}
    for column in columns:
        parts = marker_column(column)
        if parts is not None and parts[1] not in found:
            found[parts[1]] = given[parts[1]] if parts[1] in given else Marker(_arc_length(column, parts[1]))
            place = found[parts[1]].arc_length
            if not 0 <= place <= length * (1 + 1e-9):
                raise InputError(
                    f"column {column}: the marker is at {1e3 * place:g} mm, but the body is {1e3 * length:g} mm long"
                )
    return found


def _arc_length(column: str, place: str) -> float:
    try:
        return quantity(place, "length", f"column {column}")
    except InputError:
        raise InputError(
            f"column {column}: {place!r} is not an arc length such as 120mm, and no marker has this name; give "
            f"BenchSetting(markers={{{place!r}: Marker(arc_length, offset)}}), or --marker "
            f'"{place}=0, 11, 0 mm at 80 mm"'
        ) from None


def marker_positions(fields: AnyFields, offset: Float[Array, "markers 3"]) -> Float[Array, "markers components"]:
    """The positions of markers, m, in the fixed frame at the base.

    Args:
        fields: at the arc lengths of the markers.
        offset: from the axis, in the axes of the cross-section, m.
    """
    if isinstance(fields, SpatialFields):
        return fields.position + jnp.einsum("mij,mj->mi", fields.frame, offset)
    cos, sin = jnp.cos(fields.heading), jnp.sin(fields.heading)
    ahead, aside = offset[:, 0], offset[:, 1]
    return fields.position + jnp.stack([cos * ahead - sin * aside, sin * ahead + cos * aside], axis=-1)


def seen(
    position: Float[Array, "*points components"], shift: Float[Array, " 3"], turn: Float[Array, " 3"]
) -> Float[Array, "*points components"]:
    """Positions in the frame of a camera: turned about the base of the body, then shifted.

    Args:
        position: in the fixed frame at the base, m, of two components in the plane.
        shift: where the camera sees the base, m.
        turn: of the body's frame as the camera sees it: axis times angle, rad; in the plane its third number alone.
    """
    if position.shape[-1] == 2:
        cos, sin = jnp.cos(turn[2]), jnp.sin(turn[2])
        x, y = position[..., 0], position[..., 1]
        return jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1) + shift[:2]
    return in_fixed_frame(of_turn(turn), position) + shift


def registered(
    positions: Float[np.ndarray, "points components"], read: Float[np.ndarray, "points components"]
) -> tuple[float, list[float]]:
    """The pose in which a camera sees positions as they were read: the inverse of `seen`, by Kabsch (1976).

    Returns:
        The mean square of what remains, m^2, and shift and turn: six numbers in space, three in the plane.
    """
    from scipy.spatial.transform import Rotation

    own, theirs = positions - positions.mean(axis=0), read - read.mean(axis=0)
    left, _, right = np.linalg.svd(theirs.T @ own)
    signs = np.ones(len(left))
    signs[-1] = np.linalg.det(left @ right)
    turn = left * signs @ right
    rest = float(np.mean(np.sum((theirs - own @ turn.T) ** 2, axis=1)))
    shift = read.mean(axis=0) - turn @ positions.mean(axis=0)
    angles = [np.arctan2(turn[1, 0], turn[0, 0])] if len(turn) == 2 else Rotation.from_matrix(turn).as_rotvec()
    return rest, [*map(float, shift), *map(float, angles)]
