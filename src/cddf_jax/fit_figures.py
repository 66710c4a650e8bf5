"""The figures of a fit: data and model, residuals, profiles, correlation, bootstraps."""

import re
from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator
from scipy import stats

from . import plotting as draw
from .bench import TRIALS, parameter_named
from .bootstrap import Bootstrap
from .determination import AT_BOUND, NOT_IDENTIFIED
from .identification import SHOWN, Fit
from .measurements import Measurements
from .profile_likelihood import Profile
from .pulley import pulling_tension

DEGREE = np.degrees(1.0)
COLUMNS = {
    "tip_angle": (DEGREE, "Tip angle", "deg"),
    "tip_x": (1e3, "Tip position X", "mm"),
    "tip_y": (1e3, "Tip position Y", "mm"),
}
SHAPIRO_ROWS = (3, 5000)  # between which the test of Shapiro and Wilk holds
CORRELATION_COLOURS = LinearSegmentedColormap.from_list("correlation", [draw.BLUE, "#FFFFFF", draw.VERMILION])
PANEL_HEIGHT = 2.5  # inches


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


def _legend(figure: Figure, axes: Sequence[Axes]) -> None:
    """One for all panels, above them."""
    found = {label: line for panel in axes for line, label in zip(*panel.get_legend_handles_labels(), strict=True)}
    columns = min(2 if figure.get_figwidth() < draw.DOUBLE_COLUMN else 4, len(found))
    figure.legend(found.values(), found.keys(), loc="outside upper center", ncols=columns)


# --- data and model ------------------------------------------------------------------------------


def table_figures(fit: Fit) -> dict[str, Figure]:
    """One figure for each table: data, model with its 95 % band, residuals.

    There is none for tables of several tendons, under forces or of tendons that slide out, which no single curve
    holds, and none where the model gave no numbers.
    """
    figures = {}
    for name, table in zip(fit.alone, fit.tables, strict=True):
        if "pulling_tension" in table:
            panels = [_pulley_panel(fit, name, table)]
        elif fit.manipulator.num_tendons == 1 and not _is_apart(table):
            columns = [c for c in ("tip_tension", *COLUMNS) if c in table]
            panels = [_bench_panel(fit, name, table, column) for column in columns]
        else:
            continue
        if all(np.all(np.isfinite(panel.predicted)) and np.all(np.isfinite(panel.residual)) for panel in panels):
            figures["fit_" + re.sub(r"\W+", "_", name.replace(".csv", "")).strip("_")] = draw.fit_figure(panels)
    return figures


def _is_apart(table: Measurements) -> bool:
    """Whether rows lie off the curve of a free body whose tendons are pulled in."""
    forces = any(np.any(table[column]) for column in ("tip_force_x", "tip_force_y") if column in table)
    return forces or ("direction" in table and bool(np.any(table["direction"] < 0)))


def _data_label(table: Measurements) -> str:
    return "simulated data, mean ± sd" if table.simulated else "data, mean ± sd"


def _bench_panel(fit: Fit, name: str, table: Measurements, column: str) -> draw.FitPanel:
    scale, quantity, unit = COLUMNS.get(column, (1.0, "Tip tension", "N"))
    tension = table["base_tension"]
    grid = np.linspace(tension.min(), tension.max(), 100)
    value, half_width, _ = fit.predict(column, grid)
    return draw.FitPanel(
        x=tension,
        observed=scale * table[column],
        residual=scale * fit.residuals[f"{name}: {column}"],
        grid=grid,
        predicted=scale * value,
        lower=scale * (value - half_width),
        upper=scale * (value + half_width),
        x_label="Base tension (N)",
        y_label=f"{quantity} ({unit})",
        residual_label=f"Residual ({unit})",
        data_label=_data_label(table),
    )


