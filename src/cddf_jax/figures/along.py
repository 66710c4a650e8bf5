"""Lines over arc length: the fields of an equilibrium, or those after some steps of a history."""

from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import ArrayLike
from matplotlib.axes import Axes

from ..errors import InputError
from ..history.history import History
from ..numerics.arrays import evaluated
from ..quantities import QUANTITIES
from ..robot.manipulator import Manipulator
from ..statics.equilibrium import Equilibrium
from . import looks, style as draw
from .geometry import BENDING, fields_along, lines_along, stations

MARKERS = ("", "o", "s", "^", "D", "v", "x")  # one for each round through the dash patterns
HEIGHT = 2.2  # inches
STEPS_DRAWN = len(looks.CURVES)  # at most
NUMBERED = 10  # steps that are all numbered
SAME = 1e-8  # of the range of a quantity: points and lines that differ by less are drawn as one


def draw_along(
    manipulator: Manipulator,
    bent: Equilibrium | History,
    quantity: str,
    axes: Axes | None = None,
    *,
    steps: Sequence[int] | None = None,
    tendon: int = 0,
    **style: looks.LookValue,
) -> Axes:
    """A quantity over arc length, mm. Lines differ by dashes, and where these are used up by markers.

    Of an equilibrium there is one line for each tendon where each has its own, which ends where the tendon is anchored.

    Of a history there is one line for each of some steps, at most the last six. A dot marks the front: up to it the
    tendon slid last, and beyond it the tendon rests. Without a dot all of it slid. Steps with the same line have one
    together, and steps before the first tension have none.

    Args:
        manipulator: the body that was solved.
        bent: its equilibrium, or its history.
        quantity: "tension" (N); "curvature" (1/m), in space three lines: twist, and bending about y and about z;
            "bending" (1/m), the size of the curvature without twist; "twist" (1/m), zero in the plane;
            "normal_force" or "friction_force", the size of the force of a tendon on the body per length (N/m);
            "strain", the greatest of a cross-section that bends (%); "heading" (deg), in space the angle between the
            axes of cross-section and base; "outer_radius" (mm); "offset" (mm) or "angle" (deg) of the tendons.
        axes: where to draw; None for a new figure, one column wide.
        steps: which steps of a history, from 0, have the numbers 1, 2, ...; those where it turns unless given. Of more
            than ten only the turns are numbered.
        tendon: whose tensions and fronts are drawn of a history, from 0.
        style: of the lines, as `Axes.plot` takes it: color, label, ...

    Raises:
        InputError: for another quantity, or when the solve or a step failed.
    """
    s, fronts = stations(manipulator), {}
    if isinstance(bent, History):
        lines, fronts = _after_steps(manipulator, bent, quantity, s, numbered_steps(bent, steps, tendon), tendon)
    else:
        found = lines_along(manipulator, fields_along(bent, s), quantity)
        names = BENDING if quantity == "curvature" else [f"tendon {i + 1}" for i in range(len(found))]
        lines = dict(zip(names, found, strict=False)) if len(found) > 1 else {"": found[0]}
    with draw.axes_or_new(axes, HEIGHT) as axes:
        for i, (name, line) in enumerate(lines.items()):
            row, place = divmod(i, len(looks.CURVES))
            look: looks.Look = {"marker": MARKERS[row % len(MARKERS)], "markevery": 25, "markerfacecolor": "white"}
            look = looks.CURVES[place] | look | {"label": name} | style
            axes.plot(1e3 * s, line, **look)
            if (front := fronts.get(name, np.inf)) < s[-1]:
                dot: looks.Look = {"color": look["color"], "markeredgecolor": looks.BLACK}
                axes.plot(1e3 * front, np.interp(front, s, line), "o", **dot)
        if any(front < s[-1] for front in fronts.values()):
            axes.plot([], [], "o", color="white", markeredgecolor=looks.BLACK, label="front")
        axes.set(xlabel=QUANTITIES["arc_length"].axis_label, ylabel=QUANTITIES[quantity].axis_label)
        axes.set_xlim(0.0, 1e3 * s[-1])
        if quantity != "angle":  # whose zero means nothing
            axes.update_datalim([(0.0, 0.0)])
            if np.nanmin(np.abs([*lines.values()])) > 0:  # a line at zero is not drawn on the axis
                axes.lines[0].sticky_edges.y.append(0.0)
            axes.autoscale_view()
        if "label" not in style:
            draw.legend_above(axes, 3)
    return axes


# --- steps of a history ----------------------------------------------------------------------------


def _after_steps(
    manipulator: Manipulator, history: History, quantity: str, s: np.ndarray, steps: dict[int, int], tendon: int
) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """The lines of one tendon after some steps, of which equal ones are one, and the fronts, m, both by label."""
    fields = evaluated(History.at, history, s)
    tension, fronts = tendon_values(history.base_tension, tendon), tendon_values(history.front, tendon)
    lines: dict[int, np.ndarray] = {}
    for number, step in steps.items():
        if np.any(tension[: step + 1]):
            own = lines_along(manipulator, jax.tree.map(lambda x, step=step: x[step], fields), quantity)
            if quantity == "curvature" and len(own) > 1:
                raise InputError('figures: curvature in space has three parts; of a history draw "bending" or "twist"')
            lines[number] = own[tendon if len(own) > 1 else 0]
    labels: dict[str, int] = {}  # the first number of each line
    for numbers in grouped_alike(lines)[-STEPS_DRAWN:]:
        labels[f"{', '.join(map(str, numbers))}: {tension[steps[numbers[0]]]:.4g} N"] = numbers[0]
    return {x: lines[n] for x, n in labels.items()}, {x: float(fronts[steps[n]]) for x, n in labels.items()}


def numbered_steps(history: History, steps: Sequence[int] | None, tendon: int) -> dict[int, int]:
    """By their numbers 1, 2, ... the steps that are given, or if these are many only turns; or else all turns."""
    if not np.all(np.isfinite(np.asarray(history.tip_angle))):
        raise InputError("a step of the trace failed, there is no history to draw; see its status")
    turns = draw.turning_places(tendon_values(history.base_tension, tendon))
    numbered = turns if steps is None else [*map(int, steps)]
    return {n: step for n, step in enumerate(numbered, 1) if len(numbered) <= NUMBERED or step in turns}


def tendon_values(values: ArrayLike, tendon: int) -> np.ndarray:
    """The values of one tendon after each step; values that all tendons have in common stay as they are."""
    array = np.asarray(values)
    return array if array.ndim == 1 else array[:, tendon]


def grouped_alike(lines: dict[int, np.ndarray]) -> list[list[int]]:
    """The numbers of lines or points, grouped by equal ones; groups are in the order of their last number."""
    groups: list[list[int]] = []
    for number, line in lines.items():
        near = {"rtol": 0.0, "atol": SAME * np.nanmax(np.abs(line)), "equal_nan": True}
        same = next((group for group in groups if np.allclose(line, lines[group[0]], **near)), [])
        groups = [*(group for group in groups if group is not same), [*same, number]]
    return groups
