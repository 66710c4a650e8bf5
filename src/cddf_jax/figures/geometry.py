"""The arrays that figures and the explorer draw: outline of a body, tendons, fields along it. No Matplotlib here.

All places have three coordinates, mm. A body in the plane lies at Z = 0.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike

from ..errors import InputError
from ..mechanics.fields import AnyFields, SpatialFields
from ..numerics.arrays import evaluated
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..robot.validation import joints
from ..statics.equilibrium import Equilibrium

AROUND = 32  # points around a cross-section
ELEVATION, AZIMUTH = 24.0, -58.0  # deg, from where a body in space is seen
MOMENT_ARC = np.radians(190.0)  # in the plane it stays clear of the body behind the tip


class Body(NamedTuple):
    """A body as it is drawn, points along it first."""

    midline: np.ndarray  # (points, 3)
    frame: np.ndarray  # (points, 3, 3), whose columns are the axes of the cross-sections, x along the axis
    outer_radius: np.ndarray
    inner_radius: np.ndarray

    def at_distance(self, distance: ArrayLike) -> np.ndarray:
        """The line at a signed distance from the midline along the axes y, in the plane on the left, (points, 3)."""
        return self.midline + np.asarray(distance)[..., None] * self.frame[:, :, 1]

    @property
    def outline(self) -> np.ndarray:
        """The outer surface in the plane, up one side and back on the other, (2 points, 2)."""
        sides = self.at_distance(self.outer_radius), self.at_distance(-self.outer_radius)[::-1]
        return np.concatenate(sides)[:, :2]

    @property
    def walls(self) -> list[np.ndarray]:
        """Outlines in the plane of what is solid, (points, 2) each: two where there is a bore, else one."""
        if not np.any(self.inner_radius):
            return [self.outline]
        pairs = [(self.at_distance(s * self.outer_radius), self.at_distance(s * self.inner_radius)) for s in (+1, -1)]
        return [np.concatenate([wall, bore[::-1]])[:, :2] for wall, bore in pairs]

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
    """What is drawn of an equilibrium, mm."""

    body: Body
    straight: Body
    tendons: np.ndarray  # (tendons, points, 3), NaN beyond the anchor
    tension: np.ndarray  # N, (tendons, points), NaN there too
    loads: Loads  # with three components
    in_space: bool

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
    def anchors(self) -> np.ndarray:
        """Where the tendons end, (tendons, 3)."""
        return np.stack([path[np.isfinite(path[:, 0])][-1] for path in self.tendons])

    @property
    def force_arrows(self) -> list[np.ndarray]:
        """Start and end of an arrow along each force, (2, 3), a fifth of the length, ahead of the body."""
        arrows = []
        for i, force, _ in self.acting:
            if np.any(force):
                at, reach = self.body.midline[i], 0.2 * self.length * force / np.linalg.norm(force)
                ahead = reach @ self.body.frame[i, :, 0] > -1e-9 * self.length
                arrows.append(np.stack([at, at + reach] if ahead else [at - reach, at]))
        return arrows

    @property
    def moment_arrows(self) -> list[np.ndarray]:
        """An arc ahead of the body, or around it, as each moment turns, (points, 3)."""
        arcs = []
        for i, _, moment in self.acting:
            if np.any(moment):
                about = moment / np.linalg.norm(moment)
                axes = self.body.frame[i].T
                across = axes - np.outer(axes @ about, about)
                middle = across[0] if np.linalg.norm(across[0]) > 0.1 else across[1]  # it may turn about the axis
                middle = middle / np.linalg.norm(middle)
                ring = max(1.4 * self.body.outer_radius[i], 0.06 * self.length)
                angles = MOMENT_ARC * np.linspace(-0.5, 0.5, 61)[:, None]
                around = np.cos(angles) * middle + np.sin(angles) * np.cross(about, middle)
                arcs.append(self.body.midline[i] + ring * around)
        return arcs

    @property
    def acting(self) -> list[tuple[int, np.ndarray, np.ndarray]]:
        """Forces and moments with the indices of their arc lengths: at the tip and at points."""
        s, points = self.straight.midline[:, 0], self.loads.points
        places = [-1, *(int(np.argmin(np.abs(s - 1e3 * float(point.arc_length)))) for point in points)]
        forces = [self.loads.tip_force, *(point.force for point in points)]
        moments = [self.loads.tip_moment, *(point.moment for point in points)]
        return list(zip(places, map(np.asarray, forces), map(np.asarray, moments), strict=True))

    @property
    def points(self) -> np.ndarray:
        """All that must be seen, (points, 3)."""
        side = self.plate * np.array([[0.0, y, z] for y in (-1, 1) for z in (-1, 1)])
        parts = [side, self.body.rings, self.straight.rings, self.tendons, *self.force_arrows, *self.moment_arrows]
        points = np.concatenate([part.reshape(-1, 3) for part in parts])
        return points[np.all(np.isfinite(points), axis=1)]


def stations(manipulator: Manipulator) -> np.ndarray:
    """Arc lengths, m: a grid, joints of the body and ends of tendons, and points close to both sides of each."""
    length, found = float(manipulator.length), np.asarray(evaluated(joints, manipulator), float)
    inside = found[(found > 0) & (found < length)]
    return np.unique([*np.linspace(0.0, length, 201), *inside, *(inside - 1e-9 * length), *(inside + 1e-9 * length)])


def fields_along(equilibrium: Equilibrium, arc_length: np.ndarray) -> AnyFields:
    """The fields at some arc lengths as NumPy arrays; a solve that failed is refused."""
    fields = evaluated(Equilibrium.at, equilibrium, arc_length)
    if not np.all(np.isfinite(fields.position)):
        raise InputError("the solve failed, there is no shape to draw; see its status")
    return fields


def reached(manipulator: Manipulator, arc_length: ArrayLike) -> np.ndarray:
    """Which arc lengths each tendon reaches, (tendons, points)."""
    ends = [np.inf if tendon.end is None else float(tendon.end) for tendon in manipulator.tendons]
    return np.asarray(arc_length) <= np.asarray(ends)[:, None]


def straight_body(manipulator: Manipulator, arc_length: np.ndarray) -> Body:
    """The body at rest along X; one without radii is drawn with the offset of its outermost tendon, solid."""
    if manipulator.has_radii:
        outer, inner = evaluated(Manipulator.radii, manipulator, arc_length)
    else:
        outer = np.max(evaluated(Manipulator.offset, manipulator, arc_length), axis=0)
        inner = 0.0 * outer
    midline, frame = np.outer(1e3 * arc_length, [1.0, 0.0, 0.0]), np.tile(np.eye(3), (len(arc_length), 1, 1))
    return Body(midline, frame, 1e3 * outer, 1e3 * inner)


def drawn(manipulator: Manipulator, along: AnyFields, loads: Loads | None = None) -> Drawn:
    """The body, tendons and loads to draw, from the fields along a body."""
    s = np.asarray(along.arc_length)
    straight, there = straight_body(manipulator, s), reached(manipulator, s)
    if isinstance(along, SpatialFields):
        position, frame = along.position, along.frame
    else:
        x, y, none = np.cos(along.heading), np.sin(along.heading), 0.0 * s
        position = np.pad(along.position, ((0, 0), (0, 1)))
        frame = np.moveaxis(np.array([[x, -y, none], [y, x, none], [none, none, none + 1]]), 2, 0)
    body = straight._replace(midline=1e3 * np.asarray(position), frame=np.asarray(frame))
    acting = (Loads() if loads is None else loads).with_components(3)
    arms = 1e3 * evaluated(Manipulator.arms, manipulator, s)
    paths = body.midline + np.einsum("pij,tpj->tpi", body.frame, arms)
    paths, tension = np.where(there[..., None], paths, np.nan), np.where(there, along.tension, np.nan)
    return Drawn(body, straight, paths, tension, acting, isinstance(along, SpatialFields))


def bent_body(manipulator: Manipulator, equilibrium: Equilibrium, loads: Loads | None = None) -> Drawn:
    """The body, tendons and loads to draw of an equilibrium; a solve that failed is refused."""
    return drawn(manipulator, fields_along(equilibrium, stations(manipulator)), loads)


# --- fields along it -----------------------------------------------------------------------------


def _size(vectors: ArrayLike) -> np.ndarray:
    return np.linalg.norm(vectors, axis=-1)


def _angles(manipulator: Manipulator, arc_length: ArrayLike) -> np.ndarray:
    return np.array([t.angle(arc_length) for t in manipulator.with_angles().tendons if t.angle is not None])


# values in the unit of their label, (points,) or (tendons, points)
ALONG: dict[str, Callable[[Manipulator, AnyFields], ArrayLike]] = {
    "tension": lambda _, along: along.tension,
    "curvature": lambda _, along: np.transpose(along.curvature),  # in space (3, points)
    "bending": lambda _, along: np.abs(along.bend()),
    "twist": lambda _, along: along.twist if isinstance(along, SpatialFields) else 0.0 * along.curvature,
    "normal_force": lambda _, along: _size(along.normal_force),
    "friction_force": lambda _, along: _size(along.friction_force),
    "strain": lambda body, along: 100 * np.abs(body.outer_strain(along.arc_length, along.bend())),
    "heading": lambda _, along: np.degrees(along.tilt()),
    "outer_radius": lambda body, along: 1e3 * np.asarray(body.radii(along.arc_length)[0]),
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
    if quantity == "curvature" or values.ndim == 1:
        return np.atleast_2d(values)
    return np.where(reached(manipulator, along.arc_length), values, np.nan)


def _circle(count: int) -> np.ndarray:
    """A closed circle of points around the axis x, (count, 3)."""
    angles = np.linspace(0.0, 2 * np.pi, count)
    return np.stack([0.0 * angles, np.cos(angles), np.sin(angles)], axis=-1)
