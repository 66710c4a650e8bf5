"""Refits to data drawn anew: how an estimate would scatter, without trust in its linearisation.

"parametric" draws new noise about the fitted model; "cases" draws whole cases (rows, or trials where there are
trials) from the data with replacement. On few cases the second is known to be too narrow: `coverage` says how much.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtri, stdtr

from .chunks import Coordinate, Index, Layout, Variable, even_chunks
from .errors import InputError
from .fingerprint import digest, numbers_of
from .levenberg_marquardt import LeastSquaresProblem, Outcome, minimise_all
from .work import Work, carry_out

CHUNK = 250  # refits at once: bounds the memory, and shows progress
KINDS = ("parametric", "cases")
LEAST_COVERAGE = 0.93  # of 95 % intervals, below which a remark is made
MOST_COPIES = 8  # of a datum under a robust loss: more are drawn with a chance of 1e-6


class Bootstrap(NamedTuple):
    """Estimates from data drawn anew. What they tell is NaN where fewer than two refits ended at a minimum."""

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
        """In how many experiments a 95 % interval by percentiles holds the truth, of a mean of normal cases.

        Its half-width is z s sqrt((n - 1) / n) / sqrt(n) from n cases, and z s / sqrt(n) from drawn noise of standard
        deviation s, where t-statistics would have it.
        """
        z = ndtri(0.975)
        if self.kind == "parametric":
            return float(2 * stdtr(self.noise_freedom, z) - 1) if np.isfinite(self.noise_freedom) else 0.95
        n = self.num_cases
        return float(2 * stdtr(n - 1, z * np.sqrt((n - 1) / n)) - 1) if n > 1 else 0.0

    @property
    def remark(self) -> str:
        """What to know of the intervals: that they are too narrow where little was drawn from; "" elsewhere."""
        if self.coverage >= LEAST_COVERAGE:
            return ""
        if self.kind == "parametric":
            drawn = f"the noise is told by {self.noise_freedom:.0f} degree(s) of freedom only"
        else:
            drawn = f"drawn from {self.num_cases} case(s) only"
        return (
            f"{drawn}: even of a plain mean such 95 % intervals hold the truth in {100 * self.coverage:.0f} % of "
            "experiments; take the wider of these and those of the fit, or measure more"
        )

    @property
    def standard_error(self) -> dict[str, float]:
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def covariance(self) -> np.ndarray:
        return np.cov(self._told, rowvar=False).reshape(len(self.names), len(self.names))

    @property
    def correlation(self) -> np.ndarray:
        return np.corrcoef(self._told, rowvar=False).reshape(len(self.names), len(self.names))

    @property
    def bias(self) -> dict[str, float]:
        """Mean of the estimates less the estimate."""
        return dict(zip(self.names, (np.mean(self._told, axis=0) - self.estimate).tolist(), strict=True))

    @property
    def confidence_interval(self) -> dict[str, tuple[float, float]]:
        """Percentiles 2.5 and 97.5."""
        low, high = np.percentile(self._told, [2.5, 97.5], axis=0).tolist()
        return dict(zip(self.names, zip(low, high, strict=True), strict=True))

    @property
    def _told(self) -> np.ndarray:
        return self.estimates if len(self.estimates) > 1 else np.full((2, len(self.names)), np.nan)


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
    noise_freedom: float = np.inf,
    seed: int = 0,
    progress: bool = False,
    out: Any = None,
) -> Bootstrap:
    """Draw data anew and fit them from the estimate on, the weights of the data held.

    A prior counts as one more reading and is drawn anew too; under a robust loss it is held.

    Args:
        problem, noise, best: a fit, and where it ended.
        names, groups: of the parameters and of the groups of data.
        kind: "parametric" or "cases".
        replicates: how many.
        clusters: for "cases", by group, the name of what is drawn from and one label per datum: data of one label
            are drawn together, also across groups that draw from the same. Without, each datum by itself.
        noise_freedom: with how many degrees of freedom the noise was estimated; inf where it was given.
        seed: of NumPy's generator.
        progress: show a bar.
        out: path of a Zarr store for the estimates; a bootstrap that was stopped goes on where it was, and several
            processes share the work.

    Raises:
        InputError: for a kind that is none, too few replicates, clusters that fit no group, a store of other work.
    """
    if kind not in KINDS:
        raise InputError(f"bootstrap: kind {kind!r} is not known; there are {', '.join(KINDS)}")
    if replicates < 2:
        raise InputError(f"bootstrap: needs 2 replicates or more, got {replicates}")
    clusters = clusters or {}
    for name, (_, labels) in clusters.items():
        if name not in groups or len(labels) != np.size(problem.values[groups.index(name)]):
            raise InputError(f"bootstrap: clusters of {name!r} need one label for each datum of a group of data")

    def draw(layout: Layout, index: Index) -> _Drawn:
        size, rng = layout.count(index), np.random.default_rng([seed, *index])
        if kind == "parametric":
            return _draw_noise(rng, size, problem, noise, best)
        return _draw_cases(rng, size, problem, noise, groups, clusters)

    def identity() -> dict[str, Any]:
        return {"kind": kind, "seed": seed, "data and model": _digest((problem, noise, best.z, clusters))}

    found = _refit_all(best, names, draw, "replicate", replicates, identity, progress, out)
    kept, failed = found.estimates[found.ended], int(np.sum(~found.ended))
    cases = min(len(every) for every in _cases(groups, problem.values, clusters).values()) if kind == "cases" else 0
    return Bootstrap(kind, names, kept, best.parameters, failed, seed, cases, noise_freedom)


class Refits(NamedTuple):
    """Estimates from the data of many benches."""

    names: tuple[str, ...]
    estimates: np.ndarray  # (benches, parameters)
    ended: np.ndarray  # (benches,), at a minimum; the estimates of others are NaN


def refits(
    problem: LeastSquaresProblem,
    noise: tuple[np.ndarray, ...],
    best: Outcome,
    names: tuple[str, ...],
    groups: tuple[str, ...],
    observed: Mapping[str, Any],
    progress: bool = False,
    out: Any = None,
) -> Refits:
    """Fit the data of many benches from the estimate on; see `LeastSquaresFit.refits`."""
    data = {name: np.asarray(values, float) for name, values in observed.items()}
    shapes = {name: np.shape(value) for name, value in zip(groups, problem.values, strict=True)}
    for name, values in data.items():
        if name not in shapes:
            raise InputError(f"refits: {name!r} is no group of data; there are {', '.join(groups)}")
        if not np.all(np.isfinite(values)):
            bench = int(np.argmin(np.all(np.isfinite(values.reshape(len(values), -1)), axis=1)))
            raise InputError(f"refits: {name!r} holds a number that is not finite in bench {bench}; leave that one out")
        if values.shape[1:] != shapes[name] or not len(values):
            raise InputError(f"refits: {name!r} must have shape (benches, *{shapes[name]}), got {values.shape}")
    if not data:
        raise InputError(f"refits: give data; the groups are {', '.join(groups)}")
    counts = {len(values) for values in data.values()}
    if len(counts) != 1:
        raise InputError(f"refits: give every group the data of the same number of benches, got {sorted(counts)}")

    def draw(layout: Layout, index: Index) -> _Drawn:
        places = layout.region(index)[0]
        own = zip(groups, problem.values, strict=True)
        return _Drawn(problem, noise, tuple(data[name][places] if name in data else np.asarray(v) for name, v in own))

    def identity() -> dict[str, Any]:
        return {"data and model": _digest((problem, noise, best.z, data))}

    return _refit_all(best, names, draw, "bench", counts.pop(), identity, progress, out)


def _refit_all(
    best: Outcome,
    names: tuple[str, ...],
    draw: Callable[[Layout, Index], "_Drawn"],
    dimension: str,
    count: int,
    identity: Callable[[], dict[str, Any]],
    progress: bool,
    out: Any,
) -> Refits:
    """All the refits, chunk by chunk."""
    estimate = Variable((dimension, "parameter"), (count, len(names)), np.dtype(float), {"long_name": "estimate"})
    ended = Variable((dimension,), (count,), np.dtype(bool), {"long_name": "ended at a minimum"})
    coords: dict[str, Coordinate] = {"parameter": (("parameter",), np.asarray(names), {})}
    variables = {"estimate": estimate, "ended": ended}
    layout = Layout(
        {dimension: count}, even_chunks([count], CHUNK, [False]), coords, variables, {"title": "cddf_jax refits"}
    )

    def refit(layout: Layout, index: Index) -> dict[str, np.ndarray]:
        drawn = draw(layout, index)
        z = np.broadcast_to(best.z, (layout.count(index), best.z.size))
        found = minimise_all(drawn.problem, drawn.noise, z, values=drawn.values)
        pressed = np.any(
            drawn.problem.space.at_bound(found.parameters), axis=1
        )  # there a search has always a step left
        good = (found.solved | pressed) & np.isfinite(found.cost) & np.all(np.isfinite(found.parameters), axis=1)
        return {"estimate": np.where(good[:, None], found.parameters, np.nan), "ended": good}

    work = Work(layout, lambda: identity() | {dimension: count, "parameters": list(names)}, refit)
    found = carry_out(work, out, progress=progress).values()
    return Refits(names, found["estimate"], found["ended"])


def _digest(tree: Any) -> str:
    return digest(json.dumps(numbers_of(tree)))


class _Drawn(NamedTuple):
    """Many fits: data and noise have a leading axis, or are those of all."""

    problem: LeastSquaresProblem
    noise: tuple[np.ndarray, ...]
    values: tuple[np.ndarray, ...]


def _draw_noise(rng: np.random.Generator, size: int, problem: LeastSquaresProblem, noise, best: Outcome) -> _Drawn:
    """New noise about the fitted model, and about the estimate in place of the priors' means."""
    searched, deviations = _with_priors_as_data(problem, noise)
    predicted = _predicted(searched, deviations, best)
    values = (p + s * rng.normal(size=(size, *p.shape)) for p, s in zip(predicted, deviations, strict=True))
    return _Drawn(searched, deviations, tuple(values))


