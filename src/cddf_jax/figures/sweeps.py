"""Figures of sweeps: outputs over one number as lines, over two or three as contours, over samples as dots.

A sweep is first brought into the units of its labels. The result of each solve is then a coordinate of every output, so
that every part of an output knows which of its solves failed.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice, pairwise, product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from ..errors import InputError
from ..statics.status import Status
from ..sweeping.axes import OPTIONS, PATH
from ..sweeping.one_solve import RESULT
from . import looks, style as draw, sweep_labels as labels
from .sweep_labels import PARTS, axis_label, results_in_words

if TYPE_CHECKING:
    import xarray

LINES, COLUMNS, DOT_COLUMNS, PANELS = len(looks.CURVES), 4, 6, 12  # drawn at most
SAMPLES, VALUES = 3000, 500  # drawn at most: in all, and along each axis
MARKED = 30  # values up to which a line has a marker at each
LABELLED = 2  # maps beside each other up to which contours are labelled


# --- one output ----------------------------------------------------------------------------------


def draw_lines(dataset: "xarray.Dataset", output: str, over: str, axes: Axes | None = None) -> Axes:
    """An output of a sweep over one number, in mm, deg, MPa and else SI units.

    There is a line for each combination of what else varies, at most six: values of another axis, kinematics,
    tendons, components. The line consists of successful solves. Doubtful solves are hollow markers, and failed solves
    are crosses at the lower edge; the legend says why. A path of base tensions (`history=True`) is a loop with arrows.

    Args:
        dataset: of `sweep`, or a part of it, such as `dataset.sel(tendon=0)`.
        output: the name of an output, such as "tip_tension".
        over: the name of a number along an axis, such as "base_tension".
        axes: where to draw; None for a new figure, one column wide.

    Raises:
        InputError: for names that are not there, or too many lines.
    """
    array = _chosen("draw_lines", dataset, output, (over,), LINES)
    with draw.axes_or_new(axes, 2.4) as axes:
        _draw_curves(axes, array, over)
        draw.legend_above(axes)
    return axes


def draw_map(dataset: "xarray.Dataset", output: str, x: str, y: str, axes: Axes | None = None) -> Axes:
    """Contours of an output of a sweep over two numbers, in mm, deg, MPa and else SI units, with a colour scale.

    Where a solve failed or is doubtful, the map is hatched, and the legend says why.

    Args:
        dataset: of `sweep`; select one value of everything else that varies, such as `dataset.sel(tendon=0)`.
        output: the name of an output, such as "tip_tension".
        x, y: names of numbers along two axes, such as "base_tension".
        axes: where to draw; None for a new figure, one column wide.

    Raises:
        InputError: for names that are not there, or where more varies than x and y.
    """
    for name in (x, y):
        if name in dataset.coords and dataset[name].dims == (dataset.attrs.get(PATH),):
            raise InputError(f"draw_map: {name} is a path, on which tensions repeat; use draw_lines")
    array = _chosen("draw_map", dataset, output, (x, y), 1)
    with draw.axes_or_new(axes, 2.5) as axes:
        _draw_maps([axes], [array], x, y)
        draw.legend_above(axes)
    return axes


def _chosen(who: str, dataset: "xarray.Dataset", output: str, over: Sequence[str], most: int) -> "xarray.DataArray":
    """An output over one or two numbers and what else varies, of which there may be `most` combinations."""
    answer = dataset.drop_dims("point", errors="ignore").squeeze(drop=True)
    if output not in answer.data_vars or RESULT not in answer.data_vars:
        there = ", ".join(map(str, answer))
        raise InputError(
            f"{who}: {output!r} is not an output of this sweep, or is one along the body; there are {there}"
        )
    numbers = [name for name, c in _lists(answer).items() if labels.is_numeric(c.values) and name not in PARTS]
    if lost := [name for name in over if name not in numbers]:
        raise InputError(
            f"{who}: {lost[0]!r} is not a number that varies; there are {', '.join(numbers) or 'none left'}"
        )
    own = [answer[name].dims[0] for name in over]
    if len(set(own)) < len(own):
        raise InputError(f"{who}: x and y must be numbers along two different axes, got {' and '.join(over)}")
    others = {str(d): n for d, n in answer[output].sizes.items() if d not in own}
    if np.prod([*others.values()]) > most:
        name = max(others, key=others.__getitem__)
        remedy = f"choose one, as in dataset.isel({{{name!r}: 0}})"
        raise InputError(f"{who}: {name} varies too, with {others[name]} values; {remedy}")
    if (path := answer.attrs.get(PATH)) in own:
        answer = answer.assign_attrs({PATH: over[own.index(path)]})
    answer = answer.swap_dims(dict(zip(own, over, strict=True)))
    return labels.in_label_units(_thinned(answer, dict.fromkeys(over, VALUES)), {})[output].transpose(*over, ...)


def _lists(answer: "xarray.Dataset") -> "dict[str, xarray.DataArray]":
    """The coordinates along one dimension, by name."""
    return {str(name): c for name, c in answer.coords.items() if c.ndim == 1}


# --- all outputs ---------------------------------------------------------------------------------


def sweep_figure(
    answer: "xarray.Dataset", outputs: Sequence[str], varied: Mapping[str, str] | None = None
) -> Figure | str:
    """Outputs over one axis as lines, over two or three as contours, over samples as dots, over a path as loops.

    Doubtful solves are hollow, or left out of contours, and failed solves are marked; the legend says why. Outputs
    along the body have no panel.

    Args:
        answer: of `sweep`.
        outputs: names of those to draw; the first twelve of their components are drawn.
        varied: by the name of each number that varies, in the order of columns, its words for labels; all coordinates
            unless given.

    Returns:
        The figure; or in words why there is none.
    """
    names = [name for name in outputs if "point" not in answer[name].dims]
    answer = _over_a_tension(answer.drop_dims("point", errors="ignore").squeeze(drop=True))
    kinds = _kinds(answer)
    if not names:
        return "outputs along the body are not drawn over what varies"
    if not kinds.numbers and not kinds.sampled:
        return "no number varies"
    loops = answer.attrs.get(PATH) in kinds.numbers
    if not loops and not kinds.sampled and len(kinds.numbers) > 3 - bool(kinds.options):
        count = f"{len(kinds.numbers)} axes{' and options' if kinds.options else ''}"
        return f"{count} are too many for one; choose with xarray"
    varied = varied or {name: labels.name_in_words(name) for name in _lists(answer)}
    shown, swept = labels.in_label_units(_thinned(answer, kinds.most), varied), answer[RESULT].dims
    each = (part for name in names for _, part in _parts_of(shown[name], swept, PANELS))
    arrays = list(islice(each, PANELS))
    if loops:
        return _curves_figure(arrays, [answer.attrs[PATH]], 2)
    if kinds.sampled:
        numbers = [name for name in varied if name in shown.coords and name not in (*OPTIONS, *PARTS)][:DOT_COLUMNS]
        dots = [dimension for dimension in swept if dimension not in kinds.options]
        return _curves_figure(arrays, numbers, len(numbers), dots)
    return _curves_figure(arrays, kinds.numbers, 2) if len(kinds.numbers) == 1 else _maps_figure(arrays, kinds)


def left_out_of_figure(answer: "xarray.Dataset", outputs: Sequence[str]) -> list[str]:
    """What the figure of a sweep leaves out, in words."""
    names = [name for name in outputs if "point" not in answer[name].dims]
    short = _over_a_tension(answer.drop_dims("point", errors="ignore").squeeze(drop=True))
    kinds, sizes = _kinds(short), short.sizes
    varied = [name for name in short.coords if name not in (*OPTIONS, *PARTS)]
    components = sum(short[name].size // short[RESULT].size for name in names)
    combinations = int(np.prod([sizes[name] for name in kinds.options]))
    counts = [(components, PANELS, "components of outputs")]
    if short.attrs.get(PATH) in kinds.numbers:
        counts += [(short[RESULT].size // sizes[short.attrs[PATH]], LINES, "loops")]
    else:
        lines = bool(kinds.sampled) or len(kinds.numbers) == 1
        counts += [(combinations, LINES if lines else COLUMNS, "combinations of options")]
        counts += [(sizes[name], COLUMNS, f"values of {name}") for name in kinds.numbers[:-2]]
        counts += [(len(varied), DOT_COLUMNS, "numbers that vary")] if kinds.sampled else []
        counts += [(sizes[name], kinds.most[name], "samples") for name in kinds.sampled]
    along = [f"{name}, which runs along the body" for name in outputs if name not in names]
    return [*along, *(f"{count - most:,} of {count:,} {what}" for count, most, what in counts if count > most)]


def _over_a_tension(answer: "xarray.Dataset") -> "xarray.Dataset":
    """A path along which several numbers vary, over the base tension that varies most."""
    path = answer.attrs.get(PATH)
    if path in answer.coords or path not in answer.dims:
        return answer
    pulled = [name for name in _lists(answer) if name.startswith("base_tension") and answer[name].dims == (path,)]
    widest = max(pulled, key=lambda name: float(np.ptp(answer[name].values)))
    return answer.swap_dims({path: widest}).assign_attrs({PATH: widest})


class _Kinds(NamedTuple):
    """The dimensions of a sweep by what varies along them."""

    sampled: list[str]  # several numbers together
    options: list[str]
    numbers: list[str]
    most: dict[str, int]  # values along each number, and samples, that are drawn at most


def _kinds(answer: "xarray.Dataset") -> _Kinds:
    dimensions = [str(dimension) for dimension in answer[RESULT].dims]
    sampled = [dimension for dimension in dimensions if dimension not in answer.coords]
    options = [dimension for dimension in dimensions if dimension in OPTIONS]
    numbers = [dimension for dimension in dimensions if dimension not in (*sampled, *options)]
    places = int(np.prod([min(answer.sizes[name], VALUES) for name in numbers]))
    most = dict.fromkeys(numbers, VALUES) | dict.fromkeys(sampled, max(SAMPLES // places, 1))
    return _Kinds(sampled, options, numbers, most)


def _thinned(answer: "xarray.Dataset", most: Mapping[str, int]) -> "xarray.Dataset":
    """At most so many values along each dimension, in ascending order, except along a path."""
    some = answer.isel({name: _spread(answer.sizes[name], count) for name, count in most.items()}).load()
    return some.sortby([name for name in most if name in answer.coords and name != answer.attrs.get(PATH)])


def _spread(size: int, most: int) -> np.ndarray:
    """At most `most` places, evenly spread over an axis, with both ends."""
    return np.unique(np.linspace(0, size - 1, min(size, most)).round().astype(int))


def _curves_figure(
    arrays: Sequence["xarray.DataArray"], numbers: Sequence[str], columns: int, dots: Sequence[object] = ()
) -> Figure:
    """A panel for each array over each number, with a line or the dots of each combination of options."""

    def draw_one(panel: Axes, what: "tuple[xarray.DataArray, str]") -> None:
        _draw_curves(panel, *what, dots)
        if len(numbers) > 1:
            panel.label_outer()

    return draw.panels_figure(draw_one, list(product(arrays, numbers)), 2.1 if columns < 3 else 1.6, columns)


def _maps_figure(arrays: Sequence["xarray.DataArray"], kinds: _Kinds) -> Figure:
    """A panel for each array; with options or a third axis a row of panels for each array, with one colour scale."""
    *_, x, y = kinds.numbers
    rows = [list(_parts_of(array, (x, y), COLUMNS)) for array in arrays]
    across = len(rows[0])
    with draw.house_style():
        figure, panels = draw.panel_axes(len(rows) * across, max(across, 2), 2.2 if across < COLUMNS else 1.7)
        for i, row in enumerate(rows):
            own = panels[i * across : (i + 1) * across]
            _draw_maps(own, [part for _, part in row], x, y)
            for panel, (title, _) in zip(own if across > 1 else (), row, strict=False):
                panel.set_title(title if i == 0 else "")
                panel.label_outer()
        draw.common_legend(figure, panels)
    return figure


def _parts_of(array: "xarray.DataArray", over: Sequence[object], most: int) -> Iterator[tuple[str, "xarray.DataArray"]]:
    """An array over some dimensions for each combination of the others, with this in words; at most `most` of them."""
    others = [str(d) for d in array.dims if d not in over]
    places = list(np.ndindex(*(array.sizes[d] for d in others)))
    for k in _spread(len(places), most):
        at = dict(zip(others, places[k], strict=True))
        yield ", ".join(labels.value_words(array[d], i) for d, i in at.items()), array.isel(at)


# --- drawing -------------------------------------------------------------------------------------


def _draw_curves(axes: Axes, array: "xarray.DataArray", over: str, dots: Sequence[object] = ()) -> None:
    """A line for each combination of what else varies, and the solves that are doubtful or failed.

    Solves along the dimensions `dots` are drawn as dots of one colour, not as lines.
    """
    curves = []
    for (label, part), look in zip(_parts_of(array, dots or (over,), LINES), looks.CURVES, strict=False):
        x = part[over].broadcast_like(part).transpose(*part.dims).values.ravel()
        y, codes = part.values.ravel(), part[RESULT].values.ravel()
        style: looks.Look = look | ({"marker": "none"} if x.size > MARKED else {})
        if dots:
            style = look | {"linestyle": "none", "markeredgewidth": 0, "alpha": 0.6, "rasterized": x.size > 500}
            style["markersize"] = float(np.clip(60.0 / np.sqrt(x.size), 1.2, 3.5))
        axes.plot(x, np.where(codes == Status.successful, y, np.nan), label=label, **style)
        for start, end in pairwise(draw.turning_places(x)) if array[over].attrs["is_path"] else ():
            draw.draw_arrow(axes, x[start : end + 1], y[start : end + 1], look["color"])
        curves.append((x, y, codes, look))
    for x, y, codes, look in curves:
        _draw_others(axes, x, y, codes, look)
    axes.set(xlabel=axis_label(array[over]), ylabel=axis_label(array))
    if array.attrs["yes_or_no"]:
        axes.set_ylim(-0.15, 1.15)
        axes.set_yticks([0, 1], ["no", "yes"])


def _draw_others(axes: Axes, x: np.ndarray, y: np.ndarray, codes: np.ndarray, look: looks.Look) -> None:
    """Doubtful solves as hollow markers, and solves without a number as crosses at the lower edge."""
    others, there = codes != Status.successful, np.isfinite(y)
    if np.any(doubtful := others & there):
        label = f"hollow: doubtful, {results_in_words(codes[doubtful])}"
        hollow = {"linestyle": "none", "markerfacecolor": "white", "markeredgewidth": 0.7, "zorder": 1.9}
        axes.plot(x[doubtful], y[doubtful], label=label, **(look | hollow))
    if np.any(failed := others & ~there):
        label = f"at the foot: no number, {results_in_words(codes[failed])}"
        foot = {"transform": axes.get_xaxis_transform(), "markeredgewidth": 0.7, "zorder": 4, "label": label}
        axes.plot(x[failed], np.full(failed.sum(), 0.03), "x", color=looks.BLACK, **foot)


def _draw_maps(panels: Sequence[Axes], arrays: Sequence["xarray.DataArray"], x: str, y: str) -> None:
    """A panel for each array, with one scale of colours beside the last; hatched where nothing is drawn."""
    sure = [array.where(array[RESULT] == Status.successful).transpose(y, x) for array in arrays]
    numbers = [np.ma.masked_invalid(array.values) for array in sure]
    levels = _levels(np.ma.stack(numbers).compressed())
    norm, points = BoundaryNorm(levels, 256), (arrays[0][x].values, arrays[0][y].values)
    lost = results_in_words(np.array([array[RESULT].values for array in arrays]))
    for panel, values in zip(panels, numbers, strict=True):
        panel.set(xlim=points[0][[0, -1]], ylim=points[1][[0, -1]], axisbelow=False)
        panel.set(xlabel=axis_label(arrays[0][x]), ylabel=axis_label(arrays[0][y]))
        if values.count():
            panel.contourf(*points, values, levels=levels, cmap=draw.TENSION_COLOURS, norm=norm)
        within = [level for level in levels if values.count() and values.min() < level < values.max()]
        if within:
            lines = panel.contour(*points, values, within, colors=looks.BLACK, linewidths=0.5, linestyles="solid")
            if len(panels) <= LABELLED:
                _write_levels(panel, lines)
        if lost:
            look = {"facecolor": looks.PALE, "edgecolor": looks.GREY, "hatch": "/////", "linewidth": 0.0, "zorder": 0}
            panel.add_patch(Rectangle((0, 0), 1, 1, transform=panel.transAxes, label=f"hatched: {lost}", **look))
    scale = ScalarMappable(norm, draw.TENSION_COLOURS)
    draw.figure_of(panels[0]).colorbar(scale, ax=list(panels), label=axis_label(arrays[0]), pad=0.02, aspect=25)


def _levels(there: np.ndarray) -> np.ndarray:
    """Round numbers, between which all values lie."""
    low, high = (there.min(), there.max()) if there.size else (0.0, 1.0)
    if np.isclose(low, high, rtol=1e-9, atol=0.0):
        low, high = low - (0.01 * abs(low) or 1.0), high + (0.01 * abs(high) or 1.0)
    return np.asarray(MaxNLocator(8).tick_values(low, high))


def _write_levels(axes: Axes, lines: QuadContourSet) -> None:
    """The level on each line, unless it would lie over the frame."""
    for text in axes.clabel(lines, fmt="%g", fontsize=7, colors=looks.BLACK, inline=False):
        text.set_path_effects([withStroke(linewidth=2.0, foreground="white")])
        place = axes.transAxes.inverted().transform(axes.transData.transform(text.get_position()))
        text.set_visible(bool(np.all(np.abs(place - 0.5) < 0.44)))
