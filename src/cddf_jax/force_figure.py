"""The forces that tendons put on a bent body, as in Liu et al. (2020), Fig. 6."""

import numpy as np
from matplotlib.axes import Axes

from . import plotting as draw
from .along_figure import fields_along, reached
from .body_drawing import bent_body, tendon_paths
from .equilibrium import Equilibrium
from .manipulator import Manipulator

ARROWS = 10  # for each tendon
LONGEST = 1 / 7  # of the body's length
HEIGHT = 2.4  # inches


def draw_force_arrows(manipulator: Manipulator, equilibrium: Equilibrium, axes: Axes | None = None) -> Axes:
    """The bent body to scale, mm, with the normal and friction force of its tendons per length as arrows.

    Both have one scale, told beside the arrows in the corner. The force at which a tendon is anchored is not drawn.

    Args:
        manipulator: the body that was solved.
        equilibrium: its equilibrium.
        axes: where to draw; None for a new figure, one column wide.

    Raises:
        InputError: when the solve failed.
    """
    length = float(manipulator.length)
    places = length * (np.arange(ARROWS) + 0.45) / ARROWS
    s = np.unique(np.concatenate([np.linspace(0.0, length, 201), places]))
    fields, there = fields_along(equilibrium, s), reached(manipulator, s)
    body = bent_body(manipulator, fields)
    tendons = tendon_paths(manipulator, body, s)
    forces = [np.where(there[..., None], force, 0.0) for force in (fields.normal_force, fields.friction_force)]
    with draw.axes_or_new(axes, HEIGHT) as axes:
        draw.draw_body(axes, body)
        for path in tendons:
            axes.plot(*path.T, color=draw.BLACK, linewidth=0.5)
        at = np.searchsorted(s, places)
        points, vectors = tendons[:, at].reshape(-1, 2), [force[:, at].reshape(-1, 2) for force in forces]
        kept = np.all(np.isfinite(points), axis=-1)
        strongest = float(max(np.max(np.linalg.norm(force, axis=-1)) for force in forces))
        _draw_forces(axes, points[kept], [vector[kept] for vector in vectors], strongest, 1e3 * LONGEST * length)
        axes.set(xlabel="$X$ (mm)", ylabel="$Y$ (mm)")
        draw.to_scale(axes)
    return axes


def _draw_forces(axes: Axes, points: np.ndarray, forces: list[np.ndarray], strongest: float, longest: float) -> None:
    """Arrows of both kinds, the strongest `longest` mm long, and what an arrow stands for; none without any force."""
    if not strongest > 0:
        return
    key, below = draw.round_number(strongest), float(axes.dataLim.y0 + axes.dataLim.y1) < 0
    looks = (("normal", draw.BLUE), ("friction", draw.VERMILION))
    for (name, color), force, height in zip(looks, forces, (0.13, 0.05) if below else (0.95, 0.87), strict=True):
        arrows = draw.draw_arrows(axes, points, force, strongest / longest, color=color)
        label = f"{name} force, {key:g} N/m"
        axes.quiverkey(arrows, 0.17, height, key, label, labelpos="E", color=color)
