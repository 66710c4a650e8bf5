"""The figures of a fit: data and model, and the residuals."""

import re
from textwrap import fill
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from . import plotting as draw
from .bench import TRIALS, parameter_named
from .determination import AT_BOUND
from .errors import InputError
from .identification import SHOWN, Fit
from .measurements import Measurements
from .pulley import pulling_tension
from .readings import READINGS, kind_of
from .readings_drawing import draw_about_zero, draw_band, draw_levels
from .units import preferred

DEGREE = np.degrees(1.0)
SHAPIRO_ROWS = (3, 5000)  # between which the test of Shapiro and Wilk holds
PANEL_HEIGHT, RESIDUAL_HEIGHT = 2.5, 1.7  # inches


def own_names(fit: Fit) -> list[str]:
    """The parameters that were fitted, without the deviations of trials."""
    return [name for name in fit.names if not name.startswith(TRIALS)]


def moving_names(fit: Fit) -> list[str]:
    """Those that no bound holds."""
    return [name for name in own_names(fit) if fit.status[name] != AT_BOUND]


def shown_scale(name: str) -> tuple[float, str]:
    """What to multiply a parameter by, and its label with the unit that then holds."""
    scale, unit = SHOWN[parameter_named(name).dimension]
    words = "Young's modulus" if name == "youngs_modulus" else name.replace("_", " ").capitalize()
    return scale, f"{words} ({unit.strip()})" if unit else words


# --- data and model ------------------------------------------------------------------------------


def draw_fit(
    fit: Fit, table: str | Measurements | None = None, column: str | None = None, axes: Axes | None = None
) -> Axes:
    """The readings of a column over base tension, N, and the fitted model with its 95 % band.

    Readings of one level are drawn as their mean with one standard deviation. A pulley test is drawn as pulling
    tension per weight over wrap angle, deg, so that one curve holds every weight.

    Args:
        fit: of `fit`.
        table: one of the tables that were fitted, or its name as in `fit.alone`; may be left out where there is one.
        column: "tip_tension" (N), "tip_angle" (deg), "tip_x" or "tip_y" (mm); may be left out where there is one.
        axes: where to draw; None for a new figure, one column wide.

    Raises:
        InputError: for another table or column; where no single curve holds the rows, because there are several
            tendons, forces on the tip or tendons that slide out; where the model gave no numbers.
    """
    name, column = _chosen("draw_fit", fit, table, column)
    if _is_apart(fit, name):
        raise InputError(
            f"draw_fit: {name} has several tendons, forces on the tip or tendons that slide out, which no single curve "
            "holds; draw_residuals shows what is left of it"
        )
    readings, curve = _readings(fit, name, column), _curve(fit, name, column)
    if not _is_finite(readings, curve):
        raise InputError(f"draw_fit: the model gave no numbers for {column} of {name}; see fit.result")
    with draw.axes_or_new(axes, PANEL_HEIGHT) as axes:
        low, high = curve.value - curve.half_width, curve.value + curve.half_width
        draw_band(axes, curve.grid, low, high, label="95 % band of the model")
        axes.plot(curve.grid, curve.value, color=draw.BLUE, label="model")
        draw_levels(axes, readings.x, readings.observed, label=readings.data_label)
        axes.set(xlabel=readings.x_label, ylabel=f"{readings.words} ({readings.unit})")
        axes.legend(loc="best", frameon=False)
    return axes


def draw_residuals(
    fit: Fit, table: str | Measurements | None = None, column: str | None = None, axes: Axes | None = None
) -> Axes:
    """What the fitted model leaves of a column, observed less predicted, over base tension, N (wrap angle, deg).

    Every reading is a dot; over them mean and standard deviation of each level. The 95 % band of the model lies about
    zero where a single curve holds the rows.

    Args:
        fit, table, axes: as of `draw_fit`.
        column: as of `draw_fit`, and "tip_tension_2" and so on (N).

    Raises:
        InputError: for another table or column, or where the model gave no numbers.
    """
    name, column = _chosen("draw_residuals", fit, table, column)
    readings = _readings(fit, name, column)
    curve = None if _is_apart(fit, name) else _curve(fit, name, column)
    if not _is_finite(readings, curve):
        raise InputError(f"draw_residuals: the model gave no numbers for {column} of {name}; see fit.result")
    with draw.axes_or_new(axes, RESIDUAL_HEIGHT) as axes:
        if curve is not None:
            draw_band(axes, curve.grid, -curve.half_width, curve.half_width)
        draw_about_zero(axes, readings.x, readings.residual)
        axes.set(xlabel=readings.x_label, ylabel=f"Residual ({readings.unit})")
    return axes


