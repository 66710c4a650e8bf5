"""Refits to newly drawn data: how an estimate would scatter, without the linearisation of the model.

"parametric" draws new noise about the fitted model; "cases" draws whole cases (rows, or trials where there are
trials) from the data with replacement. With few cases its intervals are too narrow: `coverage` says how much.
"""

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri, stdtr

from ..errors import InputError
from ..progress import stage
from .levenberg_marquardt import Minimum, minimise_all
from .residuals import Data

CHUNK = 250  # refits at once: bounds the memory, and shows progress
KINDS = ("parametric", "cases")
LEAST_COVERAGE = 0.93  # of 95 % intervals; a smaller coverage is remarked on

Labels = Sequence[Hashable] | np.ndarray
Clusters = Mapping[str, tuple[str, Labels]]  # by group, the name of what is drawn from and one label for each datum
Sources = Sequence[tuple[str, Labels]]  # the same of all groups


class Bootstrap(NamedTuple):
    """Estimates from newly drawn data. All statistics are NaN where fewer than two refits ended at a minimum."""

    kind: str  # "parametric" or "cases"
    names: tuple[str, ...]  # of the parameters
    estimates: np.ndarray  # (replicates, parameters), those that ended at a minimum
    estimate: np.ndarray  # (parameters,), of the data themselves
    num_failed: int  # refits that ended at no minimum, left out
    seed: int  # of the draws
    num_cases: int = 0  # that were drawn from, the fewest of any source; 0 for "parametric"
    noise_freedom: float = np.inf  # degrees of freedom that the drawn noise was estimated with; inf where it was given

    @property
    def coverage(self) -> float:
        """The share of experiments whose 95 % percentile interval contains the true value, for a mean of normal data.

        The interval of n cases has the half-width z s sqrt((n - 1) / n) / sqrt(n), and that of drawn noise z s /
        sqrt(n). The exact one has the quantile of t in place of z.
        """
        z = ndtri(0.975)
        if self.kind == "parametric":
            return float(2 * stdtr(self.noise_freedom, z) - 1) if np.isfinite(self.noise_freedom) else 0.95
        n = self.num_cases
        return float(2 * stdtr(n - 1, z * np.sqrt((n - 1) / n)) - 1) if n > 1 else 0.0

    @property
    def remark(self) -> str:
        """A remark that the intervals are too narrow, if there are few cases or degrees of freedom; else ""."""
        if self.coverage >= LEAST_COVERAGE:
            return ""
        if self.kind == "parametric":
            drawn = f"the noise estimate has only {self.noise_freedom:.0f} degree(s) of freedom"
        else:
            drawn = f"drawn from {self.num_cases} case(s) only"
        return (
            f"{drawn}: even for a plain mean such 95 % intervals contain the true value in {100 * self.coverage:.0f} % "
            "of experiments; take the wider of these and those of the fit, or measure more"
        )

    @property
    def standard_error(self) -> dict[str, float]:
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def covariance(self) -> np.ndarray:
        return np.cov(self._refitted, rowvar=False).reshape(len(self.names), len(self.names))

    @property
    def correlation(self) -> np.ndarray:
        return np.corrcoef(self._refitted, rowvar=False).reshape(len(self.names), len(self.names))

    @property
    def bias(self) -> dict[str, float]:
        """Mean of the estimates less the estimate."""
        return dict(zip(self.names, (np.mean(self._refitted, axis=0) - self.estimate).tolist(), strict=True))

    @property
    def confidence_interval(self) -> dict[str, tuple[float, float]]:
        """Percentiles 2.5 and 97.5."""
        low, high = np.percentile(self._refitted, [2.5, 97.5], axis=0).tolist()
        return dict(zip(self.names, zip(low, high, strict=True), strict=True))

    @property
    def _refitted(self) -> np.ndarray:
        return self.estimates if len(self.estimates) > 1 else np.full((2, len(self.names)), np.nan)


