"""Figures in the house style, made from plain arrays.

They are `matplotlib.figure.Figure` objects without pyplot: no display is needed and no global state
is touched. Colours (Okabe and Ito's, safe for colour-blind readers) always come with a line style or a
marker of their own, so that a grey print can be read.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Rectangle
from matplotlib.path import Path
from matplotlib.quiver import Quiver

SINGLE_COLUMN, DOUBLE_COLUMN = 3.5, 7.16  # inches, the columns of IEEE's two-column page
BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILION, PURPLE = (
    *("#000000", "#E69F00", "#56B4E9", "#009E73"),
    *("#F0E442", "#0072B2", "#D55E00", "#CC79A7"),
)
GREY, PALE = "#7F7F7F", "#E8E8E8"
# perceptually uniform, for colour-blind readers and grey prints alike: the higher the tension the darker
TENSION_COLOURS = LinearSegmentedColormap.from_list("tension", mpl.colormaps["viridis_r"](np.linspace(0.05, 1.0, 256)))
# one style per curve: a colour, a dash pattern and a marker that belong together
CURVES: tuple[dict[str, Any], ...] = tuple(
    {"color": color, "linestyle": dashes, "marker": marker}
    for color, dashes, marker in (
        (BLUE, "-", "o"),
        (VERMILION, "--", "s"),
        (GREEN, "-.", "^"),
        (PURPLE, ":", "D"),
        (ORANGE, (0, (5, 1, 1, 1, 1, 1)), "v"),
        (BLACK, (0, (6, 2)), "x"),
    )
)
STYLE: dict[Any, Any] = {
    "font.family": "STIXGeneral",
    "font.size": 8.5,
    "mathtext.fontset": "stix",
    "axes.titlesize": 8.5,
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "legend.handlelength": 2.2,
    "lines.linewidth": 1.1,
    "lines.markersize": 3.2,
    "errorbar.capsize": 1.8,
    "savefig.dpi": 300,
    "pdf.fonttype": 42,  # fonts that editors of journals accept
}


@contextmanager
def house_style() -> Iterator[None]:
    """The house style within the block, nothing changed outside it."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(STYLE)
        yield


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, inches; call it within `house_style`."""
    return Figure(figsize=(width, height), layout="constrained")


def panels(count: int, columns: int, height: float) -> tuple[Figure, list[Axes]]:
    """A figure of so many panels of one height, in; call it within `house_style`."""
    columns = min(count, columns)
    rows = -(-count // columns)
    figure = new_figure(SINGLE_COLUMN if columns == 1 else DOUBLE_COLUMN, height * rows + 0.3)
    axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for unused in axes[count:]:
        unused.remove()
    return figure, axes[:count]


def render(figure: Figure, name: str) -> dict[str, bytes]:
    """The figure as PDF and PNG (300 dpi) by file name; the same bytes for the same figure."""
    files = {}
    with house_style():
        for suffix, metadata in (("pdf", {"CreationDate": None}), ("png", {"Software": None})):
            buffer = BytesIO()
            figure.savefig(buffer, format=suffix, metadata=metadata)
            files[f"{name}.{suffix}"] = buffer.getvalue()
    return files


# --- the body and the forces on it ---------------------------------------------------------------


class Body(NamedTuple):
    """A bent body as it is drawn: lengths in one unit, headings in radians, points along the body first."""

    midline: np.ndarray  # (points, 2)
    heading: np.ndarray
    outer_radius: np.ndarray
    inner_radius: np.ndarray
    tendon: np.ndarray | None = None  # signed distance of the tendon from the midline, positive to the left

    def at_distance(self, distance: Any) -> np.ndarray:
        """The line at a signed distance to the left of the midline, (points, 2)."""
        left = np.stack([-np.sin(self.heading), np.cos(self.heading)], axis=-1)
        return self.midline + np.asarray(distance)[..., None] * left

    @property
    def outline(self) -> np.ndarray:
        """The outer surface, up one side and back on the other, (2 points, 2)."""
        return np.concatenate([self.at_distance(self.outer_radius), self.at_distance(-self.outer_radius)[::-1]])


def draw_body(axes: Axes, body: Body) -> None:
    """Wall and bore to scale, the midline dash-dotted and the tendon, if there is one, as a line."""
    look = {"facecolor": PALE, "edgecolor": GREY, "linewidth": 0.5}
    if np.any(body.inner_radius):
        for side in (+1, -1):
            outside, inside = body.at_distance(side * body.outer_radius), body.at_distance(side * body.inner_radius)
            axes.fill(*np.concatenate([outside, inside[::-1]]).T, **look)
    else:
        axes.fill(*body.outline.T, **look)
    axes.plot(*body.midline.T, color=GREY, linestyle=(0, (8, 2, 1, 2)), linewidth=0.6)
    if body.tendon is not None:
        axes.plot(*body.at_distance(body.tendon).T, color=BLACK, linewidth=0.5)
    axes.set_aspect("equal")


def draw_arrows(axes: Axes, points: np.ndarray, vectors: Any, scale: float, **style: Any) -> Quiver:
    """Vectors as arrows from points, both (points, 2); `scale` is vector units per unit of the axes."""
    look = {"angles": "xy", "scale_units": "xy", "units": "inches", "width": 0.011, "zorder": 3}
    axes.update_datalim(points + vectors / scale)
    axes.autoscale_view()
    return axes.quiver(*points.T, *vectors.T, scale=scale, **(look | style))


_ARROW: dict[str, Any] = {
    "arrowstyle": "-|>",
    "mutation_scale": 8,
    "linewidth": 1.2,
    "shrinkA": 0,
    "shrinkB": 0,
    "zorder": 6,
    "fill": True,
}


def draw_arrow(axes: Axes, points: np.ndarray, **style: Any) -> None:
    """An arrow along a line of points, (points, 2), with its head at the last."""
    axes.update_datalim(points)
    axes.add_patch(FancyArrowPatch(path=Path(points), **(_ARROW | style)))


def draw_coloured_line(axes: Axes, points: np.ndarray, values: np.ndarray, norm: Normalize) -> None:
    """A line with a dark rim, coloured by a value at each of its points (points, 2); none where it is NaN."""
    axes.plot(*np.where(np.isnan(values)[:, None], np.nan, points).T, color=BLACK, linewidth=2.2, zorder=4)
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    between = 0.5 * (values[:-1] + values[1:])
    there = np.isfinite(between)
    look = {"cmap": TENSION_COLOURS, "norm": norm, "linewidth": 1.5, "capstyle": "round", "zorder": 4.5}
    axes.add_collection(LineCollection(list(pieces[there]), array=between[there], **look))


def draw_clamp(axes: Axes, half_width: float, depth: float) -> None:
    """The wall to which a body is clamped: at X = 0, hatched on the far side."""
    look = {"facecolor": "white", "edgecolor": GREY, "hatch": "///////", "linewidth": 0.0, "zorder": 0}
    axes.add_patch(Rectangle((-depth, -half_width), depth, 2 * half_width, **look))
    axes.plot([0.0, 0.0], [-half_width, half_width], color=BLACK, linewidth=1.0, zorder=3)


def place_label(axes: Axes, text: str, point: np.ndarray, obstacles: np.ndarray) -> np.ndarray:
    """Write beside a point, where least is covered; call it when the limits of the axes are final.

    Args:
        axes: where to write.
        text: what to write.
        point: beside which, in data.
        obstacles: points on what is to stay uncovered, on the display, (points, 2).

    Returns:
        The obstacles with those of the label added.
    """
    label = axes.annotate(text, tuple(point), (0, 0), textcoords="offset points", ha="center", va="center", zorder=7)
    size = np.array([label.get_window_extent().width, label.get_window_extent().height])
    pixels = axes.get_figure(root=True).dpi / 72  # type: ignore[union-attr]
    centre, frame = axes.transData.transform(point), axes.get_window_extent().get_points()
    best, least = np.zeros(2), np.inf
    for gap in (3.0, 5.0, 8.0, 12.0, 17.0):
        for angle in np.arange(16) * np.pi / 8:
            offset = (size / 2 + gap * pixels) * np.array([np.cos(angle), np.sin(angle)])
            low, high = centre + offset - size / 2 - 3, centre + offset + size / 2 + 3
            covered = np.sum(np.all((obstacles > low) & (obstacles < high), axis=-1))
            outside = np.any(low < frame[0] + 4) or np.any(high > frame[1] - 4)
            cost = covered + 1000 * outside + gap / 100
            if cost < least:
                best, least = offset, cost
    label.xyann = tuple(best / pixels)
    grid = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(-0.5, 0.5, 5)), axis=-1).reshape(-1, 2)
    return np.concatenate([obstacles, centre + best + grid * size])


def round_number(value: float) -> float:
    """The greatest of 1, 2 and 5 times a power of ten that does not exceed a positive value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(digit for digit in (1, 2, 5) if digit * power <= value * (1 + 1e-12)))


