"""The arrays that figures and the explorer draw: outline of a body, tendons, fields along it. No Matplotlib here."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike

from ..errors import InputError
from ..mechanics.fields import AnyFields, Fields, SpatialFields, in_the_plane
from ..numerics.arrays import evaluated
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..robot.validation import joints
from ..statics.equilibrium import Equilibrium

AROUND = 32  # points around a cross-section
ELEVATION, AZIMUTH = 24.0, -58.0  # deg, from where a body in space is seen
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


class SpatialBody(NamedTuple):
    """A bent body in space as it is drawn: lengths in mm, points along the body first."""

    midline: np.ndarray  # (points, 3)
    frame: np.ndarray  # (points, 3, 3), whose columns are the axes of the cross-sections
    outer_radius: np.ndarray

    @property
    def rings(self) -> np.ndarray:
        """The outer surface, closed around each cross-section, (points, around, 3)."""
        across = np.swapaxes(self.frame @ _circle(AROUND + 1).T, 1, 2)
        return self.midline[:, None] + self.outer_radius[:, None, None] * across

    def is_hidden(self, tendon: np.ndarray, sight: np.ndarray) -> np.ndarray:
        """Where the body hides a line along it, (points, 3), seen from the direction `sight`."""
        arm = tendon - self.midline
        aside = np.linalg.norm(np.cross(arm, sight / np.linalg.norm(sight)), axis=-1)
        return (arm @ sight < 0) & (aside < self.outer_radius)  # behind the midline, and not beside the body


class Drawn(NamedTuple):
    """What is drawn of an equilibrium in space, mm."""

    body: SpatialBody
    straight: SpatialBody
    tendons: np.ndarray  # (tendons, points, 3), NaN beyond the anchor
    tension: np.ndarray  # N, (tendons, points), NaN there too
    loads: Loads

    @property
    def length(self) -> float:
        return float(self.straight.midline[-1, 0])

    @property
    def plate(self) -> float:
        """The radius of the plate to which the body is clamped."""
        return 1.35 * float(max(self.body.outer_radius[0], np.max(np.linalg.norm(self.tendons[:, 0], axis=-1))))

    @property
    def plate_edge(self) -> np.ndarray:
        """Around that plate, (points, 3)."""
        return self.plate * _circle(61)

    @property
    def force_arrows(self) -> list[np.ndarray]:
        """Start and end of an arrow along each force, (2, 3), a fifth of the length: at the tip and at points."""
        arrows = []
        for i, force, _ in _acting(self.loads, self.straight.midline[:, 0]):
            if np.any(force):
                at, reach = self.body.midline[i], 0.2 * self.length * force / np.linalg.norm(force)
                ahead = reach @ self.body.frame[i, :, 0] > -1e-9 * self.length
                arrows.append(np.stack([at, at + reach] if ahead else [at - reach, at]))
        return arrows

    @property
    def moment_arrows(self) -> list[np.ndarray]:
        """An arc around the body as each moment turns, (points, 3): at the tip and at points."""
        arcs, angles = [], np.linspace(0.0, 1.5 * np.pi, 61)[:, None]
        for i, _, moment in _acting(self.loads, self.straight.midline[:, 0]):
            if np.any(moment):
                about = moment / np.linalg.norm(moment)
                start = np.cross(about, np.eye(3)[np.argmin(np.abs(about))])
                start /= np.linalg.norm(start)
                ring = max(1.4 * self.body.outer_radius[i], 8.0)
                around = np.cos(angles) * start + np.sin(angles) * np.cross(about, start)
                arcs.append(self.body.midline[i] + ring * around)
        return arcs

    @property
    def points(self) -> np.ndarray:
        """All that must be seen, (points, 3)."""
        side = self.plate * np.array([[0.0, y, z] for y in (-1, 1) for z in (-1, 1)])
        parts = [side, self.body.rings, self.straight.rings, self.tendons, *self.force_arrows, *self.moment_arrows]
        points = np.concatenate([part.reshape(-1, 3) for part in parts])
        return points[np.all(np.isfinite(points), axis=1)]


def stations(manipulator: Manipulator) -> np.ndarray:
    """Arc lengths, m: a grid, joints of the body and ends of tendons, and points close to both sides of each."""
    return with_joints(np.linspace(0.0, float(manipulator.length), 201), evaluated(joints, manipulator))


def with_joints(grid: np.ndarray, joints: ArrayLike) -> np.ndarray:
    """A grid of arc lengths with those joints that lie on it, and points close to both sides of each."""
    joints, length = np.asarray(joints, float), grid[-1]
    joints = joints[(joints > 0) & (joints < length)]
    return np.unique(np.concatenate([grid, *(joints + side * 1e-9 * length for side in (-1, 0, 1))]))


def fields_along(equilibrium: Equilibrium, arc_length: np.ndarray) -> AnyFields:
    """The fields at some arc lengths as NumPy arrays; a solve that failed is refused."""
    fields = evaluated(Equilibrium.at, equilibrium, arc_length)
    if not np.all(np.isfinite(fields.position)):
        raise InputError("the solve failed, there is no shape to draw; see its status")
    return fields


def planar_fields_along(equilibrium: Equilibrium, arc_length: np.ndarray) -> Fields:
    """The same for a body in the plane."""
    return in_the_plane(fields_along(equilibrium, arc_length), "figures")


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


def drawn(manipulator: Manipulator, along: AnyFields, loads: Loads | None) -> Drawn:
    """The body, tendons and loads to draw, from the fields along a body in space; the plane is refused."""
    if not isinstance(along, SpatialFields):
        raise InputError("figures: the body is in the plane; draw_shape draws it")
    s = np.asarray(along.arc_length)
    there, outer = reached(manipulator, s), 1e3 * _radii(manipulator, s)[0]
    return Drawn(
        body=SpatialBody(1e3 * np.asarray(along.position), np.asarray(along.frame), outer),
        straight=SpatialBody(np.outer(1e3 * s, [1.0, 0.0, 0.0]), np.tile(np.eye(3), (len(s), 1, 1)), outer),
        tendons=np.where(there[..., None], 1e3 * np.asarray(along.path), np.nan),
        tension=np.where(there, along.tension, np.nan),
        loads=(Loads() if loads is None else loads).with_components(3),
    )


def tendon_paths(manipulator: Manipulator, body: Body, arc_length: ArrayLike) -> np.ndarray:
    """The line of each tendon in the plane of a drawn body, mm, (tendons, points, 2); NaN beyond its anchor."""
    side = np.asarray([tendon.side for tendon in manipulator.tendons])[:, None]
    distance = side * 1e3 * evaluated(Manipulator.offset, manipulator, arc_length)
    distance = np.where(reached(manipulator, arc_length), distance, np.nan)
    return np.stack([body.at_distance(d) for d in distance])


def _acting(loads: Loads, arc_length: np.ndarray) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Where forces and moments act, as indices of arc lengths, mm: at the tip and at points."""
    tip = arc_length.size - 1, np.asarray(loads.tip_force), np.asarray(loads.tip_moment)
    places = [int(np.argmin(np.abs(arc_length - 1e3 * float(point.arc_length)))) for point in loads.points]
    own = [(np.asarray(point.force), np.asarray(point.moment)) for point in loads.points]
    return [tip, *((i, *both) for i, both in zip(places, own, strict=True))]


