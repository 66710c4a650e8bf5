"""An output of a sweep over two numbers, as contours."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm
from matplotlib.contour import QuadContourSet
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from . import plotting as draw
from .sweep_view import SUCCESSFUL, Part, Quantity, View, chosen, names_of

if TYPE_CHECKING:
    import xarray

SAME = 1e-9  # of the size: values that differ by less are one
EDGE = 0.06  # of a panel, nearer to which no contour is labelled
LABELLED = 2  # panels beside each other, up to which contours have their numbers
HEIGHT = 2.5  # inches


def draw_map(
    dataset: "xarray.Dataset", output: str, x: str, y: str, axes: Axes | None = None, **selection: Any
) -> Axes:
    """Contours of an output of a sweep over two numbers, in mm, deg, MPa and else SI units; the scale stands beside.

    Where a solve failed or is doubtful the map is left blank and hatched; the legend says why.

    Args:
        dataset: of `sweep`.
        output: the name of an output, as "tip_tension".
        x, y: names of numbers along two axes, as "base_tension".
        axes: where to draw; None for a new figure, one column wide.
        selection: values of all other axes, SI units; `tendon` from 0, `component` "X" or "Y". Names that hold a dot
            are given as `**{"outer_radius.tip": 0.013}`.

    Raises:
        InputError: for names and values that are not there, or where more varies than x and y.
    """
    view = chosen("draw_map", dataset, output, (x, y), selection, 1)
    parts = view.parts(1)
    with draw.axes_or_new(axes, HEIGHT) as axes:
        draw_row([axes], view, view.quantities[0], parts, x, y)
        axes.set(xlabel=view.axis(x).label, ylabel=view.axis(y).label)
        hatch([axes], view, parts)
        draw.legend_above(axes)
    return axes


def draw_row(panels: Sequence[Axes], view: View, quantity: Quantity, parts: Sequence[Part], x: str, y: str) -> None:
    """A panel for each part, with one scale of colours beside the last."""
    numbers = [np.where(view.codes[part.place] == SUCCESSFUL, quantity.values[part.place], np.nan) for part in parts]
    levels = _levels(np.stack(numbers))
    look = {"cmap": draw.TENSION_COLOURS, "norm": BoundaryNorm(levels, 256)}
    places = view.axis(x).values, view.axis(y).values
    for panel, values in zip(panels, numbers, strict=True):
        _draw_contours(panel, (*places, values.T), levels, look, labelled=len(parts) <= LABELLED)
    bar = ScalarMappable(**look)
    draw.figure_of(panels[0]).colorbar(bar, ax=list(panels), label=quantity.label, pad=0.02, aspect=25)


def hatch(panels: Sequence[Axes], view: View, parts: Sequence[Part]) -> None:
    """What shows where nothing is drawn: a grey ground with hatching."""
    codes = np.concatenate([np.ravel(view.codes[part.place]) for part in parts])
    others = codes[codes != SUCCESSFUL]
    if not others.size:
        return
    look = {"facecolor": draw.PALE, "edgecolor": draw.GREY, "hatch": "/////", "linewidth": 0.0}
    for panel in panels:
        ground = Rectangle((0, 0), 1, 1, transform=panel.transAxes, zorder=0, **look)
        ground.set_label(f"hatched: {names_of(others)}")
        panel.add_patch(ground)


def _levels(values: np.ndarray) -> np.ndarray:
    """Round numbers that hold all values between them; two where all are the same."""
    there = values[np.isfinite(values)]
    if not there.size:
        return np.array([0.0, 1.0])
    low, high = there.min(), there.max()
    if high - low <= SAME * max(abs(low), abs(high)):
        reach = 0.01 * abs(low) or 1.0
        return np.array([low - reach, high + reach])
    return np.asarray(MaxNLocator(8).tick_values(low, high))


def _draw_contours(
    axes: Axes, points: tuple[np.ndarray, ...], levels: np.ndarray, look: dict[str, Any], *, labelled: bool
) -> None:
    x, y, values = points
    axes.set(xlim=(x[0], x[-1]), ylim=(y[0], y[-1]), axisbelow=False)
    if not np.any(np.isfinite(values)):
        return
    shown = np.ma.masked_invalid(values)
    axes.contourf(x, y, shown, levels=levels, **look)
    if len(levels) > 2:
        lines = axes.contour(x, y, shown, levels=levels, colors=draw.BLACK, linewidths=0.5, linestyles="solid")
        if labelled:
            _write_levels(axes, lines)


def _write_levels(axes: Axes, lines: QuadContourSet) -> None:
    """The level on each line, unless it would lie over the frame."""
    for text in axes.clabel(lines, fmt="%g", fontsize=7, colors=draw.BLACK, inline=False):
        text.set_path_effects([withStroke(linewidth=2.0, foreground="white")])
        place = axes.transAxes.inverted().transform(axes.transData.transform(text.get_position()))
        if np.any(place < EDGE) or np.any(place > 1 - EDGE):
            text.remove()