def _pulley_panel(fit: Fit, name: str, table: Measurements) -> draw.FitPanel:
    """Pulling tension per weight over wrap angle, so that one curve holds every weight."""
    grid = np.linspace(0.0, table["wrap_angle"].max(), 100)
    ratio = np.asarray(pulling_tension(1.0, fit.value["friction_coefficient"], grid))
    slope = np.zeros((grid.size, len(fit.names)))
    if "friction_coefficient" in fit.names:
        slope[:, fit.names.index("friction_coefficient")] = grid * ratio
    half_width = fit.band(slope)
    return draw.FitPanel(
        x=DEGREE * table["wrap_angle"],
        observed=table["pulling_tension"] / table["weight"],
        residual=fit.residuals[f"{name}: pulling_tension"] / table["weight"],
        grid=DEGREE * grid,
        predicted=ratio,
        lower=ratio - half_width,
        upper=ratio + half_width,
        x_label="Wrap angle (deg)",
        y_label="Pulling tension / weight",
        residual_label="Residual",
        data_label=_data_label(table),
    )


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
        _legend(figure, axes)
    return figure


def _draw_quantiles(axes: Axes, residual: np.ndarray) -> None:
    """Sorted residuals, the line on which they would lie, and where 95 % of normal draws do, place by place."""
    count, rank = residual.size, np.arange(1, residual.size + 1)
    quantile = stats.norm.ppf((rank - 0.375) / (count + 0.25))
    lower, upper = (stats.norm.ppf(stats.beta.ppf(level, rank, count + 1 - rank)) for level in (0.025, 0.975))
    draw.draw_band(axes, quantile, lower, upper, label="95 % of normal draws")
    axes.plot(quantile, quantile, color=draw.BLUE, label="normal")
    axes.plot(quantile, np.sort(residual), "o", color=draw.BLACK, markerfacecolor="none", markersize=2.8, label="data")
    p_value = _normality(residual).p_value
    text = f"{count} residuals" + (f"\nShapiro-Wilk p = {p_value:.2g}" if np.isfinite(p_value) else "")
    axes.text(0.04, 0.96, text, transform=axes.transAxes, va="top")


# --- profiles ------------------------------------------------------------------------------------


def profiles_figure(fit: Fit, profiles: Mapping[str, Profile]) -> Figure:
    """The root of the rise of the sum of squares over each parameter; for a linear model straight lines.

    The interval lies where it stays below the dashed line; where that is never crossed the side is open.
    """
    with draw.house_style():
        figure, axes = draw.panels(len(profiles), 2, PANEL_HEIGHT)
        for panel, (name, profile) in zip(axes, profiles.items(), strict=True):
            scale, label = shown_scale(name)
            _draw_profile(panel, profile, scale, fit.value[name], fit.status[name])
            panel.set(xlabel=label, ylabel="Root of the rise in squares")
        _legend(figure, axes)
    return figure


def _draw_profile(axes: Axes, profile: Profile, scale: float, estimate: float, status: str) -> None:
    interval, valley = profile.confidence_interval, _is_valley(profile, status)
    low, high = _valley_reach(profile, estimate) if valley else _reach(profile, estimate)
    axes.set_xscale("log" if valley else "linear")
    axes.set_xlim(scale * low, scale * high)
    if not valley:
        axes.xaxis.set_major_locator(MaxNLocator(5))
    limit = np.sqrt(profile.threshold)
    axes.set_ylim(-0.1 * limit, 1.9 * limit)
    known = [closed or ends for closed, ends in zip(profile.closed, profile.model_ends, strict=True)]
    ends = [end if there else edge for end, there, edge in zip(interval, known, (low, high), strict=True)]
    ends = np.clip(ends, max(low, interval[0]), min(high, interval[1]))
    axes.axvspan(scale * ends[0], scale * ends[1], color=draw.SKY, alpha=0.35, linewidth=0, label="95 % interval")
    root = np.sqrt(np.maximum(profile.rise, 0.0))
    axes.plot(scale * profile.value, root, "o-", color=draw.BLUE, markersize=2.2, label="profile")
    axes.axhline(limit, color=draw.VERMILION, linestyle="--", label="95 % limit")
    if status != NOT_IDENTIFIED:
        axes.axvline(scale * estimate, color=draw.BLACK, linestyle=":", label="estimate")
    patch = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
    look = {"transform": axes.transAxes, "va": "top", "color": draw.VERMILION, "bbox": patch}
    if not profile.closed[0]:
        word = "no solution" if profile.model_ends[0] else "bound" if status == AT_BOUND else "open"
        axes.text(0.03, 0.96, word if word == "bound" else f"← {word}", ha="left", **look)
    if not profile.closed[1]:
        axes.text(0.97, 0.96, "no solution →" if profile.model_ends[1] else "open →", ha="right", **look)


