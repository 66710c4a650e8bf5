"""Friction that differs from trial to trial: its spread, estimated by restricted likelihood."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from ..estimation.determination import determine
from ..estimation.least_squares import LeastSquaresFit
from ..estimation.parameter_space import Priors
from ..estimation.whole_search import INTERRUPTED
from .parameters import TRIALS, Parameters

SPREAD_ROUNDS = 20
FIRST_SPREAD = 0.1
SPREADS = (1e-4, 3.0)  # of ln(mu) over trials, smallest and largest; the smallest counts as 0
RIDGE = 1e-12  # of the largest information, for directions that the data do not determine


def fit_trials(
    search: Callable[..., LeastSquaresFit],
    count: int,
    start: Parameters,
    priors: Priors,
    scales: Mapping[str, float],
    starts: int | None,
) -> tuple[LeastSquaresFit, float]:
    """Random effects, by iteration: the fit for a spread over trials, then the likeliest spread at that fit, and so on.

    Args:
        search: `least_squares_fit` of the bench and its data.
        count: the number of trials.
        start, priors, scales, starts: as `least_squares_fit` takes them.

    Returns:
        The fit and the spread of ln(mu) over trials, 0 where there is none.
    """
    start, spread = {**start, TRIALS: np.zeros(count)}, FIRST_SPREAD
    names = [f"{TRIALS}[{k}]" for k in range(count)]

    def fitted(start: Parameters, spread: float, starts: int | None) -> LeastSquaresFit:
        of_trials = dict.fromkeys(names, (0.0, spread)), dict.fromkeys(names, spread)
        return search(start, priors={**priors, **of_trials[0]}, scales={**scales, **of_trials[1]}, starts=starts)

    statistics = first = fitted(start, spread, starts)
    if statistics.result == INTERRUPTED:
        return statistics, spread
    random = tuple(i for i, name in enumerate(statistics.names) if name in names)
    for _ in range(SPREAD_ROUNDS):
        last, spread = spread, _likeliest_spread(statistics, random)
        statistics = fitted({name: np.asarray(value) for name, value in statistics.parameters.items()}, spread, 1)
        if abs(spread - last) < 1e-3 * last:
            break
    evidence = replace(statistics.evidence, random=random)
    searched = {"starts": first.starts, "restarted": first.restarted}
    statistics = replace(statistics, **vars(determine(evidence)), evidence=evidence, **searched)
    return statistics, spread if spread > 1.01 * SPREADS[0] else 0.0


def _likeliest_spread(statistics: LeastSquaresFit, random: tuple[int, ...]) -> float:
    """The spread with the largest restricted likelihood of the model, linearised at the estimate.

    Patterson and Thompson (1971), Biometrika 58, 545; by the mixed-model equations of Harville (1977), JASA 72, 320.
    """
    from scipy.optimize import minimize_scalar

    evidence, (problem, outcome) = statistics.evidence, statistics.minimum
    priors = [i for i in evidence.prior_rows if i not in random]
    jacobian = np.concatenate([*evidence.rows.values(), *(evidence.prior_rows[i] for i in priors)])
    others = np.delete(jacobian, random, axis=1)
    effects = jacobian[:, random] / evidence.size[list(random)]
    pulls = dict(zip(problem.data.prior, outcome.residual[problem.num_data :], strict=True))
    residual = np.append(outcome.residual[: problem.num_data], [pulls[i] for i in priors])
    residual = residual - effects @ outcome.parameters[list(random)]  # as it would be without the effects
    columns = np.concatenate([others, effects], axis=1)
    information, pull = columns.T @ columns, columns.T @ residual
    diagonal = np.arange(others.shape[1], columns.shape[1])

    def minus_twice(logarithm: float) -> float:
        whole = information + RIDGE * np.max(np.diag(information)) * np.eye(len(information))
        whole[diagonal, diagonal] += np.exp(-2 * logarithm)
        return np.linalg.slogdet(whole)[1] + 2 * len(random) * logarithm - pull @ np.linalg.solve(whole, pull)

    found = minimize_scalar(minus_twice, bounds=np.log(SPREADS), method="bounded", options={"xatol": 1e-5})
    return float(np.exp(found.x))