def table_figures(fit: Fit) -> dict[str, Figure]:
    """One figure for each table: data, model with its 95 % band, residuals.

    There is none for tables of several tendons, under forces or of tendons that slide out, which no single curve
    holds, and none where the model gave no numbers.
    """
    figures = {}
    for name in fit.alone:
        columns = [column for column in ("pulling_tension", *READINGS) if column in _observed(fit, name)]
        if _is_apart(fit, name) or not all(_has_numbers(fit, name, column) for column in columns):
            continue
        figures["fit_" + re.sub(r"\W+", "_", name.replace(".csv", "")).strip("_")] = _table_figure(fit, name, columns)
    return figures


def _table_figure(fit: Fit, name: str, columns: list[str]) -> Figure:
    """Data and model above, residuals below; one column fills that of a page, more stand side by side over both."""
    with draw.house_style():
        figure = draw.new_figure(draw.SINGLE_COLUMN if len(columns) == 1 else draw.DOUBLE_COLUMN, 3.2)
        axes = figure.subplots(2, len(columns), squeeze=False, sharex="col", height_ratios=(3, 1))
        for (above, below), column in zip(axes.T, columns, strict=True):
            draw_fit(fit, name, column, above).set_xlabel("")
            draw_residuals(fit, name, column, below)
        figure.align_ylabels()
    return figure


class _Readings(NamedTuple):
    """One column over what was set, in the units of the labels; residual = observed - predicted."""

    x: np.ndarray
    observed: np.ndarray
    residual: np.ndarray
    x_label: str
    words: str
    unit: str
    data_label: str


class _Curve(NamedTuple):
    """The model over a grid of what was set, and its 95 % band, in the units of the labels."""

    grid: np.ndarray
    value: np.ndarray
    half_width: np.ndarray


def _chosen(who: str, fit: Fit, table: str | Measurements | None, column: str | None) -> tuple[str, str]:
    """The names of a table and of one of its columns."""
    names = list(fit.alone)
    if isinstance(table, Measurements):
        table = next((name for name, own in zip(names, fit.tables, strict=True) if own is table), table.name)
    name = _the_one(who, "table", table, names)
    return name, _the_one(who, "column", column, _observed(fit, name))


def _the_one(who: str, what: str, given: str | None, there: list[str]) -> str:
    if given is None and len(there) == 1:
        return there[0]
    if given not in there:
        raise InputError(f"{who}: {what} must be one of {', '.join(there)}; got {given!r}")
    return given


def _observed(fit: Fit, name: str) -> list[str]:
    """The columns of a table that were fitted."""
    return list(fit.model.experiments[list(fit.alone).index(name)].columns)


def _table(fit: Fit, name: str) -> Measurements:
    return fit.tables[list(fit.alone).index(name)]


def _is_apart(fit: Fit, name: str) -> bool:
    """Whether rows lie off the curve of a free body of one tendon that is pulled in."""
    table = _table(fit, name)
    forces = any(np.any(table[column]) for column in ("tip_force_x", "tip_force_y") if column in table)
    out = "direction" in table and bool(np.any(table["direction"] < 0))
    return "pulling_tension" not in table and (fit.manipulator.num_tendons > 1 or forces or out)


def _is_finite(readings: _Readings, curve: _Curve | None) -> bool:
    return bool(np.all(np.isfinite(readings.residual)) and (curve is None or np.all(np.isfinite(curve.value))))


def _has_numbers(fit: Fit, name: str, column: str) -> bool:
    return _is_finite(_readings(fit, name, column), _curve(fit, name, column))


