"""The bent body in space, mm: a scene in three dimensions with shadows on the walls, and three plane views."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D
from mpl_toolkits.mplot3d.axis3d import Axis
from mpl_toolkits.mplot3d.proj3d import proj_transform

from ..errors import InputError
from . import looks, style as draw
from .geometry import AZIMUTH, ELEVATION, Drawn, SpatialBody

# by the name of a plane: the coordinates to the right and up, and the one that points to the reader
VIEWS = {"XY": (0, 1, 2), "XZ": (0, 2, 1), "YZ": (1, 2, 0)}
TOWARDS = {"XY": (0.0, 0.0, 1.0), "XZ": (0.0, -1.0, 0.0), "YZ": (1.0, 0.0, 0.0)}
SIDE = 2.2  # inches, of the square in which a plot lies
VIEWS_HEIGHT = 1.9  # inches, of the three views with their labels
LABELS_OFF = ((0.13, 0.32), (0.13, 0.32), (0.17, 0.42))  # inches between an axis, its numbers and its name
LIGHT = np.array([0.25, -0.45, 0.86])  # from where light falls on a body


# --- in three dimensions -------------------------------------------------------------------------


@contextmanager
def scene_or_new(axes: Axes | None, points: np.ndarray, norm: Normalize, label: str) -> Iterator[Axes3D]:
    """Axes in three dimensions around points, mm, to draw into: those given, or those of a new figure.

    The scale of colours with its label stands beside the plot. A new figure fits around the plot.
    """
    if isinstance(axes, Axes3D):
        _set_scene(axes, points)
        draw.scale_beside(axes, norm, label, shrink=0.7, pad=0.12)
        yield axes
        return
    if axes is not None:
        raise InputError('figures: the body is in space; give axes with projection="3d", or none')
    with draw.house_style():
        figure = draw.placed_figure(draw.SINGLE_COLUMN, 3.0)
        scene, taken = new_scene(figure, points, 0.12, 0.45, SIDE, SIDE)
        up, across = taken + 0.95, figure.get_figwidth()
        figure.set_figheight(up)
        scene.set_position((0.12 / across, (0.6 + 0.5 * (taken - SIDE)) / up, SIDE / across, SIDE / up))
        draw.colour_scale(figure, norm, label, draw.SINGLE_COLUMN - 0.5, 0.6, up - 0.95)
        yield scene


def new_scene(
    figure: Figure, points: np.ndarray, left: float, bottom: float, width: float, height: float
) -> tuple[Axes3D, float]:
    """Axes of three dimensions around points, mm, in a rectangle of a figure, inches, and the height that they take."""
    side, across, up = max(width, height), *figure.get_size_inches()
    place = (left + 0.5 * (width - side), bottom + 0.5 * (height - side), side, side)
    axes = figure.add_axes((place[0] / across, place[1] / up, side / across, side / up), projection="3d")
    scene = cast(Axes3D, axes)
    scene.set_in_layout(False)
    scene.patch.set_visible(False)
    _set_scene(scene, points)
    return scene, _fill_scene(scene, width, height)


def sight() -> np.ndarray:
    """The direction towards the reader."""
    up, around = np.radians([ELEVATION, AZIMUTH])
    return np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])


def _set_scene(axes: Axes3D, points: np.ndarray) -> None:
    """Limits around points, mm, one scale for all three, white walls."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.08 * np.max(high - low)
    low, high = low - margin, high + margin
    low[2] -= margin  # the shadow on the floor does not touch the body
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(tuple(high - low))
    axes.view_init(ELEVATION, AZIMUTH)
    axes.set_proj_type("ortho")
    axes.computed_zorder = False
    for axis, name in zip(_axis_of(axes), "XYZ", strict=True):
        axis.set_pane_color((1.0, 1.0, 1.0, 1.0))
        axis.line.set_linewidth(0.6)
        axis._axinfo["grid"].update(color=looks.PALE, linewidth=0.4)
        axis.set_tick_params(pad=-2)
        axis.labelpad = 0.0
        axis.set_label_text(f"${name}$ (mm)")


def _fill_scene(axes: Axes3D, width: float, height: float) -> float:
    """Enlarge the box of a plot until it fills a rectangle, inches; the height that it takes then, inches."""
    corners = np.array(list(product(axes.get_xlim(), axes.get_ylim(), axes.get_zlim())))
    side = axes.get_position(original=True).width * draw.figure_of(axes).get_figwidth()
    x, y, z = corners.T
    projected = np.stack(proj_transform(x, y, z, axes.get_proj())[:2], axis=-1)
    flat = projected / np.array([axes.viewLim.width, axes.viewLim.height]) * side  # places on the page, inches
    size = np.ptp(flat, axis=0)
    zoom = float(np.min([width, height] / size))
    limits = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])
    axes.set_box_aspect(tuple(np.ptp(limits, axis=1)), zoom=cast(int, zoom))  # any number above 0
    edges = zoom * (flat[[4, 2, 1]] - flat[0])  # of the box along X, Y and Z, as they are on the page
    for axis, edge in zip(_axis_of(axes), edges, strict=True):
        count = int(np.clip(np.linalg.norm(edge) / 0.24, 1, 6))
        axis.set_major_locator(MaxNLocator(count, steps=[1, 2, 5, 10], min_n_ticks=1))
    _keep_labels_off(axes, edges, side)
    return zoom * float(size[1])


