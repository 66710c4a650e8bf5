"""One array of a sweep, drawn: what varies and what failed, in the units and words of its labels.

Every output becomes an xarray array in the unit of its label. It is NaN where a solve gave no number, and the code of
each solve is its coordinate "result": so every part of the array that is drawn knows which of its solves failed.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm
from matplotlib.contour import QuadContourSet
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from ..quantities import QUANTITIES
from ..sweeping.axes import OPTIONS
from ..sweeping.one_solve import COMPONENTS, RESULT, RESULT_NAMES
from ..units import DIMENSION_OF, preferred
from . import style as draw

if TYPE_CHECKING:
    import xarray

SUCCESSFUL = RESULT_NAMES.index("successful")
MARKED = 30  # values up to which a line has a marker at each
LABELLED = 2  # maps beside each other up to which contours have their numbers
EDGE = 0.06  # of a map: nearer to its edge no contour has its number
SAME = 1e-9  # relative: values that differ by less are one

Look = Mapping[str, Any]  # one of `draw.CURVES`

# --- arrays, units and words ---------------------------------------------------------------------


def shown_values(answer: "xarray.Dataset", output: str, words: Mapping[str, str]) -> "xarray.DataArray":
    """An output and its coordinates in the units of their labels, NaN where there is no number, with the results."""
    array = answer[output]
    lost = answer[RESULT] < 0
    if array.dtype.kind != "f":  # whole numbers and true or false cannot be NaN: other outputs tell
        for name in _real_outputs(answer):
            lost = lost | answer[name].isnull().any([d for d in answer[name].dims if d not in lost.dims])
    scale, unit = _unit_of(array)
    coords = {str(name): _shown_axis(c, words) for name, c in array.coords.items() if is_numeric(c.values)}
    drawn = (scale * array).where(~lost).transpose(*array.dims).rename(output)
    drawn = drawn.assign_attrs(yes_or_no=array.dtype.kind == "b", unit=unit)
    return drawn.assign_coords(coords | {RESULT: answer[RESULT]})


def _shown_axis(coordinate: "xarray.DataArray", words: Mapping[str, str]) -> tuple[object, np.ndarray, dict[str, str]]:
    """A coordinate in the unit of its label."""
    scale, unit = _unit_of(coordinate)
    label = words.get(str(coordinate.name)) or name_in_words(str(coordinate.name))
    attrs = {"words": label, "unit": unit, "label": _with_unit(label, unit)}
    return coordinate.dims, np.asarray(scale * coordinate.values), attrs


def needed_for(answer: "xarray.Dataset", outputs: Sequence[str]) -> "xarray.Dataset":
    """Only what `shown` reads to draw some outputs; outputs along the body would take long to read."""
    others = [] if all(answer[name].dtype.kind == "f" for name in outputs) else _real_outputs(answer)
    return answer[list(dict.fromkeys([*outputs, RESULT, *others]))]


def _real_outputs(answer: "xarray.Dataset") -> list[str]:
    """Outputs that are NaN where a solve gave no number."""
    return [str(n) for n, array in answer.data_vars.items() if array.dtype.kind == "f" and "point" not in array.dims]


def labelled(array: "xarray.DataArray", part: Sequence[str]) -> "xarray.DataArray":
    """With a label: the output, which part of it this is, the unit."""
    return array.assign_attrs(label=_with_unit(" ".join([name_in_words(str(array.name)), *part]), array.attrs["unit"]))


def components(array: "xarray.DataArray", swept: Iterable[object]) -> Iterator["xarray.DataArray"]:
    """One array over the dimensions of the sweep for each component of an output."""
    own = [str(d) for d in array.dims if d not in swept]
    for place in np.ndindex(*(array.sizes[d] for d in own)):
        at = dict(zip(own, place, strict=True))
        words = [part_words(d, COMPONENTS[i] if d == "component" else i) for d, i in at.items() if array.sizes[d] > 1]
        yield labelled(array.isel(at), words)


def parts_of(array: "xarray.DataArray", over: Sequence[object]) -> Iterator[tuple[str, "xarray.DataArray"]]:
    """One array over some dimensions for each combination of the others, which the words name."""
    dimensions = {d for name in over for d in (array[name].dims if name in array.coords else (name,))}
    others = [str(d) for d in array.dims if d not in dimensions]
    for place in np.ndindex(*(array.sizes[d] for d in others)):
        at = dict(zip(others, place, strict=True))
        yield ", ".join(_value_words(array, d, i) for d, i in at.items()), array.isel(at)


def is_numeric(values: np.ndarray) -> bool:
    return bool(np.issubdtype(values.dtype, np.number))


def _unit_of(array: "xarray.DataArray") -> tuple[float, str]:
    """What to multiply SI by, and the unit that then holds."""
    known, unit = QUANTITIES.get(str(array.name)), array.attrs.get("units", "1")
    if known is not None and known.in_percent:
        return known.shown
    return preferred(DIMENSION_OF[unit]) if unit in DIMENSION_OF else (1.0, unit)


def _with_unit(words: str, unit: str) -> str:
    return f"{words} ({unit})" if unit else words


def part_words(dimension: str, value: object) -> str:
    """Which tendon or component of an output: "of tendon 2", "X"."""
    if dimension == "component":
        return str(value)
    return f"of tendon {int(str(value)) + 1}" if dimension == "tendon" else f"at {value} of {dimension}"


def _value_words(array: "xarray.DataArray", dimension: str, place: int) -> str:
    """The value at a place along a dimension: "tendon 2", "exact kinematics", "Friction coefficient = 0.4"."""
    if dimension == "tendon":
        return f"tendon {place + 1}"
    if dimension not in array.coords:
        return f"{dimension} {place}"
    coordinate = array[dimension]
    value = coordinate.values[place]
    if dimension == "component" or dimension in OPTIONS:
        return str(value) if dimension == "component" else f"{value} {dimension}"
    words = f"{coordinate.attrs['words']} = {value:.4g} {coordinate.attrs['unit']}"
    return words.strip().replace("-", "\N{MINUS SIGN}")


def name_in_words(name: str) -> str:
    """The name of a number or output in words: "loads.tip_force.1" is "Tip force Y"."""
    if name in QUANTITIES:
        return QUANTITIES[name].label
    parts = name.removeprefix("loads.").replace("tendons.", "tendon.").split(".")
    places = COMPONENTS if parts[0] in ("tip_force", "gravity") else range(1, 100)
    words = " ".join(str(places[int(part)]) if part.isdigit() else part for part in parts).replace("_", " ")
    return words[:1].upper() + words[1:]


def _results_in_words(codes: np.ndarray) -> str:
    """The results among some codes in words."""
    return ", ".join(RESULT_NAMES[code].replace("_", " ") for code in np.unique(codes))


# --- drawing -------------------------------------------------------------------------------------


def draw_curves(axes: Axes, array: "xarray.DataArray", over: str) -> None:
    """A line for each combination of what else varies, and the solves that are doubtful or failed."""
    curves = list(zip(parts_of(array, array[over].dims), draw.CURVES, strict=False))
    x = array[over].values
    for (label, line), look in curves:
        sure = line.where(line[RESULT] == SUCCESSFUL)
        (drawn,) = axes.plot(x, sure.values, label=label, **look)
        if len(x) > MARKED:
            drawn.set_marker("none")
    for (_, line), look in curves:
        _draw_others(axes, x, line.values, line[RESULT].values, look, 4.2)
    axes.set(xlabel=array[over].attrs["label"], ylabel=array.attrs["label"])
    axes.margins(x=0.02)
    write_ticks(axes, array)


def draw_dots(axes: Axes, array: "xarray.DataArray", over: str, look: Look, label: str) -> None:
    x = array[over].broadcast_like(array).transpose(*array.dims).values.ravel()
    y, codes = array.values.ravel(), array[RESULT].values.ravel()
    size = float(np.clip(60.0 / np.sqrt(len(x)), 1.2, 3.5))
    sure = codes == SUCCESSFUL
    (dots,) = axes.plot(x[sure], y[sure], look["marker"], color=look["color"], label=label, rasterized=len(x) > 500)
    dots.set(markersize=size, markeredgewidth=0, alpha=0.6)
    _draw_others(axes, x, y, codes, look, max(size, 2.4))


def _draw_others(axes: Axes, x: np.ndarray, y: np.ndarray, codes: np.ndarray, look: Look, size: float) -> None:
    """Solves that are doubtful, as hollow markers, and solves that gave no number, as crosses at the foot."""
    others, there = codes != SUCCESSFUL, np.isfinite(y)
    if np.any(doubtful := others & there):
        (hollow,) = axes.plot(x[doubtful], y[doubtful], look["marker"], color=look["color"], markersize=size)
        hollow.set(markeredgewidth=0.7, markerfacecolor="white", zorder=1.9)
        hollow.set_label(f"hollow: doubtful, {_results_in_words(codes[doubtful])}")
    if np.any(failed := others & ~there):
        foot = axes.get_xaxis_transform()
        (crosses,) = axes.plot(x[failed], np.full(failed.sum(), 0.03), "x", color=draw.BLACK, transform=foot)
        crosses.set(markersize=3.5, markeredgewidth=0.7, zorder=4)
        crosses.set_label(f"at the foot: no number, {_results_in_words(codes[failed])}")


def draw_maps(panels: Sequence[Axes], arrays: Sequence["xarray.DataArray"], x: str, y: str) -> None:
    """A panel for each array, with one scale of colours beside the last; hatched where nothing is drawn."""
    order = (*arrays[0][y].dims, *arrays[0][x].dims)
    sure = [array.where(array[RESULT] == SUCCESSFUL).transpose(*order) for array in arrays]
    numbers = [np.ma.masked_invalid(array.values) for array in sure]
    levels = _levels(np.ma.stack(numbers).compressed())
    norm = BoundaryNorm(levels, 256)
    codes = np.unique([array[RESULT].values for array in arrays])
    for panel, values in zip(panels, numbers, strict=True):
        points = arrays[0][x].values, arrays[0][y].values
        panel.set(xlim=points[0][[0, -1]], ylim=points[1][[0, -1]], axisbelow=False)
        if values.count():
            panel.contourf(*points, values, levels=levels, cmap=draw.TENSION_COLOURS, norm=norm)
        if values.count() and len(levels) > 2:
            lines = panel.contour(*points, values, levels, colors=draw.BLACK, linewidths=0.5, linestyles="solid")
            if len(panels) <= LABELLED:
                _write_levels(panel, lines)
        if np.any(codes != SUCCESSFUL):
            ground = Rectangle((0, 0), 1, 1, transform=panel.transAxes, zorder=0, linewidth=0.0, hatch="/////")
            ground.set(facecolor=draw.PALE, edgecolor=draw.GREY)
            ground.set_label(f"hatched: {_results_in_words(codes[codes != SUCCESSFUL])}")
            panel.add_patch(ground)
    scale = ScalarMappable(norm, draw.TENSION_COLOURS)
    label = arrays[0].attrs["label"]
    draw.figure_of(panels[0]).colorbar(scale, ax=list(panels), label=label, pad=0.02, aspect=25)


def _levels(there: np.ndarray) -> np.ndarray:
    """Round numbers that hold all values between them; two where all values are the same."""
    if not there.size:
        return np.array([0.0, 1.0])
    low, high = there.min(), there.max()
    if high - low <= SAME * max(abs(low), abs(high)):
        reach = 0.01 * abs(low) or 1.0
        return np.array([low - reach, high + reach])
    return np.asarray(MaxNLocator(8).tick_values(low, high))


def _write_levels(axes: Axes, lines: QuadContourSet) -> None:
    """The level on each line, unless it would lie over the frame."""
    for text in axes.clabel(lines, fmt="%g", fontsize=7, colors=draw.BLACK, inline=False):
        text.set_path_effects([withStroke(linewidth=2.0, foreground="white")])
        place = axes.transAxes.inverted().transform(axes.transData.transform(text.get_position()))
        if np.any(place < EDGE) or np.any(place > 1 - EDGE):
            text.remove()


def write_ticks(axes: Axes, array: "xarray.DataArray") -> None:
    axes.ticklabel_format(axis="x" if array.attrs["yes_or_no"] else "both", useOffset=False)
    if array.attrs["yes_or_no"]:
        axes.set_ylim(-0.15, 1.15)
        axes.set_yticks([0, 1], ["no", "yes"])
