"""The figures of a fit: data and model, and the residuals."""

import re
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from . import plotting as draw
from .bench import TRIALS, Bench, parameter_named
from .determination import AT_BOUND
from .errors import InputError
from .identification import Fit
from .measurements import Measurements
from .pulley import pulling_tension
from .readings import READINGS, kind_of
from .readings_drawing import draw_about_zero, draw_band, draw_levels
from .units import preferred
from .verdict import SHOWN

DEGREE = np.degrees(1.0)
SHAPIRO_ROWS = (3, 5000)  # between which the test of Shapiro and Wilk holds
PANEL_HEIGHT, RESIDUAL_HEIGHT = 2.5, 1.7  # inches
MOST_ACROSS = 3  # panels side by side
INTERVAL: dict[str, Any] = {"fmt": "none", "ecolor": draw.SKY, "elinewidth": 2.5, "capsize": 0, "alpha": 0.5}


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
    tension per weight over wrap angle, deg, so that one curve holds every weight. No single curve holds the rows of a
    table with several tendons, forces on the tip or tendons that slide out: each reading is then drawn over what the
    model predicts for its row, with the 95 % interval of the prediction.

    Args:
        fit: of `fit`.
        table: one of the tables that were fitted, or its name as in `fit.alone`; may be left out where there is one.
        column: "tip_tension", "tip_tension_2", ... (N), "tip_angle" (deg), "tip_x" or "tip_y" (mm); may be left out
            where there is one.
        axes: where to draw; None for a new figure, one column wide.

    Raises:
        InputError: for another table or column, or where the model gave no numbers.
    """
    name, column = _chosen("draw_fit", fit, table, column)
    readings, curve = _drawable("draw_fit", fit, name, column)
    with draw.axes_or_new(axes, PANEL_HEIGHT) as axes:
        if curve is None:
            _draw_over_prediction(axes, readings)
        else:
            draw_band(axes, curve.grid, *curve.band, label="95 % band of the model")
            axes.plot(curve.grid, curve.value, color=draw.BLUE, label="model")
            draw_levels(axes, readings.x, readings.observed, label=readings.data_label)
        axes.set(xlabel=readings.x_label, ylabel=f"{readings.words} ({readings.unit})")
        axes.legend(loc="best", frameon=False)
    return axes


def draw_residuals(
    fit: Fit, table: str | Measurements | None = None, column: str | None = None, axes: Axes | None = None
) -> Axes:
    """What the fitted model leaves of a column, observed less predicted, over base tension, N (wrap angle, deg).

    Every reading is a dot; over them mean and standard deviation of each level, and about zero the 95 % band of the
    model. Where no single curve holds the rows, the residuals are drawn over the prediction, as `draw_fit` does.

    Args:
        fit, table, column, axes: as of `draw_fit`.

    Raises:
        InputError: for another table or column, or where the model gave no numbers.
    """
    name, column = _chosen("draw_residuals", fit, table, column)
    readings, curve = _drawable("draw_residuals", fit, name, column)
    with draw.axes_or_new(axes, RESIDUAL_HEIGHT) as axes:
        if curve is not None:
            draw_band(axes, curve.grid, -curve.half_width, curve.half_width)
        elif np.all(np.isfinite(readings.half_width)):
            axes.errorbar(readings.x, 0 * readings.x, yerr=readings.half_width, **INTERVAL)
        draw_about_zero(axes, readings.x, readings.residual, levels=curve is not None)
        axes.set(xlabel=readings.x_label, ylabel=f"Residual ({readings.unit})")
    return axes


def table_figures(fit: Fit) -> dict[str, Figure]:
    """One figure for each table, as `draw_fit` above and `draw_residuals` below draw it, a panel for each column.

    There is none where the model gave no numbers: `tables_without_numbers`.
    """
    lost = tables_without_numbers(fit)
    return {
        "fit_" + re.sub(r"\W+", "_", name.replace(".csv", "")).strip("_"): _table_figure(fit, name)
        for name in fit.alone
        if name not in lost
    }


def tables_without_numbers(fit: Fit) -> dict[str, str]:
    """By table, what the model gave no numbers for, in words; such a table cannot be drawn."""
    lost = {}
    for name in fit.alone:
        missing = [column for column in _observed(fit, name) if not _has_numbers(fit, name, column)]
        if missing:
            rows = max(np.sum(~np.isfinite(fit.residuals[f"{name}: {column}"])) for column in missing)
            where = f" in {rows} of {len(_table(fit, name))} rows" if rows else " between the rows"
            lost[name] = f"the model gave no numbers for {', '.join(missing)}{where}"
    return lost


def _table_figure(fit: Fit, name: str) -> Figure:
    """Data and model above, residuals below; one column fills that of a page, up to three stand side by side."""
    columns = _observed(fit, name)
    across, down = min(len(columns), MOST_ACROSS), -(-len(columns) // MOST_ACROSS)
    with draw.house_style():
        figure = draw.new_figure(draw.SINGLE_COLUMN if across == 1 else draw.DOUBLE_COLUMN, 3.2 * down)
        rows = figure.subfigures(down, 1, squeeze=False)[:, 0]
        for first, row in enumerate(rows):
            axes = row.subplots(2, across, squeeze=False, sharex="col", height_ratios=(3, 1)).T
            own = columns[first * across : (first + 1) * across]
            for (above, below), column in zip(axes, own, strict=False):
                draw_fit(fit, name, column, above).set_xlabel("")
                draw_residuals(fit, name, column, below)
            for unused in axes[len(own) :].ravel():
                unused.set_axis_off()
            row.align_ylabels()
        if across > 1:
            draw.common_legend(figure, [axes for row in rows for axes in row.axes])
    return figure


class _Readings(NamedTuple):
    """One column over what was set, or over its prediction, in the units of the labels.

    residual = observed - predicted; `half_width` is that of the 95 % interval of the predictions.
    """

    x: np.ndarray
    observed: np.ndarray
    residual: np.ndarray
    x_label: str
    words: str
    unit: str
    data_label: str
    half_width: Any = np.nan  # where x is what was set, the curve has it


class _Curve(NamedTuple):
    """The model over a grid of what was set, and its 95 % band, in the units of the labels."""

    grid: np.ndarray
    value: np.ndarray
    half_width: np.ndarray

    @property
    def band(self) -> tuple[np.ndarray, np.ndarray]:
        """Its lower and upper end."""
        return self.value - self.half_width, self.value + self.half_width


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
    """Whether no single curve holds the rows of a table."""
    rows = fit.model.experiments[list(fit.alone).index(name)]
    return isinstance(rows, Bench) and not rows.on_one_curve


def _drawable(who: str, fit: Fit, name: str, column: str) -> tuple[_Readings, _Curve | None]:
    """The readings of a column, and the curve of the model where a single one holds them."""
    if not _has_numbers(fit, name, column):
        raise InputError(f"{who}: the model gave no numbers for {column} of {name}; see fit.result")
    return _readings(fit, name, column), _curve(fit, name, column)


def _has_numbers(fit: Fit, name: str, column: str) -> bool:
    if not np.all(np.isfinite(fit.residuals[f"{name}: {column}"])):
        return False
    curve = _curve(fit, name, column)
    return curve is None or bool(np.all(np.isfinite(curve.value)))


def _draw_over_prediction(axes: Axes, readings: _Readings) -> None:
    """Readings over predictions, with the intervals of these, and the line on which they would be equal."""
    ends = [np.min(readings.x), np.max(readings.x)]
    axes.plot(ends, ends, color=draw.BLUE, label="measured = predicted")
    if np.all(np.isfinite(readings.half_width)):
        label = "95 % interval of the model"
        axes.errorbar(readings.x, readings.observed, xerr=readings.half_width, label=label, **INTERVAL)
    look = {"color": draw.BLACK, "markerfacecolor": "none", "zorder": 3}
    axes.plot(readings.x, readings.observed, "o", label=readings.data_label, **look)


def _readings(fit: Fit, name: str, column: str) -> _Readings:
    table, residual = _table(fit, name), fit.residuals[f"{name}: {column}"]
    there, observed = table.has(column), table.read(column)
    label = ("simulated data" if table.simulated else "data") + (", mean ± sd" if not _is_apart(fit, name) else "")
    if column == "pulling_tension":
        x, weight = DEGREE * table["wrap_angle"][there], table["weight"][there]
        words = "Pulling tension / weight"
        return _Readings(x, observed / weight, residual / weight, "Wrap angle (deg)", words, "N/N", label)
    kind = READINGS[kind_of(column)]
    scale, unit = preferred(kind.dimension)
    number = column.removeprefix(kind_of(column))  # "_2" of tendon 2
    words = f"{kind.words}{number.replace('_', ' ')}"
    numbers = scale * observed, scale * residual
    if not _is_apart(fit, name):
        return _Readings(table["base_tension"][there], *numbers, "Base tension (N)", words, unit, label)
    predicted, x_label = numbers[0] - numbers[1], f"Predicted {_lower(words)} ({unit})"
    words, half_width = f"Measured {_lower(words)}", scale * _half_width(fit, name, column)
    return _Readings(predicted, *numbers, x_label, words, unit, label, half_width)


def _lower(words: str) -> str:
    """With a small first letter."""
    return words[0].lower() + words[1:]


def _half_width(fit: Fit, name: str, column: str) -> np.ndarray:
    """Of the 95 % intervals of the predictions for the rows of a table, SI."""
    rows = fit.model.experiments[list(fit.alone).index(name)]
    assert isinstance(rows, Bench)
    _, slope, *_ = rows.evaluate(fit.model.manipulator, fit.parameters, fit.model.nodes)
    return fit.band(slope[column][_table(fit, name).has(column)])


def _curve(fit: Fit, name: str, column: str) -> _Curve | None:
    """The model over all base tensions of a table; None where no single curve holds its rows."""
    table = _table(fit, name)
    if _is_apart(fit, name):
        return None
    if column == "pulling_tension":
        return _pulley_curve(fit, table["wrap_angle"].max())
    scale, _ = preferred(READINGS[kind_of(column)].dimension)
    grid = np.linspace(max(table["base_tension"].min(), 0.0), table["base_tension"].max(), 100)
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
