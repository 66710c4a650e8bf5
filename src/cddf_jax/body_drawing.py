"""Bodies and tendons as they are drawn: from a manipulator, in mm."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from .along_figure import reached
from .equilibrium import Fields
from .manipulator import Manipulator
from .plotting import Body


def bent_body(manipulator: Manipulator, fields: Fields) -> Body:
    """The body in an equilibrium, from the fields along it."""
    return _body(manipulator, np.asarray(fields.arc_length), np.asarray(fields.position), np.asarray(fields.heading))


def straight_body(manipulator: Manipulator, arc_length: np.ndarray, level: float = 0.0) -> Body:
    """The body at rest, its axis at the height `level`, mm."""
    midline = np.stack([arc_length, np.full_like(arc_length, 1e-3 * level)], axis=-1)
    return _body(manipulator, arc_length, midline, 0.0 * arc_length)


def tendon_paths(manipulator: Manipulator, body: Body, arc_length: np.ndarray) -> np.ndarray:
    """The line of each tendon in the plane of a drawn body, mm, (tendons, points, 2); NaN beyond its anchor."""
    side = np.asarray([tendon.side for tendon in manipulator.tendons])[:, None]
    distance = side * 1e3 * np.asarray(manipulator.offset(arc_length))
    distance = np.where(reached(manipulator, arc_length), distance, np.nan)
    return np.stack([body.at_distance(d) for d in distance])


def drawn_radii(manipulator: Manipulator, arc_length: Any) -> tuple[Any, Any]:
    """Outer and inner radius as they are drawn, m; of a body without, the offset of its outermost tendon and 0."""
    if manipulator.has_radii:
        return manipulator.radii(arc_length)
    outer = jnp.max(manipulator.offset(arc_length), axis=0)
    return outer, jnp.zeros_like(outer)


def _body(manipulator: Manipulator, arc_length: np.ndarray, midline: np.ndarray, heading: np.ndarray) -> Body:
    """From m."""
    outer, inner = map(np.asarray, drawn_radii(manipulator, arc_length))
    return Body(1e3 * midline, heading, 1e3 * outer, 1e3 * inner)
