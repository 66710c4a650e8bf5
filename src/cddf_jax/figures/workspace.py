"""The workspace: where the tip goes in a sweep, as a cloud of dots coloured by a quantity."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.lines import Line2D

from ..errors import InputError
from ..statics.named_numbers import stem_and_tendon
from ..statics.status import Status
from ..sweeping.one_solve import RESULT
from . import looks, space, style as draw
from .sweeps import axis_label, in_label_units, results_in_words, spread, varying_numbers

if TYPE_CHECKING:
    import xarray

MOST = 20_000  # dots, spread over all solves


class Cloud(NamedTuple):
    """Tips and what colours them; failed solves are left out."""

    tips: np.ndarray  # mm, (solves, 3), at Z = 0 in the plane
    values: np.ndarray
    codes: np.ndarray  # of the results
    label: str
    lost: str  # which solves are left out, in words
    in_space: bool

    @property
    def norm(self) -> Normalize:
        return Normalize(self.values.min(), self.values.max())


def draw_workspace(dataset: "xarray.Dataset", by: str | None = None, axes: Axes | None = None) -> Axes:
    """Where the tip goes in a sweep, mm, a dot for each solve, coloured by a quantity; in space with shadows.

    Doubtful solves are hollow, and failed ones are left out; the legend says why. If there are more than 20,000 solves,
    20,000 of them are drawn, spread evenly.

    Args:
        dataset: of `sweep`, with the output tip_position.
        by: what colours the dots: the name of a number that varies or of an output with one number for each solve, such
            as "tip_angle", also of one that you add, as in dataset.assign(highest=dataset.tip_tension.max("tendon")).
            None for the sum of the base tensions where all of them vary, or else the first number that varies.
        axes: where to draw, of a body in space with projection="3d"; None for a new figure, one column wide.

    Raises:
        InputError: for a dataset without tips or without a successful solve, or a name that is not there.
    """
    cloud = _cloud(dataset, by)
    with draw.axes_or_new(axes, space.HEIGHT, in_space=cloud.in_space) as axes:
        _draw_cloud(axes, cloud)
    return axes


def _cloud(dataset: "xarray.Dataset", by: str | None) -> Cloud:
    """Tips and values, in the units of their labels."""
    if "tip_position" not in dataset.data_vars or RESULT not in dataset:
        raise InputError("workspace: there is no tip_position; ask the sweep for it, with outputs=('tip_position',)")
    dataset, name = _with_colour(dataset, by)
    swept = dataset[RESULT].dims
    if several := [str(dim) for dim, count in dataset[name].sizes.items() if dim not in swept and count > 1]:
        raise InputError(f"workspace: {name} has more than one number for each solve; choose one {several[0]}")
    given = dataset[["tip_position", name, RESULT]].load()
    shown, codes = in_label_units(given), given[RESULT].values.ravel()
    tips = shown["tip_position"].transpose(*swept, "component").values.reshape(len(codes), -1)
    values = shown[name].broadcast_like(given[RESULT]).transpose(*swept, ...).values.ravel()
    there = np.flatnonzero(np.all(np.isfinite(tips), axis=1) & np.isfinite(values))
    if not there.size:
        raise InputError("workspace: no solve gave a tip; see the results of the sweep")
    count = f"no number: {len(codes) - len(there):,} of {len(codes):,}"
    lost = ", ".join(filter(None, [count, results_in_words(np.delete(codes, there))]))
    some, components = there[spread(len(there), MOST)], tips.shape[1]
    places = np.pad(tips[some], ((0, 0), (0, 3 - components)))
    words = lost if len(there) < len(codes) else ""
    return Cloud(places, values[some], codes[some], axis_label(shown[name]), words, components == 3)


def _with_colour(dataset: "xarray.Dataset", by: str | None) -> "tuple[xarray.Dataset, str]":
    """The sweep, with the sum of its base tensions where it is asked for, and the name of what colours the dots."""
    numbers = varying_numbers(dataset)
    pulls = [dataset[name] for name in numbers if stem_and_tendon(name)[0] == "base_tension"]
    if by is None and pulls and len(pulls) == dataset.sizes.get("tendon"):
        by = "total_tension"
        dataset = dataset.assign({by: sum(pulls[1:], pulls[0]).assign_attrs(units="N")})
    by = numbers[0] if by is None and numbers else by or "tip_angle"
    if by not in dataset:
        there = ", ".join(map(str, (*dataset.data_vars, *dataset.coords)))
        raise InputError(f"workspace: {by!r} is neither an output nor a number that varies; there are {there}")
    return dataset, by


# --- drawing -------------------------------------------------------------------------------------


def _draw_cloud(axes: Axes, cloud: Cloud) -> None:
    """The whole cloud with its scale of colours and its legend: in the plane, or in space with shadows on the walls."""
    if not cloud.in_space:
        _draw_dots(axes, cloud, np.array([0.0, 0.0, 1.0]), [0, 1])
        axes.set(xlabel="$X$ (mm)", ylabel="$Y$ (mm)")
        draw.to_scale(axes)
    else:
        scene = space.set_scene(axes, cloud.tips)
        for across, wall in enumerate(space.walls_behind(scene)):
            flat = np.insert(np.delete(cloud.tips, across, axis=1), across, wall, axis=1)
            _scatter(scene, cloud, flat, color=looks.PALE, zorder=1)
        _draw_dots(scene, cloud, space.sight(), [0, 1, 2])
    draw.scale_beside(axes, cloud.norm, cloud.label)
    look: looks.Look = {"color": looks.BLACK, "marker": "o", "markerfacecolor": "white", "linestyle": "none"}
    doubtful, lost = results_in_words(cloud.codes), Line2D([], [], linestyle="none", label=cloud.lost)
    entries = [Line2D([], [], label=f"hollow: doubtful, {doubtful}", **look)] if doubtful else []
    if entries := [*entries, *([lost] if cloud.lost else [])]:
        axes.legend(handles=entries, loc="upper left")


def _draw_dots(axes: Axes, cloud: Cloud, sight: np.ndarray, shown: list[int]) -> None:
    """Dots in some of the three coordinates, the nearest on top, hollow where they are doubtful."""
    order = np.argsort(cloud.tips @ sight, kind="stable")
    tips, values, sure = cloud.tips[order][:, shown], cloud.values[order], cloud.codes[order] == Status.successful
    _scatter(axes, cloud, tips[sure], c=values[sure], cmap=draw.TENSION_COLOURS, norm=cloud.norm, zorder=3)
    edges = draw.TENSION_COLOURS(cloud.norm(values[~sure]))
    _scatter(axes, cloud, tips[~sure], facecolors="white", edgecolors=edges, linewidths=0.6, zorder=3.5)


def _scatter(axes: Axes, cloud: Cloud, points: np.ndarray, **look: looks.LookValue) -> None:
    """Some dots of a cloud, which are the smaller the more it has."""
    if points.shape[1] == 3:
        look["depthshade"] = False
    if len(points):
        area = np.clip(3600.0 / len(cloud.tips), 0.6, 12.0)
        axes.scatter(*points.T, s=area, rasterized=len(points) > 500, **({"linewidths": 0.0} | look))
