"""What a fit has to say of its parameters and residuals beside its numbers."""

import numpy as np
from scipy.special import ndtr, stdtr
from scipy.stats import spearmanr

from .determination import Evidence, spectrum_of
from .levenberg_marquardt import Search

OUTLIER_CHANCE = 0.01
UNEXPLAINED = 0.9  # of the scatter of the data, left in the residuals
EXACT = 1e-7  # noise over data, below which there is none
LEAST_FOR_RANKS = 12  # data
GROWTH_CHANCE = 1e-3
ONE_DATUM = 0.5  # share of a parameter's variance that no datum should make alone


def remarks_on_parameters(evidence: Evidence) -> list[str]:
    """On a bound, without effect, hanging on one datum."""
    jacobian, found = evidence.jacobian, []
    covariance = spectrum_of(jacobian).covariance
    share = (covariance @ jacobian.T) ** 2 / np.maximum(np.diag(covariance), 1e-300)[:, None]
    labels = [f"entry {k + 1} of {name}" for name, rows in evidence.rows.items() for k in range(len(rows))]
    for i, name in enumerate(evidence.names):
        if evidence.at_bound[i]:
            nearer = evidence.nearest_bound[i]
            otherwise = "" if i in evidence.bounded_above else ", or it has no effect"
            found.append(f"{name} ended on its bound {nearer:g}: the data put it there or beyond{otherwise}")
        elif not np.any(jacobian[:, i]):
            found.append(f"{name} did not move: no datum depends on it")
        elif len(labels) > 2 * len(evidence.names) and np.max(share[i, : len(labels)]) > ONE_DATUM:
            k = int(np.argmax(share[i, : len(labels)]))
            found.append(
                f"{name} hangs on one datum, {labels[k]}, which makes {100 * share[i, k]:.0f} % of its variance"
            )
    return found


def remarks_on_residuals(evidence: Evidence, search: Search, degrees_of_freedom: int) -> list[str]:
    """Groups that are met exactly or not at all, data far from all others, noise that hardly any residual tells."""
    problem, deviations, outcome = search
    found, ends = [], np.cumsum([np.size(v) for v in problem.values])
    residuals = np.split(outcome.residual, ends)[:-1]
    covariance = spectrum_of(evidence.jacobian).covariance
    if any(evidence.noise_estimated.values()) and degrees_of_freedom in (1, 2):
        found.append(f"noise is told by {degrees_of_freedom} degree(s) of freedom only; measure more")
    for (name, rows), residual, values, noise in zip(
        evidence.rows.items(), residuals, problem.values, deviations, strict=True
    ):
        estimated, values = evidence.noise_estimated[name], np.ravel(values)
        error = residual * np.ravel(noise)
        if estimated and np.max(np.ravel(noise)) <= EXACT * np.max(np.abs(values), initial=0.0):
            found.append(f"{name} is met exactly, which tells no noise: standard errors mean nothing; give the noise")
        elif values.size > 2 and np.std(error) > UNEXPLAINED * np.std(values) > 0:
            found.append(f"{name} is hardly explained at all; search from another start, or from many (starts)")
        elif problem.loss == "linear":
            found += _uneven(name, residual, values) if estimated and np.ptp(noise) == 0 else []
            found += _outliers(name, residual, np.einsum("ki,ij,kj->k", rows, covariance, rows), estimated)
    return found


def _uneven(name: str, residual: np.ndarray, values: np.ndarray) -> list[str]:
    """Whether the residuals grow with the reading, by ranks."""
    if values.size < LEAST_FOR_RANKS or np.ptp(np.abs(values)) == 0 or np.ptp(np.abs(residual)) == 0:
        return []
    chance = np.asarray(spearmanr(np.abs(values), np.abs(residual), alternative="greater"))[1]
    grown = f'{name}: residuals grow with the reading; let the noise do so, Noise() for it or "0.1 N + 1 %"'
    return [grown] if chance < GROWTH_CHANCE else []


def _outliers(name: str, residual: np.ndarray, leverage: np.ndarray, estimated: bool) -> list[str]:
    """Data so far off that of as many honest ones the farthest is nearer in 99 of 100 experiments (Bonferroni)."""
    distance = np.abs(residual) / np.sqrt(np.maximum(1.0 - leverage, 1e-6))
    freedom = residual.size - np.sum(leverage)
    chance = 2 * ndtr(-distance)
    if estimated:  # by the scatter of all the others
        if freedom < 3:
            return []
        distance = distance * np.sqrt((freedom - 1) / np.maximum(freedom - distance**2, 1e-12 * freedom))
        chance = 2 * stdtr(freedom - 1, -distance)
    far = np.flatnonzero(chance * residual.size < OUTLIER_CHANCE)
    if far.size == 0:
        return []
    worst = far[np.argmax(distance[far])]
    others = f" (and {far.size - 1} more are far off)" if far.size > 1 else ""
    return [
        f"entry {worst + 1} of {name} lies {distance[worst]:.2g} standard deviations off the model{others}: "
        "check it, or use a robust loss"
    ]
