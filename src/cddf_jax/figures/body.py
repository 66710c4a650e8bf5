"""The bent body to scale, mm: tendons coloured by tension with loads as arrows, or the forces of the tendons."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.markers import MarkerStyle
from matplotlib.patches import FancyArrowPatch
from matplotlib.path import Path

from ..errors import InputError
from ..mechanics.fields import SpatialFields
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import Equilibrium
from ..units import round_number
from . import geometry, looks, space, style as draw
from .along import draw_along
from .geometry import Body, Drawn

VIEWS_WIDTH = 6.6  # inches, of three views
HEIGHT = 2.4  # inches, of a figure as wide as a column
ARROWS = 10  # for each tendon
LONGEST = 1 / 7  # of the body's length


def equilibrium_figure(manipulator: Manipulator, equilibrium: Equilibrium, loads: Loads | None = None) -> Figure:
    """Body, tendons and loads on the left, with the tension as colour; tension over arc length on the right.

    In space the curvature over arc length stands there too, and three plane views below.

    Args:
        manipulator, equilibrium, loads: as in `draw_shape`.

    Raises:
        InputError: when the solve failed and there is no shape to draw.
    """
    if equilibrium.tip_frame is not None:
        return _spatial_figure(manipulator, equilibrium, loads)
    with draw.house_style():
        figure = draw.new_figure(draw.DOUBLE_COLUMN, HEIGHT)
        shape, tension = figure.subplots(1, 2, width_ratios=(1.5, 1))
        draw_shape(manipulator, equilibrium, loads, shape)
        draw_along(manipulator, equilibrium, "tension", tension)
        figure.set_figheight(_fitting_height(shape, 3.6))
    return figure


def draw_shape(
    manipulator: Manipulator, equilibrium: Equilibrium, loads: Loads | None = None, axes: Axes | None = None
) -> Axes:
    """The bent body to scale, mm: wall, bore, clamp, and tendons coloured by their tension, N.

    The rest shape is dotted. Tendons end in a dot where they are anchored; several tendons are numbered. Arrows of
    loads at the tip all have the same length: the legend gives their magnitudes, and magnitude and direction of
    gravity. The colour scale is beside the axes.

    A body in space is drawn in three dimensions, with shadows on the walls. Tendons are dashed where the body hides
    them.

    Args:
        manipulator: the body that was solved.
        equilibrium: its equilibrium.
        loads: as given to `solve`; None for none.
        axes: where to draw, in space with projection="3d"; None for a new figure, one column wide.

    Raises:
        InputError: when the solve failed and there is no shape to draw, or for axes of the wrong kind.
    """
    s = geometry.stations(manipulator)
    along = geometry.fields_along(equilibrium, s)
    if isinstance(along, SpatialFields):
        return _draw_spatial_shape(geometry.drawn(manipulator, along, loads), axes)
    body, straight = geometry.bent_body(manipulator, along), geometry.straight_body(manipulator, s)
    tension = np.where(geometry.reached(manipulator, s), along.tension, np.nan)
    norm = space.tension_scale(tension)
    given, around = axes, 0.05 * 1e3 * s[-1]
    with draw.axes_or_new(axes, HEIGHT) as axes:
        axes.plot(*straight.outline.T, color=looks.GREY, linewidth=0.5, linestyle=(0, (1, 2)), zorder=0.5)
        draw.draw_clamp(axes, body.outer_radius[0] + around, around)
        draw.draw_body(axes, body)
        tendons = geometry.tendon_paths(manipulator, body, s)
        for path, own in zip(tendons, tension, strict=True):
            draw.draw_coloured_line(axes, path, own, norm)
            axes.plot(*path[np.isfinite(own)][-1], "o", color=looks.BLACK, markersize=2.3, zorder=5)
        if len(tendons) > 1:
            _number_tendons(axes, tendons[:, 0, 1], 1e3 * s[-1])
        _draw_loads(axes, body, Loads() if loads is None else loads, 1e3 * s[-1])
        draw.scale_beside(axes, norm, "$T$ (N)", pad=0.02)
        axes.set(xlabel="$X$ (mm)", ylabel="$Y$ (mm)")
        axes.margins(0.08)
        draw.to_scale(axes)
        if given is None:
            draw.figure_of(axes).set_figheight(_fitting_height(axes, 2.6))
    return axes


def draw_view(
    manipulator: Manipulator,
    equilibrium: Equilibrium,
    plane: str = "XY",
    loads: Loads | None = None,
    axes: Axes | None = None,
) -> Axes:
    """A body in space as it is seen along an axis, mm, to scale; else as `draw_shape` draws it.

    Args:
        manipulator, equilibrium, loads: as in `draw_shape`, in space.
        plane: "XY" from above, "XZ" from the side, or "YZ" from the tip towards the base.
        axes: where to draw; None for a new figure, one column wide.

    Raises:
        InputError: for another plane, a body in the plane, or when the solve failed.
    """
    if plane not in space.VIEWS:
        raise InputError(f"draw_view: plane must be one of {', '.join(space.VIEWS)}, got {plane!r}")
    what = _drawn("draw_view", manipulator, equilibrium, loads)
    norm, given = space.tension_scale(what.tension), axes
    with draw.axes_or_new(axes, HEIGHT) as axes:
        space.draw_in_plane(axes, what, norm, plane)
        draw.scale_beside(axes, norm, "$T$ (N)")
        entries = space.legend_of_loads(what.loads)
        if entries:
            look = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "columnspacing": 0.8, "handlelength": 1.2}
            axes.legend(handles=entries, ncols=2, **look)
        if given is None:
            draw.figure_of(axes).set_figheight(_fitting_height(axes, 2.4) + 0.17 * len(entries))
    return axes


def views_figure(manipulator: Manipulator, equilibrium: Equilibrium, loads: Loads | None = None) -> Figure:
    """A body in space in three plane views to one scale, with one scale of tensions.

    Args:
        manipulator, equilibrium, loads: as in `draw_shape`, in space.

    Raises:
        InputError: for a body in the plane, or when the solve failed.
    """
    what = _drawn("views_figure", manipulator, equilibrium, loads)
    norm = space.tension_scale(what.tension)
    with draw.house_style():
        height = max(space.height_of_views(what.points, VIEWS_WIDTH), 1.3)
        figure = draw.placed_figure(draw.DOUBLE_COLUMN, height + 0.25)
        _draw_views(figure, what, norm)
        draw.colour_scale(figure, norm, "$T$ (N)", draw.DOUBLE_COLUMN - 0.52, 0.45, height - 0.6)
        _legend_of_loads(figure, what.loads)
    return figure


def _draw_views(figure: Figure, what: Drawn, norm: Normalize) -> None:
    space.draw_views(figure, lambda axes, plane: space.draw_in_plane(axes, what, norm, plane), what.points, VIEWS_WIDTH)


def _drawn(who: str, manipulator: Manipulator, equilibrium: Equilibrium, loads: Loads | None) -> Drawn:
    return geometry.drawn(manipulator, geometry.fields_along(equilibrium, geometry.stations(manipulator)), loads, who)


def _draw_spatial_shape(what: Drawn, axes: Axes | None) -> Axes:
    norm = space.tension_scale(what.tension)
    with space.scene_or_new(axes, what.points, 2.2, 2.15) as scene:
        space.draw_scene(scene, what, norm)
        space.scale_of_scene(scene, norm, "$T$ (N)", given=axes is not None)
        if axes is None:
            _legend_of_loads(draw.figure_of(scene), what.loads)
    return scene


def _spatial_figure(manipulator: Manipulator, equilibrium: Equilibrium, loads: Loads | None) -> Figure:
    """The body in three dimensions, tension and curvature beside it, three plane views below."""
    what = _drawn("equilibrium_figure", manipulator, equilibrium, loads)
    norm = space.tension_scale(what.tension)
    with draw.house_style():
        below = space.height_of_views(what.points, VIEWS_WIDTH) + 0.1
        rows = -(-manipulator.num_tendons // 3)  # of the legend
        figure = draw.placed_figure(draw.DOUBLE_COLUMN, below + 3.2 + 0.16 * rows)
        scene, _ = space.new_scene(figure, what.points, 0.1, below + 0.45, 3.0, 2.4)
        space.draw_scene(scene, what, norm)
        for quantity, bottom in (("tension", 1.95), ("curvature", 0.45)):
            panel = draw.place_in(figure, 4.6, below + bottom, 2.45, 1.1)
            draw_along(manipulator, equilibrium, quantity, panel)
            if quantity == "tension":
                panel.set_xlabel("")
        _draw_views(figure, what, norm)
        draw.colour_scale(figure, norm, "$T$ (N)", 3.72, below + 0.9, 1.6)
        _legend_of_loads(figure, what.loads)
    return figure


def _legend_of_loads(figure: Figure, loads: Loads) -> None:
    if entries := space.legend_of_loads(loads):
        figure.legend(handles=entries, loc="upper left", ncols=3, columnspacing=1.2, handletextpad=0.3)


def _fitting_height(axes: Axes, width: float) -> float:
    """The height of a figure, inches, in which the axes of the body have this width."""
    across, up = axes.dataLim.size
    return float(np.clip(width * up / across + 0.7, 2.4, 4.2))


def _number_tendons(axes: Axes, heights: np.ndarray, length: float) -> None:
    """The number of each tendon in front of the base; neighbours that are too close have one label."""
    order = np.argsort(-heights, kind="stable")
    groups = np.split(order, np.flatnonzero(-np.diff(heights[order]) > 0.04 * length) + 1)  # about a line of text
    for group in groups:
        at = (-0.06 * length, float(np.mean(heights[group])))
        axes.annotate(", ".join(str(i + 1) for i in sorted(group)), at, ha="right", va="center", fontsize=7.5)


def _draw_loads(axes: Axes, body: Body, loads: Loads, length: float) -> None:
    """Arrows of tip force and tip moment; the legend gives magnitudes, and the direction of gravity."""
    force, gravity = np.asarray(loads.tip_force), np.asarray(loads.gravity)
    size, moment = np.linalg.norm(force), float(loads.tip_moment)
    turn = r"$\curvearrowleft$" if moment > 0 else r"$\curvearrowright$"
    entries = []
    if np.any(force):
        _draw_arrow(axes, geometry.tip_force_line(body, loads, length), looks.VERMILION)
        entries.append((f"$F$ = {size:.3g} N", _arrow_along(force), looks.VERMILION))
    if moment:
        _draw_arrow(axes, geometry.tip_moment_line(body, loads, length), looks.PURPLE)
        entries.append((f"$m$ = {abs(moment):.3g} N m", MarkerStyle(turn), looks.PURPLE))
    if np.any(gravity):
        entries.append((f"$g$ = {np.linalg.norm(gravity):.3g} m/s$^2$", _arrow_along(gravity), looks.BLACK))
    for label, marker, color in entries:
        axes.plot([], [], marker=marker, color=color, linestyle="none", markersize=11, label=label)
    if entries:
        axes.legend(loc="best")


def _draw_arrow(axes: Axes, points: np.ndarray, color: str) -> None:
    """An arrow along a line of points, (points, 2), with its head at the last."""
    axes.update_datalim(points)
    look = {"arrowstyle": "-|>", "mutation_scale": 8, "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0, "zorder": 6}
    axes.add_patch(FancyArrowPatch(path=Path(points), color=color, fill=True, **look))


def _arrow_along(vector: np.ndarray) -> MarkerStyle:
    return MarkerStyle(r"$\rightarrow$").rotated(rad=float(np.arctan2(vector[1], vector[0])))


def draw_force_arrows(manipulator: Manipulator, equilibrium: Equilibrium, axes: Axes | None = None) -> Axes:
    """The bent body to scale, mm, with the normal and friction force of its tendons per length as arrows.

    Both have the same scale, given beside the arrows in the corner. The force at the anchor of a tendon is not drawn.
    In space the legend gives the largest of each.

    Args:
        manipulator: the body that was solved.
        equilibrium: its equilibrium.
        axes: where to draw; None for a new figure, one column wide.

    Raises:
        InputError: when the solve failed.
    """
    if equilibrium.tip_frame is not None:
        return _draw_spatial_forces(manipulator, equilibrium, axes)
    length = float(manipulator.length)
    s, at = _with_arrows(manipulator, np.linspace(0.0, length, 201))
    along, there = geometry.planar_fields_along(equilibrium, s), geometry.reached(manipulator, s)
    forces, body = np.stack([along.normal_force, along.friction_force]), geometry.bent_body(manipulator, along)
    tendons = geometry.tendon_paths(manipulator, body, s)
    strongest = float(np.max(np.linalg.norm(forces[:, there], axis=-1)))
    with draw.axes_or_new(axes, HEIGHT) as axes:
        draw.draw_body(axes, body)
        for path in tendons:
            axes.plot(*path.T, color=looks.BLACK, linewidth=0.5)
        heights = (0.13, 0.05) if axes.dataLim.y0 + axes.dataLim.y1 < 0 else (0.95, 0.87)
        look: looks.Look = {"angles": "xy", "scale_units": "xy", "units": "inches", "width": 0.011, "zorder": 3}
        kinds = zip(("normal", "friction"), (looks.BLUE, looks.VERMILION), forces[:, at], heights, strict=True)
        for name, color, force, height in kinds if strongest > 0 else ():
            size, key = 1e3 * LONGEST * length / strongest, round_number(strongest)  # mm per N/m; N/m of the key
            axes.update_datalim(tendons[at] + size * force)
            arrows = axes.quiver(*tendons[at].T, *force.T, scale=1 / size, color=color, **look)
            axes.quiverkey(arrows, 0.17, height, key, f"{name} force, {key:g} N/m", labelpos="E", color=color)
        axes.set(xlabel="$X$ (mm)", ylabel="$Y$ (mm)")
        draw.to_scale(axes)
    return axes


def _with_arrows(manipulator: Manipulator, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A grid of arc lengths with the places of arrows, and where each tendon has an arrow, (tendons, points)."""
    places = float(manipulator.length) * (np.arange(ARROWS) + 0.45) / ARROWS
    s = np.unique(np.concatenate([grid, places]))
    return s, geometry.reached(manipulator, s) & np.isin(s, places)


