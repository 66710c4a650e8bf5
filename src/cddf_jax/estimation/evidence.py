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
from scipy.special import fdtri, stdtrit

from .parameter_space import TINY, ParameterSpace

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

    @property
    def quantile_of_two(self) -> np.ndarray:
        """The same ratio for the joint 95 % region of two quantities, along the direction of each entry."""
        return np.sqrt(2 * fdtri(2, np.minimum(self.freedom, GIVEN), 0.95) * (1 + self.growth))


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
            noise_slopes={name: self.noise_slopes[name] for name in groups},
            random=tuple(i for i in self.random if self.space.names[i] in with_priors_of),
            open_profile=(),
            bounded_above=(),
        )

    def within(self, kept: Mapping[str, np.ndarray]) -> "Evidence":
        """Only some of the data: `kept` selects rows of its groups. Other groups and the priors stay complete."""
        rows, slopes = (
            {name: own[kept[name]] if name in kept else own for name, own in every.items()}
            for every in (self.rows, self.noise_slopes)
        )
        return replace(self, rows=rows, noise_slopes=slopes, open_profile=(), bounded_above=())

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

    def freedom_of(self, group: str) -> float:
        """The readings of a group, less what the parameters take of them."""
        rows = without_nan(self.rows[group])
        return len(rows) - float(np.sum(self.spectrum.leverage(rows)))

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

        A group of data has one part, or floor and fraction. Random effects are one more group, with rows of priors.
        """
        root = self.spectrum.root
        groups = [(without_nan(self.rows[name]), slopes) for name, slopes in self.noise_slopes.items()]
        if self.random:
            rows = np.concatenate([self.prior_rows[k] for k in self.random])
            groups.append((rows, np.ones((len(rows), 1))))
        groups = [(rows @ root.T, slopes) for rows, slopes in groups if slopes.shape[1]]
        if not groups:
            return EstimatedNoise(np.zeros((0, len(root), len(root))), np.zeros((0, 0)), np.zeros((len(root),) * 2))
        pull = np.concatenate([np.einsum("ki,kr,ks->irs", slopes, rows, rows) for rows, slopes in groups])
        own = (slopes.T @ ((1 - 2 * np.sum(rows**2, axis=1))[:, None] * slopes) for rows, slopes in groups)
        information = (block_diag(*own) + np.einsum("irs,jsr->ij", pull, pull)) / 2
        whole = sum(np.sum(slopes**2) for _, slopes in groups) / 2
        ridge = RIDGE * max(np.trace(information), NONE_LEFT * whole)
        covariance = np.linalg.inv(information + ridge * np.eye(len(pull)))
        shared, growth, first = np.einsum("irs,ist->rt", pull, np.tensordot(covariance, pull, 1)), 0.0, 0
        for rows, slopes in groups:
            parts = slice(first, first + slopes.shape[1])
            weight = np.sum(slopes @ covariance[parts, parts] * slopes, axis=1)
            growth, first = growth + rows.T @ (weight[:, None] * rows), parts.stop
        return EstimatedNoise(pull, covariance, 2 * (growth - shared))
