"""Figures of a design: the body before and after, to scale; and the trade-off between two objectives."""

import re
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from . import plotting as draw
from .along_figure import draw_along, fields_along, stations
from .body_drawing import bent_body, straight_body, tendon_paths
from .design_results import Design
from .manipulator import Manipulator
from .pareto import ParetoFront
from .units import preferred

START: dict[str, Any] = {"color": draw.GREY, "linestyle": (0, (4, 2)), "label": "before"}
END: dict[str, Any] = {"color": draw.BLUE, "linestyle": "-", "label": "after"}
HEIGHT, FRONT_HEIGHT = 3.5, 2.6  # inches


def design_figure(design: Design) -> Figure:
    """Left the straight bodies before and after and the designed one bent; right curvature and strain along them.

    The first load case is drawn. Walls and tendons are to scale, one scale for all three bodies.
    """
    with draw.house_style():
        figure = draw.new_figure(draw.DOUBLE_COLUMN, 3.4)
        grid = figure.add_gridspec(2, 2, width_ratios=(1.45, 1))
        draw_design(design, figure.add_subplot(grid[:, 0]))
        curvature, strain = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
        for axes, quantity in ((curvature, "curvature"), (strain, "strain")):
            draw_along(design.start, design.equilibria_at_start[0], quantity, axes, **START)
            draw_along(design.manipulator, design.equilibria[0], quantity, axes, **END)
        curvature.set_xlabel("")
        curvature.tick_params(labelbottom=False)
        curvature.legend(loc="best")
    return figure


def draw_design(design: Design, axes: Axes | None = None) -> Axes:
    """The straight bodies before and after, and the designed one bent in its first load case; to one scale, mm.

    Outer and inner diameters at both ends are written beside the straight bodies. The bent body from which the search
    began is dashed.

    Args:
        design: of `design`.
        axes: where to draw; None for a new figure, one column wide.
    """
    with draw.axes_or_new(axes, HEIGHT) as axes:
        _draw_bodies(axes, design)
    return axes


def _draw_bodies(axes: Axes, design: Design) -> None:
    before, after = design.start, design.manipulator
    radius = 1e3 * max(np.max(np.asarray(body.outer_radius(stations(body)))) for body in (before, after))
    s = stations(after)
    bent = bent_body(after, fields_along(design.equilibria[0], s))
    top = max(float(np.max(bent.outline[:, 1])), radius)
    _draw_straight(axes, before, top + 5.4 * radius, "before (numbers: outer/inner diameter, mm)")
    _draw_straight(axes, after, top + 2.2 * radius, "after")
    draw.draw_clamp(axes, 1.3 * radius, 0.4 * radius)
    draw.draw_body(axes, bent)
    old = bent_body(before, fields_along(design.equilibria_at_start[0], stations(before)))
    axes.plot(*old.outline.T, color=draw.GREY, linewidth=0.6, linestyle=(0, (4, 2)))
    axes.plot(*bent.outline.T, color=draw.BLUE, linewidth=0.7)
    for path in tendon_paths(after, bent, s):
        axes.plot(*path.T, color=draw.BLACK, linewidth=0.6)
    axes.set(xlabel="$X$ (mm)", ylabel="$Y$ (mm)")
    draw.to_scale(axes)
    axes.update_datalim([(0.0, top + 7.4 * radius)])  # room for what is written above
    axes.autoscale_view()
    axes.set_yticks([tick for tick in axes.get_yticks() if tick <= top + 1e-9])


def _draw_straight(axes: Axes, body: Manipulator, level: float, label: str) -> None:
    """A body at rest, its axis at the height `level`, with its radii at both ends."""
    s = stations(body)
    drawn = straight_body(body, s, level)
    midline, outer, inner = drawn.midline, drawn.outer_radius, drawn.inner_radius
    draw.draw_body(axes, drawn)
    for path in tendon_paths(body, drawn, s):
        axes.plot(*path.T, color=draw.BLACK, linewidth=0.6)
    for end, align, gap in ((0, "right", -2.0), (-1, "left", 2.0)):
        text = f"{2 * outer[end]:.3g}/{2 * inner[end]:.3g}"
        axes.annotate(text, midline[end] + [gap, 0.0], ha=align, va="center", fontsize=7)
    axes.annotate(
        label, (midline[len(s) // 2, 0], level + 1.05 * np.max(outer)), ha="center", va="bottom", fontsize=7.5
    )


def pareto_figure(front: ParetoFront) -> Figure:
    """The trade-off as a figure of one column."""
    with draw.house_style():
        figure = draw.new_figure(draw.SINGLE_COLUMN, FRONT_HEIGHT)
        draw_trade_off(front, figure.subplots())
    return figure


def draw_trade_off(front: ParetoFront, axes: Axes | None = None) -> Axes:
    """The two objectives against each other: every design a point, the start apart.

    Designs that are not stationary are hollow. A start that would squash the front is told in words.

    Args:
        front: of `pareto_front`.
        axes: where to draw; None for a new figure, one column wide.
    """
    scale = [preferred(dimension) for dimension in front.dimensions]
    x, y = (front.values[:, k] * scale[k][0] for k in (0, 1))
    good = np.array([design.success for design in front.designs])
    with draw.axes_or_new(axes, FRONT_HEIGHT) as axes:
        axes.plot(x[np.isfinite(x)], y[np.isfinite(y)], color=draw.BLUE, linewidth=0.8)
        axes.plot(x[good], y[good], "o", color=draw.BLUE, label="designs")
        if np.any(~good & np.isfinite(x)):
            axes.plot(x[~good], y[~good], "o", color=draw.VERMILION, markerfacecolor="white", label="not stationary")
        _draw_start(axes, [value * factor for value, (factor, _) in zip(front.start, scale, strict=True)], (x, y))
        for set_label, name, (_, unit) in zip((axes.set_xlabel, axes.set_ylabel), front.names, scale, strict=True):
            set_label(f"{_words(name)}{f' ({_raised(unit)})' if unit else ''}")
        axes.ticklabel_format(useOffset=False)
        _widen(axes, x, y)
        axes.legend(loc="lower left", frameon=False)
    return axes


def _draw_start(axes: Axes, start: list[float], points: tuple[np.ndarray, np.ndarray]) -> None:
    """The start as a square; where it would squash the front, in words at its side of the figure."""
    spans = [(np.nanmin(values), np.nanmax(values)) for values in points]
    within = [2 * low - high <= value <= 2 * high - low for value, (low, high) in zip(start, spans, strict=True)]
    if all(within):
        axes.plot(*start, "s", color=draw.GREY, label="start")
        return
    text = f"start: {start[0]:.3g}, {start[1]:.3g} (off the figure)"
    axes.annotate(text, (0.98, 0.98), xycoords="axes fraction", ha="right", va="top", fontsize=7, color=draw.GREY)


def _widen(axes: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """Room about designs that are hardly different, so that nobody sees a trade-off in their last digits."""
    for values, set_limits in ((x, axes.set_xlim), (y, axes.set_ylim)):
        middle = float(np.nanmean(values))
        if np.nanmax(values) - np.nanmin(values) < 1e-3 * abs(middle):
            set_limits(middle - 0.05 * abs(middle), middle + 0.05 * abs(middle))


def _raised(unit: str) -> str:
    """With exponents as they are set: cm^3."""
    return re.sub(r"\^(-?\d+)", r"$^{\1}$", unit)


def _words(name: str) -> str:
    kind, _, quantity = name.partition(" ")
    return quantity.replace("_", " ").capitalize() if kind in ("least", "most") else name.replace("_", " ").capitalize()
