"""Figures of a history: loops over the base tension, and where the work goes."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..errors import InputError
from ..history.history import History
from ..identification.curves import ModelCurve
from ..quantities import QUANTITIES
from ..robot.manipulator import Manipulator
from . import looks, style as draw
from .along import NUMBERED, draw_along, grouped_alike, numbered_steps, tendon_values

HEIGHT = 2.4  # inches, of a figure as wide as a column
LOOPS = ("tip_tension", "tip_angle", "tendon_displacement", "front")
LEAST_LEG = 0.02  # of the range of a path; a shorter part has no arrow
PULLED: looks.Look = {"color": looks.BLUE, "linestyle": "-", "label": "pulled"}
RELEASED: looks.Look = {"color": looks.VERMILION, "linestyle": (0, (5, 2)), "label": "released"}


def history_figure(
    manipulator: Manipulator, history: History, steps: Sequence[int] | None = None, *, tendon: int = 0
) -> Figure:
    """Loops of tip tension and tip angle, tension along the body, and where the work goes, with one numbering of steps.

    Args:
        manipulator: the body that was traced.
        history, steps, tendon: as in `draw_loop`. Along the body the last six lines are drawn.

    Raises:
        InputError: when a step failed.
    """
    with draw.house_style():
        figure = draw.new_figure(draw.DOUBLE_COLUMN, 2 * HEIGHT + 0.3)
        tension, angle, along, energy = figure.subplots(2, 2).ravel()
        draw_loop(history, "tip_tension", tension, steps=steps, tendon=tendon)
        draw_loop(history, "tip_angle", angle, steps=steps, tendon=tendon)
        draw_along(manipulator, history, "tension", along, steps=steps, tendon=tendon)
        draw_energy(history, energy, steps=steps, tendon=tendon)
        angle.legend().remove()
        figure.align_ylabels()
    return figure


def draw_loop(
    history: History,
    quantity: str = "tip_tension",
    axes: Axes | None = None,
    *,
    steps: Sequence[int] | None = None,
    tendon: int = 0,
) -> Axes:
    """A quantity over the base tension, N, in the order of the steps: solid when pulled, dashed when released.

    Arrows show the order. Steps are numbered; steps at one point have one label.

    Args:
        history: of `trace`; the closer its steps, the smoother the loop.
        quantity: "tip_tension" (N), "tip_angle" (deg), "tendon_displacement" (mm) or "front" (mm).
        axes: where to draw; None for a new figure, one column wide.
        steps: which of its steps, from 0, have the numbers 1, 2, ...; those where it turns unless given. Of more than
            ten only the turns are numbered.
        tendon: whose tensions are drawn, from 0.

    Raises:
        InputError: for another quantity, or when a step failed.
    """
    if quantity not in LOOPS:
        raise InputError(f"draw_loop: quantity must be one of {', '.join(LOOPS)}, got {quantity!r}")
    numbered = numbered_steps(history, steps, tendon)
    x, y = tendon_values(history.base_tension, tendon), tendon_values(getattr(history, quantity), tendon)
    y = QUANTITIES[quantity].shown[0] * y
    with draw.axes_or_new(axes, HEIGHT) as axes:
        _draw_path(axes, x, y)
        _number_points(axes, x, y, numbered)
        axes.set(xlabel=_label(history, "base_tension", tendon), ylabel=_label(history, quantity, tendon))
        axes.margins(0.08, 0.12)
        draw.legend_above(axes)
    return axes


def draw_energy(
    history: History, axes: Axes | None = None, *, steps: Sequence[int] | None = None, tendon: int = 0
) -> Axes:
    """Where the work goes, mJ, over the steps: energy stored, energy lost to friction, and the work put in.

    In the exact kinematics the work is the sum of the other two.

    Args:
        history, axes, steps: as in `draw_loop`.
        tendon: whose base tensions stand below the steps, from 0.

    Raises:
        InputError: when a step failed.
    """
    numbered = numbered_steps(history, steps, tendon)
    of, scale = history.energies, QUANTITIES["work"].shown[0]
    work, lost, stored = (scale * np.asarray(energy) for energy in (of.work, of.friction_loss, of.stored_energy))
    at = np.interp(np.arange(len(work)), [*numbered.values()], [*numbered])
    with draw.axes_or_new(axes, HEIGHT) as axes:
        look = {"facecolor": looks.YELLOW, "edgecolor": looks.GREY, "hatch": "/////", "linewidth": 0}
        axes.fill_between(at, 0.0, stored, facecolor=looks.SKY, linewidth=0, label="stored in the body")
        axes.fill_between(at, stored, stored + lost, label="lost to friction", **look)
        axes.plot(at, stored, color=looks.BLUE, linestyle="--")
        axes.plot(at, work, color=looks.BLACK, label="work put in")
        axes.set(xlabel="Step, base tension (N)", ylabel="Energy (mJ)")
        axes.margins(0.0, 0.05)
        axes.set_ylim(bottom=min(0.0, *stored, *work))
        tension, some = tendon_values(history.base_tension, tendon), [*numbered][:: -(-len(numbered) // NUMBERED)]
        axes.set_xticks(some, [f"{n}\n{tension[numbered[n]]:.4g}" for n in some])
        draw.legend_above(axes, 3)
    return axes


def draw_model_loops(axes: Axes, loops: Sequence[ModelCurve]) -> None:
    """The model of a fit with its 95 % band: solid when pulled, dashed when released, with arrows along the path."""
    for loop in loops:
        low, high = loop.value - loop.half_width, loop.value + loop.half_width
        for start, end in pairwise(draw.turning_places(loop.grid)) if np.all(np.isfinite(low)) else ():
            leg = slice(start, end + 1)
            draw.draw_band(axes, loop.grid[leg], low[leg], high[leg], label="95 % band of the model")
        _draw_path(axes, loop.grid, loop.value, "model, ")


def _draw_path(axes: Axes, x: np.ndarray, y: np.ndarray, what: str = "") -> None:
    """A line in the order of its points, with an arrow on each part on which the tension rises or falls."""
    for start, end in pairwise(draw.turning_places(x)):
        leg, look = slice(start, end + 1), PULLED if x[end] >= x[start] else RELEASED
        named: looks.Look = look | {"label": f"{what}{look['label']}"}
        axes.plot(x[leg], y[leg], **named)
        if np.ptp(x[leg]) > LEAST_LEG * np.ptp(x):
            draw.draw_arrow(axes, x[leg], y[leg], look["color"])


def _label(history: History, quantity: str, tendon: int) -> str:
    """The label of an axis; with several tendons it has the number of the tendon."""
    label = QUANTITIES[quantity].axis_label
    per_tendon = getattr(history, quantity).ndim == 2
    return label.replace(" (", f" {tendon + 1} (", 1) if per_tendon else label


def _number_points(axes: Axes, x: np.ndarray, y: np.ndarray, numbered: dict[int, int]) -> None:
    """A dot with its numbers at each point: the label is below on the right after a pull, else above on the left."""
    sizes = np.array([np.ptp(x) or 1.0, np.ptp(y) or 1.0])
    for numbers in sorted(grouped_alike({n: np.array([x[step], y[step]]) / sizes for n, step in numbered.items()})):
        step = numbered[numbers[0]]
        at, pulled = (x[step], y[step]), x[step] >= x[max(step - 1, 0)]
        axes.plot(*at, "o", color=looks.BLACK, zorder=4)
        look: looks.Look = {"ha": "left", "va": "top"} if pulled else {"ha": "right", "va": "bottom"}
        offset, text = (3, -3) if pulled else (-3, 3), ", ".join(map(str, numbers))
        axes.annotate(text, at, offset, textcoords="offset points", fontsize=7.5, zorder=5, **look)
