"""Figures of sweeps: outputs over one number as lines, over two as contours.

A sweep is first brought into the units of its labels. The result of each solve is then a coordinate of every output,
so that every part of an output knows which of its solves failed.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ..errors import InputError
from ..quantities import QUANTITIES
from ..statics.status import Status
from ..sweeping.axes import PATH
from ..sweeping.one_solve import RESULT
from ..units import DIMENSION_OF, preferred
from . import looks, style as draw

if TYPE_CHECKING:
    import xarray

LINES, VALUES = len(looks.CURVES), 500  # drawn at most: lines, and values along each axis
# which part of an output
PARTS: dict[str, Callable[[Any], str]] = {
    "tendon": lambda number: f"of tendon {number + 1}",
    "component": str,
    "axis": lambda axis: f"axis {axis}",
}
MARKED = 30  # values up to which a line has a marker at each


# --- one output ----------------------------------------------------------------------------------


def draw_lines(dataset: "xarray.Dataset", output: str, over: str, axes: Axes | None = None) -> Axes:
    """An output of a sweep over one number, in mm, deg, MPa and else SI units.

    There is a line for each combination of what else varies, at most six: values of other axes, tendons,
    components. The line consists of successful solves. Doubtful solves are hollow markers, and failed solves
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
    others = [str(dimension) for dimension in array.dims if dimension != over]
    places = np.ndindex(*(array.sizes[dimension] for dimension in others))
    with draw.axes_or_new(axes, 2.4) as axes:
        for place, look in zip(places, looks.CURVES, strict=False):
            at = dict(zip(others, place, strict=True))
            label = ", ".join(value_words(array[name], i) for name, i in at.items())
            _draw_curve(axes, array.isel(at), over, look | {"label": label})
        axes.set(xlabel=axis_label(array[over]), ylabel=axis_label(array))
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
        _draw_map(axes, array, x, y)
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
    numbers = [name for name in varying_numbers(answer) if answer[name].ndim == 1]
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
    some = answer.isel({name: spread(answer.sizes[name], VALUES) for name in over}).load()
    some = some.sortby([name for name in over if name != answer.attrs.get(PATH)])
    return in_label_units(some)[output].transpose(*over, ...)


# --- all outputs ---------------------------------------------------------------------------------


def sweep_figure(answer: "xarray.Dataset", outputs: Sequence[str]) -> Figure:
    """Outputs over one axis as lines, over two as contours, over a path as loops; a panel for each component.

    Doubtful solves are hollow, or left out of contours, and failed solves are marked; the legend says why.

    Args:
        answer: of `sweep`.
        outputs: names of those to draw, which do not run along the body.

    Raises:
        InputError: where no number varies, or too many for one figure; choose some of them with xarray.
    """
    answer = answer.drop_dims("point", errors="ignore").squeeze(drop=True)
    dims = [str(dimension) for dimension in answer[RESULT].dims]
    over = [name for name in dims if name in varying_numbers(answer)]
    if (path := answer.attrs.get(PATH)) in dims:
        over = [path]
    if not over:
        raise InputError("no number varies along an axis of its own; choose what to draw with xarray")
    if len(over) > 2 or (len(over) == 2 and len(dims) > 2):
        raise InputError(f"{len(dims)} axes are too many for one figure; choose with xarray")
    one = draw_lines if len(over) == 1 else draw_map
    parts = [(part, name) for name in outputs for part in _components(answer, name)]
    return draw.panels_figure(lambda panel, part: one(*part, *over, axes=panel), parts, 2.1)


def _components(answer: "xarray.Dataset", name: str) -> "list[xarray.Dataset]":
    """The sweep with one component of an output, for each of them."""
    parts = [answer]
    for dimension in answer[name].dims:
        if dimension not in answer[RESULT].dims:
            parts = [part.isel({dimension: i}) for part in parts for i in range(part.sizes[dimension])]
    return parts


def spread(size: int, most: int) -> np.ndarray:
    """At most `most` places, evenly spread over an axis, with both ends."""
    return np.unique(np.linspace(0, size - 1, min(size, most)).round().astype(int))


# --- drawing -------------------------------------------------------------------------------------


def _draw_curve(axes: Axes, array: "xarray.DataArray", over: str, look: looks.Look) -> None:
    """A line of successful solves; doubtful ones as hollow markers, those without a number as crosses at the foot."""
    x, y, codes = array[over].values, array.values, array[RESULT].values
    sure, there = codes == Status.successful, np.isfinite(y)
    line: looks.Look = look | ({"marker": "none"} if x.size > MARKED else {})
    axes.plot(x, np.where(sure, y, np.nan), **line)
    for start, end in pairwise(draw.turning_places(x)) if array[over].attrs["is_path"] else ():
        draw.draw_arrow(axes, x[start : end + 1], y[start : end + 1], look["color"])
    if np.any(doubtful := ~sure & there):
        hollow = {"linestyle": "none", "markerfacecolor": "white", "markeredgewidth": 0.7, "zorder": 1.9}
        hollow["label"] = f"hollow: doubtful, {results_in_words(codes[doubtful])}"
        axes.plot(x[doubtful], y[doubtful], **(look | hollow))
    if np.any(failed := ~sure & ~there):
        foot: looks.Look = {"transform": axes.get_xaxis_transform(), "markeredgewidth": 0.7, "zorder": 4}
        foot["label"] = f"at the foot: no number, {results_in_words(codes[failed])}"
        axes.plot(x[failed], np.full(failed.sum(), 0.03), "x", color=looks.BLACK, **foot)


