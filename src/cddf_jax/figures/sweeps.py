"""Figures of sweeps: outputs over one number as lines, over two or three as contours, over samples as dots."""

from collections.abc import Mapping, Sequence
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ..errors import InputError
from ..sweeping.axes import OPTIONS
from ..sweeping.one_solve import RESULT
from . import style as draw
from .sweep_panels import (
    components,
    draw_curves,
    draw_dots,
    draw_maps,
    is_numeric,
    labelled,
    name_in_words,
    needed_for,
    part_words,
    parts_of,
    shown_values,
    write_ticks,
)

if TYPE_CHECKING:
    import xarray

LINES, COLUMNS, DOT_COLUMNS, PANELS = len(draw.CURVES), 4, 6, 12  # drawn at most
SAMPLES, VALUES = 3000, {1: 2000, 2: 300}  # drawn at most: in all, and along each of one or two axes
NEAR = 1e-6  # relative: a value of the user that is this near to one along an axis means it


# --- one output ----------------------------------------------------------------------------------


def draw_lines(
    dataset: "xarray.Dataset", output: str, over: str, axes: Axes | None = None, **selection: object
) -> Axes:
    """An output of a sweep over one number, in mm, deg, MPa and else SI units.

    There is a line for each combination of what else varies, six at most: values of another axis, kinematics,
    tendons, components. Successful solves make the line. Doubtful solves are hollow markers beside it. Failed solves
    are crosses at the foot. The legend says why.

    Args:
        dataset: of `sweep`.
        output: the name of an output, as "tip_tension".
        over: the name of a number along an axis, as "base_tension".
        axes: where to draw; None for a new figure, one column wide.
        selection: values of other axes, SI units; `tendon` from 0, `component` "X" or "Y". Names that hold a dot
            are given as `**{"outer_radius.tip": 0.013}`.

    Raises:
        InputError: for names and values that are not there, or too many lines.
    """
    array = _chosen("draw_lines", dataset, output, (over,), selection, LINES)
    with draw.axes_or_new(axes, 2.4) as axes:
        draw_curves(axes, array, over)
        draw.legend_above(axes)
    return axes


