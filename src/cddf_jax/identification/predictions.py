"""Predictions of a fitted model: at given base tensions and forces, and for the rows of its tables.

Also: which predictions lie beyond the data, and how far finer steps along a history would move the estimates.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from ..errors import InputError
from ..estimation.least_squares import LeastSquaresFit
from ..measurements.forces import forces_of
from ..measurements.markers import marker_column
from ..measurements.readings import SET, kind_of_set, of_tendons, tendon_number
from ..measurements.table import Measurements
from ..numerics.arrays import evaluated
from ..numerics.given_numbers import check_numbers
from .bench import Bench, BenchModel, Group
from .fit_inputs import Conditions, Numbers, unread_table
from .parameters import TRIALS

SPANNED = 1e-9  # of the largest tension or force: rows as close to the range of the data count as inside


class Prediction(NamedTuple):
    """The fitted model in some rows."""

    value: np.ndarray  # NaN where the model has no solution
    half_width: np.ndarray  # of the 95 % band, from the uncertainty of the parameters
    extrapolated: np.ndarray  # True beyond the base tensions, displacements or forces of the data
    status: np.ndarray  # how the solve of each row ended, of `Status`


def rows_to_predict(conditions: Numbers | Conditions, num_tendons: int, column: str) -> Measurements:
    """A table of rows to predict; arguments as in `Fit.predict`.

    Raises:
        InputError: for numbers that are not finite, tensions below 0, shapes that do not fit.
    """
    by_column = conditions if isinstance(conditions, Mapping) else {"base_tension": conditions}
    for name, numbers in by_column.items():
        check_numbers(f"predict: {name}", numbers)
    if not isinstance(conditions, Mapping):
        pull = np.atleast_1d(np.asarray(conditions, float))
        pull = pull[:, None] if pull.ndim == 1 else pull
        if pull.ndim > 2 or pull.shape[1] not in (1, num_tendons):
            raise InputError(f"predict: needs base tensions (rows,) or (rows, {num_tendons}), got {pull.shape}")
        pulled = np.broadcast_to(pull, (len(pull), num_tendons)).T
        by_column = dict(zip(of_tendons("base_tension", num_tendons), pulled, strict=True))
    return unread_table("predict", by_column, num_tendons, [column if marker_column(column) else "tip_angle"])


def beyond_the_data(wanted: Measurements, tables: Sequence[Measurements]) -> np.ndarray:
    """Which rows lie outside the range of the data, in any base tension, displacement or component of a force.

    A force or a tendon that a table does not name was 0 in it. Of a tendon that is named by its displacement alone the
    tension is not known, and the other way round.
    """

    def conditions(table: Measurements) -> dict[str | tuple[float, int], np.ndarray]:
        places, forces = forces_of(table.columns, len(table))
        found = zip((0.0, *places.values()), np.moveaxis(forces, 0, 2), strict=True)  # the tip comes first
        of_forces = {(place, axis): values for place, own in found for axis, values in enumerate(own)}
        named = {tendon_number(name) for name in table.columns if kind_of_set(name) in SET}
        pulls = [name for kind in SET for name in of_tendons(kind, max(named)) if tendon_number(name) in named]
        return of_forces | {name: table.columns.get(name, np.full(len(table), np.nan)) for name in pulls}

    beyond, measured = np.zeros(len(wanted), bool), [conditions(one) for one in tables if "pulling_tension" not in one]
    for what, values in conditions(wanted).items() if measured else ():
        known = np.concatenate([own.get(what, np.zeros(1)) for own in measured])
        low, high = np.fmin.reduce(known), np.fmax.reduce(known)  # NaN where nothing was measured
        slack = SPANNED * np.maximum(np.abs(low), np.abs(high))
        beyond |= np.isfinite(values) & ~((values >= low - slack) & (values <= high + slack))
    return beyond | (not measured)


def moved_by_finer_steps(fit: LeastSquaresFit, model: BenchModel, groups: Sequence[Group]) -> dict[str, float]:
    """By parameter, the error of its estimate by increments and elements, over its standard error.

    The prediction is repeated with increments and elements half as long. An error proportional to their length is twice
    the difference, one that falls with the square is less. The linearised fit gives the change of the estimates. Empty
    where every answer is exact; NaN where the finer one has no solution.
    """
    spectrum, parameters = fit.evidence.spectrum, jax.tree.map(np.asarray, fit.parameters)
    apart: dict[str, np.ndarray] = {}
    for name, one in zip(model.names, model.experiments, strict=True):
        if not isinstance(one, Bench) or one.course is None or one.course.short_steps is None:
            continue
        finer = replace(one, course=replace(one.course, short_steps=2 * one.course.short_steps), name="")
        read = evaluated(Bench.predict, finer, model.manipulator, parameters, 2 * model.nodes)
        for group in (group for group in groups if group.name == name):
            apart[group.label] = 2 * (read[group.column] - (group.observed - fit.residuals[group.label]))
    rows = np.concatenate([*fit.evidence.rows.values()])
    moved = spectrum.covariance @ (rows.T @ over_noise(fit, apart))
    with np.errstate(invalid="ignore"):
        over = np.abs(moved) / spectrum.relative_error
    own = zip(fit.names, over.tolist(), strict=True)
    return {name: value for name, value in own if not name.startswith(TRIALS)} if apart else {}


def over_noise(fit: LeastSquaresFit, numbers: Mapping[str, np.ndarray]) -> np.ndarray:
    """Numbers of readings, by group, over their noise as the rows of the fit are, which they follow; 0 for the others.

    They are without what errors of inputs have in common.
    """
    problem = fit.minimum.problem
    noise = zip(problem.groups, problem.data.noise, strict=True)
    own = [np.ravel(numbers[label] / s) if label in numbers else np.zeros(np.size(s)) for label, s in noise]
    return np.asarray(problem.shared.whitened(np.concatenate(own)))
