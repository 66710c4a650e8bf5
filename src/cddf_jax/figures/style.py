"""The house style, and drawing from plain arrays."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar, cast

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure, FigureBase
from matplotlib.style import context
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from ..errors import InputError
from ..progress import stage
from .geometry import Body, Drawn
from .looks import BLACK, GREY, PALE, PURPLE, SKY, VERMILION, Look, LookValue

Item = TypeVar("Item")

SINGLE_COLUMN, DOUBLE_COLUMN = 3.5, 7.16  # inches, the columns of IEEE's two-column page
# perceptually uniform, for colour-blind readers and for grey prints: the higher the tension the darker
TENSION_COLOURS = LinearSegmentedColormap.from_list("tension", mpl.colormaps["viridis_r"](np.linspace(0.05, 1.0, 256)))
# the same bytes for the same figure
METADATA: dict[str, dict[str, None]] = {"pdf": {"CreationDate": None}, "png": {"Software": None}}
STYLE = Path(__file__).with_name("house.mplstyle")


def house_style() -> AbstractContextManager[None]:
    """The house style within the block, nothing changed outside it."""
    return context(STYLE, after_reset=True)


class HouseFigure(Figure):
    """A figure that is drawn in the house style, wherever it is shown or saved."""

    def draw(self, renderer: Any) -> None:  # a RendererBase, or what Matplotlib passes in its place
        """Draw it; ticks take their look from the style only now."""
        with house_style():
            super().draw(renderer)

    def savefig(self, fname: Any, **options: Any) -> None:
        """Write it as Matplotlib does: sharp in print, with fonts that journals accept."""
        with house_style():
            super().savefig(fname, **options)


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, inches; call it within `house_style`."""
    return HouseFigure(figsize=(width, height), layout="constrained")


def panels_figure(draw: Callable[[Axes, Item], object], items: Sequence[Item], height: float) -> Figure:
    """A panel of one height, inches, for each item, two in a row, drawn by a function, with one legend above."""
    columns = min(len(items), 2)
    rows = -(-len(items) // columns)
    with house_style():
        figure = new_figure(SINGLE_COLUMN if columns == 1 else DOUBLE_COLUMN, height * rows + 0.3)
        panels = [figure.add_subplot(rows, columns, i + 1) for i in range(len(items))]
        for panel, item in zip(panels, items, strict=True):
            draw(panel, item)
        common_legend(figure, panels)
        figure.align_labels()
    return figure


def tension_scale(tension: np.ndarray) -> Normalize:
    """The colours of tensions: from the least to the most, or from 0 where they hardly differ."""
    low, high = float(np.nanmin(tension)), float(np.nanmax(tension))
    return Normalize(low if high - low > 1e-3 * high else 0.0, high or 1.0)


def scale_beside(axes: Axes, what: Normalize | ScalarMappable, label: str) -> None:
    """The colours of values beside axes; of numbers without a drawing of their own those of tensions."""
    what = ScalarMappable(what, TENSION_COLOURS) if isinstance(what, Normalize) else what
    look: Look = {"shrink": 0.7, "pad": 0.14} if isinstance(axes, Axes3D) else {"pad": 0.02}
    figure = cast(FigureBase, axes.get_figure(root=False))
    figure.colorbar(what, ax=axes, label=label, aspect=35, **look)


@contextmanager
def axes_or_new(axes: Axes | None, height: float, *, in_space: bool = False) -> Iterator[Axes]:
    """The axes to draw into: those given, in their own style, or new ones in the house style, in a figure in inches."""
    if axes is not None:
        if in_space and not isinstance(axes, Axes3D):
            raise InputError('figures: the body is in space; give axes with projection="3d", or none')
        yield axes
        return
    with house_style():
        yield new_figure(SINGLE_COLUMN, height).add_subplot(projection="3d" if in_space else None)


def figure_of(axes: Axes) -> Figure:
    """The whole figure that holds some axes."""
    return cast(Figure, axes.get_figure(root=True))


def legend_above(axes: Axes, columns: int = 2) -> None:
    """A legend above the axes, if anything in them has a label."""
    if found := _labelled([axes]):
        look = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "columnspacing": 1.2, "borderpad": 0.1}
        axes.legend(found.values(), found.keys(), ncols=min(columns, len(found)), **look)


def common_legend(figure: Figure, panels: Sequence[Axes]) -> None:
    """One legend for all panels, above them, in place of their own."""
    for panel in panels:
        if (own := panel.get_legend()) is not None:
            own.remove()
    if found := _labelled(panels):
        columns = min(2 if figure.get_figwidth() < DOUBLE_COLUMN else 4, len(found))
        figure.legend(found.values(), found.keys(), loc="outside upper center", ncols=columns)


def _labelled(panels: Sequence[Axes]) -> dict[str, Artist]:
    """The artists with labels in some panels, each label once."""
    found: dict[str, Artist] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return found


def to_scale(axes: Axes) -> None:
    """One scale for x and y: the limits are widened, or, where other axes share them, the axes are made smaller."""
    groups = axes.get_shared_x_axes(), axes.get_shared_y_axes()
    shared = all(len(group.get_siblings(axes)) > 1 for group in groups)
    axes.set_aspect("equal", adjustable="box" if shared else "datalim")


@stage("drawing")
def render(figure: Figure, name: str) -> dict[str, bytes]:
    """The figure as PDF and PNG (300 dpi) by file name; the same bytes for the same figure."""
    files = {}
    for suffix, metadata in METADATA.items():
        buffer = BytesIO()
        figure.savefig(buffer, format=suffix, metadata=metadata)
        files[f"{name}.{suffix}"] = buffer.getvalue()
    return files


