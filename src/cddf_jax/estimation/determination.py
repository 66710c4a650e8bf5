"""What data determine about parameters, from the thin SVD of the Jacobian at an estimate."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple, TypeVar

import numpy as np

from .evidence import Evidence, Uncertainty, spectrum_of
from .parameter_space import TINY

IDENTIFIED = "identified"
NOT_IDENTIFIED = "not identified"
PRIOR_ONLY = "prior only"
AT_BOUND = "at bound"
FIXED = "fixed"
LARGEST_RELATIVE_ERROR = 0.5  # of a parameter that is called identified
OF_ITSELF = 0.2  # largest error of a parameter that may be 0, over its value
ALL_OF_PRIOR = 0.98  # standard error over that of its prior, from which on the prior alone determines a parameter
NEGLIGIBLE_POWER = 0.02  # of a parameter in a direction, where the largest is 1; closer ones count as equal

T = TypeVar("T")


class Estimate(NamedTuple):
    """A number and how uncertain it is."""

    value: float
    standard_error: float
    confidence_interval: tuple[float, float]  # 95 %


def estimate(value: float, uncertainty: Uncertainty) -> Estimate:
    """The estimate of one quantity."""
    half_width = float(uncertainty.half_width[0])
    return Estimate(value, float(uncertainty.standard_error[0]), (value - half_width, value + half_width))


@dataclass(frozen=True, kw_only=True)
class Determination:
    """What some data determine about the parameters. The keys are names; arrays have the order of `names`."""

    names: tuple[str, ...]  # of the parameters that were fitted
    value: dict[str, float]  # estimate, SI
    standard_error: dict[str, float]  # inf where the data do not determine the parameter
    confidence_interval: dict[str, tuple[float, float]]  # 95 %, by t where noise was estimated; sides may differ
    status: dict[str, str]  # "identified", "not identified", "prior only", "at bound" or "fixed"
    combinations: dict[str, Estimate]  # products of powers of unidentified parameters that are identified
    sums: dict[str, Estimate]  # sums and differences of two unidentified parameters of one kind that are identified
    covariance: np.ndarray  # of the directions that the data determine
    correlation: np.ndarray  # of the same
    rank: int  # how many directions the data determine
    condition_number: float  # of the Jacobian scaled by noise and size of the parameters; inf without full rank

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


def determine(evidence: Evidence) -> Determination:
    """Standard errors, intervals and statuses from the rows of the Jacobian."""
    names, lower, upper = evidence.space.names, evidence.space.lower, evidence.space.upper
    value, size, spectrum = evidence.value, evidence.size, evidence.spectrum
    rank = len(spectrum.root)
    reach = evidence.uncertainty(np.eye(len(names)))
    error = reach.standard_error
    below, above = (np.ones((2, len(names))) if evidence.ends is None else evidence.ends.T) * reach.half_width
    low, high = value - below, value + above

    status = _statuses(evidence, error, low, high)
    lost = np.array([word == NOT_IDENTIFIED for word in status])
    additive = _may_be_zero(evidence) & (evidence.space.least_size > 0)  # errors and turns
    open_ended = lost | np.array([word == AT_BOUND for word in status])
    limit = np.minimum(high, upper)
    low, high = np.where(open_ended, lower, low), np.where(open_ended, upper, high)
    high[list(evidence.bounded_above)] = limit[list(evidence.bounded_above)]
    nearest_bound = np.where(value - lower < upper - value, lower, upper)
    spread = np.sqrt(np.diag(spectrum.covariance))
    with_products = evidence.products and evidence.noise_known and not evidence.failed

    def by_name(values: Iterable[T]) -> dict[str, T]:
        return dict(zip(names, values, strict=True))

    return Determination(
        names=names,
        value=by_name(np.where(evidence.at_bound, nearest_bound, value).tolist()),
        standard_error=by_name(np.where(open_ended, np.inf, error).tolist()),
        confidence_interval=by_name(zip(low.tolist(), high.tolist(), strict=True)),
        status=by_name(status),
        combinations=_combinations(evidence, lost & ~additive) if with_products else {},
        sums=_sums(evidence, lost & additive) if evidence.noise_known and not evidence.failed else {},
        covariance=spectrum.covariance * np.outer(size, size),
        correlation=spectrum.covariance / np.maximum(np.outer(spread, spread), TINY),
        rank=rank,
        condition_number=float(spectrum.values[0] / spectrum.values[-1]) if rank == len(names) else np.inf,
    )


def _statuses(evidence: Evidence, error: np.ndarray, low: np.ndarray, high: np.ndarray) -> list[str]:
    """The status of each parameter.

    Identified means: the 95 % interval closes inside the bounds, the relative error is below 0.5, and the fit did not
    fail. The error is the standard error, or more where one side of the interval is longer. A parameter that may be 0
    must be known to half of a size that matters, or to a fifth of its value: a parameter that noise makes large is then
    seldom called identified.
    """
    space = evidence.space
    may_be_zero = _may_be_zero(evidence)
    largest = error if evidence.ends is None else error * evidence.ends.max(axis=1)
    known = largest < LARGEST_RELATIVE_ERROR * np.where(may_be_zero, space.scale, evidence.size)
    known |= may_be_zero & (largest < OF_ITSELF * evidence.size)
    closed = (low > space.lower) & (high < space.upper)
    data_error = evidence.spectrum.relative_error * evidence.size
    if evidence.prior_rows:
        data_error = evidence.of(evidence.rows).spectrum.relative_error * evidence.size
    of_prior = np.full(len(error), np.nan)  # the size of a parameter over the standard deviation of its prior
    for i, row in evidence.prior_rows.items():
        of_prior[i] = np.abs(row[0, i])
    # the data alone do not determine it, and with the prior its standard error is that of the prior
    prior_only = ~(data_error < np.inf) & (error * of_prior > ALL_OF_PRIOR * evidence.size)
    identified = known & closed & (not evidence.failed)
    identified[list(evidence.open_profile)] = False
    words = [AT_BOUND, PRIOR_ONLY, IDENTIFIED]
    return np.select([evidence.at_bound, prior_only, identified], words, NOT_IDENTIFIED).tolist()


def _may_be_zero(evidence: Evidence) -> np.ndarray:
    return np.asarray((evidence.space.lower < 0) & (evidence.space.upper > 0))


def _combinations(evidence: Evidence, lost: np.ndarray) -> dict[str, Estimate]:
    """Products of powers of the unidentified parameters that the data determine."""
    found: dict[str, Estimate] = {}
    value = evidence.value[lost]
    if value.size < 2 or np.any(value <= 0):
        return found
    known, own = evidence.jacobian[:, ~lost], evidence.jacobian[:, lost]
    spectrum = spectrum_of((own - known @ np.linalg.lstsq(known, own)[0]) * (value / evidence.size[lost]))
    own_names = [name for name, gone in zip(evidence.space.names, lost, strict=True) if gone]
    first = int(np.argmin(own_names))
    for singular, direction in zip(spectrum.values, spectrum.directions, strict=True):
        if len(found) == len(own_names) - 1 or singular * LARGEST_RELATIVE_ERROR <= 1:
            break  # as many products as parameters would determine the parameters themselves
        held = np.abs(direction) > NEGLIGIBLE_POWER
        leading = first if held[first] else int(np.argmax(held))
        powers = direction * np.sign(direction[leading]) / np.abs(direction).max()  # the first: positive
        whole = np.round(powers)
        powers = np.where(np.abs(powers - whole) < NEGLIGIBLE_POWER, whole, np.round(powers, 2))
        product = float(np.exp(np.sum(powers * np.log(value))))
        slope = np.zeros((1, lost.size))
        slope[0, lost] = product * spectrum.within(powers) / value  # rounded powers point a little off these directions
        one = estimate(product, evidence.uncertainty(slope))
        if np.count_nonzero(powers) > 1 and np.isfinite(one.standard_error):  # a power alone is no product
            found[_product_name(own_names, powers)] = one
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
        slope = np.zeros((1, lost.size))
        slope[0, pair] = spectrum.within(np.array([1.0, factor]))  # the rounded factor points a little off them
        value = float(evidence.value[pair] @ [1.0, factor])
        found[f"{one} {'+' if factor > 0 else '-'} {parts}"] = estimate(value, evidence.uncertainty(slope))
    return found


def _product_name(names: Sequence[str], powers: np.ndarray) -> str:
    """For example `friction_coefficient / youngs_modulus`."""

    def factor(name: str, power: float) -> str:
        return name if power == 1 else f"{name}^{power:g}"

    above = [factor(n, p) for n, p in zip(names, powers, strict=True) if p > 0]
    below = [factor(n, -p) for n, p in zip(names, powers, strict=True) if p < 0]
    return " * ".join(above or ["1"]) + "".join(f" / {name}" for name in below)
