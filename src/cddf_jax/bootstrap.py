"""Refits to data drawn anew: how an estimate would scatter, without trust in its linearisation.

"parametric" draws new noise about the fitted model; "cases" draws whole cases (rows, or trials where there are
trials) from the data with replacement. On few cases the second is known to be too narrow.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from rich.progress import track

from .errors import InputError
from .levenberg_marquardt import LeastSquaresProblem, Outcome, minimise_all

CHUNK = 250  # refits at once: bounds the memory, and shows progress
KINDS = ("parametric", "cases")
MOST_COPIES = 8  # of a datum under a robust loss: more are drawn with a chance of 1e-6


class Bootstrap(NamedTuple):
    """Estimates from data drawn anew."""

    kind: str
    names: tuple[str, ...]
    estimates: np.ndarray  # (replicates, parameters), those that ended at a minimum
    estimate: np.ndarray  # (parameters,), of the data themselves
    num_failed: int
    seed: int

    @property
    def standard_error(self) -> dict[str, float]:
        return dict(zip(self.names, np.std(self.estimates, axis=0, ddof=1).tolist(), strict=True))

    @property
    def covariance(self) -> np.ndarray:
        return np.cov(self.estimates, rowvar=False).reshape(len(self.names), len(self.names))

    @property
    def bias(self) -> dict[str, float]:
        """Mean of the estimates less the estimate."""
        return dict(zip(self.names, (np.mean(self.estimates, axis=0) - self.estimate).tolist(), strict=True))

    @property
    def confidence_interval(self) -> dict[str, tuple[float, float]]:
        """Percentiles 2.5 and 97.5."""
        low, high = np.percentile(self.estimates, [2.5, 97.5], axis=0).tolist()
        return dict(zip(self.names, zip(low, high, strict=True), strict=True))

    @property
    def correlation(self) -> np.ndarray:
        return np.corrcoef(self.estimates, rowvar=False).reshape(len(self.names), len(self.names))


def bootstrap(
    problem: LeastSquaresProblem,
    noise: tuple[np.ndarray, ...],
    best: Outcome,
    names: tuple[str, ...],
    groups: tuple[str, ...],
    kind: str,
    replicates: int,
    *,
    clusters: Mapping[str, tuple[str, Any]] | None = None,
    seed: int = 0,
    progress: bool = False,
) -> Bootstrap:
    """Draw data anew and fit them from the estimate on, the weights of the data held.

    Args:
        problem, noise, best: a fit, and where it ended.
        names, groups: of the parameters and of the groups of data.
        kind: "parametric" or "cases".
        replicates: how many.
        clusters: for "cases", by group, the name of what is drawn from and one label per datum: data of one label
            are drawn together, also across groups that draw from the same. Without, each datum by itself.
        seed: of NumPy's generator.
        progress: show a bar.

    Raises:
        InputError: for a kind that is none, too few replicates, clusters that fit no group.
    """
    if kind not in KINDS:
        raise InputError(f"bootstrap: kind {kind!r} is not known; there are {', '.join(KINDS)}")
    if replicates < 2:
        raise InputError(f"bootstrap: needs 2 replicates or more, got {replicates}")
    rng = np.random.default_rng(seed)
    clusters = clusters or {}
    for name, (_, labels) in clusters.items():
        if name not in groups or len(labels) != np.size(problem.values[groups.index(name)]):
            raise InputError(f"bootstrap: clusters of {name!r} need one label for each datum of a group of data")
    predicted = _predicted(problem, noise, best)
    estimates, num_failed = [], 0
    sizes = [CHUNK] * (replicates // CHUNK) + [replicates % CHUNK] * (replicates % CHUNK > 0)
    for size in track(sizes, description="bootstrap", disable=not progress, transient=True):
        if kind == "parametric":
            values = tuple(p + s * rng.normal(size=(size, *p.shape)) for p, s in zip(predicted, noise, strict=True))
            deviations = noise
            searched = problem
        else:
            values = None
            counts = _draw_cases(rng, size, groups, problem.values, clusters)
            searched, deviations = _weighted(problem, noise, counts)
        found = minimise_all(searched, deviations, np.broadcast_to(best.z, (size, best.z.size)), values=values)
        good = found.solved & np.isfinite(found.cost) & np.all(np.isfinite(found.parameters), axis=1)
        estimates.append(found.parameters[good])
        num_failed += int(np.sum(~good))
    return Bootstrap(kind, names, np.concatenate(estimates), best.parameters, num_failed, seed)


def _predicted(problem: LeastSquaresProblem, noise: tuple[np.ndarray, ...], best: Outcome) -> list[np.ndarray]:
    rows = np.split(best.residual, np.cumsum([np.size(v) for v in problem.values]))[:-1]
    return [v + r.reshape(np.shape(v)) * s for v, r, s in zip(problem.values, rows, noise, strict=True)]


class _Copied(eqx.Module):
    """A model of each datum several times over."""

    predict: Callable[[Any], Any]
    copies: int = eqx.field(static=True)

    def __call__(self, parameters: Any) -> Any:
        return jax.tree.map(lambda x: jnp.stack([jnp.asarray(x)] * self.copies), self.predict(parameters))


def _weighted(
    problem: LeastSquaresProblem, noise: tuple[np.ndarray, ...], counts: list[np.ndarray]
) -> tuple[LeastSquaresProblem, tuple[np.ndarray, ...]]:
    """A problem and noise of each replicate, in which each datum counts as often as it was drawn.

    What was not drawn has infinite noise. A square counts c times with its noise over the root of c; under
    another loss the datum stands there several times, and c of them have finite noise.
    """
    if problem.loss == "linear":
        with np.errstate(divide="ignore"):
            return problem, tuple(s / np.sqrt(c) for s, c in zip(noise, counts, strict=True))
    copies = MOST_COPIES
    values = tuple(np.stack([np.asarray(v)] * copies) for v in problem.values)
    number = [np.arange(copies).reshape(-1, *([1] * np.ndim(v))) for v in problem.values]
    deviations = tuple(
        np.where(n < np.minimum(c, copies)[:, None], s, np.inf) for n, c, s in zip(number, counts, noise, strict=True)
    )
    return replace(problem, predict=_Copied(problem.predict, copies), values=values), deviations


def _draw_cases(
    rng: np.random.Generator, size: int, groups: tuple[str, ...], values: Any, clusters: Mapping[str, tuple[str, Any]]
) -> list[np.ndarray]:
    """How often each datum is drawn, (size, *shape) by group."""
    drawn: dict[str, dict[Any, np.ndarray]] = {}
    counts = []
    for name, group in zip(groups, values, strict=True):
        source, labels = clusters.get(name, (name, np.arange(np.size(group))))
        labels = np.asarray(labels).tolist()
        if source not in drawn:
            every = list(dict.fromkeys(labels))
            times = rng.multinomial(len(every), np.full(len(every), 1 / len(every)), size=size)
            drawn[source] = dict(zip(every, times.T, strict=True))
        counts.append(np.stack([drawn[source][label] for label in labels], axis=1).reshape(size, *np.shape(group)))
    return counts