def _is_valley(profile: Profile, status: str) -> bool:
    """Whether what is positive is open on a side, best seen on a logarithmic axis."""
    return status != AT_BOUND and not all(profile.closed) and bool(np.all(profile.value > 0))


def _valley_reach(profile: Profile, estimate: float) -> tuple[float, float]:
    """Lowest and highest value to show: two decades each way, or where the valley ends."""
    (low, high), known = profile.confidence_interval, np.logical_or(profile.closed, profile.model_ends)
    low, high = low / 1.5 if known[0] else estimate / 100, 1.5 * high if known[1] else 100 * estimate
    return max(low, float(profile.value[0])), min(high, float(profile.value[-1]))


def _reach(profile: Profile, estimate: float) -> tuple[float, float]:
    """Lowest and highest value to show: somewhat more than the interval, or an open side some sizes far."""
    reach = []
    for sign, end, closed in zip((-1, +1), profile.confidence_interval, profile.closed, strict=True):
        outward = np.sort(sign * (profile.value - estimate))
        reach.append(1.6 * abs(end - estimate) if closed else outward[max(-4, -outward.size)])
    least = 0.05 * max(reach) or 1e-12
    return estimate - max(reach[0], least), estimate + max(reach[1], least)


# --- correlation and bootstraps ------------------------------------------------------------------


def correlated_names(fit: Fit) -> list[str]:
    """The parameters whose correlation the data determine."""
    if fit.rank == len(fit.names):
        return moving_names(fit)
    return [name for name in moving_names(fit) if fit.status[name] != NOT_IDENTIFIED]


def correlation_figure(fit: Fit) -> Figure:
    """The correlation of the estimates, as numbers on colours."""
    names = correlated_names(fit)
    index = [fit.names.index(name) for name in names]
    matrix = fit.correlation[np.ix_(index, index)]
    labels = [fill(shown_scale(name)[1].partition(" (")[0], 14) for name in names]
    width = float(np.clip(1.5 + 0.6 * len(names), draw.SINGLE_COLUMN, draw.DOUBLE_COLUMN))
    with draw.house_style():
        figure = draw.new_figure(width, 0.8 * width)
        axes = figure.subplots()
        image = axes.imshow(matrix, cmap=CORRELATION_COLOURS, vmin=-1, vmax=1)
        for (i, k), number in np.ndenumerate(matrix):
            digits = 2 if abs(number) < 0.995 or i == k else 4
            text = f"{round(number, digits) + 0.0:.{digits}f}".replace("-", "\N{MINUS SIGN}")
            axes.text(k, i, text, ha="center", va="center", color="white" if abs(number) > 0.8 else "black")
        turn = {} if len(names) < 4 else {"rotation": 45, "ha": "right", "rotation_mode": "anchor"}
        axes.set_xticks(range(len(names)), labels, **turn)
        axes.set_yticks(range(len(names)), labels)
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        between = np.arange(1, len(names)) - 0.5
        axes.hlines(between, -0.5, len(names) - 0.5, color="white", linewidth=1.5)
        axes.vlines(between, -0.5, len(names) - 0.5, color="white", linewidth=1.5)
        figure.colorbar(image, label="Correlation", shrink=0.9, ticks=[-1, -0.5, 0, 0.5, 1])
    return figure