def _draw_map(axes: Axes, array: "xarray.DataArray", x: str, y: str) -> None:
    """Contours with a scale of colours beside them; hatched where nothing is drawn."""
    points, lost = (array[x].values, array[y].values), results_in_words(array[RESULT].values)
    values = np.ma.masked_invalid(array.where(array[RESULT] == Status.successful).transpose(y, x).values)
    axes.set(xlim=points[0][[0, -1]], ylim=points[1][[0, -1]], axisbelow=False)
    axes.set(xlabel=axis_label(array[x]), ylabel=axis_label(array[y]))
    if values.count():
        filled = axes.contourf(*points, values, 8, cmap=draw.TENSION_COLOURS)
        if within := [level for level in filled.levels if values.min() < level < values.max()]:
            axes.contour(*points, values, within, colors=looks.BLACK, linewidths=0.5, linestyles="solid")
        draw.scale_beside(axes, filled, axis_label(array))
    if lost:
        look = {"facecolor": looks.PALE, "edgecolor": looks.GREY, "hatch": "/////", "linewidth": 0.0, "zorder": 0}
        axes.add_patch(Rectangle((0, 0), 1, 1, transform=axes.transAxes, label=f"hatched: {lost}", **look))


# --- labels ----------------------------------------------------------------------------------------


def in_label_units(answer: "xarray.Dataset") -> "xarray.Dataset":
    """A sweep in the units of its labels, NaN where there is no number; the results are a coordinate of each output."""
    there = answer[RESULT] >= 0
    for array in answer.data_vars.values():
        if array.dtype.kind == "f":
            there = there & array.notnull().all([d for d in array.dims if d not in there.dims])

    def shown(array: "xarray.DataArray") -> tuple[object, np.ndarray, dict[str, object]]:
        name, unit = str(array.name), array.attrs.get("units", "1")
        scale, unit = preferred(DIMENSION_OF[unit]) if unit in DIMENSION_OF else (1.0, unit)
        if name in QUANTITIES and QUANTITIES[name].dimension == "strain":
            scale, unit = preferred("strain")
        # integers and booleans cannot be NaN: other outputs show where there is no number
        values = array if array.dtype.kind == "f" else array.where(there).transpose(*array.dims)
        attrs = {"words": name_in_words(name), "unit": unit, "is_path": name == answer.attrs.get(PATH)}
        return array.dims, np.asarray(scale * values), attrs

    outputs = {name: shown(array) for name, array in answer.data_vars.items() if name != RESULT}
    numbers = {name: shown(answer[name]) for name in varying_numbers(answer)}
    return answer.assign(outputs).assign_coords(numbers).set_coords(RESULT)


def varying_numbers(answer: "xarray.Dataset") -> list[str]:
    """The names of all numbers that vary."""
    return [str(n) for n, c in answer.coords.items() if np.issubdtype(c.dtype, np.number) and n not in PARTS]


def value_words(coordinate: "xarray.DataArray", place: int) -> str:
    """The value at a place along a dimension: "tendon 2", "exact kinematics", "Friction coefficient = 0.4"."""
    name, value = str(coordinate.name), coordinate.values[place]
    if name in PARTS:
        return PARTS[name](value).removeprefix("of ")
    if "words" not in coordinate.attrs:
        return f"{value} {name}"
    words = f"{coordinate.attrs['words']} = {value:.4g} {coordinate.attrs['unit']}"
    return words.strip().replace("-", "\N{MINUS SIGN}")


def axis_label(array: "xarray.DataArray") -> str:
    """Name, part of an output, and unit: "Tip tension of tendon 2 (N)"."""
    at = {} if array.name in array.coords else array.coords
    parts = [words(at[name].item()) for name, words in PARTS.items() if name in at and not at[name].ndim]
    unit = f"({array.attrs['unit']})" if array.attrs["unit"] else ""
    return " ".join(filter(None, [array.attrs["words"], *parts, unit]))


def name_in_words(name: str) -> str:
    """The name of a number or output in words: "outer_radius.tip" is "Outer radius tip"."""
    if name in QUANTITIES:
        return QUANTITIES[name].label
    words = name.removeprefix("loads.").replace(".", " ").replace("_", " ")
    return words[:1].upper() + words[1:]


def results_in_words(codes: np.ndarray) -> str:
    """The results of the solves that were not successful."""
    return ", ".join(Status(code).name.replace("_", " ") for code in np.unique(codes) if code != Status.successful)