def _readings(fit: Fit, name: str, column: str) -> _Readings:
    table, residual = _table(fit, name), fit.residuals[f"{name}: {column}"]
    label = "simulated data, mean ± sd" if table.simulated else "data, mean ± sd"
    if column == "pulling_tension":
        x, weight = DEGREE * table["wrap_angle"], table["weight"]
        words = "Pulling tension / weight"
        return _Readings(x, table[column] / weight, residual / weight, "Wrap angle (deg)", words, "N/N", label)
    kind = READINGS[kind_of(column)]
    scale, unit = preferred(kind.dimension)
    number = column.removeprefix(kind_of(column))  # "_2" of tendon 2
    set_to, words = f"base_tension{number}", f"{kind.words}{number.replace('_', ' ')}"
    x_label = f"{set_to.replace('_', ' ').capitalize()} (N)"
    return _Readings(table[set_to], scale * table[column], scale * residual, x_label, words, unit, label)


def _curve(fit: Fit, name: str, column: str) -> _Curve:
    table = _table(fit, name)
    if column == "pulling_tension":
        return _pulley_curve(fit, table["wrap_angle"].max())
    scale, _ = preferred(READINGS[kind_of(column)].dimension)
    grid = np.linspace(table["base_tension"].min(), table["base_tension"].max(), 100)
    value, half_width, _ = fit.predict(column, grid)
    return _Curve(grid, scale * value, scale * half_width)


def _pulley_curve(fit: Fit, furthest: float) -> _Curve:
    """Pulling tension per weight over wrap angle."""
    grid = np.linspace(0.0, furthest, 100)
    ratio = np.asarray(pulling_tension(1.0, fit.value["friction_coefficient"], grid))
    slope = np.zeros((grid.size, len(fit.names)))
    if "friction_coefficient" in fit.names:
        slope[:, fit.names.index("friction_coefficient")] = grid * ratio
    return _Curve(DEGREE * grid, ratio, fit.band(slope))


# --- residuals -----------------------------------------------------------------------------------


class Normality(NamedTuple):
    """Whether the residuals of a group could be draws from a normal distribution."""

    rows: int
    p_value: float  # Shapiro and Wilk (1965); NaN where it cannot be told


def standardised_residuals(fit: Fit) -> dict[str, np.ndarray]:
    """Observed less predicted, over the noise, by group of data."""
    return {
        name: np.ravel(fit.residuals[name] / noise)
        for name, noise in zip(fit.evidence.rows, fit.search.noise, strict=True)
    }


def normality(fit: Fit) -> dict[str, Normality]:
    """The test of Shapiro and Wilk for each group of data."""
    return {name: _normality(residual) for name, residual in standardised_residuals(fit).items()}


def _normality(residual: np.ndarray) -> Normality:
    low, high = SHAPIRO_ROWS
    fit_for_it = low <= residual.size <= high and np.all(np.isfinite(residual)) and np.ptp(residual) > 0
    return Normality(residual.size, float(stats.shapiro(residual).pvalue) if fit_for_it else float("nan"))


def residuals_figure(fit: Fit) -> Figure:
    """Residuals over their noise against normal quantiles, one panel for each group of data."""
    groups = standardised_residuals(fit)
    with draw.house_style():
        figure, axes = draw.panels(len(groups), 2, PANEL_HEIGHT)
        for panel, (name, residual) in zip(axes, groups.items(), strict=True):
            _draw_quantiles(panel, residual)
            panel.set_title(fill(name, 44))
            panel.set(xlabel="Normal quantile", ylabel="Residual / noise")
        draw.common_legend(figure, axes)
    return figure


def _draw_quantiles(axes: Axes, residual: np.ndarray) -> None:
    """Sorted residuals, the line on which they would lie, and where 95 % of normal draws do, place by place."""
    count, rank = residual.size, np.arange(1, residual.size + 1)
    quantile = stats.norm.ppf((rank - 0.375) / (count + 0.25))
    lower, upper = (stats.norm.ppf(stats.beta.ppf(level, rank, count + 1 - rank)) for level in (0.025, 0.975))
    draw_band(axes, quantile, lower, upper, label="95 % of normal draws")
    axes.plot(quantile, quantile, color=draw.BLUE, label="normal")
    axes.plot(quantile, np.sort(residual), "o", color=draw.BLACK, markerfacecolor="none", markersize=2.8, label="data")
    p_value = _normality(residual).p_value
    text = f"{count} residuals" + (f"\nShapiro-Wilk p = {p_value:.2g}" if np.isfinite(p_value) else "")
    axes.text(0.04, 0.96, text, transform=axes.transAxes, va="top")
