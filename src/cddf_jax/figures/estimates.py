"""Figures of estimates: correlation, bootstraps, profiles, and the standard errors that a plan expects."""

from collections.abc import Mapping
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from ..errors import InputError
from ..estimation.bootstrap import Bootstrap
from ..estimation.determination import AT_BOUND, NOT_IDENTIFIED
from ..estimation.profile_likelihood import Profile
from ..identification.experiment_design import Plan
from ..identification.fit import Fit
from ..identification.parameters import parameter_named
from ..identification.predictions import correlated_names, moving_names
from ..units import shown
from . import looks, style as draw
from .fit import PANEL_HEIGHT, shown_scale

ROW_HEIGHT = 0.28  # inches, of a candidate
MANY = 300  # of the largest over the smallest error: then only powers of ten are written
MOST_SHOWN = 1.9**2  # times the rise at the ends of the interval: up to there a profile is drawn
CORRELATION_COLOURS = LinearSegmentedColormap.from_list("correlation", [looks.BLUE, "#FFFFFF", looks.VERMILION])


def draw_correlation(fit: Fit, axes: Axes | None = None) -> Axes:
    """The correlation of the estimates that the data determine, as numbers on colours.

    Args:
        fit: of `fit`.
        axes: where to draw; None for a new figure, one column wide, or more where there are many parameters.

    Raises:
        InputError: where fewer than two parameters are determined.
    """
    names = correlated_names(fit)
    if len(names) < 2:
        raise InputError(
            f"draw_correlation: needs two parameters that the data determine, there are {len(names)}; see fit.verdict"
        )
    index = [fit.names.index(name) for name in names]
    matrix = fit.correlation[np.ix_(index, index)]
    width = float(np.clip(1.5 + 0.6 * len(names), draw.SINGLE_COLUMN, draw.DOUBLE_COLUMN))
    with draw.axes_or_new(axes, 0.8 * width, width) as axes:
        image = axes.imshow(matrix, cmap=CORRELATION_COLOURS, vmin=-1, vmax=1)
        for (i, k), number in np.ndenumerate(matrix):
            digits = 2 if abs(number) < 0.995 or i == k else 4
            text = f"{round(number, digits) + 0.0:.{digits}f}".replace("-", "\N{MINUS SIGN}")
            axes.text(k, i, text, ha="center", va="center", color="white" if abs(number) > 0.8 else "black")
        _name_rows(axes, [fill(shown_scale(name)[1].partition(" (")[0], 14) for name in names])
        draw.figure_of(axes).colorbar(image, ax=axes, label="Correlation", shrink=0.9, ticks=[-1, -0.5, 0, 0.5, 1])
    return axes


def _name_rows(axes: Axes, labels: list[str]) -> None:
    """Names of rows and columns, and white lines between them."""
    count = len(labels)
    turn = {} if count < 4 else {"rotation": 45, "ha": "right", "rotation_mode": "anchor"}
    axes.set_xticks(range(count), labels, **turn)
    axes.set_yticks(range(count), labels)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    between = np.arange(1, count) - 0.5
    axes.hlines(between, -0.5, count - 0.5, color="white", linewidth=1.5)
    axes.vlines(between, -0.5, count - 0.5, color="white", linewidth=1.5)


def bootstrap_figure(fit: Fit, bootstrap: Bootstrap) -> Figure:
    """Histograms of each parameter, and each pair as points about the joint 95 % region of the fit."""
    names = moving_names(fit)
    labels = [fill(shown_scale(name)[1], 24 if len(names) < 3 else 16) for name in names]
    scales = np.array([shown_scale(name)[0] for name in names])
    index = [fit.names.index(name) for name in names]
    points, estimate = scales * bootstrap.estimates[:, index], scales * bootstrap.estimate[index]
    width = draw.SINGLE_COLUMN if len(names) < 3 else draw.DOUBLE_COLUMN
    with draw.house_style():
        figure = draw.new_figure(width, 0.9 * width + 0.25)
        axes = figure.subplots(len(names), len(names), squeeze=False, sharex="col")
        for (i, k), panel in np.ndenumerate(axes):
            if i < k:
                panel.remove()
                continue
            if i == k:
                _draw_histogram(panel, points[:, i], float(estimate[i]))
            else:
                known = {names[i], names[k]} <= set(correlated_names(fit))
                region = scales[[k, i]] * _joint_region(fit, [index[k], index[i]]) if known else None
                _draw_pair(panel, points[:, [k, i]], estimate[[k, i]], region)
            panel.xaxis.set_major_locator(MaxNLocator(3))
            panel.yaxis.set_major_locator(MaxNLocator(4, integer=i == k))
            panel.set_xlabel(labels[k] if i == len(names) - 1 else "")
            panel.set_ylabel("Refits" if i == k else labels[i] if k == 0 else "")
            panel.tick_params(labelleft=i == k or k == 0)
        figure.align_labels()
        draw.common_legend(figure, [axes[0, 0], axes[-1, 0]])
    return figure


