"""One whole search of a fit: noise from residuals, a look along the valleys, and what the data tell where it ended."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .determination import Determination, Evidence, determine, without_nan
from .levenberg_marquardt import LeastSquaresProblem, Outcome, Search, minimise
from .observations import Observations
from .remarks import unexplained_groups
from .robust_loss import loss_of
from .valleys import Profiles, are_products, nearest_to_start, profiles_of

SUCCESSFUL = "successful"
NO_NUMBER = "the model gave no number at the estimate; start closer, or leave out data beyond its reach"
NOT_SETTLED = "the noise estimates did not settle; give the noise of some data"
STOPPED_SHORT = "the optimiser stopped short of a minimum; start closer, search from more starts, or allow more steps"
BETTER_ELSEWHERE = "a better minimum lies elsewhere; start closer, or search from more starts"
NOISE_ROUNDS = 50


class FitProblem(NamedTuple):
    """What stays the same however often a fit is searched."""

    problem: LeastSquaresProblem
    data: Observations
    names: tuple[str, ...]  # of the parameters
    prefer_start: bool  # in a valley that the data leave open
    max_steps: int


class Ending(NamedTuple):
    """Where a search ended with its noise estimated, and what the data tell there."""

    noise: tuple[np.ndarray, ...]
    outcome: Outcome
    evidence: Evidence
    told: Determination
    result: str
    lower: np.ndarray | None  # z of a place beside it where the cost is lower

    @property
    def success(self) -> bool:
        return self.result == SUCCESSFUL


def search_from(fit: FitProblem, z: np.ndarray) -> Ending:
    """Weights from residuals, residuals from weights, until they agree; then a look around."""
    problem, data, names, prefer_start, max_steps = fit
    noise, settled = data.first_guess(), False
    outcome = minimise(problem, noise, z, max_steps=max_steps)
    for _ in range(NOISE_ROUNDS):
        improved = data.estimate_noise(noise, problem, outcome)
        settled = all(np.allclose(a, b, rtol=1e-4, atol=0) for a, b in zip(noise, improved, strict=True))
        if settled and all(map(np.array_equal, noise, improved)):  # it was known
            break
        noise, outcome = improved, minimise(problem, improved, outcome.z, max_steps=max_steps)
        if settled or not np.all(np.isfinite(outcome.residual)):
            break

    evidence = _evidence(names, problem, data, outcome)
    told = determine(evidence)
    profiles = profiles_of(problem, noise, outcome, evidence, told, max_steps)
    result = _verdict(Search(problem, noise, outcome), evidence, settled, profiles)
    if prefer_start and np.any(profiles.open):
        outcome = nearest_to_start(problem, noise, outcome, profiles.open, told.quantile, max_steps)
        evidence = _evidence(names, problem, data, outcome)
    evidence = replace(evidence, open_profile=profiles.open, bounded_above=profiles.bounded_above)
    if result != SUCCESSFUL:
        evidence = of_failed(evidence)
    else:
        evidence = replace(evidence, products=are_products(problem, noise, outcome, determine(evidence), max_steps))
    return Ending(noise, outcome, evidence, determine(evidence), result, profiles.lower)


def _evidence(names, problem: LeastSquaresProblem, data: Observations, outcome: Outcome) -> Evidence:
    """The scaled Jacobian by groups; none of it where the model gave no number."""
    space = problem.space
    finite = np.all(np.isfinite(outcome.residual))
    at_bound = space.at_bound(outcome.parameters)  # where the value is no measure of its own precision
    size = np.where(at_bound, np.maximum(outcome.size, space.scale), outcome.size)
    jacobian = without_nan(outcome.jacobian * (size / outcome.size)) if finite else np.zeros_like(outcome.jacobian)
    ends = np.cumsum([v.size for v in data.values])
    *rows, prior_rows = np.split(jacobian, ends)
    if problem.loss != "linear":
        residuals = np.split(outcome.residual, ends)[:-1]
        rows = [row * _efficiency(problem.loss, r, len(names)) for row, r in zip(rows, residuals, strict=True)]
    return Evidence(
        names=names,
        start=np.asarray(space.start),
        scale=np.asarray(space.scale),
        lower=np.asarray(space.lower),
        upper=np.asarray(space.upper),
        value=outcome.parameters,
        size=size,
        at_bound=at_bound,
        open_profile=np.zeros(len(names), bool),
        rows=dict(zip(data.names, rows, strict=True)),
        prior_rows={i: row[None] for i, row in zip(problem.prior, prior_rows, strict=True)},
        noise_estimated={name: not known for name, known in zip(data.names, data.known, strict=True)},
    )


def of_failed(evidence: Evidence) -> Evidence:
    return replace(evidence, failed=True, bounded_above=())


def _efficiency(loss: str, residual: np.ndarray, num_parameters: int) -> float:
    """What a robust loss makes of one standard deviation: mean psi' over the root of the mean psi^2 (Huber 1981)."""
    kind = loss_of(loss)
    spread = np.sum(kind.influence(residual) ** 2) / max(residual.size - num_parameters, 1)
    return float(np.mean(kind.slope(residual)) / np.sqrt(max(spread, 1e-300)))


def _verdict(search: Search, evidence: Evidence, settled: bool, profiles: Profiles) -> str:
    problem, _, outcome = search
    if not np.all(np.isfinite(outcome.residual)) or not np.all(np.isfinite(outcome.jacobian)):
        return NO_NUMBER
    if not settled:
        return NOT_SETTLED
    free = ~evidence.at_bound  # at a bound the sum of squares may well slope
    column, total = np.linalg.norm(outcome.jacobian, axis=0), np.linalg.norm(outcome.residual)
    slope = np.abs(outcome.jacobian.T @ problem.influence(outcome.residual)) / np.maximum(column * total, 1e-300)
    exact = total <= 1e-3 * np.sqrt(outcome.residual.size)
    if not exact and np.any(slope[free] > (1e-4 if outcome.solved else 1e-6)):
        return STOPPED_SHORT
    if profiles.least_rise < -0.01:
        return BETTER_ELSEWHERE
    if unexplained := unexplained_groups(evidence, search):
        return (
            f"hardly anything of {', '.join(unexplained)} is explained (less than a fifth of the variance); "
            "check units and signs, start closer, or search from more starts"
        )
    return SUCCESSFUL
