"""The workspace: where the tip goes in a sweep, as a cloud of dots coloured by a quantity."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..errors import InputError
from ..statics.named_numbers import stem_and_tendon
from ..statics.status import Status
from ..sweeping.one_solve import RESULT
from . import looks, space, style as draw
from .sweeps import axis_label, in_label_units, results_in_words

if TYPE_CHECKING:
    import xarray

MOST = 20_000  # dots, spread over all solves
TOTAL = "total_tension"


class Cloud(NamedTuple):
    """Tips and what colours them; failed solves are left out."""

    tips: np.ndarray  # mm, (solves, components)
    values: np.ndarray
    codes: np.ndarray  # of the results
    label: str
    left_out: list[str]  # in words

    @property
    def norm(self) -> Normalize:
        return Normalize(self.values.min(), self.values.max())

    @property
    def size(self) -> float:
        """The size of a dot, points."""
        return float(np.clip(60.0 / np.sqrt(len(self.tips)), 0.8, 3.5))


def draw_workspace(dataset: "xarray.Dataset", by: "str | xarray.DataArray" = TOTAL, axes: Axes | None = None) -> Axes:
    """Where the tip goes in a sweep, mm, a dot for each solve, coloured by a quantity; in space with shadows.

    Doubtful solves are hollow, and failed ones are left out; the legend says why. If there are more than 20,000 solves,
    20,000 of them are drawn, spread evenly.

    Args:
        dataset: of `sweep`, with the output tip_position.
        by: what colours the dots: "total_tension", the sum of the base tensions; the name of another number that varies
            or of an output with one number for each solve, such as "tip_angle"; or an array with one number for each
            solve, whose name and attribute "units" label the colour scale, such as (dataset.tip_tension.sum("tendon") /
            dataset.base_tension.sum("tendon")).rename("tension that arrives").assign_attrs(units="1").
        axes: where to draw, of a body in space with projection="3d"; None for a new figure, one column wide.

    Raises:
        InputError: for a dataset without tips or without a successful solve, or a name that is not there.
    """
    cloud = _cloud("draw_workspace", dataset, by)
    if cloud.tips.shape[1] == 2:
        with draw.axes_or_new(axes, 2.6) as axes:
            _draw_dots(axes, cloud, "XY")
            draw.to_scale(axes)
            draw.scale_beside(axes, cloud.norm, cloud.label, pad=0.02)
            _legend(axes, cloud)
        return axes
    with space.scene_or_new(axes, cloud.tips, cloud.norm, cloud.label) as scene:
        _draw_cloud(scene, cloud)
        _legend(draw.figure_of(scene) if axes is None else scene, cloud)
    return scene


def workspace_figure(dataset: "xarray.Dataset", by: "str | xarray.DataArray" = TOTAL) -> Figure:
    """Where the tip goes in a sweep: in space as a cloud in three dimensions, with three plane views to one scale.

    Args:
        dataset, by: as in `draw_workspace`.

    Raises:
        InputError: as `draw_workspace`.
    """
    cloud = _cloud("workspace_figure", dataset, by)
    if cloud.tips.shape[1] == 2:
        return draw.figure_of(draw_workspace(dataset, by))
    with draw.house_style():
        width, below = 5.9, space.VIEWS_HEIGHT + 0.15
        figure = draw.placed_figure(draw.DOUBLE_COLUMN, below + 3.3)
        scene, _ = space.new_scene(figure, cloud.tips, 1.3, below + 0.55, width - 2.0, 2.6)
        _draw_cloud(scene, cloud)
        draw.colour_scale(figure, cloud.norm, cloud.label, width, below + 0.8, 2.0)
        space.draw_views(figure, lambda axes, plane: _draw_dots(axes, cloud, plane), cloud.tips)
        _legend(figure, cloud)
    return figure


def _cloud(who: str, dataset: "xarray.Dataset", by: "str | xarray.DataArray") -> Cloud:
    """Tips and values, in the units of their labels."""
    if "tip_position" not in dataset.data_vars or RESULT not in dataset:
        raise InputError(f"{who}: there is no tip_position; ask the sweep for it, with outputs=('tip_position',)")
    array = _coloured_by(who, dataset, by)
    swept = dataset[RESULT].dims
    if several := [str(dim) for dim in array.dims if dim not in swept]:
        raise InputError(f"{who}: {array.name} has more than one number for each solve; choose one {several[0]}")
    name, given = str(array.name), dataset[["tip_position", RESULT]].load()
    shown = in_label_units(given.assign({name: array.load()}))
    codes = given[RESULT].values.ravel()
    tips = shown["tip_position"].transpose(*swept, "component").values.reshape(len(codes), -1)
    values = shown[name].broadcast_like(given[RESULT]).transpose(*swept).values.ravel()
    there = np.all(np.isfinite(tips), axis=1) & np.isfinite(values)
    if not np.any(there):
        raise InputError(f"{who}: no solve gave a tip; see the results of the sweep")
    count = f"no number: {np.sum(~there):,} of {len(codes):,}"
    lost = ", ".join(filter(None, [count, results_in_words(codes[~there])]))
    places = np.flatnonzero(there)
    some = places[np.unique(np.linspace(0, len(places) - 1, min(len(places), MOST)).round().astype(int))]
    words = [] if np.all(there) else [lost]
    return Cloud(tips[some], values[some], codes[some], axis_label(shown[name]), words)


def _coloured_by(who: str, dataset: "xarray.Dataset", by: "str | xarray.DataArray") -> "xarray.DataArray":
    """One number for each solve."""
    if not isinstance(by, str):
        return by if by.name else by.rename("colour")
    if by == TOTAL and TOTAL not in dataset:
        return _total_tension(who, dataset)
    if by not in dataset:
        there = ", ".join(map(str, (*dataset.data_vars, *dataset.coords)))
        raise InputError(f"{who}: {by!r} is neither an output nor a number that varies; there are {there}")
    return dataset[by].squeeze(drop=True) if by not in dataset.dims else dataset[by]


def _total_tension(who: str, dataset: "xarray.Dataset") -> "xarray.DataArray":
    """The sum of all base tensions, N."""
    count, remedy = dataset.sizes.get("tendon"), "ask the sweep for the output 'base_tension', or give by="
    parts = [dataset[name] for name in map(str, dataset.coords) if stem_and_tendon(name)[0] == "base_tension"]
    if "base_tension" in dataset.data_vars:
        total = dataset["base_tension"].sum("tendon", skipna=False)
    elif count is not None and len(parts) == 1 and parts[0].name == "base_tension":
        total = count * parts[0]
    elif parts and len(parts) == count:
        total = sum(parts[1:], parts[0])
    else:
        raise InputError(f"{who}: not every base tension is known here; {remedy}")
    return total.rename(TOTAL).assign_attrs(units="N")


# --- drawing -------------------------------------------------------------------------------------


def _draw_cloud(axes: space.Axes3D, cloud: Cloud) -> None:
    """Dots, the nearest on top, and their shadows on the walls."""
    walls = axes.get_xlim()[0], axes.get_ylim()[1], axes.get_zlim()[0]
    for across, wall in enumerate(walls):
        flat = cloud.tips.copy()
        flat[:, across] = wall
        _scatter(axes, flat, cloud.size, color=looks.PALE, zorder=1)
    order = np.argsort(cloud.tips @ space.sight(), kind="stable")
    _draw_coloured(axes, cloud.tips[order], cloud.values[order], cloud.codes[order], cloud)


def _draw_dots(axes: Axes, cloud: Cloud, plane: str) -> None:
    """The dots in a plane, the nearest on top."""
    right, up, _ = space.VIEWS[plane]
    order = np.argsort(cloud.tips @ np.array(space.TOWARDS[plane])[: cloud.tips.shape[1]], kind="stable")
    _draw_coloured(axes, cloud.tips[order][:, [right, up]], cloud.values[order], cloud.codes[order], cloud)
    axes.set(xlabel=f"${plane[0]}$ (mm)", ylabel=f"${plane[1]}$ (mm)")


def _draw_coloured(axes: Axes, tips: np.ndarray, values: np.ndarray, codes: np.ndarray, cloud: Cloud) -> None:
    """Dots, hollow where they are doubtful."""
    sure, look = codes == Status.successful, {"cmap": draw.TENSION_COLOURS, "norm": cloud.norm, "zorder": 3}
    _scatter(axes, tips[sure], cloud.size, c=values[sure], **look)
    if not np.all(sure):
        edges = draw.TENSION_COLOURS(cloud.norm(values[~sure]))
        _scatter(axes, tips[~sure], cloud.size, facecolors="white", edgecolors=edges, linewidths=0.6, zorder=3.5)


def _scatter(axes: Axes, points: np.ndarray, size: float, **look: looks.LookValue) -> None:
    if points.shape[1] == 3:
        look["depthshade"] = False
    axes.scatter(*points.T, s=size**2, rasterized=len(points) > 500, **({"linewidths": 0.0} | look))


def _legend(where: Axes | Figure, cloud: Cloud) -> None:
    """A legend for hollow dots and for solves that are not drawn."""
    entries = []
    if np.any(cloud.codes != Status.successful):
        look: looks.Look = {"marker": "o", "markerfacecolor": "white", "color": looks.BLACK, "linestyle": "none"}
        entries.append(Line2D([], [], label=f"hollow: doubtful, {results_in_words(cloud.codes)}", **look))
    entries += [Line2D([], [], linestyle="none", label=words) for words in cloud.left_out]
    if entries:
        where.legend(handles=entries, loc="upper left")
