"""Remarks of a fit on its parameters and residuals."""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.special import chdtrc, fdtrc, ndtr, stdtr

from .evidence import Evidence, without_nan
from .levenberg_marquardt import Minimum
from .parameter_space import TINY

UNEXPLAINED = 0.9  # of the scatter of the data, left in the residuals: hardly anything is explained
OUTLIER_CHANCE = 0.01
WITHIN = 3.0  # standard deviations: data farther away do not decide whether a model explains the others
AS_GIVEN = 4.0  # mean square of residuals over the given noise, below which the noise explains them
EXACT = 1e-7  # noise over data, below which it counts as 0
LEAST_FOR_RANKS = 12  # data
GROWTH_CHANCE = 1e-3
NEW = 1e-6  # size of a column that the Jacobian does not hold yet
ONE_DATUM = 0.5  # of a parameter's variance; one datum should not determine more


Place = Callable[[str, int], str]  # of the k-th datum of a group in words, k from 0


def remarks_on_parameters(evidence: Evidence, place: Place) -> list[str]:
    """Remarks on parameters at a kink of the model, or determined mostly by one datum."""
    jacobian, found = evidence.jacobian, []
    covariance = evidence.spectrum.covariance
    share = (covariance @ jacobian.T) ** 2 / np.maximum(np.diag(covariance), TINY)[:, None]
    data = [(name, k) for name, rows in evidence.rows.items() for k in range(len(rows))]
    many = len(data) > 2 * len(evidence.space.names)
    for i, name in enumerate(evidence.space.names):
        if i == evidence.kink:
            found.append(f"{name} lies at a kink of the model; the standard errors are those on one side of it")
        k = int(np.argmax(share[i, : len(data)]))
        if many and not evidence.at_bound[i] and share[i, k] > ONE_DATUM:
            found.append(
                f"{name} depends on one datum, {place(*data[k])}, for {100 * share[i, k]:.0f} % of its variance"
            )
    return found


def remarks_on_residuals(evidence: Evidence, minimum: Minimum, place: Place) -> list[str]:
    """Remarks on groups that are met exactly or hardly explained, and outliers."""
    problem, outcome = minimum
    found, spectrum = [], evidence.spectrum
    residuals, raw = (problem.by_group(rows) for rows in (outcome.residual, problem.unwhitened(outcome.residual)))
    unexplained = unexplained_groups(evidence, minimum)
    for i, (name, rows) in enumerate(evidence.rows.items()):
        residual, values, noise = residuals[i], np.ravel(problem.data.values[i]), np.ravel(problem.data.noise[i])
        estimated = evidence.noise_estimated[name]
        far = _far_off(residual, spectrum.leverage(rows), estimated)
        if estimated and np.max(noise) <= EXACT * np.max(np.abs(values), initial=0.0):
            exact = np.max(np.abs(raw[i] * noise)) <= EXACT * np.max(np.abs(values))
            found.append(
                f"{name} is met exactly, its noise cannot be estimated: standard errors mean nothing; give the noise"
                if exact
                else f"{name} scatters as errors of what was set make it, its own noise is estimated as 0; give it"
            )
            continue
        if name in unexplained:
            found.append(
                f"{name} is hardly explained at all, no better than by a constant; check its unit and sign, the model "
                "and the start"
            )
        else:
            found += _uneven(name, residual, values) if estimated and np.ptp(noise) == 0 else []
            if far:
                k, count = far
                others = f" (and {count - 1} more)" if count > 1 else ""
                found.append(f"{place(name, k)} lies far off the model{others}: check it, or leave it out")
    return found


