"""Arrays that figures and the explorer draw: the outline of a body, its tendons, and fields along it. No Matplotlib."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import ArrayLike

from ..errors import InputError
from ..mechanics.fields import Fields
from ..programs.evaluated import evaluated
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..robot.validation import joints
from ..statics.equilibrium import Equilibrium, fields_on

GREATEST_MOMENT_ARC = np.radians(190.0)  # it stays clear of the body behind the tip


class Body(NamedTuple):
    """A bent body as it is drawn: lengths in one unit, headings in radians, points along the body first."""

    midline: np.ndarray  # (points, 2)
    heading: np.ndarray
    outer_radius: np.ndarray
    inner_radius: np.ndarray

    def at_distance(self, distance: ArrayLike) -> np.ndarray:
        """The line at a signed distance to the left of the midline, (points, 2)."""
        left = np.stack([-np.sin(self.heading), np.cos(self.heading)], axis=-1)
        return self.midline + np.asarray(distance)[..., None] * left

    @property
    def outline(self) -> np.ndarray:
        """The outer surface, up one side and back on the other, (2 points, 2)."""
        return np.concatenate([self.at_distance(self.outer_radius), self.at_distance(-self.outer_radius)[::-1]])

    @property
    def walls(self) -> list[np.ndarray]:
        """Outlines of what is solid, (points, 2) each: two where there is a bore, one where there is none."""
        if not np.any(self.inner_radius):
            return [self.outline]
        outside, inside = ([self.at_distance(s * r) for s in (+1, -1)] for r in (self.outer_radius, self.inner_radius))
        return [np.concatenate([wall, bore[::-1]]) for wall, bore in zip(outside, inside, strict=True)]


def stations(manipulator: Manipulator) -> np.ndarray:
    """Arc lengths, m: a grid, joints of the body and ends of tendons, and points close to both sides of each."""
    return with_joints(np.linspace(0.0, float(manipulator.length), 201), evaluated(joints, manipulator))


def with_joints(grid: np.ndarray, joints: ArrayLike) -> np.ndarray:
    """A grid of arc lengths with those joints that lie on it, and points close to both sides of each."""
    joints, length = np.asarray(joints, float), grid[-1]
    joints = joints[(joints > 0) & (joints < length)]
    return np.unique(np.concatenate([grid, *(joints + side * 1e-9 * length for side in (-1, 0, 1))]))


def fields_along(equilibrium: Equilibrium, arc_length: np.ndarray) -> Fields:
    """The fields at some arc lengths as NumPy arrays.

    Raises:
        InputError: when the solve failed.
    """
    fields = jax.tree.map(np.asarray, fields_on(equilibrium, arc_length))
    if not np.all(np.isfinite(fields.position)):
        raise InputError("the solve failed, there is no shape to draw; see its result")
    return fields


def reached(manipulator: Manipulator, arc_length: ArrayLike) -> np.ndarray:
    """Which arc lengths each tendon reaches, (tendons, points)."""
    ends = [np.inf if tendon.end is None else float(tendon.end) for tendon in manipulator.tendons]
    return np.asarray(arc_length) <= np.asarray(ends)[:, None]


def bent_body(manipulator: Manipulator, fields: Fields) -> Body:
    """The body in an equilibrium, from the fields along it."""
    return _body(manipulator, np.asarray(fields.arc_length), np.asarray(fields.position), np.asarray(fields.heading))


def straight_body(manipulator: Manipulator, arc_length: np.ndarray, level: float = 0.0) -> Body:
    """The body at rest, its axis at the height `level`, mm."""
    midline = np.stack([arc_length, np.full_like(arc_length, 1e-3 * level)], axis=-1)
    return _body(manipulator, arc_length, midline, 0.0 * arc_length)


def tendon_paths(manipulator: Manipulator, body: Body, arc_length: ArrayLike) -> np.ndarray:
    """The line of each tendon in the plane of a drawn body, mm, (tendons, points, 2); NaN beyond its anchor."""
    side = np.asarray([tendon.side for tendon in manipulator.tendons])[:, None]
    distance = side * 1e3 * evaluated(Manipulator.offset, manipulator, arc_length)
    distance = np.where(reached(manipulator, arc_length), distance, np.nan)
    return np.stack([body.at_distance(d) for d in distance])


def tip_force_line(body: Body, loads: Loads, length: float) -> np.ndarray:
    """The line of an arrow along the tip force, (points, 2), a fifth of a length; no points where there is none.

    It starts at the tip, or ends there: it lies ahead of the body.
    """
    force, ahead = np.asarray(loads.tip_force), np.array([np.cos(body.heading[-1]), np.sin(body.heading[-1])])
    if not np.any(force):
        return np.zeros((0, 2))
    reach = 0.2 * length * force / np.linalg.norm(force)
    start = body.midline[-1] - (reach if reach @ ahead < -1e-9 else 0.0)
    return np.linspace(start, start + reach, 25)


def tip_moment_line(body: Body, loads: Loads, length: float) -> np.ndarray:
    """The line of an arrow around the tip as its moment turns, (points, 2); no points where there is none."""
    moment = float(loads.tip_moment)
    ring = max(1.4 * body.outer_radius[-1], 0.06 * length)
    angles = body.heading[-1] + np.sign(moment) * np.linspace(-0.5, 0.5, 61) * GREATEST_MOMENT_ARC
    line = body.midline[-1] + ring * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return line if moment else line[:0]


def _size(vectors: ArrayLike) -> np.ndarray:
    return np.linalg.norm(vectors, axis=-1)


# values in the unit of their label, (points,) or (tendons, points)
ALONG: dict[str, Callable[[Manipulator, Fields], ArrayLike]] = {
    "tension": lambda _, along: along.tension,
    "curvature": lambda _, along: along.curvature,
    "normal_force": lambda _, along: _size(along.normal_force),
    "friction_force": lambda _, along: _size(along.friction_force),
    "strain": lambda body, along: 100 * np.abs(body.outer_strain(along.arc_length, along.curvature)),
    "heading": lambda _, along: np.degrees(along.heading),
}


def lines_along(manipulator: Manipulator, along: Fields, quantity: str) -> np.ndarray:
    """A quantity in the unit of its label, (lines, points): one line, or one for each tendon up to its anchor."""
    values = np.asarray(ALONG[quantity](manipulator, along))
    return values[None] if values.ndim == 1 else np.where(reached(manipulator, along.arc_length), values, np.nan)


def _body(manipulator: Manipulator, arc_length: np.ndarray, midline: np.ndarray, heading: np.ndarray) -> Body:
    """From m; a body without radii is drawn with the offset of its outermost tendon, solid."""
    if manipulator.has_radii:
        outer, inner = evaluated(Manipulator.radii, manipulator, arc_length)
    else:
        outer = np.max(evaluated(Manipulator.offset, manipulator, arc_length), axis=0)
        inner = 0.0 * outer
    return Body(1e3 * midline, heading, 1e3 * outer, 1e3 * inner)
