"""Refits to data drawn anew: how an estimate would scatter, without the linearisation of the model.

"parametric" draws new noise about the fitted model; "cases" draws whole cases (rows, or trials where there are
trials) from the data with replacement. With few cases its intervals are too narrow: `coverage` says how much.
"""

import json
from collections.abc import Callable, Hashable, Mapping, Sequence
from os import PathLike
from typing import NamedTuple, TypedDict

import numpy as np
from jaxtyping import ArrayLike
from scipy.special import ndtri, stdtr

from ..batch.chunks import Coordinate, Index, Layout, Variable, even_chunks
from ..batch.fingerprint import digest, numbers_of
from ..batch.work import Work, carry_out
from ..errors import InputError
from .levenberg_marquardt import Minimum, Redrawn, minimise_all
from .residuals import Deviations

CHUNK = 250  # refits at once: bounds the memory, and shows progress
KINDS = ("parametric", "cases")
LEAST_COVERAGE = 0.93  # of 95 % intervals, below which a remark is made

Clusters = Mapping[str, tuple[str, Sequence[Hashable] | np.ndarray]]
# by group of data, the name of what is drawn from and one label for each datum
Sources = list[tuple[str, list[Hashable]]]  # by group, what it is drawn from and the case of each datum
Path = str | PathLike[str]
Draw = tuple[Deviations, Redrawn]  # of many fits: noise and data have a leading axis, or are those of all


