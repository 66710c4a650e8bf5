"""The fitted model beside the rows of its tables, for drawing: curves with bands, and where there are none."""

from typing import NamedTuple

import numpy as np

from ..measurements.table import Measurements
from .bench import Bench, Group, Pulley
from .course import course_of
from .fit import Fit

GRID = 100  # points of a curve


class ModelCurve(NamedTuple):
    """The fitted model over a grid of base tensions, or of wrap angles (then it is pulling tension per weight); SI."""

    grid: np.ndarray
    value: np.ndarray
    half_width: np.ndarray  # of the 95 % band


def model_curve(fit: Fit, group: Group) -> ModelCurve | None:
    """The model over the base tensions (wrap angles) of a table; None where its rows do not lie on a single curve."""
    rows, experiment = group.table, group.experiment
    if isinstance(experiment, Bench) and not experiment.on_one_curve:
        return None
    if isinstance(experiment, Bench):
        grid = np.linspace(max(rows["base_tension"].min(), 0.0), rows["base_tension"].max(), GRID)
        return ModelCurve(grid, *fit.predict(group.column, grid)[:2])
    grid = np.linspace(0.0, rows["wrap_angle"].max(), GRID)
    shown = Pulley(np.ones(GRID), grid).evaluate(fit.model.manipulator, fit.parameters, fit.model.nodes)
    return ModelCurve(grid, shown.readings["pulling_tension"], fit.band(shown.derivatives["pulling_tension"]))


def model_loops(fit: Fit, group: Group) -> list[ModelCurve]:
    """The model along the path of each trial, in its order; [] where no path turns, or more than one number was set.

    Where there is no exact answer, it is known in the rows only.
    """
    bench, table = group.experiment, group.table
    course = bench.course if isinstance(bench, Bench) and not bench.on_one_curve else None
    if not isinstance(bench, Bench) or course is None or course.each_from_rest:
        return []
    if len(table.set_columns) > 1 or bench.forces is not None:
        return []
    column = table.set_columns[0].column
    if course.short_steps is not None:
        shown = bench.evaluate(fit.model.manipulator, fit.parameters, fit.model.nodes)
        numbers = table[column], shown.readings[group.column], fit.band(shown.derivatives[group.column])
        return [ModelCurve(*(own[rows] for own in numbers)) for rows in table.trials]
    parts: list[np.ndarray] = []  # the path of each trial, N or m, and the times
    for k, readings in enumerate(np.asarray(course.readings)[..., 0]):
        steps = np.arange(np.max(np.asarray(course.step)[np.asarray(course.trial) == k]) + 1)
        places = np.union1d(np.linspace(0, steps[-1], GRID), steps)
        own = [readings] if course.time is None else [readings, np.asarray(course.time)[k]]
        parts.append(np.stack([np.interp(places, steps, numbers[: steps.size]) for numbers in own]))
    path, *time = np.concatenate(parts, axis=1)
    trial = np.repeat(np.arange(len(parts)), [part.shape[1] for part in parts])
    columns = {column: path, "trial": trial} | dict(zip(["time"], time, strict=False))
    table = Measurements("curve", columns, np.arange(path.size))
    dense, _ = course_of(table, {column: 0.0}, course.past, timed=course.time is not None)
    own = None if bench.trial is None else np.asarray(bench.trial)[np.asarray(course.first_row)][trial]
    rows = Bench(path[:, None], (None,), trial=own, course=dense, setting=bench.setting)
    shown = rows.evaluate(fit.model.manipulator, fit.parameters, fit.model.nodes)
    value, band = shown.readings[group.column], fit.band(shown.derivatives[group.column])
    ends = np.flatnonzero(np.diff(trial)) + 1
    return [ModelCurve(*own) for own in zip(*(np.split(one, ends) for one in (path, value, band)), strict=True)]


def half_width(fit: Fit, group: Group) -> np.ndarray:
    """The half-widths of the 95 % intervals of the predictions for the readings of a group, SI."""
    assert isinstance(group.experiment, Bench)
    shown = group.experiment.evaluate(fit.model.manipulator, fit.parameters, fit.model.nodes)
    return fit.band(shown.derivatives[group.column][group.there])


def has_numbers(fit: Fit, group: Group) -> bool:
    """Whether the model gave a finite prediction for each row."""
    return bool(np.all(np.isfinite(fit.residuals[group.label])))


def tables_without_numbers(fit: Fit) -> dict[str, str]:
    """By table, in words, the columns that the model gave no numbers for; such a table cannot be drawn."""
    lost: dict[str, str] = {}
    for name, table in zip(fit.model.names, fit.tables, strict=True):
        without = [group for group in fit.groups if group.name == name and not has_numbers(fit, group)]
        if without:
            rows = max(np.sum(~np.isfinite(fit.residuals[group.label])) for group in without)
            columns = ", ".join(group.column for group in without)
            lost[name] = f"the model gave no numbers for {columns} in {rows} of {len(table)} rows"
    return lost