def _draw_cases(rng: np.random.Generator, size: int, problem: LeastSquaresProblem, noise, groups, clusters) -> _Drawn:
    """Data with replacement; a prior's mean is drawn about itself."""
    counts = _count_cases(rng, size, groups, problem.values, clusters)
    if problem.loss != "linear":
        return _copied(problem, noise, counts)
    searched, deviations = _with_priors_as_data(problem, noise)
    count = len(noise)
    means = (
        np.asarray(v) + s * rng.normal(size=size)
        for v, s in zip(searched.values[count:], deviations[count:], strict=True)
    )
    with np.errstate(divide="ignore"):  # c times a square is that of noise over the root of c; infinite where c is 0
        weighted = (s / np.sqrt(c) for s, c in zip(noise, counts, strict=True))
        return _Drawn(searched, (*weighted, *deviations[count:]), (*(np.asarray(v) for v in problem.values), *means))


@dataclass(frozen=True)
class _KeepNumbers:
    """An `unravel` that leaves the numbers beside the structure."""

    unravel: Callable[[Any], Any]

    def __call__(self, numbers: Any) -> Any:
        return self.unravel(numbers), numbers


class _WithNumbers(eqx.Module):
    """A model that predicts some of its parameters too."""

    predict: Callable[[Any], Any]
    which: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, parameters: Any) -> Any:
        structure, numbers = parameters
        return self.predict(structure), [numbers[i] for i in self.which]