# --- data and model ------------------------------------------------------------------------------


class Levels(NamedTuple):
    """Repeated readings gathered by level; `deviation` is NaN where a level was read once."""

    x: np.ndarray
    mean: np.ndarray
    deviation: np.ndarray  # standard deviation over the readings of a level
    lowest: np.ndarray
    highest: np.ndarray


def by_level(x: Any, y: Any) -> Levels:
    """Gather the readings y whose x agree within 2 % of the range of x, the scatter of a set point."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    order = np.argsort(x, kind="stable")
    new_level = np.flatnonzero(np.diff(x[order]) > 0.02 * np.ptp(x)) + 1
    groups = np.split(order, new_level)
    return Levels(
        x=np.array([x[group].mean() for group in groups]),
        mean=np.array([y[group].mean() for group in groups]),
        deviation=np.array([y[group].std(ddof=1) if len(group) > 1 else np.nan for group in groups]),
        lowest=np.array([y[group].min() for group in groups]),
        highest=np.array([y[group].max() for group in groups]),
    )


def draw_band(axes: Axes, x: Any, lower: Any, upper: Any, **style: Any) -> None:
    """The region between two lines."""
    axes.fill_between(x, lower, upper, **({"color": SKY, "alpha": 0.5, "linewidth": 0} | style))


def draw_levels(axes: Axes, x: Any, y: Any, **style: Any) -> None:
    """Mean and standard deviation of y at each level of x, as markers with error bars."""
    levels = by_level(x, y)
    look = {"fmt": "o", "color": BLACK, "markerfacecolor": "white", "elinewidth": 0.8, "zorder": 3}
    axes.errorbar(levels.x, levels.mean, yerr=levels.deviation, **(look | style))


class FitPanel(NamedTuple):
    """What one column of `fit_figure` shows; arrays in the units of the labels.

    The rows of the data are `x`, `observed` and `residual` = observed - predicted; the model is a line
    `predicted` over `grid` with the limits `lower` and `upper` of its 95 % band.
    """

    x: Any
    observed: Any
    residual: Any
    grid: Any
    predicted: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    x_label: str
    y_label: str
    residual_label: str
    data_label: str = "data, mean ± sd"


def fit_figure(panels: Sequence[FitPanel]) -> Figure:
    """Data with error bars and the fitted model with its 95 % band; the residuals below on the same x axis.

    The band is drawn about the residuals too, where a narrow one can be seen. One panel fills a
    column of a page, two or more stand side by side over both columns.
    """
    columns = len(panels)
    width = SINGLE_COLUMN if columns == 1 else DOUBLE_COLUMN
    with house_style():
        figure = new_figure(width, 3.2)
        axes = figure.subplots(2, columns, squeeze=False, sharex="col", height_ratios=(3, 1))
        for (top, bottom), panel in zip(axes.T, panels, strict=True):
            _draw_fit(top, panel)
            draw_band(bottom, panel.grid, panel.lower - panel.predicted, panel.upper - panel.predicted)
            draw_residuals(bottom, panel.x, panel.residual)
            bottom.set(xlabel=panel.x_label, ylabel=panel.residual_label)
        figure.align_ylabels()
    return figure


def _draw_fit(axes: Axes, panel: FitPanel) -> None:
    draw_band(axes, panel.grid, panel.lower, panel.upper, label="95 % band of the model")
    axes.plot(panel.grid, panel.predicted, color=BLUE, label="model")
    draw_levels(axes, panel.x, panel.observed, label=panel.data_label)
    axes.set_ylabel(panel.y_label)
    axes.legend(loc="best")


def draw_residuals(axes: Axes, x: Any, residual: Any) -> None:
    """Every residual as a dot, mean and standard deviation at each level over them, about a line at zero."""
    axes.axhline(0.0, color=BLUE)
    axes.plot(x, residual, ".", color=GREY, markersize=3.5, markeredgewidth=0)
    draw_levels(axes, x, residual, markersize=2.5)
    reach = 1.15 * np.max(np.abs(np.asarray(residual)), initial=0.0) or 1.0
    axes.set_ylim(-reach, reach)
