"""What data determine about parameters, from the thin SVD of the Jacobian at an estimate.

The Jacobian is scaled by the noise of the data and the size of the parameters, so that a singular value of s
stands for a standard error of 1 / s, relative, along its direction.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.special import stdtrit

from .parameter_space import TINY, ParameterSpace

IDENTIFIED = "identified"
NOT_IDENTIFIED = "not identified"
PRIOR_ONLY = "prior only"
AT_BOUND = "at bound"
FIXED = "fixed"
RELATIVE_RANK = 1e-9  # singular values below this times the largest are zero
LARGEST_RELATIVE_ERROR = 0.5  # of a parameter that is called identified
ALL_OF_PRIOR = 0.98  # standard error over that of its prior, from which on the prior alone determines a parameter
NEGLIGIBLE_POWER = 0.02  # of a parameter in a direction, where the largest is 1; closer ones count as equal
INSIDE = 1e-12  # difference from 1 below which a parameter lies within the determined directions

T = TypeVar("T")


class Estimate(NamedTuple):
    """A number and its standard error."""

    value: float
    standard_error: float


@dataclass(frozen=True, kw_only=True)
class Determination:
    """What some data determine about the parameters. The keys are names; arrays have the order of `names`."""

    names: tuple[str, ...]  # of the parameters that were fitted
    value: dict[str, float]  # estimate, SI
    standard_error: dict[str, float]  # inf where the data do not determine the parameter
    confidence_interval: dict[str, tuple[float, float]]  # 95 %, t-statistics where noise was estimated
    status: dict[str, str]  # "identified", "not identified", "prior only", "at bound" or "fixed"
    combinations: dict[str, Estimate]  # products of powers of unidentified parameters that are identified
    sums: dict[str, Estimate]  # sums and differences of two unidentified parameters of one kind that are identified
    covariance: np.ndarray  # of the directions that the data determine
    correlation: np.ndarray  # of the same
    singular_values: np.ndarray  # of the Jacobian scaled by noise and size of the parameters
    rank: int  # how many directions the data determine
    condition_number: float  # largest over smallest singular value; inf where some are zero
    sloppy_direction: dict[str, float]  # powers of the parameters in the least determined combination
    quantile: float  # half-width of a 95 % interval over its standard error, for noise of the data alone

    def __str__(self) -> str:
        lines = []
        for name, status in self.status.items():
            low, high = self.confidence_interval[name]
            number = "" if status == NOT_IDENTIFIED else f" = {self.value[name]:.4g}"
            if status == IDENTIFIED:
                number += f" +- {self.standard_error[name]:.2g} (95 %: {low:.4g} to {high:.4g})"
            lines.append(f"{name}{number}: {status}")
        together = self.identified_together.items()
        lines += [f"{name} = {e.value:.4g} +- {e.standard_error:.2g}: identified" for name, e in together]
        return "\n".join(lines)

    @property
    def identified_together(self) -> dict[str, Estimate]:
        """What is identified of parameters that are not identified themselves: `combinations` and `sums`."""
        return self.combinations | self.sums


@dataclass(frozen=True)
class Evidence:
    """The rows of the scaled Jacobian at an estimate, by group of data."""

    space: ParameterSpace
    value: np.ndarray
    size: np.ndarray  # of each parameter, the unit of the Jacobian's columns
    at_bound: np.ndarray
    rows: dict[str, np.ndarray]  # by group, (rows, parameters)
    prior_rows: dict[int, np.ndarray]  # by parameter
    noise_estimated: dict[str, bool]
    products: bool = True  # whether combinations of unidentified parameters may be written as products of powers
    open_profile: tuple[int, ...] = ()  # parameters that can move far while the sum of squares hardly rises
    bounded_above: tuple[int, ...] = ()  # parameters at the lower bound, with an upper 95 % limit
    random: tuple[int, ...] = ()  # random effects: draws about 0, with a standard deviation that was estimated
    kink: int | None = None  # the parameter that lies at a kink of the model
    failed: bool = False  # whether the fit failed, so that nothing is identified

    def of(self, groups: Collection[str], with_priors_of: Collection[str] = ()) -> "Evidence":
        """Only some groups of the data, and only the priors of the named parameters."""
        return replace(
            self,
            rows={name: self.rows[name] for name in groups},
            prior_rows={i: row for i, row in self.prior_rows.items() if self.space.names[i] in with_priors_of},
            noise_estimated={name: self.noise_estimated[name] for name in groups},
            open_profile=(),
            bounded_above=(),
        )

    def within(self, kept: Mapping[str, np.ndarray]) -> "Evidence":
        """Only some of the data: `kept` selects rows of its groups. Other groups and the priors stay complete."""
        rows = {name: own[kept[name]] if name in kept else own for name, own in self.rows.items()}
        return replace(self, rows=rows, open_profile=(), bounded_above=())

    @property
    def nearest_bound(self) -> np.ndarray:
        """By parameter, the bound that the value is closer to."""
        lower, upper = self.space.lower, self.space.upper
        return np.where(self.value - lower < upper - self.value, lower, upper)

    @cached_property
    def jacobian(self) -> np.ndarray:
        """All rows, those of the priors last."""
        return without_nan(np.concatenate([*self.rows.values(), *self.prior_rows.values()]))

    @cached_property
    def spectrum(self) -> "Spectrum":
        """The spectrum of all rows."""
        return spectrum_of(self.jacobian)

    @property
    def noise_freedom(self) -> float:
        """The degrees of freedom of the estimated noise; infinite if the noise was given."""
        freedom = max(len(self.jacobian) - int(self.spectrum.determined.sum()), 1)
        return float(freedom) if any(self.noise_estimated.values()) else np.inf


def without_nan(matrix: np.ndarray) -> np.ndarray:
    """The matrix with 0 for what is not finite."""
    return np.where(np.isfinite(matrix), matrix, 0.0)


class Spectrum(NamedTuple):
    """The thin SVD of a scaled Jacobian."""

    values: np.ndarray
    directions: np.ndarray  # rows
    determined: np.ndarray  # which are not zero
    covariance: np.ndarray  # relative, of the determined directions
    relative_error: np.ndarray  # of each parameter, inf if a part of it lies in a direction that is not determined

    def leverage(self, rows: np.ndarray) -> np.ndarray:
        """The variance of what is predicted for some rows of a Jacobian."""
        return np.einsum("ki,ij,kj->k", rows, self.covariance, rows)


def spectrum_of(jacobian: np.ndarray) -> Spectrum:
    """The thin SVD, and which of its directions the data determine."""
    _, values, directions = np.linalg.svd(jacobian, full_matrices=False)
    determined = values > RELATIVE_RANK * max(values.max(initial=0.0), TINY)
    scaled = directions[determined] / values[determined, None]
    covariance = scaled.T @ scaled
    reached = np.sum(directions[determined] ** 2, axis=0)  # 1 for a parameter within the determined directions
    error = np.where(reached < 1 - INSIDE, np.inf, np.sqrt(np.diag(covariance)))
    return Spectrum(values, directions, determined, covariance, error)


def determine(evidence: Evidence) -> Determination:
    """Standard errors, intervals and statuses from the rows of the Jacobian."""
    names, lower, upper = evidence.space.names, evidence.space.lower, evidence.space.upper
    value, size, jacobian, spectrum = evidence.value, evidence.size, evidence.jacobian, evidence.spectrum
    rank = int(spectrum.determined.sum())
    freedom = jacobian.shape[0] - rank
    error = spectrum.relative_error * size
    noise_known = freedom > 0 or not any(evidence.noise_estimated.values())
    error = error if noise_known else np.full_like(error, np.inf)
    quantile = quantiles(evidence, np.eye(len(names)))

    status = _statuses(evidence, error, quantile)
    lost = np.array([word == NOT_IDENTIFIED for word in status])
    additive = ~np.isfinite(lower) & (evidence.space.least_size > 0)  # errors and turns, which may be 0
    open_ended = lost | np.array([word == AT_BOUND for word in status])
    low, high = value - quantile * error, value + quantile * error
    limit = np.minimum(high, upper)
    low, high = np.where(open_ended, lower, low), np.where(open_ended, upper, high)
    high[list(evidence.bounded_above)] = limit[list(evidence.bounded_above)]
    spread = np.sqrt(np.diag(spectrum.covariance))
    sloppy = spectrum.directions[-1] / max(np.abs(spectrum.directions[-1]).max(), TINY)
    sloppy = sloppy * np.sign(sloppy[np.argmax(np.abs(sloppy) > NEGLIGIBLE_POWER)])  # the first that matters: positive
    with_products = evidence.products and noise_known and not evidence.failed

    def by_name(values: Iterable[T]) -> dict[str, T]:
        return dict(zip(names, values, strict=True))

    return Determination(
        names=names,
        value=by_name(np.where(evidence.at_bound, evidence.nearest_bound, value).tolist()),
        standard_error=by_name(np.where(open_ended, np.inf, error).tolist()),
        confidence_interval=by_name(zip(low.tolist(), high.tolist(), strict=True)),
        status=by_name(status),
        combinations=_combinations(names, value, lost & ~additive, jacobian) if with_products else {},
        sums=_sums(evidence, lost & additive) if noise_known and not evidence.failed else {},
        covariance=spectrum.covariance * np.outer(size, size),
        correlation=spectrum.covariance / np.maximum(np.outer(spread, spread), TINY),
        singular_values=spectrum.values,
        rank=rank,
        condition_number=float(spectrum.values[0] / spectrum.values[-1]) if rank == len(names) else np.inf,
        sloppy_direction=by_name(sloppy.tolist()),
        quantile=float(stdtrit(evidence.noise_freedom, 0.975)),
    )


def quantiles(evidence: Evidence, directions: np.ndarray) -> np.ndarray:
    """Half-widths of 95 % intervals over their standard errors, of linear combinations (rows) of scaled parameters.

    They are quantiles of the t distribution if noise was estimated, with the degrees of freedom of Satterthwaite
    (1946), Biometrics Bulletin 2, 110: each group of data with its own estimated noise, and the estimated spread of
    random effects, counts by its part of the variance. Estimated noise gives the groups weights that are not the best;
    the variance grows by what Kenward and Roger (1997), Biometrics 53, 983, find for it.
    """
    covariance = evidence.spectrum.covariance
    along = directions @ covariance
    variance = np.maximum(np.sum(along * directions, axis=1), TINY)
    uncertainty, growth = np.zeros(len(directions)), np.zeros(len(directions))
    for name in (name for name, estimated in evidence.noise_estimated.items() if estimated):
        rows = without_nan(evidence.rows[name])
        freedom = max(len(rows) - evidence.spectrum.leverage(rows).sum(), 1.0)
        own = along @ (rows.T @ rows)
        part, shared = (np.sum(own * other, axis=1) / variance for other in (along, own @ covariance))
        uncertainty += part**2 / freedom
        growth += 4 / freedom * np.maximum(part - shared, 0.0)
    if evidence.random:
        part = sum((along[:, k] * evidence.prior_rows[k][0, k]) ** 2 for k in evidence.random) / variance
        uncertainty += part**2 / (len(evidence.random) - 1)
    freedom = np.maximum(1 / np.maximum(uncertainty, TINY), 1.0)
    return stdtrit(freedom, 0.975) * np.sqrt(1 + growth)


def _statuses(evidence: Evidence, error: np.ndarray, quantile: np.ndarray) -> list[str]:
    """The status of each parameter.

    Identified means: the 95 % interval closes inside the bounds, the relative standard error is below 0.5, and the fit
    did not fail.
    """
    space, value = evidence.space, evidence.value
    # a parameter without a lower bound may be 0: its scale counts as its size where that is larger
    scale = np.where(np.isfinite(space.lower), 0.0, space.scale)
    known = error < LARGEST_RELATIVE_ERROR * np.maximum(evidence.size, scale)
    closed = (value - quantile * error > space.lower) & (value + quantile * error < space.upper)
    data_error = evidence.spectrum.relative_error * evidence.size
    if evidence.prior_rows:
        data_error = evidence.of(evidence.rows).spectrum.relative_error * evidence.size
    of_prior = np.full(len(value), np.nan)  # the size of a parameter over the standard deviation of its prior
    for i, row in evidence.prior_rows.items():
        of_prior[i] = np.abs(row[0, i])
    # the data alone do not determine it, and with the prior its standard error is that of the prior
    prior_only = ~(data_error < np.inf) & (error * of_prior > ALL_OF_PRIOR * evidence.size)
    identified = known & closed & (not evidence.failed)
    identified[list(evidence.open_profile)] = False
    words = [AT_BOUND, PRIOR_ONLY, IDENTIFIED]
    return np.select([evidence.at_bound, prior_only, identified], words, NOT_IDENTIFIED).tolist()


def _combinations(
    names: tuple[str, ...], value: np.ndarray, lost: np.ndarray, jacobian: np.ndarray
) -> dict[str, Estimate]:
    """Products of powers of the unidentified parameters that the data determine."""
    found: dict[str, Estimate] = {}
    if np.count_nonzero(lost) < 2 or np.any(value[lost] <= 0):
        return found
    known, own = jacobian[:, ~lost], jacobian[:, lost]
    spectrum = spectrum_of(own - known @ np.linalg.lstsq(known, own)[0])
    own_names = [name for name, gone in zip(names, lost, strict=True) if gone]
    first = int(np.argmin(own_names))
    for singular, direction in zip(spectrum.values, spectrum.directions, strict=True):
        if len(found) == len(own_names) - 1 or singular * LARGEST_RELATIVE_ERROR <= 1:
            break  # as many products as parameters would determine the parameters themselves
        held = np.abs(direction) > NEGLIGIBLE_POWER
        leading = first if held[first] else int(np.argmax(held))
        powers = direction * np.sign(direction[leading]) / np.abs(direction).max()  # the first: positive
        whole = np.round(powers)
        powers = np.where(np.abs(powers - whole) < NEGLIGIBLE_POWER, whole, np.round(powers, 2))
        product = float(np.exp(np.sum(powers * np.log(value[lost]))))
        along = spectrum.directions[spectrum.determined] @ powers / spectrum.values[spectrum.determined]
        found[_product_name(own_names, powers)] = Estimate(product, product * float(np.linalg.norm(along)))
    return found


def _sums(evidence: Evidence, lost: np.ndarray) -> dict[str, Estimate]:
    """Sums and differences of pairs of unidentified parameters that may be 0 and have one scale."""
    space, found = evidence.space, {}
    for pair in map(list, combinations(np.flatnonzero(lost), 2)):
        scale = space.scale[pair[0]]
        if space.scale[pair[1]] != scale:
            continue
        others, own = np.delete(evidence.jacobian, pair, axis=1), evidence.jacobian[:, pair]
        own = own * (scale / evidence.size[pair])
        spectrum = spectrum_of(own - others @ np.linalg.lstsq(others, own)[0])
        direction = (
            spectrum.directions[0] / spectrum.directions[0, 0] if spectrum.directions[0, 0] else np.array([0.0, 1.0])
        )
        if spectrum.values[0] * LARGEST_RELATIVE_ERROR <= 1 or np.abs(spectrum.directions[0]).min() <= NEGLIGIBLE_POWER:
            continue
        factor = np.round(direction[1]) if abs(abs(direction[1]) - 1) < NEGLIGIBLE_POWER else np.round(direction[1], 2)
        one, other = (space.names[i] for i in pair)
        parts = f"{abs(factor):g} {other}" if abs(factor) != 1 else other
        error = float(scale) * float(np.hypot(1.0, factor)) / float(spectrum.values[0])
        value = float(evidence.value[pair] @ [1.0, factor])
        found[f"{one} {'+' if factor > 0 else '-'} {parts}"] = Estimate(value, error)
    return found


def _product_name(names: Sequence[str], powers: np.ndarray) -> str:
    """For example `friction_coefficient / youngs_modulus`."""

    def factor(name: str, power: float) -> str:
        return name if power == 1 else f"{name}^{power:g}"

    above = [factor(n, p) for n, p in zip(names, powers, strict=True) if p > 0]
    below = [factor(n, -p) for n, p in zip(names, powers, strict=True) if p < 0]
    return " * ".join(above or ["1"]) + "".join(f" / {name}" for name in below)