def _draw_spatial_forces(manipulator: Manipulator, equilibrium: Equilibrium, axes: Axes | None) -> Axes:
    s, at = _with_arrows(manipulator, geometry.stations(manipulator))
    along = geometry.fields_along(equilibrium, s)
    what, forces = geometry.drawn(manipulator, along, None), np.stack([along.normal_force, along.friction_force])[:, at]
    strongest = float(np.max(np.linalg.norm(forces, axis=-1), initial=0.0))
    arrows = forces * (LONGEST * what.length / (strongest or 1.0))
    points = np.concatenate([what.points, *(what.tendons[at] + arrows)])
    with space.scene_or_new(axes, points, 2.6, 2.4) as scene:
        space.draw_solid(scene, what)
        for path in what.tendons:
            scene.plot(*path.T, color=looks.BLACK, linewidth=0.5, zorder=5)
        kinds = zip(("normal", "friction"), (looks.BLUE, looks.VERMILION), forces, arrows, strict=True)
        for name, color, force, arrow in kinds:
            most = np.max(np.linalg.norm(force, axis=-1), initial=0.0)
            look = {"color": color, "linewidth": 0.9, "arrow_length_ratio": 0.25, "zorder": 6}
            scene.quiver(*what.tendons[at].T, *arrow.T, label=f"{name} force, at most {most:.3g} N/m", **look)
        if axes is None:
            entries = scene.get_legend_handles_labels()
            draw.figure_of(scene).legend(*entries, loc="upper left", ncols=2, columnspacing=1.2)
        else:
            scene.legend(loc="upper left")
    return scene