def _acting_in_plane(body: Body, loads: Loads) -> list[tuple[int, np.ndarray, np.ndarray]]:
    steps = np.linalg.norm(np.diff(body.midline, axis=0), axis=1)
    return _acting(loads, np.append(0.0, np.cumsum(steps)))


def force_lines(body: Body, loads: Loads, length: float) -> list[np.ndarray]:
    """The lines of arrows along the forces, (points, 2), a fifth of a length, mm: at the tip and at points.

    Each starts where its force acts, or ends there: it lies ahead of the body.
    """
    lines = []
    for i, force, _ in _acting_in_plane(body, loads):
        if np.any(force):
            ahead = np.array([np.cos(body.heading[i]), np.sin(body.heading[i])])
            reach = 0.2 * length * force / np.linalg.norm(force)
            start = body.midline[i] - (reach if reach @ ahead < -1e-9 else 0.0)
            lines.append(np.linspace(start, start + reach, 25))
    return lines


def moment_lines(body: Body, loads: Loads, length: float) -> list[np.ndarray]:
    """The lines of arrows around the body as the moments turn, (points, 2), mm: at the tip and at points."""
    lines = []
    for i, _, moment in _acting_in_plane(body, loads):
        if np.any(moment):
            ring = max(1.4 * body.outer_radius[i], 0.06 * length)
            angles = body.heading[i] + np.sign(moment) * np.linspace(-0.5, 0.5, 61) * GREATEST_MOMENT_ARC
            lines.append(body.midline[i] + ring * np.stack([np.cos(angles), np.sin(angles)], axis=-1))
    return lines


