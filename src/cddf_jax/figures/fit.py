"""The figures of a fit: data and model, residuals over what was set, and residuals against normal quantiles."""

import re
from collections.abc import Sequence
from textwrap import fill
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import betaincinv, ndtri

from ..errors import InputError
from ..identification import predictions as diagnostics
from ..identification.bench import Bench, Group
from ..identification.course import Course
from ..identification.fit import Fit
from ..identification.parameters import parameter_named
from ..measurements.readings import kind_of
from ..quantities import QUANTITIES, dimension_of
from ..units import preferred
from . import looks, style as draw
from .history import draw_model_loops

DEGREE = np.degrees(1.0)
PANEL_HEIGHT, RESIDUAL_HEIGHT = 2.5, 1.7  # inches
MOST_ACROSS = 3  # panels side by side
BRANCHES = ((True, "o", "pulled"), (False, "v", "released"))
INTERVAL: looks.Look = {"fmt": "none", "ecolor": looks.SKY, "elinewidth": 2.5, "capsize": 0, "alpha": 0.5}


def shown_scale(name: str) -> tuple[float, str]:
    """The factor from SI to the unit in figures, and the label with this unit, of a parameter."""
    parameter = parameter_named(name)
    scale, unit = preferred(parameter.dimension)
    words = QUANTITIES[name].label if name == parameter.name else name.replace("_", " ").capitalize()
    return scale, f"{words} ({unit})" if unit else words


# --- data and model ------------------------------------------------------------------------------


def draw_fit(fit: Fit, table: str | None = None, column: str | None = None, axes: Axes | None = None) -> Axes:
    """The readings of a column over base tension, N, and the fitted model with its 95 % band.

    Readings of one level are drawn as their mean with one standard deviation. A pulley test is drawn as pulling tension
    per weight over wrap angle, deg, so that one curve holds for every weight. Rows with a history are drawn with the
    model along their path, trial by trial: solid when pulled, dashed when released; markers show the branch of a
    reading. With several tendons, forces on the tip or a stated direction -1, no single curve holds for all rows: each
    reading is then drawn over the prediction for its row, with the 95 % interval of the prediction.

    Args:
        fit: of `fit`.
        table: the name of a table that was fitted, as in `fit.model.names`; may be left out where there is one.
        column: "tip_tension", "tip_tension_2", ... (N), "tip_angle" (deg), "tip_x" or "tip_y" (mm); may be left out
            where there is one.
        axes: where to draw; None for a new figure, one column wide.

    Raises:
        InputError: for another table or column, or where the model gave no numbers.
    """
    panel = _panel_of("draw_fit", fit, table, column)
    with draw.axes_or_new(axes, PANEL_HEIGHT) as axes:
        if panel.loops and panel.course is not None:
            draw_model_loops(axes, panel.loops)
            _draw_branches(axes, panel.course, panel)
        elif (curve := panel.curve) is None:
            ends = [np.min(panel.x), np.max(panel.x)]
            axes.plot(ends, ends, color=looks.BLUE, label="measured = predicted")
            if np.all(np.isfinite(panel.half_width)):
                interval = {"xerr": panel.half_width, "label": "95 % interval of the model"} | INTERVAL
                axes.errorbar(panel.x, panel.observed, **interval)
            look = {"color": looks.BLACK, "markerfacecolor": "none", "zorder": 3}
            axes.plot(panel.x, panel.observed, "o", label=panel.data_label, **look)
        else:
            low, high = curve.value - curve.half_width, curve.value + curve.half_width
            draw_band(axes, curve.grid, low, high, label="95 % band of the model")
            axes.plot(curve.grid, curve.value, color=looks.BLUE, label="model")
            draw_levels(axes, panel.x, panel.observed, label=panel.data_label)
        axes.set(xlabel=panel.x_label, ylabel=panel.y_label)
        draw.legend_above(axes) if panel.loops else axes.legend(loc="best", frameon=False)
    return axes


