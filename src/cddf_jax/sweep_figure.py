"""The figure of a sweep: outputs over what varies, as lines, as contours or as dots."""

from collections.abc import Mapping, Sequence
from itertools import islice, product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from . import plotting as draw
from .axes import OPTIONS
from .sweep_outputs import COMPONENTS, RESULT, RESULT_NAMES

if TYPE_CHECKING:
    import xarray

SHOWN = {"m": (1e3, "mm"), "rad": (np.degrees(1.0), "deg"), "Pa": (1e-6, "MPa")}  # else SI
ALONG_LINE, ALONG_CONTOUR, SAMPLES = 2000, 300, 3000  # values that are drawn at most
LINES, COLUMNS, DOT_COLUMNS, PANELS = len(draw.CURVES), 4, 6, 12  # drawn at most
MARKED = 30  # values up to which a line has a marker at each
SAME = 1e-9  # of the size: values that differ by less are one
SUCCESSFUL = RESULT_NAMES.index("successful")
EDGE = 0.06  # of a panel, nearer to which no contour is labelled


class _Axis(NamedTuple):
    """Something that varies, in the unit of its label."""

    dimension: str
    values: np.ndarray
    words: str
    unit: str

    @property
    def label(self) -> str:
        return _label(self.words, self.unit)


class _Quantity(NamedTuple):
    """One component of an output over all dimensions of the sweep, in the unit of its label."""

    values: np.ndarray
    label: str
    yes_or_no: bool


class _Part(NamedTuple):
    """A sweep with its options at one value each."""

    place: tuple[Any, ...]  # to take it from an array over all dimensions
    label: str


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
    most = SAMPLES if sampled else ALONG_LINE if len(numbers) == 1 else ALONG_CONTOUR
    answer = _thinned(answer, [*sampled, *numbers], most)
    view = _View(answer, _quantities(answer, drawn), varied, options)
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


class _View(NamedTuple):
    """What is to be drawn."""

    answer: "xarray.Dataset"
    quantities: list[_Quantity]
    varied: Mapping[str, str]
    options: list[str]

    @property
    def codes(self) -> np.ndarray:
        """Of the results, over all dimensions of the sweep."""
        return self.answer[RESULT].values

    @property
    def dimensions(self) -> list[str]:
        return [str(dimension) for dimension in self.answer[RESULT].dims]

    def axis(self, name: str) -> _Axis:
        coordinate = self.answer.coords[name]
        scale, unit = _shown(coordinate.attrs.get("units", "1"))
        return _Axis(str(coordinate.dims[0]), scale * coordinate.values, self.varied[name], unit)

    def parts(self, most: int) -> list[_Part]:
        """One for each combination of options."""
        found = product(*(enumerate(self.answer.coords[option].values) for option in self.options))
        parts = []
        for combination in islice(found, most):
            at = {option: i for option, (i, _) in zip(self.options, combination, strict=True)}
            labels = (_option(option, value) for option, (_, value) in zip(self.options, combination, strict=True))
            parts.append(_Part(tuple(at.get(d, slice(None)) for d in self.dimensions), ", ".join(labels)))
        return parts

    def slices(self, name: str, most: int) -> list[_Part]:
        """Some of the values along an axis, as parts."""
        axis = self.axis(name)
        return [
            _Part(
                tuple(int(i) if d == name else slice(None) for d in self.dimensions),
                f"{axis.words} = {axis.values[i]:.4g} {axis.unit}".strip().replace("-", "\N{MINUS SIGN}"),
            )
            for i in _spread(len(axis.values), most)
        ]


class _Marks:
    """Gathers what a legend has to say, each thing once."""

    def __init__(self) -> None:
        self._curves: dict[str, Any] = {}
        self._others: dict[str, Any] = {}

    def curve(self, label: str, handle: Any) -> None:
        if label:
            self._curves.setdefault(label, handle)

    def other(self, label: str, handle: Any) -> None:
        self._others.setdefault(label, handle)

    def draw(self, figure: Figure) -> None:
        handles = self._curves | self._others
        if handles:
            columns = min(2 if figure.get_figwidth() < draw.DOUBLE_COLUMN else 4, len(handles))
            figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=columns)


# --- what is drawn -------------------------------------------------------------------------------


