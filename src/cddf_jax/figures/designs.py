"""Figures of a design: the body before and after, to scale; and the trade-off between two objectives."""

import re
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..designing.pareto import ParetoFront
from ..designing.results import Design
from ..robot.manipulator import Manipulator
from ..units import preferred
from . import geometry, looks, space, style as draw
from .along import draw_along
from .geometry import Drawn

START: dict[str, Any] = {"color": looks.GREY, "linestyle": (0, (4, 2)), "label": "before"}
END: dict[str, Any] = {"color": looks.BLUE, "linestyle": "-", "label": "after"}
HEIGHT, FRONT_HEIGHT = 3.5, 2.6  # inches
NOTHING = 1e-9  # 1/m, a curvature
LINE = 0.07  # of the length of the body: the height of a line of text


def design_figure(design: Design) -> Figure:
    """On the left the straight bodies before and after, and the designed body bent; on the right curvature and strain.

    The first load case is drawn. Walls and tendons are to scale, one scale for all three bodies. There is no strain
    where the bodies have no radii.

    In space: on the left the designed body bent, as `draw_design` draws it; on the right angle and offset of the
    tendons, bending and twist, along both bodies.
    """
    if design.equilibria[0].in_space:
        return _spatial_figure(design)
    with draw.house_style():
        figure = draw.new_figure(draw.DOUBLE_COLUMN, 3.4)
        grid = figure.add_gridspec(2, 2, width_ratios=(1.45, 1))
        draw_design(design, figure.add_subplot(grid[:, 0]))
        has_wall = design.manipulator.has_radii
        curvature = figure.add_subplot(grid[0, 1] if has_wall else grid[:, 1])
        _draw_before_and_after(design, "curvature", curvature)
        curvature.legend(loc="best")
        if has_wall:
            _draw_before_and_after(design, "strain", figure.add_subplot(grid[1, 1]))
            curvature.set_xlabel("")
            curvature.tick_params(labelbottom=False)
    return figure


def _draw_before_and_after(design: Design, quantity: str, axes: Axes) -> None:
    draw_along(design.start, design.equilibria_at_start[0], quantity, axes, **START)
    draw_along(design.manipulator, design.equilibria[0], quantity, axes, **END)


def draw_design(design: Design, axes: Axes | None = None) -> Axes:
    """The straight bodies before and after, and the designed body bent in its first load case; to one scale, mm.

    Outer and inner diameters at both ends are written beside the straight bodies that have radii. The bent body at the
    start of the search is dashed.

    In space only the designed body is drawn, in three dimensions; the axis of the bent start is dashed.

    Args:
        design: of `design`.
        axes: where to draw, in space with projection="3d"; None for a new figure, one column wide.

    Raises:
        InputError: for axes of the wrong kind.
    """
    if design.equilibria[0].in_space:
        after, old = _drawn(design)
        return space.draw_spatial_shape(after, axes, old)
    before, after = design.start, design.manipulator
    s, line = geometry.stations(after), LINE * 1e3 * float(after.length)
    bent = geometry.bent_body(after, geometry.planar_fields_along(design.equilibria[0], s))
    paths = geometry.tendon_paths(after, bent, s)
    fields = geometry.planar_fields_along(design.equilibria_at_start[0], geometry.stations(before))
    old = geometry.bent_body(before, fields)
    with draw.axes_or_new(axes, HEIGHT) as axes:
        draw.draw_body(axes, bent)
        axes.plot(*old.outline.T, color=looks.GREY, linewidth=0.6, linestyle=(0, (4, 2)))
        axes.plot(*bent.outline.T, color=looks.BLUE, linewidth=0.7)
        for path in paths:
            axes.plot(*path.T, color=looks.BLACK, linewidth=0.6)
        top = float(axes.dataLim.y1)
        level = _draw_straight(axes, after, "after", top, line)
        numbers = " (numbers: outer/inner diameter, mm)" if before.has_radii else ""
        _draw_straight(axes, before, f"before{numbers}", level, line)
        draw.draw_clamp(axes, 1.2 * max(bent.outer_radius[0], np.max(np.abs(paths[:, 0, 1]))), 0.6 * line)
        axes.set(xlabel="$X$ (mm)", ylabel="$Y$ (mm)")
        draw.to_scale(axes)
        axes.autoscale_view()
        bottom = axes.get_ylim()[0]  # ticks beyond it would move it
        axes.set_yticks([tick for tick in axes.get_yticks() if bottom <= tick <= top + 1e-9])
    return axes


