"""The figure of `cddf plan`: how well each candidate would tell each parameter."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullFormatter

from . import plotting as draw
from .bench import parameter_named
from .determination import Determination
from .next_measurement import Plan
from .units import shown

ROW_HEIGHT = 0.28  # inches


def plan_figure(plan: Plan) -> Figure:
    """Expected standard errors, one row for each candidate, the best on top; what stays open lies at the right edge."""
    rows = [("now", plan.now), *((ranked.candidate.name, ranked.expected) for ranked in plan.ranking)]
    names = plan.now.names
    errors = np.array([[_relative(told, name) for name in names] for _, told in rows])
    known = errors[np.isfinite(errors) & (errors > 0)]
    edge = 5 * known.max(initial=10.0)
    with draw.house_style():
        figure = draw.new_figure(draw.DOUBLE_COLUMN, 1.1 + ROW_HEIGHT * len(rows))
        axes = figure.subplots()
        axes.axhspan(-0.5, 0.5, color=draw.PALE, linewidth=0)
        for k, name in enumerate(names):
            look: dict[str, Any] = draw.CURVES[k % len(draw.CURVES)] | {"linestyle": "none", "markersize": 4.5}
            shift = 0.16 * (k - (len(names) - 1) / 2)
            height = np.arange(len(rows)) + shift
            there = np.isfinite(errors[:, k])
            axes.plot(errors[there, k], height[there], **look, label=_label(name))
            axes.plot(np.full((~there).sum(), edge), height[~there], **look, markerfacecolor="none")
        axes.axvline(edge, color=draw.GREY, linewidth=0.6, linestyle=":")
        axes.text(edge, -0.62, "open", ha="center", va="bottom", color=draw.GREY)
        axes.set_xscale("log")
        axes.set_xlim(0.5 * known.min(initial=10.0), 1.5 * edge)
        ticks = np.outer(10.0 ** np.arange(-6, 7), (1, 2, 5)).ravel()
        axes.xaxis.set_major_locator(FixedLocator(ticks[ticks < 0.7 * edge].tolist()))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_yticks(range(len(rows)), [name for name, _ in rows])
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.grid(axis="x", color=draw.PALE)
        axes.set_xlabel("Expected standard error (%)")
        figure.legend(loc="outside upper center", ncols=min(len(names), 3))
    return figure


def _relative(told: Determination, name: str) -> float:
    """Per cent of the value; of what may be zero, per cent of a size that matters."""
    kind = parameter_named(name)
    return 100 * told.standard_error[name] / (abs(told.value[name]) if kind.positive else kind.scale)


def _label(name: str) -> str:
    kind = parameter_named(name)
    return name if kind.positive else f"{name}, of {shown(kind.scale, kind.dimension)}"
