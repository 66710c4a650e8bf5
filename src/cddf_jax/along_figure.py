"""What an equilibrium holds along the body, over arc length."""

from collections.abc import Callable
from itertools import cycle
from typing import Any

import jax
import numpy as np
from matplotlib.axes import Axes

from . import plotting as draw
from .equilibrium import Equilibrium, Fields, fields_on
from .errors import InputError
from .manipulator import Manipulator

MARKERS = ("", "o", "s", "^", "D", "v", "x")  # one for each round through the dash patterns
HEIGHT = 2.2  # inches


def _size(vectors: Any) -> np.ndarray:
    return np.linalg.norm(vectors, axis=-1)


def _strain(manipulator: Manipulator, along: Fields) -> np.ndarray:
    """Of the outer wall, per cent."""
    return 100 * np.abs(manipulator.outer_strain(along.arc_length, along.curvature))


# label with its unit, and values in that unit, (points,) or (tendons, points)
QUANTITIES: dict[str, tuple[str, Callable[[Manipulator, Fields], Any]]] = {
    "tension": ("Tension $T$ (N)", lambda _, along: along.tension),
    "curvature": (r"Curvature $\kappa$ (1/m)", lambda _, along: along.curvature),
    "normal_force": (r"Normal force $|F_\mathrm{CDDN}|$ (N/m)", lambda _, along: _size(along.normal_force)),
    "friction_force": (r"Friction force $|F_\mathrm{CDDF}|$ (N/m)", lambda _, along: _size(along.friction_force)),
    "strain": (r"Strain $R|\kappa|$ (%)", _strain),
    "heading": (r"Heading $\phi$ (deg)", lambda _, along: np.degrees(along.heading)),
}


def draw_along(
    manipulator: Manipulator, equilibrium: Equilibrium, quantity: str, axes: Axes | None = None, **style: Any
) -> Axes:
    """A quantity over arc length, mm, one line for each tendon where each has its own.

    Lines of tendons end where these are anchored, are told apart by dashes and markers, and have their numbers at
    their ends.

    Args:
        manipulator: the body that was solved.
        equilibrium: its equilibrium.
        quantity: "tension" (N); "curvature" (1/m); "normal_force" or "friction_force", the size of the force of a
            tendon on the body per length (N/m); "strain", the greatest of a cross-section that bends (%); "heading"
            (deg).
        axes: where to draw; None for a new figure, one column wide.
        style: of the lines, as `Axes.plot` takes it: color, label, ...

    Raises:
        InputError: for another quantity, or when the solve failed.
    """
    if quantity not in QUANTITIES:
        raise InputError(f"draw_along: quantity must be one of {', '.join(QUANTITIES)}, got {quantity!r}")
    label, values_of = QUANTITIES[quantity]
    s = stations(manipulator)
    values = np.asarray(values_of(manipulator, fields_along(equilibrium, s)))
    with draw.axes_or_new(axes, HEIGHT) as axes:
        if values.ndim == 1:
            look: dict[str, Any] = {"color": draw.BLACK} | style
            axes.plot(1e3 * s, values, **look)
        else:
            _draw_tendons(axes, 1e3 * s, np.where(reached(manipulator, s), values, np.nan), style)
        axes.set(xlabel="Arc length $s$ (mm)", ylabel=label)
        axes.set_xlim(0.0, 1e3 * s[-1] * (1.06 if values.ndim > 1 and len(values) > 1 else 1.0))
        draw.include_zero(axes)
    return axes


def stations(manipulator: Manipulator) -> np.ndarray:
    """Arc lengths, m: a grid, the joints of the body and the ends of tendons, and a point just behind each."""
    length = float(manipulator.length)
    joints = np.asarray(manipulator.breakpoints, float)
    joints = joints[(joints > 0) & (joints < length)]
    return np.unique(np.concatenate([np.linspace(0.0, length, 201), joints, joints + 1e-9 * length]))


def fields_along(equilibrium: Equilibrium, arc_length: np.ndarray) -> Fields:
    """The fields at some arc lengths as NumPy arrays.

    Raises:
        InputError: when the solve failed.
    """
    fields = jax.tree.map(np.asarray, fields_on(equilibrium, arc_length))
    if not np.all(np.isfinite(fields.position)):
        raise InputError("the solve failed, there is no shape to draw; see its result")
    return fields


def reached(manipulator: Manipulator, arc_length: np.ndarray) -> np.ndarray:
    """Which arc lengths each tendon reaches, (tendons, points)."""
    ends = [np.inf if tendon.end is None else float(tendon.end) for tendon in manipulator.tendons]
    return arc_length <= np.asarray(ends)[:, None]


def _draw_tendons(axes: Axes, s: np.ndarray, values: np.ndarray, style: dict[str, Any]) -> None:
    """One line per tendon, told apart by dashes, when these are used up by markers, and by numbers at their ends."""
    count, dashes = len(values), cycle([look["linestyle"] for look in draw.CURVES])
    for i, (line, dash) in enumerate(zip(values, dashes, strict=False)):
        marker = MARKERS[i // len(draw.CURVES) % len(MARKERS)]
        look: dict[str, Any] = {"color": draw.BLACK, "linestyle": dash, "marker": marker, "markevery": 25}
        look |= {"markerfacecolor": "white", "label": f"tendon {i + 1}" if count > 1 else ""}
        axes.plot(s, line, **(look | style))
        if count > 1:
            last = np.flatnonzero(np.isfinite(line))[-1]
            box = {"facecolor": "white", "edgecolor": "none", "pad": 0.4}
            at = (s[last], line[last])
            axes.annotate(str(i + 1), at, (3, 0), textcoords="offset points", va="center", fontsize=7.5, bbox=box)
    if count > 1:
        draw.legend_above(axes, 3)