def bootstrap_figure(fit: Fit, bootstrap: Bootstrap) -> Figure:
    """Histograms of each parameter, and each pair as points about the 95 % ellipse of the fit."""
    names = moving_names(fit)
    labels = [fill(shown_scale(name)[1], 24 if len(names) < 3 else 16) for name in names]
    scales = np.array([shown_scale(name)[0] for name in names])
    index = [fit.names.index(name) for name in names]
    points, estimate = scales * bootstrap.estimates[:, index], scales * bootstrap.estimate[index]
    covariance = np.outer(scales, scales) * fit.covariance[np.ix_(index, index)]
    width = draw.SINGLE_COLUMN if len(names) < 3 else draw.DOUBLE_COLUMN
    with draw.house_style():
        figure = draw.new_figure(width, 0.9 * width + 0.25)
        axes = figure.subplots(len(names), len(names), squeeze=False, sharex="col")
        for (i, k), panel in np.ndenumerate(axes):
            if i < k:
                panel.remove()
            elif i == k:
                _draw_histogram(panel, points[:, i], float(estimate[i]))
            else:
                known = {names[i], names[k]} <= set(correlated_names(fit))
                pair = covariance[np.ix_([k, i], [k, i])] if known else None
                _draw_pair(panel, points[:, [k, i]], estimate[[k, i]], pair, _stretch(fit))
            _label_corner(panel, i, k, labels)
        figure.align_labels()
        _legend(figure, [axes[0, 0], axes[-1, 0]])
    return figure


def _stretch(fit: Fit) -> float:
    """Of the ellipse of one standard deviation to that of 95 %."""
    if fit.noise_estimated:
        return float(np.sqrt(2 * stats.f.ppf(0.95, 2, max(fit.degrees_of_freedom, 1))))
    return float(np.sqrt(stats.chi2.ppf(0.95, 2)))


def _draw_histogram(axes: Axes, values: np.ndarray, estimate: float) -> None:
    bins = int(np.clip(np.sqrt(values.size), 5, 40))
    axes.hist(values, bins=bins, color=draw.SKY, alpha=0.7)
    for end, label in zip(np.percentile(values, [2.5, 97.5]), ("percentiles 2.5, 97.5", None), strict=True):
        axes.axvline(end, color=draw.VERMILION, linestyle="--", linewidth=0.9, label=label)
    axes.axvline(estimate, color=draw.BLACK, linestyle=":", label="estimate")


def _draw_pair(
    axes: Axes, points: np.ndarray, estimate: np.ndarray, covariance: np.ndarray | None, stretch: float
) -> None:
    axes.plot(*points.T, ".", color=draw.GREY, markersize=2.5, markeredgewidth=0, alpha=0.7, label="refits")
    axes.plot(*estimate, "x", color=draw.BLACK, markersize=5, zorder=4)
    if covariance is None:
        return
    sizes, axes_of = np.linalg.eigh(covariance)
    width, height = 2 * stretch * np.sqrt(np.maximum(sizes[::-1], 0.0))
    angle = np.degrees(np.arctan2(axes_of[1, 1], axes_of[0, 1]))
    look = {"facecolor": "none", "edgecolor": draw.BLUE, "linewidth": 1.1, "zorder": 3}
    axes.add_patch(Ellipse(tuple(estimate), width, height, angle=angle, label="95 % ellipse of the fit", **look))
    axes.autoscale_view()


def _label_corner(axes: Axes, i: int, k: int, labels: list[str]) -> None:
    """Labels at the rim only."""
    if i < k:
        return
    axes.xaxis.set_major_locator(MaxNLocator(3))
    axes.yaxis.set_major_locator(MaxNLocator(4, integer=i == k))
    axes.ticklabel_format(useOffset=False)
    axes.tick_params(labelbottom=i == len(labels) - 1)
    if i == len(labels) - 1:
        axes.set_xlabel(labels[k])
    if i == k:
        axes.set_ylabel("Refits")
    elif k == 0:
        axes.set_ylabel(labels[i])
    else:
        axes.tick_params(labelleft=False)