def _spatial_figure(design: Design) -> Figure:
    """The designed body in three dimensions; beside it the routing of both bodies, and how they bend and twist."""
    after, old = _drawn(design)
    with draw.house_style():
        figure = draw.placed_figure(draw.DOUBLE_COLUMN, 3.5)
        scene, _ = space.new_scene(figure, np.concatenate([after.points, old]), 0.1, 0.45, 2.5, 2.6)
        norm = draw.tension_scale(after.tension)
        space.draw_scene(scene, after, norm, old)
        draw.colour_scale(figure, norm, "$T$ (N)", 3.15, 1.0, 1.6)
        for i, quantity in enumerate(("angle", "offset", "bending", "twist")):
            panel = draw.place_in(figure, (4.15, 5.95)[i % 2], (1.95, 0.45)[i // 2], 1.0, 1.2)
            _draw_before_and_after(design, quantity, panel)
            if i < 2:
                panel.set_xlabel("")
            if np.max(np.abs(panel.get_ylim())) < NOTHING:
                panel.set_ylim(-1.0, 1.0)  # differences by rounding are not drawn
        figure.legend(*figure.axes[-1].get_legend_handles_labels(), loc="upper right", ncols=2)
    return figure


def _drawn(design: Design) -> tuple[Drawn, np.ndarray]:
    """What is drawn of the designed body in its first load case, and the axis of the start, mm, (points, 3)."""
    along = geometry.fields_along(design.equilibria[0], geometry.stations(design.manipulator))
    before = geometry.fields_along(design.equilibria_at_start[0], geometry.stations(design.start))
    return geometry.drawn(design.manipulator, along, design.cases[0].loads), 1e3 * np.asarray(before.position)


def _draw_straight(axes: Axes, manipulator: Manipulator, label: str, below: float, line: float) -> float:
    """Draw a body at rest above the height `below`, with its diameters and a label; return the height of its upper end.

    `line` is the height of a line of text, mm.
    """
    s = geometry.stations(manipulator)
    rest = geometry.straight_body(manipulator, s)
    heights = np.concatenate([rest.outline[:, 1], geometry.tendon_paths(manipulator, rest, s)[..., 1].ravel()])
    reach = max(float(np.nanmax(np.abs(heights))), line / 2)
    level = below + 1.5 * line + reach
    body = geometry.straight_body(manipulator, s, level)
    draw.draw_body(axes, body)
    for path in geometry.tendon_paths(manipulator, body, s):
        axes.plot(*path.T, color=looks.BLACK, linewidth=0.6)
    for end, align, gap in ((0, "right", -3.0), (-1, "left", 3.0)) if manipulator.has_radii else ():
        text = f"{2 * body.outer_radius[end]:.3g}/{2 * body.inner_radius[end]:.3g}"
        look: dict[str, Any] = {"textcoords": "offset points", "ha": align, "va": "center", "fontsize": 7}
        axes.annotate(text, tuple(body.midline[end]), (gap, 0.0), **look)
        axes.update_datalim([body.midline[end] + np.array([np.sign(gap) * 3.5 * line, 0.0])])
    middle = (float(np.mean(body.midline[[0, -1], 0])), level + reach)
    axes.annotate(label, middle, (0.0, 1.5), textcoords="offset points", ha="center", va="bottom", fontsize=7.5)
    axes.update_datalim(np.array([(0.0, level + reach + 1.3 * line)]))
    return level + reach + 1.3 * line


def draw_trade_off(front: ParetoFront, axes: Axes | None = None) -> Axes:
    """The two objectives against each other: a point for each design, and a square for the start.

    Designs that are not stationary are hollow. The legend gives a start that is too far away to be drawn.

    Args:
        front: of `pareto_front`.
        axes: where to draw; None for a new figure, one column wide.
    """
    scale = [preferred(dimension) for dimension in front.dimensions]
    x, y = (front.values[:, k] * scale[k][0] for k in (0, 1))
    good = np.array([design.success for design in front.designs])
    with draw.axes_or_new(axes, FRONT_HEIGHT) as axes:
        axes.plot(x[np.isfinite(x)], y[np.isfinite(y)], color=looks.BLUE, linewidth=0.8)
        axes.plot(x[good], y[good], "o", color=looks.BLUE, label="designs")
        if np.any(~good & np.isfinite(x)):
            axes.plot(x[~good], y[~good], "o", color=looks.VERMILION, markerfacecolor="white", label="not stationary")
        start = [value * factor for value, (factor, _) in zip(front.start, scale, strict=True)]
        ends = [(np.nanmin(values), np.nanmax(values)) for values in (x, y)]
        near = all(2 * low - high <= at <= 2 * high - low for at, (low, high) in zip(start, ends, strict=True))
        words = "start" if near else f"start: {start[0]:.3g}, {start[1]:.3g}"
        axes.plot(*(start if near else ([], [])), "s", color=looks.GREY, label=words)
        for set_label, name, (_, unit) in zip((axes.set_xlabel, axes.set_ylabel), front.names, scale, strict=True):
            words = re.sub("^(least|most) ", "", name).replace("_", " ").capitalize()
            raised = re.sub(r"\^(-?\d+)", r"$^{\1}$", unit)  # exponents as they are set: cm^3
            set_label(f"{words} ({raised})" if unit else words)
        _widen(axes, x, y)
        axes.legend(loc="lower left", frameon=False)
    return axes


def _widen(axes: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """Wider axis limits around designs that hardly differ: else rounding would look like a trade-off."""
    for values, set_limits in ((x, axes.set_xlim), (y, axes.set_ylim)):
        middle = float(np.nanmean(values))
        if np.nanmax(values) - np.nanmin(values) < 1e-3 * abs(middle):
            set_limits(middle - 0.05 * abs(middle), middle + 0.05 * abs(middle))
