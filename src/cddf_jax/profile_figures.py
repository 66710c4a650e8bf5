"""The likelihood along a parameter: how far the data hold it."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from . import plotting as draw
from .determination import AT_BOUND, NOT_IDENTIFIED
from .errors import InputError
from .fit_figures import PANEL_HEIGHT, own_names, shown_scale
from .identification import Fit
from .profile_likelihood import Profile


def draw_profile(fit: Fit, profile: Profile | str, axes: Axes | None = None) -> Axes:
    """The root of the rise of the sum of squares over a parameter; for a linear model straight lines.

    The 95 % interval lies where it stays below the dashed line; where that is never crossed the side is open, and
    said to be. What is positive and open is drawn on a logarithmic axis, without an estimate.

    Args:
        fit: of `fit`.
        profile: of `fit.profile`, or the name of a parameter that was fitted, which is then profiled: that is a few
            dozen fits.
        axes: where to draw; None for a new figure, one column wide.

    Raises:
        InputError: for a name that was not fitted.
    """
    name = profile if isinstance(profile, str) else profile.name
    if name not in own_names(fit):
        raise InputError(f"draw_profile: {name!r} was not fitted; there are {', '.join(own_names(fit))}")
    drawn = fit.profile(profile) if isinstance(profile, str) else profile
    scale, label = shown_scale(name)
    with draw.axes_or_new(axes, PANEL_HEIGHT) as axes:
        _draw_profile(axes, drawn, scale, fit.value[name], fit.status[name])
        axes.set(xlabel=label, ylabel="Root of the rise in squares")
        draw.legend_above(axes)
    return axes


def profiles_figure(fit: Fit, profiles: Mapping[str, Profile]) -> Figure:
    """A panel for each profile, with one legend."""
    with draw.house_style():
        figure, axes = draw.panels(len(profiles), 2, PANEL_HEIGHT)
        for panel, profile in zip(axes, profiles.values(), strict=True):
            draw_profile(fit, profile, panel)
        draw.common_legend(figure, axes)
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