def draw_residuals(fit: Fit, table: str | None = None, column: str | None = None, axes: Axes | None = None) -> Axes:
    """The residuals of a column, observed less predicted, over base tension, N, or wrap angle, deg.

    Every reading is a dot. Mean and standard deviation of each level are drawn over the dots, and the 95 % band of the
    model about zero. With a history markers show the branch, and each reading has its own 95 % interval of the model.
    Where no single curve holds for all rows, the residuals are drawn over the prediction, as in `draw_fit`.

    Args:
        fit, table, column, axes: as in `draw_fit`.

    Raises:
        InputError: for another table or column, or where the model gave no numbers.
    """
    panel = _panel_of("draw_residuals", fit, table, column)
    with draw.axes_or_new(axes, RESIDUAL_HEIGHT) as axes:
        if (curve := panel.curve) is not None:
            draw_band(axes, curve.grid, -curve.half_width, curve.half_width)
        elif np.all(np.isfinite(panel.half_width)):
            axes.errorbar(panel.x, 0 * panel.x, yerr=panel.half_width, **INTERVAL)
        pulled = panel.course.pulled[panel.there] if panel.loops and panel.course is not None else None
        draw_about_zero(axes, panel.x, panel.residual, levels=curve is not None, pulled=pulled)
        axes.set(xlabel=panel.x_label, ylabel=f"Residual ({panel.unit})")
    return axes


def table_figures(fit: Fit) -> dict[str, Figure]:
    """One figure for each table, as `draw_fit` above and `draw_residuals` below draw it, a panel for each column.

    There is none where the model gave no numbers: `tables_without_numbers`.
    """
    lost = diagnostics.tables_without_numbers(fit)
    return {
        "fit_" + re.sub(r"\W+", "_", name.replace(".csv", "")).strip("_"): _table_figure(fit, name)
        for name in fit.model.names
        if name not in lost
    }


