"""The figure of one equilibrium: the bent body to scale, and the tension along each tendon."""

import numpy as np
from matplotlib.figure import Figure

from . import plotting as draw
from .equilibrium import Equilibrium
from .manipulator import Manipulator


def equilibrium_figure(manipulator: Manipulator, equilibrium: Equilibrium, loads=None) -> Figure:
    """Body with walls, tendons and midline on the left; tension over arc length on the right."""
    arc_length = np.linspace(0.0, float(manipulator.length), 201)
    along = equilibrium.at(arc_length)
    offset = np.asarray(manipulator.offset(arc_length))
    side = np.array([tendon.side for tendon in manipulator.tendons])[:, None]
    with draw.house_style():
        figure = draw.new_figure(draw.DOUBLE_COLUMN, 2.9)
        shape, tension = figure.subplots(1, 2)
        for distance in side * offset:
            lines = (
                along.position,
                along.heading,
                manipulator.outer_radius(arc_length),
                manipulator.inner_radius(arc_length),
            )
            position, heading, outer, inner = (np.asarray(line) for line in lines)
            draw.draw_body(shape, draw.Body(1e3 * position, heading, 1e3 * outer, 1e3 * inner, 1e3 * distance))
        shape.set(xlabel="$X$ (mm)", ylabel="$Y$ (mm)")
        for i, (values, style) in enumerate(zip(np.asarray(along.tension), draw.CURVES, strict=False), start=1):
            line = {key: style[key] for key in ("color", "linestyle")}
            tension.plot(1e3 * arc_length, values, label=f"tendon {i}", **line)
        tension.set(xlabel="Arc length $s$ (mm)", ylabel="Tension $T$ (N)")
        tension.set_ylim(bottom=0.0)
        tension.legend()
    return figure
