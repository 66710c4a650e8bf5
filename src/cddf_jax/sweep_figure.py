"""The figure of a sweep: outputs over what varies, as lines, as contours or as dots."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from . import plotting as draw
from .axes import OPTIONS
from .sweep_lines import LINES, draw_others, draw_quantity
from .sweep_maps import draw_row, hatch
from .sweep_outputs import RESULT
from .sweep_view import MOST, SUCCESSFUL, View, quantities, thinned, write_ticks

if TYPE_CHECKING:
    import xarray

SAMPLES = 3000  # drawn at most
COLUMNS, DOT_COLUMNS, PANELS = 4, 6, 12  # drawn at most


def sweep_figure(answer: "xarray.Dataset", outputs: Sequence[str], varied: Mapping[str, str]) -> Figure | str:
    """Outputs over one axis as lines, over two or three as contours, over samples as dots.

    What was solved without any doubt is drawn as it is. Doubtful numbers are hollow, or left out of contours, and
    failed solves are marked; the legend says why. Outputs along the body have no panel.

    Args:
        answer: of `sweep`.
        outputs: names of those to be drawn; the first dozen of their components are.
        varied: the names of all that varies, in the order of columns, and in words for labels.

    Returns:
        The figure; or in words why there is none.
    """
    answer = answer.isel({dimension: 0 for dimension in answer[RESULT].dims if answer.sizes[dimension] == 1})
    dimensions = [str(dimension) for dimension in answer[RESULT].dims]
    sampled = [dimension for dimension in dimensions if dimension not in answer.coords]
    options = [dimension for dimension in dimensions if dimension in OPTIONS]
    numbers = [dimension for dimension in dimensions if dimension not in (*sampled, *options)]
    drawn = [name for name in outputs if "point" not in answer[name].dims]
    if not drawn:
        return "outputs along the body are not drawn over what varies"
    if not numbers and not sampled:
        return "no number varies"
    if not sampled and len(numbers) > 3 - bool(options):
        return f"{len(numbers)} axes{' and options' if options else ''} are too many for one; choose with xarray"
    most = SAMPLES if sampled else MOST[min(len(numbers), 2)]
    answer = thinned(answer, [*sampled, *numbers], most)
    view = View(answer, quantities(answer, drawn)[:PANELS], varied, options)
    if sampled:
        return _dots(view)
    return _lines(view, numbers[0]) if len(numbers) == 1 else _contours(view, numbers)


def left_out(answer: "xarray.Dataset", outputs: Sequence[str]) -> list[str]:
    """What the figure of a sweep has no room for, in words."""
    sizes = {str(name): answer.sizes[name] for name in answer[RESULT].dims if answer.sizes[name] > 1}
    sampled = [name for name in sizes if name not in answer.coords]
    numbers = [name for name in sizes if name not in (*sampled, *OPTIONS)]
    drawn = [name for name in outputs if "point" not in answer[name].dims]
    components = sum(int(np.prod(answer[name].shape[answer[RESULT].ndim :])) for name in drawn)
    combinations = int(np.prod([sizes[name] for name in sizes if name in OPTIONS]))
    columns = sum(
        coordinate.ndim > 0 for name, coordinate in answer.coords.items() if name not in ("tendon", "component")
    )
    lines = bool(sampled) or len(numbers) == 1
    found = [f"{name}, which runs along the body" for name in outputs if name not in drawn]
    for count, room, what in (
        (components, PANELS, "components of outputs"),
        (combinations, LINES if lines else COLUMNS, "combinations of options"),
        (sizes[numbers[0]] if len(numbers) == 3 else 0, COLUMNS, f"values of {numbers[0] if numbers else ''}"),
        (columns if sampled else 0, DOT_COLUMNS, "numbers that vary"),
        (sizes[sampled[0]] if sampled else 0, SAMPLES, "samples"),
    ):
        found += [f"{count - room:,} of {count:,} {what}"] if count > room else []
    return found


# --- lines and contours --------------------------------------------------------------------------


def _lines(view: View, number: str) -> Figure:
    """A panel for each quantity, a line for each combination of options."""
    with draw.house_style():
        figure, panels = draw.panels(len(view.quantities), 2, 2.1)
        for panel, quantity in zip(panels, view.quantities, strict=True):
            draw_quantity(panel, view, quantity, number)
        draw.common_legend(figure, panels)
        figure.align_labels()
    return figure


def _contours(view: View, numbers: list[str]) -> Figure:
    """A panel for each quantity; for options or a third axis a row of panels for each, with one scale of colours."""
    parts = view.slices(numbers[0], COLUMNS) if len(numbers) == 3 else view.parts(COLUMNS)
    x, y = numbers[-2:]
    with draw.house_style():
        figure, rows = _grid(len(view.quantities), len(parts))
        panels = [panel for row in rows for panel in row]
        for row, quantity in zip(rows, view.quantities, strict=True):
            draw_row(row, view, quantity, parts, x, y)
        hatch(panels, view, parts)
        _label_grid(rows, view.axis(x).label, view.axis(y).label, [part.label for part in parts])
        draw.common_legend(figure, panels)
    return figure


def _grid(quantities: int, parts: int) -> tuple[Figure, list[list[Axes]]]:
    """Rows of panels: a column for each part, or where there is one part every panel as a row of its own."""
    if parts == 1:
        figure, panels = draw.panels(quantities, 2, 2.2)
        return figure, [[panel] for panel in panels]
    figure = draw.new_figure(draw.DOUBLE_COLUMN, (2.2 if parts < 4 else 1.7) * quantities + 0.4)
    return figure, figure.subplots(quantities, parts, squeeze=False, sharex=True, sharey=True).tolist()


def _label_grid(rows: list[list[Axes]], x_label: str, y_label: str, titles: list[str]) -> None:
    alone = len(titles) == 1
    for i, row in enumerate(rows):
        for k, panel in enumerate(row):
            panel.set_xlabel(x_label if alone or i == len(rows) - 1 else "")
            panel.set_ylabel(y_label if alone or k == 0 else "")
            panel.set_title(titles[k] if i == 0 else "")


# --- dots ----------------------------------------------------------------------------------------


def _dots(view: View) -> Figure:
    """A row for each quantity, a column for each number that varies."""
    dimensions, codes = view.dimensions, view.codes
    numbers = [name for name in view.varied if name not in OPTIONS and view.answer.coords[name].ndim]
    columns = [view.axis(name) for name in numbers[:DOT_COLUMNS]]
    with draw.house_style():
        width = draw.SINGLE_COLUMN if len(columns) == 1 else draw.DOUBLE_COLUMN
        height = 1.6 if len(columns) > 1 else 2.2
        figure = draw.new_figure(width, height * len(view.quantities) + 0.4)
        panels = figure.subplots(len(view.quantities), len(columns), squeeze=False, sharex="col", sharey="row")
        for (i, k), panel in np.ndenumerate(panels):
            axis, quantity = columns[k], view.quantities[i]
            x = axis.values.reshape([-1 if dimension == axis.dimension else 1 for dimension in dimensions])
            arrays = np.broadcast_to(x, codes.shape), quantity.values, codes
            for part, look in zip(view.parts(LINES), draw.CURVES, strict=False):
                points = [array[part.place].ravel() for array in arrays]
                _draw_dots(panel, points, look, part.label)
            panel.set(xlabel=axis.label if i == len(panels) - 1 else "", ylabel=quantity.label if k == 0 else "")
            write_ticks(panel, quantity)
            panel.xaxis.set_major_locator(MaxNLocator(4))
        draw.common_legend(figure, panels.ravel().tolist())
        figure.align_labels()
    return figure


def _draw_dots(axes: Axes, points: list[np.ndarray], look: dict[str, Any], label: str) -> None:
    x, y, codes = points
    sure = codes == SUCCESSFUL
    size = float(np.clip(60.0 / np.sqrt(len(x)), 1.2, 3.5))
    dots = {"marker": look["marker"], "color": look["color"], "markersize": size, "markeredgewidth": 0, "alpha": 0.6}
    axes.plot(x[sure], y[sure], linestyle="none", rasterized=len(x) > 500, label=label, **dots)
    draw_others(axes, x, y, codes, look | {"markersize": max(size, 2.4)})
