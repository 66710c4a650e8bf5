"""Lines over arc length: the fields of an equilibrium."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from ..quantities import QUANTITIES
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import Equilibrium
from . import looks, style as draw
from .geometry import BENDING, fields_along, lines_along, stations

MARKERS = ("", "o", "s", "^", "D", "v", "x")  # one for each round through the dash patterns
HEIGHT = 2.2  # inches


def draw_along(
    manipulator: Manipulator,
    equilibrium: Equilibrium,
    quantity: str,
    axes: Axes | None = None,
    **style: looks.LookValue,
) -> Axes:
    """A quantity over arc length, mm, one line for each tendon where each has its own.

    The line of a tendon ends where the tendon is anchored, and has the number of the tendon there. Lines differ by
    dashes and markers.

    Args:
        manipulator: the body that was solved.
        equilibrium: its equilibrium.
        quantity: "tension" (N); "curvature" (1/m), in space three lines: twist, and bending about y and about z;
            "bending" (1/m), the size of the curvature without twist; "twist" (1/m), zero in the plane;
            "normal_force" or "friction_force", the size of the force of a tendon on the body per length (N/m);
            "strain", the greatest of a cross-section that bends (%); "heading" (deg), in space the angle between the
            axes of cross-section and base; "outer_radius" (mm); "offset" (mm) or "angle" (deg) of the tendons.
        axes: where to draw; None for a new figure, one column wide.
        style: of the lines, as `Axes.plot` takes it: color, label, ...

    Raises:
        InputError: for another quantity, or when the solve failed.
    """
    s = stations(manipulator)
    along = fields_along(equilibrium, s)
    lines = lines_along(manipulator, along, quantity)
    names = BENDING if quantity == "curvature" else [f"tendon {i + 1}" for i in range(len(lines))]
    with draw.axes_or_new(axes, HEIGHT) as axes:
        _draw_lines(axes, 1e3 * s, dict(zip(names, lines, strict=False)), style)
        axes.set(xlabel=QUANTITIES["arc_length"].axis_label, ylabel=QUANTITIES[quantity].axis_label)
        axes.set_xlim(0.0, 1e3 * s[-1] * (1.06 if len(lines) > 1 else 1.0))
        if quantity != "angle":  # whose zero means nothing
            axes.update_datalim([(0.0, 0.0)])
            axes.lines[-1].sticky_edges.y.append(0.0)
            axes.autoscale_view()
    return axes


def _draw_lines(axes: Axes, s: np.ndarray, lines: Mapping[str, np.ndarray], style: looks.Look) -> None:
    """Lines that differ by dashes, and where these are used up by markers; several lines have numbers at their ends."""
    ends: dict[tuple[float, float], list[str]] = {}
    for i, (name, line) in enumerate(lines.items()):
        row, place = divmod(i, len(looks.CURVES))
        dash, marker = looks.CURVES[place]["linestyle"], MARKERS[row % len(MARKERS)]
        look: looks.Look = {"color": looks.BLACK, "linestyle": dash, "marker": marker, "markevery": 25}
        look |= {"markerfacecolor": "white", "label": name if len(lines) > 1 else ""}
        axes.plot(s, line, **(look | style))
        last = np.flatnonzero(np.isfinite(line))[-1]
        ends.setdefault((float(s[last]), round(float(line[last]), 3)), []).append(name.split()[-1])
    if len(lines) > 1:
        box = {"facecolor": "white", "edgecolor": "none", "pad": 0.4}
        for end, numbers in ends.items():
            place = {"textcoords": "offset points", "va": "center", "fontsize": 7.5, "bbox": box}
            axes.annotate(", ".join(numbers), end, (3, 0), **place)
        if "label" not in style:
            draw.legend_above(axes, 3)
