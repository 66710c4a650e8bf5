"""A fit of rows that were pulled and released: both branches over the base tension, in the order of the path."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes

from ..identification.course import Course
from ..identification.predictions import ModelCurve
from . import looks, style as draw
from .history import PULLED, RELEASED

BAND: looks.Look = {"color": looks.SKY, "alpha": 0.4, "linewidth": 0}
BRANCHES: tuple[tuple[bool, looks.Look], ...] = ((True, {"marker": "o"}), (False, {"marker": "v"}))
LEAST_LEG = 0.02  # of the range of the path; a shorter way bears no arrow


def draw_model_loops(axes: Axes, loops: Sequence[ModelCurve]) -> None:
    """The model with its 95 % band: solid when pulled, dashed when released, with arrows along the path."""
    for loop in loops:
        least = LEAST_LEG * np.ptp(loop.grid)
        for start, end in pairwise(draw.turning_places(loop.grid)):
            leg, pulled = slice(start, end + 1), loop.grid[end] >= loop.grid[start]
            x, y, half_width = loop.grid[leg], loop.value[leg], loop.half_width[leg]
            if np.all(np.isfinite(half_width)):
                axes.fill_between(x, y - half_width, y + half_width, **BAND, label="95 % band of the model")
            look: looks.Look = PULLED if pulled else RELEASED
            own: looks.Look = look | {"label": f"model, {look['label']}"}
            axes.plot(x, y, **own)
            if np.ptp(x) > least:
                draw.draw_arrow(axes, x, y, look["color"])


def draw_branches(axes: Axes, course: Course, there: np.ndarray, x: np.ndarray, y: np.ndarray, label: str) -> None:
    """Readings over the base tension, those of one hold as mean and standard deviation; markers tell the branch.

    Args:
        axes: where to draw.
        course: of the rows of the table.
        there: (rows,), in which of them it was read.
        x, y: (readings,), base tension, N, and what was read.
        label: of the readings.
    """
    pulled, holds = course.pulled[there], np.stack([course.trial, course.step], axis=1)[there]
    look: looks.Look = {"color": looks.BLACK, "markerfacecolor": "white", "elinewidth": 0.8, "zorder": 3}
    for branch, marker in BRANCHES:
        own = pulled == branch
        if not np.any(own):
            continue
        _, hold = np.unique(holds[own], axis=0, return_inverse=True)
        counts = np.bincount(hold)
        mean_x, mean_y = (np.bincount(hold, values[own]) / counts for values in (x, y))
        squares = np.bincount(hold, (y[own] - mean_y[hold]) ** 2)
        spread = np.where(counts > 1, np.sqrt(squares / np.maximum(counts - 1, 1)), np.nan)
        words = f"{label}, {'pulled' if branch else 'released'}"
        axes.errorbar(mean_x, mean_y, yerr=spread, linestyle="none", label=words, **look, **marker)


def draw_branches_about_zero(
    axes: Axes, course: Course, there: np.ndarray, x: np.ndarray, residual: np.ndarray
) -> None:
    """Every residual about a line at zero; markers tell the branch."""
    axes.axhline(0.0, color=looks.BLACK, linewidth=0.6)
    pulled = course.pulled[there]
    for branch, marker in BRANCHES:
        look: looks.Look = {"linestyle": "none", "color": looks.GREY, "markerfacecolor": "none", "markersize": 3}
        axes.plot(x[pulled == branch], residual[pulled == branch], **look, **marker)
    reach = 1.15 * np.max(np.abs(residual), initial=0.0) or 1.0
    axes.set_ylim(-reach, reach)
