"""Figures of estimates: profiles, and the standard errors that a plan expects."""

from collections.abc import Mapping
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from ..estimation.determination import AT_BOUND, NOT_IDENTIFIED
from ..estimation.profile_likelihood import Profile
from ..identification.experiment_design import Plan
from ..identification.fit import Fit
from ..identification.parameters import parameter_named
from ..units import shown
from . import looks, style as draw
from .fit import PANEL_HEIGHT, shown_scale

ROW_HEIGHT = 0.28  # inches, of a candidate
MANY = 300  # of the largest over the smallest error: then only powers of ten are written
MOST_SHOWN = 1.9**2  # times the rise at the ends of the interval: up to there a profile is drawn


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
