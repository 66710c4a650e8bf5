"""Figures of a design: the body before and after, to scale; and the trade-off between two objectives."""

import re
from collections.abc import Sequence
from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from ..designing.pareto import ParetoFront
from ..designing.results import Design
from ..units import preferred
from . import looks, style as draw
from .along import draw_along
from .body import draw_bent
from .geometry import bent_body

START: looks.Look = {"color": looks.GREY, "linewidth": 0.8, "label": "before"}
END: looks.Look = {"color": looks.BLUE, "label": "after"}
HEIGHT = 2.6  # inches
NOTHING = 1e-9  # 1/m, a curvature


def design_figure(design: Design) -> Figure:
    """On the left the bodies as `draw_design` draws them; on the right outer radius, curvature and strain along both.

    The first load case is drawn. Bodies without radii have the curvature alone. In space angle and offset of the
    tendons, bending and twist stand in their place.
    """
    in_space, has_wall = design.equilibria[0].in_space, design.manipulator.has_radii
    shown = ("outer_radius", "curvature", "strain") if has_wall else ("curvature",)
    shown = ("angle", "offset", "bending", "twist") if in_space else shown
    start: looks.Look = START | ({} if in_space else {"linestyle": (0, (4, 2))})  # in space dashes tell tendons apart
    with draw.house_style():
        figure = draw.new_figure(draw.DOUBLE_COLUMN, max(1.13 * len(shown), HEIGHT))
        left, right = cast(Sequence[SubFigure], figure.subfigures(1, 2, width_ratios=(1.45, 1)))
        draw_design(design, left.add_subplot(projection="3d" if in_space else None))
        panels = right.subplots(len(shown), sharex=True, squeeze=False).ravel()
        for quantity, panel in zip(shown, panels, strict=True):
            draw_along(design.start, design.equilibria_at_start[0], quantity, panel, **start)
            draw_along(design.manipulator, design.equilibria[0], quantity, panel, **END)
            if np.max(np.abs(panel.get_ylim())) < NOTHING:
                panel.set_ylim(-1.0, 1.0)  # differences by rounding are not drawn
            panel.label_outer()
        right.legend(*panels[-1].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def draw_design(design: Design, axes: Axes | None = None) -> Axes:
    """The designed body, bent in its first load case, as `draw_shape` draws it; the bent body at the start is dashed.

    In space only the axis of the start is drawn.

    Args:
        design: of `design`.
        axes: where to draw, in space with projection="3d"; None for a new figure, one column wide.

    Raises:
        InputError: for axes of the wrong kind.
    """
    loads = design.cases[0].loads
    before = bent_body(design.start, design.equilibria_at_start[0], loads)
    return draw_bent(bent_body(design.manipulator, design.equilibria[0], loads), axes, before)


def draw_trade_off(front: ParetoFront, axes: Axes | None = None) -> Axes:
    """The two objectives against each other: a point for each design, and a square for the start.

    Designs that are not stationary are hollow.

    Args:
        front: of `pareto_front`.
        axes: where to draw; None for a new figure, one column wide.
    """
    scale = [preferred(each.dimension) for each in front.objectives]
    x, y = (front.values[:, k] * scale[k][0] for k in (0, 1))
    good = np.array([design.success for design in front.designs])
    with draw.axes_or_new(axes, HEIGHT) as axes:
        axes.plot(x[np.isfinite(x)], y[np.isfinite(y)], color=looks.BLUE, linewidth=0.8)
        axes.plot(x[good], y[good], "o", color=looks.BLUE, label="designs")
        if np.any(~good & np.isfinite(x)):
            axes.plot(x[~good], y[~good], "o", color=looks.VERMILION, markerfacecolor="white", label="not stationary")
        start = [each.start * factor for each, (factor, _) in zip(front.objectives, scale, strict=True)]
        axes.plot(*start, "s", color=looks.GREY, label="start")
        for set_label, each, (_, unit) in zip((axes.set_xlabel, axes.set_ylabel), front.objectives, scale, strict=True):
            words = re.sub("^(least|most) ", "", each.name).replace("_", " ").capitalize()
            raised = re.sub(r"\^(-?\d+)", r"$^{\1}$", unit)  # exponents as they are set: cm^3
            set_label(f"{words} ({raised})" if unit else words)
        axes.legend(loc="lower left", frameon=False)
    return axes