class Bootstrap(NamedTuple):
    """Estimates from data drawn anew. All statistics are NaN where fewer than two refits ended at a minimum."""

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
            drawn = f"the noise estimate has only {self.noise_freedom:.0f} degree(s) of freedom"
        else:
            drawn = f"drawn from {self.num_cases} case(s) only"
        return (
            f"{drawn}: even for a plain mean such 95 % intervals contain the truth in {100 * self.coverage:.0f} % of "
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


class BootstrapOptions(TypedDict, total=False):
    """What a bootstrap may be given; see `bootstrap`."""

    clusters: Clusters | None
    seed: int
    progress: bool
    out: Path | None


def bootstrap(
    minimum: Minimum,
    names: tuple[str, ...],
    groups: tuple[str, ...],
    kind: str,
    replicates: int,
    *,
    clusters: Clusters | None = None,
    noise_freedom: float = np.inf,
    seed: int = 0,
    progress: bool = False,
    out: Path | None = None,
) -> Bootstrap:
    """Draw data anew and fit them from the estimate on, the weights of the data held.

    A prior counts as one more reading and is drawn anew too; under a robust loss it is held.

    Args:
        minimum: where the fit ended.
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
        InputError: for an unknown kind, too few replicates, clusters that fit no group, a store of other work.
    """
    values = minimum.problem.values
    if kind not in KINDS:
        raise InputError(f"bootstrap: kind {kind!r} is not known; there are {', '.join(KINDS)}")
    if replicates < 2:
        raise InputError(f"bootstrap: needs 2 replicates or more, got {replicates}")
    clusters = clusters or {}
    for name, (_, labels) in clusters.items():
        if name not in groups or len(labels) != np.size(values[groups.index(name)]):
            raise InputError(f"bootstrap: clusters of {name!r} need one label for each datum of a group of data")

    def draw(layout: Layout, index: Index) -> Draw:
        size, rng = layout.count(index), np.random.default_rng([seed, *index])
        if kind == "parametric":
            return _draw_noise(rng, size, minimum)
        return _draw_cases(rng, size, minimum, groups, clusters)

    of_draws = {"kind": kind, "seed": seed}
    found = _refit_all(minimum, names, draw, "replicate", replicates, of_draws, clusters, progress=progress, out=out)
    kept, failed = found.estimates[found.ended], int(np.sum(~found.ended))
    cases = [len(every) for every in _cases(_sources(groups, values, clusters)).values()]
    num_cases = min(cases) if kind == "cases" else 0
    return Bootstrap(kind, names, kept, minimum.outcome.parameters, failed, seed, num_cases, noise_freedom)


class Refits(NamedTuple):
    """Estimates from the data of many benches."""

    names: tuple[str, ...]
    estimates: np.ndarray  # (benches, parameters)
    ended: np.ndarray  # (benches,), at a minimum; the estimates of others are NaN


def refits(
    minimum: Minimum,
    names: tuple[str, ...],
    groups: tuple[str, ...],
    observed: Mapping[str, ArrayLike],
    *,
    progress: bool = False,
    out: Path | None = None,
) -> Refits:
    """Fit the data of many benches from the estimate on; see `LeastSquaresFit.refits`."""
    problem, noise, _ = minimum
    data = {name: np.asarray(values, float) for name, values in observed.items()}
    shapes = {name: np.shape(value) for name, value in zip(groups, problem.values, strict=True)}
    for name, values in data.items():
        if name not in shapes:
            raise InputError(f"refits: {name!r} is not a group of data; there are {', '.join(groups)}")
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

    def draw(layout: Layout, index: Index) -> Draw:
        places = layout.region(index)[0]
        own = zip(groups, problem.values, strict=True)
        return noise, Redrawn(tuple(data[name][places] if name in data else np.asarray(v) for name, v in own))

    return _refit_all(minimum, names, draw, "bench", counts.pop(), {}, data, progress=progress, out=out)


def _refit_all(
    minimum: Minimum,
    names: tuple[str, ...],
    draw: Callable[[Layout, Index], Draw],
    dimension: str,
    count: int,
    of_draws: Mapping[str, object],
    drawn_from: object,
    *,
    progress: bool,
    out: Path | None,
) -> Refits:
    """All the refits, chunk by chunk; what is drawn, and from what, tells a store of other work apart."""
    problem, noise, best = minimum
    estimate = Variable((dimension, "parameter"), (count, len(names)), np.dtype(float), {"long_name": "estimate"})
    ended = Variable((dimension,), (count,), np.dtype(bool), {"long_name": "ended at a minimum"})
    coords: dict[str, Coordinate] = {"parameter": (("parameter",), np.asarray(names), {})}
    variables = {"estimate": estimate, "ended": ended}
    layout = Layout(
        {dimension: count}, even_chunks([count], CHUNK, [False]), coords, variables, {"title": "cddf_jax refits"}
    )

    def refit(layout: Layout, index: Index) -> dict[str, np.ndarray]:
        weights, drawn = draw(layout, index)
        z = np.broadcast_to(best.z, (layout.count(index), best.z.size))
        found = minimise_all(problem, weights, z, drawn=drawn)
        pressed = np.any(problem.space.at_bound(found.parameters), axis=1)  # there a search has always a step left
        good = (found.solved | pressed) & np.isfinite(found.cost) & np.all(np.isfinite(found.parameters), axis=1)
        return {"estimate": np.where(good[:, None], found.parameters, np.nan), "ended": good}

    def identity() -> dict[str, object]:
        data_and_model = digest(json.dumps(numbers_of((problem, noise, best.z, drawn_from))))
        return {**of_draws, "data and model": data_and_model, dimension: count, "parameters": list(names)}

    found = carry_out(Work(layout, identity, refit), out, progress=progress).values()
    return Refits(names, found["estimate"], found["ended"])


def _draw_noise(rng: np.random.Generator, size: int, minimum: Minimum) -> Draw:
    """New noise about the fitted model, and about the estimate in place of the priors' means."""
    problem, noise, best = minimum
    values = tuple(
        np.asarray(v) + r.reshape(np.shape(v)) * s + s * rng.normal(size=(size, *np.shape(v)))
        for v, r, s in zip(problem.values, problem.by_group(best.residual), noise, strict=True)
    )
    means = _draw_priors(rng, size, minimum, {i: best.parameters[i] for i in problem.prior})
    return noise, Redrawn(values, means)


def _draw_cases(
    rng: np.random.Generator, size: int, minimum: Minimum, groups: tuple[str, ...], clusters: Clusters
) -> Draw:
    """Data with replacement; a prior's mean is drawn about itself."""
    problem, noise, _ = minimum
    counts = _count_cases(rng, size, groups, problem.values, clusters)
    if problem.loss != "linear":
        return noise, Redrawn(times=tuple(counts))
    means = _draw_priors(rng, size, minimum, {i: prior.mean for i, prior in problem.prior.items()})
    with np.errstate(divide="ignore"):  # c times a square is that of noise over the root of c; infinite where c is 0
        return tuple(s / np.sqrt(c) for s, c in zip(noise, counts, strict=True)), Redrawn(means=means)


def _draw_priors(
    rng: np.random.Generator, size: int, minimum: Minimum, about: Mapping[int, ArrayLike]
) -> tuple[np.ndarray, ...] | None:
    """Means of the priors, (size,) each; None, as they are, under a robust loss, which softens no prior."""
    if minimum.problem.loss != "linear":
        return None
    return tuple(
        np.asarray(about[i]) + np.asarray(prior.standard_deviation) * rng.normal(size=size)
        for i, prior in minimum.problem.prior.items()
    )


def _count_cases(
    rng: np.random.Generator, size: int, groups: tuple[str, ...], values: Sequence[ArrayLike], clusters: Clusters
) -> list[np.ndarray]:
    """How often each datum is drawn, (size, *shape) by group."""
    sources, drawn = _sources(groups, values, clusters), {}
    for source, every in _cases(sources).items():
        times = rng.multinomial(len(every), np.full(len(every), 1 / len(every)), size=size)
        drawn[source] = dict(zip(every, times.T, strict=True))
    counts = (np.stack([drawn[source][label] for label in labels], axis=1) for source, labels in sources)
    return [count.reshape(size, *np.shape(group)) for count, group in zip(counts, values, strict=True)]


def _sources(groups: tuple[str, ...], values: Sequence[ArrayLike], clusters: Clusters) -> Sources:
    rows = ((name, np.arange(np.size(group))) for name, group in zip(groups, values, strict=True))
    given = (clusters.get(name, (name, own)) for name, own in rows)
    return [(source, np.asarray(labels).tolist()) for source, labels in given]


def _cases(sources: Sources) -> dict[str, list[Hashable]]:
    """By source, the cases that are drawn from: those of every group that draws from it, which may lack some."""
    found: dict[str, dict[Hashable, None]] = {}
    for source, labels in sources:
        found.setdefault(source, {}).update(dict.fromkeys(labels))
    return {source: list(labels) for source, labels in found.items()}