def draw_band(axes: Axes, x: np.ndarray, lower: np.ndarray, upper: np.ndarray, **style: LookValue) -> None:
    """The region between two lines."""
    axes.fill_between(x, lower, upper, **({"color": SKY, "alpha": 0.5, "linewidth": 0} | style))


# --- lines along a path in time ------------------------------------------------------------------


def turning_places(values: np.ndarray) -> list[int]:
    """The indices of the first and the last value and of the turns between, where values begin to rise or to fall."""
    moved = np.flatnonzero(np.diff(values))
    ways = np.sign(np.diff(values))[moved]
    return [0, *(int(place) for place in moved[1:][ways[1:] != ways[:-1]]), len(values) - 1]


def draw_arrow(axes: Axes, x: np.ndarray, y: np.ndarray, color: str) -> None:
    """The head of an arrow in the middle of a line, in the order of its points; none if x does not change."""
    way = np.abs(x - x[0])
    if len(x) < 2 or not np.all(np.isfinite([*y, *way])) or way[-1] == 0:
        return
    place = int(np.clip(np.searchsorted(way, 0.5 * way[-1]), 1, len(x) - 1))
    before, after = np.array([x[place - 1], y[place - 1]]), np.array([x[place], y[place]])
    draw_head(axes, before, 0.5 * (before + after), color)


def draw_head(axes: Axes, before: np.ndarray, end: np.ndarray, color: str) -> None:
    """The head of an arrow that ends at a point and comes from another one."""
    head = {"arrowstyle": "-|>", "color": color, "linewidth": 0, "mutation_scale": 9, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tuple(end), tuple(before), arrowprops=head)


# --- the body and the forces on it ---------------------------------------------------------------


def draw_wall(axes: Axes, body: Body) -> None:
    """Wall and bore to scale in the plane, the midline dash-dotted."""
    look = {"facecolor": PALE, "edgecolor": GREY, "linewidth": 0.5}
    for wall in body.walls:
        axes.fill(*wall.T, **look)
    axes.plot(*body.midline[:, :2].T, color=GREY, linestyle=(0, (8, 2, 1, 2)), linewidth=0.6)
    axes.set(xlabel="$X$ (mm)", ylabel="$Y$ (mm)", aspect="equal")


def draw_tendons(axes: Axes, what: Drawn, shown: Sequence[int], sight: np.ndarray | None = None) -> None:
    """The tendons in some of the three coordinates, coloured by tension with a dark rim, a dot at each anchor.

    Where the body hides them from the direction `sight` they are dashed and black; None for a body that is cut open.
    """
    look = {"cmap": TENSION_COLOURS, "norm": tension_scale(what.tension), "linewidth": 1.5, "capstyle": "round"}
    for path, tension, anchor in zip(what.tendons, what.tension, what.anchors, strict=True):
        hidden = np.full(tension.shape, False) if sight is None else what.body.is_hidden(path, sight)
        parts, flat = np.isfinite(tension) & [hidden, ~hidden], path[:, shown]
        for part, dashes, width in zip(parts, ((0, (4, 2)), "-"), (0.8, 2.2), strict=True):
            line = np.where(part[:, None], flat, np.nan)
            axes.plot(*line.T, color=BLACK, linestyle=dashes, linewidth=width, zorder=5.5)
        there = parts[1, :-1] & parts[1, 1:]
        pieces, values = np.stack([flat[:-1], flat[1:]], axis=1)[there], 0.5 * (tension[:-1] + tension[1:])[there]
        if isinstance(axes, Axes3D) and len(pieces):
            axes.add_collection3d(Line3DCollection(list(pieces), array=values, zorder=6, **look))
        elif len(pieces):
            axes.add_collection(LineCollection(list(pieces), array=values, zorder=6, **look))
        axes.plot(*anchor[shown], "o", color=BLACK, markersize=2.3, zorder=7)


def draw_loads(axes: Axes, what: Drawn, shown: Sequence[int]) -> None:
    """An arrow for each load in some of the three coordinates."""
    for arrows, color in ((what.force_arrows, VERMILION), (what.moment_arrows, PURPLE)):
        for arrow in arrows:
            axes.plot(*arrow[:, shown].T, color=color, linewidth=1.2, zorder=8)
            if isinstance(axes, Axes3D):
                start, end = arrow[-2:]
                head = float(0.05 * what.length / np.linalg.norm(end - start))  # of its last piece
                axes.quiver(*start, *(end - start), arrow_length_ratio=head, color=color, linewidth=1.2, zorder=8)
            else:
                draw_head(axes, arrow[-2, shown], arrow[-1, shown], color)


def legend_of_loads(axes: Axes, what: Drawn) -> None:
    """The size of each load by the colour of its arrow, gravity by its components, and other lines with labels."""
    places = ["", *(f" at {1e3 * float(point.arc_length):.3g} mm" for point in what.loads.points)]
    gravity = np.asarray(what.loads.gravity)[: 3 if what.in_space else 2]
    components = ", ".join(f"{x:.3g}" for x in gravity).replace("-", "\N{MINUS SIGN}")
    entries = [(gravity, f"$g$ = ({components}) m/s$^2$", "none")]
    for place, (_, force, moment) in zip(places, what.acting, strict=True):
        entries.append((force, f"$F$ = {np.linalg.norm(force):.3g} N{place}", VERMILION))
        entries.append((moment, f"$m$ = {np.linalg.norm(moment):.3g} N m{place}", PURPLE))
    for load, label, color in entries:
        if np.any(load):
            axes.plot([], [], color=color, label=label)
    if _labelled([axes]):
        axes.legend(loc="upper left" if what.in_space else "best")
