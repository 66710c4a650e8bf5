"""Repeated readings of one quantity over another, gathered by level, and the band of a model about them."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from .plotting import BLACK, BLUE, GREY, SKY


class Levels(NamedTuple):
    """Repeated readings gathered by level; `deviation` is NaN where a level was read once."""

    x: np.ndarray
    mean: np.ndarray
    deviation: np.ndarray  # standard deviation over the readings of a level
    lowest: np.ndarray
    highest: np.ndarray


def by_level(x: Any, y: Any) -> Levels:
    """Gather the readings y whose x agree within 2 % of the range of x, the scatter of a set point."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    order = np.argsort(x, kind="stable")
    new_level = np.flatnonzero(np.diff(x[order]) > 0.02 * np.ptp(x)) + 1
    groups = np.split(order, new_level)
    return Levels(
        x=np.array([x[group].mean() for group in groups]),
        mean=np.array([y[group].mean() for group in groups]),
        deviation=np.array([y[group].std(ddof=1) if len(group) > 1 else np.nan for group in groups]),
        lowest=np.array([y[group].min() for group in groups]),
        highest=np.array([y[group].max() for group in groups]),
    )


def draw_band(axes: Axes, x: Any, lower: Any, upper: Any, **style: Any) -> None:
    """The region between two lines."""
    axes.fill_between(x, lower, upper, **({"color": SKY, "alpha": 0.5, "linewidth": 0} | style))


def draw_levels(axes: Axes, x: Any, y: Any, **style: Any) -> None:
    """Mean and standard deviation of y at each level of x, as markers with error bars."""
    levels = by_level(x, y)
    look = {"fmt": "o", "color": BLACK, "markerfacecolor": "white", "elinewidth": 0.8, "zorder": 3}
    axes.errorbar(levels.x, levels.mean, yerr=levels.deviation, **(look | style))


def draw_about_zero(axes: Axes, x: Any, residual: Any, *, levels: bool = True) -> None:
    """Every residual as a dot about a line at zero; over them mean and standard deviation at each level of x."""
    axes.axhline(0.0, color=BLUE)
    axes.plot(x, residual, ".", color=GREY, markersize=3.5, markeredgewidth=0)
    if levels:
        draw_levels(axes, x, residual, markersize=2.5)
    reach = 1.15 * np.max(np.abs(np.asarray(residual)), initial=0.0) or 1.0
    axes.set_ylim(-reach, reach)