def _draw_histogram(axes: Axes, values: np.ndarray, estimate: float) -> None:
    bins = int(np.clip(np.sqrt(values.size), 5, 40))
    axes.hist(values, bins=bins, color=looks.SKY, alpha=0.7)
    for end, label in zip(np.percentile(values, [2.5, 97.5]), ("percentiles 2.5, 97.5", None), strict=True):
        axes.axvline(end, color=looks.VERMILION, linestyle="--", linewidth=0.9, label=label)
    axes.axvline(estimate, color=looks.BLACK, linestyle=":", label="estimate")


def _joint_region(fit: Fit, pair: list[int]) -> np.ndarray:
    """(points, 2), the edge of the joint 95 % region of two parameters about the estimate, SI.

    It is an ellipse if one kind of noise is in all directions.
    """
    root = np.linalg.cholesky(fit.covariance[np.ix_(pair, pair)])
    turn = np.linspace(0.0, 2 * np.pi, 200)
    direction = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    slopes = np.zeros((turn.size, len(fit.names)))
    slopes[:, pair] = np.linalg.solve(root.T, direction.T).T  # of quantities with a standard error of 1
    return fit.evidence.uncertainty(slopes).quantile_of_two[:, None] * direction @ root.T


def _draw_pair(axes: Axes, points: np.ndarray, estimate: np.ndarray, region: np.ndarray | None) -> None:
    axes.plot(*points.T, ".", color=looks.GREY, markersize=2.5, markeredgewidth=0, alpha=0.7, label="refits")
    axes.plot(*estimate, "x", color=looks.BLACK, markersize=5, zorder=4)
    if region is not None:
        look = {"facecolor": "none", "edgecolor": looks.BLUE, "linewidth": 1.1, "zorder": 3}
        axes.fill(*(estimate + region).T, label="95 % region of the fit", **look)


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
    scale, label = shown_scale(name)
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
        if not profile.closed[0]:
            word = "no solution" if profile.model_ends[0] else "bound" if status == AT_BOUND else "open"
            axes.text(0.03, 0.96, word if word == "bound" else f"← {word}", ha="left", **look)
        if not profile.closed[1]:
            axes.text(0.97, 0.96, "no solution →" if profile.model_ends[1] else "open →", ha="right", **look)
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


# --- what to measure next -------------------------------------------------------------------------


def draw_plan(plan: Plan, axes: Axes | None = None) -> Axes:
    """Expected standard errors, per cent, one row for each candidate, the best on top.

    For a parameter that may be zero they are per cent of a size that matters, given in the legend. A parameter that
    stays unidentified is hollow at the right edge. The first row is what is known now.

    Args:
        plan: of `plan`.
        axes: where to draw; None for a new figure, two columns wide.
    """
    rows = [("now", plan.now), *((ranked.candidate.name, ranked.expected) for ranked in plan.ranking)]
    names = plan.now.names
    kinds = {name: parameter_named(name) for name in names}
    sizes = [
        {n: abs(found.value[n]) if kind.positive else kind.scale for n, kind in kinds.items()} for _, found in rows
    ]
    pairs = zip(rows, sizes, strict=True)
    errors = np.array([[100 * found.standard_error[n] / size[n] for n in names] for (_, found), size in pairs])
    known = errors[np.isfinite(errors) & (errors > 0)]
    edge = 5 * known.max(initial=10.0)
    with draw.axes_or_new(axes, 1.1 + ROW_HEIGHT * len(rows), draw.DOUBLE_COLUMN) as axes:
        axes.axhspan(-0.5, 0.5, color=looks.PALE, linewidth=0)
        for k, name in enumerate(names):
            look: looks.Look = looks.CURVES[k % len(looks.CURVES)] | {"linestyle": "none", "markersize": 4.5}
            height = np.arange(len(rows)) + 0.16 * (k - (len(names) - 1) / 2)
            there = np.isfinite(errors[:, k])
            of = "" if kinds[name].positive else f", of {shown(kinds[name].scale, kinds[name].dimension)}"
            axes.plot(errors[there, k], height[there], **look, label=f"{name}{of}")
            axes.plot(np.full((~there).sum(), edge), height[~there], **look, markerfacecolor="none")
        axes.axvline(edge, color=looks.GREY, linewidth=0.6, linestyle=":")
        low = 0.5 * known.min(initial=10.0)
        axes.set(xscale="log", xlim=(low, 1.5 * edge), xlabel="Expected standard error (%)")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if edge / low < MANY else (1,), numticks=50))
        axes.xaxis.set_major_formatter(lambda tick, _: f"{tick:g}" if tick < 0.4 * edge else "")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.grid(axis="x", color=looks.PALE)
        axes.annotate("open", (edge, 0.0), (0, -4), axes.get_xaxis_transform(), "offset points", ha="center", va="top")
        axes.set_yticks(range(len(rows)), [fill(name, 24) for name, _ in rows])
        axes.set_ylim(len(rows) - 0.5, -0.5)
        draw.legend_above(axes, 4)
    return axes