def _radii(manipulator: Manipulator, arc_length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Outer and inner radius, m; a body without radii is drawn with the offset of its outermost tendon, solid."""
    if manipulator.has_radii:
        return evaluated(Manipulator.radii, manipulator, arc_length)
    outer = np.max(evaluated(Manipulator.offset, manipulator, arc_length), axis=0)
    return outer, 0.0 * outer


def _circle(count: int) -> np.ndarray:
    """A closed circle of points around the axis x, (count, 3)."""
    angles = np.linspace(0.0, 2 * np.pi, count)
    return np.stack([0.0 * angles, np.cos(angles), np.sin(angles)], axis=-1)


def _size(vectors: ArrayLike) -> np.ndarray:
    return np.linalg.norm(vectors, axis=-1)


def _bent(along: AnyFields) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
    """Size of the bending, twist, and heading: in space the angle between the axes of cross-section and base."""
    if isinstance(along, Fields):
        return np.abs(along.curvature), np.zeros_like(along.curvature), along.heading
    return _size(along.curvature[..., 1:]), along.twist, np.arccos(np.clip(along.frame[..., 0, 0], -1.0, 1.0))


def _angles(manipulator: Manipulator, arc_length: ArrayLike) -> np.ndarray:
    return np.array([t.angle(arc_length) for t in manipulator.with_angles().tendons if t.angle is not None])


# values in the unit of their label, (points,) or (tendons, points)
ALONG: dict[str, Callable[[Manipulator, AnyFields], ArrayLike]] = {
    "tension": lambda _, along: along.tension,
    "curvature": lambda _, along: np.transpose(along.curvature),  # in space (3, points)
    "bending": lambda _, along: _bent(along)[0],
    "twist": lambda _, along: _bent(along)[1],
    "normal_force": lambda _, along: _size(along.normal_force),
    "friction_force": lambda _, along: _size(along.friction_force),
    "strain": lambda body, along: 100 * np.abs(body.outer_strain(along.arc_length, _bent(along)[0])),
    "heading": lambda _, along: np.degrees(_bent(along)[2]),
    "offset": lambda body, along: 1e3 * np.asarray(body.offset(along.arc_length)),
    "angle": lambda body, along: np.degrees(_angles(body, along.arc_length)),
}
BENDING = ("twist, $x$", "bending, $y$", "bending, $z$")


def lines_along(manipulator: Manipulator, along: AnyFields, quantity: str) -> np.ndarray:
    """A quantity in the unit of its label, (lines, points): one line, or one for each tendon up to its anchor.

    The curvature in space has three lines.
    """
    if quantity not in ALONG:
        raise InputError(f"figures: quantity must be one of {', '.join(ALONG)}, got {quantity!r}")
    if quantity == "strain" and manipulator.extensible:
        raise InputError("figures: the strain along an axis that stretches is not known; see peak_strain")
    values = np.asarray(ALONG[quantity](manipulator, along))
    if quantity == "curvature" and values.ndim == 2:
        return values
    return values[None] if values.ndim == 1 else np.where(reached(manipulator, along.arc_length), values, np.nan)


def _body(manipulator: Manipulator, arc_length: np.ndarray, midline: np.ndarray, heading: np.ndarray) -> Body:
    """A body to draw, mm, from arc lengths and points of the midline, m."""
    outer, inner = _radii(manipulator, arc_length)
    return Body(1e3 * midline, heading, 1e3 * outer, 1e3 * inner)
