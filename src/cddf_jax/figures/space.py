"""The bent body in space, mm: a scene in three dimensions with shadows on the walls."""

from collections.abc import Sequence
from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LightSource
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D
from mpl_toolkits.mplot3d.axis3d import Axis

from . import looks, style as draw
from .geometry import AZIMUTH, ELEVATION, Body, Drawn

PLANES = ((0, 1, 2), (0, 2, 1), (1, 2, 0))  # of the walls: their two coordinates, and the one across
HEIGHT = 2.8  # inches, of a scene as wide as a column
LEAST = 0.6  # of the longest edge of a scene: its other edges, so that numbers and names have room at all of them
LIGHT = LightSource(azdeg=151, altdeg=59)  # falls on a body


def sight() -> np.ndarray:
    """The direction towards the reader."""
    up, around = np.radians([ELEVATION, AZIMUTH])
    return np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])


def set_scene(axes: Axes, points: np.ndarray) -> Axes3D:
    """Axes in three dimensions with limits around points, mm, one scale for all three, and white walls."""
    scene = cast(Axes3D, axes)
    low, high = points.min(axis=0), points.max(axis=0)
    middle, longest = 0.5 * (low + high), np.max(high - low)
    half = 0.5 * np.maximum(high - low + 0.16 * longest, LEAST * longest)
    low, high = middle - half, middle + half
    scene.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    scene.set_box_aspect(tuple(high - low), zoom=cast(int, 0.93))  # any number above 0; names stay on the page
    scene.view_init(ELEVATION, AZIMUTH)
    scene.set_proj_type("ortho")
    scene.computed_zorder = False
    for axis, name in zip(cast(Sequence[Axis], (scene.xaxis, scene.yaxis, scene.zaxis)), "XYZ", strict=True):
        axis.set_pane_color((1.0, 1.0, 1.0, 1.0))
        axis.line.set_linewidth(0.6)
        axis._axinfo["grid"].update(color=looks.PALE, linewidth=0.4)
        axis.set_tick_params(pad=-3)
        axis.labelpad = -6.0
        axis.set_label_text(f"${name}$ (mm)")
        axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10], min_n_ticks=1))
    return scene


def draw_scene(axes: Axes, what: Drawn, also: np.ndarray) -> None:
    """Body, tendons and loads in axes of three dimensions; the rest shape is dotted. Points `also` must be seen."""
    scene = set_scene(axes, np.concatenate([what.points, also]))
    look = {"facecolor": looks.PALE, "edgecolor": looks.PALE, "linewidth": 0.3, "zorder": 1}
    scene.add_collection3d(Poly3DCollection(shadows(scene, what.body), **look))
    for line in (what.straight.midline, what.straight.rings[-1]):
        scene.plot(*line.T, color=looks.GREY, linewidth=0.6, linestyle=(0, (1, 2)), zorder=2)
    look = {"facecolor": "white", "edgecolor": looks.BLACK, "linewidth": 0.7, "zorder": 2}
    scene.add_collection3d(Poly3DCollection([what.plate_edge], **look))
    _draw_tube(scene, what.body)
    for i, path in enumerate(what.tendons if len(what.tendons) > 1 else (), 1):  # their numbers around the plate
        x, y, z = (what.plate + 0.04 * what.length) * path[0] / np.linalg.norm(path[0])
        text = scene.text(x, y, z, str(i), ha="center", va="center", fontsize=7.5, zorder=8)
        text.set_path_effects([withStroke(linewidth=1.5, foreground="white")])
    draw.draw_tendons(scene, what, [0, 1, 2], sight())
    draw.draw_loads(scene, what, [0, 1, 2])


def silhouette(body: Body, plane: Sequence[int]) -> list[np.ndarray]:
    """The outline of a body in a plane of two coordinates: a polygon (corners, 2) for each piece between two rings."""
    from scipy.spatial import ConvexHull  # takes long to load, and sweeps load this module for other figures

    flat = body.rings[:, :-1][..., list(plane)]
    pairs = np.concatenate([flat[:-1], flat[1:]], axis=1)
    return [pair[ConvexHull(pair, qhull_options="QJ").vertices] for pair in pairs]


def walls_behind(axes: Axes3D) -> tuple[float, float, float]:
    """Where the three walls are behind what is drawn, mm."""
    return axes.get_xlim()[0], axes.get_ylim()[1], axes.get_zlim()[0]


def shadows(axes: Axes3D, body: Body) -> list[np.ndarray]:
    """The polygons (corners, 3) of a body's shadows on the three walls behind it."""
    return [
        np.insert(flat, across, walls_behind(axes)[across], axis=1)
        for right, up, across in PLANES
        for flat in silhouette(body, (right, up))
    ]


def _draw_tube(axes: Axes3D, body: Body) -> None:
    """The outer surface in the light, with its rings at base and tip."""
    rings = body.rings
    look = {"color": "#F2F2F2", "lightsource": LIGHT, "rstride": 1, "cstride": 1, "linewidth": 0, "antialiased": False}
    # drawn as lines of a PDF its facets would be visible
    axes.plot_surface(*np.moveaxis(rings, -1, 0), **look, zorder=4, rasterized=True)
    for ring in (rings[0], rings[-1]):
        axes.plot(*ring.T, color=looks.GREY, linewidth=0.6, zorder=4.5)
    axes.add_collection3d(Poly3DCollection([rings[-1]], facecolor="white", zorder=4.5))