def _thinned(answer: "xarray.Dataset", dimensions: list[str], most: int) -> "xarray.Dataset":
    """No more than so many values along each dimension, samples in all, in ascending order."""
    sampled = [dimension for dimension in dimensions if dimension not in answer.coords]
    others = int(np.prod([answer.sizes[dimension] for dimension in dimensions if dimension not in sampled]))
    few = max(most // others, 1) if sampled else most
    places = {d: _spread(answer.sizes[d], few if d in sampled or not sampled else most) for d in dimensions}
    answer = answer.isel(places).load()
    return answer.sortby([dimension for dimension in dimensions if dimension not in sampled])


def _spread(size: int, most: int) -> np.ndarray:
    """Places all over an axis, its ends among them."""
    return np.unique(np.linspace(0, size - 1, min(size, most)).round().astype(int))


def _quantities(answer: "xarray.Dataset", outputs: Sequence[str]) -> list[_Quantity]:
    """The outputs, component by component."""
    found, rank = [], answer[RESULT].ndim
    lost = _lost(answer, outputs)
    for name in outputs:
        scale, unit = (100.0, "%") if name == "tension_loss" else _shown(answer[name].attrs.get("units", "1"))
        values, own = answer[name].values, answer[name].dims[rank:]
        for place in np.ndindex(values.shape[rank:]):
            told = [_component(str(d), i, answer.sizes[d]) for d, i in zip(own, place, strict=True)]
            words = " ".join([in_words(name), *filter(None, told)])
            numbers = np.where(lost, np.nan, scale * values[(..., *place)])
            found.append(_Quantity(numbers, _label(words, unit), values.dtype.kind == "b"))
    return found[:PANELS]


def _lost(answer: "xarray.Dataset", outputs: Sequence[str]) -> np.ndarray:
    """Where a solve gave no numbers, which whole numbers and true or false cannot tell."""
    rank, lost = answer[RESULT].ndim, answer[RESULT].values < 0
    for values in (answer[name].values for name in outputs if answer[name].dtype.kind == "f"):
        lost |= np.any(np.isnan(values), axis=tuple(range(rank, values.ndim)))
    return lost


def _component(dimension: str, place: int, size: int) -> str:
    if dimension == "component":
        return COMPONENTS[place]
    return f"of tendon {place + 1}" if size > 1 else ""


def _shown(unit: str) -> tuple[float, str]:
    """What to multiply SI by, and the unit that then holds."""
    return SHOWN.get(unit, (1.0, "" if unit == "1" else unit))


def _label(words: str, unit: str) -> str:
    return f"{words} ({unit})" if unit else words


def in_words(name: str) -> str:
    """The name of a number or output in words: "loads.tip_force.1" is "Tip force Y"."""
    if name == "youngs_modulus":
        return "Young's modulus"
    parts = name.removeprefix("loads.").replace("tendons.", "tendon.").split(".")
    places = COMPONENTS if parts[0] in ("tip_force", "gravity") else range(1, 100)
    words = " ".join(str(places[int(part)]) if part.isdigit() else part for part in parts).replace("_", " ")
    return words[:1].upper() + words[1:]


def _option(name: str, value: Any) -> str:
    return f"{value} kinematics" if name == "kinematics" else f"{value} {name}"


def _names(codes: np.ndarray) -> str:
    """The results among some codes in words."""
    return ", ".join(RESULT_NAMES[code].replace("_", " ") for code in np.unique(codes))


def _format(axes: Axes, quantity: _Quantity) -> None:
    axes.ticklabel_format(useOffset=False)
    if quantity.yes_or_no:
        axes.set_ylim(-0.15, 1.15)
        axes.set_yticks([0, 1], ["no", "yes"])


# --- lines ---------------------------------------------------------------------------------------


def _lines(view: _View, number: str) -> Figure:
    """A panel for each quantity, a line for each combination of options."""
    axis, codes, marks = view.axis(number), view.codes, _Marks()
    with draw.house_style():
        figure, panels = draw.panels(len(view.quantities), 2, 2.1)
        for panel, quantity in zip(panels, view.quantities, strict=True):
            for part, look in zip(view.parts(LINES), draw.CURVES, strict=False):
                y, code = quantity.values[part.place], codes[part.place]
                drawn: dict[str, Any] = look | ({} if len(y) <= MARKED else {"marker": "none"})
                (line,) = panel.plot(axis.values, np.where(code == SUCCESSFUL, y, np.nan), **drawn)
                marks.curve(part.label, line)
                _draw_others(panel, axis.values, y, code, look | {"markersize": 4.2}, marks)
            panel.set(xlabel=axis.label, ylabel=quantity.label)
            panel.margins(x=0.02)
            _format(panel, quantity)
        marks.draw(figure)
        figure.align_labels()
    return figure


def _draw_others(
    axes: Axes, x: np.ndarray, y: np.ndarray, codes: np.ndarray, look: dict[str, Any], marks: _Marks
) -> None:
    """Solves that are doubtful, hollow and alone, and those that gave no number, at the foot."""
    others, there = codes != SUCCESSFUL, np.isfinite(y)
    if np.any(doubtful := others & there):
        hollow: dict[str, Any] = {name: look[name] for name in ("marker", "color", "markersize")}
        (points,) = axes.plot(x[doubtful], y[doubtful], linestyle="none", mew=0.7, mfc="white", zorder=1.9, **hollow)
        marks.other(f"hollow: doubtful, {_names(codes[doubtful])}", points)
    if np.any(failed := others & ~there):
        foot = {"transform": axes.get_xaxis_transform(), "color": draw.BLACK, "markersize": 3.5, "zorder": 4}
        (points,) = axes.plot(x[failed], np.full(failed.sum(), 0.03), "x", markeredgewidth=0.7, **foot)
        marks.other(f"at the foot: no number, {_names(codes[failed])}", points)


# --- contours ------------------------------------------------------------------------------------


def _contours(view: _View, numbers: list[str]) -> Figure:
    """A panel for each quantity; for options or a third axis a row of panels for each, with one scale of colours."""
    parts = view.slices(numbers[0], COLUMNS) if len(numbers) == 3 else view.parts(COLUMNS)
    x, y = (view.axis(name) for name in numbers[-2:])
    codes, marks = [view.codes[part.place] for part in parts], _Marks()
    with draw.house_style():
        figure, rows = _grid(len(view.quantities), len(parts))
        for row, quantity in zip(rows, view.quantities, strict=True):
            values = [quantity.values[part.place] for part in parts]
            sure = [np.where(code == SUCCESSFUL, value, np.nan) for code, value in zip(codes, values, strict=True)]
            levels = _levels(np.stack(sure))
            look = {"cmap": draw.TENSION_COLOURS, "norm": BoundaryNorm(levels, 256)}
            for panel, value in zip(row, sure, strict=True):
                _draw_contours(panel, (x.values, y.values, value.T), levels, look, labelled=len(parts) < 3)
            figure.colorbar(ScalarMappable(**look), ax=row, label=quantity.label, pad=0.02, aspect=25)
        _hatch(rows, codes, marks)
        _label_grid(rows, x.label, y.label, [part.label for part in parts])
        marks.draw(figure)
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


def _hatch(rows: list[list[Axes]], codes: list[np.ndarray], marks: _Marks) -> None:
    """What shows where nothing is drawn: a grey ground with hatching."""
    others = np.concatenate([code[code != SUCCESSFUL] for code in codes])
    if not others.size:
        return
    look = {"facecolor": draw.PALE, "edgecolor": draw.GREY, "hatch": "/////", "linewidth": 0.0}
    for panel in (panel for row in rows for panel in row):
        panel.add_patch(Rectangle((0, 0), 1, 1, transform=panel.transAxes, zorder=0, **look))
    marks.other(f"hatched: {_names(others)}", Patch(**look))


# --- dots ----------------------------------------------------------------------------------------


def _dots(view: _View) -> Figure:
    """A row for each quantity, a column for each number that varies."""
    dimensions, codes, marks = view.dimensions, view.codes, _Marks()
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
                marks.curve(part.label, _draw_dots(panel, points, look, marks))
            panel.set(xlabel=axis.label if i == len(panels) - 1 else "", ylabel=quantity.label if k == 0 else "")
            _format(panel, quantity)
            panel.xaxis.set_major_locator(MaxNLocator(4))
        marks.draw(figure)
        figure.align_labels()
    return figure


def _draw_dots(axes: Axes, points: list[np.ndarray], look: dict[str, Any], marks: _Marks) -> Line2D:
    x, y, codes = points
    sure = codes == SUCCESSFUL
    size = float(np.clip(60.0 / np.sqrt(len(x)), 1.2, 3.5))
    dots = {"marker": look["marker"], "color": look["color"], "markersize": size, "markeredgewidth": 0, "alpha": 0.6}
    (line,) = axes.plot(x[sure], y[sure], linestyle="none", rasterized=len(x) > 500, **dots)
    _draw_others(axes, x, y, codes, look | {"markersize": max(size, 2.4)}, marks)
    return line