@stage("bootstrap")
def bootstrap(
    minimum: Minimum,
    kind: str,
    replicates: int,
    clusters: Clusters,
    noise_freedom: float,
    seed: int,
) -> Bootstrap:
    """See `LeastSquaresFit.bootstrap`; `noise_freedom` are the degrees of freedom of the estimated noise."""
    problem = minimum.problem
    if kind not in KINDS:
        raise InputError(f"bootstrap: kind {kind!r} is not known; there are {', '.join(KINDS)}")
    if replicates < 2:
        raise InputError(f"bootstrap: needs 2 replicates or more, got {replicates}")
    sizes = {name: np.size(values) for name, values in zip(problem.groups, problem.data.values, strict=True)}
    for name, (_, labels) in clusters.items():
        if len(labels) != sizes.get(name):
            raise InputError(f"bootstrap: clusters of {name!r} need one label for each datum of a group of data")
    sources = [clusters.get(name, (name, np.arange(size))) for name, size in sizes.items()]

    def drawn(chunk: int, size: int) -> Data:
        return _draw(np.random.default_rng([seed, chunk]), size, minimum, kind, sources)

    estimates = _refit_all(minimum, drawn, replicates)
    ended = np.all(np.isfinite(estimates), axis=1)
    num_cases = min(map(len, _cases(sources).values())) if kind == "cases" else 0
    names, best, failed = problem.space.names, minimum.outcome.parameters, int(np.sum(~ended))
    return Bootstrap(kind, names, estimates[ended], best, failed, seed, num_cases, noise_freedom)


def _refit_all(minimum: Minimum, drawn: Callable[[int, int], Data], count: int) -> np.ndarray:
    """The estimates, (count, parameters); NaN where a refit ended at no minimum.

    `drawn` gives the data of a chunk by its number and size.
    """
    problem, best = minimum
    size = -(-count // -(-count // CHUNK))  # chunks of nearly equal size
    found = []
    with stage("refitting", count) as now:
        for chunk, begin in enumerate(range(0, count, size)):
            own = min(size, count - begin)
            ends = minimise_all(problem, np.broadcast_to(best.z, (own, best.z.size)), drawn(chunk, own))
            pressed = np.any(problem.space.at_bound(ends.parameters), axis=1)  # at a bound a search never settles
            good = (ends.solved | pressed) & np.isfinite(ends.cost)
            found.append(np.where(good[:, None], ends.parameters, np.nan))
            now.done += own
    return np.concatenate(found)


def _draw(rng: np.random.Generator, size: int, minimum: Minimum, kind: str, sources: Sources) -> Data:
    """Draw new noise about the fitted model, or cases with replacement, and new means of the priors.

    For "parametric" the means of priors are drawn about the estimate, for "cases" about the means themselves. Under a
    robust loss, which does not soften priors, they stay as they are.
    """
    (problem, best), drawn = minimum, minimum.problem.data
    values, noise, _, priors = drawn
    if kind == "parametric":
        about = {i: best.parameters[i] for i in priors}
        drawn_errors = [rng.normal(size=(size, *np.shape(v))).reshape(size, -1) for v in values]
        errors = problem.shared.unwhitened(np.concatenate(drawn_errors, axis=1).T).T
        raw = problem.unwhitened(best.residual)[: problem.num_data] + errors
        groups = zip(values, noise, np.split(raw, np.cumsum([np.size(v) for v in values])[:-1], axis=1), strict=True)
        noisy = (v + r.reshape(size, *np.shape(v)) * s for v, s, r in groups)
        drawn = drawn._replace(values=tuple(noisy))
    else:
        about = {i: prior.mean for i, prior in priors.items()}
        counts = zip(_count_cases(rng, size, sources), values, strict=True)
        drawn = drawn._replace(times=tuple(count.reshape(size, *np.shape(v)) for count, v in counts))
    if problem.loss != "linear":
        return drawn
    errors = {i: np.asarray(prior.standard_deviation) * rng.normal(size=size) for i, prior in priors.items()}
    return drawn._replace(prior={i: p._replace(mean=np.asarray(about[i]) + errors[i]) for i, p in priors.items()})


def _count_cases(rng: np.random.Generator, size: int, sources: Sources) -> list[np.ndarray]:
    """How often each datum is drawn, (size, data) by group."""
    drawn = {}
    for source, every in _cases(sources).items():
        times = rng.multinomial(len(every), np.full(len(every), 1 / len(every)), size=size)
        drawn[source] = dict(zip(every, times.T, strict=True))
    return [
        np.stack([drawn[source][label] for label in np.asarray(labels).tolist()], axis=1) for source, labels in sources
    ]


def _cases(sources: Sources) -> dict[str, list[Hashable]]:
    """By source, all its cases: those of every group that draws from it, as a group may lack some."""
    found: dict[str, dict[Hashable, None]] = {}
    for source, labels in sources:
        found.setdefault(source, {}).update(dict.fromkeys(np.asarray(labels).tolist()))
    return {source: list(labels) for source, labels in found.items()}
