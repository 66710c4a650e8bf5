"""The bent body to scale, mm: tendons coloured by tension with loads as arrows, or the forces of the tendons."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ..mechanics.fields import in_the_plane
from ..robot.loads import Loads
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import Equilibrium
from ..units import round_number
from . import looks, space, style as draw
from .along import draw_along
from .geometry import Drawn, bent_body, drawn, fields_along, reached

HEIGHT = 2.4  # inches, of a figure as wide as a column
ARROWS = 10  # for each tendon
LONGEST = 1 / 7  # of the body's length


def equilibrium_figure(manipulator: Manipulator, equilibrium: Equilibrium, loads: Loads | None = None) -> Figure:
    """Body, tendons and loads on the left, with the tension as colour; tension over arc length on the right.

    In space the curvature over arc length stands there too.

    Args:
        manipulator, equilibrium, loads: as in `draw_shape`.

    Raises:
        InputError: when the solve failed and there is no shape to draw.
    """
    what = bent_body(manipulator, equilibrium, loads)
    with draw.house_style():
        if what.in_space:
            figure = draw.new_figure(draw.DOUBLE_COLUMN, 3.4)
            grid = figure.add_gridspec(2, 2, width_ratios=(1.4, 1))
            draw_bent(what, figure.add_subplot(grid[:, 0], projection="3d"))
            tension, curvature = (figure.add_subplot(grid[row, 1]) for row in (0, 1))
            draw_along(manipulator, equilibrium, "curvature", curvature)
        else:
            figure = draw.new_figure(draw.DOUBLE_COLUMN, HEIGHT)
            shape, tension = figure.subplots(1, 2, width_ratios=(1.5, 1))
            draw_bent(what, shape)
            figure.set_figheight(_fitting_height(shape, 3.6))
        draw_along(manipulator, equilibrium, "tension", tension)
    return figure


def draw_shape(
    manipulator: Manipulator, equilibrium: Equilibrium, loads: Loads | None = None, axes: Axes | None = None
) -> Axes:
    """The bent body to scale, mm: wall, bore, clamp, and tendons coloured by their tension, N.

    The rest shape is dotted. Tendons end in a dot where they are anchored; several tendons are numbered. Arrows of
    loads at the tip all have the same length: the legend gives their magnitudes, and the components of gravity. The
    colour scale is beside the axes.

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
    return draw_bent(bent_body(manipulator, equilibrium, loads), axes)


def draw_bent(what: Drawn, axes: Axes | None = None, before: Drawn | None = None) -> Axes:
    """What `draw_shape` draws; of a bent body `before` it the outline is dashed, in space the axis."""
    given = axes
    with draw.axes_or_new(axes, space.HEIGHT if what.in_space else HEIGHT, in_space=what.in_space) as axes:
        line = np.zeros((0, 3)) if before is None else before.body.midline if what.in_space else before.body.outline
        space.draw_scene(axes, what, line) if what.in_space else _draw_section(axes, what)
        if before is not None:
            axes.plot(*line.T, color=looks.GREY, linewidth=0.8, linestyle=(0, (4, 2)), zorder=8, label="before")
        draw.legend_of_loads(axes, what)
        draw.scale_beside(axes, draw.tension_scale(what.tension), "$T$ (N)")
        if given is None and not what.in_space:
            draw.figure_of(axes).set_figheight(_fitting_height(axes, 2.6))
    return axes


def _draw_section(axes: Axes, what: Drawn) -> None:
    """A body in the plane, cut open, with its clamp, tendons and loads; the rest shape is dotted."""
    axes.plot(*what.straight.outline.T, color=looks.GREY, linewidth=0.5, linestyle=(0, (1, 2)), zorder=0.5)
    depth = 0.05 * what.length
    half = what.body.outer_radius[0] + depth
    clamp = {"facecolor": "white", "edgecolor": looks.GREY, "hatch": "///////", "linewidth": 0.0, "zorder": 0}
    axes.add_patch(Rectangle((-depth, -half), depth, 2 * half, **clamp))
    axes.plot([0.0, 0.0], [-half, half], color=looks.BLACK, linewidth=1.0, zorder=3)
    draw.draw_wall(axes, what.body)
    draw.draw_tendons(axes, what, [0, 1])
    if len(what.tendons) > 1:
        _number_tendons(axes, what.tendons[:, 0, 1], what.length)
    draw.draw_loads(axes, what, [0, 1])
    axes.margins(0.08)
    draw.to_scale(axes)


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


def draw_force_arrows(manipulator: Manipulator, equilibrium: Equilibrium, axes: Axes | None = None) -> Axes:
    """The bent body to scale, mm, with the normal and friction force of its tendons per length as arrows.

    Both have the same scale, given beside the arrows in the corner. The force at the anchor of a tendon is not drawn.

    Args:
        manipulator: the body that was solved, in the plane.
        equilibrium: its equilibrium.
        axes: where to draw; None for a new figure, one column wide.

    Raises:
        InputError: for a body in space, or when the solve failed.
    """
    length = float(manipulator.length)
    places = length * (np.arange(ARROWS) + 0.45) / ARROWS
    s = np.unique(np.concatenate([np.linspace(0.0, length, 201), places]))
    along = in_the_plane(fields_along(equilibrium, s), "figures")
    what, there = drawn(manipulator, along), reached(manipulator, s)
    tendons, at = what.tendons[..., :2], there & np.isin(s, places)  # where each tendon has an arrow
    forces = np.stack([along.normal_force, along.friction_force])
    strongest = float(np.max(np.linalg.norm(forces[:, there], axis=-1)))
    with draw.axes_or_new(axes, HEIGHT) as axes:
        draw.draw_wall(axes, what.body)
        for path in tendons:
            axes.plot(*path.T, color=looks.BLACK, linewidth=0.5)
        heights = (0.13, 0.05) if axes.dataLim.y0 + axes.dataLim.y1 < 0 else (0.95, 0.87)
        look: looks.Look = {"angles": "xy", "scale_units": "xy", "units": "inches", "width": 0.011, "zorder": 3}
        kinds = zip(("normal", "friction"), (looks.BLUE, looks.VERMILION), forces[:, at], heights, strict=True)
        for name, color, force, height in kinds if strongest > 0 else ():
            size, key = LONGEST * what.length / strongest, round_number(strongest)  # mm per N/m; N/m of the key
            axes.update_datalim(tendons[at] + size * force)
            arrows = axes.quiver(*tendons[at].T, *force.T, scale=1 / size, color=color, **look)
            axes.quiverkey(arrows, 0.17, height, key, f"{name} force, {key:g} N/m", labelpos="E", color=color)
        draw.to_scale(axes)
    return axes