def unexplained_groups(evidence: Evidence, minimum: Minimum) -> dict[str, int]:
    """The groups that a model hardly explains, and how many data each holds.

    The residuals of such a group keep more than `UNEXPLAINED` of its scatter: less than a fifth of the variance is
    explained. Repeats of one level, whose scatter is only noise, do not count as such a group: more than half of the
    sum of squares of the readings must be left too, or the predictions must vary more than the readings do. Data beyond
    3 standard deviations are left out, as one outlier would hide how well all others are met. Residuals of the size of
    given noise count as explained.
    """
    problem, outcome = minimum
    residuals, raw = (problem.by_group(rows) for rows in (outcome.residual, problem.unwhitened(outcome.residual)))
    found, groups = {}, zip(problem.groups, problem.data.values, problem.data.noise, residuals, raw, strict=True)
    for name, values, sigma, residual, unwhitened in groups:
        values = np.ravel(values)
        estimated = evidence.noise_estimated[name]
        near = np.abs(residual) <= WITHIN if estimated else np.full(values.size, True)
        error, values = (unwhitened * np.ravel(sigma))[near], values[near]
        if values.size < 3 or not (estimated or np.mean(residual**2) > AS_GIVEN):
            continue
        as_a_constant = np.mean(error**2) > UNEXPLAINED**2 * np.var(values)
        if as_a_constant and (2 * np.sum(error**2) > np.sum(values**2) or np.var(values + error) > np.var(values)):
            found[name] = values.size
    return found


def chance_of_more(evidence: Evidence, residuals: Mapping[str, np.ndarray], name: str, columns: np.ndarray) -> float:
    """The p-value of some more columns in the Jacobian, (rows of one group, columns): whether residuals contain them.

    A chi-square test if the noise of this group was given. If it was estimated, an F test against what the columns
    leave of the residuals of this group; other groups have other noise. 1 where nothing can be tested.

    Args:
        evidence: of the fit without these columns.
        residuals: by group, over the noise.
        name: the group in which the columns are not 0.
        columns: over the noise.
    """
    own = np.concatenate([np.full(len(rows), label == name) for label, rows in evidence.rows.items()])
    own = np.append(own, np.full(len(evidence.prior_rows), False))
    every = np.append(np.concatenate([residuals[label] for label in evidence.rows]), np.zeros(len(evidence.prior_rows)))
    wide = np.zeros((every.size, columns.shape[1]))
    wide[own] = columns
    basis = evidence.jacobian @ evidence.spectrum.root.T
    directions, sizes, _ = np.linalg.svd(wide - basis @ (basis.T @ wide), full_matrices=False)
    kept = directions[:, sizes > NEW * np.linalg.norm(wide)]
    count, explained = kept.shape[1], kept @ (kept.T @ every)
    rows = without_nan(evidence.rows[name])
    freedom = len(rows) - np.sum(evidence.spectrum.leverage(rows)) - np.sum(kept[own] ** 2)
    if not count or not np.all(np.isfinite(every)) or freedom < 1:
        return 1.0
    if not evidence.noise_estimated[name]:
        return float(chdtrc(count, np.sum(explained**2)))
    left = max(np.sum((every - explained)[own] ** 2), TINY) / freedom
    return float(fdtrc(count, freedom, np.sum(explained**2) / count / left))


def _uneven(name: str, residual: np.ndarray, values: np.ndarray) -> list[str]:
    """A remark if the residuals grow with the reading, by ranks."""
    if values.size < LEAST_FOR_RANKS or np.ptp(np.abs(values)) == 0 or np.ptp(np.abs(residual)) == 0:
        return []
    from scipy.stats import spearmanr

    chance = np.asarray(spearmanr(np.abs(values), np.abs(residual), alternative="greater"))[1]
    grown = f'{name}: residuals grow with the reading; give a noise that grows too, Noise() or "0.1 N + 1 %"'
    return [grown] if chance < GROWTH_CHANCE else []


def _far_off(residual: np.ndarray, leverage: np.ndarray, estimated: bool) -> tuple[int, int] | None:
    """The farthest outlier and the number of outliers, at 1 % with Bonferroni's correction; None for none."""
    distance = np.abs(residual) / np.sqrt(np.maximum(1.0 - leverage, 1e-6))
    freedom = residual.size - np.sum(leverage)
    chance = 2 * ndtr(-distance)
    if estimated:  # by the scatter of all the others
        if freedom < 3:
            return None
        distance = distance * np.sqrt((freedom - 1) / np.maximum(freedom - distance**2, 1e-12 * freedom))
        chance = 2 * stdtr(freedom - 1, -distance)
    far = np.flatnonzero(chance * residual.size < OUTLIER_CHANCE)
    return (int(far[np.argmax(distance[far])]), far.size) if far.size else None
