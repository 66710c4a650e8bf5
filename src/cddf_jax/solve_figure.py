"""The figure of one equilibrium: the bent body to scale with what acts on it, and the tension along each tendon."""

from itertools import cycle
from typing import NamedTuple

import equinox as eqx
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from . import plotting as draw
from .equilibrium import Equilibrium
from .loads import Loads
from .manipulator import Manipulator

MARKERS = ("", "o", "s", "^", "D", "v", "x")  # one for each round through the dash patterns
GREATEST_MOMENT_ARC = np.radians(190.0)  # it stays clear of the body behind the tip

_fields_at = eqx.filter_jit(lambda equilibrium, arc_length: equilibrium.at(arc_length))


class _Drawn(NamedTuple):
    """What is drawn, in mm and N, along one grid of arc lengths; tendons first."""

    arc_length: np.ndarray
    body: draw.Body
    straight: draw.Body
    tendons: np.ndarray  # (tendons, points, 2), NaN beyond an anchor
    tension: np.ndarray  # the same


class _Arrow(NamedTuple):
    """A load as it is drawn."""

    points: np.ndarray
    label: str
    place: np.ndarray  # of the label
    color: str


def equilibrium_figure(manipulator: Manipulator, equilibrium: Equilibrium, loads: Loads | None = None) -> Figure:
    """Body, tendons and loads on the left, with the tension as colour; tension over arc length on the right.

    The rest shape is dotted; tendons end in a dot where they are anchored. Arrows of loads have one length: their
    magnitudes are written beside them.

    Args:
        manipulator: the body that was solved.
        equilibrium: its equilibrium.
        loads: those under which it was solved; None for none.

    Raises:
        ValueError: when the solve failed and there is no shape to draw.
    """
    drawn, loads = _along(manipulator, equilibrium), Loads() if loads is None else loads
    norm = _tension_range(drawn.tension)
    arrows = _arrows(drawn, loads)
    with draw.house_style():
        figure = draw.new_figure(draw.DOUBLE_COLUMN, 3.0)
        shape, tension = figure.subplots(1, 2, width_ratios=(1.5, 1))
        _draw_shape(shape, drawn, norm)
        for arrow in arrows:
            draw.draw_arrow(shape, arrow.points, color=arrow.color)
            room = drawn.arc_length[-1] * np.array([0.2, 0.08])
            shape.update_datalim([arrow.place - room, arrow.place + room])
        colours = ScalarMappable(norm, draw.TENSION_COLOURS)
        figure.colorbar(colours, ax=shape, aspect=35, pad=0.02).ax.set_title("$T$ (N)")
        _draw_tension(tension, drawn)
        _fit(figure, shape)
        _write(shape, drawn, arrows, np.asarray(loads.gravity))
    return figure


def _fit(figure: Figure, shape: Axes) -> None:
    """The figure as high as the shape needs, and the limits of all axes as they will be."""
    shape.set(xlabel="$X$ (mm)", ylabel="$Y$ (mm)")
    shape.margins(0.08)
    shape.autoscale_view()
    shape.set_aspect("equal", adjustable="datalim")
    figure.set_figheight(float(np.clip(3.6 * shape.dataLim.height / shape.dataLim.width + 0.7, 2.4, 4.2)))
    figure.draw_without_rendering()


# --- what is drawn -------------------------------------------------------------------------------


def _along(manipulator: Manipulator, equilibrium: Equilibrium) -> _Drawn:
    s = stations(manipulator)
    along = _fields_at(equilibrium, s)
    outer, inner = (1e3 * np.asarray(radius(s)) for radius in (manipulator.outer_radius, manipulator.inner_radius))
    position, heading = 1e3 * np.asarray(along.position), np.asarray(along.heading)
    if not np.all(np.isfinite(position)):
        raise ValueError("equilibrium_figure: the solve failed, there is no shape to draw; see its result")
    body = draw.Body(position, heading, outer, inner)
    straight = draw.Body(np.stack([1e3 * s, 0.0 * s], axis=-1), 0.0 * s, outer, inner)
    end = [np.inf if tendon.end is None else float(tendon.end) for tendon in manipulator.tendons]
    there = s <= np.asarray(end)[:, None]
    side = np.asarray([tendon.side for tendon in manipulator.tendons])[:, None]
    distance = np.where(there, side * 1e3 * np.asarray(manipulator.offset(s)), np.nan)
    tendons = np.stack([body.at_distance(d) for d in distance])
    return _Drawn(1e3 * s, body, straight, tendons, np.where(there, np.asarray(along.tension), np.nan))


def stations(manipulator: Manipulator) -> np.ndarray:
    """Arc lengths: a grid, the joints of the body and the ends of tendons, and a point just behind each."""
    length = float(manipulator.length)
    joints = np.asarray(manipulator.breakpoints, float)
    joints = joints[(joints > 0) & (joints < length)]
    return np.unique(np.concatenate([np.linspace(0.0, length, 201), joints, joints + 1e-9 * length]))


def _tension_range(tension: np.ndarray) -> Normalize:
    """From the smallest tension to the largest; from zero where they hardly differ."""
    low, high = float(np.nanmin(tension)), float(np.nanmax(tension))
    return Normalize(low if high - low > 1e-3 * high else 0.0, high or 1.0)


