"""An output of a sweep over one number, as lines."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes

from . import plotting as draw
from .sweep_view import SUCCESSFUL, Quantity, View, chosen, names_of, write_ticks

if TYPE_CHECKING:
    import xarray

LINES = len(draw.CURVES)  # drawn at most
MARKED = 30  # values up to which a line has a marker at each
HEIGHT = 2.4  # inches


def draw_lines(dataset: "xarray.Dataset", output: str, over: str, axes: Axes | None = None, **selection: Any) -> Axes:
    """An output of a sweep over one number, in mm, deg, MPa and else SI units.

    There is a line for each combination of what else varies, six at most: values of another axis, kinematics,
    tendons, components. What was solved without any doubt is a line, doubtful solves are hollow markers beside it, and
    failed ones crosses at the foot; the legend says why.

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
    view = chosen("draw_lines", dataset, output, (over,), selection, LINES)
    with draw.axes_or_new(axes, HEIGHT) as axes:
        draw_quantity(axes, view, view.quantities[0], over)
        draw.legend_above(axes)
    return axes


def draw_quantity(axes: Axes, view: View, quantity: Quantity, number: str) -> None:
    """A line for each part, and the solves that are doubtful or failed."""
    axis, parts = view.axis(number), list(zip(view.parts(LINES), draw.CURVES, strict=False))
    for part, look in parts:
        y, code = quantity.values[part.place], view.codes[part.place]
        drawn: dict[str, Any] = look | ({} if len(y) <= MARKED else {"marker": "none"})
        axes.plot(axis.values, np.where(code == SUCCESSFUL, y, np.nan), label=part.label, **drawn)
    for part, look in parts:
        draw_others(axes, axis.values, quantity.values[part.place], view.codes[part.place], look | {"markersize": 4.2})
    axes.set(xlabel=axis.label, ylabel=quantity.label)
    axes.margins(x=0.02)
    write_ticks(axes, quantity)


def draw_others(axes: Axes, x: np.ndarray, y: np.ndarray, codes: np.ndarray, look: dict[str, Any]) -> None:
    """Solves that are doubtful, hollow and alone, and those that gave no number, at the foot."""
    others, there = codes != SUCCESSFUL, np.isfinite(y)
    if np.any(doubtful := others & there):
        hollow: dict[str, Any] = {name: look[name] for name in ("marker", "color", "markersize")}
        hollow |= {"linestyle": "none", "label": f"hollow: doubtful, {names_of(codes[doubtful])}"}
        axes.plot(x[doubtful], y[doubtful], mew=0.7, mfc="white", zorder=1.9, **hollow)
    if np.any(failed := others & ~there):
        foot: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "color": draw.BLACK, "markersize": 3.5}
        foot |= {"zorder": 4, "label": f"at the foot: no number, {names_of(codes[failed])}"}
        axes.plot(x[failed], np.full(failed.sum(), 0.03), "x", markeredgewidth=0.7, **foot)
