"""The bent body to scale, mm: its tendons coloured by tension, loads as arrows, or the forces of its tendons."""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import Equilibrium
from ..units import round_number
from . import style as draw
from .along import draw_along
from .geometry import Body, bent_body, fields_along, reached, stations, straight_body, tendon_paths

GREATEST_MOMENT_ARC = np.radians(190.0)  # it stays clear of the body behind the tip


class _Arrow(NamedTuple):
    """A load as it is drawn."""

    points: np.ndarray
    label: str
    place: np.ndarray  # of the label
    color: str


class _Scene(NamedTuple):
    """What is drawn, in mm and N, along one grid of arc lengths; tendons first."""

    arc_length: np.ndarray
    body: Body
    straight: Body
    tendons: np.ndarray  # (tendons, points, 2), NaN beyond an anchor
    tension: np.ndarray  # the same
    arrows: list[_Arrow]
    gravity: np.ndarray

    @property
    def around(self) -> float:
        """Of the clamp, what lies about the body."""
        return 0.05 * self.arc_length[-1]

    @property
    def extent(self) -> np.ndarray:
        """Corners of all that needs room, (points, 2)."""
        room = self.arc_length[-1] * np.array([0.2, 0.08])
        labels = [arrow.place + sign * room for arrow in self.arrows for sign in (-1, +1)]
        wall = np.array([(-2.5 * self.around, sign * (self.body.outer_radius[0] + self.around)) for sign in (-1, +1)])
        arrows = [arrow.points for arrow in self.arrows]
        return np.concatenate(
            [self.body.outline, self.straight.outline, wall, *arrows, *np.reshape(labels, (-1, 1, 2))]
        )

    def height(self, width: float) -> float:
        """Of a figure whose axes for the body are so wide, in."""
        across, up = np.ptp(self.extent, axis=0)
        return float(np.clip(width * up / across + 0.7, 2.4, 4.2))


def equilibrium_figure(manipulator: Manipulator, equilibrium: Equilibrium, loads: Loads | None = None) -> Figure:
    """Body, tendons and loads on the left, with the tension as colour; tension over arc length on the right.

    Args:
        manipulator: the body that was solved.
        equilibrium: its equilibrium.
        loads: those under which it was solved; None for none.

    Raises:
        InputError: when the solve failed and there is no shape to draw.
    """
    scene = _scene(manipulator, equilibrium, loads)
    with draw.house_style():
        figure = draw.new_figure(draw.DOUBLE_COLUMN, scene.height(3.6))
        shape, tension = figure.subplots(1, 2, width_ratios=(1.5, 1))
        draw_along(manipulator, equilibrium, "tension", tension)
        _draw_scene(shape, scene)
    return figure


def draw_shape(
    manipulator: Manipulator, equilibrium: Equilibrium, loads: Loads | None = None, axes: Axes | None = None
) -> Axes:
    """The bent body to scale, mm: wall, bore, clamp, and tendons coloured by their tension, N.

    The rest shape is dotted; tendons end in a dot where they are anchored, and have numbers where there are several.
    Arrows of loads have one length: their magnitudes are written beside them. Labels are placed where they cover
    nothing in the limits of the moment: draw other things first. The scale of colours stands beside the axes.

    Args:
        manipulator: the body that was solved.
        equilibrium: its equilibrium.
        loads: those under which it was solved; None for none.
        axes: where to draw; None for a new figure, one column wide.

    Raises:
        InputError: when the solve failed and there is no shape to draw.
    """
    scene = _scene(manipulator, equilibrium, loads)
    with draw.axes_or_new(axes, scene.height(2.6)) as axes:
        _draw_scene(axes, scene)
    return axes


# --- what is drawn -------------------------------------------------------------------------------


def _scene(manipulator: Manipulator, equilibrium: Equilibrium, loads: Loads | None) -> _Scene:
    s, loads = stations(manipulator), Loads() if loads is None else loads
    along = fields_along(equilibrium, s)
    body, straight = bent_body(manipulator, along), straight_body(manipulator, s)
    tension = np.where(reached(manipulator, s), along.tension, np.nan)
    arrows, gravity = _arrows(body, 1e3 * s[-1], loads), np.asarray(loads.gravity)
    return _Scene(1e3 * s, body, straight, tendon_paths(manipulator, body, s), tension, arrows, gravity)


