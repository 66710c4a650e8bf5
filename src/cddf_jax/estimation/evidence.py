"""The rows of the scaled Jacobian at an estimate, and how uncertain they leave any quantity.

The Jacobian is scaled by the noise of the data and the size of the parameters, so that a singular value of s
stands for a standard error of 1 / s, relative, along its direction.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.special import stdtrit

from .parameter_space import TINY, ParameterSpace
from .residuals import Shared

RELATIVE_RANK = 1e-9  # singular values below this times the largest are zero
INSIDE = 1e-12  # difference from 1 below which a parameter lies within the determined directions
UNDETERMINED = 1e-10  # part of a quantity's squared slope along directions that the data leave open
GIVEN = 1e9  # degrees of freedom that count as infinite
RIDGE = 1e-12  # of the information on the noise, for parts of it that no datum tells apart
NONE_LEFT = 1e-8  # of the information on the noise without parameters: rounding may leave less than this of none


class Spectrum(NamedTuple):
    """The thin SVD of a scaled Jacobian."""

    values: np.ndarray
    directions: np.ndarray  # rows
    determined: np.ndarray  # which are not zero
    root: np.ndarray  # (determined, parameters): the determined directions over their singular values
    relative_error: np.ndarray  # of each parameter, inf if a part of it lies in a direction that is not determined

    @property
    def covariance(self) -> np.ndarray:
        """Relative, of the determined directions."""
        return self.root.T @ self.root

    def within(self, row: np.ndarray) -> np.ndarray:
        """The part of a row along the determined directions."""
        directions = self.directions[self.determined]
        return row @ directions.T @ directions

    def leverage(self, rows: np.ndarray) -> np.ndarray:
        """The variance of what is predicted for some rows of a Jacobian."""
        return np.sum((rows @ self.root.T) ** 2, axis=1)


def spectrum_of(jacobian: np.ndarray) -> Spectrum:
    """The thin SVD, and which of its directions the data determine."""
    _, values, directions = np.linalg.svd(jacobian, full_matrices=False)
    determined = values > RELATIVE_RANK * max(values.max(initial=0.0), TINY)
    root = directions[determined] / values[determined, None]
    reached = np.sum(directions[determined] ** 2, axis=0)  # 1 for a parameter within the determined directions
    error = np.where(reached < 1 - INSIDE, np.inf, np.linalg.norm(root, axis=0))
    return Spectrum(values, directions, determined, root, error)


def without_nan(matrix: np.ndarray) -> np.ndarray:
    """The matrix with 0 for what is not finite."""
    return np.where(np.isfinite(matrix), matrix, 0.0)


class Uncertainty(NamedTuple):
    """How uncertain some quantities are, one entry for each."""

    standard_error: np.ndarray  # inf for a quantity that depends on what the data do not determine
    freedom: np.ndarray  # degrees of freedom of the variance, at least 1; inf where all noise is given
    growth: np.ndarray  # of the variance by weights from estimated noise, relative

    @property
    def quantile(self) -> np.ndarray:
        """The half-width of a 95 % interval over its standard error."""
        return stdtrit(self.freedom, 0.975) * np.sqrt(1 + self.growth)

    @property
    def half_width(self) -> np.ndarray:
        """Of the 95 % interval."""
        return self.quantile * self.standard_error


class EstimatedNoise(NamedTuple):
    """The estimated parts of the variances, in coordinates in which the covariance of the parameters is 1."""

    pull: np.ndarray  # (parts, determined, determined): minus the derivative of the information by each part
    covariance: np.ndarray  # (parts, parts), of the estimated parts, relative to the variances
    growth: np.ndarray  # (determined, determined), of the covariance of the parameters


@dataclass(frozen=True)
class Evidence:
    """The rows of the scaled Jacobian at an estimate, by group of data."""

    space: ParameterSpace
    value: np.ndarray
    size: np.ndarray  # of each parameter, the unit of the Jacobian's columns
    at_bound: np.ndarray
    rows: dict[str, np.ndarray]  # by group, (rows, parameters)
    prior_rows: dict[int, np.ndarray]  # by parameter
    noise_slopes: dict[str, np.ndarray]  # by group, (rows, parts): see `Observed.noise_slopes`; no parts where given
    shared: Shared  # errors of inputs in the data; the rows of data are whitened
    estimated_inputs: tuple[str, ...] = ()  # input groups whose standard deviation was estimated
    products: bool = True  # whether combinations of unidentified parameters may be written as products of powers
    open_profile: tuple[int, ...] = ()  # parameters that can move far while the sum of squares hardly rises
    bounded_above: tuple[int, ...] = ()  # parameters at the lower bound, with an upper 95 % limit
    ends: np.ndarray | None = None  # (parameters, 2), of 95 % intervals below and above, in half-widths; None: all 1
    random: tuple[int, ...] = ()  # random effects: draws about 0, with a standard deviation that was estimated
    kink: int | None = None  # the parameter that lies at a kink of the model
    failed: bool = False  # whether the fit failed, so that nothing is identified

    def of(self, groups: Collection[str], with_priors_of: Collection[str] = ()) -> "Evidence":
        """Only some groups of the data, and only the priors of the named parameters.

        The rows are whitened anew: what they have in common with other rows no longer counts.
        """
        if unknown := [name for name in groups if name not in self.rows]:
            raise KeyError(unknown[0])
        kept = [name for name in self.rows if name in groups]  # in the order of `shared`
        which = np.concatenate([np.full(len(own), name in groups) for name, own in self.rows.items()])
        raw = self.shared.unwhitened(without_nan(np.concatenate([*self.rows.values()])))
        shared = self.shared.at(which)
        ends = np.cumsum([len(self.rows[name]) for name in kept])[:-1]
        return replace(
            self,
            rows=dict(zip(kept, np.split(shared.whitened(raw[which]), ends), strict=True)),
            prior_rows={i: row for i, row in self.prior_rows.items() if self.space.names[i] in with_priors_of},
            noise_slopes={name: self.noise_slopes[name] for name in kept},
            shared=shared,
            random=tuple(i for i in self.random if self.space.names[i] in with_priors_of),
            open_profile=(),
            bounded_above=(),
            ends=None,
        )

    def enlarged(self, factors: Mapping[str, float]) -> "Evidence":
        """With the variance of the noise of some groups times a factor, as where their data are not independent."""
        rows = {name: own / np.sqrt(factors.get(name, 1.0)) for name, own in self.rows.items()}
        return replace(self, rows=rows)

    @cached_property
    def jacobian(self) -> np.ndarray:
        """All rows, those of the priors last."""
        return without_nan(np.concatenate([*self.rows.values(), *self.prior_rows.values()]))

    @cached_property
    def spectrum(self) -> Spectrum:
        """The spectrum of all rows."""
        return spectrum_of(self.jacobian)

    @property
    def noise_estimated(self) -> dict[str, bool]:
        """By group, whether its noise was estimated."""
        return {name: slopes.shape[1] > 0 for name, slopes in self.noise_slopes.items()}

    @property
    def noise_known(self) -> bool:
        """Whether all noise was given, or some data were left to estimate it."""
        return len(self.jacobian) > len(self.spectrum.root) or not any(self.noise_estimated.values())

    def uncertainty(self, slopes: np.ndarray) -> Uncertainty:
        """Of quantities with these derivatives by the parameters (rows: quantities). All intervals come from here.

        The degrees of freedom are those of Satterthwaite (1946), Biometrics Bulletin 2, 110: each estimated part of the
        noise, and the estimated spread of random effects, counts by its part of the variance. Weights from estimated
        noise are not the best; the variance grows by what Kenward and Roger (1997), Biometrics 53, 983, find for it.
        """
        scaled, spectrum, noise = slopes * self.size, self.spectrum, self._estimated_noise
        along, whole = scaled @ spectrum.root.T, np.sum(scaled**2, axis=1)
        outside = whole - np.sum(spectrum.within(scaled) ** 2, axis=1) > UNDETERMINED * whole
        error = np.linalg.norm(along, axis=1)
        unit = along / np.maximum(error, TINY)[:, None]
        share = np.einsum("qr,irs,qs->qi", unit, noise.pull, unit)
        uncertain = np.einsum("qi,ij,qj->q", share, noise.covariance, share)
        return Uncertainty(
            np.where(outside, np.inf, error) if self.noise_known else np.full(len(error), np.inf),
            np.where(uncertain > TINY, np.maximum(2 / np.maximum(uncertain, TINY), 1.0), np.inf),
            np.maximum(np.einsum("qr,rs,qs->q", unit, noise.growth, unit), 0.0),
        )

    @cached_property
    def _estimated_noise(self) -> EstimatedNoise:
        """The information of restricted likelihood on the parts of the variances, and what follows from it.

        A group of data has one part, or floor and fraction, and inputs have one. Random effects are one more group,
        with rows of priors.
        """
        root, shared, count = self.spectrum.root, self.shared, len(self.shared.basis)
        rows = np.concatenate([*self.rows.values(), *(self.prior_rows[k] for k in self.random)])
        rows = without_nan(rows) @ root.T
        weight = np.asarray(
            block_diag(*self.noise_slopes.values(), *[np.ones((len(self.random), 1))] * bool(self.random))
        )

        def whitened(some: np.ndarray) -> np.ndarray:
            return np.concatenate([shared.whitened(some[:count]), some[count:]])

        inner = whitened(rows)
        moved = [whitened(own[:, None] * inner) for own in weight.T]  # each part of the variance, times the rows
        inputs = [own for name in self.estimated_inputs if np.any(own := np.asarray(shared.columns[name]))]
        for own in inputs:
            effect = np.zeros((len(rows), own.shape[1]))
            effect[:count] = shared.whitened(own)
            moved.append(effect @ (effect.T @ rows))
        if not moved:
            return EstimatedNoise(np.zeros((0, len(root), len(root))), np.zeros((0, 0)), np.zeros((len(root),) * 2))
        along, pull = np.stack(moved), np.stack([rows.T @ own for own in moved])
        twice = np.einsum("inr,jns->ijrs", along, along)
        whole = _traces(weight, inputs, shared)
        information = (whole - 2 * np.einsum("ijrr->ij", twice) + np.einsum("irs,jsr->ij", pull, pull)) / 2
        ridge = RIDGE * max(np.trace(information), NONE_LEFT * np.trace(whole) / 2)
        covariance = np.linalg.inv(information + ridge * np.eye(len(pull)))
        common = np.einsum("irs,ist->rt", pull, np.tensordot(covariance, pull, 1))
        return EstimatedNoise(pull, covariance, 2 * (np.einsum("ij,ijrs->rs", covariance, twice) - common))


def _traces(weight: np.ndarray, inputs: list[np.ndarray], shared: Shared) -> np.ndarray:
    """(parts, parts), the trace of the product of two parts of the whitened variance."""
    count = len(shared.basis)
    if not shared.basis.shape[1]:
        return weight.T @ weight
    inverse, own = shared.inverse, weight[:count]
    found = weight[count:].T @ weight[count:] + own.T @ inverse**2 @ own
    if not inputs:
        return found
    across = np.stack([own.T @ np.sum((inverse @ some) ** 2, axis=1) for some in inputs])
    among = np.array([[np.sum((one.T @ inverse @ other) ** 2) for other in inputs] for one in inputs])
    return np.block([[found, across.T], [across, among]])
