"""A table of cross-sections as it was read: its points, and the profile that was taken for each column."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from . import plotting as draw
from .cross_sections import SectionColumn
from .profiles import Constant, breakpoints

HEIGHT = 1.9  # of a panel, in


def draw_section_column(column: SectionColumn, axes: Axes | None = None) -> Axes:
    """The points of a column, and the profile that was taken for it, over the arc length, mm.

    Args:
        column: of `section_columns`.
        axes: where to draw; None for a new figure, one column wide.
    """
    points, values = 1e3 * column.arc_length, 1e3 * column.values
    s = _stations(column)
    with draw.axes_or_new(axes, HEIGHT) as axes:
        axes.plot(1e3 * s, 1e3 * np.asarray(column.profile(s)), color=draw.BLUE, label="as read")
        many = len(points) > 60
        look = {"markersize": 1.2 if many else 3.2, "markerfacecolor": "white", "markeredgewidth": 0.7}
        axes.plot(points, values, "o", color=draw.VERMILION, label="points of the table", **look)
        low, high = axes.dataLim.intervaly
        constant = isinstance(column.profile, Constant)
        margin = (0.1 * high or 0.1) if constant else 0.08 * (high - low)
        axes.set_ylim(low - margin, high + margin)
        axes.set(xlabel="Arc length $s$ (mm)", ylabel=f"{column.name.replace('_', ' ').capitalize()} (mm)")
        draw.legend_above(axes)
    return axes


def sections_figure(columns: Sequence[SectionColumn]) -> Figure:
    """A panel for each column of a table of cross-sections, with one legend.

    Args:
        columns: of `section_columns`.
    """
    with draw.house_style():
        figure, panels = draw.panels(len(columns), 2, HEIGHT)
        for panel, column in zip(panels, columns, strict=True):
            draw_section_column(column, panel)
        draw.common_legend(figure, panels)
    return figure


def _stations(column: SectionColumn) -> np.ndarray:
    """Arc lengths, m: a grid, and both sides of every joint."""
    length = column.arc_length[-1]
    joints = np.asarray(breakpoints(column.profile), float)
    sides = np.concatenate([joints - 1e-9 * length, joints])
    return np.unique(np.clip(np.concatenate([np.linspace(0.0, length, 1001), sides]), 0.0, length))
