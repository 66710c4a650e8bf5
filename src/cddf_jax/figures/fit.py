"""The figures of a fit: data and model, residuals over what was set and against normal quantiles, and profiles."""

import re
from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import NamedTuple, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.special import betaincinv, ndtri

from ..errors import InputError
from ..estimation.determination import AT_BOUND, NOT_IDENTIFIED
from ..estimation.profile_likelihood import Profile
from ..identification import curves
from ..identification.bench import Bench, Group
from ..identification.fit import Fit
from ..identification.parameters import parameter_named
from ..measurements.readings import kind_of, kind_of_set, set_by
from ..quantities import QUANTITIES, Quantity
from . import looks, style as draw
from .history import draw_model_loops

DEGREE = np.degrees(1.0)
PANEL_HEIGHT, RESIDUAL_HEIGHT = 2.5, 1.7  # inches
MOST_ACROSS = 3  # panels side by side
MOST_SHOWN = 1.9**2  # times the rise at the ends of the interval: up to there a profile is drawn


# --- data and model ------------------------------------------------------------------------------


def draw_fit(fit: Fit, table: str | None = None, column: str | None = None, axes: Axes | None = None) -> Axes:
    """The readings of a column over base tension, N, or displacement, and the fitted model with its 95 % band.

    A pulley test is drawn as pulling tension per weight over wrap angle, deg, so that one curve holds for every weight.
    Rows with a history are drawn with the model along their path, trial by trial: solid when pulled, dashed when
    released; markers show the branch of a reading. With several tendons, forces on the tip or a stated direction -1, no
    single curve holds for all rows: each reading is then drawn over the prediction for its row, with the 95 % interval
    of the prediction.

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
        if panel.loops:
            draw_model_loops(axes, panel.loops)
        elif (curve := panel.curve) is not None:
            low, high = curve.value - curve.half_width, curve.value + curve.half_width
            draw.draw_band(axes, curve.grid, low, high, label="95 % band of the model")
            axes.plot(curve.grid, curve.value, color=looks.BLUE, label="model")
        else:
            ends = [np.min(panel.x), np.max(panel.x)]
            axes.plot(ends, ends, color=looks.BLUE, label="measured = predicted")
            if np.all(np.isfinite(panel.half_width)):
                look = {"fmt": "none", "ecolor": looks.SKY, "elinewidth": 2.5, "capsize": 0, "alpha": 0.5}
                interval = {"xerr": panel.half_width, "label": "95 % interval of the model"}
                axes.errorbar(panel.x, panel.observed, **interval, **look)
        _draw_readings(axes, panel, panel.observed)
        axes.set(xlabel=panel.x_label, ylabel=panel.y_label)
        draw.legend_above(axes)
    return axes


def draw_residuals(fit: Fit, table: str | None = None, column: str | None = None, axes: Axes | None = None) -> Axes:
    """The residuals of a column, observed less predicted, over what `draw_fit` draws it over.

    Args:
        fit, table, column, axes: as in `draw_fit`.

    Raises:
        InputError: for another table or column, or where the model gave no numbers.
    """
    panel = _panel_of("draw_residuals", fit, table, column)
    with draw.axes_or_new(axes, RESIDUAL_HEIGHT) as axes:
        axes.axhline(0.0, color=looks.BLUE)
        _draw_readings(axes, panel, panel.residual)
        reach = 1.15 * np.max(np.abs(panel.residual)) or 1.0
        axes.set(xlabel=panel.x_label, ylabel=f"Residual{panel.unit}", ylim=(-reach, reach))
    return axes


def _draw_readings(axes: Axes, panel: "_Panel", values: np.ndarray) -> None:
    """A marker for each reading; with a history it shows the branch."""
    every = np.full(values.shape, True)
    parts = (
        [(every, "o", "")]
        if panel.pulled is None
        else [
            (panel.pulled, "o", ", pulled"),
            (~panel.pulled, "v", ", released"),
        ]
    )
    look = {"linestyle": "none", "color": looks.BLACK, "markerfacecolor": "white", "zorder": 3}
    for rows, marker, branch in parts:
        axes.plot(panel.x[rows], values[rows], marker, label=f"{panel.data_label}{branch}", **look)


def table_figures(fit: Fit) -> dict[str, Figure]:
    """One figure for each table, as `draw_fit` above and `draw_residuals` below draw it, a panel for each column.

    There is none where the model gave no numbers: `tables_without_numbers`.
    """
    lost = curves.tables_without_numbers(fit)
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
        parts = cast(np.ndarray, figure.subfigures(down, across, squeeze=False)).ravel()
        for part, column in zip(parts, columns, strict=False):
            above, below = part.subplots(2, sharex=True, height_ratios=(3, 1))
            draw_fit(fit, name, column, above).set_xlabel("")
            draw_residuals(fit, name, column, below)
            part.align_ylabels()
        if across > 1:
            draw.common_legend(figure, figure.axes)
    return figure


class _Panel(NamedTuple):
    """One column over what was set, or over its prediction, in the units of the labels."""

    x: np.ndarray
    observed: np.ndarray
    residual: np.ndarray  # observed - predicted
    x_label: str
    y_label: str
    unit: str  # " (N)", "" for a plain number
    data_label: str
    curve: curves.ModelCurve | None = None  # None where no single one holds the rows
    loops: Sequence[curves.ModelCurve] = ()  # the model along the path of each trial that comes back
    half_width: np.ndarray | float = np.nan  # of the 95 % interval of the predictions, where there is no line
    pulled: np.ndarray | None = None  # with loops, whether the tendon was pulled in each reading


def _panel_of(who: str, fit: Fit, table: str | None, column: str | None) -> _Panel:
    """The readings of a column and the model."""
    name = _the_one(who, "table", table, list(fit.model.names))
    groups = _groups(fit, name)
    column = _the_one(who, "column", column, list(groups))
    group = groups[column]
    if not curves.has_numbers(fit, group):
        raise InputError(f"{who}: the model gave no numbers for {column} of {name}; see fit.result")
    rows, there, curve = group.table, group.there, curves.model_curve(fit, group)
    observed, residual, kind = group.observed, fit.residuals[group.label], kind_of(column)
    label = "simulated data" if rows.simulated else "data"
    if column == "pulling_tension" and curve is not None:
        weight, curve = rows["weight"][there], curve._replace(grid=DEGREE * curve.grid)
        numbers = DEGREE * rows["wrap_angle"][there], observed / weight, residual / weight
        return _Panel(*numbers, "Wrap angle (deg)", "Pulling tension / weight (N/N)", " (N/N)", label, curve)
    scale, unit = QUANTITIES[kind].shown

    def scaled(model: curves.ModelCurve) -> curves.ModelCurve:
        return curves.ModelCurve(size * model.grid, scale * model.value, scale * model.half_width)

    # " 2" of tendon 2, " at head" of a marker
    number = f" at {column.partition('@')[2]}" if "@" in column else column.removeprefix(kind).replace("_", " ")
    unit = f" ({unit})" if unit else ""
    words, observed, residual = f"{QUANTITIES[kind].label}{number}{unit}", scale * observed, scale * residual
    own = set_by(rows.columns)[0]
    size, x_label = QUANTITIES[kind_of_set(own)].shown[0], QUANTITIES[kind_of_set(own)].axis_label
    over_base = _Panel(size * rows[own][there], observed, residual, x_label, words, unit, label)
    if curve is not None:
        return over_base._replace(curve=scaled(curve))
    if loops := curves.model_loops(fit, group):
        assert isinstance(group.experiment, Bench)
        assert group.experiment.course is not None
        return over_base._replace(loops=list(map(scaled, loops)), pulled=group.experiment.course.pulled[there])
    words, half = words[0].lower() + words[1:], scale * curves.half_width(fit, group)
    labels = {"x_label": f"Predicted {words}", "y_label": f"Measured {words}"}
    return over_base._replace(x=observed - residual, half_width=half, **labels)


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
    draw.draw_band(axes, quantile, lower, upper, label="95 % of normal draws")
    axes.plot(quantile, quantile, color=looks.BLUE, label="normal")
    axes.plot(quantile, np.sort(residual), "o", color=looks.BLACK, markerfacecolor="none", markersize=2.8, label="data")
    axes.text(0.04, 0.96, f"{count} residuals", transform=axes.transAxes, va="top")
    axes.set(xlabel="Normal quantile", ylabel="Residual / noise")
    axes.set_title(fill(name, 44), parse_math=False)  # dollar signs of a file name are no formula


# --- profiles of the likelihood --------------------------------------------------------------------


def draw_profile(fit: Fit, profile: Profile, axes: Axes | None = None) -> Axes:
    """The root of the rise of the sum of squares over a parameter; two straight lines for a linear model.

    The 95 % interval is where the profile is below the dashed line. A side on which it never crosses that line is
    marked as open. A positive parameter with an open side is drawn on a logarithmic axis, without an estimate.

    Args:
        fit: of `fit`.
        profile: of `fit.profile`.
        axes: where to draw; None for a new figure, one column wide.
    """
    name, estimate, status = profile.name, fit.value[profile.name], fit.status[profile.name]
    quantity = QUANTITIES.get(name) or Quantity(name, parameter_named(name).dimension)
    scale, label = quantity.shown[0], quantity.axis_label
    with draw.axes_or_new(axes, PANEL_HEIGHT) as axes:
        interval, limit = profile.confidence_interval, np.sqrt(profile.threshold)
        valley = status != AT_BOUND and not all(profile.closed) and bool(np.all(profile.value > 0))
        low, high = _reach(profile, estimate, valley)
        axes.set(xscale="log" if valley else "linear", xlabel=label, ylabel="Root of the rise in squares")
        axes.set(xlim=(scale * low, scale * high), ylim=(-0.1 * limit, 1.9 * limit))
        if not valley:
            axes.xaxis.set_major_locator(MaxNLocator(5))
        ends = np.clip(interval, low, high)
        axes.axvspan(scale * ends[0], scale * ends[1], color=looks.SKY, alpha=0.35, linewidth=0, label="95 % interval")
        root = np.sqrt(np.maximum(profile.rise, 0.0))
        axes.plot(scale * profile.value, root, "o-", color=looks.BLUE, markersize=2.2, label="profile")
        axes.axhline(limit, color=looks.VERMILION, linestyle="--", label="95 % limit")
        if status != NOT_IDENTIFIED:
            axes.axvline(scale * estimate, color=looks.BLACK, linestyle=":", label="estimate")
        patch = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
        look = {"transform": axes.transAxes, "va": "top", "color": looks.VERMILION, "bbox": patch}
        sides = zip((0.03, 0.97), ("left", "right"), interval, profile.closed, profile.model_ends, strict=True)
        for place, side, end, closed, model_ends in sides:
            at_bound = status == AT_BOUND and np.isfinite(end)
            word = "" if closed else "no solution" if model_ends else "bound" if at_bound else "open"
            if word:
                axes.text(place, 0.96, word, ha=side, **look)
        draw.legend_above(axes)
    return axes


def profiles_figure(fit: Fit, profiles: Mapping[str, Profile]) -> Figure:
    """A panel for each profile, with one legend."""
    drawn = list(profiles.values())
    return draw.panels_figure(lambda panel, profile: draw_profile(fit, profile, panel), drawn, PANEL_HEIGHT)


def _reach(profile: Profile, estimate: float, valley: bool) -> tuple[float, float]:
    """Lowest and highest value to show: somewhat more than the interval; for a valley at most two decades each way."""
    ends = [end for end, closed in zip(profile.confidence_interval, profile.closed, strict=True) if closed]
    shown = np.array([*profile.value[profile.rise < MOST_SHOWN * profile.threshold], *ends, estimate])
    if valley:
        return max(estimate / 100, shown.min() / 1.1), min(100 * estimate, 1.1 * shown.max())
    margin = 0.05 * np.ptp(shown) or 1e-12
    return shown.min() - margin, shown.max() + margin