def _with_priors_as_data(problem: LeastSquaresProblem, noise) -> tuple[LeastSquaresProblem, tuple[np.ndarray, ...]]:
    """A prior is a reading of its parameter; no robust loss softens it, so that there it stays what it is."""
    if not problem.prior or problem.loss != "linear":
        return problem, tuple(noise)
    means = (np.asarray(prior.mean) for prior in problem.prior.values())
    deviations = (np.asarray(prior.standard_deviation) for prior in problem.prior.values())
    predict = _WithNumbers(problem.predict, tuple(problem.prior))
    unravel, values = _KeepNumbers(problem.unravel), (*problem.values, *means)
    return replace(problem, predict=predict, unravel=unravel, values=values, prior={}), (*noise, *deviations)


def _predicted(problem: LeastSquaresProblem, noise: tuple[np.ndarray, ...], best: Outcome) -> list[np.ndarray]:
    rows = np.split(best.residual, np.cumsum([np.size(v) for v in problem.values]))[:-1]
    return [np.asarray(v) + r.reshape(np.shape(v)) * s for v, r, s in zip(problem.values, rows, noise, strict=True)]


class _Copied(eqx.Module):
    """A model of each datum several times over."""

    predict: Callable[[Any], Any]
    copies: int = eqx.field(static=True)

    def __call__(self, parameters: Any) -> Any:
        return jax.tree.map(lambda x: jnp.stack([jnp.asarray(x)] * self.copies), self.predict(parameters))


def _copied(problem: LeastSquaresProblem, noise, counts: list[np.ndarray]) -> _Drawn:
    """Under another loss than the square a datum stands there several times, and c of them have finite noise."""
    values = tuple(np.stack([np.asarray(v)] * MOST_COPIES) for v in problem.values)
    number = [np.arange(MOST_COPIES).reshape(-1, *([1] * np.ndim(v))) for v in problem.values]
    deviations = (
        np.where(n < np.minimum(c, MOST_COPIES)[:, None], s, np.inf)
        for n, c, s in zip(number, counts, noise, strict=True)
    )
    return _Drawn(
        replace(problem, predict=_Copied(problem.predict, MOST_COPIES), values=values), tuple(deviations), values
    )


def _count_cases(
    rng: np.random.Generator, size: int, groups: tuple[str, ...], values: Any, clusters: Mapping[str, tuple[str, Any]]
) -> list[np.ndarray]:
    """How often each datum is drawn, (size, *shape) by group."""
    drawn: dict[str, dict[Any, np.ndarray]] = {}
    for source, every in _cases(groups, values, clusters).items():
        times = rng.multinomial(len(every), np.full(len(every), 1 / len(every)), size=size)
        drawn[source] = dict(zip(every, times.T, strict=True))
    counts = []
    for name, group in zip(groups, values, strict=True):
        source, labels = _source(name, group, clusters)
        counts.append(np.stack([drawn[source][label] for label in labels], axis=1).reshape(size, *np.shape(group)))
    return counts


def _source(name: str, group: Any, clusters: Mapping[str, tuple[str, Any]]) -> tuple[str, list[Any]]:
    """What a group of data is drawn from, and the case of each datum."""
    source, labels = clusters.get(name, (name, np.arange(np.size(group))))
    return source, np.asarray(labels).tolist()


def _cases(groups: tuple[str, ...], values: Any, clusters: Mapping[str, tuple[str, Any]]) -> dict[str, list[Any]]:
    """By source, the cases that are drawn from: those of every group that draws from it, which may lack some."""
    found: dict[str, dict[Any, None]] = {}
    for name, group in zip(groups, values, strict=True):
        source, labels = _source(name, group, clusters)
        found.setdefault(source, {}).update(dict.fromkeys(labels))
    return {source: list(labels) for source, labels in found.items()}
