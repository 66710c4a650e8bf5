"""Figures of a design: the body before and after, to scale; and the trade-off between two objectives."""

import re
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from ..designing.pareto import ParetoFront
from ..designing.results import Design
from ..robot.manipulator import Manipulator
from ..units import preferred
from . import looks, space, style as draw
from .along import draw_along
from .geometry import Body, Drawn, drawn, fields_along, stations, tendon_paths

START: dict[str, Any] = {"color": looks.GREY, "linestyle": (0, (4, 2)), "label": "before"}
END: dict[str, Any] = {"color": looks.BLUE, "linestyle": "-", "label": "after"}
HEIGHT, FRONT_HEIGHT = 3.5, 2.6  # inches
NOTHING = 1e-9  # 1/m, a curvature
LINE = 0.07  # of the length of the body: the height of a line of text


def design_figure(design: Design) -> Figure:
    """On the left the bodies as `draw_design` draws them; on the right curvature and strain along both.

    The first load case is drawn. There is no strain where the bodies have no radii. In space angle and offset of the
    tendons, bending and twist stand in their place.
    """
    in_space, has_wall = design.equilibria[0].in_space, design.manipulator.has_radii
    shown = ("angle", "offset", "bending", "twist") if in_space else ("curvature", "strain")[: 1 + has_wall]
    with draw.house_style():
        figure = draw.new_figure(draw.DOUBLE_COLUMN, HEIGHT)
        left, right = cast(Sequence[SubFigure], figure.subfigures(1, 2, width_ratios=(1.45, 1)))
        draw_design(design, left.add_subplot(projection="3d" if in_space else None))
        columns = 2 if in_space else 1
        panels = right.subplots(len(shown) // columns, columns, sharex=True, squeeze=False).ravel()
        for quantity, panel in zip(shown, panels, strict=True):
            draw_along(design.start, design.equilibria_at_start[0], quantity, panel, **START)
            draw_along(design.manipulator, design.equilibria[0], quantity, panel, **END)
            if np.max(np.abs(panel.get_ylim())) < NOTHING:
                panel.set_ylim(-1.0, 1.0)  # differences by rounding are not drawn
        for panel in panels[:-columns]:
            panel.set_xlabel("")
        right.legend(*panels[-1].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def draw_design(design: Design, axes: Axes | None = None) -> Axes:
    """The straight bodies before and after, and the designed body bent in its first load case; to one scale, mm.

    Outer and inner diameters at both ends are written above the straight bodies that have radii. The bent body at the
    start of the search is dashed.

    In space only the designed body is drawn, in three dimensions; the axis of the bent start is dashed.

    Args:
        design: of `design`.
        axes: where to draw, in space with projection="3d"; None for a new figure, one column wide.

    Raises:
        InputError: for axes of the wrong kind.
    """
    (before, old), (after, new) = (
        (body, drawn(body, fields_along(equilibrium, stations(body)), design.cases[0].loads))
        for body, equilibrium in (
            (design.start, design.equilibria_at_start[0]),
            (design.manipulator, design.equilibria[0]),
        )
    )
    if design.equilibria[0].in_space:
        with draw.axes_or_new(axes, space.HEIGHT, in_space=True) as axes:
            space.draw_scene(new, axes, old.body.midline)
        return axes
    line = LINE * new.length
    with draw.axes_or_new(axes, HEIGHT) as axes:
        _draw_section(axes, new.body, new.tendons)
        axes.plot(*old.body.outline.T, color=looks.GREY, linewidth=0.6, linestyle=(0, (4, 2)))
        axes.plot(*new.body.outline.T, color=looks.BLUE, linewidth=0.7)
        top = level = float(axes.dataLim.y1)
        for manipulator, what, name in ((after, new, "after"), (before, old, "before")):
            level = _draw_straight(axes, manipulator, what, name, level, line)
        draw.draw_clamp(axes, 1.2 * max(new.body.outer_radius[0], np.max(np.abs(new.tendons[:, 0, 1]))), 0.6 * line)
        axes.set(xlabel="$X$ (mm)", ylabel="$Y$ (mm)")
        draw.to_scale(axes)
        axes.autoscale_view()
        bottom = axes.get_ylim()[0]  # ticks beyond it would move it
        axes.set_yticks([tick for tick in axes.get_yticks() if bottom <= tick <= top + 1e-9])
    return axes


def _draw_section(axes: Axes, body: Body, tendons: np.ndarray) -> None:
    draw.draw_body(axes, body)
    for path in tendons:
        axes.plot(*path[:, :2].T, color=looks.BLACK, linewidth=0.6)


def _draw_straight(axes: Axes, manipulator: Manipulator, what: Drawn, name: str, below: float, line: float) -> float:
    """Draw a body at rest above the height `below`, with a label above it; return the height of its upper end.

    `line` is the height of a line of text, mm.
    """
    body, s = what.straight, stations(manipulator)
    heights = [*body.outline[:, 1], *tendon_paths(manipulator, body, s)[..., 1].ravel()]
    reach = max(float(np.nanmax(np.abs(heights))), line / 2)
    up, top = below + 1.5 * line + reach, below + 1.5 * line + 2 * reach
    body = body._replace(midline=body.midline + np.array([0.0, up, 0.0]))
    _draw_section(axes, body, tendon_paths(manipulator, body, s))
    if manipulator.has_radii:
        ends = [f"{2 * body.outer_radius[end]:.3g}/{2 * body.inner_radius[end]:.3g}" for end in (0, -1)]
        name += f", outer/inner diameter {' to '.join(ends)} mm"
    middle = (0.5 * what.length, top)
    axes.annotate(name, middle, (0.0, 1.5), textcoords="offset points", ha="center", va="bottom", fontsize=7.5)
    axes.update_datalim(np.array([(0.0, top + 1.3 * line)]))
    return top + 1.3 * line


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
        axes.legend(loc="lower left", frameon=False)
    return axes