def _keep_labels_off(axes: Axes3D, edges: np.ndarray, side: float) -> None:
    """Numbers and names at one distance from their axes: Matplotlib lets it depend on the shape of the box."""
    step = 0.08 * 48 / (144 * side)  # of the box for each point of pad, as in mpl_toolkits.mplot3d.axis3d
    outward = -edges[1] - edges[2], edges[0] - edges[2], edges[0] + edges[1]
    for axis, edge, out, (number, name) in zip(_axis_of(axes), edges, outward, LABELS_OFF, strict=True):
        apart = abs(edge[0] * out[1] - edge[1] * out[0]) / np.linalg.norm(edge)
        points = np.clip(np.array([number, name]) / (step * apart), 0.0, 300.0)
        axis.set_tick_params(pad=points[0] - 8)
        axis.labelpad = points[1] - 21


def _axis_of(axes: Axes3D) -> Sequence[Axis]:
    return cast(Sequence[Axis], (axes.xaxis, axes.yaxis, axes.zaxis))


def draw_spatial_shape(what: Drawn, axes: Axes | None, before: np.ndarray | None = None) -> Axes:
    """A body in space with a scale of its tensions, in given axes or in a new figure.

    `before` is the axis of another body, mm, (points, 3), which is dashed.
    """
    norm = draw.tension_scale(what.tension)
    points = what.points if before is None else np.concatenate([what.points, before])
    with scene_or_new(axes, points, norm, "$T$ (N)") as scene:
        draw_scene(scene, what, norm, before)
        if axes is None:
            draw.legend_of_loads(draw.figure_of(scene), what.loads, loc="upper left", ncols=3)
    return scene


def draw_scene(axes: Axes3D, what: Drawn, norm: Normalize, before: np.ndarray | None = None) -> None:
    """Body, tendons and loads in a scene whose limits are set; the rest shape dotted, and shadows on the walls."""
    look = {"facecolor": looks.PALE, "edgecolor": looks.PALE, "linewidth": 0.3, "zorder": 1}
    axes.add_collection3d(Poly3DCollection(shadows(axes, what.body), **look))
    for line in (what.straight.midline, what.straight.rings[-1]):
        axes.plot(*line.T, color=looks.GREY, linewidth=0.6, linestyle=(0, (1, 2)), zorder=2)
    look = {"facecolor": "white", "edgecolor": looks.BLACK, "linewidth": 0.7, "zorder": 2}
    axes.add_collection3d(Poly3DCollection([what.plate_edge], **look))
    _draw_tube(axes, what.body)
    for i, path in enumerate(what.tendons if len(what.tendons) > 1 else (), 1):  # their numbers around the plate
        x, y, z = (what.plate + 0.04 * what.length) * path[0] / np.linalg.norm(path[0])
        text = axes.text(x, y, z, str(i), ha="center", va="center", fontsize=7.5, zorder=8)
        text.set_path_effects([withStroke(linewidth=1.5, foreground="white")])
    _draw_tendons(axes, what, norm, sight(), [0, 1, 2])
    if before is not None:
        axes.plot(*before.T, color=looks.GREY, linewidth=0.9, linestyle=(0, (4, 2)), zorder=8)
    _draw_loads(axes, what)


def _draw_tendons(axes: Axes, what: Drawn, norm: Normalize, sight: np.ndarray, shown: list[int]) -> None:
    """The tendons in some of the three coordinates, dashed where the body hides them from the direction `sight`."""
    for path, tension in zip(what.tendons, what.tension, strict=True):
        line, hidden = path[:, shown], what.body.is_hidden(path, sight)
        dashes = np.where(hidden, _dashed(path, tension), np.nan)
        draw.draw_coloured_line(axes, line, np.where(hidden, np.nan, tension), norm, 6.0)
        draw.draw_coloured_line(axes, line, dashes, norm, 5.0, rim=False)
        axes.plot(*line[np.isfinite(tension)][-1], "o", color=looks.BLACK, markersize=2.3, zorder=7)


def silhouette(body: SpatialBody, plane: Sequence[int]) -> list[np.ndarray]:
    """The outline of a body in a plane of two coordinates: a polygon (corners, 2) for each piece between two rings."""
    from scipy.spatial import ConvexHull  # takes long to load, and sweeps load this module for other figures

    flat = body.rings[:, :-1][..., list(plane)]
    pairs = np.concatenate([flat[:-1], flat[1:]], axis=1)
    return [pair[ConvexHull(pair, qhull_options="QJ").vertices] for pair in pairs]