def _tension_range(tension: np.ndarray) -> Normalize:
    """From the smallest tension to the largest; from zero where they hardly differ."""
    low, high = float(np.nanmin(tension)), float(np.nanmax(tension))
    return Normalize(low if high - low > 1e-3 * high else 0.0, high or 1.0)


def _arrows(body: Body, length: float, loads: Loads) -> list[_Arrow]:
    """Tip force and tip moment."""
    arrows = []
    tip, heading, radius = body.midline[-1], body.heading[-1], body.outer_radius[-1]
    ahead = np.array([np.cos(heading), np.sin(heading)])
    force, moment = np.asarray(loads.tip_force), float(loads.tip_moment)
    if np.any(force):
        reach = 0.2 * length * force / np.linalg.norm(force)
        ends = (tip, tip + reach) if reach @ ahead >= -1e-9 else (tip - reach, tip)  # clear of the body
        far = ends[1] if ends[0] is tip else ends[0]
        points = np.linspace(*ends, 25)
        arrows.append(_Arrow(points, f"$F$ = {np.linalg.norm(force):.3g} N", far, draw.VERMILION))
    if moment:
        ring = max(1.4 * radius, 0.06 * length)
        angles = heading + np.sign(moment) * np.linspace(-0.5, 0.5, 61) * GREATEST_MOMENT_ARC
        points = tip + ring * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        arrows.append(_Arrow(points, f"$m$ = {abs(moment):.3g} N m", points[30], draw.PURPLE))
    return arrows


# --- the body ------------------------------------------------------------------------------------


def _draw_scene(axes: Axes, scene: _Scene) -> None:
    norm, figure = _tension_range(scene.tension), draw.figure_of(axes)
    _draw_body(axes, scene, norm)
    for arrow in scene.arrows:
        draw.draw_arrow(axes, arrow.points, color=arrow.color)
    axes.update_datalim(scene.extent)
    figure.colorbar(ScalarMappable(norm, draw.TENSION_COLOURS), ax=axes, aspect=35, pad=0.02).ax.set_title("$T$ (N)")
    axes.set(xlabel="$X$ (mm)", ylabel="$Y$ (mm)")
    axes.margins(0.08)
    axes.autoscale_view()
    draw.to_scale(axes)
    figure.draw_without_rendering()  # the limits as they will be
    _write(axes, scene)


def _draw_body(axes: Axes, scene: _Scene, norm: Normalize) -> None:
    axes.plot(*scene.straight.outline.T, color=draw.GREY, linewidth=0.5, linestyle=(0, (1, 2)), zorder=0.5)
    draw.draw_clamp(axes, scene.body.outer_radius[0] + scene.around, scene.around)
    draw.draw_body(axes, scene.body)
    for path, tension in zip(scene.tendons, scene.tension, strict=True):
        draw.draw_coloured_line(axes, path, tension, norm)
        axes.plot(*path[np.isfinite(tension)][-1], "o", color=draw.BLACK, markersize=2.3, zorder=5)


def _write(axes: Axes, scene: _Scene) -> None:
    """Labels, and gravity as a small arrow, where they cover nothing."""
    if len(scene.tendons) > 1:
        _number_tendons(axes, scene)
    body, inner = scene.body, scene.body.inner_radius
    lines = [
        scene.straight.outline,
        body.outline,
        body.midline,
        body.at_distance(inner),
        body.at_distance(-inner),
        *scene.tendons,
    ]
    points = np.concatenate([*lines, *(arrow.points for arrow in scene.arrows), [[0.0, 0.0]]])
    taken = axes.transData.transform(points[np.all(np.isfinite(points), axis=-1)])
    for arrow in scene.arrows:
        taken = draw.place_label(axes, arrow.label, arrow.place, taken)
    if np.any(scene.gravity):
        _draw_gravity(axes, scene.gravity, taken)