def _table_figure(fit: Fit, name: str) -> Figure:
    """Data and model above, residuals below; up to three columns of the table stand side by side."""
    columns = list(_groups(fit, name))
    across, down = min(len(columns), MOST_ACROSS), -(-len(columns) // MOST_ACROSS)
    with draw.house_style():
        figure = draw.new_figure(draw.SINGLE_COLUMN if across == 1 else draw.DOUBLE_COLUMN, 3.2 * down)
        axes = figure.subplots(2 * down, across, squeeze=False, height_ratios=(3, 1) * down)
        for i, column in enumerate(columns):
            above, below = axes[2 * (i // across) :, i % across][:2]
            below.sharex(above)
            draw_fit(fit, name, column, above).set_xlabel("")
            above.tick_params(labelbottom=False)
            draw_residuals(fit, name, column, below)
        for unused in axes[-2:, len(columns) - across * (down - 1) :].ravel():
            unused.set_axis_off()
        figure.align_ylabels()
        if across > 1:
            draw.common_legend(figure, figure.axes)
    return figure


class _Panel(NamedTuple):
    """One column over what was set, or over its prediction, in the units of the labels."""

    x: np.ndarray
    observed: np.ndarray
    residual: np.ndarray  # observed - predicted
    curve: diagnostics.ModelCurve | None  # None where no single one holds the rows
    half_width: np.ndarray | float  # of the 95 % interval of the predictions, where there is no curve
    x_label: str
    y_label: str
    unit: str
    data_label: str
    there: np.ndarray  # (rows,), in which rows of the table it was read
    loops: Sequence[diagnostics.ModelCurve] = ()  # the model along the path of each trial that comes back
    course: Course | None = None


def _panel_of(who: str, fit: Fit, table: str | None, column: str | None) -> _Panel:
    """The readings of a column and the model."""
    name = _the_one(who, "table", table, list(fit.model.names))
    groups = _groups(fit, name)
    column = _the_one(who, "column", column, list(groups))
    group = groups[column]
    if not diagnostics.has_numbers(fit, group):
        raise InputError(f"{who}: the model gave no numbers for {column} of {name}; see fit.result")
    rows, curve = group.table, diagnostics.model_curve(fit, group)
    there, observed, residual = group.there, group.observed, fit.residuals[group.label]
    label = ("simulated data" if rows.simulated else "data") + (", mean ± sd" if curve is not None else "")
    if column == "pulling_tension" and curve is not None:
        weight, curve = rows["weight"][there], curve._replace(grid=DEGREE * curve.grid)
        numbers = DEGREE * rows["wrap_angle"][there], observed / weight, residual / weight
        words = "Wrap angle (deg)", "Pulling tension / weight (N/N)", "N/N"
        return _Panel(*numbers, curve, np.nan, *words, label, there)
    kind = kind_of(column)
    scale, unit = preferred(dimension_of(kind))
    # " 2" of tendon 2, " at head" of a marker
    number = f" at {column.partition('@')[2]}" if "@" in column else column.removeprefix(kind).replace("_", " ")
    words, observed, residual = f"{QUANTITIES[kind].label}{number} ({unit})", scale * observed, scale * residual
    base, axis = rows["base_tension"][there], "Base tension (N)"
    if curve is not None:
        curve = curve._replace(value=scale * curve.value, half_width=scale * curve.half_width)
        return _Panel(base, observed, residual, curve, np.nan, axis, words, unit, label, there)
    half = scale * diagnostics.half_width(fit, group)
    if loops := diagnostics.model_loops(fit, group):
        assert isinstance(group.experiment, Bench)
        loops = [loop._replace(value=scale * loop.value, half_width=scale * loop.half_width) for loop in loops]
        path = loops, group.experiment.course
        return _Panel(base, observed, residual, None, half, axis, words, unit, label, there, *path)
    words = words[0].lower() + words[1:]
    labels = f"Predicted {words}", f"Measured {words}"
    return _Panel(observed - residual, observed, residual, None, half, *labels, unit, label, there)


def _groups(fit: Fit, table: str) -> dict[str, Group]:
    """The groups of readings of a table, by column."""
    return {group.column: group for group in fit.groups if group.name == table}


def _the_one(who: str, what: str, given: str | None, there: list[str]) -> str:
    if given is None and len(there) == 1:
        return there[0]
    if given not in there:
        raise InputError(f"{who}: {what} must be one of {', '.join(there)}; got {given!r}")
    return given


# --- residuals -----------------------------------------------------------------------------------


def residuals_figure(fit: Fit) -> Figure:
    """Residuals over their noise against normal quantiles, one panel for each group of data."""
    return draw.panels_figure(_draw_quantiles, list(fit.standardised_residuals.items()), PANEL_HEIGHT)


def _draw_quantiles(axes: Axes, group: tuple[str, np.ndarray]) -> None:
    """Sorted residuals, the line of normal residuals, and the band that holds 95 % of normal draws at each place."""
    name, residual = group
    count, rank = residual.size, np.arange(1, residual.size + 1)
    quantile = ndtri((rank - 0.375) / (count + 0.25))
    lower, upper = (ndtri(betaincinv(rank, count + 1 - rank, level)) for level in (0.025, 0.975))
    draw_band(axes, quantile, lower, upper, label="95 % of normal draws")
    axes.plot(quantile, quantile, color=looks.BLUE, label="normal")
    axes.plot(quantile, np.sort(residual), "o", color=looks.BLACK, markerfacecolor="none", markersize=2.8, label="data")
    axes.text(0.04, 0.96, f"{count} residuals", transform=axes.transAxes, va="top")
    axes.set(xlabel="Normal quantile", ylabel="Residual / noise", title=fill(name, 44))


# --- readings by level ---------------------------------------------------------------------------


class Levels(NamedTuple):
    """Repeated readings gathered by level; `deviation` is NaN where a level was read once."""

    x: np.ndarray
    mean: np.ndarray
    deviation: np.ndarray  # standard deviation over the readings of a level
    lowest: np.ndarray
    highest: np.ndarray


def by_level(x: ArrayLike, y: ArrayLike) -> Levels:
    """Gather the readings y whose x agree within 2 % of the range of x, by which a set level may scatter."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    order = np.argsort(x, kind="stable")
    new_level = np.flatnonzero(np.diff(x[order]) > 0.02 * np.ptp(x)) + 1
    return _gathered(np.split(order, new_level), x, y)


def _gathered(groups: Sequence[np.ndarray], x: np.ndarray, y: np.ndarray) -> Levels:
    """Readings by level, from the places of those of each level."""
    return Levels(
        x=np.array([x[group].mean() for group in groups]),
        mean=np.array([y[group].mean() for group in groups]),
        deviation=np.array([y[group].std(ddof=1) if len(group) > 1 else np.nan for group in groups]),
        lowest=np.array([y[group].min() for group in groups]),
        highest=np.array([y[group].max() for group in groups]),
    )


def draw_band(axes: Axes, x: np.ndarray, lower: np.ndarray, upper: np.ndarray, **style: looks.LookValue) -> None:
    """The region between two lines."""
    axes.fill_between(x, lower, upper, **({"color": looks.SKY, "alpha": 0.5, "linewidth": 0} | style))


def draw_levels(axes: Axes, x: ArrayLike, y: ArrayLike, **style: looks.LookValue) -> None:
    """Mean and standard deviation of y at each level of x, as markers with error bars."""
    levels = by_level(x, y)
    look = {"fmt": "o", "color": looks.BLACK, "markerfacecolor": "white", "elinewidth": 0.8, "zorder": 3}
    axes.errorbar(levels.x, levels.mean, yerr=levels.deviation, **(look | style))


def _draw_branches(axes: Axes, course: Course, panel: _Panel) -> None:
    """Mean and standard deviation of each hold over the base tension; markers show the branch."""
    pulled, holds = course.pulled[panel.there], np.stack([course.trial, course.step], axis=1)[panel.there]
    look: looks.Look = {"color": looks.BLACK, "markerfacecolor": "white", "elinewidth": 0.8, "zorder": 3}
    for branch, marker, words in BRANCHES:
        own = np.flatnonzero(pulled == branch)
        if own.size:
            _, hold, counts = np.unique(holds[own], axis=0, return_inverse=True, return_counts=True)
            groups = np.split(own[np.argsort(hold, kind="stable")], np.cumsum(counts)[:-1])
            levels, label = _gathered(groups, panel.x, panel.observed), f"{panel.data_label}, {words}"
            axes.errorbar(levels.x, levels.mean, levels.deviation, fmt=marker, label=label, **look)


def draw_about_zero(
    axes: Axes, x: np.ndarray, residual: np.ndarray, *, levels: bool = True, pulled: np.ndarray | None = None
) -> None:
    """Every residual about a line at zero.

    They are dots, with mean and standard deviation at each level of x over them. If `pulled` says of each reading
    whether the tendon was pulled, they are markers that show the branch.
    """
    if pulled is None:
        axes.axhline(0.0, color=looks.BLUE)
        axes.plot(x, residual, ".", color=looks.GREY, markersize=3.5, markeredgewidth=0)
        if levels:
            draw_levels(axes, x, residual, markersize=2.5)
    else:
        axes.axhline(0.0, color=looks.BLACK, linewidth=0.6)
        for branch, marker, _ in BRANCHES:
            look: looks.Look = {"color": looks.GREY, "markerfacecolor": "none", "markersize": 3}
            axes.plot(x[pulled == branch], residual[pulled == branch], marker, **look)
    reach = 1.15 * np.max(np.abs(residual), initial=0.0) or 1.0
    axes.set_ylim(-reach, reach)