def shadows(axes: Axes3D, body: SpatialBody) -> list[np.ndarray]:
    """The polygons (corners, 3) of a body's shadows on the three walls behind it."""
    walls, polygons = (axes.get_xlim()[0], axes.get_ylim()[1], axes.get_zlim()[0]), []
    for right, up, across in VIEWS.values():
        for flat in silhouette(body, (right, up)):
            polygon = np.full((len(flat), 3), walls[across])
            polygon[:, [right, up]] = flat
            polygons.append(polygon)
    return polygons


def _draw_tube(axes: Axes3D, body: SpatialBody) -> None:
    rings = body.rings
    faces = np.stack([rings[:-1, :-1], rings[1:, :-1], rings[1:, 1:], rings[:-1, 1:]], axis=2)
    outward = np.mean(faces, axis=2) - 0.5 * (body.midline[:-1] + body.midline[1:])[:, None]
    lit = np.clip((outward / np.linalg.norm(outward, axis=-1, keepdims=True)) @ LIGHT, -0.2, 1.0)
    colours = (0.74 + 0.20 * lit)[..., None].repeat(3, axis=-1).reshape(-1, 3)
    tube = Poly3DCollection(list(faces.reshape(-1, 4, 3)), facecolors=colours, edgecolors=colours, linewidth=0.3)
    tube.set(zorder=4, rasterized=True)  # drawn as lines of a PDF its facets would be visible
    axes.add_collection3d(tube)
    for ring in (rings[0], rings[-1]):
        axes.plot(*ring.T, color=looks.GREY, linewidth=0.6, zorder=4.5)
    cap = Poly3DCollection([rings[-1]], facecolor="white", edgecolor=looks.GREY, linewidth=0.6, zorder=4.5)
    axes.add_collection3d(cap)


def _dashed(path: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values along a line, NaN in the gaps between dashes of a 48th of its length."""
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(np.nan_to_num(path), axis=0), axis=1)))
    return np.where((way * 48 / way[-1]).astype(int) % 2 == 0, values, np.nan)


def _draw_loads(axes: Axes3D, what: Drawn) -> None:
    for arrow in what.force_arrows:
        look = {"color": looks.VERMILION, "linewidth": 1.3, "arrow_length_ratio": 0.25, "zorder": 9}
        axes.quiver(*arrow[0], *(arrow[1] - arrow[0]), **look)
    for arc in what.moment_arrows:
        axes.plot(*arc.T, color=looks.PURPLE, linewidth=1.3, zorder=9)
        look = {"color": looks.PURPLE, "linewidth": 1.3, "arrow_length_ratio": 2.0, "zorder": 9}
        axes.quiver(*arc[-3], *(arc[-1] - arc[-3]), **look)


# --- in a plane ----------------------------------------------------------------------------------


def draw_view(axes: Axes, what: Drawn, norm: Normalize, plane: str) -> None:
    """Body, tendons and loads as seen along the third axis, to scale."""
    right, up, _ = VIEWS[plane]
    flat, polygons = [right, up], silhouette(what.body, VIEWS[plane][:2])
    for color, width in ((looks.GREY, 1.2), (looks.PALE, 0.3)):  # the rim, and over it the body
        axes.add_collection(PolyCollection(polygons, facecolor=color, edgecolor=color, linewidth=width, zorder=1.5))
    axes.plot(*what.straight.midline[:, flat].T, color=looks.GREY, linewidth=0.6, linestyle=(0, (1, 2)), zorder=1)
    axes.plot(*what.plate_edge[:, flat].T, color=looks.BLACK, linewidth=1.0 if right == 0 else 0.6, zorder=1)
    _draw_tendons(axes, what, norm, np.array(TOWARDS[plane]), flat)
    for arrows, color in ((what.force_arrows, looks.VERMILION), (what.moment_arrows, looks.PURPLE)):
        for arrow in arrows:
            axes.plot(*arrow[:, flat].T, color=color, linewidth=1.2, zorder=6)
            draw.draw_head(axes, arrow[-2, flat], arrow[-1, flat], color)
    axes.set(xlabel=f"${plane[0]}$ (mm)", ylabel=f"${plane[1]}$ (mm)")


def draw_views(figure: Figure, draw_into: Callable[[Axes, str], None], points: np.ndarray) -> None:
    """Three plane views of points, mm, beside each other to one scale, at the foot of a figure."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.05 * np.max(high - low)
    low, high = low - margin, high + margin
    middle, half = 0.5 * (low + high), 0.5 * np.max((high - low)[1:])  # all views are as high as the highest
    ratios, up = [high[right] - low[right] for right, _, _ in VIEWS.values()], figure.get_figheight()
    place = {"left": 0.07, "right": 0.98, "bottom": 0.45 / up, "top": VIEWS_HEIGHT / up, "wspace": 0.35}
    grid = figure.add_gridspec(1, 3, width_ratios=ratios, **place)
    for column, (plane, (right, up, _)) in enumerate(VIEWS.items()):
        axes = figure.add_subplot(grid[0, column])
        draw_into(axes, plane)
        axes.set(xlim=(low[right], high[right]), ylim=(middle[up] - half, middle[up] + half), aspect="equal")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10], min_n_ticks=1))
