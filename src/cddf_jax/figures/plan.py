"""The figure of `cddf plan`: how well each candidate would tell each parameter."""

from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from ..estimation.determination import Determination
from ..identification.bench import parameter_named
from ..identification.experiment_design import Plan
from ..units import shown
from . import looks, style as draw

ROW_HEIGHT = 0.28  # inches
MANY = 300  # of the largest over the smallest error: then only powers of ten are written


def draw_plan(plan: Plan, axes: Axes | None = None) -> Axes:
    """Expected standard errors, per cent, one row for each candidate, the best on top.

    Of what may be zero they are per cent of a size that matters, told in the legend. What stays open is hollow at the
    right edge. The first row is what is known now.

    Args:
        plan: of `plan`.
        axes: where to draw; None for a new figure, two columns wide.
    """
    rows = [("now", plan.now), *((ranked.candidate.name, ranked.expected) for ranked in plan.ranking)]
    names = plan.now.names
    errors = np.array([[_relative(told, name) for name in names] for _, told in rows])
    known = errors[np.isfinite(errors) & (errors > 0)]
    edge = 5 * known.max(initial=10.0)
    with draw.axes_or_new(axes, 1.1 + ROW_HEIGHT * len(rows), draw.DOUBLE_COLUMN) as axes:
        axes.axhspan(-0.5, 0.5, color=looks.PALE, linewidth=0)
        for k, name in enumerate(names):
            look: looks.Look = looks.CURVES[k % len(looks.CURVES)] | {"linestyle": "none", "markersize": 4.5}
            height = np.arange(len(rows)) + 0.16 * (k - (len(names) - 1) / 2)
            there = np.isfinite(errors[:, k])
            axes.plot(errors[there, k], height[there], **look, label=_label(name))
            axes.plot(np.full((~there).sum(), edge), height[~there], **look, markerfacecolor="none")
        axes.axvline(edge, color=looks.GREY, linewidth=0.6, linestyle=":")
        _scale_errors(axes, 0.5 * known.min(initial=10.0), edge)
        axes.set_yticks(range(len(rows)), [fill(name, 24) for name, _ in rows])
        axes.set_ylim(len(rows) - 0.5, -0.5)
        draw.legend_above(axes, 4)
    return axes


def _scale_errors(axes: Axes, low: float, edge: float) -> None:
    """A logarithmic axis with round numbers, and "open" at the edge."""
    axes.set(xscale="log", xlim=(low, 1.5 * edge), xlabel="Expected standard error (%)")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if edge / low < MANY else (1,), numticks=50))
    axes.xaxis.set_major_formatter(lambda tick, _: f"{tick:g}" if tick < 0.4 * edge else "")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(axis="x", color=looks.PALE)
    axes.annotate("open", (edge, 0.0), (0, -4), axes.get_xaxis_transform(), "offset points", ha="center", va="top")


def _relative(told: Determination, name: str) -> float:
    """Per cent of the value; of what may be zero, per cent of a size that matters."""
    kind = parameter_named(name)
    return 100 * told.standard_error[name] / (abs(told.value[name]) if kind.positive else kind.scale)


def _label(name: str) -> str:
    kind = parameter_named(name)
    return name if kind.positive else f"{name}, of {shown(kind.scale, kind.dimension)}"
