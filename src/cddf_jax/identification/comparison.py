"""Which model explains the data best: information criteria, and the prediction of data that were left out.

It compares several fits of the same tables, for instance with and without drag, or with and without errors of cells.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..estimation.levenberg_marquardt import minimise_all
from ..estimation.parameter_space import Numbers
from .fit import Fit

ROW_FOLDS = 6  # where there are no trials


@dataclass(frozen=True)
class Comparison:
    """One model among others. Lower criteria and errors are better."""

    name: str  # as it was given
    num_parameters: int  # including the estimated noise
    AIC: float  # Akaike's criterion
    BIC: float  # Schwarz's criterion
    cross_validation: float  # root mean square of what was left out, in standard deviations of the first fit's noise
    mean_relative_error: float  # of the tip tensions, the measure of Liu et al. (2020)
    success: bool  # whether the fit succeeded


def compare(fits: Mapping[str, Fit]) -> list[Comparison]:
    """Compare fits of the same tables; the one with the least AIC comes first.

    Cross-validation divides the errors of all fits by the noise of the first one, so that they can be compared.

    Raises:
        InputError: for fewer than two fits, or fits of different data.
    """
    if len(fits) < 2:
        raise InputError("compare: needs two fits or more, by name")
    checksums = {name: [table.checksum for table in fit.tables] for name, fit in fits.items()}
    first, *others = checksums.items()
    for name, found in others:
        if found != first[1]:
            raise InputError(f"compare: {name!r} was fitted to other data than {first[0]!r}; fit the same tables")
    noise = next(iter(fits.values())).minimum.problem.data.noise
    found = [
        Comparison(
            name,
            fit.num_estimated,
            **fit.information_criteria,
            cross_validation=cross_validation(fit, noise),
            mean_relative_error=fit.mean_relative_error,
            success=fit.success,
        )
        for name, fit in fits.items()
    ]
    return sorted(found, key=lambda comparison: comparison.AIC)


def cross_validation(fit: Fit, noise: Sequence[Numbers] | None = None) -> float:
    """Each trial (or sixth of the rows of a table without trials) predicted by a fit to all the others.

    Args:
        fit: the model.
        noise: standard deviations by which errors are divided, one array for each group of data; None for those of the
            fit.

    Returns:
        Root mean square of the errors of prediction over the noise; NaN where a fit to the others failed.
    """
    problem, best = fit.minimum
    folds = _folds(fit)
    kept = problem.data._replace(times=tuple(np.where(out, 0.0, 1.0) for out in folds))
    count = folds[0].shape[0]
    found = minimise_all(problem, np.broadcast_to(best.z, (count, best.z.size)), kept)
    over = zip(problem.data.noise, problem.data.noise if noise is None else noise, strict=True)
    errors = found.residual[:, : problem.num_data] * np.concatenate([own / other for own, other in over])
    left_out = np.concatenate(folds, axis=1)
    return float(np.sqrt(np.mean(errors[left_out] ** 2)))


def _folds(fit: Fit) -> list[np.ndarray]:
    """For each group of data, whether a fold leaves an entry out, (folds, entries)."""
    marks, clusters = [], fit.clusters
    groups = [clusters[name] for name in fit.evidence.rows]  # in the order of the noise
    with_trials = {table for table, labels in groups if len(np.unique(labels)) < len(labels)}
    for table, labels in groups:
        trials = table in with_trials
        marks.append([(table, label if trials else int(label) % ROW_FOLDS) for label in labels.tolist()])
    every = list(dict.fromkeys(mark for group in marks for mark in group))
    return [np.array([[mark == fold for mark in group] for fold in every]) for group in marks]
