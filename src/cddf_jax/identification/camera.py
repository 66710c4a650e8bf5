"""The frame in which a camera sees tip and markers: where the search for its pose starts, and when it must be wrong."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..estimation.least_squares import LeastSquaresFit
from ..estimation.remarks import UNEXPLAINED
from ..measurements.markers import registered
from ..robot.manipulator import Manipulator
from .bench import Bench, BenchModel, Group
from .parameters import CAMERA, camera_parameters, stiffness_parameter

FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)  # of the stiffness at the start, for which the pose is found
LEAST_POINTS = 3  # to find a pose
SPARE = 0.1  # of a length: it may be measured badly, and what is tracked may sit beyond the tip
STRETCHED = 2.0  # times the length, which a body that stretches does not reach


class Tracked(NamedTuple):
    """The tip, or a marker, in one table."""

    what: str  # "the tip" or "the marker head"
    reach: float  # m, its largest distance from the base along the body
    axes: dict[str, Group]  # by "x", "y", "z": the readings


def _points(groups: Sequence[Group]) -> Iterator[Tracked]:
    """Every point of every table whose coordinates were read."""
    for name in dict.fromkeys(group.name for group in groups):
        own = {group.column: group for group in groups if group.name == name}
        bench = next(iter(own.values())).experiment
        if not isinstance(bench, Bench):
            continue
        tip = {axis: own[f"tip_{axis}"] for axis in "xyz" if f"tip_{axis}" in own}
        found = [Tracked("the tip", np.nan, tip)]
        places = zip(bench.setting.marker_names, bench.setting.arc_length, bench.setting.offset, strict=True)
        for marker, place, offset in places:
            axes = {axis: own[f"{axis}@{marker}"] for axis in "xyz" if f"{axis}@{marker}" in own}
            found.append(Tracked(f"the marker {marker}", float(place + np.linalg.norm(offset)), axes))
        yield from (point for point in found if point.axes)


# --- readings out of reach -------------------------------------------------------------------------


def check_reach(model: BenchModel, groups: Sequence[Group], free: Collection[str], given: Mapping[str, float]) -> None:
    """Refuse positions that are farther from the base than the body is long.

    Args:
        model, groups: the bench and its data.
        free: the parameters that are fitted; along an axis in which the camera is free, the base may be anywhere.
        given: known parameters.

    Raises:
        InputError: names table, row and remedy.
    """
    body, length = model.manipulator, float(np.asarray(model.manipulator.length))
    spare = STRETCHED if body.extensible else 1 + SPARE
    for point in _points(groups) if "length" not in free else ():
        reach = spare * (point.reach if np.isfinite(point.reach) else length)
        table = next(iter(point.axes.values())).table
        base = {axis: given.get(f"{CAMERA}_{axis}", 0.0) for axis in point.axes if f"{CAMERA}_{axis}" not in free}
        away = [np.nan_to_num(table[point.axes[axis].column] - place) for axis, place in base.items()]
        distance = np.linalg.norm(np.reshape(away, (-1, len(table))), axis=0)
        far = np.flatnonzero(distance > reach)
        if not len(far):
            continue
        i = int(far[0])
        raise InputError(
            f"{point.what} is {1e3 * distance[i]:.0f} mm or more from the base, but a body of {1e3 * length:.0f} mm "
            f"reaches {1e3 * reach:.0f} mm ({len(far)} of {len(table)} rows)",
            where=f"{table.name}: {table.place(i)}, {', '.join(group.column for group in point.axes.values())}",
            remedy="check the unit, leave the row out (leave_out, --leave-out), or fit the pose of its frame too: add "
            "camera to the parameters that are fitted (free, --free)",
        )


def unexplained_pose(statistics: LeastSquaresFit, groups: Sequence[Group], manipulator: Manipulator) -> str:
    """Why the pose that was fitted cannot be that of the camera; "" where it explains the positions."""
    if not set(camera_parameters(manipulator)) <= set(statistics.names):
        return ""
    for group in (group for point in _points(groups) for group in point.axes.values()):
        error, scatter = statistics.residuals[group.label], np.std(group.observed)
        one_outlier = np.max(error**2, initial=0.0) > 0.5 * np.sum(error**2)
        if np.std(error) > UNEXPLAINED * scatter > 0 and not one_outlier:
            return (
                f"no pose of the camera explains {group.label}; if its frame is left-handed, change the sign of one "
                "axis, and check the order and the units of the columns"
            )
    return ""


# --- where the search starts -----------------------------------------------------------------------


def camera_start(model: BenchModel, groups: Sequence[Group], start: Mapping[str, float]) -> dict[str, float]:
    """The start of the whole pose of the camera, and of the stiffness where it is fitted; {} where none is found.

    The positions that the model shows at the start are turned and shifted onto the readings (Kabsch 1976, Acta
    Crystallographica A 32, 922), for several stiffnesses; the one whose rest is smallest is taken.
    """
    names, stiffness = camera_parameters(model.manipulator), stiffness_parameter(model.manipulator)
    found: list[tuple[float, dict[str, float]]] = []
    points = [point for point in _points(groups) if len(point.axes) == model.manipulator.components]
    for factor in FACTORS if stiffness in start else (1.0,):
        at = {**start, **dict.fromkeys(names, 0.0)}
        at |= {stiffness: factor * start[stiffness]} if stiffness in start else {}
        pairs = [_pairs(point, model, at) for point in points]
        if sum(map(len, pairs)) < LEAST_POINTS:
            continue
        rest, pose = registered(*np.moveaxis(np.concatenate(pairs), 1, 0))
        own = {stiffness: at[stiffness]} if stiffness in start else {}
        found.append((rest, own | dict(zip(names, pose, strict=True))))
    return min(found, key=lambda one: one[0])[1] if found else {}


def _pairs(point: Tracked, model: BenchModel, parameters: Mapping[str, float]) -> np.ndarray:
    """(points, 2, axes), m: the positions in the model, and those that were read."""
    groups = list(point.axes.values())
    bench = groups[0].experiment
    assert isinstance(bench, Bench)
    shown = bench.solved(model.manipulator, parameters, model.nodes)
    readings = bench.readings(shown, [group.column for group in groups], parameters)
    both = [[readings[group.column], group.table[group.column]] for group in groups]
    pairs = np.moveaxis(np.array(both), 0, 2).swapaxes(0, 1)
    return pairs[np.all(np.isfinite(pairs), axis=(1, 2))]