def draw_map(
    dataset: "xarray.Dataset", output: str, x: str, y: str, axes: Axes | None = None, **selection: object
) -> Axes:
    """Contours of an output of a sweep over two numbers, in mm, deg, MPa and else SI units; the scale stands beside.

    Where a solve failed or is doubtful the map is left blank and hatched. The legend says why.

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
    array = _chosen("draw_map", dataset, output, (x, y), selection, 1)
    with draw.axes_or_new(axes, 2.5) as axes:
        draw_maps([axes], [array], x, y)
        axes.set(xlabel=array[x].attrs["label"], ylabel=array[y].attrs["label"])
        draw.legend_above(axes)
    return axes


def _chosen(
    who: str, dataset: "xarray.Dataset", output: str, over: Sequence[str], selection: Mapping[str, object], most: int
) -> "xarray.DataArray":
    """An output over one or two numbers and what else varies, of which there may be `most` combinations."""
    if output not in dataset.data_vars or RESULT not in dataset.data_vars:
        raise InputError(f"{who}: {output!r} is no output of this sweep; there are {', '.join(map(str, dataset))}")
    answer = needed_for(dataset, [output])
    for name, value in selection.items():
        answer = answer.isel(_place(who, answer, name, value))
    own = [_dimension(who, answer, name) for name in over]
    if len(set(own)) < len(own):
        raise InputError(f"{who}: x and y must be numbers along two different axes, got {' and '.join(over)}")
    answer = answer.isel({d: 0 for d in answer[output].dims if d not in own and answer.sizes[d] == 1})
    rest = [str(d) for d in answer[output].dims if d not in own]
    if int(np.prod([answer.sizes[d] for d in rest])) > most:
        raise InputError(f"{who}: {_too_many(answer, max(rest, key=lambda d: answer.sizes[d]))}")
    answer = answer.isel({d: _spread(answer.sizes[d], VALUES[len(own)]) for d in own}).load().sortby(list(over))
    chosen = {str(d): answer[d].item() for d in dataset[output].dims if d in ("tendon", "component") and d not in rest}
    words = [part_words(d, value) for d, value in chosen.items() if dataset.sizes[d] > 1]
    return labelled(shown_values(answer, output, {}), words).transpose(*own, *rest)


def _place(who: str, answer: "xarray.Dataset", name: str, value: object) -> dict[str, int]:
    """Where an axis has a value, as `isel` takes it."""
    if name not in answer.coords or answer.coords[name].ndim != 1:
        there = [str(key) for key, coordinate in answer.coords.items() if coordinate.ndim == 1]
        raise InputError(f"{who}: nothing varies along {name!r}; there are {', '.join(there)}")
    (dimension,), values = answer.coords[name].dims, answer.coords[name].values
    wanted = np.asarray(value)
    if is_numeric(values) and is_numeric(wanted) and wanted.ndim == 0:
        place = int(np.argmin(np.abs(values - wanted)))
        found = bool(abs(values[place] - wanted) <= NEAR * max(abs(wanted), np.ptp(values)))
        hint = f"the nearest is {values[place]:.10g}"
    else:
        found, place = bool(np.any(values == wanted)), int(np.argmax(values == wanted))
        hint = f"there are {', '.join(map(str, values))}"
    if not found:
        raise InputError(f"{who}: {name} has no value {value!r}; {hint}")
    return {str(dimension): place}


def _dimension(who: str, answer: "xarray.Dataset", name: str) -> str:
    """The dimension along which a number varies."""
    numbers = [str(key) for key, c in answer.coords.items() if c.ndim == 1 and is_numeric(c.values)]
    if name not in numbers:
        there = ", ".join(key for key in numbers if key != "tendon") or "none left"
        raise InputError(f"{who}: {name!r} is no number that varies; there are {there}")
    (dimension,), steps = answer.coords[name].dims, np.diff(answer.coords[name].values)
    if dimension != name and not (np.all(steps > 0) or np.all(steps < 0)):
        raise InputError(
            f"{who}: {name} varies together with others along {dimension!r}, in no order; sweep_figure draws samples"
        )
    return str(dimension)


def _too_many(answer: "xarray.Dataset", name: str) -> str:
    said = f"{name} varies too, with {answer.sizes[name]} values"
    if name not in answer.coords:
        return f"{said}; choose with dataset.isel({name}=0)"
    value = answer.coords[name].values.tolist()[0]
    keyword = f"{name}={value!r}" if name.isidentifier() else f"**{{{name!r}: {value!r}}}"
    return f"{said}; choose one, as in {keyword}"


# --- all outputs ---------------------------------------------------------------------------------


def sweep_figure(
    answer: "xarray.Dataset", outputs: Sequence[str], varied: Mapping[str, str] | None = None
) -> Figure | str:
    """Outputs over one axis as lines, over two or three as contours, over samples as dots.

    Successful solves are drawn as they are. Doubtful numbers are hollow, or left out of contours, and failed solves
    are marked; the legend says why. Outputs along the body have no panel.

    Args:
        answer: of `sweep`.
        outputs: names of those to be drawn; the first dozen of their components are.
        varied: the names of all that varies, in the order of columns, and in words for labels; unless given all
            coordinates.

    Returns:
        The figure; or in words why there is none.
    """
    answer = answer.isel({d: 0 for d in answer[RESULT].dims if answer.sizes[d] == 1})
    kinds = _kinds(answer)
    drawn = [name for name in outputs if "point" not in answer[name].dims]
    if not drawn:
        return "outputs along the body are not drawn over what varies"
    if not kinds.numbers and not kinds.sampled:
        return "no number varies"
    if not kinds.sampled and len(kinds.numbers) > 3 - bool(kinds.options):
        count = f"{len(kinds.numbers)} axes{' and options' if kinds.options else ''}"
        return f"{count} are too many for one; choose with xarray"
    if varied is None:
        varied = {str(name): name_in_words(str(name)) for name in answer.coords if name not in ("tendon", "component")}
    answer = _thinned(needed_for(answer, drawn), kinds)
    each = (part for name in drawn for part in components(shown_values(answer, name, varied), answer[RESULT].dims))
    arrays = list(islice(each, PANELS))
    if kinds.sampled:
        numbers = [name for name in varied if name not in OPTIONS and answer.coords[name].ndim]
        return _dots_figure(arrays, numbers[:DOT_COLUMNS], kinds.options)
    return _lines_figure(arrays, *kinds.numbers) if len(kinds.numbers) == 1 else _maps_figure(arrays, kinds)


def left_out_of_figure(answer: "xarray.Dataset", outputs: Sequence[str]) -> list[str]:
    """What the figure of a sweep has no room for, in words."""
    sizes = {str(name): answer.sizes[name] for name in answer[RESULT].dims if answer.sizes[name] > 1}
    kinds = _kinds(answer.isel({d: 0 for d in answer[RESULT].dims if answer.sizes[d] == 1}))
    drawn = [name for name in outputs if "point" not in answer[name].dims]
    found = [f"{name}, which runs along the body" for name in outputs if name not in drawn]
    varied = [name for name, c in answer.coords.items() if c.ndim > 0 and name not in ("tendon", "component")]
    components = sum(int(np.prod(answer[name].shape[answer[RESULT].ndim :])) for name in drawn)
    combinations = int(np.prod([sizes[name] for name in kinds.options]))
    lines = bool(kinds.sampled) or len(kinds.numbers) == 1
    counts = [(components, PANELS, "components of outputs")]
    counts += [(combinations, LINES if lines else COLUMNS, "combinations of options")]
    counts += [(sizes[name], COLUMNS, f"values of {name}") for name in kinds.numbers[:1] if len(kinds.numbers) == 3]
    counts += [(len(varied), DOT_COLUMNS, "numbers that vary")] if kinds.sampled else []
    counts += [(sizes[name], SAMPLES, "samples") for name in kinds.sampled[:1]]
    return found + [f"{count - room:,} of {count:,} {what}" for count, room, what in counts if count > room]


class _Kinds(NamedTuple):
    """The dimensions of a sweep by what varies along them."""

    sampled: list[str]  # several numbers together
    options: list[str]
    numbers: list[str]


def _kinds(answer: "xarray.Dataset") -> _Kinds:
    dimensions = [str(dimension) for dimension in answer[RESULT].dims]
    sampled = [dimension for dimension in dimensions if dimension not in answer.coords]
    options = [dimension for dimension in dimensions if dimension in OPTIONS]
    return _Kinds(sampled, options, [name for name in dimensions if name not in (*sampled, *options)])


def _thinned(answer: "xarray.Dataset", kinds: _Kinds) -> "xarray.Dataset":
    """No more than can be seen along each number or of the samples, in ascending order."""
    most = SAMPLES if kinds.sampled else VALUES[min(len(kinds.numbers), 2)]
    sizes = {name: min(answer.sizes[name], most) for name in kinds.numbers}
    few = max(SAMPLES // int(np.prod(list(sizes.values()))), 1)
    sizes |= dict.fromkeys(kinds.sampled, few)
    return answer.isel({d: _spread(answer.sizes[d], size) for d, size in sizes.items()}).load().sortby(kinds.numbers)


def _spread(size: int, most: int) -> np.ndarray:
    """Places all over an axis, its ends among them."""
    return np.unique(np.linspace(0, size - 1, min(size, most)).round().astype(int))


def _lines_figure(arrays: Sequence["xarray.DataArray"], number: str) -> Figure:
    """A panel for each array, a line for each combination of options."""
    with draw.house_style():
        figure, panels = draw.panel_axes(len(arrays), 2, 2.1)
        for panel, array in zip(panels, arrays, strict=True):
            draw_curves(panel, array, number)
        draw.common_legend(figure, panels)
        figure.align_labels()
    return figure


def _maps_figure(arrays: Sequence["xarray.DataArray"], kinds: _Kinds) -> Figure:
    """A panel for each array; for options or a third axis a row of panels for each, with one scale of colours."""
    *third, x, y = kinds.numbers
    arrays = [array.isel({d: _spread(array.sizes[d], COLUMNS) for d in third}) for array in arrays]
    rows = [list(islice(parts_of(array, (x, y)), COLUMNS)) for array in arrays]
    titles = [title for title, _ in rows[0]]
    alone = len(titles) == 1
    with draw.house_style():
        if alone:
            figure, each = draw.panel_axes(len(arrays), 2, 2.2)
            panels = np.array(each, object)[:, None]
        else:
            figure = draw.new_figure(draw.DOUBLE_COLUMN, (2.2 if len(titles) < 4 else 1.7) * len(arrays) + 0.4)
            panels = figure.subplots(len(arrays), len(titles), squeeze=False, sharex=True, sharey=True)
        for row, parts in zip(panels, rows, strict=True):
            draw_maps(row.tolist(), [part for _, part in parts], x, y)
        for (i, k), panel in np.ndenumerate(panels):
            panel.set_xlabel(arrays[0][x].attrs["label"] if alone or i == len(rows) - 1 else "")
            panel.set_ylabel(arrays[0][y].attrs["label"] if alone or k == 0 else "")
            panel.set_title(titles[k] if i == 0 else "")
        draw.common_legend(figure, panels.ravel().tolist())
    return figure


def _dots_figure(arrays: Sequence["xarray.DataArray"], numbers: Sequence[str], options: Sequence[str]) -> Figure:
    """A row for each array, a column for each number that varies."""
    with draw.house_style():
        width = draw.SINGLE_COLUMN if len(numbers) == 1 else draw.DOUBLE_COLUMN
        figure = draw.new_figure(width, (2.2 if len(numbers) == 1 else 1.6) * len(arrays) + 0.4)
        panels = figure.subplots(len(arrays), len(numbers), squeeze=False, sharex="col", sharey="row")
        for (i, k), panel in np.ndenumerate(panels):
            array, name = arrays[int(i)], numbers[int(k)]
            parts = parts_of(array, [d for d in array.dims if d not in options])
            for (label, part), look in zip(parts, draw.CURVES, strict=False):
                draw_dots(panel, part, name, look, label)
            x_label = array[name].attrs["label"] if i == len(arrays) - 1 else ""
            panel.set(xlabel=x_label, ylabel=array.attrs["label"] if k == 0 else "")
            write_ticks(panel, array)
            panel.xaxis.set_major_locator(MaxNLocator(4))
        draw.common_legend(figure, panels.ravel().tolist())
        figure.align_labels()
    return figure