def _arrows(drawn: _Drawn, loads: Loads) -> list[_Arrow]:
    """Tip force and tip moment."""
    arrows = []
    tip, heading, radius = drawn.body.midline[-1], drawn.body.heading[-1], drawn.body.outer_radius[-1]
    ahead = np.array([np.cos(heading), np.sin(heading)])
    force, moment = np.asarray(loads.tip_force), float(loads.tip_moment)
    if np.any(force):
        reach = 0.2 * drawn.arc_length[-1] * force / np.linalg.norm(force)
        ends = (tip, tip + reach) if reach @ ahead >= -1e-9 else (tip - reach, tip)  # clear of the body
        far = ends[1] if ends[0] is tip else ends[0]
        points = np.linspace(*ends, 25)
        arrows.append(_Arrow(points, f"$F$ = {np.linalg.norm(force):.3g} N", far, draw.VERMILION))
    if moment:
        ring = max(1.4 * radius, 0.06 * drawn.arc_length[-1])
        angles = heading + np.sign(moment) * np.linspace(-0.5, 0.5, 61) * GREATEST_MOMENT_ARC
        points = tip + ring * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        arrows.append(_Arrow(points, f"$m$ = {abs(moment):.3g} N m", points[30], draw.PURPLE))
    return arrows


# --- the body ------------------------------------------------------------------------------------


def _draw_shape(axes: Axes, drawn: _Drawn, norm: Normalize) -> None:
    around = 0.05 * drawn.arc_length[-1]
    axes.plot(*drawn.straight.outline.T, color=draw.GREY, linewidth=0.5, linestyle=(0, (1, 2)), zorder=0.5)
    draw.draw_clamp(axes, drawn.body.outer_radius[0] + around, around)
    draw.draw_body(axes, drawn.body)
    for path, tension in zip(drawn.tendons, drawn.tension, strict=True):
        draw.draw_coloured_line(axes, path, tension, norm)
        axes.plot(*path[np.isfinite(tension)][-1], "o", color=draw.BLACK, markersize=2.3, zorder=5)
    axes.update_datalim([(-2.5 * around, 0.0)])


def _write(axes: Axes, drawn: _Drawn, arrows: list[_Arrow], gravity: np.ndarray) -> None:
    """Labels, and gravity as a small arrow, where they cover nothing."""
    if len(drawn.tendons) > 1:
        _number_tendons(axes, drawn)
    body, inner = drawn.body, drawn.body.inner_radius
    lines = [
        drawn.straight.outline,
        body.outline,
        body.midline,
        body.at_distance(inner),
        body.at_distance(-inner),
        *drawn.tendons,
    ]
    points = np.concatenate([*lines, *(arrow.points for arrow in arrows), [[0.0, 0.0]]])
    taken = axes.transData.transform(points[np.all(np.isfinite(points), axis=-1)])
    for arrow in arrows:
        taken = draw.place_label(axes, arrow.label, arrow.place, taken)
    if np.any(gravity):
        _draw_gravity(axes, gravity, taken)


def _number_tendons(axes: Axes, drawn: _Drawn) -> None:
    """The number of each tendon in front of the base; neighbours that are too close share a label."""
    heights = drawn.tendons[:, 0, 1]
    millimetres = 9.0 / 72 * drawn.arc_length[-1] / 3.0  # about a line of text
    order = np.argsort(-heights, kind="stable")
    groups = np.split(order, np.flatnonzero(-np.diff(heights[order]) > millimetres) + 1)
    for group in groups:
        at = (-0.06 * drawn.arc_length[-1], float(np.mean(heights[group])))
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


# --- tension over arc length ---------------------------------------------------------------------


def _draw_tension(axes: Axes, drawn: _Drawn) -> None:
    """One line per tendon, told apart by dashes, when these are used up by markers, and by numbers at their ends."""
    count, dashes = len(drawn.tension), cycle([style["linestyle"] for style in draw.CURVES])
    for i, (values, dash) in enumerate(zip(drawn.tension, dashes, strict=False)):
        marker = MARKERS[i // len(draw.CURVES) % len(MARKERS)]
        look = {"color": draw.BLACK, "linestyle": dash, "marker": marker, "markevery": 25, "markerfacecolor": "white"}
        axes.plot(drawn.arc_length, values, label=f"tendon {i + 1}", **look)
        if count > 1:
            last = np.flatnonzero(np.isfinite(values))[-1]
            at = (drawn.arc_length[last], values[last])
            box = {"facecolor": "white", "edgecolor": "none", "pad": 0.4}
            axes.annotate(str(i + 1), at, (3, 0), textcoords="offset points", va="center", fontsize=7.5, bbox=box)
    axes.set(xlabel="Arc length $s$ (mm)", ylabel="Tension $T$ (N)")
    axes.set_xlim(0.0, drawn.arc_length[-1] * (1.06 if count > 1 else 1.0))
    axes.set_ylim(0.0, 1.05 * (np.nanmax(drawn.tension) or 1.0))
    if count > 1:
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=min(count, 3), columnspacing=1.2, borderpad=0.0)