def _number_tendons(axes: Axes, scene: _Scene) -> None:
    """The number of each tendon in front of the base; neighbours that are too close share a label."""
    heights = scene.tendons[:, 0, 1]
    millimetres = 9.0 / 72 * scene.arc_length[-1] / 3.0  # about a line of text
    order = np.argsort(-heights, kind="stable")
    groups = np.split(order, np.flatnonzero(-np.diff(heights[order]) > millimetres) + 1)
    for group in groups:
        at = (-0.06 * scene.arc_length[-1], float(np.mean(heights[group])))
        axes.annotate(", ".join(str(i + 1) for i in sorted(group)), at, ha="right", va="center", fontsize=7.5)


def _draw_gravity(axes: Axes, gravity: np.ndarray, taken: np.ndarray) -> None:
    """A small arrow and its label in the emptiest corner of the axes."""
    to_display = axes.transAxes.transform
    there = axes.transAxes.inverted().transform(taken)
    corners = [np.array([x, y]) for y in (0.85, 0.15) for x in (0.86, 0.14)]
    corner = max(corners, key=lambda corner: np.min(np.linalg.norm(there - corner, axis=-1)))
    size = np.linalg.norm(gravity)
    line = to_display(corner) + np.linspace(-15.0, 15.0, 25)[:, None] * gravity / size
    points = axes.transData.inverted().transform(line)
    draw.draw_arrow(axes, points, color=draw.BLACK, linewidth=1.0)
    draw.place_label(axes, f"$g$ = {size:.3g} m/s$^2$", points[12], np.concatenate([taken, line]))


ARROWS = 10  # for each tendon
LONGEST = 1 / 7  # of the body's length
HEIGHT = 2.4  # inches


def draw_force_arrows(manipulator: Manipulator, equilibrium: Equilibrium, axes: Axes | None = None) -> Axes:
    """The bent body to scale, mm, with the normal and friction force of its tendons per length as arrows.

    Both have one scale, told beside the arrows in the corner. The force at which a tendon is anchored is not drawn.

    Args:
        manipulator: the body that was solved.
        equilibrium: its equilibrium.
        axes: where to draw; None for a new figure, one column wide.

    Raises:
        InputError: when the solve failed.
    """
    length = float(manipulator.length)
    places = length * (np.arange(ARROWS) + 0.45) / ARROWS
    s = np.unique(np.concatenate([np.linspace(0.0, length, 201), places]))
    fields, there = fields_along(equilibrium, s), reached(manipulator, s)
    body = bent_body(manipulator, fields)
    tendons = tendon_paths(manipulator, body, s)
    forces = [np.where(there[..., None], force, 0.0) for force in (fields.normal_force, fields.friction_force)]
    with draw.axes_or_new(axes, HEIGHT) as axes:
        draw.draw_body(axes, body)
        for path in tendons:
            axes.plot(*path.T, color=draw.BLACK, linewidth=0.5)
        at = np.searchsorted(s, places)
        points, vectors = tendons[:, at].reshape(-1, 2), [force[:, at].reshape(-1, 2) for force in forces]
        kept = np.all(np.isfinite(points), axis=-1)
        strongest = float(max(np.max(np.linalg.norm(force, axis=-1)) for force in forces))
        _draw_forces(axes, points[kept], [vector[kept] for vector in vectors], strongest, 1e3 * LONGEST * length)
        axes.set(xlabel="$X$ (mm)", ylabel="$Y$ (mm)")
        draw.to_scale(axes)
    return axes


def _draw_forces(axes: Axes, points: np.ndarray, forces: list[np.ndarray], strongest: float, longest: float) -> None:
    """Arrows of both kinds, the strongest `longest` mm long, and what an arrow stands for; none without any force."""
    if not strongest > 0:
        return
    key, below = round_number(strongest), float(axes.dataLim.y0 + axes.dataLim.y1) < 0
    looks = (("normal", draw.BLUE), ("friction", draw.VERMILION))
    for (name, color), force, height in zip(looks, forces, (0.13, 0.05) if below else (0.95, 0.87), strict=True):
        arrows = draw.draw_arrows(axes, points, force, strongest / longest, color=color)
        label = f"{name} force, {key:g} N/m"
        axes.quiverkey(arrows, 0.17, height, key, label, labelpos="E", color=color)
