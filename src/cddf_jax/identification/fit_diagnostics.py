"""What a fitted model predicts for the rows of its tables, and the residuals: observed less predicted."""

from typing import NamedTuple

import numpy as np

from ..estimation.determination import AT_BOUND, NOT_IDENTIFIED
from ..mechanics.capstan import pulling_tension
from .bench import TRIALS, Bench, Group
from .course import between
from .fit import Fit

SHAPIRO_ROWS = (3, 5000)  # between which the test of Shapiro and Wilk holds
GRID = 100  # points of a curve


def own_names(fit: Fit) -> list[str]:
    """The parameters that were fitted, without the deviations of trials."""
    return [name for name in fit.names if not name.startswith(TRIALS)]


def moving_names(fit: Fit) -> list[str]:
    """The fitted parameters that are not at a bound."""
    return [name for name in own_names(fit) if fit.status[name] != AT_BOUND]


def correlated_names(fit: Fit) -> list[str]:
    """The parameters whose correlation the data determine."""
    if fit.rank == len(fit.names):
        return moving_names(fit)
    return [name for name in moving_names(fit) if fit.status[name] != NOT_IDENTIFIED]


# --- residuals over their noise ------------------------------------------------------------------


class Normality(NamedTuple):
    """Whether the residuals of a group could be draws from a normal distribution."""

    rows: int
    p_value: float  # Shapiro and Wilk (1965); NaN where the test does not apply


def normality(fit: Fit) -> dict[str, Normality]:
    """The test of Shapiro and Wilk for each group of data."""
    return {name: normality_of(residual) for name, residual in fit.standardised_residuals.items()}


def normality_of(residual: np.ndarray) -> Normality:
    """The test of Shapiro and Wilk; not of few, very many, equal or infinite residuals."""
    from scipy.stats import shapiro

    low, high = SHAPIRO_ROWS
    fit_for_it = low <= residual.size <= high and np.all(np.isfinite(residual)) and np.ptp(residual) > 0
    return Normality(residual.size, float(shapiro(residual).pvalue) if fit_for_it else float("nan"))


# --- the model beside the rows -------------------------------------------------------------------


class ModelCurve(NamedTuple):
    """The fitted model over a grid, SI units: base tension, or wrap angle (then pulling tension per weight)."""

    grid: np.ndarray
    value: np.ndarray
    half_width: np.ndarray  # of the 95 % band


def model_curve(fit: Fit, group: Group) -> ModelCurve | None:
    """The model over all base tensions (wrap angles) of a table; None where no single curve holds its rows."""
    rows, experiment = group.table, group.experiment
    if isinstance(experiment, Bench) and not experiment.on_one_curve:
        return None
    if isinstance(experiment, Bench):
        grid = np.linspace(max(rows["base_tension"].min(), 0.0), rows["base_tension"].max(), GRID)
        return ModelCurve(grid, *fit.predict(group.column, grid)[:2])
    grid = np.linspace(0.0, rows["wrap_angle"].max(), GRID)
    ratio = np.asarray(pulling_tension(1.0, fit.value["friction_coefficient"], grid))
    slope = np.zeros((grid.size, len(fit.names)))
    if "friction_coefficient" in fit.names:
        slope[:, fit.names.index("friction_coefficient")] = grid * ratio
    return ModelCurve(grid, ratio, fit.band(slope))


def model_loops(fit: Fit, group: Group) -> list[ModelCurve]:
    """The model along the path of each trial, in its order; [] where it does not come back, or has no exact answer."""
    bench = group.experiment
    course = bench.course if isinstance(bench, Bench) and not bench.on_one_curve else None
    if not isinstance(bench, Bench) or course is None or course.short_steps is not None:
        return []
    own = None if bench.trial is None else np.asarray(bench.trial)[np.asarray(course.first_row)]
    course, paths = between(course, GRID)
    trial = None if own is None else own[np.asarray(course.trial)]
    rows = Bench(np.concatenate(paths)[:, None], (None,), trial=trial, course=course, setting=bench.setting)
    shown = rows.evaluate(fit.model.manipulator, fit.parameters, fit.model.nodes)
    value, band = shown.readings[group.column], fit.band(shown.derivatives[group.column])
    ends = np.cumsum([path.size for path in paths])[:-1]
    parts = (np.split(numbers, ends) for numbers in (value, band))
    return [ModelCurve(*numbers) for numbers in zip(paths, *parts, strict=True)]


def half_width(fit: Fit, group: Group) -> np.ndarray:
    """Of the 95 % intervals of the predictions for what was read of the manipulator, SI."""
    assert isinstance(group.experiment, Bench)
    shown = group.experiment.evaluate(fit.model.manipulator, fit.parameters, fit.model.nodes)
    return fit.band(shown.derivatives[group.column][group.there])


def has_numbers(fit: Fit, group: Group) -> bool:
    """Whether the model gave a finite prediction for each row, and along the whole curve where there is one."""
    if not np.all(np.isfinite(fit.residuals[group.label])):
        return False
    curve = model_curve(fit, group)
    curves = model_loops(fit, group) if curve is None else [curve]
    return all(np.all(np.isfinite(curve.value)) for curve in curves)


def tables_without_numbers(fit: Fit) -> dict[str, str]:
    """By table, in words, the columns that the model gave no numbers for; such a table cannot be drawn."""
    lost = {}
    without = [group for group in fit.groups if not has_numbers(fit, group)]
    for name, table in {group.name: group.table for group in without}.items():
        columns = {group.column: fit.residuals[group.label] for group in without if group.name == name}
        rows = max(np.sum(~np.isfinite(residual)) for residual in columns.values())
        where = f" in {rows} of {len(table)} rows" if rows else " between the rows"
        lost[name] = f"the model gave no numbers for {', '.join(columns)}{where}"
    return lost
